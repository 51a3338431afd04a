"""Ablations: other choices of settings that the paper does not specify, and SAC-LB-Streak without
one of its parts. Their grid and their tables."""

from dataclasses import replace
from pathlib import Path

import pytest
from small_runs import cells, write_evaluated

from agents.paper.grid import ablations
from agents.paper.sections import STUDY
from agents.presets import preset, preset_with
from agents.reporting.report import table
from agents.reporting.table import markdown
from agents.training.grid import grid

ALGORITHMS = ["trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"]
TASK, SAFETY = "Circle2D-1-v0", "circle2d_mj/SafetyPointGoal1-v0"


def test_the_grid_with_ablations():
    arguments = (Path("x"), [TASK, SAFETY], ALGORITHMS, (0, 1, 2), 1000)
    usual, all_of = grid(*arguments), grid(*arguments, variants=ablations)
    assert {folder: all_of[folder] for folder in usual} == usual
    safety = f"x/{SAFETY.replace('/', '-')}"
    added = {str(f): c for f, c in all_of.items() if f not in usual}
    assert added.keys() == {
        *(f"x/{TASK}/{name}" for name in ("trpo-lag-sgd", "sac-lag-bootstrap")),
        *(f"x/{TASK}/{name}" for name in ("sac-lb-bootstrap", "wcsac-bootstrap")),
        *(f"x/{TASK}/{name}-units" for name in ALGORITHMS),
        *(f"x/{TASK}/{name}-bootstrap-units" for name in ("sac-lag", "sac-lb", "wcsac")),
        *(f"{folder}/wcsac-library" for folder in (f"x/{TASK}", safety)),
        # The presets of Safety tasks bootstrap.
        *(f"{safety}/{name}" for name in ("trpo-lag-sgd", "sac-lag-terminal")),
        *(f"{safety}/{name}" for name in ("sac-lb-terminal", "wcsac-terminal")),
    }
    for folder, config in added.items():
        name, _, _ = folder.rpartition("/")[2].partition("-units")
        algorithm, _, choice = name.rpartition("-")
        changed = {
            "sgd": {"multiplier_optimizer": "sgd"},
            "library": {"variance_target": "unsquared", "damping_gradient": "through"},
            "bootstrap": {"time_limit": "bootstrap"},
            "terminal": {"time_limit": "terminal"},
        }.get(choice, {})
        algorithm = algorithm if changed else name
        if folder.endswith("-units"):
            changed = changed | {"input_scale": 15.0}
        expected = replace(preset(algorithm, config.tasks[0]), **changed)
        assert config.hyperparameters == expected
        assert (config.seeds, config.steps) == ((0, 1, 2), 1000)
    # The longest trainings still come first.
    assert [config.algorithm for config in all_of.values()][-5:] == ["trpo-lag"] * 5


def write_runs(folder, name, j_r, hyperparameters=None, ends=((-0.5, 0.0),), task=TASK):
    """Write runs of ten episodes, in which four of ten steps cost; they end at `ends` in turn."""
    at = [[end] for end in ends] if task.startswith("Circle2D") else None
    write_evaluated(folder, name, [4] * len(j_r), hyperparameters, task, returns=j_r, at=at)


ENDS = ((-0.5, 0.0), (1.0, 0.0))
"""In the corridor, and at the right rim."""


@pytest.fixture
def folder(tmp_path):
    write_runs(tmp_path / "trpo-lag", "trpo-lag", [-10.0, -20.0, -12.0], ends=ENDS)
    sgd = preset_with("trpo-lag", TASK, ablations("trpo-lag", TASK)["sgd"])
    write_runs(tmp_path / "trpo-lag-sgd", "trpo-lag", [-1.0, -3.0], sgd, ends=ENDS)
    write_runs(tmp_path / "cpo", "cpo", [-30.0, -32.0], ends=ENDS)
    return tmp_path


def test_both_choices_side_by_side(folder):
    words = markdown(table(folder, STUDY))
    start = words.index("Other choices of what the paper does not specify")
    end = words.index("Measures, over all tasks, in which")
    main_table, ablated = cells(words[:start]), cells(words[start:end])
    assert [row[0] for row in ablated[1:]] == [
        f"{TASK}, TRPO-Lag, adam (preset), mean of 3",
        f"{TASK}, TRPO-Lag, sgd, mean of 2",
        f"{TASK}, TRPO-Lag, paper (3 seeds)",
    ]
    of_preset, of_other, of_paper = ablated[1:]
    assert of_preset[5] == "-14.00 range -20.00 to -10.00"
    assert of_other[5] == "**-2.00** range -3.00 to -1.00"  # 2.68 from the paper, not 9.32
    assert of_paper[5] == "-4.68"
    assert of_preset[6].startswith("**4.25**")  # both of two equal ones are marked
    assert of_other[6].startswith("**4.25**")
    # The lower end for 3 of 3 runs is the third root of .025, for 2 of 2 the square root.
    ends = "corridor, round 2 of 3 [0.09, 0.99]; right rim 1 of 3 [0.01, 0.91]"
    assert of_preset[9:] == ["3 of 3 [0.29, 1.00]", ends]
    ends = "corridor, round 1 of 2 [0.01, 0.99]; right rim 1 of 2 [0.01, 0.99]"
    assert of_other[9:] == ["2 of 2 [0.16, 1.00]", ends]
    # The best J_R in the main table is the preset's, though that of the other choice is higher.
    assert not any("sgd" in row[0] for row in main_table)
    (of_preset,) = (row for row in main_table if row[0] == "TRPO-Lag, mean of 3")
    assert of_preset[5] == "**-14.00** range -20.00 to -10.00"
    assert "TRPO-Lag (multiplier_optimizer sgd" in (folder / "report.csv").read_text()


def test_each_part_of_sac_lb_streak_is_left_out_once():
    usual, plain = preset("sac-lb-streak", TASK), preset("sac-lb", TASK)
    choices = ablations("sac-lb-streak", TASK)
    changed = {choice: {*values} for choice, values in choices.items()}
    assert all(v != getattr(usual, k) for values in choices.values() for k, v in values.items())
    assert changed == {
        "without-streak": {"streak_weight"},
        "without-brown": {"random_exponent"},
        "without-share": {"random_share"},
        "without-novelty": {"novelty_bonus"},
        "without-horizon": {"time_limit"},
        "without-scale": {"input_scale", "novelty_length"},
        "without-speed": {"learning_rate", "temperature_lr", "batch_size", "gradient_steps"},
        "margin": {"streak_weight", "cost_limit"},
    }
    unscaled = choices["without-scale"]["novelty_length"]  # the same distance in other units
    assert unscaled == pytest.approx(2.0 / 15)
    changed["without-scale"].remove("novelty_length")
    # Together the parts are everything in which it differs from SAC-LB.
    parts = set().union(*(of for choice, of in changed.items() if choice != "margin"))
    assert parts == {k for k, v in vars(usual).items() if v != getattr(plain, k)}
    for choice in changed.keys() - {"margin"}:
        assert all(choices[choice][k] == getattr(plain, k) for k in changed[choice])
    assert choices["margin"]["cost_limit"] == 3.5
    assert ablations("sac-lb-streak", SAFETY) == {}


def test_parts_have_a_table_of_their_own(tmp_path):
    choices = {"": {}} | ablations("sac-lb-streak", TASK)  # the table has this order
    for value, (choice, values) in enumerate(choices.items()):
        folder, j_r = tmp_path / f"of-{choice}", [-10.0 - value, -20.0]
        config = preset_with("sac-lb-streak", TASK, values)
        write_runs(folder, "sac-lb-streak", j_r, config, ends=ENDS)
    words = markdown(table(tmp_path, STUDY))
    assert "Other choices of what the paper does not specify" not in words
    start = words.index("SAC-LB-Streak without one of its parts")
    main_table, of_parts = cells(words[:start]), cells(words[start:])[1:]
    assert [row[0] for row in of_parts] == [
        f"{TASK}, SAC-LB-Streak, {choice or 'preset'}, mean of 2" for choice in choices
    ]
    assert [row[5].split()[0] for row in of_parts] == [f"{-15 - k / 2:.2f}" for k in range(9)]
    assert len([row for row in main_table if "mean of" in row[0]]) == 1


def test_parts_over_all_tasks(tmp_path):
    """Two runs of the preset against two without the streak cost, on each of two levels. Their
    records are equal, so that every permutation is as extreme. A part that was left out on one
    level alone is not in the table."""
    for task in (TASK, "Circle2D-2-v0"):
        choices = ablations("sac-lb-streak", task)
        shown = ["without-streak", "without-share"] if task == TASK else ["without-streak"]
        usual = tmp_path / task / "preset"
        write_runs(usual, "sac-lb-streak", [-10.0, -20.0], task=task, ends=ENDS)
        for choice in shown:
            folder = tmp_path / task / choice
            config = preset_with("sac-lb-streak", task, choices[choice])
            write_runs(folder, "sac-lb-streak", [0.0, 0.0], config, task=task, ends=ENDS)
    words = markdown(table(tmp_path, STUDY))
    found = cells(words[words.index("| over all tasks") :])
    name = "B - A: without-streak - preset"
    assert found[1:4] == [
        [f"{name}, 2 tasks, 2 seeds against 2", *["+0.000"] * 4],
        ["p, corrected for 4 (Holm)", *["1.000"] * 4],
        ["P(B better)", *["0.50"] * 4],
    ]
    assert "without-share - preset" not in words


def test_how_often_a_choice_is_the_nearest(folder):
    """TRPO-Lag's choices differ in J_R alone, in which SGD is nearer to the paper. Where measures
    are equal, both choices count. CPO has no other choice here."""
    words = markdown(table(folder, STUDY))
    found = cells(words[words.index("Measures, over all tasks, in which") :])
    assert found[1:] == [["TRPO-Lag, adam (preset)", "6 of 7"], ["TRPO-Lag, sgd", "7 of 7"]]
