"""CPO as in a later library of the paper's group, where it differs from the CPO paper.

Source: 2BH/saferl-lib, commit 6163e2e, `saferl/algorithms/cpo/cpo.py`. Not adopted: the library
takes the mean cost over the last 50 episodes. Results: results/library.
"""

from dataclasses import dataclass

import torch

import agents
from agents.algorithms.ppo import advantage
from agents.trust_region import Step, StepRule, TRPOConfig, TrustRegion, dot

EPS = 1e-8
RECOVERY, BROKEN, KEPT, INSIDE = 0, 1, 2, 3
"""Cases of the policy step."""


@dataclass(frozen=True)
class LibraryCPOConfig(TRPOConfig):
    """Hyper-parameters of the library's CPO."""

    residual: float = 0.1
    """Squared norm of the residual below which conjugate gradients stop; the library passes its
    damping here."""


def solve(config, problem, b):
    """Solve H x = b, both [R, P], by conjugate gradients from a point close to 0; for a short b
    this point is also the result."""
    x = 1.4e-4 * torch.sin(1e6 * b)  # the library draws noise of deviation 1e-4; this imitates it
    rest = b - problem.product(x)
    direction, square = rest, dot(rest, rest)
    for _ in range(config.cg_iterations):
        going = square >= config.residual
        image = problem.product(direction)
        length = torch.where(going, square / dot(direction, image), 0.0)
        x, rest = x + length * direction, rest - length * image
        before, square = square, torch.where(going, dot(rest, rest), square)
        direction = torch.where(going, rest + square / before * direction, direction)
    return x


def multipliers(q, r, s, c, delta):
    """Return λ and ν, [R, 1], of the dual's better branch. As in the library, ν uses `λc - r`,
    where ascent needs `λc + r`."""
    gain, room, border = q - r**2 / (s + EPS), 2.0 * delta - c**2 / s, r / (c + EPS)

    def below(x):
        return torch.minimum(border, x).clamp(min=0.0)

    def above(x):
        return torch.maximum(border, x)

    cut, free = (gain / room).sqrt(), (q / (2.0 * delta)).sqrt()
    cut = torch.where(c + EPS < 0, below(cut), above(cut))
    free = torch.where(c + EPS < 0, above(free), below(free))
    of_cut = -0.5 * (gain / (cut + EPS) + cut * room) - r * (c + EPS) / (s + EPS)
    of_free = -0.5 * (q / (free + EPS) + free * 2.0 * delta)
    chosen = torch.where(of_cut > of_free, cut, free)
    return chosen, ((chosen * (c + EPS) - r) / (s + EPS)).clamp(min=0.0)


def step(config, problem):
    """Compute the library's step, from gradients rounded to six decimals."""
    gradient, b = (v.round(decimals=6) for v in (problem.gradient, problem.cost_gradient()))
    norm, c, delta = dot(b, b).sqrt(), problem.excess[:, None], config.target_kl
    natural = solve(config, problem, gradient)
    natural_b = norm * solve(config, problem, b / (norm + EPS))
    image = problem.product(natural)
    q, r = dot(image, natural), dot(image, natural_b)
    s = dot(problem.product(natural_b), natural_b)
    reached = c**2 / s <= 2.0 * delta
    case = torch.where(reached, torch.where(c < 0, KEPT, BROKEN), INSIDE)
    case = torch.where(~reached & (c >= 0), RECOVERY, case)
    case = torch.where((norm**2 < EPS) & (c < 0), INSIDE, case)
    weight, nu = multipliers(q, r, s, c, delta)
    cut = (case == KEPT) | (case == BROKEN)
    weight = torch.where(cut, weight, (q / (2.0 * delta)).sqrt())
    ahead = (natural - torch.where(cut, nu, 0.0) * natural_b) / (weight + EPS)
    back = -(2.0 * delta / (s + EPS)).sqrt() * natural_b
    return Step(
        displacement=torch.where(case == RECOVERY, back, ahead),
        must_improve=case[:, 0] >= KEPT,
        cost_bound=(-problem.excess).clamp(min=0.0),
        case=case[:, 0],
    )


class LibraryCPO(TrustRegion):
    """The trust-region family, with standardised cost advantages."""

    def improve(self, epoch, steps, generators):
        """Update the policy with standardised cost advantages."""
        costs = epoch.cost_advantage
        spread = (epoch.weight[:, None] * costs**2).sum(dim=-1, keepdim=True).sqrt()
        epoch = epoch._replace(cost_advantage=costs / (spread + EPS))
        return super().improve(epoch, steps, generators)


rule = StepRule(advantage, step, has_cases=True)
agents.register("cpo-library", agents.Algorithm("CPO-library", LibraryCPOConfig, rule, LibraryCPO))
