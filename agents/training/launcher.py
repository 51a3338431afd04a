"""Trainings of several folders at a time, on one core each: in processes of this machine, or as
tasks of a Ray cluster."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Annotated, Any, Literal

from agents.checks import In, check
from agents.errors import UserError, extra
from agents.training.config import CHECKPOINTS, RESULTS, STATUS, STEPS, finished
from agents.training.files import UNFINISHED, locked, write_whole

EngineName = Literal["local", "ray"]
MOST_WORKERS = 1024
PATIENCE = 20.0
"""Seconds to wait for a process to write a last checkpoint."""
MOST_LOSSES = 5
"""Nodes that a training may lose one after the other without a checkpoint in between."""
SECONDS_TO_CONNECT = 5.0
LOG = "worker.log"
"""File with the output of the process that trained a folder."""
PROGRAM = """
import sys
from agents.training.launcher import end_with_parent
end_with_parent()
from agents.cli.main import main
sys.exit(main())
"""


class Launcher:
    """Trains folders to their end, `count` at a time, from their newest checkpoints.

    It is a context manager: on exit, trainings that still run write a last checkpoint and end. They
    end in the same way when this process ends, however that happens. A training that fails does not
    stop the others.
    """

    def __init__(self, count: int, train: Callable[[Path, threading.Event], str]) -> None:
        """train: (folder, event that asks the training to end) -> why it failed, or ""."""
        self.count = count
        self._train, self._ending = train, threading.Event()
        self._threads = ThreadPoolExecutor(count)
        self.jobs: dict[Path, Future[str]] = {}
        """The trainings by folder; their results say why they failed, or are ""."""

    def submit(self, folder: Path) -> Future[str]:
        """Have a folder trained when its turn comes."""
        self.jobs[folder] = self._threads.submit(self._run, folder)
        return self.jobs[folder]

    def _run(self, folder: Path) -> str:
        if self._ending.is_set():
            return "not started"
        try:
            return self._train(folder, self._ending)
        except (UserError, OSError) as error:  # of this folder, or no further process
            return str(error)

    @property
    def running(self) -> list[Path]:
        """Folders that are being trained."""
        return [folder for folder, job in self.jobs.items() if job.running()]

    @property
    def failed(self) -> dict[Path, str]:
        """Trainings that have ended with a failure, and why."""
        over = {folder: job.result() for folder, job in self.jobs.items() if job.done()}
        return {folder: why for folder, why in over.items() if why}

    def wait(self, on_change: Callable[[], None] = lambda: None, every: float = 1.0) -> None:
        """Wait for all trainings; call `on_change` every so many seconds, and at the end."""
        while wait(self.jobs.values(), timeout=every).not_done:
            on_change()
        on_change()

    def __enter__(self) -> Launcher:
        return self

    def __exit__(self, *exception: object) -> None:
        self._ending.set()
        self._threads.shutdown(cancel_futures=True)


@contextlib.contextmanager
def launcher(
    engine: EngineName = "local",
    count: int | None = None,
    imports: Sequence[str] = (),
    address: str | None = None,
) -> Iterator[Launcher]:
    """Yield a launcher for an engine; it is shut down at the end of the `with` block.

    count: trainings at a time, by default as many as there are cores. imports: modules that each
    process imports first. address: that of the Ray cluster's head, such as 10.0.0.1:6379, or auto
    for a cluster on this machine; None starts one here, unless RAY_ADDRESS names one. Raises
    UserError for an unknown engine, a missing library, and a cluster that does not answer.
    """
    check("workers", count, Annotated[int | None, In(1, MOST_WORKERS)])
    if engine not in ("local", "ray"):
        raise UserError(f"engine must be local or ray, got {engine!r}")
    if engine == "local" and address is not None:
        raise UserError("address is of a Ray cluster: it needs the engine ray")
    with contextlib.ExitStack() as stack:
        most, train = cores(), functools.partial(_train_here, imports=imports)
        if engine == "ray":
            ray, most = stack.enter_context(_connected(address))
            train = functools.partial(_train_on_ray, ray, imports=imports)
        yield stack.enter_context(Launcher(count or most, train))


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _train_here(folder: Path, ending: threading.Event, imports: Sequence[str]) -> str:
    """Train a folder in a process of its own; return why it failed, or ""."""
    log = folder / LOG
    since = log.stat().st_size if log.exists() else 0
    with locked(folder, PATIENCE):  # the process of a killed parent may still be ending
        pass
    process = start(folder, imports)
    try:
        while process.poll() is None and not ending.is_set():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.2)
    finally:
        _end(process)
    return _why(folder, process.returncode, since)


def start(folder: Path, imports: Sequence[str]) -> subprocess.Popen:
    """Start a process with one thread that trains a folder, and ends with this process."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    options = [option for name in imports for option in ("--import", name)]
    with (folder / LOG).open("ab") as log:
        return subprocess.Popen(
            # -P: otherwise Python would look for every module in the current folder first.
            [sys.executable, "-P", "-c", PROGRAM, "resume", str(folder), *options],
            stdout=log,
            stderr=log,
            stdin=subprocess.PIPE,
            env=os.environ | threads,
            start_new_session=True,  # Ctrl-C reaches us alone; we end them
        )


def _end(process: subprocess.Popen) -> None:
    """End a training process, with a checkpoint if writing one does not take too long."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    assert process.stdin is not None
    process.stdin.close()


def end_with_parent() -> None:
    """End this process when its standard input, a pipe held only by the parent, ends.

    It ends as at SIGTERM, with a checkpoint, or at once if that takes too long.
    """

    def watch() -> None:
        while os.read(0, 1):
            pass
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(PATIENCE / 2)
        os._exit(128 + signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def _why(folder: Path, status: int, since: int = 0) -> str:
    """Return why a training failed whose process ended with a status, or "". since: byte at which
    its part of the log begins."""
    words = _last_words(folder / LOG, since)
    if status == 0 and not finished(folder):
        return f"its process ended before the training did: {words}"
    return words if status else ""


def _last_words(log: Path, since: int) -> str:
    """Return the last line, or the last error, that a process wrote to its log from a byte on."""
    try:
        lines = log.read_bytes()[since:].decode(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    own = [line.removeprefix("circle2d: ") for line in lines if line.startswith("circle2d: ")]
    return (own or lines or ["its process printed nothing"])[-1]


@contextlib.contextmanager
def _connected(address: str | None) -> Iterator[tuple[Any, int]]:
    """Connect to a cluster, or start one on this machine; yields Ray and its number of cores.

    An existing connection of the caller is used, and stays open.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # For a cluster started here: the priority of local processes, not the lowest of all.
    os.environ.setdefault("RAY_worker_niceness", "0")
    ray = extra("ray", "ray")
    if ray.is_initialized():
        if address is not None:
            raise UserError("Ray is connected already: leave address out")
        yield ray, _cpus(ray)
        return
    address = address or os.environ.get("RAY_ADDRESS")
    if address not in (None, "auto", "local"):
        _check_reachable(address)
    own = {"num_cpus": cores(), "include_dashboard": False} if address in (None, "local") else {}
    try:
        ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **own)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise UserError(f"no Ray cluster at {address}: {error}") from error
    try:
        yield ray, _cpus(ray)
    finally:
        ray.shutdown()


def _cpus(ray: Any) -> int:
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def _check_reachable(address: str) -> None:
    """Raise UserError if nothing listens at an address: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise UserError(f"address must be HOST:PORT or auto, got {address!r}")
    try:
        socket.create_connection((host, int(port)), SECONDS_TO_CONNECT).close()
    except (OSError, OverflowError) as error:
        raise UserError(f"no Ray cluster answers at {address}: {error}") from error


Files = Mapping[str, bytes]


def _train_on_ray(ray: Any, folder: Path, ending: threading.Event, imports: Sequence[str]) -> str:
    """Train a folder as a Ray task; return why it failed, or "".

    Nodes need the package, but no shared files. The task trains in a folder of its node and sends
    the files that this side lacks, so that at any time the training can continue on another node
    from the folder here, as it does when a node is lost.
    """
    losses = 0
    with locked(folder, PATIENCE):
        task = ray.remote(num_cpus=1, max_retries=0)(_train_there)
        while True:
            files = {name: (folder / name).read_bytes() for name in _names(folder)}
            messages = task.options(num_returns="streaming").remote(folder.name, files, imports)
            try:
                while not ending.is_set():
                    ready, _ = ray.wait([messages], timeout=0.5)
                    if ready:
                        sent, names, status = ray.get(next(messages))
                        take_in(folder, sent, names)
                        losses = 0 if any(n.startswith(CHECKPOINTS) for n in sent) else losses
                        if status is not None:
                            return _why(folder, status)
                ray.cancel(messages)
                return "interrupted"
            except StopIteration:
                return "its Ray task ended without a status"
            except ray.exceptions.RayTaskError as error:
                return str(error).strip().splitlines()[-1]
            except ray.exceptions.RayError as error:  # the node, or what it had sent, is lost
                losses += 1
                if losses > MOST_LOSSES:
                    return f"lost {losses} nodes: {type(error).__name__}"


def _train_there(
    name: str, files: Files, imports: Sequence[str]
) -> Iterator[tuple[Files, list[str], int | None]]:
    """Train on a node, in a temporary folder that starts with some files.

    Yields the files that are new there, the names of all files, and at the end the exit status.
    """
    with tempfile.TemporaryDirectory(prefix="circle2d-") as root:
        folder = Path(root) / name
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        known, process = set(files) - {STATUS}, start(folder, imports)
        try:
            status = None
            while status is None:
                status = process.poll()
                new, names = new_files(folder, known, last=status is not None)
                if new or status is not None:
                    yield new, names, status
                time.sleep(1.0)
        finally:
            _end(process)


def new_files(folder: Path, known: set[str], last: bool) -> tuple[Files, list[str]]:
    """Return the files that the other side lacks, and the names of all files; add the former to
    `known`. Files never change, except the status, sent with others, and the log, sent last."""
    names = _names(folder)
    new = [name for name in names if name not in known and name not in (STATUS, LOG)]
    changing = [STATUS] * bool(new or last) + [LOG] * last
    sent = {}
    for name in (*new, *(name for name in changing if name in names)):
        with contextlib.suppress(FileNotFoundError):  # an old checkpoint, removed meanwhile
            sent[name] = (folder / name).read_bytes()
    known.update(new)
    return sent, names


def take_in(folder: Path, files: Files, names: Sequence[str]) -> None:
    """Write files in an order that a kill may interrupt anywhere, and remove checkpoints that the
    other side has removed."""
    order = (STEPS, CHECKPOINTS, RESULTS)  # all else first
    ranks = {n: next((k for k, o in enumerate(order) if n.startswith(o)), -1) for n in files}
    for name in sorted(files, key=lambda name: (ranks[name], name)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / name, files[name])
    for name in _names(folder):
        if name.startswith(CHECKPOINTS) and name not in names:
            (folder / name).unlink()


def _names(folder: Path) -> list[str]:
    """Return the paths of the files in a folder, without locks and unfinished files."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    kept = (path for path in paths if path.name != ".lock" and not path.name.endswith(UNFINISHED))
    return [path.relative_to(folder).as_posix() for path in kept]
