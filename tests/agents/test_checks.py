"""Settings whose annotations say which values are allowed."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import pytest

from agents.algorithms import ALGORITHMS, BUILT_IN
from agents.checks import In, Settings
from agents.errors import UserError


@dataclass(frozen=True)
class Own(Settings):
    """A field of every kind that is checked."""

    share: Annotated[float, In(0, 1)] = 0.5
    rate: Annotated[float, In(above=0, high=1)] = 0.1
    free: float = 0.0
    count: Annotated[int, In(1)] = 3
    index: int = 0
    kind: Literal["adam", "sgd"] = "adam"
    flag: bool = False
    sizes: Annotated[tuple[int, ...], In(1, 100)] = (64,)
    scale: Annotated[float | tuple[float, ...], In(0, 10)] = 1.0
    every: Annotated[int, In(1)] | None = None
    other: dict = None  # pyright: ignore: not checked


ALLOWED = {
    "share": [0, 1, 0.3, 1.0],
    "rate": [1e-12, 1],
    "free": [-1e300, 3],
    "count": [1, 2**40],
    "index": [-5, 0],
    "kind": ["sgd"],
    "flag": [True],
    "sizes": [(1,), (100, 1, 33)],
    "scale": [0, 10.0, (0.0, 10.0)],
    "every": [None, 1],
    "other": [{}, 3],
}
REFUSED = {
    "share": ([-1e-9, 1.1, math.nan, "0.5", None, True, [0.5]], "0 and at most 1|finite number"),
    "rate": ([0, 0.0, 1.5], "above 0 and at most 1"),
    "free": ([math.inf, -math.inf, 10**400, "1", 1j], "a finite number"),
    "count": ([0, 2.5, True, 2**41, 10**400], "at least 1|an integer|at most 10995|finite"),
    "index": ([1.5, "1", None], "an integer"),
    "kind": (["Adam", None, 1], "adam or sgd"),
    "flag": ([1, "no", None], "True or False"),
    "sizes": (
        [(), [64], 64, (0,), (101, 5), (5.0,), (True,)],
        "a tuple of one or more integers, each",
    ),
    "scale": ([-1, 11.0, (), (1.0, -1.0), [1.0], "1"], "at least 0 and at most 10"),
    "every": ([0, 1.5, False], "at least 1|an integer"),
}


@pytest.mark.parametrize("name", ALLOWED)
def test_what_is_allowed(name):
    for value in ALLOWED[name]:
        assert getattr(Own(**{name: value}), name) == value


def test_numbers_of_numpy_become_pythons():
    """In type as well, since sweeps compare the texts of settings."""
    given = {"share": 0.5, "count": 3, "flag": True, "sizes": (8, 4), "other": {"level": 2}}
    of_numpy = {"share": np.float64(0.5), "count": np.int64(3), "flag": np.bool_(True)}
    of_numpy |= {"sizes": tuple(np.array([8, 4])), "other": {"level": np.int8(2)}}
    assert repr(Own(**of_numpy)) == repr(Own(**given))


def test_whole_floats_are_integers_as_on_the_command_line():
    """In type as well; where a float is allowed, it stays a float."""
    given = {"count": 1e6, "every": np.float64(2.0), "share": 1.0, "index": -1e3}
    own = Own(**given)
    assert repr((own.count, own.every, own.share, own.index)) == "(1000000, 2, 1.0, -1000)"


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_and_how(name):
    """The message names the field, what is allowed, and the value."""
    values, allowed = REFUSED[name]
    for value in values:
        with pytest.raises(UserError, match=allowed) as error:
            Own(**{name: value})
        assert str(error.value).startswith(f"{name} must be ")
        assert str(error.value).endswith(f"got {value!r}")


def test_an_overriding_field_is_checked_by_its_own_annotation():
    """Bounds belong to their annotation: a field that a subclass overrides has its own bounds or
    none. A default that is not allowed is refused as well."""

    @dataclass(frozen=True)
    class Annotated_(Own):
        share: Annotated[float, In(0, 5)] = 2.0

    @dataclass(frozen=True)
    class Bare(Own):
        share: float = 2.0

    @dataclass(frozen=True)
    class Wrong(Own):
        count: int = 3.5  # pyright: ignore

    assert Annotated_().share == Bare().share == 2.0
    assert Bare(share=100.0).share == 100.0
    with pytest.raises(UserError, match="share must be at least 0 and at most 5, got 6"):
        Annotated_(share=6)
    with pytest.raises(UserError, match="share must be a finite number"):
        Bare(share="much")
    with pytest.raises(UserError, match=r"count must be an integer, got 3\.5"):
        Wrong()
    with pytest.raises(UserError, match="rate"):
        Bare(rate=0)


WRONG = [
    ("sac", "batch_size", 65_536, "replay_size"),
    ("sac-lb", "log_barrier_factor", 0, "0.001"),
    ("sac-lb", "streak_weight", -0.5, "at least 0"),
    ("wcsac", "initial_multiplier", 90, "at most 50"),
    ("wcsac", "variance_target", "cubed", "squared or unsquared"),
    ("wcsac", "damping_gradient", "no", "stopped or through"),
    ("trpo-lag", "multiplier_optimizer", "rms", "adam or sgd or pid"),
    ("trpo-lag", "initial_multiplier", -1, "at least 0"),
    ("trpo-lag", "pid_ki", -1, "at least 0"),
    ("ppo-lag", "clip_range", 0.0, "above 0 and at most 1"),
    ("ppo", "actor_iterations", 0, "at least 1"),
    ("cpo", "cost_limit", -1.0, "at least 0"),
]


@pytest.mark.parametrize(("name", "field", "value", "allowed"), WRONG)
def test_hyperparameters_out_of_bounds_are_refused(name, field, value, allowed):
    with pytest.raises(UserError, match=f"{field} must be .*{allowed}.*got {value}|{allowed}"):
        ALGORITHMS[name].config(**{field: value})


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_algorithm_checks_its_hyperparameters(name):
    """Odd layer sizes are allowed; no float may be infinite, NaN or a text."""
    config = ALGORITHMS[name].config
    assert config(hidden=(1, 17), activation="silu").hidden == (1, 17)
    for field, value in vars(config()).items():
        if isinstance(value, float):
            for wrong in (math.nan, math.inf, -math.inf, "1"):
                with pytest.raises(UserError, match=field):
                    config(**{field: wrong})
    wrong = {"activation": ("gelu",), "hidden": ((), (0,), 64)}
    for field, values in (wrong | {"input_scale": (0.0, (1.0, -1.0), ())}).items():
        for value in values:
            with pytest.raises(UserError, match=field):
                config(**{field: value})
