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

    begun = time.monotonic()
    shows = sys.stderr.isatty() and not quiet and duration != 0.0
    bar: list[tuple[Progress, TaskID]] = []

    def watch(t: float) -> bool:
        if shows and time.monotonic() - begun > SILENT:
            if not bar:
                bar.append(_progress_bar())
            bar[0][0].update(bar[0][1], completed=t / duration)
        return bool(stopped)

    numbers = (signal.SIGINT, *ending_signals())
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield watch
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if bar:
            bar[0][0].stop()


def _progress_bar() -> tuple[Progress, TaskID]:
    from rich.console import Console
    from rich.progress import Progress

    progress = Progress(console=Console(stderr=True), transient=True)
    task = progress.add_task("simulating", total=1.0)
    progress.start()
    return progress, task
