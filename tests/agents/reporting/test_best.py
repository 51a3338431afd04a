"""Which cells the results table marks, against the paper's own marks."""

import json
from importlib.resources import files

from agents.paper.evidence import paper_results
from agents.paper.presets import preset
from agents.reporting.tables import best

MEASURES = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C", "CVaR_0.5")
NAMES = {"TRPO-Lag": 0, "CPO": 1, "SAC-Lag": 2, "SAC-LB": 3, "WCSAC": 4}
T, C, S, B, W = range(5)
# The bold cells of the paper's two tables, from its source; rows in the order of MEASURES.
BOLD = {
    "Circle2D-0": [{B}, {B, W}, {S}, {W}, {S}, {S}, {S}],
    "Circle2D-1": [{T}, {T}, {T}, {W}, {S}, {S, W}, {S, W}],
    "Circle2D-2": [{T}, {T}, {T}, {B}, {W}, {W}, {W}],
    "Circle2D-3": [{T}, {T}, {T}, {C, B, W}, {B}, {B}, {B}],
    "SafetyPointCircle1-v0": [{C}, {S}, {S}, {C}, {C}, {C}, {C}],
    "SafetyPointGoal1-v0": [{S, B}, {S, B}, {S}, {C}, set(), set(), set()],
    "SafetyHopperVelocity-v1": [{S}, {C}, {C}, {C}, {T}, {T}, {T}],
}
BEYOND_ITS_RULE = {("Circle2D-1", W, "J_C"), ("Circle2D-1", W, "CVaR_0.5")}
"""WCSAC's costs are marked there as well, though its return is not the highest."""


def test_the_papers_marks():
    printed = json.loads(files("agents.paper").joinpath("printed.json").read_text())["results"]
    assert set(printed) == set(BOLD)
    for task, bold in BOLD.items():
        name = f"{task}-v0" if task.startswith("Circle2D") else f"circle2d_mj/{task}"
        limit = preset("cpo", name).cost_limit
        assert limit == (5 if task.startswith("Circle2D") else 25)
        candidates = {
            k: (values := paper_results(name, title), values["J_C"] <= limit)
            for title, k in NAMES.items()
        }
        expected = {(k, m) for m, marked in zip(MEASURES, bold, strict=True) for k in marked}
        expected -= {(k, m) for of, k, m in BEYOND_ITS_RULE if of == task}
        assert best(candidates) == expected, task


def values(emcc, j_r, j_c):
    return dict.fromkeys(MEASURES[:4], emcc) | {"J_R": j_r, "J_C": j_c, "CVaR_0.5": j_c}


def test_equal_to_two_digits_is_equal_and_one_alone_is_not_best():
    one, two = values(0.301, -3.001, 4.0), values(0.304, -3.002, 6.0)
    marked = best({3: (one, True), 7: (two, True)})
    assert {key for key, name in marked if name.startswith("EMCC")} == {3, 7}
    assert {key for key, name in marked if name == "J_R"} == {3, 7}
    assert best({3: (one, True)}) == set()
    assert {key for key, name in best({3: (one, True), 7: (two, False)}) if name == "J_R"} == {3}
    assert not {m for m in best({0: (two, False), 1: (two, False)}) if m[1] == "J_R"}


def test_what_is_not_known_is_not_marked():
    """Neither are rows without a cost limit for what they reach, nor a measure that one row has."""
    one, two = values(0.3, -3.0, 1.0), values(0.4, -2.0, 1.0)
    marked = best({0: (one | {"EMCC_0.33": None}, True), 1: (two, True), 2: (two, None)})
    assert {key for key, name in marked if name == "EMCC_0.33"} == {1, 2}
    assert {key for key, name in marked if name == "J_R"} == {1}
    unknown = best({0: (one | {"cost_rate": None}, True), 1: (two, True)})
    assert not {m for m in unknown if m[1] == "cost_rate"}
    assert not {m for m in marked if m[1] == "mean_streak"}
