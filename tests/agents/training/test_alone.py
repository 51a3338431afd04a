"""A run gives the same bits alone and beside others; equal trainings write equal bytes."""

import gymnasium as gym
import numpy as np
import pytest
from small_runs import SAC, TRPO, differing, results, run_of
from small_trainings import of_run
from small_trainings import trained as small_training
from toy_family import known
from toys import Walk, registered
from toys import register as register_toys

import agents
from agents.algorithms import algorithm
from agents.errors import UserError
from agents.on_policy.epoch import BLOCK
from agents.results.archive import write_archive
from agents.results.reading import read_groups
from agents.training.config import RunId, TrainConfig

OPTIONS = {"steps": 200, "checkpoint_every": 50, "evaluate_every": 100}
FAMILIES = {"trpo-lag": TRPO, "cpo": TRPO, "sac-lb": SAC}
AT_SIZE = {"sac-lb": {"hidden": (64, 64), "batch_size": 256, "steps": 300}}
"""Sizes at which computing twenty runs at once could round otherwise than computing one."""
TASKS = ("Circle2D-1-v0", "Circle2D-2-v0")
PHYSICS = ("Circle2DMuJoCo-0-v0", "Circle2DMuJoCo-1-v0")


def trained(out, algorithm, tasks, seeds, **more):
    own = FAMILIES.get(algorithm, {}) | {"cost_limit": 5.0} | OPTIONS | more
    return agents.train(algorithm, tasks, seeds=seeds, out=out, **own).folder


def policies(folder, run):
    files = (folder / "policies" / run.prefix).iterdir()
    return {path.name: path.read_bytes() for path in files}


def assert_as_alone(together, alone, run):
    ours, theirs = run_of(together, run), run_of(alone, run)
    assert {"evaluation/deterministic/returns", "costs/cost/unsafe", "length"} <= ours.keys()
    assert not differing(ours, theirs)
    assert policies(together, run) == policies(alone, run)
    both = (agents.load_policy(f, run.seed, task=run.task) for f in (together, alone))
    observations = np.random.default_rng(0).normal(size=(20, 4 if run.task in PHYSICS else 2))
    np.testing.assert_array_equal(*(policy(observations) for policy in both))


@pytest.mark.parametrize("algorithm", FAMILIES)
def test_a_run_among_several_tasks_and_seeds_is_what_it_is_alone(tmp_path, algorithm):
    tasks = PHYSICS if algorithm == "cpo" else TASKS
    own, seeds = AT_SIZE.get(algorithm, {}), range(3, 13 if algorithm in AT_SIZE else 5)
    together = trained(tmp_path / "all", algorithm, tasks, seeds, **own)
    for run in (RunId(tasks[0], 4), RunId(tasks[1], 3)):
        alone = trained(tmp_path / f"{run.prefix}".replace("/", "-"), algorithm, *run, **own)
        assert_as_alone(together, alone, run)
        assert len(set(policies(together, run).values())) > 1  # it has learned
    config = TrainConfig.read(together)
    assert [str(run) for run in config.runs] == [f"{t}, seed {s}" for t in tasks for s in seeds]
    starts = [run_of(together, run)["replay/drawn"].tolist() for run in config.runs]
    # Each task and each seed has a random stream of its own.
    assert len(set(map(str, starts))) == len(starts)


@pytest.mark.parametrize(("algorithm", "how"), [("trpo-lag", "sync"), ("sac-lb", "async")])
def test_equal_trainings_leave_equal_bytes_by_any_vectorization(tmp_path, algorithm, how):
    """So do their archives, written at different times."""
    more = {"steps": 300}
    ways = {"a": "auto", "b": "auto", "c": how}
    folders = [
        trained(tmp_path / k / "x", algorithm, TASKS, (3, 4), vectorization=way, **more)
        for k, way in ways.items()
    ]
    first, again, other = map(results, folders)
    assert first == again
    del first["config.json"], other["config.json"]
    assert first == other
    archives = []
    for folder in folders[:2]:
        (folder / "status.json").unlink()  # times and machines go into the archive
        write_archive(folder.with_suffix(".zip"), read_groups([folder], []))
        archives.append(folder.with_suffix(".zip").read_bytes())
    assert archives[0] == archives[1]


def test_an_advantage_sees_its_own_steps_alone():
    """A mean or standard deviation over the last dimension, as the docs write it, is of the run's
    own steps, however many more steps the other runs have."""
    register_toys()
    seen, own = [], algorithm("ppo-lag")

    def advantage(config, reward, cost, multipliers):
        seen.append(reward.std(correction=0).item())
        raised = own.rule.advantage(config, reward, cost, multipliers)
        return raised / raised.std(dim=-1, keepdim=True)

    with known("ppo-scaled", own._replace(rule=own.rule._replace(advantage=advantage))):
        together, alone = (
            small_training("ppo-scaled", seeds=seeds, steps=2000, episodes=30)
            for seeds in ((0, 1), (1,))
        )
    other, own_steps = (of_run(together, k)["length"].reshape(-1, 30).sum(axis=1) for k in (0, 1))
    assert ((own_steps[: len(other)] <= BLOCK) & (other > BLOCK)).any()
    np.testing.assert_allclose(seen, 1.0, atol=1e-4)
    np.testing.assert_array_equal(of_run(together, 1)["actor"], of_run(alone, 0)["actor"])


def test_tasks_that_do_not_fit_together_are_refused(tmp_path):
    four = type("Four", (Walk,), {"action_space": gym.spaces.Box(-1, 1, (1,))})
    with registered(Wide=Walk, Four=four):
        with pytest.raises(UserError, match="equal observations and actions"):
            trained(tmp_path / "x", "cpo", ("Walk-v0", "Four-v0"), 0)
        assert not (tmp_path / "x").exists()
        with pytest.raises(UserError, match=r"different presets for .*cost_limit"):
            agents.train("sac-lb", ("Walk-v0", "Circle2D-1-v0"), out=tmp_path / "x")
        with known():
            trained(tmp_path / "y", "toy", ("Walk-v0", "Wide-v0"), 0)
    assert not (tmp_path / "x").exists()
