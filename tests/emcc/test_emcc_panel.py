"""The panel of measures against plain loops over steps, which share no code with the package."""

import json
import math

import numpy as np
import pytest

import emcc
from emcc import EpisodeRecords, panel

KINDS = {
    "mixed": lambda rng: [(rng.random(n) < 0.4) * rng.random(n) for n in rng.integers(1, 30, 60)],
    "zero or one": lambda rng: [(rng.random(n) < 0.4) * 1.0 for n in rng.integers(1, 30, 60)],
    "single steps": lambda rng: [rng.integers(0, 2, 1) * 1.0 for _ in range(60)],
    "every step costs": lambda rng: [np.ones(n) for n in rng.integers(1, 9, 60)],
    "no step costs": lambda rng: [np.zeros(n) for n in rng.integers(1, 9, 60)],
    "one episode": lambda rng: [np.array([0.0, 1.0, 1.0, 0.0, 1.0])],
}


def streaks_of(costs):
    """Return the lengths of an episode's streaks."""
    found, running = [], 0
    for cost in [*costs, 0]:
        if cost > 0:
            running += 1
        elif running:
            found.append(running)
            running = 0
    return found


def highest_tenth(values):
    """Return the worst tenth: every value repeated ten times, the highest len(values) of these."""
    return sorted((value for value in values for _ in range(10)), reverse=True)[: len(values)]


def oracle(episodes, limit, window):
    """Return the measures; each episode is a rollout. episodes: costs of steps of each."""
    sums = [math.fsum(costs) for costs in episodes]
    lengths = [len(costs) for costs in episodes]
    over = [max(total - limit, 0) for total in sums]
    violating = [total - limit for total in sums if total > limit]
    excess = sum(violating) / len(violating) if violating else 0.0
    rates = []
    size = min(window, len(sums))
    for first in range(len(sums) - size + 1):
        rates.append(sum(sums[first : first + size]) / sum(lengths[first : first + size]))
    mcc = [max(streaks_of(costs), default=0) / len(costs) for costs in episodes]
    streaks = [streak for costs in episodes for streak in streaks_of(costs)]
    ranked = sorted(sums)
    place = 0.95 * (len(sums) - 1)
    below, above = ranked[math.floor(place)], ranked[math.ceil(place)]
    tail, tail_mcc = highest_tenth(sums), highest_tenth(mcc)
    return {
        "episodes": len(sums),
        "steps": sum(lengths),
        "cost_rate": sum(sums) / sum(lengths),
        "cvar": sum(tail) / len(tail),
        "violation_rate": len(violating) / len(sums),
        "severity": None if limit == 0 else (sum(sums) / len(sums) - limit) / limit,
        "severity_of_violations": excess and (None if limit == 0 else excess / limit),
        "regret": sum(over),
        "p95": below + (place - math.floor(place)) * (above - below),
        "maximum": max(sums),
        "peak_rate": max(rates),
        "emcc": sum(tail_mcc) / len(tail_mcc),
        "mcc": sum(mcc) / len(mcc),
        "longest_streak": max(streaks, default=0),
        "mean_streak": sum(streaks) / len(streaks) if streaks else 0.0,
    }  # fmt: skip


def records_of(episodes, **options):
    return EpisodeRecords.from_costs(
        np.concatenate(episodes), [len(c) for c in episodes], **options
    )


def third(episodes, low, high):
    """Return the episodes that start in [low, high) % of all steps."""
    total, start, found = sum(map(len, episodes)), 0, []
    for costs in episodes:
        if low * total <= 100 * start < high * total:
            found.append(costs)
        start += len(costs)
    return found


def assert_equal(measures, expected):
    for name, value in expected.items():
        found = getattr(measures, name)
        assert found == (value if value is None else pytest.approx(value, rel=1e-12)), name


@pytest.mark.parametrize("limit", [0, 1.5, 4, 1000])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(2))
def test_every_measure_of_training_and_of_its_thirds(kind, limit, seed):
    episodes = KINDS[kind](np.random.default_rng(seed))
    rows = np.random.default_rng(seed).permutation(len(episodes))  # start steps give the order
    found = panel(records_of(episodes).select(rows), limit, moving_window=7)
    assert_equal(found, oracle(episodes, limit, 7))
    assert list(found.parts) == [0.33, 0.66, 0.99]
    for part, (low, high) in zip(found.parts.values(), ((0, 33), (33, 66), (66, 99)), strict=True):
        some = third(episodes, low, high)
        if some:
            assert_equal(part, oracle(some, limit, 7))


@pytest.mark.parametrize("seed", range(5))
def test_time_to_feasible(seed):
    rng = np.random.default_rng(seed)
    sums = rng.integers(0, 9, 40)
    episodes = [np.ones(n) if n else np.zeros(2) for n in sums]
    found = panel(records_of(episodes), 4.0, moving_window=5)
    within = [sum(sums[i : i + 5]) <= 20 for i in range(36)]
    first = within.index(True)
    assert found.steps_to_feasible == sum(map(len, episodes[:first]))
    assert found.feasible_share == sum(within[first:]) / (36 - first)
    never = panel(records_of([np.ones(3)] * 9), 2.0, moving_window=4)
    assert (never.steps_to_feasible, never.feasible_share) == (None, 0.0)
    always = panel(records_of([np.ones(3)] * 9), 3.0, moving_window=4)
    assert (always.steps_to_feasible, always.feasible_share) == (0, 1.0)


@pytest.mark.parametrize("limit", [0.1, 0.7, 12.3, 25.3])
def test_limits_that_means_miss_by_rounding(limit):
    """Costs equal to the limit satisfy it; without costs, severity is -1, in a table too."""
    equal = panel(records_of([[limit]] * 100), limit)
    assert (equal.steps_to_feasible, equal.feasible_share) == (0, 1.0)
    for count in range(1, 60):
        none = panel(records_of([[0.0]] * count), limit, moving_window=1)
        assert none.severity == -1.0 and "-1" in none.to_markdown()


def test_distribution_of_mcc_and_rollouts_of_several_trajectories():
    """MCC is a measure of rollouts, the violation rate of episodes."""
    episodes = [[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [1, 1, 1, 1]]
    assert panel(records_of(episodes), 1.0).mcc_above == {0.25: 0.75, 0.5: 0.5, 0.75: 0.25}
    found = panel(records_of([[1, 0], [0, 0], [1, 1], [0, 0]], rollouts=[0, 0, 1, 1]), 1.0)
    assert (found.mcc, found.violation_rate) == (0.75, 0.25)


def test_a_third_in_which_no_whole_episode_starts_has_its_emcc():
    """Two environments, each with one episode of 6 steps, cut into rollouts of 2 steps: both
    episodes start at step 0, but a rollout starts in each third."""
    recorders = {kind: emcc.CostRecorder(2, kind) for kind in ("manual", "episode")}
    for step, cost in enumerate([1, 0, 1, 1, 0, 0], 1):
        for recorder in recorders.values():
            recorder.step([cost, 0], [0, 0], [step == 6] * 2)
        if step % 2 == 0:
            recorders["manual"].end_rollout()
    rollouts, episodes = (recorder.records for recorder in recorders.values())
    found = panel(rollouts, 2.0, episodes=episodes)
    by_part = {part: measures.emcc for part, measures in found.parts.items()}
    assert by_part == rollouts.emcc_by_part() == {0.33: 0.5, 0.66: 1.0, 0.99: 0.0}
    assert found.parts[0.33].violation_rate == 0.5
    later = found.parts[0.66]
    assert (later.episodes, later.steps, later.cost_rate) == (0, 4, 0.5)
    assert {later.maximum, later.cvar, later.p95, later.violation_rate, later.regret} == {None}


def test_without_a_limit():
    found = panel(records_of([[1, 0], [1, 1]]))
    assert found == panel(records_of([[1, 0], [1, 1]]), None)
    limited = found.violation_rate, found.severity, found.severity_of_violations, found.regret
    assert {*limited, found.steps_to_feasible, found.feasible_share} == {None}
    assert "violation" not in found.to_markdown()


def test_ties_are_passed_on():
    records = records_of([[1, 0], [1, 1], [1, 1], [0, 0]])
    split = panel(records, 1.0, alpha=0.625)
    assert split.emcc == pytest.approx((1 + 1 + 0.25) / 2.5)
    every = panel(records, 1.0, alpha=0.7, ties="all")
    assert every.emcc == pytest.approx(5 / 6)
    assert "α = 0.7, ties all" in every.to_markdown()


def test_windows_in_place_of_rollouts():
    """Seven episodes make three windows of two; the last episode counts in all but MCC and EMCC."""
    episodes = [[1, 0], [1, 1], [0, 0, 0, 1], [0, 0], [0, 0], [1, 1, 1, 0], [1, 1]]
    found = panel(records_of(episodes), 2.0, alpha=0.5, window=2, moving_window=100)
    assert found.emcc == pytest.approx((1 + 0.5 * 0.75) / 1.5)
    assert (found.mcc, found.mcc_above[0.5]) == pytest.approx(((1 + 0.25 + 0.75) / 3, 2 / 3))
    usual = panel(records_of(episodes), 2.0, alpha=0.5)
    assert (found.episodes, found.cost_rate, found.cvar) == (7, usual.cost_rate, usual.cvar)
    # Windows start at steps 0, 4 and 10 of 18: the middle third begins at 5.94, the last at 11.88.
    assert found.parts[0.33].emcc == pytest.approx(1.0)
    assert (found.parts[0.66].emcc, found.parts[0.99]) == (0.75, None)
    assert "windows of 2 episodes" in found.to_markdown()
    assert json.loads(json.dumps(found.to_dict()))["window"] == 2


def test_windows_group_whole_episodes_where_rollouts_cut_them():
    pieces = records_of([[1, 0], [0, 1], [1, 1], [0, 0]], rollouts=[0, 1, 2, 3])
    whole = records_of([[1, 0, 0, 1], [1, 1, 0, 0]])
    found = panel(pieces, alpha=1.0, window=1, moving_window=1, episodes=whole)
    assert (found.emcc, panel(pieces, alpha=1.0).emcc) == (0.375, 0.5)


def test_a_window_without_a_moving_window_warns_that_it_concerns_emcc_alone():
    with pytest.warns(FutureWarning, match="moving_window"):
        panel(records_of([[1, 0], [1, 1]]), window=1)


BAD = {
    "limit": ({"limit": -1.0}, "limit must be >= 0, got -1.0"),
    "alpha": ({"alpha": 0.0}, r"alpha must be in \(0, 1\], got 0.0"),
    "moving window": ({"moving_window": 0}, "moving_window must be >= 1, got 0"),
    "window": ({"window": 0, "moving_window": 9}, "window must be >= 1, got 0"),
    "no window": ({"window": 9, "moving_window": 9}, "no window of 9 episodes in . trajectories"),
    "steps": ({"total_steps": 2}, "total_steps must be at least the 4 .* got 2"),
    "records": ({"records": [1, 2]}, "records must be EpisodeRecords"),
    "episodes": ({"episodes": []}, "episodes must be EpisodeRecords, got list"),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(changes, message):
    arguments = {"records": records_of([[1, 0], [1, 1]]), "limit": 1.0, **changes}
    error = TypeError if "EpisodeRecords" in message else ValueError
    with pytest.raises(error, match=message):
        panel(**arguments)


def test_records_without_a_finished_trajectory_say_what_to_call():
    recorder = emcc.CostRecorder(1)
    for cost in (0, 1, 1, 0):
        recorder.step([cost], [0], [False])
    for call in (EpisodeRecords.emcc, EpisodeRecords.emcc_by_part, panel):
        with pytest.raises(ValueError, match=r"no finished trajectory; call end_rollout\(\) first"):
            call(recorder.records)
    recorder.end_rollout()
    assert recorder.records.emcc() == panel(recorder.records).emcc == 0.5
    late = EpisodeRecords([0], [50], [10], [0], [0], [0])
    with pytest.raises(ValueError, match=r"starts at step 50, but only 10 .* give total_steps"):
        late.emcc_by_part()


def test_renderings():
    found = panel(records_of([[1, 0], [1, 1], [0, 0], [1, 0]]), 1.0)
    told = json.loads(json.dumps(found.to_dict()))
    assert told["emcc"] == found.emcc
    of_numpy = panel(records_of([[1, 0]]), np.int64(1), np.float32(0.5)).to_dict()
    assert (of_numpy["limit"], of_numpy["alpha"]) == (1.0, 0.5)
    assert told["parts"]["0.33"]["mcc_above"]["0.25"] == 1.0
    latex = found.to_latex().splitlines()
    assert r"measure & all & 0 to 33 \% & 33 to 66 \% & 66 to 99 \% \\" in latex
    assert r"EMCC ($\alpha$ = 0.1) & 1.000 & 1.000 & 0.000 & 0.500 \\" in latex
    assert latex[-1] == r"\end{tabular}"
    row = next(line for line in found.to_markdown().splitlines() if "EMCC" in line)
    assert row.replace("|", " ").split()[-4:] == ["1.000", "1.000", "0.000", "0.500"]
