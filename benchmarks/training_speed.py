"""Environment steps a second of training, lockstep beside the plain one-run loop, one core.

Each turn runs both in processes of their own, so that neither has the other's settings; what is
timed begins after imports and 1 000 steps of warm-up, and holds rollout, replay, updates, records.

python benchmarks/training_speed.py
"""

import os
import statistics
import subprocess
import sys

TURNS, STEPS = 3, 3_000

PLAIN = f"""
import sys, time
sys.path.insert(0, {os.path.dirname(os.path.abspath(__file__))!r})
import torch
torch.set_num_threads(1)
from plain_sac_lag import train
train(0, 1_000, random_steps=0)
start = time.perf_counter()
train(0, {STEPS}, random_steps=0)
print({STEPS} / (time.perf_counter() - start))
"""

LOCKSTEP = f"""
import sys, tempfile, time
from dataclasses import replace
from pathlib import Path
from agents.bench.presets import preset
from agents.lockstep import backend
from agents.runs.config import TrainConfig
from agents.runs.train import Training
backend.configure()
runs = int(sys.argv[1])
task = "Circle2D-1-v0"
config = replace(preset("sac-lag", task), random_steps=0)
config = TrainConfig("sac-lag", task, tuple(range(runs)), 1_000 + {STEPS}, config)
with tempfile.TemporaryDirectory() as folder:
    config.write(Path(folder))
    training = Training(config)
    while training.steps[0] < 1_000:
        training.run_epoch()
    start = time.perf_counter()
    while not training.done:
        training.run_epoch()
    training.save(Path(folder))
    print(runs * {STEPS} / (time.perf_counter() - start))
"""


def speed(code, *args):
    command = [sys.executable, "-c", code, *args]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


def main():
    rows = {"plain, 1 run": lambda: speed(PLAIN)}
    for runs in (1, 3, 12):
        rows[f"lockstep, {runs} run{'s' if runs > 1 else ''}"] = lambda n=str(runs): speed(
            LOCKSTEP, n
        )
    results = {name: [] for name in rows}
    for _ in range(TURNS):
        for name, measure in rows.items():
            results[name].append(measure())
    print("| SAC-Lag, Circle2D-1 | env steps/s, median | over plain, median |\n| --- | --- | --- |")
    for name, values in results.items():
        pairs = zip(values, results["plain, 1 run"], strict=True)
        ratio = statistics.median(v / p for v, p in pairs)
        print(f"| {name} | {statistics.median(values):,.0f} | {ratio:.2f} |")


if __name__ == "__main__":
    main()
