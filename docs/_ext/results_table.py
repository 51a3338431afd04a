"""The tables of results/README.md and results/solve/README.md, from the reports' numbers.

python docs/_ext/results_table.py
"""

from __future__ import annotations

import csv
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import scipy.stats

import emcc

RESULTS = Path(__file__).parents[2] / "results"
REPORT = RESULTS / "circle2d" / "report.csv"
SOLVED = RESULTS / "solve" / "report.csv"
SAFETY = RESULTS / "solve" / "safety" / "report.csv"
MEASURES = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C")
LEVELS = ("Circle2D-0-v0", "Circle2D-1-v0", "Circle2D-2-v0", "Circle2D-3-v0")
ALGORITHMS = ("TRPO-Lag", "CPO", "SAC-Lag", "SAC-LB", "WCSAC")
LIMIT = 5.0
PARTS = {
    "scale": "the unit of length",
    "novelty": "the bonus for new states",
    "share": "the share of random actions",
    "horizon": "bootstrapping at the time limit",
    "streak": "streak cost",
    "brown": "brown random actions",
    "speed": "its own step sizes and batches",
}
"""The parts of SAC-LB-Streak by the names of their ablations."""
ROWS = {f"without-{k}": f"without {v}" for k, v in PARTS.items()} | {
    "margin": "a margin instead of streak cost"
}


def solves(run: dict[str, str]) -> bool:
    """Whether the trained policy of a report's row ends in the corridor within the limit."""
    return run["ends_in"].startswith("corridor") and _is_within(run)


def _lines(report: Path) -> list[dict[str, str]]:
    with report.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def rows(report: Path) -> list[str]:
    """A row of Markdown for each level and algorithm, with the presets: means with their t interval
    or range, the paper's mean in brackets, seeds within the limit, and where seeds end."""
    lines = _lines(report)
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


def choices(report: Path) -> list[str]:
    """Rows of Markdown for each algorithm that was trained with other choices of what the paper
    does not print: those of the preset, of each choice, and of the paper. Means of J_C and
    EMCC_0.99 on levels 0 to 3, and runs within the limit, and in the corridor within it, there."""
    lines = [line for line in _lines(report) if line["task"] in LEVELS]
    found = []
    for name in ALGORITHMS:
        own = [line for line in lines if line["algorithm"].partition(" (")[0] == name]
        by_folder: dict[str, list[dict[str, str]]] = {}
        for line in own:
            by_folder.setdefault(line["folder"].partition("/")[2], []).append(line)
        printed = [line for line in own if line["kind"] == "paper"]
        preset = by_folder.pop(name.lower())
        others = {k.removeprefix(f"{name.lower()}-"): of for k, of in by_folder.items() if k}
        if others:
            titled = {"preset": preset} | others | {"paper": printed}
            found += [_choice(f"{name}, {title}", of) for title, of in titled.items()]
    return found


def parts(report: Path) -> list[str]:
    """Rows of Markdown for each level on which SAC-LB-Streak was trained without its parts: of the
    preset, then without each. Runs in the corridor within the limit, and means."""
    lines = _lines(report)
    found = []
    for level in LEVELS:
        rows = [_part(_runs(lines, level, choice), ROWS[choice]) for choice in list(ROWS)[:-1]]
        rows = [row for row in rows if row]
        preset = _part(_runs(lines, level, ""), "all parts")
        found += [f"| {level[9]} | {row} |" for row in (preset, *rows) if rows]
    return found


def parts_over_levels(report: Path) -> list[str]:
    """Rows of Markdown for each part of SAC-LB-Streak: on the levels where it was left out, runs in
    the corridor within the limit without and with it, and by how much means are higher without it.

    Behind each a p value: of counts Fisher's exact test, of means the permutation test over levels,
    either corrected for all of the table (Holm).
    """
    lines = _lines(report)
    counts, gaps, of_counts, of_gaps = {}, {}, {}, {}
    for choice in ROWS:
        levels = [level for level in LEVELS if _runs(lines, level, choice)]
        sides = [[_runs(lines, level, of) for level in levels] for of in (choice, "")]
        if len(levels) < 2:
            continue
        solved = [sum(solves(run) for runs in side for run in runs) for side in sides]
        total = [sum(map(len, side)) for side in sides]
        counts[choice] = [f"{k} of {n}" for k, n in zip(solved, total, strict=True)], len(levels)
        table = [[k, n - k] for k, n in zip(solved, total, strict=True)]
        of_counts[choice] = float(scipy.stats.fisher_exact(table).pvalue)
        for measure in MEASURES[:4]:
            without, usual = (
                np.transpose([[float(run[measure]) for run in runs] for runs in side])
                for side in sides
            )
            gaps[choice, measure] = without.mean() - usual.mean()
            rng = np.random.default_rng(0)
            of_gaps[choice, measure] = emcc.permutation_test(usual, without, rng=rng)
    of_counts, of_gaps = _holm(of_counts), _holm(of_gaps)
    found = []
    for choice, ((without, usual), levels) in counts.items():
        cells = [f"{without}, {usual} ({_p(of_counts[choice])})"]
        for measure in MEASURES[:4]:
            gap = round(gaps[choice, measure], 3) or 0.0  # no -0
            cells.append(f"{gap:+.3f} ({_p(of_gaps[choice, measure])})".replace("0.", ".", 1))
        found.append(f"| {ROWS[choice]} | {levels} | {' | '.join(cells)} |")
    return found


def safety(report: Path) -> list[str]:
    """Rows of Markdown for each Safety task and algorithm: mean EMCC and cost rate; means of J_R
    and J_C with the range of the seeds; seeds within the limit."""
    lines = _lines(report)
    found = []
    for folder in dict.fromkeys(line["folder"] for line in lines if line["seed"]):
        own = [line for line in lines if line["folder"] == folder]
        kinds = {line["kind"]: line for line in own if not line["seed"]}
        task, title = kinds["mean"]["task"], kinds["mean"]["algorithm"]
        means = {of: _short(float(kinds["mean"][of]), 2) for of in MEASURES[:4]}
        ranges = [
            "{:.1f}, from {:.1f} to {:.1f}".format(
                *(float(kinds[kind][of]) for kind in ("mean", "mean lowest", "mean highest"))
            )
            for of in MEASURES[4:]
        ]
        cells = [task.partition("/Safety")[2].rpartition("-")[0], title.partition(" (")[0]]
        cells += [" ".join(means[of] for of in MEASURES[:3]), means["cost_rate"], *ranges]
        found.append(f"| {' | '.join([*cells, _count(kinds['within limit'])])} |")
    return found


def _short(value: float, digits: int) -> str:
    """A number without the 0 before its point."""
    return f"{value:.{digits}f}".removeprefix("0")


def _holm(p_values: dict[Any, float]) -> dict[Any, float]:
    return dict(zip(p_values, emcc.holm(list(p_values.values())).tolist(), strict=True))


def _p(value: float) -> str:
    if value < 0.001:
        return "p < .001"
    return "p = 1" if value > 0.9995 else f"p = {value:.3f}".replace("0.", ".", 1)


def _runs(lines: list[dict[str, str]], level: str, choice: str) -> list[dict[str, str]]:
    """Runs of SAC-LB-Streak on a level, of a choice or, for none, of the preset."""
    folder = f"{level}-sac-lb-streak{'-' if choice else ''}{choice}"
    return [line for line in lines if line["folder"] == folder and line["kind"] == "run"]


def _part(runs: list[dict[str, str]], title: str) -> str:
    """The cells of a row; empty without runs."""
    if not runs:
        return ""

    def mean(measure: str, digits: int) -> str:
        return _short(fmean(float(line[measure]) for line in runs), digits)

    emcc_of = " ".join(mean(measure, 2) for measure in MEASURES[:3])
    others = [mean(of, digits) for of, digits in (("cost_rate", 2), ("J_R", 1), ("J_C", 1))]
    return " | ".join([title, f"{sum(map(solves, runs))} of {len(runs)}", emcc_of, *others])


def _choice(title: str, lines: list[dict[str, str]]) -> str:
    means = {line["task"]: line for line in lines if line["kind"] in ("mean", "paper")}
    runs = {of: [x for x in lines if (x["task"], x["kind"]) == (of, "run")] for of in LEVELS}
    cells = [
        ", ".join(f"{float(means[of][measure]):{digits}}" if of in means else "–" for of in LEVELS)
        for measure, digits in (("J_C", ".1f"), ("EMCC_0.99", ".2f"))
    ]
    for is_counted in (_is_within, solves):
        counts = ", ".join(str(sum(map(is_counted, of))) if of else "–" for of in runs.values())
        (seeds,) = {len(of) for of in runs.values() if of} or {0}  # equally many on all levels
        cells.append(f"{counts} of {seeds}" if seeds else "")
    return f"| {title} | {' | '.join(cells)} |"


def _is_within(run: dict[str, str]) -> bool:
    return float(run["J_C"]) <= LIMIT


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
    tables = [rows(REPORT), choices(REPORT), parts(SOLVED), parts_over_levels(SOLVED)]
    tables += [safety(SAFETY)]
    print("\n\n".join(map("\n".join, tables)))
