"""Folders of runs: written by hand in the format of a training, and compared with each other."""

import contextlib
import csv
import json
import time
from pathlib import Path

import numpy as np

from agents.presets import preset
from agents.results.reading import read_folder
from agents.training import derive, evaluation, trainer
from agents.training.config import TrainConfig
from agents.training.environments import view_of
from agents.training.files import write_arrays

TASK = "Circle2D-3-v0"
# The longest streaks of 12 rollouts with two episodes of 5 steps each, 120 steps.
STREAKS = [(0, 4), (5, 1), (2, 2), (3, 0), (5, 5), (1, 0), (2, 4), (0, 0), (1, 1), (3, 2), (2, 2)]
STREAKS += [(0, 1)]

TINY = {"backend": "numpy", "hidden": (8,)}
SAC = TINY | {"random_steps": 40, "gradient_steps": 1, "batch_size": 32, "replay_size": 500}
TRPO = TINY | {"episodes": 2, "critic_iterations": 2}
"""Hyper-parameters of trainings that take a fraction of a second."""


@contextlib.contextmanager
def few_episodes(count=3):
    """Evaluate trainings by `count` episodes in this context."""
    before = derive.write_results.__defaults__, evaluation.SNAPSHOT_EPISODES
    derive.write_results.__defaults__, evaluation.SNAPSHOT_EPISODES = (count,), count
    try:
        yield
    finally:
        derive.write_results.__defaults__, evaluation.SNAPSHOT_EPISODES = before


def chain(cost, length):
    """Return the costs of an episode that begins with a chain of cost steps."""
    return [1.0] * cost + [0.0] * (length - cost)


def write_steps(folder, run, costs, lengths, episodes, **more):
    """Return the arrays of the file of all steps, for one run. episodes: in each rollout."""
    rollouts = len(lengths) // episodes
    arrays = {"costs/cost": np.array(costs, dtype=float), "length": np.array(lengths)}
    arrays |= {"return": np.full(len(lengths), -1.0)}
    arrays |= {"updates": np.zeros((rollouts, 0), np.float32), **more}
    return {run.prefix + name: array for name, array in arrays.items()}


def write_runs(folder, task=TASK, weight=1.0, lengths=(5,) * 24, each=2):
    """Write the steps and positions of two SAC-Lag runs, without checkpoints or evaluations.

    weight: the cost of a cost step; lengths: of the episodes, of which each rollout has `each`.
    """
    config = TrainConfig("sac-lag", (task,), (0, 1), 120, preset("sac-lag", task))
    config.write(folder)
    costs = [weight * cost for pair in STREAKS for streak in pair for cost in chain(streak, 5)]
    arrays = {"metrics": np.array([], dtype=np.str_)}
    for run in config.runs:
        rows = np.arange(240, dtype=np.float32).reshape(120, 2) / 100 + run.seed
        arrays |= write_steps(folder, run, costs, lengths, each, positions=rows)
    (folder / "steps").mkdir()
    write_arrays(folder / "steps" / "000000120.npz", arrays)
    return config


def evaluate(folder, **more):
    """Write `results.npz` of `write_runs`' folder: one evaluated episode per run, and `more`."""
    config = TrainConfig.read(folder)
    results = derive.derived(folder, config)
    one = {"returns": np.array([-5.25]), "costs": np.array([[3.0]]), "lengths": np.array([10])}
    for run in config.runs:
        prefix = f"{run.prefix}evaluation/deterministic/"
        results |= {prefix + name: array for name, array in one.items()}
    write_arrays(folder / "results.npz", results | more)


def write_evaluated(
    folder,
    name,
    costs,
    hyperparameters=None,
    task="Circle2D-1-v0",
    seeds=None,
    returns=None,
    evaluated=((4.25,),),
    at=None,
    second=None,
):
    """Write evaluated runs of ten episodes of ten steps; the seeds default to 0, 1, ...

    costs: one entry per run, either the length of the chain of cost steps that begins each episode,
    or a list of all its steps' costs; second: the same for a second cost, "cost_2". returns: the
    return of each run's evaluated episodes, by default -9. evaluated: the costs of the evaluated
    episodes of each run, or of all runs; they are twice as high for "cost_2". at: where each
    evaluated episode of each run ends, in units of the arena; without it no places are stored.
    """
    seeds = tuple(seeds or range(len(costs)))
    names = ("cost",) if second is None else ("cost", "cost_2")
    own = hyperparameters or preset(name, task)
    config = TrainConfig(name, (task,), seeds, 100, own, costs=names)
    config.write(folder)
    arrays = {"metrics": np.array([], dtype=np.str_)}
    for run, *several in zip(config.runs, costs, second or costs, strict=True):
        first, other = (c if isinstance(c, list) else chain(c, 10) * 10 for c in several)
        more = {} if second is None else {"costs/cost_2": np.array(other, dtype=float)}
        arrays |= write_steps(folder, run, first, [10] * 10, 1, **more)
    (folder / "steps").mkdir()
    write_arrays(folder / "steps" / "000000100.npz", arrays)
    results, view = derive.derived(folder, config), view_of(task, {})
    for k, run in enumerate(config.runs):
        paid = np.array(evaluated[k % len(evaluated)], dtype=float)
        found = {"returns": np.resize(np.array(returns[k] if returns else -9.0, float), len(paid))}
        found |= {"costs": np.stack([paid, 2 * paid][: len(names)], axis=1)}
        found |= {"lengths": np.full(len(paid), 10)}
        for policy in ("deterministic", "stochastic"):
            if at is not None and policy == "deterministic":
                ends = view.positions(np.array(at[k % len(at)], np.float32), {})
                found |= derive.places_of(view, ends, paid)
            results |= {f"{run.prefix}evaluation/{policy}/{n}": a for n, a in found.items()}
    write_arrays(folder / "results.npz", results)
    return config


def steps_of(folder, run, name):
    """Return a column of all environment steps of a run, which is named as "task/seed"."""
    files = [np.load(path) for path in sorted((folder / "steps").iterdir())]
    return np.concatenate([file[f"{run}/{name}"] for file in files])


@contextlib.contextmanager
def checkpoints_often():
    """Write a checkpoint whenever one is due by steps, however long writing takes."""
    before, trainer.WRITING_SHARE = trainer.WRITING_SHARE, 1e9
    try:
        yield
    finally:
        trainer.WRITING_SHARE = before


def edit_results(folder, **changes):
    """Replace arrays in `results.npz`; None removes one.

    Names have two underscores in place of each slash.
    """
    with np.load(folder / "results.npz") as file:
        arrays = dict(file)
    arrays |= {name.replace("__", "/"): array for name, array in changes.items()}
    write_arrays(folder / "results.npz", {n: a for n, a in arrays.items() if a is not None})


def cells(markdown):
    """Return the cells of all rows with a name, of all tables in a text."""
    lines = (line for line in markdown.splitlines() if line.startswith("|"))
    rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    return [row for row in rows if row[0].strip("-")]


def lines_of(path):
    """Return the lines of a CSV file as dicts by its head."""
    return list(csv.DictReader(path.read_text().splitlines()))


def wait_until(condition, seconds=300):
    """Wait until a condition holds; fail after some seconds."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def groups_of(*folders):
    """Read the groups of each folder by itself, so that the folders do not affect each other."""
    return [group for folder in folders for group in read_folder(folder, folder.name)]


def write_status(folder, share, speed=None, **sessions):
    """Write `status.json` of a training; sessions: seconds that each process took."""
    each = {name: {"seconds": seconds} for name, seconds in sessions.items()}
    content = {"share": share, "steps_per_second": speed, "sessions": each}
    (folder / "status.json").write_text(json.dumps(content))


def processes(*words):
    """Return the ids of the processes whose command line contains one of the words."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # the process has ended in the meantime
            line = path.read_bytes()
            if any(str(word).encode() in line for word in words):
                found.add(int(path.parent.name))
    return found


NO_RESULTS = ("status.json", "report.md", "report.csv", "measures.csv", ".lock", "worker.log")
"""Files with timings and logs, and the command's tables."""


def results(folder):
    """Return the bytes of every file that must not depend on interruptions.

    Of the checkpoints, which may be due at other times, it is the newest one. The files of steps
    are left out: `results.npz` has their numbers.
    """
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    paths = [path for path in paths if path.name not in NO_RESULTS and path.parent.name != "steps"]
    newest = {path.parent: path for path in paths if path.parent.name == "checkpoints"}
    kept = [p for p in paths if p.parent.name != "checkpoints" or p in newest.values()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in kept}


def run_of(folder, run):
    """Return the arrays of one run, from its results and its state in the newest checkpoint."""
    config = TrainConfig.read(folder)
    with np.load(folder / "results.npz") as file:
        found = {n[len(run.prefix) :]: file[n] for n in file if n.startswith(run.prefix)}
    index = config.runs.index(run)
    with np.load(sorted((folder / "checkpoints").glob("*.npz"))[-1]) as file:
        states = {f"state/{n}": file[n][index] for n in file if file[n].shape}
    if "state/replay.rows" in states:  # rows beyond a run's own are room for longer runs
        states["state/replay.rows"] = states["state/replay.rows"][: states["state/replay.stored"]]
    return found | states


def differing(a, b):
    """Return the names of the arrays that are not equal bit for bit."""
    names = a.keys() | b.keys()
    return {n for n in names if n not in a or n not in b or a[n].tobytes() != b[n].tobytes()}
