"""Surrogates, natural gradient steps and the line search, against PyTorch's distributions and
explicit matrices; the step of TRPO-Lag by hand."""

import math

import numpy as np
import pytest
import torch
from small_policy import NETS, SIZE, normal, policy
from torch.distributions import kl_divergence

from agents import trust_region as trpo
from agents.algorithms import trpo_lag
from agents.algorithms.cpo import CPOConfig
from agents.algorithms.trpo_lag import TRPOLagConfig
from agents.lockstep.normalizer import Inputs
from agents.on_policy import state as on_policy
from agents.on_policy.epoch import BLOCK, EpochData, compared, taken
from agents.on_policy.state import OnPolicyState
from agents.trust_region import Problem, Step, conjugate_gradient, line_search


def spd(eigenvalues, seed=0):
    """Return a random symmetric matrix for each row of eigenvalues, [R, P] -> [R, P, P]."""
    runs, size = eigenvalues.shape
    basis, _ = torch.linalg.qr(normal(runs, size, size, seed=seed))
    return basis * eigenvalues[:, None].double() @ basis.mT


def times(matrix):
    return lambda v: (matrix @ v[..., None])[..., 0]


def random_epoch(steps, size, seed=0):
    """Return a random epoch, in which the rows beyond a run's steps are not 0 but have weight 0."""
    runs = len(steps)
    weight = (torch.arange(size) < steps[:, None]) / steps[:, None].double()
    columns = normal(runs, size, 6, seed=seed)
    return EpochData(
        observation=columns[..., :2],
        action=columns[..., 2:4],
        weight=weight,
        reward_advantage=columns[..., 4],
        cost_advantage=columns[..., 5][:, None],
        value_targets=torch.zeros(runs, 2, size),
        length=torch.full((runs,), 50.0, dtype=torch.float64),
        cost=torch.zeros(runs, 1, dtype=torch.float64),
    )


def random_actor(runs, seed=0):
    return 0.5 * normal(runs, NETS.actor.size, seed=seed)


def test_conjugate_gradient_against_direct_solution():
    """Matrices with condition numbers from 1 to 10,000 in one batch; one right-hand side is 0."""
    conditions = torch.tensor([1.0, 10.0, 100.0, 1e4, 10.0])
    matrix = spd(conditions[:, None] ** torch.linspace(0, 1, 12))
    b = normal(5, 12, seed=1) * torch.tensor([[1.0], [1e-6], [1e3], [1.0], [0.0]])
    found = conjugate_gradient(times(matrix), b, 40)
    expected = torch.linalg.solve(matrix, b)
    # It stops at a residual of 1e-5 |b|, so that the error is at most 1e-5 times the condition.
    error = (found - expected).norm(dim=-1) / expected.norm(dim=-1)
    assert (error[:4] <= 1e-5 * conditions[:4]).all()
    assert (found[4] == 0).all()


def test_conjugate_gradient_takes_one_iteration_for_each_distinct_eigenvalue():
    matrix = spd(torch.tensor([[1.0] * 4 + [5.0] * 4 + [9.0] * 4]))
    b = normal(1, 12)
    expected = torch.linalg.solve(matrix, b)
    torch.testing.assert_close(conjugate_gradient(times(matrix), b, 3), expected)
    assert (conjugate_gradient(times(matrix), b, 2) - expected).norm() > 1e-2 * expected.norm()


@pytest.mark.parametrize(("steps", "size"), [((100, 30), BLOCK), ((700, 40), 2 * BLOCK)])
def test_fisher_product_against_the_hessian_of_kl(steps, size):
    """Every entry, for two runs of different lengths, within one block and beyond it."""
    actor, epoch = random_actor(2), random_epoch(torch.tensor(steps), size)
    product, solve = trpo.curvature(NETS, TRPOLagConfig(cg_damping=0.3), actor, epoch)
    columns = [product(unit.expand(2, -1)) for unit in torch.eye(SIZE, dtype=torch.float64)]
    found = torch.stack(columns, dim=-1)
    for run, n in enumerate(steps):
        observation = epoch.observation[run, :n]
        old = policy(actor[run], observation)

        def mean_kl(params, old=old, observation=observation):
            return kl_divergence(old, policy(params, observation)).mean()

        expected = torch.autograd.functional.hessian(mean_kl, actor[run]) + 0.3 * torch.eye(SIZE)
        torch.testing.assert_close(found[run], expected)
    b = normal(2, SIZE)
    torch.testing.assert_close(solve(b), conjugate_gradient(times(found), b, 15))


def test_a_step_that_is_not_finite_is_not_taken():
    """Even where the judge accepts it."""
    step, anything = torch.ones(2, 32), (torch.ones(2).bool(), torch.zeros(2))
    step[1, 5] = torch.nan
    found = line_search(torch.zeros(2, 32), step, lambda candidate: anything, 3, 0.5)
    assert found.accepted.tolist() == [True, False]
    assert torch.equal(found.params, torch.tensor([[1.0], [0.0]]).expand(2, 32))


def test_a_rule_may_learn_no_cost():
    """Its step is that of a rule that learns a cost and ignores it."""
    actor, epoch = random_actor(2), random_epoch(torch.full((2,), 60), BLOCK)
    anything = torch.zeros(2).bool(), torch.full((2,), torch.inf), torch.zeros(2)
    chosen = Step(0.001 * normal(2, NETS.actor.size, seed=1), *anything)
    found = []
    for costs in (1, 0):
        seen = []

        def step(config, problem, seen=seen):
            seen.append(problem)
            return chosen

        rule = trpo.StepRule(lambda config, reward, *_: reward, step, costs=costs)
        learned = {k: getattr(epoch, k)[:, :costs] for k in ("cost", "cost_advantage")}
        state, steps = OnPolicyState(actor, None, None, ()), np.full(2, 60)
        what = CPOConfig(), rule, state, epoch._replace(**learned), steps
        params, records = trpo.policy_step(NETS, *what)
        found.append((params, records["kl"], records["step_scale"], seen[0].gradient))
    assert seen[0].excess.tolist() == [0.0, 0.0]
    torch.testing.assert_close(found[0], found[1], rtol=0, atol=0)
    assert (found[0][2] > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_no_step_beyond_the_trust_region_gets_through(seed):
    """Random steps of all sizes for random policies, judged again with torch.distributions.

    The last run but one has NaN in its step, after which its parameters are NaN; the last has NaN
    in its costs, and takes no step.
    """
    runs, config = 24, CPOConfig(target_kl=0.01, line_search_steps=8, line_search_decay=0.5)
    actor, epoch = random_actor(runs, seed), random_epoch(torch.full((runs,), 60), BLOCK, seed)
    size = 10 ** torch.linspace(-3, 1, runs, dtype=torch.float64)[:, None]
    chosen = Step(
        displacement=size * normal(runs, NETS.actor.size, seed=seed + 100),
        must_improve=torch.arange(runs) % 2 == 0,
        cost_bound=torch.tensor([0.0, 0.05, torch.inf, 0.0]).repeat(runs // 4),
        case=torch.zeros(runs),
    )
    chosen.displacement[-2, 3] = epoch.cost_advantage[-1, 0, 5] = torch.nan
    rule = trpo.StepRule(lambda config, reward, *_: reward, lambda *_: chosen)
    state = OnPolicyState(actor, None, None, ())
    steps = np.full(runs, 60)
    params, records = trpo.policy_step(NETS, config, rule, state, epoch, steps)

    def judged(run, candidate):
        old, new = (policy(p, epoch.observation[run, :60]) for p in (actor[run], candidate))
        action = epoch.action[run, :60]
        ratio = (new.log_prob(action) - old.log_prob(action)).exp() - 1
        gains = (epoch.reward_advantage, epoch.cost_advantage[:, 0])
        growth, costs = ((ratio * gain[run, :60]).mean() for gain in gains)
        kl = kl_divergence(old, new).mean()
        better = growth > 0 or not chosen.must_improve[run]
        return bool(kl <= 0.01 and better and 50 * costs <= chosen.cost_bound[run]), kl

    for run in range(runs):
        tries = [actor[run] + 0.5**k * chosen.displacement[run] for k in range(8)]
        finite = [candidate for candidate in tries if candidate.isfinite().all()]
        passing = [candidate for candidate in finite if judged(run, candidate)[0]]
        if run == runs - 2:
            assert params[run].isnan().all()
        elif not passing:
            assert torch.equal(params[run], actor[run])
            assert records["step_scale"][run] == records["kl"][run] == 0
        else:
            torch.testing.assert_close(params[run], passing[0])
            assert judged(run, params[run])[1] <= 0.01
            torch.testing.assert_close(records["kl"][run].double(), judged(run, passing[0])[1])
            scale = [0.5**k for k in range(8) if tries[k] is passing[0]]
            assert records["step_scale"][run] == scale[0]
    taken = records["step_scale"] > 0
    assert 2 < taken.sum() < runs - 2
    assert not taken[-2:].any()


OBSERVATION, ACTION = 2, 2
SMALL = {"hidden": (32,), "episodes": 2, "critic_iterations": 2}
ACTOR = NETS.actor
LAG = trpo_lag.RULE.multipliers


def test_the_policys_distribution_and_actions_against_torch():
    params, others = random_actor(3), random_actor(3, seed=5)
    observation, action = normal(3, 7, OBSERVATION, seed=1), normal(3, 7, ACTION, seed=2)
    found = ACTOR.distribution(params, observation)
    log_prob, kl = found.log_prob(action), found.kl(ACTOR.distribution(others, observation))
    act = ACTOR.acting(params.numpy(), Inputs(np.ones((), np.float32)))
    acted, deterministic = act(observation.numpy(), action.numpy()), act(observation.numpy(), None)
    for run in range(3):
        theirs = policy(params[run], observation[run])
        other = policy(others[run], observation[run])
        torch.testing.assert_close(log_prob[run], theirs.log_prob(action[run]))
        torch.testing.assert_close(kl[run], kl_divergence(theirs, other))
        by_hand = theirs.mean + theirs.stddev * action[run]
        torch.testing.assert_close(torch.from_numpy(acted[run]), by_hand)
        torch.testing.assert_close(torch.from_numpy(deterministic[run]), theirs.mean)


def test_the_initial_state_has_its_standard_deviation_and_depends_on_the_seed():
    config = TRPOLagConfig(initial_log_std=-0.5, **SMALL)
    state = on_policy.initial_state(NETS, config, LAG, 1, [3, 4])
    policy = ACTOR.distribution(state.actor, torch.zeros(2, 1, OBSERVATION))
    torch.testing.assert_close(policy.std, torch.full((2, 1, ACTION), math.exp(-0.5)))
    assert (state.actor[:, ACTOR.net.size + ACTION :] == 0).all()
    assert (state.actor[0] != state.actor[1]).any()
    again = on_policy.initial_state(NETS, config, LAG, 1, [4])
    assert torch.equal(again.actor[0], state.actor[1])
    assert torch.equal(again.critics[0], state.critics[1])
    assert (state.critics[:, 0] != state.critics[:, 1]).any()


@pytest.mark.parametrize(("steps", "size"), [((90, 400), BLOCK), ((1000, 20), 2 * BLOCK)])
def test_compared_and_its_gradient_against_separate_runs(steps, size):
    """E[ratio · A] for both advantages, and the KL from the old to the new policy."""
    old, new = random_actor(2), random_actor(2, seed=3)
    epoch = random_epoch(torch.tensor(steps), size)
    steps_taken = taken(NETS, old, epoch, epoch.reward_advantage)
    found, kl = compared(NETS, new, steps_taken)
    for of, advantage in enumerate((epoch.reward_advantage, epoch.cost_advantage[:, 0])):
        at = new.clone().requires_grad_()
        (moved,) = torch.autograd.grad(compared(NETS, at, steps_taken)[0][:, of].sum(), at)
        for run, n in enumerate(steps):
            vector = new[run].clone().requires_grad_()
            observation, action = epoch.observation[run, :n], epoch.action[run, :n]
            theirs, ours = policy(old[run], observation), policy(vector, observation)
            ratio = (ours.log_prob(action) - theirs.log_prob(action)).exp()
            surrogate = (ratio * advantage[run, :n]).mean()
            surrogate.backward()
            torch.testing.assert_close(found[run, of].double(), surrogate.detach())
            divergence = kl_divergence(theirs, ours).mean().detach()
            torch.testing.assert_close(kl[run].double(), divergence)
            torch.testing.assert_close(moved[run], vector.grad)


def test_step_of_trpo_by_hand():
    """H = diag(4, 1), g = (8, 1): x = H⁻¹g = (2, 1) has ½ xᵀHx = 8.5, a hundred times δ = 0.085.

    The step has to improve the surrogate, and its cost is not bounded."""
    diagonal = torch.tensor([4.0, 1.0])
    problem = Problem(
        gradient=torch.tensor([[8.0, 1.0], [0.0, 0.0]]),
        cost_gradient=lambda: pytest.fail("of no use here"),
        excess=torch.tensor([5.0, -5.0]),
        product=lambda v: diagonal * v,
        solve=lambda b: b / diagonal,
        target_kl=0.085,
    )
    found = trpo_lag.step(TRPOLagConfig(), problem)
    torch.testing.assert_close(found.displacement, torch.tensor([[0.2, 0.1], [0.0, 0.0]]))
    assert found.must_improve.all()
    assert (found.cost_bound == torch.inf).all()


def test_rows_of_weight_zero_do_not_change_a_sharp_policy():
    """At σ = e⁻⁷ the density ratio of an action far from the mean may exceed e^100."""
    actor = torch.zeros(1, ACTOR.size)
    mean = sum(a * b + b for a, b in ((OBSERVATION, 32),)) + 32 * ACTION
    actor[:, mean : mean + ACTION] = 1.0
    actor[:, ACTOR.net.size : ACTOR.net.size + ACTION] = -7.0
    nearer = actor.clone()
    nearer[:, mean : mean + ACTION] = 1.0 - 2e-4
    found = []
    for size in (BLOCK, 2 * BLOCK):
        zeros = torch.zeros(1, size)
        there = (torch.arange(size) < 500).float()[None]
        epoch = EpochData(
            observation=torch.zeros(1, size, OBSERVATION),
            action=there[..., None].expand(1, size, ACTION).contiguous(),
            weight=there / 500,
            reward_advantage=there,
            cost_advantage=zeros[None],
            value_targets=torch.zeros(1, 2, size),
            length=torch.ones(1),
            cost=torch.zeros(1, 1),
        )
        steps = taken(NETS, actor, epoch, epoch.reward_advantage)
        at_padding = NETS.actor.distribution(nearer, epoch.observation).log_prob(epoch.action)
        assert (at_padding - steps.old_log_prob[:, -1])[0, -1] > 100
        found.append(compared(NETS, nearer, steps))
    for short, long in zip(*found, strict=True):
        assert short.isfinite().all()
        assert torch.equal(short, long)
