"""Trainings in processes of their own, as many at a time as there are cores."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

LOG = "worker.log"
"""In the folder of the runs, the first of a group: output of the process that trained them."""
Group = tuple[Path, ...]
"""Folders that train together."""


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers:
    """Trains groups of folders, in order, `count` groups at a time.

    Each is a process of one thread, in which the runs of a group's folders train together, from
    their last checkpoints if they have any. Of a group that fails every folder that is not
    `finished` is tried alone, last; one that fails does not stop the others. Used as a context
    manager: leaving it ends the processes that still run, which lose what they did since their last
    checkpoints.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        count: int,
        finished: Callable[[Path], bool],
        imports: Sequence[str] = (),
    ) -> None:
        """imports: modules that each process imports first."""
        self._waiting, self._count, self._finished = list(groups), count, finished
        self._imports = imports
        self._running: dict[Group, subprocess.Popen] = {}
        self.over: list[Path] = []
        """Folders whose process has ended, those that failed among them."""
        self.failed: dict[Path, str] = {}
        """Those that failed, and the last line that their process printed."""

    @property
    def running(self) -> list[Group]:
        """Groups that are trained now."""
        return list(self._running)

    def run(self, on_change: Callable[[], None], every: float = 1.0) -> None:
        """Train all; `on_change` is called every so many seconds, and at the end."""
        while self._waiting or self._running:
            while self._waiting and len(self._running) < self._count:
                group = self._waiting.pop(0)
                self._running[group] = self._start(group)
            on_change()
            time.sleep(every)
            for group, process in list(self._running.items()):
                if process.poll() is not None:
                    del self._running[group]
                    self._ended(group, process.returncode)
        on_change()

    def _start(self, group: Group) -> subprocess.Popen:
        return start(group, self._imports)

    def _ended(self, group: Group, status: int) -> None:
        left = []
        if status and len(group) > 1:  # it may be one folder's fault: each goes on alone
            left = [folder for folder in group if not self._finished(folder)]
        self._waiting += [(folder,) for folder in left]
        over = [folder for folder in group if folder not in left]
        self.over.extend(over)
        if status:
            self.failed |= dict.fromkeys(over, _last_words(group))

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *exception: object) -> None:
        for process in self._running.values():
            process.send_signal(signal.SIGTERM)
        for process in self._running.values():
            process.wait()


def start(group: Group, imports: Sequence[str]) -> subprocess.Popen:
    """Start a process of one thread that trains a group. imports: modules it imports first."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    options = [option for name in imports for option in ("--import", name)]
    with (group[0] / LOG).open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "agents.cli", "resume", *map(str, group), *options],
            stdout=log,
            stderr=log,
            stdin=subprocess.DEVNULL,
            env=os.environ | threads,
            start_new_session=True,  # Ctrl-C reaches us alone; we end them
        )


def _last_words(group: Group) -> str:
    try:
        lines = (group[0] / LOG).read_text(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return lines[-1] if lines else "it printed nothing"
