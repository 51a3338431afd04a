"""Every algorithm on a task whose episodes end early: a run alone and among others, resumed
trainings, runs that fail alone; evaluations and TensorBoard's files."""

from dataclasses import replace

import numpy as np
import pytest
from small_trainings import assert_same, finished, of_run, small, trainer
from toys import register

from agents.algorithms import BUILT_IN, algorithm
from agents.lockstep import kernel
from agents.training import derive
from agents.training.config import TrainConfig
from agents.training.evaluation import evaluate_runs
from agents.training.trainer import lengthen, train

register()

VARIANTS = {
    "pid": {"multiplier_optimizer": "pid"},
    "normalized": {"normalize_observations": True},
    "start": {"multiplier_of": "start"},
    "episode": {"multiplier_of": "episode"},
    "streaks": {"streak_limit": 1.0, "multiplier_lr": 0.1},
    "tail": {"streak_limit": 1.0, "streak_alpha": 0.3},
}
WITH_PID = ("trpo-lag pid", "sac-lag pid", "wcsac pid")
NORMALIZED = ("ppo-lag normalized", "cpo normalized", "sac-lb-streak normalized")
FOLLOWING = ("sac-lag start", "sac-pid episode", "wcsac start", "wcsac episode", "cal start")
STREAKS = ("trpo-pid streaks", "rcpo tail", "ppo-lag tail", "focops tail", "cup streaks")
STREAKS += ("sac-lag tail", "sac-pid tail", "sac-lb tail")
EVERYTHING = (*BUILT_IN, *WITH_PID, *NORMALIZED, *FOLLOWING, *STREAKS)
FAMILIES = ("trpo-lag", "cpo", "ppo-lag", "sac-lb", "wcsac")
"""One of each learner, and the algorithms that add to its state."""


def config(name, seeds=(0, 1, 2), steps=160, **parameters):
    """Return a small configuration; name: an algorithm, and a variant behind a space."""
    name, _, variant = name.partition(" ")
    own = small(name, **VARIANTS.get(variant, {}))
    return TrainConfig(name, ("Walk-v0",), seeds, steps, own, parameters, checkpoint_every=100)


def arrays_of(it):
    """Return the state of all runs, and the steps and epochs taken."""
    return it.learner.state_dict() | {"steps": it.steps, "epoch": it.epochs}


@pytest.mark.parametrize("name", EVERYTHING)
def test_a_run_is_what_it_is_alone_and_without_a_stop(name, tmp_path):
    """Bit for bit, though the other runs' episodes have other lengths and end at other times.

    Also for a finished training that is made longer, where runs that waited for others catch up.
    """
    whole = finished(trainer(config(name), tmp_path / "whole"))
    alone = finished(trainer(config(name, (1,))))
    lengths, fewest = of_run(whole, 0)["length"], waiting(whole)
    assert len(np.unique(lengths)) > 2
    assert_same(of_run(alone, 0), of_run(whole, 1))
    whole.save()
    stopped = trainer(config(name), tmp_path / "stopped")
    while stopped.steps.min() < 60:
        stopped.run_epoch()
    stopped.save()
    resumed = trainer(config(name), tmp_path / "stopped")
    resumed.load()
    finished(resumed).save()
    shorter = finished(trainer(config(name, steps=fewest), tmp_path / "shorter"))
    shorter.save()
    assert np.ptp(shorter.epochs) > 0
    lengthen(shorter.folder, 160)
    longer = trainer(TrainConfig.read(shorter.folder), shorter.folder)
    longer.load()
    finished(longer).save()
    for it in (resumed, longer):
        assert_same(arrays_of(it), arrays_of(whole))
        found, expected = (derive.derived(i.folder, i.config) for i in (it, whole))
        assert_same(found, expected)
        assert newest_checkpoint(it) == newest_checkpoint(whole)


def waiting(whole):
    """Return the fewest steps after which some runs have begun more epochs than others."""
    each = (of_run(whole, run)["length"] for run in range(3))
    ends = [np.cumsum(own.reshape(-1, whole.learner.episodes).sum(axis=1)) for own in each]
    return next(n for n in range(1, 160) if len({np.searchsorted(own, n) for own in ends}) > 1)


def newest_checkpoint(it):
    """Return the name and the bytes of the newest checkpoint."""
    path = max((it.folder / "checkpoints").iterdir())
    return path.name, path.read_bytes()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_poisoned_run_fails_alone(name):
    """The second run's first actor weight becomes NaN after some epochs."""
    healthy, poisoned = finished(trainer(config(name))), trainer(config(name))
    while poisoned.steps[1] < 60:
        poisoned.run_epoch()
    step = int(poisoned.steps[1])
    poisoned.learner._state.actor[1, 0] = np.nan
    finished(poisoned)
    for run in (0, 2):
        assert_same(of_run(poisoned, run), of_run(healthy, run))
    assert (poisoned.failures != "").tolist() == [False, True, False]
    assert step <= poisoned.steps[1] <= step + 40 * poisoned.learner.episodes


def circle2d(level=1, steps=100, **settings):
    own = algorithm("cpo").config(episodes=2)
    return TrainConfig("cpo", (f"Circle2D-{level}-v0",), (0, 1), steps, own, **settings)


def test_the_deterministic_policy_gets_no_noise():
    """The policy here goes right without noise and left with it."""

    def policy(observation, noise):
        to = 1.0 if noise is None else -1.0
        return np.full((*observation.shape[:2], 2), to, np.float32)

    found = evaluate_runs(circle2d(), policy, 3)
    assert (found["deterministic"].ends == 15).all()  # the corner of the arena
    assert (found["stochastic"].ends == -15).all()


def test_evaluations_do_not_depend_on_how_many_episodes_are_played_at_once():
    """A run plays a hundred at once in the task's own vector environment, otherwise ten."""
    policy = trainer(circle2d(2)).learner.policy()
    whole = evaluate_runs(circle2d(2), policy, 120)  # in two parts
    parts = evaluate_runs(circle2d(2, vectorization="sync"), policy, 120)
    for name in ("deterministic", "stochastic"):
        np.testing.assert_allclose(parts[name].returns, whole[name].returns, rtol=1e-6)
        assert all(len(set(returns)) == 120 for returns in whole[name].returns)


def test_tensorboard_has_the_recorded_numbers(tmp_path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    it = replace(config("trpo-lag", (0, 1), 300), tensorboard=True)
    it.write(tmp_path)
    train(tmp_path)
    arrays = dict(np.load(tmp_path / "results.npz"))
    length, returns = (arrays[f"Walk-v0/1/{name}"].reshape(-1, 3) for name in ("length", "return"))
    [file] = tmp_path.glob("tensorboard/**/*1/events*")
    events = accumulator.EventAccumulator(str(file.parent)).Reload()
    found = events.Scalars("rollout/return")
    assert [e.value for e in found] == pytest.approx(returns.mean(axis=1), rel=1e-6)
    assert [e.step for e in found] == np.cumsum(length.sum(axis=1, dtype=int)).tolist()
    kl = arrays["Walk-v0/1/updates"][:, list(arrays["metrics"]).index("kl")]
    assert [e.value for e in events.Scalars("update/kl")] == pytest.approx(kl, rel=1e-6)


def test_the_second_step_of_cup_has_passes_of_its_own(monkeypatch):
    """Though `kl_stop` has ended the passes of the first step."""
    taken, descend = {}, kernel.InCpp.descend

    def noted(self, it, loss, order, steps):
        if it.log_std.stop:
            taken.setdefault(type(loss), []).append(bool(steps.any()))
        return descend(self, it, loss, order, steps)

    monkeypatch.setattr(kernel.InCpp, "descend", noted)
    own = small("cup", kl_stop=1e-12)
    trainer(TrainConfig("cup", ("Walk-v0",), (0,), 160, own)).run_epoch()
    first, second = taken.values()
    assert first[0] and not first[-1] and second[0]
