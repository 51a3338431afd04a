"""How a report was made: commands that train the same again, machine, time from status.json."""

import shlex
from dataclasses import replace

import pytest
from small_runs import write_status

from agents.cli.main import main
from agents.paper.presets import preset
from agents.reporting.provenance import command, made
from agents.results.reading import Group
from agents.results.source import FolderSource
from agents.training import machine
from agents.training.config import TrainConfig
from agents.training.files import read_json
from agents.training.status import duration


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(40, "40 s"), (100, "2 min"), (3599, "1 h 0 min"), (10_920, "3 h 2 min")],
)
def test_duration(seconds, words):
    assert duration(seconds) == words


def test_the_command_trains_the_same(tmp_path):
    hyperparameters = replace(preset("sac-lag", "Circle2D-3-v0"), cost_limit=3.0, hidden=(32, 64))
    parameters = {"constraint_radius": 3.0, "optima_perturbation": (1.0, 0.5)}
    config = TrainConfig("sac-lag", "Circle2D-3-v0", (4, 7), 50, hyperparameters, parameters)
    config = replace(config, vectorization="sync")
    said = command(config, str(tmp_path / "with a space"))
    program, *arguments = shlex.split(said)
    assert program == "circle2d"
    assert main(arguments) == 0
    assert (
        replace(TrainConfig.read(tmp_path / "with a space"), task_parameters=parameters) == config
    )
    assert "--hidden 32 64 " in said
    assert "--discount" not in said  # as the preset has it
    assert "--device" not in said
    on_gpu = replace(config, device="cuda", backend="compiled")
    assert "--backend compiled --vectorization sync --device cuda" in command(on_gpu, "x")


def test_what_is_told(tmp_path):
    groups = []
    for name in ("cpo", "wcsac"):
        task = "Circle2D-1-v0"
        config = TrainConfig(name, task, (0, 1), 1000, preset(name, task))
        config.write(tmp_path / name)
        write_status(tmp_path / name, 1.0, **{name: 300.4})
        groups.append(Group(name, config, []))
    of = machine.machine()
    assert (
        made(FolderSource(tmp_path), groups)["machine"] == f"{of['processor']}, {of['cores']} cores"
    )
    assert made(FolderSource(tmp_path), groups)["training time"] == "10 min, all processes together"
    first, second = made(FolderSource(tmp_path), groups)["command"].splitlines()
    assert first == (
        "circle2d train --algorithm cpo --task Circle2D-1-v0 --seeds 0 1 --steps 1000 "
        f"--backend eager --out {tmp_path.name}/cpo"
    )
    assert "wcsac" in second
    assert made(FolderSource(tmp_path), groups)["steps"] == "1,000"
    assert read_json(tmp_path / "cpo" / "seed-0" / "config.json")["machine"] == of
    # Runs of before these were recorded.
    content = (tmp_path / "cpo" / "config.json").read_text().replace('"machine"', '"versions"')
    (tmp_path / "cpo" / "config.json").write_text(content)
    (tmp_path / "cpo" / "checksums.json").unlink()
    (tmp_path / "cpo" / "status.json").unlink()
    told = made(FolderSource(tmp_path), groups)["training time"]
    assert told == "5 min, all processes together, of 1 of 2 folders"
    assert made(FolderSource(tmp_path), groups[:1]).keys() == {
        "command",
        "versions",
        "runs",
        "seeds",
        "steps",
    }


def test_who_went_on_is_recorded_and_told(tmp_path, monkeypatch):
    config = TrainConfig("cpo", "Circle2D-1-v0", (0,), 1000, preset("cpo", "Circle2D-1-v0"))
    config.write(tmp_path)
    before = (tmp_path / "config.json").read_bytes()
    machine.note_session(tmp_path)
    assert machine.other_session(tmp_path) == ""
    assert (tmp_path / "config.json").read_bytes() == before
    monkeypatch.setattr(machine, "machine", lambda: {"processor": "A Chip", "cores": 9})
    for _ in range(2):  # asking changes nothing
        said = machine.other_session(tmp_path)
        assert said.startswith("trained so far with other machine {'processor': ")
    machine.note_session(tmp_path)
    assert machine.other_session(tmp_path) == ""
    monkeypatch.setattr(machine, "versions", lambda: {"torch": "9.9"})
    said = machine.other_session(tmp_path)
    assert said.startswith("trained so far with other versions {'python'")
    machine.note_session(tmp_path)
    assert TrainConfig.read(tmp_path) == config
    told = made(FolderSource(tmp_path), [Group(".", config, [])])
    assert told["machine"].count(" cores") == 2
    assert "A Chip, 9 cores" in told["machine"]
    assert "torch 9.9" in told["versions"]
    assert "numpy" in told["versions"]


def test_processor(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "CPUINFO", tmp_path / "cpuinfo")
    assert machine.machine()["processor"]  # where there is no such file
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nmodel name\t: A  Chip 9\nmodel name\t: B\n")
    assert machine.machine()["processor"] == "A  Chip 9"
