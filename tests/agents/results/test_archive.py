"""An archive gives the report of the folders byte for byte, and says when it cannot."""

import json
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from small_runs import write_evaluated, write_runs

from agents.cli.main import main
from agents.errors import UserError
from agents.paper.presets import preset
from agents.reporting.compare import compare
from agents.reporting.maps import Scenes, maps
from agents.results import steps
from agents.results.archive import ArchiveSource, open_source, write_archive
from agents.results.columns import Arrays, pack_costs, pack_records, unpack_costs, unpack_records
from agents.results.precision import five_digits, from_planes, to_planes
from agents.results.reading import read_groups
from agents.results.source import FolderSource
from agents.training.config import TrainConfig
from agents.training.loop import train
from emcc import EpisodeRecords, count_streaks, longest_streaks

WRITTEN = ("report.md", "report.csv", "index.html")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Trained runs on two tasks, one of them failed, and an old folder with an unfinished run."""
    folder = tmp_path_factory.mktemp("runs") / "grid"
    for name, task in (("cpo", "Circle2D-1-v0"), ("wcsac", "circle2d_mj/SafetyPointCircle1-v0")):
        out = folder / task.replace("/", "-") / name
        hyperparameters = preset(name, task)  # WCSAC acts at random for so few steps
        TrainConfig(name, task, (0, 3), 1500, hyperparameters).write(out)
        train(out)
    (folder / "Circle2D-1-v0" / "cpo" / "seed-3" / "failed.json").write_text('{"step": 500}')
    write_evaluated(folder / "old", "wcsac", costs=(3, 4), old=True)
    (folder / "old" / "seed-1" / "evaluation.json").unlink()
    (folder / "broken").mkdir()
    (folder / "broken" / "config.json").write_text("{")
    return folder


@pytest.fixture(scope="module")
def packed(runs, tmp_path_factory):
    """The archive of the runs, their report, and the report from the archive alone."""
    folder = tmp_path_factory.mktemp("packed")
    copy = folder / runs.name
    shutil.copytree(runs, copy)
    assert main(["report", str(copy), "--archive", str(folder / "runs.zip")]) == 1  # a run failed
    first = contents(copy)
    shutil.rmtree(copy)
    return folder / "runs.zip", first


def contents(folder):
    return {name: (folder / name).read_bytes() for name in WRITTEN}


def test_the_same_report_byte_for_byte(packed):
    archive, first = packed
    assert main(["report", str(archive)]) == 1
    again = archive.with_suffix("")
    assert contents(again) == first
    text = first["report.md"].decode()
    for note in (
        "left out: grid/broken/config.json is damaged",
        "left out: grid/Circle2D-1-v0/cpo/seed-3: failed at step 500",
        "left out: grid/old/seed-1: grid/old/seed-1/evaluation.json is missing",
        "no heat map of grid/old: grid/old/seed-0/visited.npy is missing",
    ):
        assert note in text
    assert str(archive.parent) not in text + first["index.html"].decode()
    html = first["index.html"].decode()
    for part in ("Visited states", "Trained policies", 'id="replay-data"', "training time"):
        assert part in html
    assert {path.name for path in again.iterdir()} == set(WRITTEN)


def test_an_archive_of_an_archive_and_a_comparison(packed, runs, tmp_path):
    archive, _ = packed
    source = open_source(archive)
    write_archive(tmp_path / "again.zip", source, read_groups(source, []))
    assert (tmp_path / "again.zip").read_bytes() == archive.read_bytes()
    [compared, *_], [expected, *_] = compare(runs, archive), compare(runs, runs)
    assert compared.rows == expected.rows


def test_a_folder_of_an_archive_is_as_the_folder_that_was_packed(packed, runs, capsys):
    archive, _ = packed
    for part in ("Circle2D-1-v0", "Circle2D-1-v0/cpo", "old"):
        of_folder, of_archive = FolderSource(runs / part), open_source(archive / part)
        assert (of_archive.name, of_archive.configs) == (of_folder.name, of_folder.configs)
        expected, found = read_groups(of_folder, []), read_groups(of_archive, [])
        assert [g.folder for g in found] == [g.folder for g in expected]
        assert [r.measures for g in found for r in g.runs] == [
            r.measures for g in expected for r in g.runs
        ]
    assert main(["report", str(archive / "old")]) == 1
    assert (archive.with_suffix("") / "old" / "index.html").exists()
    for part, said in (
        ("nothing", "no folder nothing; it has Circle2D-1-v0, circle2d_mj-Safety"),
        ("Circle2D-1-v0/sac", "no folder Circle2D-1-v0/sac; Circle2D-1-v0 has cpo\n"),
        ("old/seed-0", "no folder old/seed-0; old has none\n"),
    ):
        capsys.readouterr()
        assert main(["report", str(archive / part)]) == 2
        assert said in capsys.readouterr().err


def test_every_step_and_the_replay(packed, runs):
    """Against the files of the folder."""
    archive, _ = packed
    sources = FolderSource(runs), ArchiveSource(archive)
    groups = [read_groups(source, []) for source in sources]
    for ours, theirs in zip(*groups, strict=True):
        assert (ours.folder, ours.seeds, ours.config) == (
            theirs.folder, theirs.seeds, theirs.config,
        )  # fmt: skip
        for run, packed_run in zip(ours.runs, theirs.runs, strict=True):
            assert run.measures == packed_run.measures
            if ours.folder == "old":
                with pytest.raises(UserError, match=r"grid/old/seed-0/costs\.npy is missing"):
                    sources[1].costs("old", 0, packed_run.records)
                continue
            path = runs / ours.folder / f"seed-{run.seed}"
            costs, seen = np.load(path / "costs.npy"), (path / "visited.npy").exists()
            visited = np.load(path / "visited.npy") if seen else np.zeros((1500, 2))
            records = packed_run.records
            np.testing.assert_array_equal(sources[1].costs(ours.folder, run.seed, records), costs)
            replay = sources[1].replay(ours.folder, ours.config, run.seed, records)
            for played in replay.episodes:
                of_window = [
                    row
                    for row, start in enumerate(run.records.start_step)
                    if played.window * 1500 <= 60 * start < (played.window + 1) * 1500
                ]
                mcc = (run.records.longest_streak / run.records.length)[of_window]
                row = of_window[int(np.argmax(mcc))]
                steps_of = slice(played.start_step, played.start_step + len(played.costs))
                assert played.start_step == run.records.start_step[row]
                assert len(played.costs) == run.records.length[row]
                np.testing.assert_array_equal(played.costs, costs[steps_of])
                box = visited.max(axis=0) - visited.min(axis=0)
                assert len(played.points) == (len(played.costs) if seen else 0)
                if not seen:
                    continue
                off = np.abs(replay.positions(played.points) - visited[steps_of])
                assert (off <= 0.5001 * box / 65_535).all()


def test_files_that_are_no_archives(packed, tmp_path, capsys):
    archive, _ = packed
    data = archive.read_bytes()
    foreign, cut, damaged = (tmp_path / f"{name}.zip" for name in ("foreign", "cut", "damaged"))
    foreign.write_text("a,b\n1,2\n")
    cut.write_bytes(data[: len(data) // 2])
    with zipfile.ZipFile(archive) as file:
        names = file.namelist()
        where = file.getinfo("0/0/length.npy").header_offset
    changed = bytearray(data)
    changed[where + 60] ^= 0xFF
    damaged.write_bytes(changed)
    for path, said in (
        (foreign, "foreign.zip is no archive that circle2d report wrote"),
        (cut, "cut.zip is no archive that circle2d report wrote"),
        (damaged, "damaged.zip is damaged: "),
        (rewritten(archive, tmp_path / "new.zip", version=2), "reads 'circle2d results', version"),
        (without(archive, tmp_path / "less.zip", "0/0/length.npy"), "less.zip is damaged: "),
        (without(archive, tmp_path / "none.zip", "index.json"), "none.zip is no archive"),
    ):
        assert main(["report", str(path)]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert said in err
        assert not path.with_suffix("").exists()
    assert "0/0/length.npy" in names


def test_policies_that_no_page_draws_are_not_played(tmp_path):
    write_evaluated(tmp_path / "runs", "sac-lag", [1, 2, 3, 4, 5, 6])
    asked = []

    class Asked(FolderSource):
        def trained(self, folder, config, seeds):
            asked.append(list(seeds))
            return super().trained(folder, config, seeds)

    source = Asked(tmp_path / "runs")
    groups = read_groups(source, [])
    maps([replace(group, source=source) for group in groups], Scenes(), [])
    write_archive(tmp_path / "runs.zip", source, groups)
    assert asked == [[0, 1, 2, 3, 4]] * 2


def without(archive, path, left_out):
    with zipfile.ZipFile(archive) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            if name != left_out:
                new.writestr(name, old.read(name))
    return path


def rewritten(archive, path, **changes):
    path = without(archive, path, "index.json")
    with zipfile.ZipFile(archive) as old, zipfile.ZipFile(path, "a") as new:
        new.writestr("index.json", json.dumps(json.loads(old.read("index.json")) | changes))
    return path


def kept(packed):
    return Arrays(packed.__contains__, packed.__getitem__)


@pytest.mark.parametrize("values", [(0.0, 1.0), (0.0, 0.25, 1.0, 3.5)])
def test_records_and_costs_there_and_back(values):
    rng = np.random.default_rng(0)
    length = rng.integers(1, 300, 500)
    costs = rng.choice(values, length.sum())
    ends = np.cumsum(length)
    cost = np.array([part.sum() for part in np.split(costs, ends[:-1])])
    counted = longest_streaks(costs, length), *count_streaks(costs, length)
    reward = rng.normal(size=500) * 10.0 ** rng.integers(-5, 6, 500)
    records = EpisodeRecords(np.arange(500) // 3 * 2, ends - length, length, reward, cost, *counted)
    for given in (costs, None):
        packed = pack_records(records, given) | (pack_costs(costs) if given is not None else {})
        read = None if given is None else unpack_costs(kept(packed))
        if given is not None:
            np.testing.assert_array_equal(read, costs)
            assert "longest_streak" not in packed
        found = unpack_records(kept(packed), read)
        for name in ("rollout", "start_step", "length", "cost", "longest_streak", "streaks"):
            np.testing.assert_array_equal(getattr(found, name), getattr(records, name))
        np.testing.assert_allclose(found.reward, reward, rtol=2**-16)


def test_five_digits():
    values = np.array([0.0, -1.0, 1 / 3, -123.456789, 1e30, 65537.0])
    rounded = five_digits(values)
    np.testing.assert_allclose(rounded, values, rtol=2**-16)
    np.testing.assert_array_equal(five_digits(rounded), rounded)
    np.testing.assert_array_equal(from_planes(to_planes(rounded)), rounded)
    assert rounded[:2].tolist() == [0.0, -1.0]
    np.testing.assert_array_equal(five_digits([1e39, 1 / 3]), [1e39, 1 / 3])


def test_the_replay_takes_the_worst_of_each_window(tmp_path):
    """12 rollouts of two episodes in 120 steps: a window of two steps for each of 60."""
    config = write_runs(tmp_path)
    records = EpisodeRecords.load(tmp_path / "seed-0" / "episodes.csv")
    windows, rows = zip(*steps.replay_rows(records, config.steps), strict=True)
    assert windows == tuple(5 * k // 2 for k in range(24))
    assert rows == tuple(range(24))
    few = EpisodeRecords(
        np.arange(4), [0, 1, 2, 3], [1, 1, 1, 1], np.zeros(4), [0, 1, 1, 0], [0, 1, 1, 0]
    )
    assert steps.replay_rows(few, 240) == [(0, 1)]  # the first of two equal ones
