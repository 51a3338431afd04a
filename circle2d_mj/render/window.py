"""MuJoCo's viewer, for render_mode "human"."""

# mujoco has no stubs for what is compiled.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import threading
import time
from typing import Any

import mujoco
import mujoco.viewer


class Window:
    """Shows states of a model in real time; opened when it is made.

    step_time: seconds that a step of the task takes.
    """

    def __init__(self, model: Any, step_time: float) -> None:
        self._model, self._step_time = model, step_time
        self._data = mujoco.MjData(model)
        before = set(threading.enumerate())
        self._viewer = mujoco.viewer.launch_passive(model, self._data)
        self._threads = set(threading.enumerate()) - before
        self._shown = time.monotonic()

    def show(self, data: Any) -> None:
        """Show a state with its derived quantities; returns when the step's time is over."""
        with self._viewer.lock():
            mujoco.mj_copyData(self._data, self._model, data)
        self._viewer.sync()
        time.sleep(max(self._shown + self._step_time - time.monotonic(), 0.0))
        self._shown = time.monotonic()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()
        for thread in self._threads:
            thread.join(timeout=5.0)  # a program that ends before the thread does crashes
