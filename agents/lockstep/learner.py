"""The interface between the training loop and a family of algorithms."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agents.lockstep.rollout import Act, Policy, Rollout


class Learner(Protocol):
    """The runs of one algorithm, as the training loop sees them: what a family provides.

    R runs train side by side, and none depends on the others.

    Arrays of the state whose names are `actor` or begin with `actor.` are those that the policy
    depends on: a trained policy is loaded from them alone. For `to_torch` a learner also has a
    method `module(run)`: its deterministic policy as an `nn.Module`, observations -> actions.
    """

    episodes: int
    """Whole episodes of each run in an epoch."""
    metrics: tuple[str, ...]
    """Names of the numbers that `learn` returns."""

    def policy(self) -> Policy:
        """The policy of every run as it stands now."""
        ...

    def explorer(self, epoch: int, steps: NDArray[np.int64]) -> Act:
        """Actions of the runs in an epoch; steps: [R], environment steps each has taken before."""
        ...

    def learn(self, rollout: Rollout, epoch: int, active: NDArray[np.bool_]) -> NDArray:
        """Learn from an epoch of R·E episodes; active: [R], runs that take part.

        Returns each of `metrics`, [R, metrics]; NaN for runs that learned nothing.
        """
        ...

    def finite(self) -> NDArray[np.bool_]:
        """Mask of the runs that hold only finite numbers, [R]."""
        ...

    def state_dict(self) -> dict[str, NDArray]:
        """The whole training state as named arrays, the run axis first."""
        ...

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state, bit for bit. KeyError or ValueError for one that does not fit."""
        ...
