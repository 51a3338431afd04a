"""The README's examples run as they stand there."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_sixth_algorithm_trains(tmp_path):
    """In a copy of the package, edited as the README says."""
    shutil.copytree(ROOT / "agents", tmp_path / "agents")
    ((path, code),) = re.findall(r"```python\n# (agents/\S+)\n(.*?)```", README, re.DOTALL)
    (tmp_path / path).write_text(code)
    ((imports, entry),) = re.findall(r"```python\n(from .*)\n\.\.\.\n( +.*)\n```", README)
    listing = tmp_path / "agents/algorithms/__init__.py"
    edited = re.sub(r"(?m)^from agents\.algorithms import .*$", imports, listing.read_text())
    listing.write_text(re.sub(r'(?m)^( +"wcsac": .*)$', rf"\1\n{entry}", edited))
    command = [sys.executable, "-m", "agents.cli", "train", "--algorithm", "sac-fixed"]
    command += ["--price", "0.5", "--seeds", "0", "--steps", "1000", "--out", "runs"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "SAC-Fixed (price 0.5, 1,000 steps), mean of 1" in done.stdout


def test_the_examples_run(opengl, tmp_path, monkeypatch):
    """One after another, as a reader would type them; a random agent stands for the reader's."""
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n((?!# agents/|from agents).*?)```", README, re.DOTALL)
    assert len(examples) == 3

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
    assert names["env"].records.total_steps == 500
