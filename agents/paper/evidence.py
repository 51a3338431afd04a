"""Evidence for claims: the paper's numbers, the runs that count, findings, and verdicts."""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from typing import Any, Literal, NamedTuple

from agents.algorithms import title
from agents.paper.grid import PAPER_ALGORITHMS, PAPER_SEEDS, ablations
from agents.presets import PAPER_STEPS, registered_id
from agents.reporting.table import Number, number, p_number
from agents.results.groups import Group, RunResult, one_place
from agents.results.measures import measure
from agents.results.names import hyperparameter_changes
from agents.results.statistics import (
    LEVEL,
    Values,
    difference_of,
    equivalence_of,
    known,
    mean_of,
    p_of,
)
from circle2d_mj.registration import KINEMATIC
from emcc import Interval, mean_interval, share
from emcc.statistics import UNBOUNDED, Bounds

Verdict = Literal["reproduced", "not reproduced", "undecided"]
Count = Callable[[int, int, int], Verdict]
"""A rule: from the number of runs that do something, the number of all runs, and the number of
parts of the claim."""
Value = str | Callable[[RunResult], float | None]
"""A measure's name, or a function that computes another number of a run."""

SEEDS, SAFETY_SEEDS = 10, 3
"""Fewest complete runs of the paper's length from which claims about an algorithm are decided, on
Circle2D and on a Safety task; Safety runs are ten times as long, and there only tests decide."""
LEVEL_TASKS = list(KINEMATIC.values())
EARLY, MIDDLE, LATE = "EMCC_0.33", "EMCC_0.66", "EMCC_0.99"
HALF, RARE = 0.5, 0.05
"""Thresholds on shares of runs: "the runs do" means more than half, "there are runs that do" more
than one in twenty."""


def paper_results(task: str, title: str) -> dict[str, float]:
    """Return the paper's numbers for an algorithm on a task, by measure; empty if it has none.

    title: of the algorithm, as the paper prints it.
    """
    name = registered_id(task)
    name = name.removesuffix("-v0") if name.startswith("Circle2D-") else name.split("/")[-1]
    return {
        measure: _as_meant(name, title, measure, values[title])
        for measure, values in _numbers()["results"].get(name, {}).items()
        if title in values
    }


@functools.cache
def _numbers() -> dict[str, Any]:
    return json.loads(files("agents.paper").joinpath("printed.json").read_text())


def _as_meant(task: str, title: str, measure: str, value: float) -> float:
    """Correct a misprint: the paper prints 4.68, but no return of this task can be positive."""
    is_misprint = (task, title, measure) == ("Circle2D-1", "TRPO-Lag", "J_R")
    return -value if is_misprint else value


def printed(group: Group) -> Group:
    """Return the group with the paper's numbers for its algorithm and task; without them if the
    task has other parameters than the paper's."""
    values = paper_results(group.task, title(group.config.algorithm))
    if not values or group.config.task_parameters:
        return group
    return replace(group, printed=values, publication=f"paper ({PAPER_SEEDS} seeds)")


def choice_of(group: Group) -> str | None:
    """Return the name in `grid.ablations` of a group's differences from the preset: empty if there
    are none, None if the differences are not among the ablations."""
    changed = hyperparameter_changes(group.config, group.task)
    named = {"": {}} | ablations(group.config.algorithm, group.task)
    return next((name for name, values in named.items() if values == changed), None)


class Finding(NamedTuple):
    """A part of a claim: the measured numbers in words, and the verdict on them."""

    words: str
    verdict: Verdict


class Cell(NamedTuple):
    """The runs of an algorithm on a task, with the preset or another choice of what the paper does
    not specify."""

    task: str
    algorithm: str
    runs: tuple[RunResult, ...]
    lacking: str
    """Why the runs are inconclusive (too few seeds, wrong length); empty if they count."""
    full: bool = False
    """Whether the runs have the paper's length."""
    choice: str = ""
    """The other choice, a name of `grid.ablations`; empty for the preset."""

    @property
    def title(self) -> str:
        """The algorithm, with the other choice if there is one."""
        return self.named(title(self.algorithm))

    def named(self, name: str) -> str:
        """Return a name, with the other choice if there is one."""
        return f"{name} with {self.choice}" if self.choice else name

    @property
    def printed(self) -> dict[str, float]:
        """The paper's numbers."""
        return paper_results(self.task, title(self.algorithm))

    def values(self, of: Value) -> list[float | None]:
        """Return a measure, or another number, of each run."""
        return [run.measures[of] if isinstance(of, str) else of(run) for run in self.runs]

    def judged(self, rule: Count, does: Callable[[RunResult], bool], parts: int) -> Verdict:
        """Return a rule's verdict on how many runs do something; undecided if runs are lacking."""
        if self.lacking:
            return "undecided"
        return rule(sum(map(does, self.runs)), len(self.runs), parts)

    def share(self, does: Callable[[RunResult], bool], name: str, words: str) -> list[str]:
        """Return in words the share of runs that do something; empty without runs."""
        if not self.runs:
            return []
        told = share(sum(map(does, self.runs)), len(self.runs))
        counted = f"{told.count} of {told.runs} runs [{told.low:.2f}, {told.high:.2f}]"
        return [f"{name} {counted} {words}".strip()]

    def mean(
        self,
        name: str,
        of: Value,
        printed: float | None,
        bounds: Bounds = UNBOUNDED,
        signed: bool = False,
    ) -> list[str]:
        """Return in words the mean over the runs and the paper's number; empty without runs."""
        mean = mean_of(self.values(of), one_place(self.runs), bounds)
        return [in_words(name, mean, printed, signed=signed)] if self.runs else []

    def means(self, *names: str) -> list[str]:
        """Return in words the means of several measures."""
        several = (self.mean(n, n, self.printed[n], measure(n).bounds) for n in names)
        return [words for mean in several for words in mean]


def in_words(
    name: str,
    value: Interval | None,
    printed: float | None,
    tests: Sequence[tuple[str, float | None]] = (),
    signed: bool = False,
    runs: Sequence[int] = (),
) -> str:
    """Return in words a mean, or a signed difference, with the paper's number, if any, and p values
    with the names of their tests. value: None if a run lacks it. runs: number on each side of a
    difference."""
    sides = [] if value is None else dict.fromkeys(runs or [value.runs])
    beside = [f"n = {' and '.join(map(str, sides))}"] if sides else []
    if printed is not None:
        beside.append(f"paper {Number(printed, signed=signed)}")
    beside += [f"{test}: {p_number(p)}" for test, p in tests]
    return f"{name} {number(value, signed=signed)} ({'; '.join(beside)})".lstrip()


def difference_in_words(
    a: Cell,
    b: Cell,
    of: Value,
    tests: Sequence[tuple[str, float | None]],
) -> list[str]:
    """Return in words the mean of b minus the mean of a; empty if a side has no runs."""
    if not (a.runs and b.runs):
        return []
    gap = difference_of(a.values(of), b.values(of), one_place(a.runs) and one_place(b.runs))
    printed = b.printed[of] - a.printed[of] if isinstance(of, str) else None
    runs = (len(b.runs), len(a.runs))
    return [in_words(f"{b.title} - {a.title}", gap, printed, tests, signed=True, runs=runs)]


Evidence = Mapping[tuple[str, str], Cell]
"""Cells by task and algorithm, for all tasks and algorithms of the paper."""


class Claim(NamedTuple):
    """A statement of the paper, and the rule that decides it."""

    text: str
    rule: str
    """The rule in words, printed beside the verdict."""
    check: Callable[[Evidence], list[Finding]]
    tasks: Sequence[str]
    """Tasks that the claim is about; without runs on any of them the claim is left out."""
    across: bool = False
    """Whether the claim compares EMCC of on- and off-policy methods, which needs windows: see
    `agents.results.statistics.ACROSS`."""


def gather(groups: Sequence[Group], choice: str = "") -> Evidence:
    """Collect the runs on the paper's tasks that have preset settings or, if given, another choice
    of what the paper does not specify. Runs with any other setting are left out."""
    pairs = itertools.product(PAPER_STEPS, PAPER_ALGORITHMS)
    return {(task, name): _cell(groups, task, name, choice) for task, name in pairs}


def _cell(groups: Sequence[Group], task: str, name: str, choice: str) -> Cell:
    """Collect the runs of the paper's length that have all measures it prints, one for each seed.

    If there are none, the longest others are taken, which decide nothing."""
    needed, printed = PAPER_STEPS[task], paper_results(task, title(name))
    by_steps: dict[int, dict[int, RunResult]] = {}  # by seed
    for group in groups:
        config = group.config
        same = registered_id(group.task) == task and config.algorithm == name
        usual = not config.task_parameters and group.is_of_first_cost
        for run in group.runs if same and usual and choice_of(group) == choice else ():
            if all(run.measures[measure] is not None for measure in printed):
                by_steps.setdefault(group.total_steps, {}).setdefault(run.seed, run)
    if not by_steps:
        return Cell(task, name, (), "no runs", choice=choice)
    steps = needed if needed in by_steps else max(by_steps)
    runs, enough = tuple(by_steps[steps].values()), SEEDS if task in LEVEL_TASKS else SAFETY_SEEDS
    lacking = f"{len(runs)} of {enough} runs" if len(runs) < enough else ""
    if steps != needed:
        lacking = f"{steps:,} of {needed:,} steps"
    return Cell(task, name, runs, lacking, steps == needed, choice)


def all_of(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict on a claim that holds if all its parts hold: one failure decides."""
    parts = set(verdicts)
    if "not reproduced" in parts:
        return "not reproduced"
    return "undecided" if "undecided" in parts else "reproduced"


def any_of(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict on a claim that holds if any part holds: one that holds decides."""
    parts = set(verdicts)
    if "reproduced" in parts:
        return "reproduced"
    return "undecided" if "undecided" in parts else "not reproduced"


def opposite(verdict: Verdict) -> Verdict:
    """Return the verdict on the negated claim."""
    return _verdict(verdict == "not reproduced", verdict == "reproduced")


def _verdict(holds: bool, fails: bool) -> Verdict:
    return "reproduced" if holds else "not reproduced" if fails else "undecided"


def against(parts: int) -> float:
    """Return the level of the interval to decide against a claim of several parts.

    Each end of the interval is a one-sided bound at `LEVEL` / parts: any part can decide against
    the claim, so the error probabilities add up."""
    return 1 - 2 * LEVEL / parts


def mostly(count: int, runs: int, parts: int) -> Verdict:
    """Judge "the runs do": reproduced if the share's interval is above a half, not if below."""
    wide = share(count, runs, against(parts))
    return _verdict(share(count, runs).low > HALF, wide.high < HALF)


def some(count: int, runs: int, parts: int) -> Verdict:
    """Judge "there are runs that do": reproduced if the share's interval is above `RARE`; not
    reproduced if no run does and the interval is below a half."""
    wide = share(count, runs, against(parts))
    return _verdict(share(count, runs).low > RARE, count == 0 and wide.high < HALF)


def none(count: int, runs: int, parts: int) -> Verdict:
    """Judge "no run does": reproduced if none does and the share's interval is below a half; not
    reproduced if the interval is above `RARE`."""
    wide = share(count, runs, against(parts))
    return _verdict(count == 0 and share(count, runs).high < HALF, wide.low > RARE)


def about(values: Values, printed: float, parts: int) -> Verdict:
    """Judge "the mean is about `printed`": reproduced if its whole interval is within a fifth of
    the number; not reproduced if the whole interval is farther away."""
    numbers, near = known(values), (0.8 * printed, 1.2 * printed)
    if numbers is None:
        return "undecided"
    mean, wide = mean_interval(numbers), mean_interval(numbers, against(parts))
    if mean.kind != "t" or mean.low is None or mean.high is None:
        return "undecided"
    farther = wide.low > near[1] or wide.high < near[0]  # pyright: ignore
    return _verdict(near[0] <= mean.low and mean.high <= near[1], farther)


def equal(a: Values, b: Values, margin: float, parts: int) -> Verdict:
    """Judge "the means are equal": reproduced if they are equivalent within the margin; not
    reproduced if they are not and the permutation test tells them apart."""
    equivalence, p = equivalence_of(a, b, margin), p_of(a, b)
    if equivalence is None or p is None:
        return "undecided"
    return _verdict(equivalence <= LEVEL, p <= LEVEL / parts)


def apart(a: Values, b: Values, margin: float, parts: int) -> Verdict:
    """Judge "the means differ": reproduced if the permutation test tells them apart; not reproduced
    if they are equivalent within the margin."""
    equivalence, p = equivalence_of(a, b, margin), p_of(a, b)
    if equivalence is None or p is None:
        return "undecided"
    fails = equivalence <= LEVEL / parts
    return _verdict(p <= LEVEL and not fails, fails)


def lower(a: Values, b: Values, parts: int) -> Verdict:
    """Judge "the mean of a is below the mean of b": reproduced if it is and the permutation test
    tells them apart; not reproduced if the test tells them apart the other way round."""
    first, second, p = known(a), known(b), p_of(a, b)
    if first is None or second is None or p is None:
        return "undecided"
    below = sum(first) / len(first) < sum(second) / len(second)
    return _verdict(below and p <= LEVEL, not below and p <= LEVEL / parts)


def finding(where: str, verdict: Verdict, cells: Sequence[Cell], facts: Sequence[str]) -> Finding:
    """Return a finding that names the cells that lack runs, by task if all have one algorithm."""
    by_task = len(cells) > 1 and len({cell.algorithm for cell in cells}) == 1
    lacking: dict[str, list[str]] = {}
    for cell in (cell for cell in cells if cell.lacking):
        lacking.setdefault(cell.lacking, []).append(short(cell.task) if by_task else cell.title)
    told = [", ".join(facts)] if facts else []
    told += [f"{why}: {', '.join(names)}" for why, names in lacking.items()]
    return Finding(f"{where}: {'; '.join(told)}", verdict)


def short(task: str) -> str:
    """Return a task's short name: SafetyPointGoal1 for circle2d_mj/SafetyPointGoal1-v0."""
    return task.rpartition("/")[2].rpartition("-")[0]
