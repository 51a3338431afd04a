"""Environments that fail at random steps, and `reproduce` killed at random moments."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
from fault_common import SAC, SMALL, Tally, difference, forked, leftovers
from gymnasium.spaces import Box
from small_runs import results

from agents.cli.main import main
from agents.training.files import numbered

HOW = ("observation", "reward", "cost", "raise", "exit", "die", "hang", "nan", "negative")


class Faulty(gym.Env):
    """Episodes of 10 steps; from step `at` of all on it fails."""

    observation_space = Box(-1.0, 1.0, (2,))
    action_space = Box(-1.0, 1.0, (1,))

    def __init__(self, how="never", at=50):
        self.how, self.at, self.taken, self.t = how, at, 0, 0

    def reset(self, *, seed=None, options=None):
        """A new episode."""
        super().reset(seed=seed)
        self.t = 0
        return np.zeros(2, np.float32), {}

    def step(self, action):
        """A step, or a fault."""
        self.t, self.taken = self.t + 1, self.taken + 1
        values = {"observation": np.zeros(2, np.float32), "reward": 0.0, "cost": 0.0}
        if self.taken >= self.at:
            if self.how in values:
                values[self.how] = np.zeros((2, 3))
            elif self.how in ("raise", "exit"):
                raise {"raise": KeyError, "exit": SystemError}[self.how]("x\ny")
            elif self.how == "die":
                os._exit(3)
            elif self.how == "hang":
                time.sleep(30)
            values["cost"] = {"nan": np.nan, "negative": -1.0}.get(self.how, values["cost"])
        observation, reward, cost = values.values()
        return observation, reward, False, self.t == 10, {"cost": cost}


def try_environments(tally: Tally, count, rng, root):
    """Environments that fail: one line, status 1, the checkpoint before it whole, no process."""
    if "Faulty-v0" not in gym.registry:
        gym.register("Faulty-v0", entry_point=Faulty, disable_env_checker=True)
    out = root / "faulty"
    for _ in range(count):
        how, at, apart = rng.choice(HOW), rng.randrange(11, 140), rng.random() < 0.4
        apart = apart or how in ("die", "hang")
        shutil.rmtree(out, ignore_errors=True)
        command = ["train", "sac-lag", "--task", "Faulty-v0", *SMALL, *SAC]
        command += ["--backend", "eager", "--task-parameters", "how", how, "at", str(at)]
        command += ["--vectorization", "async", "--step-timeout", "1.5"] if apart else []
        done = forked(lambda command=command: main([*command, "--out", str(out)]))
        problem = done.problem((1,))
        steps = at // 50 * 50  # checkpoints
        if not problem and steps and how != "nan" and at % 10 != 1:
            newest = max(numbered(out, "checkpoints"), default=0)
            problem = "" if newest in (steps, steps - 50) else f"checkpoint at {newest}"
        if not problem and (left := processes_of(str(out))):
            problem = f"processes are left: {left}"
        tally.note("failing environments", f"{how} at {at}: {problem}" if problem else "")


def processes_of(words):
    """Command lines of running processes that hold some words, this one apart."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            line = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
            if words in line and int(path.parent.name) != os.getpid():
                found.append(line)
    return found


def try_reproduce(tally: Tally, count, rng, root):
    """`reproduce` killed at random moments; no worker is left, and the same command goes on."""
    command = [sys.executable, "-m", "agents.cli", "reproduce", "--algorithms", "trpo-lag", "cpo"]
    command += ["--levels", "1", "--seeds", "3", "--steps", "2000", "--workers", "2"]
    command += ["--backend", "eager", "--out"]
    whole, out = root / "grid", root / "killed"
    started = time.monotonic()
    if count:
        subprocess.run([*command, str(whole)], capture_output=True, check=True)
    took = time.monotonic() - started
    for _ in range(count):
        shutil.rmtree(out, ignore_errors=True)
        process = subprocess.Popen(
            [*command, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(rng.uniform(0.3, 1.0) * took)
        number = rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM])
        process.send_signal(number)
        process.wait()
        again = subprocess.run([*command, str(out)], capture_output=True, text=True, check=False)
        problem = "" if again.returncode == 0 else f"status {again.returncode}: {again.stderr}"
        problem = problem or ("a traceback" if "Traceback" in again.stderr else "")
        if not problem and (left := [*processes_of(str(out)), *leftovers(out)]):
            problem = f"left: {left}"
        problem = problem or _changed(out, whole)
        tally.note("reproduce killed", problem)


def _changed(out, whole):
    """Files of trainings that differ; reports tell times."""
    found, expected = (
        {k: v for k, v in results(folder).items() if "results.npz" in k or "checkpoint" in k}
        for folder in (out, whole)
    )
    return difference(found, expected)
