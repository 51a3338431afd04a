"""Algorithms by name: listed without torch, registered from outside, a family of one's own."""

import inspect
import json
import math
import subprocess
import sys
from dataclasses import dataclass, fields, make_dataclass, replace

import numpy as np
import pytest
from agents.cli.train import TrainOptions
from agents.training.loop import Training
from toys import register as register_tasks

import agents
from agents import algorithms
from agents.algorithms import (
    ALGORITHMS,
    BUILT_IN,
    RESERVED,
    Algorithm,
    algorithm,
    module_of,
    register,
    title,
)
from agents.errors import UserError
from agents.lockstep import tree
from agents.lockstep.learner import Learner
from agents.paper.presets import preset
from agents.training.config import TrainConfig

register_tasks()

SAC_FIXED = '''
"""SAC that pays a fixed price for costs."""

from dataclasses import dataclass

from agents.algorithms import Algorithm, register
from agents.algorithms.sac_lag import critic_loss, risk
from agents.sac import CostRule, OffPolicy, SACConfig


@dataclass(frozen=True)
class Config(SACConfig):
    """Hyper-parameters of SAC-Fixed."""

    price: float = 1.0
    """Price of a unit of the discounted cost return Q_c, in units of reward."""


def penalty(config, risk, multiplier):
    return config.price * risk


register("sac-fixed", Algorithm("SAC-Fixed", Config, CostRule(risk, critic_loss, penalty), OffPolicy))
'''  # noqa: E501


@pytest.fixture(autouse=True)
def nothing_stays(monkeypatch):
    monkeypatch.setattr(algorithms._algorithms, "registered", {})


@pytest.fixture
def sac_fixed(tmp_path, monkeypatch):
    (tmp_path / "my_sac.py").write_text(SAC_FIXED)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_sac", raising=False)
    __import__("my_sac")


def trained(name, **settings):
    config = algorithm(name).config(
        batch_size=32, hidden=(32, 32), random_steps=50, gradient_steps=2, **settings
    )
    training = Training(TrainConfig(name, "Walk-v0", (0, 1), 300, config))
    while not training.done:
        training.run_epoch()
    return training


def test_names_are_listed_without_torch():
    ask = """
import json, sys
from agents.algorithms import ALGORITHMS, title
names = list(ALGORITHMS), len(ALGORITHMS), "ppo" in ALGORITHMS, title("my-own"), "torch" in sys.modules
from agents.paper.presets import PAPER_ALGORITHMS
print(json.dumps([*names, PAPER_ALGORITHMS, "torch" in sys.modules]))
"""  # noqa: E501
    said = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    names, count, has_ppo, own, before, paper, after = json.loads(said.stdout)
    assert names == list(BUILT_IN)
    assert paper == ["trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"]
    assert count == len(names)
    assert has_ppo
    assert own == "my-own"
    assert not before
    assert not after


def test_titles():
    expected = ["TRPO-Lag", "CPO", "SAC-Lag", "SAC-LB", "WCSAC"]
    expected += ["SAC-LB-Streak", "PPO-Lag", "PPO", "SAC"]
    assert [title(name) for name in ALGORITHMS] == expected


def test_an_unknown_one_is_an_error_that_lists_the_others():
    with pytest.raises(
        UserError, match=r"unknown algorithm 'dqn': valid are trpo-lag, cpo, .*, sac"
    ):
        algorithm("dqn")
    with pytest.raises(KeyError):
        ALGORITHMS["dqn"]


def test_from_a_file_of_ones_own(sac_fixed):
    """At price 0 it is SAC, bit for bit; at ln 2 SAC-Lag with its first multiplier kept."""
    assert list(ALGORITHMS) == [*BUILT_IN, "sac-fixed"]
    assert title("sac-fixed") == "SAC-Fixed"
    free, plain = trained("sac-fixed", price=0.0), trained("sac")
    assert free.learner.metrics == plain.learner.metrics
    for name, value in plain.learner.state_dict().items():
        np.testing.assert_array_equal(free.learner.state_dict()[name], value, err_msg=name)
    paying, lag = trained("sac-fixed", price=math.log(2.0)), trained("sac-lag", multiplier_lr=0.0)
    actor = lag.learner.state_dict()["actor"]
    np.testing.assert_allclose(paying.learner.state_dict()["actor"], actor, rtol=0, atol=1e-4)
    assert np.abs(actor - plain.learner.state_dict()["actor"]).max() > 1e-3


def test_reserved_are_the_names_of_options():
    functions = [inspect.signature(f).parameters for f in (agents.train, agents.sweep)]
    of_functions = {name for parameters in functions for name in parameters}
    options = {field.name for field in fields(TrainOptions)}
    assert set(RESERVED) == (of_functions | options) - {"hyperparameters"}


def test_what_register_refuses(sac_fixed):
    own = algorithm("sac-fixed")
    for name in ("sac", "sac-fixed"):
        with pytest.raises(UserError, match=f"algorithm '{name}' is there already"):
            register(name, own)
    for name in ("", "My-Own", "my own", "my--own", "../own", 3):
        with pytest.raises(UserError, match="lower-case words joined by '-', got"):
            register(name, own)
    loose, incomplete = (
        make_dataclass("Config", of_config, frozen=frozen)
        for of_config, frozen in (([("a", int, 1)], False), ([("a", int)], True))
    )
    for config in (loose, dict, loose(), None):
        with pytest.raises(TypeError, match="config of 'own' must be a frozen dataclass, got"):
            register("own", own._replace(config=config))
    with pytest.raises(TypeError, match=r"Config\.a of 'own' needs a default"):
        register("own", own._replace(config=incomplete))
    named = make_dataclass("Config", [("device", str, "cpu")], frozen=True)
    with pytest.raises(UserError, match=r"Config\.device of 'own' is named like an option"):
        register("own", own._replace(config=named))
    for other in ("cpo", "ppo-lag"):
        takes = f"takes a subclass of {algorithm(other).family.takes[0].__name__} as config and a "
        with pytest.raises(TypeError, match=takes):
            register("own", algorithm(other)._replace(rule=own.rule))
        with pytest.raises(TypeError, match=takes):
            register("own", algorithm(other)._replace(config=own.config))
    with pytest.raises(TypeError, match="family of 'own' must make a Learner, got None"):
        register("own", own._replace(family=None))
    with pytest.raises(TypeError, match=r"expects an agents\.algorithms\.Algorithm, got 'sac'"):
        register("own", "sac")
    assert list(ALGORITHMS) == [*BUILT_IN, "sac-fixed"]


def test_the_module_that_registers(sac_fixed, tmp_path):
    """Not that of the config, which may be the package's own. Processes cannot import a script."""
    lag = algorithm("sac-lag")
    register("lag-again", lag)
    exec(
        "agents.register('of-script', lag)", {"__name__": "__main__", "agents": agents, "lag": lag}
    )
    names = ("sac-lag", "sac-fixed", "lag-again", "of-script")
    expected = ["agents.algorithms.sac_lag", "my_sac", __name__, "__main__"]
    assert [module_of(name) for name in names] == expected
    with pytest.raises(UserError, match="of-script is registered in the running script"):
        agents.sweep("of-script", grid={"cost_limit": (1.0, 2.0)}, steps=100, out=tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_a_family_that_extends_another_has_its_presets():
    lag = algorithm("sac-lag")

    class Extended(lag.family):
        """A family of one's own."""

    register("extended", lag._replace(family=Extended))
    for task in ("Circle2D-1-v0", "circle2d_mj/SafetyPointGoal1-v0", "Walk-v0"):
        assert preset("extended", task) == preset("sac-lag", task)
    assert preset("extended", "Circle2D-1-v0").time_limit == "terminal"


def test_runs_whose_algorithm_is_not_registered(sac_fixed, tmp_path):
    """Their numbers are reported; to go on, the module is needed."""
    small = {"batch_size": 32, "hidden": (32, 32), "random_steps": 50}
    agents.train("sac-fixed", "Walk-v0", seeds=(0, 1), steps=300, out=tmp_path / "runs", **small)
    known = agents.report(tmp_path / "runs").split()
    algorithms._algorithms.registered.clear()
    label = "SAC-Fixed (batch_size 32, random_steps 50, hidden (32, 32), 300 steps)"
    now = " ".join(known).replace(label, "sac-fixed (300 steps)")
    assert now == " ".join(agents.report(tmp_path / "runs").split())
    with pytest.raises(UserError, match=r"'sac-fixed' of .* is not registered here: import my_sac"):
        agents.resume(tmp_path / "runs")


@dataclass(frozen=True)
class ClimbConfig:
    """Of the family below."""

    step: float = 0.1
    """How far the action moves at most."""


class Climb:
    """A family of its own: one number a run, the action, which follows the better half of two."""

    episodes = 2
    metrics = ("action",)

    def __init__(self, config, rule, seeds, observation_size, action_size):
        self.config, self.seeds, self.size = config, seeds, action_size
        self.action = np.zeros(len(seeds))

    def policy(self, runs=tree.ALL):
        action = self.action[runs, None, None]
        shape = (len(action), 1, self.size)
        return lambda observation, noise: (
            np.broadcast_to(action, (len(action), observation.shape[1], self.size)).astype(
                np.float32
            )
            + np.zeros(shape, np.float32)
        )

    def explorer(self, epoch, steps):
        tried = np.repeat(self.action, 2) + np.tile([-1, 1], len(self.seeds)) * self.config.step
        return lambda observation: np.tile(tried[:, None], self.size).astype(np.float32)

    def learn(self, rollout, epoch, active):
        better = rollout.returns.reshape(-1, 2).argmax(axis=1)
        self.action += np.where(active, (2 * better - 1) * self.config.step, 0.0)
        return np.where(active, self.action, np.nan)[:, None]

    def finite(self):
        return np.isfinite(self.action)

    def state_dict(self, runs=tree.ALL):
        return {"action": self.action[runs]}

    def load_state_dict(self, state, runs=tree.ALL):
        self.action[runs] = tree.expect("action", state, self.action[runs].shape, np.float64)


def test_a_family_of_ones_own_trains_and_resumes(tmp_path):
    """`Target` pays for a = 0.8."""
    register("climb", Algorithm("Climb", ClimbConfig, None, Climb))
    config = TrainConfig("climb", "Target-v0", (0, 1), 60, ClimbConfig())
    config.write(tmp_path)
    whole, stopped, resumed = (Training(TrainConfig.read(tmp_path)) for _ in range(3))
    learner: Learner = Climb(ClimbConfig(), None, (0,), 1, 1)
    assert set(learner.state_dict()) == {"action"}
    for _ in range(30):
        whole.run_epoch()
    for _ in range(4):
        stopped.run_epoch()
    stopped.save(tmp_path)
    resumed.load(tmp_path)
    while not resumed.done:
        resumed.run_epoch()
    assert resumed.learner.action == pytest.approx([0.8, 0.8], abs=0.101)
    np.testing.assert_array_equal(resumed.learner.action, whole.learner.action)
    with pytest.raises(UserError, match="hyperparameters of climb must be a ClimbConfig"):
        replace(config, hyperparameters=algorithm("sac").config())
