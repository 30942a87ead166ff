"""Signals that end a command, so that open files are tidied up."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Mapping
from types import FrameType
from typing import Any, NoReturn

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
    """End the command at once, as one that the signal has ended."""
    note(number)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)
