"""A second cost of a task: recorded, evaluated, and with EMCC of its own."""

import gymnasium as gym
import numpy as np
import pytest
from small_runs import SAC, TRPO, steps_of
from toys import TwoCosts

import agents
import emcc
from agents.errors import UserError

BOTH = {"seeds": (0, 1), "steps": 300, "costs": ("cost", "cost_2")}


@pytest.fixture(scope="module", params=["trpo-lag", "sac-lag"])
def runs(request, tmp_path_factory):
    own = TRPO if request.param == "trpo-lag" else SAC
    out = tmp_path_factory.mktemp("costs") / "x"
    return agents.train(request.param, "TwoCosts-v0", out=out, **BOTH, **own)


@pytest.mark.parametrize("cost", ["cost", "cost_2"])
def test_records_and_measures_of_each_cost(runs, cost):
    records = runs.records_of(cost)
    [group] = [group for group in runs.results if group.cost == cost]
    assert group.apart == ("" if cost == "cost" else "cost_2")
    for run in group.runs:
        names = (f"costs/{cost}", "length")
        costs, lengths = (steps_of(runs.folder, f"TwoCosts-v0/{run.seed}", n) for n in names)
        assert set(np.unique(costs)) == ({0.0, 1.0} if cost == "cost" else {0.0, 0.25})
        ours = records[runs.folder, run.seed]
        ends = np.cumsum(lengths)
        episodes = np.split(costs, ends[:-1])
        np.testing.assert_array_equal(ours.cost, [episode.sum() for episode in episodes])
        streaks = [emcc.longest_streak(episode) for episode in episodes]
        np.testing.assert_array_equal(ours.longest_streak, streaks)
        np.testing.assert_array_equal(run.records.cost, ours.cost)
        np.testing.assert_array_equal(group.costs(run), costs)
        per_rollout = len(lengths) // (ours.rollout[-1] + 1)
        rollouts = [episodes[k : k + per_rollout] for k in range(0, len(episodes), per_rollout)]
        starts = (ends - lengths)[::per_rollout]
        expected = emcc.emcc_by_part([emcc.mcc(r) for r in rollouts], starts, 300)
        for part, value in expected.items():
            assert run.measures[f"EMCC_{part:.2f}"] == pytest.approx(value)
        assert run.measures["cost_rate"] == pytest.approx(costs.mean())


def test_evaluations_of_each_cost(runs):
    found = {g.cost: [run.evaluation["deterministic"] for run in g.runs] for g in runs.results}
    with np.load(runs.folder / "results.npz") as arrays:
        for k, cost in enumerate(("cost", "cost_2")):
            for seed, evaluation in enumerate(found[cost]):
                own = arrays[f"TwoCosts-v0/{seed}/evaluation/deterministic/costs"][:, k]
                np.testing.assert_array_equal(evaluation["cost_returns"], own)
                assert evaluation["J_C"] == own.mean()
    policy = agents.load_policy(runs, seed=1)
    both = [agents.evaluate(policy, episodes=3, cost=cost).costs for cost in ("cost", "cost_2")]
    assert not np.array_equal(*both)
    assert set(np.unique(both[1] % 0.25)) == {0.0}


def test_a_second_cost_changes_nothing_that_limits_the_first(runs, tmp_path):
    config = runs.config
    own = BOTH | {"costs": "cost"} | (TRPO if config.algorithm == "trpo-lag" else SAC)
    alone = agents.train(config.algorithm, "TwoCosts-v0", out=tmp_path / "x", **own)
    first = [run.measures for group in runs.results if group.cost == "cost" for run in group.runs]
    assert [run.measures for run in alone.results[0].runs] == first
    assert list(config.limits) == ["cost"]


def test_epochs_and_frames_name_further_costs():
    epochs = []
    runs = agents.train("cpo", "TwoCosts-v0", on_epoch=epochs.append, **BOTH, **TRPO)
    first = runs.records_of("cost_2")[runs.folder, 1].cost[:2].mean()
    assert epochs[0].runs[1]["cost_2"] == pytest.approx(first)
    frame = runs.to_pandas("episodes")
    column = frame[frame.seed == 1]["cost_2"].to_numpy()
    np.testing.assert_array_equal(column, runs.records_of("cost_2")[runs.folder, 1].cost)


@pytest.mark.parametrize("vectorization", ["auto", "async"])
def test_a_cost_that_the_task_lacks(tmp_path, vectorization):
    for task in ("Walk-v0", "Circle2D-1-v0"):
        with pytest.raises(UserError, match=rf"task '{task}'.* gives no info\['cost_2'\]"):
            agents.train("cpo", task, out=tmp_path / "x", vectorization=vectorization, **BOTH)
        assert not (tmp_path / "x").exists()
    for costs, words in ((("cost", "cost"), "costs must be different"), ((), "at least one")):
        with pytest.raises(UserError, match=words):
            agents.train("cpo", "Walk-v0", out=tmp_path / "x", **BOTH | {"costs": costs})
    assert not (tmp_path / "x").exists()


def test_a_cost_that_is_not_finite_is_named():
    class Bad(TwoCosts):
        def step(self, action):
            *others, info = super().step(action)
            return *others, info | {"cost_2": np.nan}

    gym.register("Bad-v0", Bad, disable_env_checker=True)
    try:
        with pytest.raises(UserError, match="its cost_2 is not finite"):
            agents.train("cpo", "Bad-v0", **BOTH, **TRPO)
    finally:
        del gym.registry["Bad-v0"]
