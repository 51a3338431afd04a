"""The paper's claims in words."""

from __future__ import annotations

from collections.abc import Sequence

from agents.paper.claims import LIMIT, Checked
from agents.paper.evidence import SEEDS, Fact, Finding
from agents.reporting.table import Number, number_of, p_number
from agents.results.statistics import LEVEL
from emcc import Share

TITLE = "The paper's claims"
METHOD = (
    "Each claim is decided by the rule below it, a part at a time: confirmed where all its parts "
    "are, refuted where one is, undecided otherwise. Runs count that have the presets' settings; "
    f"an algorithm with fewer than {SEEDS} complete runs of the paper's length on a task decides "
    "nothing there. A run ends where its evaluated episodes end most often; the limit is "
    f"{LIMIT:g}. Shares of runs have 95 % Clopper-Pearson intervals, and a rule on a share holds "
    "where it holds for the whole interval: 9 of 10 runs, from 0.55 on, are more than half, 8 of "
    "10 are not. Means have 95 % t intervals; where runs end in different places, or are fewer "
    "than five, their range. Differences are decided by permutation tests of Welch's t, "
    f"equivalence by two one-sided ones, at {LEVEL:g}. To refute, one-sided bounds, and two-sided "
    f"tests, at {LEVEL:g} divided by the number of parts of the claim are taken, since one part is "
    "enough. Runs of equal settings in several folders count together; of one seed, the first. "
    "The paper does not print some settings, such as whether values bootstrap at the time limit. "
    '"With bootstrap: refuted": the verdict is another where runs with that choice take the place '
    f"of the preset's, on all tasks that have {SEEDS} of them."
)


def finding_words(finding: Finding) -> str:
    """Where, the numbers, and the runs that are lacking."""
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
    words, beside = str(number_of(value, signed=fact.signed)), []
    if value is not None:
        beside.append(f"n = {value.runs}")
    if fact.printed is not None:
        beside.append(f"paper {Number(fact.printed, signed=fact.signed)}")
    beside += [f"{name}: {p_number(p)}" for name, p in fact.tests]
    return f"{fact.name} {words} ({'; '.join(beside)})".lstrip()


def markdown(checked: Sequence[Checked]) -> str:
    """A section with a heading for each claim."""
    lines = [f"## {TITLE}", "", METHOD, ""]
    for number, (claim, findings, verdict, otherwise) in enumerate(checked, 1):
        lines += [f"### {number}. {claim.text} **{verdict.capitalize()}**", ""]
        lines += [f"Rule: {claim.rule}", "", *_listed(findings)]
        for other in otherwise:
            lines += [f"With {other.choice}: {other.verdict}", "", *_listed(other.findings)]
    return "\n".join(lines)


def _listed(findings: Sequence[Finding]) -> list[str]:
    return [*(f"- {finding_words(finding)}: {finding.verdict}" for finding in findings), ""]
