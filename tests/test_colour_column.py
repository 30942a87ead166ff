"""The column that colours a map: numbers, words, empty fields, faults and their lines."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest

from robodyn.errors import InputError
from robodyn.pictures.value_map import MOST_WORDS, ColourColumn
from robodyn.tables.table import Reader


def read(fields: list[str], *, positive: bool = False, parts: int = 1) -> ColourColumn:
    """The column `c` of a table with these fields, which arrive in so many parts."""
    column = ColourColumn("c", positive)
    lines = [f"0,{field},x\n" for field in fields]
    for part in np.array_split(np.array(lines, object), parts):
        reader = Reader(io.BytesIO(("a,c,d\n" + "".join(part)).encode()), "x.csv")
        for chunk in reader.chunks(["a"]):
            column.add(chunk, 1, "x.csv")
    return column


@pytest.mark.parametrize("parts", [1, 3])
def test_numbers_and_empty_fields(parts: int) -> None:
    texts = ["", "1", " ", "-2.5e-3", '"7"', '""', " 0.1 ", ""]
    column = read(texts, parts=parts)
    expected = [math.nan, 1, math.nan, -2.5e-3, 7, math.nan, 0.1, math.nan]
    assert np.array_equal(column.values, expected, equal_nan=True)
    assert column.words == ()


@pytest.mark.parametrize("parts", [1, 4])
def test_words_are_places_in_their_order(parts: int) -> None:
    texts = ["", "open", "crossed", '"a, b"', "open", "7", "", "crossed"]
    column = read(texts, parts=parts)
    assert column.words == ("7", "a, b", "crossed", "open")
    found = ["" if math.isnan(v) else column.words[int(v)] for v in column.values]
    assert found == [text.strip('"') for text in texts]


def test_only_empty_fields_and_none_at_all() -> None:
    assert np.isnan(read(["", ""]).values).all()
    assert read(["", ""]).words == ()
    assert len(read([]).values) == 0


@pytest.mark.parametrize("bad", ["x", "nan", "inf", "1_0", "1e999", "0x1", "1;2"])
def test_what_is_no_number_is_told_with_its_line(bad: str) -> None:
    with pytest.raises(InputError) as caught:
        read(["1", "", bad, "y"])
    assert str(caught.value) == f"x.csv: line 4: c = {bad}: must be a finite number or empty"


@pytest.mark.parametrize("first", ["nan", "inf", "-Infinity", "1_0"])
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
