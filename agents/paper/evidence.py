"""Evidence for a claim: the runs that count, findings as numbers, verdicts and how they combine."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

from agents.algorithms import algorithm
from agents.paper.presets import PAPER_ALGORITHMS, PAPER_SEEDS, PAPER_STEPS, registered_id
from agents.paper.printed import paper_results
from agents.paper.settings import changes
from agents.results.reading import Group, Run
from agents.results.statistics import mean_of
from emcc import Difference, Estimate

Verdict = Literal["confirmed", "refuted", "open"]


class Cell(NamedTuple):
    """The runs of an algorithm on a task with the paper's settings."""

    task: str
    algorithm: str
    runs: tuple[Run, ...]
    lacking: str
    """Why they decide nothing: fewer than the paper's, or of other length; empty where they do."""

    @property
    def title(self) -> str:
        """Of the algorithm."""
        return algorithm(self.algorithm).title

    @property
    def printed(self) -> dict[str, float]:
        """The paper's numbers."""
        return paper_results(self.task, self.title)

    def share(self, does: Callable[[Run], bool], words: str = "") -> Share:
        """Number of runs that do something."""
        return Share(sum(map(does, self.runs)), len(self.runs), words)

    def mean(self, measure: str) -> Estimate | None:
        """Of a measure; None where there are no runs or one lacks it."""
        return mean_of([run.measures[measure] for run in self.runs])

    def means(self, *measures: str) -> list[Fact]:
        """Means beside the paper's numbers; nothing where there are no runs."""
        return [Fact(name, self.mean(name), self.printed[name]) for name in measures if self.runs]


class Share(NamedTuple):
    """Number of runs that do something."""

    number: int
    of: int
    does: str = ""
    """In words, where the fact's name does not say it."""


class Fact(NamedTuple):
    """A number measured, beside the paper's."""

    name: str
    """Of what: a measure, an algorithm, a task."""
    value: Share | Estimate | Difference | None
    """None where a run lacks it."""
    printed: float | None = None
    """The paper's, where it prints one."""


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


def gather(groups: Sequence[Group]) -> Evidence:
    """The runs of presets on the paper's tasks, those with another setting left out."""
    pairs = itertools.product(PAPER_STEPS, PAPER_ALGORITHMS)
    return {(task, name): _cell(groups, task, name) for task, name in pairs}


def _cell(groups: Sequence[Group], task: str, name: str) -> Cell:
    """Runs of the paper's length, one for each seed; where there are none, the longest of the
    others, which decide nothing."""
    found: dict[int, dict[int, Run]] = {}  # by steps and seed
    for group in groups:
        config = group.config
        same = registered_id(config.task) == task and config.algorithm == name
        if same and group.runs and not changes(config):
            of_length = found.setdefault(config.steps, {})
            measured = {run.seed: run for run in group.runs if _has(run, task, name)}
            found[config.steps] = measured | of_length
    found = {steps: runs for steps, runs in found.items() if runs}
    if not found:
        return Cell(task, name, (), "no runs")
    full = PAPER_STEPS[task]
    steps = full if full in found else max(found)
    lacking = ""
    if steps != full:
        lacking = f"{steps:,} of {full:,} steps"
    elif len(found[steps]) < PAPER_SEEDS:
        lacking = f"{len(found[steps])} of {PAPER_SEEDS} runs"
    return Cell(task, name, tuple(found[steps].values()), lacking)


def _has(run: Run, task: str, name: str) -> bool:
    """Whether a run has all that the paper prints."""
    printed = paper_results(task, algorithm(name).title)
    return all(run.measures[measure] is not None for measure in printed)


def all_of(verdicts: Iterable[Verdict]) -> Verdict:
    """Of a claim that holds where all its parts hold: one that does not refutes it."""
    found = set(verdicts)
    return "refuted" if "refuted" in found else "open" if "open" in found else "confirmed"


def any_of(verdicts: Iterable[Verdict]) -> Verdict:
    """Of a claim that holds where one of its parts holds: one that does confirms it."""
    found = set(verdicts)
    return "confirmed" if "confirmed" in found else "open" if "open" in found else "refuted"


def opposite(verdict: Verdict) -> Verdict:
    """Of the claim that it is not so."""
    return "refuted" if verdict == "confirmed" else "confirmed" if verdict == "refuted" else "open"


def judge(cell: Cell, rule: Callable[[Sequence[Run]], Verdict]) -> Verdict:
    """The rule's verdict; open where runs are lacking."""
    return "open" if cell.lacking else rule(cell.runs)


def most(count: int, of: int) -> Verdict:
    """Of "the runs do": all do, half or fewer do, or it is undecided."""
    return "confirmed" if count == of else "refuted" if 2 * count <= of else "open"


def some(count: int) -> Verdict:
    """Of "there are runs that do"."""
    return "confirmed" if count else "refuted"


def none(count: int) -> Verdict:
    """Of "no run does"."""
    return "refuted" if count else "confirmed"


def about(mean: Estimate | None, printed: float) -> Verdict:
    """Of "the mean is about": it is within a fifth of the number; refuted where the whole 95 %
    interval over seeds is farther away."""
    if mean is None:
        return "open"
    near = 0.8 * printed, 1.2 * printed
    if near[0] <= mean.value <= near[1]:
        return "confirmed"
    if mean.low is None or mean.high is None:
        return "open"
    return "refuted" if mean.low > near[1] or mean.high < near[0] else "open"


def below_zero(mean: Estimate | None) -> Verdict:
    """Of "it falls": the 95 % interval over seeds of the changes is below 0; refuted where it has
    nothing below 0."""
    if mean is None or mean.low is None or mean.high is None:
        return "open"
    return "confirmed" if mean.high < 0 else "refuted" if mean.low >= 0 else "open"


def apart(gap: Difference | None) -> Verdict:
    """Of "the two differ": the 95 % interval of the difference of means leaves out 0."""
    if gap is None or gap.low is None or gap.high is None:
        return "open"
    return "confirmed" if gap.low > 0 or gap.high < 0 else "open"


def equal(gap: Difference | None) -> Verdict:
    """Of "the two cannot be told apart": that interval has 0 in it."""
    if gap is None or gap.low is None:
        return "open"
    return "refuted" if apart(gap) == "confirmed" else "confirmed"


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
