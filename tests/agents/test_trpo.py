"""What the on-policy family shares, against PyTorch's own modules, one run at a time; TRPO-Lag."""

import math

import numpy as np
import pytest
import torch
from modules import flat, module
from torch.distributions import Independent, Normal, kl_divergence

from agents.algorithms import cpo, trpo_lag
from agents.algorithms.cpo import CPOConfig
from agents.algorithms.trpo_lag import TRPOLagConfig
from agents.lockstep.nets import MLP
from agents.lockstep.rollout import Rollout
from agents.updates import critics, trpo
from agents.updates.gaussian import GaussianPolicy
from agents.updates.on_policy import METRICS, OnPolicy
from agents.updates.packing import BLOCK, Packing
from agents.updates.trust_region import Problem

OBSERVATION, ACTION = 3, 2
SMALL = {"hidden": (32,), "episodes": 2, "critic_iterations": 2}
ACTOR = GaussianPolicy(MLP((OBSERVATION, 32, ACTION)))
NETS = trpo.Nets(ACTOR, MLP((OBSERVATION, 32, 1)))


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


class Separate:
    """One run's policy with PyTorch's modules and distributions."""

    def __init__(self, params):
        self.net = module(ACTOR.net, params)
        start = ACTOR.net.size
        self.log_std = params[start : start + ACTION].clone().requires_grad_()

    def at(self, observation):
        mean = self.net(observation)
        return Independent(Normal(mean, self.log_std.exp().expand_as(mean)), 1)


def random_actor(runs, seed=0):
    return 0.3 * normal(runs, ACTOR.size, seed=seed)


def random_epoch(steps, size):
    """What lies in the rows beyond a run's steps is not 0: only their weight keeps it out."""
    runs, steps = len(steps), torch.tensor(steps)
    columns = normal(runs, size, OBSERVATION + ACTION + 2, seed=1)
    observation, action, advantages = columns.split((OBSERVATION, ACTION, 2), dim=-1)
    return trpo.Epoch(
        observation=observation,
        action=action,
        weight=(torch.arange(size) < steps[:, None]) / steps[:, None].double(),
        reward_advantage=advantages[..., 0],
        cost_advantage=advantages[..., 1],
        value_targets=normal(runs, 2, size, seed=2),
        length=torch.full((runs,), 50.0),
        excess=torch.zeros(runs),
    )


def test_distribution_against_torch():
    params, others = random_actor(3), random_actor(3, seed=5)
    observation, action = normal(3, 7, OBSERVATION, seed=1), normal(3, 7, ACTION, seed=2)
    found = ACTOR.distribution(params, observation)
    log_prob, kl = found.log_prob(action), found.kl(ACTOR.distribution(others, observation))
    acted = ACTOR.act(params.numpy(), observation.numpy(), action.numpy())  # action: the noise
    deterministic = ACTOR.act(params.numpy(), observation.numpy(), None)
    for run in range(3):
        theirs = Separate(params[run]).at(observation[run])
        other = Separate(others[run]).at(observation[run])
        torch.testing.assert_close(log_prob[run], theirs.log_prob(action[run]))
        torch.testing.assert_close(kl[run], kl_divergence(theirs, other))
        by_hand = theirs.mean + theirs.stddev * action[run]
        torch.testing.assert_close(torch.from_numpy(acted[run]), by_hand)
        torch.testing.assert_close(torch.from_numpy(deterministic[run]), theirs.mean)


def test_initial_deviation():
    config = TRPOLagConfig(initial_log_std=-0.5, **SMALL)
    state = trpo.initial_state(NETS, config, trpo_lag.RULE, [3, 4])
    policy = ACTOR.distribution(state.actor, torch.zeros(2, 1, OBSERVATION))
    torch.testing.assert_close(policy.std, torch.full((2, 1, ACTION), math.exp(-0.5)))
    assert (state.actor[:, ACTOR.net.size + ACTION :] == 0).all()
    assert (state.actor[0] != state.actor[1]).any()
    again = trpo.initial_state(NETS, config, trpo_lag.RULE, [4])
    assert torch.equal(again.actor[0], state.actor[1])
    assert torch.equal(again.critics[0], state.critics[1])
    assert (state.critics[:, 0] != state.critics[:, 1]).any()


@pytest.mark.parametrize(("steps", "size"), [((90, 400), BLOCK), ((1000, 20), 2 * BLOCK)])
def test_compared_and_its_gradient_against_separate_runs(steps, size):
    """E[ratio · A] for both advantages, and the KL from the old to the new policy."""
    old, new, epoch = random_actor(2), random_actor(2, seed=3), random_epoch(steps, size)
    blocks = trpo.blocks_of(NETS, old, epoch, epoch.reward_advantage)
    found, kl = trpo.compared(NETS, new, blocks)
    for of, advantage in enumerate((epoch.reward_advantage, epoch.cost_advantage)):
        gradient = torch.func.grad(lambda p, of=of: trpo.compared(NETS, p, blocks)[0][:, of].sum())
        moved = gradient(new)
        for run, n in enumerate(steps):
            before, after = Separate(old[run]), Separate(new[run])
            observation, action = epoch.observation[run, :n], epoch.action[run, :n]
            theirs, ours = before.at(observation), after.at(observation)
            ratio = ours.log_prob(action).exp() / theirs.log_prob(action).exp().detach()
            surrogate = (ratio * advantage[run, :n]).mean()
            surrogate.backward()
            torch.testing.assert_close(found[run, of].double(), surrogate.detach())
            torch.testing.assert_close(kl[run].double(), kl_divergence(theirs, ours).mean())
            expected = flat(after.net)
            torch.testing.assert_close(moved[run, : len(expected)], expected)
            assert (moved[run, len(expected) : ACTOR.net.size] == 0).all()
            log_std = moved[run, ACTOR.net.size : ACTOR.net.size + ACTION]
            torch.testing.assert_close(log_std, after.log_std.grad)


def test_critics_against_separate_runs():
    """Four steps of Adam; the second run has no rows in the third minibatch, and waits."""
    config, epoch = CPOConfig(**SMALL), random_epoch((200, 40), BLOCK)
    epoch = epoch._replace(observation=epoch.observation.float())
    state = trpo.initial_state(NETS, config, cpo.RULE, [0, 1])
    theirs = [[module(NETS.critic, vector) for vector in run] for run in state.critics]
    optimizers = [[torch.optim.Adam(net.parameters(), lr=3e-4) for net in run] for run in theirs]
    rng = np.random.default_rng(0)
    for held in torch.tensor([[32, 9], [32, 9], [32, 0], [7, 32]]):
        rows = torch.from_numpy(rng.integers((200, 40), size=(32, 2)).T.copy())
        weight = (torch.arange(32) < held[:, None]) / held[:, None].clamp(min=1)
        state, losses = critics.critic_step(NETS, config, state, epoch, rows, weight)
        for run, n in enumerate(held):
            if n == 0:
                assert (losses[run] == 0).all()
                continue
            for of in range(2):
                net, optimizer, row = theirs[run][of], optimizers[run][of], rows[run, :n]
                said = net(epoch.observation[run, row].double())[:, 0]
                loss = 0.5 * ((said - epoch.value_targets[run, of, row]) ** 2).mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                assert losses[run, of].item() == pytest.approx(loss.item(), rel=1e-5)
    for run in range(2):
        for of in range(2):
            expected = flat(theirs[run][of], of=lambda parameter: parameter.data)
            found = state.critics[run, of, : len(expected)].double()
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def learner(rule, config, seeds=(0,)):
    return OnPolicy(config, rule, seeds, OBSERVATION, ACTION)


def episodes(lengths, draw):
    """A rollout of episodes that `draw`, (n, length) -> columns, fills; NaN beyond their ends.

    Episodes of even number end in a terminal state, the others are cut off.
    """
    steps, n = max(lengths), len(lengths)
    widths = (OBSERVATION, ACTION, None, None, OBSERVATION)
    shapes = [(steps, n) if width is None else (steps, n, width) for width in widths]
    columns = [np.full(shape, np.nan, np.float32 if len(shape) > 2 else float) for shape in shapes]
    for k, length in enumerate(lengths):
        for column, values in zip(columns, draw(k, length), strict=True):
            column[:length, k] = values
    ends = np.arange(steps)[:, None] == np.array(lengths) - 1
    even = np.arange(n) % 2 == 0
    return Rollout(*columns, ends & even, ends & ~even, np.array(lengths), np.zeros(n, bool))


def saying(critic, values):
    """Parameters of critics that say a constant each, [1, 2, size]."""
    params = torch.zeros(1, 2, critic.size)
    last = sum(a * b + b for a, b in zip(critic.sizes[:-1], critic.sizes[1:], strict=True)) - 1
    params[0, :, last] = torch.tensor(values)
    return params


@pytest.mark.parametrize("time_limit", ["bootstrap", "terminal"])
def test_an_epoch_by_hand(time_limit):
    """Critics say 2 and 4; γ = ½, λ = 0, so that A = r + ½ V' - V.

    The first episode, r = 5 and c = 2, ends in a terminal state: targets 5 and 2. The second,
    r = 1, 3 and c = 1, 0, is cut off: targets 1 + ½·2 = 2 and 1 + ½·4 = 3, then bootstrapping
    3 + ½·2 = 4 and 0 + ½·4 = 2, or else 3 and 0.
    """
    config = TRPOLagConfig(time_limit=time_limit, discount=0.5, gae_lambda=0.0, **SMALL)
    it = learner(trpo_lag.RULE, config)
    it._state = it._state._replace(critics=saying(it.nets.critic, [2.0, 4.0]))
    signals = [([5.0], [2.0]), ([1.0, 3.0], [1.0, 0.0])]
    rollout = episodes([1, 2], lambda k, length: (0.5, 0.5, *signals[k], 0.5))
    epoch = it._epoch(rollout, Packing(rollout.during, 1))
    bootstraps = time_limit == "bootstrap"
    targets = np.array([[5.0, 2.0, 4.0], [2.0, 3.0, 2.0]] if bootstraps else [[5, 2, 3], [2, 3, 0]])
    np.testing.assert_allclose(epoch.value_targets[0, :, :3], targets)
    # Advantages: of the reward with mean 0 and deviation 1, of the cost with mean 0 only
    reward, cost = targets[0] - 2.0, targets[1] - 4.0
    expected = (reward - reward.mean()) / reward.std()
    np.testing.assert_allclose(epoch.reward_advantage[0, :3], expected, rtol=1e-6)
    np.testing.assert_allclose(epoch.cost_advantage[0, :3], cost - cost.mean(), rtol=1e-6)
    assert epoch.length.tolist() == [1.5]
    assert epoch.excess.tolist() == [(2.0 + 1.0) / 2 - 25.0]


def test_objective_by_hand():
    """(A_r - λ A_c) / (1 + λ): (2 - ½·1) / 1.5 = 1, (-1 - ½·4) / 1.5 = -2; (2 - 3) / 4 = -¼."""
    reward, cost = torch.tensor([[2.0, -1.0], [2.0, 0.0]]), torch.tensor([[1.0, 4.0], [1.0, 0.0]])
    found = trpo_lag.objective(TRPOLagConfig(), reward, cost, torch.tensor([[0.5], [3.0]]))
    torch.testing.assert_close(found, torch.tensor([[1.0, -2.0], [-0.25, 0.0]]))


def test_step_of_trpo_by_hand():
    """H = diag(4, 1), g = (8, 1): H⁻¹g = (2, 1), of which ½ xᵀHx = 8.5; δ = 0.085 is a hundredth.

    It has to be better, and costs do not stand in its way."""
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
    torch.testing.assert_close(found.step, torch.tensor([[0.2, 0.1], [0.0, 0.0]]))
    assert found.must_improve.all()
    assert (found.cost_bound == torch.inf).all()


@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
def test_multiplier_follows_the_cost_of_episodes(optimizer):
    """λ₀ = 0.001, lr 0.005, d = 3. Episodes cost 5, 1 and 3 on average: λ rises, falls to 0, stays.

    Adam's first step is the step size; the plain gradient's is 0.005·2 = 0.01.
    """
    config = TRPOLagConfig(cost_limit=3.0, multiplier_optimizer=optimizer, **SMALL)
    it = learner(trpo_lag.RULE, config, seeds=(0, 1, 2))
    rng, costs = np.random.default_rng(0), [4, 6, 0, 2, 3, 3]
    rollout = episodes(
        [10] * 6, lambda k, length: (*rng.normal(size=(2, 1, 1)), 0.0, costs[k] / 10, 0.0)
    )
    column, everyone = it.metrics.index("multiplier"), np.ones(3, bool)
    used = [it.learn(rollout, epoch, everyone)[:, column] for epoch in range(2)]
    np.testing.assert_allclose(used[0], 0.001, rtol=1e-6)
    risen = 0.001 + (0.005 if optimizer == "adam" else 0.01)
    np.testing.assert_allclose(used[1], [risen, 0.0, 0.001], rtol=1e-4, atol=1e-8)


def noisy(seed, epoch):
    """Episodes of a seed and an epoch, of a cost of about 1; actions of deviation 1."""

    def draw(k, length):
        rng = np.random.default_rng((seed, epoch, k))
        observation, following = rng.normal(size=(2, length, OBSERVATION))
        action, reward = rng.normal(size=(length, ACTION)), rng.normal(size=length)
        return observation, action, reward, 2.0 / length * (action[:, 0] > 0), following

    return draw


LENGTHS = {0: (37, 60), 1: (900, 201), 2: (1, 2), 3: (250, 263)}


def trained(rule, config, seeds, epochs=2, absent=()):
    """What learning leaves behind and its metrics, after epochs on each seed's own episodes."""
    it, metrics = learner(rule, config, seeds), []
    for epoch in range(epochs):
        lengths = [length for seed in seeds for length in LENGTHS[seed]]
        draws = [noisy(seed, epoch) for seed in seeds]
        rollout = episodes(lengths, lambda n, length, d=draws: d[n // 2](n % 2, length))
        active = np.array([seed not in absent for seed in seeds])
        metrics.append(it.learn(rollout, epoch, active))
    return it.state(), np.array(metrics)


@pytest.mark.parametrize(
    ("rule", "config"), [(trpo_lag.RULE, TRPOLagConfig), (cpo.RULE, CPOConfig)], ids=["lag", "cpo"]
)
def test_a_run_is_bitwise_the_same_alone(rule, config):
    """Beside one of 1101 steps, in three blocks, where others have 97, 3 and 513. Costs are about
    their limit, so that CPO comes to more than its plain step."""
    config = config(cost_limit=1.0, **SMALL)
    together, their_metrics = trained(rule, config, (1, 0, 2, 3))
    assert (their_metrics[..., METRICS.index("step_scale")] > 0).any()
    for k, seed in enumerate((1, 0, 2, 3)):
        alone, metrics = trained(rule, config, (seed,))
        np.testing.assert_array_equal(metrics[:, 0], their_metrics[:, k])
        for name, value in alone.items():
            np.testing.assert_array_equal(value[0], together[name][k], err_msg=name)


def test_a_run_that_takes_no_part_stays_as_it_is():
    config = TRPOLagConfig(**SMALL)
    before = learner(trpo_lag.RULE, config, (0, 1)).state()
    after, metrics = trained(trpo_lag.RULE, config, (0, 1), absent=(1,))
    alone, its_metrics = trained(trpo_lag.RULE, config, (0,))
    assert np.isnan(metrics[:, 1]).all()
    np.testing.assert_array_equal(metrics[:, 0], its_metrics[:, 0])
    for name, value in after.items():
        np.testing.assert_array_equal(value[1], before[name][1], err_msg=name)
        np.testing.assert_array_equal(value[0], alone[name][0], err_msg=name)


@pytest.mark.parametrize("multiplier", [0.0, 1.0, 1e6])
def test_step_of_a_policy(multiplier):
    """It raises the objective to the edge of the trust region, for a large λ by what costs less."""
    config = TRPOLagConfig(initial_multiplier=multiplier, multiplier_lr=0.0, **SMALL)
    epoch = random_epoch((300, 120), BLOCK)
    actor = random_actor(2)
    state = trpo.initial_state(NETS, config, trpo_lag.RULE, [0, 1])._replace(actor=actor)
    found, records = trpo.policy_step(NETS, config, trpo_lag.RULE, state, epoch)
    for run, n in enumerate((300, 120)):
        observation, action = epoch.observation[run, :n], epoch.action[run, :n]
        old, new = (Separate(params[run]).at(observation) for params in (actor, found))
        kl = kl_divergence(old, new).mean().item()
        assert 0.002 < kl <= 0.01
        assert records["kl"][run].item() == pytest.approx(kl, rel=1e-5)
        ratio = (new.log_prob(action) - old.log_prob(action)).exp() - 1
        reward, cost = (
            (ratio * advantage[run, :n]).mean()
            for advantage in (epoch.reward_advantage, epoch.cost_advantage)
        )
        assert reward - multiplier * cost > 0
        assert (cost < 0) if multiplier > 10 else (reward > 0)


def test_learns_what_pays():
    """Reward -(a - 0.5)², cost where the second component is positive: both components obey."""
    config = TRPOLagConfig(cost_limit=0.0, initial_multiplier=1.0, **SMALL)
    it = learner(trpo_lag.RULE, config, seeds=(0, 1))
    zeros = np.zeros((4, OBSERVATION), np.float32)
    for epoch in range(25):
        act = it.explorer(epoch, np.zeros(2, np.int64))
        actions = np.stack([act(zeros) for _ in range(100)])

        def draw(k, length, actions=actions):
            action = actions[:, k]
            cost = (action[:, 1] > 0).astype(float)
            return 0.0, action, -((action[:, 0] - 0.5) ** 2), cost, 0.0

        metrics = it.learn(episodes([100] * 4, draw), epoch, np.ones(2, bool))
    mean = it.policy()(zeros.reshape(2, 2, OBSERVATION), None)[:, 0]
    assert (np.abs(mean[:, 0] - 0.5) < 0.2).all()
    assert (mean[:, 1] < -0.5).all()
    std = metrics[:, METRICS.index("std")]
    assert (std < 0.9).all()


def test_rows_of_weight_zero_do_not_change_a_sharp_policy():
    """At σ = e⁻⁷ the density of an action far from the mean may grow by more than e^100."""
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
        epoch = trpo.Epoch(
            observation=torch.zeros(1, size, OBSERVATION),
            action=there[..., None].expand(1, size, ACTION).contiguous(),
            weight=there / 500,
            reward_advantage=there,
            cost_advantage=zeros,
            value_targets=torch.zeros(1, 2, size),
            length=torch.ones(1),
            excess=torch.zeros(1),
        )
        steps = trpo.blocks_of(NETS, actor, epoch, epoch.reward_advantage)
        at_padding = NETS.actor.distribution(nearer, epoch.observation).log_prob(epoch.action)
        assert (at_padding - steps[0].old_log_prob[:, -1])[0, -1] > 100
        found.append(trpo.compared(NETS, nearer, steps))
    for short, long in zip(*found, strict=True):
        assert short.isfinite().all()
        assert torch.equal(short, long)
