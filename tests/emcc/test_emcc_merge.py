"""Records from costs, and records of several recorders put together."""

import numpy as np
import pytest

from emcc import CostRecorder, EpisodeRecords

COLUMNS = ("start_step", "length", "reward", "cost", "longest_streak", "cost_steps", "streaks")


def play(seed, envs=3, steps=200, rollout="episode"):
    """The same steps in one recorder of all environments, and in one for each."""
    rng = np.random.default_rng(seed)
    together = CostRecorder(envs, rollout if rollout == "episode" else envs * rollout)
    apart = [CostRecorder(1, rollout) for _ in range(envs)]
    for _ in range(steps):
        cost, reward = (rng.random(envs) < 0.5) * 1.0, rng.random(envs)
        done = rng.random(envs) < 0.1
        together.step(cost, reward, done)
        for env, recorder in enumerate(apart):
            recorder.step(cost[env : env + 1], reward[env : env + 1], done[env : env + 1])
    return together.records, [recorder.records for recorder in apart]


@pytest.mark.parametrize("seed", range(5))
def test_interleaved_environments_are_as_recorded_together(seed):
    together, apart = play(seed)
    merged = EpisodeRecords.merge(apart, interleaved=True)
    for name in COLUMNS:
        assert getattr(merged, name).tolist() == getattr(together, name).tolist()
    assert merged.emcc_by_part(total_steps=600) == together.emcc_by_part(total_steps=600)


@pytest.mark.parametrize("seed", range(5))
def test_rollouts_that_environments_share(seed):
    together, apart = play(seed, rollout=32)
    merged = EpisodeRecords.merge(apart, shared_rollouts=True)
    assert merged.rollout.tolist() == together.rollout.tolist()
    ours, theirs = (of.mcc_per_rollout() for of in (merged, together))
    assert [column.tolist() for column in ours] == [column.tolist() for column in theirs]
    by_env = EpisodeRecords.merge(apart)
    assert by_env.emcc(alpha=1) < merged.emcc(alpha=1)  # a maximum over fewer trajectories


def test_sessions_one_after_another():
    first = EpisodeRecords([0, 1], [0, 3], [3, 2], [1, 2], [1, 0], [1, 0], [1, 0], [1, 0])
    second = EpisodeRecords([0, 0], [0, 4], [4, 1], [3, 4], [2, 1], [2, 1], [2, 1], [1, 1])
    merged = EpisodeRecords.merge([first, second], interleaved=False)
    assert merged.rollout.tolist() == [0, 1, 2, 2]
    assert merged.start_step.tolist() == [0, 3, 5, 9]
    assert merged.reward.tolist() == [1, 2, 3, 4]


def test_columns_that_some_lack():
    old = EpisodeRecords([0], [0], [3], [0], [1], [1])
    new = EpisodeRecords([0], [0], [3], [0], [1], [1], [1], [1])
    merged = EpisodeRecords.merge([new, old])
    assert (merged.cost_steps, merged.streaks) == (None, None)
    assert len(merged) == 2


def test_mistakes_of_merging_are_named():
    with pytest.raises(ValueError, match="no records to merge"):
        EpisodeRecords.merge([])
    with pytest.raises(TypeError, match="must be EpisodeRecords, got CostRecorder"):
        EpisodeRecords.merge([CostRecorder(1)])  # pyright: ignore[reportArgumentType]
    one = EpisodeRecords([0], [2], [3], [0], [1], [1])
    with pytest.raises(ValueError, match="shared_rollouts needs interleaved"):
        EpisodeRecords.merge([one], interleaved=False, shared_rollouts=True)


def test_recent_rollouts():
    recorder = CostRecorder(2, "manual")
    for count in (3, 1, 2):
        for _ in range(count):
            recorder.step([1.0, 0.0], [0.0, 0.0], [True, False])
        recorder.end_rollout()
    assert recorder.recent(1).rollout.tolist() == [2, 2, 2]
    assert recorder.recent(2).rollout.tolist() == [1, 1, 2, 2, 2]
    assert recorder.recent(9).rollout.tolist() == recorder.records.rollout.tolist()
    assert len(CostRecorder(1).recent(3)) == 0
