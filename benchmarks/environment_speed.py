"""Steps per second of Circle2D and of gymnasium's native vector CartPole, in turns, on one core.

python benchmarks/environment_speed.py
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import statistics
import time

import gymnasium as gym

import circle2d_mj  # noqa: F401 - registers the tasks

SIZE, STEPS, TURNS = 4096, 500, 9


def vector(task):
    envs = gym.make_vec(task, num_envs=SIZE, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    actions = [envs.action_space.sample() for _ in range(8)]

    def run():
        start = time.perf_counter()
        for k in range(STEPS):
            envs.step(actions[k % 8])
        return SIZE * STEPS / (time.perf_counter() - start)

    return run


def single(task):
    env = gym.make(task)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(8)]

    def run():
        start = time.perf_counter()
        for k in range(10_000):
            *_, terminated, truncated, _ = env.step(actions[k % 8])
            if terminated or truncated:
                env.reset()
        return 10_000 / (time.perf_counter() - start)

    return run


def main():
    """Print the table. Resets are included: CartPole's episodes last about 20 steps, ours 50."""
    runs = {
        f"CartPole-v1, vector of {SIZE}": vector("CartPole-v1"),
        f"Circle2D-1-v0, vector of {SIZE}": vector("Circle2D-1-v0"),
        f"Circle2D-3-v0, vector of {SIZE}": vector("Circle2D-3-v0"),
        "Circle2D-1-v0, single": single("Circle2D-1-v0"),
        "Circle2D-3-v0, single": single("Circle2D-3-v0"),
    }
    speeds = {name: [] for name in runs}
    for _ in range(TURNS):
        for name, run in runs.items():
            speeds[name].append(run())
    yardstick = speeds[next(iter(runs))]
    print("| environment | steps/s, median | over CartPole, median of turns |\n| --- | --- | --- |")
    for name, values in speeds.items():
        ratio = statistics.median(v / y for v, y in zip(values, yardstick, strict=True))
        shown = f"{ratio:.2f}" if "vector" in name else ""
        print(f"| {name} | {statistics.median(values):,.0f} | {shown} |")


if __name__ == "__main__":
    main()
