"""The table of results/README.md, from the report's numbers.

python docs/_ext/results_table.py
"""

from __future__ import annotations

import csv
from pathlib import Path

REPORT = Path(__file__).parents[2] / "results" / "circle2d" / "report.csv"
MEASURES = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C")
LEVELS = ("Circle2D-0-v0", "Circle2D-1-v0", "Circle2D-2-v0", "Circle2D-3-v0")
ALGORITHMS = ("TRPO-Lag", "CPO", "SAC-Lag", "SAC-LB", "WCSAC")


def rows(report: Path) -> list[str]:
    """A row of Markdown for each level and algorithm, with the presets: means with their t interval
    or range, the paper's mean in brackets, seeds within the limit, and where seeds end."""
    with report.open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    return [
        _row(level, name, [x for x in lines if (x["task"], x["algorithm"]) == (level, name)])
        for level in LEVELS
        for name in ALGORITHMS
    ]


def _row(level: str, name: str, lines: list[dict[str, str]]) -> str:
    kinds = {line["kind"]: line for line in lines if not line["seed"] and not line["share"]}
    means = [_mean(measure, kinds) for measure in MEASURES]
    (within,) = (_count(line) for line in lines if line["kind"] == "within limit")
    ends = [f"{x['ends_in']} {_count(x)}" for x in lines if x["kind"] == "ends in"]
    return f"| {' | '.join([level[9], name, *means, within, '; '.join(ends)])} |"


def _mean(measure: str, kinds: dict[str, dict[str, str]]) -> str:
    """Mean, interval or range, and the paper's mean."""

    def of(kind: str) -> str:
        return f"{float(kinds[kind][measure]):.2f}"

    if "mean low" in kinds:
        spread = f" [{of('mean low')}, {of('mean high')}]"
    else:
        spread = f", {of('mean lowest')} to {of('mean highest')}"
    return f"{of('mean')}{spread} ({of('paper')})"


def _count(line: dict[str, str]) -> str:
    """Seeds of a share."""
    return f"{round(float(line['share']) * int(line['seeds']))} of {line['seeds']}"


if __name__ == "__main__":
    print("\n".join(rows(REPORT)))
