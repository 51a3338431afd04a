"""Tables over all tasks: pairs that only EMCC tells apart, means with tests, ranks and orders."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import title
from agents.reporting.table import Number, Row, Table, corrected, number, p_head, p_number
from agents.reporting.tables import difference_rows
from agents.results.groups import Group, RunResult
from agents.results.names import by_task, changes, in_order, titled
from agents.results.statistics import (
    ACROSS_WORDS,
    LEVEL,
    MARGIN,
    OverTasks,
    alike,
    bootstrapped,
    by_third,
    common_limit,
    common_measures,
    comparisons,
    difference_of,
    differences_of_sets,
    holm,
    known,
    mixed,
    on_common_seeds,
    only,
)
from emcc import iqm
from emcc.parts import ALPHA, PARTS
from emcc.statistics import FEWEST_RUNS

RATES, TASKS = "Cost rate against EMCC", "All tasks together"
RANKS, ORDERS = "Ranks over tasks", "What EMCC orders otherwise than the cost rate"
RESAMPLES = 1_000
FEWEST_ALGORITHMS, FEWEST_TASKS = 3, 2
"""Fewest algorithms and tasks for tables of ranks and orders."""
MOST_PAIRED = 8
"""Most algorithms of which every pair is compared over all tasks."""

Cells = Mapping[str, Mapping[str, Group]]
"""Groups by the algorithm's title and the task; every algorithm has all tasks."""
Draws = NDArray[np.float64]
"""[RESAMPLES + 1, ...]: value for the actual runs, then for each bootstrap resample"""


def tables_over_tasks(groups: Sequence[Group]) -> dict[str, Table]:
    """Return the tables over tasks by title, without those for which there are too few runs.

    All but the table of pairs are about one cost, the first group's."""
    across = [ACROSS_WORDS] if mixed(groups) else []
    groups = alike(groups)
    of_one_cost = [group for group in groups if group.cost == groups[0].cost]
    cells = comparable(of_one_cost)
    made = {TASKS: over_tasks(of_one_cost)}
    if len(cells) >= FEWEST_ALGORITHMS and len(tasks_of(cells)) >= FEWEST_TASKS:
        names = dict.fromkeys(title(g.config.algorithm) for g in of_one_cost if g.runs)
        left_out = [name for name in names if name not in cells]
        made |= {RANKS: ranks_table(cells, left_out), ORDERS: orders_table(cells)}
    alone = [f"Of {groups[0].cost} alone."] if len(of_one_cost) < len(groups) else []
    over = {k: replace(t, notes=[*t.notes, *alone]) for k, t in made.items() if t is not None}
    rates = separated_table(groups)
    made = ({} if rates is None else {RATES: rates}) | over
    return {name: replace(table, notes=[*table.notes, *across]) for name, table in made.items()}


def tasks_of(cells: Cells) -> list[str]:
    """Return the tasks of the cells, the same for every algorithm."""
    return list(next(iter(cells.values()), ()))


def on_every_task(groups: Sequence[Group], name: Callable[[Group], str]) -> Cells:
    """Return groups by name and task, for names with a group on every task.

    Of several groups with a name on a task, the one with the most runs is taken."""
    named: dict[str, dict[str, Group]] = {}
    for group in groups:
        own = named.setdefault(name(group), {})
        own[group.task] = max(own.get(group.task, group), group, key=lambda g: len(g.runs))
    tasks = dict.fromkeys(group.task for group in groups)
    complete = {name: own for name, own in named.items() if len(own) == len(tasks)}
    return {name: {task: own[task] for task in tasks} for name, own in complete.items()}


def of_presets(groups: Iterable[Group]) -> list[Group]:
    """Return the groups with complete runs and preset settings, in the order of `in_order`."""
    return [g for g in in_order(groups) if g.runs and not changes(g.config, g.task)]


def comparable(groups: Iterable[Group]) -> Cells:
    """Return the groups with preset settings that can be compared over tasks.

    On each task those of the most common length are taken; algorithms without such a group on every
    task are left out."""
    usual = of_presets(groups)
    lengths: dict[str, Counter[int]] = {}
    for group in usual:
        lengths.setdefault(group.task, Counter())[group.total_steps] += 1
    most = {
        task: max(count.items(), key=lambda pair: pair[::-1])[0] for task, count in lengths.items()
    }
    equal = [group for group in usual if group.total_steps == most[group.task]]
    return on_every_task(equal, lambda group: title(group.config.algorithm))


SEPARATED = ("cost rate A", "cost rate B", "B - A", "p equal", "EMCC A", "EMCC B", "B - A")


def separated_table(groups: Sequence[Group]) -> Table | None:
    """Return the table of pairs with equal cost rates and different EMCC; its caption counts them.

    None if there is nothing to compare."""
    pairs = comparisons([group for own in by_task(groups).values() for group in own])
    if pairs.empty:
        return None
    not_told, equal = pairs.loc[pairs.rate_p > LEVEL], pairs.loc[pairs.equal_rates]
    shown, differ = equal.loc[equal.emcc_p <= LEVEL], (not_told.emcc_p <= LEVEL).sum()
    words = (
        f"Of {len(pairs)} comparisons the cost rate does not tell {len(not_told)} apart, of which "
        f"EMCC tells {differ} apart; {len(equal)} have equal cost rates, of which EMCC tells "
        f"{len(shown)} apart: these are listed. Compared are all pairs on a task in each third of "
        f"training, of {FEWEST_RUNS} seeds or more. Cost rates are equal where their permutation "
        f"test has p > {LEVEL:g} and means differ by less than {MARGIN:g} (p equal: equivalence "
        f"test, ≤ {LEVEL:g}). EMCC (α = {ALPHA:g}) differs where its p, corrected for "
        f"{len(pairs)} tests (Holm), is at most {LEVEL:g}. Differences with Welch's 95 % t "
        "interval, where all runs of either end in one place"
    )
    head = ["A and B", *SEPARATED, p_head(len(pairs))]
    none = Row("none", [Number(None)] * (len(head) - 1), kind="difference")
    return Table(words, head, [*map(_separated_row, shown.itertuples())] or [none])


def _separated_row(pair: Any) -> Row:
    """Return the row of a pair; pair: a row of `comparisons`."""
    names = " and ".join(group.name for group in (pair.a, pair.b))
    one_place = pair.a.one_place and pair.b.one_place
    cells = []
    for stem, p in (("rate", pair.equivalence_p), ("EMCC", pair.emcc_p)):
        sides = by_third(pair.a, stem)[pair.part], by_third(pair.b, stem)[pair.part]
        cells += [Number(float(np.mean(side)), 3) for side in sides]
        gap = difference_of(*sides, one_place)
        cells += [number(gap, 3, signed=True), p_number(p)]
    return Row(f"{pair.a.task}, {PARTS[pair.part]}: {names}", cells, kind="difference")


TEST = (
    "permutation test of Welch's t of the means over seeds and tasks, runs exchanged within tasks"
)
"""The permutation test over tasks, as captions describe it."""


def over_tasks(groups: Sequence[Group]) -> Table | None:
    """Return the table of training's measures over all tasks, for algorithms with runs of one
    length and preset settings on every task.

    None if there are fewer than two tasks, or no algorithm has five seeds in common on all. Pairs
    of more than `MOST_PAIRED` algorithms are left to the table of ranks.
    """
    columns = common_measures()
    cells = on_every_task(of_presets(groups), lambda g: titled(g.config.algorithm, g.length))
    runs = {name: on_common_seeds(list(own.values()), FEWEST_RUNS) for name, own in cells.items()}
    runs = {name: values for name, values in runs.items() if values}
    tasks = len(tasks_of(cells))
    if tasks < 2 or not runs:
        return None
    rows = []
    for name, values in runs.items():
        middle = [
            number(bootstrapped(iqm, values[m.name]) if m.name in values else None, m.digits)
            for m in columns
        ]
        seeds = len(next(iter(values.values())))
        rows.append(Row(f"{name}, {seeds} seeds", middle, kind="mean"))
    pairs = list(combinations(runs, 2)) if len(runs) <= MOST_PAIRED else []
    tested, tests = holm(
        {
            f"P({a} better than {b})": differences_of_sets(runs[b], runs[a], gaps=False)
            for a, b in pairs
        }
    )
    for name, told in tested.items():
        _, p, better = difference_rows("", told, columns, tests)
        rows += [Row(name, better.numbers, kind="test"), p]
    words = [f"Over {tasks} tasks, presets' runs: interquartile mean of all seeds and tasks"]
    if pairs:
        words.append(
            "P: probability that a run of the first is better than one of the second on a task, "
            "equal ones half"
        )
    words.append("[95 % bootstrap interval]")
    if pairs:
        words.append(f"p: {TEST}{corrected(tests, 'of this table')}")
    ending = f". Algorithms with {FEWEST_RUNS} common seeds or more on every task"
    caption = "; ".join(words) + ending
    return Table(caption, [f"{tasks} tasks", *(m.head for m in columns)], rows)


def differences_over_tasks(told: OverTasks, asked: Collection[str] | None = None) -> Table | None:
    """Return the table of differences B - A of means over all tasks with their tests.

    None if `told` is empty. asked: see `agents.results.statistics.only`.
    """
    if not told:
        return None
    columns = common_measures()
    tested, tests = holm({key: only(asked, own) for key, own in told.items()})
    rows = []
    for key, own in tested.items():
        # One digit more than means have: over tasks, small differences can be significant.
        rows += difference_rows(", ".join(key), own, columns, tests, more_digits=1)
    words = (
        "Over all tasks that both have: B - A, difference of the means over seeds and tasks [95 % "
        f"bootstrap interval, of {FEWEST_RUNS} seeds or more]; p: {TEST}"
        f"{corrected(tests, 'of this table')}; P(B better): probability that a run of B "
        "is better than one of A on a task, equal ones half"
    )
    return Table(words, ["over all tasks", *(m.head for m in columns)], rows)


def ranked(run: RunResult, limit: float | None) -> dict[str, float | None]:
    """Return the numbers by which algorithms are ranked, by column heading; lower is better, and
    None stands for what the run lacks."""
    found = {f"EMCC_{part}": run.measures.get(f"EMCC_{part}") for part in PARTS}
    found["cost rate"], j_r = run.measures.get("cost_rate"), run.measures.get("J_R")
    above = None if limit is None else float((run.records.cost > limit).mean())
    return found | {"violation rate": above, "J_R": None if j_r is None else -j_r}


def ranked_values(cells: Cells) -> dict[str, list[list[NDArray[np.float64]]] | None]:
    """Return the values of `ranked` by heading, then per task and algorithm, [runs] each.

    None for a heading that some run lacks."""
    tables: dict[str, list[list[list[float] | None]]] = {}
    for task in tasks_of(cells):
        groups = [own[task] for own in cells.values()]
        limit = common_limit(groups)
        found = [[ranked(run, limit) for run in group.runs] for group in groups]
        for head in found[0][0]:
            values = [known([run[head] for run in runs]) for runs in found]
            tables.setdefault(head, []).append(values)
    return {
        head: [[np.array(v) for v in values] for values in table] if all(map(all, table)) else None
        for head, table in tables.items()
    }


def weights(runs: Sequence[NDArray[np.float64]], rng: np.random.Generator) -> Draws:
    """Return each run's weight in the mean of its algorithm, for the runs of one task, and for each
    bootstrap resample of them: [RESAMPLES + 1, all runs, one algorithm after another]."""
    counts = [rng.multinomial(len(r), np.full(len(r), 1 / len(r)), RESAMPLES) for r in runs]
    drawn = [
        np.concatenate([np.ones((1, len(r))), c]) / len(r)
        for r, c in zip(runs, counts, strict=True)
    ]
    return np.concatenate(drawn, axis=1)


def ranks_and_wins(table: Sequence[Sequence[NDArray[np.float64]]]) -> tuple[Draws, Draws]:
    """Return each algorithm's mean rank over tasks and its probability of improvement.

    Both are [RESAMPLES + 1, algorithms]. Ranks are those of means over runs, 1 the best. The second
    is the probability that a run of the algorithm is better than a run of another algorithm on the
    same task; ties count half."""
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
    """Return the cell of a statistic, with its 95 % interval if there are enough runs.

    draws: [RESAMPLES + 1]."""
    low, high = np.quantile(draws[1:], [0.025, 0.975]).tolist() if enough else (None, None)
    return Number(float(draws[0]), digits, low, high, signed=signed)


def ranks_table(cells: Cells, left_out: Sequence[str]) -> Table:
    """Return the table of mean ranks over tasks, and of the probability of improvement over the
    other algorithms, with their intervals. left_out: algorithms without runs on every task."""
    drawn = {
        head: ranks_and_wins(table) if table else None
        for head, table in ranked_values(cells).items()
    }
    emcc, rate = drawn[f"EMCC_{max(PARTS)}"], drawn["cost rate"]
    rows, tasks = [], len(tasks_of(cells))
    for k, (name, own) in enumerate(cells.items()):
        seeds = [len(group.runs) for group in own.values()]
        enough = min(seeds) > 1 and sum(seeds) >= FEWEST_RUNS
        for what, digits in ((0, 1), (1, 2)):
            numbers = [
                cell(draws[what][:, k], enough, digits) if draws else Number(None)
                for draws in drawn.values()
            ]
            moved = Number(None)
            if emcc and rate:
                gap = emcc[what][:, k] - rate[what][:, k]
                moved = cell(gap, enough, digits, signed=True)
            number_of_seeds = " to ".join(map(str, sorted({min(seeds), max(seeds)})))
            words = "P(better)" if what else f"{name}, {number_of_seeds} seeds"
            kind = "test" if what else "mean"
            rows.append(Row(words, [*numbers, moved], kind=kind))
    words = (
        f"Over {tasks} tasks and {len(cells)} algorithms: mean rank of the means over seeds, "
        "1 the best (J_R: the highest, costs or not); P(better): probability that a run is better "
        "than one of another algorithm on the same task, equal ones half, mean over tasks and "
        "algorithms; [95 % stratified bootstrap interval, seeds drawn again within each task]. The "
        "last column: by EMCC in the last third less that by the cost rate. Violation rate: share "
        "of training's episodes above the limit"
    )
    notes = [f"Not on every task, and left out: {', '.join(left_out)}."] if left_out else []
    head = [f"{tasks} tasks", *drawn, f"EMCC_{max(PARTS)} less cost rate", ""]
    return Table(words, head, rows, notes)


def orders_table(cells: Cells) -> Table:
    """Return the table of how differently EMCC and the cost rate of a third order algorithms."""
    rows = []
    for task in tasks_of(cells):
        rates, emccs = (
            {name: by_third(own[task], stem) for name, own in cells.items()}
            for stem in ("rate", "EMCC")
        )
        for part in [p for p in PARTS if all(p in of for of in rates.values())]:
            one_place = {name: own[task].one_place for name, own in cells.items()}
            rate = {name: of[part] for name, of in rates.items()}
            emcc = {name: of[part] for name, of in emccs.items()}
            rows.append(order_row(f"{task}, {PARTS[part]}", rate, emcc, one_place))
    words = (
        "Pairs of algorithms of which the one with the lower mean cost rate has the higher mean "
        "EMCC in the same third of training; tau: Kendall's rank correlation of both orders; the "
        "pair whose EMCC differs most, A before B by the cost rate and after it by EMCC, with the "
        f"differences A - B [Welch's 95 % t interval, of {FEWEST_RUNS} seeds or more that end in "
        "one place]"
    )
    head = ["task and third", "otherwise", "tau", "cost rate A - B", "EMCC A - B", "A, B"]
    return Table(words, head, rows)


def order_row(
    name: str,
    rates: Mapping[str, list[float]],
    emccs: Mapping[str, list[float]],
    one_place: Mapping[str, bool],
) -> Row:
    """Return the row on pairs of algorithms that EMCC and cost rate order differently.

    name: of the task and third; rates, emccs: values of the runs by algorithm; one_place: whether
    all runs of an algorithm end in one place.
    """
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
    both = one_place[a] and one_place[b]
    gaps = [number(difference_of(of[b], of[a], both), 3, signed=True) for of in (rates, emccs)]
    return Row(name, [*counts, *gaps], f"{a}, {b}", kind="difference")
