"""The report of trained runs: tables, figures, and one page with all of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from agents.errors import UserError
from agents.paper import ablations
from agents.paper.claims import check_claims
from agents.paper.presets import is_circle2d
from agents.reporting import claims_text
from agents.reporting.ablations import TITLE, ablation_table
from agents.reporting.csv_table import numbers_csv, report_lines
from agents.reporting.figures import Figure, figures, introduction
from agents.reporting.page import Section, page
from agents.reporting.panel_table import panel_table, panel_title
from agents.reporting.provenance import made
from agents.reporting.table import Table
from agents.reporting.tables import task_table
from agents.results.archive import open_source, write_archive
from agents.results.reading import Group, read_groups
from agents.results.source import Source
from agents.training.files import write_whole


def report(path: Path, archive: Path | None = None, out: Path | None = None) -> str:
    """Write the report of every folder of runs at or below a folder, or in an archive.

    Writes `report.md`, `report.csv` for a program, figures into `pictures`, and `index.html`, which
    holds everything, and returns the tables and the paper's claims as Markdown. Runs that are
    missing, damaged or unfinished are named below the table and left out of its means; figures
    that cannot be drawn are named too.

    archive: a file to pack all that the report needs into; a report from it has the same bytes.
    out: folder to write to; by default the runs' own, for an archive the one beside it that has its
    name without the suffix. Raises UserError where no run is left, or the archive is damaged.
    """
    source = open_source(path)
    if out is None:
        out = path.with_suffix("") if path.is_file() else path
    if out.is_file():
        raise UserError(f"{out} is a file; the report needs a folder: give another for out")
    notes: list[str] = []
    everything = read_groups(source, notes)
    groups, ablated = ablations.split(everything)
    by_task = _by_task(groups)
    shown = {task: figures(source, of_task, notes) for task, of_task in by_task.items()}
    tables = _tables(by_task, ablated, notes)
    tables |= {
        panel_title(task): panel_table(of)
        for task, of in by_task.items()
        if any(group.runs for group in of)
    }
    checked = check_claims(groups)
    markdown = "\n".join(table.markdown() for table in tables.values())
    markdown += "\n" + claims_text.markdown(checked) if checked else ""
    if archive is not None:
        write_archive(archive, source, everything)
    if any(is_circle2d(group.config.task) and group.runs for group in groups):
        shown = {"Circle2D and EMCC": introduction()} | shown
    sections = [
        Section(name, tables.get(name), shown.get(name, [])) for name in {**shown, **tables}
    ]
    if checked:
        sections.append(Section(claims_text.TITLE, claims=checked))
    out.mkdir(parents=True, exist_ok=True)
    images = _write(out / "pictures", [f for of_task in shown.values() for f in of_task])
    html = page(source.name, sections, made(source, everything))
    write_whole(out / "index.html", html)
    write_whole(out / "report.md", "\n".join([markdown, *images]))
    write_whole(out / "report.csv", numbers_csv(report_lines(everything)))
    return markdown


def table(folder: Path) -> str:
    """Write the tables of every folder of runs at or below a folder, without figures.

    Writes `report.md` and `report.csv`, and returns the tables as Markdown. Otherwise as `report`.
    """
    source: Source = open_source(folder)
    notes: list[str] = []
    everything = read_groups(source, notes)
    groups, ablated = ablations.split(everything)
    found = _tables(_by_task(groups), ablated, notes)
    markdown = "\n".join(of_task.markdown() for of_task in found.values())
    write_whole(folder / "report.md", markdown)
    write_whole(folder / "report.csv", numbers_csv(report_lines(everything)))
    return markdown


def _by_task(groups: Sequence[Group]) -> dict[str, list[Group]]:
    tasks = dict.fromkeys(group.config.task for group in groups)
    return {task: [g for g in groups if g.config.task == task] for task in tasks}


def _tables(
    by_task: dict[str, list[Group]],
    ablated: Sequence[tuple[Group, Group]],
    notes: Sequence[str],
) -> dict[str, Table]:
    """The tables of the tasks and the ablations, by title; the notes below the last task's."""
    tables = {task: task_table(of_task) for task, of_task in by_task.items()}
    *_, last = by_task
    tables[last] = dataclasses.replace(tables[last], notes=[*tables[last].notes, *notes])
    return tables | ({TITLE: ablation_table(ablated)} if ablated else {})


def _write(folder: Path, shown: Sequence[Figure]) -> list[str]:
    """Write the figures into a folder; returns the lines of Markdown that show them."""
    folder.mkdir(exist_ok=True)
    for figure in shown:
        write_whole(folder / figure.file, figure.content)
    return [
        f"![{figure.title}](<{folder.name}/{figure.file}>)\n\n{figure.caption}\n"
        for figure in shown
    ]
