"""Claims and their evidence: the runs that count, findings as numbers, rules and verdicts."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

from agents.algorithms import algorithm
from agents.paper.presets import PAPER_ALGORITHMS, PAPER_STEPS, registered_id
from agents.paper.printed import choice_of, paper_results
from agents.reporting.table import Number, number, p_number
from agents.results.measures import measure
from agents.results.reading import Group, Run, one_place
from agents.results.statistics import LEVEL, Values, equivalence_of, known, mean_of, p_of
from circle2d_mj.registration import KINEMATIC
from emcc import Interval, Share, mean_interval, share
from emcc.statistics import UNBOUNDED, Bounds

Verdict = Literal["confirmed", "refuted", "undecided"]

SEEDS, SAFETY_SEEDS = 10, 3
"""Complete runs of the paper's length that an algorithm needs to decide anything, on Circle2D and
on a Safety task, whose runs are ten times as long: there the tests alone decide."""
LEVEL_TASKS = list(KINEMATIC.values())
EARLY, MIDDLE, LATE = "EMCC_0.33", "EMCC_0.66", "EMCC_0.99"
HALF, RARE = 0.5, 0.05
"""Shares of runs: "the runs do" is more than half; "there are runs that do" is more than one in
twenty."""


class Cell(NamedTuple):
    """The runs of an algorithm on a task with the preset, or with another choice of what the paper
    does not print."""

    task: str
    algorithm: str
    runs: tuple[Run, ...]
    lacking: str
    """Why they decide nothing: fewer than `SEEDS`, or of other length; empty where they decide."""
    full: bool = False
    """Whether they have the paper's length."""
    choice: str = ""
    """The other choice, a name of `presets.ablations`; empty for the preset."""

    @property
    def title(self) -> str:
        """The algorithm, with the other choice."""
        return self.named(algorithm(self.algorithm).title)

    def named(self, name: str) -> str:
        """A name, with the other choice."""
        return f"{name} with {self.choice}" if self.choice else name

    @property
    def printed(self) -> dict[str, float]:
        """The paper's numbers."""
        return paper_results(self.task, algorithm(self.algorithm).title)

    def share(self, does: Callable[[Run], bool], name: str, words: str) -> list[Fact]:
        """Share of runs that do something; nothing where there are no runs."""
        counted = sum(map(does, self.runs))
        return [Fact(name, share(counted, len(self.runs)), does=words)] if self.runs else []

    def mean(
        self,
        name: str,
        values: Values,
        printed: float | None,
        bounds: Bounds = UNBOUNDED,
    ) -> list[Fact]:
        """Mean over the runs beside the paper's number; nothing where there are no runs."""
        if not self.runs:
            return []
        return [Fact(name, mean_of(values, one_place(self.runs), bounds), printed)]

    def means(self, *measures: str) -> list[Fact]:
        """Means of measures."""
        facts = []
        for name in measures:
            values = [run.measures[name] for run in self.runs]
            facts += self.mean(name, values, self.printed[name], measure(name).bounds)
        return facts


class Fact(NamedTuple):
    """A number measured, beside the paper's."""

    name: str
    """A measure, an algorithm, a task."""
    value: Share | Interval | None
    """None where a run lacks it."""
    printed: float | None = None
    """The paper's, where it prints one."""
    does: str = ""
    """In words, behind a share: the thing that so many runs do."""
    signed: bool = False
    """Whether it is a change or a difference."""
    tests: Sequence[tuple[str, float | None]] = ()
    """P values, each with the name of its test."""


class Finding(NamedTuple):
    """A part of a claim: the numbers measured, and the verdict on them."""

    where: str
    """Task, algorithm or measure."""
    verdict: Verdict
    facts: Sequence[Fact]
    lacking: Mapping[str, Sequence[str]]
    """Algorithms or tasks that decide nothing, by the reason."""
    about: str = ""
    """In words, the event that the facts count, where their names do not say it."""
    claimed: str = ""
    """In words, the counts that the claim expects, likewise."""


Evidence = Mapping[tuple[str, str], Cell]
"""By task and algorithm, for all of the paper's."""


class Claim(NamedTuple):
    """A statement of the paper, and the rule that decides it."""

    text: str
    rule: str
    """In words, as it is printed beside the verdict."""
    check: Callable[[Evidence], list[Finding]]
    tasks: Sequence[str]
    """The claim is on these: without any runs on them it is left out."""


def gather(groups: Sequence[Group], choice: str = "") -> Evidence:
    """The runs of presets on the paper's tasks, or those with another choice of what the paper does
    not print; those with another setting are left out."""
    pairs = itertools.product(PAPER_STEPS, PAPER_ALGORITHMS)
    return {(task, name): _cell(groups, task, name, choice) for task, name in pairs}


def _cell(groups: Sequence[Group], task: str, name: str, choice: str) -> Cell:
    """Runs of the paper's length, one for each seed; where there are none, the longest of the
    others, which decide nothing."""
    lengths: dict[int, dict[int, Run]] = {}  # by steps and seed
    for group in groups:
        config = group.config
        same = registered_id(group.task) == task and config.algorithm == name
        usual = not config.task_parameters and group.cost == config.costs[0]
        if same and usual and group.runs and choice_of(group) == choice:
            before = lengths.setdefault(config.steps, {})
            measured = {run.seed: run for run in group.runs if _has(run, task, name)}
            lengths[config.steps] = measured | before
    lengths = {steps: runs for steps, runs in lengths.items() if runs}
    if not lengths:
        return Cell(task, name, (), "no runs", choice=choice)
    full = PAPER_STEPS[task]
    steps = full if full in lengths else max(lengths)
    lacking = ""
    if steps != full:
        lacking = f"{steps:,} of {full:,} steps"
    elif len(lengths[steps]) < (needed := SEEDS if task in LEVEL_TASKS else SAFETY_SEEDS):
        lacking = f"{len(lengths[steps])} of {needed} runs"
    return Cell(task, name, tuple(lengths[steps].values()), lacking, steps == full, choice)


def _has(run: Run, task: str, name: str) -> bool:
    """Whether a run has all that the paper prints."""
    printed = paper_results(task, algorithm(name).title)
    return all(run.measures[measure] is not None for measure in printed)


def all_of(verdicts: Iterable[Verdict]) -> Verdict:
    """The verdict on a claim that holds where all its parts hold: one that does not refutes it."""
    parts = set(verdicts)
    return "refuted" if "refuted" in parts else "undecided" if "undecided" in parts else "confirmed"


def any_of(verdicts: Iterable[Verdict]) -> Verdict:
    """The verdict on a claim that holds where one of its parts holds: one that does confirms it."""
    parts = set(verdicts)
    if "confirmed" in parts:
        return "confirmed"
    return "undecided" if "undecided" in parts else "refuted"


def opposite(verdict: Verdict) -> Verdict:
    """The verdict on the claim that it is not so."""
    opposites: dict[Verdict, Verdict] = {"confirmed": "refuted", "refuted": "confirmed"}
    return opposites.get(verdict, "undecided")


def judge(cell: Cell, rule: Callable[[Sequence[Run]], Verdict]) -> Verdict:
    """The rule's verdict; undecided where runs are lacking."""
    return "undecided" if cell.lacking else rule(cell.runs)


def refuting(parts: int) -> float:
    """Level of the interval whose either end is a one-sided bound at `LEVEL` over the parts of a
    claim: a claim is refuted by any of them, so that their errors add up."""
    return 1 - 2 * LEVEL / parts


def mostly(count: int, runs: int, parts: int) -> Verdict:
    """The verdict on "the runs do": the share's interval is above a half; refuted where below."""
    if share(count, runs).low > HALF:
        return "confirmed"
    return "refuted" if share(count, runs, refuting(parts)).high < HALF else "undecided"


def some(count: int, runs: int, parts: int) -> Verdict:
    """The verdict on "there are runs that do": the share's interval is above `RARE`; refuted where
    no run does and the interval is below a half."""
    if share(count, runs).low > RARE:
        return "confirmed"
    nobody = count == 0 and share(count, runs, refuting(parts)).high < HALF
    return "refuted" if nobody else "undecided"


def none(count: int, runs: int, parts: int) -> Verdict:
    """The verdict on "no run does": none does and the share's interval is below a half; refuted
    where the interval is above `RARE`."""
    if count == 0 and share(count, runs).high < HALF:
        return "confirmed"
    return "refuted" if share(count, runs, refuting(parts)).low > RARE else "undecided"


def about(values: Values, printed: float, parts: int) -> Verdict:
    """The verdict on "the mean is about": its whole interval is within a fifth of the number;
    refuted where it lies wholly farther away."""
    numbers, near = known(values), (0.8 * printed, 1.2 * printed)
    if numbers is None:
        return "undecided"
    mean, wide = mean_interval(numbers), mean_interval(numbers, refuting(parts))
    if mean.low is None or mean.high is None or wide.low is None or wide.high is None:
        return "undecided"
    if mean.kind == "t" and near[0] <= mean.low and mean.high <= near[1]:
        return "confirmed"
    farther = wide.low > near[1] or wide.high < near[0]
    return "refuted" if mean.kind == "t" and farther else "undecided"


def equal(a: Values, b: Values, margin: float, parts: int) -> Verdict:
    """The verdict on "the means are equal": equivalent within the margin; refuted where they are
    not and the permutation test tells them apart."""
    equivalence, p = equivalence_of(a, b, margin), p_of(a, b)
    if equivalence is None or p is None:
        return "undecided"
    if equivalence <= LEVEL:
        return "confirmed"
    return "refuted" if p <= LEVEL / parts else "undecided"


def apart(a: Values, b: Values, margin: float, parts: int) -> Verdict:
    """The verdict on "the means differ": the permutation test tells them apart; refuted where they
    are equivalent within the margin."""
    equivalence, p = equivalence_of(a, b, margin), p_of(a, b)
    if equivalence is None or p is None:
        return "undecided"
    if equivalence <= LEVEL / parts:
        return "refuted"
    return "confirmed" if p <= LEVEL else "undecided"


def lower(a: Values, b: Values, parts: int) -> Verdict:
    """The verdict on "the mean of a is below that of b": it is, and the permutation test tells them
    apart; refuted where it tells them apart the other way round."""
    first, second, p = known(a), known(b), p_of(a, b)
    if first is None or second is None or p is None:
        return "undecided"
    if sum(first) / len(first) < sum(second) / len(second):
        return "confirmed" if p <= LEVEL else "undecided"
    return "refuted" if p <= LEVEL / parts else "undecided"


def finding(
    where: str,
    verdict: Verdict,
    cells: Sequence[Cell],
    facts: Sequence[Fact],
    about: str = "",
    claimed: str = "",
) -> Finding:
    """A finding that names the runs it lacks: by task where all are of one algorithm."""
    by_task = len(cells) > 1 and len({cell.algorithm for cell in cells}) == 1
    lacking: dict[str, list[str]] = {}
    for cell in (cell for cell in cells if cell.lacking):
        name = short(cell.task) if by_task else cell.title
        lacking.setdefault(cell.lacking, []).append(name)
    return Finding(where, verdict, facts, lacking, about, claimed)


def short(task: str) -> str:
    """Circle2D-1 for Circle2D-1-v0, SafetyPointGoal1 for circle2d_mj/SafetyPointGoal1-v0."""
    return task.rpartition("/")[2].rpartition("-")[0]


def worded(findings: Iterable[Finding]) -> list[tuple[str, str]]:
    """Each finding in words, and its verdict."""
    return [(_words(finding), finding.verdict) for finding in findings]


def _words(finding: Finding) -> str:
    """The place, the numbers, and the runs that are lacking."""
    facts = ", ".join(map(_fact, finding.facts))
    if facts and finding.about:
        facts = f"{finding.about}: {facts} (claimed: {finding.claimed})"
    lacking = [f"{why}: {', '.join(names)}" for why, names in finding.lacking.items()]
    return f"{finding.where}: " + "; ".join([*([facts] if facts else []), *lacking])


def _fact(fact: Fact) -> str:
    value = fact.value
    if isinstance(value, Share):
        words = f"{value.count} of {value.runs} runs [{value.low:.2f}, {value.high:.2f}]"
        return f"{fact.name} {words} {fact.does}".strip()
    words, beside = str(number(value, signed=fact.signed)), []
    if value is not None:
        beside.append(f"n = {value.runs}")
    if fact.printed is not None:
        beside.append(f"paper {Number(fact.printed, signed=fact.signed)}")
    beside += [f"{name}: {p_number(p)}" for name, p in fact.tests]
    return f"{fact.name} {words} ({'; '.join(beside)})".lstrip()
