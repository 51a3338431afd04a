"""Environments for training: any gymnasium task with Box spaces and costs in its info."""

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
"""Ids of tasks as in gymnasium, optionally preceded by the module that registers them."""


def make_envs(
    task: str,
    num_envs: int,
    parameters: dict[str, Any],
    vectorization: Vectorization = "auto",
    step_timeout: float | None = None,
    costs: Sequence[str] = ("cost",),
    alone: bool = False,
) -> VectorEnv:
    """Make `num_envs` environments that take actions in [-1, 1] and do not reset themselves.

    auto: the task's own vector environment, if it has one that need not reset itself, else
    gymnasium's `SyncVectorEnv`; async: `AsyncVectorEnv`, a process for each environment. All give
    the same numbers. step_timeout, alone: see `Guard`. Raises UserError for an unknown task,
    parameters that the task refuses, and spaces that are not flat Boxes (bounded for actions).
    Errors in a reset or step are TaskFailures.
    """
    envs = unscaled(task, num_envs, parameters, vectorization, costs)
    return ScaledActions(Guard(envs, task, costs, step_timeout, alone))


def unscaled(
    task: str,
    num_envs: int,
    parameters: dict[str, Any],
    vectorization: Vectorization = "auto",
    costs: Sequence[str] = ("cost",),
) -> VectorEnv:
    """Make the environments of `make_envs`, but with the task's own actions."""
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
            traceback.clear_frames(error.__traceback__)  # the frames hold the other processes
            raise OwnCodeError(f"cannot make task {task!r}: {inner}") from inner.__cause__
        if isinstance(error, (TypeError, ValueError)) and not module_of_task(task):
            raise UserError(f"cannot make task {task!r}: {error}") from error
        raise OwnCodeError(f"cannot make task {task!r}: {described(error)}") from error
    does = envs.metadata.get("autoreset_mode", AutoresetMode.DISABLED)
    if does not in (AutoresetMode.DISABLED, AutoresetMode.DISABLED.value):
        raise UserError(
            f"the vector environment of task {task!r} must not reset itself if it is made with "
            f"autoreset_mode DISABLED; its metadata has {does}"
        )
    checked_spaces(task, envs.single_observation_space, envs.single_action_space)
    return envs


def check_task(task: str, parameters: dict[str, Any], costs: Sequence[str] = ("cost",)) -> None:
    """Raise UserError if a task cannot be made, never ends, or its steps lack a cost."""
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
    """Whether a task fails because its step returns six values, which gymnasium's wrappers hide."""
    own: Any = envs.unwrapped
    env = own.envs[0].unwrapped if isinstance(own, SyncVectorEnv) else own
    with contextlib.suppress(*OWN_ERRORS):
        env.reset(seed=0)
        return len(env.step(env.action_space.sample())) == 6
    return False


def time_limit(task: str, parameters: dict[str, Any]) -> int | None:
    """Return the steps after which episodes of a registered task are truncated; None if unknown."""
    return parameters.get("max_episode_steps", gym.spec(registered(task)).max_episode_steps)


def most_steps(*limits: int | None) -> int:
    """Return after how many steps an episode is taken to never end, by the tasks' time limits."""
    return max(MAX_STEPS, *(limit or 0 for limit in limits))


class Looks(NamedTuple):
    """The view and the recorded numbers that a task's environment declares."""

    view: View | None
    """Attribute `view` of the environment; None if it has none."""
    recorded: dict[str, str]
    """Units, by name, of the numbers recorded from infos: see `recorded_info`."""


def looks_of(task: str, parameters: dict[str, Any]) -> Looks:
    """Return what a registered task declares; for any other task nothing, as no module is imported
    for it. Raises UserError if the task cannot be made."""
    with _one(task, parameters) as env:
        return Looks(_view(env), {} if env is None else recorded_info(env))


def view_of(task: str, parameters: dict[str, Any]) -> View | None:
    """Return only the view of a registered task: see `looks_of`."""
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
    """Yield an environment of a registered task, with its wrappers, which may hold attributes; None
    for any other task."""
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
    """Return the common spaces of tasks as policies see them; wrap: (environments, task) -> the
    environments as policies see them. Raises UserError if the spaces differ."""
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
    """Return `Spaces` from the spaces of an environment. Raises UserError if they are not flat
    Boxes, or actions are not bounded."""
    _check_space(task, "observation", observations)
    _check_space(task, "action", actions)
    if not (np.isfinite([actions.low, actions.high]).all() and (actions.low < actions.high).all()):
        rule = "have finite bounds, each low below its high"
        raise UserError(f"the action space of task {task!r} must {rule}, got {actions}")
    low, high = (tuple(map(float, bound)) for bound in (actions.low, actions.high))
    return Spaces(observations.shape[0], low, high, str(actions.dtype))


class Spaces(NamedTuple):
    """Size of a task's observations, and bounds and type of its actions."""

    observation_size: int
    low: tuple[float, ...]
    """Least value of each number of an action."""
    high: tuple[float, ...]
    """Greatest value of each number of an action."""
    dtype: str
    """Type of actions, such as float32."""

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers in an observation and in an action."""
        return self.observation_size, len(self.low)


def registered(task: str) -> str:
    """Return the id of a registered task, without the module in "module:id".

    Nothing is imported, since the task may come from somebody else's files. Raises UserError,
    naming the module to import, if the task is not registered.
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
        if isinstance(error, gym.error.VersionNotFound):  # it names the versions
            raise UserError(f"cannot make task {task!r}: {error}") from None
        hint = nearest(name, gym.registry, otherwise="gymnasium does not have it")
        raise UserError(
            f"unknown task {task!r}: {hint} (a task of your own: import its module first, on the "
            "command line by --import MODULE)"
        ) from None
    return name


def task_id(task: str) -> str:
    """Return the id of the task that a user names, by default with the newest version.

    For example, Circle2D-1-v0 for Circle2D-1. "module:id" imports the module, as in gymnasium.
    Raises UserError for an unknown task, and for anything that is no id.
    """
    if not isinstance(task, str) or not TASK.fullmatch(task):
        given = repr(task)[:80]
        raise UserError(f"task must be the id of a gymnasium task, like 'Circle2D-1', got {given}")
    module, _, name = task.rpartition(":")
    if module:
        try:
            importlib.import_module(module)
        except OWN_ERRORS as error:  # of the user's own code
            if is_missing(error, module):  # not one that it imports
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
    """Return the module whose import registers a task: that of "module:id", else of the entry
    point; "" for tasks that gymnasium or this package registers."""
    module = task.rpartition(":")[0]
    entry_point = gym.spec(registered(task)).entry_point
    if isinstance(entry_point, str):
        of_entry_point = entry_point.partition(":")[0]
    else:
        of_entry_point = getattr(entry_point, "__module__", "")
    known = of_entry_point.partition(".")[0] in ("gymnasium", "circle2d_mj")
    return module or ("" if known else of_entry_point)


def is_native(task: str) -> bool:
    """Whether a task has its own vector environment, with a choice of the autoreset mode."""
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
        remedy = "the algorithms here have continuous actions only"
    elif (without := task.replace("Vision-", "-")) != task:
        remedy = f"the algorithms here learn from numbers, not from pictures; {without} has none"
    raise UserError(
        f"the {name} space of task {task!r} must be {must}, got {space}: {remedy}; the metric, "
        "emcc.RecordCosts, works with any library and any space"
    )
