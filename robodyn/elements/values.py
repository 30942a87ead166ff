"""What fields of a scene hold beside numbers: points, and what varies."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn.elements.keys import Declared, Way, key
from robodyn.tables.records import Record

FRAMES = ("ground", "link")  # in which a load's force stays


class Point(Declared):
    """A point of a link (its index; `at` in the link's frame) or of the ground (link None), m."""

    link: int | None = key("link_name", "the link's name")
    at: complex = key("vector", "where, [x, y] in the link's frame", unit="m")

    ways: ClassVar[tuple[Way, ...]] = (
        Way("link_point", "point", "A point of a link."),
        Way("link_point", "moving_point", "A point of a link."),
    )


class Law(Record):
    """A smooth expression: as its file has it, its tree (`scene/syntax.py`), and its names."""

    text: str
    node: Any
    names: frozenset[str]  # t, q0.., qd0..; of a spring x, its extension, and v, its rate


class Table(Declared):
    """A function of one variable that is linear between its rows, x increasing."""

    file: str = key("name", "the CSV file, from the scene file's folder", name="table")
    over: str = key("name", "t, or a joint q1, ..: its column tells where the rows are")
    column: str = key("name", "the column of the force or torque")
    x: tuple[float, ...]
    F: tuple[float, ...]
    repeats: bool = False  # after its span; else it ends there

    ways: ClassVar[tuple[Way, ...]] = (
        Way("load_table", "varying", "A force or torque by a table, linear between its rows."),
    )

    @property
    def names(self) -> frozenset[str]:
        """The variable, as a law has its own; t or q0..; of a spring x."""
        return frozenset((self.over,))


Signal = Law | Table

# of files that a scene names: x and value of each row, by file, both columns' names, and whether
# x is an angle that turns
Tables = dict[tuple[str, str, str, bool], tuple[tuple[float, ...], tuple[float, ...]]]


def told(signal: Signal) -> str:
    """An expression as its file has it, or the file of a table."""
    return signal.text if isinstance(signal, Law) else signal.file
