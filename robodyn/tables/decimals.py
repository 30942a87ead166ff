"""Many plain decimal numbers at once, by numpy: each the float nearest to it, as `float` gives.

A number such as -1.5707963267948966 is a whole number over a power of ten, both without rounding.
Their quotient is had to twice the digits of a float; where its rounding might still be in doubt
(it never is but next to a tie) nobody is told a number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn.tables.arrays import Array

TENS = np.array([float(f"1e{k}") for k in range(23)])  # those that are floats
COMMAS = bytes.maketrans(b"\n", b",")
PIECE = 512  # lines that stay in cache
LARGEST = 2**62
SPLITTER = 2.0**27 + 1.0  # parts a float in two of half as many digits
DOUBT = 2.0**-98  # of a quotient, more than it is off


def decimals(lines: Sequence[str], width: int, places: Sequence[int]) -> Array | None:
    """The columns `places` (n, k) of n lines of `width` fields, all digits with a point inside.

    None where there is another field or another number of them.
    """
    if len(lines) > PIECE:
        parts = [decimals(lines[k : k + PIECE], width, places) for k in range(0, len(lines), PIECE)]
        sure = [x for x in parts if x is not None]
        return np.concatenate(sure) if len(sure) == len(parts) else None
    written = "\n".join([*lines, ""]).encode()
    if written.translate(None, b"0123456789.-,\n"):
        return None
    code = np.frombuffer(written, np.uint8)
    ends = np.flatnonzero((code == ord(",")) | (code == ord("\n")))
    points = np.flatnonzero(code == ord("."))
    if not len(points) == len(ends) == width * len(lines):
        return None
    begins = np.append(0, ends[:-1] + 1)
    negative, after = code[begins] == ord("-"), ends - points - 1
    sound = (begins <= points) & (after >= 0) & (after < len(TENS))
    sound &= ends - begins > 1 + negative  # it has digits
    minuses = np.count_nonzero(code == ord("-")) == np.count_nonzero(negative)
    if not (sound.all() and minuses and (code[ends[width - 1 :: width]] == ord("\n")).all()):
        return None
    whole = np.fromstring(written.translate(COMMAS, b"."), np.int64, sep=",")
    whole, after, negative = (x.reshape(-1, width)[:, places] for x in (whole, after, negative))
    if not -LARGEST < whole.min() <= whole.max() < LARGEST:  # too long, and cut
        return None
    ten, high = TENS[after], whole.astype(float)
    low = (whole - high.astype(np.int64)).astype(float)
    near = high / ten
    product = near * ten
    (a, b), (c, d) = _halves(near), _halves(ten)
    missing = high - product - (((a * c - product) + a * d + b * c) + b * d) + low
    rest, doubt = missing / ten, DOUBT * np.abs(near)
    found = near + (rest + doubt)
    if (found != near + (rest - doubt)).any():
        return None
    signed: Array = np.copysign(found, np.where(negative, -1.0, 1.0))
    return signed


def _halves(x: Array) -> tuple[Array, Array]:
    """Two floats of half as many digits, whose sum x is."""
    y = SPLITTER * x
    high = y - (y - x)
    return high, x - high
