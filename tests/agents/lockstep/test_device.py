"""Updates on another device than the CPU, as far as a machine without a GPU can tell.

The meta device holds shapes without numbers, and refuses to mix with tensors of another device: so
every tensor that an update makes must be made where the others are.
"""

import numpy as np
import pytest
import torch
from small_trainings import small
from threadpoolctl import threadpool_info, threadpool_limits

import agents
from agents.algorithms import ALGORITHMS, BUILT_IN
from agents.lockstep import backend, lagrange
from agents.lockstep.rollout import critic_inputs
from agents.on_policy import learner
from agents.on_policy.epoch import Epoch
from agents.on_policy.learner import OnPolicy
from agents.sac import OffPolicy
from agents.sac import update as sac
from agents.sac.replay import Batch

R, B = 3, 64


@pytest.fixture
def elsewhere():
    torch.set_default_device("meta")
    yield torch.empty
    torch.set_default_device(None)


def family(name):
    return ALGORITHMS[name].family


OFF_POLICY = [name for name in BUILT_IN if family(name) is OffPolicy]
ON_POLICY = [name for name in BUILT_IN if issubclass(family(name), OnPolicy)]


@pytest.mark.parametrize("name", OFF_POLICY)
def test_off_policy_updates(name, elsewhere):
    config, rule = ALGORITHMS[name].config(batch_size=B), ALGORITHMS[name].rule
    nets = sac.make_nets(config, 3, 2, 1)
    state = sac.initial_state(nets, config, rule, range(R))
    seen = (R, B, critic_inputs(config, 3, 1))
    shapes = seen, (R, B, 2), (R, B), (R, 1, B), seen, (R, B), (R, B)
    batch, noise = Batch(*map(elsewhere, shapes)), elsewhere(R, B, 2)
    after, metrics = sac.update(nets, config, rule, state, batch, sac.UpdateNoise(noise, noise))
    assert after.actor.shape == state.actor.shape
    assert after.critics.is_meta
    assert all(value.is_meta and len(value) == R for value in metrics.values())


@pytest.mark.parametrize("name", ON_POLICY)
def test_on_policy_updates(name, elsewhere, monkeypatch):
    """The whole improvement of a policy. Where it asks for a number, to stop early, the answer is
    no: a line search then goes through all of its tries."""
    config, rule = small(name, batch_size=256), ALGORITHMS[name].rule
    it = family(name)(config, rule, range(R), 3, 2)
    shapes = (R, 512, 3), (R, 512, 2), (R, 512), (R, 512), (R, 1, 512), (R, 2, 512), (R,), (R, 1)
    epoch, steps = Epoch(*map(elsewhere, shapes)), np.array([500, 70, 0])
    monkeypatch.setattr(torch.Tensor, "__bool__", lambda tensor: False)
    after, records = it.improve(epoch, steps, [np.random.default_rng(seed) for seed in range(R)])
    assert after.actor.is_meta
    assert after.actor.shape == it._state.actor.shape
    assert all(value.is_meta and value.shape == (R,) for value in records.values())
    rows, weight = backend.tensor(np.zeros((R, B), dtype=np.int64)), elsewhere(R, B)
    after, losses = learner.critic_step(it.nets, config, after, epoch, rows, weight)
    assert after.critics.is_meta
    assert losses.is_meta


@pytest.mark.parametrize("optimizer", ["adam", "sgd", "pid"])
def test_multipliers(optimizer, elsewhere):
    config = ALGORITHMS["trpo-lag"].config(multiplier_optimizer=optimizer)
    rule = ALGORITHMS["trpo-lag"].rule.multipliers
    states = lagrange.follow(rule, config, lagrange.initial(rule, config, R), elsewhere(R, 1))
    assert lagrange.values(rule, states, R).is_meta


def test_numpy_has_one_thread_in_training_and_the_callers_afterwards():
    """Its idle threads spin: two trainings side by side were nine times slower with two each."""

    def of_numpy():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    seen = []
    with threadpool_limits(3, user_api="blas"):
        arguments = {"seeds": 0, "steps": 200, "episodes": 2, "backend": "numpy"}
        agents.train("trpo-lag", **arguments, on_epoch=lambda _: seen.append(of_numpy()))
        assert of_numpy() == {3}
    assert seen == [{1}, {1}]


def test_auto_compiles_long_trainings_alone(monkeypatch):
    monkeypatch.setattr(backend, "cannot_compile", lambda: "")
    assert [backend.choose("auto", n, "cpu") for n in (299_999, 300_000)] == ["eager", "compiled"]


def test_the_callers_limit_of_compilations_comes_back(monkeypatch, tmp_path):
    """After a second training and one inside another too; while one compiles, it is ours."""
    from torch._dynamo import config

    def cannot_compile():
        backend._keep_compiled_code()
        return ""

    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(backend, "cannot_compile", cannot_compile)
    monkeypatch.setattr(config, "recompile_limit", 5)
    for _ in range(2):
        with backend.restored():
            for compiles, limit in ((True, 1024), (False, 5), (True, 1024)):
                with backend.restored():
                    backend.configure(compiles)
                    assert config.recompile_limit == limit
                backend.configure(True)
                assert config.recompile_limit == 1024
        assert config.recompile_limit == 5
