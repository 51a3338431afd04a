"""The report of trained runs: tables, figures, and one page with all of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from agents.errors import UserError
from agents.paper import ablations
from agents.paper.claims import check_claims
from agents.paper.presets import is_circle2d
from agents.paper.settings import with_distinct_titles
from agents.reporting import claims_text, together
from agents.reporting.ablations import (
    NEAREST,
    PARTS_TITLE,
    PARTS_TOGETHER,
    TIES,
    TITLE,
    ablation_table,
    nearest_table,
    parts_over_tasks,
    parts_table,
    ties_table,
)
from agents.reporting.csv_table import numbers_csv, report_lines
from agents.reporting.figures import figures, introduction
from agents.reporting.maps import maps
from agents.reporting.page import Section, page
from agents.reporting.panel_table import panel_table, panel_title
from agents.reporting.provenance import heading, made, name_of_all, summary
from agents.reporting.replay import replay_data
from agents.reporting.scenes import Scenes
from agents.reporting.table import Block, Table, markdown, plain
from agents.reporting.tables import task_table
from agents.results.archive import archive_of
from agents.results.reading import Group, read, write_archive
from agents.training.files import write_whole


def report(*paths: Path, archive: Path | None = None, out: Path | None = None) -> list[Block]:
    """Write the report of every folder of runs at or below some folders, or in archives.

    Writes `report.md`, `report.csv` for a program, and `index.html`, which holds everything, with
    all figures. Returns the main tables and the paper's claims; `report.md` has the details
    too: EMCC with ties split, and each task's panel. Runs that are missing, damaged or
    unfinished are named below the table and left out of its means; figures that cannot be drawn are
    named too. Folders that differ in their seeds alone count as one, which is named as well.

    archive: a file to pack all that the report needs into; a report on it has the same bytes.
    A path may lead into an archive, such as `runs.zip/Circle2D-1-v0`: to the runs of that folder.
    out: folder to write to; by default that of the runs, for an archive the one beside it that has
    its name without the suffix; several paths need one. Raises UserError where no run is left, or
    an archive is damaged.
    """
    out = _output_folder(paths, out)
    if archive is not None:
        _check_archive(archive)
    notes: list[str] = []
    everything = with_distinct_titles(read(paths, notes, out.resolve().name))
    groups, ablated = ablations.split(everything)
    by_task = _by_task(groups)
    # Early, since later it would add to the memory that all else holds.
    on_circle2d = any(is_circle2d(group.config.task) and group.runs for group in groups)
    about = introduction() if on_circle2d else []
    scenes = Scenes()
    replay = replay_data(groups, scenes, notes)
    drawn = {
        task: Section(task, figures=figures(of_task), maps=maps(of_task, scenes, notes))
        for task, of_task in by_task.items()
    }
    shown, common = together.figures(groups), together.tables(groups)
    main = _tables(by_task, ablated, notes) | common
    details = _details(by_task)
    tables = main | details
    checked = check_claims(everything)
    verdicts = [claims_text.markdown(checked)] if checked else []
    if archive is not None:
        write_archive(archive, everything)
    sections = [Section(claims_text.TITLE, claims=checked)] if checked else []
    sections += [Section(name, common.get(name), of) for name, of in shown.items()]
    sections += [Section("Replay of training", replay=replay)] if replay["runs"] else []
    sections += [
        drawn.get(name, Section(name))._replace(table=of_task)
        for name, of_task in tables.items()
        if name not in shown
    ]
    if about:
        sections.append(Section("Circle2D and EMCC", figures=about))
    out.mkdir(parents=True, exist_ok=True)
    title = f"{heading(groups)} ({name_of_all(everything)})"
    html = page(title, sections, made(everything), summary(groups), scenes.all)
    write_whole(out / "index.html", html)
    ending = "Figures, heat maps and replay: index.html\n"
    titled = [block for name, of in tables.items() for block in (f"## {plain(name)}\n", of)]
    write_whole(out / "report.md", markdown([*verdicts, *titled, ending]))
    write_whole(out / "report.csv", numbers_csv(report_lines(everything)))
    return [*main.values(), *verdicts]


def _output_folder(paths: Sequence[Path], out: Path | None) -> Path:
    """The folder to write to: see `report`."""
    if not paths:
        raise UserError("give a folder of runs, or an archive")
    if out is None and len(paths) > 1:
        raise UserError("a report on several folders or archives needs out, a folder to write to")
    archive = archive_of(paths[0])
    chosen = out or paths[0]
    if out is None and archive is not None:
        chosen = archive.with_suffix("") / paths[0].relative_to(archive)
    if chosen.is_file():
        raise UserError(f"{chosen} is a file; the report needs a folder: give another for out")
    return chosen


def _check_archive(path: Path) -> None:
    """Make the folder of a file to be written. Raises UserError where there can be none."""
    if path.is_dir():
        raise UserError(f"archive must be a file, but {str(path)!r} is a folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"archive cannot be written: {error}") from None


def table(folder: Path) -> list[Table]:
    """Write the tables of every folder of runs at or below a folder, without figures.

    Writes `report.md` and `report.csv`. Otherwise as `report`.
    """
    notes: list[str] = []
    everything = with_distinct_titles(read([folder], notes))
    groups, ablated = ablations.split(everything)
    found = list(_tables(_by_task(groups), ablated, notes).values())
    write_whole(folder / "report.md", markdown(found))
    write_whole(folder / "report.csv", numbers_csv(report_lines(everything)))
    return found


def _by_task(groups: Sequence[Group]) -> dict[str, list[Group]]:
    tasks = dict.fromkeys(group.config.task for group in groups)
    return {task: [g for g in groups if g.config.task == task] for task in tasks}


def _details(by_task: dict[str, list[Group]]) -> dict[str, Table]:
    """EMCC with ties split, and the panel of each task, by title."""
    everyone = [group for groups in by_task.values() for group in groups]
    return {TIES: ties_table(everyone)} | {
        panel_title(task): panel_table(groups)
        for task, groups in by_task.items()
        if any(group.runs for group in groups)
    }


def _tables(
    by_task: dict[str, list[Group]],
    ablated: Sequence[tuple[Group, Group]],
    notes: Sequence[str],
) -> dict[str, Table]:
    """The tables of the tasks and the ablations, by title; the notes below the last task's."""
    tables = {task: task_table(of_task) for task, of_task in by_task.items()}
    *_, last = by_task
    tables[last] = dataclasses.replace(tables[last], notes=[*tables[last].notes, *notes])
    of_ablations = {
        TITLE: ablation_table(ablated),
        NEAREST: nearest_table(ablated),
        PARTS_TITLE: parts_table(ablated),
        PARTS_TOGETHER: parts_over_tasks(ablated),
    }
    return tables | {name: table for name, table in of_ablations.items() if table is not None}
