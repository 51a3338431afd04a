"""The table of a task: our runs beside the paper's numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from agents.algorithms import title
from agents.paper.presets import PAPER_SEEDS, is_circle2d, preset, unprinted
from agents.paper.printed import paper_results
from agents.paper.settings import cost_limit, hyperparameter_changes, in_order, name_of
from agents.reporting.marks import best, marking
from agents.reporting.table import Number, Row, Table, count_of, number_of
from agents.results.measures import measures
from agents.results.reading import Group, Run
from agents.results.statistics import INTERVALS, group_mean, places, within_limit
from emcc.parts import ALPHA


def task_table(groups: Sequence[Group]) -> Table:
    """One task: for each algorithm the means above the paper's numbers, then every run.

    What is best among the means, and among the paper's numbers, is marked: see `marks.best`.
    """
    task, notes = groups[0].config.task, _paper_notes(groups)
    groups = in_order(groups)
    rows: list[Row] = []
    ours, papers = {}, {}
    for name in dict.fromkeys(group.config.algorithm for group in groups):
        for group in groups:
            if group.config.algorithm == name and group.runs:
                ours[len(rows)] = means(group), within(group)
                rows.append(mean_row(group))
        if paper := paper_results(task, title(name)):
            papers[len(rows)] = paper, paper["J_C"] <= preset(name, task).cost_limit
            rows.append(paper_row(title(name), paper))
    rows = mark(rows, best(ours) | best(papers))
    rows += [row for group in groups for row in run_rows(group)]
    words = f"{marking()}; among our means" + (
        ", and among the paper's, of which J_C, a mean, is within the limit" if papers else ""
    )
    return measures_table(caption(groups), task, rows, notes, words)


def measures_table(
    caption: str, first: str, rows: Sequence[Row], notes: Sequence[str] = (), marking: str = ""
) -> Table:
    """A table of rows of a name (headed by `first`), each measure, the runs within the cost limit,
    and where runs end."""
    head = [first, *(measure.head for measure in measures()), "within limit", "ends in"]
    return Table(caption, head, rows, notes, marking)


def mark(rows: Sequence[Row], marked: set[tuple[int, str]]) -> list[Row]:
    """The rows with some measures marked: pairs of a row's place and a measure's name."""
    names = [measure.name for measure in measures()]
    return [
        replace(
            row,
            numbers=[
                replace(cell, marked=(place, name) in marked)
                for name, cell in zip([*names, ""], row.numbers, strict=True)
            ],
        )
        for place, row in enumerate(rows)
    ]


def caption(groups: Sequence[Group]) -> str:
    """Definitions of the numbers of a table."""
    episodes = sorted({run.episodes for group in groups for run in group.runs})
    notes = "".join(f"{measure.note}; " for measure in measures() if measure.note)
    if any(run.ways for group in groups for run in group.runs):
        notes += (
            '"through": it came to where it ends with at least as many cost steps as the shortest '
            'way through the region takes, "round": with fewer; '
        )
    return (
        f"EMCC with alpha = {ALPHA:g}, all values at the quantile kept; J_R, J_C and CVaR: "
        f"undiscounted, deterministic policy, {' or '.join(map(str, episodes)) or 'no'} episodes; "
        f"{notes}mean {INTERVALS}; within limit: the seeds whose J_C is at most the cost limit; "
        "within limit and ends in: counts of seeds [95 % Clopper-Pearson interval of the share]"
    )


def means(group: Group) -> dict[str, float | None]:
    """The mean over a group's runs of each measure; None where a run lacks it."""
    found = {measure.name: group_mean(group, measure.name) for measure in measures()}
    return {name: mean and mean.value for name, mean in found.items()}


def within(group: Group) -> bool | None:
    """Whether all runs of a group keep its cost limit; None where that is not known."""
    share = within_limit(group, cost_limit(group.config))
    return share and share.count == share.runs


def mean_row(group: Group, prefix: str = "") -> Row:
    """The row of the means of a group, with their intervals over seeds, and of its shares."""
    cells = [number_of(group_mean(group, m.name), m.digits) for m in measures()]
    cells.append(count_of(within_limit(group, cost_limit(group.config))))
    ends = "; ".join(f"{place} {count_of(of)}" for place, of in places(group).items())
    name = f"{prefix}{name_of(group)}, mean of {len(group.runs)}"
    return Row(name, cells, ends, kind="mean")


def paper_row(name: str, printed: Mapping[str, float]) -> Row:
    """The row of what the paper prints."""
    cells = [Number(printed.get(measure.name), measure.digits) for measure in measures()]
    return Row(f"{name}, paper ({PAPER_SEEDS} seeds)", [*cells, Number(None)], kind="paper")


def run_rows(group: Group, prefix: str = "") -> Iterator[Row]:
    """A row for each run of a group."""
    limit = cost_limit(group.config)
    for run in group.runs:
        cells = [Number(run.measures.get(m.name), m.digits) for m in measures()]
        share = within_limit(replace(group, runs=[run]), limit)
        cells.append(Number(share and share.count, of=1))
        yield Row(f"{prefix}{name_of(group)}, seed {run.seed}", cells, ends_words(run))


def ends_words(run: Run) -> str:
    """Place where most evaluated episodes of a run end, with their share unless all do, and the way
    by which they came, where it is known."""
    total = sum(run.ends.values())
    shares = [f"{100 * run.ends[run.end] / total:.0f} %"] if len(run.ends) > 1 else []
    ways = run.ways.get(run.end, {})
    if len(ways) == 1:
        return f"{run.end}, {next(iter(ways))}" + "".join(f" ({share})" for share in shares)
    shares += [f"{100 * count / total:.0f} % {way}" for way, count in sorted(ways.items())]
    return run.end + (f" ({', '.join(shares)})" if shares else "")


def _paper_notes(groups: Sequence[Group]) -> list[str]:
    """The settings of our presets that the paper does not print, and what it did otherwise."""
    titles: dict[str, dict[str, None]] = {}
    for config in (group.config for group in groups):
        setting, name = unprinted(config.algorithm), title(config.algorithm)
        if (
            setting
            and setting.field not in hyperparameter_changes(config)
            and paper_results(config.task, name)
        ):
            choice = getattr(config.hyperparameters, setting.field)
            titles.setdefault(setting.choices[choice], {})[name] = None
    source = "The paper does not print this choice."
    if is_circle2d(groups[0].config.task):
        source = "The paper does not print this choice, which decides where runs end."
    notes = [f"{', '.join(of)}: {meaning}. {source}" for meaning, of in titles.items()]
    limited: dict[str, dict[str, None]] = {}
    for config in (group.config for group in groups):
        if words := getattr(config.hyperparameters, "limited_cost", ""):
            limited.setdefault(words, {})[title(config.algorithm)] = None
    if len(limited) > 1:
        kinds = "; ".join(f"the {words} of {', '.join(of)}" for words, of in limited.items())
        notes.append(f"The cost limit holds for {kinds}. Marks and claims compare J_C with it.")
    if any("circle2d_mj/Safety" in group.config.task for group in groups):
        notes.append("The paper evaluated 10 episodes of each run on the Safety tasks.")
    return notes
