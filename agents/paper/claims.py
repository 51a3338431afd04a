"""The paper's claims, each with the rule that decides it, checked against trained runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from agents.paper.evidence import (
    Cell,
    Evidence,
    Fact,
    Finding,
    Verdict,
    about,
    all_of,
    any_of,
    apart,
    below_zero,
    equal,
    finding,
    gather,
    judge,
    most,
    none,
    opposite,
    short,
    some,
)
from agents.paper.presets import PAPER_STEPS, preset
from agents.results.reading import Group, Run
from agents.results.statistics import difference_of, mean_of
from circle2d_mj.registration import KINEMATIC

ON_POLICY, OFF_POLICY = ("trpo-lag", "cpo"), ("sac-lag", "sac-lb", "wcsac")
EVERYONE = (*ON_POLICY, *OFF_POLICY)
LEVEL_TASKS = list(KINEMATIC.values())
LIMIT = preset("cpo", LEVEL_TASKS[0]).cost_limit
EARLY, MIDDLE, LATE = "EMCC_0.33", "EMCC_0.66", "EMCC_0.99"


class Claim(NamedTuple):
    """A statement of the paper, and the rule that decides it."""

    text: str
    rule: str
    """In words, as it is printed beside the verdict."""
    check: Callable[[Evidence], list[Finding]]


class Checked(NamedTuple):
    """A claim with what was found; confirmed where all parts are, refuted where one is."""

    claim: Claim
    findings: list[Finding]
    verdict: Verdict


def in_corridor(run: Run) -> bool:
    """Whether a run's evaluated episodes end in the left corridor more often than elsewhere."""
    return run.end == "corridor"


def within(run: Run) -> bool:
    """Whether a run keeps the cost limit of Circle2D in its evaluation."""
    cost = run.measures["J_C"]
    return cost is not None and cost <= LIMIT


def _safely(run: Run) -> bool:
    return in_corridor(run) and within(run)


def _straight(run: Run) -> bool:
    return in_corridor(run) and not within(run)


def _straight_through(evidence: Evidence) -> list[Finding]:
    def rule(runs: Sequence[Run]) -> Verdict:
        costs, late = (mean_of([run.measures[name] for run in runs]) for name in ("J_C", LATE))
        through = most(sum(map(_straight, runs)), len(runs))
        return all_of([through, about(costs, 9), about(late, 0.2)])

    findings = []
    for task in LEVEL_TASKS[1:]:
        cell = evidence[task, "trpo-lag"]
        facts = [Fact("", cell.share(_straight, "go through")), *cell.means("J_C", LATE)]
        findings.append(finding(short(task), judge(cell, rule), [cell], facts))
    return findings


STRAIGHT_THROUGH = Claim(
    "TRPO-Lag ignores the region on levels 1 to 3 and goes straight through, at a cost of "
    "about 9 and a late EMCC of about 0.2.",
    "On each level every run ends in the corridor with J_C above the limit, and the means of "
    "J_C and EMCC_0.99 are within a fifth of 9 and of 0.2. Refuted on a level where half the "
    "runs or fewer do so, or where a mean's interval lies wholly outside that fifth.",
    _straight_through,
)


def _trend(evidence: Evidence) -> list[Finding]:
    """A finding for each algorithm, over all tasks."""
    findings = []
    for name in (*ON_POLICY, *OFF_POLICY):
        cells = [evidence[task, name] for task in PAPER_STEPS]
        falls: list[Verdict] = [
            judge(cell, lambda runs: below_zero(mean_of(_changes(runs)))) for cell in cells
        ]
        verdict = all_of(falls) if name in ON_POLICY else any_of(map(opposite, falls))
        facts = [_change(cell) for cell in cells if cell.runs]
        findings.append(finding(cells[0].title, verdict, cells, facts))
    return findings


def _changes(runs: Sequence[Run]) -> list[float | None]:
    pairs = ((run.measures[LATE], run.measures[EARLY]) for run in runs)
    return [None if late is None or early is None else late - early for late, early in pairs]


def _change(cell: Cell) -> Fact:
    printed = cell.printed[LATE] - cell.printed[EARLY]
    return Fact(short(cell.task), mean_of(_changes(cell.runs)), printed)


TREND = Claim(
    "EMCC of the on-policy methods falls over training on every task; the off-policy methods "
    "show no such trend.",
    "The change is EMCC_0.99 - EMCC_0.33 of each run. It falls where the interval of its mean "
    "is below 0, and does not where the interval has nothing below 0. An on-policy method must "
    "fall on every task; an off-policy method must not fall on one task at least, and is "
    "refuted where it falls on all.",
    _trend,
)


def _corridor(evidence: Evidence) -> list[Finding]:
    level_0, level_1 = LEVEL_TASKS[:2]
    others = tuple(name for name in EVERYONE if name != "sac-lb")
    return [
        _runs_that(evidence, level_0, ("sac-lag", "sac-lb"), some, in_corridor),
        _runs_that(evidence, level_0, (*ON_POLICY, "wcsac"), none, in_corridor),
        _runs_that(evidence, level_1, ("sac-lb",), some, _safely),
        _runs_that(evidence, level_1, others, none, _safely),
    ]


CORRIDOR = Claim(
    "On level 0 only SAC-Lag and SAC-LB have runs that end in the left corridor; on level 1 "
    "only SAC-LB has, within the cost limit.",
    "The named methods each have such a run, the others have none. Level 0: the run ends in "
    "the corridor; level 1: and its J_C is within the limit.",
    _corridor,
)


def _nobody(evidence: Evidence) -> list[Finding]:
    return [_runs_that(evidence, task, EVERYONE, none, _safely) for task in LEVEL_TASKS[2:]]


NOBODY = Claim(
    "Nobody ends inside the corridor within the limit on levels 2 and 3.",
    "No run of any of the five methods ends in the corridor with J_C within the limit.",
    _nobody,
)


def _runs_that(
    evidence: Evidence,
    task: str,
    names: Sequence[str],
    rule: Callable[[int], Verdict],
    does: Callable[[Run], bool],
) -> Finding:
    """Whether each algorithm has runs that end in the corridor, or none has (the rule)."""
    cells = [evidence[task, name] for name in names]
    verdict = all_of(judge(cell, lambda runs: rule(sum(map(does, runs)))) for cell in cells)
    facts = [Fact(cell.title, cell.share(does)) for cell in cells if cell.runs]
    where = "in the corridor" + (" within the limit" if does is _safely else "")
    expected = "each has some" if rule is some else "none has any"
    return finding(short(task), verdict, cells, facts, where, expected)


def _low_cost(evidence: Evidence) -> list[Finding]:
    findings = []
    for task in (LEVEL_TASKS[0], LEVEL_TASKS[1], LEVEL_TASKS[3]):
        cell = evidence[task, "wcsac"]
        verdict = judge(cell, lambda runs: most(sum(map(_settled, runs)), len(runs)))
        later = Fact("episode cost after the first third", mean_of(_later_costs(cell.runs)))
        facts = [Fact("", cell.share(_settled, "do so")), *cell.means("J_C"), later]
        findings.append(finding(short(task), verdict, [cell], facts if cell.runs else []))
    return findings


def _settled(run: Run) -> bool:
    return not in_corridor(run) and within(run) and _later_costs([run])[0] <= LIMIT


def _later_costs(runs: Sequence[Run]) -> list[float]:
    """Mean cost return of the episodes that start after the first third of training."""
    later = [3 * run.records.start_step >= run.records.total_steps for run in runs]
    return [float(run.records.cost[of].mean()) for run, of in zip(runs, later, strict=True)]


LOW_COST = Claim(
    "WCSAC goes early to a local optimum at low cost, but for level 2.",
    "On levels 0, 1 and 3 every run ends outside the corridor with J_C within the limit, and "
    "the mean cost of its training episodes after the first third is within it too. Refuted on "
    "a level where half the runs or fewer do so.",
    _low_cost,
)


def _told_apart(evidence: Evidence) -> list[Finding]:
    cpo, wcsac = cells = [evidence[LEVEL_TASKS[3], name] for name in ("cpo", "wcsac")]
    decided = not cpo.lacking and not wcsac.lacking
    findings = []
    for name, rule in (("cost_rate", equal), (MIDDLE, apart), (LATE, apart)):
        gap = difference_of(*([run.measures[name] for run in cell.runs] for cell in cells))
        fact = Fact("WCSAC - CPO", gap, wcsac.printed[name] - cpo.printed[name])
        facts = [fact] if cpo.runs and wcsac.runs else []
        findings.append(finding(name, rule(gap) if decided else "open", cells, facts))
    return findings


TOLD_APART = Claim(
    "CPO and WCSAC have equal cost rates on level 3 and different EMCC: EMCC tells apart what "
    "the cost rate cannot.",
    "The interval of the difference of cost rates has 0 in it (refuted where it has not), those "
    "of the differences of EMCC_0.66 and EMCC_0.99 have not.",
    _told_apart,
)


CLAIMS = (STRAIGHT_THROUGH, TREND, CORRIDOR, LOW_COST, NOBODY, TOLD_APART)
"""In the order of the paper's sections Results and Analysis."""


def check_claims(groups: Sequence[Group]) -> list[Checked]:
    """Every claim against the runs of the paper's grid; nothing where no algorithm has them.

    Runs with other settings or task parameters decide nothing, and neither do runs of other length
    than the paper's, or fewer.
    """
    evidence = gather(groups)
    if all(cell.lacking for cell in evidence.values()):
        return []
    checked = []
    for claim in CLAIMS:
        findings = claim.check(evidence)
        checked.append(Checked(claim, findings, all_of(part.verdict for part in findings)))
    return checked
