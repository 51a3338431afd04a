"""How a report was made: commands that train the same again, machine, time from status.json."""

import json
import shlex
import subprocess
from dataclasses import asdict, replace
from types import SimpleNamespace

from small_runs import write_evaluated, write_status

from agents.cli.main import main
from agents.paper.presets import preset
from agents.reporting import provenance
from agents.reporting.provenance import command, heading, made, summary
from agents.results.reading import Group, read
from agents.training import config
from agents.training.config import TrainConfig


def test_the_command_trains_the_same(tmp_path):
    hyperparameters = replace(preset("sac-lag", "Circle2D-3-v0"), cost_limit=3.0, hidden=(32, 64))
    parameters = {"constraint_radius": 3.0, "optima_perturbation": (1.0, 0.5)}
    config = TrainConfig("sac-lag", ("Circle2D-3-v0",), (4, 7), 150, hyperparameters, parameters)
    config = replace(config, vectorization="sync")
    said = command(config, str(tmp_path / "with a space"), {})
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
    assert "--backend compiled --vectorization sync --device cuda" in command(on_gpu, "x", {})


def test_the_command_imports_what_registers_algorithm_and_task():
    preset_of = preset("sac-lag", "Circle2D-3-v0")
    config = TrainConfig("sac-lag", ("Circle2D-3-v0",), (4,), 150, preset_of)
    own_task = {"modules": ["my_tasks"]}
    assert command(config, "x", own_task).startswith("circle2d train sac-lag --import my_tasks ")
    by_prefix = replace(config, tasks=("my_tasks:Mine-v0",))
    assert "--import" not in command(by_prefix, "x", own_task)
    content = asdict(config) | {"algorithm": "mine"}
    own = TrainConfig.parse(content, "x", strict=False)  # not registered here
    for modules, imports in ((["a", "b"], ["a", "b"]), (["__main__"], []), ([], [])):
        said = command(own, "x", {"modules": modules}).partition(" --task")[0]
        assert said == " ".join(["circle2d train mine", *(f"--import {m}" for m in imports)])


def test_what_is_told(tmp_path):
    for name in ("cpo", "wcsac"):
        write_evaluated(tmp_path / name, name, costs=(1, 2))
        write_status(tmp_path / name, 1.0, **{name: 300.4})
    told = made(read([tmp_path], []))
    assert told["training time"] == "10 min, all processes together"
    assert told["program"].startswith("circle2d-mj ")
    first, second = told["command"].splitlines()
    assert first == (
        "circle2d train cpo --task Circle2D-1-v0 --seeds 0 1 --steps 100 "
        f"--backend eager --out {tmp_path.name}/cpo"
    )
    assert "wcsac" in second
    assert (told["runs"], told["steps"]) == ("4", "100")
    (tmp_path / "cpo" / "status.json").unlink()
    groups = read([tmp_path], [])
    assert made(groups)["training time"] == "5 min, all processes together, of 1 of 2 folders"
    assert not {"machine", "training time"} & made(groups[:1]).keys()


def test_every_machine_and_version_is_told(tmp_path):
    write_evaluated(tmp_path, "cpo", costs=(1,))
    chips = {f"{k}": {"seconds": 1, "machine": {"processor": k, "cores": 9}} for k in ("A", "B")}
    chips["A"]["versions"] = {"torch": "9.9"}
    (tmp_path / "status.json").write_text(json.dumps({"share": 1.0, "sessions": chips}))
    told = made(read([tmp_path], []))
    assert (told["machine"], told["versions"]) == ("A, 9 cores; B, 9 cores", "torch 9.9")


def test_a_title_and_a_line_that_name_the_runs():
    """Of algorithms in the registry's order, however the folders are called."""
    hyperparameters = preset("wcsac", "Circle2D-1-v0")
    one = TrainConfig("wcsac", ("Circle2D-1-v0",), tuple(range(10)), 1000, hyperparameters)
    other = TrainConfig("cpo", ("Circle2D-2-v0",), (0, 3), 2000, preset("cpo", "Circle2D-2-v0"))
    groups = [
        Group(name, config.tasks[0], config, [], []) for name, config in (("a", one), ("b", other))
    ]
    assert heading(groups) == "CPO and WCSAC on Circle2D-1-v0 and Circle2D-2-v0"
    assert heading(groups[:1]) == "WCSAC on Circle2D-1-v0"
    assert summary(groups) == (
        "0 runs, 2 tasks, 2 algorithms, seeds 0 to 9, 1,000 or 2,000 steps each"
    )
    again = replace(one, hyperparameters=replace(hyperparameters, cost_limit=1.0))
    groups = [
        Group("a", "Circle2D-1-v0", one, [], []),
        Group("b", "Circle2D-1-v0", again, [], []),
        Group("c", "Circle2D-2-v0", other, [], []),
    ]
    assert "1 algorithm, 2 settings, seeds 0 to 9" in summary(groups[:2])
    assert "seeds 0, 3, 2,000 steps each" in summary(groups[2:])
    many = [Group(f"{k}", f"Circle2D-{k}-v0", one, [], []) for k in range(6)]
    assert heading(many) == "WCSAC on 6 tasks"


def test_the_commit_is_told_where_it_is_known(tmp_path, monkeypatch):
    module = tmp_path / "agents" / "training" / "config.py"
    monkeypatch.setattr(config, "__file__", str(module))
    origin = SimpleNamespace(read_text=lambda name: None)
    monkeypatch.setattr(config, "distribution", lambda name: origin)
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
