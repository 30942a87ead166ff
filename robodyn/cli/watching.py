"""A run that is watched: a progress bar on a terminal, an end in order after a signal."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from robodyn.cli import signals
from robodyn.cli.progress import progress
from robodyn.simulation.recording import Outcome, StopRun

PATIENCE = 0.4  # s that a run has to come to the end of a step after a signal; and then to finish


@contextmanager
def watching(duration: float, quiet: bool) -> Iterator[Callable[[float], bool]]:
    """A watch for the run: moves a progress bar, and asks it to stop after a signal.

    A run that does not come to the end of its step is stopped within it; and what does not come to
    its end after that (a pipe that nobody reads), or gets another signal, ends at once.
    """
    stopped: list[int] = []
    told = False  # whether the run knows

    def stop(number: int, frame: FrameType | None) -> None:
        if stopped:
            signals.end(number, frame)
        stopped.append(number)
        signals.note(number)
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, PATIENCE, PATIENCE)

    def urge(_: int, frame: FrameType | None) -> None:
        nonlocal told
        stopped.append(stopped[0])
        if len(stopped) > 2:
            signals.end(stopped[0], frame)
        if not told:
            told = True
            raise StopRun(Outcome.INTERRUPTED)

    alarms = hasattr(signal, "setitimer")
    urged = signal.signal(signal.SIGALRM, urge) if alarms else None
    before = signals.answer(stop)
    try:
        with progress("simulating", quiet or duration == 0.0) as show:

            def watch(t: float) -> bool:
                nonlocal told
                show(t / duration)
                told = told or bool(stopped)
                return bool(stopped)

            yield watch
    except StopRun:  # before there was a run
        signals.end(stopped[0])
    finally:
        if alarms:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, urged)
        for number, handler in before.items():
            signal.signal(number, handler)
