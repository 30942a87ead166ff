"""The units of the columns that commands write and read, by their names."""

from __future__ import annotations

import re

UNITS = {
    "t": "s",
    "q": "rad",
    "qd": "rad/s",
    "qdd": "rad/s²",
    "tau": "N m",
    "fx": "N",
    "fy": "N",
    "tc": "N m",
    "rx": "N",
    "ry": "N",
    "shake_fx": "N",
    "shake_fy": "N",
    "shake_m": "N m",
    "KE": "J",
    "PE": "J",
    "energy": "J",
    "gap": "m",
    "flip": "s",
    "flip_time": "s",
    "e": "rad",
    **{f"{part}_{axis}": "m" for part in ("joint", "tip", "centre") for axis in "xy"},
    **{f"{part}_v{axis}": "m/s" for part in ("joint", "tip", "centre") for axis in "xy"},
}


def quantity_of(name: str) -> str:
    """A column's name less the number of its link or closure: `q` of `q1`."""
    return name.rstrip("0123456789") or name


def unit_of(name: str) -> str:
    """The unit of a column, also of its end, least or largest value; "" where none is known."""
    return UNITS.get(quantity_of(re.sub("_(end|min|max)$", "", name)), "")
