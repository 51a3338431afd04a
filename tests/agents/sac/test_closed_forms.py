"""Closed-form gradients of the SAC family's rules against PyTorch's autograd."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.algorithms import ALGORITHMS, algorithm
from agents.lockstep import tree
from agents.lockstep.pulled import has_closed_form, pulled
from agents.lockstep.rollout import critic_inputs
from agents.sac import OffPolicy
from agents.sac import update as sac
from agents.sac.replay import Batch

RUNS, ROWS = 3, 50
CONFIGS = {
    "sac": {},
    "sac-lag": {},
    "sac-lag, mean": {"cost_estimate": "mean"},
    "sac-pid": {},
    "sac-lb": {"cost_limit": 1.0},
    "sac-lb-streak": {"cost_limit": 0.2, "log_barrier_factor": 0.7},
    "wcsac": {},
    "wcsac, unsquared": {"variance_target": "unsquared", "risk_level": 0.9},
    "wcsac, through": {"damping_gradient": "through"},
    "wcsac, start": {"multiplier_of": "start"},
    "cal": {},
    "cal, 2": {"cost_critics": 2},
}


def of(name):
    """Return the rule and the config of a case of CONFIGS."""
    found = algorithm(name.partition(",")[0])
    return found.rule, found.config(**{"discount": 0.9, "batch_size": 64} | CONFIGS[name])


def test_all_algorithms_of_the_family_are_here():
    family = {name for name in ALGORITHMS if algorithm(name).family is OffPolicy}
    assert {name.partition(",")[0] for name in CONFIGS} == family


def batch(config, rng, rows, costs=1):
    """Return a batch of random transitions, in float64."""
    shape, seen = (RUNS, rows), (RUNS, rows, critic_inputs(config, 2, costs))
    reward, cost = rng.normal(size=shape), rng.random((RUNS, costs, rows))
    action = rng.uniform(-1, 1, (*shape, 2))
    ends = (rng.random((2, *shape)) < 0.3).astype(float)
    return Batch(rng.normal(size=seen), action, reward, cost, rng.normal(size=seen), *ends)


@pytest.mark.parametrize("name", CONFIGS)
def test_closed_forms_agree_with_autograd(name):
    """Values and gradients in float64, for critics that are equal, far apart and in between, with a
    random output gradient. A function that wraps a built-in one is differentiated by autograd."""
    rule, config = of(name)
    rng, shape = np.random.default_rng(0), (RUNS, config.cost_critics, ROWS)
    values, following = rng.normal(scale=3.0, size=(2, *shape))
    values[:, :, :5] = values[:, :1, :5]
    values[:, :, 5:9] *= 10.0
    drawn = batch(config, rng, ROWS)
    multipliers = rng.random((RUNS, len(rule.multipliers)))
    of_costs = rng.normal(scale=2.0, size=(RUNS, 1, ROWS))
    for function, *given in (
        (rule.risk, values),
        (rule.critic_loss, values, following, drawn._replace(cost=drawn.cost[:, 0])),
        (rule.penalty, of_costs, multipliers),
    ):
        wrapped = functools.wraps(function)(functools.partial(function))
        assert has_closed_form(function) and not has_closed_form(wrapped)
        (ours, pull), (theirs, their_pull) = (
            pulled(f, config, *given) for f in (function, wrapped)
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8)
        slope = rng.normal(size=ours.shape)
        expected = their_pull(slope)
        assert np.abs(expected).max() > 0 or name == "sac"
        np.testing.assert_allclose(pull(slope), expected, rtol=1e-7, atol=1e-8)


def trained(rule, config, nets, seed=1):
    """Return the state and the records after three updates."""
    rng, found = np.random.default_rng(seed), []
    state = sac.initial_state(nets, config, rule, range(RUNS))
    for _ in range(3):
        drawn = batch(config, rng, 64, rule.costs)
        numbers = [column.astype(np.float32) for column in drawn]
        noise = sac.UpdateNoise(*rng.normal(size=(2, RUNS, 64, 2)).astype(np.float32))
        state, records = sac.update(nets, config, rule, state, Batch(*numbers), noise)
        found.append(records)
    return state, found


@pytest.mark.parametrize("costs", [1, 2])
@pytest.mark.parametrize("name", CONFIGS)
def test_a_user_defined_rule_trains_to_the_same_numbers(name, costs):
    """The rule is the built-in one, but differentiated by PyTorch; for one cost and for two."""
    rule, config = of(name)
    rule = rule._replace(costs=costs)
    own = {k: getattr(rule, k) for k in ("risk", "critic_loss", "penalty")}
    own = {k: functools.wraps(function)(functools.partial(function)) for k, function in own.items()}
    nets = sac.make_nets(config, 2, 2, costs)
    (ours, our_records), (theirs, their_records) = (
        trained(r, config, nets) for r in (rule, rule._replace(**own))
    )
    for key, array in tree.flatten(ours).items():
        np.testing.assert_allclose(
            array, tree.flatten(theirs)[key], rtol=1e-3, atol=2e-5, err_msg=key
        )
    for our, their in zip(our_records, their_records, strict=True):
        assert our.keys() == their.keys()
        for key in our:
            np.testing.assert_allclose(our[key], their[key], rtol=1e-4, atol=1e-5, err_msg=key)


@pytest.mark.parametrize("scale", [0.1, 1.0, 8.0])
def test_gradients_of_sampled_actions(scale):
    """Against PyTorch's gradients of `tanh(μ + σ·noise)` and its log-probability, in float64."""
    rng = np.random.default_rng(0)
    outputs, noise = scale * rng.normal(size=(2, 30, 6)), rng.normal(size=(2, 30, 3))
    of_action, of_log_prob = rng.normal(size=(3, 2, 30)), rng.normal(size=(2, 1))
    leaf = torch.tensor(outputs, requires_grad=True)
    mean, log_std = leaf.chunk(2, dim=-1)
    log_std = log_std.clamp(*sac.LOG_STD)
    u = mean + log_std.exp() * torch.tensor(noise)
    normal = torch.distributions.Normal(mean, log_std.exp())
    slope = 2.0 * (np.log(2.0) - u - torch.nn.functional.softplus(-2.0 * u))
    log_prob = (normal.log_prob(u) - slope).sum(dim=-1)
    along = torch.tensor(of_action).movedim(0, -1) * u.tanh()
    loss = along.sum() + (torch.tensor(of_log_prob) * log_prob).sum()
    (expected,) = torch.autograd.grad(loss, leaf)
    found = sac.sampled(outputs, noise)
    np.testing.assert_allclose(found.log_prob, log_prob.detach(), rtol=1e-8, atol=1e-6)
    slopes = found.slope(of_action, of_log_prob)
    np.testing.assert_allclose(slopes, expected, rtol=1e-5, atol=1e-7)


def test_the_batch_of_a_rule_without_closed_forms_is_a_multiple_of_32():
    """PyTorch computes the rest behind the last full vector otherwise, so that a run's numbers
    would depend on the runs beside it."""
    rule, config = of("sac-lag")
    config = replace(config, batch_size=50)
    OffPolicy(config, rule, (0,), 2, 1)
    own = rule._replace(penalty=lambda config, risk, multipliers: multipliers[..., None] * risk)
    with pytest.raises(ValueError, match="batch_size must be a multiple of 32, got 50"):
        OffPolicy(config, own, (0,), 2, 1)


@pytest.mark.parametrize("name", CONFIGS)
def test_a_run_is_bitwise_the_same_alone_with_any_batch_size(name):
    """Batches of 50 are no multiple of the vectors' length."""
    rule, config = of(name)
    nets = sac.make_nets(config, 2, 2, 1)
    rng = np.random.default_rng(2)
    drawn = [column.astype(np.float32) for column in batch(config, rng, ROWS)]
    noise = rng.normal(size=(2, RUNS, ROWS, 2)).astype(np.float32)
    states = []
    for runs in (slice(None), *(slice(run, run + 1) for run in range(RUNS))):
        state = sac.initial_state(nets, config, rule, range(RUNS)[runs])
        own = Batch(*(column[runs].copy() for column in drawn))
        for _ in range(2):
            what = (own, sac.UpdateNoise(*noise[:, runs].copy()))
            state, _ = sac.update(nets, config, rule, state, *what)
        states.append(tree.flatten(state))
    together, *alone = states
    for run, state in enumerate(alone):
        for key, array in state.items():
            np.testing.assert_array_equal(array[0], together[key][run], err_msg=key)
