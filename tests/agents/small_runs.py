"""Runs on the disk: written by hand in the form of a training, and what a training left."""

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
# Of 12 rollouts with two episodes of 5 steps each, 120 steps: the longest streaks.
STREAKS = [(0, 4), (5, 1), (2, 2), (3, 0), (5, 5), (1, 0), (2, 4), (0, 0), (1, 1), (3, 2), (2, 2)]
STREAKS += [(0, 1)]

TINY = {"backend": "numpy", "hidden": (8,)}
SAC = TINY | {"random_steps": 40, "gradient_steps": 1, "batch_size": 32, "replay_size": 500}
TRPO = TINY | {"episodes": 2, "critic_iterations": 2}
"""Settings of trainings that take a fraction of a second."""


@contextlib.contextmanager
def few_episodes(count=3):
    """Trainings are evaluated by so few episodes."""
    before = derive.write_results.__defaults__, evaluation.SNAPSHOT_EPISODES
    derive.write_results.__defaults__, evaluation.SNAPSHOT_EPISODES = (count,), count
    try:
        yield
    finally:
        derive.write_results.__defaults__, evaluation.SNAPSHOT_EPISODES = before


def chain(cost, length):
    """Costs of an episode that begins with a chain of cost steps."""
    return [1.0] * cost + [0.0] * (length - cost)


def write_steps(folder, run, costs, lengths, episodes, **more):
    """The file of all steps of a training with one run. episodes: in each rollout."""
    rollouts = len(lengths) // episodes
    arrays = {"costs/cost": np.array(costs, dtype=float), "length": np.array(lengths)}
    arrays |= {"return": np.full(len(lengths), -1.0)}
    arrays |= {"updates": np.zeros((rollouts, 0), np.float32), **more}
    return {run.prefix + name: array for name, array in arrays.items()}


def write_runs(folder, task=TASK, weight=1.0, lengths=(5,) * 24, each=2):
    """Two runs of SAC-Lag on a task: their steps, with positions, and neither checkpoint nor
    evaluation. weight: of a cost step; lengths: of episodes, `each` a rollout."""
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
    """`results.npz` of such runs: an evaluated episode of each, and further arrays."""
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
    """Evaluated runs of ten episodes of ten steps, of the seeds 0, 1, ... where none are given: for
    each of `costs` a run with as many steps at a cost in each episode, in one chain, or with these
    costs of its steps. second: the same of a second cost, "cost_2".

    returns: of each run's evaluated episodes, -9 where none are given; evaluated: their costs,
    those of the second cost are twice as high; of one for all runs, or of each. at: where each
    episode of each run ends, in the arena's unit; without it nobody knows.
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
    """A column of all steps of a run, "task/seed", from the files of a training's steps."""
    files = [np.load(path) for path in sorted((folder / "steps").iterdir())]
    return np.concatenate([file[f"{run}/{name}"] for file in files])


@contextlib.contextmanager
def checkpoints_often():
    """A checkpoint whenever one is due by steps."""
    before, trainer.WRITING_SHARE = trainer.WRITING_SHARE, 1e9
    try:
        yield
    finally:
        trainer.WRITING_SHARE = before


def edit_results(folder, **changes):
    """Other arrays in `results.npz`, by their names with two underscores for each slash; None of
    one that is to be missing."""
    with np.load(folder / "results.npz") as file:
        arrays = dict(file)
    arrays |= {name.replace("__", "/"): array for name, array in changes.items()}
    write_arrays(folder / "results.npz", {n: a for n, a in arrays.items() if a is not None})


def cells(markdown):
    """Cells of all tables of a text, by rows that have a name."""
    lines = (line for line in markdown.splitlines() if line.startswith("|"))
    rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    return [row for row in rows if row[0].strip("-")]


def lines_of(path):
    """The lines of a table for programs, by its head."""
    return list(csv.DictReader(path.read_text().splitlines()))


def wait_until(condition, seconds=300):
    """Until something is so, which it has to become in time."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def groups_of(*folders):
    """The groups of folders, which are not named after each other."""
    return [group for folder in folders for group in read_folder(folder, folder.name)]


def write_status(folder, share, speed=None, **sessions):
    """`status.json` of a training; sessions: seconds that each process took."""
    each = {name: {"seconds": seconds} for name, seconds in sessions.items()}
    content = {"share": share, "steps_per_second": speed, "sessions": each}
    (folder / "status.json").write_text(json.dumps(content))


def processes(*words):
    """Ids of the processes whose command line has one of some words."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            line = path.read_bytes()
            if any(str(word).encode() in line for word in words):
                found.add(int(path.parent.name))
    return found


NO_RESULTS = ("status.json", "report.md", "report.csv", "measures.csv", ".lock", "worker.log")
"""Timings, logs and the command's table."""


def results(folder):
    """The bytes of every file that must not depend on interruptions: of checkpoints, which may be
    due at other times, the newest, and of steps their numbers, run by run."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    paths = [path for path in paths if path.name not in NO_RESULTS and path.parent.name != "steps"]
    newest = {path.parent: path for path in paths if path.parent.name == "checkpoints"}
    kept = [p for p in paths if p.parent.name != "checkpoints" or p in newest.values()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in kept}


def run_of(folder, run):
    """The arrays of one run: of its results, and of its state in the newest checkpoint."""
    config = TrainConfig.read(folder)
    with np.load(folder / "results.npz") as file:
        found = {n[len(run.prefix) :]: file[n] for n in file if n.startswith(run.prefix)}
    index = config.runs.index(run)
    with np.load(sorted((folder / "checkpoints").glob("*.npz"))[-1]) as file:
        states = {f"state/{n}": file[n][index] for n in file if file[n].shape}
    if "state/replay.rows" in states:  # behind its own is the others' space
        states["state/replay.rows"] = states["state/replay.rows"][: states["state/replay.stored"]]
    return found | states


def differing(a, b):
    """Names of the arrays that are not equal bit for bit."""
    names = a.keys() | b.keys()
    return {n for n in names if n not in a or n not in b or a[n].tobytes() != b[n].tobytes()}
