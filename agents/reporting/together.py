"""Figures and tables of all tasks of a report together, by the title of their section."""

from __future__ import annotations

from collections.abc import Sequence

from agents.reporting.figures import Figure
from agents.reporting.over_tasks import over_tasks
from agents.reporting.overview import intervals_figure, profiles_figure, rates_figure
from agents.reporting.separated import separated_table
from agents.reporting.table import Table
from agents.results.reading import Group

RUNS, RATES, TASKS = "Every run", "Cost rate against EMCC", "All tasks together"


def figures(groups: Sequence[Group]) -> dict[str, list[Figure]]:
    """Every run with its mean, and what EMCC shows that the cost rate does not; nothing where no
    run is complete."""
    if not any(group.runs for group in groups):
        return {}
    return {
        RUNS: [intervals_figure(groups)],
        RATES: [rates_figure(groups), profiles_figure(groups)],
    }


def tables(groups: Sequence[Group]) -> dict[str, Table]:
    """The separated pairs and the measures over all tasks, where there are enough runs."""
    found = {RATES: separated_table(groups), TASKS: over_tasks(groups)}
    return {title: table for title, table in found.items() if table is not None}
