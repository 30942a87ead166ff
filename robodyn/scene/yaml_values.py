"""Strict reading of values from a YAML tree: each fault is collected with its place and line."""

from __future__ import annotations

import re
from typing import Any, ClassVar

from robodyn.errors import MOST_FAULTS, Fault, nearest_first
from robodyn.scene.grammar import NUMBERS, OR_VECTOR, WITH_UNIT, WORDS, Key, excluded, form_of
from robodyn.scene.quantities import is_plain, parse_quantity
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence

COMPARISONS = 2000  # of names that a file's suggestions may cost
_VARIABLE = re.compile(r": (t|x|v|qd?\d+) is no unit or function")  # of what varies elsewhere
LONGEST_GUESS = 60  # characters of a name that is compared


class TooManyFaults(Exception):
    """More than MOST_FAULTS: it is no use to read on."""


class ValueReader:
    """Reads forms, words, numbers and vectors; after a fault it goes on with a harmless value.

    A kind of the grammar that is none of these is read by the method of its name.
    """

    missing: ClassVar[dict[str, Any]] = {  # what stands for a value that is left out, by its kind
        "list": None,
        **dict.fromkeys(NUMBERS, 0.0),
        **{kind: words[0] for kind, words in WORDS.items()},
        **dict.fromkeys(("vector", "direction", *OR_VECTOR), 0j),
    }

    def __init__(self) -> None:
        self.faults: list[Fault] = []
        self.compared = 0

    def keys(
        self,
        node: Node,
        place: str,
        needed: list[str],
        optional: list[str],
        kind: str = "key",
        beside: dict[str, str] | None = None,
        form: str = "",
    ) -> dict[str, Node]:
        """The known keys of a mapping; faults for unknown, repeated and missing ones.

        `beside` has keys that one of the known ones excludes, and which; `form` is the kind of the
        grammar that the mapping is of.
        """
        if not isinstance(node, Mapping):
            limit = f"must be a mapping with {', '.join(needed + optional)}"
            if isinstance(node, Sequence):
                from robodyn.scene.other_conventions import LISTS  # only a fault pays for it

                limit += LISTS.get(form, "")
            self.fault(place, node, limit, self.shown(node))
            return {}
        known = dict.fromkeys(needed + optional)
        found: dict[str, Node] = {}
        prefix = f"{place}." if place else ""
        for key, value in node.pairs:
            if key.text not in known:
                from robodyn.scene.other_conventions import way_here

                here = way_here(form, key.text, known)
                near = f"; {here}" if here else self.nearest(key.text, list(known))
                limit = f"is an unknown {kind}{near}"
                if beside and key.text in beside:
                    limit = f"and {beside[key.text]} exclude each other: give one"
                self.fault(prefix + key.text, key, limit)
            elif key.text in found:
                self.fault(prefix + key.text, key, "is given twice")
            else:
                found[key.text] = value
        for missing in needed:
            if missing not in found:
                self.fault(prefix + missing, node, "is missing")
        return found

    def form(self, kind: str, node: Node, place: str) -> dict[str, Any]:
        """What a mapping of this kind holds, key by key."""
        given = {key.text for key, _ in node.pairs} if isinstance(node, Mapping) else ()
        form = form_of(kind, given)
        names = form.named(needed=True), form.named(needed=False)
        found = self.keys(node, place, *names, beside=excluded(kind, given), form=kind)
        prefix = f"{place}." if place else ""
        for one in form.one:
            given_one = [name for name in one if name in found]
            if not given_one and isinstance(node, Mapping):
                self.fault(prefix + one[0], node, "is missing")
            for other in given_one[1:]:
                self.fault(prefix + other, found[other], f"stands beside {given_one[0]}; give one")
        return {
            name: self.value(key, found[name], prefix + name)
            if name in found
            else None
            if key.absent
            else self.missing.get("list" if key.listed else key.kind)
            for name, key in form.keys.items()
        }

    def value(self, key: Key, node: Node, place: str) -> Any:
        """The value of a key."""
        if key.listed:
            one = key._replace(listed=False)
            items = self.items(node, place)
            return tuple(self.value(one, item, f"{place}[{k}]") for k, item in enumerate(items))
        if key.kind in NUMBERS:
            return self.number(node, place, key)
        if key.kind in OR_VECTOR:
            plain = key._replace(kind=OR_VECTOR[key.kind])
            vector = isinstance(node, Sequence)
            return self.vector(node, place, key.unit) if vector else self.number(node, place, plain)
        if key.kind in WORDS:
            return self.word(node, place, WORDS[key.kind])
        more = (key.unit,) if key.kind in WITH_UNIT else ()
        name = key.kind.removeprefix("slide_")
        if name in ("friction", "limits", "motor"):  # of joints that turn, or slide
            more = (key.kind,)
        return getattr(self, name)(node, place, *more)

    def items(self, node: Node, place: str) -> list[Node]:
        if isinstance(node, Sequence):
            return node.items
        self.fault(place, node, "must be a list", self.shown(node))
        return []

    def name(self, node: Node, place: str) -> str:
        if isinstance(node, Scalar) and node.text.strip():
            return node.text
        self.fault(place, node, "must be a name", self.shown(node))
        return ""

    def word(self, node: Node, place: str, words: tuple[str, ...]) -> str:
        word = self.name(node, place)
        if word not in words:
            self.fault(place, node, f"must be {' or '.join(words)}", word)
        return word

    def number(self, node: Node, place: str, key: Key = Key("number", "")) -> float:
        if not isinstance(node, Scalar):
            self.fault(place, node, "must be a number", self.shown(node))
            return 0.0
        try:
            if node.quoted and is_plain(node.text):
                raise ValueError("is quoted text, not a number")
            value = parse_quantity(node.text, key.unit)
        except ValueError as error:
            truth = node.text.lower() in ("yes", "no", "on", "off", "true", "false")
            reason = "is a truth value, not a number" if truth else str(error)
            if name := _VARIABLE.search(reason):
                reason = f"must be a number: this key cannot vary, and has no {name[1]}"
            self.fault(place, node, reason.replace("is not", "must be"), self.shown(node))
            return 0.0
        limit = NUMBERS[key.kind]
        kept = {">= 0": value >= 0.0, "> 0": value > 0.0, "not 0": value != 0.0}
        kept["in [0, 1]"] = 0.0 <= value <= 1.0
        if not kept.get(limit, True):
            told = "must not be 0" if limit == "not 0" else f"must be {limit}"
            self.fault(place, node, f"{told}{key.hint}", self.shown(node))
            return 0.0
        return value

    def vector(self, node: Node, place: str, unit: str = "") -> complex:
        if not isinstance(node, Sequence) or len(node.items) != 2:
            count = f"{len(node.items)} values" if isinstance(node, Sequence) else self.shown(node)
            self.fault(place, node, "must be two numbers, [x, y]", count)
            return 0j
        key = Key("number", "", unit)
        x, y = (self.number(item, f"{place}[{k}]", key) for k, item in enumerate(node.items))
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
    known = list(nearest_first(word, known)) if guess else known
    shown = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return f"; known: {shown}" if known else ""
