"""Environments of other people's code: their errors become one that names task and step."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Iterator
from typing import Any

import numpy as np
from gymnasium import logger
from gymnasium.vector import AsyncVectorEnv, VectorEnv, VectorWrapper
from gymnasium.vector.async_vector_env import _async_worker
from numpy.typing import NDArray

from agents.errors import TaskFailure, UserError


class Guard(VectorWrapper):
    """Raises TaskFailure, naming task and step, where the environments raise anything, give arrays
    of other shapes than their spaces, end or do not answer."""

    def __init__(self, env: VectorEnv, task: str, step_timeout: float | None = None) -> None:
        """step_timeout: seconds that a step or reset of environments in processes of their own may
        take; None: any."""
        super().__init__(env)
        self._task, self._timeout, self._steps = task, step_timeout, 0
        self._shape, self._each = env.observation_space.shape, (env.num_envs,)

    def __repr__(self) -> str:
        return f"task {self._task!r}"

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """As the environments'."""
        if options is None or "reset_mask" not in options:
            self._steps = 0
        try:
            if isinstance(self.env, AsyncVectorEnv):
                with _silent():
                    self.env.reset_async(seed=seed, options=options)
                    observations, info = self.env.reset_wait(self._timeout)
            else:
                observations, info = self.env.reset(seed=seed, options=options)
            if np.shape(observations) != self._shape:
                raise ValueError(_wrong("observations", observations, self._shape))
        except Exception as error:  # of the task's own code
            raise self._failure(error, "in a reset") from None
        return observations, info

    def step(self, actions: Any) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        """As the environments'."""
        self._steps += 1
        try:
            if isinstance(self.env, AsyncVectorEnv):
                with _silent():
                    self.env.step_async(actions)
                    found = self.env.step_wait(self._timeout)
            else:
                found = self.env.step(actions)
            self._check(*found)
        except Exception as error:  # of the task's own code
            raise self._failure(error, f"in step {self._steps} of an episode") from None
        return found

    def close(self, **kwargs: Any) -> None:
        """Close the environments; end their processes where they do not answer."""
        try:
            self.env.close(**kwargs)
        except Exception:  # of processes that are gone, or of the task's own code
            if isinstance(self.env, AsyncVectorEnv):
                end_processes(self.env)

    def _check(
        self, observations: Any, rewards: Any, terminated: Any, truncated: Any, info: dict[str, Any]
    ) -> None:
        """Raise ValueError for an array of another shape."""
        columns = {"rewards": rewards, "terminated": terminated, "truncated": truncated}
        if "cost" in info:
            columns["info['cost']"] = info["cost"]
        for name, values in columns.items():
            if np.shape(values) != self._each:
                raise ValueError(_wrong(name, values, self._each))
        if np.shape(observations) != self._shape:
            raise ValueError(_wrong("observations", observations, self._shape))

    def _failure(self, error: Exception, when: str) -> TaskFailure:
        """The failure for an error; processes of the environments are ended."""
        why = f"{type(error).__name__}: {error}".removesuffix(": ")
        if isinstance(error, UserError):
            why = str(error)
        elif isinstance(error, (TimeoutError, multiprocessing.TimeoutError)):
            why = f"a process did not answer within step_timeout, {self._timeout:g} s"
        elif isinstance(error, (EOFError, ConnectionError)):
            why = "a process of its environments ended"
        if isinstance(self.env, AsyncVectorEnv):
            end_processes(self.env)
        return TaskFailure(f"task {self._task!r} failed {when}: {why}")


def _wrong(name: str, values: Any, shape: Any) -> str:
    return f"{name} must be {list(shape)}, got {list(np.shape(values))}"


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep gymnasium from printing the errors of its processes, which it raises as well."""
    log: Any = logger
    before, log.min_level = log.min_level, log.ERROR + 1
    try:
        yield
    finally:
        log.min_level = before


def end_processes(envs: AsyncVectorEnv) -> None:
    """End the processes of environments, whatever they do, and wait for their end."""
    for process in envs.processes:
        process.kill()
    for process in envs.processes:
        process.join()
    for pipe in envs.parent_pipes:
        if pipe is not None:
            pipe.close()
    envs.closed = True


def quiet_worker(*args: Any) -> None:
    """gymnasium's process of one environment, which leaves Ctrl-C to its parent, ends by itself
    with it, and prints nothing of either."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("SIGTERM", "SIGHUP"):  # the parent's handlers are not the child's
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
    try:
        _async_worker(*args)  # pyright: ignore[reportCallIssue]
    except BaseException:
        os._exit(1)  # the parent is gone, or knows from the pipe
