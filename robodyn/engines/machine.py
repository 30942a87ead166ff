"""Compiles kernel text with llvmlite, if it is installed and allowed; otherwise returns None.

llvmlite produces an object file.  Loading it takes a tenth of the time of compiling.  So it is kept
on disk, in the user's cache folder, readable by the owner only.

A file that is damaged, of another owner, or not writable counts as absent, and the code is compiled
again.  `ROBODYN_CACHE` names another folder; if it is empty, nothing is kept.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import hashlib
import mmap
import os
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from robodyn.engines.expression import FUNCTIONS

KEPT = 1000  # files; the oldest half goes when there are more
_DIGEST = 32  # bytes of a digest in front of the object


def folder() -> Path | None:
    """Return the folder for object files, or None if they are not kept."""
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
    """Return the object `name`, or None if it is absent, incomplete, or writable by others."""
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
    """Store an object; readers see all of it or nothing."""
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
    """Return whether a file belongs to this user and cannot be written by others."""
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


# Lines of text from which code is made at level 0: in 15 us a line, not 50, and slower by 5 to 15 %
# with 8 lanes, 20 to 30 % with one; loops would be slower by a factor of 5
LARGE = 5000
LONG = 1000  # lines of a function that then is; those that are shorter hold the loops
LEAST_LLVM = 17  # the first in which an address has no other type
LIBRARY = (*FUNCTIONS, "pow", "fma")  # of C, that kernels may call
ROOMS = (
    "elements",
    "engines",
    "loops",
    "mechanics",
    "runs",
    "sweeps",
)  # that decide the text
PLAIN = "plain"  # the processor's family without what is optional: for tests


class Processor(NamedTuple):
    """The processor that code is made for."""

    name: str
    features: str
    lanes: int  # doubles in a vector
    together: int = 0  # sums of eight numbers that its registers hold, with what these read


class Code:
    """Loaded machine code; it must stay alive as long as its functions are used."""

    def __init__(self, engine: Any, processor: Processor) -> None:
        self.engine, self.processor = engine, processor

    def function(self, name: str, *types: Any, result: Any = ctypes.c_int64) -> Callable[..., Any]:
        """Return a kernel as a Python function, which releases the GIL while it runs."""
        call = ctypes.CFUNCTYPE(result, *types)(self.engine.get_function_address(name))
        call.code = self  # type: ignore[attr-defined]  # keeps the machine code
        return call


_lock = threading.RLock()


@contextmanager
def _uncollected() -> Iterator[None]:
    """Disable garbage collection: graphs are many small objects that stay in use."""
    searches = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searches:
            gc.enable()


def _renew_lock() -> None:
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):  # a child does not wait for a thread that it does not have
    os.register_at_fork(after_in_child=_renew_lock)


def make(
    write: Callable[[Processor], str],
    key: str = "",
    level: int | None = None,
    family: str = "",
    lanes: int = 0,
) -> Code | None:
    """Compile the text returned by `write(processor)`; return None if that is impossible.

    `key`, if given, must determine the text, together with the processor and the engines' sources:
    a stored object then saves writing the text.  `level` is LLVM's optimisation level 0 to 3; by
    default it depends on the text's length.  `family` "plain" uses no optional processor features.
    `lanes` defaults to the width of the processor's vectors.
    """
    if not available():
        return None
    with _lock, _uncollected():
        try:
            processor = this_processor(family)
            return _made(write, key, level, processor._replace(lanes=lanes or processor.lanes))
        except Exception:  # whatever code generation may meet: the other engines serve
            return None


def _made(
    write: Callable[[Processor], str],
    key: str,
    level: int | None,
    processor: Processor,
) -> Code:
    import llvmlite
    from llvmlite import binding as llvm

    text = "" if key else write(processor)
    parts = (key or text, key and generator(), level, processor, llvm.get_process_triple())
    name = hashlib.sha256(repr((*parts, llvmlite.__version__, llvm.llvm_version_info)).encode())
    place = folder()
    content = load(place, name.hexdigest())
    if content is not None:
        try:
            return _loaded(content, processor)
        except Exception:  # made anew below
            content = None
    objects = []
    for part, its_level in _parts(text or write(processor), level):
        module = llvm.parse_assembly(part)
        module.verify()
        objects.append(_machine(processor, its_level).emit_object(module))
    content = b"".join(len(each).to_bytes(8, "little") + each for each in objects)
    store(place, name.hexdigest(), content)
    return _loaded(content, processor)


def _parts(text: str, level: int | None) -> list[tuple[str, int]]:
    """Return the text in pieces with their levels; each piece declares the others' functions."""
    if level is not None:
        return [(text, level)]
    if text.count("\n") < LARGE:
        return [(text, 2)]
    functions = text.strip().split("\n\n")
    declared = [x for x in functions if x.startswith("declare")]
    declared += [
        f"declare {x.partition(' nounwind {')[0][7:]}" for x in functions if x not in declared
    ]
    found = []
    for long, its_level in ((True, 0), (False, 2)):
        own = [x for x in functions if x.startswith("define") and (x.count("\n") >= LONG) == long]
        names = {x.partition("(")[0].split()[-1] for x in own}
        others = [x for x in declared if x.partition("(")[0].split()[-1] not in names]
        found.append(("\n".join([*others, *own, ""]), its_level))
    return found


def _machine(processor: Processor, level: int) -> Any:
    from llvmlite import binding as llvm

    target = llvm.Target.from_triple(llvm.get_process_triple())
    return target.create_target_machine(
        cpu=processor.name, features=processor.features, opt=level, codemodel="jitdefault", jit=True
    )


def _loaded(content: bytes, processor: Processor) -> Code:
    from llvmlite import binding as llvm

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine(processor, 0))
    while content:
        end = 8 + int.from_bytes(content[:8], "little")
        if end > len(content):
            raise ValueError("no object behind its length")  # as older versions kept it
        engine.add_object_file(llvm.ObjectFileRef.from_data(content[8:end]))
        content = content[end:]
    engine.finalize_object()
    return Code(engine, processor)


@lru_cache(maxsize=1)
def available() -> bool:
    """Return whether machine code can be made and run here."""
    if find_spec("llvmlite") is None or not executable_memory():
        return False
    with _lock:
        try:
            from llvmlite import binding as llvm

            if llvm.llvm_version_info[0] < LEAST_LLVM:
                return False
            llvm.initialize_native_target()
            llvm.initialize_native_asmprinter()
            library = _c_library()
            for name in LIBRARY:
                address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
                llvm.add_symbol(name, address)
        except Exception:
            return False
        return True


def _c_library() -> ctypes.CDLL:
    if sys.platform == "win32":
        return ctypes.CDLL("ucrtbase")
    own = ctypes.CDLL(None)  # what Python itself is linked with
    return own if all(hasattr(own, name) for name in LIBRARY) else ctypes.CDLL("libm.so.6")


def executable_memory() -> bool:
    """Return whether the system lets this process write and execute code."""
    if sys.platform != "linux":
        return True
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        kind = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
        with mmap.mmap(-1, mmap.PAGESIZE, flags=kind) as page:
            held = ctypes.c_char.from_buffer(page)
            read_and_run = 1 | 4
            address = ctypes.c_void_p(ctypes.addressof(held))
            refused = libc.mprotect(address, ctypes.c_size_t(mmap.PAGESIZE), read_and_run)
            del held
    except (OSError, AttributeError, ValueError):
        return False
    return not refused


@lru_cache(maxsize=2)
def this_processor(family: str = "") -> Processor:
    """Return the processor, with as many lanes as its vectors hold."""
    from llvmlite import binding as llvm

    features = {} if family == PLAIN else dict(llvm.get_host_cpu_features())
    name = "" if family == PLAIN else llvm.get_host_cpu_name()
    lanes = 8 if features.get("avx512f") else 4 if features.get("avx2") else 2
    listed = ",".join(f"{'+' if on else '-'}{f}" for f, on in sorted(features.items()))
    together = {8: 16, 4: 4, 2: 2}[lanes]
    return Processor(name, listed, lanes, together)


@lru_cache(maxsize=1)
def generator() -> str:
    """Return a hash of the sources of ROOMS."""
    digest = hashlib.sha256()
    for room in ROOMS:
        for path in sorted((Path(__file__).parent.parent / room).glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()
