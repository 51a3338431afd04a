"""WCSAC: soft actor-critic that bounds the conditional value-at-risk of the cost.

The first cost critic is the mean of the discounted cost return, the second its variance.
Source: Yang et al. 2021, "WCSAC: Worst-case soft actor critic for safety-constrained reinforcement
learning"; in the paper's grid as "WCSAC" with the index 0.5, its risk level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import softplus

from agents.algorithms import Algorithm
from agents.checks import In
from agents.lockstep import lagrange
from agents.lockstep.kernel import Float
from agents.lockstep.lagrange import EXP, Multiplier
from agents.lockstep.pulled import Pull, closed_form
from agents.sac import CostRule, MultiplierOfConfig, OffPolicy
from agents.sac.replay import Batch
from agents.sac.update import mean
from emcc import cvar

VARIANCE = (1e-8, 1e8)
"""Bounds to which variances are clamped."""


@dataclass(frozen=True)
class WCSACConfig(MultiplierOfConfig):
    """Hyper-parameters of WCSAC.

    The multiplier is κ = exp(parameter), at first 1: the parameter starts at 0.
    """

    initial_multiplier: Annotated[float, In(-50, 50)] = 0.0  # far from where exp overflows
    """Initial parameter of the multiplier, before it is mapped to positive numbers. Not specified
    in the paper."""
    risk_level: Annotated[float, In(above=0, high=1)] = 0.5
    """Risk level α: the mean of the worst share α of cost returns is limited; 1 limits the mean of
    all. Paper: 0.5."""
    damping: Annotated[float, In(0, 1e6)] = 10.0
    """Scale of the damping of the multiplier in the actor's loss. Not specified in the paper; 10 in
    the code of Yang et al."""
    variance_target: Literal["squared", "unsquared"] = "squared"
    """Last term of the variance's target: squared, as in a variance; or unsquared, and without a
    mask at terminal steps, as in a later library of the paper's group. No preset uses unsquared."""
    damping_gradient: Literal["stopped", "through"] = "stopped"
    """Whether the actor's gradient goes through the damping: stopped as in the code of Yang et al.,
    or through it as in a later library of the paper's group. No preset uses through."""


def tail_factor(level: float) -> Tensor:
    """`φ(Φ⁻¹(α)) / α`: how many standard deviations the mean of a Gaussian's worst share α, the
    `level`, lies above the Gaussian's mean; [], in double precision."""
    quantile = torch.special.ndtri(torch.full((), level, dtype=torch.float64))
    return torch.exp(-0.5 * quantile**2) / (math.sqrt(2.0 * math.pi) * level)


def variance(output: Tensor) -> Tensor:
    """The second critic's output as a variance: `softplus`, clamped."""
    return softplus(output).clamp(*VARIANCE)


def risk(config: WCSACConfig, cost_values: Tensor) -> Tensor:
    """`Γ = Q_c + φ(Φ⁻¹(α))/α √V_c`: the CVaR of a Gaussian."""
    return cost_values[:, 0] + tail_factor(config.risk_level) * variance(cost_values[:, 1]).sqrt()


def critic_loss(
    config: WCSACConfig, cost_values: Tensor, next_cost_values: Tensor, batch: Batch
) -> Tensor:
    """Half the mean squared error of the mean, plus half the 2-Wasserstein distance of the
    deviations, `V + V* - 2 √(V V*)`.
    """
    discount = config.discount * (1.0 - batch.cost_terminal)
    mean_target, variance_target = targets(
        discount, cost_values[:, 0].detach(), next_cost_values, batch.cost
    )
    if config.variance_target == "unsquared":
        variance_target = unsquared_variance_target(
            config.discount, cost_values[:, 0].detach(), next_cost_values, batch.cost
        )
    error = cost_values[:, 0] - mean_target
    spread = variance(cost_values[:, 1])
    distance = spread + variance_target - 2.0 * (spread * variance_target).sqrt()
    return 0.5 * (error * error).mean(dim=-1) + 0.5 * distance.mean(dim=-1)


def targets(
    discount: Tensor, mean: Tensor, next_cost_values: Tensor, cost: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the targets of the cost return's mean, `c + γ Q_c'`, and of its variance,
    `c² - Q_c² + 2 γ c Q_c' + γ² V_c' + γ² Q_c'²`, clamped. All arrays are [R, B] except
    next_cost_values, [R, 2, B].
    """
    next_mean, next_variance = next_cost_values[:, 0], variance(next_cost_values[:, 1])
    future = discount * discount * (next_variance + next_mean * next_mean)
    second_moment = cost * cost + 2.0 * discount * cost * next_mean + future
    return cost + discount * next_mean, (second_moment - mean * mean).clamp(*VARIANCE)


def unsquared_variance_target(
    discount: float, mean: Tensor, next_cost_values: Tensor, cost: Tensor
) -> Tensor:
    """`c² - Q_c² + 2 γ c Q_c' + γ² V_c' + γ² Q_c'`, clamped, without a mask at terminal steps.

    This is no variance: for large Q_c' it is far below one. Shapes as in `targets`.
    """
    next_mean, next_variance = next_cost_values[:, 0], variance(next_cost_values[:, 1])
    future = discount * discount * (next_variance + next_mean)
    target = cost * cost - mean * mean + 2.0 * discount * cost * next_mean + future
    return target.clamp(*VARIANCE)


def penalty(config: WCSACConfig, risk: Tensor, multipliers: Tensor) -> Tensor:
    """`(κ - κ_d) Γ` with the damping `κ_d = scale · E[d - Γ]`, by default without its gradient.

    multipliers: κ; where `multiplier_of` is not replay, what `damped` returned.
    """
    if config.multiplier_of != "replay":
        return multipliers[..., None] * risk
    mean = (risk.detach() if config.damping_gradient == "stopped" else risk).mean(-1, keepdim=True)
    damping = config.damping * (config.cost_limit - mean)
    return (multipliers[..., None] - damping) * risk


def damped(config: WCSACConfig, multipliers: Tensor, followed: Tensor) -> Tensor:
    """`κ - scale · (d - Γ)`, with `followed`, what the multiplier follows, instead of Γ."""
    return multipliers - config.damping * (config.cost_limit - followed)


def worst(config: WCSACConfig, costs: NDArray[np.float64]) -> float:
    """The mean of the worst share α of episode costs [E]: their CVaR."""
    return cvar(costs, config.risk_level, ties="split")


# Closed forms of the rule, in NumPy.


def _variance(output: Float) -> tuple[Float, Float]:
    """`variance` and its slope in the output."""
    free = lagrange.softplus(output)
    clamped = free.clip(*VARIANCE)
    return clamped, (free == clamped) * lagrange.sigmoid(output)


@closed_form(risk)
def _risk(config: WCSACConfig, cost_values: Float) -> tuple[Float, Pull]:
    factor, (spread, slope) = tail_factor(config.risk_level).item(), _variance(cost_values[:, 1])
    std = np.sqrt(spread)
    of_output = 0.5 * factor * slope / std
    return cost_values[:, 0] + factor * std, lambda s: np.stack([s, s * of_output], axis=1)


@closed_form(critic_loss)
def _critic_loss(
    config: WCSACConfig, cost_values: Float, next_cost_values: Float, batch: Batch
) -> tuple[Float, Pull]:
    now, following, cost = cost_values[:, 0], next_cost_values[:, 0], batch.cost
    discount = going = config.discount * (1.0 - batch.cost_terminal)
    squared = following * following
    if config.variance_target == "unsquared":
        going, squared = config.discount, following
    squared = squared + _variance(next_cost_values[:, 1])[0]
    later = going * (2.0 * cost * following + going * squared)
    target = (cost * cost - now * now + later).clip(*VARIANCE)
    error, (spread, slope) = now - cost - discount * following, _variance(cost_values[:, 1])
    both = np.sqrt(spread * target)
    loss = 0.5 * mean(error * error + spread + target - 2.0 * both)
    slopes = np.stack([error, 0.5 * slope * (1.0 - target / both)], axis=1) / now.shape[-1]
    return loss, lambda s: s[:, None, None] * slopes


@closed_form(penalty)
def _penalty(config: WCSACConfig, risk: Float, multipliers: Float) -> tuple[Float, Pull]:
    weight, through = multipliers[..., None], 0.0
    if config.multiplier_of == "replay":
        weight = weight - config.damping * (config.cost_limit - mean(risk)[..., None])
        through = config.damping * (config.damping_gradient == "through") / risk.shape[-1]
    along = lambda s: (s * risk).sum(axis=-1, keepdims=True)  # noqa: E731
    return weight * risk, lambda s: weight * s + (through * along(s) if through else 0.0)


RULE = CostRule(
    *(risk, critic_loss, penalty, (Multiplier(EXP),)),
    augmented=damped,
    augments_replay=False,
    of_episodes=worst,
)
ALGORITHM = Algorithm("WCSAC", WCSACConfig, RULE, OffPolicy, work=5.2)
