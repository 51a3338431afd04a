"""How a report was made: commands that train the same again, machine, time from status.json."""

import shlex
import subprocess
from dataclasses import asdict, replace
from types import SimpleNamespace

from small_runs import write_status

from agents.cli.main import main
from agents.paper.presets import preset
from agents.reporting import provenance
from agents.reporting.provenance import command, heading, made, summary
from agents.results.reading import Group
from agents.results.source import FolderSource
from agents.training import machine
from agents.training.config import TrainConfig
from agents.training.files import read_json


def test_the_command_trains_the_same(tmp_path):
    hyperparameters = replace(preset("sac-lag", "Circle2D-3-v0"), cost_limit=3.0, hidden=(32, 64))
    parameters = {"constraint_radius": 3.0, "optima_perturbation": (1.0, 0.5)}
    config = TrainConfig("sac-lag", "Circle2D-3-v0", (4, 7), 150, hyperparameters, parameters)
    config = replace(config, vectorization="sync")
    said = command(config, config.task, str(tmp_path / "with a space"), {})
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
    assert "--backend compiled --vectorization sync --device cuda" in command(
        on_gpu, config.task, "x", {}
    )


def test_the_command_imports_what_registers_algorithm_and_task():
    config = TrainConfig("sac-lag", "Circle2D-3-v0", (4,), 150, preset("sac-lag", "Circle2D-3-v0"))
    own_task = {"algorithm_module": "agents.algorithms.sac_lag", "task_module": "my_tasks"}
    assert command(config, config.task, "x", own_task).startswith(
        "circle2d train --import my_tasks --algorithm"
    )
    by_prefix = replace(config, task="circle2d_mj:Circle2D-3-v0")
    assert "--import" not in command(by_prefix, by_prefix.task, "x", own_task)
    content = asdict(config) | {"algorithm": "mine"}
    own = TrainConfig.parse(content, "x", strict=False)  # not registered here
    for recorded, imports in (
        ({"algorithm_module": "my_module", "task_module": "my_tasks"}, "my_module my_tasks"),
        ({"algorithm_module": "mine", "task_module": "mine"}, "mine"),
        ({"algorithm_module": "__main__", "task_module": "__main__"}, ""),
        ({}, ""),  # a folder of before they were recorded
    ):
        said = command(own, own.task, "x", recorded).partition(" --algorithm")[0]
        assert said == " ".join(["circle2d train", *(f"--import {m}" for m in imports.split())])


def unfinished(folder, *names):
    """Groups of folders without a complete run."""
    groups = []
    for name in names:
        path = folder / name
        config, recorded = TrainConfig.read(path), read_json(path / "config.json")
        title, source = f"{folder.name}/{name}", FolderSource(folder)
        groups.append(Group(name, config, [], title=title, recorded=recorded, source=source))
    return groups


def test_what_is_told(tmp_path):
    for name in ("cpo", "wcsac"):
        task = "Circle2D-1-v0"
        config = TrainConfig(name, task, (0, 1), 1000, preset(name, task))
        config.write(tmp_path / name)
        write_status(tmp_path / name, 1.0, **{name: 300.4})
    told, here = made(unfinished(tmp_path, "cpo", "wcsac")), machine.machine()
    assert told["machine"] == f"{here['processor']}, {here['cores']} cores"
    assert told["training time"] == "10 min, all processes together"
    assert told["program"].startswith("circle2d-mj ")
    first, second = told["command"].splitlines()
    assert first == (
        "circle2d train --algorithm cpo --task Circle2D-1-v0 --seeds 0 1 --steps 1000 "
        f"--backend eager --out {tmp_path.name}/cpo"
    )
    assert "wcsac" in second
    assert told["steps"] == "1,000"
    # Runs of before these were recorded.
    content = (tmp_path / "cpo" / "config.json").read_text().replace('"machine"', '"versions"')
    (tmp_path / "cpo" / "config.json").write_text(content)
    (tmp_path / "cpo" / "checksums.json").unlink()
    (tmp_path / "cpo" / "status.json").unlink()
    groups = unfinished(tmp_path, "cpo", "wcsac")
    assert made(groups)["training time"] == "5 min, all processes together, of 1 of 2 folders"
    assert not {"machine", "training time"} & made(groups[:1]).keys()


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
    told = made(unfinished(tmp_path, "."))
    assert told["machine"].count(" cores") == 2
    assert "A Chip, 9 cores" in told["machine"]
    assert "torch 9.9" in told["versions"]
    assert "numpy" in told["versions"]


def test_processor(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "CPUINFO", tmp_path / "cpuinfo")
    assert machine.machine()["processor"]  # where there is no such file
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nmodel name\t: A  Chip 9\nmodel name\t: B\n")
    assert machine.machine()["processor"] == "A  Chip 9"


def test_a_title_and_a_line_that_name_the_runs():
    """Of algorithms in the registry's order, however the folders are called."""
    hyperparameters = preset("wcsac", "Circle2D-1-v0")
    one = TrainConfig("wcsac", "Circle2D-1-v0", tuple(range(10)), 1000, hyperparameters)
    other = TrainConfig("cpo", "Circle2D-2-v0", (0, 3), 2000, preset("cpo", "Circle2D-2-v0"))
    groups = [Group(name, config, []) for name, config in (("a", one), ("b", other))]
    assert heading(groups) == "CPO and WCSAC on Circle2D-1-v0 and Circle2D-2-v0"
    assert heading(groups[:1]) == "WCSAC on Circle2D-1-v0"
    assert summary(groups) == (
        "0 runs, 2 tasks, 2 algorithms, seeds 0 to 9, 1,000 or 2,000 steps each"
    )
    again = replace(one, hyperparameters=replace(hyperparameters, cost_limit=1.0))
    groups = [Group("a", one, []), Group("b", again, []), Group("c", other, [])]
    assert "1 algorithm, 2 settings, seeds 0 to 9" in summary(groups[:2])
    assert "seeds 0, 3, 2,000 steps each" in summary(groups[2:])
    many = [Group(f"{k}", replace(one, task=f"Circle2D-{k}-v0"), []) for k in range(6)]
    assert heading(many) == "WCSAC on 6 tasks"


def test_the_commit_is_told_where_it_is_known(tmp_path, monkeypatch):
    module = tmp_path / "agents" / "training" / "machine.py"
    monkeypatch.setattr(machine, "__file__", str(module))
    origin = SimpleNamespace(read_text=lambda name: None)
    monkeypatch.setattr(machine, "distribution", lambda name: origin)
    assert "commit" not in provenance.program()
    origin.read_text = lambda name: '{"url": "", "vcs_info": {"vcs": "git", "commit_id": "b1c2"}}'
    assert provenance.program().endswith(", commit b1c2")  # as pip notes it
    (tmp_path / "a").write_text("")
    for words in ("init -q", "add a", "-c user.name=a -c user.email=b commit -qm x"):
        subprocess.run(["git", "-C", str(tmp_path), *words.split()], check=True)
    head = subprocess.run(
        ["git", "-C", str(tmp_path), "rev-parse", "HEAD"], capture_output=True, text=True
    ).stdout.strip()
    assert provenance.program().endswith(f", commit {head}")
    (tmp_path / "a").write_text("changed")
    assert provenance.program().endswith(f", commit {head}-dirty")
