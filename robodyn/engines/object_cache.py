"""Machine code kept on disk, in the user's cache folder, for its owner alone.

Whatever is wrong with it (damaged, of another owner, not writable, a full disk) reads as "not
there": the code is made anew.  `ROBODYN_CACHE` names another folder or, empty, turns it off.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import sys
import tempfile
from pathlib import Path

KEPT = 1000  # files; the oldest half goes when there are more
_DIGEST = 32  # bytes of a digest in front of the object


def folder() -> Path | None:
    """Where objects are kept; None: nowhere."""
    named = os.environ.get("ROBODYN_CACHE")
    if named is not None:
        return Path(named).expanduser() if named else None
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "robodyn"
    if sys.platform == "win32":
        return (
            Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "robodyn" / "Cache"
        )
    base = Path(os.environ.get("XDG_CACHE_HOME") or "")
    return (base if base.is_absolute() else home / ".cache") / "robodyn"


def load(folder: Path | None, name: str) -> bytes | None:
    """The object of this name; None unless it is there, whole, and nobody else could write it."""
    if folder is None:
        return None
    try:
        if not _own(os.stat(folder)):
            return None
        descriptor = os.open(folder / name, os.O_RDONLY | _BINARY | getattr(os, "O_NOFOLLOW", 0))
        with os.fdopen(descriptor, "rb") as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode) or not _own(status):
                return None
            content = stream.read()
    except OSError:
        return None
    digest, found = content[:_DIGEST], content[_DIGEST:]
    return found if hashlib.sha256(found).digest() == digest else None


def store(folder: Path | None, name: str, content: bytes) -> None:
    """Keep an object; readers see the whole of it or nothing."""
    if folder is None:
        return
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _own(os.stat(folder)):
            return
        _prune(folder)
        descriptor, temporary = tempfile.mkstemp(dir=folder, prefix=".new-")  # mode 0600
        try:
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(hashlib.sha256(content).digest() + content)
            os.replace(temporary, folder / name)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
    except OSError:
        return


_BINARY = getattr(os, "O_BINARY", 0)


def _own(status: os.stat_result) -> bool:
    """Whether it belongs to this user, and no other may write it."""
    if not hasattr(os, "geteuid"):
        return True
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _prune(folder: Path) -> None:
    files = [entry for entry in os.scandir(folder) if entry.is_file(follow_symlinks=False)]
    if len(files) <= KEPT:
        return
    for entry in sorted(files, key=lambda entry: entry.stat().st_mtime)[: len(files) // 2]:
        with contextlib.suppress(OSError):
            os.unlink(entry.path)
