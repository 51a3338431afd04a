"""Steps a second of the three Safety-Gymnasium tasks, beside the original and MuJoCo's own limit.

    python benchmarks/safety_speed.py

One core, resets included, random actions. "open loop" is `mujoco.rollout` of the same models, all
contacts in, without observations, rewards or resets: what no environment that steps all of them
could surpass. SafetyPointGoal1 may, since it does not step a vase that stands out of reach.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import statistics
import time

import gymnasium as gym
import mujoco
import numpy as np
from mujoco import rollout

import circle2d_mj
from circle2d_mj.safety import models

# Recorded from safety-gymnasium 1.0.0 itself, on Python 3.10 with mujoco 2.3.3, one core: steps a
# second over whole episodes of random actions with their resets, and a reset alone in ms. It needs
# versions that do not install beside ours, so it cannot run here. Hopper-v5 tells how fast this
# machine is: the original's Hopper is gymnasium's with a cost.
ORIGINAL = {
    "SafetyPointCircle1-v0": (684, 664),
    "SafetyPointGoal1-v0": (1_028, 642),
    "SafetyHopperVelocity-v1": (15_331, 0.02),
}
# The model, physics steps in a step, and steps of an open-loop episode (random hoppers soon fall).
OPEN_LOOP = {
    "SafetyPointCircle1-v0": (models.point_circle, 10, 100),
    "SafetyPointGoal1-v0": (models.point_goal, 10, 100),
    "SafetyHopperVelocity-v1": (models.hopper, 4, 20),
}
TURNS = 7


def single(name):
    env = gym.make(name)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(64)]

    def run(steps=2000):
        start = time.perf_counter()
        for k in range(steps):
            *_, terminated, truncated, _ = env.step(actions[k % 64])
            if terminated or truncated:
                env.reset()
        return steps / (time.perf_counter() - start)

    def reset(times=50):
        start = time.perf_counter()
        for _ in range(times):
            env.reset()
        return 1e3 * (time.perf_counter() - start) / times

    return run, reset


def vector(task, size):
    envs = gym.make_vec(f"circle2d_mj/{task}", num_envs=size)
    envs.reset(seed=0)
    actions = [envs.action_space.sample() for _ in range(8)]

    def run():
        steps = 32_768 // size
        start = time.perf_counter()
        for k in range(steps):
            envs.step(actions[k % 8])
        return steps * size / (time.perf_counter() - start)

    return run


def open_loop(task, size=64):
    load, substeps, steps = OPEN_LOOP[task]
    model = load()
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    control = np.repeat(rng.uniform(-1, 1, (size, steps, model.nu)), substeps, axis=1)

    def run():
        start = time.perf_counter()
        rollout.rollout(model, data, np.tile(state, (size, 1)), control)
        return steps * size / (time.perf_counter() - start)

    return run


def main():
    print(f"{circle2d_mj.__name__} with mujoco {mujoco.__version__}\n")
    print(
        "| task | original | single | over it | 256 | 1024 | over it | open loop | reset, ms | it |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for task, (speed, reset_ms) in ORIGINAL.items():
        one, reset = single(f"circle2d_mj/{task}")
        runs = (one, vector(task, 256), vector(task, 1024), open_loop(task), reset)
        turns = [[run() for run in runs] for _ in range(TURNS)]
        alone, some, many, limit, ms = (
            statistics.median(values) for values in zip(*turns, strict=True)
        )
        cells = (
            *(task, f"{speed:,}", f"{alone:,.0f}", f"{alone / speed:.1f}", f"{some:,.0f}"),
            *(f"{many:,.0f}", f"{many / speed:.1f}", f"{limit:,.0f}", f"{ms:.2f}", reset_ms),
        )
        print(f"| {' | '.join(map(str, cells))} |")
    theirs = single("Hopper-v5")[0]
    print(
        f"\ngymnasium's Hopper-v5, single: {statistics.median(theirs() for _ in range(TURNS)):,.0f}"
    )


if __name__ == "__main__":
    main()
