"""The panel of a task: EMCC beside the measures of cost that other papers report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from agents.paper.settings import cost_limit, in_order, name_of
from agents.reporting.table import Row, Table, number_of
from agents.results.reading import Group, Run
from agents.results.statistics import INTERVALS, Values, mean_of
from emcc import panel
from emcc.panels import SEVERITY, WINDOW, CostMeasures, Panel, cost_measures
from emcc.panels import rows as panel_rows
from emcc.parts import ALPHA
from emcc.statistics import COST, SHARE, Bounds

OF_POLICIES = (
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
"""Final policies in `evaluation.json`, in the words of the rows."""


def panel_title(task: str) -> str:
    """The title of a task's panel."""
    return f"{task}: panel of cost measures"


def panel_table(groups: Sequence[Group]) -> Table:
    """A row for each measure, a column for each algorithm: means over its runs.

    groups: of one task, at least one with a run. Each is measured by its own cost limit; one of an
    unconstrained algorithm by that of the others, where they have one.
    """
    groups = [group for group in in_order(groups) if group.runs]
    own = [cost_limit(group.config) for group in groups]
    shared = {limit for limit in own if limit is not None}
    usual = shared.pop() if len(shared) == 1 else None
    limits = [usual if limit is None else limit for limit in own]
    # One window for all columns, since a row names it.
    window = min(WINDOW, *(len(run.records) for group in groups for run in group.runs))
    panels = [
        [
            panel(run.records, limit, window=window, total_steps=group.config.steps)
            for run in group.runs
        ]
        for group, limit in zip(groups, limits, strict=True)
    ]
    listed = list(_training_rows(groups, panels))
    for policy, words in POLICIES.items():
        listed += _policy_rows(policy, words, groups, limits)
    head = [groups[0].config.task, *(name_of(group) for group in groups)]
    return Table(_caption(groups, limits), [*head, ""], listed)  # the last is for places


def _caption(groups: Sequence[Group], limits: Sequence[float | None]) -> str:
    """The limits, and how cells are to be read."""
    known = {name_of(g): d for g, d in zip(groups, limits, strict=True) if d is not None}
    if len(set(known.values())) == 1:
        words = f"limit {next(iter(known.values())):g}"
    else:
        words = ", ".join(f"limit of {name} {d:g}" for name, d in known.items()) or "no limit"
    return (
        f"Undiscounted costs of episodes, {words}; mean {INTERVALS}. "
        "Definitions and sources: `emcc.panel`; thirds of training: `python -m emcc --limit`"
    )


def _training_rows(groups: Sequence[Group], panels: Sequence[Sequence[Panel]]) -> Iterator[Row]:
    """Rows of the costs during training. panels: of each run of each group."""
    all_panels = [of_run for of_group in panels for of_run in of_group]
    limited = [of_run for of_run in all_panels if of_run.limit is not None]
    for row in panel_rows((limited or all_panels)[0]):
        values = [[row.value(of_run) for of_run in of_group] for of_group in panels]
        yield _mean_row(f"training: {row.title}", groups, values, row.digits, row.bounds)


def _policy_rows(
    policy: str, words: str, groups: Sequence[Group], limits: Sequence[float | None]
) -> Iterator[Row]:
    """Rows of the costs of a final policy; none where no run has its episodes."""
    measured = [
        [_of_policy(run, policy, limit) for run in group.runs]
        for group, limit in zip(groups, limits, strict=True)
    ]
    if not any(of_run for of_group in measured for of_run in of_group):
        return
    for title, name, digits, bounds in OF_POLICIES:
        values = [[of_run and getattr(of_run, name) for of_run in runs] for runs in measured]
        yield _mean_row(f"{words}: {title}", groups, values, digits, bounds)


def _mean_row(
    name: str, groups: Sequence[Group], values: Sequence[Values], digits: int, bounds: Bounds
) -> Row:
    """The row of the means over each group's runs, with their intervals."""
    means = [mean_of(v, of.one_place, bounds) for of, v in zip(groups, values, strict=True)]
    return Row(name, [number_of(mean, digits) for mean in means], kind="mean")


def _of_policy(run: Run, policy: str, limit: float | None) -> CostMeasures | None:
    """Measures of the evaluated episodes of a run; None where the run lacks them."""
    evaluated = run.evaluation.get(policy, {})
    cost, length = (np.array(evaluated.get(name, [])) for name in ("cost_returns", "lengths"))
    if not cost.size or cost.shape != length.shape:
        return None
    return cost_measures(cost, length, limit, ALPHA, WINDOW, "all")
