"""A progress bar on a terminal, for work that takes a while; rich comes in when it shows."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SILENT = 0.5  # s before a progress bar appears
LIVELY = 0.05  # s from one of its pictures to the next


@contextmanager
def progress(
    doing: str, quiet: bool = False, silent: float | None = None
) -> Iterator[Callable[[float], object]]:
    """A function that moves a bar to a part of the whole; on a terminal, after `silent` seconds."""
    silent = SILENT if silent is None else silent
    if quiet or not sys.stderr.isatty():
        yield lambda part: None
        return
    bars: list[tuple[Any, Any]] = []
    due = time.monotonic() + silent

    def begin() -> None:
        from rich.console import Console
        from rich.progress import Progress

        bar = Progress(console=Console(stderr=True), transient=True)
        bars.append((bar, bar.add_task(doing, total=1.0)))
        bar.start()

    def show(part: float) -> None:
        nonlocal due
        if time.monotonic() < due:
            return
        if not bars:
            begin()
        due = time.monotonic() + LIVELY
        bars[0][0].update(bars[0][1], completed=part)

    if not silent:
        begin()
    try:
        yield show
    finally:
        for bar, _ in bars:
            bar.stop()
