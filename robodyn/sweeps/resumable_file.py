"""A file that is written chunk by chunk, and goes on where it was cut off.

Until it is whole, FILE's rows are in FILE.partial, and what they depend on is in
FILE.partial.json.  Each chunk is on the disk before the next begins; what was cut off in the middle
of a chunk is left out when the file goes on.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from types import TracebackType
from typing import BinaryIO

from robodyn.errors import InputError

BLOCK = 1 << 20
MOST_SHOWN = 60  # characters of a value in a message


class ResumableFile:
    """Lines under a header; to be used in a `with` block, which leaves the partial file behind.

    `facts` are what the lines depend on; a partial file of other facts is refused with InputError.
    `lines` are wanted in all, in chunks of `chunk`; `done` chunks are there already.
    """

    def __init__(
        self, path: str, header: bytes, facts: Mapping[str, object], lines: int, chunk: int
    ) -> None:
        self.path = path
        self._target = os.path.realpath(path)
        self.partial = f"{path}.partial"
        self._rows, self._facts = f"{self._target}.partial", f"{self._target}.partial.json"
        self.done = 0
        text = json.dumps(facts, indent=2) + "\n"
        try:
            if os.path.exists(self._target):
                os.close(os.open(self._target, os.O_WRONLY))  # a read-only file stays
            there = os.path.exists(self._rows) and os.path.getsize(self._rows) > 0
            if there:
                self._check(json.loads(text))
            self._stream: BinaryIO = open(self._rows, "r+b" if there else "w+b")  # noqa: SIM115
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError("cannot be written", where=path, limit=reason) from error
        try:
            self._lock()
            if there:
                self._keep(header, lines, chunk)
            else:
                with open(self._facts, "w", encoding="utf-8") as stream:
                    stream.write(text)
                    stream.flush()
                    os.fsync(stream.fileno())
                self.append(header)
        except BaseException:
            self._stream.close()
            raise

    def append(self, lines: bytes) -> None:
        """Write lines, onto the disk."""
        self._stream.write(lines)
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def finish(self) -> None:
        """The file is whole: it takes its place."""
        if os.path.exists(self._target):
            shutil.copymode(self._target, self._rows)
        os.replace(self._rows, self._target)
        os.unlink(self._facts)

    def __enter__(self) -> ResumableFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stream.close()

    def _check(self, facts: Mapping[str, object]) -> None:
        """Refuse to go on with the lines of another computation."""
        try:
            with open(self._facts, encoding="utf-8") as stream:
                known = json.load(stream)
        except (FileNotFoundError, ValueError):
            known = None
        if not isinstance(known, dict):
            limit = f"{self.partial}.json, which tells what they are, is missing: "
            raise InputError("rows", where=self.partial, limit=limit + "remove or rename it")
        other = [name for name in {**known, **facts} if known.get(name) != facts.get(name)]
        if other:
            there = ", ".join(_shown(name, known.get(name)) for name in other)
            here = ", ".join(_shown(name, facts.get(name)) for name in other)
            limit = f"there: {there}; here: {here}; remove it, or name another file"
            raise InputError("holds rows of another computation", where=self.partial, limit=limit)

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:  # not a Unix: two runs into one file are not told apart
            return
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            limit = "another process is writing it"
            raise InputError("cannot be written", where=self.partial, limit=limit) from None

    def _keep(self, header: bytes, lines: int, chunk: int) -> None:
        """Find the whole chunks, and cut off what follows them."""
        count, kept, place = -1, 0, 0  # the header counts for none
        self._stream.seek(0)
        while block := self._stream.read(BLOCK):
            begin = 0
            while (end := block.find(b"\n", begin)) >= 0:
                count, begin = count + 1, end + 1
                if count % chunk == 0 or count == lines:
                    kept, self.done = place + begin, -(-count // chunk)
            place += len(block)
        self._stream.truncate(kept)
        self._stream.seek(kept)
        if not kept:
            self.append(header)


def _shown(name: str, value: object) -> str:
    text = json.dumps(value)
    return f"{name} {text if len(text) <= MOST_SHOWN else text[:MOST_SHOWN] + '...'}"
