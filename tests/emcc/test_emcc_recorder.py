"""CostRecorder: takes steps, gives trajectories, and needs no gymnasium."""

import copy

import numpy as np
import pytest
from written import rows

from emcc import CostRecorder, longest_streak


def feed(recorder, costs, done_at=()):
    for index, cost in enumerate(costs, start=1):
        recorder.step([cost], [0.5], [index in done_at])


@pytest.mark.parametrize("rollout", ["episode", 4, "manual"])
def test_a_snapshot_equals_the_records_after_end_rollout_and_cuts_nothing(rollout):
    recorder, watched = CostRecorder(2, rollout), CostRecorder(2, rollout)
    rng = np.random.default_rng(0)
    for count in range(60):
        step = rng.integers(0, 2, 2), rng.integers(0, 5, 2), rng.random(2) < 0.2
        recorder.step(*step)
        watched.step(*step)
        ended = copy.deepcopy(recorder)
        ended.end_rollout()
        once = ended.records.to_csv()
        ended.end_rollout()  # a second call adds nothing
        assert watched.snapshot.to_csv() == once == ended.records.to_csv()
        assert watched.snapshot.total_steps == 2 * (count + 1)
    assert watched.records.to_csv() == recorder.records.to_csv()


def test_rollouts_of_n_steps_cut_the_running_episode():
    """Episodes have 5 steps and rollouts 4: a streak across the cut becomes two streaks."""
    recorder = CostRecorder(1, rollout=4)
    feed(recorder, [0, 1, 1, 1, 1, 0, 0, 1, 1, 1], done_at=(5, 10))
    expected = [(0, 0, 4, 3.0, 3), (1, 4, 1, 1.0, 1), (1, 5, 3, 1.0, 1), (2, 8, 2, 2.0, 2)]
    assert rows(recorder) == expected


def test_steps_are_counted_over_all_environments():
    recorder = CostRecorder(2, rollout=5)
    for done in ([False, False], [True, False], [False, False]):
        recorder.step([1, 0], [0, 0], done)
    assert recorder.steps == 6  # a rollout ends with the vector step that reaches 5
    assert rows(recorder) == [(0, 0, 2, 2.0, 2), (0, 4, 1, 1.0, 1), (0, 0, 3, 0.0, 0)]


def test_random_steps_against_episodes_collected_by_hand():
    """Three environments. An inactive one takes no step: its streak goes on after it, and its cost
    and end are ignored."""
    rng = np.random.default_rng(0)
    recorder = CostRecorder(3, threshold=0.5)
    episodes, running = [], [[], [], []]
    for _ in range(300):
        costs, done, active = rng.random(3), rng.random(3) < 0.1, rng.random(3) < 0.8
        recorder.step(np.where(active, costs, np.nan), np.zeros(3), done, active)
        for index in np.flatnonzero(active):
            running[index].append(costs[index])
            if done[index]:
                episodes.append(running[index])
                running[index] = []
    kept = recorder.records
    assert recorder.steps == kept.total_steps + sum(map(len, running))
    assert kept.longest_streak.tolist() == [longest_streak(costs, 0.5) for costs in episodes]
    assert kept.length.tolist() == [len(costs) for costs in episodes]
    assert kept.cost == pytest.approx([sum(costs) for costs in episodes])
    assert kept.rollout.tolist() == list(range(len(episodes)))


BAD = {
    "shape": (([0.0], [0, 0], [False] * 2), r"cost must have shape \(2,\), got \(1,\)"),
    "NaN": (([0, np.nan], [0, 0], [False] * 2), "cost of the environments .* nan at index 1"),
    "negative": (([0, -1], [0, 0], [False] * 2), "cost of the environments .* -1.0 at index 1"),
    "reward": (([0, 0], [np.inf, 0], [False] * 2), "reward of the environments .* inf at index 0"),
    "done": (([0, 0], [0, 0], True), "must have shape"),
    "no end": (([0, 0], [0, 0], [0, np.nan]), "must be True or False"),
}


@pytest.mark.parametrize(("step", "message"), BAD.values(), ids=BAD)
def test_bad_steps_are_named(step, message):
    with pytest.raises(ValueError, match=message):
        CostRecorder(2).step(*step)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="must be 'episode', 'manual' or steps, got 'epoch'"):
        CostRecorder(1, "epoch")
    with pytest.raises(ValueError, match="num_envs must be >= 1, got 0"):
        CostRecorder(0)


def test_a_rollout_that_ends_with_its_episode_leaves_no_empty_piece():
    recorder = CostRecorder(1, rollout=2)
    feed(recorder, [1, 1, 1, 1], done_at=(2, 4))
    assert rows(recorder) == [(0, 0, 2, 2.0, 2), (1, 2, 2, 2.0, 2)]
