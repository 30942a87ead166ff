"""Sine and cosine of the machine code beside exact ones, in units of the last place."""

from __future__ import annotations

import ctypes
from functools import lru_cache

import numpy as np

from robodyn.engines import machine, segment
from robodyn.engines.assembler import ADDRESS, WHOLE, Kernel, Module


def mapped(processor, write, inputs=1):
    """A kernel `run(count, x..., y...)` of a function of words, for arrays of W times any number.

    `write(kernel, words)` gives the words of the results.
    """
    module = Module(processor.lanes)
    results = 2
    k = Kernel(module, "run", (WHOLE, *[ADDRESS] * (inputs + results)))
    count, *places = k.arguments
    with k.loop(count, step=k.lanes) as i:
        words = write(k, [k.load(k.at(place, i)) for place in places[:inputs]])
        for word, place in zip(words, places[inputs:], strict=False):
            k.store(word, k.at(place, i))
    k.done(k.whole(0))
    return module.text


def run(write, *x, family="", level=2):
    """Two results of `write` for arrays."""
    code = machine.make(lambda p: mapped(p, write, len(x)), level=level, family=family)
    assert code is not None
    total = len(x[0])
    length = -(-total // 8) * 8
    columns = [np.resize(np.asarray(a, float), length) for a in x]
    found = np.full((2, length), np.nan)
    function = code.function("run", ctypes.c_int64, *[ctypes.c_void_p] * (len(x) + 2))
    function(length, *(a.ctypes.data for a in (*columns, *found)))
    return found[:, :total]


def sine_and_cosine(x, family="", level=2):
    """(2, T)."""

    def write(k, words):
        return segment.sine_cosine(k, words[0])

    return run(write, x, family=family, level=level)


@lru_cache(maxsize=1)
def hard_angles(count):
    """Angles to 1e5 rad of all sizes, and next to multiples of pi/4."""
    rng = np.random.default_rng(5)
    share = count // 4
    wide, small = rng.uniform(-1e5, 1e5, share), rng.uniform(-10.0, 10.0, share)
    sizes = 10.0 ** rng.uniform(-12, 5, share) * rng.choice([-1.0, 1.0], share)
    turns = rng.integers(1, 127_000, count - 3 * share) * (np.pi / 4)
    beside = turns * (1.0 + rng.integers(-2, 3, turns.size) * 2.0**-52)
    return np.concatenate([wide, small, sizes, beside])
