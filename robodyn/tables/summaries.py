"""What is told of a table in place of its rows: of each column its least and greatest value, ..."""

from __future__ import annotations

import io
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import finite, is_missing, shown, split_fields, unquoted
from robodyn.tables.numbers import read
from robodyn.tables.table_writer import Writer

Rows = list[list[float | str | None]]
EXTREMES = ("column", "min", "min_t", "min_q1", "max", "max_t", "max_q1", "mean", "rms")


class SummaryWriter(Writer):
    """Takes the rows that a writer takes, as numbers, and writes what is told of them at the end.

    `make` makes the writer of that, from its columns; it is called when all rows are there, so that
    a failure leaves nothing written.  A column of the input with a field that is no finite number
    is none of numbers; an empty field is one without a value.  A computed text is no value, and a
    column of such texts is left out.
    """

    needs_rows = True
    note: Callable[[str], object] = staticmethod(lambda text: None)

    def __init__(
        self,
        make: Callable[[Sequence[str]], Writer],
        columns: Sequence[str],
        input_header: Sequence[str] = (),
    ) -> None:
        super().__init__(io.BytesIO(), columns, input_header)  # which stays empty
        self._make, self._width = make, len(input_header)
        self._passing = [k for k in range(self._width) if k not in self._places]
        self._worded: set[int] = set()  # computed columns with a text
        self._count_of_rows, self._numbered = 0, set[int]()  # columns that have had a number
        self._mixed: dict[str, str] = {}  # columns with a word below numbers: the word, and its row

    @abstractmethod
    def tell(self) -> tuple[Sequence[str], Rows]:
        """Return the columns and rows of the summary."""

    @abstractmethod
    def write_columns(self, values: Array) -> None:
        """Take rows (n, columns), NaN in columns that are not of numbers."""

    def write_row(self, values: Sequence[float | str | None]) -> None:
        words = {k for k, value in enumerate(values) if isinstance(value, str)}
        self._worded |= words
        row = [None if k in words else x for k, x in enumerate(values)]
        self.write_columns(np.array([row], float))

    def _begin(self) -> None:
        """Nothing is written yet."""

    def write_rows(self, lines: Sequence[str], values: Array) -> None:
        rows = np.full((len(lines), len(self._header)), np.nan)
        rows[:, self._places] = values
        passed, numeric = self._numbers(lines)
        rows[:, self._passing] = passed
        self._look_for_words(lines, passed, numeric)
        self._passing = [k for k, good in zip(self._passing, numeric, strict=True) if good]
        self.write_columns(rows)

    def _look_for_words(self, lines: Sequence[str], passed: Array, numeric: list[bool]) -> None:
        """Keep the first word in each column if numbers stand above it."""
        for k, column, good in zip(self._passing, passed.T, numeric, strict=True):
            row = len(lines)
            if not good:
                texts = [unquoted(split_fields(line)[k]) for line in lines]
                row = next(
                    i for i, x in enumerate(texts) if finite(x) is None and not is_missing(x)
                )
            if not np.isnan(column[:row]).all():
                self._numbered.add(k)
            if not good and k in self._numbered:
                place = f"row {self._count_of_rows + row + 1}"
                self._mixed[self._header[k]] = f"{shown(texts[row])} in {place}"
        self._count_of_rows += len(lines)

    def write_empty(self, line: str) -> None:
        self.write_rows([line], np.full((1, len(self._places)), np.nan))

    def close(self) -> None:
        for column, word in self._mixed.items():
            self.note(f"Note: column {shown(column)} is left out: it has numbers, and {word}")
        columns, rows = self.tell()
        writer = self._make(columns)
        for name, *values in rows:
            writer.write_row([writer.title(name) if isinstance(name, str) else name, *values])
        writer.close()

    def cut(self) -> None:
        """Nothing is written."""

    def numeric(self, name: str) -> int | None:
        """The place of a column, None where it is not there or not of numbers."""
        place = self._header.index(name) if name in self._header else -1
        return place if place in self._passing or place in self._places else None

    def _numbers(self, lines: Sequence[str]) -> tuple[Array, list[bool]]:
        """The fields (n, k) of the input that pass through, NaN where one is no number.

        And which columns have numbers alone, and fields without a value.
        """
        found = read(lines, self._width, self._passing) if self._passing else None
        if found is not None:
            return found, [True] * len(self._passing)
        split = [split_fields(line) for line in lines]
        texts = [[unquoted(row[k]) for k in self._passing] for row in split]
        values = [[finite(text) for text in row] for row in texts]
        known = [
            [x is not None or is_missing(text) for x, text in zip(*row, strict=True)]
            for row in zip(values, texts, strict=True)
        ]
        numeric = [all(column) for column in zip(*known, strict=True)]
        return np.array(values, float).reshape(len(lines), len(self._passing)), numeric


class KeptRows(SummaryWriter):
    """Keeps all rows, and writes what `of` tells of them: columns and rows.

    It takes the names of all columns, their values (T, columns), and those that are computed.
    """

    def __init__(
        self,
        *given: Any,
        of: Callable[[Sequence[str], Array, Array], tuple[Sequence[str], Rows]],
    ) -> None:
        super().__init__(*given)
        self._of, self._kept = of, [np.zeros((0, len(self._header)))]

    def write_columns(self, values: Array) -> None:
        self._kept.append(values)

    def tell(self) -> tuple[Sequence[str], Rows]:
        rows = np.concatenate(self._kept)
        rows[:, [k for k, name in enumerate(self._header) if self.numeric(name) is None]] = np.nan
        return self._of(self._header, rows, rows[:, self._places])


class Extremes(SummaryWriter):
    """For each column but t: least and greatest value with their t and q1, mean and rms.

    Mean and rms are integrals over t by the trapezoidal rule; if t is missing or falls, rows count
    equally, and `note` is called.  A row without a value (NaN) does not count in that column.  Of
    equal values the first is given.
    """

    rank: Callable[[str], int] = staticmethod(lambda name: 0)  # of columns, by which they are told

    def _begin(self) -> None:
        width = len(self._header)
        self._count = np.zeros(width, np.int64)
        self._ends = np.full((2, 3, width), np.nan)  # least and greatest: the value, its t, its q1
        self._ends[:, 0] = [[np.inf], [-np.inf]]
        self._sums = np.zeros((2, width), np.longdouble)  # of values, and of their squares
        self._last = np.zeros((0, width))  # the last row
        self._rises, self._spans = True, np.zeros(width, np.longdouble)  # times with a value, s
        self._integrals = np.zeros((2, width), np.longdouble)  # of values, and of their squares

    @property
    def _q1(self) -> int | None:
        """The place of q1, which may be in degrees."""
        place = self.numeric("q1")
        return self.numeric("q1_deg") if place is None else place

    def write_columns(self, values: Array) -> None:
        known, every = ~np.isnan(values), np.arange(values.shape[1])
        nowhere, places = np.full(len(values), np.nan), (self.numeric("t"), self._q1)
        where = [nowhere if place is None else values[:, place] for place in places]
        ways = ((np.argmin, np.less, np.inf), (np.argmax, np.greater, -np.inf))
        for end, (pick, beats, last) in zip(self._ends, ways, strict=True):
            row = pick(np.where(known, values, last), axis=0)
            found = np.stack([values[row, every], *(x[row] for x in where)])
            new = beats(found[0], end[0])
            end[:, new] = found[:, new]
        self._count += known.sum(axis=0)
        # whose range holds the squares of all floats
        wide = np.where(known, values, 0.0).astype(np.longdouble)
        self._sums += [wide.sum(axis=0), np.square(wide).sum(axis=0)]
        if (t := self.numeric("t")) is not None:
            self._integrate(t, np.concatenate([self._last, values]))
        self._last = values[-1:]

    def _integrate(self, t: int, values: Array) -> None:
        """Add the integrals between these rows, whose time is column `t`."""
        steps, known = np.diff(values[:, t]), ~np.isnan(values)
        self._rises &= not (steps < 0.0).any()
        wide = np.where(known, values, 0.0).astype(np.longdouble)
        spans = np.where(known[1:] & known[:-1], steps[:, None], 0.0)
        for total, power in zip(self._integrals, (wide, np.square(wide)), strict=True):
            total += (0.5 * spans * (power[1:] + power[:-1])).sum(axis=0)
        self._spans += spans.sum(axis=0)

    def tell(self) -> tuple[Sequence[str], Rows]:
        rows: Rows = []
        mean, square = self._sums / np.maximum(self._count, 1)
        t, q1 = self.numeric("t"), self._q1
        over = (self._spans > 0.0) & (t is not None and self._rises)
        mean[over], square[over] = self._integrals[:, over] / self._spans[over]
        if not over.any() and self._count.max(initial=0) > 1:
            why = "there is no column t of numbers" if t is None else "t does not rise"
            self.note(f"Note: {why}: rows count equally in mean and rms")
        for name in sorted(self._header, key=self.rank):
            if name == "t" or (k := self.numeric(name)) is None:
                continue
            row: list[float | str | None] = [name]
            if not self._count[k]:
                if k in self._worded:
                    continue
                rows.append([name, *(None for _ in EXTREMES[1:])])
                continue
            for value, at_t, at_q1 in self._ends[:, :, k].tolist():
                row += [value, None if t is None else at_t, None if q1 is None else at_q1]
            rows.append([*row, float(mean[k]), float(np.sqrt(square[k]))])
        end = "" if q1 is None else self._header[q1].removeprefix("q1")
        return [name + end if name.endswith("q1") else name for name in EXTREMES], rows


def correlations(
    header: Sequence[str], varied: int, parts: Sequence[Array]
) -> dict[str, list[float | None]]:
    """Return the rank correlations of each column with the first `varied` ones.

    1 if one never falls as the other grows, -1 if it never grows, None if one is constant.  Rows
    (T, columns) without a value in the column do not count.
    """
    columns = np.concatenate([np.zeros((0, len(header))), *parts]).T
    found = {}
    for name, y in zip(header[varied:], columns[varied:], strict=True):
        there = ~np.isnan(y)
        found[name] = [_spearman(x[there], y[there]) for x in columns[:varied]]
    return found


def _spearman(x: Array, y: Array) -> float | None:
    """The correlation of the ranks of two columns, equal values sharing theirs."""
    from scipy.stats import rankdata

    if not len(x):
        return None
    a, b = (ranks - ranks.mean() for ranks in (rankdata(x), rankdata(y)))
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size else None
