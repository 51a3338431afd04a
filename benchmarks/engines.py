"""The quick grid with both engines of training, in turns, and the overhead of a Ray task.

Every grid is a separate command, so that its time includes all that a user waits for: imports, the
start of a Ray cluster on this machine, trainings, report. Both engines use equally many processes.
The reports' numbers must be the same, byte for byte. Ratios are of neighbouring measurements;
ratios and times are medians over turns. The measurements of tasks are those in `docs/ray.md`: a
message is as large as a checkpoint, sent and written as by the launcher.

python benchmarks/engines.py --turns 2 -- --levels 1 --steps 3000
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ENGINES = ("local", "ray")
TASKS = 10
NAME, MEGABYTES = "checkpoints/000050000.npz", 50
"""Size of a message: about that of a checkpoint of ten runs of a long off-policy training."""


def grid(engine, out, options):
    """Run the command; return the seconds it took."""
    command = [sys.executable, "-m", "agents.cli", "reproduce", "--quick", "--out", str(out)]
    started = time.perf_counter()
    subprocess.run(
        [*command, "--engine", engine, *options],
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return time.perf_counter() - started


def grids(turns, options):
    """Return the seconds of each turn, by engine."""
    found = {engine: [] for engine in ENGINES}
    for turn in range(turns):
        with tempfile.TemporaryDirectory() as root:
            # Engines take turns in going first.
            for engine in ENGINES if turn % 2 == 0 else reversed(ENGINES):
                found[engine].append(grid(engine, Path(root) / engine / "grid", options))
                print(f"turn {turn + 1}: {engine}: {found[engine][-1]:.1f} s", file=sys.stderr)
            local, ray = (Path(root) / engine / "grid/report.csv" for engine in ENGINES)
            assert local.read_bytes() == ray.read_bytes(), "the reports differ"
    return found


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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=3, help="0: the tasks only")
    parser.add_argument("options", nargs="*", help="after --: options of circle2d reproduce")
    args = parser.parse_args()
    if args.turns:
        found = grids(args.turns, args.options)
        print("| engine | quick grid, s | over local |\n| --- | --- | --- |")
        for engine, seconds in found.items():
            pairs = zip(seconds, found["local"], strict=True)
            ratio = statistics.median(a / b for a, b in pairs)
            print(f"| {engine} | {statistics.median(seconds):.1f} | {ratio:.2f} |")
        print()
    print("| Ray | median s | least s |\n| --- | --- | --- |")
    for what, seconds in tasks().items():
        print(f"| {what} | {statistics.median(seconds):.3f} | {min(seconds):.3f} |")


if __name__ == "__main__":
    main()
