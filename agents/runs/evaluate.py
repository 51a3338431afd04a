"""Evaluation after training: whole episodes of the deterministic and the stochastic policy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from agents.errors import UserError
from agents.lockstep.noise import Purpose, environment_seeds, steps_of_noise
from agents.lockstep.rollout import collect
from agents.runs.config import TrainConfig, run_folder
from agents.runs.files import write_json
from agents.runs.tasks import make_envs
from emcc import cvar

Results = dict[str, list[dict[str, Any]]]
CVAR_ALPHA = 0.5
POLICIES = ("deterministic", "stochastic")


def evaluate(folder: Path, config: TrainConfig, policy: Any, episodes: int) -> Results:
    """Play episodes with a policy of every run and write `evaluation.json` into its folder.

    Returns for each of `POLICIES` a dictionary a run: means, and values per episode.

    policy: of a learner, `policy(observation [R, N, ...], noise) -> actions [R, N, ...]`. Start
    states and noise come from the run's seed, so that an evaluation can be repeated bit for bit.
    """
    if episodes < 1:
        raise UserError(f"episodes must be at least 1, got {episodes}")
    envs = make_envs(config.task, len(config.seeds) * episodes, config.task_parameters)
    results = {
        name: _play(envs, config, policy, episodes, name == "stochastic") for name in POLICIES
    }
    envs.close()
    for run, seed in enumerate(config.seeds):
        of_run = {name: result[run] for name, result in results.items()}
        content = {"seed": seed, "episodes": episodes, **of_run}
        write_json(run_folder(folder, seed) / "evaluation.json", content)
    return results


def _play(
    envs: Any, config: TrainConfig, policy: Any, episodes: int, noisy: bool
) -> list[dict[str, Any]]:
    """For each run the means and, per episode, the undiscounted sums of rewards and costs."""
    runs = len(config.seeds)
    action_size = envs.single_action_space.shape[0]
    seeds = environment_seeds(config.seeds, Purpose.EVALUATION, 0, episodes)
    noise = steps_of_noise(config.seeds, Purpose.EVALUATION, 1, (episodes, action_size))

    def act(observation):
        observation = observation.reshape(runs, episodes, -1)
        action = policy(observation, next(noise)[0] if noisy else None)
        return action.reshape(runs * episodes, -1)

    rollout = collect(envs, seeds, act)
    columns = {
        "returns": rollout.returns,
        "cost_returns": rollout.cost_returns,
        "lengths": rollout.length,
        "final_observations": rollout.final_observation,
    }
    results = []
    for run in range(runs):
        of_run = slice(run * episodes, (run + 1) * episodes)
        costs = rollout.cost_returns[of_run]
        means = {
            "J_R": float(np.mean(rollout.returns[of_run])),
            "J_C": float(np.mean(costs)),
            f"CVaR_{CVAR_ALPHA:g}": cvar(costs, CVAR_ALPHA),
        }
        results.append(means | {name: c[of_run].tolist() for name, c in columns.items()})
    return results
