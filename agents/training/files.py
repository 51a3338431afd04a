"""Files of runs, each written whole or not at all, and locks of folders."""

from __future__ import annotations

import contextlib
import errno
import functools
import io
import json
import os
import secrets
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from emcc.npz import UNREADABLE, Npz, is_damage, words_of

AnyPath = Path | zipfile.Path
"""A file or folder on disk, or in an archive."""
UNFINISHED = ".unfinished"
"""Suffix of the name of a file while it is being written."""


@contextlib.contextmanager
def content_of(path: AnyPath) -> Iterator[None]:
    """Raise UserError, naming the file, for content with a wrong form or checksum.

    Errors of the disk or the memory pass unchanged: they say nothing about the file, which may be
    readable the next time.
    """
    why: BaseException
    try:
        yield
        return
    except UserError:
        raise
    except UNREADABLE as error:
        why = error
    except OSError as error:
        if not is_damage(error):
            raise
        why = error
    raise UserError(f"{path} is damaged: {words_of(why)}")


class NoLocks(UserError):
    """The file system has no file locks."""


@contextlib.contextmanager
def locked(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """Keep other processes from training or evaluating in a folder meanwhile.

    A killed process leaves no lock. patience: seconds to wait for another process. Raises UserError
    if it holds the lock longer, NoLocks if the file system has no locks.
    """
    with warnings.catch_warnings():  # filelock warns where the system has no file locks
        warnings.simplefilter("ignore")
        from filelock import FileLock, Timeout
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=patience, poll_interval=0.1)
    except Timeout:
        raise UserError(f"another process is training or evaluating in {folder}") from None
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP):
            raise
        raise NoLocks(
            f"{lock.lock_file} cannot be locked: {error.strerror}. The file system has no locks, "
            "like NFS mounted without them: choose a folder on a local disk, or mount it with locks"
        ) from None
    try:
        yield
    finally:
        lock.release()


@contextlib.contextmanager
def whole(path: Path) -> Iterator[IO[bytes]]:
    """Open a new file that, flushed, replaces `path` on exit; after an error nothing is left of it.
    Raises UserError as `check_file`, OSError with the file's name."""
    check_file(path)
    unfinished = path.with_name(f".{path.name}.{secrets.token_hex(8)}{UNFINISHED}")
    try:
        with unfinished.open("xb") as file:  # x: follows no link
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except OSError as error:
        if error.errno is not None and error.filename is None:  # as for a full disk
            error.filename = str(path)
        raise
    finally:
        unfinished.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file, whole or not at all."""
    with whole(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def remove_unfinished(folder: Path) -> None:
    """Remove unfinished files of killed processes; the folder must be locked."""
    for path in folder.rglob(f".*{UNFINISHED}"):
        path.unlink(missing_ok=True)


def write_json(path: Path, content: Any) -> None:
    """Write JSON, indented; floats round-trip bit for bit."""
    write_whole(path, json.dumps(content, indent=1) + "\n")


def archive_of(path: Path) -> Path | None:
    """Return the file that a path is or leads into; None if there are only folders."""
    return next((part for part in (path, *path.parents) if part.is_file()), None)


def opened(path: Path) -> AnyPath:
    """Return a path for reading: one that leads into an archive becomes a path within it."""
    archive = archive_of(path)
    return zipfile.Path(archive).joinpath(*path.relative_to(archive).parts) if archive else path


def read_json(path: AnyPath) -> dict[str, Any]:
    """Read a JSON object. Raises UserError naming the file if it is missing or damaged."""
    with content_of(path):
        with _there(path):
            data = path.read_bytes()
        content = json.loads(data.decode("utf-8"))
    if not isinstance(content, dict):
        raise UserError(f"{path} is damaged: must be a JSON object, got {type(content).__name__}")
    return content


def write_arrays(
    target: Path | IO[bytes], arrays: Mapping[str, NDArray], compression: int = zipfile.ZIP_STORED
) -> None:
    """Write named arrays as an .npz file, for `numpy.load`; equal arrays give equal bytes."""
    if isinstance(target, Path):
        with whole(target) as file:
            write_arrays(file, arrays, compression)
        return
    with zipfile.ZipFile(target, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # with a fixed date
            member.compress_type = compression
            with archive.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)


@contextlib.contextmanager
def _there(path: AnyPath) -> Iterator[None]:
    """Raise UserError if the file does not exist."""
    try:
        yield
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError, KeyError):
        raise UserError(f"{path} is missing") from None


class _Reopened:
    """A file that is open only inside `with`: a training may have more than a process may open."""

    def __init__(self, path: AnyPath) -> None:
        self._open: Callable[[], IO[bytes]]
        if isinstance(path, Path):
            self._open = lambda: path.open("rb")
        else:  # compressed in an archive
            self._open = functools.partial(io.BytesIO, path.read_bytes())
        with self:
            self.size = self._file.seek(0, os.SEEK_END)

    def __enter__(self) -> None:
        self._file = self._open()

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def read(self, count: int = -1) -> bytes:
        """Read at most the bytes left; a damaged directory may ask for more than memory holds."""
        left = max(0, self.size - self._file.tell())
        return self._file.read(left if count < 0 else min(count, left))

    def __getattr__(self, name: str) -> Any:
        if name == "_file":
            raise AttributeError(name)
        return getattr(self._file, name)


class Arrays(Mapping[str, NDArray]):
    """The arrays of an .npz file by name. Each is read and compared with its checksum on access; in
    between the file is closed. Raises UserError naming the file if it is missing or damaged,
    OSError if it cannot be read."""

    def __init__(self, path: AnyPath) -> None:
        self.path = path
        with content_of(path), _there(path):
            self._source = _Reopened(path)
        with content_of(path), self._source:
            self._npz = Npz(self._source)

    def __getitem__(self, name: str) -> NDArray:
        if name not in self._npz:
            raise KeyError(name)
        with content_of(self.path), self._source:
            return self._npz[name]

    def __contains__(self, name: object) -> bool:
        return name in self._npz

    def __iter__(self) -> Iterator[str]:
        return iter(self._npz)

    def __len__(self) -> int:
        return len(self._npz)


def numbered(folder: AnyPath, name: str) -> dict[int, AnyPath]:
    """Return the numbered files in a subfolder, such as checkpoints/000050000.npz, in order."""
    part = folder / name
    if not part.is_dir():
        return {}
    stems = {path.name.removesuffix(".npz"): path for path in part.iterdir()}
    return {int(stem): stems[stem] for stem in sorted(stems) if stem.isdecimal()}


def numbered_path(folder: Path, name: str, number: int) -> Path:
    """Return the path of the file with a number: see `numbered`."""
    return folder / name / f"{number:09d}.npz"


def check_folder(path: Path) -> None:
    """Raise UserError if a folder cannot be made because a file is in the way."""
    for part in (path, *path.parents):
        if part.exists() and not part.is_dir():
            raise UserError(f"out must be a folder, but {str(part)!r} is a file")


def check_file(path: Path) -> None:
    """Raise UserError for a path that no file may replace: a folder, a device, a pipe."""
    if path.is_dir():
        raise UserError(f"{path} is a folder: give the path of a file")
    if path.exists() and not path.is_file():
        raise UserError(f"{path} is a device or a pipe, which no file may replace: give a new path")
