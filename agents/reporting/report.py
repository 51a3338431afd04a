"""The report of trained runs: tables, figures, and one page with all of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from agents.paper import ablations
from agents.paper.claims import check_claims
from agents.reporting import claims_text
from agents.reporting.csv_table import numbers_csv, report_lines
from agents.reporting.figures import Figure, figures, introduction
from agents.reporting.page import Section, page
from agents.reporting.provenance import made
from agents.reporting.tables import task_table
from agents.results.reading import Group, read_groups
from agents.training.environments import circle2d_config
from agents.training.files import write_whole


def report(folder: Path, with_figures: bool = False) -> str:
    """The table of every folder of runs at or below `folder`, as Markdown.

    Writes `report.md` there and, for a program, `report.csv`; with_figures also the paper's claims,
    figures into `pictures`, and `index.html`, which holds everything. Runs that are missing,
    damaged or unfinished are named below the table and left out of its means; figures that cannot
    be drawn are named too. Raises UserError where no run is left.
    """
    notes: list[str] = []
    everything = read_groups(folder, notes)
    groups, ablated = ablations.split(everything)
    tasks = list(dict.fromkeys(group.config.task for group in groups))
    by_task = {task: [g for g in groups if g.config.task == task] for task in tasks}
    tables = {task: task_table(of_task) for task, of_task in by_task.items()}
    shown = _figures(by_task, notes) if with_figures else {}
    last = tables[tasks[-1]]
    tables[tasks[-1]] = dataclasses.replace(last, notes=[*last.notes, *notes])
    if ablated:
        tables[ablations.TITLE] = ablations.ablation_table(ablated)
    markdown = "\n".join(table.render("md") for table in tables.values())
    images = []
    if with_figures:
        checked = check_claims(groups)
        markdown += "\n" + claims_text.markdown(checked) if checked else ""
        images = _write(folder / "pictures", [f for of_task in shown.values() for f in of_task])
        sections = [
            Section(title, [tables[title]] if title in tables else [], of_title)
            for title, of_title in shown.items()
        ]
        if ablated:
            sections.append(Section(ablations.TITLE, [tables[ablations.TITLE]], []))
        if checked:
            sections.append(Section(claims_text.TITLE, [], [], claims_text.html(checked)))
        how = made(folder, everything)
        write_whole(folder / "index.html", page(folder.resolve().name, sections, how))
    write_whole(folder / "report.md", "\n".join([markdown, *images]))
    write_whole(folder / "report.csv", numbers_csv(report_lines(folder, everything)))
    return markdown


def _figures(by_task: dict[str, list[Group]], notes: list[str]) -> dict[str, list[Figure]]:
    """The figures of every section of the page, by its title."""
    configs = [group.config for of_task in by_task.values() for group in of_task if group.runs]
    is_circle2d = any(circle2d_config(c.task, c.task_parameters) for c in configs)
    first = {"Circle2D and EMCC": introduction()} if is_circle2d else {}
    return first | {task: figures(of_task, notes) for task, of_task in by_task.items()}


def _write(folder: Path, shown: Sequence[Figure]) -> list[str]:
    """Write the figures into a folder; returns the lines of Markdown that show them."""
    folder.mkdir(exist_ok=True)
    for figure in shown:
        write_whole(folder / figure.name, figure.content)
    return [
        f"![{figure.title}](<{folder.name}/{figure.name}>)\n\n{figure.caption}\n"
        for figure in shown
    ]
