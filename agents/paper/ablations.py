"""Both choices of the settings that the paper does not print, side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import isclose

from agents.algorithms import algorithm
from agents.paper.presets import ablation, preset, unprinted
from agents.reporting.tables import (
    caption,
    mean_row,
    means,
    measures_table,
    paper_results,
    paper_row,
    unusual_steps,
)
from agents.results.reading import MEASURES, Group
from agents.training.config import TrainConfig
from emcc.table import Table

TITLE = "Both choices of what the paper does not print"
MEANING = (
    "TRPO-Lag's multiplier ascends by Adam or by the plain gradient (multiplier_optimizer adam or "
    "sgd); a time limit ends an episode for good or not in the off-policy methods (time_limit "
    "terminal or bootstrap). Runs of the choice that is not the preset's are in no other table and "
    "decide no claim"
)
MARKING = "of the two choices the mean that is nearer to the paper's"


def split(groups: Sequence[Group]) -> tuple[list[Group], list[tuple[Group, Group]]]:
    """The groups to report as ever, and the pairs of a preset's group and its ablated one.

    Ablated is a group whose unprinted setting has the other choice while nothing else differs from
    the preset, where the preset's group is there too; without it, it is a group like any other.
    """
    pairs = []
    for group in groups:
        beside = [other for other in groups if _is_ablation(group.config, other.config)]
        pairs += [(beside[0], group)] if beside else []
    ablated = {group.folder for _, group in pairs}
    return [group for group in groups if group.folder not in ablated], pairs


def _is_ablation(config: TrainConfig, of: TrainConfig) -> bool:
    """Whether it is that of a preset but for the choice of what is not printed, on equal terms."""
    other = ablation(config.algorithm, config.task)
    if other is None or config.hyperparameters != other[1]:
        return False
    if of.algorithm != config.algorithm or of.hyperparameters != preset(of.algorithm, of.task):
        return False
    terms = [(c.task, c.task_parameters, c.steps) for c in (config, of)]
    return terms[0] == terms[1]


def ablation_table(pairs: Sequence[tuple[Group, Group]]) -> Table:
    """For each task and algorithm the preset's means, those of the other choice, and the paper's.

    "ends in" counts the runs that end in each place. Marked is, of each measure, the choice whose
    mean is nearer to what the paper prints.
    """
    rows, marked = [], set()
    for pair in pairs:
        complete = [group for group in pair if group.runs]
        config = pair[0].config
        printed = paper_results(config.task, algorithm(config.algorithm).title)
        if len(complete) == 2 and printed:
            marked |= {(len(rows) + row, column) for row, column in _nearer(complete, printed)}
        rows += [_row(group) for group in complete]
        if printed:
            rows.append(paper_row(f"{config.task}, {algorithm(config.algorithm).title}", printed))
    groups = [group for pair in pairs for group in pair]
    what = "task, algorithm and choice"
    table = measures_table(f"{TITLE}: {MEANING}. {caption(groups)}", what, rows)
    return replace(table, marked=frozenset(marked), marking=MARKING)


def _nearer(groups: Sequence[Group], printed: Mapping[str, float]) -> Iterator[tuple[int, int]]:
    """Row and column of the means that are nearest to the paper's numbers, to two digits."""
    of_groups = [means(group.runs) for group in groups]
    for column, name in enumerate(MEASURES, 1):
        off = [abs(round(of_group[name], 2) - printed[name]) for of_group in of_groups]
        yield from ((row, column) for row, far in enumerate(off) if isclose(far, min(off)))


def _row(group: Group) -> list[str]:
    config = group.config
    setting = unprinted(config.algorithm)
    assert setting is not None
    choice = getattr(config.hyperparameters, setting.field)
    if config.hyperparameters == preset(config.algorithm, config.task):
        choice += " (preset)"
    title = algorithm(config.algorithm).title
    what = ", ".join([config.task, title, choice, *unusual_steps(config)])
    places = Counter(run.ends.partition(" (")[0] for run in group.runs if run.ends)
    ends = ", ".join(f"{place} {count}" for place, count in places.most_common())
    return [f"{what}, mean of {len(group.runs)}", *mean_row(group)[1:-1], ends]
