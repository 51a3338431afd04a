"""Mistakes on the command line: one line on stderr, status 2, nothing written."""

import re

import pytest
import torch

from agents.cli.main import main

TRAIN = ["train", "--algorithm", "sac-lag", "--seeds", "0", "1", "--steps", "600"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder that holds runs already."""
    path = tmp_path_factory.mktemp("runs") / "first"
    assert main([*TRAIN[:-1], "120", "--out", str(path)]) == 0
    return path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "--algorithm", "SAC-Lag"], "'SAC-Lag': did you mean 'sac-lag'\\?\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--lr", "1"], "--lr: did you mean '--learning-rate'\\?\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--level", "2"], "did you mean '--task Circle2D-1'\\?\n"),
        ([*TRAIN[:-2], "--out", "{tmp}/x", "--steps", "10,000"], "mean '10000' or '10 000'\\?\n"),
        ([*TRAIN[:-2], "--out", "{tmp}/x", "--steps", "1M"], "1000000 or 1e6, got '1M'\n"),
        (
            ["train", "--algorithm", "cpo", "--out", "{tmp}/x", "--seeds", "0-9"],
            "--seeds takes numbers with spaces between them, got '0-9'\n",
        ),
        (
            [*TRAIN, "--out", "{tmp}/x", "--input-scale", "15", "15,1.1"],
            "--input-scale takes numbers with spaces between them, got '15', '15,1.1'\n",
        ),
        ([*TRAIN, "--out", "{tmp}/x", "-s", "3"], "train takes no argument '-s'\n"),
        ([*TRAIN, "--out", "{folder}/config.json"], "be a folder, but '.*config.json' is a file\n"),
        ([*TRAIN, "--out", "{folder}/config.json/x"], "but '.*config.json' is a file\n"),
        (
            [*TRAIN, "--out", "{tmp}/x", "--step-timeout", "5"],
            "vectorization must be async, got auto\n",
        ),
        (
            [*TRAIN, "--out", "{tmp}/x", "--task-parameters", "optima_perturbation", "1", "0"],
            "takes pairs: NAME VALUE",
        ),
        (["resume"], "resume needs a folder of runs\n"),
        (["resume", "{folder}", "--steps", "9"], "'circle2d resume --help' lists those it has\n"),
        (["evaluate", "{folder}", "{folder}"], "evaluate takes no argument '.*first'\n"),
        (["report", "{folder}", "--format", "html"], "'circle2d report --help' lists those it has"),
        (
            ["report", "{folder}", "--archive", "{tmp}"],
            "archive must be a file, but '.*' is a folder",
        ),
        (["compare", "{folder}", "{tmp}/nothing"], "nothing is no folder\n"),
        (["heatmap", "{folder}", "--part", "1"], "part must be some of \\[0.33, 0.66, 0.99\\]"),
        (["heatmap", "{folder}", "--names", "a", "b"], "one for each of the 1 folders, got 2"),
        (["heatmap", "{folder}", "--out", "a.jpg"], "out must end in .png, got 'a.jpg'\n"),
        (["render", "{folder}", "--seed", "77"], "no run of seed 77: its seeds are \\[0, 1\\]\n"),
        (["render", "pretrained:cpo/Circle2D-2-v0"], "no policy of 'cpo' comes with the package"),
        (["export", "{folder}", "--format", "pt"], "'pt'.*'safetensors', 'onnx'"),
        (
            ["reproduce", "--out", "{tmp}/x", "--levels", "4"],
            "some of \\[0, 1, 2, 3\\], got \\[4\\]\n",
        ),
        (["reproduce", "--out", "{folder}/config.json"], "but '.*config.json' is a file\n"),
        (["reproduce", "--out", "{tmp}/x", "--shard", "5/4"], "I from 1 to N.*, got '5/4'\\n"),
        (["reproduce", "--out", "{tmp}/x", "--address", "host:1"], "needs the engine ray\\n"),
        (["fly"], "unknown command 'fly': valid are train, resume, evaluate, reproduce, report"),
        (["help"], "unknown command 'help': did you mean '--help'\\?\n"),
        (["-V"], "unknown option '-V': did you mean '--version'\\?\n"),
        (["trian"], "unknown command 'trian': did you mean 'train'\\?\n"),
        (["--verison"], "unknown option '--verison': did you mean '--version'\\?\n"),
        (["train", "--algorithm", "sac-log"], "'sac-log': did you mean 'sac-lag'\\?\n"),
        (["train", "--algorithm", "dqn"], "unknown algorithm 'dqn': valid are trpo-lag, "),
        (["train", "sac-lag", "--out", "{tmp}/x"], "did you mean '--algorithm sac-lag'\\?\n"),
        (["train", "--algo", "sac-lag"], "no option --algo: did you mean '--algorithm'\\?\n"),
        (["train", "--out", "{tmp}"], "train needs --algorithm: one of trpo-lag, "),
        ([*TRAIN], "train needs --out: Folder that the runs are written to"),
        ([*TRAIN, "--out"], "circle2d: --out needs a value\n"),
        ([*TRAIN, "--out", "{tmp}/x", "more"], "train takes no argument 'more'\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--seeds", "0,1"], "did you mean '0 1'\\?\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--learning-rate", "low"], "a number, got 'low'\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--device", "gpu"], "'gpu'.*'cpu', 'cuda'"),
        pytest.param(
            [*TRAIN, "--out", "{tmp}/x", "--device", "cuda"],
            "sees no GPU; 'cpu' is there\n",
            marks=pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU"),
        ),
        (
            [*TRAIN, "--out", "{tmp}/x", "--steps", "100"],
            "at least 101 for a table, got 100: .* 50",
        ),
        (
            ["train", "--algorithm", "cpo", "--steps", "1e3", "--out", "{tmp}/x"],
            "at least 1001 for a table, got 1000: .* 10 episodes of up to 50 steps\n",
        ),
        ([*TRAIN, "--out", "{tmp}/x", "--task-parameters", "radius"], "takes pairs: NAME VALUE"),
        (["reproduce", "--out", "{tmp}/x", "--quik"], "did you mean '--quick'\\?\n"),
        (["reproduce", "--out", "{tmp}/x", "--steps", "100"], "for a table, got 100"),
        (["report", "{folder}", "--width", "9"], "width must be at least 40, got 9\n"),
        (["evaluate"], "evaluate needs FOLDER: Folder of the runs"),
        (["render", "{tmp}/nothing", "{folder}", "--names", "a"], "one for each of the 2 folders"),
        (
            ["heatmap", "{folder}/.."],
            r"holds folders of runs: did you mean (one of )?.*'[^']*first'(, '[^']*')*\?\n",
        ),
        (["scene", "2"], "scene takes no argument '2': options begin with --\n"),
        (["scene", "--level", "9"], "circle2d: level must be one of \\(0, 1, 2, 3\\), got 9\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--task", "Nope-v1"], "unknown task 'Nope-v1': "),
        ([*TRAIN, "--out", "{tmp}/x", "--task", "CartPole-v1"], "action space.*flat Box"),
        ([*TRAIN, "--out", "{tmp}/x", "--task", "Pendulum-v1"], "info\\['cost'\\]"),
        ([*TRAIN, "--out", "{tmp}/x", "--task", "Circle2D-9"], "did you mean 'Circle2D-\\d-v0'\\?"),
        (
            [*TRAIN, "--out", "{tmp}/x", "--task", "SafetyPointGoal1-v0"],
            "did you mean 'circle2d_mj/SafetyPointGoal1-v0'",
        ),
        (
            [*TRAIN, "--out", "{tmp}/x", "--learning-rat", "1"],
            "train has no option --learning-rat: did you mean '--learning-rate'\\?\n",
        ),
        (
            [*TRAIN, "--out", "{tmp}/x", "--log_barrier_factor=3"],
            "no option --log-barrier-factor: an option of sac-lb, sac-lb-streak, not of sac-lag\n",
        ),
        ([*TRAIN, "--out", "{tmp}/x", "--qqq"], "'circle2d train --help' lists those it has\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--vectorization", "fast"], "invalid choice 'fast'"),
        ([*TRAIN, "--out", "{tmp}/x", "--import", "no_such"], "cannot import 'no_such': .*No mod"),
        ([*TRAIN, "--out", "{tmp}/x", "--import", "mine.py"], "a module's name: 'mine'\n"),
        (["report", "{tmp}", "--import", "no_such"], "cannot import 'no_such'"),
        ([*TRAIN, "--out", "{tmp}/x", "--learning-rate", "0"], "learning_rate must be above 0"),
        (
            [*TRAIN, "--out", "{tmp}/x", "--discount", "1.5"],
            "discount must be .*at most 1, got 1.5",
        ),
        ([*TRAIN, "--out", "{tmp}/x", "--batch-size", "100"], "multiples of 32, got 100"),
        ([*TRAIN, "--out", "{tmp}/x", "--replay-size", "64"], "batch_size must be at most 64"),
        (
            [*TRAIN, "--out", "{tmp}/x", "--task-parameters", "max_episode_steps", "None"],
            "episodes must end",
        ),
        (
            [*TRAIN, "--out", "{tmp}/x", "--task-parameters", "level", "3"],
            "level is part of the task's id",
        ),
        ([*TRAIN, "--out", "{tmp}/x", "--steps", "0"], "steps must be at least 1, got 0"),
        ([*TRAIN, "--out", "{tmp}/x", "--steps", "many"], "as 1000000 or 1e6, got 'many'\n"),
        ([*TRAIN, "--out", "{tmp}/x", "--steps", "1e-3"], "must be an integer .*got '1e-3'"),
        ([*TRAIN, "--out", "{tmp}/x", "--seeds", "1", "1"], "seeds must be different"),
        ([*TRAIN, "--out", "{tmp}/x", "--seeds", "-1"], "seeds must be in"),
        (
            [*TRAIN, "--out", "{tmp}/x", "--task-parameters", "radius", "3"],
            "unexpected keyword argument 'radius'",
        ),
        (["resume", "{tmp}/nothing"], "nothing is no folder"),
        (["evaluate", "{tmp}/nothing"], "nothing is no folder"),
        (["report", "{tmp}/nothing"], "nothing is no folder"),
        (["report", "{tmp}"], "holds no runs"),
        (["evaluate", "{folder}", "--episodes", "0"], "episodes must be at least 1"),
        ([*TRAIN, "--out", "{folder}"], "holds runs already: go on with them by 'circle2d resume"),
    ],
)
def test_mistakes(arguments, message, folder, tmp_path, capsys):
    arguments = [a.format(tmp=tmp_path, folder=folder) for a in arguments]
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("circle2d: ")
    assert err.count("\n") == 1
    assert err.lower().count("did you mean") <= 1
    assert re.search(message, err), err
    assert not (tmp_path / "x").exists()
