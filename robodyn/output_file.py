"""Output files that take their place whole, or not at all."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from io import BufferedIOBase
from typing import TYPE_CHECKING, BinaryIO, cast

from robodyn.errors import InputError, printable_lines

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


@contextmanager
def open_output(
    path: str | os.PathLike[str] | None,
    partial: Callable[[str], object] | None = None,
    styled: bool = False,
) -> Iterator[BinaryIO]:
    """A binary stream to a file that takes its place, whole, when the block ends well.

    Where the block raises, an older file stays as it was; what was written is removed, or, with
    `partial`, kept under a name beside it that `partial` is told.  None and "-" are the standard
    output; a device or a pipe is written as it stands.  A terminal is shown what it would obey
    written out, unless the output is `styled`, made for a terminal.  Raises InputError where the
    file cannot be created.
    """
    if path is None or os.fspath(path) == "-":
        raw = on_terminal(None) and not styled
        yield cast(BinaryIO, _Terminal()) if raw else sys.stdout.buffer
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


def on_terminal(path: str | None) -> bool:
    """Whether an output goes to a terminal."""
    return path in (None, "-") and sys.stdout.isatty()


class _Terminal(BufferedIOBase):
    """The standard output for data that may hold what a terminal would obey."""

    def write(self, data: ReadableBuffer) -> int:
        text = bytes(data).decode(errors="surrogateescape")
        return sys.stdout.buffer.write(printable_lines(text).encode())

    def flush(self) -> None:
        sys.stdout.buffer.flush()


def same_file(first: str, second: str | None) -> bool:
    """Whether two outputs would take the same place; a device takes both."""
    targets = {"-" if path in (None, "-") else os.path.realpath(path) for path in (first, second)}
    return len(targets) == 1 and (
        first == "-" or not os.path.exists(first) or os.path.isfile(first)
    )
