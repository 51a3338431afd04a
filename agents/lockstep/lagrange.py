"""Lagrange multipliers: how a parameter stands for one, and how it follows the cost.

A multiplier is updated from an explicit estimate of the cost, never from a log of past episodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import softplus

from agents.errors import check, check_choice
from agents.lockstep.adam import Moments, adam, no_moments
from agents.lockstep.nets import LANES

PID_SMOOTHING = 0.95
"""Share of the old value in the smoothed cost, whose growth the derivative term sees. Source: code
of Stooke et al. 2020; OmniSafe."""


@dataclass(frozen=True)
class PIDConfig:
    """Gains of the PID controller of a multiplier."""

    pid_kp: float = 0.1
    """Gain of the cost above its limit, by pid. Not in the paper; 0.1 as in OmniSafe."""
    pid_ki: float = 0.01
    """Gain of the sum over epochs of the cost above its limit, by pid. Not in the paper; 0.01 as in
    OmniSafe."""
    pid_kd: float = 0.01
    """Gain of the smoothed cost's growth in an epoch, by pid. Not in the paper; 0.01 as in
    OmniSafe."""


@dataclass(frozen=True)
class MultiplierConfig(PIDConfig):
    """Hyper-parameters of a multiplier, for the configs of algorithms that have one."""

    initial_multiplier: float = 0.0
    """Initial parameter of the multiplier, before it is mapped to positive numbers. Paper: 0 for
    SAC-Lag; not printed for WCSAC."""
    multiplier_lr: float = 3e-4
    """Step size of the multiplier's parameter by adam or sgd. Paper: 3e-4 for SAC-Lag; not printed
    for WCSAC."""
    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "adam"
    """How the multiplier follows the cost: its parameter ascends by Adam or by the plain gradient
    (sgd), or a PID controller sets it once an epoch (pid; Stooke et al. 2020). Not printed in the
    paper."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        # Numbers are float32: beyond these bounds the first update is not finite.
        check(self, "initial_multiplier", low=-1e6, high=1e6)
        check(self, "multiplier_lr", "pid_kp", "pid_ki", "pid_kd", low=0, high=1e6)
        check_choice(self, "multiplier_optimizer", "adam", "sgd", "pid")
        of_family = getattr(super(), "__post_init__", None)
        if of_family:
            of_family()


class MultiplierForm(NamedTuple):
    """How a parameter stands for a multiplier, which cannot be negative."""

    value: Callable[[Tensor], Tensor]
    """parameter -> multiplier"""
    slope: Callable[[Tensor], Tensor]
    """parameter -> derivative of the multiplier"""
    lowest: float = -math.inf
    """Lower bound of the parameter."""
    law: Callable[[Any, Tensor, Tensor], Tensor] | None = None
    """(config, parameter [R, LANES], cost [R, 1]) -> the parameter after an update. An algorithm's
    own law, instead of a `multiplier_optimizer`; its config has `initial_multiplier` alone."""


SOFTPLUS = MultiplierForm(softplus, torch.sigmoid)
EXP = MultiplierForm(torch.exp, torch.exp)
PROJECTED = MultiplierForm(torch.clone, torch.ones_like, lowest=0.0)
"""The parameter is the multiplier."""


class MultiplierState(NamedTuple):
    """The multipliers of all runs that ascend a gradient. Lanes of a row are equal: see `nets`."""

    parameter: Tensor
    """[R, LANES]"""
    moments: Moments


class PIDState(NamedTuple):
    """The multipliers of all runs that a PID controller sets. Lanes of a row are equal."""

    value: Tensor
    """[R, LANES]: the multiplier itself, at least 0"""
    integral: Tensor
    """[R, LANES]: the integral term, its gain included, at least 0"""
    smoothed_cost: Tensor
    """[R, LANES]: exponential average of the costs seen, from 0"""


def initial(
    form: MultiplierForm | None, config: Any, runs: int
) -> MultiplierState | PIDState | None:
    """The state before the first update; None for an algorithm without a multiplier.

    A PID controller starts from the same multiplier as the others, as its integral term. Raises
    TypeError for a form with a law where the config has an optimiser, too.
    """
    if form is None:
        return None
    parameter = torch.full((runs, LANES), float(config.initial_multiplier))
    if form.law:
        if hasattr(config, "multiplier_optimizer"):
            raise TypeError(f"the multiplier has a law: {config!r} must not have an optimizer")
        return MultiplierState(parameter, no_moments(parameter))
    if config.multiplier_optimizer == "pid":
        value = form.value(parameter)
        return PIDState(value, value.clone(), torch.zeros_like(value))
    return MultiplierState(parameter, no_moments(parameter))


def value(
    form: MultiplierForm | None, state: MultiplierState | PIDState | None, runs: int
) -> Tensor:
    """The multiplier of each run, [R, 1]; 0 for an algorithm without one."""
    if form is None or state is None:
        return torch.zeros(runs, 1)
    if isinstance(state, PIDState):
        return state.value[:, :1]
    return form.value(state.parameter)[:, :1]


def follow(
    form: MultiplierForm | None,
    config: Any,
    state: MultiplierState | PIDState | None,
    cost: Tensor,
) -> MultiplierState | PIDState | None:
    """The state after an update by the form's law or the config's optimiser.

    cost: [R, 1], to be compared with `config.cost_limit`.
    """
    if form is None or state is None:
        return None
    if isinstance(state, PIDState):
        return control(config, state, cost)
    if form.law:
        parameter = form.law(config, state.parameter, cost).clamp(min=form.lowest)
        return MultiplierState(parameter, state.moments)
    return ascend(form, config, state, cost)


def ascend(
    form: MultiplierForm, config: Any, state: MultiplierState, cost: Tensor
) -> MultiplierState:
    """One gradient step up `λ (cost - d)`: λ rises exactly where the cost is above its limit."""
    parameter, moments = state
    excess = (cost - config.cost_limit).to(parameter.dtype)
    gradient = -form.slope(parameter) * excess
    if config.multiplier_optimizer == "adam":
        parameter, moments = adam(parameter, gradient, moments, config.multiplier_lr)
    else:
        parameter = parameter - config.multiplier_lr * gradient
    return MultiplierState(parameter.clamp(min=form.lowest), moments)


def control(config: Any, state: PIDState, cost: Tensor) -> PIDState:
    """One step of the PID controller, `Δ = cost - d`, `(x)₊ = max(x, 0)`.

    `I ← (I + k_I Δ)₊`, `c ← .95 c + .05 cost`, `λ = (k_P Δ + I + k_D (c - c_before)₊)₊`.
    Source: Stooke et al. 2020, "Responsive safety in reinforcement learning by PID Lagrangian
    methods", algorithm 2, with the derivative of the smoothed cost as in its code.
    """
    excess = (cost - config.cost_limit).to(state.value.dtype)
    integral = (state.integral + config.pid_ki * excess).clamp(min=0.0)
    new_share = (1.0 - PID_SMOOTHING) * cost.to(state.value.dtype)
    smoothed = PID_SMOOTHING * state.smoothed_cost + new_share
    growth = (smoothed - state.smoothed_cost).clamp(min=0.0)
    value = config.pid_kp * excess + integral + config.pid_kd * growth
    return PIDState(value.clamp(min=0.0), integral, smoothed)
