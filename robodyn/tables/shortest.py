"""Many floats as text at once and back, by numpy: as `repr` writes them, as `float` reads them.

With s places so that 10^s times the gap between floats near x lies between 1 and 10, x 10^s is had
without rounding, as a whole number and a fraction.  What lies within half a gap of it reads back as
x: a multiple of ten there (there is one at most), or else the nearest whole number, is the answer,
less its zeros at the end.  At powers of two, where the gap below is half as wide, the answer is
x 10^s itself.  Floats that are below 2^-10, from 10,000 on, not finite, or at an end of what reads
back as them are left to `repr`.

A text such as -1.5707963267948966 is a whole number over a power of ten, both without rounding.
Their quotient is had to twice the digits of a float; where its rounding might still be in doubt
(it never is but next to a tie) nobody is told a number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.tables.arrays import Array, Truth

Whole = NDArray[np.int64]

PIECE = 8192  # floats whose numbers stay in cache
LEAST, MOST = 2.0**-10, 1e4
LOWEST, GAPS = 1023 - 10, 2.0 ** np.arange(-62, -38)  # by the exponent of two, from LEAST on
PLACES = np.floor(-np.log10(GAPS)).astype(np.int64) + 1
TENS = np.array([10**s for s in PLACES.tolist()], np.uint64)
SHIFTS = np.array([10 ** (19 - s) for s in PLACES.tolist()], np.uint64)  # to 19 places
SCALES = TENS.astype(float)
HALVES = 0.5 * GAPS * SCALES
UPPER = ~((1 << 27) - 1)  # of the bits of a float, the half that a product keeps whole
SCALES_UPPER = (SCALES.view(np.int64) & UPPER).view(float)

COUNT = 10_000  # of whole numbers of four digits


def _groups() -> tuple[NDArray[np.uint32], NDArray[np.uint64], NDArray[np.int8]]:
    """Four digits; a comma, a sign and digits; the characters of the latter, (2 COUNT,).

    Groups are little-endian numbers: the first character is the lowest byte.
    """
    count = np.arange(COUNT)[:, None]
    digits = count // [1000, 100, 10, 1] % 10 + ord("0")
    four = (digits << [0, 8, 16, 24]).sum(axis=1).astype("<u4")
    width = 1 + (count >= [10, 100, 1000]).sum(axis=1)
    whole = four.astype("<u8") >> (8 * (4 - width)).astype("<u8")  # without the zeros before it
    heads = np.concatenate([whole << 8 | ord(","), whole << 16 | ord("-") << 8 | ord(",")])
    return four, heads, np.concatenate([1 + width, 2 + width]).astype(np.int8)


FOUR, HEADS, WIDTHS = _groups()
THREE = (FOUR[:1000] & 0xFFFFFF00 | ord(".")).astype("<u4")
SPAN = 32  # bytes of a text of any float, with its comma, and more than it needs


def shortest(values: Array) -> str:
    """The rows of values (n, k), n k > 0, with commas between the fields and a line end a row."""
    n, k = values.shape
    step = max(1, PIECE // k)
    pieces = [_written(values[begin : begin + step]) for begin in range(0, n, step)]
    return b"".join(pieces)[1:].decode() + "\n"


def _written(values: Array) -> bytes:
    """The same with a line end before each row."""
    x = values.ravel()
    size, zero = np.abs(x), x == 0.0
    within = (size >= LEAST) & (size < MOST)
    y = np.where(within, size, 1.0)
    of = (y.view(np.int64) >> 52) - LOWEST
    found, places, unsure = _digits(y, of)
    integer = y.astype(np.int64)
    rest = (found.view(np.uint64) - integer.view(np.uint64) * TENS[of]) * SHIFTS[of]
    head = integer - zero + COUNT * np.signbit(x)
    texts = _texts(head, rest)
    lengths = np.stack([WIDTHS[head], places + 1], axis=-1)

    characters = texts.view(np.uint8)
    left = np.flatnonzero(~(within | zero) | unsure)
    if len(left):
        given = [b"," + repr(value).encode() for value in x[left].tolist()]
        characters[left, 0] = np.array(given, f"S{SPAN}").view(np.uint8).reshape(-1, SPAN)
        lengths[left] = 0
        lengths[left, 0] = list(map(len, given))
    characters[:: values.shape[1], 0, 0] = ord("\n")

    # each text begins where that before it ends, and is written over what is too much of that
    ends = np.cumsum(lengths.ravel())
    line = np.empty(int(ends[-1]) + SPAN, np.uint8)
    spans = np.ndarray(len(line) - SPAN + 1, f"V{SPAN}", line, 0, 1)
    spans[ends - lengths.ravel()] = texts.view(f"V{SPAN}").ravel()
    return line[: ends[-1]].tobytes()


def _digits(y: Array, of: Whole) -> tuple[Whole, Whole, Truth]:
    """The answer of each y > 0 as a whole number, times 10^-places; and where it is not sure.

    `of` are the entries of the tables by the exponent of two.
    """
    half, places = HALVES[of], PLACES[of]
    scale, scale_upper = SCALES[of], SCALES_UPPER[of]
    y_upper = (y.view(np.int64) & UPPER).view(float)
    scale_lower, y_lower = scale - scale_upper, y - y_upper
    near = y * scale
    missing = near - y_upper * scale_upper - y_lower * scale_upper - y_upper * scale_lower
    missing = y_lower * scale_lower - missing
    whole = np.floor(missing)
    fraction = missing - whole
    found = near.astype(np.int64) + whole.astype(np.int64)

    tens = found // 10
    below = (found - 10 * tens) + fraction
    above = 10.0 - below
    upward = above < half
    short = upward | (below < half)
    tens += upward
    found = np.where(short, 10 * tens, found + (fraction > 0.5))
    unsure = (fraction == 0.5) | (below == half) | (above == half)

    places -= short
    shorter = np.flatnonzero(short & (tens // 10 * 10 == tens))
    tens = tens[shorter]
    for k in (8, 4, 2, 1):
        tenth = tens // 10**k
        ends = tenth * 10**k == tens
        tens = np.where(ends, tenth, tens)
        places[shorter] -= k * ends
    return found, np.maximum(places, 1, out=places), unsure


def _texts(head: Whole, rest: NDArray[np.uint64]) -> NDArray[np.uint32]:
    """What is before each point and from it on, (n, 2, SPAN / 4); `rest` has 19 digits."""
    texts = np.zeros((len(head), 2, SPAN // 4), "<u4")
    texts.view("<u8")[:, 0, 0] = HEADS[head]
    high = rest // 10**8
    top = high // 10**8
    texts[:, 1, 0] = THREE[top.view(np.int64)]
    for k, eight in ((1, high - top * 10**8), (3, rest - high * 10**8)):
        short_eight = eight.astype(np.uint32)
        four = short_eight // 10**4
        texts[:, 1, k], texts[:, 1, k + 1] = FOUR[four], FOUR[short_eight - four * 10**4]
    return texts


POWERS = np.array([float(f"1e{k}") for k in range(23)])  # those that are floats
COMMAS = bytes.maketrans(b"\n", b",")
LINES = 512  # lines that stay in cache
LARGEST = 2**62
SPLITTER = 2.0**27 + 1.0  # parts a float in two of half as many digits
DOUBT = 2.0**-98  # of a quotient, more than it is off


def decimals(lines: Sequence[str], width: int, places: Sequence[int]) -> Array | None:
    """The columns `places` (n, k) of n lines of `width` fields, all digits with a point inside.

    None where there is another field or another number of them.
    """
    if len(lines) > LINES:
        parts = [decimals(lines[k : k + LINES], width, places) for k in range(0, len(lines), LINES)]
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
    sound = (begins <= points) & (after >= 0) & (after < len(POWERS))
    sound &= ends - begins > 1 + negative  # it has digits
    minuses = np.count_nonzero(code == ord("-")) == np.count_nonzero(negative)
    if not (sound.all() and minuses and (code[ends[width - 1 :: width]] == ord("\n")).all()):
        return None
    whole = np.fromstring(written.translate(COMMAS, b"."), np.int64, sep=",")
    whole, after, negative = (x.reshape(-1, width)[:, places] for x in (whole, after, negative))
    if not -LARGEST < whole.min() <= whole.max() < LARGEST:  # too long, and cut
        return None
    ten, high = POWERS[after], whole.astype(float)
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
