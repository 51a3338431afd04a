"""The search for the paper's settings: its distance by hand, its proposals, and its page."""

import importlib.util
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.algorithms import algorithm
from agents.paper.grid import PAPER_ALGORITHMS
from circle2d_mj.circle2d.config import Circle2DConfig

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("found", ROOT / "benchmarks" / "identification.py")
search = importlib.util.module_from_spec(spec)
spec.loader.exec_module(search)
Setting = search.Setting
WIDE = {(*cell[:2], m): 2.0 for cell in search.cells() for m in (*search.FLOORS, *search.HELD_BACK)}
"""A spread of 2 in every cell."""


def runs(setting=Setting(), off=0.0, seeds=4, noise=0.0):  # noqa: B008
    """Return runs whose means are the paper's numbers, plus `off` in J_R."""
    rng, rows = np.random.default_rng(0), []
    printed = search.cells({**search.FLOORS, **search.HELD_BACK})
    for name in PAPER_ALGORITHMS:
        for task in search.TASKS:
            for seed in range(seeds):
                own = {"setting": setting.name, **asdict(setting)}
                own |= {"algorithm": name, "task": task, "seed": seed}
                for m in (*search.FLOORS, *search.HELD_BACK):
                    own[m] = printed[name, task, m] + off * (m == "J_R") + noise * rng.normal()
                rows.append(own)
    return pd.DataFrame(rows)


def test_there_are_eighty_numbers_and_sixty_held_back():
    assert len(search.cells()) == 80 and len(search.cells(search.HELD_BACK)) == 60
    assert not set(search.FLOORS) & set(search.HELD_BACK)
    assert search.cells()["trpo-lag", "Circle2D-2-v0", "J_R"] == -4.23
    assert search.cells()["sac-lb", "Circle2D-2-v0", "J_C"] == 0
    assert search.cells()["trpo-lag", "Circle2D-1-v0", "J_R"] == -4.68  # printed without its sign


def test_the_distance_by_hand():
    """J_R is off by 3, or 1.5 spreads of 2, in 20 of 80 cells: 1.5 / 4 = .375. Off by 30 counts as
    5 spreads, the most: 5 / 4. The four cells of an algorithm that lacks a level count as 5 each.
    A spread below the floor of .5 counts as .5: 3 / .5 = 6, so 5 again."""
    assert search.distance_of(runs(), WIDE) == 0
    assert search.distance_of(runs(off=3.0), WIDE) == pytest.approx(0.375)
    assert search.distance_of(runs(off=-3.0), WIDE) == pytest.approx(0.375)
    assert search.distance_of(runs(off=30.0), WIDE) == pytest.approx(1.25)
    own = runs()
    lacking = own[(own["algorithm"] != "cpo") | (own["task"] != "Circle2D-3-v0")]
    assert search.distance_of(lacking, WIDE) == pytest.approx(4 * 5 / 80)
    one_seed = own.index.difference(lacking.index)[0]
    assert search.distance_of(own.drop(one_seed), WIDE) == pytest.approx(4 * 5 / 80)
    narrow = dict.fromkeys(WIDE, 0.0)
    assert search.distance_of(runs(off=3.0), narrow) == pytest.approx(1.25)
    assert search.distance_of(runs(off=3.0), WIDE, search.HELD_BACK) == 0


def test_the_distance_is_that_of_means_over_seeds():
    own = runs()
    own["J_C"] += np.where(own["seed"] % 2, 4.0, -4.0)
    assert search.distance_of(own, WIDE) == pytest.approx(0, abs=1e-9)


def test_the_rule_finds_the_nearest_setting():
    """The distance is the number of values that differ from `target`. The rule proposes 18
    settings, then 11 more, then 6, within its limit of 40, and finds the target."""
    target = Setting(0.6, 0.1, "length", follows="episode", optimizer="sgd")

    def far(own):
        wrong = sum(asdict(own)[k] != v for k, v in asdict(target).items())
        return wrong + own.step / 100

    known, sizes = {}, []
    while True:
        asked = search.proposed(known)
        sizes.append(len(asked))
        new = [own for own in asked if own not in known]
        if not new:
            break
        known[new[0]] = far(new[0])
    assert sorted(set(sizes)) == [18, 29, 35] and sizes[-1] <= search.MOST_SETTINGS
    assert min(known, key=known.get) == target
    assert Setting() in known
    full = search.in_full(known)
    order = sorted(known, key=known.get)
    assert full[:5] == order[:5] and full[-1] == Setting() and len(full) == 7
    assert full[5].geometry == Setting().geometry


def test_settings_become_hyperparameters_that_the_algorithms_have():
    other = Setting(units="length", limit="bootstrap", reward="running", follows="start")
    other = replace(other, optimizer="sgd", on_policy_limit="terminal", wcsac="library")
    for name in PAPER_ALGORITHMS:
        config = algorithm(name).config(**other.hyperparameters(name))
        assert config.input_scale == 15.0
        assert config.time_limit == ("bootstrap" if algorithm(name).off_policy else "terminal")
    assert other.hyperparameters("sac-lag")["multiplier_of"] == "start"
    assert other.hyperparameters("trpo-lag")["multiplier_optimizer"] == "sgd"
    assert "multiplier_of" not in other.hyperparameters("sac-lb")
    assert other.hyperparameters("wcsac")["variance_target"] == "unsquared"
    assert Setting(depth=0.6).geometry == {"cutout_depth": 0.6, "step_length": 0.11}
    assert Setting(depth=0.6).name == "depth 0.6" and Setting().name == "today's"


def test_runs_in_common_are_trained_once(monkeypatch, tmp_path):
    """Only runs that a change concerns are trained; the others are taken from the table, under the
    new setting's name."""
    trained, table = [], runs(seeds=2)
    monkeypatch.setattr(search.agents, "grid", lambda *what, **_: trained.append(what))
    every, cut_out = list(search.TASKS), ["Circle2D-2-v0", "Circle2D-3-v0"]
    for change, expected in (
        ({"depth": 0.6}, [(name, cut_out) for name in PAPER_ALGORITHMS]),
        ({"follows": "start"}, [("sac-lag", every), ("wcsac", every)]),
        ({"on_policy_limit": "terminal"}, [("trpo-lag", every), ("cpo", every)]),
        ({"wcsac": "library"}, [("wcsac", every)]),
        ({}, []),
    ):
        new = replace(Setting(), **change)
        found = search.train(new, {}, tmp_path, table)
        assert sorted(trained) == sorted(expected)
        assert len(found) == len(table) - 2 * sum(len(tasks) for _, tasks in expected)
        assert set(found["setting"]) <= {new.name}
        trained.clear()
    step = search.train(Setting(step=0.1), {}, tmp_path, table)
    assert not len(step) and sorted(trained) == sorted((n, every) for n in PAPER_ALGORITHMS)


@pytest.mark.parametrize("level", range(4))
def test_the_depth_matters_on_levels_with_cut_outs(level):
    points = np.random.default_rng(0).uniform(-16, 16, (20_000, 2))
    of_depth = [Circle2DConfig(level, cutout_depth=depth).region for depth in (0.5, 0.55)]
    same = np.array_equal(*(region.contains(points) for region in of_depth))
    assert same == (search.TASKS[level] not in search.CUT_OUT)


def test_another_geometry_must_be_clearly_nearer():
    """By at least .25, certainly over seeds, and without being farther in EMCC."""
    home, away = Setting(), Setting(depth=0.6)
    far, near = runs(home, off=3.0, noise=0.3), runs(away, noise=0.3)
    found = search.clearly_nearer(pd.concat([far, near]), WIDE)
    assert found[0] == away and found[1][0] > 0.25
    assert search.clearly_nearer(pd.concat([runs(home, off=1.0), near]), WIDE) is None
    worse = near.assign(**{"EMCC_0.99": near["EMCC_0.99"] + 5})
    assert search.clearly_nearer(pd.concat([far, worse]), WIDE) is None
    noisy = runs(away, seeds=4, noise=8.0)
    assert search.clearly_nearer(pd.concat([runs(home, off=3.0, noise=8.0), noisy]), WIDE) is None
    assert search.clearly_nearer(far, WIDE) is None


def squeezed(text):
    """Return the text with single spaces."""
    return re.sub(" +", " ", text)


def test_the_page_ranks_settings_and_names_cells_that_none_explains():
    screened = pd.concat([runs(off=3.0), runs(Setting(depth=0.6), off=10.0)])
    text = squeezed(search.page(screened, runs(Setting(depth=0.6)), WIDE))
    assert text.index("| today's | 0.38 |") < text.index("| depth 0.6 | 1.25 |")
    assert "| depth | 0.6 | 1 | 0.88 | 0.88 | 0.88 |" in text and "| step |" not in text
    assert "| depth 0.6 | 0.00 | 0.00 |" in text
    far = squeezed(search.page(runs(off=30.0), pd.DataFrame(), WIDE))
    assert "| TRPO-Lag | Circle2D-2-v0 | J_R | -4.23 | 5.00 |" in far


def test_what_a_choice_moves_is_told_by_pairs_that_differ_in_it_alone():
    """Depth .6 has two pairs, at either step: 3 - 4 and 1 - 5. (.55, .1) has none."""
    near = {Setting(): 4.0, Setting(0.6): 3.0, Setting(0.55, 0.1): 0.5}
    near |= {Setting(step=0.115): 5.0, Setting(0.6, 0.115): 1.0}
    assert list(search.moved(near, "depth")) == [["0.6", 2, -2.5, -4.0, -1.0]]
    assert list(search.moved(near, "step")) == [["0.115", 2, -0.5, -2.0, 1.0]]
    assert list(search.moved(near, "optimizer")) == []


def test_the_published_runs_give_a_spread_for_every_cell():
    assert search.read_spread().keys() >= WIDE.keys()
