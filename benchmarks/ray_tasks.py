"""Overhead of a Ray task beside the training in it, as in `docs/ray.md`; times are medians.

A message is as large as a checkpoint, sent and written as by the launcher.

python benchmarks/ray_tasks.py
"""

import os
import statistics
import tempfile
import time
from pathlib import Path

TASKS = 10
NAME, MEGABYTES = "checkpoints/000050000.npz", 50
"""Size of a message: about that of a checkpoint of ten runs of a long off-policy training."""


def messages(content):
    """Task that only sends one message."""
    yield {NAME: content}, [NAME], 0


def tasks():
    """Measure Ray tasks; return seconds by what was measured."""
    import ray

    from agents.training.launcher import launcher, take_in

    found, started = {}, time.perf_counter()
    with launcher("ray", 1), tempfile.TemporaryDirectory() as folder:
        found["start of a cluster of this machine"] = [time.perf_counter() - started]
        task = ray.remote(num_cpus=1, max_retries=0)(messages).options(num_returns="streaming")

        def first_message(content):
            started = time.perf_counter()
            files, names, _ = ray.get(next(task.remote(content)))
            return time.perf_counter() - started, files, names

        found["first task: a process starts, and imports"] = [first_message(b"")[0]]
        found["a task more"] = [first_message(b"")[0] for _ in range(TASKS)]
        there, written = [], []
        for _ in range(TASKS):
            seconds, *message = first_message(os.urandom(MEGABYTES * 10**6))
            there.append(seconds)
            started = time.perf_counter()
            take_in(Path(folder), *message)
            written.append(time.perf_counter() - started)
        found[f"a task with {MEGABYTES} MB on the way there and back"] = there
        found[f"writing {MEGABYTES} MB in the driver's folder"] = written
    return found


def main():
    """Print a row for each measurement."""
    print("| Ray | median s | least s |\n| --- | --- | --- |")
    for what, seconds in tasks().items():
        print(f"| {what} | {statistics.median(seconds):.3f} | {min(seconds):.3f} |")


if __name__ == "__main__":
    main()
