"""A Minari data set, written and read."""

import numpy as np
import pytest

pytest.importorskip("minari")

import gymnasium as gym
import minari

import emcc

EPISODES = [[0.0, 1.0, 1.0], [2.0], [1.0, 1.0, 0.0, 1.0]]


class Scripted(gym.Env):
    """Plays EPISODES; the reset has a cost of its own, which is no step's."""

    observation_space = gym.spaces.Box(0, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)
    spec = gym.envs.registration.EnvSpec("Scripted-v0")

    def __init__(self, cost=True):
        self.cost, self.episode = cost, -1

    def info(self, cost):
        return {"cost": cost} if self.cost else {"other": cost}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.episode, self.at = self.episode + 1, 0
        return np.zeros(1, np.float32), self.info(9.0)

    def step(self, action):
        costs = EPISODES[self.episode]
        self.at += 1
        done = self.at == len(costs)
        return np.zeros(1, np.float32), 0.5, done, False, self.info(costs[self.at - 1])


@pytest.fixture
def dataset(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))

    def write(record_infos=True, **options):
        env = minari.DataCollector(Scripted(**options), record_infos=record_infos)
        for _ in EPISODES:
            env.reset(seed=0)
            done = False
            while not done:
                _, _, done, _, _ = env.step(0)
        env.create_dataset("tests/scripted-v0", requirements=[], algorithm_name="none",
            author="none", author_email="none", code_permalink="none",
            description="none")  # fmt: skip
        env._tmp_dir.cleanup()
        return minari.load_dataset("tests/scripted-v0")

    return write


@pytest.mark.filterwarnings("ignore")  # of what a data set should say beside its data
def test_written_and_read(dataset):
    found = emcc.from_minari(dataset())
    assert found.length.tolist() == [3, 1, 4]
    assert found.cost.tolist() == [2.0, 2.0, 3.0]
    assert found.reward.tolist() == [1.5, 0.5, 2.0]
    assert found.longest_streak.tolist() == [2, 1, 2]
    mcc, starts = found.mcc_per_rollout()
    assert mcc.tolist() == [emcc.mcc([costs]) for costs in EPISODES]
    assert starts.tolist() == [0, 3, 4]
    assert emcc.from_minari(minari.load_dataset("tests/scripted-v0"), 1.0).cost_steps is not None


@pytest.mark.filterwarnings("ignore")
def test_data_without_costs_are_named(dataset):
    with pytest.raises(ValueError, match=r"episode 0 has no 'cost' in its infos \(it has \['other"):
        emcc.from_minari(dataset(cost=False))


@pytest.mark.filterwarnings("ignore")
def test_data_without_infos_are_named(dataset):
    with pytest.raises(ValueError, match=r"episode 0 has no 'cost' .* record_infos=True"):
        emcc.from_minari(dataset(record_infos=False))
