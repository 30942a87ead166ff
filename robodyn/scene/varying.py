"""Reads laws of springs and loads that vary: numbers, expressions, and tables in files."""

from __future__ import annotations

import math

from robodyn.elements.keys import Key
from robodyn.scene.dimensions import dimension_of, misfit
from robodyn.scene.expressions import check_smooth, number_of
from robodyn.scene.quantities import Variables, expressions, read_value, state_variables
from robodyn.scene.scene import Law, Signal, Table, Tables
from robodyn.scene.syntax import CONSTANTS, NotAllowedError, tokens_of
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence
from robodyn.scene.yaml_values import ValueReader

SPRING = {
    unit: Variables(
        {"x": "x", "v": "v"}.get,
        "x, v",
        {"x": dimension_of(x), "v": dimension_of(f"{x}/s")}.get,
    )
    for unit, x in (("N m", "rad"), ("N", "m"))
}


TIME = Variables({"t": "t"}.get, "t", {"t": dimension_of("s")}.get)


def _has_time(node: Node) -> bool:
    """Whether a component of gravity varies."""
    if isinstance(node, Mapping):
        return any(key.text == "table" for key, _ in node.pairs)
    names = tokens_of(node.text) if isinstance(node, Scalar) else []
    return any(token.text == "t" for token in names)


class SignalReader(ValueReader):
    """The kinds of the grammar that are signals."""

    def __init__(self) -> None:
        super().__init__()
        self.source = ""
        self.tables: Tables = {}

    def law(self, node: Node, place: str, unit: str) -> Law | None:
        """The pull of a spring as an expression in x and v."""
        if not isinstance(node, Scalar) or not node.text.strip():
            self.fault(place, node, "must be an expression in x and v", self.shown(node))
            return None
        return self.expression(node, place, unit, SPRING[unit])

    def spring_table(self, node: Node, place: str) -> Table | None:
        """The pull of a spring by the columns x and F of a file."""
        file = self.name(node, place)
        return self.file_table(node, place, file, "x", "x", "F", False) if file else None

    def varying(
        self, node: Node, place: str, unit: str, known: Variables | None = None
    ) -> float | Signal:
        """A number, an expression in t, q1.., qd1.., or {table, over, column}.

        With `known` variables it has no others.
        """
        if isinstance(node, Mapping):
            table = self.load_table(node, place)
            if table is not None and known is not None and known.named(table.over) is None:
                self.fault(f"{place}.over", node, f"must be {known.known}", table.over)
            return table or 0.0
        if not isinstance(node, Scalar) or self._meant_as_number(node):
            return self.number(node, place, Key("number", "", unit))
        law = self.expression(node, place, unit, known)
        if law is None or law.names:
            return law or 0.0
        value = number_of(law.node)
        if value is not None and math.isfinite(value):
            return value
        self.fault(place, node, "must be a finite number", self.shown(node))
        return 0.0

    def varying_vector(
        self, node: Node, place: str, unit: str, known: Variables | None = None
    ) -> tuple[float | Signal, float | Signal]:
        """Two of these."""
        if not isinstance(node, Sequence) or len(node.items) != 2:
            self.vector(node, place)  # says so
            return 0.0, 0.0
        each = enumerate(node.items)
        x, y = (self.varying(item, f"{place}[{k}]", unit, known) for k, item in each)
        return x, y

    def gravity(
        self, node: Node, place: str, unit: str
    ) -> float | complex | tuple[float | Signal, float | Signal]:
        """A number along -Y, a vector, or two components of which some vary with the time."""
        if isinstance(node, Sequence):
            if not any(map(_has_time, node.items)):
                return self.vector(node, place, unit)
            return self.varying_vector(node, place, unit, TIME)
        if not _has_time(node):
            return self.number(node, place, Key("number", "", unit))
        down = self.varying(node, place, unit, TIME)
        if isinstance(down, Law):
            return 0.0, Law(f"-({down.text})", ("neg", down.node), down.names)
        if isinstance(down, Table):
            return 0.0, down._replace(F=tuple(-x for x in down.F))
        return down

    def varying_place(
        self, node: Node, place: str, unit: str
    ) -> tuple[float | Signal, float | Signal]:
        """Two coordinates, numbers or expressions in t and q1.., or tables over these."""
        state = state_variables(self.count, self.slides)

        def named(name: str) -> str | None:
            return None if name.startswith("qd") else state.named(name)

        known = Variables(named, f"t, q1..q{self.count}", state.of)
        return self.varying_vector(node, place, unit, known)

    def load_table(self, node: Node, place: str) -> Table | None:
        """A table over t or a joint."""
        faults, (_, values) = len(self.faults), self.form("varying", node, place)
        if len(self.faults) > faults:
            return None
        over = values["over"]
        own = state_variables(self.count).named(over)
        if own is None or own.startswith("qd"):
            limit = f"must be t, or a joint: q1 to q{self.count}"
            self.fault(f"{place}.over", node, limit, over)
            return None
        turns = own != "t" and int(own[1:]) not in self.slides
        if values["hold"] and own != "t":
            self.fault(f"{place}.hold", node, "is for tables over t alone", values["over"])
            return None
        where, column, hold = f"{place}.table", values["column"], values["hold"]
        return self.file_table(node, where, values["file"], own, over, column, turns, hold)

    def file_table(
        self,
        node: Node,
        place: str,
        file: str,
        over: str,
        x: str,
        column: str,
        turns: bool,
        hold: bool = False,
    ) -> Table | None:
        """Return the table in a file; None, and a fault, if it has none."""
        from robodyn.scene.table_files import read_table

        try:
            return read_table(self.source, file, over, x, column, turns, self.tables, hold)
        except ValueError as error:
            self.fault(place, node, str(error), file)
        return None

    def expression(
        self, node: Scalar, place: str, unit: str, known: Variables | None = None
    ) -> Law | None:
        """A smooth expression in `known` variables, or in the state; None, and a fault."""
        known = known or state_variables(self.count, self.slides)
        try:
            found = expressions(node.text, known, {**CONSTANTS, **self.named})
            check_smooth([x.node for x in found])
            limit = misfit(found[0].measure, unit)
        except NotAllowedError as error:
            limit = f"has {error}"
        except ValueError as error:
            limit = f"must be an expression: {error}"
        if limit:
            self.fault(place, node, limit, self.shown(node))
            return None
        return Law(node.text.strip(), found[0].node, found[0].names)

    def _meant_as_number(self, node: Scalar) -> bool:
        """Whether it is a number, or was meant as one."""
        try:
            read_value(node.text, self.named)
        except ValueError as error:
            return not str(error).startswith("is not a number")
        return True
