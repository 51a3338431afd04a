"""Vector environments of several tasks in one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.lockstep.rollout import require_cost


class SideBySide(VectorEnv):
    """Vector environments that do not reset themselves, one after the other in every array.

    They have observations of one size and actions of one size. The info of a step holds the costs.
    """

    def __init__(self, parts: Sequence[VectorEnv]) -> None:
        self._parts = parts
        self._ends = np.cumsum([part.num_envs for part in parts])
        self.num_envs = int(self._ends[-1])

    def __repr__(self) -> str:
        return " beside ".join(map(str, self._parts))

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, *, seed: Sequence[int] = (), options: dict | None = None
    ) -> tuple[NDArray, dict[str, Any]]:
        """Reset all, with a seed for each environment; or those in `options["reset_mask"]`."""
        if options is None:
            pairs = zip(self._parts, self._split(seed), strict=True)
            found = [part.reset(seed=seeds.tolist())[0] for part, seeds in pairs]
        else:
            found = []
            masks = self._split(options["reset_mask"])
            for part, mask, last in zip(self._parts, masks, self._split(self._last), strict=True):
                to_reset = {"reset_mask": mask.copy()}
                found.append(part.reset(options=to_reset)[0] if mask.any() else last)
        self._last = np.concatenate(found)
        return self._last, {}

    def step(
        self, actions: NDArray
    ) -> tuple[NDArray, NDArray, NDArray, NDArray, dict[str, NDArray]]:
        """Step all; actions: [N, action size]."""
        found = []
        for part, of_part in zip(self._parts, self._split(actions), strict=True):
            *columns, info = part.step(of_part)
            require_cost(part, info)
            found.append((*columns, info["cost"]))
        self._last, *columns, cost = (np.concatenate(c) for c in zip(*found, strict=True))
        reward, terminated, truncated = columns
        return self._last, reward, terminated, truncated, {"cost": cost}

    def _split(self, values: Any) -> list[NDArray]:
        return np.split(np.asarray(values), self._ends[:-1])
