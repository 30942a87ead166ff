"""The next kink of a torque, and whether a time is one."""

from __future__ import annotations

import math

from named_case import case

from robodyn.mechanics.kinks import NEAR, kink_at, next_kink

KINKS = (-1.0, 0.0, 0.5, 2.0)


NEXT = [
    (0.0, 3.0, 0.5),
    (0.1, 3.0, 0.5),
    (0.1, 0.4, 0.4),
    (2.0, 3.0, 3.0),
    (0.0, -3.0, -1.0),
    (0.6, -3.0, 0.5),
    (-1.0, -3.0, -3.0),
    (0.5, 0.5, 0.5),
]


def test_next() -> None:
    for t, end, expected in NEXT:
        with case(t, end, expected):
            assert next_kink(KINKS, t, end) == expected
            assert next_kink((), t, end) == end


def test_one_that_is_missed_by_rounding() -> None:
    before, after = math.nextafter(0.5, 0.0), math.nextafter(0.5, 1.0)
    assert next_kink(KINKS, before, 3.0) == 0.5
    assert next_kink(KINKS, before, 3.0, NEAR) == 2.0
    assert next_kink(KINKS, after, -3.0, NEAR) == 0.0
    for t in (before, 0.5, after):
        assert kink_at(KINKS, t) == 0.5
    for t in (0.3, 0.5 + 1e-14, 3.0, -2.0):
        assert kink_at(KINKS, t) is None
