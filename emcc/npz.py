"""Reading .npy and .npz files so that damage is an error: each array up to its checksum."""

import errno
import io
import math
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

try:
    from lzma import LZMAError
except ImportError:  # this Python was built without lzma; zipfile raises an error of its own
    LZMAError = zipfile.BadZipFile

UNREADABLE = (
    *(ValueError, LookupError, TypeError, EOFError, RuntimeError, Warning, SyntaxError),
    *(zipfile.BadZipFile, LZMAError, zlib.error, struct.error, NotImplementedError),
    tokenize.TokenError,
)
"""Errors that zipfile, json and NumPy raise for damaged files, and that misfit arrays cause."""
MOST_BYTES, MOST_TIMES = 2**30, 100
"""An array may unpack to more than MOST_BYTES or to more than MOST_TIMES its size, but not both."""
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def words_of(error: BaseException) -> str:
    """Return the message for one of the `UNREADABLE` errors."""
    if isinstance(error, UnicodeDecodeError):
        return f"no text at byte {error.start}"
    return str(error) or type(error).__name__


def is_damage(error: OSError) -> bool:
    """Return whether an error comes from the file's content, not from the disk: bz2 sets no errno,
    and a damaged zip directory makes zipfile seek before the file's start (EINVAL)."""
    return error.errno in (None, errno.EINVAL)


def open_zip(source: Any) -> zipfile.ZipFile:
    """Open a zip file and check that its directory fits its members: a member whose name is damaged
    would otherwise be missing silently. source: a path, or a seekable open file. Raises one of
    `UNREADABLE` if the directory is damaged."""
    file = zipfile.ZipFile(source)
    assert file.fp is not None
    size = file.fp.seek(0, io.SEEK_END)
    for member in file.infolist():
        file.open(member).close()  # compares the member's name with the directory's
        beyond = member.header_offset + member.compress_size > size
        if beyond or b"PK\1\2" in member.comment + member.extra:  # has swallowed the next entry
            raise zipfile.BadZipFile("its directory is damaged")
    return file


class Npz(Mapping[str, NDArray[Any]]):
    """The arrays of an .npz file by name; each is read, and its checksum verified, on access.
    Raises one of `UNREADABLE` if the file is damaged."""

    def __init__(self, source: Any) -> None:
        """source: a seekable open file."""
        self._file = open_zip(source)
        self._members = {m.filename.removesuffix(".npy"): m for m in self._file.infolist()}

    def __getitem__(self, name: str) -> NDArray[Any]:
        member = self._members[name]
        packed, unpacked = member.compress_size, member.file_size
        if unpacked > max(MOST_BYTES, MOST_TIMES * packed):
            raise ValueError(
                f"{name} unpacks from {packed:,} bytes to {unpacked:,}, which no records do: if "
                "this is intended, save the array uncompressed"
            )
        return _read_array(lambda: self._file.open(member), unpacked, member.filename)

    def __contains__(self, name: object) -> bool:
        return name in self._members

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)


def read_arrays(content: bytes) -> Mapping[str, NDArray[Any]] | NDArray[Any]:
    """Read the arrays of an .npz file, or the array of an .npy file, from the file's bytes."""
    if content.startswith(b"PK"):
        return Npz(io.BytesIO(content))
    return _read_array(lambda: io.BytesIO(content), len(content), "the array")


def _read_array(open_: Callable[[], IO[bytes]], size: int, name: str) -> NDArray[Any]:
    """Read an array in .npy format that takes `size` bytes. Raises one of `UNREADABLE`, also if the
    header's size differs from `size`: a larger one would end in a MemoryError, a smaller one in a
    different array."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a damaged header may only cause a warning
        with open_() as file:
            version = np.lib.format.read_magic(file)
            if version not in _HEADERS:
                raise ValueError(f"{name} has version {version} of numpy's format")
            shape, _, dtype = _HEADERS[version](file)
            held = size - file.tell()
        if not dtype.hasobject and math.prod(shape) * dtype.itemsize != held:
            raise ValueError(f"{name} holds {held} bytes, its header says {list(shape)} {dtype}")
        with open_() as file:  # opened again: after a seek zipfile may not verify the checksum
            array = np.lib.format.read_array(file, allow_pickle=False)
            file.read()  # zipfile verifies the checksum at the end of the member
    return array
