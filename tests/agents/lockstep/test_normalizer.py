"""The normalisation of observations, against NumPy, PyTorch and Stable-Baselines3."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from small_trainings import small, trainer
from toys import register

import agents
from agents.lockstep.normalizer import Normalizer
from agents.training.config import TrainConfig

register()
FAMILIES = ("ppo-lag", "trpo-lag", "sac-lag")


@settings(max_examples=40, deadline=None)
@given(st.lists(st.lists(st.integers(0, 7), min_size=4, max_size=4), min_size=1, max_size=5))
def test_moments_are_those_of_all_steps_within_episodes(epochs):
    """Two runs of two episodes each, of any lengths, with a mean far from 0, where sums of squares
    would cancel."""
    rng = np.random.default_rng(1)
    normalizer, seen = Normalizer(2, 3), [[], []]
    for lengths in epochs:
        observation = rng.normal([1e3, -2.0, 0.0], [1.0, 5.0, 0.0], (7, 4, 3)).astype(np.float32)
        normalizer.count(observation, np.array(lengths))
        for episode, length in enumerate(lengths):
            seen[episode // 2] += list(observation[:length, episode].astype(float))
    for run, own in enumerate(seen):
        mean, variance = (np.mean(own, 0), np.var(own, 0)) if own else (np.zeros(3), np.ones(3))
        scale = 1 / np.sqrt(variance + 1e-8) if own else np.ones(3)
        np.testing.assert_allclose(normalizer.mean[run], mean, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(normalizer.inputs.scale[run], scale, rtol=1e-6)


def test_statistics_are_those_of_vecnormalize():
    """On the same observations; VecNormalize starts from 1e-4 of a step with mean 0, variance 1."""
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    stream = np.random.default_rng(2).normal([3.0, -1.0], [0.5, 40.0], (500, 4, 2))
    stream = stream.astype(np.float32)
    box = gym.spaces.Box(-np.inf, np.inf, (2,))

    class Replayed(gym.Env):
        observation_space, action_space = box, gym.spaces.Box(-1.0, 1.0, (1,))

        def __init__(self, k):
            self.k, self.t = k, 0

        def reset(self, *, seed=None, options=None):
            return stream[0, self.k], {}

        def step(self, action):
            self.t += 1
            return stream[self.t, self.k], 0.0, False, False, {}

    envs = vec_env.DummyVecEnv([lambda k=k: Replayed(k) for k in range(4)])
    theirs = vec_env.VecNormalize(envs, clip_obs=10.0)
    theirs.reset()
    for _ in range(499):
        theirs.step(np.zeros((4, 1)))
    ours = Normalizer(1, 2)
    ours.count(stream, np.full(4, 500))
    np.testing.assert_allclose(ours.mean[0], theirs.obs_rms.mean, rtol=1e-6)
    np.testing.assert_allclose(ours.variance[0], theirs.obs_rms.var, rtol=1e-5)
    probe = np.array([[3.2, -7.0], [900.0, 0.0]], np.float32)
    np.testing.assert_allclose(ours.inputs(probe[None])[0], theirs.normalize_obs(probe), rtol=1e-4)


@pytest.mark.parametrize("name", FAMILIES)
def test_networks_use_the_moments_of_the_epochs_before(name):
    """Actions against PyTorch's layers on observations normalised here.

    The replay keeps plain observations and normalises them when they are drawn.
    """
    own = small(name, normalize_observations=True)
    it = trainer(TrainConfig(name, ("Walk-v0",), (0, 1), 2_000, own, {"scale": (1e3, 1e-3)}))
    seen, plain_learn = [[], []], it.learner.learn

    def learn(rollout, *others):
        expected = [np.concatenate(s) if s else np.zeros((0, 2)) for s in seen]
        probe = np.random.default_rng(0).normal(0, 1e3, (2, 50, 2)).astype(np.float32)
        found = it.learner.policy()(probe, None)
        for run, own in enumerate(expected):
            mean, std = (own.mean(0), own.std(0)) if len(own) else (0.0, 1.0)
            shown = ((probe[run] - mean) / std).clip(-10, 10).astype(np.float32)
            [_, *layers] = it.learner.module(run)
            with torch.no_grad():
                by_hand = torch.nn.Sequential(*layers)(torch.from_numpy(shown)).numpy()
                by_module = it.learner.module(run)(torch.from_numpy(probe[run])).numpy()
            np.testing.assert_allclose(found[run], by_hand, atol=2e-3)
            np.testing.assert_allclose(found[run], by_module, atol=1e-5)
        metrics = plain_learn(rollout, *others)
        each = it.learner.episodes
        for k, length in enumerate(rollout.length):
            seen[k // each].append(rollout.observation[:length, k].astype(float))
        return metrics

    it.learner.learn = learn
    while not it.done:
        it.run_epoch()
    moments = it.learner.state_dict()["actor.observations"]
    for run, own in enumerate(map(np.concatenate, seen)):
        assert moments[run, 0].tolist() == [len(own)] * 2
        np.testing.assert_allclose(moments[run, 1], own.mean(0), rtol=1e-10)
    if name == "sac-lag":
        stored = it.learner._replay.gather(np.tile(np.arange(40), (2, 1))).observation
        np.testing.assert_array_equal(stored[1], np.concatenate(seen[1])[:40].astype(np.float32))
        drawn = it.learner._as_learned(it.learner._replay.gather(np.tile(np.arange(40), (2, 1))))
        shown = (stored[1] - moments[1, 1]) / np.sqrt(moments[1, 2] / moments[1, 0] + 1e-8)
        np.testing.assert_allclose(drawn.observation[1], shown.clip(-10, 10), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_policy_acts_by_the_moments_of_its_training(name, tmp_path):
    """They are frozen: evaluating the policy does not change it. The PyTorch module agrees."""
    own = {"normalize_observations": True, "steps": 400, "evaluation_episodes": 2}
    runs = agents.train(name, "Walk-v0", seeds=[5], out=tmp_path / "x", **own)
    policy = agents.load_policy(runs.folder)
    observations = np.random.default_rng(0).normal(0, 2, (200, 2)).astype(np.float32)
    first = policy(observations)
    agents.evaluate(policy, episodes=2)
    np.testing.assert_array_equal(policy(observations), first)
    with torch.no_grad():
        found = policy.to_torch()(torch.from_numpy(observations)).numpy()
    np.testing.assert_allclose(found, first, atol=1e-5)


def test_normalisation_with_an_input_scale_is_refused():
    with pytest.raises(agents.UserError, match="input_scale must be 1 with normalize_observations"):
        small("ppo-lag", normalize_observations=True, input_scale=15.0)
