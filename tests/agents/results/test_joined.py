"""Folders and archives side by side give the report of one folder that holds all of them."""

import shutil
from dataclasses import replace

import pytest
from small_runs import write_evaluated

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.paper.presets import preset
from agents.paper.printed import split
from agents.results.joined import JoinedSource
from agents.results.reading import read_groups

TASK = "Circle2D-1-v0"


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """A grid of two algorithms, and its parts: an archive of one, a folder of the other."""
    root = tmp_path_factory.mktemp("joined")
    for name, costs in (("cpo", (2, 4, 3)), ("wcsac", (7, 9))):
        write_evaluated(root / "whole" / TASK / name, name, costs=costs)
        shutil.copytree(root / "whole" / TASK / name, root / name / "grid" / TASK / name)
    archive = root / "cpo.zip"
    assert main(["report", str(root / "cpo" / "grid"), "--archive", str(archive)]) == 0
    return root, archive, root / "wcsac" / "grid"


def csv(folder):
    return (folder / "report.csv").read_text().splitlines()


def test_an_archive_and_a_folder_are_reported_as_one(parts, tmp_path, capsys):
    root, archive, folder = parts
    agents.report(root / "whole")
    packed, out = tmp_path / "new" / "both.zip", tmp_path / "out"
    sources = [str(archive), str(folder)]
    assert main(["report", *sources, "--out", str(out), "--archive", str(packed)]) == 0
    assert csv(out) == csv(root / "whole")
    agents.report(packed)  # what was joined is an archive like any other
    for name in ("report.csv", "report.md", "index.html"):
        assert (tmp_path / "new" / "both" / name).read_bytes() == (out / name).read_bytes()


def test_folders_of_one_name_have_their_sources_before_it(parts):
    root, archive, folder = parts
    joined = JoinedSource([root / "whole", folder], "all")
    assert set(joined.configs) == {f"{TASK}/cpo", f"whole/{TASK}/wcsac", f"grid/{TASK}/wcsac"}
    alone = JoinedSource([folder / TASK / "wcsac", archive], "all")
    assert set(alone.configs) == {"wcsac", f"{TASK}/cpo"}
    assert alone.title("wcsac") == "all/wcsac"


def test_sources_have_as_much_of_their_paths_as_tells_them_apart(parts, tmp_path):
    """Archives of single folders; `runs` beside `published/runs.zip`; `runs` beside `runs.zip`."""
    root, *_ = parts
    single = tmp_path / "mine" / "runs"
    shutil.copytree(root / "whole" / TASK / "cpo", single)
    for name in ("cpo", "published/runs", "mine/runs"):
        agents.report(single, archive=tmp_path / f"{name}.zip")
    cpo, published, beside = (
        tmp_path / f"{of}.zip" for of in ("cpo", "published/runs", "mine/runs")
    )
    assert list(JoinedSource([cpo, published], "all").configs) == ["cpo", "runs"]
    assert list(JoinedSource([single, published], "all").configs) == ["mine/runs", "published/runs"]
    assert list(JoinedSource([single, beside], "all").configs) == ["runs", "runs.zip"]
    with pytest.raises(UserError, match="two of the sources hold runs named cpo: rename one"):
        JoinedSource([root / "whole" / TASK, cpo], "all")


def test_the_ablation_of_one_source_stands_beside_the_preset_of_most_runs(tmp_path):
    preset_of = preset("trpo-lag", TASK)
    for folder, costs, changes in (
        ("mine/trial", (2,), {}),
        ("grid/trpo-lag", (2, 4, 3), {}),
        ("grid/trpo-lag-sgd", (5, 6), {"multiplier_optimizer": "sgd"}),
    ):
        hyperparameters = replace(preset_of, **changes)
        write_evaluated(tmp_path / folder, "trpo-lag", costs, hyperparameters, task=TASK)
    source = JoinedSource([tmp_path / "mine", tmp_path / "grid"], "all")
    _, pairs = split(read_groups(source, []))
    assert [(a.folder, b.folder) for a, b in pairs] == [("trpo-lag", "trpo-lag-sgd")]


def test_mistakes(parts, tmp_path):
    root, archive, folder = parts
    empty = tmp_path / "empty"
    empty.mkdir()
    for inner in (root / "whole", root / "whole" / TASK, root / "whole" / ".." / "whole"):
        with pytest.raises(UserError, match=r"is in .*whole: its runs would count twice"):
            JoinedSource([inner, root / "whole"], "all")
    with pytest.raises(UserError, match="empty holds no runs"):
        JoinedSource([empty, archive], "all")
    with pytest.raises(UserError, match=r"archive must be a file, but .* is a folder"):
        agents.report(archive, archive=empty)
    with pytest.raises(UserError, match="archive cannot be written"):
        agents.report(archive, archive=archive / "x.zip")
    with pytest.raises(UserError, match="several folders or archives needs out"):
        agents.report(archive, folder)
    with pytest.raises(UserError, match="give a folder of runs"):
        agents.report()
