"""The paper's claims as Markdown and HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from agents.paper.claims import LIMIT, Checked
from agents.paper.presets import PAPER_SEEDS

TITLE = "The paper's claims"
METHOD = (
    "Each claim is decided by the rule below it, a part at a time: confirmed where all its parts "
    "are, refuted where one is, open otherwise. Runs count that have the presets' settings; an "
    f"algorithm with fewer than {PAPER_SEEDS} complete runs of the paper's length on a task "
    "decides nothing there. A run ends where its evaluated episodes end most often; the limit is "
    f"{LIMIT:g}. Intervals: 95 % bootstrap over seeds (of a "
    "mean of three: from the lowest to the highest)."
)


def markdown(checked: Sequence[Checked]) -> str:
    """A section with a heading for each claim."""
    lines = [f"## {TITLE}", "", METHOD, ""]
    for number, (claim, findings, verdict) in enumerate(checked, 1):
        lines += [f"### {number}. {claim.text} **{verdict.capitalize()}**", ""]
        lines += [f"Rule: {claim.rule}", ""]
        lines += [f"- {finding.text}: {finding.verdict}" for finding in findings]
        lines.append("")
    return "\n".join(lines)


def html(checked: Sequence[Checked]) -> str:
    """The same for a section of a page."""
    parts = [f'<p class="note">{escape(METHOD)}</p>']
    for number, (claim, findings, verdict) in enumerate(checked, 1):
        items = (f"<li>{escape(f.text)}: <em>{f.verdict}</em></li>" for f in findings)
        parts.append(
            f"<h3>{number}. {escape(claim.text)} <em>{verdict.capitalize()}</em></h3>"
            f'<p class="note">Rule: {escape(claim.rule)}</p><ul>{"".join(items)}</ul>'
        )
    return "\n".join(parts)
