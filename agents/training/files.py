"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file so that whoever reads it, whenever, finds the old content or the new.

    The content is written beside it and moved into place, which the system does in one step. The
    name beside it is fixed: what a killed process left there, the next one overwrites.
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
    """Keep other processes from training in a folder meanwhile; a killed one holds nothing.

    Raises UserError where another process is at it.
    """
    with (folder / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(f"another process is training in {folder}") from None
        yield


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


def read_arrays(path: Path) -> dict[str, NDArray]:
    """Read named arrays; nothing is unpickled. Raises UserError where the file is damaged."""
    try:
        with path.open("rb") as file:  # numpy leaves a damaged file open
            return dict(np.load(file, allow_pickle=False))
    except FileNotFoundError:
        raise UserError(f"{path} is missing: nothing has been trained there yet") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise UserError(f"{path} is damaged: {error}") from None
