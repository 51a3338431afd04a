"""Files that are whole or missing, and the lock of a folder."""

from __future__ import annotations

import contextlib
import io
import json
import os
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError

_DAMAGE = (OSError, ValueError, EOFError, KeyError, RuntimeError, zipfile.BadZipFile, zlib.error)
"""Raised by numpy and zipfile for a damaged .npz file."""


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file so that a reader finds the old content or the new, never a part.

    The content is written to a file beside it, which the system moves into place in one step. That
    file's name is fixed: one that a killed process left is overwritten by the next.
    """
    data = content.encode() if isinstance(content, str) else content
    unfinished = path.with_name(f".{path.name}.unfinished")
    with unfinished.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    os.replace(unfinished, path)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes from training and evaluating in a folder meanwhile.

    A process that is killed holds nothing. Raises UserError where another process holds the lock.
    """
    with warnings.catch_warnings():  # where the system has no file locks: filelock makes do
        warnings.simplefilter("ignore")
        from filelock import FileLock, Timeout
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise UserError(f"another process is training or evaluating in {folder}") from None
    try:
        yield
    finally:
        lock.release()


def write_json(path: Path, content: Any) -> None:
    """Write JSON, indented; floats round-trip bit for bit."""
    write_whole(path, json.dumps(content, indent=1) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object. Raises UserError naming the file where it is missing or damaged."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path} is missing: not a run folder, or a damaged one") from None
    except (OSError, ValueError) as error:
        raise UserError(f"{path} is damaged: {error}") from None
    if not isinstance(content, dict):
        raise UserError(f"{path} is damaged: must be a JSON object, got {type(content).__name__}")
    return content


def write_arrays(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """Write named arrays (.npz)."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    write_whole(path, buffer.getvalue())


def read_arrays(
    path: Path, wanted: Callable[[str], bool] = lambda name: True
) -> dict[str, NDArray]:
    """Read those named arrays whose name is `wanted`, all by default; nothing is unpickled.

    Raises UserError where the file is missing or damaged.
    """
    try:
        with path.open("rb") as file:  # numpy leaves a damaged file open
            arrays = np.load(file, allow_pickle=False)
            return {name: arrays[name] for name in arrays.files if wanted(name)}
    except FileNotFoundError:
        raise UserError(f"{path} is missing: nothing has been trained there yet") from None
    except _DAMAGE as error:
        raise UserError(f"{path} is damaged: {error}") from None
