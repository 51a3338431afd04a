"""Runs on the disk: written by hand in the form of a training, and what a training left."""

import contextlib
import json

import numpy as np

from agents.paper.presets import preset
from agents.training import derive, evaluation
from agents.training.config import TrainConfig
from agents.training.files import write_arrays

TASK = "Circle2D-3-v0"
# Of 12 rollouts with two episodes of 5 steps each, 120 steps: the longest streaks.
STREAKS = [(0, 4), (5, 1), (2, 2), (3, 0), (5, 5), (1, 0), (2, 4), (0, 0), (1, 1), (3, 2), (2, 2)]
STREAKS += [(0, 1)]

TINY = {"backend": "eager", "hidden": (8,)}
SAC = TINY | {"random_steps": 40, "gradient_steps": 1, "batch_size": 32, "replay_size": 500}
TRPO = TINY | {"episodes": 2}
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


def write_runs(folder, task=TASK):
    """Two runs of SAC-Lag on a task: their steps, with positions, and neither checkpoint nor
    evaluation."""
    config = TrainConfig("sac-lag", (task,), (0, 1), 120, preset("sac-lag", task))
    config.write(folder)
    costs = [cost for pair in STREAKS for streak in pair for cost in chain(streak, 5)]
    arrays = {"metrics": np.array([], dtype=np.str_)}
    for run in config.runs:
        rows = np.arange(240, dtype=np.float32).reshape(120, 2) / 100 + run.seed
        arrays |= write_steps(folder, run, costs, [5] * 24, 2, positions=rows)
    (folder / "steps").mkdir()
    write_arrays(folder / "steps" / "000000120.npz", arrays)
    return config


def write_evaluated(
    folder, name, costs, hyperparameters=None, task="Circle2D-1-v0", seeds=None, returns=None
):
    """Evaluated runs of ten episodes of ten steps, with as many steps at a cost in each episode, in
    one chain: a run for each number in `costs`, of the seeds 0, 1, ... where none are given.

    returns: of the one evaluated episode of each run, -9 where none are given; its cost is 4.25.
    """
    seeds = tuple(seeds or range(len(costs)))
    config = TrainConfig(name, (task,), seeds, 100, hyperparameters or preset(name, task))
    config.write(folder)
    (folder / "steps").mkdir()
    arrays = {"metrics": np.array([], dtype=np.str_)}
    for run, cost in zip(config.runs, costs, strict=True):
        arrays |= write_steps(folder, run, chain(cost, 10) * 10, [10] * 10, 1)
    write_arrays(folder / "steps" / "000000100.npz", arrays)
    results = derive.derived(folder, config)
    for run, value in zip(config.runs, returns or [-9.0] * len(seeds), strict=True):
        for policy in ("deterministic", "stochastic"):
            prefix = f"{run.prefix}evaluation/{policy}/"
            one = {"returns": np.array([value]), "costs": np.array([[4.25]])}
            results |= {prefix + k: a for k, a in (one | {"lengths": np.array([10])}).items()}
    write_arrays(folder / "results.npz", results)
    return config


def write_status(folder, share, speed=None, **sessions):
    """`status.json` of a training; sessions: seconds that each process took."""
    each = {name: {"seconds": seconds} for name, seconds in sessions.items()}
    content = {"share": share, "steps_per_second": speed, "sessions": each}
    (folder / "status.json").write_text(json.dumps(content))


NO_RESULTS = ("status.json", "report.md", "report.csv", ".lock", "worker.log")
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
