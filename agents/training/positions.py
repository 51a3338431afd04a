"""Positions of the states that vector environments pass through, by their task's view."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from agents.errors import UserError
from circle2d_mj.core.view import View


class RecordPositions(VectorWrapper):
    """Records where the agents are, since the last reset of all of them.

    Works with native vector environments as with gymnasium's, whose infos hold arrays too.
    """

    def __init__(self, env: VectorEnv, view: View) -> None:
        super().__init__(env)
        self._view = view
        self._positions: list[NDArray[np.float32]] = []

    @property
    def positions(self) -> NDArray[np.float32]:
        """Where each step ended, [steps, num_envs, 2]."""
        return np.array(self._positions, dtype=np.float32).reshape(-1, self.num_envs, 2)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """As the environments'. Forgets the positions, unless only some environments are reset."""
        if options is None or "reset_mask" not in options:
            self._positions = []
        return self.env.reset(seed=seed, options=options)

    def step(self, actions: Any) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        """As the environments'. Raises UserError where the view cannot give the positions."""
        observation, *others, info = self.env.step(actions)
        try:
            found = self._view.positions(np.asarray(observation, dtype=np.float32), info)
        except KeyError as error:
            raise UserError(f"the view of {self.env} needs info[{error}]") from None
        positions = np.asarray(found, dtype=np.float32)
        if positions.shape != (self.num_envs, 2):
            raise UserError(
                f"the view of {self.env} must give positions [{self.num_envs}, 2], "
                f"got {list(positions.shape)}"
            )
        self._positions.append(positions)
        reward, terminated, truncated = others
        return observation, reward, terminated, truncated, info
