"""Algorithms registered by users. A user-defined family is in toy_family.py."""

import inspect
import math
import re
import sys
from dataclasses import make_dataclass
from pathlib import Path

import numpy as np
import pytest
from small_trainings import trained
from toys import register as register_tasks

import agents
from agents import algorithms
from agents.algorithms import ALGORITHMS, BUILT_IN, RESERVED, algorithm, module_of, register, title
from agents.errors import UserError
from agents.presets import preset

register_tasks()

PAGE = Path(__file__).parents[3] / "docs" / "extending.md"


@pytest.fixture(autouse=True)
def nothing_stays(monkeypatch):
    monkeypatch.setattr(algorithms._algorithms, "registered", {})


@pytest.fixture
def sac_fixed(tmp_path, monkeypatch):
    """The algorithm of docs/extending.md, registered by the module my_algorithm."""
    (code,) = re.findall(r"```python\n# my_algorithm\.py\n(.*?)```", PAGE.read_text(), re.S)
    (tmp_path / "my_algorithm.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_algorithm", raising=False)
    __import__("my_algorithm")


@pytest.mark.parametrize(
    ("name", "more"), [("sac", {"cost_critic_loss", "risk"}), ("ppo", {"cost_critic_loss"})]
)
def test_a_baseline_trains_as_it_would_with_cost_critics(name, more):
    """A copy whose rule learns a cost without penalising it has the same policy and reward critics,
    and further metrics."""
    known = algorithm(name)
    register("beside", known._replace(rule=known.rule._replace(costs=1)))
    plain, beside = trained(name), trained("beside")
    assert set(beside.learner.metrics) - set(plain.learner.metrics) == more
    np.testing.assert_array_equal(plain.learner._state.actor, beside.learner._state.actor)
    own, critics = plain.learner._state.critics, beside.learner._state.critics
    np.testing.assert_array_equal(own, critics[:, : own.shape[1]])


def test_the_algorithm_of_the_docs_is_sac_and_sac_lag_at_two_prices(sac_fixed):
    """At price 0 its actor is SAC's, bit for bit; at price ln 2 it is that of SAC-Lag with a
    constant multiplier."""
    assert list(ALGORITHMS) == [*BUILT_IN, "sac-fixed"]
    assert title("sac-fixed") == "SAC-Fixed"
    free, plain = trained("sac-fixed", price=0.0), trained("sac")
    np.testing.assert_array_equal(free.learner._state.actor, plain.learner._state.actor)
    paying, lag = trained("sac-fixed", price=math.log(2.0)), trained("sac-lag", multiplier_lr=0.0)
    actor = lag.learner.state_dict()["actor"]
    np.testing.assert_allclose(paying.learner.state_dict()["actor"], actor, rtol=0, atol=1e-4)
    assert np.abs(actor - plain.learner.state_dict()["actor"]).max() > 1e-3


def test_names_of_parameters_of_train_sweep_and_grid_are_reserved():
    every = agents.train, agents.sweep, agents.grid
    functions = [inspect.signature(f).parameters.values() for f in every]
    names = {one.name for own in functions for one in own if one.kind is not one.VAR_KEYWORD}
    assert names <= set(RESERVED)


def test_what_register_refuses(sac_fixed):
    own = algorithm("sac-fixed")
    for name in ("sac", "sac-fixed", "", "My-Own", "my own", "my--own", "../own", 3, "zoo"):
        with pytest.raises(UserError, match=repr(name)):
            register(name, own)
    loose = make_dataclass("Config", [("a", int, 1)])
    incomplete = make_dataclass("Config", [("a", int)], frozen=True)
    named = make_dataclass("Config", [("backend", str, "c++")], frozen=True)  # as in `train`
    cpo, ppo = algorithm("cpo"), algorithm("ppo-lag")
    for wrong, named_in_message in (
        *((own._replace(config=c), "config of 'own'") for c in (loose, dict, loose(), None)),
        (own._replace(config=incomplete), r"Config\.a of 'own' needs a default"),
        (own._replace(config=named), r"Config\.backend of 'own'"),
        *((other._replace(rule=own.rule), "rule") for other in (cpo, ppo)),
        *((other._replace(config=own.config), "config") for other in (cpo, ppo)),
        (own._replace(family=None), "family of 'own'"),
        ("sac", "'sac'"),
    ):
        with pytest.raises((TypeError, UserError), match=named_in_message):
            register("own", wrong)
    assert list(ALGORITHMS) == [*BUILT_IN, "sac-fixed"]


def test_an_algorithm_belongs_to_the_module_that_registers_it(sac_fixed, tmp_path):
    """Not to its config's module, which may be the package's own. A sweep refuses an algorithm of
    the running script, which its processes cannot import."""
    lag = algorithm("sac-lag")
    register("lag-again", lag)
    script = {"__name__": "__main__", "agents": agents, "lag": lag}
    exec("agents.register('of-script', lag)", script)
    names = ("sac-lag", "sac-fixed", "lag-again", "of-script")
    expected = ["agents.algorithms.sac_lag", "my_algorithm", __name__, "__main__"]
    assert [module_of(name) for name in names] == expected
    with pytest.raises(UserError, match="of-script is registered in the running script"):
        agents.sweep("of-script", grid={"cost_limit": (1.0, 2.0)}, steps=100, out=tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_a_notebooks_cell_may_register_its_algorithm_again():
    lag = algorithm("sac-lag")
    cell = {"__name__": "__main__", "agents": agents, "lag": lag}
    for name in ("First", "Second"):
        exec(f"agents.register('of-cell', lag._replace(title='{name}'))", cell)
    assert algorithm("of-cell").title == "Second"
    with pytest.raises(UserError, match="'of-cell' is registered already"):
        register("of-cell", lag)


def test_a_family_that_extends_another_has_its_presets():
    lag = algorithm("sac-lag")

    class Extended(lag.family):
        """A user-defined family."""

    register("extended", lag._replace(family=Extended))
    for task in ("Circle2D-1-v0", "circle2d_mj/SafetyPointGoal1-v0", "Walk-v0"):
        assert preset("extended", task) == preset("sac-lag", task)
    assert preset("extended", "Circle2D-1-v0").time_limit == "terminal"
