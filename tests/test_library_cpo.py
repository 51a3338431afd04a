"""The example of the paper group's CPO, by hand arithmetic, beside CPO itself."""

import pytest
import torch

from agents.algorithms import cpo
from agents.trust_region import Problem, conjugate_gradient


def problem(gradient, cost_gradient, excess):
    """With the identity as Hessian, and δ = 0.01."""
    gradient, b = torch.tensor([gradient]), torch.tensor([cost_gradient])
    solve = lambda v: conjugate_gradient(lambda x: x, v, 2)  # noqa: E731
    return Problem(gradient, lambda: b, torch.tensor([excess]), lambda v: v, solve, 0.01)


def test_where_the_limit_is_broken_it_goes_on_along_the_cost(library_cpo):
    """g = (.6, .8), b = (1, 0), c = .05: q = 1, r = .6, s = 1, so that the branches of the dual are
    worth -.162 (λ = 12) and -.141 (λ = √50). ν = .05 √50 - .6 < 0, so the step is g / √50 and the
    predicted cost grows, where CPO goes back to the limit."""
    found = problem([0.6, 0.8], [1.0, 0.0], 0.05)
    its = library_cpo.step(library_cpo.LibraryCPOConfig(), found)
    assert its.case.tolist() == [library_cpo.BROKEN]
    expected = [[0.6 / 50**0.5, 0.8 / 50**0.5]]
    torch.testing.assert_close(its.displacement, torch.tensor(expected), rtol=1e-4, atol=1e-4)
    ours = cpo.step(cpo.CPOConfig(), found).displacement
    assert ours[0, 0].item() == pytest.approx(-0.05, abs=1e-5)


def test_a_short_gradient_is_not_followed(library_cpo):
    """Its squared norm, .05, is below the residual at which its conjugate gradients stop."""
    config, nothing = library_cpo.LibraryCPOConfig(), problem([0.1, 0.2], [0.0, 0.0], -1.0)
    assert library_cpo.solve(config, nothing, torch.tensor([[0.1, 0.2]])).abs().max() < 2e-4
    longer = torch.tensor([[0.3, 0.2]])
    torch.testing.assert_close(library_cpo.solve(config, nothing, longer), longer)
