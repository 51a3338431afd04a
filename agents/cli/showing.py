"""`circle2d report`, `plot`, `zoo`, `compare`, `heatmap` and `scene`: commands that show results
and tasks."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents.checks import In, Settings
from agents.cli.options import (
    Folder,
    Folders,
    Imports,
    Size,
    Task,
    Width,
    check_suffix,
    literals,
    one_for_each,
    parse,
)
from agents.errors import UserError
from agents.reporting.table import LATEX_COLUMNS, Number, Row, Table, show, working
from agents.training.environments import task_id, unscaled
from circle2d_mj.registration import PHYSICS
from emcc.parts import ALPHA, PARTS


@dataclass(frozen=True)
class ReportOptions(Settings):
    """Print the table of trained runs with the paper's numbers, or those of the study that a module
    of --import chooses (agents.use_study); write report.md, report.tex, report.csv, measures.csv,
    and index.html, which also has training curves and heat maps."""

    folders: Folders
    """Folders of runs, folders above such folders, archives, or folders in archives. All go into
    one report, for example your runs and results/circle2d/runs.zip/Circle2D-1-v0. If each is a
    single training, tables keep the given order."""
    archive: Path | None = None
    """Archive to write, with everything that the report needs; `circle2d report FILE` makes the
    report from the archive."""
    out: Path | None = None
    """Folder for the report; by default the folder of the runs, or a folder beside the archive with
    its name. Required with several FOLDERs."""
    columns: tuple[str, ...] = LATEX_COLUMNS
    """Columns of report.tex, named as in report.md."""
    window: Annotated[int, In(1)] | None = None
    """Compute EMCC over windows of this many consecutive episodes instead of rollouts, which are
    ten episodes for on-policy algorithms and one for off-policy ones. Default: rollouts, as in the
    paper; tables that compare both families always use windows of 10."""
    width: Width = None
    imports: Imports = ()


def report(args: Sequence[str]) -> int:
    """Run `circle2d report`; return the exit status: 1 if runs had to be left out."""
    from agents.reporting.report import report as write_report
    from agents.studies import used_study

    options = parse(ReportOptions, "report", args)
    with working("reading runs and drawing figures"):
        written = write_report(
            *options.folders,
            study=used_study(),
            archive=options.archive,
            out=options.out,
            columns=options.columns,
            window=options.window,
        )
    show(written.blocks, options.width, str(written.page))
    return int(bool(written.left_out))


@dataclass(frozen=True)
class PlotOptions(Settings):
    """Draw learning curves of trained runs for a paper, with intervals over seeds: one file with a
    row of panels for each task and a column for each measure. Prints a caption."""

    folders: Folders
    """Folders of runs, folders above such folders, archives, or folders in archives."""
    measure: tuple[str, ...] = ("return", "cost", "emcc")
    """Measures of training's episodes to draw: return, cost, emcc, length."""
    out: Path = Path("figure.pdf")
    """File to write; its suffix decides the format: .pdf, .svg, .png, or .pgf for LaTeX."""
    names: dict[str, str] = field(default_factory=dict)
    """Other names for the legend, as CURVE NAME ..., such as TRPO-Lag "the baseline"."""
    colours: dict[str, str] = field(default_factory=dict)
    """Colours, as CURVE COLOUR ..., such as TRPO-Lag black CPO #0072B2."""
    width: Annotated[float, In(1, 20)] = 5.5
    """Width of the figure in inches; text is 8 points high at any width."""
    imports: Imports = ()


def plot(args: Sequence[str]) -> int:
    """Run `circle2d plot`; return the exit status: 1 if runs had to be left out."""
    from agents.reporting.plot import plot as draw

    options = parse(PlotOptions, "plot", args)
    with working("reading runs"):
        drawn = draw(
            options.folders,
            options.out,
            measures=options.measure,
            names=options.names,
            colours=options.colours,
            width=options.width,
        )
    print(f"{options.out}\nCaption: {drawn.words}")
    return int(bool(drawn.left_out))


@dataclass(frozen=True)
class ZooOptions(Settings):
    """List the trained agents that come with the package: their results on each task, with the best
    published ones. 'circle2d train zoo --task TASK' trains them again; other commands take such a
    policy as pretrained:zoo/TASK."""

    task: Task = None
    width: Width = None


def zoo(args: Sequence[str]) -> int:
    """Run `circle2d zoo`; return the exit status."""
    from agents.presets import recipe, registered_id
    from agents.zoo import zoo as rows_of

    options = parse(ZooOptions, "zoo", args)
    rows = rows_of()
    if options.task is not None:
        task = registered_id(task_id(options.task)).rpartition("/")[2]
        recipe(task)  # raises UserError if there is none
        rows = rows.query("task == @task")
    numbers = {"J_R": 2, "J_C": 2, "EMCC_0.33": 2, "EMCC_0.99": 2}
    numbers |= {"published_J_R": 2, "published_J_C": 2}
    shown = [
        Row(
            f"{row['task']}, {row['algorithm']}, {row['steps']:,} steps, mean of {row['seeds']}",
            [Number(row[name], digits) for name, digits in numbers.items()],
        )
        for row in rows.astype(object).where(rows.notna(), None).to_dict("records")
    ]
    words = (
        "J_R, J_C: undiscounted, deterministic policy, 100 episodes per seed; limit of J_C: 25, "
        "5 on Circle2D; published: the highest return within the limit in OmniSafe's benchmarks "
        "(on-policy 10 000 000 steps, off-policy up to 3 000 000), without algorithms that end an "
        "episode at the limit"
    )
    show([Table(words, ["agent", *(n.replace("_J", " J") for n in numbers)], shown)], options.width)
    return 0


@dataclass(frozen=True)
class CompareOptions(Settings):
    """Print the tables of two sets of runs, such as your algorithm's and a baseline's, with the
    differences B - A, their 95 % intervals over seeds, and permutation tests, on each task and over
    all tasks together."""

    a: Folder
    """The first set of runs: a folder of runs, a folder above such folders, an archive, or a folder
    in an archive, such as results/circle2d/runs.zip/Circle2D-1-v0/sac-lb."""
    b: Folder
    """The second set of runs, in the same form."""
    out: Path | None = None
    """Folder for compare.md, compare.tex, compare.csv, and compare.html with the training curves of
    both; by default nothing is written."""
    measure: tuple[str, ...] | None = None
    """Measures to test, such as J_R: the p values are corrected for the number of tests. By default
    all."""
    width: Width = None
    imports: Imports = ()


def compare(args: Sequence[str]) -> int:
    """Run `circle2d compare`; return the exit status: 1 if runs had to be left out."""
    from agents.reporting.compare import compare as compare_runs
    from agents.results.reading import LeftOut

    options = parse(CompareOptions, "compare", args)
    with working("reading runs and drawing figures"):
        tables = compare_runs(options.a, options.b, options.out, options.measure)
    show(tables, options.width)
    return int(any(isinstance(note, LeftOut) for table in tables for note in table.notes))


@dataclass(frozen=True)
class HeatmapOptions(Settings):
    """Draw, as a PNG, the states that agents visited in training in the rollouts that dominate
    EMCC, all runs of a folder together. Several folders are drawn side by side."""

    folders: Folders
    """Folders of runs on tasks that offer positions."""
    part: tuple[float, ...] = tuple(PARTS)
    """Parts of training, named as in EMCC: 0.33, 0.66, 0.99."""
    alpha: Annotated[float, In(above=0, high=1)] = ALPHA
    """Share of a part's rollouts to draw, those with the highest MCC; 1 draws all."""
    task: Task = None
    seeds: tuple[int, ...] | None = None
    """Seeds of the runs; by default all but those that failed."""
    names: tuple[str, ...] = ()
    """Titles, one for each folder; by default the algorithm with its settings, and the task."""
    out: Path | None = None
    """File to write; by default heatmap.png in the first folder."""
    size: Size = 640
    imports: Imports = ()


def heatmap(args: Sequence[str]) -> int:
    """Run `circle2d heatmap`; return the exit status."""
    from agents.reporting import pictures

    options = parse(HeatmapOptions, "heatmap", args)
    if not options.folders:
        raise UserError("heatmap needs a folder of runs")
    if not options.part or not set(options.part) <= set(PARTS):
        raise UserError(f"part must be among {list(PARTS)}, got {list(options.part)}")
    out = options.out or options.folders[0] / "heatmap.png"
    check_suffix(out, ".png")
    names = one_for_each("names", options.names, options.folders)
    drawn = pictures.heatmap(
        options.folders,
        options.part,
        options.alpha,
        options.size,
        seeds=options.seeds,
        names=names,
        task=options.task,
    )
    pictures.write_picture(out, drawn)
    print(out)
    return 0


@dataclass(frozen=True)
class SceneOptions:
    """Print the MuJoCo scene of a task as MJCF, for `python -m mujoco.viewer --mjcf=FILE`."""

    task: tyro.conf.Positional[str] = "Circle2DMuJoCo-1-v0"
    """Id of a Circle2DMuJoCo task."""
    task_parameters: dict[str, str] = field(default_factory=dict)
    """Parameters of the task, as NAME VALUE ..., e.g. contact soft stiffness 200."""


def scene(args: Sequence[str]) -> int:
    """Run `circle2d scene`; return the exit status."""
    from circle2d_mj.circle2d.scene import scene as build

    options = parse(SceneOptions, "scene", args)
    task = task_id(options.task)
    with contextlib.closing(unscaled(task, 1, literals(options.task_parameters))) as envs:
        env: Any = envs.unwrapped
        if task.rpartition(":")[2] not in PHYSICS.values():
            raise UserError(f"task must be one of {', '.join(PHYSICS.values())}, got {task!r}")
        spec = build(env.config, env.simulation.dynamics.physics)
    spec.compile()
    print(spec.to_xml(), end="")
    return 0
