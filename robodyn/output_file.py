"""Output files that take their place whole, or not at all."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import BinaryIO

from robodyn.errors import InputError


@contextmanager
def open_output(
    path: str | os.PathLike[str] | None, partial: Callable[[str], object] | None = None
) -> Iterator[BinaryIO]:
    """A binary stream to a file that takes its place, whole, when the block ends well.

    Where the block raises, an older file stays as it was; what was written is removed, or, with
    `partial`, kept under a name beside it that `partial` is told.  None and "-" are the standard
    output; a device or a pipe is written as it stands.  Raises InputError where the file
    cannot be created.
    """
    if path is None or os.fspath(path) == "-":
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    target = os.path.realpath(path)  # a link stays, the file that it names is replaced
    temporary = os.path.join(os.path.dirname(target), f".robodyn-{os.urandom(8).hex()}.tmp")
    is_file = os.path.isfile(path)
    in_place = os.path.exists(path) and not is_file
    with ExitStack() as cleanup:
        try:
            if is_file:
                os.close(os.open(path, os.O_WRONLY))  # a read-only file is not to be replaced
            if not os.path.basename(path):
                raise OSError("it names no file")
            if in_place:
                stream = cleanup.enter_context(open(path, "wb"))
            else:
                stream = cleanup.enter_context(open(temporary, "xb"))
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError("cannot be written", where=os.fspath(path), limit=reason) from error
        if in_place:
            yield stream
            return
        try:
            if is_file:
                shutil.copymode(target, temporary)
            yield stream
            stream.close()
            os.replace(temporary, target)
        except BaseException:
            stream.close()
            if partial is None or not os.path.getsize(temporary):
                os.unlink(temporary)
            else:
                kept = f"{target}.partial"
                os.replace(temporary, kept)
                partial(kept)
            raise


def same_file(first: str, second: str | None) -> bool:
    """Whether two outputs would take the same place; a device takes both."""
    targets = {"-" if path in (None, "-") else os.path.realpath(path) for path in (first, second)}
    return len(targets) == 1 and (
        first == "-" or not os.path.exists(first) or os.path.isfile(first)
    )
