"""Numbers of the info that a task has recorded: at every step, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from small_runs import SAC, TRPO, steps_of
from toys import Pressed, Walk

import agents
import emcc
from agents.errors import UserError
from agents.reporting.tables import recorded_table
from agents.results.reading import read
from agents.training.derive import unpack_costs
from emcc import longest_streak

OPTIONS = TRPO | {"seeds": (3, 4), "steps": 300}


def unpacked(folder, name):
    with np.load(folder / "results.npz") as arrays:
        return unpack_costs(lambda key: arrays[f"Pressed-v0/3/info/{name}/{key}"], True)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    out = tmp_path_factory.mktemp("pressed") / "x"
    return agents.train("trpo-lag", ("Pressed-v0", "Walk-v0"), out=out, **OPTIONS)


def test_every_step_is_recorded(runs):
    """Beside a task that records nothing; x > 0.5 costs 1, in the same step."""
    x, beyond, costs = (
        steps_of(runs.folder, "Pressed-v0/3", n) for n in ("info/x", "info/beyond", "costs/cost")
    )
    assert x.dtype == beyond.dtype == np.float32
    assert len(x) == steps_of(runs.folder, "Pressed-v0/3", "length").sum()
    np.testing.assert_array_equal(x > 0.5, costs)
    np.testing.assert_allclose(beyond, np.maximum(x - 0.5, 0), atol=1e-7)
    with np.load(runs.folder / "results.npz") as arrays:
        assert not [name for name in arrays if name.startswith("Walk") and "info" in name]
        assert arrays["Pressed-v0/info"].tolist() == [["x", "m"], ["beyond", "m"]]
    for name, values in (("x", x), ("beyond", beyond)):
        np.testing.assert_allclose(unpacked(runs.folder, name), values, rtol=2**-16)


def test_another_vectorization_and_a_resumed_training_record_the_same(runs, tmp_path):
    more = OPTIONS | {"vectorization": "async", "checkpoint_every": 100}
    tasks = ("Pressed-v0", "Walk-v0")
    stop = {"on_epoch": lambda epoch: epoch.runs["Pressed-v0", 3]["step"] < 150}
    agents.train("trpo-lag", tasks, out=tmp_path / "x", **more, **stop)
    agents.resume(tmp_path / "x")
    other = (tmp_path / "x" / "results.npz").read_bytes()
    assert other == (runs.folder / "results.npz").read_bytes()


def test_recording_changes_no_number_and_an_archive_keeps_it(tmp_path, monkeypatch):
    more = SAC | {"seeds": 3, "steps": 200}
    with_it = agents.train("sac-lag", "Pressed-v0", out=tmp_path / "a", **more)
    agents.report(with_it, archive=tmp_path / "a.zip")
    [kept], [own] = (read([path], []) for path in (tmp_path / "a.zip", with_it.folder))
    assert kept.parts[0].arrays["Pressed-v0/3/info/x/values"].dtype == np.float32
    for name, array in own.parts[0].arrays.items():
        if "/info/" in name:
            np.testing.assert_array_equal(kept.parts[0].arrays[name], array)
    monkeypatch.setattr(Pressed, "recorded_info", {})
    without = agents.train("sac-lag", "Pressed-v0", out=tmp_path / "b", **more)
    with np.load(without.folder / "results.npz") as fewer:
        assert not [name for name in fewer if "info" in name]
        for name, array in fewer.items():
            np.testing.assert_array_equal(own.parts[0].arrays[name], array)


def test_what_cannot_be_recorded(monkeypatch):
    def told(recorded, words):
        monkeypatch.setattr(Pressed, "recorded_info", recorded)
        with pytest.raises(UserError, match=words):
            agents.train("trpo-lag", "Pressed-v0", **OPTIONS)

    told({"x": "m", "depth": "m"}, r"gives no info\['depth'\]; it gives \['beyond', 'cost'")
    told(["x"], "recorded_info of .* must be units by name, got")
    far = {"cost": 0.0, "x": "far"}
    monkeypatch.setattr(Pressed, "step", lambda env, action: (*Walk.step(env, action)[:4], far))
    told({"x": "m"}, r"gives info\['x'\] = 'far', which is no number")


def test_the_table_of_what_is_recorded_by_hand(runs):
    """Of one run: shares, percentiles and streaks of each third, counted in loops."""
    group = next(group for group in read([runs.folder], []) if group.task == "Pressed-v0")
    one = replace(group, runs=group.runs[:1])
    table = recorded_table([one])
    assert table is not None
    beyond = unpacked(runs.folder, "beyond")
    assert [", ".join(row.name.split(", ")[-2:]) for row in table.rows] == [
        f"beyond (m), {part}" for part in (0.33, 0.66, 0.99)
    ]  # x may be negative
    limit = float(f"{np.median(beyond[beyond > 0]):.2g}")
    records, start = group.runs[0].records, 0
    shares: dict[float, list[list[float]]] = {0.0: [[], [], []], limit: [[], [], []]}
    for rollout in np.unique(records.rollout):
        lengths = records.length[records.rollout == rollout]
        third = int(100 * start / 300 >= 33) + int(100 * start / 300 >= 66)
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
        in_part = [(33 * k <= i / 3 < 33 * (k + 1)) or (i == 297 and k == 2) for i in range(300)]
        part = beyond[in_part]
        assert share == pytest.approx((part > 0).mean())
        told = np.percentile(part[part > 0], [50, 90, 100])
        np.testing.assert_allclose([median, most, highest], told)
        assert above == pytest.approx(emcc.emcc(shares[0.0][k], 0.1))
        assert high == pytest.approx(emcc.emcc(shares[limit][k], 0.1))
