"""The column that colours a map: numbers or words, of which some may be missing."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import InputError
from robodyn.tables.csv_fields import finite, shown, split_fields, unquoted
from robodyn.tables.table import Chunk

MOST_WORDS = 20  # that colours can tell apart


class ColourColumn:
    """One column of successive chunks; its first field that is not empty tells what it holds.

    After all `add`, `values` (T,) are the numbers, or places in the sorted `words`; nan where
    the field is empty.  With `positive`, numbers must be > 0.
    """

    def __init__(self, name: str, positive: bool = False) -> None:
        self.name = name
        self._positive = positive
        self._of_words: bool | None = None  # nothing seen so far
        self._places: dict[str, int] = {}  # of words as they came
        self._values: list[float] = []

    def add(self, chunk: Chunk, place: int, source: str) -> None:
        """Take the fields at a place of a chunk's lines.

        Raises InputError, with the line of `source`, where one is neither empty nor what the
        column holds.
        """
        for line, number in zip(chunk.lines, chunk.line_numbers, strict=True):
            text = unquoted(split_fields(line)[place]).strip()
            if text and self._of_words is None:
                self._of_words = _is_word(text)
            if not text:
                self._values.append(math.nan)
            elif self._of_words:
                self._values.append(self._places.setdefault(text, len(self._places)))
            else:
                value = finite(text)
                if value is None or (self._positive and value <= 0.0):
                    where, limit = f"{source}: line {number}", "must be > 0 for --log"
                    limit = "must be a finite number or empty" if value is None else limit
                    raise InputError(self.name, where=where, value=shown(text), limit=limit)
                self._values.append(value)
        if len(self._places) > MOST_WORDS:
            limit = f"has more than {MOST_WORDS} different words: no colours for so many"
            raise InputError("--colour", value=shown(self.name), limit=limit)

    @property
    def words(self) -> tuple[str, ...]:
        return tuple(sorted(self._places))

    @property
    def values(self) -> NDArray[np.float64]:
        values = np.array(self._values, float)
        if self._places:
            order = np.array([self.words.index(word) for word in self._places], float)
            there = ~np.isnan(values)
            values[there] = order[values[there].astype(int)]
        return values


def _is_word(text: str) -> bool:
    """Whether a field is no number, not even nan or inf."""
    try:
        float(text)
    except ValueError:
        return True
    return False
