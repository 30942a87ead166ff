"""A progress bar on a terminal, for work that takes a while; rich comes in when it shows."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

SILENT = 0.5  # s before a progress bar appears
LIVELY = 0.05  # s from one of its pictures to the next


@contextmanager
def progress(
    doing: str, quiet: bool = False, silent: float | None = None
) -> Iterator[Callable[[float], object]]:
    """A function that moves a bar to a part of the whole; on a terminal, after `silent` seconds."""
    if quiet or not sys.stderr.isatty():
        yield lambda part: None
        return
    due = time.monotonic() + (SILENT if silent is None else silent)
    bar: Any = None
    with ExitStack() as shown:

        def show(part: float) -> None:
            nonlocal bar, due
            if time.monotonic() < due:
                return
            if bar is None:
                from rich.console import Console
                from rich.progress import Progress

                bar = Progress(console=Console(stderr=True), transient=True)
                bar.add_task(doing, total=1.0)
                shown.enter_context(bar)
            due = time.monotonic() + LIVELY
            bar.update(bar.task_ids[0], completed=part)

        show(0.0)
        yield show
