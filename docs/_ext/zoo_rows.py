"""Add trained runs of the zoo to results/zoo (zoo.csv, seeds.csv, curves.csv) and one of their
policies to the package, and print rows for the page's table.

python docs/_ext/zoo_rows.py FOLDER ...

The policy is from the run whose return is nearest to the median of the runs whose deterministic
policy satisfies the task's cost limit.
"""

from __future__ import annotations

import functools
import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import agents
from agents.algorithms import title
from agents.presets import limit_of
from agents.results.statistics import mean_of
from agents.training.config import RunId, TrainConfig
from agents.training.files import write_arrays
from agents.training.policy import read_policy_arrays

ROOT = Path(__file__).parents[2]
TABLE, POLICIES = ROOT / "results/zoo/zoo.csv", ROOT / "agents/policies/zoo"
CURVES, SEEDS = ROOT / "results/zoo/curves.csv", ROOT / "results/zoo/seeds.csv"
WINDOW, POINTS = 10, 50
# From OmniSafe's benchmarks (its repository, benchmarks/on-policy and off-policy): J_R, J_C and the
# algorithm with the highest return within the limit, without algorithms that end an episode at the
# limit. On-policy ones took 10 000 000 steps, SAC-Lag and TD3-PID 3 000 000. The off-policy numbers
# on circle tasks are of episodes twice as long as those of Safety-Gymnasium 1.0.
PUBLISHED = {
    "SafetyPointGoal1-v0": (21.45, 19.2, "SAC-Lag"),
    "SafetyPointGoal2-v0": (1.67, 23.5, "TRPO-PID"),
    "SafetyPointButton1-v0": (4.60, 20.8, "PPO-Lag"),
    "SafetyPointButton2-v0": (2.43, 17.9, "FOCOPS"),
    "SafetyCarGoal1-v0": (27.28, 9.5, "TD3-PID"),
    "SafetyCarGoal2-v0": (2.30, 22.9, "RCPO"),
    "SafetyCarButton1-v0": (-0.31, 15.2, "TRPO-PID"),
    "SafetyCarButton2-v0": (-0.99, 20.4, ""),
    "SafetyAntVelocity-v1": (3262, 12.1, "PPO-Lag"),
    "SafetyHalfCheetahVelocity-v1": (2965, 2.4, "FOCOPS"),
    "SafetyHopperVelocity-v1": (1716, 7.5, "CUP"),
    "SafetyHumanoidVelocity-v1": (6624, 5.9, "PPO-Lag"),
    "SafetySwimmerVelocity-v1": (91.1, 19.1, "CPPO-PID"),
    "SafetyWalker2dVelocity-v1": (3207, 15.0, "TRPO-Lag"),
}


@functools.cache
def evaluated(folder: Path) -> pd.DataFrame:
    """Return mean return and cost in the last evaluation, by policy and seed."""
    frame = agents.load_runs(folder).to_pandas("evaluations")
    last = frame[frame.step == frame.groupby("seed").step.transform("max")]
    return last.groupby(["policy", "seed"])[["return", "cost"]].mean()


def row(folder: Path) -> dict[str, Any]:
    """Return the row of zoo.csv for a folder of finished runs on one task."""
    runs = agents.load_runs(folder)
    config = runs.config
    (task,) = (name.rpartition("/")[2] for name in config.tasks)
    means = evaluated(folder).groupby("policy").mean()
    records = runs.records.values()
    parts = [own.emcc_by_part(alpha=0.1, window=WINDOW) for own in records]
    status = json.loads((folder / "status.json").read_text())
    published = PUBLISHED.get(task, (np.nan, np.nan, ""))
    return {
        "task": task,
        "algorithm": config.algorithm,
        "steps": max(int(own.total_steps) for own in records),
        "seeds": len(config.seeds),
        "J_R": means.loc["deterministic", "return"].round(2),
        "J_C": means.loc["deterministic", "cost"].round(2),
        "J_R_stochastic": means.loc["stochastic", "return"].round(2),
        "J_C_stochastic": means.loc["stochastic", "cost"].round(2),
        **{f"EMCC_{part}": round(np.mean([p[part] for p in parts]), 4) for part in parts[0]},
        "steps_per_second": round(status["steps_per_second"]),
        "commit": json.loads((folder / "config.json").read_text())["commit"][:7],
        "policy": f"pretrained:zoo/{task}",
        "published_J_R": published[0],
        "published_J_C": published[1],
        "published_algorithm": published[2],
    }


def line(folder: Path, own: Mapping[str, Any]) -> str:
    """Return a row of the page's table, and below it the t intervals over seeds."""
    config = TrainConfig.read(folder)
    means = evaluated(folder).loc["deterministic"]
    limit = limit_of(config.tasks[0])
    within = f"{(means.cost <= limit).sum()} of {len(means)}"
    plain, noisy = (f"{own['J_R' + s]:,} / {own['J_C' + s]}" for s in ("", "_stochastic"))
    emcc = f"{own['EMCC_0.33']:.2f}, {own['EMCC_0.99']:.2f}"
    published = "—"
    if own["published_algorithm"]:
        published = (
            f"{own['published_J_R']} / {own['published_J_C']} ({own['published_algorithm']})"
        )
    cells = [
        own["task"],
        f"{title(config.algorithm)}, {own['steps']:,}",
        plain,
        noisy,
        within,
        emcc,
    ]
    intervals = {name: mean_of(list(means[name])) for name in ("return", "cost")}
    return f"| {' | '.join([*cells, published])} |\n{intervals}"


def seeds(folder: Path) -> pd.DataFrame:
    """Return the rows of seeds.csv: what each seed reaches, without its noise and with it."""
    means, config = evaluated(folder).round(3), TrainConfig.read(folder)
    plain, noisy = (means.loc[policy] for policy in ("deterministic", "stochastic"))
    columns = {"J_R": plain["return"], "J_C": plain.cost}
    columns |= {"J_R_stochastic": noisy["return"], "J_C_stochastic": noisy.cost}
    found = pd.DataFrame(columns).rename_axis("seed").reset_index()
    task = config.tasks[0].rpartition("/")[2]
    return found.assign(task=task, algorithm=config.algorithm, steps=config.steps)


def curves(folder: Path) -> pd.DataFrame:
    """Return `POINTS` rows with return and cost of training episodes: mean, lowest and highest of
    the runs' means."""
    runs = agents.load_runs(folder)
    episodes = runs.to_pandas("episodes")
    end = episodes.start_step.max() + 1
    step = (episodes.start_step * POINTS // end).rename("step")
    of_runs = episodes.groupby(["seed", step])[["return", "cost"]].mean().groupby("step")
    found = of_runs.agg(["mean", "min", "max"]).round(3)
    found.columns = ["_".join(names) for names in found.columns]
    task = runs.config.tasks[0].rpartition("/")[2]
    found.index = ((found.index + 0.5) * end / POINTS).astype(int)
    return found.rename_axis("step").reset_index().assign(task=task)


def chosen_seed(folder: Path) -> int:
    """Return the seed whose policy comes with the package."""
    (task,) = TrainConfig.read(folder).tasks
    means = evaluated(folder).loc["deterministic"]
    within = means[means.cost <= limit_of(task)]["return"]
    return int((within - within.median()).abs().idxmin())


def write_policy(folder: Path, seed: int) -> None:
    """Add the policy of a run to the package."""
    config = TrainConfig.read(folder)
    (task,) = config.tasks
    arrays, steps, _ = read_policy_arrays(folder, config, RunId(task, seed))
    target = POLICIES / task.rpartition("/")[2]
    shutil.rmtree(target, ignore_errors=True)
    (target / "checkpoints").mkdir(parents=True)
    content = json.loads((folder / "config.json").read_text()) | {"seeds": [seed]}
    (target / "config.json").write_text(json.dumps(content, indent=1) + "\n")
    write_arrays(target / "checkpoints" / f"{steps:09}.npz", arrays)


def write_rows(path: Path, rows: pd.DataFrame, by: Sequence[str] = ("task",)) -> None:
    """Write rows to a table, in place of the table's rows of the same tasks, or tasks and seeds."""
    if path.exists():
        old, own = pd.read_csv(path), pd.MultiIndex.from_frame(rows[[*by]])
        rows = pd.concat([old[~pd.MultiIndex.from_frame(old[[*by]]).isin(own)], rows])
    path.parent.mkdir(exist_ok=True)
    rows.sort_values([*by], kind="stable").to_csv(path, index=False)


def main(folders: list[Path]) -> None:
    """Replace the rows, curves and policies of the folders' tasks."""
    rows = [row(folder) for folder in folders]
    for folder, own in zip(folders, rows, strict=True):
        print(line(folder, own))
    write_rows(TABLE, pd.DataFrame(rows))
    write_rows(SEEDS, pd.concat([seeds(folder) for folder in folders]), ("task", "seed"))
    write_rows(CURVES, pd.concat([curves(folder) for folder in folders]))
    for folder in folders:
        write_policy(folder, chosen_seed(folder))


if __name__ == "__main__":
    main([Path(word) for word in sys.argv[1:]])
