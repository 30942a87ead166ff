"""C text made a library by the compiler of this machine."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

COMPILER = shutil.which("cc") or shutil.which("gcc")

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")


def compiled(source: str, folder: Path) -> ctypes.CDLL:
    """A library of the C text; a warning of the compiler is an error."""
    assert COMPILER is not None
    (folder / "motion.c").write_text(source, encoding="utf-8")
    library = folder / "motion.so"
    subprocess.run(
        [COMPILER, *STRICT, "-shared", "-fPIC", "motion.c", "-o", str(library), "-lm"],
        cwd=folder,
        check=True,
        timeout=60,
    )
    return ctypes.CDLL(str(library))
