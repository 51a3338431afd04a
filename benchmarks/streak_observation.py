"""Must a policy observe the current and the longest streak, if the longest streak is limited?

    python benchmarks/streak_observation.py --out FOLDER

Trains PPO-Lag with `--streak-limit 10` on SafetyPointGoal1, with normalised observations, with and
without both numbers in the observation, and prints measures of the last third of training: mean
over seeds with the range. It can be interrupted: given again, it continues.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from streaks import rows_of

import agents
from agents.algorithms import ppo_lag
from agents.lockstep.streaks import Streaks
from emcc.augmented import augmented

STEPS, SEEDS, LIMIT = 300_000, (0, 1, 2), 10.0
SHOWN = {"longest": "longest streak", "EMCC": "EMCC", "rate": "cost rate"}
SHOWN |= {"cost": "cost", "return": "return"}
"""Columns of `streaks.rows_of` and their headings."""


@dataclass(frozen=True)
class BlindConfig(ppo_lag.PPOLagConfig):
    """PPO-Lag's config, with the same record cost, but without streaks in the observation."""

    def wrap(self, env, costs, time_limit):
        return augmented(env, Streaks(cost=costs[0], scale=None))


agents.register("ppo-lag-blind", ppo_lag.ALGORITHM._replace(config=BlindConfig))


def main():
    """Train what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--steps", type=int, default=STEPS)
    options = parser.parse_args()
    sides = {"seen": "ppo-lag", "not seen": "ppo-lag-blind"}
    for k, (side, name) in enumerate(sides.items()):
        folder = options.out / name
        if (folder / "config.json").exists():
            agents.resume(folder)
        else:
            own = {"normalize_observations": True, "streak_limit": LIMIT, "preset": "none"}
            own |= {"seeds": SEEDS, "steps": options.steps, "evaluation_episodes": 10}
            agents.train(name, "SafetyPointGoal1-v0", out=folder, **own)
        found = pd.DataFrame(rows_of(folder))
        if k == 0:
            print(f"| k and m | {' | '.join(SHOWN.values())} |\n| --- |{' --- |' * len(SHOWN)}")
        of = (found[name] for name in SHOWN)
        cells = [f"{own.mean():.3f} ({own.min():.3f} to {own.max():.3f})" for own in of]
        print(f"| {side} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
