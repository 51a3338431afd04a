"""Numbers in README and documentation are those of the reports and of `emcc`."""

import csv
import functools
import re
from pathlib import Path

import numpy as np
import pytest
import results_table

import agents
import emcc

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
RESULTS = (ROOT / "results" / "README.md").read_text()
METRIC = (ROOT / "docs" / "metric.md").read_text()


@functools.cache
def of_level(level):
    """The rows of the reports on the paper's five and on SAC-LB-Streak."""
    rows = []
    for grid in ("circle2d", "solve"):
        with (ROOT / "results" / grid / "report.csv").open() as file:
            rows += [row for row in csv.DictReader(file) if row["task"] == f"Circle2D-{level}-v0"]
    return rows


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["circle2d", "solve", "solve/safety"])
def test_the_published_archives_give_the_published_numbers(folder, tmp_path):
    published = ROOT / "results" / folder
    agents.report(published / "runs.zip", out=tmp_path)
    found, expected = ((of / "report.csv").open() for of in (tmp_path, published))
    with found, expected:
        for row, known in zip(csv.DictReader(found), csv.DictReader(expected), strict=True):
            if not known["share"]:  # written before the lines of means told their seeds
                known["seeds"] = row["seeds"]
            assert row.keys() == known.keys()
            for name, cell in known.items():
                assert row[name] == cell or near(row[name], cell), (known, name, row[name])


def near(cell, other):
    """Equal up to rounding: the published intervals are of before scipy's."""
    return float(cell) == pytest.approx(float(other), rel=1e-9, abs=1e-12)


def test_the_readmes_table():
    rows = of_level(1)
    for name in ("TRPO-Lag", "CPO", "SAC-Lag", "SAC-LB", "WCSAC", "SAC-LB-Streak"):
        own = [row for row in rows if row["algorithm"] == name]
        (mean,) = (row for row in own if row["kind"] == "mean")
        columns = ("EMCC_0.33", "EMCC_0.99", "cost_rate", "J_R", "J_C")
        numbers = " | ".join(f"{float(mean[column]):.2f}" for column in columns)
        runs = [row for row in own if row["seed"]]
        good = sum(map(results_table.solves, runs))
        assert f"| {name} | {numbers} | {good} of {len(runs)} |" in README


def test_the_table_of_the_results():
    rows = results_table.rows(results_table.REPORT)
    assert len(rows) == 20
    assert all(row in RESULTS for row in rows)


def test_the_choices_of_the_results():
    rows = results_table.choices(results_table.REPORT)
    assert len(rows) == 23
    assert all(row in RESULTS for row in rows)


def test_which_choice_is_the_nearest():
    report = (ROOT / "results" / "circle2d" / "report.md").read_text()
    section = report.partition("## Which choice is the nearest to the paper")[2]
    section = section.partition("\n## ")[0]
    rows = re.findall(r"^\| ([\w-]+), ([\w-]+).*? \| (\d+ of \d+) *\|$", section, re.MULTILINE)
    assert len(rows) == 18
    table = RESULTS.partition("In how many measures each choice is the nearest")[2]
    for name, choice, count in rows:
        (row,) = re.findall(rf"^\| {name} \| (.*) \|$", table.partition("\n## ")[0], re.MULTILINE)
        preset, units, other, both, library = (cell.strip() for cell in row.split("|"))
        own = {"units": units, "library": library, "sgd": other, "bootstrap": other}
        assert (own | {"bootstrap-units": both}).get(choice, preset) == count


def test_the_sentences_on_the_five():
    """Counts over several levels, which no report has."""

    def runs_of(name, levels=range(4)):
        return [r for k in levels for r in of_level(k) if r["seed"] and r["algorithm"] == name]

    def count(runs, end="", limit=np.inf):
        good = [r for r in runs if r["ends_in"].startswith(end) and float(r["J_C"]) <= limit]
        share = emcc.share(len(good), len(runs))
        low, high = (f"{end:.2f}".removeprefix("0") for end in (share.low, share.high))
        low, high = ("0" if low == ".00" else low, "1" if high == "1.00" else high)
        return f"{len(good)} of {len(runs)}", f" [{low}, {high}]", f" runs [{low}, {high}]"

    def of_paper(name, level, measure):
        rows = [r for r in of_level(level) if r["kind"] == "paper" and r["algorithm"] == name]
        return float(rows[0][measure])

    behind = (1, 2, 3)
    page = " ".join(RESULTS.split())
    for words, (told, plain, named) in {
        "{} go straight through": count(runs_of("TRPO-Lag", behind), "corridor, through"),
        "{} end in the corridor": count(runs_of("CPO"), "corridor"),
        "{} keep the limit. Of 12 means": count(runs_of("CPO"), limit=5),
        "through on levels 1 to 3, {}, at": count(runs_of("SAC-Lag", behind), "corridor, through"),
        "on levels 1 to 3 ({})": count(runs_of("SAC-LB", behind), "corridor", 5),
        "so in {} on level 0": count(runs_of("SAC-LB", [0]), "corridor", 5),
        "of levels 1 to 3 in {}": count(runs_of("WCSAC", behind), "corridor, through"),
        "{} keep the limit. The paper's": count(runs_of("WCSAC"), limit=5),
        "But {} end in the corridor": count(runs_of("CPO (input_scale 15.0)"), "corridor"),
        "and {} keeps the limit": count(runs_of("CPO (input_scale 15.0)"), limit=5),
        "There {} end in the corridor within the": count(
            runs_of("SAC-LB (input_scale 15.0)", behind), "corridor", 5
        ),
        "with the preset {} (Fisher": count(runs_of("SAC-LB", behind), "corridor", 5),
        "round level 0, in {} within the limit;": count(
            runs_of("SAC-LB (input_scale 15.0, time_limit bootstrap)", [0]), "corridor", 5
        ),
        "On levels 1 to 3 it is {}, fewer": count(
            runs_of("SAC-LB (input_scale 15.0, time_limit bootstrap)", behind), "corridor", 5
        ),
        "run of SAC-Lag and SAC-LB, {}, ends": count(
            [r for k in ("Lag", "LB") for r in runs_of(f"SAC-{k} (time_limit bootstrap)", [0])],
            "corridor",
        ),
    }.items():
        assert any(words.format(told + more) in page for more in (plain, named)), words
    thirds = [(k, m) for k in range(4) for m in ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99")]
    for name, told in (("CPO", 10), ("SAC-LB", 11)):
        highest = {(k, m): max(float(r[m]) for r in runs_of(name, [k])) for k, m in thirds}
        assert sum(of_paper(name, *key) > most for key, most in highest.items()) == told
    equal = [
        (float(r["EMCC_0.99"]), r["algorithm"])
        for name in ("TRPO-Lag", "CPO", "SAC-Lag", "SAC-LB", "WCSAC")
        for r in runs_of(name, [0])
        if 0.09 <= float(r["cost_rate"]) <= 0.11
    ]
    ends = [f"{value:.2f} ({name})".removeprefix("0") for value, name in (min(equal), max(equal))]
    assert f"On level 0 {len(equal)} of the 50 runs have a cost rate between .09 and .11" in page
    assert f"from {' to '.join(ends)}" in page


def test_the_corridor_with_bootstrap():
    """Claims 3 and 5: who of the SAC family ends there."""
    ends = {}
    for level in range(4):
        for name in ("SAC-Lag", "SAC-LB", "WCSAC"):
            of = f"{name} (time_limit bootstrap)"
            runs = [row for row in of_level(level) if row["seed"] and row["algorithm"] == of]
            ends[level, name] = [row["ends_in"].partition(",")[0] for row in runs]
            assert len(runs) in (0, 10)
    on_level_0 = [end for name in ("SAC-Lag", "SAC-LB", "WCSAC") for end in ends[0, name]]
    assert len(on_level_0) == 30
    assert "corridor" not in on_level_0
    of_sac_lb = [end for level in range(4) for end in ends[level, "SAC-LB"]]
    assert len(of_sac_lb) == 40
    assert all(end.endswith("rim") for end in of_sac_lb)
    assert ends[1, "SAC-Lag"].count("corridor") == 3
    assert set(ends[0, "SAC-Lag"]) == {"right rim"}


def test_the_intervals_of_shares():
    (row,) = re.findall(r"^\| share, 95 % interval \| (.*) \|$", RESULTS, re.MULTILINE)
    for count, printed in enumerate(row.split(" | ")):
        share = emcc.share(count, 10)
        assert [f"{end:.2f}" for end in (share.low, share.high)] == [
            f"{float(end):.2f}" for end in printed.strip("[]").split(", ")
        ]


def test_two_algorithms_of_one_cost_rate():
    rng = np.random.default_rng(0)
    for level in (1, 2):
        runs = [row for row in of_level(level) if row["seed"]]

        def pair(measure, runs=runs):
            names = ("SAC-LB", "SAC-LB-Streak")
            return [[float(r[measure]) for r in runs if r["algorithm"] == of] for of in names]

        rates, *of_emcc = map(pair, ("cost_rate", "EMCC_0.33", "EMCC_0.66", "EMCC_0.99"))
        assert emcc.equivalence_test(*rates, 0.02, rng=rng) < 0.001
        # Sixteen comparisons: Holm's correction multiplies by no more.
        assert all(16 * emcc.permutation_test(*of, rng=rng) < 0.001 for of in of_emcc)
        means = [
            " and ".join(f"{np.mean(side):.3f}"[1:] for side in of) for of in (rates, *of_emcc)
        ]
        assert f"| {level} | {means[0]} | < .001 | {' | '.join(means[1:])} |" in RESULTS


def test_streak_cost_against_a_margin():
    page = (ROOT / "results" / "solve" / "README.md").read_text()
    measures = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "mean_streak", "cost_rate", "J_R", "J_C")
    digits = (3, 3, 3, 2, 3, 1, 1)
    p_values, rng = {}, np.random.default_rng(0)
    for level in (1, 3):
        sides = []
        for title, options in (
            ("streak cost", ""),
            ("margin", " (cost_limit 3.5, streak_weight 0.0)"),
        ):
            name = f"SAC-LB-Streak{options}"
            runs = [r for r in of_level(level) if r["seed"] and r["algorithm"] == name]
            sides.append({m: np.array([float(r[m]) for r in runs]) for m in measures})
            numbers = [
                f"{sides[-1][m].mean():.{k}f}" for m, k in zip(measures, digits, strict=True)
            ]
            printed = " | ".join(re.sub(r"^0\.", ".", number) for number in numbers)
            good = sum(map(results_table.solves, runs))
            assert f"| {level} | {title} | {printed} | {good} of 10 |" in page
        for m in measures:
            p_values[level, m] = emcc.permutation_test(*(of[m] for of in sides), rng=rng)
        lower = [sides[0][m].mean() < sides[1][m].mean() for m in measures[:5]]
        assert lower == [True] * 4 + [False]
    safety = {key: p for key, p in p_values.items() if not key[1].startswith("J")}
    corrected = dict(zip(safety, emcc.holm(list(safety.values())), strict=True))
    assert max(corrected.values()) <= 0.026
    clear = [(1, "EMCC_0.99"), (3, "EMCC_0.33"), *((k, m) for k in (1, 3) for m in measures[3:5])]
    assert all(corrected[key] < 0.001 for key in clear)
    assert min(p for key, p in p_values.items() if key not in safety) >= 0.056


def test_the_verdicts():
    report = (ROOT / "results" / "circle2d" / "report.md").read_text()
    verdicts = re.findall(r"^### (\d)\. .* \*\*(\w+)\*\*$", report, re.MULTILINE)
    assert [number for number, _ in verdicts] == list("1234567")
    told = re.findall(r"^\| (\d)\. [^|]* \| (\w+) \|", RESULTS, re.MULTILINE)
    assert told == [(number, verdict.lower()) for number, verdict in verdicts]
    sections = dict(
        zip("1234567", re.split(r"^### \d", report, flags=re.MULTILINE)[1:], strict=True)
    )
    for number, row in re.findall(r"^\| (\d)\. (.*)$", RESULTS, re.MULTILINE):
        other = re.search(r"^With bootstrap: (\w+)$", sections[number], re.MULTILINE)
        assert ("`bootstrap`" in row) == (other is not None)
        assert other is None or other[1] in row.partition("`bootstrap`")[2]
    counts = [sum(of == verdict for _, of in told) for verdict in ("confirmed", "refuted")]
    assert counts == [1, 4]
    told = "Of the paper's seven claims one is confirmed, four are refuted, two stay undecided"
    assert told in " ".join(README.split())


def test_the_example_of_ties():
    """`emcc` itself is held to the definition in tests/emcc."""
    rows = re.findall(r"^\| (\d+) \| (\.\d+) \| (\.\d+) \|$", METRIC, re.MULTILINE)
    assert [int(safe) for safe, *_ in rows] == [89, 90, 91]
    for safe, *printed in rows:
        values = [0.0] * int(safe) + [0.5] * (100 - int(safe))
        assert [emcc.emcc(values, 0.1, ties) for ties in ("all", "split")] == [*map(float, printed)]
    costs = [4, 38, 54, 0, 0, 25, 39, 13, 20, 0]
    assert [emcc.cvar(costs, 0.5, ties) for ties in ("all", "split")] == [31.5, 35.2]
    assert "is 31.5 with `all` and 35.2 with `split`" in METRIC
