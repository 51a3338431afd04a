"""`results.npz`: all that reports read of a training, derived once from its steps.

Arrays of a run, whose names begin with its prefix such as "Circle2D-1-v0/0/" (see `config.RunId`):

- `rollouts` [rollouts]: episodes in each; `length` and `return` [episodes]
- `costs/NAME/steps`, `/unsafe` and, unless every cost is 0 or 1, `/values`: see `pack_costs`
- `info/NAME/...`: recorded numbers of each step, packed like costs, values to five digits
- `updates` [epochs, metrics]; the file's array `metrics` has the names of the metrics
- `failure`, `evaluation_failure`: why the run or its evaluation failed, if it did; `traceback`: of
  the task's error, if it was one
- `evaluation/POLICY/returns`, `/costs` and `/lengths`; for the deterministic policy also `/places`
  and `/ways`, where episodes end and how they got there, if the task names them
- `trained/states`, `/positions` and `/unsafe`, a bit each: the drawn states (see `Drawn`) of the
  first evaluated episodes, if the task has a view
- `replay/drawn`, as `path_digits`, `/unsafe`, a bit for each step, and `/box`: see
  `results.groups.Highlights`; `/steps`: environment steps that are divided into windows

An archive has a row for each episode instead: `results.archive`.

Arrays of a task, whose names begin with "Circle2D-1-v0/": `visits` [3, CELLS, CELLS] and `visited`
[3, 3], see `Visits`; `info` [numbers, 2], names and units of the recorded numbers.
"""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError, traced
from agents.lockstep.rollout import Policy
from agents.training.config import RESULTS, STEPS, RunId, TrainConfig, file_name
from agents.training.environments import Looks, looks_of
from agents.training.evaluation import Episodes, evaluate_runs
from agents.training.files import Arrays, numbered, write_arrays
from circle2d_mj.core.view import TellsWays, View, histogram
from emcc import EpisodeRecords, emcc, worst
from emcc.parts import ALPHA, PARTS, rollouts_by_part
from emcc.records import digits, of_digits, records_of

CELLS = 80
"""Cells along each side of a report's heat map, each of about four pixels."""
WINDOWS = 60
"""Number of windows, equal parts of training, in a page's replay."""
STATES = 128
"""About how many states of an episode a page draws: of longer ones every second, third, ..."""
BITS = 10
"""Bits of a coordinate of the replay's grid."""
NEAR = 128
"""Added to the differences of consecutive points, so that small ones are not negative."""
ROUNDED = 0.01
"""Relative difference up to which total steps count as equal."""
DRAWN_POLICIES = 5
"""Number of a task's first runs whose trained policies a report draws."""


class Visits(NamedTuple):
    """States that the agents of some runs visited in a part of training."""

    counts: NDArray[np.int64]
    """Visits of each cell, [cells, cells], the top row first."""
    emcc: float
    """EMCC of that part, mean over the runs."""
    rollouts: int
    """Number of rollouts that are counted."""
    of: int
    """Number of all rollouts in the part."""


class Drawn(NamedTuple):
    """The states of an episode that a page draws."""

    positions: NDArray[np.float32]
    """[K, 2] in the view's unit"""
    unsafe: NDArray[np.bool_]
    """[K]: whether a step after the previous drawn state, up to this state, had a cost"""


class Steps:
    """All steps of a training so far, from its files in `steps/` up to the number `until`."""

    def __init__(self, folder: Path, until: float = np.inf) -> None:
        files = numbered(folder, STEPS).items()
        self._files = [Arrays(path) for number, path in files if number <= until]

    def get(self, run: RunId, name: str) -> NDArray | None:
        """Return an array of a run, concatenated over all files; None if there is none."""
        key = run.prefix + name
        parts = [file[key] for file in self._files if key in file]
        return np.concatenate(parts) if parts else None

    @property
    def metrics(self) -> NDArray[np.str_]:
        """Names of the numbers that an update records."""
        return self._files[0]["metrics"] if self._files else np.array([], dtype=np.str_)


def steps_recorded(folder: Path, config: TrainConfig, until: float) -> NDArray[np.int64]:
    """Return the number of steps of each run in `steps/` up to a checkpoint's number, [R], without
    the epoch in which a run failed."""
    steps = Steps(folder, until)
    lengths = (steps.get(run, "length") for run in config.runs)
    return np.array([0 if length is None else length.sum() for length in lengths], dtype=np.int64)


def write_results(
    folder: Path,
    config: TrainConfig,
    policy: Policy,
    failures: NDArray[np.object_],
    tracebacks: NDArray[np.object_],
    episodes: int | None = None,
) -> dict[str, Episodes]:
    """Evaluate the policies of a finished training, and write `results.npz`.

    failures, tracebacks: [R], why runs failed. episodes: number per run, by default the
    configuration's. Returns the evaluations by policy.
    """
    episodes = config.evaluation_episodes if episodes is None else episodes
    evaluated = evaluate_runs(config, policy, episodes, failures == "")
    looks = _looks(config)
    arrays = derived(folder, config, failures, looks)
    for k, run in enumerate(config.runs):
        trace = tracebacks[k]
        for name, result in evaluated.items():
            if result.failure[k]:
                arrays[run.prefix + "evaluation_failure"] = np.array(result.why(k))
                trace = traced(getattr(result.failure[k], "__cause__", None))
            if not result.void[k]:
                own = result.of_run(k)
                if name == "deterministic":
                    own |= places_of(looks[run.task].view, result.ends[k], result.costs[k, :, 0])
                prefix = f"{run.prefix}evaluation/{name}/"
                arrays |= {prefix + key: array for key, array in own.items()}
        if trace:
            arrays[run.prefix + "traceback"] = np.array(trace)
        paths = evaluated["deterministic"].paths[k]
        first = config.seeds.index(run.seed) < DRAWN_POLICIES
        if paths and first and not evaluated["deterministic"].void[k]:
            positions, unsafe = zip(*(drawn(*path) for path in paths), strict=True)
            arrays |= {
                run.prefix + "trained/states": smallest(np.array([*map(len, unsafe)])),
                run.prefix + "trained/positions": np.concatenate(positions),
                run.prefix + "trained/unsafe": np.packbits(np.concatenate(unsafe)),
            }
    write_arrays(folder / RESULTS, arrays, zipfile.ZIP_DEFLATED)
    return evaluated


def _looks(config: TrainConfig) -> dict[str, Looks]:
    return {task: looks_of(task, config.task_parameters) for task in config.tasks}


def derived(
    folder: Path,
    config: TrainConfig,
    failures: NDArray | None = None,
    looks: Mapping[str, Looks] | None = None,
) -> dict[str, NDArray]:
    """Return the arrays of `results.npz` except evaluations; the training may be unfinished. looks:
    those of the tasks, if the caller has them."""
    steps, looks = Steps(folder), looks or _looks(config)
    arrays: dict[str, NDArray] = {"metrics": steps.metrics}
    for task in config.tasks:
        located: list[tuple[EpisodeRecords, NDArray[np.float32]]] = []
        view, info = looks[task]
        if info:
            arrays[file_name(task) + "/info"] = np.array([*info.items()], dtype=np.str_)
        for run in (run for run in config.runs if run.task == task):
            failure = "" if failures is None else failures[config.runs.index(run)]
            if failure:
                arrays[run.prefix + "failure"] = np.array(failure)
            if (length := steps.get(run, "length")) is None:
                continue
            own, records = _run(steps, run, length, config)
            for name in info:
                values = steps.get(run, f"info/{name}")
                # Steps are missing if the task was made to record it after the training began.
                if values is not None and len(values) == length.sum():
                    packed = pack_costs(five_digits(values).astype(np.float32)).items()
                    own |= {f"info/{name}/{key}": array for key, array in packed}
            positions = steps.get(run, "positions")
            if positions is not None and not failure:
                located.append((records, positions))
                costs = steps.get(run, f"costs/{config.costs[0]}")
                assert costs is not None
                own |= _replay(records, positions, costs, whole_training(records, config.steps))
            arrays |= {run.prefix + name: array for name, array in own.items()}
        if located and view:
            with contextlib.suppress(UserError):  # a third without a rollout
                visits = count_visits(view, located, config.steps)
                prefix = file_name(task) + "/"
                counts = np.array([part.counts for part in visits], dtype=np.uint32)
                arrays[prefix + "visits"] = counts
                arrays[prefix + "visited"] = np.array([part[1:] for part in visits], dtype=float)
    return arrays


def _run(
    steps: Steps, run: RunId, length: NDArray[np.int64], config: TrainConfig
) -> tuple[dict[str, NDArray], EpisodeRecords]:
    """Return the arrays of a run, and its records with the first cost."""
    updates, returns = steps.get(run, "updates"), steps.get(run, "return")
    assert updates is not None
    assert returns is not None
    each = len(length) // max(len(updates), 1)
    arrays = {"rollouts": np.full(len(updates), each, np.uint16), "updates": updates}
    arrays |= {"length": smallest(length), "return": returns}
    for name in config.costs:
        costs = steps.get(run, f"costs/{name}")
        assert costs is not None
        arrays |= {f"costs/{name}/{key}": array for key, array in pack_costs(costs).items()}
    return arrays, records_of(arrays, "", config.costs[0])


def smallest(values: NDArray[np.int64]) -> NDArray:
    """Return integers in the smallest type that holds them."""
    for kind in (np.uint8, np.uint16, np.int32):
        if np.array_equal(values.astype(kind), values):
            return values.astype(kind)
    return values


def pack_costs(costs: NDArray[np.floating]) -> dict[str, NDArray]:
    """Pack the costs of steps: a bit each, and the values unless all are 0 or 1. The inverse is
    `emcc.records.unpack_costs`."""
    unsafe = costs != 0
    packed = {"unsafe": np.packbits(unsafe), "steps": np.array(len(costs))}
    if (costs[unsafe] != 1).any():
        packed["values"] = costs[unsafe]
    return packed


def why_failed(arrays: Mapping[str, NDArray], run: RunId) -> str:
    """Return why a run of `results.npz`, or its evaluation, failed; "" if neither did."""
    for name in ("failure", "evaluation_failure"):
        if run.prefix + name in arrays:
            return str(arrays[run.prefix + name])
    evaluated = f"{run.prefix}evaluation/deterministic/returns" in arrays
    return "" if evaluated else "its evaluation met a number that is not finite"  # before 0.4


def failed_runs(folder: Path, config: TrainConfig) -> Iterator[tuple[RunId, str, str]]:
    """Yield the runs of `results.npz` that failed, or whose evaluation did, with the reason and the
    traceback of the task's error, "" if it was none. config: that of the folder."""
    arrays = Arrays(folder / RESULTS)
    for run in config.runs:
        if why := why_failed(arrays, run):
            trace = run.prefix + "traceback"
            yield run, why, str(arrays[trace]) if trace in arrays else ""


def whole_training(records: EpisodeRecords, steps: int) -> int:
    """Return the environment steps of a whole training: those asked for, or those taken if the last
    epoch took more."""
    return max(steps, records.total_steps)


def told_steps(asked: int, taken: Iterable[int]) -> int:
    """Return the environment steps for names and axes: the most that a run took, or those asked for
    if the difference is only the rest of a last episode. Thirds of training are of the exact number
    that each run took."""
    most = max(taken, default=asked)
    return most if most > (1 + ROUNDED) * asked else asked


def count_visits(
    view: View,
    runs: Sequence[tuple[EpisodeRecords, NDArray[np.float32]]],
    steps: int,
    parts: Sequence[float] = tuple(PARTS),
    alpha: float = ALPHA,
    cells: int = CELLS,
) -> list[Visits]:
    """Count the states of the rollouts that dominate EMCC in parts of training, over all runs.

    runs: records and positions [steps, 2] of each; steps: environment steps asked of each run;
    alpha: the share of rollouts with the highest MCC, including all that equal the last of them; 1
    takes all. cells: number along each side. Source: the paper's figures of visited states. Raises
    UserError if no rollout starts in a part.
    """
    visits = []
    for part in parts:
        counts, values, chosen, every = np.zeros((cells, cells), np.int64), [], 0, 0
        for records, positions in runs:
            mcc, starts = records.mcc_per_rollout()
            in_part = np.flatnonzero(rollouts_by_part(starts, whole_training(records, steps))[part])
            if not len(in_part):
                raise UserError(f"no rollout starts in part {part:g} of training")
            dominating = in_part[worst(mcc[in_part], alpha)]
            rollouts = np.unique(records.rollout)[dominating]
            rows = np.repeat(np.isin(records.rollout, rollouts), records.length)
            counts += histogram(view.extent, positions[rows], cells)
            values.append(emcc(mcc[in_part], alpha))
            chosen, every = chosen + len(dominating), every + len(in_part)
        visits.append(Visits(counts, float(np.mean(values)), chosen, every))
    return visits


def replay_rows(records: EpisodeRecords, steps: int) -> list[tuple[int, int]]:
    """Return, for each window of training in which an episode starts, the window and the row of the
    episode with the highest MCC, the first of equal ones."""
    window = np.minimum(records.start_step * WINDOWS // steps, WINDOWS - 1)
    share = records.longest_streak / records.length
    # By window, then by falling MCC, then by time.
    order = np.lexsort((records.start_step, -share, window))
    windows, first = np.unique(window[order], return_index=True)
    return list(zip(windows.tolist(), order[first].tolist(), strict=True))


def _replay(
    records: EpisodeRecords,
    positions: NDArray[np.float32],
    costs: NDArray[np.floating],
    steps: int,
) -> dict[str, NDArray]:
    """Return the drawn points of the replay's episodes, one after the other, the box of all their
    points, and which of their steps have a cost."""
    rows = [row for _, row in replay_rows(records, steps)]
    spans = [slice(s, s + n) for s, n in zip(records.start_step, records.length, strict=True)]
    paths = [positions[spans[row]].astype(float) for row in rows]
    box = np.array([f([f(path, axis=0) for path in paths], axis=0) for f in (np.min, np.max)])
    size = np.where(box[1] > box[0], box[1] - box[0], 1.0)
    shown = np.concatenate([path[shown_states(len(path))] for path in paths])
    grid = np.round((shown - box[0]) / size * (2**BITS - 1)).astype(np.uint16)
    unsafe = np.concatenate([costs[spans[row]] > 0 for row in rows])
    arrays = {"drawn": path_digits(grid), "unsafe": np.packbits(unsafe), "box": box}
    return {f"replay/{k}": v for k, v in (arrays | {"steps": np.array(steps)}).items()}


def shown_states(steps: int) -> NDArray[np.int64]:
    """Return which states of an episode are drawn: all up to `STATES`, else each k-th and the last.

    The page's script has the same rule.
    """
    every = -(-steps // STATES)
    return np.append(np.arange(0, steps - 1, every), steps - 1)


def drawn(positions: NDArray[np.float32], costs: NDArray[np.float64]) -> Drawn:
    """Return the points of an episode that a page draws.

    positions: [T + 1, 2], the start first, or [T, 2]; costs: [T], each for the state in which its
    step ends.
    """
    at = shown_states(len(positions))
    cost = np.concatenate((np.zeros(len(positions) - len(costs)), costs)) > 0
    return Drawn(positions[at], np.logical_or.reduceat(cost, np.concatenate(([0], at[:-1] + 1))))


def path_digits(points: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Encode points of the replay's grid, [K, 2], as digits of the differences of consecutive
    points, [D, 2, K], which compress better: most fit one byte. `path_of` is the inverse."""
    ways = np.diff(points.astype(np.int64), axis=0, prepend=0) + NEAR
    return digits((ways % 2**BITS).T)


def path_of(ways: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return the points that `path_digits` encoded."""
    return (np.cumsum(of_digits(ways) - NEAR, axis=1) % 2**BITS).T.astype(np.uint16)


def places_of(
    view: View | None, ends: NDArray[np.float32], costs: NDArray[np.float64]
) -> dict[str, NDArray]:
    """Return where evaluated episodes end, and by which way; {} if the view names no places.

    ends: [N, 2], positions; costs: [N], of whole episodes.
    """
    if view is None:
        return {}
    left, right, bottom, top = view.extent
    middle = np.array([[(left + right) / 2, (bottom + top) / 2]])
    if not view.places(middle):  # the task's places have no names
        return {}
    places = {"places": np.array(view.places(ends), dtype=np.str_)}
    if isinstance(view, TellsWays):
        places["ways"] = np.array(view.ways(ends, costs), dtype=np.str_)
    return places


def three_digits(values: NDArray) -> NDArray[np.float64]:
    """Round numbers to three significant digits each; it does not matter if they were float32."""
    exact = np.asarray(values, dtype=np.float64)
    size = np.abs(exact, where=exact != 0, out=np.ones_like(exact))
    scale = 10.0 ** (2 - np.floor(np.log10(size)))
    return np.round(exact * scale) / scale


def thousandths(values: NDArray[np.float64]) -> tuple[NDArray[np.int64], float]:
    """Round numbers to three digits of the largest in magnitude: return them as whole numbers, and
    what these are to be divided by. Rounding twice changes nothing."""
    largest = float(np.abs(values).max(initial=0.0))
    if not largest:
        return np.zeros(len(values), np.int64), 1.0
    digits = 2 - int(np.floor(np.log10(largest)))
    digits -= round(largest * 10.0**digits) > 999  # 99.97 is 100
    return np.round(values * 10.0**digits).astype(np.int64), 10.0**digits


def five_digits(values: NDArray) -> NDArray[np.float64]:
    """Round numbers to 16 significant bits: an error of at most one part in 65 536.

    Means over hundreds of episodes to three digits need no more. Rounding twice changes nothing. If
    a number lies beyond float32, all stay as they are.
    """
    exact = np.asarray(values, dtype=np.float64)
    with np.errstate(over="ignore"):
        bits = exact.astype(np.float32).view(np.uint32).astype(np.uint64)
    rounded = ((bits + np.uint64(128)) // np.uint64(256) * np.uint64(256)).astype(np.uint32)
    numbers = rounded.view(np.float32).astype(np.float64)
    return numbers if np.isfinite(numbers).all() else exact
