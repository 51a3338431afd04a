"""Running mean and variance of what runs have seen, and normalisation of observations by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from agents.checks import Settings
from agents.errors import UserError
from agents.lockstep import tree
from agents.lockstep.nets import Activation, mlp

CLIP = 10.0
"""Bound to which normalised numbers are clipped, as in gymnasium and Stable-Baselines3."""


class RunningMoments:
    """Mean and variance, for each of R runs, of the numbers [*shape] counted so far."""

    def __init__(self, runs: int, *shape: int) -> None:
        self._moments = np.zeros((runs, 3, *shape))  # count, mean, sum of squared deviations

    def add(self, run: int, values: NDArray[np.float64]) -> None:
        """Count values [n, *shape] of a run, n > 0 (Chan et al. 1979)."""
        (before, mean, squares), more = self._moments[run], len(values)
        own = values.mean(axis=0)
        after, change = before + more, own - mean
        squares = squares + (((values - own) ** 2).sum(axis=0) + change**2 * before * more / after)
        self._moments[run] = after, mean + change * more / after, squares

    @property
    def mean(self) -> NDArray[np.float64]:
        """[R, *shape]: 0 for a run that has counted nothing."""
        return self._moments[:, 1]

    @property
    def variance(self) -> NDArray[np.float64]:
        """[R, *shape]: 0 for a run that has counted nothing."""
        return self._moments[:, 2] / np.maximum(self._moments[:, 0], 1)

    @property
    def empty(self) -> NDArray[np.bool_]:
        """[R, *shape]: mask of the runs that have counted nothing."""
        return self._moments[:, 0] == 0

    def state_dict(self) -> dict[str, NDArray]:
        """The state for a checkpoint."""
        return {"moments": self._moments}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        self._moments = tree.expect("moments", state, self._moments.shape, np.float64).copy()


class Inputs(NamedTuple):
    """Map from observations of R runs to the inputs of their networks: `scale · x`, or with a mean
    `clip(scale · (x - mean), -10, 10)`."""

    scale: NDArray[np.float32]
    """[] or [observation size]; with a mean [R, observation size]"""
    mean: NDArray[np.float32] | None = None
    """[R, observation size]"""

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the inputs for observations [R, N, at least observation size]. With a mean,
        numbers behind the observation, which only critics see, stay as they are."""
        if self.mean is None:
            return self.scale * observation
        size = self.mean.shape[-1]
        seen = (observation[..., :size] - self.mean[:, None]) * self.scale[:, None]
        seen = np.minimum(np.maximum(seen, -CLIP), CLIP)
        return np.concatenate([seen, observation[..., size:]], axis=-1)

    def module(
        self, run: int, layers: Sequence[NDArray[np.float32]], activation: Activation
    ) -> nn.Sequential:
        """Return a run's network in PyTorch for the task's observations; layers: as for `mlp`."""
        if self.mean is None:
            first, *others = layers
            return mlp([self.scale[..., None] * first, *others], activation)
        normalized = Normalized(self.mean[run], self.scale[run])
        return nn.Sequential(normalized, *mlp(layers, activation))


class Normalized(nn.Module):
    """Module that computes `clip(scale · (x - mean), -10, 10)`."""

    mean: Tensor
    scale: Tensor

    def __init__(self, mean: NDArray[np.float32], scale: NDArray[np.float32]) -> None:
        super().__init__()
        self.register_buffer("mean", torch.from_numpy(mean.copy()))
        self.register_buffer("scale", torch.from_numpy(scale.copy()))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the inputs for observations [..., size], of the same shape."""
        return ((observation - self.mean) * self.scale).clamp(-CLIP, CLIP)


class Normalizer(RunningMoments):
    """Running moments of the observations on which runs have acted.

    The actions and the update of an epoch use the moments of the epochs before; in the first epoch
    mean 0 and variance 1. Source: `NormalizeObservation` of gymnasium and `VecNormalize` of
    Stable-Baselines3, which update the moments at every environment step.
    """

    def count(self, observation: NDArray[np.float32], length: NDArray[np.int64]) -> None:
        """Count the first `length` [R·E] steps of episodes [T, R·E, at least observation size]."""
        runs, _, size = self._moments.shape
        episodes = len(length) // runs
        for run in range(runs):
            own = range(run * episodes, (run + 1) * episodes)
            seen = np.concatenate([observation[: length[k], k, :size] for k in own])
            if len(seen):
                self.add(run, seen.astype(np.float64))

    def state_dict(self) -> dict[str, NDArray]:
        """Return the state for a checkpoint, named as a part of the policy."""
        return {"actor.observations": self._moments}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        super().load_state_dict({"moments": state["actor.observations"]})

    @property
    def inputs(self) -> Inputs:
        """The networks' inputs, by the current moments."""
        scale = np.where(self.empty, 1.0, 1.0 / np.sqrt(self.variance + 1e-8))
        return Inputs(scale.astype(np.float32), self.mean.astype(np.float32))


class InputConfig(Settings):
    """How an algorithm's networks see observations; the config of a family declares both fields."""

    if TYPE_CHECKING:
        input_scale: float | tuple[float, ...]
        normalize_observations: bool

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming one that is not allowed."""
        super().__post_init__()
        if self.normalize_observations and self.input_scale != 1.0:
            raise UserError(
                "input_scale must be 1 with normalize_observations, which gives every number a "
                f"scale of its own, got {self.input_scale}"
            )

    def inputs(self, normalizer: Normalizer | None) -> Inputs:
        """Return the networks' inputs; normalizer: that of the runs, if they have one."""
        return normalizer.inputs if normalizer else Inputs(np.asarray(self.input_scale, np.float32))

    def normalizer(self, runs: int, observation_size: int) -> Normalizer | None:
        """Return a new normalizer for the runs, or None without `normalize_observations`."""
        return Normalizer(runs, observation_size) if self.normalize_observations else None
