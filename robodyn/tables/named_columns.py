"""A table by its columns: what pandas and polars take as it is."""

from __future__ import annotations

from typing import Any

from robodyn.tables.short_repr import named

ROWS_SHOWN = 10


class Columns(dict[str, Any]):
    """Names of columns, and their values: arrays (T,), or lists of words."""

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(next(iter(self.values()), ()))

    def __repr__(self) -> str:
        return f"<{self.rows} rows of {len(self)} columns: {named(self)}>"

    def _repr_html_(self) -> str:
        from html import escape

        head = "".join(f"<th>{escape(name)}</th>" for name in self)
        lines = []
        for row in zip(*(values[:ROWS_SHOWN] for values in self.values()), strict=True):
            told = (escape(x) if isinstance(x, str) else f"{x:.6g}" for x in row)
            lines.append("<tr>" + "".join(f"<td>{text}</td>" for text in told) + "</tr>")
        more = f"<p>{self.rows} rows</p>" if self.rows > ROWS_SHOWN else ""
        return f"<table><thead><tr>{head}</tr></thead>{''.join(lines)}</table>{more}"
