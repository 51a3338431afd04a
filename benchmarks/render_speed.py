"""Milliseconds to render pictures without a screen, with EGL and with OSMesa, on one core.

python benchmarks/render_speed.py

Each backend is measured in a separate process, in turns; times are those of the processor. The
reference is a frame of gymnasium's Reacher-v5, with the same backend.
"""

import json
import os
import statistics
import subprocess
import sys
import time

import numpy as np

VISITS, STATES, EPISODE = 1_000_000, 10_000, 50
SIZE, CELLS = 640, 160
TURNS, REPEATS = 5, 5
# Threads of NumPy, and of Mesa's llvmpipe.
ONE_CORE = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}


def milliseconds(call, repeats=1):
    """Return the median milliseconds of a call."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times)


def walks(config, episodes):
    """Return random walks from the right edge inwards, [episodes, EPISODE + 1, 2], and costs."""
    rng = np.random.default_rng(0)
    steps = rng.normal((-0.3, 0.0), 0.8, (episodes, EPISODE, 2))
    starts = np.tile((12.0, 0.0), (episodes, 1, 1))
    paths = np.clip(np.concatenate((starts, steps), axis=1).cumsum(axis=1), -15.0, 15.0)
    return paths, config.region.contains(paths[:, 1:]).astype(float)


def measure():
    """Measure one turn of the backend that MUJOCO_GL names; return milliseconds by name."""
    import gymnasium as gym

    from circle2d_mj import Circle2DConfig
    from circle2d_mj.circle2d.view import Circle2DView
    from circle2d_mj.core.view import histogram
    from circle2d_mj.render import canvas

    config = Circle2DConfig(level=3)
    paths, costs = walks(config, VISITS // EPISODE)
    visited, view = paths[:, 1:].reshape(-1, 2), Circle2DView(config)
    ground = view.background(SIZE)
    few = STATES // EPISODE

    def heat_map():
        counts = histogram(view.extent, visited, CELLS)
        return view.overlay(canvas.with_counts(ground, counts, canvas.most_visits([counts])))

    def trajectories():
        drawn = canvas.with_trajectories(ground, view.extent, paths[:few], costs[:few])
        return view.overlay(drawn)

    times = {
        "heat map of 1 000 000 states": milliseconds(heat_map, REPEATS),
        "trajectories of 10 000 states": milliseconds(trajectories, REPEATS),
    }
    for task in ("Circle2D-3-v0", "Circle2DMuJoCo-3-v0", "Reacher-v5"):
        env = gym.make(task, render_mode="rgb_array")
        env.reset(seed=0)
        height, width, _ = env.render().shape
        times[f"frame of {task}, {width} x {height}"] = milliseconds(env.render, 4 * REPEATS)
        env.close()
    return times


def main():
    """Measure both backends in turns and print the medians."""
    backends = ("egl", "osmesa")
    turns = {backend: [] for backend in backends}
    for _ in range(TURNS):
        for backend in backends:
            done = subprocess.run(
                [sys.executable, __file__, "--turn"],
                env=os.environ | ONE_CORE | {"MUJOCO_GL": backend},
                check=True,
                capture_output=True,
            )
            turns[backend].append(json.loads(done.stdout))
    print(f"| milliseconds, median of {TURNS} processes | EGL | OSMesa |\n| --- | --- | --- |")
    for name in turns["egl"][0]:
        medians = (statistics.median(turn[name] for turn in turns[b]) for b in backends)
        print(f"| {name} | {' | '.join(f'{value:.1f}' for value in medians)} |")


if __name__ == "__main__":
    if "--turn" in sys.argv:
        print(json.dumps(measure()))
    else:
        main()
