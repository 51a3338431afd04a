"""Passes of Adam over minibatches, and the losses that the C++ kernel has in closed form.

A pass trains R runs with K networks each, N = R·K in all. The parameters of a policy are those of
its network followed by its log-std.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from agents.lockstep.kernel import Float, InNumpy, Shape

MAY_DIVERGE = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""For updates: the learner's `finite` finds runs whose numbers are no longer finite."""


class Slopes(NamedTuple):
    """The gradient of a loss, summed over runs, in the networks' outputs and log-stds."""

    outputs: Float
    """[N, b, out]"""
    log_std: Float
    """[N, A]; A is 0 if the loss depends on outputs alone"""
    record: Float
    """[N]: number that the loss records of the minibatch"""


class Loss(Protocol):
    """A loss of the networks' outputs at some rows of an epoch."""

    def slopes(
        self, rows: NDArray[np.int64], weight: Float, outputs: Float, log_std: Float
    ) -> Slopes:
        """Return the slopes at rows [R, b] with weights [R, b] that sum to 1, or to 0 for a run
        without rows in the minibatch; outputs: [N, b, out]; log_std: [N, A]."""
        ...


class Clipped(NamedTuple):
    """PPO's loss, `-E[min(ρ A, clip(ρ, 1 - ε, 1 + ε) A)]`, as a function of means and log-stds. The
    gradient is `-ρ A ∂ log π` where ρ is not clipped, 0 elsewhere. Records the share of environment
    steps whose ratio is outside the range."""

    action: Float
    """[R, B, A]"""
    advantage: Float
    """[R, B]"""
    old_log_prob: Float
    """[R, B]"""
    clip_range: float
    """ε"""

    def slopes(
        self, rows: NDArray[np.int64], weight: Float, outputs: Float, log_std: Float
    ) -> Slopes:
        """See `Loss`."""
        run, log_std = np.arange(len(rows))[:, None], log_std[:, None]
        action, advantage, old = (column[run, rows] for column in self[:3])
        std = np.exp(log_std)
        z = (action - outputs) / std
        log_prob = (-0.5 * z * z - log_std - 0.5 * math.log(2.0 * math.pi)).sum(axis=-1)
        ratio = np.exp(np.where(weight > 0, log_prob - old, 0.0))
        beyond = np.abs(ratio - 1.0) > self.clip_range
        cut = beyond & ((ratio > 1.0) == (advantage > 0.0))
        slope = np.where(cut, 0.0, -weight * advantage * ratio)[..., None]
        of_log_std = (slope * (z * z - 1.0)).sum(axis=1)
        return Slopes(slope * z / std, of_log_std, (weight * beyond).sum(axis=-1))


class Squared(NamedTuple):
    """Half the mean squared error of networks with one output; records its value."""

    target: Float
    """[R, K, B]"""

    def slopes(
        self, rows: NDArray[np.int64], weight: Float, outputs: Float, log_std: Float
    ) -> Slopes:
        """See `Loss`."""
        runs, count, _ = self.target.shape
        run, k = np.arange(runs)[:, None, None], np.arange(count)[:, None]
        error = outputs.reshape(runs, count, -1) - self.target[run, k, rows[:, None]]
        slope = weight[:, None] * error
        record = (0.5 * slope * error).sum(axis=-1).reshape(-1)
        return Slopes(slope.reshape(outputs.shape), log_std, record)


class Moments(NamedTuple):
    """Adam's state for parameters [R, ...]: arrays, or tensors where the parameters are tensors."""

    mean: Any
    square: Any
    decay1: Any
    """β₁ᵗ [R, 1, ...]. A running product, since the last bit of a power depends on its lane."""
    decay2: Any
    """β₂ᵗ [R, 1, ...]"""

    @property
    def arrays(self) -> Moments:
        """Views of all parts as arrays [R, P]."""
        return Moments(*(np.asarray(part).reshape(len(part), -1) for part in self))


class Descent(NamedTuple):
    """A pass: the `params` and `moments` that it changes in place, and its settings."""

    net: Shape
    params: Float
    """[N, P]: those of the network, in a policy the log-std, and padding, which stays 0"""
    moments: Moments
    """[R, K·P]"""
    inputs: Float
    """[R, B, at least in]: networks see the first `in` numbers"""
    batch_size: int
    rate: float
    """Adam's step size"""
    log_std: slice = slice(0, 0)
    """Slice of a policy's parameters that holds the log-std."""
    longest: float = math.inf
    """Norm to which the gradient of each network is clipped."""


def orders(steps: NDArray[np.int64], streams: Sequence[np.random.Generator]) -> NDArray[np.int64]:
    """Return a random order of each run's rows, [R, most steps]; the first `steps` [R] count."""
    order = np.zeros((len(steps), int(steps.max())), dtype=np.int64)
    for run, (n, rng) in enumerate(zip(steps, streams, strict=True)):
        order[run, :n] = rng.permutation(n)
    return order


LANES = 32
"""Multiple of the vector lanes of PyTorch's functions, which compute a remainder differently."""


def minibatches(
    order: NDArray[np.int64], steps: NDArray[np.int64], size: int
) -> Iterator[tuple[NDArray[np.int64], Float]]:
    """Yield rows and weights [R, b] of minibatches; b: size, padded to a multiple of `LANES`.

    The weights of a run's minibatch sum to 1, or to 0 if the run has no rows left.
    """
    width = -(-size // LANES) * LANES
    for start in range(0, int(steps.max()), size):
        rows = np.zeros((len(steps), width), dtype=np.int64)
        part = order[:, start : start + size]
        rows[:, : part.shape[1]] = part
        held = np.minimum(np.maximum(steps - start, 0), size)[:, None]
        here = np.arange(width) < held
        yield rows, (here / np.maximum(held, 1)).astype(np.float32)


@MAY_DIVERGE
def descend(
    own: InNumpy, it: Descent, loss: Loss, order: NDArray[np.int64], steps: NDArray[np.int64]
) -> Float:
    """Make a pass with any loss: see `InNumpy.descend`."""
    params, runs = it.params, len(steps)
    share, seen = len(params) // runs, it.inputs[..., : it.net.sizes[0]]
    total = np.zeros(len(params), params.dtype)
    for rows, weight in minibatches(order, steps, it.batch_size):
        x = seen[np.arange(runs)[:, None], rows]
        outputs, tape = own.forward(it.net, params, x, share)
        found = loss.slopes(rows, weight.astype(x.dtype), outputs, params[:, it.log_std])
        gradient, _ = own.backward(it.net, params, x, tape, found.outputs, "p", share)
        assert gradient is not None
        gradient[:, it.log_std] = found.log_std
        norm = np.sqrt((gradient * gradient).sum(axis=-1, keepdims=True))
        gradient *= np.minimum(it.longest / (norm + 1e-6), 1.0)
        present = weight[:, 0] > 0
        own_rows = [slice(r, r + 1) for r in np.flatnonzero(present)]
        by_run = (params.reshape(runs, -1), gradient.reshape(runs, -1), *it.moments)
        for part in [slice(None)] if present.all() else own_rows:
            to, down, mean, square, decay1, decay2 = (array[part] for array in by_run)
            own.adam(to, down, Moments(mean, square, decay1, decay2), it.rate)
        total += found.record
    return total
