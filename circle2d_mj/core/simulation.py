"""The interface of a simulation: all that the Gymnasium environments know of a task."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import ArrayLike, NDArray

from circle2d_mj.core.streams import Streams
from circle2d_mj.core.view import View

State = dict[str, NDArray]


class Outcome(NamedTuple):
    """Result of a step: new arrays with an entry for each environment."""

    reward: NDArray[np.float64]
    """[num_envs]"""
    terminated: NDArray[np.bool_]
    """[num_envs]"""
    info: dict[str, NDArray[np.float64]]
    """[num_envs] each: "cost" and other numbers that describe the step"""


class Simulation(Protocol):
    """A task in `num_envs` independent copies."""

    num_envs: int
    observation_space: Space[Any]
    """Observation space of one environment."""
    action_space: Box
    """Action space of one environment."""
    info_keys: tuple[str, ...]
    """Names of the numbers in infos: those of `Outcome.info`, then those of `state_info`."""
    recorded_info: dict[str, str]
    """Names in `info_keys` that training records at each step, with their units."""
    moving: NDArray[np.intp] | None
    """Indices of the environments that must move in a step; None for all. Moving others has no
    effect."""

    @property
    def view(self) -> View | None:
        """Pictures of where agents are; None if there is nothing to show."""
        ...

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Begin an episode in the environments `index`, drawing only from their streams."""
        ...

    def step(self, action: NDArray[np.float64]) -> Outcome:
        """Take a step in all environments with finite actions, [num_envs, action size]."""
        ...

    def observe(self) -> Any:
        """Return the observations: a new array [num_envs, observation size], or a dict of arrays
        [num_envs, ...]."""
        ...

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return the numbers of the info that describe the state, like the observation, not the
        step that led there: new arrays [num_envs]."""
        ...

    def state_dict(self) -> State:
        """Return everything that steps depend on: named arrays [num_envs, ...] (copies)."""
        ...

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        ...

    def frame(self, index: int) -> NDArray[np.uint8]:
        """Draw one environment: [height, width, 3]."""
        ...

    def show(self, index: int) -> None:
        """Show one environment in a window; the first call opens the window."""
        ...

    def close(self) -> None:
        """Close the renderer and the window."""
        ...


def of_one(observations: Any, index: int) -> Any:
    """Return one environment's part of the observations from `Simulation.observe`."""
    if isinstance(observations, dict):
        return {name: part[index] for name, part in observations.items()}
    return observations[index]


LARGEST_ACTION = 1e150
"""Largest absolute value of an action's numbers: their squares are finite."""


def checked_action(action: ArrayLike, shape: tuple[int, ...] | None) -> NDArray[np.float64]:
    """Return the action as float64. Raises ValueError for a wrong shape, for anything but an array
    of real numbers (masked arrays are refused), and for numbers that are not finite or larger than
    `LARGEST_ACTION`."""
    try:
        given = np.asarray(action)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged, or a tensor with a gradient
        raise ValueError(f"action must be numbers of shape {shape}, got {action!r}") from error
    if given.dtype.kind not in "fiub":
        raise ValueError(f"action must be numbers (real), got {given.dtype} in {action!r}")
    if _is_masked(action):
        raise ValueError(f"action must not be masked, got {action!r}")
    values = given.astype(np.float64)
    if values.shape != shape:
        raise ValueError(f"action must have shape {shape}, got shape {values.shape}")
    if not (np.abs(values) <= LARGEST_ACTION).all():
        raise ValueError(
            f"action must be finite and at most {LARGEST_ACTION:g} in magnitude, got {action!r}"
        )
    return values


def _is_masked(action: Any) -> bool:
    """Return whether the action, or an array in it, has a mask, which NumPy would drop."""
    if isinstance(action, (list, tuple)):
        return any(_is_masked(part) for part in action if not isinstance(part, float))
    return isinstance(action, np.ma.MaskedArray)


def positive_integer(name: str, value: Any) -> int:
    """Return the value as an int >= 1. Raises TypeError or ValueError, naming it, otherwise."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    if value < 1:
        raise ValueError(f"{name} must be at least 1, got {value!r}")
    return int(value)
