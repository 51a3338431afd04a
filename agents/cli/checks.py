"""Checks of options before anything is read or written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import gymnasium as gym

from agents.errors import UserError
from agents.reporting.table import LEAST_WIDTH
from agents.training.environments import registered

T = TypeVar("T")


def check_width(width: int | None) -> None:
    """Raise UserError for a line that is too short for a table."""
    if width is not None and width < LEAST_WIDTH:
        raise UserError(f"width must be at least {LEAST_WIDTH}, got {width}")


def check_suffix(path: Path, *allowed: str) -> None:
    """Raise UserError for a file to be written that has none of these suffixes."""
    if path.suffix.lower() not in allowed:
        raise UserError(f"out must end in {' or '.join(allowed)}, got {str(path)!r}")


def check_enough_steps(
    task: str, parameters: Mapping[str, Any], steps: int, hyperparameters: Any
) -> None:
    """Raise UserError for a training after which there is no table, since EMCC needs a rollout in
    each third of it.

    A rollout is an epoch: its length is that of its episodes where those reach their time limit.
    For a task without a limit nothing is checked.
    """
    limit = parameters.get("max_episode_steps") or gym.spec(registered(task)).max_episode_steps
    episodes = getattr(hyperparameters, "episodes", 1)
    if isinstance(limit, int) and 0 < steps <= 2 * episodes * limit:
        of = f"{episodes} episodes" if episodes > 1 else "an episode"
        raise UserError(
            f"steps must be at least {2 * episodes * limit + 1} for a table, got {steps}: each "
            f"third of training needs a rollout, which is {of} of up to {limit} steps"
        )


def check_size(size: int) -> None:
    """Raise UserError for a picture's size that is not even and in [64, 4096] pixels."""
    if not 64 <= size <= 4096 or size % 2:
        raise UserError(f"size must be an even number in [64, 4096], got {size}")


def one_for_each(name: str, given: Sequence[T], folders: int) -> Sequence[T | None]:
    """An option's value for each folder, None where it is not given. Raises UserError for a number
    of values that is not theirs."""
    if given and len(given) != folders:
        raise UserError(f"{name} must be one for each of the {folders} folders, got {len(given)}")
    return given or [None] * folders
