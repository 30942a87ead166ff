"""A run that is watched: a progress bar on a terminal, an end at a whole step after a signal."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robodyn.cli import ending_signals

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

SILENT = 0.5  # s before a progress bar appears


@contextmanager
def watching(duration: float, quiet: bool) -> Iterator[Callable[[float], bool]]:
    """A watch for the run: moves a progress bar, and asks it to stop after Ctrl-C and the like."""
    stopped: list[int] = []

    def stop(number: int, _: object) -> None:
        if stopped:  # a second Ctrl-C does not wait for the step to end
            raise KeyboardInterrupt
        stopped.append(number)

    numbers = (signal.SIGINT, *ending_signals())
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        with progress("simulating", quiet or duration == 0.0) as advance:

            def watch(t: float) -> bool:
                advance(t / duration if duration else 1.0)
                return bool(stopped)

            yield watch
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def progress(told: str, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A function of the part that is done: it moves a bar on a terminal, after a while."""
    begun = time.monotonic()
    shows = sys.stderr.isatty() and not quiet
    bar: list[tuple[Progress, TaskID]] = []

    def advance(part: float) -> None:
        if shows and time.monotonic() - begun > SILENT:
            if not bar:
                bar.append(_progress_bar(told))
            bar[0][0].update(bar[0][1], completed=part)

    try:
        yield advance
    finally:
        if bar:
            bar[0][0].stop()


def _progress_bar(told: str) -> tuple[Progress, TaskID]:
    from rich.console import Console
    from rich.progress import Progress

    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task(told, total=1.0)
    bar.start()
    return bar, task
