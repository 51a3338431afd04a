"""The report of trained runs: tables, figures, and one page with all of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from agents.bench import ablations
from agents.bench.claims import check_claims
from agents.bench.claims_text import claims_html, claims_markdown
from agents.bench.curves import curves_svg
from agents.bench.page import Section, page
from agents.bench.pictures import ALPHA, draw_heatmaps
from agents.bench.provenance import made
from agents.bench.results import Group, read_groups
from agents.bench.tables import task_table, title_of
from agents.runs.files import write_whole


def report(folder: Path, with_figures: bool = False) -> str:
    """The table of every folder of runs at or below `folder`, as Markdown.

    Writes `report.md` and `report.csv` there; with_figures also the paper's claims, training curves
    and heat maps into `pictures`, and `index.html`, which holds everything. Runs that are missing,
    damaged or unfinished are named below the table and left out of its means; pictures that cannot
    be drawn are named too. Raises UserError where no run is left.
    """
    notes: list[str] = []
    everything = read_groups(folder, notes)
    groups, ablated = ablations.split(everything)
    tasks = list(dict.fromkeys(group.config.task for group in groups))
    by_task = {task: [g for g in groups if g.config.task == task] for task in tasks}
    complete = {g.folder: tuple(run.seed for run in g.runs) for g in groups if g.runs}
    heatmaps = draw_heatmaps(folder, complete, notes) if with_figures else {}
    tables = {task: task_table(of_task) for task, of_task in by_task.items()}
    last = tables[tasks[-1]]
    tables[tasks[-1]] = dataclasses.replace(last, notes=[*last.notes, *notes])
    if ablated:
        tables[ablations.TITLE] = ablations.ablation_table(ablated)
    markdown = "\n".join(table.render("md") for table in tables.values())
    images = []
    if with_figures:
        checked = check_claims(groups)
        markdown += "\n" + claims_markdown(checked) if checked else ""
        sections = []
        for task, of_task in by_task.items():
            curves = _curves(task, of_task)
            if curves:
                path = Path("pictures") / f"curves-{task.replace('/', '-')}.svg"
                (folder / "pictures").mkdir(exist_ok=True)
                write_whole(folder / path, curves)
                images.append(f"![Training curves on {task}](<{path}>)")
            drawn = {g.folder: heatmaps[g.folder] for g in of_task if g.folder in heatmaps}
            images += [f"![Visited states: {path.stem}](<{path}>)" for path in drawn.values()]
            shown = {str(runs): folder / path for runs, path in drawn.items()}
            sections.append(Section(task, tables[task], curves, shown))
        if ablated:
            sections.append(Section(ablations.TITLE, tables[ablations.TITLE], "", {}))
        title, how = folder.resolve().name, made(folder, everything)
        write_whole(folder / "index.html", page(title, sections, how, claims_html(checked)))
    write_whole(folder / "report.md", "\n".join([markdown, *images]))
    write_whole(folder / "report.csv", "\n".join(t.render("csv") for t in tables.values()))
    return markdown


def _curves(task: str, groups: list[Group]) -> str:
    """Training curves of the complete runs as SVG; nothing where there are none."""
    groups = [group for group in groups if group.runs]
    if not groups:
        return ""
    names = {title_of(group.config): group for group in groups}
    limits = {group.config.hyperparameters.cost_limit for group in groups}
    return curves_svg(
        task,
        {name: [run.records for run in group.runs] for name, group in names.items()},
        {name: group.config.steps for name, group in names.items()},
        limits.pop() if len(limits) == 1 else None,
        ALPHA,
    )
