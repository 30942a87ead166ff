"""Rows of floats as text, and back: as `repr` writes them, as `float` reads them.

By orjson where it is there (the extra `fast`), else by Python and numpy: the bytes are the same.

orjson writes 2e-05 as 0.00002, and its versions differ above 1e16, so rows with a value of such a
size are left to `repr`.  It reads JSON alone: of other notations (+1, .5), and of -0, which it
takes for a whole number without a sign, nothing is read by it.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import repeat
from typing import Any

import numpy as np

from robodyn.tables.arrays import Array

FEW = 500  # numbers that Python reads or writes in less time than an import takes
PIECE = 2048  # numbers that are lists of Python's at once
ALIKE = (1e-10, 1e-4, 1e16)  # below the first, and from the second to the third, orjson is `repr`
IN_NUMBERS = b"0123456789+-.eE,\n"


@cache
def _orjson() -> Any:
    """The module, or None where it is not installed.

    Its first steps import other modules and do not look whether that failed: an exception of a
    signal's handler there would end the process by a segmentation fault.
    """
    with _signals_wait():
        try:
            import orjson
        except ImportError:
            return None
        orjson.dumps(np.zeros((1, 1)), option=orjson.OPT_SERIALIZE_NUMPY)
    return orjson


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Handlers of signals in Python wait for the end of the block."""
    if threading.current_thread() is not threading.main_thread():  # no handler is called in others
        yield
        return
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    received: list[int] = []
    for number in handlers:
        signal.signal(number, lambda number, _: received.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for late in received:
        signal.raise_signal(late)


def written(values: Array) -> list[str]:
    """Return the rows of values (n, k) as text, with commas between the fields."""
    module = _orjson() if values.size >= FEW else None
    if module is None:
        return [",".join(map(repr, row)) for row in values.tolist()]
    size = np.abs(values)
    tiny, least, most = ALIKE
    alike = (size < tiny) | ((size >= least) & (size < most))
    data = module.dumps(np.ascontiguousarray(values), option=module.OPT_SERIALIZE_NUMPY)
    lines: list[str] = data[2:-2].decode().split("],[")
    for row in np.flatnonzero(~alike.all(axis=1)).tolist():
        lines[row] = ",".join(map(repr, values[row].tolist()))
    return lines


def read(rows: Sequence[str], width: int, places: Sequence[int]) -> Array | None:
    """Return the columns `places` (n, k) of n rows of `width` fields; all finite, or None.

    None if a row has another number of fields, or if a field of these is no such number.
    """
    found = None
    if len(rows) * width >= FEW and (module := _orjson()) is not None:
        found = _by_orjson(module, rows, width)
    if found is not None:
        found = found[:, list(places)]
    else:
        # loadtxt parses exactly, but given columns does not mind rows of unequal length
        if set(map(str.count, rows, repeat(","))) != {width - 1}:
            return None
        try:
            plain: Any = {"delimiter": ",", "comments": None, "encoding": None}
            found = np.loadtxt(rows, usecols=places, ndmin=2, **plain)
        except ValueError:
            return None
    return found if np.isfinite(found).all() else None


def _by_orjson(module: Any, rows: Sequence[str], width: int) -> Array | None:
    """All fields (n, width) of rows of numbers; None for other rows."""
    step = max(1, PIECE // width)
    parts = [_piece(module, rows[k : k + step], width) for k in range(0, len(rows), step)]
    whole = [part for part in parts if part is not None]
    return np.concatenate(whole) if len(whole) == len(parts) else None


def _piece(module: Any, rows: Sequence[str], width: int) -> Array | None:
    data = "\n".join(rows).encode()
    if data.translate(None, IN_NUMBERS) or _has_whole_minus_zero(data):
        return None
    try:
        found = np.array(module.loads(b"[[" + data.replace(b"\n", b"],[") + b"]]"), float)
    except ValueError:  # no JSON, or rows of unequal length
        return None
    return found if found.shape == (len(rows), width) else None


def _has_whole_minus_zero(data: bytes) -> bool:
    """Whether a field ends with -0, which JSON reads as a whole number without a sign."""
    return b"-0," in data or b"-0\n" in data or data.endswith(b"-0")
