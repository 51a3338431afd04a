"""The tables of a report: each a pivot of the runs' frame, or of tests on it."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import title
from agents.reporting.table import Number, Row, Table, count, number, p_number
from agents.results.frame import by_task, changes, in_order, name_of, title_of
from agents.results.measures import Measure, measure, measures
from agents.results.reading import Group, Run
from agents.results.statistics import (
    INTERVALS,
    LEVEL,
    MARGIN,
    Comparison,
    Difference,
    Summary,
    TwoSets,
    Values,
    bootstrapped,
    common_measures,
    comparisons,
    corrected,
    difference_of,
    matrices,
    mean_of,
    places,
    summaries,
    within_limit,
)
from emcc import emcc_by_part, iqm, longest_streaks, panel
from emcc.panels import SEVERITY, WINDOW, CostMeasures, Panel, cost_measures
from emcc.panels import rows as panel_rows
from emcc.parts import ALPHA, PARTS, rollouts_by_part
from emcc.statistics import COST, FEWEST_RUNS, SHARE, Bounds

Key = TypeVar("Key", bound=Hashable)


class Printed(NamedTuple):
    """Numbers that a publication prints for an algorithm on a task."""

    values: Mapping[str, float]
    """By the measure's name."""
    within: bool
    """Whether its J_C is within the cost limit."""
    source: str
    """Name of the publication, and its number of runs."""


Reference = Callable[[str, str], Printed | None]
"""The printed numbers by task and algorithm, None where there are none."""


def nothing_printed(task: str, algorithm: str) -> None:
    """The reference of a report without one."""


def task_table(
    groups: Sequence[Group], printed: Reference = nothing_printed, notes: Sequence[str] = ()
) -> Table:
    """One task: for each algorithm the means above the printed numbers, then every run.

    What is best among the means, and among the printed numbers, is marked: see `best`.
    """
    task, groups = groups[0].task, in_order(groups)
    told = dict(zip(map(id, groups), summaries(groups), strict=True))
    rows: list[Row] = []
    ours, others = {}, {}
    for name in dict.fromkeys(group.config.algorithm for group in groups):
        for group in groups:
            if group.config.algorithm == name and group.runs:
                summary = told[id(group)]
                ours[len(rows)] = means(summary), within(group)
                rows.append(mean_row(group, summary))
        if reference := printed(task, name):
            others[len(rows)] = reference.values, reference.within
            rows.append(printed_row(title(name), reference))
    rows = mark(rows, best(ours) | best(others))
    rows += [row for group in groups for row in run_rows(group)]
    words = f"{marking()}; among our means" + (
        ", and among the paper's, of which J_C, a mean, is within the limit" if others else ""
    )
    return measures_table(caption(groups), task, rows, [*notes, *_limited(groups)], words)


def measures_table(
    caption: str, first: str, rows: Sequence[Row], notes: Sequence[str] = (), marking: str = ""
) -> Table:
    """A table of rows of a name (headed by `first`), each measure, the runs within the cost limit,
    and where runs end."""
    head = [first, *(m.head for m in measures()), "within limit", "ends in"]
    return Table(caption, head, rows, notes, marking, [m.head for m in measures() if m.detail])


def mark(rows: Sequence[Row], marked: set[tuple[int, str]]) -> list[Row]:
    """The rows with some measures marked: pairs of a row's place and a measure's name."""
    names = [*(m.name for m in measures()), ""]
    return [
        replace(
            row,
            numbers=[
                replace(cell, marked=(place, name) in marked)
                for name, cell in zip(names, row.numbers, strict=True)
            ],
        )
        for place, row in enumerate(rows)
    ]


def caption(groups: Sequence[Group]) -> str:
    """Definitions of the numbers of a table."""
    episodes = sorted({run.episodes for group in groups for run in group.runs})
    notes = "".join(f"{m.note}; " for m in measures() if m.note)
    if any(run.ways for group in groups for run in group.runs):
        notes += (
            '"through": as many cost steps as the shortest way through the region takes, or more, '
            '"round": fewer; '
        )
    return (
        f"EMCC: alpha = {ALPHA:g}, ties kept; J_R, J_C, CVaR: undiscounted, deterministic policy, "
        f"{' or '.join(map(str, episodes)) or 'no'} episodes; {notes}mean {INTERVALS}; within "
        "limit: seeds whose J_C is at most the cost limit; counts of seeds [95 % Clopper-Pearson "
        "interval of the share]"
    )


def means(summary: Mapping[str, Summary]) -> dict[str, float | None]:
    """The mean of each measure; None where a run lacks it."""
    return {name: told.mean and told.mean.value for name, told in summary.items()}


def within(group: Group) -> bool | None:
    """Whether all runs of a group keep its cost limit; None where that is not known."""
    share = within_limit(group, group.limit)
    return share and share.count == share.runs


def mean_row(group: Group, summary: Mapping[str, Summary], name: str = "") -> Row:
    """The row of the means of a group, with their intervals over seeds, and of its shares."""
    cells = [number(summary[m.name].mean, m.digits) for m in measures()]
    cells.append(count(within_limit(group, group.limit)))
    ends = "; ".join(f"{place} {count(share)}" for place, share in places(group).items())
    return Row(f"{name or name_of(group)}, mean of {len(group.runs)}", cells, ends, kind="mean")


def printed_row(name: str, printed: Printed) -> Row:
    """The row of printed numbers."""
    cells = [Number(printed.values.get(m.name), m.digits) for m in measures()]
    return Row(f"{name}, {printed.source}", [*cells, Number(None)], kind="paper")


def run_rows(group: Group, prefix: str = "") -> Iterator[Row]:
    """A row for each run of a group."""
    limit = group.limit
    for run in group.runs:
        cells = [Number(run.measures.get(m.name), m.digits) for m in measures()]
        share = within_limit(replace(group, runs=[run]), limit)
        cells.append(Number(share and share.count, total=1))
        yield Row(f"{prefix}{name_of(group)}, seed {run.seed}", cells, ends_words(run))


def ends_words(run: Run) -> str:
    """Place where most evaluated episodes of a run end, with their share unless all do, and the way
    by which they came, where it is known."""
    total = sum(run.ends.values())
    shares = [f"{100 * run.ends[run.end] / total:.0f} %"] if len(run.ends) > 1 else []
    ways = run.ways.get(run.end, {})
    if len(ways) == 1:
        return f"{run.end}, {next(iter(ways))}" + "".join(f" ({share})" for share in shares)
    shares += [f"{100 * episodes / total:.0f} % {way}" for way, episodes in sorted(ways.items())]
    return run.end + (f" ({', '.join(shares)})" if shares else "")


def _limited(groups: Sequence[Group]) -> list[str]:
    """The costs that the algorithms' limits hold for, where they differ."""
    names: dict[str, dict[str, None]] = {}
    for config in (group.config for group in groups):
        if words := getattr(config.hyperparameters, "limited_cost", ""):
            names.setdefault(words, {})[title(config.algorithm)] = None
    if len(names) < 2:
        return []
    kinds = "; ".join(f"the {words} of {', '.join(titles)}" for words, titles in names.items())
    return [f"The cost limit holds for {kinds}. Marks and claims compare J_C with it."]


Candidate = tuple[Mapping[str, float | None], bool | None]
"""Measures by name, and whether they are within the cost limit (None: not known)."""


def best(candidates: Mapping[Key, Candidate]) -> set[tuple[Key, str]]:
    """The best measures of some candidates.

    Of each measure of training the lowest, or the highest where that is better; of those of the
    trained policy all that belong to the candidates of the highest J_R among those within their
    limit. All to the digits that are printed, so that equal ones are marked together; nothing where
    there is nothing to compare with. Source: caption of table Circle2DResults.
    """
    marked: set[tuple[Key, str]] = set()
    returns = _rounded({k: c for k, c in candidates.items() if c[1]}, measure("J_R"))
    safest = {key for key, value in returns.items() if value == max(returns.values())}
    for m in measures():
        values = _rounded(candidates, m)
        if len(values) < 2 or m.better == "neither":
            continue
        if m.of == "policy":
            chosen = safest & values.keys()
        else:
            wanted = (min if m.better == "lower" else max)(values.values())
            chosen = {key for key, value in values.items() if value == wanted}
        marked |= {(key, m.name) for key in chosen}
    return marked


def _rounded(candidates: Mapping[Key, Candidate], m: Measure) -> dict[Key, float]:
    """The measure of each candidate that has it, as it is printed."""
    values = {key: candidate[0].get(m.name) for key, candidate in candidates.items()}
    return {key: round(v, m.digits) for key, v in values.items() if v is not None}


def marking() -> str:
    """The rule of `best` in words."""
    rules = [
        f"the {rule} {_list(chosen)}"
        for rule, better in (("lowest", "lower"), ("highest", "higher"))
        if (chosen := [m for m in measures() if m.of == "training" and m.better == better])
    ]
    policy = [m for m in measures() if m.of == "policy" and m.better != "neither"]
    if policy:
        rules.append(f"{_list(policy)} of the highest return with every seed within the limit")
    return "; ".join(rules)


def _list(chosen: Iterable[Measure]) -> str:
    """Words of measures: A, B and C."""
    *first, last = dict.fromkeys(m.word or m.title for m in chosen)
    return f"{', '.join(first)} and {last}" if first else last


PANEL_OF_POLICIES = (
    ("cost rate (per step)", "cost_rate", 3, COST),
    (f"CVaR of episode cost (α = {ALPHA:g})", "cvar", 2, COST),
    ("95th percentile of episode cost", "p95", 2, COST),
    ("highest episode cost", "maximum", 2, COST),
    ("violation rate V", "violation_rate", 3, SHARE),
    ("severity D", "severity", 3, SEVERITY),
    ("severity of violations D+", "severity_of_violations", 3, COST),
)
"""Rows for the episodes of the final policies: title, field of `CostMeasures`, decimal places, and
the values that there can be."""
POLICIES = {"stochastic": "policy with its noise", "deterministic": "policy without noise"}
"""Final policies, in the words of the rows."""


def panel_table(groups: Sequence[Group]) -> Table:
    """EMCC beside the measures of cost that other papers report: a row for each measure, a column
    for each algorithm, means over its runs.

    groups: of one task, at least one with a run. Each is measured by its own cost limit; one of an
    unconstrained algorithm by that of the others, where they have one.
    """
    groups = [group for group in in_order(groups) if group.runs]
    own = [group.limit for group in groups]
    shared = {limit for limit in own if limit is not None}
    usual = shared.pop() if len(shared) == 1 else None
    limits = [usual if limit is None else limit for limit in own]
    # One window for all columns, since a row names it.
    window = min(WINDOW, *(len(run.records) for group in groups for run in group.runs))
    panels: list[list[Panel]] = [
        [
            panel(run.records, limit, window=window, total_steps=group.config.steps)
            for run in group.runs
        ]
        for group, limit in zip(groups, limits, strict=True)
    ]

    def row(name: str, values: Iterable[Values], digits: int, bounds: Bounds) -> Row:
        runs = zip(groups, values, strict=True)
        cells = [number(mean_of(v, group.one_place, bounds), digits) for group, v in runs]
        return Row(name, cells, kind="mean")

    everyone = [run for column in panels for run in column]
    limited = [run for run in everyone if run.limit is not None]
    rows = []
    for line in panel_rows((limited or everyone)[0]):
        values = [[line.value(run) for run in column] for column in panels]
        rows.append(row(f"training: {line.title}", values, line.digits, line.bounds))
    for policy, words in POLICIES.items():
        measured = [
            [_evaluated(run, policy, limit) for run in group.runs]
            for group, limit in zip(groups, limits, strict=True)
        ]
        for name, field, digits, bounds in PANEL_OF_POLICIES if any(map(any, measured)) else ():
            values = [[run and getattr(run, field) for run in column] for column in measured]
            rows.append(row(f"{words}: {name}", values, digits, bounds))
    head = [groups[0].task, *map(name_of, groups), ""]  # the last is for places
    return Table(_panel_caption(groups, limits), head, rows)


def _evaluated(run: Run, policy: str, limit: float | None) -> CostMeasures | None:
    """Measures of the evaluated episodes of a run; None where the run lacks them."""
    evaluated = run.evaluation.get(policy, {})
    cost, length = (np.array(evaluated.get(name, [])) for name in ("cost_returns", "lengths"))
    if not cost.size or cost.shape != length.shape:
        return None
    return cost_measures(cost, length, limit, ALPHA, WINDOW, "all")


def _panel_caption(groups: Sequence[Group], limits: Sequence[float | None]) -> str:
    named = {name_of(g): d for g, d in zip(groups, limits, strict=True) if d is not None}
    if len(set(named.values())) == 1:
        words = f"limit {next(iter(named.values())):g}"
    else:
        words = ", ".join(f"limit of {name} {d:g}" for name, d in named.items()) or "no limit"
    return f"Undiscounted costs of episodes, {words}; mean {INTERVALS}. Definitions: `emcc.panel`"


HEAD_OF_RECORDED = ("steps above 0", "median", "90 %", "max", "EMCC above 0")


def recorded_table(groups: Sequence[Group]) -> Table | None:
    """Numbers recorded at each step, by third of training: how many steps are above 0, how
    much it is there, and EMCC of the steps above a threshold. None where nothing is recorded.

    groups: of one task. The threshold is the median of all values above 0, to two digits.
    """
    groups = [group for group in in_order(groups) if group.runs and group.recorded]
    rows, words = [], []
    for name, unit in groups[0].recorded.items() if groups else ():
        values = [[group.steps(run, name) for run in group.runs] for group in groups]
        every = np.concatenate([steps for runs in values for steps in runs])
        if (every < 0).any() or not (every > 0).any():
            continue
        threshold = float(f"{np.median(every[every > 0]):.2g}")
        words.append(f"{name}: {threshold:g} {unit}")
        for group, runs in zip(groups, values, strict=True):
            rows += _recorded_rows(group, runs, f"{name} ({unit})", threshold)
    if not rows:
        return None
    caption = (
        f"Steps of training: median, 90 % and maximum of those above 0, of all runs; mean "
        f"{INTERVALS}; threshold: the median over all algorithms ({', '.join(words)})"
    )
    return Table(caption, [groups[0].task, *HEAD_OF_RECORDED, "EMCC above threshold", ""], rows)


def _recorded_rows(
    group: Group, runs: Sequence[NDArray[np.float64]], words: str, threshold: float
) -> Iterator[Row]:
    """A row for each third."""
    total = group.config.steps
    streaks = [
        [_emcc_above(run, steps, limit, total) for run, steps in zip(group.runs, runs, strict=True)]
        for limit in (0.0, threshold)
    ]
    for part in PARTS:
        inside = [
            s[:total][rollouts_by_part(np.arange(min(len(s), total)), total)[part]] for s in runs
        ]
        above = np.concatenate(inside)
        above = above[above > 0]
        told = [*np.percentile(above, (50, 90, 100))] if len(above) else [None] * 3
        share = mean_of([float((s > 0).mean()) for s in inside], group.one_place, SHARE)
        cells = [number(share), *(Number(value, 3) for value in told)]
        cells += [
            number(mean_of([run[part] for run in of_limit], group.one_place, SHARE))
            for of_limit in streaks
        ]
        yield Row(f"{name_of(group)}, {words}, {part:g}", cells, kind="mean")


def _emcc_above(
    run: Run, steps: NDArray[np.float64], threshold: float, total: int
) -> dict[float, float]:
    """EMCC by third, of the steps above a threshold."""
    streaks = longest_streaks(steps, run.records.length, threshold)
    records = replace(run.records, longest_streak=streaks, cost_steps=None, streaks=None)
    return emcc_by_part(*records.mcc_per_rollout(), total, ALPHA)


SEPARATED = ("cost rate A", "cost rate B", "B - A", "p equal", "EMCC A", "EMCC B", "B - A", "p")


def separated_table(groups: Sequence[Group]) -> Table | None:
    """Pairs that EMCC tells apart and the cost rate does not, with the counts in a sentence; None
    where there is nothing to compare."""
    pairs = comparisons([group for own in by_task(groups).values() for group in own])
    if not pairs:
        return None
    not_told = [pair for pair in pairs if pair.rate_p > LEVEL]
    equal = [pair for pair in not_told if pair.equal_rates]
    shown = [pair for pair in equal if pair.separated]
    differ = sum(pair.emcc_p <= LEVEL for pair in not_told)
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
    return Table(words, ["A and B", *SEPARATED], list(map(_separated_row, shown)))


def _separated_row(pair: Comparison) -> Row:
    names = " and ".join(name_of(group) for group in (pair.a, pair.b))
    cells = []
    for sides, p in ((pair.rates, pair.equivalence_p), (pair.emccs, pair.emcc_p)):
        cells += [Number(float(np.mean(side)), 3) for side in sides]
        gap = difference_of(*sides, pair.one_place)
        cells += [number(gap, 3, signed=True), p_number(p)]
    return Row(f"{pair.a.task}, {PARTS[pair.part]}: {names}", cells, kind="difference")


TEST = (
    "permutation test of Welch's t of the means over seeds and tasks, runs exchanged within tasks, "
    "corrected for"
)
"""The test of both tables over tasks, before the number of comparisons."""


def over_tasks(groups: Sequence[Group]) -> Table | None:
    """Measures of training over all tasks, of the algorithms that have presets' runs of one length
    on each.

    None where there are not two tasks with five seeds each.
    """
    columns = common_measures()
    tasks = list(dict.fromkeys(group.task for group in groups if group.runs))
    named: dict[str, dict[str, Group]] = {}
    for group in in_order(groups):
        if group.runs and not changes(group.config, group.task):
            beside = named.setdefault(title_of(group.config, group.task), {})
            same = beside.setdefault(group.task, group)
            beside[group.task] = max(same, group, key=lambda g: len(g.runs))
    common = {name: list(own.values()) for name, own in named.items() if len(own) == len(tasks)}
    runs = {name: matrices(own, FEWEST_RUNS) for name, own in common.items()}
    runs = {name: values for name, values in runs.items() if values}
    if len(tasks) < 2 or not runs:
        return None
    rows = []
    for name, values in runs.items():
        cells = [number(bootstrapped(iqm, values.get(m.name)), m.digits) for m in columns]
        seeds = len(next(iter(values.values())))
        rows.append(Row(f"{name}, {seeds} seeds", cells, kind="mean"))
    tested = {
        f"P({a} better than {b})": TwoSets(runs[b], runs[a], len(tasks)).differences(gaps=False)
        for a, b in combinations(runs, 2)
    }
    p_values = holm(tested)
    for name, told in tested.items():
        rows.append(Row(name, [number(told[m.name].better) for m in columns], kind="test"))
        rows.append(p_row(name, columns, p_values))
    words = (
        f"Over {len(tasks)} tasks, presets' runs: interquartile mean of all seeds and tasks; P: "
        "probability that a run of the first is better than one of the second on a task, equal "
        f"ones half; [95 % bootstrap interval]; p: {TEST} the {tests(p_values)} comparisons of "
        f"this table (Holm). Algorithms with {FEWEST_RUNS} common seeds or more on every task"
    )
    return Table(words, [f"{len(tasks)} tasks", *(m.head for m in columns)], rows)


def differences_over_tasks(sets: Mapping[str, TwoSets]) -> Table | None:
    """Differences B - A of the means over all tasks, with a test of each; None of no sets.

    sets: by the name of their rows.
    """
    if not sets:
        return None
    columns = common_measures()
    tested = {name: two.differences() for name, two in sets.items()}
    p_values = holm(tested)
    rows = []
    for name, told in tested.items():
        # A digit more than means have: over tasks small differences can be told from none.
        gaps = [number(told[m.name].gap, m.digits + 1, signed=True) for m in columns]
        better = [number(told[m.name].better) for m in columns]
        rows += [
            Row(f"{name}, {sets[name].size}", gaps, kind="difference"),
            p_row(name, columns, p_values),
            Row("P(B better)", better, kind="test"),
        ]
    words = (
        "Over all tasks that both have: B - A, difference of the means over seeds and tasks [95 % "
        f"bootstrap interval, of {FEWEST_RUNS} seeds or more]; p: {TEST} the {tests(p_values)} "
        "comparisons of this table (Holm); P(B better): probability that a run of B is better than "
        "one of A on a task, equal ones half"
    )
    return Table(words, ["over all tasks", *(m.head for m in columns)], rows)


PValues = Mapping[tuple[Any, str], float | None]
"""P values by the pair compared and the measure's name."""


def holm(tested: Mapping[Any, Mapping[str, Difference]]) -> PValues:
    """The p values of all comparisons of a table, corrected together."""
    return corrected({(k, m): d.p for k, told in tested.items() for m, d in told.items()})


def tests(p_values: PValues) -> int:
    """Number of p values that are known."""
    return sum(p is not None for p in p_values.values())


def p_row(pair: Any, columns: Sequence[Measure], p_values: PValues) -> Row:
    """The row of the corrected p values of one pair."""
    return Row("p", [p_number(p_values[pair, m.name]) for m in columns], kind="test")
