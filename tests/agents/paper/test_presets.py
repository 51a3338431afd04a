"""Presets against the paper's table HP_Circle2D, typed off."""

from dataclasses import dataclass, fields

import pytest

import agents
from agents import algorithms
from agents.algorithms import ALGORITHMS
from agents.paper.grid import unprinted
from agents.paper.presets import PAPER_ALGORITHMS, preset

SHARED = {"batch_size": 256, "discount": 0.99, "learning_rate": 3e-4, "cost_limit": 5}
SHARED |= {"hidden": (64, 64)}
ON_POLICY = {
    "episodes": 10,
    "critic_iterations": 10,
    "gae_lambda": 0.95,
    "cg_iterations": 15,
    "line_search_steps": 15,
    "target_kl": 0.01,
    "time_limit": "bootstrap",  # not printed
}
OFF_POLICY = {
    "gradient_steps": 5,
    "random_steps": 5000,
    "replay_size": 50000,
    "time_limit": "terminal",  # not printed
}
PRINTED = {
    "trpo-lag": ON_POLICY | {"initial_multiplier": 0.001, "multiplier_lr": 0.005},
    "cpo": ON_POLICY,
    "sac-lag": OFF_POLICY | {"initial_multiplier": 0, "multiplier_lr": 3e-4},
    "sac-lb": OFF_POLICY | {"log_barrier_factor": 3},
    "wcsac": OFF_POLICY | {"risk_level": 0.5},
}


@pytest.mark.parametrize("name", PAPER_ALGORITHMS)
def test_presets_are_the_papers(name):
    config = preset(name, "Circle2D-2-v0")
    for field, value in (SHARED | PRINTED[name]).items():
        assert getattr(config, field) == value, field


# Table HP_SafetyGymnasium: what differs there.
SAFETY = {"SafetyPointCircle1-v0": 20, "SafetyPointGoal1-v0": 10, "SafetyHopperVelocity-v1": 10}


@pytest.mark.parametrize("name", PAPER_ALGORITHMS)
@pytest.mark.parametrize("task", SAFETY)
def test_presets_of_the_safety_tasks(name, task):
    printed = SHARED | PRINTED[name] | {"cost_limit": 25}
    if "episodes" in printed:
        printed |= {"episodes": SAFETY[task]}
    else:
        printed |= {"random_steps": 50_000, "replay_size": 500_000, "time_limit": "bootstrap"}
    config = preset(name, f"circle2d_mj/{task}")
    for field, value in printed.items():
        assert getattr(config, field) == value, field
    assert preset(name, f"circle2d_mj:circle2d_mj/{task}") == config


def test_presets_of_algorithms_that_the_paper_does_not_have():
    """Those of their family on the paper's tasks."""
    assert preset("ppo-lag", "Circle2D-1-v0").cost_limit == 5.0
    assert preset("ppo-lag", "Circle2D-1-v0").time_limit == "bootstrap"
    assert preset("ppo-lag", "circle2d_mj/SafetyPointCircle1-v0").episodes == 20
    assert preset("sac", "Circle2D-1-v0").time_limit == "terminal"
    assert preset("sac", "circle2d_mj/SafetyPointGoal1-v0").replay_size == 500_000
    assert unprinted("sac") is unprinted("ppo-lag") is None


@pytest.fixture
def subclass():
    """Register an algorithm with a config class as "mine", like the built-in one given."""

    def register(name, config):
        agents.register("mine", ALGORITHMS[name]._replace(config=config))

    yield register
    algorithms._algorithms.registered.pop("mine", None)


def test_a_default_of_ones_own_comes_before_the_preset(subclass):
    @dataclass(frozen=True)
    class Mine(ALGORITHMS["sac-lb"].config):
        cost_limit: float = 3.0
        replay_size: int = 1000

    subclass("sac-lb", Mine)
    assert preset("mine", "Circle2D-1-v0") == Mine(time_limit="terminal")
    assert preset("mine", "circle2d_mj/SafetyPointGoal1-v0") == Mine(random_steps=50_000)


def test_a_subclass_of_sac_lb_streak_has_its_preset(subclass):
    @dataclass(frozen=True)
    class Mine(ALGORITHMS["sac-lb-streak"].config):
        streak_weight: float = 2.0

    subclass("sac-lb-streak", Mine)
    for task in ("Circle2D-1-v0", "Circle2DMuJoCo-1-v0", "circle2d_mj/SafetyPointGoal1-v0"):
        found = {of.name: getattr(preset("mine", task), of.name) for of in fields(Mine)}
        usual = preset("sac-lb-streak", task)
        assert found == {of: getattr(usual, of) for of in found} | {"streak_weight": 2.0}
