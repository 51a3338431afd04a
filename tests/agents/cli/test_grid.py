"""`circle2d grid` and `agents.grid`: several algorithms on several tasks with given settings."""

import re

import gymnasium as gym
import pytest
from small_runs import differing, run_of
from toys import Walk, registered

import agents
from agents.cli.main import main
from agents.cli.options import split_options
from agents.cli.training import GridOptions
from agents.errors import UserError
from agents.training.config import TrainConfig

TASKS = ("Circle2D-1-v0", "Circle2D-2-v0")
FEW = ["--steps", "200", "--seeds", "0", "1", "--evaluation-episodes", "1"]
FEW += ["--backend", "numpy", "--hidden", "8", "8"]


def test_every_algorithm_trains_on_every_task_with_the_settings_given(tmp_path, capsys):
    """A run gives the same bits by `circle2d grid`, by `agents.grid` and by `agents.train`."""
    own = ["--episodes", "2", "--cost-limit=3", "--normalize-observations", "--workers", "1"]
    args = ["grid", "trpo-lag", "cpo", "--task", *TASKS, *FEW, *own, "--out", str(tmp_path / "a")]
    assert main(args) == 0
    assert capsys.readouterr().out.count("CPO (") >= 2  # a table of each task
    places = [tmp_path / "a" / task / name for task in TASKS for name in ("trpo-lag", "cpo")]
    for place in places:
        config = TrainConfig.read(place)
        hyperparameters = config.hyperparameters
        assert (config.steps, config.seeds, hyperparameters.hidden) == (200, (0, 1), (8, 8))
        assert (hyperparameters.cost_limit, hyperparameters.episodes) == (3.0, 2)
        assert hyperparameters.normalize_observations
    settings = {"steps": 200, "seeds": (0, 1), "evaluation_episodes": 1, "hidden": (8, 8)}
    settings |= {"episodes": 2, "cost_limit": 3.0, "normalize_observations": True}
    how = {"out": tmp_path / "b", "backend": "numpy", "workers": 1}
    found = agents.grid(["cpo"], TASKS[0], **how, **settings)
    straight = agents.train("cpo", TASKS[0], out=tmp_path / "c", backend="numpy", **settings)
    for run in straight.config.runs:
        expected = run_of(straight.folder, run)
        for folder in (found.folder, tmp_path / "a" / TASKS[0] / "cpo"):
            differ = differing(run_of(folder, run), expected)
            # Evaluations in this process have fewer episodes: see conftest.
            assert {
                name for name in differ if not name.startswith(("evaluation", "trained"))
            } == set()
    assert main(args) == 0  # everything is trained already: it only reports


class Bad(Walk):
    """A walk that fails in the second step of an episode."""

    def step(self, action):
        if self.t == 1:
            raise FloatingPointError("unstable")
        return super().step(action)


def test_a_cell_that_has_failed_says_how_it_is_trained_again(tmp_path, capsys, monkeypatch):
    """The same command leaves it as it is, even if its task no longer fails."""
    own = {"steps": 200, "seeds": (0, 1), "evaluation_episodes": 1, "hidden": (8, 8)}
    cell = tmp_path / "Bad-v0" / "cpo"
    args = ["grid", "cpo", "--task", "Bad-v0", *FEW, "--out", str(tmp_path), "--workers", "1"]
    with registered(Bad=Bad):
        with pytest.raises(UserError, match=r"every run of .*Bad-v0/cpo failed"):
            agents.train("cpo", "Bad-v0", out=cell, backend="numpy", **own)
        monkeypatch.setattr(gym.spec("Bad-v0"), "entry_point", Walk)
        assert main(args) == 1
        words = rf"circle2d: {re.escape(str(cell))}: holds runs that failed: .*remove it"
        assert re.search(words, capsys.readouterr().err)


def test_options_of_algorithms_are_read_apart():
    args = "cpo --hidden 8 8 --pid-kp=1e-2 --seeds 3 4 --normalize-observations --no-x --activation"
    own, values = split_options(GridOptions, [*args.split(), "tanh", "--tensorboard", "--out", "a"])
    assert own == ["cpo", "--seeds", "3", "4", "--tensorboard", "--out", "a"]
    assert values == {
        "hidden": (8, 8),
        "pid_kp": 0.01,
        "normalize_observations": True,
        "x": False,
        "activation": "tanh",
    }


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["ppo", "cpo", "--cost-limit", "3"], "ppo has no hyper-parameter 'cost_limit'"),
        (["cpo", "--cost-limt", "3"], "did you mean 'cost_limit'?"),
        (["cpo", "--cost-limit", "three"], "cost_limit must be a finite number, got 'three'"),
        ([], "grid needs at least one algorithm"),
        (["cpo", "--shard", "3/2"], "shard must be I/N"),
    ],
)
def test_mistakes_are_named_before_anything_is_written(args, words, tmp_path, capsys):
    assert main(["grid", *args, "--out", str(tmp_path / "a")]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
