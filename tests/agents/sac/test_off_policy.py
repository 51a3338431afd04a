"""The inputs of an epoch's updates: transitions from the replay, noise, and exploration."""

from dataclasses import replace

import numpy as np
import pytest
from small_trainings import trainer

from agents.errors import UserError
from agents.lockstep.noise import Purpose
from agents.lockstep.rollout import Rollout
from agents.presets import preset
from agents.sac import learner
from agents.sac.replay import Replay
from agents.training.config import TrainConfig


def training(**changes):
    hyperparameters = replace(preset("sac-lag", "Circle2D-1-v0"), **changes)
    return trainer(TrainConfig("sac-lag", ("Circle2D-1-v0",), (0, 1), 10_000, hyperparameters))


def test_a_share_of_each_batch_is_of_the_random_actions():
    """With a share of a quarter, 16 rows of 64 are drawn from the first 200 transitions, which stay
    in the replay, and the others from the last 300."""
    it = training(batch_size=64, random_steps=200, random_share=0.25, replay_size=500)
    for _ in range(4):
        it.run_epoch()
    first = it.learner._replay._rows[:, :200].copy()
    of_random_alone = np.concatenate([index.ravel() for index, _ in it.learner._draws(4)])
    assert of_random_alone.max() < 200  # as long as there are no other transitions
    for _ in range(36):
        it.run_epoch()
    np.testing.assert_array_equal(it.learner._replay._rows[:, :200], first)
    draws = np.concatenate([index for epoch in range(40) for index, _ in it.learner._draws(epoch)])
    kept, last = draws[:, :16].ravel(), draws[:, 16:].ravel()
    assert (kept.min(), kept.max()) == (0, 199)
    assert (last.min(), last.max()) == (200, 499)
    for slots, size, low in ((kept, 200, 0), (last, 300, 200)):
        mean = len(slots) / size
        counts = np.bincount(slots - low, minlength=size)
        assert counts.max() < mean + 6 * mean**0.5


def test_noise_is_fresh_and_without_a_share_every_slot_is_drawn():
    it = training(batch_size=64)
    for _ in range(40):
        it.run_epoch()
    draws = [draw for epoch in range(40) for draw in it.learner._draws(epoch)]
    slots = np.concatenate([index.ravel() for index, _ in draws])
    assert (slots.min(), slots.max()) == (0, 1999)
    assert np.bincount(slots, minlength=2000).max() < 45  # 12.8 on average
    noises = [noise for _, noises in draws[:6] for noise in noises[:2]]
    assert len({run.tobytes() for noise in noises for run in noise}) == 2 * len(noises)


@pytest.mark.parametrize("changes", [{"random_steps": 0}, {"random_steps": 50_000}])
def test_a_share_of_no_random_actions_is_refused(changes):
    with pytest.raises(UserError, match="random_share needs random_steps"):
        training(random_share=0.5, **changes)


@pytest.mark.parametrize(
    ("time_limit", "ends"),
    [("bootstrap", (False, False)), ("terminal", (True, True)), ("terminal_cost", (False, True))],
)
def test_what_ends_at_the_time_limit(time_limit, ends):
    """Whether the last of an episode's 50 steps is terminal for the return and for the cost."""
    it = training(time_limit=time_limit)
    for _ in range(2):
        it.run_epoch()
    batch = it.learner._replay.gather(np.tile(np.arange(100), (2, 1)))
    last = np.arange(100) % 50 == 49
    for column, expected in zip((batch.terminal, batch.cost_terminal), ends, strict=True):
        np.testing.assert_array_equal(column, np.tile(last & expected, (2, 1)))


def test_episodes_have_different_starts():
    it, starts = training(random_steps=0), []
    for _ in range(3):
        it.run_epoch()
        starts.append(tuple(it.learner._replay._rows[0, it.steps[0] - 50, :2]))
    assert len(set(starts)) == 3


def test_metrics_are_means_over_gradient_steps():
    """The temperature changes by at most its learning rate per step, so its mean stays near 1."""
    it = training(gradient_steps=20)
    for _ in range(6):
        it.run_epoch()
    rows, column = it.recorder.take(), it.learner.metrics.index("temperature")
    temperature = np.stack([rows[run.prefix + "updates"][:, column] for run in it.config.runs], 1)
    assert np.isnan(temperature[4]).all()
    np.testing.assert_allclose(temperature[5], 1.0, atol=20 * 3e-4 + 1e-6)


@pytest.mark.parametrize("name", ["sac-lag", "trpo-lag"])
def test_every_epoch_explores_by_other_noise(name):
    task = "Circle2D-1-v0"
    it = trainer(TrainConfig(name, (task,), (0, 1), 10_000, preset(name, task)))
    observation = np.zeros((2 * it.learner.episodes, 2), np.float32)
    taken = it.steps + 9_000  # beyond random actions
    first, again, later = (it.learner.explorer(k, taken)(observation) for k in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != later).all()


def random_rollout(rng, steps, lengths):
    def numbers(*shape):
        return rng.normal(size=(steps, len(lengths), *shape)).astype(np.float32)

    flags = rng.random((2, steps, len(lengths))) < 0.2
    columns = (numbers(3), numbers(2), numbers(), numbers(2), numbers(3), *flags)
    return Rollout(*columns, np.array(lengths), np.full(len(lengths), ""))


class Kept(list):
    """A list of a run's first `kept` rows and its last ones: those between are dropped."""

    def __init__(self, capacity, kept):
        super().__init__()
        self._capacity, self._kept = capacity, kept

    def append(self, row):
        if len(self) == self._capacity:
            del self[self._kept]
        super().append(row)


def fill(replay, capacity, epochs=9, kept=0):
    rng = np.random.default_rng(0)
    held = [Kept(capacity, kept) for _ in range(2)]
    for _ in range(epochs):
        rollout = random_rollout(rng, 5, rng.integers(0, 6, size=2))
        replay.add(rollout, rollout.terminated, rollout.truncated)
        for run, length in enumerate(rollout.length):
            for t in range(length):
                columns = [np.ravel(column[t, run]) for column in rollout[:7]]
                held[run].append(tuple(np.concatenate(columns, dtype=np.float32)))
    return held


def rows(batch):
    batch = batch._replace(cost=batch.cost.swapaxes(1, 2))
    return np.concatenate([c if c.ndim == 3 else c[..., None] for c in batch], axis=-1)


@pytest.mark.parametrize(("capacity", "kept"), [(12, 0), (12, 5), (12, 11), (100, 0), (100, 7)])
def test_holds_the_first_and_the_last_transitions(capacity, kept):
    replay = Replay(2, capacity, 3, 2, 2, kept)
    held = fill(replay, capacity, kept=kept)
    assert replay.size.tolist() == [len(h) for h in held]
    smallest = min(map(len, held))
    everything = np.tile(np.arange(smallest), (2, 1))
    for run in range(2):
        index = everything.copy()
        index[run] = np.arange(smallest)
        found = {tuple(row) for row in rows(replay.gather(index))[run]}
        expected = set(held[run])
        assert found <= expected
        if smallest == len(held[run]):
            assert found == expected
        first = rows(replay.gather(everything))[run, :kept]
        np.testing.assert_array_equal(first, np.array(held[run][:kept], np.float32).reshape(-1, 13))


def test_each_noise_has_its_stream(monkeypatch):
    drawn, used = learner.steps_of_noise, []

    def noted(draw, seeds, purpose, *more):
        used.append(purpose)
        return drawn(draw, seeds, purpose, *more)

    monkeypatch.setattr(learner, "steps_of_noise", noted)
    training().learner.explorer(0, np.zeros(2, np.int64))
    assert used == [Purpose.EXPLORATION, Purpose.RANDOM_ACTIONS]


def test_the_last_random_action():
    """The n-th action is random where random_steps = n, and none after it."""
    it = training()
    n, seen = it.learner.config.random_steps, np.zeros((2, 2), np.float32)
    last, policy = (it.learner.explorer(0, np.full(2, k)) for k in (n - 1, n))
    assert (last(seen) != policy(seen)).all()
    np.testing.assert_array_equal(last(seen), policy(seen))
