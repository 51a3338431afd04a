"""`circle2d reproduce` on a part of the grid, and with an engine that there is not."""

import shutil
import sys

import pytest
from small_runs import results

from agents.cli.main import main


def reproduce(out, *options):
    return main(["reproduce", "--quick", "--out", str(out), *options])


def test_without_ray(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert reproduce(tmp_path / "x", "--engine", "ray") == 2
    assert "needs ray, which is not installed: pip install" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_address_is_rays(tmp_path, capsys):
    assert reproduce(tmp_path / "x", "--address", "auto") == 2
    assert "address is of a Ray cluster: it needs the engine ray" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("given", ["0/2", "3/2", "1", "a/b", "1/2/3"])
def test_shards_that_there_are_not(tmp_path, capsys, given):
    assert reproduce(tmp_path / "x", "--shard", given) == 2
    assert f"shard must be I/N with I from 1 to N, such as 1/4, got '{given}'" in (
        capsys.readouterr().err
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_shards_train_the_whole(tmp_path, capsys):
    options = ["reproduce", "--levels", "1", "--algorithms", "trpo-lag", "cpo", "--seeds", "3"]
    options += ["--steps", "2000", "--backend", "eager", "--workers", "1"]
    parts = tmp_path / "parts" / "grid"
    for part in ("1/2", "2/2"):
        assert main([*options, "--out", str(parts), "--shard", part]) == 0
        assert f"part {part} is over" in capsys.readouterr().out
    assert not (parts / "report.md").exists()
    assert main([*options, "--out", str(tmp_path / "whole" / "grid")]) == 0
    assert main(["report", str(parts)]) == 0
    shutil.rmtree(parts / "pictures", ignore_errors=True)
    whole = tmp_path / "whole" / "grid"
    shutil.rmtree(whole / "pictures", ignore_errors=True)
    for of in (parts, whole):
        for path in (*of.rglob("worker.log"), of / "index.html", of / ".lock"):
            path.unlink(missing_ok=True)  # they name the folder; parts do not lock the whole
    assert (parts / "report.csv").read_bytes() == (whole / "report.csv").read_bytes()
    assert results(parts) == results(whole)
