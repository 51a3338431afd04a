"""The paper's part of a report: its numbers next to ours, tables of other choices, and claims."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import comb, isclose

from agents.algorithms import ALGORITHMS, title
from agents.paper.claims import LIMIT, check_claims
from agents.paper.evidence import SAFETY_SEEDS, SEEDS, choice_of, printed
from agents.paper.grid import LIMIT_MARGIN, PAPER_ALGORITHMS, SAFETY, ablations, unprinted
from agents.presets import is_circle2d, registered_id, usual_steps
from agents.reporting.overall import differences_over_tasks
from agents.reporting.page import HANGS, Section
from agents.reporting.study import Study
from agents.reporting.table import Number, Row, Table, number
from agents.reporting.tables import (
    caption,
    lengths_differ,
    mark,
    mean_row,
    means,
    measures_table,
    printed_row,
)
from agents.results.groups import Group, RunResult
from agents.results.measures import measure, measures
from agents.results.names import by_task, hyperparameter_changes
from agents.results.statistics import ACROSS, INTERVALS, LEVEL, Pair, group_mean, pairs_over_tasks
from circle2d_mj.registration import KINEMATIC, PHYSICS
from emcc.panels import emcc_of_thirds
from emcc.parts import PARTS, TIES

CLAIMS_TITLE = "The paper's claims"
CLAIMS_WITH_PHYSICS = f"{CLAIMS_TITLE}, on Circle2D with physics, of which it has no runs"
LEAST_P = 2 / comb(2 * SAFETY_SEEDS, SAFETY_SEEDS)
METHOD = (
    "A claim is reproduced where all its parts are, not reproduced where one is not, undecided "
    "otherwise: the verdict is on the reconstruction, not on the paper. Runs "
    f"with the presets' settings and of the paper's length count, {SEEDS} or more of an algorithm "
    f"on a task, on a Safety task {SAFETY_SEEDS} (as few on both sides decide no difference: p is "
    f"{LEAST_P:g} at least). A run ends where its evaluated episodes end most often; Circle2D's "
    f"limit is {LIMIT:g}. A rule on a share of runs holds where it holds for the whole 95 % "
    "Clopper-Pearson interval. Means have 95 % t intervals; where runs end in different places, or "
    "are fewer than five, their range. Differences are decided by permutation tests of Welch's t, "
    f"equivalence by two one-sided ones, at {LEVEL:g}; against a claim, at {LEVEL:g} divided "
    "by the number of its parts. EMCC is as the paper defines it, over rollouts, of an epoch or an "
    f"episode; where a claim compares on- and off-policy methods, over windows of {ACROSS} "
    "episodes. "
    f"{HANGS}: the verdict depends on what the paper does not specify. "
    '"With bootstrap: undecided": the verdict with runs of another choice of that in the place of '
    "the preset's."
)
CHOICES = "Other choices of what the paper does not specify"
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
    f"limit that is {LIMIT_MARGIN:g} lower"
)
OTHER_TIES = "All ties instead of split ones"
OTHER_TIES_MEANING = (
    "EMCC is the mean of the highest tenth of a third's MCC. Ties split: exactly a tenth of the "
    "rollouts counts, as in the paper's and all other tables; all: every value at or above the "
    "quantile counts, as the paper's equation reads"
)
EMCCS = [f"EMCC_{part}" for part in PARTS]
MARKING = "of the choices the mean that is nearest to the paper's"


class Paper(Study):
    """Everything that the paper adds to a report."""

    def printed(self, group: Group) -> Group:
        """Return the group with the paper's numbers: see `evidence.printed`."""
        return printed(group)

    def set_apart(self, groups: Sequence[Group]) -> tuple[list[Group], dict[str, Table]]:
        """Set apart groups with other choices of what the paper does not specify, if the preset's
        group is there; they get their own tables."""
        usual, pairs = split(groups)
        if not pairs:
            return usual, {}
        choices = _by_preset(pairs)
        of_paper, of_parts = (
            [own for own in choices if (own[0].config.algorithm in PAPER_ALGORITHMS) == is_paper]
            for is_paper in (True, False)
        )
        tables = {
            CHOICES: choices_table(of_paper, "choice", f"{CHOICES}: {CHOICES_MEANING}"),
            NEAREST: nearest_table(of_paper),
            PARTS_TITLE: choices_table(of_parts, "part", f"{PARTS_TITLE}: {PARTS_MEANING}"),
            f"{PARTS_TITLE}, all tasks together": parts_over_tasks(of_parts),
        }
        return usual, {name: table for name, table in tables.items() if table is not None}

    def notes(self, groups: Sequence[Group]) -> list[str]:
        """Return notes on what the paper does not specify, and on how its runs differ from ours."""
        task = groups[0].task
        titles: dict[str, dict[str, None]] = {}
        for group in (group for group in groups if group.printed):
            config, setting = group.config, unprinted(group.config.algorithm)
            if setting and setting.field not in hyperparameter_changes(config, task):
                choice = getattr(config.hyperparameters, setting.field)
                titles.setdefault(setting.choices[choice], {})[title(config.algorithm)] = None
        decides = ", which decides where runs end" if is_circle2d(task) else ""
        source = f"The paper does not specify this choice{decides}."
        notes = [f"{', '.join(names)}: {meaning}. {source}" for meaning, names in titles.items()]
        steps = usual_steps(task)
        if any(group.printed and group.runs and group.total_steps < steps for group in groups):
            notes.append(f"The paper's numbers are of trainings of {steps:,} steps.")
        if registered_id(task) in SAFETY:
            notes.append("The paper evaluated 10 episodes of each run on the Safety tasks.")
        return notes

    def details(self, groups: Sequence[Group]) -> dict[str, Table]:
        """Return the table of EMCC with all ties: see `ties_table`."""
        return {OTHER_TIES: ties_table(groups)}

    def sections(self, groups: Sequence[Group]) -> list[Section]:
        """Return the paper's claims with their verdicts: see `claims_sections`."""
        return claims_sections(groups)


STUDY = Paper()


def split(groups: Sequence[Group]) -> tuple[list[Group], list[tuple[Group, Group]]]:
    """Return the groups to report as usual, and pairs of the preset's group and an ablated one.

    A group is ablated if it differs from the preset only by one of `grid.ablations`. Without the
    preset's group there is no pair, and the ablated group is reported as usual.
    """
    pairs = []
    for group in groups:
        if not choice_of(group):
            continue
        beside = [other for other in groups if _is_preset_of(other, group)]
        if beside:  # of several, such as published runs and a trial, the one with the most runs
            pairs.append((max(beside, key=lambda other: len(other.runs)), group))
    ablated = {id(group) for _, group in pairs}
    return [group for group in groups if id(group) not in ablated], pairs


def _is_preset_of(group: Group, ablated: Group) -> bool:
    """Whether a group has the preset's settings and is otherwise equal to an ablated group."""
    names = ("algorithm", "task_parameters", "steps")
    equal = all(getattr(group.config, n) == getattr(ablated.config, n) for n in names)
    return equal and group.task == ablated.task and choice_of(group) == ""


def claims_sections(groups: Sequence[Group]) -> list[Section]:
    """Return sections on the paper's claims, and on the same claims for the tasks with physics, for
    which the paper has no runs. Sections that no run can decide are left out."""
    same = {PHYSICS[level]: task for level, task in KINEMATIC.items()}
    physics = [
        replace(group, task=same[registered_id(group.task)])
        for group in groups
        if registered_id(group.task) in same
    ]
    found = {CLAIMS_TITLE: check_claims(groups), CLAIMS_WITH_PHYSICS: check_claims(physics)}
    return [
        Section(title, statements=statements, method=METHOD)
        for title, statements in found.items()
        if statements
    ]


Choices = Sequence[Sequence[Group]]
"""For each preset its group, followed by the groups with other choices."""


def choices_table(choices: Choices, kind: str, words: str) -> Table | None:
    """Return the table of means with the preset, with other choices, and in the paper.

    For each measure the choice whose mean is nearest to the paper's is marked. None if there are no
    choices. kind: the word for a choice; words: what the choices mean.
    """
    rows: list[Row] = []
    marked: set[tuple[int, str]] = set()
    for own in choices:
        task, name = own[0].task, own[0].config.algorithm
        complete = [group for group in own if group.runs]
        marked |= {(len(rows) + k, m) for k, m in _nearest(complete, own[0].printed)}
        for group in complete:
            words_of = [task, title(name), _choice(group), *group.length]
            rows.append(mean_row(group, ", ".join(words_of)))
        if own[0].printed:
            rows.append(printed_row(f"{task}, {title(name)}", own[0]))
    if not rows:
        return None
    groups = [group for own in choices for group in own]
    legend = f"{words}. {caption(groups)}"
    head = f"task, algorithm and {kind}"
    rows, lengths = mark(rows, marked), lengths_differ(groups)
    return measures_table(legend, head, rows, marking=MARKING, lengths=lengths)


def nearest_table(choices: Choices) -> Table | None:
    """Return the table that counts, over all tasks, the measures in which each choice is nearest to
    the paper; None if nothing can be compared."""
    nearest: Counter[tuple[str, str]] = Counter()
    compared: Counter[tuple[str, str]] = Counter()
    for own in choices:
        name, complete = title(own[0].config.algorithm), [group for group in own if group.runs]
        found = list(_nearest(complete, own[0].printed))
        for k, group in enumerate(complete):
            key = name, _choice(group)
            compared[key] += len({m for _, m in found})
            nearest[key] += sum(place == k for place, _ in found)
    rows = [
        Row(f"{name}, {choice}", [Number(nearest[name, choice], total=total)])
        for (name, choice), total in compared.items()
        if total
    ]
    words = "Measures, over all tasks, in which a choice's mean is the nearest to the paper's"
    return Table(words, ["algorithm and choice", "nearest"], rows) if rows else None


def parts_over_tasks(choices: Choices) -> Table | None:
    """Return the table of differences, over all tasks, of SAC-LB-Streak without each part from its
    preset; None if there is only one task."""
    named = []
    for usual, *others in choices:
        for other in others:
            words = [_choice(other), *other.length, other.apart, other.where]
            name = f"B - A: {', '.join(filter(None, words))} - preset"
            named.append((name, (usual, other)))
    return differences_over_tasks(pairs_over_tasks(named))


def _by_preset(pairs: Sequence[Pair]) -> list[list[Group]]:
    """Sort the choices by algorithm, then task, then the order of `grid.ablations`."""
    beside: dict[int, list[Group]] = {}
    for usual, other in sorted(pairs, key=_place):
        beside.setdefault(id(usual), [usual]).append(other)
    return list(beside.values())


def _place(pair: Pair) -> tuple[int, str, int]:
    name, task = pair[1].config.algorithm, pair[1].task
    where = list(ablations(name, task)).index(choice_of(pair[1]) or "")
    return list(ALGORITHMS).index(name), task, where


def _nearest(groups: Sequence[Group], values: Mapping[str, float]) -> Iterator[tuple[int, str]]:
    """Yield index of the group and measure where a mean, as printed, is nearest to the paper's;
    nothing for a single group."""
    known = [means(group) for group in groups] if len(groups) > 1 else []
    for m in measures() if known else ():
        ours = [group[m.name] for group in known]
        if m.name in values and None not in ours:
            off = [abs(round(mean, m.digits) - values[m.name]) for mean in ours if mean is not None]
            yield from ((k, m.name) for k, far in enumerate(off) if isclose(far, min(off)))


def _choice(group: Group) -> str:
    """Return the name of a choice; for the preset, "preset", with its value if it is one of two."""
    if choice := choice_of(group):
        return choice
    setting, chosen = unprinted(group.config.algorithm), group.config.hyperparameters
    return f"{getattr(chosen, setting.field)} (preset)" if setting else "preset"


def ties_table(groups: Sequence[Group]) -> Table:
    """Return the table of EMCC of each third with both treatments of ties, and the paper's.

    EMCC is recomputed from the records of training, without training again.
    """
    columns = [measure(name) for name in EMCCS]
    rows: list[Row] = []
    for group in (group for own in by_task(groups).values() for group in own):
        name = f"{group.task}, {group.name}"
        values = group.printed
        both = [group, replace(group, runs=[_with_all_ties(run) for run in group.runs])]
        nearest = set(_nearest(both, values))
        for k, (way, own) in enumerate(zip(TIES, both, strict=True)):
            cells = [
                replace(number(group_mean(own, m.name), m.digits), marked=(k, m.name) in nearest)
                for m in columns
            ]
            rows.append(Row(f"{name}, ties {way}, mean of {len(own.runs)}", cells, kind="mean"))
        if values:
            theirs = [Number(values.get(m.name), m.digits) for m in columns]
            rows.append(Row(f"{name}, paper", theirs, kind="paper"))
    head = ["task, algorithm and ties", *(m.head for m in columns)]
    return Table(f"{OTHER_TIES_MEANING}; mean {INTERVALS}", head, rows, marking=MARKING)


def _with_all_ties(run: RunResult) -> RunResult:
    by_part = emcc_of_thirds(run.records, run.total_steps, ties="all")
    return replace(
        run, measures={**run.measures, **dict(zip(EMCCS, by_part.values(), strict=True))}
    )
