"""The replay against a plain list of transitions."""

import numpy as np
import pytest

from agents.lockstep.rollout import Rollout
from agents.sac.replay import Replay


def random_rollout(rng, steps, lengths):
    def numbers(*shape):
        return rng.normal(size=(steps, len(lengths), *shape)).astype(np.float32)

    flags = rng.random((2, steps, len(lengths))) < 0.2
    columns = (numbers(3), numbers(2), numbers(), numbers(2), numbers(3), *flags)
    return Rollout(*columns, np.array(lengths), np.full(len(lengths), ""))


class Kept(list):
    """The first rows of a run, and behind them the last: a list that forgets in its middle."""

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
                held[run].append(
                    (
                        *rollout.observation[t, run],
                        *rollout.action[t, run],
                        rollout.reward[t, run],
                        *rollout.cost[t, run],
                        *rollout.next_observation[t, run],
                        float(rollout.terminated[t, run]),
                        float(rollout.truncated[t, run]),
                    )
                )
    return held


def rows(batch):
    batch = batch._replace(cost=batch.cost.mT)
    columns = [c if c.dim() == 3 else c[..., None] for c in batch]
    return np.concatenate([c.numpy() for c in columns], axis=-1)


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
        expected = {tuple(np.float32(v) for v in row) for row in held[run]}
        assert found <= expected
        if smallest == len(held[run]):
            assert found == expected
        first = rows(replay.gather(everything))[run, :kept]
        np.testing.assert_array_equal(first, np.array(held[run][:kept], np.float32).reshape(-1, 13))


def test_restore():
    replay, other = Replay(2, 50, 3, 2, 2), Replay(2, 50, 3, 2, 2)
    fill(replay, 50)
    other.load_state_dict({k: v.copy() for k, v in replay.state_dict().items()})
    index = np.random.default_rng(1).integers(replay.size.min(), size=(2, 64))
    np.testing.assert_array_equal(rows(replay.gather(index)), rows(other.gather(index)))
    np.testing.assert_array_equal(replay.stored, other.stored)
