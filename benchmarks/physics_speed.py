"""Steps per second of Circle2D with MuJoCo's physics, compared with MuJoCo's own rollout and
gymnasium's MuJoCo environments, in turns, on one core (two where the table says so).

python benchmarks/physics_speed.py
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import argparse
import statistics
import time

import gymnasium as gym
import mujoco
import numpy as np
from mujoco import rollout

from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv

SIZE, TURNS = 1024, 5
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (50, SIZE, 2))
SPAN = 0.6  # seconds of a turn for environments made by gymnasium
LEVELS = range(4)
SOFT = {"contact": "soft", "stiffness": 200.0}
SCENES = {f"level {level}": {"level": level} for level in LEVELS}
SCENES |= {f"level {level}, soft": {"level": level, **SOFT} for level in (1, 3)}
DRAWN = {"randomize": {"mass": (0.5, 2.0), "friction": (0.0, 1.0)}}
SCENES["level 1, soft, drawn"] = {"level": 1, **SOFT, **DRAWN}


def vector(num_threads=1, **parameters):
    """Return a function that measures 1024 episodes of 50 steps with resets, in steps/s."""
    envs = Circle2DMuJoCoVectorEnv(
        SIZE, num_threads=num_threads, autoreset_mode="SameStep", **parameters
    )
    envs.reset(seed=0)

    def run():
        start = time.perf_counter()
        for action in ACTIONS:
            envs.step(action)
        return SIZE * len(ACTIONS) / (time.perf_counter() - start)

    return run


def open_loop(**parameters):
    """Return a function that measures mujoco.rollout, physics only, on equal starts and actions."""
    envs = Circle2DMuJoCoVectorEnv(SIZE, **parameters)
    envs.reset(seed=0)
    model, substeps = envs.simulation.dynamics.model, envs.simulation.dynamics.physics.substeps
    data = mujoco.MjData(model)
    full = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    starts = np.zeros((SIZE, full))
    starts[:, 1:3] = envs.position
    most = model.actuator_ctrlrange[:, 1]
    control = np.repeat(ACTIONS.swapaxes(0, 1) * most, substeps, axis=1)

    def run():
        start = time.perf_counter()
        rollout.rollout(model, data, starts, control)
        return SIZE * len(ACTIONS) / (time.perf_counter() - start)

    return run


def resets(**parameters):
    """Return a function that measures the seconds of a reset of all 1024 environments."""
    envs = Circle2DMuJoCoVectorEnv(SIZE, **parameters)
    envs.reset(seed=0)

    def run():
        start = time.perf_counter()
        for _ in range(20):
            envs.reset()
        return (time.perf_counter() - start) / 20

    return run


def through_gymnasium(task, mode=None, num_envs=8):
    """Return a function that measures the steps/s of a single environment (mode None) or of
    gymnasium's own vector environment; resets included."""
    env = gym.make(task) if mode is None else gym.make_vec(task, num_envs, mode)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]

    def run():
        start, count = time.perf_counter(), 0
        while time.perf_counter() - start < SPAN:
            for action in actions:
                *_, terminated, truncated, _ = env.step(action)
                if mode is None and (terminated or truncated):
                    env.reset()
            count += len(actions)
        return (1 if mode is None else num_envs) * count / (time.perf_counter() - start)

    return run


def measurements():
    """Return the functions that a turn calls, by the name of their row."""
    runs = {}
    for name, parameters in SCENES.items():
        runs[name] = vector(**parameters)
        runs[f"{name}, open loop"] = open_loop(**parameters)
        runs[f"{name}, 2 threads"] = vector(num_threads=2, **parameters)
        runs[f"{name}, resets"] = resets(**parameters)
    for task in ("Circle2DMuJoCo-1-v0", "Reacher-v5", "InvertedPendulum-v5"):
        runs[f"{task}, single"] = through_gymnasium(task)
        for mode in ("sync", "async"):
            runs[f"{task}, {mode}"] = through_gymnasium(task, mode)
    return runs


def table(seen):
    """Yield the lines of a table: medians over turns of values and ratios. seen: row -> [turns]."""

    def ratio(name, of):
        pairs = zip(seen[name], seen[of], strict=True)
        return f"{statistics.median(a / b for a, b in pairs):.2f}"

    def speed(name):
        return f"{statistics.median(seen[name]):,.0f}"

    yield "| | steps/s | mujoco.rollout, open loop | ratio | 2 threads over 1 | reset, ms |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for name in SCENES:
        free, threads, reset = (f"{name}, {what}" for what in ("open loop", "2 threads", "resets"))
        yield (
            f"| {name}, vector of {SIZE} | {speed(name)} | {speed(free)} "
            f"| {ratio(name, free)} | {ratio(threads, name)} "
            f"| {1000 * statistics.median(seen[reset]):.2f} |"
        )
    for name in seen:
        if "-v" in name:
            yield f"| {name}{'' if 'single' in name else ' vector of 8'} | {speed(name)} | | | | |"


def main():
    """Print one Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=TURNS)
    turns = parser.parse_args().turns
    runs = measurements()
    seen = {name: [] for name in runs}
    for _ in range(turns):
        for name, run in runs.items():
            seen[name].append(run())
    print("\n".join(table(seen)))


if __name__ == "__main__":
    main()
