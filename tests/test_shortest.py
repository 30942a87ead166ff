"""Floats as text by numpy: the same characters as `repr`, whatever the floats are."""

import numpy as np
import pytest

from robodyn.tables.shortest import MOST, PIECE, shortest

RNG = np.random.default_rng(0)
COUNT = 60_000


def by_repr(values):
    return "".join(",".join(map(repr, row)) + "\n" for row in values.tolist())


def assert_same(values):
    found, wanted = shortest(values).split("\n"), by_repr(values).split("\n")
    assert len(found) == len(wanted)
    assert [pair for pair in zip(found, wanted, strict=True) if len(set(pair)) > 1][:5] == []


@pytest.mark.parametrize("columns", [1, 3, 12])
def test_numbers_of_any_length(columns):
    assert_same(RNG.uniform(-3.0, 3.0, (COUNT // columns, columns)))


def test_every_size():
    size = 10.0 ** RNG.uniform(-7.0, 18.0, (COUNT, 1))
    assert_same(size * [1.0, -1.0])
    assert_same(RNG.integers(0, 2**64, (COUNT, 1), dtype=np.uint64).view(float))


def test_numbers_of_few_digits_and_their_neighbours():
    for digits in range(1, 17):
        whole = RNG.integers(-(10**digits), 10**digits, (3000, 1))
        few = whole / 10.0 ** RNG.integers(0, digits + 3, (3000, 1))
        assert_same(np.hstack([few, np.nextafter(few, np.inf), np.nextafter(few, -np.inf)]))


def test_binary_fractions_and_ties():
    assert_same(RNG.integers(-(2**53), 2**53, (COUNT, 1)) / 2.0 ** np.arange(40, 56, 3))
    assert_same(RNG.integers(-(10**6), 10**6, (COUNT, 1)) / 2.0 ** np.arange(0, 20, 4))


def test_powers_of_two_and_ten_and_their_neighbours():
    powers = np.concatenate(
        [2.0 ** np.arange(-1074, 1024), [float(f"1e{k}") for k in range(-30, 30)]]
    )
    sides = [powers, np.nextafter(powers, 0.0), np.nextafter(powers, np.inf)]
    assert_same(np.stack([*sides, -powers], axis=-1))


def test_what_is_no_number_and_zeros():
    assert_same(np.array([[0.0, -0.0, np.nan, np.inf, -np.inf, 5e-324, MOST, -MOST, 1e16, 1e-4]]))
    assert_same(np.zeros((7, 2)))


def test_pieces_meet():
    for rows in (PIECE - 1, PIECE, PIECE + 1, 2 * PIECE + 1):
        assert_same(RNG.uniform(-3.0, 3.0, (rows, 1)))
    assert_same(RNG.uniform(-3.0, 3.0, (2, PIECE + 5)))


def test_a_view_is_read_in_its_own_order():
    table = RNG.uniform(-3.0, 3.0, (40, 30))
    assert_same(table.T)
    assert_same(table[::-2, 3::4])
