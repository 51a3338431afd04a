"""On-policy learning: targets and advantages by their definitions, packed rows, the clipped
surrogate by hand, minibatch passes against PyTorch's Adam, and runs side by side."""

import math

import numpy as np
import pytest
import torch
from modules import data, flat, module
from torch.distributions import Independent, Normal

from agents import trust_region as trpo
from agents.algorithms import cpo, trpo_lag
from agents.algorithms.cpo import CPOConfig
from agents.algorithms.trpo_lag import TRPOLagConfig
from agents.first_order import Minibatch, PPOConfig, Raised, clipped, loss_of, surrogate_at
from agents.lockstep import kernel
from agents.lockstep.descent import Clipped, Descent, minibatches, orders
from agents.lockstep.nets import MLP, no_moments
from agents.lockstep.rollout import Rollout
from agents.on_policy.epoch import BLOCK, Packing, advantages
from agents.on_policy.state import Gaussian, GaussianPolicy, Nets
from agents.trust_region import TrustRegion

METRICS = ("kl", "step_scale", "critic_loss", "cost_critic_loss", "std")

OBSERVATION, ACTION, COSTS = 3, 2, 1
SMALL = {"hidden": (32,), "episodes": 2, "critic_iterations": 2}


def learner(rule, config, seeds=(0,)):
    return TrustRegion(config, rule, seeds, OBSERVATION, ACTION)


def episodes(lengths, draw):
    """Return a rollout of episodes that `draw`, (n, length) -> columns, fills; NaN beyond its ends.

    Episodes 0, 2, ... end in a terminal state; the others are truncated.
    """
    steps, n = max(lengths), len(lengths)
    widths = (OBSERVATION, ACTION, None, COSTS, OBSERVATION)
    shapes = [(steps, n) if width is None else (steps, n, width) for width in widths]
    columns = [np.full(shape, np.nan) for shape in shapes]
    for k in (0, 1, 4):
        columns[k] = columns[k].astype(np.float32)
    for k, length in enumerate(lengths):
        for column, values in zip(columns, draw(k, length), strict=True):
            column[:length, k] = values
    ends = np.arange(steps)[:, None] == np.array(lengths) - 1
    even = np.arange(n) % 2 == 0
    return Rollout(*columns, ends & even, ends & ~even, np.array(lengths), np.full(n, ""))


def saying(critic, values):
    """Return the parameters [1, 2, size] of two critics whose outputs are constant."""
    params = np.zeros((2, critic.size), np.float32)
    critic.layers(params)[-1][:, 0, 0] = values
    return torch.from_numpy(params)[None]


@pytest.mark.parametrize("time_limit", ["bootstrap", "terminal"])
def test_an_epoch_by_hand(time_limit):
    """The critics' values are 2 and 4; γ = ½ and λ = 0, so that A = r + ½ V' - V.

    The first episode, r = 5 and c = 2, ends in a terminal state: its targets are 5 and 2. The
    second, r = 1, 3 and c = 1, 0, is truncated: its targets are 1 + ½·2 = 2 and 1 + ½·4 = 3 in the
    first step; in the second 3 + ½·2 = 4 and 0 + ½·4 = 2 with bootstrapping, without it 3 and 0.
    """
    config = TRPOLagConfig(time_limit=time_limit, discount=0.5, gae_lambda=0.0, **SMALL)
    it = learner(trpo_lag.RULE, config)
    it._state = it._state._replace(critics=saying(it.nets.critic, [2.0, 4.0]))
    signals = [([5.0], [[2.0]]), ([1.0, 3.0], [[1.0], [0.0]])]
    rollout = episodes([1, 2], lambda k, length: (0.5, 0.5, *signals[k], 0.5))
    epoch = it._epoch(rollout, Packing(rollout.during, 1))
    bootstraps = time_limit == "bootstrap"
    targets = np.array([[5.0, 2.0, 4.0], [2.0, 3.0, 2.0]] if bootstraps else [[5, 2, 3], [2, 3, 0]])
    np.testing.assert_allclose(epoch.value_targets[0, :, :3], targets)
    # The reward's advantages have mean 0 and standard deviation 1, the cost's have mean 0.
    reward, cost = targets[0] - 2.0, targets[1] - 4.0
    expected = (reward - reward.mean()) / reward.std()
    np.testing.assert_allclose(epoch.reward_advantage[0, :3], expected, rtol=1e-6)
    np.testing.assert_allclose(epoch.cost_advantage[0, 0, :3], cost - cost.mean(), rtol=1e-6)
    assert epoch.length.tolist() == [1.5]
    assert epoch.cost.tolist() == [[(2.0 + 1.0) / 2]]


def noisy(seed, epoch):
    """Return a `draw` for `episodes`, by seed and epoch; the cost of an episode is about 1."""

    def draw(k, length):
        rng = np.random.default_rng((seed, epoch, k))
        observation, following = rng.normal(size=(2, length, OBSERVATION))
        action, reward = rng.normal(size=(length, ACTION)), rng.normal(size=length)
        return observation, action, reward, 2.0 / length * (action[:, :1] > 0), following

    return draw


LENGTHS = {0: (37, 60), 1: (900, 201), 2: (1, 2), 3: (250, 263)}


def trained(rule, config, seeds, epochs=2, absent=()):
    """Return the state and metrics after epochs of learning on each seed's own episodes."""
    it, metrics = learner(rule, config, seeds), []
    for epoch in range(epochs):
        lengths = [length for seed in seeds for length in LENGTHS[seed]]
        draws = [noisy(seed, epoch) for seed in seeds]
        rollout = episodes(lengths, lambda n, length, d=draws: d[n // 2](n % 2, length))
        active = np.array([seed not in absent for seed in seeds])
        metrics.append(it.learn(rollout, epoch, active))
    return it.state_dict(), np.array(metrics)


@pytest.mark.parametrize(
    ("rule", "config"), [(trpo_lag.RULE, TRPOLagConfig), (cpo.RULE, CPOConfig)], ids=["lag", "cpo"]
)
def test_a_run_is_bitwise_the_same_alone(rule, config):
    """The runs have 1101 steps, in three blocks, and 97, 3 and 513. Costs are about as high as
    their limit, so that CPO takes other steps than the unconstrained one."""
    config = config(cost_limit=1.0, **SMALL)
    together, their_metrics = trained(rule, config, (1, 0, 2, 3))
    assert (their_metrics[..., METRICS.index("step_scale")] > 0).any()
    for k, seed in enumerate((1, 0, 2, 3)):
        alone, metrics = trained(rule, config, (seed,))
        np.testing.assert_array_equal(metrics[:, 0], their_metrics[:, k])
        for name, value in alone.items():
            np.testing.assert_array_equal(value[0], together[name][k], err_msg=name)


def test_a_run_that_takes_no_part_stays_as_it_is(monkeypatch):
    compared, compares = trpo.compared, []
    monkeypatch.setattr(trpo, "compared", lambda *a: compares.append(1) or compared(*a))
    config = TRPOLagConfig(**SMALL)
    before = learner(trpo_lag.RULE, config, (0, 1)).state_dict()
    after, metrics = trained(trpo_lag.RULE, config, (0, 1), absent=(1,))
    count = len(compares)
    alone, its_metrics = trained(trpo_lag.RULE, config, (0,))
    assert len(compares) == 2 * count  # the line search makes no further tries for it
    assert np.isnan(metrics[:, 1]).all()
    np.testing.assert_array_equal(metrics[:, 0], its_metrics[:, 0])
    for name, value in after.items():
        np.testing.assert_array_equal(value[1], before[name][1], err_msg=name)
        np.testing.assert_array_equal(value[0], alone[name][0], err_msg=name)


@pytest.mark.parametrize(("discount", "gae_lambda"), [(0.99, 0.95), (0.9, 1.0), (0.9, 0.0)])
def test_advantages_are_sums_of_errors(discount, gae_lambda):
    """A_t = Σ_k (γλ)^k δ_{t+k} to the end of the episode, which is terminal or truncated.

    Values beyond an episode are NaN and must not matter.
    """
    rng, length = np.random.default_rng(0), np.array([1, 2, 7, 12, 30, 0])
    during = np.arange(30)[:, None] < length
    reward, value, next_value = np.where(during, rng.normal(size=(3, 30, 6)), np.nan)
    ends = np.arange(30)[:, None] == length - 1
    terminal = ends & (np.arange(6) % 2 == 0)
    found = advantages(reward, value, next_value, terminal, during, discount, gae_lambda)
    expected = np.zeros((30, 6))
    for n in range(6):
        for t in range(length[n]):
            for k in range(length[n] - t):
                error = reward[t + k, n] - value[t + k, n]
                if not terminal[t + k, n]:
                    error += discount * next_value[t + k, n]
                expected[t, n] += (discount * gae_lambda) ** k * error
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def during(length, steps):
    return np.arange(steps)[:, None] < np.array(length)


def test_packing_round_trip():
    """Runs of 600, 1, 0 and 512 steps, with a column of vectors that is NaN beyond the episodes."""
    lengths = [300, 300, 0, 1, 0, 0, 500, 12]
    packing = Packing(during(lengths, 500), runs=4)
    assert packing.steps.tolist() == [600, 1, 0, 512]
    assert packing.size == 2 * BLOCK
    inside = during(lengths, 500)[..., None]
    values = np.where(inside, np.random.default_rng(0).normal(size=(500, 8, 3)), np.nan)
    packed = packing.pack(values)
    for run in range(4):
        episodes = [values[: lengths[n], n] for n in (2 * run, 2 * run + 1)]
        expected = np.concatenate(episodes).astype(np.float32)
        np.testing.assert_array_equal(packed[run, : len(expected)], expected)
        assert not packed[run, len(expected) :].any()
        means = packing.weight[run] @ packed[run]
        if len(expected):
            np.testing.assert_allclose(means, expected.mean(axis=0), atol=1e-6)
    back = packing.unpack(packed[..., 1])
    np.testing.assert_array_equal(back, np.where(inside, values, 0.0)[..., 1].astype(np.float32))
    np.testing.assert_allclose(packing.weight.sum(axis=1), [1, 1, 0, 1], rtol=1e-6)


def test_a_pass_takes_every_row_once():
    steps = np.array([1000, 0, 3, 256])
    generators = [np.random.default_rng(seed) for seed in range(4)]
    passes = list(minibatches(orders(steps, generators), steps, 256))
    assert len(passes) == 4
    for run, n in enumerate(steps):
        taken = np.concatenate([rows[run][weight[run] > 0] for rows, weight in passes])
        assert sorted(taken.tolist()) == list(range(n))
        for k, (rows, weight) in enumerate(passes):
            assert rows.shape == weight.shape == (4, 256)
            held = int(np.clip(n - 256 * k, 0, 256))
            expected = [1 / max(held, 1)] * held + [0.0] * (256 - held)
            np.testing.assert_allclose(weight[run], expected, rtol=1e-6)
    first = passes[0][0][0]
    assert (first > 255).sum() > 100  # not in the order of time


CRITIC = MLP((3, 32, 1))
CONFIG = PPOConfig(clip_range=0.2)


def normal_policy(mean):
    """N(mean, 1) at five steps of one run."""
    log_std = torch.zeros(1, 1, 1, dtype=torch.float64)
    return Gaussian(torch.full((1, 5, 1), mean, dtype=torch.float64), log_std, log_std.exp())


def five_steps():
    """Actions drawn from N(0, 1), at observation 0; advantages of both signs."""
    action = torch.tensor([[1.0, 1.0, -1.0, -1.0, 0.25]], dtype=torch.float64)
    return Minibatch(
        observation=torch.zeros(1, 5, 1, dtype=torch.float64),
        action=action[..., None],
        weight=torch.full((1, 5), 0.2, dtype=torch.float64),
        advantage=torch.tensor([[2.0, -1.0, 1.0, -1.0, 3.0]], dtype=torch.float64),
        old_log_prob=-0.5 * action**2 - 0.5 * math.log(2 * math.pi),
        cost_advantage=torch.zeros(1, 1, 5),
        start=normal_policy(0.0),
    )


def slopes(policy, batch):
    """Return the slopes of the clipped loss at all rows, by autograd and in closed form."""
    rows = np.arange(batch.weight.shape[1])[None].repeat(len(policy.mean), axis=0)
    said = (batch.weight.numpy(), policy.mean.numpy(), policy.log_std[:, 0].numpy())
    losses = (Raised(CONFIG, clipped, batch), loss_of(CONFIG, clipped, batch))
    assert isinstance(losses[1], Clipped)
    return [loss.slopes(rows, *said) for loss in losses]


def test_surrogate_and_its_gradient_by_hand():
    """From N(0, 1) to N(½, 1): log ρ = a/2 - 1/8, so ρ = 1.4549914 at a = 1, 0.5352614 at a = -1
    and 1 at a = ¼; ε = 0.2. The derivative of ρ A by the mean is ρ A (a - ½), that by log σ is
    ρ A ((a - ½)² - 1).

    - a = 1, A = 2: clipped to 1.2·2 = 2.4, slopes 0.
    - a = 1, A = -1: -1.4549914 is less than -1.2 and stays; slopes -0.7274957 and 1.0912436.
    - a = -1, A = 1: 0.5352614 is less than 0.8 and stays; slopes -0.8028921 and 0.6690768.
    - a = -1, A = -1: clipped to -0.8, slopes 0.
    - a = ¼, A = 3: 3; slopes -0.75 and -2.8125.
    """
    policy, batch = normal_policy(0.5), five_steps()
    found, outside = surrogate_at(CONFIG, clipped, policy, batch)
    assert found.item() == pytest.approx((2.4 - 1.4549914 + 0.5352614 - 0.8 + 3.0) / 5, abs=1e-7)
    assert outside.item() == pytest.approx(4 / 5)
    for found in slopes(policy, batch):
        by_hand = np.array([0.0, -0.7274957, -0.8028921, 0.0, -0.75]) / 5
        np.testing.assert_allclose(-found.outputs[0, :, 0], by_hand, atol=1e-7)
        assert -found.log_std.item() == pytest.approx((1.0912436 + 0.6690768 - 2.8125) / 5)
        assert found.record.item() == pytest.approx(4 / 5)


@pytest.mark.parametrize("seed", range(5))
def test_the_closed_form_agrees_with_autograd(seed):
    """For random minibatches, of which some rows have weight 0."""
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=generator).double()  # noqa: E731
    log_std = 0.3 * draw(3, 1, 2)
    policy = Gaussian(draw(3, 64, 2), log_std, log_std.exp())
    weight = torch.rand(3, 64, generator=generator).double().clamp(min=0.3) - 0.3
    old = policy.log_prob(action := draw(3, 64, 2)) + 0.3 * draw(3, 64)
    columns = (draw(3, 64, 1), action, weight, draw(3, 64), old)
    by_autograd, closed = slopes(policy, Minibatch(*columns, torch.zeros(3, 1, 64), policy))
    for name, expected in by_autograd._asdict().items():
        own = getattr(closed, name)
        np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-12, err_msg=name)


def test_rows_of_weight_zero_do_not_count():
    """Not even a row whose probability ratio overflows."""
    step = five_steps()
    far = step._replace(
        weight=torch.tensor([[0.25, 0.25, 0.25, 0.25, 0.0]], dtype=torch.float64),
        old_log_prob=torch.where(torch.arange(5) == 4, -1e9, step.old_log_prob),
    )
    policy = normal_policy(0.5)
    cut = policy._replace(mean=policy.mean[:, :4])
    without = far._replace(
        **{name: getattr(far, name)[:, :4] for name in far._fields[:5]}, start=cut
    )
    for whole, part in zip(slopes(policy, far), slopes(cut, without), strict=True):
        np.testing.assert_array_equal(whole.outputs[:, :4], part.outputs)
        np.testing.assert_array_equal(whole.outputs[:, 4:], 0.0)
        np.testing.assert_allclose(whole.log_std, part.log_std)


def test_a_surrogate_that_forgets_the_mean_is_an_error():
    def unsummed(config, policy, ratio, batch):
        return ratio * batch.advantage, torch.zeros(1)

    with pytest.raises(ValueError, match=r"two of \[runs\], here \[1\], got \[\[1, 5\], \[1\]\]"):
        surrogate_at(CONFIG, unsummed, normal_policy(0.5), five_steps())


@pytest.mark.parametrize("longest", [0.05, 1e9])
@pytest.mark.parametrize("kind", ["closed", "autograd"])
def test_passes_of_adam_against_separate_runs(longest, kind):
    """Three passes of two runs; in the second pass one run waits, in the third it has two
    minibatches."""
    nets = Nets(GaussianPolicy(MLP((3, 32, 2))), CRITIC)
    rng = np.random.default_rng(0)
    actor = torch.from_numpy(np.stack([nets.actor.initial(rng, -0.5) for _ in range(2)]))
    start, moments = nets.actor.net.size, no_moments(actor)
    theirs = [module(nets.actor.net, params) for params in actor]
    log_stds = [params[start : start + 2].double().requires_grad_() for params in actor]
    own = [[*net.parameters(), s] for net, s in zip(theirs, log_stds, strict=True)]
    optimizers = [torch.optim.Adam(parameters, lr=1e-2) for parameters in own]
    for held in ([30, 20], [30, 0], [9, 43]):
        columns = torch.from_numpy(rng.normal(size=(2, 43, 7)).astype(np.float32))
        observation, action, gain, before = columns.split((3, 2, 1, 1), dim=-1)
        gain, before = gain[..., 0].contiguous(), before[..., 0] / 3 - 2.5
        policy = Gaussian(action, torch.zeros(2, 1, 2), torch.ones(2, 1, 2))
        columns = (observation, action.contiguous(), None, gain, before)
        epoch = Minibatch(*columns, torch.zeros(2, 1, 43), policy)
        loss = (loss_of if kind == "closed" else Raised)(CONFIG, clipped, epoch)
        order = np.stack([rng.permutation(n).tolist() + [0] * (43 - n) for n in held])
        what = (nets.actor.net, actor.numpy(), moments.arrays, observation.numpy())
        descent = Descent(*what, 30, 1e-2, nets.actor.log_std, longest)
        kernel.of(actor.numpy()).descend(descent, loss, order, np.array(held))
        for run, rows in [
            (r, order[r, k : min(n, k + 30)]) for r, n in enumerate(held) for k in range(0, n, 30)
        ]:
            mean = theirs[run](observation[run, rows].double())
            policy = Independent(Normal(mean, log_stds[run].exp().expand_as(mean)), 1)
            ratio = (policy.log_prob(action[run, rows]) - before[run, rows]).exp()
            gains = gain[run, rows]
            loss = -torch.minimum(ratio * gains, ratio.clamp(0.8, 1.2) * gains).mean()
            optimizers[run].zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(own[run], longest)
            optimizers[run].step()
    for run in range(2):
        expected = flat(nets.actor.net, theirs[run], data)
        found = actor[run, :start].double()
        torch.testing.assert_close(found, expected, rtol=0, atol=2e-5)
        log_std = actor[run, start : start + 2].double()
        torch.testing.assert_close(log_std, log_stds[run].detach(), rtol=0, atol=2e-5)


def test_discounted_costs_by_hand():
    """γ = ½: 2 in the first episode, 1 + ½·4 + ¼·8 = 5 in the second."""
    signals = [([5.0], [[2.0]]), ([1.0, 3.0, 1.0], [[1.0], [4.0], [8.0]])]
    rollout = episodes([1, 3], lambda k, length: (0.5, 0.5, *signals[k], 0.5))
    assert rollout.discounted_costs(0.5).tolist() == [[2.0], [5.0]]
    it = learner(trpo_lag.RULE, TRPOLagConfig(discount=0.5, **SMALL))
    assert it._epoch(rollout, Packing(rollout.during, 1)).discounted_cost.tolist() == [[3.5]]
