"""Folders and archives side by side give the report of one folder that holds all of them."""

import shutil

import pytest
from small_runs import write_evaluated

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.results.joined import JoinedSource

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


def test_archives_of_single_folders_have_the_names_of_their_files(parts, tmp_path):
    root, *_ = parts
    for name in ("cpo", "wcsac"):
        single = tmp_path / name / "runs"
        shutil.copytree(root / "whole" / TASK / name, single)
        agents.report(single, archive=tmp_path / f"{name}-runs.zip")
    joined = JoinedSource(sorted(tmp_path.glob("*.zip")), "all")
    assert list(joined.configs) == ["cpo-runs", "wcsac-runs"]


def test_mistakes(parts):
    root, archive, folder = parts
    shutil.copytree(root / "cpo" / "grid", root / "other" / "grid", dirs_exist_ok=True)
    with pytest.raises(UserError, match=f"two of the sources hold runs named grid/{TASK}/cpo"):
        JoinedSource([root / "other" / "grid", root / "cpo" / "grid"], "all")
    with pytest.raises(UserError, match="several folders or archives needs out"):
        agents.report(archive, folder)
    with pytest.raises(UserError, match="give a folder of runs"):
        agents.report()
