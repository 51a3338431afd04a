"""Every algorithm on a task whose episodes end early: records, resume, runs that fail alone."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from agents.training.loop import Training, train
from agents.training.records import COLUMNS
from gymnasium.vector import AsyncVectorEnv
from toys import register

from agents.algorithms import BUILT_IN, algorithm
from agents.lockstep import tree
from agents.training import evaluation
from agents.training import loop as train_module
from agents.training.config import TrainConfig
from agents.training.environments import make_envs
from agents.training.evaluation import evaluate
from agents.training.files import read_json
from emcc import EpisodeRecords, longest_streak

register()


SMALL = {"cost_limit": 1.0, "batch_size": 32, "hidden": (32, 32), "episodes": 3}
SMALL |= {"random_steps": 50, "gradient_steps": 2, "actor_iterations": 2}
WITH_PID = ("trpo-lag pid", "sac-lag pid", "wcsac pid")
EVERYTHING = (*BUILT_IN, *WITH_PID)


def config(name, seeds=(0, 1, 2), steps=900, **parameters):
    """name: of an algorithm, and its multiplier's optimiser if it is not the default."""
    name, _, optimizer = name.partition(" ")
    settings = SMALL | ({"multiplier_optimizer": optimizer} if optimizer else {})
    of_all = {field.name for field in fields(algorithm(name).config)}
    hyperparameters = algorithm(name).config(**{k: v for k, v in settings.items() if k in of_all})
    return TrainConfig(name, "Walk-v0", seeds, steps, hyperparameters, parameters, 300)


def arrays_of(training):
    return training.learner.state_dict() | training.log.state_dict() | {"steps": training.steps}


def of_run(training, run):
    """A run's parameters, and its records of the epochs it took part in."""
    state = {k: v[run] for k, v in tree.flatten(training.learner._state).items()}
    episodes, updates = training.log.episodes[:, run], training.log.updates[:, run]
    there = ~np.isnan(episodes[:, 0, 0])
    assert np.isnan(updates[~there]).all()
    return state | {"episodes": episodes[there], "updates": updates[there]}


def assert_same(a, b):
    assert a.keys() == b.keys()
    for name, value in a.items():
        np.testing.assert_array_equal(value, b[name], err_msg=name)


def finished(training):
    while not training.done:
        training.run_epoch()
    return training


@pytest.mark.parametrize("name", EVERYTHING)
def test_resumed_in_the_middle_is_as_never_stopped(name, tmp_path):
    whole = finished(Training(config(name)))
    stopped = Training(config(name))
    config(name).write(tmp_path)
    while stopped.steps.min() < 400:
        stopped.run_epoch()
    stopped.save(tmp_path)
    resumed = Training(config(name))
    resumed.load(tmp_path)
    assert_same(arrays_of(finished(resumed)), arrays_of(whole))


@pytest.mark.parametrize("name", EVERYTHING)
def test_a_run_does_not_see_the_others(name):
    """Episodes of the others have other lengths, and they finish at other times."""
    together, alone = finished(Training(config(name))), finished(Training(config(name, (1,))))
    lengths = together.log.episodes[..., 1]
    assert len(np.unique(lengths[~np.isnan(lengths)])) > 5
    assert_same(of_run(alone, 0), of_run(together, 1))


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_poisoned_run_fails_alone(name, tmp_path):
    """NaN in the first weight of the second run's actor, after some epochs."""
    healthy = finished(Training(config(name)))
    config(name).write(tmp_path)
    poisoned = Training(config(name))
    while poisoned.steps[1] < 300:
        poisoned.run_epoch()
    step = int(poisoned.steps[1])
    poisoned.learner._state.actor[1, 0] = np.nan
    finished(poisoned).save(tmp_path)
    assert poisoned.failed.tolist() == [False, True, False]
    assert read_json(tmp_path / "seed-1/failed.json") == {"step": poisoned.steps[1]}
    assert step <= poisoned.steps[1] <= step + 40 * poisoned.learner.episodes
    for run in (0, 2):
        assert_same(of_run(poisoned, run), of_run(healthy, run))
    results = evaluate(tmp_path, poisoned.config, poisoned.learner.policy(), 5, ~poisoned.failed)
    assert not results["deterministic"][1]
    assert not (tmp_path / "seed-1/evaluation.json").exists()
    assert (tmp_path / "seed-2/evaluation.json").exists()
    restored = Training(config(name))
    restored.load(tmp_path)
    assert restored.failed.tolist() == [False, True, False]
    assert restored.done


@pytest.mark.parametrize("poisons", ["reward", "cost", "observation"])
@pytest.mark.parametrize("name", ["trpo-lag", "sac-lag"])
def test_an_environment_that_gives_nan_fails_its_run(name, poisons, tmp_path):
    it = config(name, tuple(range(6)), 600, poison=0.0004, poisons=poisons)
    it.write(tmp_path)
    [training] = train(tmp_path)
    assert 0 < training.failed.sum() < 6
    assert (training.steps[~training.failed] >= 600).all()
    for run, failed in enumerate(training.failed):
        rows = training.log.episodes[:, run].reshape(-1, len(COLUMNS))
        assert np.isfinite(rows[~np.isnan(rows[:, 0])]).all()
        assert (tmp_path / f"seed-{run}" / "failed.json").exists() == failed
        if failed:
            assert not (tmp_path / f"seed-{run}" / "evaluation.json").exists()


@pytest.mark.parametrize("name", BUILT_IN)
def test_records_are_of_what_the_environments_did(name, tmp_path):
    """The rows of `episodes.csv` against costs and rewards noted beside the training."""
    config(name, (0, 1)).write(tmp_path)
    training = Training(config(name, (0, 1)))
    episodes, noted = training.learner.episodes, []
    learn = training.learner.learn

    def note(rollout, epoch, active):
        for n in np.flatnonzero(np.repeat(active, episodes)):
            end = rollout.length[n]
            columns = (rollout.reward[:end, n], rollout.cost[:end, n])
            noted.append((n // episodes, epoch[n // episodes], *(c.tolist() for c in columns)))
        return learn(rollout, epoch, active)

    training.learner.learn = note
    finished(training).save(tmp_path)
    for run in (0, 1):
        records = EpisodeRecords.load(tmp_path / f"seed-{run}/episodes.csv")
        mine = [row[1:] for row in noted if row[0] == run]
        assert records.rollout.tolist() == [epoch for epoch, _, _ in mine]
        assert records.length.tolist() == [len(costs) for _, _, costs in mine]
        assert records.cost.tolist() == [sum(costs) for _, _, costs in mine]
        assert records.reward.tolist() == pytest.approx([sum(rewards) for _, rewards, _ in mine])
        assert records.longest_streak.tolist() == [longest_streak(costs) for _, _, costs in mine]
        starts = np.cumsum(records.length) - records.length
        assert records.start_step.tolist() == starts.tolist()
        assert records.total_steps == training.steps[run]
        updates = np.genfromtxt(tmp_path / f"seed-{run}/updates.csv", delimiter=",", names=True)
        assert updates.dtype.names[2:] == training.learner.metrics
        assert np.isfinite(updates.tolist()).all()


def test_the_deterministic_policy_gets_no_noise(tmp_path):
    """One that goes right without noise, left with it."""
    it = TrainConfig("cpo", "Circle2D-1-v0", (0, 1), 100, algorithm("cpo").config())
    it.write(tmp_path)

    def policy(observation, noise):
        to = 1.0 if noise is None else -1.0
        return np.full((*observation.shape[:2], 2), to, np.float32)

    results = evaluate(tmp_path, it, policy, 3)
    for run in (0, 1):
        assert (np.array(results["deterministic"][run]["final_observations"]) == 1).all()
        assert (np.array(results["stochastic"][run]["final_observations"]) == -1).all()


@pytest.mark.parametrize(
    ("episodes", "native"), [(23, 23), (120, 100), (10_000, 100), (1_000_000, 10_000)]
)
def test_episodes_of_a_run_at_once(episodes, native, monkeypatch):
    """At most a hundred, or a hundredth; ten where the environments are not native."""
    made = []
    monkeypatch.setattr(evaluation, "make_envs", lambda task, num_envs, *_: made.append(num_envs))
    it = TrainConfig("cpo", "Circle2D-2-v0", (0, 1), 100, algorithm("cpo").config())
    for one in (it, replace(it, vectorization="sync")):
        with pytest.raises(AttributeError):  # there are no environments
            evaluation.play_policies(one, None, episodes, np.ones(2, bool))
    assert made == [2 * native, 2 * 10]


def test_evaluation_in_parts_is_that_at_once(tmp_path):
    """A hundred episodes of a run with the task's own vector environment, else ten."""
    it = TrainConfig("cpo", "Circle2D-2-v0", (0, 1), 100, algorithm("cpo").config())
    it.write(tmp_path)
    policy = Training(it).learner.policy()
    whole = evaluate(tmp_path, it, policy, 120)  # in two parts
    parts = evaluate(tmp_path, replace(it, vectorization="sync"), policy, 120)
    for name in ("deterministic", "stochastic"):
        for run in (0, 1):
            returns = whole[name][run]["returns"]
            assert parts[name][run]["returns"] == pytest.approx(returns, rel=1e-6)
            assert len(set(returns)) == 120


def test_saves_go_on_when_the_run_ahead_has_ended(tmp_path):
    it = config("trpo-lag", (0, 1), 900)
    it.write(tmp_path)
    training, saved = Training(it), []
    training.steps[0], save = 900, training.save
    training.save = lambda folder: (saved.append(int(training.steps[1])), save(folder))
    train_module._train({tmp_path: training}, lambda trainings: None)
    assert [steps // 300 for steps in saved] == [1, 2, 3]


def test_all_runs_fail_at_once():
    training = finished(Training(config("cpo", (0, 1), 300, poison=1.0)))
    assert training.failed.all()
    assert np.isnan(training.log.episodes).all()


def test_what_each_algorithm_records():
    metrics = {name: Training(config(name)).learner.metrics for name in BUILT_IN}
    on_policy = ("kl", "step_scale", "critic_loss", "cost_critic_loss", "std")
    assert metrics["trpo-lag"] == (*on_policy, "multiplier")
    assert metrics["cpo"] == (*on_policy, "case")
    off_policy = {"critic_loss", "cost_critic_loss", "actor_loss", "temperature", "risk", "entropy"}
    assert set(metrics["sac-lb"]) == off_policy
    assert set(metrics["sac"]) == off_policy
    assert set(metrics["sac-lag"]) == set(metrics["wcsac"]) == off_policy | {"multiplier"}
    first_order = ("kl", "clipped", "critic_loss", "cost_critic_loss", "std")
    assert metrics["ppo"] == first_order
    assert metrics["ppo-lag"] == (*first_order, "multiplier")


def test_sync_and_async_give_the_same():
    found = []
    for vectorization in ("sync", "async"):
        it = replace(config("trpo-lag", (0, 1), 300), vectorization=vectorization)
        training = finished(Training(it))
        training.close()
        found.append(arrays_of(training))
    assert_same(*found)
    envs = make_envs("Circle2D-1-v0", 2, {}, "async")
    assert isinstance(envs.unwrapped, AsyncVectorEnv)
    envs.close()


def test_a_sync_circle2d_is_the_native_one():
    hyperparameters = algorithm("cpo").config(episodes=2)
    found = []
    for vectorization in ("auto", "sync"):
        it = TrainConfig("cpo", "Circle2D-3-v0", (0, 1), 400, hyperparameters, {}, 200)
        training = Training(replace(it, vectorization=vectorization))
        found.append(arrays_of(finished(training)))
    assert_same(*found)


def test_tensorboard(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    it = replace(config("trpo-lag", (0, 1), 300), tensorboard=True)
    it.write(tmp_path)
    [training] = train(tmp_path)
    events = EventAccumulator(str(tmp_path / "seed-1" / "tensorboard")).Reload()
    returns = events.Scalars("rollout/return")
    rows = training.log.episodes[:, 1]
    rows = rows[~np.isnan(rows[:, 0, 0])]
    assert [e.value for e in returns] == pytest.approx(rows[..., 2].mean(axis=1), rel=1e-6)
    assert [e.step for e in returns] == np.cumsum(rows[..., 1].sum(axis=1)).tolist()
    kl = training.log.updates[: len(rows), 1, training.learner.metrics.index("kl")]
    assert [e.value for e in events.Scalars("update/kl")] == pytest.approx(kl, rel=1e-6)
    assert json.loads((tmp_path / "config.json").read_text())["tensorboard"] is True
