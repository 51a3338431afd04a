"""The README's examples run as they stand there."""

import re
from pathlib import Path

import gymnasium as gym
import pytest

from agents import cli
from agents.algorithms import ALGORITHMS

README = (Path(__file__).parents[1] / "README.md").read_text()
(SIXTH,) = re.findall(r"```python\n(# agents/algorithms/.*?)```", README, re.DOTALL)


@pytest.fixture
def sixth(monkeypatch, tmp_path):
    """The file of the README's example, and its line in ALGORITHMS."""
    path, code = re.match(r"# (\S+)\n(.*)", SIXTH, re.DOTALL).groups()
    file = tmp_path / Path(path).name
    file.write_text(code)
    namespace = {"__name__": "sixth"}
    exec(compile(code, file, "exec"), namespace)
    (line,) = re.findall(r'^"sac-fixed": Algorithm\((.*)\),$', README, re.MULTILINE)
    scope = {file.stem: type("module", (), namespace)}
    from agents.algorithms import Algorithm, OffPolicy

    entry = eval(f"Algorithm({line})", scope | {"Algorithm": Algorithm, "OffPolicy": OffPolicy})
    monkeypatch.setitem(ALGORITHMS, "sac-fixed", entry)


def test_the_sixth_algorithm_trains(sixth, tmp_path, capsys):
    options = ["--algorithm", "sac-fixed", "--price", "0.5", "--seeds", "0", "--steps", "1000"]
    assert cli.main(["train", *options, "--out", str(tmp_path / "runs")]) == 0
    assert "SAC-Fixed (price 0.5, 1,000 steps), mean of 1" in capsys.readouterr().out


def test_the_examples_run(opengl, tmp_path, monkeypatch):
    """One after another, as a reader would type them; a random agent stands for the reader's."""
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n((?!# agents/|\").*?)```", README, re.DOTALL)
    assert len(examples) == 3

    def training(env):
        env.reset(seed=0)
        for _ in range(500):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()

    names = {"your_env": gym.make("Circle2D-1-v0"), "your_training": training}
    for example in examples:
        exec(compile(example, "README.md", "exec"), names)
    assert (tmp_path / "circle2d.png").stat().st_size > 1000
    assert names["env"].records.total_steps == 500
