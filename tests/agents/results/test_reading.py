"""Runs read from folders and archives, what is left out, and damaged files."""

import io
import json
import shutil
import zipfile
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st
from small_runs import TRPO, cells, edit_results, evaluate, results, write_evaluated, write_runs

import agents
from agents.cli.main import main
from agents.errors import FailedRunWarning, UserError
from agents.presets import preset
from agents.reporting.numbers import numbers_csv, report_lines
from agents.results.archive import write_archive
from agents.results.names import with_names
from agents.results.reading import folders_below, name_of_source, read_groups
from agents.training.derive import path_digits, path_of, thousandths, three_digits
from emcc.records import digits, of_digits
from emcc.sources import read_runs

TASK = "Circle2D-1-v0"
toys.register()


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Trainings on two tasks, on a task where runs fail, and with two costs; one was stopped."""
    folder = tmp_path_factory.mktemp("runs") / "grid"
    more = TRPO | {"seeds": (0, 3), "steps": 300}
    tasks = (TASK, "Circle2D-3-v0")
    agents.train("cpo", tasks, out=folder / "both", cost_limit=5.0, **more)
    poison = {"task_parameters": {"poison": 0.002}, "seeds": range(5)}
    with pytest.warns(FailedRunWarning):
        agents.train("trpo-lag", "Walk-v0", out=folder / "Walk" / "trpo-lag", **more | poison)
    stop = {"on_epoch": lambda epoch: False}
    agents.train("ppo-lag", TASK, out=folder / "part", **more, **stop)
    agents.train("cpo", "TwoCosts-v0", out=folder / "two", costs=("cost", "cost_2"), **more)
    return folder


@pytest.fixture(scope="module")
def packed(runs, tmp_path_factory):
    path = tmp_path_factory.mktemp("packed") / "runs.zip"
    write_archive(path, read_groups([runs], []))
    return path


def assert_equal_groups(ours, theirs, located=True):
    """Assert that groups agree in all that a report shows.

    Returns of training's episodes agree to three digits of the largest.
    """
    assert [(g.task, g.config, g.cost, g.seeds) for g in ours] == [
        (g.task, g.config, g.cost, g.seeds) for g in theirs
    ]
    for a, b in zip(ours, theirs, strict=True):
        assert a.missing == b.missing
        for x, y in zip(a.runs, b.runs, strict=True):
            assert (x.measures, x.ends, x.ways, x.place) == (y.measures, y.ends, y.ways, y.place)
            off = 0.0051 * np.abs(y.records.reward).max()
            np.testing.assert_allclose(x.records.reward, y.records.reward, rtol=0, atol=off)
            for name in ("rollout", "start_step", "length", "cost", "longest_streak", "streaks"):
                columns = (getattr(run.records, name) for run in (x, y))
                np.testing.assert_array_equal(*columns)
            assert str(x.evaluation) == str(y.evaluation)
            if located and a.task.startswith("Circle2D"):
                assert str(x.replay()) == str(y.replay())
                assert str(x.trained()) == str(y.trained())
        if located and a.task.startswith("Circle2D") and a.runs:
            for own, other in zip(a.visits(), b.visits(), strict=True):
                assert own[1:] == other[1:]
                np.testing.assert_array_equal(own.counts, other.counts)


def test_an_archive_gives_what_the_folders_gave(runs, packed, tmp_path):
    notes, again = [], []
    groups, archived = read_groups([runs], notes), read_groups([packed], again)
    assert_equal_groups(archived, groups)
    assert notes == again
    assert sum("is not finite" in note for note in notes) > 0
    assert any("grid/part, seeds 0, 3: unfinished: 100 of 300 steps" in n for n in notes)
    assert {(g.task, g.cost) for g in groups} == {
        *((TASK, "cost"), ("Circle2D-3-v0", "cost"), ("Walk-v0", "cost")),
        *(("TwoCosts-v0", "cost"), ("TwoCosts-v0", "cost_2")),
    }
    write_archive(tmp_path / "again.zip", archived)
    assert (tmp_path / "again.zip").read_bytes() == packed.read_bytes()
    with zipfile.ZipFile(packed) as file:
        names = file.namelist()
    assert "both/config.json" in names
    assert not any("checkpoints" in name or "steps/" in name for name in names)


def test_a_run_of_several_costs_is_noted_once(runs, tmp_path):
    shutil.copytree(runs / "two", tmp_path / "two")
    edit_results(tmp_path / "two", **{"TwoCosts-v0__3__failure": np.array("it fell")})
    notes = []
    groups = read_groups([tmp_path / "two"], notes)
    assert [group.cost for group in groups] == ["cost", "cost_2"]
    assert notes == ["left out: two, seed 3: it fell"]


def write_old_archive(path, folder):
    """Write an archive as versions before 0.4 did: with the bits of all steps, without updates."""
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(folder.rglob("config.json")):
            own = file.parent.relative_to(folder)
            archive.write(file, str(own / "config.json"))
            arrays = np.load(file.parent / "results.npz")
            kept = {name: arrays[name] for name in arrays if not name.endswith("/updates")}
            np.savez(content := io.BytesIO(), **kept)
            archive.writestr(str(own / "results.npz"), content.getvalue())


def test_an_old_archive_is_converted_without_changing_a_number(runs, tmp_path):
    """Also with windows of episodes. New archives do not have the costs of single steps."""
    folder = shutil.copytree(runs, tmp_path / "runs", ignore=lambda *_: ["part", "steps"])
    old, new = tmp_path / "one" / "runs.zip", tmp_path / "two" / "runs.zip"
    old.parent.mkdir()
    write_old_archive(old, folder)
    new.parent.mkdir()
    write_archive(new, read_groups([old], []))
    numbers, again = (
        numbers_csv(report_lines(with_names(read_groups([path], [])))) for path in (old, new)
    )
    assert numbers == again
    assert numbers.count(",run,") > 6
    for window in (3, 7):
        for a, b in zip(
            *(read_groups([path], [], None, window) for path in (old, new)), strict=True
        ):
            assert [run.measures for run in a.runs] == [run.measures for run in b.runs]
    for a, b in zip(read_runs(old), read_runs(new), strict=True):
        for name in ("rollout", "start_step", "length", "cost", "longest_streak", "streaks"):
            columns = (getattr(run.records, name) for run in (a, b))
            np.testing.assert_array_equal(*columns)
    with pytest.raises(ValueError, match="leave the threshold out"):
        read_runs(new, threshold=0.5)
    with zipfile.ZipFile(new) as file:
        assert "both/pictures.npz" in file.namelist()
        arrays = np.load(io.BytesIO(file.read("both/results.npz")))
        assert not any(name.endswith(("/steps", "/unsafe", "/points")) for name in arrays)
        assert arrays["Circle2D-1-v0/0/return"].dtype == np.uint8


@given(st.lists(st.floats(-1e6, 1e6).map(lambda x: round(x, 6)), min_size=1))
def test_three_digits(values):
    """They are those that Python prints, except for halves, and stay the same in float32, as
    archives hold them."""
    found = three_digits(np.array(values))
    np.testing.assert_allclose(found, [float(f"{x:.3g}") for x in values], rtol=0.0101)
    np.testing.assert_allclose(found, values, rtol=0.00501)
    np.testing.assert_allclose(three_digits(found.astype(np.float32)), found, rtol=1e-12)


@given(st.lists(st.floats(-1e6, 1e6).map(lambda x: round(x, 6)), min_size=1))
def test_returns_to_three_digits_of_the_largest(values):
    """They are rounded as decimals and held as integers below 1000; rounding again changes none."""
    whole, scale = thousandths(np.array(values))
    largest = max(map(abs, values))
    if largest:
        place = Decimal(f"{Decimal(f'{largest:.2e}'):.2e}").as_tuple().exponent
        half = Decimal(10) ** place * Decimal("0.50001")
        for number, value in zip((whole / scale).tolist(), values, strict=True):
            assert abs(Decimal(number) - Decimal(value)) <= half
    assert np.abs(whole).max() < 1000
    again, same = thousandths(whole / scale)
    np.testing.assert_array_equal(again / same, whole / scale)


@given(st.lists(st.tuples(st.integers(0, 1023), st.integers(0, 1023)), min_size=1))
def test_a_packed_path_is_unpacked_as_it_was(points):
    path = np.array(points, dtype=np.uint16)
    np.testing.assert_array_equal(path_of(path_digits(path)), path)


@given(st.lists(st.integers(0, 2**40), min_size=1))
def test_integers_as_bytes(numbers):
    """The lowest byte comes first, as in Python's `int.to_bytes`."""
    found = digits(np.array(numbers))
    for column, number in zip(found.T, numbers, strict=True):
        assert column.tobytes() == number.to_bytes(len(found), "little")
    assert of_digits(found).tolist() == numbers


def test_a_folder_within_an_archive_can_be_read(runs, packed):
    for part in ("both", "Walk", "Walk/trpo-lag"):
        assert_equal_groups(read_groups([packed / part], []), read_groups([runs / part], []))
        assert name_of_source(packed / part) == Path(part).name
    assert name_of_source(packed) == "grid"
    with pytest.raises(UserError, match="no folder nothing; it has Walk, both"):
        folders_below(packed / "nothing")


def test_reading_changes_nothing_and_imports_nothing(runs, tmp_path):
    copy = shutil.copytree(runs, tmp_path / "grid")
    path = copy / "both" / "config.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"algorithm": "mine", "modules": ["no_such_module"]}))
    before = results(copy)
    groups = read_groups([copy], [])
    assert [g.config.algorithm for g in groups].count("mine") == 2
    assert results(copy) == before


def without(archive, path, name, content=None):
    with zipfile.ZipFile(archive) as old, zipfile.ZipFile(path, "w") as new:
        for other in old.namelist():
            if other != name:
                new.writestr(other, old.read(other))
            elif content is not None:
                new.writestr(other, content)
    return path


def test_files_that_are_no_archives_or_damaged(packed, tmp_path):
    data = packed.read_bytes()
    foreign, cut = tmp_path / "foreign.zip", tmp_path / "cut.zip"
    foreign.write_text("a,b\n1,2\n")
    cut.write_bytes(data[: len(data) // 2])
    with zipfile.ZipFile(tmp_path / "none.zip", "w") as file:
        file.writestr("readme", "")
    for name in ("foreign", "cut", "none"):
        with pytest.raises(UserError, match=f"{name}.zip is not an archive by circle2d report"):
            read_groups([tmp_path / f"{name}.zip"], [])
    for name, content in (
        ("both/results.npz", None),
        ("both/config.json", "{"),
        ("both/config.json", b"{\xff"),
    ):
        notes = []
        path = without(packed, tmp_path / "less.zip", name, content)
        assert read_groups([path], notes)
        assert any("results.npz is missing" in n or "config.json is damaged" in n for n in notes)
        assert not any("codec" in note for note in notes)
    with zipfile.ZipFile(path, "a") as file:
        file.comment = b"\xff"  # as another program may write it
    assert read_groups([path], [])


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("length", lambda a: a[:-1]),
        ("length", lambda a: a * 0),
        ("return", lambda a: a * np.nan),
        ("rollouts", lambda a: a + 1),
        ("costs/cost/steps", lambda a: a + 100),
        ("evaluation/deterministic/returns", lambda a: a * np.nan),
    ],
)
def test_numbers_that_cannot_be_are_left_out(tmp_path, name, change):
    write_evaluated(tmp_path, "cpo", costs=(3, 4))
    with np.load(tmp_path / "results.npz") as file:
        changed = {f"{TASK}/1/{name}": change(file[f"{TASK}/1/{name}"])}
    edit_results(tmp_path, **changed)
    notes = []
    [group] = read_groups([tmp_path], notes)
    assert group.seeds == [0]
    assert len(notes) == 1
    assert "seed 1" in notes[0]


def test_several_sources_are_one(tmp_path):
    """An archive of one algorithm and a folder of another are read as one folder of both."""
    for name, costs in (("cpo", (2, 4, 3)), ("wcsac", (7, 9))):
        write_evaluated(tmp_path / "whole" / TASK / name, name, costs=costs)
        shutil.copytree(tmp_path / "whole" / TASK / name, tmp_path / name / "grid" / TASK / name)
    archive, folder = tmp_path / "cpo.zip", tmp_path / "wcsac" / "grid"
    write_archive(archive, read_groups([tmp_path / "cpo" / "grid"], []))
    both, whole = (
        read_groups([archive, folder], [], "all"),
        read_groups([tmp_path / "whole"], [], "all"),
    )
    assert_equal_groups(both, whole, located=False)
    assert [g.folder for g in both] == [g.folder for g in whole]
    assert both[0].title == f"all/{TASK}/cpo"
    joined = read_groups([folder / TASK / "wcsac", archive], [], "all")
    assert {group.folder for group in joined} == {"wcsac", f"{TASK}/cpo"}
    same = read_groups([tmp_path / "whole", folder], [], "all")
    several = {f"{root}/{TASK}/wcsac" for root in ("whole", "grid")}
    assert {group.folder for group in same} == {f"{TASK}/cpo"} | several
    for inner in (tmp_path / "whole" / TASK, tmp_path / "whole" / ".." / "whole"):
        with pytest.raises(UserError, match=r"is in .*whole: its runs would count twice"):
            read_groups([inner, tmp_path / "whole"], [], "all")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match="empty holds no runs"):
        read_groups([tmp_path / "empty", archive], [], "all")


def test_folders_that_differ_in_their_seeds_count_as_one(tmp_path):
    """They have the numbers of one training with all seeds, whatever the folders' order. A limit of
    5 equals one of 5.0."""
    more = TRPO | {"steps": 300}
    folders = {"whole": ((0, 1, 2), 5.0), "p/one": ((0, 1), 5.0), "p/more": ((2,), 5)}
    for name, (seeds, limit) in folders.items():
        more |= {"seeds": seeds, "cost_limit": limit}
        agents.train("trpo-lag", TASK, out=tmp_path / name, **more)
    notes = []
    [pooled], [whole] = read_groups([tmp_path / "p"], notes), read_groups([tmp_path / "whole"], [])
    assert pooled.seeds == [0, 1, 2]
    assert pooled.folder == "one + more"
    assert "counted as one: p/one (seeds 0, 1); p/more (seed 2)" in notes[0]
    assert [run.measures for run in pooled.runs] == [run.measures for run in whole.runs]
    for own, other in zip(pooled.visits(), whole.visits(), strict=True):
        np.testing.assert_array_equal(own.counts, other.counts)
        assert own.emcc == pytest.approx(other.emcc)
    assert str(pooled.runs[2].trained()) == str(whole.runs[2].trained())
    assert str(pooled.runs[2].replay()) == str(whole.runs[2].replay())
    write_archive(tmp_path / "p.zip", [pooled])
    assert_equal_groups(read_groups([tmp_path / "p.zip"], []), [pooled])


def test_folders_with_a_common_seed_or_other_settings_stay_apart(tmp_path):
    for name, seeds in (("a", (0, 1)), ("b", (2, 3)), ("c", (3, 4))):
        write_evaluated(tmp_path / "x" / name, "cpo", seeds, seeds=seeds)
    assert [group.folder for group in read_groups([tmp_path / "x"], [])] == ["a", "b", "c"]
    usual = preset("trpo-lag", TASK)
    for name, seeds, discount in (("a", (0, 1), 0.99), ("b", (2, 3), 0.9)):
        chosen = replace(usual, discount=discount)
        write_evaluated(tmp_path / "y" / name, "trpo-lag", seeds, chosen, seeds=seeds)
    assert [group.folder for group in read_groups([tmp_path / "y"], [])] == ["a", "b"]


def test_a_third_without_a_rollout_is_missing_and_said(tmp_path):
    """Two rollouts of 50 steps: the second starts at half of the training."""
    runs = agents.train(
        "trpo-lag", TASK, out=tmp_path / "x", **TRPO | {"seeds": 0, "steps": 100, "episodes": 1}
    )
    assert "\N{EN DASH}" in runs.table()
    notes = []
    (group,) = read_groups([tmp_path / "x"], notes)
    emccs = [group.runs[0].measures[f"EMCC_{part}"] for part in (0.33, 0.66, 0.99)]
    assert [value is None for value in emccs] == [False, False, True]
    assert "x has no EMCC_0.99: of its 100 steps no rollout starts in that part" in notes


NOT_FITTING = {
    "visits": lambda a: a[:2],
    "0/trained/positions": lambda a: a[:-1],
    "0/trained/unsafe": lambda a: a[1:],
    "0/replay/drawn": lambda a: a[..., :-3],
    "0/replay/box": lambda a: a[:1],
    "0/replay/steps": lambda a: np.array([60, 60]),
    "0/evaluation/deterministic/costs": lambda a: a[:, 0],
    "0/evaluation/deterministic/lengths": lambda a: a[:-1],
    "0/evaluation/deterministic/returns": lambda a: a[:, None],
    "0/evaluation/deterministic/places": lambda a: a[:-1],
}
PICTURES = {
    "visits": "heat map",
    "0/trained": "trajectories of seed 0",
    "0/replay": "replay of seed 0",
}
"""What a report leaves out where these arrays are damaged."""


@pytest.fixture(scope="module")
def one_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("one") / "cpo"
    agents.train("cpo", TASK, out=folder, **(TRPO | {"seeds": 0, "steps": 300}))
    return folder


@pytest.mark.parametrize("name", NOT_FITTING)
def test_arrays_that_do_not_fit_each_other_are_damage(one_run, tmp_path, name, capsys):
    """Though each array is whole, the report is an error of one line. Where the arrays are of
    pictures, the report has everything but these, and a note with the array's shape."""
    folder = shutil.copytree(one_run, tmp_path / "cpo")
    arrays = dict(np.load(folder / "results.npz"))
    key = f"{TASK}/{name}"
    arrays[key] = NOT_FITTING[name](arrays[key])
    np.savez(folder / "results.npz", **arrays)
    picture = PICTURES.get("/".join(name.split("/")[:2]))
    if picture:
        damage = f"cpo/results.npz is damaged: {key} has shape {[*arrays[key].shape]}"
        note = f"left out: {picture} of cpo: {damage}"
        assert_left_out(folder, note, agents.load_runs(one_run).table())
        return
    assert main(["report", str(folder)]) == 2
    err = capsys.readouterr().err
    assert "Traceback" not in err
    assert len(err.splitlines()) == 1
    assert "damaged" in err


def assert_left_out(folder, note, table):
    """Assert that the report has the exit status 1, a note, and all rows of a table."""
    assert main(["report", str(folder)]) == 1
    words = (folder / "report.md").read_text()
    assert f"Note: {note}" in words.replace("\\", "")
    assert {row[0] for row in cells(table)} <= {row[0] for row in cells(words)}


def test_a_task_by_either_of_its_ids_is_one_task(tmp_path, capsys):
    """A Safety task has its own id and a longer one, which published runs use."""
    short, long = "SafetyPointGoal1-v0", "circle2d_mj/SafetyPointGoal1-v0"
    for name, task in (("short", short), ("long", long)):
        write_runs(tmp_path / name, task)
        evaluate(tmp_path / name)
    alone = {name: read_groups([tmp_path / name], []) for name in ("short", "long")}
    assert [group.task for groups in alone.values() for group in groups] == [short, long]
    both = read_groups([tmp_path / "short", tmp_path / "long"], [])
    assert [group.task for group in both] == [long, long]
    for ours, (theirs,) in zip(both, alone.values(), strict=True):
        assert ours.values("EMCC_0.33") == theirs.values("EMCC_0.33")
        for a, b in zip(ours.visits(), theirs.visits(), strict=True):
            np.testing.assert_array_equal(a.counts, b.counts)
    assert main(["compare", str(tmp_path / "short"), str(tmp_path / "long")]) == 0
    assert "B - A" in capsys.readouterr().out
