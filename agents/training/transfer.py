"""Files of a group of trainings on their way from the node where they are written to the driver.

Of files that grew, and of a checkpoint that became the one before, only what is new is sent.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from agents.training.checksums import CHECKSUMS, digest
from agents.training.files import write_whole
from agents.training.workers import Group

STATUS = "status.json"
"""The name that `agents.training.status` gives it, whose import would bring torch to Ray's own
processes."""
CHECKPOINT = "checkpoint"
"""Beginning of the names of the files of a checkpoint."""
Key = tuple[int, str]
"""Index of a folder, path of a file in it."""
HEAD = 128
"""Bytes at the beginning of a file that are always sent: the header of a .npy file, which counts
its rows."""
Seen = dict[Key, tuple[int, int]]
"""Time of the last change and size of files."""


class File(NamedTuple):
    """The content of a file: a head, bytes that the driver's folder holds already, a tail."""

    folder: int
    """Its index in the group."""
    name: str
    """Path in the folder."""
    head: bytes
    tail: bytes
    source: str | None = None
    """The file in the driver's folder that holds the bytes between, from HEAD to `until`."""
    until: int = HEAD


class Message(NamedTuple):
    """Files that changed in the folders of a group, and how its process is."""

    files: Sequence[File]
    """In the order in which a driver that may end meanwhile has to write them: records before the
    checkpoint that counts them, checksums last."""
    names: Collection[Key] | None
    """All files that there are; None where only the progress is reported."""
    status: int | None
    """Exit status of the process; None while it runs."""


class Sent:
    """The folders of a group, and what the driver knows of them."""

    def __init__(self, group: Group) -> None:
        """The driver's folders are equal now."""
        self._group, self._seen = group, _seen(group)
        self._known = {key: _known(self._content(key)) for key in self._seen}

    def changes(self, status: int | None) -> Message | None:
        """The files that changed, where a checkpoint or the end is among it; else the progress, if
        that changed; None where nothing is to be told. status: of the process."""
        before = _seen(self._group)
        changed = [key for key in before if self._seen.get(key) != before[key]]
        checkpoints = (key for key in changed if Path(key[1]).name.startswith(CHECKPOINT))
        whole = status is not None or any(checkpoints)
        if not whole:
            changed = [key for key in changed if key[1] == STATUS]
        changed.sort(key=lambda key: (_rank(key[1]), before[key]))
        try:
            contents = {key: self._content(key) for key in changed}
        except FileNotFoundError:
            return None  # replaced meanwhile: next time
        settled = [key for key in before if key[1] != STATUS]
        after = _seen(self._group)
        if whole and status is None and any(after.get(key) != before[key] for key in settled):
            return None  # in the middle of writing: next time
        if not changed and status is None:
            return None
        files = [self._file(key, content) for key, content in contents.items()]
        self._seen.update((key, before[key]) for key in changed)
        if whole:
            self._known = {key: known for key, known in self._known.items() if key in before}
        return Message(files, set(before) if whole else None, status)

    def _content(self, key: Key) -> bytes:
        index, name = key
        return (self._group[index] / name).read_bytes()

    def _file(self, key: Key, content: bytes) -> File:
        """The shortest that tells the driver, which knows it then."""
        index, name = key
        if name == CHECKSUMS:  # small, and removed before the message is taken in
            return File(index, name, content[:HEAD], content[HEAD:])
        others = [(i, n) for i, n in self._known if i == index and n.startswith(CHECKPOINT)]
        sources = [key, *(others if name.startswith(CHECKPOINT) else [])]
        file = File(index, name, content[:HEAD], content[HEAD:])
        for source in sources:
            size, of_rest = self._known.get(source, (0, ""))
            if HEAD < size <= len(content) and digest(content[HEAD:size]) == of_rest:
                file = File(index, name, content[:HEAD], content[size:], source[1], size)
                break
        self._known[key] = _known(content)
        return file


def _rank(name: str) -> int:
    return 2 if name == CHECKSUMS else int(name.startswith(CHECKPOINT))


def _known(content: bytes) -> tuple[int, str]:
    """Size of a file, and digest of what follows its head."""
    return len(content), digest(content[HEAD:])


def _seen(group: Group) -> Seen:
    found: Seen = {}
    for index, folder in enumerate(group):
        for name in files_of(folder):
            with contextlib.suppress(FileNotFoundError):
                stat = (folder / name).stat()
                found[index, name] = stat.st_mtime_ns, stat.st_size
    return found


def files_of(folder: Path) -> list[str]:
    """Paths of the files in a folder, but locks and those that are being written."""
    paths = (path for path in sorted(folder.rglob("*")) if not path.name.startswith("."))
    return [path.relative_to(folder).as_posix() for path in paths if path.is_file()]


def take_in(group: Group, message: Message) -> None:
    """Bring the folders of a group up to date with a message.

    Meanwhile they have no checksums: the old ones would not be those of the new files.
    """
    for file in message.files:
        if file.name == CHECKSUMS:
            (group[file.folder] / CHECKSUMS).unlink(missing_ok=True)
    for file in message.files:
        folder = group[file.folder]
        there = b"" if file.source is None else (folder / file.source).read_bytes()
        (folder / file.name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / file.name, file.head + there[HEAD : file.until] + file.tail)
    if message.names is not None:
        for index, folder in enumerate(group):
            for name in files_of(folder):
                if (index, name) not in message.names:
                    (folder / name).unlink()
