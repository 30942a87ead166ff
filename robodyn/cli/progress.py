"""A progress bar on a terminal, for work that takes a while, and signals that end it in order.

rich comes in when the bar shows; open files are tidied up, a run comes to its end.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any, NoReturn

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


PATIENCE = 0.4  # s that a run has to come to the end of a step after a signal; and then to finish
LONG = 25  # times as long, as long as it works: on a table of hundred thousands of events
WORKS = 0.1  # of the time; a process that waits takes less of it on the processor
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU")  # not all of them are everywhere
ENDING = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]

received: list[int] = []  # by this process, in order


def answer(handler: Callable[[int, FrameType | None], Any]) -> Mapping[int, Any]:
    """Let `handler` answer the signals, less those ignored as under nohup; the ones before."""
    before = {number: signal.getsignal(number) for number in ENDING}
    before = {number: old for number, old in before.items() if old != signal.SIG_IGN}
    for number in before:
        signal.signal(number, handler)
    return before


def note(number: int) -> None:
    """A signal has come: of what it breaks off (a callback of a compiler's) nothing is told."""
    received.append(number)
    sys.unraisablehook = lambda _: None


def end(number: int, _: FrameType | None = None) -> NoReturn:
    """End the command at once, as one that the signal has ended.

    C code may drop the exception that is raised in it (an import of numpy, a callback): then it is
    raised once more.
    """
    note(number)
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda *_: end(number))
        signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


@contextmanager
def watching(duration: float, quiet: bool) -> Iterator[Callable[[float], bool]]:
    """A watch for the run: moves a progress bar, and asks it to stop after a signal.

    A run that does not come to the end of its step is stopped within it; and what waits after that
    (for a pipe that nobody reads), works for too long, or gets another signal, ends at once.
    """
    from robodyn.runs.report import InterruptedRun

    stopped: list[int] = []
    told = False  # whether the run knows, or has come to its end
    worked = 0.0  # s of the processor

    def stop(number: int, frame: FrameType | None) -> None:
        if stopped:
            end(number, frame)
        stopped.append(number)
        note(number)
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, PATIENCE, PATIENCE)

    def urge(_: int, frame: FrameType | None) -> None:
        nonlocal told, worked
        stopped.append(stopped[0])
        before, worked = worked, time.process_time()
        waits = worked - before < WORKS * PATIENCE
        if len(stopped) > 2 and (waits or len(stopped) > LONG):
            end(stopped[0], frame)
        if not told:
            told = True
            raise InterruptedRun

    alarms = hasattr(signal, "setitimer")
    urged = signal.signal(signal.SIGALRM, urge) if alarms else None
    before = answer(stop)
    try:
        with progress("simulating", quiet or duration == 0.0) as show:

            def watch(t: float) -> bool:
                nonlocal told
                show(t / duration)
                told = told or bool(stopped) or t == duration
                return bool(stopped)

            yield watch
    except InterruptedRun:  # before there was a run
        end(stopped[0])
    finally:
        if alarms:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, urged)
        for number, handler in before.items():
            signal.signal(number, handler)
