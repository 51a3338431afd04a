"""Circle2D: observation, reward and cost, and the paper's dynamics.

To change the task, change the functions of this module: both modes (kinematic and MuJoCo) and the
single and vector environments call them. `StartArea` defines where episodes start, `CostRegion`
where steps cost, `Circle2DConfig` how far a step goes. Source: safe_exploration.tex, "Circle2D
details"; choices that it leaves open define version v0.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.core.simulation import State
from circle2d_mj.core.streams import Streams


class Move(NamedTuple):
    """Result of a step of the dynamics: new arrays with an entry for each environment."""

    contact: NDArray[np.bool_]
    """[num_envs], whether the agent touched the cost region; the argument of `cost`."""
    info: dict[str, NDArray[np.float64]]
    """[num_envs] for each name in `Dynamics.info_units`."""


def observe(
    config: Circle2DConfig,
    position: NDArray[np.float64],
    velocity: NDArray[np.float64] | None = None,
) -> NDArray[np.float32]:
    """Scale the position by the arena's half-width, and append the scaled velocity if given.

    position: [..., 2] world units -> [..., 2] float32 in [-1, 1]. velocity: [..., 2] world units
    per step -> [..., 4], the last two numbers as multiples of a full action's step.
    """
    scaled = (position * (1.0 / config.arena)).astype(np.float32)
    if velocity is None:
        return scaled
    of_full_step = velocity * (1.0 / config.full_step)
    return np.concatenate((scaled, of_full_step.astype(np.float32)), axis=-1)


def position(config: Circle2DConfig, observation: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the position in an observation: [..., 2 or 4] -> [..., 2] world units."""
    return observation[..., :2].astype(np.float64) * config.arena


def reward(config: Circle2DConfig, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return minus the distance to the optimum over the arena's half-diagonal.

    That is `-‖p - o‖ / (√2·m·R)`; with `sparse_reward`, 1 is added in the corridor and the
    cut-outs, and the reward is 0 elsewhere.
    position: [..., 2] world units -> [...] float64; in [-1, 0] for the default optimum.
    """
    x, y = position[..., 0], position[..., 1]
    optimum_x, optimum_y = config.optima_perturbation
    if optimum_x or optimum_y:
        x, y = x - optimum_x, y - optimum_y
    minus_distance = np.sqrt(x * x + y * y) * (-1.0 / (math.sqrt(2.0) * config.arena))
    if config.sparse_reward:
        return np.where(config.region.in_cutout(position), 1.0 + minus_distance, 0.0)
    return minus_distance


def cost(
    config: Circle2DConfig, position: NDArray[np.float64], contact: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return 1.0 if the agent touched the cost region in the step, else 0.0.

    position: [..., 2] world units, where the step ended; contact: [...], whether the dynamics
    report a touch (see `Kinematic.step`, `Physics.step`) -> [...] float64.
    """
    return contact.astype(np.float64)


class Dynamics(Protocol):
    """How actions move the agents: `Kinematic`, `Physics`, or a class of your own."""

    info_units: dict[str, str]
    """Units, by name, of the numbers that `step` adds to the info besides the cost."""
    camera: str | None
    """Camera of frames that MuJoCo draws; None for plain pictures of the arena."""

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        """Upper bounds of the absolute values of the observation's numbers."""
        ...

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions of the agents: [num_envs, 2], world units."""
        ...

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Place the agents `index` at random, at rest, drawing only from their streams."""
        ...

    def step(self, action: NDArray[np.float64]) -> Move:
        """Move every agent with its action, [num_envs, 2]."""
        ...

    def observe(self) -> NDArray[np.float32]:
        """Return the observations: a new array [num_envs, len(observation_bounds)]."""
        ...

    def state_dict(self) -> State:
        """Return everything that steps depend on: named arrays [num_envs, ...] (copies)."""
        ...

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        ...


class Kinematic:
    """`num_envs` agents whose actions are their displacements."""

    observation_bounds = (1.0, 1.0)
    camera: str | None = None

    def __init__(self, config: Circle2DConfig, num_envs: int) -> None:
        self.config = config
        self.info_units: dict[str, str] = {}
        self.start_area = config.start_area
        # Column-major, since every formula works on x and y separately.
        self.position = np.zeros((num_envs, 2), order="F")
        """Positions of the agents: [num_envs, 2], world units."""

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Place the agents `index` at random in the start area."""
        self.place(index, self.start_area.sample(streams, index))

    def place(self, index: NDArray[np.intp], position: NDArray[np.float64]) -> None:
        """Put the agents `index` at `position`, [len(index), 2]."""
        self.position[index] = position

    def step(self, action: NDArray[np.float64]) -> Move:
        """Move every agent: `p' = clip(p + step_length·R·a, arena)`.

        action: [num_envs, 2], clipped to [-1, 1]. A move that ends in the cost region is a contact.
        If the region is rigid, the move is undone, but still counts as a contact.
        """
        config, arena = self.config, self.config.arena
        end = action.T.copy().T  # a new array in the memory order of `position`
        np.maximum(end, -1.0, out=end)
        np.minimum(end, 1.0, out=end)
        end *= config.full_step
        end += self.position
        np.maximum(end, -arena, out=end)
        np.minimum(end, arena, out=end)
        contact = config.region.contains(end)
        if not config.infeasible_region_penetratable:
            end = np.where(contact[:, None], self.position, end)
        self.position = end
        return Move(contact, {})

    def observe(self) -> NDArray[np.float32]:
        """Return the scaled positions: [num_envs, 2] float32."""
        return observe(self.config, self.position)

    def state_dict(self) -> State:
        """Return the positions: [num_envs, 2]."""
        return {"position": self.position.copy()}

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        self.position = np.asfortranarray(state["position"])
