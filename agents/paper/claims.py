"""The paper's claims, each with a rule that decides it, and their check against trained runs."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence

from agents.algorithms import title
from agents.paper.evidence import (
    EARLY,
    LATE,
    LEVEL_TASKS,
    MIDDLE,
    Cell,
    Claim,
    Count,
    Evidence,
    Finding,
    Value,
    Verdict,
    about,
    all_of,
    any_of,
    apart,
    choice_of,
    difference_in_words,
    equal,
    finding,
    gather,
    lower,
    mostly,
    none,
    opposite,
    short,
    some,
)
from agents.paper.grid import PAPER_ALGORITHMS
from agents.presets import PAPER_STEPS, preset
from agents.reporting.page import Otherwise, Statement
from agents.results.groups import Group, RunResult
from agents.results.statistics import MARGIN, equivalence_of, over_windows, p_of
from emcc.statistics import COST

LIMIT = preset("cpo", LEVEL_TASKS[0]).cost_limit


def in_corridor(run: RunResult) -> bool:
    """Whether most of a run's evaluated episodes end in the left corridor, of all places."""
    return run.end == "corridor"


def within(run: RunResult) -> bool:
    """Whether a run satisfies the cost limit of Circle2D in its evaluation."""
    cost = run.measures["J_C"]
    return cost is not None and cost <= LIMIT


def _safely(run: RunResult) -> bool:
    return in_corridor(run) and within(run)


def _straight(run: RunResult) -> bool:
    return in_corridor(run) and not within(run)


def _waiting(run: RunResult) -> bool:
    return not in_corridor(run) and within(run)


def _straight_through(evidence: Evidence) -> list[Finding]:
    findings, parts = [], 3 * len(LEVEL_TASKS[1:])
    for task in LEVEL_TASKS[1:]:
        cell = evidence[task, "trpo-lag"]
        through = cell._replace(runs=tuple(filter(_straight, cell.runs)))
        verdict = cell.judged(mostly, _straight, parts)
        if not cell.lacking:
            cost, late = (through.values(name) for name in ("J_C", LATE))
            verdict = all_of([verdict, about(cost, 9, parts), about(late, 0.2, parts)])
        facts = [*cell.share(_straight, "", "go through"), *through.means("J_C", LATE)]
        findings.append(finding(short(task), verdict, [cell], facts))
    return findings


STRAIGHT_THROUGH = Claim(
    "TRPO-Lag ignores the region on levels 1 to 3 and goes straight through, at a cost of "
    "about 9 and a late EMCC of about 0.2.",
    "On each level more than half of the runs end in the corridor with J_C above the limit, and "
    "the means of J_C and EMCC_0.99 over those that do are within a fifth of 9 and of 0.2, with "
    "their whole interval. No test of the paper: the step length and the multiplier's optimiser "
    "were chosen so that it comes out.",
    _straight_through,
    LEVEL_TASKS[1:],
)


def _corridor(evidence: Evidence) -> list[Finding]:
    level_0, level_1 = LEVEL_TASKS[:2]
    others = tuple(name for name in PAPER_ALGORITHMS if name != "sac-lb")
    parts = 2 * len(PAPER_ALGORITHMS)
    return [
        _runs_that(evidence, level_0, ("sac-lag", "sac-lb"), some, in_corridor, parts),
        _runs_that(evidence, level_0, ("trpo-lag", "cpo", "wcsac"), none, in_corridor, parts),
        _runs_that(evidence, level_1, ("sac-lb",), some, _safely, parts),
        _runs_that(evidence, level_1, others, none, _safely, parts),
    ]


CORRIDOR = Claim(
    "On level 0 only SAC-Lag and SAC-LB have runs that end in the left corridor; on level 1 "
    "only SAC-LB has, within the cost limit.",
    "A method has such runs where more than one in twenty is one of them; it has none where no "
    "run is and fewer than half would be. Level 0: the run ends in the corridor; level 1: and its "
    "J_C is within the limit.",
    _corridor,
    LEVEL_TASKS[:2],
)


def _nobody(evidence: Evidence) -> list[Finding]:
    tasks = LEVEL_TASKS[2:]
    parts = len(tasks) * len(PAPER_ALGORITHMS)
    return [_runs_that(evidence, task, PAPER_ALGORITHMS, none, _safely, parts) for task in tasks]


NOBODY = Claim(
    "Nobody ends inside the corridor within the limit on levels 2 and 3.",
    "Of each of the five methods no run ends in the corridor with J_C within the limit, and fewer "
    "than half would; not reproduced where more than one in twenty do so.",
    _nobody,
    LEVEL_TASKS[2:],
)


def _runs_that(
    evidence: Evidence,
    task: str,
    names: Sequence[str],
    rule: Count,
    does: Callable[[RunResult], bool],
    parts: int,
) -> Finding:
    """Judge whether each algorithm has runs that do something, or whether none has.

    rule: `some` or `none`; does: whether a run does it: `in_corridor` or `_safely`."""
    cells = [evidence[task, name] for name in names]
    verdict = all_of(cell.judged(rule, does, parts) for cell in cells)
    facts = ", ".join(fact for cell in cells for fact in cell.share(does, cell.title, ""))
    where = "in the corridor" + (" within the limit" if does is _safely else "")
    expected = "each has some" if rule is some else "none has any"
    told = [f"{where}: {facts} (claimed: {expected})"] if facts else []
    return finding(short(task), verdict, cells, told)


def _low_cost(evidence: Evidence) -> list[Finding]:
    tasks = (LEVEL_TASKS[0], LEVEL_TASKS[1], LEVEL_TASKS[3])
    findings = []
    for task in tasks:
        cell = evidence[task, "wcsac"]
        later = cell.mean("episode cost after the first third", _later_cost, None, COST)
        facts = [*cell.share(_settled, "", "do so"), *cell.means("J_C"), *later]
        verdict = cell.judged(mostly, _settled, len(tasks))
        findings.append(finding(short(task), verdict, [cell], facts))
    return findings


def _settled(run: RunResult) -> bool:
    return _waiting(run) and _later_cost(run) <= LIMIT


def _later_cost(run: RunResult) -> float:
    """Return the mean cost of the episodes that start after the first third of training."""
    later = 3 * run.records.start_step >= run.records.total_steps
    return float(run.records.cost[later].mean())


LOW_COST = Claim(
    "WCSAC goes early to a local optimum at low cost, but for level 2.",
    "On levels 0, 1 and 3 more than half of the runs end outside the corridor with J_C within the "
    "limit, and a mean cost of the training episodes after the first third within it too.",
    _low_cost,
    (LEVEL_TASKS[0], LEVEL_TASKS[1], LEVEL_TASKS[3]),
)


ON_POLICY = ("trpo-lag", "cpo")
RATE_MARGIN, EMCC_MARGIN = MARGIN, 0.05
"""Margins of the equivalence tests: differences of mean cost rates and mean EMCC that count as
none."""


def _trend(evidence: Evidence) -> list[Finding]:
    """Return a finding for each algorithm, over all tasks."""
    findings, parts = [], len(PAPER_STEPS) * len(PAPER_ALGORITHMS)
    for name in PAPER_ALGORITHMS:
        cells = [evidence[task, name] for task in PAPER_STEPS]
        falls: list[Verdict] = [cell.judged(mostly, _falls, parts) for cell in cells]
        verdict = all_of(falls) if name in ON_POLICY else any_of(map(opposite, falls))
        facts = [fact for cell in cells for fact in _change(cell)]
        findings.append(finding(title(name), verdict, cells, facts))
    return findings


def _falls(run: RunResult) -> bool:
    change = _change_of(run)
    return change is not None and change < 0


def _change_of(run: RunResult) -> float | None:
    late, early = run.measures[LATE], run.measures[EARLY]
    return None if late is None or early is None else late - early


def _change(cell: Cell) -> list[str]:
    printed = cell.printed[LATE] - cell.printed[EARLY]
    falls = cell.share(_falls, cell.named(short(cell.task)), "fall")
    return [*falls, *cell.mean("by", _change_of, printed, signed=True)]


TREND = Claim(
    "EMCC of the on-policy methods falls over training on every task; the off-policy methods "
    "show no such trend.",
    "A run's EMCC falls where EMCC_0.99 is below its EMCC_0.33. For an on-policy method more than "
    "half of the runs fall on every task; for an off-policy method fewer than half do on one task "
    "at least, and it is not reproduced where more than half do on all, by 95 % intervals, since "
    "all are needed.",
    _trend,
    tuple(PAPER_STEPS),
)


def _equal_rates(evidence: Evidence) -> list[Finding]:
    cpo, wcsac = cells = [evidence[LEVEL_TASKS[3], name] for name in ("cpo", "wcsac")]
    measured = (
        ("cost_rate", equal, RATE_MARGIN),
        (MIDDLE, apart, EMCC_MARGIN),
        (LATE, apart, EMCC_MARGIN),
    )
    findings = []
    for name, rule, margin in measured:
        a, b = cpo.values(name), wcsac.values(name)
        tests = (
            (f"p of equivalence within {margin:g}", equivalence_of(a, b, margin)),
            ("p of the difference", p_of(a, b)),
        )
        lacking = cpo.lacking or wcsac.lacking
        verdict = "undecided" if lacking else rule(a, b, margin, len(measured))
        facts = difference_in_words(cpo, wcsac, name, tests)
        findings.append(finding(name, verdict, cells, facts))
    return findings


EQUAL_RATES = Claim(
    "CPO and WCSAC have equal cost rates on level 3, and different EMCC in the later two thirds.",
    f"The mean cost rates are equivalent within {RATE_MARGIN:g} (not reproduced where they are not "
    "and a permutation test tells them apart); permutation tests tell the means of EMCC_0.66 and "
    f"EMCC_0.99 apart (not reproduced where they are equivalent within {EMCC_MARGIN:g}).",
    _equal_rates,
    LEVEL_TASKS[3:],
    across=True,
)


def _below(a: Cell, b: Cell, of: Value, parts: int) -> tuple[Verdict, list[str]]:
    """Judge whether the mean of a is below the mean of b; return the difference in words too."""
    sides = a.values(of), b.values(of)
    verdict = "undecided" if a.lacking or b.lacking else lower(*sides, parts)
    return verdict, difference_in_words(a, b, of, [("p", p_of(*sides))])


def _lowest_late(evidence: Evidence) -> list[Finding]:
    tasks, others = LEVEL_TASKS[1:], [name for name in PAPER_ALGORITHMS if name != "trpo-lag"]
    parts = []
    for task, measure in itertools.product(tasks, (MIDDLE, LATE)):
        pairs = [(evidence[task, "trpo-lag"], evidence[task, name]) for name in others]
        parts.append((f"{short(task)}, {measure}", pairs, measure))
    return _each_below(parts)


def _each_below(parts: Sequence[tuple[str, Sequence[tuple[Cell, Cell]], Value]]) -> list[Finding]:
    """Return a finding for each part: a name, pairs of cells of which the first is claimed to have
    the lower mean, and the value compared. The claim counts as many parts as there are pairs."""
    count = sum(len(pairs) for _, pairs, _ in parts)
    return [_all_below(name, pairs, of, count) for name, pairs, of in parts]


def _all_below(name: str, pairs: Sequence[tuple[Cell, Cell]], of: Value, parts: int) -> Finding:
    """Judge whether the first cell of each pair has the lower mean; report the differences."""
    verdicts, facts = zip(*(_below(low, high, of, parts) for low, high in pairs), strict=True)
    cells = {(cell.task, cell.algorithm): cell for pair in pairs for cell in pair}
    return finding(name, all_of(verdicts), [*cells.values()], [*itertools.chain(*facts)])


LOWEST_LATE = Claim(
    "TRPO-Lag has the lowest EMCC in the later stages of training on levels 1 to 3.",
    "On each level its mean EMCC_0.66 and EMCC_0.99 are below those of each other method, which a "
    "permutation test tells apart; not reproduced where it tells one apart that is lower.",
    _lowest_late,
    LEVEL_TASKS[1:],
    across=True,
)


def _cheap_but_long(evidence: Evidence) -> list[Finding]:
    level_1 = LEVEL_TASKS[1]
    pairs = [
        (evidence[level_1, off_policy], evidence[level_1, on_policy])
        for off_policy in ("sac-lag", "wcsac")
        for on_policy in ON_POLICY
    ]
    turned = [(on_policy, off_policy) for off_policy, on_policy in pairs]
    longer = [(name, turned, name) for name in (EARLY, MIDDLE, LATE)]
    return _each_below([("J_C", pairs, "J_C"), *longer])


CHEAP_BUT_LONG = Claim(
    "On level 1 SAC-Lag and WCSAC have a lower final cost than the on-policy methods, but a "
    "higher EMCC: the cost of the trained policy does not tell how safe its training was.",
    "Each of the two has a lower mean of J_C and higher means of EMCC in each third than each of "
    "TRPO-Lag and CPO, which permutation tests tell apart; not reproduced where one tells them "
    "apart the other way round.",
    _cheap_but_long,
    LEVEL_TASKS[1:2],
    across=True,
)


def _both_ways(evidence: Evidence) -> list[Finding]:
    names = ("sac-lag", "wcsac")
    does = ((_straight, "go through"), (_waiting, "wait within the limit"))
    findings = []
    for name in names:
        cell = evidence[LEVEL_TASKS[2], name]
        verdict = all_of(cell.judged(some, of, len(names) * len(does)) for of, _ in does)
        facts = [fact for of, words in does for fact in cell.share(of, "", words)]
        findings.append(finding(cell.title, verdict, [cell], facts))
    return findings


BOTH_WAYS = Claim(
    "On level 2 the results of SAC-Lag and WCSAC vary strongly between seeds: some runs ignore the "
    "region, the others wait at a local optimum at a cost of 0.",
    "Of each of the two more than one run in twenty ends in the corridor with J_C above the limit, "
    "and more than one in twenty outside it with J_C within the limit; not reproduced where no run "
    "does one of them and fewer than half would.",
    _both_ways,
    LEVEL_TASKS[2:3],
)


POINT_CIRCLE, HOPPER = "circle2d_mj/SafetyPointCircle1-v0", "circle2d_mj/SafetyHopperVelocity-v1"


def _costly_but_short(evidence: Evidence) -> list[Finding]:
    trpo, sac = (evidence[POINT_CIRCLE, name] for name in ("trpo-lag", "sac-lag"))
    parts = [(name, [(trpo, sac)], name) for name in ("cost_rate", "J_C")]
    return _each_below(parts + [(name, [(sac, trpo)], name) for name in (EARLY, MIDDLE, LATE)])


COSTLY_BUT_SHORT = Claim(
    "On SafetyPointCircle1 SAC-Lag has a higher cost rate and a higher final cost than TRPO-Lag, "
    "but a lower EMCC.",
    "The means of the cost rate and of J_C are higher, and those of EMCC in each third lower, "
    "which permutation tests tell apart; not reproduced where one tells them apart the other way "
    "round.",
    _costly_but_short,
    (POINT_CIRCLE,),
    across=True,
)


def _short_episodes(evidence: Evidence) -> list[Finding]:
    trpo, sac = (evidence[HOPPER, name] for name in ("trpo-lag", "sac-lb"))
    return _each_below(
        [
            ("episode length", [(trpo, sac)], functools.partial(_early_mean, "length")),
            ("cost of an episode", [(trpo, sac)], functools.partial(_early_mean, "cost")),
            (EARLY, [(sac, trpo)], EARLY),
        ]
    )


def _early_mean(column: str, run: RunResult) -> float:
    """Return the mean over the episodes that start in the first third of training."""
    rows = 3 * run.records.start_step < run.records.total_steps
    return float(getattr(run.records, column)[rows].mean())


SHORT_EPISODES = Claim(
    "On SafetyHopperVelocity, in the first third of training, TRPO-Lag's episodes are shorter and "
    "cost less than SAC-LB's, yet its EMCC is higher.",
    "The means of length and cost over the episodes that start in the first third are lower, that "
    "of EMCC_0.33 is higher, which permutation tests tell apart; not reproduced where one tells "
    "them apart the other way round.",
    _short_episodes,
    (HOPPER,),
    across=True,
)


CLAIMS = (STRAIGHT_THROUGH, TREND, CORRIDOR, LOW_COST, NOBODY, EQUAL_RATES, LOWEST_LATE)
CLAIMS = (*CLAIMS, CHEAP_BUT_LONG, BOTH_WAYS, COSTLY_BUT_SHORT, SHORT_EPISODES)
"""All claims, in the order in which pages number them."""


def check_claims(groups: Sequence[Group]) -> list[Statement]:
    """Check every claim on tasks with runs; empty if no algorithm has runs of the paper's length.

    Runs with other settings, task parameters or lengths than the paper's decide nothing, and
    neither do too few runs. Runs with another choice of what the paper does not specify show where
    the verdict depends on the choice.
    """
    evidence = gather(groups)
    if not any(cell.full for cell in evidence.values()):
        return []
    sides = {False: (evidence, _other_choices(groups, evidence))}
    windows = [over_windows(group) for group in groups]
    of_windows = gather(windows)
    sides[True] = of_windows, _other_choices(windows, of_windows)
    known = {task for task, name in evidence if evidence[task, name].runs}
    told = [claim for claim in CLAIMS if known.intersection(claim.tasks)]
    return [_checked(claim, *sides[claim.across]) for claim in told]


def _other_choices(groups: Sequence[Group], evidence: Evidence) -> dict[str, Evidence]:
    """Return, for each other choice, the evidence with its runs in place of the preset's.

    They replace the preset's runs on tasks where there are enough of them to decide; a choice
    without such a task is left out."""
    others = {}
    for choice in filter(None, dict.fromkeys(choice_of(group) for group in groups)):
        cells = gather(groups, choice)
        decisive = {key: cell for key, cell in cells.items() if not cell.lacking}
        if decisive:
            others[choice] = {**evidence, **decisive}
    return others


def _checked(claim: Claim, evidence: Evidence, others: Mapping[str, Evidence]) -> Statement:
    """Return a claim with its verdict, the other choices that change the verdict, and the parts of
    the claim that they change. A claim is reproduced if all its parts are."""
    findings = claim.check(evidence)
    verdict = all_of(part.verdict for part in findings)
    otherwise = []
    for choice, other_evidence in others.items():
        parts = claim.check(other_evidence)
        other = all_of(part.verdict for part in parts)
        if other != verdict:
            changed = [part for part in parts if part not in findings]
            otherwise.append(Otherwise(choice, other, changed))
    return Statement(claim.text, verdict, claim.rule, findings, otherwise)
