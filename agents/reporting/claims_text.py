"""The paper's claims in words."""

from __future__ import annotations

from collections.abc import Sequence

from agents.paper.claims import LIMIT, Checked
from agents.paper.evidence import Fact, Finding, Share
from agents.paper.presets import PAPER_SEEDS
from agents.reporting.table import Number, number_of

TITLE = "The paper's claims"
METHOD = (
    "Each claim is decided by the rule below it, a part at a time: confirmed where all its parts "
    "are, refuted where one is, open otherwise. Runs count that have the presets' settings; an "
    f"algorithm with fewer than {PAPER_SEEDS} complete runs of the paper's length on a task "
    "decides nothing there. A run ends where its evaluated episodes end most often; the limit is "
    f"{LIMIT:g}. Intervals: 95 % bootstrap over seeds (of a "
    "mean of three: from the lowest to the highest)."
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
        words = f"{value.number} of {value.of} runs {value.does}".rstrip()
    else:
        cell = number_of(value)
        words = str(cell)
        if fact.printed is not None:
            words += f" (paper {Number(fact.printed, signed=cell.signed)})"
    return f"{fact.name} {words}".lstrip()


def markdown(checked: Sequence[Checked]) -> str:
    """A section with a heading for each claim."""
    lines = [f"## {TITLE}", "", METHOD, ""]
    for number, (claim, findings, verdict) in enumerate(checked, 1):
        lines += [f"### {number}. {claim.text} **{verdict.capitalize()}**", ""]
        lines += [f"Rule: {claim.rule}", ""]
        lines += [f"- {finding_words(finding)}: {finding.verdict}" for finding in findings]
        lines.append("")
    return "\n".join(lines)
