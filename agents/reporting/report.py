"""The report of trained runs: tables, figures, and one page with everything."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from agents.errors import UserError
from agents.reporting.figures import (
    Figure,
    intervals_figure,
    profiles_figure,
    rates_figure,
    task_figures,
)
from agents.reporting.maps import Scene, Scenes, maps, replay_data
from agents.reporting.numbers import measures_csv, numbers_csv, report_lines
from agents.reporting.overall import RATES, tables_over_tasks
from agents.reporting.page import Section, page
from agents.reporting.provenance import heading, made, summary
from agents.reporting.study import Study, ask
from agents.reporting.table import LATEX_COLUMNS, Block, Table, latex, markdown, plain
from agents.reporting.tables import panel_table, recorded_table, task_table
from agents.results.archive import write_archive
from agents.results.groups import Group, name_of_all
from agents.results.names import with_names
from agents.results.reading import LeftOut, left_out, read_groups
from agents.results.statistics import alike
from agents.training.files import archive_of, check_file, check_folder, write_whole

RUNS = "Every run"
ENDING = "Figures, heat maps and replay: index.html\n"


class Report(NamedTuple):
    """A report that was written."""

    blocks: list[Block]
    """The main tables, and the statements of the study's sections."""
    left_out: list[LeftOut]
    """Folders, runs and pictures that were left out, and why."""
    page: Path
    """Path of `index.html`."""


def report(
    *paths: Path,
    study: Study | None = None,
    archive: Path | None = None,
    out: Path | None = None,
    columns: Sequence[str] = LATEX_COLUMNS,
    window: int | None = None,
) -> Report:
    """Write the report of all run folders at or below the given folders: see `agents.report`.

    `report.tex` has the means of the main tables; `report.md` and `index.html` also have details:
    the study's, numbers recorded at each step, and each task's panel. Notes below the last task's
    table name runs left out, figures that cannot be drawn, and folders that count as one.
    """
    out = _output_folder(paths, out)
    if archive is not None:
        _check_archive(archive)
    notes: list[str] = []
    name = out.resolve().name if len(paths) > 1 else None
    study = study or Study()
    read = with_names(read_groups(paths, notes, name, window))
    groups = [ask(study.printed, group) for group in read]
    usual, apart = ask(study.set_apart, groups)
    own = ask(study.sections, groups)
    pictures = _pictures(usual, notes)
    details = ask(study.details, usual) | _details(usual, notes)
    over_tasks = tables_over_tasks(usual)
    main = _task_tables(usual, study, notes) | apart | over_tasks  # with all notes: the last
    tables = main | details
    together = [
        Section(name, over_tasks.get(name), figures)
        for name, figures in _figures_together(usual).items()
    ]
    others = [
        pictures.by_task.get(name, Section(name))._replace(table=table)
        for name, table in tables.items()
        if name not in [section.title for section in together]
    ]
    if archive is not None:
        write_archive(archive, groups)
    out.mkdir(parents=True, exist_ok=True)
    title = f"{heading(usual)} ({name_of_all(groups)})"
    shown = [*own, *together, *pictures.replay, *others]
    html = page(title, shown, made(groups), summary(usual), pictures.scenes)
    write_whole(out / "index.html", html)
    verdicts = [section.statements_markdown() for section in own if section.statements]
    titled = [block for name, table in tables.items() for block in (f"## {plain(name)}\n", table)]
    _write_tables(out, [*verdicts, *titled, ENDING], groups)
    write_whole(out / "report.tex", latex(main, columns))
    missing = [note for note in notes if isinstance(note, LeftOut)]
    return Report([*main.values(), *verdicts], missing, out / "index.html")


def table(folder: Path, study: Study | None = None) -> list[Table]:
    """Write the tables of all run folders at or below a folder, without figures.

    Writes `report.md`, `measures.csv` and `report.csv` without the study's sections; for an archive
    it writes nothing. Otherwise as `report`.
    """
    notes: list[str] = []
    study = study or Study()
    groups = [ask(study.printed, group) for group in with_names(read_groups([folder], notes))]
    usual, apart = ask(study.set_apart, groups)
    tables = [*_task_tables(usual, study, notes).values(), *apart.values()]
    if not archive_of(folder):
        _write_tables(folder, tables, groups)
    return tables


def _write_tables(folder: Path, blocks: Sequence[Block], groups: Sequence[Group]) -> None:
    """Write `report.md` from the blocks, and `measures.csv` and `report.csv` from the groups."""
    write_whole(folder / "report.md", markdown(blocks))
    write_whole(folder / "measures.csv", measures_csv(groups))
    write_whole(folder / "report.csv", numbers_csv(report_lines(groups)))


def _output_folder(paths: Sequence[Path], out: Path | None) -> Path:
    """Return the folder to write to: `out`, the only folder, or one named after the archive."""
    if not paths:
        raise UserError("give a folder of runs, or an archive")
    if out is None and len(paths) > 1:
        raise UserError("a report on several folders or archives needs out, a folder to write to")
    archive = archive_of(paths[0])
    chosen = out or paths[0]
    if out is None and archive is not None:
        chosen = archive.with_suffix("") / paths[0].relative_to(archive)
    check_folder(chosen)
    return chosen


def _check_archive(path: Path) -> None:
    """Create the folder of a file to be written. Raises UserError if that is impossible."""
    check_file(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"archive cannot be written: {error}") from None


def _by_task(groups: Sequence[Group]) -> dict[str, list[Group]]:
    tasks = dict.fromkeys(group.task for group in groups)
    return {task: [group for group in groups if group.task == task] for task in tasks}


class Pictures(NamedTuple):
    """Figures and maps of the runs."""

    by_task: dict[str, Section]
    replay: list[Section]
    """One section, or none if no run can be replayed."""
    scenes: list[Scene]


def _pictures(groups: Sequence[Group], notes: list[str]) -> Pictures:
    """Make learning curves, maps and replay; add notes on what cannot be drawn."""
    scenes = Scenes()
    located = [group for group in groups if group.is_of_first_cost]
    if len(located) < len(groups):
        notes.append("visited states, trained policies and replay are of the first cost alone")
    replay = replay_data(located, scenes, notes)
    seen = _by_task(located)
    sections = {
        task: Section(task, figures=task_figures(own), maps=maps(seen[task], scenes, notes))
        for task, own in _by_task(groups).items()
    }
    replayed = [Section("Replay of training", replay=replay)] if replay["runs"] else []
    return Pictures(sections, replayed, scenes.all)


def _figures_together(groups: Sequence[Group]) -> dict[str, list[Figure]]:
    """Return the figures over all tasks by the title of their section: every run with its mean, and
    EMCC against the cost rate. Empty if no run is complete."""
    if not any(group.runs for group in groups):
        return {}
    return {
        RUNS: [intervals_figure(groups)],
        RATES: [rates_figure(alike(groups)), profiles_figure(alike(groups))],
    }


def _task_tables(groups: Sequence[Group], study: Study, notes: Sequence[str]) -> dict[str, Table]:
    """Return the table of each task, with `notes` below the last one."""
    by_task = _by_task(groups)
    *_, last = by_task
    return {
        task: task_table(own, [*ask(study.notes, own), *(notes if task == last else [])])
        for task, own in by_task.items()
    }


def _details(groups: Sequence[Group], notes: list[str]) -> dict[str, Table]:
    """Return each task's tables of numbers recorded at each step and of cost measures, by title;
    add notes on damaged numbers."""
    recorded, panels = {}, {}
    for task, own in _by_task(groups).items():
        try:
            recorded[f"{task}: recorded at each step"] = recorded_table(own)
        except UserError as error:
            notes.append(left_out(f"numbers recorded on {task}", own, error))
        if any(group.runs for group in own):
            panels[f"{task}: panel of cost measures"] = panel_table(own)
    return {name: table for name, table in recorded.items() if table is not None} | panels
