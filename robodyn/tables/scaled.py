"""Tables whose columns are told in other units: other names, and values times a constant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from robodyn.tables.csv_fields import finite, split_fields, unquoted
from robodyn.tables.table_writer import Writer

if TYPE_CHECKING:
    from robodyn.tables.table import Array

Told = Callable[[str], tuple[str, float]]  # of a column: its name there, and what its values are


class ScaledWriter(Writer):
    """Hands rows on to the writer that `make` makes, each column as `told` says.

    Fields of the input are scaled too, where they are numbers and pass through.
    """

    def __init__(
        self,
        make: Callable[[Sequence[str], Sequence[str]], Writer],
        told: Told,
        columns: Sequence[str],
        input_header: Sequence[str] = (),
    ) -> None:
        own, passing = [told(name) for name in columns], [told(name) for name in input_header]
        self._factors = [factor for _, factor in own]
        self._places = [k for k, (_, factor) in enumerate(passing) if factor != 1.0]
        self._passing = [factor for _, factor in passing]
        self._writer = make([name for name, _ in own], [name for name, _ in passing])
        self.needs_rows = self._writer.needs_rows

    def write_row(self, values: Sequence[float | str | None]) -> None:
        pairs = zip(values, self._factors, strict=True)
        self._writer.write_row([f * x if isinstance(x, float) else x for x, f in pairs])

    def write_ended(self, values: Array, ends: Sequence[str]) -> None:
        self._writer.write_ended(values * self._factors[:-1], ends)

    def write_columns(self, values: Array) -> None:
        self._writer.write_columns(values * self._factors)

    def write_rows(self, lines: Sequence[str], values: Array) -> None:
        if self._places:
            lines = list(map(self._scaled, lines))
        self._writer.write_rows(lines, values * self._factors)

    def _scaled(self, line: str) -> str:
        fields = split_fields(line)
        for k in self._places:
            if (value := finite(unquoted(fields[k]))) is not None:
                fields[k] = repr(self._passing[k] * value)
        return ",".join(fields)

    def close(self) -> None:
        self._writer.close()

    def cut(self) -> None:
        self._writer.cut()

    def title(self, name: str) -> str:
        return self._writer.title(name)
