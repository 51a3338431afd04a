"""The novelty of states and the scale of rewards, by hand and against plain linear algebra."""

import numpy as np
import pytest
from small_trainings import trained
from threadpoolctl import threadpool_limits

from agents.lockstep import backend
from agents.sac.replay import FEATURES, Novelty, ReturnScale


def test_the_novelty_near_a_visited_state_and_far_away_by_hand():
    """After one visit of s, φ(t)ᵀ A⁻¹ φ(t) = 1 - k² / 2, where k = φ(s)ᵀ φ(t) is about
    exp(-d² / 2): 0.88 at half a length and 0 far away."""
    novelty = Novelty(1.0, range(40), 2)
    visited = np.zeros((1, 40, 2), np.float32)
    novelty.add(visited, np.ones(40, dtype=int))
    places = np.zeros((40, 2, 2), np.float32)
    places[:, 0, 0], places[:, 1, 1] = 0.5, 20.0
    near, far = novelty.of(places).mean(axis=0)
    k = np.exp(-(0.5**2) / 2)
    assert near == pytest.approx(np.sqrt(1 - k**2 / 2), abs=0.02)
    # The squared mean cosine of 64 random angles is 1 / 128 on average.
    assert far == pytest.approx(1.0, abs=0.01)


def test_the_novelty_against_the_solution_of_a_linear_system():
    """The features are computed here from the drawn frequencies, in float64."""
    rng = np.random.default_rng(1)
    novelty = Novelty(0.7, [5, 6], 3)
    states = rng.normal(size=(30, 2, 3)).astype(np.float32)
    length = np.array([30, 12])
    novelty.add(states, length)
    found = novelty.of(states.transpose(1, 0, 2))
    for run in range(2):
        angle = states[:, run].astype(float) @ novelty._frequencies[run].astype(float)
        features = np.exp(1j * angle) / np.sqrt(FEATURES / 2)
        features = np.concatenate([features.real, features.imag], axis=1)
        counted = features[: length[run]]
        solved = np.linalg.solve(np.eye(FEATURES) + counted.T @ counted, features.T)
        expected = np.sqrt((features * solved.T).sum(axis=1))
        np.testing.assert_allclose(found[run], expected, rtol=1e-3)


def test_inputs_that_only_critics_have_do_not_count():
    novelty = Novelty(1.0, [0], 2)
    states = np.random.default_rng(3).normal(size=(20, 1, 3)).astype(np.float32)
    novelty.add(states, np.array([20]))
    of_all = novelty.of(states.transpose(1, 0, 2))
    np.testing.assert_array_equal(of_all, novelty.of(states.transpose(1, 0, 2)[..., :2].copy()))


def test_the_number_of_threads_does_not_matter():
    """The inverse is the same bit for bit, though NumPy's own inverse depends on the threads."""
    found = set()
    for threads in (1, 2):
        with backend.restored(), threadpool_limits(threads):
            backend.configure("numpy")
            novelty, rng = Novelty(2.0, range(10), 2), np.random.default_rng(0)
            for k in range(12):
                states = rng.normal(size=(50, 10, 2)).astype(np.float32)
                novelty.add(states, np.full(10, 50))
                found.add((k, novelty._inverse.tobytes()))
    assert len(found) == 12


def test_the_bonus_is_added_to_the_rewards_of_batches_alone():
    """The replay keeps the plain rewards."""
    it = trained("sac-lb", "Circle2D-1-v0", steps=300, novelty_bonus=3.0, random_steps=100)
    learner = it.learner
    index = np.tile(np.arange(32), (2, 1))
    plain = learner._replay.gather(index)
    with_bonus = learner._as_learned(plain)
    novelty = learner._novelty.of(plain.next_observation)
    np.testing.assert_allclose(with_bonus.reward, plain.reward + 3.0 * novelty, rtol=1e-6)
    assert (plain.reward <= 0).all()
    assert novelty.max() > 5 * novelty.min() / 4


def test_the_scale_of_rewards_is_that_of_all_discounted_returns():
    """By the definition, return by return; a run without steps keeps its scale."""
    rng = np.random.default_rng(4)
    scale, returns = ReturnScale(2, 0.9), [[], []]
    for length in ([5, 3], [4, 0], [1, 6]):
        reward = rng.normal(3.0, 2.0, size=(6, 2))
        scale.add(reward, np.array(length))
        for run, steps in enumerate(length):
            for t in range(steps):
                discounted = [0.9 ** (t - k) * reward[k, run] for k in range(t + 1)]
                returns[run].append(sum(discounted))
    learned = np.array([[1.0, -2.0, 1e4], [1.0, -2.0, -1e4]], np.float32)
    deviation = np.array([[np.std(returns[0])], [np.std(returns[1])]])
    expected = np.clip(learned / deviation, -10, 10)
    np.testing.assert_allclose(scale.of(learned), expected, rtol=1e-6)


def test_batches_are_scaled_and_the_scale_is_in_the_checkpoint():
    it = trained("sac-lag", "Circle2D-1-v0", steps=300, reward_scale="running", random_steps=100)
    learner = it.learner
    plain = learner._replay.gather(np.tile(np.arange(32), (2, 1)))
    scaled = learner._as_learned(plain).reward
    ratio = plain.reward / scaled
    np.testing.assert_allclose(ratio, ratio[:, :1].repeat(32, axis=1), rtol=1e-5)
    again = ReturnScale(2, 0.99)
    again.load_state_dict({"moments": learner.state_dict()["scale.moments"]})
    np.testing.assert_array_equal(again.of(plain.reward), scaled)
