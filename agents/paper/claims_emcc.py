"""The paper's claims about EMCC, each with the rule that decides it."""

from __future__ import annotations

import itertools

from agents.algorithms import title
from agents.paper.evidence import (
    EARLY,
    LATE,
    LEVEL_TASKS,
    MIDDLE,
    Cell,
    Claim,
    Evidence,
    Fact,
    Finding,
    Verdict,
    all_of,
    any_of,
    apart,
    equal,
    finding,
    judge,
    lower,
    mostly,
    opposite,
    short,
)
from agents.paper.presets import PAPER_ALGORITHMS, PAPER_STEPS
from agents.results.reading import Run, one_place
from agents.results.separation import MARGIN
from agents.results.statistics import difference_of, equivalence_of, p_of

ON_POLICY = ("trpo-lag", "cpo")
RATE_MARGIN, EMCC_MARGIN = MARGIN, 0.05
"""Differences of means up to which two cost rates, or two EMCC, are taken as equal."""


def _trend(evidence: Evidence) -> list[Finding]:
    """A finding for each algorithm, over all tasks."""
    findings, parts = [], len(PAPER_STEPS) * len(PAPER_ALGORITHMS)
    for name in PAPER_ALGORITHMS:
        cells = [evidence[task, name] for task in PAPER_STEPS]
        falls: list[Verdict] = [
            judge(cell, lambda runs: mostly(sum(map(_falls, runs)), len(runs), parts))
            for cell in cells
        ]
        verdict = all_of(falls) if name in ON_POLICY else any_of(map(opposite, falls))
        facts = [fact for cell in cells for fact in _change(cell)]
        findings.append(finding(title(name), verdict, cells, facts))
    return findings


def _falls(run: Run) -> bool:
    change = _change_of(run)
    return change is not None and change < 0


def _change_of(run: Run) -> float | None:
    late, early = run.measures[LATE], run.measures[EARLY]
    return None if late is None or early is None else late - early


def _change(cell: Cell) -> list[Fact]:
    printed = cell.printed[LATE] - cell.printed[EARLY]
    mean = cell.mean("by", list(map(_change_of, cell.runs)), printed)
    falls = cell.share(_falls, cell.named(short(cell.task)), "fall")
    return [*falls, *(fact._replace(signed=True) for fact in mean)]


TREND = Claim(
    "EMCC of the on-policy methods falls over training on every task; the off-policy methods "
    "show no such trend.",
    "A run's EMCC falls where EMCC_0.99 is below its EMCC_0.33. For an on-policy method more than "
    "half of the runs fall on every task; for an off-policy method fewer than half do on one task "
    "at least, and it is refuted where more than half do on all, by 95 % intervals, since all are "
    "needed.",
    _trend,
)


def _equal_rates(evidence: Evidence) -> list[Finding]:
    cpo, wcsac = cells = [evidence[LEVEL_TASKS[3], name] for name in ("cpo", "wcsac")]
    decided = not cpo.lacking and not wcsac.lacking
    findings = []
    measured = (("cost_rate", equal, RATE_MARGIN), (MIDDLE, apart, EMCC_MARGIN))
    measured += ((LATE, apart, EMCC_MARGIN),)
    for name, rule, margin in measured:
        a, b = ([run.measures[name] for run in cell.runs] for cell in cells)
        printed = wcsac.printed[name] - cpo.printed[name]
        tests = (
            (f"p of equivalence within {margin:g}", equivalence_of(a, b, margin)),
            ("p of the difference", p_of(a, b)),
        )
        gap = difference_of(a, b, one_place(cpo.runs) and one_place(wcsac.runs))
        fact = Fact("WCSAC - CPO", gap, printed, signed=True, tests=tests)
        verdict = rule(a, b, margin, len(measured)) if decided else "undecided"
        facts = [fact] if cpo.runs and wcsac.runs else []
        findings.append(finding(name, verdict, cells, facts))
    return findings


EQUAL_RATES = Claim(
    "CPO and WCSAC have equal cost rates on level 3 and different EMCC: EMCC tells apart what "
    "the cost rate cannot.",
    f"The mean cost rates are equivalent within {RATE_MARGIN:g} (refuted where they are not and a "
    "permutation test tells them apart); permutation tests tell the means of EMCC_0.66 and "
    f"EMCC_0.99 apart (refuted where they are equivalent within {EMCC_MARGIN:g}).",
    _equal_rates,
)


def _lowest_late(evidence: Evidence) -> list[Finding]:
    tasks, others = LEVEL_TASKS[1:], [name for name in PAPER_ALGORITHMS if name != "trpo-lag"]
    parts = 2 * len(tasks) * len(others)
    findings = []
    for task, name in itertools.product(tasks, (MIDDLE, LATE)):
        first, *beside = cells = [evidence[task, of] for of in ("trpo-lag", *others)]
        verdicts, facts = [], []
        for cell in beside:
            a, b = ([run.measures[name] for run in of.runs] for of in (first, cell))
            decided = not first.lacking and not cell.lacking
            verdicts.append(lower(a, b, parts) if decided else "undecided")
            if a and b:
                gap = difference_of(a, b, one_place(first.runs) and one_place(cell.runs))
                printed, tests = cell.printed[name] - first.printed[name], [("p", p_of(a, b))]
                facts.append(
                    Fact(f"{cell.title} - {first.title}", gap, printed, signed=True, tests=tests)
                )
        findings.append(finding(f"{short(task)}, {name}", all_of(verdicts), cells, facts))
    return findings


LOWEST_LATE = Claim(
    "TRPO-Lag has the lowest EMCC in the later stages of training on levels 1 to 3.",
    "On each level its mean EMCC_0.66 and EMCC_0.99 are below those of each other method, which a "
    "permutation test tells apart; refuted where it tells one apart that is lower.",
    _lowest_late,
)
