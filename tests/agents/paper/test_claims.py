"""The verdicts on the paper's claims, for made-up runs that reproduce them, contradict them, or
decide nothing."""

from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from agents.paper import claims
from agents.paper.claims import CLAIMS, check_claims
from agents.paper.evidence import all_of, gather, paper_results
from agents.paper.sections import CLAIMS_WITH_PHYSICS, claims_sections
from agents.presets import PAPER_STEPS, preset
from agents.reporting.page import page
from agents.results.groups import Group, RunResult
from agents.results.statistics import mixed, over_windows
from agents.training.config import TrainConfig
from emcc import EpisodeRecords

ALGORITHMS = ("trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac")
SAFETY = [task for task in PAPER_STEPS if "Safety" in task]
LEVEL = [f"Circle2D-{level}-v0" for level in range(4)]
ALL = tuple(range(10))


def run(seed, parts, rate, j_c, end, later_cost, early=(10, 40.0)):
    """Return a run of ten episodes, of which the last six are after the first third of training.

    early: length and cost of the first four episodes.
    """
    measures = dict(zip(("EMCC_0.33", "EMCC_0.66", "EMCC_0.99"), parts, strict=True))
    measures |= {"cost_rate": rate, "J_R": -9.0, "J_C": j_c, "CVaR_0.5": j_c}
    cost = np.array([early[1]] * 4 + [later_cost] * 6)
    length = np.array([early[0]] * 4 + [10] * 6)
    of_ten, zero = np.arange(10), np.zeros(10)
    records = EpisodeRecords(of_ten, of_ten * 10, length, zero, cost, zero)
    return RunResult(seed, measures, 100, end_at(end), records)


def end_at(place, share=80):
    """Return where 100 episodes end: `share` of them at a place, the others elsewhere."""
    return {"right rim" if place == "bottom rim" else "bottom rim": 100 - share, place: share}


def as_the_paper_says(task, name):
    """Return ten runs for which every claim holds; the seeds differ a little."""
    parts, rate, j_c, ends, later = (0.5, 0.4, 0.45), 0.1, 1.0, "right rim", 1.0
    early = (8, 30.0) if (name, task) == ("trpo-lag", SAFETY[2]) else (10, 40.0)
    if name in ("trpo-lag", "cpo"):
        parts = (0.5, 0.3, 0.2) if name == "trpo-lag" else (0.5, 0.35, 0.3)
        if name == "trpo-lag" and task in LEVEL[1:]:
            j_c, ends = 9.4, "corridor"
        elif task == LEVEL[1]:
            j_c = 4.0
    elif name in ("sac-lag", "sac-lb"):
        parts = (0.3, 0.4, 0.5)
        ends = "corridor" if task == LEVEL[0] or (name, task) == ("sac-lb", LEVEL[1]) else ends
        if (name, task) == ("sac-lag", SAFETY[0]):
            parts, rate, j_c = (0.3, 0.2, 0.1), 0.2, 2.0
        elif (name, task) == ("sac-lag", LEVEL[1]):
            parts = (0.6, 0.6, 0.5)
    else:
        parts = (0.6, 0.6, 0.7)
    runs = []
    for seed in ALL:
        shifted = [part + 0.003 * seed for part in parts]
        costs = rate + 0.001 * seed, j_c + 0.01 * seed
        length, cost = early[0] - seed % 2, early[1] + seed
        runs.append(run(seed, shifted, *costs, ends, later, (length, cost)))
    if task == LEVEL[2] and name in ("sac-lag", "wcsac"):
        runs = changed(runs, ALL[:5], ends="corridor", J_C=9.0)
    return runs


def group(task, name, runs, steps=None, **changes):
    seeds = tuple(of.seed for of in runs) or (0,)
    hyperparameters = replace(preset(name, task), **changes)
    config = TrainConfig(name, (task,), seeds, steps or PAPER_STEPS[task], hyperparameters)
    return Group(name, task, config, list(runs), [])


@pytest.fixture
def world(monkeypatch):
    """Every run of the paper, by task and algorithm; EMCC is made up and not of the records."""
    monkeypatch.setattr(claims, "over_windows", lambda group: group)
    return {
        (task, name): as_the_paper_says(task, name) for task in PAPER_STEPS for name in ALGORITHMS
    }


def groups_of(world, **options):
    return [group(task, name, runs, **options) for (task, name), runs in world.items()]


def verdicts(groups):
    return [checked.verdict for checked in check_claims(groups)]


def verdict_of(world, claim):
    """Return the verdict on one claim, counted from 1."""
    checked = CLAIMS[claim - 1].check(gather(groups_of(world)))
    return all_of(part.verdict for part in checked)


def test_differences_are_of_the_second_less_the_first(world):
    """By hand: SAC-Lag's cost rate is .2, TRPO-Lag's .1, and TRPO-Lag's EMCC falls from .5 to .2 in
    every run.

    J_C of WCSAC is 1, 1.01, ... 1.09, with the standard deviation .03028, so that the interval is
    1.045 ± 2.262 · .03028 / √10. Its EMCC_0.66 less CPO's is .6 - .35, both with the standard
    deviation .00908, so that the interval is .25 ± 2.101 · .00908 √(2 / 10).
    """
    checked = check_claims(groups_of(world))
    for k, told in {
        1: "Circle2D-0 10 of 10 runs [0.69, 1.00] fall, by -0.30 [-0.30, -0.30] (n = 10; paper +",
        3: "J_C 1.04 [1.02, 1.07] (n = 10; paper 1.65), episode cost after the first third 1.00 [",
        5: "EMCC_0.66: WCSAC - CPO +0.25 [+0.24, +0.26] (n = 10; paper +0.26; p of equivalence "
        "within 0.05: 1.000; p of the difference: <0.001)",
    }.items():
        assert any(told in words for words, _ in checked[k].findings)
    (words, verdict), *_ = checked[9].findings
    assert words.startswith("cost_rate: SAC-Lag - TRPO-Lag +0.10 [")
    printed = [paper_results(SAFETY[0], name)["cost_rate"] for name in ("SAC-Lag", "TRPO-Lag")]
    assert f"; paper {printed[0] - printed[1]:+.2f}; " in words
    assert verdict == "reproduced"
    fewer = world | {(SAFETY[0], "sac-lag"): world[SAFETY[0], "sac-lag"][:6]}
    (words, _), *_ = check_claims(groups_of(fewer))[9].findings
    assert "(n = 6 and 10; paper" in words


def test_claims_on_tasks_without_runs_are_left_out(world):
    circle2d = {key: runs for key, runs in world.items() if key[0] in LEVEL}
    assert len(verdicts(groups_of(circle2d))) == 9
    hopper = {key: runs[:3] for key, runs in world.items() if key[0] == SAFETY[2]}
    assert [of[0][:6] for of in check_claims(groups_of(hopper))] == ["EMCC o", "On Saf"]


def changed(runs, seeds, ends=None, records=None, **measures):
    """Return the runs with other numbers for some seeds; two underscores in a name are a dot."""
    measures = {k.replace("__", "."): v for k, v in measures.items()}
    return [
        replace(of, measures=of.measures | measures, ends=end_at(ends, 51) if ends else of.ends)
        if k in seeds
        else of
        for k, of in enumerate(runs)
    ]


SCENARIOS = {
    # Task and algorithm, seeds, their numbers, the claim (from 1), its verdict. The lower end of
    # the 95 % interval is .555 for 9 of 10 runs and .444 for 8; the one-sided upper end at .05 / 9
    # is .405 for 0 of 10 and .53 for 1; the lower end at .05 / 10 is .08 for 4 of 10 and .04 for 3.
    "one run stays within": (LEVEL[2], "trpo-lag", (0,), {"J_C": 5.0}, 1, "reproduced"),
    "two runs stay within": (LEVEL[2], "trpo-lag", (0, 1), {"J_C": 5.0}, 1, "undecided"),
    "nine runs stay within": (LEVEL[2], "trpo-lag", ALL[:9], {"J_C": 5.0}, 1, "undecided"),
    "all stay within": (LEVEL[2], "trpo-lag", ALL, {"J_C": 5.0}, 1, "not reproduced"),
    "two runs wait": (LEVEL[3], "trpo-lag", (1, 2), {"ends": "right rim"}, 1, "undecided"),
    "cost of 10.7": (LEVEL[1], "trpo-lag", ALL, {"J_C": 10.7}, 1, "reproduced"),
    "cost of 11": (LEVEL[1], "trpo-lag", ALL, {"J_C": 11.0}, 1, "not reproduced"),
    "cost of 9 to 15": (LEVEL[1], "trpo-lag", (0, 1, 2), {"J_C": 15.0}, 1, "undecided"),
    "one cost of 100 within": (LEVEL[1], "trpo-lag", (0,), {"J_C": 0.1}, 1, "reproduced"),
    "late EMCC": (LEVEL[1], "trpo-lag", ALL, {"EMCC_0__99": 0.25}, 1, "not reproduced"),
    "level 0 is not claimed": (LEVEL[0], "trpo-lag", ALL, {"J_C": 20.0}, 1, "reproduced"),
    "on-policy rises": (SAFETY[1], "cpo", ALL, {"EMCC_0__99": 0.6}, 2, "not reproduced"),
    "one seed rises": (SAFETY[1], "cpo", (0,), {"EMCC_0__99": 0.6}, 2, "reproduced"),
    "two seeds rise": (SAFETY[1], "cpo", (0, 1), {"EMCC_0__99": 0.6}, 2, "undecided"),
    "off-policy falls once": (SAFETY[1], "wcsac", ALL, {"EMCC_0__99": 0.1}, 2, "reproduced"),
    "SAC-Lag nowhere": (LEVEL[0], "sac-lag", ALL, {"ends": "right rim"}, 3, "not reproduced"),
    "SAC-Lag once": (LEVEL[0], "sac-lag", ALL[1:], {"ends": "right rim"}, 3, "undecided"),
    "SAC-Lag thrice": (LEVEL[0], "sac-lag", ALL[3:], {"ends": "right rim"}, 3, "reproduced"),
    "CPO once": (LEVEL[0], "cpo", (1,), {"ends": "corridor"}, 3, "undecided"),
    "CPO thrice": (LEVEL[0], "cpo", (1, 2, 3), {"ends": "corridor"}, 3, "undecided"),
    "CPO four times": (LEVEL[0], "cpo", ALL[:4], {"ends": "corridor"}, 3, "not reproduced"),
    "SAC-LB above": (LEVEL[1], "sac-lb", ALL, {"J_C": 5.01}, 3, "not reproduced"),
    "WCSAC too": (LEVEL[1], "wcsac", ALL, {"ends": "corridor", "J_C": 5.0}, 3, "not reproduced"),
    "in a cut-out": (LEVEL[3], "wcsac", ALL, {"ends": "top cut-out"}, 4, "reproduced"),
    "one in the corridor": (LEVEL[3], "wcsac", (1,), {"ends": "corridor"}, 4, "reproduced"),
    "two in the corridor": (LEVEL[3], "wcsac", (1, 2), {"ends": "corridor"}, 4, "undecided"),
    "nine above the limit": (LEVEL[0], "wcsac", ALL[1:], {"J_C": 6.0}, 4, "not reproduced"),
    "but for level 2": (LEVEL[2], "wcsac", ALL, {"J_C": 20.0}, 4, "reproduced"),
    "somebody once": (LEVEL[3], "sac-lb", (0,), {"ends": "corridor"}, 5, "undecided"),
    "somebody often": (LEVEL[3], "sac-lb", ALL[:5], {"ends": "corridor"}, 5, "not reproduced"),
    "not safely": (LEVEL[3], "sac-lb", ALL, {"ends": "corridor", "J_C": 6.0}, 5, "reproduced"),
    "other cost rates": (LEVEL[3], "cpo", ALL, {"cost_rate": 0.2}, 6, "not reproduced"),
    "cost rates of .1 to .2": (LEVEL[3], "cpo", (0, 1), {"cost_rate": 0.2}, 6, "undecided"),
    "equal EMCC": (LEVEL[3], "wcsac", ALL, {"EMCC_0__66": 0.36}, 6, "not reproduced"),
    "EMCC of .3 to .9": (LEVEL[3], "wcsac", ALL[1:], {"EMCC_0__66": 0.36}, 6, "undecided"),
    # TRPO-Lag's late EMCC is .2 to .227; with one seed of 1 the mean is .29.
    "CPO lower": (LEVEL[1], "cpo", ALL, {"EMCC_0__99": 0.19}, 7, "not reproduced"),
    "CPO equal": (LEVEL[1], "cpo", ALL, {"EMCC_0__99": 0.2135}, 7, "undecided"),
    "CPO higher but for a seed": (LEVEL[1], "cpo", (0,), {"EMCC_0__99": 0.2}, 7, "reproduced"),
    "TRPO-Lag of .2 to 1": (LEVEL[3], "trpo-lag", (0,), {"EMCC_0__99": 1.0}, 7, "undecided"),
    # p = .03: below .05, but not below .05 / 24.
    "CPO hardly lower": (LEVEL[1], "cpo", ALL, {"EMCC_0__99": 0.206}, 7, "undecided"),
    "SAC-LB lower in the middle": (
        LEVEL[2],
        "sac-lb",
        ALL,
        {"EMCC_0__66": 0.29},
        7,
        "not reproduced",
    ),
    "early EMCC is not claimed": (LEVEL[2], "trpo-lag", ALL, {"EMCC_0__33": 0.9}, 7, "reproduced"),
    "SAC-Lag cheaper": (SAFETY[0], "sac-lag", ALL, {"J_C": 0.5}, 10, "not reproduced"),
    "SAC-Lag once longer": (SAFETY[0], "sac-lag", ALL[:5], {"EMCC_0__66": 0.5}, 10, "undecided"),
    "TRPO-Lag shorter": (SAFETY[2], "trpo-lag", ALL, {"EMCC_0__33": 0.1}, 11, "not reproduced"),
    "CPO cheaper": (LEVEL[1], "cpo", ALL, {"J_C": 0.5}, 8, "not reproduced"),
    "CPO as cheap": (LEVEL[1], "cpo", ALL, {"J_C": 1.04}, 8, "undecided"),
    "WCSAC shorter early": (LEVEL[1], "wcsac", ALL, {"EMCC_0__33": 0.4}, 8, "not reproduced"),
    "on levels 2 and 3 not claimed": (LEVEL[2], "cpo", ALL, {"J_C": 0.5}, 8, "reproduced"),
    # With bounds at .05 / 4 the upper end for 0 of 10 is .355, the lower end for 2 of 10 is .03.
    "all through": (
        LEVEL[2],
        "sac-lag",
        ALL,
        {"ends": "corridor", "J_C": 9.0},
        9,
        "not reproduced",
    ),
    "all wait": (LEVEL[2], "wcsac", ALL, {"ends": "top cut-out", "J_C": 0.0}, 9, "not reproduced"),
    "eight through": (LEVEL[2], "wcsac", ALL[:8], {"ends": "corridor", "J_C": 9.0}, 9, "undecided"),
    "seven through": (
        LEVEL[2],
        "wcsac",
        ALL[:7],
        {"ends": "corridor", "J_C": 9.0},
        9,
        "reproduced",
    ),
    "waits at a cost": (LEVEL[2], "wcsac", ALL[5:], {"J_C": 5.01}, 9, "not reproduced"),
}


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_scenarios(world, scenario):
    task, name, seeds, numbers, claim, verdict = scenario
    world[task, name] = changed(world[task, name], seeds, **numbers)
    assert verdict_of(world, claim) == verdict


def test_an_off_policy_emcc_that_falls_on_every_task(world):
    for task in PAPER_STEPS:
        world[task, "sac-lb"] = changed(world[task, "sac-lb"], ALL, EMCC_0__99=0.1)
    assert verdict_of(world, 2) == "not reproduced"
    world[LEVEL[1], "sac-lb"] = changed(world[LEVEL[1], "sac-lb"], (0, 1), EMCC_0__99=0.9)
    assert verdict_of(world, 2) == "undecided"


def test_cost_late_in_training(world):
    world[LEVEL[0], "wcsac"] = [
        run(k, (0.5, 0.6, 0.7), 0.1, 1.0, "right rim", 5.5 if k else 1.0) for k in ALL
    ]
    assert verdict_of(world, 4) == "not reproduced"


def test_runs_that_decide_nothing(world):
    assert verdicts(groups_of(world, steps=10_000)) == []  # no run is of the paper's length
    few = {key: runs[: 9 if key[0] in LEVEL else 2] for key, runs in world.items()}
    assert verdicts(groups_of(few)) == ["undecided"] * 11
    others = [
        group(task, "trpo-lag", world[task, "trpo-lag"], multiplier_optimizer="sgd")
        for task in LEVEL
    ]
    assert check_claims(others) == []
    # Beside the preset's runs, those with another setting change no verdict.
    ablated = [group(of.task, "trpo-lag", changed(of.runs, ALL, J_C=0.0)) for of in others]
    ablated = [replace(of, config=other.config) for of, other in zip(ablated, others, strict=True)]
    assert verdicts([*ablated, *groups_of(world)]) == ["reproduced"] * 11


def test_another_choice_that_changes_a_verdict(world):
    """SAC-Lag that waits on level 0 with bootstrapping changes the third claim's verdict alone."""
    groups = [group(LEVEL[0], name, world[LEVEL[0], name]) for name in ALGORITHMS]
    waiting = changed(world[LEVEL[0], "sac-lag"], ALL, ends="right rim")
    nine, ten = (
        group(LEVEL[0], "sac-lag", runs, time_limit="bootstrap") for runs in (waiting[:9], waiting)
    )
    assert not any(checked.otherwise for checked in check_claims([*groups, nine]))
    [[other]] = [of.otherwise for of in check_claims([ten, *groups]) if of.otherwise]
    assert (other.choice, other.verdict, len(other.findings)) == ("bootstrap", "not reproduced", 1)
    words = (
        "in the corridor: SAC-Lag with bootstrap 0 of 10 runs [0.00, 0.31], SAC-LB 10 of 10 runs "
        "[0.69, 1.00] (claimed: each has some)"
    )
    [section] = claims_sections([ten, *groups])
    text = section.statements_markdown()
    assert f"With bootstrap: not reproduced\n\n- Circle2D-0: {words}: not reproduced\n" in text
    html = unescape(page("x", [section], {}))
    assert 'With bootstrap: <span class="not-reproduced">not reproduced</span>' in html
    assert html.count(words) == 1


def test_runs_with_physics_have_claims_of_their_own(world):
    """The rules are the same. Neither kind of runs decides the claims about the other."""
    world = {(task, name): runs for (task, name), runs in world.items() if task in LEVEL}
    groups = groups_of(world)
    with_physics = [
        replace(own, task=own.task.replace("Circle2D", "Circle2DMuJoCo")) for own in groups
    ]
    [kinematic] = claims_sections(groups)
    [physics] = claims_sections(with_physics)
    assert physics.title == CLAIMS_WITH_PHYSICS
    assert physics.statements == kinematic.statements
    other = [replace(own, runs=own.runs[:3]) for own in with_physics]
    both = claims_sections([*groups, *other])
    assert [section.statements == kinematic.statements for section in both] == [True, False]


def test_two_folders_of_other_seeds_count_together(world):
    parts = [
        group(task, name, of)
        for (task, name), runs in world.items()
        for of in (runs[:1], runs[1:], runs[:1])
    ]
    assert verdicts(parts) == ["reproduced"] * 11


def test_what_is_missing_is_named(world):
    del world[SAFETY[2], "cpo"]
    world[LEVEL[3], "wcsac"] = world[LEVEL[3], "wcsac"][:3]
    groups = groups_of(world)
    [section] = claims_sections(groups)
    text = section.statements_markdown()
    assert "; no runs: SafetyHopperVelocity: undecided" in text
    assert "; 3 of 10 runs: WCSAC: undecided" in text


def test_runs_of_other_length_decide_nothing_beside_full_ones(world):
    """The shorter runs stand before the full ones, the longer ones behind them. They have the same
    seeds, and by their costs the first claim would not hold."""
    demo = changed(world[LEVEL[1], "trpo-lag"], ALL, J_C=1.0, ends="right rim")
    others = [group(LEVEL[1], "trpo-lag", demo, steps=steps) for steps in (250_000, 2_000_000)]
    groups = groups_of(world)
    assert verdicts([others[0], *groups, others[1]]) == ["reproduced"] * 11
    del world[LEVEL[1], "trpo-lag"]
    checked = check_claims([*others, *groups_of(world)])[0]
    assert checked.verdict == "undecided"
    assert any("2,000,000 of 1,000,000 steps" in words for words, _ in checked.findings)


def test_emcc_across_families_is_of_windows_of_ten_episodes():
    """Every fortieth episode has a streak of half its length. Of the 20 windows that start in the
    second third five have such an episode, and the worst two count. With windows of one episode
    five of the worst 19.8 of 198 have one."""
    records = EpisodeRecords(
        np.arange(600), np.arange(600) * 10, np.full(600, 10), np.zeros(600), np.zeros(600),
        np.where(np.arange(600) % 10 == 3, 5, 0),
    )  # fmt: skip
    rare = replace(records, longest_streak=np.where(np.arange(600) % 40 == 3, 5, 0))
    runs = [replace(run(seed, (0, 0, 0), 0.1, 1.0, "right rim", 1.0), records=rare) for seed in ALL]
    own = group(LEVEL[3], "wcsac", runs)
    assert over_windows(own).values("EMCC_0.66") == [0.5] * 10
    alone = over_windows(own, 1)
    assert alone.values("EMCC_0.66") == pytest.approx([2.5 / 19.8] * 10)
    assert over_windows(alone).values("EMCC_0.66") == alone.values("EMCC_0.66")
    of_cpo = group(LEVEL[3], "cpo", runs)
    assert not mixed([own, own]) and mixed([own, of_cpo])
    assert not mixed([over_windows(own), over_windows(of_cpo)])
    across = [k for k, claim in enumerate(CLAIMS, 1) if claim.across]
    assert across == [6, 7, 8, 10, 11]  # the claims that compare EMCC of both families
    told = [of.findings for of in check_claims([own, of_cpo])]
    assert any("EMCC_0.66: WCSAC - CPO +0.00" in words for of in told for words, _ in of)


def test_the_first_third_by_hand():
    """Ten episodes of 10 steps: the first four start in the first 33 of 100 steps."""
    one = run(0, (0.5, 0.5, 0.5), 0.1, 1.0, "right rim", 1.0)
    one = replace(one, records=replace(one.records, cost=np.arange(10.0)))
    assert claims._early_mean("cost", one) == 1.5
    assert claims._later_cost(one) == 6.5


def test_runs_on_another_task_decide_nothing(world):
    own = group(LEVEL[1], "trpo-lag", world[LEVEL[1], "trpo-lag"])
    other = replace(own.config, task_parameters={"corridor_height_factor": 0.4})
    assert gather([replace(own, config=other)])[LEVEL[1], "trpo-lag"].lacking == "no runs"
