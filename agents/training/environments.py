"""Environments to train in: any gymnasium task with Box spaces and costs in its info."""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import re
import traceback
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from agents.errors import (
    OWN_ERRORS,
    OwnCodeError,
    TaskFailure,
    UserError,
    described,
    is_missing,
    nearest,
)
from agents.lockstep.rollout import MAX_STEPS, require_info
from agents.training.wrappers import (
    CheckedEnv,
    FailsAlone,
    Guard,
    ScaledActions,
    quiet_worker,
    recorded_info,
    silent,
)
from circle2d_mj.core.view import View

Vectorization = Literal["auto", "sync", "async"]
TASK = re.compile(r"([\w.]+:)?([\w-]+/)?[\w:.-]+")
"""Ids of tasks, as gymnasium has them, with the module that registers them before."""


def make_envs(
    task: str,
    num_envs: int,
    parameters: dict[str, Any],
    vectorization: Vectorization = "auto",
    step_timeout: float | None = None,
    costs: Sequence[str] = ("cost",),
    alone: bool = False,
) -> VectorEnv:
    """`num_envs` environments that take actions in [-1, 1] and do not reset themselves.

    auto: the task's own vector environment where it has one that need not reset itself, gymnasium's
    `SyncVectorEnv` otherwise; async: `AsyncVectorEnv`, a process for each environment. All give the
    same numbers. step_timeout, alone: see `Guard`. Raises UserError for an unknown task, parameters
    it refuses, and spaces that are not flat Boxes (actions: bounded); stepping them, TaskFailure.
    """
    envs = unscaled(task, num_envs, parameters, vectorization, costs)
    return ScaledActions(Guard(envs, task, step_timeout, alone))


def unscaled(
    task: str,
    num_envs: int,
    parameters: dict[str, Any],
    vectorization: Vectorization = "auto",
    costs: Sequence[str] = ("cost",),
) -> VectorEnv:
    """The environments of `make_envs` with the task's own actions."""
    name, mode = registered(task), "async" if vectorization == "async" else "sync"
    own: dict[str, Any] = {"autoreset_mode": AutoresetMode.DISABLED}
    try:
        if vectorization == "auto" and is_native(task):
            mode, how = "vector_entry_point", own
        else:
            own |= {"worker": quiet_worker} if mode == "async" else {}
            wrappers = (functools.partial(CheckedEnv, costs=costs), FailsAlone)
            how = {"vector_kwargs": own, "wrappers": wrappers}
        with silent() if mode == "async" else contextlib.nullcontext():
            envs = gym.make_vec(name, num_envs, vectorization_mode=mode, **how, **parameters)
    except OWN_ERRORS as error:  # of the task's own code
        # gymnasium wraps the error of another process in one of the same class.
        inner = error.args[0] if isinstance(error, OwnCodeError) else error
        if isinstance(inner, OwnCodeError):
            traceback.clear_frames(error.__traceback__)  # which hold the other processes
            raise OwnCodeError(f"cannot make task {task!r}: {inner}") from inner.__cause__
        if isinstance(error, (TypeError, ValueError)) and not module_of_task(task):
            raise UserError(f"cannot make task {task!r}: {error}") from error
        raise OwnCodeError(f"cannot make task {task!r}: {described(error)}") from error
    checked_spaces(task, envs.single_observation_space, envs.single_action_space)
    return envs


def check_task(task: str, parameters: dict[str, Any], costs: Sequence[str] = ("cost",)) -> None:
    """Raise UserError for a task that cannot be made, never ends, or whose steps lack a cost."""
    if parameters.get("max_episode_steps", 1) is None:
        raise UserError("task_parameters: max_episode_steps must not be None, episodes must end")
    for parameter in sorted(parameters.keys() & gym.spec(registered(task)).kwargs.keys()):
        raise UserError(
            f"task_parameters: {parameter} is part of the task's id, {task}; choose another id"
        )
    with contextlib.closing(make_envs(task, 1, parameters, costs=costs)) as envs:
        envs.reset(seed=0)
        try:
            info = envs.step(np.zeros(envs.action_space.shape or (), dtype=np.float32))[-1]
        except TaskFailure as error:
            if type(error.__cause__) is UserError:  # not of the task's own code
                raise UserError(f"task {task!r}: {error.__cause__}") from None
            if isinstance(error.__cause__, (ValueError, gym.error.Error)) and _gives_six(envs):
                raise UserError(
                    f"a step of task {task!r} returns Safety-Gymnasium's six values: register it "
                    "with circle2d_mj.FromSafetyGymnasium around it, which makes them five"
                ) from None
            raise
    require_info(f"task {task!r}", info, costs)


def _gives_six(envs: VectorEnv) -> bool:
    """Whether a step of a task that fails returns six values, as gymnasium's wrappers hide."""
    own: Any = envs.unwrapped
    env = own.envs[0].unwrapped if isinstance(own, SyncVectorEnv) else own
    with contextlib.suppress(*OWN_ERRORS):
        env.reset(seed=0)
        return len(env.step(env.action_space.sample())) == 6
    return False


def time_limit(task: str, parameters: dict[str, Any]) -> int | None:
    """Steps after which an episode of a registered task is cut off; None where it is not known."""
    return parameters.get("max_episode_steps", gym.spec(registered(task)).max_episode_steps)


def most_steps(*limits: int | None) -> int:
    """Steps after which an episode counts as one that never ends, by the tasks' time limits."""
    return max(MAX_STEPS, *(limit or 0 for limit in limits))


class Looks(NamedTuple):
    """View and recorded numbers that a task's environment declares."""

    view: View | None
    """Its attribute `view`; None where it has none."""
    recorded: dict[str, str]
    """`recorded_info`"""


def looks_of(task: str, parameters: dict[str, Any]) -> Looks:
    """The declarations of a registered task, empty for another: no module is imported for it.
    Raises UserError where the task cannot be made."""
    with _one(task, parameters) as env:
        return Looks(_view(env), {} if env is None else recorded_info(env))


def view_of(task: str, parameters: dict[str, Any]) -> View | None:
    """The view of a registered task alone: see `looks_of`."""
    with _one(task, parameters) as env:
        return _view(env)


def _view(env: Any) -> View | None:
    try:
        view = env.get_wrapper_attr("view") if isinstance(env, gym.Env) else env.view
    except AttributeError:
        return None
    return view if callable(getattr(view, "positions", None)) else None


@contextlib.contextmanager
def _one(task: str, parameters: dict[str, Any]) -> Iterator[Any]:
    """An environment of a registered task, with its wrappers, which may hold attributes; None of
    another task."""
    name = task.rpartition(":")[2]
    if name not in gym.registry:
        yield None
        return
    with contextlib.closing(unscaled(name, 1, parameters)) as envs:
        env = envs.unwrapped
        yield env.envs[0] if isinstance(env, SyncVectorEnv) else env


def spaces_of(
    tasks: Sequence[str],
    parameters: dict[str, Any],
    wrap: Callable[[VectorEnv, str], VectorEnv] = lambda envs, task: envs,
) -> Spaces:
    """`Spaces` of some tasks as policies see them: wrap returns their environments so. Raises
    UserError where they have different ones."""
    spaces: list[Spaces] = []
    for task in tasks:
        with contextlib.closing(unscaled(task, 1, parameters)) as envs:
            seen = wrap(envs, task)
            own = seen.single_observation_space, seen.single_action_space
            spaces.append(checked_spaces(task, *own))
    for task, other in zip(tasks, spaces, strict=True):
        if other != spaces[0]:
            raise UserError(
                "tasks that train together must have equal observations and actions: "
                f"{tasks[0]} has {spaces[0]}, {task} has {other}"
            )
    return spaces[0]


def checked_spaces(task: str, observations: Any, actions: Any) -> Spaces:
    """`Spaces` of the spaces of one environment of a task. Raises UserError where they are not flat
    Boxes, that of the actions bounded."""
    _check_space(task, "observation", observations)
    _check_space(task, "action", actions)
    if not (np.isfinite([actions.low, actions.high]).all() and (actions.low < actions.high).all()):
        rule = "have finite bounds, each low below its high"
        raise UserError(f"the action space of task {task!r} must {rule}, got {actions}")
    low, high = (tuple(map(float, bound)) for bound in (actions.low, actions.high))
    return Spaces(observations.shape[0], low, high, str(actions.dtype))


class Spaces(NamedTuple):
    """Observations and actions of a task."""

    observation_size: int
    low: tuple[float, ...]
    """Least value of each number of an action."""
    high: tuple[float, ...]
    """Greatest likewise."""
    dtype: str
    """Type of actions, such as float32."""

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers an observation and an action hold."""
        return self.observation_size, len(self.low)


def registered(task: str) -> str:
    """The id of a task, without the module in "module:id".

    Nothing is imported: the task may come from the files of somebody else. Raises UserError where
    the task is not registered, naming the module to be imported.
    """
    module, _, name = task.rpartition(":")
    if module and name not in gym.registry:
        raise UserError(
            f"task {task!r} is not registered: if you trust the module {module!r}, import it "
            f"first, with --import {module} on the command line"
        )
    try:
        gym.spec(name)
    except gym.error.Error as error:
        task, name = (text if len(text) < 80 else f"{text[:80]}..." for text in (task, name))
        if isinstance(error, gym.error.VersionNotFound):  # which names the versions there are
            raise UserError(f"cannot make task {task!r}: {error}") from None
        hint = nearest(name, gym.registry, otherwise="gymnasium does not have it")
        raise UserError(
            f"unknown task {task!r}: {hint} (a task of your own: import its module first, on the "
            "command line by --import MODULE)"
        ) from None
    return name


def task_id(task: str) -> str:
    """The id of a task that the user names, with its version, where none is given the newest:
    Circle2D-1-v0 for Circle2D-1.

    "module:id" imports the module, as gymnasium does it. Raises UserError for an unknown task, and
    for what is no id.
    """
    if not isinstance(task, str) or not TASK.fullmatch(task):
        given = repr(task)[:80]
        raise UserError(f"task must be the id of a gymnasium task, like 'Circle2D-1', got {given}")
    module, _, name = task.rpartition(":")
    if module:
        try:
            importlib.import_module(module)
        except OWN_ERRORS as error:  # of the user's own code
            if is_missing(error, module):  # itself
                words = f"there is no module {module!r}; for one in the current folder give"
                raise UserError(f"task {task!r}: {words} --import {module}") from None
            raise OwnCodeError(f"cannot make task {task!r}: {described(error)}") from error
    versions = [re.fullmatch(f"{re.escape(name)}-v([0-9]+)", other) for other in gym.registry]
    newest = max(filter(None, versions), key=lambda found: int(found[1]), default=None)
    if name not in gym.registry and newest:
        return task + newest[0].removeprefix(name)
    registered(task)
    return task


def module_of_task(task: str) -> str:
    """The module whose import makes a task known: that of "module:id", else of its entry point; ""
    for tasks that gymnasium and this package register."""
    module = task.rpartition(":")[0]
    entry_point = gym.spec(registered(task)).entry_point
    if isinstance(entry_point, str):
        of_entry_point = entry_point.partition(":")[0]
    else:
        of_entry_point = getattr(entry_point, "__module__", "")
    known = of_entry_point.partition(".")[0] in ("gymnasium", "circle2d_mj")
    return module or ("" if known else of_entry_point)


def is_native(task: str) -> bool:
    """Whether a task has a vector environment of its own with a choice of autoreset mode."""
    entry_point = gym.spec(registered(task)).vector_entry_point
    if entry_point is None:
        return False
    make = load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
    return "autoreset_mode" in inspect.signature(make).parameters


def _check_space(task: str, name: str, space: gym.Space) -> None:
    flat = isinstance(space, Box) and len(space.shape) == 1 and bool(space.shape[0])
    if flat and (name == "observation" or np.issubdtype(space.dtype, np.floating)):
        return
    must = "a flat Box" if not flat else "of floats"
    remedy = "register the task with gymnasium.wrappers.FlattenObservation around it"
    if name == "action":
        remedy = "the algorithms here have continuous actions alone"
    elif (without := task.replace("Vision-", "-")) != task:
        remedy = f"the algorithms here learn from numbers, not from pictures; {without} has none"
    raise UserError(
        f"the {name} space of task {task!r} must be {must}, got {space}: {remedy}; the metric, "
        "emcc.RecordCosts, works with any library and any space"
    )
