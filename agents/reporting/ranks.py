"""Algorithms over all tasks: ranks, and what EMCC orders otherwise than the cost rate does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import title
from agents.reporting.table import Number, Row, Table, number
from agents.results.frame import changes, in_order
from agents.results.reading import Group, Run
from agents.results.statistics import difference_of, known, thirds_of
from emcc.parts import PARTS
from emcc.statistics import FEWEST_RUNS

RESAMPLES = 1_000
FEWEST_ALGORITHMS, FEWEST_TASKS = 3, 2

Cells = Mapping[str, Mapping[str, Group]]
"""A group by the algorithm's title and the task; every algorithm has all tasks."""
Draws = NDArray[np.float64]
"""[RESAMPLES + 1, ...]: the runs as they are, then as they were drawn again"""


def cells_of(groups: Sequence[Group]) -> Cells:
    """The runs with preset settings that can be compared: on each task those of the length that
    most algorithms have there; of the algorithms that have runs on every task."""
    found: dict[tuple[str, str], Group] = {}
    usual = [g for g in in_order(groups) if g.runs and not changes(g.config, g.task)]
    lengths: dict[str, Counter[int]] = {}
    for group in usual:
        lengths.setdefault(group.task, Counter())[group.config.steps] += 1
    for group in usual:
        most = max(lengths[group.task].items(), key=lambda pair: (pair[1], pair[0]))[0]
        key = title(group.config.algorithm), group.task
        if group.config.steps == most and (
            key not in found or len(group.runs) > len(found[key].runs)
        ):
            found[key] = group
    names = dict.fromkeys(name for name, _ in found)
    common = [name for name in names if all((name, task) in found for task in lengths)]
    return {name: {task: found[name, task] for task in lengths} for name in common}


def violation_rate(run: Run, limit: float | None) -> float | None:
    """Share of training's episodes whose cost is above the limit."""
    return None if limit is None else float((run.records.cost > limit).mean())


def limits(cells: Cells) -> dict[str, float | None]:
    """The cost limit of each task that its algorithms share; None where they share none."""
    told: dict[str, set[float]] = {}
    for own in cells.values():
        for task, group in own.items():
            if group.limit is not None:
                told.setdefault(task, set()).add(group.limit)
    tasks = next(iter(cells.values()))
    return {task: told[task].pop() if len(told.get(task, ())) == 1 else None for task in tasks}


def columns(cells: Cells) -> dict[str, tuple[int, Callable[[Group, Run], float | None]]]:
    """The measures that are ranked by their heads: 1 where the lower is the better, else -1, and
    the value of a run."""
    common = limits(cells)

    def measured(name: str) -> Callable[[Group, Run], float | None]:
        return lambda group, run: run.measures.get(name)

    made = {f"EMCC_{part}": (1, measured(f"EMCC_{part}")) for part in PARTS}
    made["cost rate"] = 1, measured("cost_rate")
    made["violation rate"] = 1, lambda group, run: violation_rate(run, common[group.task])
    made["J_R"] = -1, measured("J_R")
    return made


def values(
    cells: Cells, sign: int, value: Callable[[Group, Run], float | None]
) -> list[list[NDArray[np.float64]]] | None:
    """Values of the runs, the lower the better, for each task and algorithm; None where some
    lack."""
    tasks = next(iter(cells.values()))
    table = []
    for task in tasks:
        own = [known([value(c[task], run) for run in c[task].runs]) for c in cells.values()]
        if not all(own):
            return None
        table.append([sign * np.array(runs) for runs in own])
    return table


def weights(runs: Sequence[NDArray[np.float64]], rng: np.random.Generator) -> Draws:
    """The share of every run of a task, all algorithms in turn, in the mean of its own
    algorithm."""
    counts = [rng.multinomial(len(r), np.full(len(r), 1 / len(r)), RESAMPLES) for r in runs]
    drawn = [
        np.concatenate([np.ones((1, len(r))), c]) / len(r)
        for r, c in zip(runs, counts, strict=True)
    ]
    return np.concatenate(drawn, axis=1)


def ranks_and_wins(table: Sequence[Sequence[NDArray[np.float64]]]) -> tuple[Draws, Draws]:
    """Each algorithm's mean rank over tasks, of the means over runs, 1 the best, and the
    probability that a run of it is better than one of another algorithm on the same task, equal
    ones half: [RESAMPLES + 1, algorithms] each."""
    from scipy.stats import rankdata

    rng, ranks, wins = np.random.default_rng(0), [], []
    for runs in table:
        share, flat = weights(runs, rng), np.concatenate(runs)
        owner = np.repeat(np.arange(len(runs)), [len(r) for r in runs])
        own = (owner[:, None] == np.arange(len(runs))).astype(float)
        ranks.append(rankdata((share * flat) @ own, axis=1))
        better = (flat[:, None] < flat) + 0.5 * (flat[:, None] == flat)
        better *= owner[:, None] != owner
        wins.append((share * (share @ better.T)) @ own / (len(runs) - 1))
    return np.mean(ranks, axis=0), np.mean(wins, axis=0)


def cell(draws: NDArray[np.float64], enough: bool, digits: int, signed: bool = False) -> Number:
    """The number of some draws, with their 95 % interval where there are enough runs."""
    low, high = np.quantile(draws[1:], [0.025, 0.975]).tolist() if enough else (None, None)
    return Number(float(draws[0]), digits, low, high, signed=signed)


def ranks_table(groups: Sequence[Group]) -> Table | None:
    """Mean ranks over tasks with their intervals, and the probability of improvement over the other
    algorithms; None of fewer than three algorithms or two tasks."""
    cells = cells_of(groups)
    tasks = list(next(iter(cells.values()), ()))
    if len(cells) < FEWEST_ALGORITHMS or len(tasks) < FEWEST_TASKS:
        return None
    ranked = {}
    for head, (sign, value) in columns(cells).items():
        table = values(cells, sign, value)
        ranked[head] = ranks_and_wins(table) if table else None
    emcc, rate = ranked[f"EMCC_{max(PARTS)}"], ranked["cost rate"]
    rows = []
    for k, (name, own) in enumerate(cells.items()):
        seeds = [len(group.runs) for group in own.values()]
        enough = min(seeds) > 1 and sum(seeds) >= FEWEST_RUNS
        for what, digits in ((0, 1), (1, 2)):
            numbers = [
                cell(draws[what][:, k], enough, digits) if draws else Number(None)
                for draws in ranked.values()
            ]
            moved = Number(None)
            if emcc and rate:
                gap = emcc[what][:, k] - rate[what][:, k]
                moved = cell(gap, enough, digits, signed=True)
            words = "P(better)" if what else f"{name}, {min(seeds)} to {max(seeds)} seeds"
            kind = "test" if what else "mean"
            rows.append(Row(words, [*numbers, moved], kind=kind))
    left = dict.fromkeys(title(g.config.algorithm) for g in groups if g.runs)
    left = [name for name in left if name not in cells]
    words = (
        f"Over {len(tasks)} tasks and {len(cells)} algorithms: mean rank of the means over seeds, "
        "1 the best (J_R: the highest, costs or not); P(better): probability that a run is better "
        "than one of another algorithm on the same task, equal ones half, mean over tasks and "
        "algorithms; [95 % stratified bootstrap interval, seeds drawn again within each task]. The "
        "last column: by EMCC in the last third less that by the cost rate. Violation rate: share "
        "of training's episodes above the limit"
    )
    notes = [f"Not on every task, and left out: {', '.join(left)}."] if left else []
    head = [f"{len(tasks)} tasks", *ranked, f"EMCC_{max(PARTS)} less cost rate", ""]
    return Table(words, head, rows, notes)


def orders_table(groups: Sequence[Group]) -> Table | None:
    """Where EMCC orders algorithms otherwise than the cost rate of the same third, and by how much;
    None of fewer than three algorithms or two tasks."""
    cells = cells_of(groups)
    tasks = list(next(iter(cells.values()), ()))
    if len(cells) < FEWEST_ALGORITHMS or len(tasks) < FEWEST_TASKS:
        return None
    rows = []
    for task in tasks:
        found = {name: thirds_of(own[task]) for name, own in cells.items()}
        for part, third in PARTS.items():
            rates = {name: [run.cost_rate for run in of[part]] for name, of in found.items()}
            emccs = {name: [run.emcc for run in of[part]] for name, of in found.items()}
            rows.append(order_row(f"{task}, {third}", rates, emccs))
    words = (
        "Pairs of algorithms of which the one with the lower mean cost rate has the higher mean "
        "EMCC in the same third of training; tau: Kendall's rank correlation of both orders; the "
        "pair whose EMCC differs most, A before B by the cost rate and after it by EMCC, with the "
        f"differences A - B [Welch's 95 % t interval, of {FEWEST_RUNS} seeds or more]"
    )
    head = ["task and third", "otherwise", "tau", "cost rate A - B", "EMCC A - B", "A, B"]
    return Table(words, head, rows)


def order_row(name: str, rates: Mapping[str, list[float]], emccs: Mapping[str, list[float]]) -> Row:
    """The pairs of a task and third that the two measures order otherwise."""
    from scipy.stats import kendalltau

    rate, emcc = ({k: float(np.mean(v)) for k, v in of.items()} for of in (rates, emccs))
    pairs = [
        pair if rate[pair[0]] < rate[pair[1]] else pair[::-1] for pair in combinations(rate, 2)
    ]
    swapped = [(a, b) for a, b in pairs if rate[a] < rate[b] and emcc[a] > emcc[b]]
    tau = float(np.asarray(kendalltau(list(rate.values()), list(emcc.values())))[0])
    counts = [
        Number(len(swapped), total=len(pairs)),
        Number(None if np.isnan(tau) else tau, 2, signed=True),
    ]
    if not swapped:
        return Row(name, [*counts, Number(None), Number(None)], kind="difference")
    a, b = max(swapped, key=lambda pair: emcc[pair[0]] - emcc[pair[1]])
    gaps = [number(difference_of(of[b], of[a]), 3, signed=True) for of in (rates, emccs)]
    return Row(name, [*counts, *gaps], f"{a}, {b}", kind="difference")
