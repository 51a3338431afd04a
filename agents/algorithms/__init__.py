"""The algorithms by name: the built-in ones, a file each, and those that users register."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from agents.errors import UserError, nearest

if TYPE_CHECKING:  # torch takes a second to import, and a list of names does not need it
    import numpy as np
    from numpy.typing import NDArray

    from agents.lockstep.rollout import Act, Policy, Rollout

BUILT_IN = (
    *("trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"),
    *("sac-lb-streak", "ppo-lag", "ppo", "sac"),
    *("cppo-pid", "focops", "cup", "p3o", "ipo"),
    *("crpo", "pcpo", "c-trpo", "rcpo", "sac-pid", "cal", "trpo-pid"),
    *("ppo-saute", "trpo-saute"),
)
"""Each a module of this package that defines `ALGORITHM`. `ppo` and `sac` know no constraint."""


RESERVED = (
    *("algorithm", "task", "seeds", "steps", "out", "task_parameters", "costs", "preset"),
    *("checkpoint_every", "evaluate_every", "vectorization", "step_timeout", "backend"),
    *("tensorboard", "on_epoch", "progress", "engine", "address", "grid", "workers"),
    *("evaluation_episodes", "imports"),
)
"""Parameters of `agents.train` and `agents.sweep` and options of `circle2d train`, which no
hyper-parameter can be named like."""


class Learner(Protocol):
    """The runs of one algorithm, as the training loop sees them: what a family provides.

    R runs train side by side, and none depends on the others.

    Arrays of the state whose names are `actor` or begin with `actor.` are those that the policy
    depends on: a trained policy is loaded from them alone. For `to_torch` a learner also has a
    method `module(run)`: its deterministic policy as an `nn.Module`, observations -> actions. Where
    these are not those of `policy`, `to_torch` is refused.
    """

    episodes: int
    """Whole episodes of each run in an epoch."""
    metrics: tuple[str, ...]
    """Names of the numbers that `learn` returns."""

    def policy(self) -> Policy:
        """The policy of every run as it stands now."""
        ...

    def explorer(self, epoch: int, steps: NDArray[np.int64]) -> Act:
        """Actions of the runs in an epoch; steps: [R], environment steps each has taken before."""
        ...

    def learn(self, rollout: Rollout, epoch: int, active: NDArray[np.bool_]) -> NDArray:
        """Learn from an epoch of R·E episodes; active: [R], runs that take part.

        Returns each of `metrics`, [R, metrics]; NaN for runs that learned nothing.
        """
        ...

    def finite(self) -> NDArray[np.bool_]:
        """Mask of the runs that hold only finite numbers, [R]."""
        ...

    def state_dict(self) -> dict[str, NDArray]:
        """The whole training state as named arrays, the run axis first."""
        ...

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state, bit for bit. KeyError or ValueError for one that does not fit."""
        ...


class Algorithm(NamedTuple):
    """An algorithm: its title in tables, its hyper-parameters, its rule, its family, its speed."""

    title: str
    config: type
    """A frozen dataclass in which every hyper-parameter has a default, a text below it, and a name
    that is not `RESERVED`. Two methods are asked for where it has them: `wrap(env, costs,
    time_limit)` returns an Env or a VectorEnv of the task, which need not reset itself, as policies
    see it, in training, in evaluations and in films (costs: their names in the infos; time_limit:
    of the task, or None); `relabelled(rollout)` the `Rollout` that is learned from, while records
    keep the task's. Where `wrap` adds costs to the infos, `added_costs(costs)` returns their names;
    they are recorded behind those that the rule of the class limits."""
    rule: Any
    """The part that the algorithm adds to its family, which receives it."""
    family: Callable[..., Learner]
    """(config, rule, seeds, observation size, action size) -> the runs, ready to be trained. Where
    it has an attribute `takes`, these are the types of config and rule; `off_policy` says that it
    learns from a replay."""
    work: float = 7.5
    """Time of a step on Circle2D, in that of TRPO-Lag's; by default that of the slowest built-in
    one. Decides the order of a grid (what takes longest goes first) and the time left that is
    shown; no result."""

    @property
    def off_policy(self) -> bool:
        """Whether it learns from a replay, as its family says."""
        return getattr(self.family, "off_policy", False)


class _Algorithms(Mapping[str, Algorithm]):
    """Name -> algorithm; a built-in one is imported when it is asked for."""

    def __init__(self) -> None:
        self.registered: dict[str, Algorithm] = {}
        self.modules: dict[str, str] = {}

    def __getitem__(self, name: str) -> Algorithm:
        if name in BUILT_IN:
            return importlib.import_module(module_of(name)).ALGORITHM
        return self.registered[name]

    def __contains__(self, name: object) -> bool:
        return name in BUILT_IN or name in self.registered

    def __iter__(self) -> Iterator[str]:
        yield from (*BUILT_IN, *self.registered)

    def __len__(self) -> int:
        return len(BUILT_IN) + len(self.registered)


_algorithms = _Algorithms()
ALGORITHMS: Mapping[str, Algorithm] = _algorithms
"""Every algorithm by name. Listing the names imports nothing."""


def register(name: str, algorithm: Algorithm) -> None:
    """Register an algorithm under a name, for training, the command line and reports.

    The module that registered a name may do so again, such as a notebook whose cell runs again; the
    new algorithm takes its place. Raises UserError where the name is taken or cannot name a folder,
    or a hyper-parameter has the name of an option, and TypeError where `algorithm` is no
    `Algorithm` or its config no frozen dataclass with a default for every field, and ValueError
    where a multiplier or a limit is of a cost, or names a hyper-parameter, that is not there.
    """
    words = name.split("-") if isinstance(name, str) else [""]
    if not all(word.isascii() and word.isalnum() and word == word.lower() for word in words):
        raise UserError(f"an algorithm's name is lower-case words joined by '-', got {name!r}")
    module = sys._getframe(1).f_globals.get("__name__", "__main__")
    if name in ALGORITHMS and _algorithms.modules.get(name) != module:
        raise UserError(f"algorithm {name!r} is there already: choose another name")
    if not isinstance(algorithm, Algorithm):
        raise TypeError(f"register expects an agents.algorithms.Algorithm, got {algorithm!r}")
    config = algorithm.config
    parameters = getattr(config, "__dataclass_params__", None)
    if not isinstance(config, type) or parameters is None or not parameters.frozen:
        raise TypeError(f"the config of {name!r} must be a frozen dataclass, got {config!r}")
    missing = dataclasses.MISSING
    for field in dataclasses.fields(config):
        if field.default is missing and field.default_factory is missing:
            raise TypeError(f"{config.__name__}.{field.name} of {name!r} needs a default")
        if field.name in RESERVED:
            raise UserError(
                f"{config.__name__}.{field.name} of {name!r} is named like an option of training: "
                "choose another name"
            )
    if not callable(algorithm.family):
        raise TypeError(f"the family of {name!r} must make a Learner, got {algorithm.family!r}")
    of_config, of_rule = getattr(algorithm.family, "takes", (object, object))
    if not issubclass(config, of_config) or not isinstance(algorithm.rule, of_rule):
        raise TypeError(
            f"the family of {name!r} takes a subclass of {of_config.__name__} as config and a "
            f"{of_rule.__name__} as rule, got {config.__name__} and {algorithm.rule!r}"
        )
    _check_limits(name, algorithm)
    _algorithms.registered[name] = algorithm
    _algorithms.modules[name] = module


def _check_limits(name: str, algorithm: Algorithm) -> None:
    """Raise ValueError where a limit is of a cost that is not learned, or a multiplier follows one,
    and where they name a hyper-parameter that the config lacks."""
    rule, there = algorithm.rule, [field.name for field in dataclasses.fields(algorithm.config)]
    limits, multipliers = getattr(rule, "limits", ()), getattr(rule, "multipliers", ())
    if len(limits) > getattr(rule, "costs", len(limits)):
        raise ValueError(f"limits of {name!r} must be at most costs={rule.costs}, got {limits}")
    for multiplier in multipliers:
        if not 0 <= multiplier.signal < rule.costs:
            words = f"costs={rule.costs}, got {multiplier.signal}"
            raise ValueError(f"signal of a multiplier of {name!r} must be below {words}")
    # An algorithm without a limit keeps the default of `limits`.
    named = [("limits", field) for field in limits if field != "cost_limit"]
    roles = [(role, getattr(own, role)) for own in multipliers for role in ("limit", "highest")]
    named += [(f"{role} of a multiplier", field) for role, field in roles if field]
    for role, field in named:
        if not hasattr(algorithm.config, field):
            raise ValueError(
                f"{role} of {name!r} must be a hyper-parameter of {algorithm.config.__name__}, got "
                f"{field!r}: {nearest(field, there)}"
            )


def module_of(name: str) -> str:
    """The module whose import makes an algorithm known; "__main__" for the running script."""
    if name in BUILT_IN:
        return f"{__name__}.{name.replace('-', '_')}"
    return _algorithms.modules[name]


def algorithm(name: str) -> Algorithm:
    """The algorithm of that name. Raises UserError, naming the valid ones, for another."""
    if not isinstance(name, str):
        raise UserError(f"algorithm must be a name, like 'sac-lag', got {name!r}")
    if name not in ALGORITHMS:
        raise UserError(f"unknown algorithm {name!r}: {nearest(name, ALGORITHMS)}")
    return ALGORITHMS[name]


def title(name: str) -> str:
    """Title of an algorithm in tables; its name where it is not registered."""
    return ALGORITHMS[name].title if name in ALGORITHMS else name


def learner(
    name: str, config: Any, seeds: Sequence[int], observation_size: int, action_size: int
) -> Learner:
    """The runs of an algorithm, ready to be trained."""
    found = algorithm(name)
    return found.family(config, found.rule, seeds, observation_size, action_size)
