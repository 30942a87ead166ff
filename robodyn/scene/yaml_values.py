"""Strict reading of values from a YAML tree: each fault is collected with its place and line."""

from __future__ import annotations

from collections.abc import Callable

from robodyn.errors import MOST_FAULTS, Fault
from robodyn.scene.quantities import parse_number
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence

COMPARISONS = 2000  # of names that a file's suggestions may cost
LONGEST_GUESS = 60  # characters of a name that is compared


class TooManyFaults(Exception):
    """More than MOST_FAULTS: it is no use to read on."""


class ValueReader:
    """Reads keys, names, numbers and vectors; after a fault it goes on with a harmless value."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []
        self.compared = 0

    def keys(
        self, node: Node, place: str, needed: list[str], optional: list[str], kind: str = "key"
    ) -> dict[str, Node]:
        """The known keys of a mapping; faults for unknown, repeated and missing ones."""
        if not isinstance(node, Mapping):
            limit = f"must be a mapping with {', '.join(needed + optional)}"
            self.fault(place, node, limit, self.shown(node))
            return {}
        known = dict.fromkeys(needed + optional)
        found: dict[str, Node] = {}
        prefix = f"{place}." if place else ""
        for key, value in node.pairs:
            if key.text not in known:
                limit = f"is an unknown {kind}{self.nearest(key.text, list(known))}"
                self.fault(prefix + key.text, key, limit)
            elif key.text in found:
                self.fault(prefix + key.text, key, "is given twice")
            else:
                found[key.text] = value
        for missing in needed:
            if missing not in found:
                self.fault(prefix + missing, node, "is missing")
        return found

    def items(self, node: Node | None, place: str) -> list[Node]:
        if node is None:
            return []
        if isinstance(node, Sequence):
            return node.items
        self.fault(place, node, "must be a list", self.shown(node))
        return []

    def text(self, node: Node, place: str) -> str:
        if isinstance(node, Scalar) and node.text.strip():
            return node.text
        self.fault(place, node, "must be a name", self.shown(node))
        return ""

    def number(self, node: Node, place: str, parse: Callable[[str], float] = parse_number) -> float:
        if not isinstance(node, Scalar):
            self.fault(place, node, "must be a number", self.shown(node))
            return 0.0
        try:
            if node.quoted:
                raise ValueError("is quoted text, not a number")
            return parse(node.text)
        except ValueError as error:
            truth = node.text.lower() in ("yes", "no", "on", "off", "true", "false")
            reason = "is a truth value, not a number" if truth else str(error)
            self.fault(place, node, reason.replace("is not", "must be"), self.shown(node))
            return 0.0

    def amount(self, node: Node, place: str) -> float:
        value = self.number(node, place)
        if value < 0.0:
            limit = "must be >= 0"
            if place.endswith(".r"):
                limit += "; write [x, y] for a centre of gravity behind or beside the link"
            self.fault(place, node, limit, self.shown(node))
            return 0.0
        return value

    def vector(self, node: Node, place: str) -> complex:
        if not isinstance(node, Sequence):
            self.fault(place, node, "must be two numbers, [x, y]", self.shown(node))
            return 0j
        if len(node.items) != 2:
            self.fault(place, node, "must be two numbers, [x, y]", f"{len(node.items)} values")
            return 0j
        x, y = (self.number(item, f"{place}[{k}]") for k, item in enumerate(node.items))
        return complex(x, y)

    @staticmethod
    def shown(node: Node) -> str:
        """A value as a message shows it."""
        if isinstance(node, Sequence):
            return "a list"
        if isinstance(node, Mapping):
            return "a mapping"
        text = f"'{node.text}'" if node.quoted else node.text
        return (text if len(text) <= 60 else text[:57] + "...") or "nothing"

    def fault(self, place: str, node: Node, limit: str, value: object = None) -> None:
        self.faults.append(Fault(place, limit, value, node.line))
        if len(self.faults) > MOST_FAULTS:
            raise TooManyFaults

    def nearest(self, word: str, known: list[str]) -> str:
        """`nearest` of few comparisons: each costs time, and faults and names may be many."""
        self.compared += len(known)
        return nearest(word, known, guess=self.compared <= COMPARISONS)


def nearest(word: str, known: list[str], guess: bool = True) -> str:
    """The known name that `word` may mean, or some that are known."""
    from difflib import get_close_matches  # only a faulty scene pays for the import

    if guess and len(word) <= LONGEST_GUESS:
        close = get_close_matches(word, [x for x in known if len(x) <= LONGEST_GUESS], n=1)
        if close:
            return f"; did you mean {close[0]}?"
    shown = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return f"; known: {shown}" if known else ""
