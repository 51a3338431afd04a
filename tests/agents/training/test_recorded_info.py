"""Numbers from a step's info: those that a task has recorded, and a second cost with records,
measures and evaluations of its own."""

import re
import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from small_runs import SAC, TRPO, edit_results, steps_of
from toys import Pressed, Walk

import agents
import emcc
from agents.cli.main import main
from agents.errors import UserError
from agents.reporting.tables import recorded_table
from agents.results import recorded
from agents.results.archive import write_archive
from agents.results.reading import read_groups
from agents.results.recorded import two_digits
from emcc import longest_streak
from emcc.records import unpack_costs

OPTIONS = TRPO | {"seeds": (3, 4), "steps": 300}


def unpacked(folder, name):
    with np.load(folder / "results.npz") as arrays:
        return unpack_costs(arrays, f"Pressed-v0/3/info/{name}/")


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    out = tmp_path_factory.mktemp("pressed") / "x"
    return agents.train("trpo-lag", ("Pressed-v0", "Walk-v0"), out=out, **OPTIONS)


def test_every_step_is_recorded(pressed):
    """Beside a task that records nothing. A step with x > 0.5 costs 1, so that both columns must be
    of the same step."""
    x, beyond, costs = (
        steps_of(pressed.folder, "Pressed-v0/3", n) for n in ("info/x", "info/beyond", "costs/cost")
    )
    assert x.dtype == beyond.dtype == np.float32
    assert len(x) == steps_of(pressed.folder, "Pressed-v0/3", "length").sum()
    np.testing.assert_array_equal(x > 0.5, costs)
    np.testing.assert_allclose(beyond, np.maximum(x - 0.5, 0), atol=1e-7)
    with np.load(pressed.folder / "results.npz") as arrays:
        assert not [name for name in arrays if name.startswith("Walk") and "info" in name]
        assert arrays["Pressed-v0/info"].tolist() == [["x", "m"], ["beyond", "m"]]
    for name, values in (("x", x), ("beyond", beyond)):
        np.testing.assert_allclose(unpacked(pressed.folder, name), values, rtol=2**-16)


def test_another_vectorization_and_a_resumed_training_record_the_same(pressed, tmp_path):
    more = OPTIONS | {"vectorization": "async", "checkpoint_every": 100}
    tasks = ("Pressed-v0", "Walk-v0")
    stop = {"on_epoch": lambda epoch: epoch.runs["Pressed-v0", 3]["step"] < 150}
    agents.train("trpo-lag", tasks, out=tmp_path / "x", **more, **stop)
    agents.resume(tmp_path / "x")
    other = (tmp_path / "x" / "results.npz").read_bytes()
    assert other == (pressed.folder / "results.npz").read_bytes()


def test_a_report_leaves_out_damaged_recorded_numbers_alone(pressed, tmp_path):
    folder = shutil.copytree(pressed.folder, tmp_path / "x")
    edit_results(folder, **{"Pressed-v0__3__info__x__unsafe": np.zeros(1, np.uint8)})
    assert main(["report", str(folder)]) == 1
    words = (folder / "report.md").read_text()
    note = "left out: numbers recorded on Pressed-v0 of x: x/results.npz is damaged: "
    assert note in words
    assert "## Pressed-v0: recorded at each step" not in words
    assert "## Pressed-v0: panel of cost measures" in words


def test_recording_changes_no_number_and_an_archive_keeps_it(tmp_path, monkeypatch):
    more = SAC | {"seeds": 3, "steps": 200}
    with_it = agents.train("sac-lag", "Pressed-v0", out=tmp_path / "a", **more)
    write_archive(tmp_path / "a.zip", with_it.results)
    [kept], [own] = (read_groups([path], []) for path in (tmp_path / "a.zip", with_it.folder))
    assert "Pressed-v0/3/info/beyond/unsafe" not in kept.trainings[0].arrays
    assert str(recorded_table([kept])) == str(recorded_table([own])) != "None"
    x, beyond = (kept.runs[0].recorded(name) for name in ("x", "beyond"))
    assert x.lowest < 0 == beyond.lowest
    steps = unpacked(with_it.folder, "beyond")
    assert beyond.steps.sum() == len(steps)
    assert beyond.most.max() == steps.max()
    told = [float(f"{value:.3g}") for value in np.sort(steps[steps > 0])]
    np.testing.assert_allclose(beyond.above_0(), told, rtol=0.0101)
    for threshold in (0.0, 0.11, 0.5, 3.0, 1e-9, 1e9):
        archived, exact = (
            group.runs[0].recorded("beyond").emcc_above(threshold) for group in (kept, own)
        )
        assert archived == pytest.approx(exact)
    [windowed] = read_groups([tmp_path / "a.zip"], [], None, 2)
    above = windowed.runs[0].recorded("beyond").emcc_above
    assert {*above(0.0).values()} == {None}
    never = np.zeros(own.runs[0].records.total_steps)  # a run in which the number is always 0
    kept_of_it = recorded.packed(never, own.runs[0].records)
    for threshold in (0.0, 5.0):
        exact = recorded.of_steps(never, own.runs[0].records, None).emcc_above(threshold)
        assert recorded.unpacked(kept_of_it, "", None).emcc_above(threshold) == exact
    monkeypatch.setattr(Pressed, "recorded_info", {})
    without = agents.train("sac-lag", "Pressed-v0", out=tmp_path / "b", **more)
    with np.load(without.folder / "results.npz") as fewer:
        assert not [name for name in fewer if "info" in name]
        for name, array in fewer.items():
            np.testing.assert_array_equal(own.trainings[0].arrays[name], array)


@pytest.mark.parametrize("least", [0.00123, 0.5, 9.99, 10.0, 99.5, 1e5])
@pytest.mark.parametrize("times", [1.0, 1.7, 12.0, 3e4])
def test_thresholds_have_two_digits_and_steps_of_at_most_ten_percent(least, times):
    numbers = two_digits(least, least * times).tolist()
    assert numbers[0] == 0.0
    assert numbers[1] <= least
    assert all(number > least for number in numbers[2:])
    assert numbers[-2] < least * times <= numbers[-1]
    assert all(float(f"{number:.2g}") == number for number in numbers)
    assert all(b / a < 1.101 for a, b in pairwise(numbers[1:]))


def test_what_cannot_be_recorded_is_named(monkeypatch):
    def told(recorded, words):
        monkeypatch.setattr(Pressed, "recorded_info", recorded)
        with pytest.raises(UserError, match=words):
            agents.train("trpo-lag", "Pressed-v0", **OPTIONS)

    told({"x": "m", "depth": "m"}, r"gives no info\['depth'\]; it gives \['beyond', 'cost'")
    told(["x"], "recorded_info of .* must be units by name, got")
    far = {"cost": 0.0, "x": "far"}
    monkeypatch.setattr(Pressed, "step", lambda env, action: (*Walk.step(env, action)[:4], far))
    told({"x": "m"}, r"gives info\['x'\] = 'far', which is no number")


def test_the_table_of_recorded_numbers_by_hand(pressed):
    """Shares, percentiles and streaks of one run in each third of training, counted in loops."""
    group = next(group for group in read_groups([pressed.folder], []) if group.task == "Pressed-v0")
    one = replace(group, runs=group.runs[:1])
    table = recorded_table([one])
    assert table is not None
    beyond = unpacked(pressed.folder, "beyond")
    assert [", ".join(row.name.split(", ")[-2:]) for row in table.rows] == [
        f"beyond (m), {part}" for part in (0.33, 0.66, 0.99)
    ]  # x may be negative
    limit = float(f"{np.median(beyond[beyond > 0]):.2g}")
    records, start = group.runs[0].records, 0
    total = int(records.length.sum())  # in whole epochs, of 300 asked for
    shares: dict[float, list[list[float]]] = {0.0: [[], [], []], limit: [[], [], []]}
    for rollout in np.unique(records.rollout):
        lengths = records.length[records.rollout == rollout]
        third = int(100 * start >= 33 * total) + int(100 * start >= 66 * total)
        longest = {0.0: 0, limit: 0}
        for length in lengths:
            for threshold in longest:
                streak = longest_streak(beyond[start : start + length], threshold)
                longest[threshold] = max(longest[threshold], streak / length)
            start += int(length)
        for threshold, values in shares.items():
            values[third].append(longest[threshold])
    for k, row in enumerate(table.rows):
        share, median, most, highest, above, high = (cell.value for cell in row.numbers)
        first, last = -(-33 * k * total // 100), -(-33 * (k + 1) * total // 100)
        last += k == 2 and 99 * total % 100 == 0  # the last third includes its end
        part = beyond[first:last]
        assert share == pytest.approx((part > 0).mean())
        told = np.percentile(part[part > 0], [50, 90, 100])
        np.testing.assert_allclose([median, most], told[:2], rtol=0.005)
        assert highest == told[2]
        assert above == pytest.approx(emcc.emcc(shares[0.0][k], 0.1))
        assert high == pytest.approx(emcc.emcc(shares[limit][k], 0.1))


BOTH = {"seeds": (0, 1), "steps": 300, "costs": ("cost", "cost_2")}


@pytest.fixture(scope="module", params=["trpo-lag", "sac-lag"])
def runs(request, tmp_path_factory):
    own = TRPO if request.param == "trpo-lag" else SAC
    out = tmp_path_factory.mktemp("costs") / "x"
    return agents.train(request.param, "TwoCosts-v0", out=out, **BOTH, **own)


@pytest.mark.parametrize("cost", ["cost", "cost_2"])
def test_records_and_measures_of_each_cost(runs, cost):
    records = runs.records_of(cost)
    [group] = [group for group in runs.results if group.cost == cost]
    assert group.apart == ("" if cost == "cost" else "cost_2")
    for run in group.runs:
        names = (f"costs/{cost}", "length")
        costs, lengths = (steps_of(runs.folder, f"TwoCosts-v0/{run.seed}", n) for n in names)
        assert set(np.unique(costs)) == ({0.0, 1.0} if cost == "cost" else {0.0, 0.25})
        ours = records[runs.folder, run.seed]
        ends = np.cumsum(lengths)
        episodes = np.split(costs, ends[:-1])
        np.testing.assert_array_equal(ours.cost, [episode.sum() for episode in episodes])
        streaks = [emcc.longest_streak(episode) for episode in episodes]
        np.testing.assert_array_equal(ours.longest_streak, streaks)
        np.testing.assert_array_equal(run.records.cost, ours.cost)
        per_rollout = len(lengths) // (ours.rollout[-1] + 1)
        rollouts = [episodes[k : k + per_rollout] for k in range(0, len(episodes), per_rollout)]
        starts = (ends - lengths)[::per_rollout]
        expected = emcc.emcc_by_part([emcc.mcc(r) for r in rollouts], starts, 300)
        for part, value in expected.items():
            assert run.measures[f"EMCC_{part:.2f}"] == pytest.approx(value)
        assert run.measures["cost_rate"] == pytest.approx(costs.mean())


def test_evaluations_of_each_cost(runs):
    found = {g.cost: [run.evaluation["deterministic"] for run in g.runs] for g in runs.results}
    with np.load(runs.folder / "results.npz") as arrays:
        for k, cost in enumerate(("cost", "cost_2")):
            for seed, evaluation in enumerate(found[cost]):
                own = arrays[f"TwoCosts-v0/{seed}/evaluation/deterministic/costs"][:, k]
                np.testing.assert_array_equal(evaluation["cost_returns"], own)
                assert evaluation["J_C"] == own.mean()
    policy = agents.load_policy(runs, seed=1)
    first = agents.evaluate(policy, episodes=3).costs  # by default the first cost of the training
    both = [agents.evaluate(policy, episodes=3, cost=cost).costs for cost in ("cost", "cost_2")]
    np.testing.assert_array_equal(first, both[("cost", "cost_2").index(runs.config.costs[0])])
    assert not np.array_equal(*both)
    assert set(np.unique(both[1] % 0.25)) == {0.0}


def test_a_second_cost_changes_nothing_that_limits_the_first(runs, tmp_path):
    config = runs.config
    own = BOTH | {"costs": "cost"} | (TRPO if config.algorithm == "trpo-lag" else SAC)
    alone = agents.train(config.algorithm, "TwoCosts-v0", out=tmp_path / "x", **own)
    first = [run.measures for group in runs.results if group.cost == "cost" for run in group.runs]
    assert [run.measures for run in alone.results[0].runs] == first
    assert list(config.limits) == ["cost"]


def test_epochs_and_frames_name_further_costs():
    epochs = []
    runs = agents.train("cpo", "TwoCosts-v0", on_epoch=epochs.append, **BOTH, **TRPO)
    with pytest.raises(UserError, match=r"has no cost 'cost_3': cost, cost_2$"):
        runs.records_of("cost_3")
    first = runs.records_of("cost_2")[runs.folder, 1].cost[:2].mean()
    assert epochs[0].runs[1]["cost_2"] == pytest.approx(first)
    frame = runs.to_pandas("episodes")
    column = frame[frame.seed == 1]["cost_2"].to_numpy()
    np.testing.assert_array_equal(column, runs.records_of("cost_2")[runs.folder, 1].cost)


def test_a_first_cost_of_another_name_stands_beside_one_named_cost():
    epochs, more = [], BOTH | {"costs": ("cost_2", "cost"), "evaluate_every": 100}
    runs = agents.train("cpo", "TwoCosts-v0", on_epoch=epochs.append, **more, **TRPO)
    frames = {rows: runs.to_pandas(rows) for rows in ("episodes", "evaluations")}
    of_run_1 = {rows: frame[frame.seed == 1] for rows, frame in frames.items()}
    for cost, multiple in (("cost", 1.0), ("cost_2", 0.25)):
        records = runs.records_of(cost)[runs.folder, 1]
        assert epochs[0].runs[1][cost] == pytest.approx(records.cost[:2].mean())
        np.testing.assert_array_equal(of_run_1["episodes"][cost], records.cost)
        assert set(of_run_1["evaluations"][cost] % multiple) == {0.0}
    first = runs.records_of("cost_2")[runs.folder, 1]
    np.testing.assert_array_equal(of_run_1["episodes"]["longest_streak"], first.longest_streak)


@pytest.mark.parametrize("vectorization", ["auto", "async"])
def test_a_cost_that_the_task_lacks_is_refused(tmp_path, vectorization):
    for task in ("Walk-v0", "Circle2D-1-v0"):
        with pytest.raises(UserError, match=rf"task '{task}'.* gives no info\['cost_2'\]"):
            agents.train("cpo", task, out=tmp_path / "x", vectorization=vectorization, **BOTH)
        assert not (tmp_path / "x").exists()
    for costs, words in ((("cost", "cost"), "different values"), ((), r"costs .*, got \(\)")):
        with pytest.raises(UserError, match=words):
            agents.train("cpo", "Walk-v0", out=tmp_path / "x", **BOTH | {"costs": costs})
    assert not (tmp_path / "x").exists()


def test_a_table_says_that_all_actions_were_random_and_names_the_cost(tmp_path):
    more = {"seeds": 0, "steps": 100, "costs": ("cost_2",), "random_steps": 200}
    table = agents.train("sac-lag", "TwoCosts-v0", out=tmp_path / "x", **more).table()
    assert re.search(r"cost_2\): all its training's actions are random", table)
