"""Steps per second of the Safety tasks, the original and gymnasium, in one run on one core.

    python benchmarks/safety_speed.py [--original PYTHON] [--turns 3] [TASK ...]

CPU time with random actions, resets included; medians over turns, so that whatever else the machine
does affects all alike. PYTHON: an interpreter (Python 3.10) with safety-gymnasium 1.0.0 installed;
without it that column is empty. TASK: such as SafetyPointGoal1-v0; by default all. "MuJoCo" is the
speed of a single environment that only took MuJoCo's steps: ten of them, without objects at rest,
and mj_forward for the sensors. The velocity tasks are compared with gymnasium's v5.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import argparse
import statistics
import subprocess
import sys
import time

VECTOR = 64
STEPS = {"single": 2000, "vector": 100}
# A picture takes most of the time of a step: less than an episode, on both sides.
STEPS_SEEN = {"single": 300, "vector": 3}
# Runs in the original's Python: an episode with its reset, and one more reset.
ORIGINAL = """
import sys, time, warnings
warnings.filterwarnings("ignore")
import safety_gymnasium
env = safety_gymnasium.make(sys.argv[1])
env.reset(seed=0)
env.action_space.seed(0)
actions, steps = [env.action_space.sample() for _ in range(64)], int(sys.argv[2])
start = time.process_time()
for k in range(steps):
    values = env.step(actions[k % 64])
    if values[3] or values[4]:
        env.reset()
print(steps / (time.process_time() - start))
"""


def timed(run, name, kind):
    steps = (STEPS_SEEN if "Vision" in name else STEPS)[kind]
    start = time.process_time()
    run(steps)
    return steps / (time.process_time() - start)


def single(name):
    import gymnasium as gym

    env = gym.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]

    def run(steps):
        for k in range(steps):
            *_, terminated, truncated, _ = env.step(actions[k % 64])
            if terminated or truncated:
                env.reset()

    return lambda: timed(run, name, "single")


def mujoco_alone(name):
    import gymnasium as gym

    env = gym.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(64)]
    for action in actions[:40]:  # until objects rest
        env.step(action)
    task = env.unwrapped._envs.simulation

    def run(steps):
        for k in range(steps):
            task._control[:] = actions[k % 64]
            task.batch.step(nstep=task._substeps)
            task.batch.forward()

    return lambda: timed(run, name, "single")


def vector(name):
    import gymnasium as gym

    envs = gym.make_vec(name, num_envs=VECTOR, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(16)]

    def run(steps):
        for k in range(steps):
            envs.step(actions[k % 16])

    return lambda: VECTOR * timed(run, name, "vector")


def original(python, name):
    if python is None:
        return lambda: float("nan")
    steps = "1000" if "Velocity" in name or ("Circle" not in name and "Run" not in name) else "500"
    if "Vision" in name:
        steps = str(STEPS_SEEN["single"])
    command = [python, "-c", ORIGINAL, name, steps]

    def run():
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return float(done.stdout.split()[-1])

    return run


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--original", metavar="PYTHON")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("tasks", nargs="*", metavar="TASK")
    options = parser.parse_args()
    from circle2d_mj.safety.tasks import NAMES

    heads = ("task", "single", "vector of 64", "original", "single over it", "MuJoCo")
    heads += ("gymnasium v5", "single over it", "vector over it")
    print(f"| {' | '.join(heads)} |")
    print(f"| {' | '.join(['---'] * len(heads))} |")
    for name in options.tasks or NAMES.values():
        ours = f"circle2d_mj/{name}"
        runs = [single(ours), vector(ours), original(options.original, name)]
        velocity = "Velocity" in name
        v5 = name.removeprefix("Safety").replace("Velocity-v1", "-v5")
        runs.append(single(v5) if velocity else mujoco_alone(ours))
        turns = [[run() for run in runs] for _ in range(options.turns)]
        alone, many, its, other = (statistics.median(values) for values in zip(*turns, strict=True))
        cells = [f"{alone:,.0f}", f"{many:,.0f}", f"{its:,.0f}", f"{alone / its:.1f}"]
        if velocity:
            cells += ["", f"{other:,.0f}", f"{alone / other:.2f}", f"{many / other:.2f}"]
        else:
            cells += [f"{other:,.0f}", "", "", ""]
        print(f"| {name} | {' | '.join(cells)} |")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
