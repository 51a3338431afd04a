"""The tables of a report on each task: its measures, the panel of cost measures, and numbers
recorded at each step."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from agents.algorithms import ALGORITHMS, title
from agents.presets import preset
from agents.reporting.table import Number, Row, Table, count, number, p_head, p_number
from agents.results.groups import Group, RunResult
from agents.results.measures import Measure, measure, measures
from agents.results.names import (
    changes,
    in_order,
    publications,
    setting,
    unusual_steps,
)
from agents.results.recorded import Recorded
from agents.results.statistics import (
    INTERVALS,
    Difference,
    Values,
    common_limit,
    group_mean,
    mean_of,
    places,
    within_limit,
)
from agents.training.derive import told_steps
from emcc import panel
from emcc.panels import (
    MOVING_WINDOW,
    CostMeasures,
    Panel,
    cost_measures,
    window_words,
)
from emcc.panels import rows as panel_rows
from emcc.parts import ALPHA, PARTS, TIES
from emcc.statistics import FEWEST_RUNS, SHARE, Bounds

Key = TypeVar("Key", bound=Hashable)


def task_table(groups: Sequence[Group], notes: Sequence[str] = ()) -> Table:
    """Return the table of one task: the means and published numbers by algorithm, then every run.

    The best of the means, and the best of the published numbers, are marked: see `best`.
    """
    task, groups = groups[0].task, in_order(groups)
    rows: list[Row] = []
    ours: dict[str, dict[int, Candidate]] = {}  # by cost: costs of one policy do not compete
    others = {}
    for name in dict.fromkeys(group.config.algorithm for group in groups):
        same = [group for group in groups if group.config.algorithm == name]
        for group in same:
            if group.runs:
                ours.setdefault(group.cost, {})[len(rows)] = means(group), _keeps_all(group, groups)
                rows.append(mean_row(group, group.name))
        for group in [group for group in same if group.printed][:1]:  # one for all of them
            others[len(rows)] = group.printed, _printed_within(group)
            rows.append(printed_row(title(name), group))
    rows = mark(rows, best(others).union(*map(best, ours.values())))
    rows += [row for group in groups for row in run_rows(group)]
    words = f"{marking()}; among our means" + (
        f", and among {publications(groups)}'s, of which J_C, a mean, is within the limit"
        if others
        else ""
    )
    notes = [*notes, *long_settings(groups), *unequal_lengths(groups), *_limited(groups)]
    notes += [*_few_rollouts(groups), *_records(groups), *_random(groups)]
    made = measures_table(caption(groups), task, rows, notes, words, lengths_differ(groups))
    return replace(made, in_paper=caption_in_paper(groups))


def measures_table(
    caption: str,
    first: str,
    rows: Sequence[Row],
    notes: Sequence[str] = (),
    marking: str = "",
    lengths: bool = False,
) -> Table:
    """Return a table with the columns: name (headed by `first`), each measure, runs that satisfy
    the cost limit, length of evaluated episodes, and where runs end.

    lengths: whether to show the length, which says nothing if all are equal.
    """
    head = [first, *(m.head for m in measures()), "within limit", "length (steps)", "ends in"]
    if lengths:
        caption += "; length: mean of the evaluated episodes"
    else:
        head.remove("length (steps)")
        rows = [replace(row, numbers=row.numbers[:-1]) for row in rows]
    return Table(caption, head, rows, notes, marking, [m.head for m in measures() if m.detail])


def mark(rows: Sequence[Row], marked: set[tuple[int, str]]) -> list[Row]:
    """Return the rows with some cells marked; marked: pairs of row index and measure name."""
    names = [*(m.name for m in measures()), "", ""]
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
    """Return the definitions of a table's numbers."""
    notes = "".join(f"{m.note}; " for m in measures() if m.note)
    if any(run.ways for group in groups for run in group.runs):
        notes += (
            '"through": as many cost steps as the shortest way through the region takes, or more, '
            '"round": fewer; '
        )
    of = [group for group in groups if group.one_length and group.runs]
    left_out = dict.fromkeys(word for g in of for word in unusual_steps(g.total_steps, g.task))
    length = f"trainings of {' or '.join(left_out)}; " if left_out else ""
    return (
        f"{length}EMCC: alpha = {_emcc(groups)}; J_R, J_C, CVaR: {_evaluated_by(groups)}; {notes}"
        f"mean {INTERVALS}; within limit: seeds whose J_C is at most the cost limit; counts of "
        "seeds [95 % Clopper-Pearson interval of the share]"
    )


def caption_in_paper(groups: Sequence[Group]) -> str:
    """Return the LaTeX caption, which defines the means and the intervals below them; empty if no
    run is complete."""
    groups = [group for group in groups if group.runs]
    if not groups:
        return ""
    seeds = {len(group.runs) for group in groups}
    limits = sorted({group.limit for group in groups if group.limit is not None})
    words = f"mean over {' to '.join(map(str, sorted({min(seeds), max(seeds)})))} "
    words += "seeds" if max(seeds) > 1 else "seed"
    few = any(1 < n < FEWEST_RUNS for n in seeds)
    enough = [group.one_place for group in groups if len(group.runs) >= FEWEST_RUNS]
    words += " [95 % t interval]" * any(enough)
    if few or not all(enough):
        kinds = [f"fewer than {FEWEST_RUNS} seeds"] * few
        kinds += ["seeds that end in different places"] * (not all(enough))
        words += f" or, of {' and of '.join(kinds)}," * any(enough) + " (lowest, highest)"
    if len(steps := {group.total_steps for group in groups}) == 1:  # otherwise names have them
        words += f"; trainings of {steps.pop():,} steps"
    words += f"; EMCC: thirds of training, α = {_emcc(groups)}; J_R, J_C: {_evaluated_by(groups)}"
    return words + f"; cost limit {' or '.join(f'{d:g}' for d in limits)}" * bool(limits)


def _emcc(groups: Sequence[Group]) -> str:
    """Return in words how EMCC is computed: alpha, ties and windows."""
    windows = {window_words(run.window, None) for group in groups for run in group.runs}
    return ", ".join(filter(None, (f"{ALPHA:g}", f"ties {TIES[0]}", *windows)))


def _evaluated_by(groups: Sequence[Group]) -> str:
    """Return in words how J_R and J_C are computed."""
    episodes = sorted({run.episodes for group in groups for run in group.runs})
    number_of = " or ".join(map(str, episodes)) or "no"
    return f"undiscounted, deterministic policy, {number_of} episodes"


def means(group: Group) -> dict[str, float | None]:
    """Return the mean of each measure; None if a run lacks it."""
    several = {m.name: group_mean(group, m.name) for m in measures()}
    return {name: mean and mean.value for name, mean in several.items()}


def within(group: Group) -> bool | None:
    """Whether all runs of a group satisfy the cost limit; None if unknown."""
    share = within_limit(group)
    return share and share.count == share.runs


def _keeps_all(group: Group, groups: Sequence[Group]) -> bool | None:
    """Whether all runs of a training satisfy the limits of all its costs; None if unknown."""
    kept = [within(other) for other in groups if other.folder == group.folder]
    known = [of_cost for of_cost in kept if of_cost is not None]
    return all(known) if known else None


def mean_row(group: Group, name: str) -> Row:
    """Return the row of a group's means with their intervals over seeds, and of its shares."""
    cells = [number(group_mean(group, m.name), m.digits) for m in measures()]
    ends = "; ".join(f"{place} {count(share)}" for place, share in places(group).items())
    name = f"{name}, mean of {len(group.runs)}"
    cells += [count(within_limit(group)), number(group_mean(group, "length"), 1)]
    return Row(name, cells, ends, kind="mean")


def printed_row(name: str, group: Group) -> Row:
    """Return the row of the published numbers for a group."""
    cells = [Number(group.printed.get(m.name), m.digits) for m in measures()]
    return Row(f"{name}, {group.publication}", [*cells, Number(None), Number(None)], kind="paper")


def _printed_within(group: Group) -> bool | None:
    """Whether the published J_C satisfies the preset's limit; None if unknown."""
    known = group.config.algorithm in ALGORITHMS
    limit = (
        getattr(preset(group.config.algorithm, group.task), "cost_limit", None) if known else None
    )
    j_c = group.printed.get("J_C")
    return None if j_c is None or limit is None else j_c <= limit


def run_rows(group: Group, prefix: str = "") -> Iterator[Row]:
    """Yield a row for each run of a group."""
    for run in group.runs:
        cells = [Number(run.measures.get(m.name), m.digits) for m in measures()]
        share = within_limit(replace(group, runs=[run]))
        cells += [Number(share and share.count, total=1), Number(run.measures.get("length"), 1)]
        yield Row(f"{prefix}{group.name}, seed {run.seed}", cells, ends_words(run))


def difference_rows(
    name: str,
    told: Mapping[str, Difference],
    columns: Sequence[Measure],
    tests: int,
    more_digits: int = 0,
    beside: Sequence[Number] = (),
) -> list[Row]:
    """Return three rows over measures: B - A, the p values, and P(B better).

    told: the differences, with p values corrected for `tests` tests; more_digits: in addition to
    those of means; beside: further cells for each row.
    """
    both = [(m, told[m.name]) for m in columns]
    gaps = [number(d.gap, m.digits + more_digits, signed=True) for m, d in both]
    return [
        Row(name, [*gaps, *beside], kind="difference"),
        Row(p_head(tests), [*(p_number(d.p) for _, d in both), *beside], kind="test"),
        Row("P(B better)", [*(number(d.better) for _, d in both), *beside], kind="test"),
    ]


def ends_words(run: RunResult) -> str:
    """Return the place where most evaluated episodes of a run end, with the share of episodes
    unless all end there, and the way to the place if known."""
    total = sum(run.ends.values())
    shares = [f"{100 * run.ends[run.end] / total:.0f} %"] if len(run.ends) > 1 else []
    ways = run.ways.get(run.end, {})
    if len(ways) == 1:
        return f"{run.end}, {next(iter(ways))}" + "".join(f" ({share})" for share in shares)
    shares += [f"{100 * episodes / total:.0f} % {way}" for way, episodes in sorted(ways.items())]
    return run.end + (f" ({', '.join(shares)})" if shares else "")


def _limited(groups: Sequence[Group]) -> list[str]:
    """Return a note on which costs the algorithms limit, if these differ."""
    names: dict[str, dict[str, None]] = {}
    for config in (group.config for group in groups):
        if words := getattr(config.hyperparameters, "limited_cost", ""):
            names.setdefault(words, {})[title(config.algorithm)] = None
    if len(names) < 2:
        return []
    kinds = "; ".join(f"the {words} of {', '.join(titles)}" for words, titles in names.items())
    return [f"The cost limit holds for {kinds}. Marks and claims compare J_C with it."]


def _few_rollouts(groups: Sequence[Group]) -> list[str]:
    """Return a note if a third has fewer than 1 / alpha rollouts, so that EMCC is one MCC."""
    thirds = [third for group in groups for run in group.runs for third in run.thirds.values()]
    fewest = min((np.unique(third.rollout).size for third in thirds if len(third)), default=0)
    if not 0 < fewest * ALPHA < 1:
        return []
    return [
        f"the smallest third of a training has {fewest} rollout{'s' * (fewest > 1)}; of fewer than "
        f"{1 / ALPHA:g} EMCC is the highest MCC."
    ]


def _records(groups: Sequence[Group]) -> list[str]:
    """Return notes on rows of record costs (`agents.lockstep.streaks`), and on groups that limit a
    CVaR of the longest streak."""
    own = [group for group in groups if group.cost not in group.config.task_costs]
    alphas = ((g, getattr(g.config.hyperparameters, "streak_alpha", 1.0)) for g in own)
    return [
        f"{cost} is 1 in a step that makes the longest streak of an episode longer: its J_C is the "
        "mean longest streak in steps; EMCC, cost rate and mean streak are measures of the plain "
        "cost, not of it."
        for cost in dict.fromkeys(group.cost for group in own)
    ] + [
        f"{group.name}: its limit holds for CVaR_{alpha:g} of the longest streak, the mean of the "
        f"worst share {alpha:g} of episodes; counts and marks compare the mean of all with it."
        for group, alpha in alphas
        if alpha < 1
    ]


def lengths_differ(groups: Iterable[Group]) -> bool:
    """Whether episodes, in training or evaluation, differ in length. An episode that ends early may
    satisfy the cost limit for that reason alone."""
    lengths: set[float] = set()
    for run in (run for group in groups for run in group.runs):
        lengths |= {*run.records.length.tolist()}
        lengths |= {*np.unique(run.evaluation.get("deterministic", {}).get("lengths", ())).tolist()}
    return len(lengths) > 1


def long_settings(groups: Iterable[Group]) -> list[str]:
    """Return notes with the values that are too long for names: see `names.setting`."""
    told = {
        (name, repr(value)): group
        for group in groups
        for name, value in changes(group.config, group.task).items()
        if setting(name, value) != f"{name} {value}"
    }
    return [f"{name} of {g.variant}: {value}." for (name, value), g in told.items()]


def unequal_lengths(groups: Sequence[Group]) -> list[str]:
    """Return a note on the shortest and longest training, if their lengths differ."""
    taken = sorted((run.total_steps, group.name) for group in groups for run in group.runs)
    if not taken or told_steps(taken[0][0], [taken[-1][0]]) == taken[0][0]:
        return []
    (least, a), (most, b) = taken[0], taken[-1]
    words = f"from {least:,} steps ({a}) to {most:,} ({b})"
    return [f"Runs are of unequal length, {words}: what differs here may be for that alone."]


def _random(groups: Sequence[Group]) -> list[str]:
    """Return notes on groups whose training had only random actions."""
    return [
        f"{group.name}: all its training's actions are random (random_steps)."
        for group in groups
        if getattr(group.config.hyperparameters, "random_steps", 0) >= group.total_steps
    ]


Candidate = tuple[Mapping[str, float | None], bool | None]
"""Measures by name, and whether they satisfy the cost limit (None: unknown)."""


def best(candidates: Mapping[Key, Candidate]) -> set[tuple[Key, str]]:
    """Return the pairs of candidate and measure to mark as best.

    For a measure of training, the best candidate has the lowest value, or the highest where that is
    better. For measures of the trained policy, whatever their values, the best candidate has the
    highest J_R of those that satisfy their limit. Values are compared as printed, so that equal
    ones are marked together; a single value is not marked. Source: caption of table
    Circle2DResults.
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
    """Return a measure's value, rounded as printed, for each candidate that has it."""
    values = {key: candidate[0].get(m.name) for key, candidate in candidates.items()}
    return {key: round(v, m.digits) for key, v in values.items() if v is not None}


def marking() -> str:
    """Return the rule of `best` in words."""
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
    """Return the measures' names in sentences, like "A, B and C"."""
    *first, last = dict.fromkeys(m.word or m.title for m in chosen)
    return f"{', '.join(first)} and {last}" if first else last


OF_POLICIES = ("cost_rate", "cvar", "p95", "maximum")
OF_POLICIES = (*OF_POLICIES, "violation_rate", "severity", "severity_of_violations")
"""Fields of `CostMeasures` that are also shown for the final policies' episodes."""
POLICIES = {"stochastic": "policy with its noise", "deterministic": "policy without noise"}
"""Final policies, in the words of the rows."""


def panel_table(groups: Sequence[Group]) -> Table:
    """Return the panel: EMCC next to the cost measures of other papers, as means over runs, with a
    row for each measure and a column for each algorithm.

    groups: of one task, at least one with a run. Each uses its own cost limit; a group without one
    uses the limit that the other groups with the same cost share, if any.
    """
    groups = [group for group in in_order(groups) if group.runs]
    usual = {a.cost: common_limit([b for b in groups if b.cost == a.cost]) for a in groups}
    limits = [usual[group.cost] if group.limit is None else group.limit for group in groups]
    # One window for all columns, since a row names it.
    moving = min(MOVING_WINDOW, *(len(run.records) for group in groups for run in group.runs))
    panels: list[list[Panel]] = [
        [
            panel(
                run.records,
                limit,
                window=run.window,
                moving_window=moving,
                total_steps=run.total_steps,
            )
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
    lines = panel_rows((limited or everyone)[0])
    for line in lines:
        values = [[line.value(run) for run in column] for column in panels]
        rows.append(row(f"training: {line.title}", values, line.digits, line.bounds))
    for policy, words in POLICIES.items():
        measured = [
            [_evaluated(run, policy, limit) for run in group.runs]
            for group, limit in zip(groups, limits, strict=True)
        ]
        for line in lines if any(map(any, measured)) else ():
            if line.field in OF_POLICIES:
                values = [[run and line.value(run) for run in column] for column in measured]
                rows.append(row(f"{words}: {line.title}", values, line.digits, line.bounds))
    head = [groups[0].task, *(group.name for group in groups), ""]  # the last is for places
    return Table(_panel_caption(groups, limits), head, rows)


def _evaluated(run: RunResult, policy: str, limit: float | None) -> CostMeasures | None:
    """Return the cost measures of a run's evaluated episodes; None if the run has none."""
    evaluated = run.evaluation.get(policy, {})
    cost, length = (np.array(evaluated.get(name, [])) for name in ("cost_returns", "lengths"))
    if not cost.size or cost.shape != length.shape:
        return None
    return cost_measures(cost, length, limit, ALPHA, MOVING_WINDOW, TIES[0])


def _panel_caption(groups: Sequence[Group], limits: Sequence[float | None]) -> str:
    named = {g.name: d for g, d in zip(groups, limits, strict=True) if d is not None}
    if len(set(named.values())) == 1:
        words = f"limit {next(iter(named.values())):g}"
    else:
        words = ", ".join(f"limit of {name} {d:g}" for name, d in named.items()) or "no limit"
    return f"Undiscounted costs of episodes, {words}; mean {INTERVALS}. Definitions: `emcc.panel`"


HEAD_OF_RECORDED = ("steps above 0", "median", "90 %", "max", "EMCC above 0")


def recorded_table(groups: Sequence[Group]) -> Table | None:
    """Return the table of numbers recorded at each step, by third of training.

    It shows the share of steps above 0, their values to three digits, and EMCC of the steps above a
    threshold: the median of all values above 0, to two digits. None if nothing is recorded. groups:
    of one task.
    """
    groups = [group for group in in_order(groups) if group.runs and group.recorded]
    rows, words = [], []
    for name, unit in groups[0].recorded.items() if groups else ():
        told = [[run.recorded(name) for run in group.runs] for group in groups]
        every = [of_run for runs in told for of_run in runs]
        above = np.concatenate([of_run.above_0() for of_run in every])
        if any(of_run.lowest < 0 for of_run in every) or not len(above):
            continue
        threshold = float(f"{np.median(above):.2g}")
        words.append(f"{name}: {threshold:g} {unit}")
        for group, runs in zip(groups, told, strict=True):
            rows += _recorded_rows(group, runs, f"{name} ({unit})", threshold)
    if not rows:
        return None
    caption = (
        f"Steps of training: median, 90 % and maximum of those above 0, of all runs; mean "
        f"{INTERVALS}; threshold: the median over all algorithms ({', '.join(words)})"
    )
    return Table(caption, [groups[0].task, *HEAD_OF_RECORDED, "EMCC above threshold", ""], rows)


def _recorded_rows(
    group: Group, runs: Sequence[Recorded], words: str, threshold: float
) -> Iterator[Row]:
    """Yield a row for each third."""
    streaks = [[run.emcc_above(limit) for run in runs] for limit in (0.0, threshold)]
    for k, part in enumerate(PARTS):
        above = np.concatenate([run.above_0(k) for run in runs])
        told = [None] * 3
        if len(above):
            told = [*np.percentile(above, (50, 90)), max(run.most[k] for run in runs)]
        shares = [float(run.counts[k].sum() / run.steps[k]) for run in runs]
        cells = [number(mean_of(shares, group.one_place, SHARE))]
        cells += [Number(value, 3) for value in told]
        cells += [
            number(mean_of([run[part] for run in of_limit], group.one_place, SHARE))
            for of_limit in streaks
        ]
        yield Row(f"{group.name}, {words}, {part:g}", cells, kind="mean")
