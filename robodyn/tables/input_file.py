"""Files that are read as a whole: regular ones of a bounded size."""

from __future__ import annotations

import os
import stat
from typing import BinaryIO

MOST_BYTES = 16 * 2**20


def read_regular(path: str | os.PathLike[str]) -> bytes:
    """Return the bytes of a regular file; ValueError as `read_bounded`, and for any other kind.

    A pipe is not waited for, a device not read.  Raises OSError for a file that cannot be read.
    """

    def at_once(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))

    with open(path, "rb", opener=at_once) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise ValueError("is not a regular file")
        return read_bounded(stream)


def read_bounded(stream: BinaryIO) -> bytes:
    """Return what is left of a stream; ValueError if that is more than MOST_BYTES."""
    data = stream.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ValueError(f"is larger than {MOST_BYTES // 2**20} MiB")
    return data
