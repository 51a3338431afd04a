"""The analysis of the study of streaks, on invented tables whose outcome is known."""

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import agents
from emcc import emcc, mcc

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("streaks", ROOT / "benchmarks" / "streaks.py")
streaks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(streaks)
RATES = {
    "weight .1": 0.02,
    "streak 20": 0.02,
    "streak 10": 0.015,
    "streak 5": 0.01,
    "tail 20": 0.005,
}
CONTROL_RATES = {arm: float(arm.split()[1]) / 1000 for arm in streaks.CONTROL}


def table(gap=0.0, rate=0.012, lost=0.0, tasks=streaks.TASKS, noise=0.01, draw=0):
    """Return invented runs. Control arms have an EMCC of 10 and a return of 1000 times their cost
    rate, plus noise. Other arms have the given rate (None: that of `RATES`), an EMCC that is lower
    by `gap`, and a return that is lower by `lost`."""
    rng, rows = np.random.default_rng(draw), []
    for task in tasks:
        for arm in streaks.ARMS:
            control = arm in CONTROL_RATES
            at = CONTROL_RATES.get(arm) or rate or RATES[arm]
            for seed in streaks.SEEDS:
                emcc_ = 10 * at - gap * (not control) + noise * rng.normal()
                returned = 1000 * at - lost * (not control) + 10 * noise * rng.normal()
                own = {"task": task, "arm": arm, "seed": seed, "EMCC": emcc_, "rate": at}
                own |= {"return": returned, "longest": 1.0, "J_R": returned, "J_C": 25.0}
                rows.append(own)
    return pd.DataFrame(rows)


def primary(judged):
    return judged[judged["arm"] == streaks.PRIMARY].set_index("task")


def test_a_lower_emcc_at_equal_rate_and_return_is_a_success():
    """So on four tasks. On the fifth the return is lower, on the sixth the cost rate is below all
    of the control's, on the seventh EMCC is that of the control."""
    of = streaks.TASKS
    parts = [table(0.05, tasks=of[:4]), table(0.05, lost=5.0, tasks=of[4:5])]
    parts += [table(0.05, rate=0.001, tasks=of[5:6]), table(0.0, tasks=of[6:])]
    runs = pd.concat(parts)
    found = primary(streaks.judge(runs))
    assert found["success"].tolist() == [True] * 4 + [False] * 3
    assert found.loc[list(of[:4]), "gap"].to_numpy() == pytest.approx(-0.05, abs=0.01)
    assert not found.loc[of[4], "as_good"] and found.loc[of[4], "lower"]
    assert not found.loc[of[5], "comparable"] and found.loc[of[5], "lower"]
    assert not found.loc[of[6], "lower"]
    assert streaks.verdict(streaks.judge(runs)).startswith("Success: `streak 10` succeeds on 4 of")
    fewer = runs[runs["task"] != of[0]]
    assert streaks.verdict(streaks.judge(fewer)) == "Undecided: 6 of 7 tasks are complete."


def test_the_study_fails_as_soon_as_the_remaining_tasks_cannot_avert_it():
    """After one success and three failures all three others must succeed; a failure decides."""
    runs = pd.concat([table(0.05, tasks=of(1)), table(0.0, tasks=streaks.TASKS[1:5])])
    four = streaks.judge(runs[runs["task"] != streaks.TASKS[4]])
    assert streaks.verdict(four) == "Undecided: 4 of 7 tasks are complete."
    assert streaks.verdict(streaks.judge(runs)) == (
        f"No success: `streak 10` succeeds on 1 of 5 tasks ({streaks.TASKS[0]}); 4 of 7 are asked."
    )


def test_an_arm_on_the_controls_curve_is_no_success():
    """It has another cost rate, with the EMCC and the return that the control has there."""
    for rate in (0.008, 0.02):
        judged = streaks.judge(table(rate=rate))
        assert not judged["success"].any()
        assert streaks.verdict(judged).startswith(
            "No success: `streak 10` succeeds on 0 of 7 tasks;"
        )
    higher = streaks.judge(table(gap=-0.05))
    assert not higher["success"].any() and (primary(higher)["p"] < 0.02).all()


def test_a_gap_by_hand():
    """The control's points of cost rate and EMCC are (.005, .05), (.01, .1), ..., (.025, .25). The
    curve is .12 at a rate of .012 and .05 below all rates; the arm's EMCC is .08."""
    for rate, expected in ((0.012, -0.04), (0.001, 0.03), (0.1, -0.17)):
        own = table(rate=rate, tasks=of(1), noise=0.0)
        own.loc[own["arm"] == "streak 10", "EMCC"] = 0.08
        np.testing.assert_allclose(streaks.gaps(own, "streak 10", "EMCC"), expected)


def test_the_sign_test_by_hand():
    """Of the eight signed sums of 1, 2, 3, two are as far from 0 as 6; 1 + 2 - 3 is 0."""
    assert streaks.sign_test(np.array([1.0, 2.0, 3.0])) == 2 / 8
    assert streaks.sign_test(np.array([1.0, 2.0, -3.0])) == 1


def test_the_test_errs_no_more_often_than_it_says():
    """In 300 draws of an arm on the control's curve, p <= .05 is expected 15 times, with a standard
    deviation of 3.8."""
    p = [
        streaks.sign_test(streaks.gaps(table(tasks=of(1), draw=k), "streak 10", "EMCC"))
        for k in range(300)
    ]
    assert 4 <= np.sum(np.array(p) <= 0.05) <= 27


def test_p_values_are_corrected_over_tasks():
    """A certain gap has the least p, 2 of 1 024 signs; on seven tasks it is seven times that."""
    for count in (1, 7):
        judged = primary(streaks.judge(table(0.1, tasks=of(count))))
        np.testing.assert_allclose(judged["p"], count * 2 / 1024)


def of(count):
    return streaks.TASKS[:count]


def test_incomplete_tasks_are_left_out():
    runs = table(tasks=of(2))
    lacking = (runs["task"] == of(1)[0]) & (runs["arm"] == "tail 20") & (runs["seed"] == 203)
    assert streaks.complete(runs) == list(of(2))
    assert streaks.complete(runs[~lacking]) == [of(2)[1]]
    doubled = pd.concat([runs[~lacking], runs[:1]])
    assert streaks.complete(doubled) == [of(2)[1]]


def test_rows_are_added_and_the_first_of_a_run_stays():
    """Rows of two tasks, and of three with another return; sorted by task, arm and seed."""
    before, again = table(tasks=of(2)), table(tasks=of(3), lost=1.0)
    found = streaks.merged(before, again.to_dict("records"))
    assert len(found) == len(again) and streaks.complete(found) == list(of(3))
    key = ["task", "arm", "seed"]
    expected = pd.concat([before, again[again["task"] == of(3)[2]]]).sort_values(key)
    pd.testing.assert_frame_equal(found, expected.reset_index(drop=True)[found.columns])
    assert streaks.merged(pd.DataFrame(), again.to_dict("records")).equals(
        again.sort_values(key, ignore_index=True)
    )


def test_hypervolumes_by_hand():
    """(.2, .6) and (.5, .1) give .8 x .4 + .5 x .5 = .57; a dominated point adds nothing."""
    points = [(0.5, 0.1), (0.2, 0.6)]
    assert streaks.hypervolume(np.array(points)) == pytest.approx(0.57)
    assert streaks.hypervolume(np.array([*points, (0.6, 0.7)])) == pytest.approx(0.57)
    assert streaks.hypervolume(np.array([(1.0, 0.0), (0.0, 1.0)])) == 0


def test_hypervolumes_against_counting_points_of_a_grid():
    rng = np.random.default_rng(1)
    points = rng.random((5, 2))
    grid = (np.arange(400) + 0.5) / 400
    x, y = np.meshgrid(grid, grid)
    covered = ((x[..., None] >= points[:, 0]) & (y[..., None] >= points[:, 1])).any(axis=-1)
    assert streaks.hypervolume(points) == pytest.approx(covered.mean(), abs=0.01)


def test_hypervolumes_tell_the_better_family():
    for gap, sign in ((0.05, 1), (-0.05, -1)):
        found = streaks.volume_rows(table(gap, rate=None, tasks=of(4)))
        assert (np.sign(found["streak"] - found["plain"]) == sign).all()
        assert (found["p"] < 0.001).all()


def test_the_base_learner_is_the_best_that_meets_its_limit():
    """B has the highest return but exceeds the limit on one task. A's score is higher than C's:
    (10/20 + 4/4) / 2 = .75 against (8/20 + 2/4) / 2 = .45."""
    rows = [("A", "t", 27.0, 10.0), ("A", "u", 20.0, 4.0), ("B", "t", 28.0, 20.0)]
    rows += [("B", "u", 20.0, 4.0), ("C", "t", 5.0, 8.0), ("C", "u", 5.0, 2.0)]
    screening = pd.DataFrame(rows, columns=["candidate", "task", "cost", "return"])
    assert streaks.choose(screening) == "A"
    screening["cost"] += 20
    assert streaks.choose(screening) == "C"


def test_rows_of_runs_are_what_their_records_say(tmp_path):
    """EMCC of the last third, in windows of ten episodes of 50 steps, computed from the costs of
    single steps. The second cost, that of the streak limit, has no rows."""
    settings = {"seeds": (3, 4), "steps": 3_000, "evaluation_episodes": 2, "episodes": 3}
    runs = agents.train("ppo-lag", out=tmp_path / "run", streak_limit=5.0, **settings)
    rows = streaks.rows_of(tmp_path, arm="x")
    assert [(row["arm"], row["task"], row["seed"]) for row in rows] == [
        ("x", "Circle2D-1-v0", seed) for seed in (3, 4)
    ]
    arrays, prefix = np.load(runs.folder / "results.npz"), "Circle2D-1-v0/3/costs/cost/"
    costs = np.unpackbits(arrays[prefix + "unsafe"])[: arrays[prefix + "steps"]].astype(float)
    assert len(costs) >= 3_000
    episodes = costs.reshape(-1, 50)
    windows = [episodes[k : k + 10] for k in range(0, len(episodes) - 9, 10)]
    starts = np.arange(len(windows)) * 500
    late = [w for w, start in zip(windows, starts, strict=True) if start >= 2 / 3 * costs.size]
    assert rows[0]["EMCC"] == pytest.approx(emcc([mcc(window) for window in late], 0.1))
    assert rows[0]["rate"] == pytest.approx(np.mean(late))


def test_page_and_figure(tmp_path):
    runs = table(0.05, tasks=of(1))
    text = streaks.page(runs)
    assert text.startswith("# The longest streak as a constraint: analysis\n\nUndecided: 1 of 7")
    assert text.count("\n| SafetyPointCircle1-v0 |") == 5 + len(streaks.ARMS)
    streaks.draw(runs, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000
