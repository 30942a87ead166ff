"""A file that is written chunk by chunk, and goes on where it was cut off.

Until it is whole, FILE's rows are in FILE.partial, what they depend on in FILE.partial.json, and a
digest of each chunk in FILE.partial.sums.  Each chunk is on the disk before the next begins; what
does not match its digest, as what was cut off in the middle of a chunk, is left out when the file
goes on.  FILE.partial.json is locked by whoever touches any of them.  What something else made
under one of these names is refused, and stays as it is.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import shutil
import stat
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType

from robodyn.errors import InputError
from robodyn.tables.output_file import NamedFile, check_same, close_quietly

BLOCK = 1 << 20
MOST_FACTS = 1 << 26  # bytes
MOST_SHOWN = 60  # characters of a value in a message
RECORD = re.compile(rb"([0-9]{15}) ([0-9a-f]{64})\n")  # a chunk's length and digest
RECORD_SIZE = 81


class ResumableFile:
    """Lines under a header; to be used in a `with` block, which leaves the partial file behind.

    `facts` are what the lines depend on; a partial file of other facts is refused with InputError.
    `lines` are wanted in all, in chunks of `chunk`; `done` chunks are there already.  `doubted`
    tells whether more was there, which does not match its digests and is left out.
    """

    def __init__(
        self, path: str, header: bytes, facts: Mapping[str, object], lines: int, chunk: int
    ) -> None:
        self.path = path
        self._target = os.path.realpath(path)
        self.partial = f"{path}.partial"
        self._rows_name = f"{self._target}.partial"
        self._facts_name, self._sums_name = f"{self._rows_name}.json", f"{self._rows_name}.sums"
        self.done, self.doubted = 0, False
        text = (json.dumps(facts, indent=2) + "\n").encode()
        self._seed = hashlib.sha256(text + header)
        with ExitStack() as opened, ExitStack() as made:
            try:
                if os.path.exists(self._target):
                    os.close(os.open(self._target, os.O_WRONLY))  # a read-only file stays
                for name in (self._rows_name, self._facts_name, self._sums_name):
                    with suppress(FileNotFoundError):
                        if not stat.S_ISREG(os.lstat(name).st_mode):
                            raise self._foreign(name, "it is a link or no regular file")
                lock = self._locked()
                opened.callback(close_quietly, lock)
                known = lock.read(MOST_FACTS)
                if not known:  # made just now
                    made.callback(os.unlink, self._facts_name)
                there = [x for x in (self._rows_name, self._sums_name) if os.path.lexists(x)]
                if there or not text.startswith(known):
                    self._check(known, json.loads(text), there)
                else:
                    lock.truncate(0)
                    lock.seek(0)
                    self._write(lock, text)
                streams = []
                for name in (self._sums_name, self._rows_name):
                    mode = "r+b" if name in there else "x+b"
                    file = NamedFile(name, mode, self._told(name), _no_link)
                    streams.append(io.BufferedRandom(file))
                    opened.callback(close_quietly, streams[-1])
                    if name not in there:
                        made.callback(os.unlink, name)
                self._sums, self._rows = streams
                self._keep(header, -(-lines // chunk))
                self.doubted &= bool(known)
            except OSError as error:
                reason = (error.strerror or str(error)).lower()
                raise InputError("cannot be written", where=path, limit=reason) from error
            made.pop_all()
            self._opened = opened.pop_all()

    def append(self, lines: bytes) -> None:
        """Write the lines of the next chunk, and their digest, onto the disk."""
        self._write(self._rows, lines)
        digest = self._digest()
        digest.update(lines)
        self._write(self._sums, b"%015d %s\n" % (len(lines), digest.hexdigest().encode()))
        self.done += 1

    def finish(self) -> None:
        """The file is whole: it takes its place."""
        for name, stream in ((self._rows_name, self._rows), (self._sums_name, self._sums)):
            check_same(name, stream)
        if os.path.exists(self._target):
            shutil.copymode(self._target, self._rows_name)
        os.replace(self._rows_name, self._target)
        os.unlink(self._sums_name)
        os.unlink(self._facts_name)  # the file that is locked goes last

    def __enter__(self) -> ResumableFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._opened.close()

    def _locked(self) -> io.BufferedRandom:
        """The file of facts, locked, and still the one of this name."""
        while True:
            descriptor = _no_link(self._facts_name, os.O_RDWR | os.O_CREAT)
            stream = open(descriptor, "r+b")  # noqa: SIM115
            try:
                self._lock(stream)
                with suppress(FileNotFoundError):
                    if os.path.samestat(os.fstat(descriptor), os.stat(self._facts_name)):
                        return stream
            except BaseException:
                stream.close()
                raise
            stream.close()  # who had it locked has come to the end, and removed it

    def _lock(self, stream: io.BufferedRandom) -> None:
        try:
            import fcntl
        except ImportError:  # not a Unix: two runs into one file are not told apart
            return
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            limit = "another process is writing it"
            raise InputError("cannot be written", where=self.partial, limit=limit) from None

    def _told(self, name: str) -> str:
        """The name of a file beside the target, as messages tell it."""
        return self.path + name[len(self._target) :]

    def _foreign(self, name: str, why: str) -> InputError:
        """The error for a file beside the target that this sweep did not make."""
        limit = f"{why}: remove or rename it"
        return InputError("is not of this sweep", where=self._told(name), limit=limit)

    def _check(self, text: bytes, facts: Mapping[str, object], there: Sequence[str]) -> None:
        """Refuse to go on with the lines of another computation; `there` are rows and digests."""
        missing = f"{self.partial}.json, which tells what it is, is missing or damaged"
        unknown = self._foreign((*there, self._facts_name)[0], missing)
        try:
            known = json.loads(text)
            if not isinstance(known, dict):
                raise unknown
            other = [name for name in {**known, **facts} if known.get(name) != facts.get(name)]
            theirs = ", ".join(_shown(name, known.get(name)) for name in other)
        except (ValueError, RecursionError):  # of brackets within brackets
            raise unknown from None
        if other:
            ours = ", ".join(_shown(name, facts.get(name)) for name in other)
            limit = f"there: {theirs}; here: {ours}; remove it, .json and .sums, or name another"
            raise InputError("holds rows of another computation", where=self.partial, limit=limit)
        if there == [self._rows_name]:
            raise self._foreign(there[0], f"{self.partial}.sums, its digests, is missing")

    def _keep(self, header: bytes, most: int) -> None:
        """Find the chunks that match their digests, and cut off what follows them."""
        begin = self._rows.read(len(header))
        if not header.startswith(begin):
            raise self._foreign(self._rows_name, "it has another header")
        kept = len(header) if begin == header else 0
        while kept and self.done < most:
            record = RECORD.fullmatch(self._sums.read(RECORD_SIZE))
            if record is None or self._digest_of(int(record[1])) != record[2].decode():
                break
            kept += int(record[1])
            self.done += 1
        ends = ((self._rows, kept), (self._sums, self.done * RECORD_SIZE))
        for stream, end in ends:
            self.doubted |= stream.seek(0, os.SEEK_END) > end
            stream.seek(end)
            stream.truncate()
        if not kept:
            self._write(self._rows, header)

    def _digest(self) -> hashlib._Hash:
        """The digest of the next chunk, of nothing yet but of what it belongs to."""
        digest = self._seed.copy()
        digest.update(b"%d\n" % self.done)
        return digest

    def _digest_of(self, length: int) -> str:
        """The digest of as many bytes of the rows."""
        digest = self._digest()
        while length > 0 and (block := self._rows.read(min(length, BLOCK))):
            digest.update(block)
            length -= len(block)
        return "" if length else digest.hexdigest()

    def _write(self, stream: io.BufferedRandom, data: bytes) -> None:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _no_link(path: str, flags: int) -> int:
    """Open a file, made where the flags say so, that is no symbolic link."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def _shown(name: str, value: object) -> str:
    text = f"{name} {json.dumps(value)}"
    return text if len(text) <= MOST_SHOWN else text[:MOST_SHOWN] + "..."
