"""Both choices of the settings that the paper does not print, side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import isclose

from agents.algorithms import title
from agents.paper.presets import preset, unprinted
from agents.paper.printed import paper_results
from agents.paper.settings import unusual_steps
from agents.reporting.table import Row, Table
from agents.reporting.tables import caption, mark, mean_row, means, measures_table, paper_row
from agents.results.measures import measures
from agents.results.reading import Group

TITLE = "Both choices of what the paper does not print"
MEANING = (
    "TRPO-Lag's multiplier ascends by Adam or by the plain gradient (multiplier_optimizer adam or "
    "sgd); a time limit ends an episode for good or not in the off-policy methods (time_limit "
    "terminal or bootstrap). Runs of the choice that is not the preset's are in no other table and "
    "decide no claim"
)
MARKING = "of the two choices the mean that is nearer to the paper's"


def ablation_table(pairs: Sequence[tuple[Group, Group]]) -> Table:
    """For each task and algorithm the preset's means, those of the other choice, and the paper's.

    "ends in" counts the runs that end in each place. Marked is, of each measure, the choice whose
    mean is nearer to what the paper prints.
    """
    rows: list[Row] = []
    marked = set()
    for pair in pairs:
        complete = [group for group in pair if group.runs]
        config = pair[0].config
        name = title(config.algorithm)
        printed = paper_results(config.task, name)
        if len(complete) == 2:
            marked |= {(len(rows) + row, name) for row, name in _nearer(complete, printed)}
        rows += [_row(group) for group in complete]
        if printed:
            rows.append(paper_row(f"{config.task}, {name}", printed))
    groups = [group for pair in pairs for group in pair]
    what = "task, algorithm and choice"
    words = f"{TITLE}: {MEANING}. {caption(groups)}"
    return measures_table(words, what, mark(rows, marked), marking=MARKING)


def _nearer(groups: Sequence[Group], printed: Mapping[str, float]) -> Iterator[tuple[int, str]]:
    """Place and measure of the means that are nearest to the paper's numbers, as printed."""
    of_groups = [means(group) for group in groups]
    for measure in measures():
        values = [of_group[measure.name] for of_group in of_groups]
        if measure.name not in printed or None in values:
            continue
        goal = printed[measure.name]
        off = [abs(round(value, measure.digits) - goal) for value in values if value is not None]
        yield from ((row, measure.name) for row, far in enumerate(off) if isclose(far, min(off)))


def _row(group: Group) -> Row:
    config = group.config
    setting = unprinted(config.algorithm)
    assert setting is not None
    choice = getattr(config.hyperparameters, setting.field)
    if config.hyperparameters == preset(config.algorithm, config.task):
        choice += " (preset)"
    words = [config.task, title(config.algorithm), choice, *unusual_steps(config)]
    places = Counter(run.end for run in group.runs if run.end)
    ends = ", ".join(f"{place} {count}" for place, count in places.most_common())
    return replace(
        mean_row(group), name=f"{', '.join(words)}, mean of {len(group.runs)}", ends=ends
    )
