"""The column that colours a map: numbers, words, empty fields, faults and their lines."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from robodyn.errors import InputError
from robodyn.pictures.value_map import MOST_WORDS, colour_values
from robodyn.tables.csv_fields import unquoted


class Column(NamedTuple):
    values: np.ndarray
    words: tuple[str, ...]


def read(fields: list[str], *, positive: bool = False) -> Column:
    """The column `c` with these fields, in lines 2, 3, ..."""
    texts = [unquoted(field).strip() for field in fields]
    places = [f"x.csv: line {k}" for k in range(2, len(texts) + 2)]
    return Column(*colour_values("c", list(zip(texts, places, strict=True)), positive))


def test_numbers_and_empty_fields() -> None:
    texts = ["", "1", " ", "-2.5e-3", '"7"', '""', " 0.1 ", "NaN"]
    column = read(texts)
    expected = [math.nan, 1, math.nan, -2.5e-3, 7, math.nan, 0.1, math.nan]
    assert np.array_equal(column.values, expected, equal_nan=True)
    assert column.words == ()


def test_words_are_places_in_their_order() -> None:
    texts = ["", "open", "crossed", '"a, b"', "open", "7", "", "crossed"]
    column = read(texts)
    assert column.words == ("7", "a, b", "crossed", "open")
    found = ["" if math.isnan(v) else column.words[int(v)] for v in column.values]
    assert found == [text.strip('"') for text in texts]


def test_only_empty_fields_and_none_at_all() -> None:
    assert np.isnan(read(["", ""]).values).all()
    assert read(["", ""]).words == ()
    assert len(read([]).values) == 0


@pytest.mark.parametrize("bad", ["x", "inf", "1_0", "1e999", "0x1", "1;2"])
def test_what_is_no_number_is_told_with_its_line(bad: str) -> None:
    with pytest.raises(InputError) as caught:
        read(["1", "", bad, "y"])
    assert str(caught.value) == f"x.csv: line 4: c = {bad}: must be a finite number or empty"


@pytest.mark.parametrize("first", ["inf", "-Infinity", "1_0"])
def test_a_column_that_begins_with_a_bad_number_holds_no_words(first: str) -> None:
    with pytest.raises(InputError, match="line 2: c = "):
        read([first, "open"])


@pytest.mark.parametrize("bad", ["0", "-1e-300", "-5"])
def test_a_logarithm_needs_positive_numbers(bad: str) -> None:
    with pytest.raises(InputError) as caught:
        read(["", "1e-300", bad], positive=True)
    assert str(caught.value) == f"x.csv: line 4: c = {bad}: must be > 0 for --log"
    assert len(read(["", "1e-300", bad]).values) == 3


@pytest.mark.parametrize("text", ["\u0661\u0662", "\uff11", "1_0"])
def test_digits_of_other_scripts_are_no_numbers(text: str) -> None:
    with pytest.raises(InputError, match="must be a finite number or empty"):
        read(["1", text])


def test_too_many_words() -> None:
    words = [f"w{k}" for k in range(MOST_WORDS)]
    assert len(read(words).words) == MOST_WORDS
    with pytest.raises(InputError, match="--colour = c: has more than 20 different words"):
        read([*words, "one more"])
