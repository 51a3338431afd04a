"""An algorithm and a task from modules of the user."""

import subprocess
import sys

import gymnasium as gym
import numpy as np

import agents
from agents import algorithms


def test_an_algorithm_and_a_task_from_outside(tmp_path, monkeypatch):
    """Both from modules of the user, without an edit of the package."""
    (tmp_path / "my_algorithm.py").write_text(
        "from dataclasses import dataclass\n"
        "import agents\n"
        "from agents.algorithms.sac_lb import ALGORITHM\n"
        "@dataclass(frozen=True)\n"
        "class MyConfig(ALGORITHM.config):\n"
        "    my_factor: float = 0.5\n"
        "    'A number of mine.'\n"
        "agents.register('sac-mine', ALGORITHM._replace(title='Mine', config=MyConfig))\n"
    )
    (tmp_path / "my_task.py").write_text(
        "import gymnasium as gym\nfrom toys import Walk\ngym.register('Mine-v0', Walk)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import my_algorithm  # noqa: F401

    options = {"my_factor": 0.25, "random_steps": 20, "gradient_steps": 1, "backend": "eager"}
    out = tmp_path / "x"
    try:
        runs = agents.train("sac-mine", "my_task:Mine-v0", seeds=0, steps=60, out=out, **options)
        assert runs.config.hyperparameters.my_factor == 0.25
        assert agents.load_policy(out)(np.zeros(2)).shape == (1,)
        code = "import sys, agents\ntry: agents.resume(sys.argv[1])\n"
        code += "except agents.UserError as error: print(error)"
        command = [sys.executable, "-c", code, str(out)]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        assert "'sac-mine'" in said
        assert "import my_algorithm first (--import my_algorithm)" in said
    finally:
        algorithms._algorithms.registered.pop("sac-mine", None)
        gym.registry.pop("Mine-v0", None)
