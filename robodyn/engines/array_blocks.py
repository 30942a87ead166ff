"""Many states through generated array code: blocks that stay in cache, shared among threads.

numpy lets other threads run while it works on a block, so threads share the blocks of one call.
Block size and thread limit are where `make bench` found the least time a state.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.straightline import ArrayFunction

BLOCK = 8192
MAX_THREADS = 4

Array = NDArray[np.float64]


def evaluate(
    function: ArrayFunction, buffers: int, inputs: Sequence[Array], outputs: Sequence[Array]
) -> None:
    """Run `function` over the rows of `inputs` (T, n) and fill the columns of `outputs` (T, k)."""
    total = inputs[0].shape[0]
    threads = max(1, min(MAX_THREADS, os.cpu_count() or 1, total // (4 * BLOCK)))
    share = -(-total // threads)
    failures: list[BaseException] = []

    def run(begin: int, end: int) -> None:
        work = np.empty((buffers, min(BLOCK, max(end - begin, 1))))
        try:
            with np.errstate(all="ignore"):  # a singular state is the caller's to find
                for i in range(begin, end, BLOCK):
                    j = min(i + BLOCK, end)
                    columns = [column for array in (*inputs, *outputs) for column in array[i:j].T]
                    function(*columns, *work[:, : j - i])
        except BaseException as failure:  # re-raised below, in the caller's thread
            failures.append(failure)

    others = [
        threading.Thread(target=run, args=(k * share, min((k + 1) * share, total)))
        for k in range(1, threads)
    ]
    for thread in others:
        thread.start()
    run(0, min(share, total))
    for thread in others:
        thread.join()
    if failures:
        raise failures[0]
