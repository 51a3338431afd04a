"""Policies kept during training: `policies/STEP.npz` and `policies/STEP.json` of a run.

STEP is a multiple of `evaluate_every`; the policy is that at the end of the epoch which reached it.
Each file depends on the state of the training alone: after a kill the same ones are written again.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.lockstep.learner import Learner
from agents.training.config import CHECKPOINT, PREVIOUS, TrainConfig, run_folder
from agents.training.evaluation import evaluation_bytes, play_policies
from agents.training.files import read_arrays, write_arrays, write_whole

EPISODES = 20
"""Of each evaluation during training and each policy."""


def write_snapshots(
    folder: Path,
    config: TrainConfig,
    learner: Learner,
    runs: slice,
    failed: NDArray[np.bool_],
    before: NDArray[np.int64],
    now: NDArray[np.int64],
) -> None:
    """Write snapshots of those runs of a folder that passed a multiple of `evaluate_every`.

    runs: which of the learner's they are; failed: [R]; before, now: [R], environment steps each run
    had taken before an epoch and has taken now.
    """
    every = config.evaluate_every
    due = ~failed & (now // every > before // every) if every else np.zeros_like(failed)
    if not every or not due.any():
        return
    results = play_policies(config, learner.policy(runs), EPISODES, due)
    arrays = policy_arrays(learner.state_dict(runs))
    for run in np.flatnonzero(due).tolist():
        path = snapshot_path(folder, config.seeds[run], int(now[run] // every * every))
        path.parent.mkdir(exist_ok=True)
        write_arrays(path, {name: array[run : run + 1] for name, array in arrays.items()})
        evaluation = evaluation_bytes(results, run, config.seeds[run], EPISODES)
        if evaluation is None:
            path.with_suffix(".json").unlink(missing_ok=True)
        else:
            write_whole(path.with_suffix(".json"), evaluation)


def snapshot_path(folder: Path, seed: int, step: int) -> Path:
    """File of the policy of a run at a step."""
    return run_folder(folder, seed) / "policies" / f"{step}.npz"


def snapshot_steps(folder: Path, seed: int) -> list[int]:
    """Steps of the policies that a run has left, in order."""
    files = (run_folder(folder, seed) / "policies").glob("*.npz")
    return sorted(int(path.stem) for path in files if path.stem.isdecimal())


def policy_arrays(state: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """The part of a learner's state that its policy depends on.

    By convention it is named `actor`, or `actor.` and more; of a learner without it, all.
    """
    of_actor = {name: array for name, array in state.items() if is_of_policy(name)}
    return of_actor or dict(state)


def is_of_policy(name: str) -> bool:
    """Whether an array of a learner's state is one of its policy."""
    return name == "actor" or name.startswith("actor.")


def read_policy_arrays(
    folder: Path, config: TrainConfig, seed: int, step: int | None
) -> tuple[dict[str, NDArray], int | None]:
    """The arrays of the policy of one run, each [1, ...], and the steps that the run had taken.

    step: of a snapshot; None for the last checkpoint. The steps are None where the folder has a
    policy alone, as versions before wrote it. Reads nothing else of a checkpoint. Raises UserError
    where there is no such policy.
    """
    if step is not None:
        path = snapshot_path(folder, seed, step)
        if not path.exists():
            steps = snapshot_steps(folder, seed)
            there = f"there are {', '.join(map(str, steps))}" if steps else "there is none"
            raise UserError(
                f"{folder} has no policy of seed {seed} at step {step}: {there}; training leaves "
                "one every evaluate_every steps"
            )
        return read_arrays(path), step
    run = config.seeds.index(seed)
    try:
        arrays = _policies_in(folder / CHECKPOINT, config)
    except UserError as error:
        if not (folder / PREVIOUS).exists():
            raise
        try:
            arrays = _policies_in(folder / PREVIOUS, config)
        except UserError:
            raise error from None
        warnings.warn(f"{error}: this is the policy of the checkpoint before it", stacklevel=4)
    steps = arrays.pop("steps", None)
    policy = {name: array[run : run + 1] for name, array in arrays.items()}
    return policy, None if steps is None else int(steps[run])


def _policies_in(path: Path, config: TrainConfig) -> dict[str, NDArray]:
    """The arrays of the policies in a checkpoint, and its steps where it has them.

    Raises UserError where they are not there.
    """
    arrays = read_arrays(path, lambda name: name == "steps" or is_of_policy(name))
    if not arrays.keys() - {"steps"}:  # a family without the convention
        own = ("epoch", "seeds", "failed")
        arrays = read_arrays(path, lambda name: name not in own and not name.startswith("log."))
    for name, array in arrays.items():
        if array.ndim == 0 or len(array) != len(config.seeds):
            raise UserError(f"{path} is damaged or of another version: {name} is {array.shape}")
    return arrays
