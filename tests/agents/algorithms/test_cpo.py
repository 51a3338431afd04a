"""CPO's step against geometry and a general solver, in each of its cases; `tests/benchmarks`
compares whole updates with a plain loop.

In coordinates where H is the identity, the trust region is a ball of radius √(2δ) and `c + b·x = 0`
a plane. The centre lies `share = c / √(2δ s)` radii beyond the plane. The plain step goes along g
to the ball's boundary; it ends beyond the plane where `share + cos(angle of g and b) > 0`.
"""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from small_policy import normal

from agents.algorithms import cpo
from agents.algorithms.cpo import INSIDE, PARTLY, RECOVERABLE, RECOVERY, CPOConfig
from agents.trust_region import Problem

DELTA, SIZE = 0.01, 8
RADIUS = math.sqrt(2 * DELTA)

# share, cosine, the case, whether the step ends on the plane
CASES = [
    (-1.5, 0.7, INSIDE, False),
    (-0.5, 0.7, PARTLY, True),
    (-0.5, -0.7, PARTLY, False),
    (-0.9, 0.7, PARTLY, False),
    (0.0, 0.7, PARTLY, True),
    (0.0, -0.7, PARTLY, False),
    (0.5, -0.7, RECOVERABLE, False),
    (0.5, 0.7, RECOVERABLE, True),
    (0.9, -0.7, RECOVERABLE, True),
    (1.5, 0.7, RECOVERY, False),
    (1.5, -0.7, RECOVERY, False),
]


def one_run(share, cosine, seed):
    """Return g, b, c and the root L of H = L Lᵀ of a random run with that geometry."""
    matrix = normal(SIZE, SIZE, seed=seed)
    root = torch.linalg.cholesky(matrix @ matrix.T / SIZE + 0.1 * torch.eye(SIZE))
    along, across = torch.linalg.qr(normal(SIZE, 2, seed=seed + 1000))[0].T
    g = 3.0 * (cosine * along + math.sqrt(1 - cosine**2) * across)
    b = 10 ** normal(1, seed=seed + 2000) * along
    return root @ g, root @ b, share * RADIUS * b.norm(), root


def problem_of(runs):
    """Return the problem of some runs (g, b, c, L), whose linear systems are solved exactly."""
    gradient, b, excess, root = (torch.stack(column) for column in zip(*runs, strict=True))
    matrix = root @ root.mT
    return Problem(
        gradient=gradient,
        cost_gradient=lambda: b,
        excess=excess,
        product=lambda v: (matrix @ v[..., None])[..., 0],
        solve=lambda v: torch.linalg.solve(matrix, v),
        target_kl=DELTA,
    )


def expected_step(g, b, c, root):
    """Return one run's step by geometry: down the cost, where the plane is out of reach; else the
    ball's furthest point along g; where that lies beyond the plane, the furthest point along g of
    the ball's boundary within the plane."""
    g, b = torch.linalg.solve(root, g), torch.linalg.solve(root, b)
    x = RADIUS * g / g.norm()
    if c > RADIUS * b.norm() > 0:
        x = -RADIUS * b / b.norm()
    elif c + b @ x > 0 and b.norm() > 0:
        foot, across = -c * b / (b @ b), g - (g @ b) / (b @ b) * b
        x = foot + (RADIUS**2 - foot @ foot).sqrt() * across / across.norm()
    return torch.linalg.solve(root.T, x)


def solver_step(g, b, c, root):
    """Return one run's step by sequential quadratic programming, where there is a solution."""
    g, b = (torch.linalg.solve(root, v).numpy() for v in (g, b))
    share = c.item() / RADIUS / np.linalg.norm(b)
    g, b = g / np.linalg.norm(g), b / np.linalg.norm(b)
    plane = {"type": "ineq", "fun": lambda x: -(share + b @ x), "jac": lambda x: -b}
    ball = {"type": "ineq", "fun": lambda x: 1.0 - x @ x, "jac": lambda x: -2.0 * x}
    found = minimize(
        lambda x: -g @ x,
        -share * b,
        jac=lambda x: -g,
        constraints=[plane, ball],
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 500},
    )
    return torch.linalg.solve(root.T, RADIUS * torch.from_numpy(found.x))


def close(found, expected):
    """Return whether two vectors are equal up to the precision of a step in float32."""
    return (found - expected).norm() <= 1e-4 * expected.norm()


def test_every_case_in_one_batch():
    runs = [one_run(share, cosine, seed) for seed, (share, cosine, *_) in enumerate(CASES)]
    found = cpo.step(CPOConfig(), problem_of(runs))
    assert found.case.tolist() == [case for _, _, case, _ in CASES]
    for (*_, case, held), (g, b, c, root), x in zip(CASES, runs, found.displacement, strict=True):
        assert close(x, expected_step(g, b, c, root))
        if case != RECOVERY:
            assert close(x, solver_step(g, b, c, root))
            assert (abs(c + b @ x) < 1e-4 * RADIUS * b.norm()) == held
    for run, (_, _, c, _) in enumerate(runs):
        alone = cpo.step(CPOConfig(), problem_of([runs[run]]))
        torch.testing.assert_close(alone.displacement[0], found.displacement[run])
        # Where the constraint is satisfied, costs may grow up to the limit if the objective grows.
        assert found.must_improve[run] == (c <= 0)
        assert found.cost_bound[run] == max(0.0, -c)


@pytest.mark.parametrize("size", [0.0, 1e-6])
def test_where_costs_do_not_depend_on_the_policy(size):
    """It is the plain step, whatever the cost."""
    runs = [one_run(0.0, 0.5, seed) for seed in range(3)]
    costs = torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)
    runs = [(g, size * b / b.norm(), c, r) for (g, b, _, r), c in zip(runs, costs, strict=True)]
    found = cpo.step(CPOConfig(), problem_of(runs))
    assert found.case.tolist() == [INSIDE] * 3
    assert found.cost_bound.tolist() == [1.0, 0.0, 0.0]
    assert found.must_improve[:2].all()
    for (g, _, _, root), x in zip(runs, found.displacement, strict=True):
        plain = expected_step(g, torch.zeros(SIZE, dtype=torch.float64), 0.0, root)
        assert close(x, plain)


@pytest.mark.parametrize("share", [-0.5, 0.5])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4])
def test_objective_and_cost_with_the_same_gradient(noise, share):
    """In float32, as in training, it is still the best step that is allowed."""
    runs = [one_run(share, math.sqrt(1 - noise**2), seed) for seed in range(20)]
    problem = problem_of([[value.float() for value in run] for run in runs])
    found = cpo.step(CPOConfig(), problem)
    for (g, b, c, root), x in zip(runs, found.displacement.double(), strict=True):
        reach = RADIUS * b.norm()
        assert 0.5 * (root.T @ x).square().sum() <= 1.01 * DELTA
        assert c + b @ x <= 0.01 * reach
        # g = 3 b / |b| up to the noise, and b·x = -c
        assert g @ x >= 3 * RADIUS * (-share - 0.01)


def test_without_a_gradient_of_the_objective():
    """The step is 0, or the shortest way back to the limit."""
    runs = [one_run(share, 0.5, seed) for seed, share in enumerate((-1.5, -0.5, 0.5, 1.5))]
    runs = [(0 * g, b, c, root) for g, b, c, root in runs]
    x = cpo.step(CPOConfig(), problem_of(runs)).displacement
    assert (x[:2] == 0).all()
    for run, back in ((2, 0.5), (3, 1.0)):
        _, b, _, root = runs[run]
        u = torch.linalg.solve(root, b)
        expected = torch.linalg.solve(root.T, -back * RADIUS * u / u.norm())
        assert close(x[run], expected)
