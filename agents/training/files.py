"""Files of runs: each is written once, whole or not at all, and the lock of a folder."""

from __future__ import annotations

import contextlib
import io
import json
import lzma
import os
import secrets
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError

AnyPath = Path | zipfile.Path
"""A file or folder on disk, or in an archive."""
UNFINISHED = ".unfinished"
"""Ends the name of a file that is being written."""
UNREADABLE = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, Warning),
    *(zipfile.BadZipFile, lzma.LZMAError, zlib.error, struct.error, NotImplementedError),
    SyntaxError,
)
"""Errors that damaged files have zipfile, json and numpy raise."""


@contextlib.contextmanager
def locked(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """Keep other processes from training and evaluating in a folder meanwhile.

    A process that is killed holds nothing. patience: seconds to wait for a lock that another
    process holds. Raises UserError where it still holds it then.
    """
    with warnings.catch_warnings():  # where the system has no file locks: filelock makes do
        warnings.simplefilter("ignore")
        from filelock import FileLock, Timeout
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=patience, poll_interval=0.1)
    except Timeout:
        raise UserError(f"another process is training or evaluating in {folder}") from None
    try:
        yield
    finally:
        lock.release()


@contextlib.contextmanager
def whole(path: Path) -> Iterator[IO[bytes]]:
    """A new file that takes the place of `path` at the end, flushed; nothing is left of it where
    that is not reached."""
    unfinished = path.with_name(f".{path.name}.{secrets.token_hex(8)}{UNFINISHED}")
    try:
        with unfinished.open("xb") as file:  # x: follows no link
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file, whole or not at all."""
    with whole(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def remove_unfinished(folder: Path) -> None:
    """Remove what killed processes left of files that they were writing; while it is locked."""
    for path in folder.rglob(f".*{UNFINISHED}"):
        path.unlink(missing_ok=True)


def write_json(path: Path, content: Any) -> None:
    """Write JSON, indented; floats round-trip bit for bit."""
    write_whole(path, json.dumps(content, indent=1) + "\n")


def archive_of(path: Path) -> Path | None:
    """The file that a path is or leads into; None for a path of folders alone."""
    return next((part for part in (path, *path.parents) if part.is_file()), None)


def opened(path: Path) -> AnyPath:
    """A folder as its files are read: of a path that leads into an archive, the folder there."""
    archive = archive_of(path)
    return zipfile.Path(archive).joinpath(*path.relative_to(archive).parts) if archive else path


def read_json(path: AnyPath) -> dict[str, Any]:
    """Read a JSON object. Raises UserError naming the file where it is missing or damaged."""
    if not path.is_file():
        raise UserError(f"{path} is missing")
    try:
        content = json.loads(path.read_bytes().decode("utf-8"))
    except (*UNREADABLE, RecursionError) as error:
        raise UserError(f"{path} is damaged: {error}") from None
    if not isinstance(content, dict):
        raise UserError(f"{path} is damaged: must be a JSON object, got {type(content).__name__}")
    return content


def write_arrays(
    target: Path | IO[bytes], arrays: Mapping[str, NDArray], compression: int = zipfile.ZIP_STORED
) -> None:
    """Write named arrays as an .npz file, which `numpy.load` reads; equal ones give equal bytes."""
    if isinstance(target, Path):
        with whole(target) as file:
            write_arrays(file, arrays, compression)
        return
    with zipfile.ZipFile(target, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # of a fixed date
            member.compress_type = compression
            with archive.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)


class Arrays(Mapping[str, NDArray]):
    """The arrays of an .npz file by name, each read, and compared with its checksum, when it is
    asked for. Raises UserError naming the file where it is missing or damaged."""

    def __init__(self, path: AnyPath) -> None:
        self.path = path
        if not path.is_file():
            raise UserError(f"{path} is missing")
        try:
            # One in an archive is read as a whole: it is compressed there.
            source = path if isinstance(path, Path) else io.BytesIO(path.read_bytes())
            self._file = zipfile.ZipFile(source)
            for member in self._file.infolist():
                self._file.open(member).close()  # an array whose name is damaged would be missing
                if b"PK\1\2" in member.comment + member.extra:  # so would be what that holds
                    raise zipfile.BadZipFile("its directory is damaged")
        except UNREADABLE as error:
            raise self._damaged(error) from None
        self._names = {name.removesuffix(".npy"): name for name in self._file.namelist()}

    def __getitem__(self, name: str) -> NDArray:
        if name not in self._names:
            raise KeyError(name)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # of a damaged header too
                with self._file.open(self._names[name]) as file:
                    array = np.lib.format.read_array(file, allow_pickle=False)
                    file.read()  # to its end, where its checksum is compared
                    return array
        except UNREADABLE as error:
            raise self._damaged(error) from None

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def _damaged(self, error: BaseException) -> UserError:
        return UserError(f"{self.path} is damaged: {str(error) or type(error).__name__}")


def numbered(folder: AnyPath, name: str) -> dict[int, AnyPath]:
    """The files of a folder's part, such as checkpoints/000050000.npz, by number, in order."""
    part = folder / name
    if not part.is_dir():
        return {}
    stems = {path.name.removesuffix(".npz"): path for path in part.iterdir()}
    return {int(stem): stems[stem] for stem in sorted(stems) if stem.isdecimal()}


def numbered_path(folder: Path, name: str, number: int) -> Path:
    """The file of a number: see `numbered`."""
    return folder / name / f"{number:09d}.npz"


def check_folder(path: Path) -> None:
    """Raise UserError for a folder that cannot be made, since a file is in its way."""
    for part in (path, *path.parents):
        if part.is_file():
            raise UserError(f"out must be a folder, but {str(part)!r} is a file")
