"""Rows of motions in lanes at given times, from the series of each step.

The times that are asked for are the same in each lane, but lanes come by them in different steps:
each has a next row of its own, and writes it where its step has reached it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.engines.assembler import SCALAR, Kernel, Word
from robodyn.engines.lane_driver import LEFT, Observer

Array = NDArray[np.float64]

END, ROW = "end", "row"  # a lane's whole time, fixed; its next row, kept


def work_array(times: Array, motions: int, width: int) -> tuple[Array, Array]:
    """The array for the driver, and within it the rows (motions, times, width), nan so far."""
    count = len(times)
    work = np.full(1 + count + motions * count * width, np.nan)
    work[0], work[1 : 1 + count] = count, times
    return work, work[1 + count :].reshape(motions, count, width)


def rows_of(series: Sequence[Sequence[str]]) -> Observer:
    """An observer that writes values of these series, the names of coefficients from order 0.

    Its driver has END among what is fixed and ROW among what is kept, shows the coefficients, and
    gets a `work_array` of as many motions as its lanes hold, padding included.
    """

    def observe(k: Kernel, words: Mapping[str, Word], places: Mapping[str, Word]) -> None:
        work, width = words["work"], k.whole_lanes(len(series))
        count = k.spread(k.load(work, SCALAR))
        whole_count = k.convert("fptosi", count, k.wholes)
        times = k.at(work, 1)
        values = k.at(times, k.convert("fptosi", k.load(work, SCALAR), "i64"))
        lanes = [k.add(words["motion"], k.whole(i)) for i in range(k.lanes)]
        first = k.multiply(k.gathered(lanes), whole_count)
        begin = k.subtract(words[END], words[LEFT])
        arrived = k.compare("oeq", words[f"after_{LEFT}"], k.number(0.0))
        with k.forever() as done:
            row = k.load(places[ROW])
            there = k.both(words["active"], k.less(row, count))
            index = k.convert("fptosi", k.select(there, row, k.number(0.0)), k.wholes)
            t = gather(k, times, index)
            x = k.subtract(t, begin)
            last = k.both(arrived, k.compare("ole", t, words[END]))  # rounding does not lose it
            reached = k.either(k.compare("ole", x, words["h"]), last)
            due = k.both(there, reached)
            k.leave(k.invert(k.any(due)), done)
            begins = k.multiply(k.add(first, index), width)
            for c, names in enumerate(series):
                total = words[names[-1]]
                for name in reversed(names[:-1]):
                    total = k.add(k.multiply(total, x), words[name])
                scatter(k, total, values, k.add(begins, k.whole_lanes(c)), due)
            k.store(k.select(due, k.add(row, k.number(1.0)), row), places[ROW])

    return observe


def gather(kernel: Kernel, base: Word, indices: Word) -> Word:
    """From an array of doubles the items of these indices, one a lane."""
    k = kernel
    return k.gathered([k.load(k.at(base, k.lane(indices, i)), SCALAR) for i in range(k.lanes)])


def scatter(kernel: Kernel, value: Word, base: Word, indices: Word, mask: Word) -> None:
    """Each lane to its item of an array of doubles, where the mask is set."""
    k, aside = kernel, kernel.room(SCALAR, 1)
    for i in range(k.lanes):
        place = k.at(base, k.lane(indices, i))
        k.store(k.lane(value, i), k.select(k.lane(mask, i), place, aside))
