"""Environments that fail: one error with the task's name and the step; no process is left."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box

import agents
from agents.cli.main import main
from agents.errors import TaskFailure
from agents.training.environments import make_envs
from agents.training.loop import load_training

OPTIONS = ["--random-steps", "40", "--gradient-steps", "1", "--checkpoint-every", "40"]
OPTIONS += ["--backend", "eager", "--steps", "100", "--seeds", "0", "1"]


class Failing(gym.Env):
    """Episodes of 20 steps; from step `at` of all episodes on it fails in one of several ways."""

    observation_space = Box(-1.0, 1.0, (2,))
    action_space = Box(-1.0, 1.0, (1,))

    def __init__(self, how="never", at=50):
        self.how, self.at, self.taken = how, at, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        return np.zeros(2, np.float32), {}

    def step(self, action):
        self.t, self.taken = self.t + 1, self.taken + 1
        observation, reward, info = np.zeros(2, np.float32), float(action[0]), {"cost": 0.5}
        if self.taken >= self.at:
            if self.how == "observation":
                observation = np.zeros(3, np.float32)
            elif self.how == "reward":
                reward = np.zeros(2)
            elif self.how == "complex":
                reward = 1j
            elif self.how == "cost":
                info = {"cost": "much"}
            elif self.how == "raise":
                raise RuntimeError("motor\nbroken")
            elif self.how == "die":
                os._exit(3)
            elif self.how == "hang":
                time.sleep(60)
        return observation, reward, False, self.t == 20, info


if "Failing-v0" not in gym.registry:
    gym.register("Failing-v0", entry_point=Failing, disable_env_checker=True)


@pytest.mark.parametrize(
    ("how", "vectorization", "why"),
    [
        ("observation", "sync", "gives an observation of shape [3], its observation space has [2]"),
        ("reward", "sync", "gives reward = array([0., 0.]), which is no number"),
        ("complex", "sync", "gives reward = 1j, which is no number"),
        ("cost", "sync", "gives info['cost'] = 'much', which is no number"),
        ("raise", "sync", "RuntimeError: motor broken"),
        ("raise", "async", "RuntimeError: motor broken"),
        ("die", "async", "a process of its environments ended"),
        ("hang", "async", "a process did not answer within step_timeout, 0.5 s"),
    ],
)
def test_a_failing_environment_is_one_line(how, vectorization, why, tmp_path, capsys):
    """The checkpoint at step 40 is there, and training goes on from it."""
    out = tmp_path / "x"
    command = ["train", "--algorithm", "sac-lag", "--task", "Failing-v0", *OPTIONS]
    command += ["--task-parameters", "how", repr(how), "--vectorization", vectorization]
    if vectorization == "async":
        command += ["--step-timeout", "0.5"]
    assert main([*command, "--out", str(out)]) == 1
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("circle2d")]
    assert len(lines) == 1
    assert lines[0].startswith("circle2d: task 'Failing-v0' failed in step 10 of an episode: ")
    assert lines[0].endswith(why)
    assert not multiprocessing.active_children()
    assert load_training(out).steps.tolist() == [40, 40]


def test_arrays_of_other_shapes_from_a_vector_environment():
    with pytest.raises(
        TaskFailure, match=r"'Failing-v0' failed in step 1 .*: rewards must be \[3\]"
    ):
        envs = make_envs("Failing-v0", 3, {})
        step = envs.unwrapped.step
        envs.unwrapped.step = lambda actions: (step(actions)[0], np.zeros(2), *step(actions)[2:])
        envs.reset(seed=[1, 2, 3])
        envs.step(np.zeros((3, 1), np.float32))


def test_playing_a_policy_in_a_failing_environment():
    with pytest.raises(TaskFailure, match=r"'Failing-v0' failed in step 5 of an episode: Runtime"):
        agents.evaluate(
            lambda observation: np.zeros(1, np.float32),
            "Failing-v0",
            episodes=2,
            task_parameters={"how": "raise", "at": 5},
        )


PROGRAM = """
import signal
import sys

signal.signal(signal.SIGINT, signal.default_int_handler)  # a caller in the background ignores them
signal.signal(signal.SIGHUP, signal.SIG_DFL)
sys.path[:0] = {paths!r}
import test_guard
from agents.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


def children_of(pid):
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, fields = path.read_text().rpartition(")")
        except OSError:
            continue
        if int(fields.split()[1]) == pid:
            found.append(int(name.split()[0]))
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130), (signal.SIGKILL, -9)],
)
def test_a_signal_leaves_no_process_of_an_environment(number, status, tmp_path):
    """And, but for SIGKILL, a checkpoint and one line."""
    out = tmp_path / "x"
    program = PROGRAM.format(paths=[str(Path(__file__).parent)])
    command = [sys.executable, "-c", program, "train", "--algorithm", "sac-lag", *OPTIONS]
    command += ["--task", "Failing-v0", "--vectorization", "async", "--out", str(out)]
    command += ["--steps", "1e6", "--checkpoint-every", "1e6"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 180
    while not (out / "status.json").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    children = children_of(process.pid)
    assert children
    time.sleep(0.3)
    process.send_signal(number)
    try:
        _, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == status, err
    while any(Path(f"/proc/{pid}").exists() for pid in children):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    lines = [line for line in err.splitlines() if not line.startswith("sac-lag ")]
    if number == signal.SIGKILL:
        assert not lines
        return
    assert len(lines) == 1
    assert f"interrupted by {number.name} after" in lines[0]
    steps = int(lines[0].split(" after ")[1].split()[0])
    assert load_training(out).steps.min() == steps
