"""How a report was made: commands that train the same again, machine, time from status.json."""

import shlex
import subprocess
from dataclasses import asdict, replace
from types import SimpleNamespace

from small_runs import write_evaluated, write_status

from agents.cli.main import main
from agents.paper.presets import preset
from agents.reporting import provenance
from agents.reporting.provenance import command, made
from agents.results.reading import read
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
