"""Numbers on the pages of results/, docs/metric.md and the README are those of the published runs
and of `emcc`."""

import csv
import io
import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import omnisafe_parity
import pytest
import results_pages
import results_table
from results_table import LEVELS, short

import emcc
from agents.algorithms import title
from agents.paper import evidence
from agents.paper.grid import PAPER_ALGORITHMS
from agents.paper.sections import _with_all_ties, claims_sections
from agents.reporting.numbers import numbers_csv, report_lines
from agents.results.names import changes, with_names
from agents.results.reading import read_groups
from agents.results.statistics import over_windows

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
SOURCES = {
    "circle2d": ["runs.zip", "bootstrap.zip"],
    "physics": ["level-0.zip", "runs.zip"],
    "sensitivity": ["runs.zip"],
    **{
        name: sorted(path.name for path in (RESULTS / name).glob("*.zip"))
        for name in ("library", "safety", "solve")
    },
    "solve/safety": ["runs.zip"],
    "baselines/safety": [*itertools.chain(*results_table.SAFETY_TASKS.values())],
    "baselines": [
        "runs.zip",
        "sac-pid-cal.zip",
        *(f"../solve/runs.zip/{task}-sac-lb-streak" for task in LEVELS),
        *(f"../circle2d/runs.zip/{task}/{name}" for task in LEVELS for name in PAPER_ALGORITHMS),
    ],
}
"""The archives of each published report."""


def page(name):
    return (ROOT / name).read_text()


@pytest.mark.slow
@pytest.mark.parametrize("folder", SOURCES)
def test_the_published_archives_give_the_published_numbers(folder, library):
    published = RESULTS / folder
    groups = with_names(read_groups([published / name for name in SOURCES[folder]], []))
    found = io.StringIO(numbers_csv(report_lines([*map(evidence.printed, groups)])))
    with (published / "report.csv").open() as expected:
        for row, known in zip(csv.DictReader(found), csv.DictReader(expected), strict=True):
            if not known["share"]:  # older reports have no seeds in the rows of means
                known["seeds"] = row["seeds"]
            assert row.keys() == known.keys()
            for name, cell in known.items():
                assert row[name] == cell or near(row[name], cell), (known, name, row[name])


def near(cell, other):
    """Return True if equal up to rounding: published intervals are older than those by SciPy."""
    return float(cell) == pytest.approx(float(other), rel=1e-9, abs=1e-12)


PAGES = results_table.PAGES | {"omnisafe/README.md": (omnisafe_parity.omnisafe,)}


@pytest.mark.parametrize(
    ("name", "table"),
    [
        # Unpacking the forces of all steps, 22 MB in LZMA, is slow.
        pytest.param(name, table, marks=[pytest.mark.slow] * (table is results_table.forces))
        for name, tables in PAGES.items()
        for table in tables
    ],
)
def test_the_rows_of_a_table_are_on_its_page(name, table):
    rows = table()
    assert rows
    text = page(f"results/{name}")
    assert [row for row in rows if row not in text] == []


VERDICT = re.compile(r"\*\*([\w ]+?)( †)?(?: \(parts: (.*)\))?\*\*$", re.M)
"""Verdict, mark and parts in the section of a claim."""


def test_the_verdicts():
    """Verdicts, numbers of parts, verdicts with bootstrap, and every number of a row are in the
    section of its claim."""
    report = page("results/circle2d/report.md")
    columns = r"([\w ]+?)( †)? \| (\d) of (\d) \| (.*) \| ([\w ]*?) ?\|$"
    rows = re.findall(rf"^\| (\d)\. [^|]* \| {columns}", page("results/README.md"), re.M)
    sections = re.split(r"^### \d", report, flags=re.M)[1:]
    assert len(rows) == len(sections) == 9
    for (_, *stated, held, parts, decides, other), section in zip(rows, sections, strict=True):
        found = VERDICT.search(section)
        assert [found[1].lower(), found[2] or ""] == stated
        own = section.partition("\nWith bootstrap:")[0]
        verdicts = [line.rpartition(": ")[2] for line in own.splitlines() if line[:2] == "- "]
        assert (verdicts.count("reproduced"), len(verdicts)) == (int(held), int(parts))
        bootstrap = re.search(r"^With bootstrap: (.*)$", section, re.M)
        assert other == (bootstrap[1] if bootstrap else "")
        for counted in re.findall(r"\d+ of \d+(?: runs \[[^\]]*\])?", decides):
            assert re.sub(r"(?<!\d)\.", "0.", counted) in own, counted
        for number in re.findall(r"(?<![\d.])\d*\.\d+", re.sub(r"\[.*?\]|< \.001", "", decides)):
            assert re.search(rf"(?<!\d)0?{re.escape(number)}(?!\d)", own), number
    counts = [
        sum(row[1] == verdict for row in rows) for verdict in ("reproduced", "not reproduced")
    ]
    assert counts == [1, 6]


@pytest.mark.parametrize("name", results_pages.PAGES)
def test_generated_pages_are_up_to_date(name):
    """`python docs/_ext/results_pages.py` writes them."""
    assert results_pages.made(name) == page(f"results/{name}/README.md")


@pytest.mark.slow
def test_ties_and_windows():
    """No verdict depends on ties; the table of docs/metric.md with windows of one and ten episodes
    in place of rollouts."""
    own = read_groups([RESULTS / "circle2d" / name for name in SOURCES["circle2d"]], [])
    kept = [replace(of, runs=[_with_all_ties(run) for run in of.runs]) for of in own]
    verdicts = [
        [statement.verdict for section in claims_sections(way) for statement in section.statements]
        for way in (own, kept)
    ]
    assert verdicts[0] == verdicts[1] and verdicts[0].count("not reproduced") == 6
    usual = [group for group in own if not changes(group.config, group.task)]
    rows = []
    for level, part in (("1", "0.33"), ("3", "0.33"), ("1", "0.99"), ("3", "0.99")):
        for name in ("trpo-lag", "cpo", "sac-lb"):
            [group] = [of for of in usual if (of.config.algorithm, of.task[9]) == (name, level)]
            ways = (group, over_windows(group, 1), over_windows(group))
            cells = [short(np.mean(way.values(f"EMCC_{part}")), 3) for way in ways]
            rows.append(f"| {level}, EMCC_{part} | {title(name)} | {' | '.join(cells)} |")
    metric = page("docs/metric.md")
    assert [row for row in rows if row not in metric] == []


def test_the_example_of_the_first_page():
    """The numbers of its two algorithms are those of the published runs. The runs of the better do
    not overlap those of the worse in any of the measures, except in the final cost."""
    archive = RESULTS / "baselines" / "safety" / "runs.zip" / "circle2d_mj-SafetyPointGoal1-v0"
    pair = [read_groups([archive / name], [])[0] for name in ("cppo-pid", "rcpo")]
    found = re.search(r"\*\*metric\*\*.*?;\n", page("README.md"), re.S)
    assert found
    words = " ".join(found[0].split())
    told = {
        "J_C": r"J_C (\S+) and (\S+)\. Late",
        "rate_0.99": r"lower cost rate, (\.\d+) against (\.\d+),",
        "EMCC_0.99": r"(?P<b>\.\d+) against (?P<a>\.\d+) \(three seeds",
        "mean_streak": r"last (?P<b>\d+) steps, CPPO-PID's (?P<a>\d+)",
    }
    for name, pattern in told.items():
        stated = re.search(pattern, words)
        assert stated, name
        of = [side.values(name) for side in pair]
        a, b = (stated["a"], stated["b"]) if "?P" in pattern else stated.groups()
        for text, values in zip((a, b), of, strict=True):
            assert text == short(np.mean(values), len(text.partition(".")[2]))
            assert len(values) == 3
        low, high = sorted(of, key=np.mean)
        assert (max(low) < min(high)) == (name != "J_C")


def test_the_example_of_ties():
    metric = page("docs/metric.md")
    rows = re.findall(r"^\| (\d+) \| (\.\d+) \| (\.\d+) \|$", metric, re.M)
    assert [int(safe) for safe, *_ in rows] == [89, 90, 91]
    for safe, *printed in rows:
        values = [0.0] * int(safe) + [0.5] * (100 - int(safe))
        assert [emcc.emcc(values, 0.1, ties) for ties in ("split", "all")] == [*map(float, printed)]
    costs = [4, 38, 54, 0, 0, 25, 39, 13, 20, 0]
    assert [emcc.cvar(costs, 0.5, ties) for ties in ("split", "all")] == [35.2, 31.5]
    assert "is 35.2 with `split` and 31.5 with `all`" in metric
