"""Files of numpy, read so that damage is an error: each array to its end, where its checksum is."""

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
except ImportError:  # a Python that was built without it, whose zipfile says so
    LZMAError = zipfile.BadZipFile

UNREADABLE = (
    *(ValueError, LookupError, TypeError, EOFError, RuntimeError, Warning, SyntaxError),
    *(zipfile.BadZipFile, LZMAError, zlib.error, struct.error, NotImplementedError),
    tokenize.TokenError,
)
"""Errors that damaged files have zipfile, json and numpy raise, and arrays that do not fit."""
MOST_BYTES, MOST_TIMES = 2**30, 100
"""An array may unpack to more bytes, or to more times its bytes in the file, but not to both."""
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def words_of(error: BaseException) -> str:
    """Words for what is wrong with a file's content, by one of these errors."""
    if isinstance(error, UnicodeDecodeError):
        return f"no text at byte {error.start}"
    return str(error) or type(error).__name__


def is_damage(error: OSError) -> bool:
    """Whether an error is of a file's content and not of the disk: bz2 gives no number, a damaged
    directory asks for a place before the file's start."""
    return error.errno in (None, errno.EINVAL)


def open_zip(source: Any) -> zipfile.ZipFile:
    """A zip file whose directory fits its members: one whose name is damaged would be missing
    without a word. source: a path, or an open file in which one can seek. Raises one of
    `UNREADABLE` where the directory is damaged."""
    file = zipfile.ZipFile(source)
    assert file.fp is not None
    size = file.fp.seek(0, io.SEEK_END)
    for member in file.infolist():
        file.open(member).close()  # compares its name with that in the directory
        beyond = member.header_offset + member.compress_size > size
        if beyond or b"PK\1\2" in member.comment + member.extra:  # it holds the next one's entry
            raise zipfile.BadZipFile("its directory is damaged")
    return file


class Npz(Mapping[str, NDArray[Any]]):
    """The arrays of an .npz file by name, each read, and compared with its checksum, when it is
    asked for. Raises one of `UNREADABLE` where the file is damaged."""

    def __init__(self, source: Any) -> None:
        """source: the open file, in which one can seek."""
        self._file = open_zip(source)
        self._members = {m.filename.removesuffix(".npy"): m for m in self._file.infolist()}

    def __getitem__(self, name: str) -> NDArray[Any]:
        member = self._members[name]
        packed, unpacked = member.compress_size, member.file_size
        if unpacked > max(MOST_BYTES, MOST_TIMES * packed):
            raise ValueError(
                f"{name} unpacks from {packed:,} bytes to {unpacked:,}, which no records do: if it "
                "is what you want, save it uncompressed"
            )
        return _read_array(lambda: self._file.open(member), unpacked, member.filename)

    def __contains__(self, name: object) -> bool:
        return name in self._members

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)


def read_arrays(content: bytes) -> Mapping[str, NDArray[Any]] | NDArray[Any]:
    """The arrays of an .npz file's bytes, or the array of an .npy file's."""
    if content.startswith(b"PK"):
        return Npz(io.BytesIO(content))
    return _read_array(lambda: io.BytesIO(content), len(content), "the array")


def _read_array(open_: Callable[[], IO[bytes]], size: int, name: str) -> NDArray[Any]:
    """An array in the form of an .npy file of so many bytes. Raises one of `UNREADABLE`, also where
    its header asks for another size than there is: more would be taken for a lack of memory, less
    for another array."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of a damaged header too
        with open_() as file:
            version = np.lib.format.read_magic(file)
            if version not in _HEADERS:
                raise ValueError(f"{name} has version {version} of numpy's format")
            shape, _, dtype = _HEADERS[version](file)
            held = size - file.tell()
        if not dtype.hasobject and math.prod(shape) * dtype.itemsize != held:
            raise ValueError(f"{name} holds {held} bytes, its header says {list(shape)} {dtype}")
        with open_() as file:  # again: going back would give up the comparison below
            array = np.lib.format.read_array(file, allow_pickle=False)
            file.read()  # to its end, where its checksum is compared
    return array
