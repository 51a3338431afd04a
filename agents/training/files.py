"""Files of runs: JSON, arrays, and the lock of a folder. `checksums` writes them whole."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import io
import json
import os
import secrets
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.training.checksums import check_digest, digest, write_whole

__all__ = (
    "check_folder",
    "compare",
    "json_bytes",
    "locked",
    "npz_bytes",
    "read_arrays",
    "read_json",
    "remove_leftovers",
    "unfinished",
    "write_arrays",
    "write_json",
    "write_whole",
)


@contextlib.contextmanager
def locked(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """Keep other processes from training and evaluating in a folder meanwhile.

    A process that is killed holds nothing. patience: seconds to wait for a lock that another
    process holds. Raises UserError where it still holds it then.
    """
    with warnings.catch_warnings():  # where the system has no file locks: filelock makes do
        warnings.simplefilter("ignore")
        from filelock import FileLock, Timeout
    lock, until = FileLock(folder / ".lock"), time.monotonic() + patience
    while not lock.is_locked:
        try:
            lock.acquire(blocking=False)
        except Timeout:
            if time.monotonic() >= until:
                raise UserError(f"another process is training or evaluating in {folder}") from None
            time.sleep(0.1)
    try:
        yield
    finally:
        lock.release()


def remove_leftovers(folder: Path) -> None:
    """Remove what killed processes left of files that they were writing, in folders of runs too.

    Only while the folder is locked.
    """
    for path in folder.rglob(".*.unfinished"):
        path.unlink(missing_ok=True)


def json_bytes(content: Any) -> bytes:
    """JSON, indented; floats round-trip bit for bit."""
    return (json.dumps(content, indent=1) + "\n").encode()


def write_json(path: Path, content: Any) -> None:
    """Write JSON: see `json_bytes`."""
    write_whole(path, json_bytes(content))


def read_json(path: Path, checked: bool = False) -> dict[str, Any]:
    """Read a JSON object.

    checked: compare the file with its checksum, where there is one. Raises UserError naming the
    file where it is missing or damaged.
    """
    try:
        data = path.read_bytes()
        content = json.loads(data.decode("utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path} is missing: not a run folder, or a damaged one") from None
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path} is damaged: {error}") from None
    if not isinstance(content, dict):
        raise UserError(f"{path} is damaged: must be a JSON object, got {type(content).__name__}")
    if checked:
        compare(path, data)
    return content


def check_folder(path: Path) -> None:
    """Raise UserError for a folder that cannot be made, since a file is in its way."""
    for part in (path, *path.parents):
        if part.is_file():
            raise UserError(f"out must be a folder, but {str(part)!r} is a file")


def compare(path: Path, data: bytes) -> str:
    """The checksum of a file's content. Raises UserError where another one is known."""
    found = digest(data)
    try:
        check_digest(path, found)
    except ValueError as error:
        raise UserError(str(error)) from None
    return found


def npz_bytes(arrays: Mapping[str, NDArray]) -> bytes:
    """Named arrays as the content of an .npz file."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def write_arrays(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """Write named arrays (.npz)."""
    write_whole(path, npz_bytes(arrays))


def read_arrays(
    path: Path, wanted: Callable[[str], bool] = lambda name: True
) -> dict[str, NDArray]:
    """Read those named arrays whose name is `wanted`, all by default; nothing is unpickled.

    Each array's own checksum (CRC-32) is looked at. Raises UserError where the file is missing or
    damaged. MemoryError and OSError are let out where the file's checksum shows that it is whole:
    a smaller load on the machine may read it.
    """
    try:
        with path.open("rb") as file:  # numpy leaves a damaged file open
            return _arrays_in(file, wanted)
    except FileNotFoundError:
        raise UserError(f"{path} is missing: nothing has been trained there yet") from None
    except Exception as error:  # a damaged file has numpy and zipfile raise errors of any kind
        if isinstance(error, (MemoryError, OSError)) and _is_whole(path):
            raise
        raise UserError(f"{path} is damaged: {error or type(error).__name__}") from None


def _is_whole(path: Path) -> bool:
    """Whether a file's checksum is known and matches. It need not fit into memory."""
    try:
        with path.open("rb") as file:
            return check_digest(path, hashlib.file_digest(file, "sha256").hexdigest())
    except (OSError, ValueError):
        return False


def _arrays_in(file: Any, wanted: Callable[[str], bool]) -> dict[str, NDArray]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of a damaged header too
        arrays: Any = np.load(file, allow_pickle=False)
        if isinstance(arrays, np.ndarray):
            raise ValueError("it holds one array, not several by name")
        return {name: arrays[name] for name in arrays.files if wanted(name)}


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """A new path beside a file, of the same suffix, for a library that writes it in pieces.

    What it wrote is moved into place at the end, or removed where that raises.
    """
    for left in path.parent.glob(f".*.{glob.escape(path.stem)}.unfinished{path.suffix}"):
        with contextlib.suppress(OSError):
            left.unlink()
    temporary = path.with_name(f".{secrets.token_hex(8)}.{path.stem}.unfinished{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
