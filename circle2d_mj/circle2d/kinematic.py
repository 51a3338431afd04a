"""The paper's dynamics: the action is the step, and only its end point is tested."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.task import Move
from circle2d_mj.core.simulation import State
from circle2d_mj.core.streams import Streams


class Kinematic:
    """`num_envs` agents whose actions are their steps."""

    observation_bounds = (1.0, 1.0)
    camera = None

    def __init__(self, config: Circle2DConfig, num_envs: int) -> None:
        self.config = config
        self.info_units: dict[str, str] = {}
        self.start_area = config.start_area
        # Column-major: every formula works on x and y separately.
        self.position = np.zeros((num_envs, 2), order="F")
        """Positions of the agents: [num_envs, 2], world units."""

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Place the agents `index` at random in the start area."""
        self.place(index, self.start_area.sample(streams, index))

    def place(self, index: NDArray[np.intp], position: NDArray[np.float64]) -> None:
        """Put the agents `index` at `position`, [len(index), 2]."""
        self.position[index] = position

    def step(self, action: NDArray[np.float64]) -> Move:
        """Move every agent: `p' = clip(p + 0.11·R·a, arena)`.

        action: [num_envs, 2], clipped to [-1, 1]. There is contact where the move ends in the cost
        region. Where that is rigid, such a move is taken back, and is a contact all the same.
        """
        config, arena = self.config, self.config.arena
        end = action.T.copy().T  # a fresh array in the memory order of `position`
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
        return task.observe(self.config, self.position)

    def state_dict(self) -> State:
        """Return the positions: [num_envs, 2]."""
        return {"position": self.position.copy()}

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        self.position = np.asfortranarray(state["position"])
