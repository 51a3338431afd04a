"""Lagrange multipliers: how they are parametrised, and how they follow the cost.

A multiplier is updated from an explicit estimate of the cost, never from a log of past episodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from agents.checks import In, Settings
from agents.errors import UserError
from agents.lockstep.backend import tensor
from agents.lockstep.kernel import Float
from agents.lockstep.nets import LANES, Moments, adam, no_moments

PID_SMOOTHING = 0.95
"""Share of the old value in the smoothed cost, from which the derivative term is computed. Source:
code of Stooke et al. 2020; OmniSafe."""
Gain = In(0, 1e6)
"""Range of gains: in float32 the first update with a larger one is not finite."""


@dataclass(frozen=True)
class PIDConfig(Settings):
    """Gains of the PID controller of a multiplier."""

    pid_kp: Annotated[float, Gain] = 0.1
    """Proportional gain of the cost above its limit (pid). Not in the paper; 0.1 as in OmniSafe."""
    pid_ki: Annotated[float, Gain] = 0.01
    """Integral gain of the sum over epochs of the cost above its limit (pid). Not in the paper;
    0.01 as in OmniSafe."""
    pid_kd: Annotated[float, Gain] = 0.01
    """Derivative gain of the smoothed cost's growth in an epoch (pid). Not in the paper; 0.01 as in
    OmniSafe."""


@dataclass(frozen=True)
class MultiplierConfig(PIDConfig):
    """Hyper-parameters of a multiplier, for the configs of algorithms that have one."""

    initial_multiplier: Annotated[float, In(-1e6, 1e6)] = 0.0
    """Initial parameter of the multiplier, before it is mapped to positive numbers. Paper: 0 for
    SAC-Lag; not specified for WCSAC."""
    multiplier_lr: Annotated[float, Gain] = 3e-4
    """Step size of the multiplier's parameter with adam or sgd. Paper: 3e-4 for SAC-Lag; not
    specified for WCSAC."""
    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "adam"
    """How the multiplier follows the cost: its parameter ascends by Adam or by the plain gradient
    (sgd), or a PID controller sets it once an epoch (pid; Stooke et al. 2020). Not specified in the
    paper."""


class MultiplierForm(NamedTuple):
    """Map from an unconstrained parameter to a multiplier, which cannot be negative."""

    value: Callable[[Float], Float]
    """parameter -> multiplier"""
    slope: Callable[[Float], Float]
    """parameter -> derivative of the multiplier in the parameter"""
    lowest: float = -math.inf
    """Lower bound of the parameter."""
    law: Callable[[Any, Tensor, Tensor], Tensor] | None = None
    """(config, parameter [R, LANES], cost [R, 1]) -> the parameter after an update, of the same
    shape or [R, 1], in PyTorch: an algorithm's own law instead of a `multiplier_optimizer`. The
    parameter starts at the config's `initial_multiplier`, or at 0 if the config has none."""


def softplus(x: Float) -> Float:
    """`log(1 + eˣ)`, without overflow."""
    return np.maximum(x, 0.0) + np.log1p(np.exp(-np.abs(x)))


def sigmoid(x: Float) -> Float:
    """`1 / (1 + e⁻ˣ)`, without overflow."""
    return 0.5 + 0.5 * np.tanh(0.5 * x)


SOFTPLUS = MultiplierForm(softplus, sigmoid)
EXP = MultiplierForm(np.exp, np.exp)
PROJECTED = MultiplierForm(np.copy, np.ones_like, lowest=0.0)
"""The parameter is the multiplier."""


class Multiplier(NamedTuple):
    """A multiplier of an algorithm's rule: its form, the cost that it follows, and its bounds."""

    form: MultiplierForm
    signal: int = 0
    """Index of the cost that the multiplier follows."""
    limit: str = "cost_limit"
    """Name of the hyper-parameter that limits that cost."""
    highest: str = ""
    """Name of the hyper-parameter that bounds the multiplier, if one does."""
    ahead: bool = False
    """On-policy: follow an epoch's cost before, instead of after, the policy learns from the
    epoch."""
    discounted: bool = False
    """On-policy: follow the discounted cost of an episode."""


class MultiplierState(NamedTuple):
    """State of a multiplier that ascends a gradient. The lanes of a row are equal: see `nets`."""

    parameter: NDArray
    """[R, LANES]"""
    moments: Moments


class PIDState(NamedTuple):
    """State of a multiplier that a PID controller sets. The lanes of a row are equal."""

    value: NDArray
    """[R, LANES]: the multiplier itself, at least 0"""
    integral: NDArray
    """[R, LANES]: the integral term, which includes its gain, at least 0"""
    smoothed_cost: NDArray
    """[R, LANES]: exponential average of the costs seen, starting at 0"""


State = MultiplierState | PIDState


def initial(multipliers: Sequence[Multiplier], config: Any, runs: int) -> tuple[State, ...]:
    """Return the states of a rule's multipliers before the first update.

    A PID controller starts with the initial multiplier as its integral term. Raises TypeError if a
    form has a law and the config also an optimiser, and ValueError for a law that returns a wrong
    shape.
    """
    return tuple(_initial(multiplier.form, config, runs) for multiplier in multipliers)


def _initial(form: MultiplierForm, config: Any, runs: int) -> State:
    start = getattr(config, "initial_multiplier", 0.0) if form.law else config.initial_multiplier
    parameter = np.full((runs, LANES), start, np.float32)
    if form.law and hasattr(config, "multiplier_optimizer"):
        raise TypeError(f"the multiplier has a law: {config!r} must not have an optimizer")
    if form.law:
        after = tuple(form.law(config, *map(tensor, (parameter, parameter[:, :1] * 0))).shape)
        if after not in (parameter.shape, (runs, 1)):
            raise ValueError(f"a law must return [{runs}, {LANES}] or [{runs}, 1], got {[*after]}")
    if form.law or config.multiplier_optimizer != "pid":
        return MultiplierState(parameter, no_moments(parameter))
    value = form.value(parameter)
    return PIDState(value, value.copy(), np.zeros_like(value))


def values(multipliers: Sequence[Multiplier], states: Sequence[State], runs: int) -> Float:
    """Return the M multipliers of each run, [R, M]."""
    columns = [
        state.value[:, :1] if isinstance(state, PIDState) else of.form.value(state.parameter[:, :1])
        for of, state in zip(multipliers, states, strict=True)
    ]
    return np.concatenate(columns or [np.zeros((runs, 0), np.float32)], axis=-1)


def with_streaks(rule: Any, config: Any) -> Any:
    """Return the rule with the record cost as its last cost, if the config has a `streak_limit`.

    If the rule has multipliers, a copy of the last one follows that cost. Without a `streak_limit`
    the rule is returned as it is. Raises UserError for a rule whose multiplier has a law of its
    own.
    """
    if getattr(config, "streak_limit", None) is None:
        return rule
    more = rule._replace(costs=rule.costs + 1)
    if not rule.multipliers:
        return more._replace(limits=(*rule.limits, "streak_limit"))
    like = rule.multipliers[-1]
    if like.form.law:
        raise UserError("streak_limit needs an algorithm whose multiplier has an optimizer")
    added = like._replace(signal=rule.costs, limit="streak_limit", discounted=False)
    return more._replace(multipliers=(*rule.multipliers, added))


def limit_names(rule: Any, config: Any) -> dict[int, str]:
    """Return the name of the hyper-parameter that limits each cost, by the index of the cost, from
    a rule's `limits` and multipliers; a cost without a limit has no entry."""
    names = dict(enumerate(rule.limits)) | {own.signal: own.limit for own in rule.multipliers}
    return {k: name for k, name in sorted(names.items()) if hasattr(config, name)}


def limits(rule: Any, config: Any) -> Float:
    """Return the limit of each cost, [C]; NaN for a cost without a limit."""
    names = limit_names(rule, config)
    chosen = [getattr(config, names[k]) if k in names else math.nan for k in range(rule.costs)]
    return np.array(chosen)


def names(multipliers: Sequence[Multiplier]) -> tuple[str, ...]:
    """Return the names of the multipliers in records: multiplier, multiplier_2, ..."""
    return numbered("multiplier", len(multipliers))


def numbered(name: str, count: int) -> tuple[str, ...]:
    """Return the names of several columns: risk, risk_2, ..."""
    return tuple(name + f"_{k}" * (k > 1) for k in range(1, count + 1))


def follow(
    multipliers: Sequence[Multiplier],
    config: Any,
    states: Sequence[State],
    cost: Float,
    discounted: Float | None = None,
    ahead: bool | None = None,
) -> tuple[State, ...]:
    """Return the states after an update by each form's law or the config's optimiser.

    cost, discounted: [R, C]; each multiplier compares the column of its `signal` with its limit.
    ahead: update only multipliers with this value of `ahead`; all by default.
    """
    followed = []
    for one, state in zip(multipliers, states, strict=True):
        costs = discounted if one.discounted and discounted is not None else cost
        waits = ahead is not None and one.ahead != ahead
        followed.append(state if waits else _follow(one, config, state, costs[:, [one.signal]]))
    return tuple(followed)


def _follow(multiplier: Multiplier, config: Any, state: State, cost: Float) -> State:
    """cost: [R, 1]."""
    form, excess = multiplier.form, cost - getattr(config, multiplier.limit)
    if isinstance(state, PIDState):
        return control(config, state, cost, excess)
    if not form.law:
        after = ascend(form, config, state, excess)
        if multiplier.highest:
            highest = getattr(config, multiplier.highest)
            after = after._replace(parameter=np.minimum(after.parameter, highest))
        return after
    own = form.law(config, tensor(state.parameter), tensor(cost)).numpy()
    parameter = np.empty_like(state.parameter)
    parameter[...] = np.maximum(own, form.lowest)
    return state._replace(parameter=parameter)


def ascend(
    form: MultiplierForm, config: Any, state: MultiplierState, excess: Float
) -> MultiplierState:
    """Step up the gradient of `λ (cost - d)`: λ rises exactly where the excess [R, 1] is above
    0."""
    parameter, moments = state
    gradient = -form.slope(parameter) * excess.astype(parameter.dtype)
    if config.multiplier_optimizer == "adam":
        parameter, moments = adam(parameter, gradient, moments, config.multiplier_lr)
    else:
        parameter = parameter - config.multiplier_lr * gradient
    return MultiplierState(np.maximum(parameter, form.lowest), moments)


def control(config: Any, state: PIDState, cost: Float, excess: Float) -> PIDState:
    """Take a step of the PID controller, `Δ = cost - d`, `(x)₊ = max(x, 0)`; cost, excess: [R, 1].

    `I ← (I + k_I Δ)₊`, `c ← .95 c + .05 cost`, `λ = (k_P Δ + I + k_D (c - c_before)₊)₊`.
    Source: Stooke et al. 2020, "Responsive safety in reinforcement learning by PID Lagrangian
    methods", algorithm 2, with the derivative of the smoothed cost as in its code.
    """
    excess = excess.astype(state.value.dtype)
    integral = np.maximum(state.integral + config.pid_ki * excess, 0.0)
    new_share = (1.0 - PID_SMOOTHING) * cost.astype(state.value.dtype)
    smoothed = PID_SMOOTHING * state.smoothed_cost + new_share
    growth = np.maximum(smoothed - state.smoothed_cost, 0.0)
    value = config.pid_kp * excess + integral + config.pid_kd * growth
    return PIDState(np.maximum(value, 0.0), integral, smoothed)
