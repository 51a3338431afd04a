"""Trainings in processes of their own, as many at a time as there are cores."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from agents.errors import UserError
from agents.training.files import locked

MOST_WORKERS = 1024
PATIENCE = 20.0
"""Seconds to wait for a process that still holds a folder: that of a parent which was killed writes
a last checkpoint."""
PROGRAM = """
import sys
from agents.training.workers import end_with_parent
end_with_parent()
from agents.cli.main import main
sys.exit(main())
"""
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
    manager: leaving it ends the processes that still run, which write a last checkpoint. They end
    likewise with this process, however that ends.
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
        self._logged: dict[Group, int] = {}
        """Length of the log of each group before its process began."""
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
                self._begin(self._waiting.pop(0))
            on_change()
            time.sleep(every)
            for group, process in list(self._running.items()):
                if process.poll() is not None:
                    _close(self._running.pop(group))
                    self._ended(group, process.returncode)
        on_change()

    def _begin(self, group: Group) -> None:
        """Start the process of a group, where no other process holds one of its folders."""
        log = group[0] / LOG
        self._logged[group] = log.stat().st_size if log.exists() else 0
        try:
            for folder in group:
                with locked(folder, PATIENCE):
                    pass
        except UserError as error:
            self.over.extend(group)
            self.failed |= dict.fromkeys(group, str(error))
        else:
            self._running[group] = self._start(group)

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
            self.failed |= dict.fromkeys(over, _last_words(group, self._logged[group]))

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *exception: object) -> None:
        for process in self._running.values():
            process.terminate()
        until = time.monotonic() + PATIENCE
        for process in self._running.values():
            try:
                process.wait(max(0.0, until - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            _close(process)


def end_with_parent() -> None:
    """End this process when its standard input ends, a pipe that only the parent can write to.

    It ends as at SIGTERM, with a checkpoint, or at once where that takes too long.
    """

    def watch() -> None:
        while os.read(0, 1):
            pass
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(PATIENCE / 2)
        os._exit(128 + signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def start(group: Group, imports: Sequence[str]) -> subprocess.Popen:
    """Start a process of one thread that trains a group, and ends with this one. imports: modules
    it imports first."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    options = [option for name in imports for option in ("--import", name)]
    with (group[0] / LOG).open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-c", PROGRAM, "resume", *map(str, group), *options],
            stdout=log,
            stderr=log,
            stdin=subprocess.PIPE,
            env=os.environ | threads,
            start_new_session=True,  # Ctrl-C reaches us alone; we end them
        )


def _close(process: subprocess.Popen) -> None:
    assert process.stdin is not None
    process.stdin.close()


def _last_words(group: Group, since: int) -> str:
    """The last line of a group's process, its error if there is one, in the log from a byte on."""
    try:
        text = (group[0] / LOG).read_bytes()[since:].decode(errors="replace")
    except OSError:
        text = ""
    lines = text.strip().splitlines()
    own = [line for line in lines if line.startswith("circle2d: ")]
    return (own or lines or ["it printed nothing"])[-1]
