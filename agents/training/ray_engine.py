"""Trainings as tasks of a Ray cluster. Its nodes need the package, and no files in common.

Each group trains in a folder of its node's own. Whenever it has written a checkpoint, all files
that changed come back to the driver's folder, in the order in which they were written, so that the
driver's folder is at any time one from which the group can go on elsewhere.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.errors import UserError
from agents.training.files import locked
from agents.training.transfer import Message, Sent, files_of, take_in
from agents.training.workers import Group, Workers, cores, start

MOST_LOSSES = 5
"""Nodes that a group may lose one after the other without a checkpoint between them."""
SECONDS_TO_CONNECT, SECONDS_TO_END = 5.0, 20.0


def _ray() -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Of a cluster that is started here: as the local processes, not below all others.
    os.environ.setdefault("RAY_worker_niceness", "0")
    try:
        return importlib.import_module("ray")
    except ModuleNotFoundError:
        raise UserError(
            "the engine ray needs ray, which is not installed: pip install 'circle2d-mj[ray]'"
        ) from None


@contextlib.contextmanager
def connected(address: str | None) -> Iterator[int]:
    """Connect to a cluster, or start one on this machine; yields the number of its cores.

    A connection that the caller has already is used, and left. See `engines.engine` for address.
    """
    ray = _ray()
    if ray.is_initialized():
        if address is not None:
            raise UserError("Ray is connected already: leave address out")
        yield _cpus(ray)
        return
    address = address or os.environ.get("RAY_ADDRESS")
    if address not in (None, "auto", "local"):
        _check_reachable(address)
    own = {"num_cpus": cores(), "include_dashboard": False} if address in (None, "local") else {}
    try:
        ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **own)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise UserError(f"no Ray cluster at {address}: {error}") from None
    try:
        yield _cpus(ray)
    finally:
        ray.shutdown()


def _cpus(ray: Any) -> int:
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def _check_reachable(address: str) -> None:
    """Raise UserError where nothing listens at an address: Ray itself tries for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise UserError(f"address must be HOST:PORT or auto, got {address!r}")
    try:
        socket.create_connection((host, int(port)), SECONDS_TO_CONNECT).close()
    except (OSError, OverflowError) as error:
        raise UserError(f"no Ray cluster answers at {address}: {error}") from None


class RayWorkers(Workers):
    """`Workers` whose groups are tasks of Ray, of one core each.

    A group whose node is lost goes on elsewhere from its last checkpoint. Leaving it as a context
    manager cancels the tasks that still run.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        count: int,
        finished: Callable[[Path], bool],
        imports: Sequence[str] = (),
        gpus: int = 0,
    ) -> None:
        """gpus: for each group."""
        super().__init__(groups, count, finished, imports)
        self._gpus = gpus

    def _start(self, group: Group) -> Any:
        return _Task(group, self._imports, self._gpus)

    def __exit__(self, *exception: object) -> None:
        for task in self._running.values():
            task.terminate()
        until = time.monotonic() + SECONDS_TO_END
        for task in self._running.values():
            task.wait(until - time.monotonic())


class _Task:
    """A group that trains elsewhere; used as a process is. Holds the locks of its folders."""

    def __init__(self, group: Group, imports: Sequence[str], gpus: int) -> None:
        self._ray, self._group, self._imports, self._gpus = _ray(), group, imports, gpus
        self.stdin = io.BytesIO()
        self.returncode: int | None = None
        self._losses = 0
        self._locks = contextlib.ExitStack()
        for folder in group:
            self._locks.enter_context(locked(folder))
        self._submit()

    def _submit(self) -> None:
        task = self._ray.remote(num_cpus=1, num_gpus=self._gpus, max_retries=0)(_train)
        files = [_read(folder, files_of(folder)) for folder in self._group]
        names = [folder.name for folder in self._group]
        self._messages = task.options(num_returns="streaming").remote(names, files, self._imports)

    def poll(self) -> int | None:
        """Take in what has come; the exit status, None while the group trains."""
        errors = self._ray.exceptions
        while self.returncode is None:
            ready, _ = self._ray.wait([self._messages], timeout=0)
            if not ready:
                return None
            try:
                self._take_in(self._ray.get(next(self._messages)))
            except (StopIteration, errors.RayTaskError) as error:
                self._end(1, str(error).strip().splitlines()[-1:])
            except errors.RayError as error:  # the node is lost, or what it had sent
                self._losses += 1
                if self._losses > MOST_LOSSES:
                    self._end(1, [f"lost {self._losses} nodes: {type(error).__name__}"])
                else:
                    self._submit()
        return self.returncode

    def _take_in(self, message: Message) -> None:
        take_in(self._group, message)
        if message.names is not None:
            self._losses = 0
        if message.status is not None:
            self._end(message.status)

    def _end(self, status: int, words: Sequence[str] = ()) -> None:
        self.returncode = status
        self._locks.close()
        if words:
            with (self._group[0] / "worker.log").open("a") as log:
                log.write("".join(f"{word}\n" for word in words))

    def terminate(self) -> None:
        """Cancel the task, whose process then ends."""
        with contextlib.suppress(Exception):  # the cluster may be gone
            self._ray.cancel(self._messages)

    def wait(self, timeout: float) -> None:
        """Wait so many seconds at most for the end of a cancelled task."""
        with contextlib.suppress(Exception):
            self._ray.wait([self._messages.completed()], timeout=max(0.0, timeout))
        self._locks.close()


def _train(
    names: Sequence[str], files: Sequence[Mapping[str, bytes]], imports: Sequence[str]
) -> Iterator[Message]:
    """Train a group on a node, in folders of its own that begin with some files."""
    with tempfile.TemporaryDirectory(prefix="circle2d-") as root:
        group = tuple(Path(root) / str(k) / name for k, name in enumerate(names))
        for folder, of_folder in zip(group, files, strict=True):
            for name, content in of_folder.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
        sent = Sent(group)
        process = start(group, imports)
        try:
            while True:
                status = process.poll()
                message = sent.changes(status)
                if message is not None:
                    yield message
                if status is not None:
                    return
                time.sleep(1.0)
        finally:
            if process.poll() is None:
                process.kill()  # its folder goes
                process.wait()


def _read(folder: Path, names: Sequence[str]) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in names}
