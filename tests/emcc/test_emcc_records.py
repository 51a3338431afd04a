"""EpisodeRecords: checks, MCC of rollouts and windows, files, and merging."""

import copy
import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emcc import CostRecorder, EpisodeRecords, count_streaks, longest_streaks

HEADER = "rollout,start_step,length,return,cost,longest_streak,cost_steps,streaks"


def records(**changes):
    columns = {"rollout": [3, 0, 3], "start_step": [50, 0, 40], "length": [10, 40, 20]}
    columns |= {"reward": [-1.5, 2.0, 0.1], "cost": [4.0, 8.0, 0.0], "longest_streak": [4, 8, 0]}
    columns |= {"cost_steps": [4, 10, 0], "streaks": [1, 2, 0]}
    return EpisodeRecords(**{**columns, **changes})


def test_mcc_per_rollout_is_in_the_order_of_ids():
    mcc_values, start_steps = records().mcc_per_rollout()
    assert mcc_values.tolist() == [8 / 40, 4 / 10]
    assert start_steps.tolist() == [0, 40]  # rollout 3 starts with its earlier trajectory
    assert records().total_steps == 70


def test_arrays_are_copies_and_read_only():
    length = np.array([10, 40, 20])
    kept = records(length=length)
    length[0] = 99
    assert kept.length.tolist() == [10, 40, 20]
    for again in (kept, copy.deepcopy(kept), pickle.loads(pickle.dumps(kept))):
        assert bits(again) == bits(kept)
        with pytest.raises(ValueError, match="read-only"):
            again.length[0] = 1


finite = st.floats(allow_nan=False, allow_infinity=False)
rows = st.tuples(
    st.integers(0, 2**62), st.integers(0, 2**62), st.integers(5, 2**40), finite,
    st.floats(0, allow_infinity=False), *[st.just(k) for k in (3, 4, 2)],
)  # fmt: skip


def bits(of):
    return [
        None if array is None else (array.dtype, array.tobytes()) for array in vars(of).values()
    ]


@given(st.lists(rows, max_size=20), st.sampled_from([6, 8]))
def test_save_and_load_give_the_same_bits(tmp_path_factory, table, count):
    """With all eight columns, and with the six that remain without counts of streaks."""
    folder = tmp_path_factory.getbasetemp() / "records"
    folder.mkdir(exist_ok=True)
    columns = list(zip(*table, strict=True)) or [[]] * 8
    before = EpisodeRecords(*columns[:count])
    before.save(folder / "a.csv")
    after = EpisodeRecords.load(folder / "a.csv")
    assert bits(before) == bits(after)
    after.save(folder / "b.csv")
    assert (folder / "a.csv").read_bytes() == (folder / "b.csv").read_bytes()
    assert sorted(path.name for path in folder.iterdir()) == ["a.csv", "b.csv"]


@pytest.mark.parametrize("length", range(1, 6))
def test_counts_that_no_trajectory_can_have_are_refused(length):
    """Against all sequences of cost steps of that length; every other count is accepted."""
    possible = set()
    for unsafe in itertools.product((0, 1), repeat=length):
        counts = count_streaks(unsafe, [length])
        possible.add((longest_streaks(unsafe, [length])[0], *(of[0] for of in counts)))
    for given_counts in itertools.product(range(length + 2), repeat=3):
        if given_counts in possible:
            records_of(length, *given_counts)
        else:
            with pytest.raises(ValueError, match=r"longest_streak|cost_steps|streaks"):
                records_of(length, *given_counts)


def records_of(length, longest, cost_steps, streaks):
    row = (0, 0, length, 0.0, 1.0, longest, cost_steps, streaks)
    return EpisodeRecords(*([value] for value in row))


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "r.csv"
    records().save(path)
    before = path.read_bytes()

    def fail(*_):
        raise OSError("disk")

    monkeypatch.setattr("emcc.records.os.replace", fail)
    with pytest.raises(OSError, match="disk"):
        records(length=[11, 40, 20]).save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@given(st.lists(st.lists(st.booleans(), min_size=1, max_size=9), min_size=1, max_size=9))
def test_costs_of_each_trajectory_or_joined_are_the_same(costs):
    lengths, joined = [len(of) for of in costs], [cost for of in costs for cost in of]
    rewards = np.arange(len(joined)) / 8
    expected = EpisodeRecords.from_costs(joined, lengths, rewards).to_csv()
    split = np.split(rewards, np.cumsum(lengths)[:-1])
    arrays = tuple(np.array(of) for of in costs)
    for given_ in (
        *((costs, None, split), (arrays, None, rewards)),
        *((arrays, lengths, split), (joined, lengths, split)),
    ):
        assert EpisodeRecords.from_costs(*given_).to_csv() == expected


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 1], [[1]]],), r"costs of trajectory 1 must be 1-D, got shape \(1, 1\)"),
        (([[0, 1], [1, 0]], [2, 1]), "lengths must equal the lengths of the arrays in costs"),
        (([[0, 1], [1]], None, [[1], [2, 3]]), "lengths must equal .* of the arrays in rewards"),
        (([[0, 1], [1]], None, [1, 2]), r"3 costs, but rewards have shape \(2,\)"),
    ],
)
def test_arrays_that_do_not_fit_each_other_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        EpisodeRecords.from_costs(*arguments)


BAD_ROWS = {
    "length 0": ({"length": [10, 40, 0]}, "length .* got 0 at index 2"),
    "streak": ({"longest_streak": [4, 41, 0]}, "40 steps cannot have longest_streak 41"),
    "NaN": ({"reward": [0, np.nan, 0]}, "return .* got nan at index 1"),
    "cost": ({"cost": [0, 0, -2.0]}, "cost .* got -2.0 at index 2"),
    "lengths": ({"cost": [1.0]}, r"1-D and of one length, got shapes \[\(1,\), \(3,\)\]"),
    "fraction": ({"length": [10, 40.5, 20]}, "length must be whole numbers .* got 40.5"),
}


@pytest.mark.parametrize(("changes", "message"), BAD_ROWS.values(), ids=BAD_ROWS)
def test_bad_rows_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        records(**changes)


GOOD_ROW = "0,0,10,-1.5,4.0,4,4,1"
BAD_FILES = {
    "columns": ("start_step,length,cost,longest_streak\n0,1,0,0\n", "columns rollout are missing"),
    "fields": (f"{HEADER}\n{GOOD_ROW}\n0,0,10\n", "line 3: 3 fields, not 8"),
    "fraction": (f"{HEADER}\n0,0.5,1,0.0,0.0,0,0,0\n", "line 2, column start_step: '0.5' is not"),
    "cut off": (f"{HEADER}\n{GOOD_ROW}", "the last line is cut off"),
    "huge": (f"{HEADER}\n0,0,{10**30},0.0,0.0,0,0,0\n", "length must be .* integer"),
}


@pytest.mark.parametrize(("text", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_damaged_files_are_named_with_the_place(tmp_path, text, message):
    path = tmp_path / "damaged.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        EpisodeRecords.load(path)
    assert str(path) in str(error.value)


COLUMNS = ("start_step", "length", "reward", "cost", "longest_streak", "cost_steps", "streaks")


def play(rollout="episode", envs=3, steps=200):
    """Give the same steps to one recorder of all environments and to one recorder for each."""
    rng = np.random.default_rng(0)
    together = CostRecorder(envs, rollout if rollout == "episode" else envs * rollout)
    apart = [CostRecorder(1, rollout) for _ in range(envs)]
    for _ in range(steps):
        cost, reward = (rng.random(envs) < 0.5) * 1.0, rng.random(envs)
        done = rng.random(envs) < 0.1
        together.step(cost, reward, done)
        for env, recorder in enumerate(apart):
            recorder.step(cost[env : env + 1], reward[env : env + 1], done[env : env + 1])
    return together.records, [recorder.records for recorder in apart]


def test_merged_environments_equal_one_recorder_of_all():
    together, apart = play()
    merged = EpisodeRecords.merge(apart, interleaved=True)
    for name in COLUMNS:
        assert getattr(merged, name).tolist() == getattr(together, name).tolist()
    together, apart = play(rollout=32)
    merged = EpisodeRecords.merge(apart, shared_rollouts=True)
    assert merged.rollout.tolist() == together.rollout.tolist()
    ours, theirs = (of.mcc_per_rollout() for of in (merged, together))
    assert [column.tolist() for column in ours] == [column.tolist() for column in theirs]
    by_env = EpisodeRecords.merge(apart)
    assert by_env.emcc(alpha=1) < merged.emcc(alpha=1)  # maxima over fewer trajectories


def test_sessions_one_after_another():
    first = EpisodeRecords([0, 1], [0, 3], [3, 2], [1, 2], [1, 0], [1, 0], [1, 0], [1, 0])
    second = EpisodeRecords([0, 0], [0, 4], [4, 1], [3, 4], [2, 1], [2, 1], [2, 1], [1, 1])
    merged = EpisodeRecords.merge([first, second], interleaved=False)
    assert merged.rollout.tolist() == [0, 1, 2, 2]
    assert merged.start_step.tolist() == [0, 3, 5, 9]
    assert merged.reward.tolist() == [1, 2, 3, 4]


def test_bad_input_of_merge_is_named():
    with pytest.raises(ValueError, match="no records to merge"):
        EpisodeRecords.merge([])
    with pytest.raises(TypeError, match="must be EpisodeRecords, got CostRecorder"):
        EpisodeRecords.merge([CostRecorder(1)])  # pyright: ignore[reportArgumentType]
    one = EpisodeRecords([0], [2], [3], [0], [1], [1])
    with pytest.raises(ValueError, match="shared_rollouts needs interleaved"):
        EpisodeRecords.merge([one], interleaved=False, shared_rollouts=True)


def test_merging_with_nothing_finished_and_with_columns_that_some_lack():
    old = EpisodeRecords([0], [0], [3], [0], [1], [1])
    empty = EpisodeRecords(*[[]] * 8)
    one = EpisodeRecords([0], [2], [3], [0], [1], [1], [1], [1])
    assert EpisodeRecords.merge([empty, one]).start_step.tolist() == [4]
    assert EpisodeRecords.merge([empty, one], interleaved=False).start_step.tolist() == [2]
    assert len(EpisodeRecords.merge([empty, empty])) == 0
    merged = EpisodeRecords.merge([one, old])
    assert (len(merged), merged.cost_steps, merged.streaks) == (2, None, None)


def grouped(streaks, lengths, of):
    """Return the MCC of each group of trajectories. of: their groups; None drops a trajectory."""
    groups = {}
    for streak, length, group in zip(streaks, lengths, of, strict=True):
        if group is not None:
            groups[group] = max(groups.get(group, 0), streak / length)
    return list(groups.values())


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9)), min_size=1, max_size=40),
    st.integers(1, 12),
    st.randoms(use_true_random=False),
)
def test_windows_by_hand(trajectories, size, random):
    """Windows of `size` trajectories and of `size` steps, whatever the order of the rows; a window
    starts where its first trajectory does."""
    streaks, lengths = zip(*((min(s, n), n) for s, n in trajectories), strict=True)
    starts = np.cumsum(lengths) - lengths
    rows = random.sample(range(len(lengths)), len(lengths))
    ids = [random.randrange(5) for _ in rows]
    records = EpisodeRecords(
        ids,
        starts[rows],
        np.array(lengths)[rows],
        *np.zeros((2, len(rows))),
        np.array(streaks)[rows],
    )
    count, total = len(lengths) // size, sum(lengths)
    of_episodes = [k // size if k // size < count else None for k in range(len(lengths))]
    of_steps = [int(s) // size if (s // size + 1) * size <= total else None for s in starts]
    for of, how in ((of_episodes, {"window": size}), (of_steps, {"window_steps": size})):
        expected = grouped(streaks, lengths, of)
        found, begin = records.windows(**how).mcc_per_rollout()
        assert found.tolist() == expected
        firsts = dict(zip(of[::-1], starts[::-1].tolist(), strict=True))
        assert begin.tolist() == [firsts[k] for k in dict.fromkeys(of) if k is not None]
        if expected:
            assert records.emcc(1.0, **how) == pytest.approx(np.mean(expected))
        else:
            with pytest.raises(ValueError, match=f"no window of {size} "):
                records.emcc(**how)


def test_windows_make_rollouts_of_different_size_comparable():
    """The same 90 episodes, with one and with ten episodes per rollout."""
    alone = EpisodeRecords.from_costs([np.arange(10) < k % 7 for k in range(90)])
    tens = replace(alone, rollout=np.arange(90) // 10)
    assert alone.emcc_by_part(1.0) != tens.emcc_by_part(1.0)
    assert alone.emcc_by_part(1.0, window=10) == tens.emcc_by_part(1.0)
    assert alone.emcc_by_part(window_steps=100) == tens.emcc_by_part(window=10)
    assert tens.emcc_by_part(1.0, window=1) == alone.emcc_by_part(1.0)
    assert alone.windows() is alone
    for how in ({"window": 0}, {"window_steps": 0}, {"window": 2, "window_steps": 2}):
        with pytest.raises(ValueError, match="window"):
            alone.emcc(**how)
