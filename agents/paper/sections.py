"""The paper's part of a report: its numbers beside ours, other choices, claims, introduction."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import isclose
from typing import NamedTuple

from agents.algorithms import ALGORITHMS, title
from agents.paper.claims import LIMIT, check_claims
from agents.paper.evidence import SAFETY_SEEDS, SEEDS
from agents.paper.introduction import introduction
from agents.paper.presets import MARGIN, PAPER_ALGORITHMS, ablations, is_circle2d, unprinted
from agents.paper.printed import choice_of, paper_results, printed, split
from agents.reporting.figures import Figure
from agents.reporting.page import Section
from agents.reporting.table import Number, Row, Table, number
from agents.reporting.tables import (
    Reference,
    caption,
    differences_over_tasks,
    mark,
    mean_row,
    means,
    measures_table,
    printed_row,
)
from agents.results.frame import by_task, hyperparameter_changes, name_of, unusual_steps
from agents.results.measures import measure, measures
from agents.results.reading import Group
from agents.results.statistics import (
    INTERVALS,
    LEVEL,
    Pair,
    Summary,
    group_mean,
    mean_of,
    summaries,
    two_sets,
)
from emcc import emcc_by_part
from emcc.parts import ALPHA, PARTS
from emcc.statistics import SHARE

CLAIMS = "The paper's claims"
METHOD = (
    "A claim is confirmed where all its parts are, refuted where one is, undecided otherwise. Runs "
    f"with the presets' settings and of the paper's length count, {SEEDS} or more of an algorithm "
    f"on a task, on a Safety task {SAFETY_SEEDS}. A run ends where its evaluated episodes end most "
    f"often; the limit is {LIMIT:g}. A rule on a share of runs holds where it holds for the whole "
    "95 % Clopper-Pearson interval. Means have 95 % t intervals; where runs end in different "
    "places, or are fewer than five, their range. Differences are decided by permutation tests of "
    f"Welch's t, equivalence by two one-sided ones, at {LEVEL:g}; to refute, at {LEVEL:g} divided "
    "by the number of parts. "
    '"With bootstrap: refuted": the verdict with runs of another choice of what the paper does not '
    "print in the place of the preset's."
)
CHOICES = "Other choices of what the paper does not print"
CHOICES_MEANING = (
    "adam, sgd: TRPO-Lag's multiplier ascends by Adam or by the plain gradient; terminal, "
    "bootstrap: a time limit ends an episode for good or not; library: WCSAC as in a later library "
    "of the paper's group (variance_target unsquared, damping_gradient through); units: "
    "observations in units of length. These runs are in no other table and decide no claim"
)
NEAREST = "Which choice is the nearest to the paper"
PARTS_TITLE = "SAC-LB-Streak without one of its parts"
PARTS_MEANING = (
    "without-streak: plain cost; without-brown: white random actions; without-share: batches of "
    "the last transitions alone; without-novelty: no bonus for new states; without-horizon: "
    "returns end at the time limit; without-scale: observations in shares of the arena; "
    "without-speed: step sizes, batch and gradient steps of SAC-LB; margin: plain cost and a cost "
    f"limit that is {MARGIN:g} lower"
)
TIES = "Ties split instead of kept"
TIES_MEANING = (
    "EMCC is the mean of the highest tenth of a third's MCC. Ties kept: every value equal to the "
    "quantile counts, as in the paper's equation and all other tables; split: exactly a tenth of "
    "the rollouts counts"
)
MARKING = "of the choices the mean that is nearest to the paper's"


class Paper(NamedTuple):
    """All that the paper adds to a report."""

    usual: list[Group]
    """Groups for the usual tables: those of the other choices are in tables of their own."""
    printed: Reference
    notes: Mapping[str, list[str]]
    """Notes below the table of each task."""
    tables: dict[str, Table]
    """Tables of other choices, by title."""
    details: dict[str, Table]
    claims: Section | None
    introduction: list[Figure]


def sections(groups: Sequence[Group]) -> Paper:
    """The paper's part of a report on some groups."""
    usual, pairs = split(groups)
    choices = {
        CHOICES: choices_table(pairs),
        NEAREST: nearest_table(pairs),
        PARTS_TITLE: parts_table(pairs),
        f"{PARTS_TITLE}, all tasks together": parts_over_tasks(pairs),
    }
    circle2d = any(is_circle2d(group.task) and group.runs for group in usual)
    return Paper(
        usual,
        printed,
        {task: _notes([g for g in usual if g.task == task]) for task in {g.task for g in usual}},
        {name: table for name, table in choices.items() if table is not None},
        {TIES: ties_table(usual)},
        claims_section(groups),
        introduction() if circle2d else [],
    )


def _notes(groups: Sequence[Group]) -> list[str]:
    """The settings of our presets that the paper does not print, and what it did otherwise."""
    task = groups[0].task
    titles: dict[str, dict[str, None]] = {}
    for config in (group.config for group in groups):
        setting, name = unprinted(config.algorithm), title(config.algorithm)
        if (
            setting
            and setting.field not in hyperparameter_changes(config, task)
            and paper_results(task, name)
        ):
            choice = getattr(config.hyperparameters, setting.field)
            titles.setdefault(setting.choices[choice], {})[name] = None
    decides = ", which decides where runs end" if is_circle2d(task) else ""
    source = f"The paper does not print this choice{decides}."
    notes = [f"{', '.join(names)}: {meaning}. {source}" for meaning, names in titles.items()]
    if "circle2d_mj/Safety" in task:
        notes.append("The paper evaluated 10 episodes of each run on the Safety tasks.")
    return notes


def claims_section(groups: Sequence[Group]) -> Section | None:
    """The paper's claims with their verdicts; None where no run can tell."""
    statements = check_claims(groups)
    return Section(CLAIMS, statements=statements, method=METHOD) if statements else None


def choices_table(pairs: Sequence[Pair]) -> Table | None:
    """For each task and algorithm the preset's means, those of the other choices, and the paper's.

    Marked is, of each measure, the choice whose mean is nearest to what the paper prints. None
    where no algorithm of the paper has other choices.
    """
    rows: list[Row] = []
    marked, shown = set(), []
    for choices in _by_preset(pairs):
        name = choices[0].config.algorithm
        if name not in PAPER_ALGORITHMS:
            continue
        complete = [group for group in choices if group.runs]
        told = summaries(complete)
        reference = printed(choices[0].task, name)
        if reference and len(complete) > 1:
            marked |= {(len(rows) + row, m) for row, m in _nearer(told, reference.values)}
        rows += map(_row, complete, told)
        if reference:
            rows.append(printed_row(f"{choices[0].task}, {title(name)}", reference))
        shown += choices
    if not rows:
        return None
    words = f"{CHOICES}: {CHOICES_MEANING}. {caption(shown)}"
    return measures_table(words, "task, algorithm and choice", mark(rows, marked), marking=MARKING)


def nearest_table(pairs: Sequence[Pair]) -> Table | None:
    """In how many measures, over all tasks, each choice of an algorithm is the nearest to the
    paper; None where nothing can be compared."""
    nearest: Counter[tuple[str, str]] = Counter()
    compared: Counter[tuple[str, str]] = Counter()
    for choices in _by_preset(pairs):
        complete = [group for group in choices if group.runs]
        name = title(choices[0].config.algorithm)
        values = paper_results(choices[0].task, name)
        places = list(_nearer(summaries(complete), values)) if len(complete) > 1 else []
        for row, group in enumerate(complete):
            key = name, _choice(group)
            compared[key] += len({m for _, m in places})
            nearest[key] += sum(place == row for place, _ in places)
    rows = [
        Row(f"{name}, {choice}", [Number(nearest[name, choice], total=total)])
        for (name, choice), total in compared.items()
        if total
    ]
    if not rows:
        return None
    words = "Measures, over all tasks, in which a choice's mean is the nearest to the paper's"
    return Table(words, ["algorithm and choice", "nearest"], rows)


def parts_table(pairs: Sequence[Pair]) -> Table | None:
    """For each task SAC-LB-Streak's means, and those without one of its parts; None without any."""
    groups = [group for choices in _streak_choices(pairs) for group in choices if group.runs]
    if not groups:
        return None
    words = f"{PARTS_TITLE}: {PARTS_MEANING}. {caption(groups)}"
    rows = list(map(_row, groups, summaries(groups)))
    return measures_table(words, "task, algorithm and part", rows)


def parts_over_tasks(pairs: Sequence[Pair]) -> Table | None:
    """Differences, over all tasks, of SAC-LB-Streak's runs without each part; None of one task."""
    named: dict[str, list[Pair]] = {}
    for usual, *others in _streak_choices(pairs):
        for other in others:
            apart = filter(None, [other.apart])
            words = [_choice(other), *unusual_steps(other.config, other.task), *apart]
            named.setdefault(f"B - A: {', '.join(words)} - preset", []).append((usual, other))
    sets = {name: two_sets(same) for name, same in named.items()}
    return differences_over_tasks({name: two for name, two in sets.items() if two})


def _streak_choices(pairs: Sequence[Pair]) -> list[list[Group]]:
    return [c for c in _by_preset(pairs) if c[0].config.algorithm not in PAPER_ALGORITHMS]


def _by_preset(pairs: Sequence[Pair]) -> list[list[Group]]:
    """The group of each preset, followed by those of the other choices: by algorithm, then by task,
    choices in the order of `presets.ablations`."""
    beside: dict[int, list[Group]] = {}
    for usual, other in sorted(pairs, key=_place):
        beside.setdefault(id(usual), [usual]).append(other)
    return list(beside.values())


def _place(pair: Pair) -> tuple[int, str, int]:
    name, task = pair[1].config.algorithm, pair[1].task
    where = list(ablations(name, task)).index(choice_of(pair[1]) or "")
    return list(ALGORITHMS).index(name), task, where


def _nearer(
    told: Sequence[Mapping[str, Summary]], values: Mapping[str, float]
) -> Iterator[tuple[int, str]]:
    """Place and measure of the means that are nearest to the paper's numbers, as printed."""
    known = [means(summary) for summary in told]
    for m in measures():
        ours = [group[m.name] for group in known]
        if m.name in values and None not in ours:
            off = [abs(round(mean, m.digits) - values[m.name]) for mean in ours if mean is not None]
            yield from ((row, m.name) for row, far in enumerate(off) if isclose(far, min(off)))


def _row(group: Group, summary: Mapping[str, Summary]) -> Row:
    words = [group.task, title(group.config.algorithm), _choice(group)]
    return mean_row(group, summary, ", ".join([*words, *unusual_steps(group.config, group.task)]))


def _choice(group: Group) -> str:
    """The name of a choice; "preset", with its value where the choice is one of two."""
    if choice := choice_of(group):
        return choice
    setting, chosen = unprinted(group.config.algorithm), group.config.hyperparameters
    return f"{getattr(chosen, setting.field)} (preset)" if setting else "preset"


def ties_table(groups: Sequence[Group]) -> Table:
    """EMCC of each third with both readings of its quantile, and the paper's.

    The records of training decide it: no run is trained for it.
    """
    columns = [measure(f"EMCC_{part}") for part in PARTS]
    rows: list[Row] = []
    for group in (group for own in by_task(groups).values() for group in own):
        name = f"{group.task}, {name_of(group)}"
        values = paper_results(group.task, title(group.config.algorithm))
        kept = [group_mean(group, m.name) for m in columns]
        divided = [mean_of(third, group.one_place, SHARE) for third in _split(group)]
        cells: list[list[Number]] = [[], []]
        for m, pair in zip(columns, zip(kept, divided, strict=True), strict=True):
            goal = values.get(m.name)
            off = [
                abs(round(mean.value, m.digits) - goal)
                for mean in pair
                if mean and goal is not None
            ]
            for k, mean in enumerate(pair):
                nearer = len(off) == 2 and isclose(off[k], min(off))
                cells[k].append(replace(number(mean, m.digits), marked=nearer))
        for way, numbers in zip(("kept", "split"), cells, strict=True):
            rows.append(Row(f"{name}, ties {way}, mean of {len(group.runs)}", numbers, kind="mean"))
        if values:
            theirs = [Number(values.get(m.name), m.digits) for m in columns]
            rows.append(Row(f"{name}, paper", theirs, kind="paper"))
    head = ["task, algorithm and ties", *(m.head for m in columns)]
    return Table(f"{TIES_MEANING}; mean {INTERVALS}", head, rows, marking=MARKING)


def _split(group: Group) -> list[list[float]]:
    """EMCC with split ties of each run, by third."""
    runs = [
        emcc_by_part(*run.records.mcc_per_rollout(), group.config.steps, ALPHA, "split").values()
        for run in group.runs
    ]
    return [list(third) for third in zip(*runs, strict=True)]
