"""Many states through generated array code: blocks that stay in cache, shared among threads.

numpy lets other threads run while it works on a block, and so does machine code; threads share the
blocks of one call.  Block size and thread limit are where `make bench` found the least time a
state.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence

import numpy as np

from robodyn.engines.straightline import ArrayFunction
from robodyn.tables.arrays import Array

BLOCK = 8192
MAX_THREADS = 4


def shared(total: int, share: int, piece: int, run: Callable[[int, int, int], object]) -> None:
    """run(thread, first, stop) over pieces of 0 .. total, `share` of which are worth a thread.

    What one thread raises, Ctrl-C too, ends all after their pieces.
    """
    threads = max(1, min(MAX_THREADS, total // share))
    if threads > 1:  # the system is asked for those there are
        threads = min(threads, os.cpu_count() or 1)
    bounds = [total * k // threads for k in range(threads + 1)]
    failures: list[BaseException] = []

    def work(k: int) -> None:
        try:
            for first in range(bounds[k], bounds[k + 1], piece):
                if failures:
                    return
                run(k, first, min(first + piece, bounds[k + 1]))
        except BaseException as failure:  # re-raised below, in the caller's thread
            failures.append(failure)

    others = [threading.Thread(target=work, args=(k,)) for k in range(1, threads)]
    for thread in others:
        thread.start()
    work(0)
    for thread in others:
        thread.join()
    if failures:
        raise failures[0]


def evaluate(
    function: ArrayFunction, buffers: int, inputs: Sequence[Array], outputs: Sequence[Array]
) -> None:
    """Run `function` over the rows of `inputs` (T, n) and fill the columns of `outputs` (T, k)."""
    total = len(inputs[0])
    rooms: dict[int, Array] = {}

    def run(thread: int, first: int, stop: int) -> None:
        if thread not in rooms:
            rooms[thread] = np.empty((buffers, min(BLOCK, total)))
        columns = [column for array in (*inputs, *outputs) for column in array[first:stop].T]
        with np.errstate(all="ignore"):  # a singular state is the caller's to find
            function(*columns, *rooms[thread][:, : stop - first])

    shared(total, 4 * BLOCK, BLOCK, run)
