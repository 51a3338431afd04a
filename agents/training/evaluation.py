"""Evaluation: whole episodes of the deterministic and the stochastic policy."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.errors import UserError
from agents.lockstep.noise import Purpose, environment_seeds, normal, steps_of_noise
from agents.lockstep.rollout import Policy, Rollout, collect
from agents.training.checksums import write_files
from agents.training.config import TrainConfig, run_folder
from agents.training.environments import make_envs, sizes
from agents.training.files import json_bytes
from emcc import cvar

Results = dict[str, list[dict[str, Any]]]
CVAR_ALPHA = 0.5
EVALUATION_EPISODES = 100
"""Of each run and policy at the end of a training."""
MOST_EPISODES = 1_000_000
POLICIES = ("deterministic", "stochastic")


def evaluate(
    folder: Path,
    config: TrainConfig,
    policy: Policy,
    episodes: int,
    active: NDArray[np.bool_] | None = None,
) -> Results:
    """Evaluate a policy of every run and write `evaluation.json` into its folder.

    As `play_policies`. Instead of empty results an older file is removed.
    """
    active = np.ones(len(config.seeds), dtype=bool) if active is None else active
    results = play_policies(config, policy, episodes, active)
    contents = {}
    for run, seed in enumerate(config.seeds):
        name = f"{run_folder(folder, seed).name}/evaluation.json"
        contents[name] = evaluation_bytes(results, run, seed, episodes)
    write_files(folder, contents)
    return results


def evaluation_bytes(results: Results, run: int, seed: int, episodes: int) -> bytes | None:
    """Results of a run as the content of a file; None where there are none."""
    of_run = {name: result[run] for name, result in results.items()}
    if not all(of_run.values()):
        return None
    return json_bytes({"seed": seed, "episodes": episodes, **of_run})


def play_policies(
    config: TrainConfig, policy: Policy, episodes: int, active: NDArray[np.bool_]
) -> Results:
    """Play episodes with a policy of every run.

    Returns for each of `POLICIES` a dictionary a run: means, and values per episode. Start states
    and noise come from the run's seed, so that an evaluation can be repeated bit for bit.
    active: [R], runs to be evaluated. The results of the others, and of a run whose policy gives
    numbers that are not finite, are empty.
    """
    if not 1 <= episodes <= MOST_EPISODES:
        rule = "at least 1" if episodes < 1 else f"at most {MOST_EPISODES}"
        raise UserError(f"episodes must be {rule}, got {episodes}")
    results = {name: [{} for _ in config.seeds] for name in POLICIES}
    if active.any():
        # As many as memory holds; others than native ones are a model or a process each. Noise is
        # drawn for all episodes in every part, so there are about 100 parts at the most.
        at_once = min(episodes, max(100, episodes // 100) if config.is_native else 10)
        arguments = (config.task, len(config.seeds) * at_once, config.task_parameters)
        how = (config.vectorization, config.step_timeout)
        with contextlib.closing(make_envs(*arguments, *how)) as envs:
            for name in POLICIES:
                noisy = name == "stochastic"
                results[name] = _play(envs, config, policy, episodes, at_once, active, noisy)
    return results


def _play(
    envs: VectorEnv,
    config: TrainConfig,
    policy: Policy,
    episodes: int,
    at_once: int,
    active: NDArray[np.bool_],
    noisy: bool,
) -> list[dict[str, Any]]:
    """For each run the means and, per episode, the undiscounted sums of rewards and costs."""
    starts = range(0, episodes, at_once)
    rollouts = (play(envs, config, policy, episodes, k, at_once, active, noisy) for k in starts)
    parts = [_columns(rollout, len(config.seeds)) for rollout in rollouts]
    columns = {name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]}
    valid = active & ~columns.pop("diverged")[:, :episodes].any(axis=1)
    results = []
    for run in range(len(config.seeds)):
        if not valid[run]:
            results.append({})
            continue
        of_run = {name: column[run, :episodes] for name, column in columns.items()}
        means = {
            "J_R": float(np.mean(of_run["returns"])),
            "J_C": float(np.mean(of_run["cost_returns"])),
            f"CVaR_{CVAR_ALPHA:g}": cvar(of_run["cost_returns"], CVAR_ALPHA),
        }
        results.append(means | {name: column.tolist() for name, column in of_run.items()})
    return results


def _columns(rollout: Rollout, runs: int) -> dict[str, NDArray]:
    """Results of the episodes of a rollout, in arrays [R, episodes of each, ...]."""
    columns = {
        "returns": rollout.returns,
        "cost_returns": rollout.cost_returns,
        "lengths": rollout.length,
        "final_observations": rollout.final_observation,
        "diverged": rollout.diverged,
    }
    return {name: column.reshape(runs, -1, *column.shape[1:]) for name, column in columns.items()}


def play(
    envs: VectorEnv,
    config: TrainConfig,
    policy: Policy,
    episodes: int,
    first: int,
    count: int,
    active: NDArray[np.bool_],
    noisy: bool,
) -> Rollout:
    """Play episodes `first`, `first + 1`, ... of an evaluation over `episodes`, `count` a run.

    envs: R·count environments. The rollout holds run after run, [T, R·count].
    """
    runs, (_, action_size) = len(config.seeds), sizes(envs)
    chosen = np.arange(first, first + count) % episodes  # beyond the last: played, and left out
    seeds = environment_seeds(config.stream_seeds, Purpose.EVALUATION, 0, episodes)
    seeds = np.array(seeds).reshape(runs, episodes)[:, chosen].ravel().tolist()
    shape = (episodes, action_size)
    noise = steps_of_noise(normal, config.stream_seeds, Purpose.EVALUATION, 1, shape)

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        observation = observation.reshape(runs, count, -1)
        action = policy(observation, next(noise)[:, chosen] if noisy else None)
        return action.reshape(runs * count, -1)

    return collect(envs, seeds, act, np.repeat(active, count))
