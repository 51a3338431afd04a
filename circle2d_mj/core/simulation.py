"""A task as a simulation of many copies: all that the gymnasium side knows of it."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import ArrayLike, NDArray

from circle2d_mj.core.streams import Streams
from circle2d_mj.core.view import View

State = dict[str, NDArray]


class Outcome(NamedTuple):
    """Result of a step: fresh arrays, an entry for each environment."""

    reward: NDArray[np.float64]
    """[num_envs]"""
    terminated: NDArray[np.bool_]
    """[num_envs]"""
    info: dict[str, NDArray[np.float64]]
    """[num_envs] each: "cost" and other numbers of the step"""


class Simulation(Protocol):
    """A task in `num_envs` independent copies."""

    num_envs: int
    observation_space: Space[Any]
    """Observation space of one environment."""
    action_space: Box
    """Action space of one environment."""
    info_keys: tuple[str, ...]
    """Names of the numbers in infos: of `Outcome.info`, then of `state_info`."""
    recorded_info: dict[str, str]
    """Those of `info_keys` that training records at each step, with their units."""
    moving: NDArray[np.intp] | None
    """The environments that must move in a step; None: all. Others may, to no effect."""

    @property
    def view(self) -> View | None:
        """Pictures of where agents are; None where there is nothing to show."""
        ...

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Begin an episode in the environments `index`, with numbers from their streams alone."""
        ...

    def step(self, action: NDArray[np.float64]) -> Outcome:
        """Move all environments by finite actions, [num_envs, action size]."""
        ...

    def observe(self) -> Any:
        """Return the observations: a fresh array [num_envs, observation size], or a dict of arrays
        [num_envs, ...]."""
        ...

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return the numbers of the info that describe the state, as the observation does, and not
        the step that led there: fresh arrays [num_envs]."""
        ...

    def state_dict(self) -> State:
        """Return all that steps depend on: named arrays (copies), num_envs their first axis."""
        ...

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        ...

    def frame(self, index: int) -> NDArray[np.uint8]:
        """Draw one environment: [height, width, 3]."""
        ...

    def show(self, index: int) -> None:
        """Show one environment in a window, which the first call opens."""
        ...

    def close(self) -> None:
        """Close the renderer and the window."""
        ...


def of_one(observations: Any, index: int) -> Any:
    """Return the observation of one environment, of what `Simulation.observe` returned."""
    if isinstance(observations, dict):
        return {name: part[index] for name, part in observations.items()}
    return observations[index]


LARGEST_ACTION = 1e150
"""Of each number of an action, in size: its square is a finite number."""


def checked_action(action: ArrayLike, shape: tuple[int, ...] | None) -> NDArray[np.float64]:
    """Return the action as float64. Raises ValueError for another shape, for what is no array of
    real numbers (a masked array among them), and for numbers that are not finite or larger than
    `LARGEST_ACTION`."""
    try:
        given = np.asarray(action)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged; a tensor with a gradient
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
            f"action must be finite, and at most {LARGEST_ACTION:g} in size, got {action!r}"
        )
    return values


def _is_masked(action: Any) -> bool:
    """Whether numpy would drop a mask of the action or of an array in it."""
    if isinstance(action, (list, tuple)):
        return any(_is_masked(part) for part in action if not isinstance(part, float))
    return isinstance(action, np.ma.MaskedArray)


def positive_integer(name: str, value: Any) -> int:
    """Return the value as an int. Raises TypeError or ValueError, naming it, if it is not one."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    if value < 1:
        raise ValueError(f"{name} must be at least 1, got {value!r}")
    return int(value)
