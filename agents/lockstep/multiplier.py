"""Lagrange multipliers: how a parameter stands for one, and how it follows the excess cost.

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


@dataclass(frozen=True)
class MultiplierConfig:
    """Hyper-parameters of a multiplier, for the configs of algorithms that have one."""

    initial_multiplier: float = 0.0
    """Initial parameter of the multiplier, before it is mapped to positive numbers. Paper: 0 for
    SAC-Lag; not printed for WCSAC."""
    multiplier_lr: float = 3e-4
    """Step size of the multiplier's parameter. Paper: 3e-4 for SAC-Lag; not printed for WCSAC."""
    multiplier_optimizer: Literal["adam", "sgd"] = "adam"
    """How the multiplier's parameter ascends: by Adam, or by the plain gradient. Not printed in the
    paper."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        check(self, "initial_multiplier")
        check(self, "multiplier_lr", low=0)
        check_choice(self, "multiplier_optimizer", "adam", "sgd")
        of_family = getattr(super(), "__post_init__", None)
        if of_family:
            of_family()


class Form(NamedTuple):
    """How a parameter stands for a multiplier, which cannot be negative."""

    value: Callable[[Tensor], Tensor]
    """parameter -> multiplier"""
    slope: Callable[[Tensor], Tensor]
    """parameter -> derivative of the multiplier"""
    lowest: float = -math.inf
    """What the parameter is kept above."""


SOFTPLUS = Form(softplus, torch.sigmoid)
EXP = Form(torch.exp, torch.exp)
PROJECTED = Form(torch.clone, torch.ones_like, lowest=0.0)
"""The parameter is the multiplier."""


class Multiplier(NamedTuple):
    """The multipliers of all runs. Every lane of a row is the same: see `nets`."""

    parameter: Tensor
    """[R, LANES]"""
    moments: Moments


def initial(form: Form | None, config: Any, runs: int) -> Multiplier | None:
    """Before the first update; None for an algorithm without a multiplier."""
    if form is None:
        return None
    parameter = torch.full((runs, LANES), float(config.initial_multiplier))
    return Multiplier(parameter, no_moments(parameter))


def value(form: Form | None, multiplier: Multiplier | None, runs: int) -> Tensor:
    """The multiplier of each run, [R, 1]; 0 for an algorithm without one."""
    if form is None or multiplier is None:
        return torch.zeros(runs, 1)
    return form.value(multiplier.parameter)[:, :1]


def ascend(
    form: Form | None, config: Any, multiplier: Multiplier | None, excess: Tensor
) -> Multiplier | None:
    """One step up `λ · excess`: λ rises exactly where the cost is above its limit.

    excess: [R, 1], cost less its limit.
    """
    if form is None or multiplier is None:
        return None
    parameter, moments = multiplier
    gradient = -form.slope(parameter) * excess
    if config.multiplier_optimizer == "adam":
        parameter, moments = adam(parameter, gradient, moments, config.multiplier_lr)
    else:
        parameter = parameter - config.multiplier_lr * gradient
    return Multiplier(parameter.clamp(min=form.lowest), moments)
