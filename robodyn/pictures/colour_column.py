"""The column that colours a map: numbers or words, of which some may be missing."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import InputError
from robodyn.tables.csv_fields import finite, plain_digits, shown, split_fields, unquoted
from robodyn.tables.table import Chunk

Array = NDArray[np.float64]

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
        self._blocks: list[Array] = []

    def add(self, chunk: Chunk, place: int, source: str) -> None:
        """Take the fields at a place of a chunk's lines.

        Raises InputError, with the line of `source`, where one is neither empty nor what the
        column holds.
        """
        texts = [_field(line, place) for line in chunk.lines]
        if self._of_words is None:
            first = next((text for text in texts if text), "")
            self._of_words = _is_word(first) if first else None
        values = self._words(texts) if self._of_words else _numbers(texts)
        if values is None:
            values = np.array([math.nan if (x := finite(t)) is None else x for t in texts])
        if not self._of_words:
            self._check(values, texts, chunk, source)
        self._blocks.append(values)

    @property
    def words(self) -> tuple[str, ...]:
        return tuple(sorted(self._places))

    @property
    def values(self) -> Array:
        values = np.concatenate(self._blocks) if self._blocks else np.zeros(0)
        if self._places:
            order = np.array([self.words.index(word) for word in self._places], float)
            there = ~np.isnan(values)
            values[there] = order[values[there].astype(int)]
        return values

    def _words(self, texts: Sequence[str]) -> Array:
        places = self._places
        for word in set(texts) - places.keys() - {""}:
            places[word] = len(places)
        if len(places) > MOST_WORDS:
            limit = f"has more than {MOST_WORDS} different words: no colours for so many"
            raise InputError("--colour", value=shown(self.name), limit=limit)
        known = {**places, "": math.nan}
        return np.array([known[text] for text in texts], float)

    def _check(self, values: Array, texts: Sequence[str], chunk: Chunk, source: str) -> None:
        bad = np.isnan(values)
        limit = "must be a finite number or empty"
        for k in np.flatnonzero(bad).tolist():
            if texts[k]:
                raise self._fault(texts[k], chunk.line_numbers[k], source, limit)
        if self._positive and (values <= 0.0).any():
            k = int(np.argmax(values <= 0.0))
            limit = "must be > 0 for --log"
            raise self._fault(texts[k], chunk.line_numbers[k], source, limit)

    def _fault(self, text: str, line: int, source: str, limit: str) -> InputError:
        return InputError(self.name, where=f"{source}: line {line}", value=shown(text), limit=limit)


def _field(line: str, place: int) -> str:
    if '"' in line:
        return unquoted(split_fields(line)[place]).strip()
    return line.split(",", place + 1)[place].strip()


def _is_word(text: str) -> bool:
    """Whether a field is no number, not even nan or inf."""
    try:
        float(text)
    except ValueError:
        return True
    return False


def _numbers(texts: Sequence[str]) -> Array | None:
    """The numbers, nan where a text is empty; None where one is not as `finite` takes them."""
    if not all(map(plain_digits, texts)):
        return None
    try:
        values = np.array([float(text) if text else math.nan for text in texts])
    except ValueError:
        return None
    there = sum(map(bool, texts))
    return values if np.isfinite(values).sum() == there else None
