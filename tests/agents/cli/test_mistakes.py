"""Mistakes on the command line: one line on stderr, status 2, and nothing is written."""

import os
import re
import sys
from pathlib import Path

import pytest

import agents
from agents.cli.main import main
from agents.errors import extra_hint
from agents.training import config
from emcc import EpisodeRecords

TRAIN = ("train", "sac-lag", "--seeds", "0", "1", "--steps", "600", "--backend", "numpy")
TO = (*TRAIN, "--out", "{tmp}/x")
REPRODUCE = ("reproduce", "--quick", "--out", "{tmp}/x")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder that holds runs already."""
    path = tmp_path_factory.mktemp("runs") / "first"
    assert main([*TRAIN, "--steps", "120", "--out", str(path)]) == 0
    return path


def mistake(arguments, capsys):
    """Run a command that is refused and return its line on stderr."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("circle2d: ")
    assert err.count("\n") == 1
    assert "\x1b" not in err
    return err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fly"], "'fly': valid are train, resume, grid, evaluate, reproduce, zoo, report"),
        (["train"], "train needs the algorithm first: one of trpo-lag, "),
        (["train", "SAC-Lag"], "'SAC-Lag': did you mean 'sac-lag'"),
        (TRAIN, "--out"),
        ([*TO, "--learning-rat", "1"], "^circle2d: Unrecognized options: --learning-rat, 1 "),
        ([*TO, "--lr", "1"], "--lr is --learning-rate here"),
        ([*TO, "--kl-stop", "3"], "no hyper-parameter 'kl_stop': it belongs to ppo-lag, "),
        ([*TRAIN, "--out", ""], "--out is followed by an empty word"),
        ([*TO, "--import", "mine.py"], "the name of a module: 'mine'"),
        ([*TO, "--import", "typo.mine"], "there is no module 'typo.mine'"),
        ([*TO, "--steps", "1M"], "^circle2d: Error parsing --steps: .*must .* 1e6, got '1M'"),
        (["train", "cpo", "--seeds", "-1", "--out", "{tmp}/x"], "seeds must be in"),
        ([*TO, "--hidden", "60000", "60000"], "hidden need about [0-9.,]+ GB of memory"),
        ([*TO, "--replay-size", "1e10", "--steps", "1e10"], "replay_size .* GB .* for 2 runs"),
        ([*TO, "--replay-size", "1e12"], "replay_size 1000000000000 cannot be allocated"),
        ([*TO, "--backend", "compiled"], "--backend"),
        ([*TO, "--task", "Circle2D-9"], "did you mean 'Circle2D-\\d-v0'"),
        ([*TO, "--task", "\x1b[31mred"], r"\\x1b\[31mred"),
        ([*TO, "--task", "CartPole-v1"], "action space.*flat Box.*continuous.*RecordCosts"),
        ([*TO, "--task", "Pendulum-v1"], "info\\['cost'\\]"),
        ([*TO, "--task", "Circle2D-1", "Circle2D-1"], "different"),
        ([*TO, "--task", "Circle2D-1", "--task=Circle2D-2"], "--task is given twice: give all"),
        ([*TO, "--hidden", "9", "--hidden=8"], "--hidden is given twice"),
        ([*TO, "--seeds", "3"], "--seeds is given twice"),
        ([*TO, "--task-parameters", "max_episode_steps", "None"], "episodes must end"),
        (
            [*TRAIN, "--out", "{folder}"],
            "holds runs already, which are done: train them longer by 'circle2d resume",
        ),
        ([*TRAIN, "--out", "{folder}/config.json"], "be a folder, but '.*config.json' is a file"),
        (["resume"], "resume needs a folder of runs"),
        (["report", "{folder}", "--width", "9"], "width must be at least 40 or None, got 9"),
        (["report", "{folder}", "--archive", "{tmp}"], "is a folder: give the path of a file"),
        (["report", "{folder}", "--out", os.devnull], "be a folder, but '.*null' is a file"),
        (["compare", "{folder}", "{folder}", "--out", os.devnull], "be a folder, but '.*null' is"),
        ([*TO, "--task", "typo.mine:X-v0"], "no module 'typo.mine'.*give --import typo.mine"),
        (["heatmap", "{folder}", "--part", "1"], "part must be among \\[0.33, 0.66, 0.99\\]"),
        (["heatmap", "{folder}", "--out", "a.jpg"], "out must end in .png, got 'a.jpg'"),
        (["render", "{folder}", "--out", "{folder}/config.json/a.gif"], "config.json' is a file"),
        (["render", "{folder}", "--camera", "side"], "camera needs --frames mujoco"),
        (["render", "{folder}", "--every", "5"], "every is for films"),
        (["render", "pretrained:p3o/Circle2D-2-v0"], "no policy of 'p3o' comes with the package"),
        (["export", "{folder}", "--format", "pt"], "safetensors"),
        (["scene", "--task-parameters", "mass", "0"], "mass must be above 0"),
        (["scene", "Circle2D-1-v0"], "task must be one of Circle2DMuJoCo-0-v0"),
        ([*REPRODUCE, "--levels", "4"], "levels must be among \\[0, 1, 2, 3\\], got \\[4\\]"),
        ([*REPRODUCE, "--benchmark", "--safety"], "benchmark has its own tasks"),
        ([*REPRODUCE, "--levels", "1", "--safety"], "give only one choice of tasks"),
        ([*REPRODUCE, "--algorithms"], "algorithms must be among trpo-lag, .*, got none"),
        (
            [*REPRODUCE, "--workers", "0"],
            "workers must be at least 1 and at most 1024 or None, got 0",
        ),
        ([*REPRODUCE, "--address", "host:1"], "needs the engine ray"),
        ([*REPRODUCE, "--shard", "0/2"], "I/N with I from 1 to N, .* got '0/2'"),
        (["reproduce", "--out", "{folder}/config.json"], "but '.*config.json' is a file"),
    ],
    ids=lambda given: " ".join(given)[:60] if isinstance(given, (list, tuple)) else "",
)
def test_mistakes(arguments, message, folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(config, "machine_memory", lambda: 64 * 10**9)
    err = mistake([a.format(tmp=tmp_path, folder=folder) for a in arguments], capsys)
    assert re.search(message, err), err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("module", "options", "hint"),
    [
        ("tensorboard", [*TRAIN, "--tensorboard"], "[tensorboard]"),
        ("ray", ["reproduce", "--quick", "--engine", "ray"], "[ray]"),
        ("onnx", ["export", "{folder}", "--format", "onnx"], "[export]"),
    ],
)
def test_a_missing_library_is_named_with_its_extra(
    module, options, hint, folder, tmp_path, capsys, monkeypatch
):
    monkeypatch.setitem(sys.modules, module, None)
    options = [word.format(folder=folder) for word in options]
    assert f"pip install -c constraints.txt '.{hint}'" in mistake(
        [*options, "--out", str(tmp_path / "x")], capsys
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("importer", "needs"),
    [("agents/cli/showing.py", True), ("agents/zoo.py", True), ("../my_algorithm.py", False)],
)
def test_the_hint_of_an_extra_is_only_for_imports_by_this_package(importer, needs):
    """A user's file may lack the same library. What counts is the file with the import statement,
    behind the frames of Python's import system."""
    file = str(Path(agents.__file__).parents[1] / importer)
    code = "def imports(name):\n    import importlib\n    importlib.import_module(name)"
    names = {}
    exec(compile(code, file, "exec"), names)
    with pytest.raises(ModuleNotFoundError) as caught:
        names["imports"]("rich.nothing_of_that_name")
    hint = extra_hint(caught.value, "train")
    assert hint.startswith("train needs rich.nothing_of_that_name, which") if needs else not hint


@pytest.mark.parametrize(
    "command",
    [
        ["report", "{folder}", "--archive", "{pipe}"],
        ["heatmap", "{folder}", "--out", "{pipe}"],
    ],
)
def test_a_pipe_or_a_device_is_not_replaced(command, folder, tmp_path, capsys):
    os.mkfifo(pipe := tmp_path / "a.png")
    err = mistake([word.format(folder=folder, pipe=pipe) for word in command], capsys)
    assert "a.png is a device or a pipe" in err
    assert pipe.is_fifo()
    with pytest.raises(ValueError, match=r"a\.png is a device or a pipe"):
        EpisodeRecords.from_costs([1.0], [1]).save(pipe)
    assert pipe.is_fifo()


def test_only_import_looks_into_the_current_folder(folder, tmp_path, monkeypatch, capsys):
    """It may hold anything, such as a file with the name of a library that torch imports."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [part for part in sys.path if part])
    own = tmp_path / "zz_own.py"
    own.write_text("")
    for command in ("report", "evaluate", "resume"):
        more = ["--episodes", "1"] if command == "evaluate" else []
        assert main([command, str(folder), *more]) == 0
        assert str(tmp_path) not in sys.path
    assert main(["report", str(folder), "--import", "zz_own"]) == 0
    assert sys.path[-1] == str(tmp_path)
    assert "zz_own" in sys.modules


def test_processes_that_train_do_not_look_into_the_current_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "numpy.py").write_text("raise RuntimeError('taken from the current folder')")
    grid = {"seeds": 0, "steps": 100, "hidden": (8,)}
    agents.sweep("trpo-lag", grid={"cost_limit": (1.0,)}, out=tmp_path / "x", **grid)
