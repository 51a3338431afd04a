"""Wrappers of environments for training: checks, failures, records, several tasks side by side."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium import logger
from gymnasium.spaces import Box
from gymnasium.vector import AsyncVectorEnv, VectorActionWrapper, VectorEnv, VectorWrapper
from gymnasium.vector.async_vector_env import _async_worker
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from agents.errors import OWN_ERRORS, OwnCodeError, TaskFailure, UserError, described
from agents.lockstep.rollout import FAILURE, require_info
from circle2d_mj.core.view import View
from emcc.arrays import as_flag, as_one

T = TypeVar("T")


class CheckedEnv(gym.Wrapper):
    """Converts reward, costs and recorded numbers of every step to float, `terminated` and
    `truncated` to bool, and errors of the task to TaskFailures.

    gymnasium's vector environments take the type of an array of costs from the first cost they
    meet, and fill in 0 for a missing cost: both would change costs silently. The cause of a
    TaskFailure is the task's error, also if it comes from another process.
    """

    def __init__(self, env: gym.Env, costs: Sequence[str]) -> None:
        super().__init__(env)
        self.numbers, self._steps = (*costs, *recorded_info(env)), 0

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment. Raises TaskFailure for any error in it."""
        self._steps = 0
        with failing("in a reset"):
            observation, info = self.env.reset(**kwargs)
            self._check(observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment. Raises TaskFailure for any error in it, and if the reward or a cost
        is no number, or `terminated` or `truncated` neither True nor False."""
        self._steps += 1
        with failing(f"in step {self._steps} of an episode"):
            observation, reward, terminated, truncated, info = self.env.step(action)
            self._check(observation)
            require_info(self.env, info, self.numbers)
            numbers = {name: self._number(f"info[{name!r}]", info[name]) for name in self.numbers}
            reward = self._number("reward", reward)
            terminated = self._number("terminated", terminated, as_flag)
            truncated = self._number("truncated", truncated, as_flag)
        return observation, reward, terminated, truncated, info | numbers

    def close(self) -> None:
        """Close the environment. Only warns of an error in it, since its work is done."""
        with told_in_close(self.env):
            self.env.close()

    def _check(self, observation: Any) -> None:
        shape = self.env.observation_space.shape
        if np.shape(observation) != shape:
            raise UserError(
                f"an observation must be {list(shape or ())}, as its space says, "
                f"got {list(np.shape(observation))}"
            )

    def _number(self, name: str, value: Any, read: Callable[[Any, str], T] = as_one) -> T:
        try:
            return read(value, name)
        except (TypeError, ValueError) as error:
            kind = "neither True nor False" if read is as_flag else "no number"
            raise UserError(f"{self.env} gives {name} = {value!r}, which is {kind}") from error


@contextlib.contextmanager
def failing(when: str) -> Iterator[None]:
    """Raise TaskFailure for any error of a task's own code, with the error as its cause."""
    try:
        yield
    except MemoryError:  # of the machine
        raise
    except OWN_ERRORS as error:
        why = error if isinstance(error, UserError) else described(error)
        raise TaskFailure(f"failed {when}: {why}") from error


@contextlib.contextmanager
def told_in_close(source: object) -> Iterator[None]:
    """Warn of an error of a task's own code while the task is closed."""
    try:
        yield
    except OWN_ERRORS as error:
        warnings.warn(f"{source} failed while it was closed: {described(error)}", stacklevel=3)


class FailsAlone(gym.Wrapper):
    """Puts a failure into the info instead of raising it, so that the environments beside it go on.

    Until its next reset, a failed environment returns its last observation and info, and zeros for
    all numbers.
    """

    def __init__(self, env: CheckedEnv) -> None:
        super().__init__(env)
        space, self._zeros = env.observation_space, dict.fromkeys(env.numbers, 0.0)
        self._observation, self._info = np.zeros(space.shape or (), space.dtype), {}

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        try:
            self._observation, self._info = self.env.reset(**kwargs)
        except TaskFailure as error:
            self._info = self._info | self._zeros | {FAILURE: error}
        return self._observation, self._info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, unless it has failed."""
        if FAILURE not in self._info:
            try:
                result = self.env.step(action)
                self._observation, self._info = result[0], result[4]
                return result
            except TaskFailure as error:
                self._info = self._info | self._zeros | {FAILURE: error}
        return self._observation, 0.0, False, False, self._info


class Guard(VectorWrapper):
    """Raises TaskFailures that name the task: for environments that raise errors, return arrays of
    a wrong shape, end, or do not answer. A cost that an environment does not give is NaN."""

    def __init__(
        self,
        env: VectorEnv,
        task: str,
        costs: Sequence[str] = ("cost",),
        step_timeout: float | None = None,
        alone: bool = False,
    ) -> None:
        """costs: their names in the infos. step_timeout: seconds that a step or reset of
        environments in separate processes may take; None: any number. alone: leave the failures of
        single environments in the info."""
        super().__init__(env)
        self._task, self._timeout, self._steps, self._alone = task, step_timeout, 0, alone
        self._costs = costs
        self._shape, self._each = env.observation_space.shape, (env.num_envs,)

    def __repr__(self) -> str:
        return f"task {self._task!r}"

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments. Raises TaskFailure."""
        if options is None or "reset_mask" not in options:
            self._steps = 0
        with self._failing("in a reset"):
            if isinstance(self.env, AsyncVectorEnv):
                with silent():
                    self.env.reset_async(seed=seed, options=options)
                    observations, info = self.env.reset_wait(self._timeout)
            else:
                observations, info = self.env.reset(seed=seed, options=options)
            _check_shapes({"observations": (observations, self._shape)})
        return observations, self._named(info)

    def step(self, actions: Any) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Step the environments. Raises TaskFailure."""
        self._steps += 1
        with self._failing(f"in step {self._steps} of an episode"):
            if isinstance(self.env, AsyncVectorEnv):
                with silent():
                    self.env.step_async(actions)
                    results = self.env.step_wait(self._timeout)
            else:
                results = self.env.step(actions)
            observations, rewards, terminated, truncated, info = results
            columns = {"rewards": rewards, "terminated": terminated, "truncated": truncated}
            costs = {name: info[name] for name in self._costs if name in info}
            columns |= {f"info[{name!r}]": cost for name, cost in costs.items()}
            shapes = {name: (values, self._each) for name, values in columns.items()}
            _check_shapes(shapes | {"observations": (observations, self._shape)})
            ends = (_flags("terminated", terminated), _flags("truncated", truncated))
        for name, cost in costs.items():
            if not (gave := np.asarray(info.get(f"_{name}", True), dtype=bool)).all():
                info = info | {name: np.where(gave, cost, np.nan)}  # gymnasium fills in zeros
        return observations, rewards, *ends, self._named(info)

    def _named(self, info: dict[str, Any]) -> dict[str, Any]:
        """Return the info with the task named in failures. Raises the first one unless `alone`."""
        if FAILURE not in info:
            return info
        named = np.full(self.num_envs, None)
        for k, error in enumerate(info[FAILURE]):
            if error is not None:
                named[k] = TaskFailure(f"task {self._task!r} {error}")
                named[k].__cause__ = error.__cause__
                if not self._alone:
                    raise named[k]
        return info | {FAILURE: named}

    def close(self, **kwargs: Any) -> None:
        """Close the environments; end their processes if they do not answer in time."""
        if not isinstance(self.env, AsyncVectorEnv):
            with told_in_close(self):
                self.env.close(**kwargs)
            return
        try:
            if self._timeout is not None:
                close_processes(self.env, self._timeout)
            self.env.close(**kwargs)
        except OWN_ERRORS:  # the processes are gone
            end_processes(self.env)

    @contextlib.contextmanager
    def _failing(self, when: str) -> Iterator[None]:
        try:
            yield
        except OWN_ERRORS as error:
            if isinstance(self.env, AsyncVectorEnv):
                end_processes(self.env)
            why = str(error) if isinstance(error, UserError) else described(error)
            if isinstance(error, (TimeoutError, multiprocessing.TimeoutError)):
                why = f"a process did not answer within step_timeout, {self._timeout:g} s"
            elif isinstance(error, (EOFError, ConnectionError)):
                why = "a process of its environments ended"
            raise TaskFailure(f"task {self._task!r} failed {when}: {why}") from error


class Bounds:
    """Bounds of a task's actions; maps actions of policies, in [-1, 1], to them."""

    def __init__(self, low: NDArray, high: NDArray) -> None:
        """low, high: [action size], of the type of the task's actions."""
        self.low, self.high = low, high
        self._same = bool((low == -1).all() and (high == 1).all())

    def __call__(self, action: NDArray) -> NDArray:
        """Return actions [..., action size] in [-1, 1] as the task takes them: of its type, and
        within its bounds even after rounding."""
        if self._same:
            return action.astype(self.low.dtype, copy=False)
        share = (1.0 + action.astype(np.float64)) / 2.0
        scaled = (self.low * (1.0 - share) + self.high * share).astype(self.low.dtype)
        return np.minimum(np.maximum(scaled, self.low), self.high)


class ScaledActions(VectorActionWrapper):
    """Environments that take actions in [-1, 1] instead of the task's own."""

    def __init__(self, env: VectorEnv) -> None:
        super().__init__(env)
        space: Any = env.single_action_space
        self._bounds = Bounds(space.low, space.high)
        self.single_action_space = Box(-1.0, 1.0, space.shape, np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def __repr__(self) -> str:
        return repr(self.env)

    def actions(self, actions: NDArray) -> NDArray:
        """Return the task's own actions."""
        return self._bounds(actions)


def _flags(name: str, values: Any) -> NDArray[np.bool_]:
    """Return an array of bools. Raises UserError if values are not True, False, 1 or 0."""
    array = np.asarray(values)
    if array.dtype != bool and not np.isin(array, (0, 1)).all():
        raise UserError(f"{name} must be True or False, got {array.tolist()}")
    return array.astype(bool, copy=False)


def _check_shapes(arrays: dict[str, tuple[Any, Any]]) -> None:
    """Raise UserError for an array of a wrong shape; arrays: array and shape by name."""
    for name, (values, shape) in arrays.items():
        if np.shape(values) != shape:
            raise UserError(f"{name} must be {list(shape)}, got {list(np.shape(values))}")


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Keep gymnasium from printing errors of its processes, which it also raises."""
    log: Any = logger
    before, log.min_level = log.min_level, log.ERROR + 1
    try:
        yield
    finally:
        log.min_level = before


def close_processes(envs: AsyncVectorEnv, timeout: float) -> None:
    """Close environments in processes, and end processes that have not ended after so many seconds,
    for which gymnasium would wait for ever."""
    for pipe in envs.parent_pipes:
        if pipe is not None and not pipe.closed:
            pipe.send(("close", None))
    until = time.monotonic() + timeout
    for process in envs.processes:
        process.join(max(0.0, until - time.monotonic()))
    end_processes(envs)


def end_processes(envs: AsyncVectorEnv) -> None:
    """Kill the processes of environments, and wait for their end."""
    for process in envs.processes:
        process.kill()
    for process in envs.processes:
        process.join()
    for pipe in envs.parent_pipes:
        if pipe is not None:
            pipe.close()
    envs.closed = True


def quiet_worker(index: int, make: Any, pipe: Any, parent_pipe: Any, *others: Any) -> None:
    """Run one environment in a process, as gymnasium's worker does, but leave Ctrl-C to the parent,
    end with the parent, and print nothing. If the environment cannot be made here, the parent gets
    an OwnCodeError."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("SIGTERM", "SIGHUP"):  # not the parent's handlers
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
    try:
        try:
            env = make()
        except OWN_ERRORS as error:
            parent_pipe.close()
            pipe.recv()
            _, errors, *_ = others
            errors.put((index, OwnCodeError, _with_words(error), ""))
            pipe.send((None, False))
            return
        _async_worker(index, lambda: env, pipe, parent_pipe, *others)
    except BaseException:
        os._exit(1)  # the parent is gone, or knows from the pipe


def _with_words(error: BaseException) -> OwnCodeError:
    told = OwnCodeError(described(error))
    told.__cause__ = error
    return told


def recorded_info(env: Any) -> dict[str, str]:
    """Return the units, by name, of the info's numbers that a task asks to record at each step: the
    attribute `recorded_info` of its environment, or {}. Raises UserError for anything else."""
    try:
        given = env.get_wrapper_attr("recorded_info")
    except AttributeError:
        given = getattr(env.unwrapped, "recorded_info", {})
    if not isinstance(given, dict) or not all(
        isinstance(x, str) for x in (*given, *given.values())
    ):
        raise UserError(f"recorded_info of {env} must be units by name, got {given!r}")
    return given


class RecordSteps(VectorWrapper):
    """Records each step since the last reset of all environments: the agents' positions by the
    task's view, and numbers of the info."""

    def __init__(self, env: VectorEnv, view: View | None, info: Sequence[str]) -> None:
        super().__init__(env)
        self._view, self._names = view, info
        self._start: NDArray[np.float32] | None = None
        self._positions: list[NDArray[np.float32]] = []
        self._info: list[NDArray[np.float32]] = []

    def __repr__(self) -> str:
        return repr(self.env)

    @property
    def recorded(self) -> dict[str, NDArray[np.float32]]:
        """Arrays by name: "positions", where each step ended, [steps, num_envs, 2], if there is a
        view; "info/NAME", [steps, num_envs]."""
        columns = np.moveaxis(np.array(self._info, dtype=np.float32), 1, 0) if self._names else ()
        recorded = {f"info/{name}": c for name, c in zip(self._names, columns, strict=True)}
        return recorded | ({} if self._view is None else {"positions": np.array(self._positions)})

    @property
    def with_start(self) -> NDArray[np.float32] | None:
        """Where each episode started and each step ended, [steps + 1, num_envs, 2]; None without a
        view."""
        return None if self._start is None else np.array([self._start, *self._positions])

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments, and forget the recorded steps unless only some are reset."""
        every = options is None or "reset_mask" not in options  # gymnasium's remove it
        observation, info = self.env.reset(seed=seed, options=options)
        if every:
            self._positions, self._info = [], []
            self._start = self._located(observation, info) if self._view else None
        return observation, info

    def step(self, actions: Any) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Step the environments. Raises UserError if the info lacks a recorded number, or the view
        gives no valid positions, TaskFailure if the view fails."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        if self._names:
            require_info(self.env, info, self._names)
            values = [np.asarray(info[name], dtype=np.float32) for name in self._names]
            self._info.append(np.stack(values))
        if self._view:
            self._positions.append(self._located(observation, info))
        return observation, reward, terminated, truncated, info

    def _located(self, observation: Any, info: dict[str, Any]) -> NDArray[np.float32]:
        assert self._view is not None
        if FAILURE in info and all(info[FAILURE]):  # the info may be empty
            return np.zeros((self.num_envs, 2), np.float32)
        try:
            given = self._view.positions(np.asarray(observation, dtype=np.float32), info)
        except KeyError as error:
            raise UserError(f"the view of {self.env} needs info[{error}]") from error
        except OWN_ERRORS as error:
            words = f"the view of {self.env} failed: {described(error)}"
            raise TaskFailure(words) from error
        positions = np.array(given, dtype=np.float32)  # a copy: the task may reuse its own
        if positions.shape != (self.num_envs, 2):
            raise UserError(
                f"the view of {self.env} must give positions [{self.num_envs}, 2], "
                f"got {list(positions.shape)}"
            )
        lost = ~np.isfinite(positions).all(axis=1)
        if lost.any():  # if the observation is not finite, only that run fails
            seen = np.isfinite(observation).reshape(self.num_envs, -1).all(axis=1)
            if (lost & seen).any():
                raise UserError(f"the view of {self.env} gives positions that are not finite")
        return positions


class SideBySide(VectorEnv):
    """Vector environments of several tasks as one: one after the other in every array. They do not
    reset themselves, and have equal sizes of observations and of actions. The info of a step holds
    the costs, and failures."""

    def __init__(
        self,
        parts: Sequence[RecordSteps],
        costs: Sequence[str],
        seen: Sequence[VectorEnv] | None = None,
    ) -> None:
        """seen: the parts as policies see them, by default the parts themselves."""
        self.parts, self._costs = parts, costs
        self._seen = parts if seen is None else seen
        ends = np.cumsum([0, *(part.num_envs for part in parts)]).tolist()
        self._own, self.num_envs = [slice(*pair) for pair in pairwise(ends)], ends[-1]
        self.single_observation_space = self._seen[0].single_observation_space
        self.single_action_space = self._seen[0].single_action_space

    def __repr__(self) -> str:
        return " beside ".join(map(str, self.parts))

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, *, seed: Sequence[int] = (), options: dict | None = None
    ) -> tuple[NDArray, dict[str, Any]]:
        """Reset all, each environment with its seed, or those in `options["reset_mask"]`."""
        if options is None:
            pairs = zip(self._seen, self._split(seed), strict=True)
            resets = [part.reset(seed=seeds.tolist()) for part, seeds in pairs]
            observations, infos = zip(*resets, strict=True)
        else:
            infos = ()  # of episodes that are over
            observations = []
            masks = self._split(options["reset_mask"])
            for part, mask, last in zip(self._seen, masks, self._split(self._last), strict=True):
                to_reset = {"reset_mask": mask.copy()}
                waits = part.metadata.get("ended_may_wait") or not mask.any()
                observations.append(last if waits else part.reset(options=to_reset)[0])
        self._last = np.concatenate(observations)
        return self._last, self._failures(infos)

    def step(
        self, actions: NDArray
    ) -> tuple[NDArray, NDArray, NDArray, NDArray, dict[str, NDArray]]:
        """Step all; actions: [N, action size]."""
        results, infos = [], []
        seen = zip(self.parts, self._seen, self._split(actions), strict=True)
        for part, as_seen, own in seen:
            *columns, info = as_seen.step(own)
            require_info(part, info, self._costs)
            results.append((*columns, *(info[name] for name in self._costs)))
            infos.append(info)
        columns = [np.concatenate(column) for column in zip(*results, strict=True)]
        self._last, reward, terminated, truncated, *costs = columns
        info = dict(zip(self._costs, costs, strict=True)) | self._failures(infos)
        return self._last, reward, terminated, truncated, info

    def _failures(self, infos: Sequence[dict[str, Any]]) -> dict[str, NDArray[np.object_]]:
        """Return the failures in the infos of all parts; {} if there are none."""
        if not any(FAILURE in info for info in infos):
            return {}
        pairs = zip(self.parts, infos, strict=True)
        each = [info.get(FAILURE, np.full(part.num_envs, None)) for part, info in pairs]
        return {FAILURE: np.concatenate(each)}

    def close(self, **kwargs: Any) -> None:
        """Close all."""
        for part in self.parts:
            part.close(**kwargs)

    def _split(self, values: Any) -> list[NDArray]:
        return [np.asarray(values)[own] for own in self._own]
