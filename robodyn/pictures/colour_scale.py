"""Values to colours and colours to values: linear or logarithmic scales, their ticks, a palette."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.pictures.chart import limits, multiples, tick_texts, ticks
from robodyn.tables.arrays import Array

Rgb = tuple[int, int, int]

# Okabe and Ito's colours, which colour-blind people tell apart
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#222222")
NONE = "#d4d4d4"  # a point without a value
# matplotlib's viridis (van der Walt and Smith, 2015) at 17 even places: as much lighter as larger
VIRIDIS = (
    *("#440154", "#48186a", "#472d7b", "#424086", "#3b528b", "#33638d", "#2c728e", "#26818e"),
    *("#21908c", "#1f9f88", "#28ae80", "#3ebc74", "#5dc963", "#82d34c", "#abdc32", "#d5e21a"),
    "#fde725",
)
LEVELS = 160  # shades of a scale


class ColourScale(NamedTuple):
    """The values from `low` to `high`, linear or logarithmic, over [0, 1]."""

    low: float
    high: float
    log: bool

    def fraction(self, values: Array) -> Array:
        """How far values are along the scale, 0 to 1; nan stays nan.  Shapes as given."""
        low, high = self.low, self.high
        if self.log:
            values, low, high = np.log(values), math.log(low), math.log(high)
        # in halves: high - low itself may overflow
        far = (0.5 * values - 0.5 * low) / (0.5 * high - 0.5 * low)
        return np.asarray(np.clip(far, 0.0, 1.0))

    def ticks(self, most: int) -> tuple[list[float], list[str]]:
        """At most `most` round values along the scale, and their texts."""
        values = log_ticks(self.low, self.high, most) if self.log else []
        if len(values) < 2:
            values = ticks(self.low, self.high, most)
        return values, tick_texts(values)


def colour_scale(values: Array, log: bool) -> ColourScale | None:
    """The scale of values (k,) of which some may be nan; None where all are.

    A logarithmic one takes values > 0.
    """
    there = values[np.isfinite(values)]
    if not len(there):
        return None
    if not log:
        return ColourScale(*limits([there]), False)
    low, high = float(there.min()), float(there.max())
    if high - low <= 1e-12 * high:
        low, high = max(0.5 * low, math.ulp(0.0)), 2.0 * high
    return ColourScale(low, high, True)


def log_ticks(low: float, high: float, most: int) -> list[float]:
    """At most `most` of 1, 2 and 5, or 1, times powers of ten (or of 100, ...) in [low, high]."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    found: list[float] = []
    for factors, apart in [("125", 1), ("13", 1), *(("1", k) for k in range(1, 700))]:
        powers = range(math.ceil(first / apart) * apart, last + 1, apart)
        marks = [float(f"{factor}e{power}") for power in powers for factor in factors]
        found = [mark for mark in marks if low * (1 - 1e-9) <= mark <= high * (1 + 1e-9)]
        if len(found) <= most:
            break
    return found


def angle_ticks(low: float, high: float, most: int) -> tuple[list[float], list[str]]:
    """Ticks of an axis in radians: multiples of pi/4, pi/2 or pi where there are three or more."""
    for parts, factor in ((4, 1), (2, 1), (1, 1), (1, 2), (1, 5), (1, 10)):
        apart = math.pi * factor / parts
        numbers = multiples(low, high, apart)
        if len(numbers) <= most:
            break
    if not 3 <= len(numbers) <= most:
        values = ticks(low, high, most)
        return values, tick_texts(values)
    return [k * apart for k in numbers], [_multiple_of_pi(k * factor, parts) for k in numbers]


def _multiple_of_pi(number: int, parts: int) -> str:
    shared = math.gcd(number, parts)
    number, parts = number // shared, parts // shared
    text = {0: "0", 1: "π", -1: "-π"}.get(number, f"{number}π")
    return f"{text}/{parts}" if parts > 1 and number else text


def rgb(colour: str) -> Rgb:
    """Red, green and blue of `#rrggbb`, 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def viridis(fractions: Array) -> NDArray[np.uint8]:
    """The colours (..., 3) of fractions (...), 0 dark to 1 bright."""
    places = np.linspace(0.0, 1.0, len(VIRIDIS))
    parts = np.array([rgb(colour) for colour in VIRIDIS], float).T
    shades = np.stack([np.interp(fractions, places, part) for part in parts], axis=-1)
    return np.asarray(np.round(shades), np.uint8)


def word_colours(count: int) -> list[Rgb]:
    """A colour for each of so many words: those that differ most while they last."""
    if count <= len(COLOURS):
        return [rgb(colour) for colour in COLOURS[:count]]
    return [(r, g, b) for r, g, b in viridis(np.linspace(0.0, 1.0, count)).tolist()]


def painted(values: Array, scale: ColourScale | None, words: Sequence[str]) -> NDArray[np.uint8]:
    """Colours (..., 3) of values (...): numbers on the scale, or places in `words`; nan is NONE."""
    if scale is None:
        table, places = np.array([*word_colours(len(words)), rgb(NONE)], np.uint8), values
    else:
        table, places = viridis(np.linspace(0.0, 1.0, LEVELS)), scale.fraction(values)
        places = np.rint(places * (LEVELS - 1))
    shades: NDArray[np.uint8] = table[np.nan_to_num(places).astype(int)]
    shades[np.isnan(values)] = rgb(NONE)
    return shades
