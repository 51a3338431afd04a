"""Pages of results/ that are generated from templates and the reports' numbers.

python docs/_ext/results_pages.py
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import results_table
import scipy.stats
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from results_table import EMCC, LEVELS, MEASURES, RESULTS, paper, report, runs, runs_as_later

import emcc

TEMPLATES = Path(__file__).parent / "templates"


def share(chosen: pd.Series, words: str = " runs") -> str:
    """Return how many runs are chosen, with the interval of their share."""
    ends = emcc.share(int(chosen.sum()), len(chosen))
    counted = f"{results_table.count(chosen)}{words}"
    return f"{counted} [{results_table.short(ends.low)}, {results_table.short(ends.high)}]"


def of_all(chosen: pd.Series) -> str:
    """Return how many are chosen: "all N" or "K of N"."""
    return f"all {len(chosen)}" if chosen.all() else results_table.count(chosen)


def fisher(a: pd.Series, b: pd.Series) -> str:
    """Return the p value of Fisher's exact test on the runs of two sides."""
    table = [[int(side.sum()), int((~side).sum())] for side in (a, b)]
    return results_table.p_value(scipy.stats.fisher_exact(table).pvalue)


Runs = Callable[[str], pd.DataFrame]
"""Runs of an algorithm on the given task."""


def distances(algorithm: str, sides: Mapping[str, Runs]) -> pd.DataFrame:
    """Return how far means are from the paper's numbers for an algorithm, to their two digits: a
    column for each side, and a row for each level and measure, indexed by measure."""
    found = []
    for task in LEVELS:
        printed = paper(report("circle2d"), task, algorithm)[MEASURES].iloc[0]
        means = {side: of(task)[MEASURES].mean() for side, of in sides.items()}
        found.append(
            pd.DataFrame({k: (mean - printed).abs().round(2) for k, mean in means.items()})
        )
    return pd.concat(found)


def numbers_of_library() -> dict[str, Any]:
    """Return the numbers of results/library: the later library's choices, presets and the paper."""
    lines = report("circle2d")
    sides: dict[str, Runs] = {
        "preset": lambda task: runs(lines, task, "CPO"),
        "units": lambda task: runs(lines, task, "CPO (input_scale 15.0)"),
        "as_later": lambda task: runs_as_later("CPO", task),
        "solved": lambda task: runs_as_later("CPO, solved", task),
    }
    off = distances("CPO", sides)
    nearer = off.lt(off["preset"], axis=0)
    barrier, lag = (
        pd.concat([runs_as_later(name, task) for task in LEVELS]) for name in ("SAC-LB", "SAC-Lag")
    )
    lags = {
        "preset": lambda task: runs(lines, task, "SAC-Lag"),
        "as_later": lambda task: runs_as_later("SAC-Lag", task),
    }
    of_lag = distances("SAC-Lag", lags)
    ratios = [
        paper(lines, task, "CPO")[measure].item() / sides["preset"](task)[measure].mean()
        for task in LEVELS
        for measure in EMCC
    ]
    return {
        "later_library": "\n".join(results_table.later_library()),
        "nearer": nearer,
        "nearest": off[["preset", "units", "as_later"]].idxmin(axis=1),
        "ratios": ratios,
        "corridor": {
            side: pd.concat(map(of, LEVELS)).ends_in.str.startswith("corridor")
            for side, of in sides.items()
        },
        "at_start": barrier.ends_in == "right rim",
        "lag_nearer": of_lag["as_later"] < of_lag["preset"],
        "lag_farther": of_lag["as_later"] > of_lag["preset"],
        "lag_at_rims": lag.ends_in[:3].str.contains("rim"),
        "lag_through": lag.ends_in[3:] == "corridor, through",
        "emcc": list(EMCC),
    }


PAGES = {"library": numbers_of_library}
"""Function for the numbers of each page, named by its folder in results/."""


def made(name: str) -> str:
    """Return the text of a page."""
    loader = FileSystemLoader(TEMPLATES)
    templates = Environment(loader=loader, undefined=StrictUndefined, keep_trailing_newline=True)
    words = {"share": share, "fisher": fisher, "count": results_table.count, "of_all": of_all}
    return templates.get_template(f"{name}.md").render(PAGES[name]() | words)


if __name__ == "__main__":
    for name in PAGES:
        (RESULTS / name / "README.md").write_text(made(name), encoding="utf-8")
