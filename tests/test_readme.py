"""The README's examples run as they stand there."""

import json
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def circle2d(folder, *args, status=0):
    command = [sys.executable, "-m", "agents.cli", *args]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    return done


@pytest.fixture
def folder(tmp_path):
    """A folder with the README's algorithm, outside the package."""
    ((name, code),) = re.findall(r"```python\n# (my_\w+\.py)\n(.*?)```", README, re.DOTALL)
    (tmp_path / name).write_text(code)
    return tmp_path


def test_an_algorithm_of_the_users_own(folder):
    """Trains by the README's command, resumes, is evaluated, reported and explained."""
    ((line),) = re.findall(r"```\ncircle2d (train --import my_.*)\n```", README)
    train = line.replace("runs/fixed", "runs").split()
    done = circle2d(folder, *train, "--seeds", "0", "--steps", "1e3")
    assert "SAC-Fixed (price 0.5, 1,000 steps), mean of 1" in done.stdout
    assert json.loads((folder / "runs/config.json").read_text())["algorithm"] == "sac-fixed"
    done = circle2d(folder, "resume", "runs", status=2)
    assert done.stderr.count("\n") == 1
    assert "my_algorithm" in done.stderr
    known = ("--import", "my_algorithm")
    circle2d(folder, "resume", "runs", *known)
    assert "J_R" in circle2d(folder, "evaluate", "runs", "--episodes", "2", *known).stdout
    assert "SAC-Fixed (price 0.5" in circle2d(folder, "report", "runs", *known).stdout
    text = circle2d(folder, "train", *known, "--algorithm", "sac-fixed", "--help").stdout
    assert "--price" in text
    assert "Price of a unit of discounted cost" in re.sub(r"[│\s]+", " ", text)
    assert "--price" in circle2d(folder, "train", *known, "--help").stdout


def test_an_algorithm_of_the_users_own_in_worker_processes(folder):
    command = [
        "reproduce",
        "--import",
        "my_algorithm",
        "--algorithms",
        "sac-fixed",
        "--levels",
        "1",
    ]
    command += ["--seeds", "0", "--steps", "1000", "--backend", "eager", "--out", "grid"]
    assert "SAC-Fixed (1,000 steps), mean of 1" in circle2d(folder, *command).stdout


def test_the_examples_run(opengl, tmp_path, monkeypatch):
    """One after another, as a reader would type them; a random agent stands for the reader's."""
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n((?!# my_).*?)```", README, re.DOTALL)
    assert len(examples) == 4

    def training(env):
        env.reset(seed=0)
        for _ in range(500):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()

    names = {"your_env": gym.make("circle2d_mj:Circle2D-1-v0"), "your_training": training}
    for example in examples:
        exec(compile(example, "README.md", "exec"), names)
    assert (tmp_path / "circle2d.png").stat().st_size > 1000
    assert names["action"].shape == (2,)
    assert names["env"].records.total_steps == 500
