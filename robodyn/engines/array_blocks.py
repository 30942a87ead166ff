"""Recorded formulas on arrays of many states, in blocks that fit the cache, on several threads.

numpy and machine code let other threads run while they work on a block, so threads share the blocks
of one call.  Block size and number of threads were chosen by `make bench`.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from robodyn.engines.expression import FUNCTIONS, Expression, Value, needed
from robodyn.tables.arrays import Array

BLOCK = 8192
MAX_THREADS = 4


def shared(total: int, share: int, piece: int, run: Callable[[int, int, int], object]) -> None:
    """Call run(thread, first, stop) for pieces of 0 .. total, in several threads.

    A thread is started per `share` items.  An exception in one thread, Ctrl-C included, stops all
    others after their current piece.
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


def _choose(x: Any, y: Any, a: Any, b: Any, out: Array) -> None:
    np.copyto(out, np.where(np.less(x, y), a, b))


_CALLS: dict[str, Callable[..., object]] = {name: getattr(np, name) for name in FUNCTIONS}
_CALLS |= {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "neg": np.negative}
_CALLS |= {"pow": np.power, "rough": np.power, "abs": np.absolute, "atan2": np.arctan2}
_CALLS["choose"] = _choose


class ArrayFormula:
    """A recorded formula on arrays of states: one numpy call per node and block of states.

    `inputs` are names of the columns of states, `outputs` the columns of results.  Parameters take
    their values from the graph.
    """

    def __init__(self, inputs: Sequence[str], outputs: Sequence[Value]) -> None:
        # A call finds its arguments and its result in a table: columns of states, columns of
        # results, work buffers, and numbers, which are counted from the end.
        self._calls: list[tuple[Callable[..., object], Callable[[Any], Any]]] = []
        self._numbers: list[float] = []
        self._buffers = 0
        places = {name: i for i, name in enumerate(inputs)}
        results = range(len(inputs), len(inputs) + len(outputs))
        ends = [_meant(x) for x in outputs]
        nodes = [x for x in needed(outputs) if _meant(x) is x and x.op != "var"]
        arguments = {x.index: [_meant(a) for a in x.args] for x in nodes}
        last = {a.index: x.index for x in nodes for a in arguments[x.index] if _is_node(a)}
        target = {x.index: to for x, to in zip(ends, results, strict=True) if _is_node(x)}
        at: dict[int, int] = {}
        free: list[int] = []

        def place(a: Any) -> int:
            if not isinstance(a, Expression):
                self._numbers.append(float(a))
                return -len(self._numbers)
            return places[str(a.args[0])] if a.op == "var" else at[a.index]

        for node in nodes:
            args, index = arguments[node.index], node.index
            read = [place(a) for a in args]
            # the last node that reads a buffer may write to it
            free += {at[a.index] for a in args if _is_node(a) and last[a.index] == index}
            if index not in last:
                at[index] = target[index]
            else:
                if not free:
                    free.append(results.stop + self._buffers)
                    self._buffers += 1
                at[index] = free.pop()
            self._calls.append((_CALLS[node.op], itemgetter(*read, at[index])))
            if target.get(index, at[index]) != at[index]:
                self._calls.append((np.positive, itemgetter(at[index], target[index])))
        for end, to in zip(ends, results, strict=True):
            if not _is_node(end):
                self._calls.append((np.positive, itemgetter(place(end), to)))
            elif target[end.index] != to:  # the same node is two outputs
                self._calls.append((np.positive, itemgetter(target[end.index], to)))

    def fill(self, states: Sequence[Array], results: Sequence[Array]) -> None:
        """Fill the columns of `results` (T, k) from the rows of `states` (T, n).

        A singular state raises no warning; the caller has to look for values that are not finite.
        """
        total = len(states[0])
        numbers = self._numbers[::-1]
        rooms: dict[int, Array] = {}

        def run(thread: int, first: int, stop: int) -> None:
            if thread not in rooms:
                rooms[thread] = np.empty((self._buffers, min(BLOCK, total)))
            columns = [column for array in (*states, *results) for column in array[first:stop].T]
            table = [*columns, *rooms[thread][:, : stop - first], *numbers]
            with np.errstate(all="ignore"):
                for call, pick in self._calls:
                    call(*pick(table))

        shared(total, 4 * BLOCK, BLOCK, run)


def _meant(a: Any) -> Any:
    """Return the node behind `keep` nodes; the number of a constant node."""
    while isinstance(a, Expression) and a.op == "keep":
        a = a.args[0]
    return a.number if isinstance(a, Expression) and a.constant else a


def _is_node(a: object) -> bool:
    """Return whether it is a node that must be computed."""
    return isinstance(a, Expression) and a.op != "var"
