"""Registry of algorithms: the built-in ones, one file each, and those that users register."""

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
"""Names of the built-in algorithms, each with a module of this package that defines `ALGORITHM`.
`ppo` and `sac` have no constraint."""


RESERVED = (
    *("algorithm", "task", "seeds", "steps", "out", "task_parameters", "costs", "preset"),
    *("checkpoint_every", "evaluate_every", "vectorization", "step_timeout", "backend"),
    *("tensorboard", "on_epoch", "progress", "engine", "address", "grid", "workers"),
    *("evaluation_episodes", "imports", "algorithms", "tasks", "shard", "width"),
)
"""Parameters of `agents.train`, `agents.sweep` and `agents.grid` and options of their commands:
names that no hyper-parameter may have."""


class Learner(Protocol):
    """Interface of a family of algorithms to the training loop: the runs of one algorithm.

    R runs train side by side, and none depends on the others.

    Arrays of `state_dict` named `actor` or `actor.*` are all that the policy depends on: a trained
    policy is loaded from these alone. For `to_torch` a learner also has a method `module(run)`,
    which returns the deterministic policy as an `nn.Module`, observations -> actions. `to_torch`
    raises UserError where the module's actions differ from those of `policy`.
    """

    episodes: int
    """Number of whole episodes that a run plays in an epoch."""
    metrics: tuple[str, ...]
    """Names of the numbers that `learn` returns."""

    def policy(self) -> Policy:
        """Return the current policy of every run."""
        ...

    def explorer(self, epoch: int, steps: NDArray[np.int64]) -> Act:
        """Return the function that acts in an epoch; steps: [R], environment steps taken before."""
        ...

    def learn(self, rollout: Rollout, epoch: int, active: NDArray[np.bool_]) -> NDArray:
        """Learn from an epoch of R·E episodes; active: [R], runs that take part.

        Returns the values of `metrics`, [R, metrics]; NaN for runs that learned nothing.
        """
        ...

    def finite(self) -> NDArray[np.bool_]:
        """Return a mask [R] of the runs whose numbers are all finite."""
        ...

    def state_dict(self) -> dict[str, NDArray]:
        """Return the whole training state as named arrays; their first axis is that of runs. No
        name may be epoch, steps, failures or tracebacks."""
        ...

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state, bit for bit. Raises KeyError or ValueError if it does not fit."""
        ...


class Algorithm(NamedTuple):
    """An algorithm: its title in tables, hyper-parameters, rule, family and speed."""

    title: str
    config: type
    """Frozen dataclass of the hyper-parameters. Each has a default, a text below it, and a name
    that is not in `RESERVED`. Three methods are optional. `wrap(env, costs, time_limit)` returns an
    Env or a VectorEnv of the task as policies see it in training, evaluations and films; it need
    not reset itself (costs: their names in the infos; time_limit: of the task, or None).
    `relabelled(rollout)` returns the `Rollout` to learn from; records keep the original.
    `added_costs(costs)` returns the names of the costs that `wrap` adds to the infos; they are
    recorded right after the costs that `rule` learns."""
    rule: Any
    """The algorithm's own part, such as a `CostRule`, which `family` receives."""
    family: Callable[..., Learner]
    """(config, rule, seeds, observation size, action size) -> a new `Learner`. Optional attributes:
    `takes`, the types of config and rule; `off_policy`, whether the family learns from a replay
    buffer."""
    work: float = 7.5
    """Time of an environment step on Circle2D, relative to TRPO-Lag; the default is that of the
    slowest built-in algorithm. It decides the order of a grid, longest training first, and the time
    left that is shown, but no result."""

    @property
    def off_policy(self) -> bool:
        """Whether the algorithm learns from a replay buffer, according to its family."""
        return getattr(self.family, "off_policy", False)


class _Algorithms(Mapping[str, Algorithm]):
    """Mapping from name to algorithm; a built-in algorithm is imported when it is looked up."""

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

    The module that registered a name may register it again, as a notebook cell that is run twice
    does; the new algorithm replaces the old one. Raises UserError if the name is taken or cannot
    name a folder, or if a hyper-parameter has the name of an option; TypeError if `algorithm` is no
    `Algorithm`, its config no frozen dataclass with a default for every field, or its family takes
    another config or rule; ValueError if a limit or a multiplier refers to a cost or a
    hyper-parameter that does not exist.
    """
    words = name.split("-") if isinstance(name, str) else [""]
    if not all(word.isascii() and word.isalnum() and word == word.lower() for word in words):
        raise UserError(f"an algorithm's name is lower-case words joined by '-', got {name!r}")
    module = sys._getframe(1).f_globals.get("__name__", "__main__")
    if name == "zoo" or (name in ALGORITHMS and _algorithms.modules.get(name) != module):
        raise UserError(f"algorithm {name!r} is registered already: choose another name")
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
                f"{config.__name__}.{field.name} of {name!r} has the name of a training option: "
                "choose another name"
            )
    if not callable(algorithm.family):
        raise TypeError(f"the family of {name!r} must return a Learner, got {algorithm.family!r}")
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
    """Raise ValueError if a limit or a multiplier refers to a cost that is not learned, or to a
    hyper-parameter that the config lacks."""
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
    """Return the module whose import registers an algorithm; "__main__" for the running script."""
    if name in BUILT_IN:
        return f"{__name__}.{name.replace('-', '_')}"
    return _algorithms.modules[name]


def algorithm(name: str) -> Algorithm:
    """Return the algorithm of that name. Raises UserError, naming valid ones, if there is none."""
    if not isinstance(name, str):
        raise UserError(f"algorithm must be a name, like 'sac-lag', got {name!r}")
    if name not in ALGORITHMS:
        raise UserError(f"unknown algorithm {name!r}: {nearest(name, ALGORITHMS)}")
    return ALGORITHMS[name]


def title(name: str) -> str:
    """Return the title of an algorithm in tables, or its name if it is not registered."""
    return ALGORITHMS[name].title if name in ALGORITHMS else name


def learner(
    name: str, config: Any, seeds: Sequence[int], observation_size: int, action_size: int
) -> Learner:
    """Return a new learner for the runs of an algorithm."""
    found = algorithm(name)
    return found.family(config, found.rule, seeds, observation_size, action_size)
