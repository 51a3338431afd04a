"""TorchRL's batches, against the costs that the environments gave."""

import warnings

import numpy as np
import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # torchrl's own, of its future versions
    pytest.importorskip("torchrl.collectors")
    import gymnasium as gym
    import torch
    from tensordict import TensorDict
    from torchrl.collectors import Collector
    from torchrl.envs import GymWrapper, SerialEnv

import emcc

LOG = []


class Noisy(gym.Env):
    """Episodes of random length and cost."""

    observation_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, number):
        self.number, self.rng = number, np.random.default_rng(number)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = int(self.rng.integers(1, 12))
        return np.zeros(2, np.float32), {"cost": np.float64(77)}

    def step(self, action):
        self.left -= 1
        cost = np.float64(self.rng.random() < 0.4)
        done = self.left == 0
        LOG.append((self.number, float(cost), done))
        return np.zeros(2, np.float32), 1.0, done, False, {"cost": cost}


def made(number):
    env = GymWrapper(Noisy(number))
    env.auto_register_info_dict()
    return env


def batches(count, rollout, total):
    """Batches of a collector; LOG has the steps they hold."""
    envs = SerialEnv(count, [lambda k=k: made(k) for k in range(count)])
    collector = Collector(envs, None, frames_per_batch=count * rollout, total_frames=total)
    LOG.clear()  # of the steps that making the environments took
    for _ in range(1):
        yield from collector
    collector.shutdown()


def trajectories(steps):
    """Costs of each environment's trajectories, whole or not, of some entries of LOG."""
    running, found = {}, []
    for number, cost, done in steps:
        running.setdefault(number, []).append(cost)
        if done:
            found.append(running.pop(number))
    return [*found, *running.values()]


@pytest.mark.filterwarnings("ignore")  # torchrl's own
@pytest.mark.parametrize("count", [1, 2])
def test_a_collector(count):
    found = emcc.from_tensordict(batches(count, 20, 100 * count))
    assert found.cost.sum() == sum(cost for _, cost, _ in LOG)
    size = 20 * count
    expected = [emcc.mcc(trajectories(LOG[i : i + size])) for i in range(0, 5 * size, size)]
    mcc, starts = found.mcc_per_rollout()
    assert mcc.tolist() == expected
    assert starts.tolist() == list(range(0, 5 * size, size))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("count", [1, 2])
def test_episodes_that_go_on_in_the_next_batch(count):
    found = emcc.from_tensordict(batches(count, 20, 100 * count), rollout="episode")
    expected = [emcc.mcc([costs]) for costs in trajectories(LOG)]
    assert sorted(found.mcc_per_rollout()[0]) == sorted(expected)
    assert found.reward.tolist() == found.length.tolist()


@pytest.mark.filterwarnings("ignore")
def test_a_rollout_of_an_environment():
    env = made(3)
    LOG.clear()
    found = emcc.from_tensordict(env.rollout(50, break_when_any_done=False))
    assert found.emcc(alpha=1) == emcc.mcc(trajectories(LOG))
    assert found.total_steps == 50


def by_hand(**changes):
    steps = {"cost": [0, 1, 1], "reward": [1, 1, 1], "done": [False, False, True], **changes}
    values = {name: torch.tensor(value, dtype=torch.float32)[:, None] for name, value in
        steps.items() if value is not None}  # fmt: skip
    return TensorDict({"next": TensorDict(values, [3])}, [3])


def test_where_the_time_is():
    late = torch.stack([by_hand(), by_hand(cost=[1, 0, 1])])  # [environments, time]
    early = late.transpose(0, 1).contiguous()
    early.names = ["time", None]
    for batch in (late, early):
        found = emcc.from_tensordict(batch)
        assert found.longest_streak.tolist() == [2, 1]
        assert found.rollout.tolist() == [0, 0]


def test_mistakes_are_named():
    with pytest.raises(KeyError, match=r"no \('next', 'cost'\)"):
        emcc.from_tensordict(by_hand(cost=None))
    with pytest.raises(ValueError, match='rollout must be "batch" or "episode", got'):
        emcc.from_tensordict(by_hand(), rollout="update")
    with pytest.raises(ValueError, match="there is no batch"):
        emcc.from_tensordict([])
    with pytest.raises(TypeError, match="not iterable"):
        emcc.from_tensordict(3)
    with pytest.raises(ValueError, match="must have a time dimension"):
        emcc.from_tensordict(by_hand()[0])
    with pytest.raises(ValueError, match="a batch has 2 environments, the first 1"):
        emcc.from_tensordict([by_hand(), torch.stack([by_hand(), by_hand()])])
