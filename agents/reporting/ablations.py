"""Choices that the paper does not print, side by side: settings of training, and of EMCC."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import isclose

from agents.algorithms import ALGORITHMS, title
from agents.paper.ablations import choice_of
from agents.paper.presets import MARGIN, PAPER_ALGORITHMS, ablations, unprinted
from agents.paper.printed import paper_results
from agents.paper.settings import by_task, name_of, unusual_steps
from agents.reporting.over_tasks import differences_over_tasks
from agents.reporting.table import Number, Row, Table, number_of
from agents.reporting.tables import caption, mark, mean_row, means, measures_table, paper_row
from agents.results.measures import measure, measures
from agents.results.over_tasks import two_sets
from agents.results.reading import Group
from agents.results.statistics import INTERVALS, group_mean, mean_of
from agents.training.config import TrainConfig
from emcc import emcc_by_part
from emcc.parts import ALPHA, PARTS

TITLE = "Other choices of what the paper does not print"
NEAREST = "Which choice is the nearest to the paper"
MEANING = (
    "TRPO-Lag's multiplier ascends by Adam or by the plain gradient (multiplier_optimizer adam or "
    "sgd); a time limit ends an episode for good or not in the off-policy methods (time_limit "
    "terminal or bootstrap); library: WCSAC as in a later library of the paper's group, the last "
    "term of its variance's target without the square and that target without the end of "
    "episodes (variance_target unsquared), and a damping that the gradient goes through "
    "(damping_gradient through); units: observations in units of length (input_scale 15) "
    "instead of shares of the arena. Runs of a choice that is not the preset's are in no other "
    "table and decide no claim; where a verdict would be another with them, the claim says so"
)
PARTS_TITLE = "SAC-LB-Streak without one of its parts"
PARTS_TOGETHER = f"{PARTS_TITLE}, all tasks together"
PARTS_MEANING = (
    "without-streak: plain cost (streak_weight 0); without-brown: white random actions "
    "(random_exponent 0); without-share: batches of the last transitions alone (random_share 0); "
    "without-novelty: no bonus for new states (novelty_bonus 0); "
    "without-horizon: returns end at the time limit (time_limit terminal); without-scale: "
    "observations in shares of the arena (input_scale 1), where the bonus counts the same places "
    "(novelty_length 2 / 15); without-speed: step sizes, batch and "
    f"gradient steps of SAC-LB; margin: plain cost and a cost limit that is {MARGIN:g} lower. "
    "Means of the runs that the rows tell; the table of all tasks together has the tests"
)
TIES = "Ties split instead of kept"
TIES_MEANING = (
    "EMCC is the mean of the highest tenth of a third's MCC. Many rollouts have equal MCC: ties "
    "are kept where every value equal to the quantile counts, as in the paper's equation and in "
    "all other tables; they are split where exactly a tenth of the rollouts counts. Computed from "
    "the records of the same runs"
)
MARKING = "of the choices the mean that is nearest to the paper's"


def ablation_table(pairs: Sequence[tuple[Group, Group]]) -> Table | None:
    """For each task and algorithm the preset's means, those of the other choices, and the paper's.

    Marked is, of each measure, the choice whose mean is nearest to what the paper prints. None
    where no algorithm of the paper has other choices.
    """
    rows: list[Row] = []
    marked = set()
    of_presets = [of for of in _by_preset(pairs) if of[0].config.algorithm in PAPER_ALGORITHMS]
    for choices in of_presets:
        complete = [group for group in choices if group.runs]
        config = choices[0].config
        name = title(config.algorithm)
        printed = paper_results(config.task, name)
        if len(complete) > 1:
            marked |= {(len(rows) + row, name) for row, name in _nearer(complete, printed)}
        rows += [_row(group) for group in complete]
        if printed:
            rows.append(paper_row(f"{config.task}, {name}", printed))
    if not rows:
        return None
    groups = [group for choices in of_presets for group in choices]
    what = "task, algorithm and choice"
    words = f"{TITLE}: {MEANING}. {caption(groups)}"
    return measures_table(words, what, mark(rows, marked), marking=MARKING)


def parts_over_tasks(pairs: Sequence[tuple[Group, Group]]) -> Table | None:
    """Differences, over all tasks, of SAC-LB-Streak's runs without each part; None of one task."""
    by_choice: dict[str, list[tuple[Group, Group]]] = {}
    for usual, *others in _of_parts(pairs):
        for other in others:
            config, apart = other.config, filter(None, [other.apart])
            name = ", ".join([_choice(config), *unusual_steps(config), *apart])
            by_choice.setdefault(f"B - A: {name} - preset", []).append((usual, other))
    found = {name: two_sets(of) for name, of in by_choice.items()}
    return differences_over_tasks({name: sets for name, sets in found.items() if sets})


def parts_table(pairs: Sequence[tuple[Group, Group]]) -> Table | None:
    """For each task SAC-LB-Streak's means, and those without one of its parts; None without any."""
    groups = [group for choices in _of_parts(pairs) for group in choices if group.runs]
    if not groups:
        return None
    words = f"{PARTS_TITLE}: {PARTS_MEANING}. {caption(groups)}"
    return measures_table(words, "task, algorithm and part", [_row(group) for group in groups])


def nearest_table(pairs: Sequence[tuple[Group, Group]]) -> Table | None:
    """In how many measures, over all tasks, each choice of an algorithm is the nearest to the
    paper; None where nothing can be compared."""
    nearest: Counter[tuple[str, str]] = Counter()
    compared: Counter[tuple[str, str]] = Counter()
    for choices in _by_preset(pairs):
        complete = [group for group in choices if group.runs]
        name = title(choices[0].config.algorithm)
        printed = paper_results(choices[0].config.task, name)
        found = list(_nearer(complete, printed)) if len(complete) > 1 else []
        for row, group in enumerate(complete):
            key = name, _choice(group.config)
            compared[key] += len({of for _, of in found})
            nearest[key] += sum(place == row for place, _ in found)
    rows = [
        Row(f"{name}, {choice}", [Number(nearest[name, choice], of=total)])
        for (name, choice), total in compared.items()
        if total
    ]
    if not rows:
        return None
    words = (
        "Measures, over all tasks, in which a choice's mean is the nearest to the paper's, each of "
        "equal ones counted; of those in which it was compared"
    )
    return Table(words, ["algorithm and choice", "nearest"], rows)


def _of_parts(pairs: Sequence[tuple[Group, Group]]) -> list[list[Group]]:
    return [of for of in _by_preset(pairs) if of[0].config.algorithm not in PAPER_ALGORITHMS]


def _by_preset(pairs: Sequence[tuple[Group, Group]]) -> list[list[Group]]:
    """The group of each preset, followed by those of the other choices: by algorithm, then by task,
    choices in the order of `presets.ablations`."""
    found: dict[str, list[Group]] = {}
    for usual, other in sorted(pairs, key=_place):
        found.setdefault(usual.folder, [usual]).append(other)
    return list(found.values())


def _place(pair: tuple[Group, Group]) -> tuple[int, str, int]:
    config = pair[1].config
    choices = list(ablations(config.algorithm, config.task))
    where = choices.index(choice_of(config) or "")
    return list(ALGORITHMS).index(config.algorithm), config.task, where


def _nearer(groups: Sequence[Group], printed: Mapping[str, float]) -> Iterator[tuple[int, str]]:
    """Place and measure of the means that are nearest to the paper's numbers, as printed."""
    of_groups = [means(group) for group in groups]
    for column in measures():
        values = [of_group[column.name] for of_group in of_groups]
        if column.name not in printed or None in values:
            continue
        goal = printed[column.name]
        off = [abs(round(value, column.digits) - goal) for value in values if value is not None]
        yield from ((row, column.name) for row, far in enumerate(off) if isclose(far, min(off)))


def _row(group: Group) -> Row:
    config = group.config
    words = [config.task, title(config.algorithm), _choice(config), *unusual_steps(config)]
    return replace(mean_row(group), name=f"{', '.join(words)}, mean of {len(group.runs)}")


def _choice(config: TrainConfig) -> str:
    """The name of a choice; "preset", with its value where the choice is one of two."""
    if choice := choice_of(config):
        return choice
    setting = unprinted(config.algorithm)
    return f"{getattr(config.hyperparameters, setting.field)} (preset)" if setting else "preset"


def ties_table(groups: Sequence[Group]) -> Table:
    """EMCC of each third with both readings of its quantile, and the paper's.

    The records of training decide it: no run is trained for it.
    """
    columns = [measure(f"EMCC_{part}") for part in PARTS]
    rows: list[Row] = []
    for group in (group for of_task in by_task(groups).values() for group in of_task):
        name = f"{group.config.task}, {name_of(group)}"
        printed = paper_results(group.config.task, title(group.config.algorithm))
        kept = [group_mean(group, column.name) for column in columns]
        split = [mean_of(values, group.one_place) for values in _split(group)]
        cells: list[list[Number]] = [[], []]
        for column, pair in zip(columns, zip(kept, split, strict=True), strict=True):
            goal = printed.get(column.name)
            off = (
                [abs(round(of.value, column.digits) - goal) for of in pair if of]
                if goal is not None
                else []
            )
            for k, of in enumerate(pair):
                nearer = len(off) == 2 and isclose(off[k], min(off))
                cells[k].append(number_of(of, column.digits, marked=nearer))
        for way, of_way in zip(("kept", "split"), cells, strict=True):
            rows.append(Row(f"{name}, ties {way}, mean of {len(group.runs)}", of_way, kind="mean"))
        if printed:
            of_paper = [Number(printed.get(column.name), column.digits) for column in columns]
            rows.append(Row(f"{name}, paper", of_paper, kind="paper"))
    words = f"{TIES_MEANING}; mean {INTERVALS}"
    head = ["task, algorithm and ties", *(column.head for column in columns)]
    return Table(words, head, rows, marking=MARKING)


def _split(group: Group) -> list[list[float]]:
    """EMCC with split ties of each run, by third."""
    runs = [
        emcc_by_part(*run.records.mcc_per_rollout(), group.config.steps, ALPHA, "split").values()
        for run in group.runs
    ]
    return [list(of_third) for of_third in zip(*runs, strict=True)]
