"""Files that are whole or missing, and checksums by which damage to them is seen."""

import contextlib
import glob
import hashlib
import json
import os
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path

CHECKSUMS = "checksums.json"
"""In a folder: SHA-256 of its files and of those in folders in it, by their names below it,
{"seed-0/episodes.csv": ["..."]}. A file has one of the sums in its list: there are two while it is
being replaced, so that a process that is killed then leaves nothing that looks damaged."""


def write_whole(path: Path, content: bytes | str, keep: Path | None = None) -> None:
    """Write a file so that a reader finds the old content or the new, never a part.

    The content is written to a new file of a random name beside it, which the system moves into
    place in one step; what killed processes left of such files is removed. keep: where to move the
    old file.
    """
    data = content.encode() if isinstance(content, str) else content
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.unfinished"):
        with contextlib.suppress(OSError):
            left.unlink()
    for attempt in range(5):
        unfinished = path.with_name(f".{path.name}.{secrets.token_hex(8)}.unfinished")
        try:
            with unfinished.open("xb") as file:  # x: follows no link
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if keep is not None and path.exists():
                os.replace(path, keep)
            os.replace(unfinished, path)
            return
        except FileNotFoundError:
            # Another process writes the same file, and took ours for one that was left.
            if attempt == 4 or not path.parent.is_dir():
                raise
        finally:
            unfinished.unlink(missing_ok=True)


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def read_checksums(folder: Path) -> dict[str, list[str]]:
    """The checksums of a folder, empty where it has none. ValueError: a damaged file."""
    path = folder / CHECKSUMS
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: {error}") from None
    lists = content.values() if isinstance(content, dict) else [None]
    if not all(isinstance(sums, list) and all(isinstance(s, str) for s in sums) for sums in lists):
        raise ValueError(f"{path} is damaged: must hold a list of checksums for each file")
    return content


def check_digest(path: Path, found: str) -> bool:
    """Whether a checksum of the file is known; files of earlier versions have none.

    ValueError where it is known and another than that of its content.
    """
    above, known = path.parent.absolute(), False
    for folder, name in ((above, path.name), (above.parent, f"{above.name}/{path.name}")):
        sums = read_checksums(folder).get(name)
        if sums is not None and found not in sums:
            raise ValueError(
                f"{path} is damaged: it does not match its checksum in {folder / CHECKSUMS}"
            )
        known |= sums is not None
    return known


def read_checked(path: Path) -> bytes:
    """The content of a file. ValueError: damaged by its checksum. OSError: cannot be read."""
    for _ in range(3):
        data = path.read_bytes()
        try:
            check_digest(path, digest(data))
            return data
        except ValueError:
            if path.read_bytes() == data:  # else it was replaced meanwhile
                check_digest(path, digest(data))
                return data
    return path.read_bytes()


@contextlib.contextmanager
def replacing(folder: Path, digests: Mapping[str, str | None]) -> Iterator[None]:
    """Note the checksums of files that are written meanwhile; None: of one that is removed.

    A process that is killed meanwhile leaves the old checksum and the new one.
    """
    before = read_checksums(folder)
    announced = dict(before)
    for name, new in digests.items():
        if new is not None and new not in before.get(name, []):
            # Of a file that is there without a checksum, nothing is said until it is replaced.
            known = name in before or not (folder / name).exists()
            announced[name] = [*before.get(name, []), new] if known else []
    announced = {name: sums for name, sums in announced.items() if sums}
    if announced != before:
        _write(folder, announced)
    yield
    after = {name: sums for name, sums in announced.items() if name not in digests}
    after |= {name: [new] for name, new in digests.items() if new is not None}
    if after != announced:
        _write(folder, after)


def write_files(folder: Path, contents: Mapping[str, bytes | None]) -> None:
    """Write files of a folder, each whole, and their checksums; None: remove one."""
    digests = {name: None if data is None else digest(data) for name, data in contents.items()}
    with replacing(folder, digests):
        for name, data in contents.items():
            if data is None:
                (folder / name).unlink(missing_ok=True)
            else:
                write_whole(folder / name, data)


def _write(folder: Path, sums: Mapping[str, list[str]]) -> None:
    write_whole(folder / CHECKSUMS, json.dumps(dict(sorted(sums.items())), indent=1) + "\n")
