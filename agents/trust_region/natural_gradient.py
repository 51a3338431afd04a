"""Natural gradient steps with a run axis: Fisher-vector products, conjugate gradients, line search.

Source: Schulman et al. 2015, "Trust region policy optimization", appendix C.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

Product = Callable[[Tensor], Tensor]


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Inner product of each run's vectors [R, P] -> [R, 1]."""
    return (a * b).sum(dim=-1, keepdim=True)


def conjugate_gradient(product: Product, b: Tensor, iterations: int) -> Tensor:
    """Approximate solution x of `H x = b`; product: v -> H v, symmetric positive definite.

    b: [R, P] -> [R, P]. A run whose residual has vanished stays where it is.
    """
    x, residual, direction = torch.zeros_like(b), b, b
    square = dot(residual, residual)
    for _ in range(iterations):
        image = product(direction)
        going = square > 1e-10 * dot(b, b)
        curvature = torch.where(going, dot(direction, image), 1.0)
        step = torch.where(going, square / curvature, 0.0)
        x, residual = x + step * direction, residual - step * image
        before, square = square, dot(residual, residual)
        direction = residual + torch.where(going, square / before, 0.0) * direction
    return x


class Problem(NamedTuple):
    """The local model that a step of the policy is computed from; each run's own."""

    gradient: Tensor
    """[R, P]: of the objective"""
    cost_gradient: Callable[[], Tensor]
    """() -> [R, P]: of the undiscounted cost of an episode"""
    excess: Tensor
    """[R]: cost of an episode above its limit, `J_C - d`"""
    product: Product
    """v -> H v, H the damped Hessian of the mean KL divergence"""
    solve: Product
    """b -> H⁻¹ b"""
    target_kl: float
    """δ"""
    multipliers: Tensor = torch.zeros(0)
    """[R, M]"""

    def to_boundary(self, direction: Tensor) -> Tensor:
        """The direction [R, P] scaled until `½ xᵀ H x = δ`; 0 stays 0."""
        square = dot(direction, self.product(direction))
        return direction * torch.where(square > 0, (2.0 * self.target_kl / square).sqrt(), 0.0)


Divergence = Callable[[Tensor, Tensor], Tensor]
"""(mean KL divergence [R], growth of the predicted cost of an episode [R]) -> [R]"""


class Step(NamedTuple):
    """A step to be tried, and the conditions of its line search."""

    displacement: Tensor
    """[R, P]"""
    must_improve: Tensor
    """[R], bool: whether the objective has to grow"""
    cost_bound: Tensor
    """[R]: how much the predicted cost of an episode may grow; inf where it does not matter"""
    case: Tensor
    """[R]: which case of the algorithm the step is, for the records"""
    divergence: Divergence = lambda kl, cost_growth: kl
    """Divergence that the line search keeps at or below δ."""


class Accepted(NamedTuple):
    """The result of a line search."""

    params: Tensor
    """[R, P]"""
    accepted: Tensor
    """[R], bool; the others keep their parameters"""
    kl: Tensor
    """[R]: of the parameters kept"""
    scale: Tensor
    """[R]: share of the step that was taken"""


Judge = Callable[[Tensor], tuple[Tensor, Tensor]]
"""params [R, P] -> which runs may go there [R], bool, and their KL divergence [R]"""


def line_search(
    params: Tensor, displacement: Tensor, judge: Judge, tries: int, decay: float
) -> Accepted:
    """The first of `params + decay^k displacement`, k < tries, that each run's judge accepts.

    params, displacement: [R, P]. Where none is accepted the parameters stay as they are, bit for
    bit.
    """
    runs = len(params)
    found = Accepted(
        params, torch.zeros(runs, dtype=torch.bool), torch.zeros(runs), torch.zeros(runs)
    )
    for k in range(tries):
        candidate = params + decay**k * displacement
        allowed, kl = judge(candidate)
        new = allowed & ~found.accepted & candidate.isfinite().all(dim=-1)
        found = Accepted(
            torch.where(new[:, None], candidate, found.params),
            found.accepted | new,
            torch.where(new, kl, found.kl),
            torch.where(new, decay**k, found.scale),
        )
        if found.accepted.all():
            break
    return found
