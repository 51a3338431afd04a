"""Evaluation after training: whole episodes of the deterministic and the stochastic policy."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.errors import UserError
from agents.lockstep.noise import Purpose, environment_seeds, normal, steps_of_noise
from agents.lockstep.rollout import Policy, collect
from agents.runs.config import TrainConfig, run_folder
from agents.runs.files import write_json
from agents.runs.tasks import make_envs, sizes
from emcc import cvar

Results = dict[str, list[dict[str, Any]]]
CVAR_ALPHA = 0.5
POLICIES = ("deterministic", "stochastic")


def evaluate(
    folder: Path,
    config: TrainConfig,
    policy: Policy,
    episodes: int,
    active: NDArray[np.bool_] | None = None,
) -> Results:
    """Play episodes with a policy of every run and write `evaluation.json` into its folder.

    Returns for each of `POLICIES` a dictionary a run: means, and values per episode. Start states
    and noise come from the run's seed, so that an evaluation can be repeated bit for bit.
    active: [R], runs to be evaluated, all by default. The results of the others, and of a run whose
    policy gives numbers that are not finite, are empty and not written.
    """
    if episodes < 1:
        raise UserError(f"episodes must be at least 1, got {episodes}")
    active = np.ones(len(config.seeds), dtype=bool) if active is None else active
    if not active.any():
        return {name: [{} for _ in config.seeds] for name in POLICIES}
    envs = make_envs(config.task, len(config.seeds) * episodes, config.task_parameters)
    with contextlib.closing(envs):
        results = {
            name: _play(envs, config, policy, episodes, active, name == "stochastic")
            for name in POLICIES
        }
    for run, seed in enumerate(config.seeds):
        of_run = {name: result[run] for name, result in results.items()}
        if all(of_run.values()):
            content = {"seed": seed, "episodes": episodes, **of_run}
            write_json(run_folder(folder, seed) / "evaluation.json", content)
    return results


def _play(
    envs: VectorEnv,
    config: TrainConfig,
    policy: Policy,
    episodes: int,
    active: NDArray[np.bool_],
    noisy: bool,
) -> list[dict[str, Any]]:
    """For each run the means and, per episode, the undiscounted sums of rewards and costs."""
    runs, (_, action_size) = len(config.seeds), sizes(envs)
    seeds = environment_seeds(config.seeds, Purpose.EVALUATION, 0, episodes)
    shape = (episodes, action_size)
    noise = steps_of_noise(normal, config.seeds, Purpose.EVALUATION, 1, shape)

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        observation = observation.reshape(runs, episodes, -1)
        action = policy(observation, next(noise) if noisy else None)
        return action.reshape(runs * episodes, -1)

    rollout = collect(envs, seeds, act, np.repeat(active, episodes))
    valid = active & ~rollout.diverged.reshape(runs, episodes).any(axis=1)
    columns = {
        "returns": rollout.returns,
        "cost_returns": rollout.cost_returns,
        "lengths": rollout.length,
        "final_observations": rollout.final_observation,
    }
    results = []
    for run in range(runs):
        of_run = {k: v[run * episodes : (run + 1) * episodes] for k, v in columns.items()}
        means = {
            "J_R": float(np.mean(of_run["returns"])),
            "J_C": float(np.mean(of_run["cost_returns"])),
            f"CVaR_{CVAR_ALPHA:g}": cvar(of_run["cost_returns"], CVAR_ALPHA),
        }
        lists = {name: column.tolist() for name, column in of_run.items()}
        results.append(means | lists if valid[run] else {})
    return results
