"""The first-order family: minibatch steps of Adam up surrogate objectives, such as PPO's.

An algorithm adds an `Objective`. Source: Schulman et al. 2017, "Proximal policy optimization
algorithms".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.checks import In
from agents.lockstep import kernel, lagrange, tree
from agents.lockstep.backend import tensor
from agents.lockstep.descent import Clipped, Descent, Loss, Slopes, orders
from agents.lockstep.kernel import Float
from agents.lockstep.lagrange import Multiplier
from agents.lockstep.nets import no_moments
from agents.on_policy.epoch import (
    EpochData,
    compared,
    divergence,
    raised_advantage,
    ratios,
    taken,
)
from agents.on_policy.learner import OnPolicy
from agents.on_policy.state import Gaussian, OnPolicyConfig, OnPolicyState


@dataclass(frozen=True)
class FirstOrderConfig(OnPolicyConfig):
    """Hyper-parameters of the first-order family.

    The paper has no algorithm of this family. The defaults are those of Stable-Baselines3, except
    for the on-policy epoch, whose defaults are the paper's.
    """

    batch_size: Annotated[int, In(1)] = 64
    """Environment steps in a minibatch of actor and critics. Not in the paper; 64 as in
    Stable-Baselines3 and OmniSafe."""
    actor_iterations: Annotated[int, In(1, 10_000)] = 10
    """Passes of the actor over an epoch's steps. Not in the paper; 10 as in Schulman et al. and
    Stable-Baselines3."""
    max_gradient_norm: Annotated[float, In(above=0, high=1e12)] = 0.5
    """Norm to which the actor's gradient is clipped. Not in the paper; 0.5 as in
    Stable-Baselines3."""
    kl_stop: Annotated[float, In(0, 1e12)] = 0.0
    """Mean KL divergence beyond which an epoch's passes of the actor end; 0: never. Not in the
    paper; 0 as in Schulman et al."""


@dataclass(frozen=True)
class PPOConfig(FirstOrderConfig):
    """Hyper-parameters of the algorithms with PPO's clipped surrogate."""

    clip_range: Annotated[float, In(above=0, high=1)] = 0.2
    """Distance ε from 1 at which the ratio of new and old probability is clipped. Not in the paper;
    0.2 as in Schulman et al."""


class Minibatch(NamedTuple):
    """Steps of an epoch that the actor learns from."""

    observation: Tensor
    """[R, B, observation size]"""
    action: Tensor
    """[R, B, A]"""
    weight: Tensor
    """[R, B]: sums to 1, or to 0 for a run without steps in the minibatch"""
    advantage: Tensor
    """[R, B]"""
    old_log_prob: Tensor
    """[R, B]: log π_old(a|s) of the policy that took the steps"""
    cost_advantage: Any = None
    """[R, C, B]"""
    start: Any = None
    """The policy at the start of the passes, a `Gaussian`."""
    excess: Any = None
    """[R, C]: mean cost of the epoch's episodes above its limit, `J_C - d`; NaN without a limit"""
    multipliers: Any = None
    """[R, M]"""


Surrogate = Callable[[Any, Gaussian, Tensor, Minibatch], tuple[Tensor, Tensor]]
"""(config, policy, its ratios `ρ = π(a|s) / π_old(a|s)` [R, B], minibatch) -> the objective to be
raised, [R], and the share of environment steps left out of it as too far from π_old, [R]"""


def mean(batch: Minibatch, values: Tensor) -> Tensor:
    """Return the weighted mean over a minibatch of values [R, B]: [R]."""
    return (batch.weight * values).sum(dim=-1)


def clipped(
    config: Any, policy: Gaussian, ratio: Tensor, batch: Minibatch
) -> tuple[Tensor, Tensor]:
    """`E[min(ρ A, clip(ρ, 1 - ε, 1 + ε) A)]`; equation 7 of Schulman et al."""
    bounded = ratio.clamp(1.0 - config.clip_range, 1.0 + config.clip_range)
    gain = torch.minimum(ratio * batch.advantage, bounded * batch.advantage)
    outside = ((ratio - 1.0).abs() > config.clip_range).to(ratio.dtype)
    return mean(batch, gain), mean(batch, outside)


class Objective(NamedTuple):
    """How an algorithm of the family treats costs."""

    advantage: Callable[[Any, Tensor, Tensor, Tensor], Tensor]
    """(config, reward advantages [R, B], cost advantages [R, C, B], multipliers [R, M]) -> [R, B]:
    the advantages that the policy maximises. Called for one run at a time, with the environment
    steps of its epoch."""
    multipliers: tuple[Multiplier, ...] = ()
    """Each follows `J_C - d` of its cost."""
    costs: int = 1
    """How many costs are learned."""
    limits: tuple[str, ...] = ("cost_limit",)
    """Names of the hyper-parameters that limit the costs, in the order of the costs; the `limit` of
    a multiplier takes precedence for its cost."""
    surrogates: tuple[Surrogate, ...] = (clipped,)
    """Objectives of the actor, one after the other, each for `actor_iterations` passes."""
    reverse_kl: bool = False
    """Whether `kl_stop` is compared with `KL(π ‖ π_k)` instead of `KL(π_k ‖ π)`, π_k being the
    policy that took the steps."""


def surrogate_at(
    config: Any, surrogate: Surrogate, policy: Gaussian, batch: Minibatch
) -> tuple[Tensor, Tensor]:
    """Return what the surrogate gives for a policy, [R] each. Raises ValueError for other
    shapes."""
    returned = surrogate(config, policy, ratios(policy, batch), batch)
    shapes, runs = [list(value.shape) for value in returned], len(policy.mean)
    if shapes != [[runs], [runs]]:  # of [R, B], the loss would be a sum over steps
        raise ValueError(f"a surrogate must return two of [runs], here [{runs}], got {shapes}")
    return returned


class Raised(NamedTuple):
    """Loss of any surrogate: its negative, whose gradient in the policy's means and log-stds
    autograd computes."""

    config: Any
    surrogate: Surrogate
    epoch: Minibatch
    """All environment steps of the epoch, [R, B]."""

    def slopes(
        self, rows: NDArray[np.int64], weight: Float, outputs: Float, log_std: Float
    ) -> Slopes:
        """See `Loss`."""
        spread = tensor(log_std[:, None]).requires_grad_()
        means, batch = tensor(outputs).requires_grad_(), self._at(rows, weight)
        with torch.enable_grad():
            policy = Gaussian(means, spread, spread.exp())
            raised, outside = surrogate_at(self.config, self.surrogate, policy, batch)
        of_means, of_spread = torch.autograd.grad(
            -raised.sum(), (means, spread), allow_unused=True, materialize_grads=True
        )
        return Slopes(of_means.numpy(), of_spread[:, 0].numpy(), outside.detach().numpy())

    def _at(self, rows: NDArray[np.int64], weight: Float) -> Minibatch:
        """Return the minibatch of some rows [R, b] of the epoch, with weights [R, b]."""
        run, whole = np.arange(len(rows))[:, None], self.epoch

        def at(column: Tensor) -> Tensor:
            return tensor(column.numpy()[run, rows])

        steps = {"observation", "action", "advantage", "old_log_prob"}
        columns = {name: at(getattr(whole, name)) for name in steps}
        costs, start = whole.cost_advantage.numpy(), whole.start
        k = np.arange(costs.shape[1])[:, None]
        of_costs = tensor(costs[run[..., None], k, rows[:, None]])
        start = start._replace(mean=at(start.mean))
        return whole._replace(
            weight=tensor(weight), cost_advantage=of_costs, start=start, **columns
        )


def loss_of(config: Any, surrogate: Surrogate, epoch: Minibatch) -> Loss:
    """Return the loss of a surrogate over an epoch, in closed form if there is one."""
    if surrogate is not clipped:
        return Raised(config, surrogate, epoch)
    action, advantage, old_log_prob = (
        column.numpy() for column in (epoch.action, epoch.advantage, epoch.old_log_prob)
    )
    return Clipped(action, advantage, old_log_prob, config.clip_range)


class FirstOrder(OnPolicy):
    """The runs of one algorithm of the first-order family."""

    takes = (FirstOrderConfig, Objective)
    improvement_metrics = ("kl", "clipped")
    """Mean KL divergence from the old to the new policy; mean share of environment steps whose
    ratio is clipped or, without clipping, which lie outside the trust region."""

    def __init__(self, config: FirstOrderConfig, rule: Objective, *runs: Any) -> None:
        super().__init__(config, rule, *runs)
        self._state = self._state._replace(actor_moments=no_moments(self._state.actor))

    def improve(
        self, epoch: EpochData, steps: NDArray[np.int64], generators: list[np.random.Generator]
    ) -> tuple[OnPolicyState, dict[str, Tensor]]:
        """Train the actors in passes over the epoch, each in minibatches of a new random order."""
        config, rule, state = self.config, self.rule, self._state
        actor, moments, runs = state.actor, state.actor_moments, len(self.seeds)
        assert moments is not None
        multipliers = tensor(lagrange.values(rule.multipliers, state.multipliers, runs))
        advantage = raised_advantage(rule, config, epoch, steps, multipliers)
        old = taken(self.nets, actor, epoch, advantage)
        excess = (epoch.cost - tensor(lagrange.limits(rule, config))).to(actor.dtype)
        actor, moments = tree.copy((actor, moments))
        descent = Descent(
            net=self.nets.actor.net,
            params=actor.numpy(),
            moments=moments.arrays,
            inputs=epoch.observation.numpy(),
            batch_size=config.batch_size,
            rate=config.learning_rate,
            log_std=self.nets.actor.log_std,
            longest=config.max_gradient_norm,
        )
        own = kernel.of(descent.params)
        columns = (epoch.observation, epoch.action, epoch.weight, advantage, old.old_log_prob)
        whole = Minibatch(*columns, epoch.cost_advantage, None, excess, multipliers)
        clipped, count = np.zeros(runs), np.zeros(runs)
        for k, surrogate in enumerate(rule.surrogates):
            start = taken(self.nets, actor, epoch, advantage) if k else old
            whole = whole._replace(start=start.old)
            loss, taking = loss_of(config, surrogate, whole), steps
            for _ in range(config.actor_iterations):
                order = orders(steps, generators)
                clipped += own.descend(descent, loss, order, taking)
                count += -(-taking // config.batch_size)
                if config.kl_stop:
                    moved = divergence(self.nets, actor, old, rule.reverse_kl)
                    taking = np.where(moved.numpy() <= config.kl_stop, taking, 0)
        _, kl = compared(self.nets, actor, old)
        records = {"kl": kl, "clipped": tensor(clipped / np.maximum(count, 1)).float()}
        names = lagrange.names(rule.multipliers)
        records |= dict(zip(names, multipliers.unbind(dim=-1), strict=True))
        return state._replace(actor=actor, actor_moments=moments), records
