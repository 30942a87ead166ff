"""Strict reading of values from a YAML tree: each fault is collected with its place and line."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any, ClassVar

from robodyn.elements.keys import Key
from robodyn.errors import MOST_FAULTS, Fault, nearest_first
from robodyn.scene.grammar import (
    KEEPS,
    NUMBERS,
    OR_PAIR,
    OR_VECTOR,
    WITH_UNIT,
    WORDS,
    Form,
    excluded,
    form_of,
)
from robodyn.scene.quantities import is_plain, parse_quantity
from robodyn.scene.scene import JOINTS
from robodyn.scene.yaml_tree import Mapping, Node, Scalar, Sequence

COMPARISONS = 2000  # of names that a file's suggestions may cost
_VARIABLE = re.compile(r": (t|x|v|qd?\d+) is no unit or function")  # of what varies elsewhere
NAN = re.compile(r"[+-]?\.?(nan|inf)", re.IGNORECASE)  # which YAML calls numbers
LONGEST_GUESS = 60  # characters of a name that is compared
PLAIN = Key("number", "")


class TooManyFaults(Exception):
    """More than MOST_FAULTS: it is no use to read on."""


class ValueReader:
    """Reads records, words, numbers and vectors; after a fault it goes on with a harmless value.

    A kind of value that is none of these is read by the method of its name.
    """

    missing: ClassVar[dict[str, Any]] = {  # what stands for a value that is missing, by its kind
        **dict.fromkeys((*NUMBERS, *OR_PAIR), 0.0),
        **{kind: words[0] for kind, words in WORDS.items()},
        **dict.fromkeys(("vector", "direction", *OR_VECTOR), 0j),
    }

    def __init__(self) -> None:
        self.faults: list[Fault] = []
        self.named: dict[str, Any] = {}  # constants of the scene, as trees of expressions have them
        self.compared = 0
        self.count = 0  # of links that move: welds come behind them
        self.slides: set[int] = set()  # joints
        self.joint = -1  # of the link that is read

    def keys(
        self,
        node: Node,
        place: str,
        needed: list[str],
        optional: list[str],
        kind: str = "key",
        beside: tuple[str, Collection[str]] | None = None,
    ) -> dict[str, Node]:
        """The known keys of a mapping; faults for unknown, repeated and missing ones.

        `beside` has the kind of the mapping and its keys: some exclude others.
        """
        if not isinstance(node, Mapping):
            limit = f"must be a mapping with {', '.join(needed + optional)}"
            self.fault(place, node, limit, self.shown(node))
            return {}
        known = dict.fromkeys(needed + optional)
        found: dict[str, Node] = {}
        prefix = f"{place}." if place else ""
        for key, value in node.pairs:
            if key.text not in known:
                others = excluded(*beside) if beside else {}
                if key.text in others:
                    limit = f"and {others[key.text]} exclude each other: give one"
                else:
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

    def record(self, kind: str, node: Node, place: str, **own: Any) -> Any:
        """The record that a mapping of this kind holds; `own` stands where it has no value."""
        faults = len(self.faults)
        form, values = self.form(kind, node, place)
        if form.has_joint:
            own["joint"] = self.joint
        for field, value in own.items():
            if values.get(field) is None:
                values[field] = value
        if form.sided:
            self.fits_joint(form, values, node, place)
        made = form.made.from_keys(values)
        if len(self.faults) == faults:
            for field, limit, value in made.misfits(form.names):
                where = f"{place}.{form.names[field]}" if field else place
                self.fault(where, node, limit, value)
        return made

    def form(self, kind: str, node: Node, place: str) -> tuple[Form, dict[str, Any]]:
        """The form of a mapping of this kind, and what it holds, by fields."""
        given = {key.text for key, _ in node.pairs} if isinstance(node, Mapping) else ()
        form = form_of(kind, given)
        found = self.keys(node, place, form.needed, form.optional, beside=(kind, given))
        prefix = f"{place}." if place else ""
        names = [name for group in form.together for name in group]
        some = not found.keys().isdisjoint(names)
        for one in (*form.one, *(form.together if some else ())):
            given_one = [name for name in one if name in found]
            if not given_one and isinstance(node, Mapping):
                all_or_none = ", ".join(group[0] for group in form.together)
                other = one in form.together and f": give {all_or_none}, or none of them"
                self.fault(prefix + one[0], node, f"is missing{other or ''}")
            for other in given_one[1:]:
                self.fault(prefix + other, found[other], f"stands beside {given_one[0]}; give one")
        values: dict[str, Any] = dict(form.absent)
        for name, key in form.keys.items():
            if name in found:
                values[key.field] = self.value(key, found[name], prefix + name)
            elif key.needed:
                values[key.field] = () if key.listed else self.missing.get(key.kind)
        return form, values

    def fits_joint(self, form: Form, values: dict[str, Any], node: Node, place: str) -> None:
        """A fault where a mapping has the keys of joints that turn and names one that slides."""
        slides = values.get("joint") in self.slides
        if slides != form.way.slides:
            limit = f"is missing: the joint is {JOINTS[slides]}"
            self.fault(f"{place}.{form.sided[0][slides]}", node, limit)

    def value(self, key: Key, node: Node, place: str) -> Any:
        """The value of a key."""
        if key.listed:
            one = key._replace(listed=False)
            items = self.items(node, place)
            return tuple([self.value(one, x, f"{place}[{k}]") for k, x in enumerate(items)])
        kind = key.kind
        if kind in NUMBERS:
            return self.number(node, place, key)
        if kind in OR_VECTOR:
            if isinstance(node, Sequence):
                return self.vector(node, place, key.unit)
            return self.number(node, place, key._replace(kind=OR_VECTOR[kind]))
        if kind in OR_PAIR:
            own = key._replace(kind=OR_PAIR[kind])
            if not isinstance(node, Sequence):
                return self.number(node, place, own)
            if len(node.items) != 2:
                self.fault(place, node, "must be a number, or two", f"{len(node.items)} values")
                return 0.0
            return tuple(self.number(x, f"{place}[{k}]", own) for k, x in enumerate(node.items))
        read = getattr(self, kind, None)
        if read is None:
            if kind in WORDS:
                return self.word(node, place, WORDS[kind])
            return self.record(kind, node, place)
        return read(node, place, key.unit) if kind in WITH_UNIT else read(node, place)

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

    def truth(self, node: Node, place: str) -> bool:
        """True or false."""
        word = node.text.lower() if isinstance(node, Scalar) and not node.quoted else ""
        if word not in ("true", "false"):
            self.fault(place, node, "must be true or false", self.shown(node))
        return word == "true"

    def word(self, node: Node, place: str, words: tuple[str, ...]) -> str:
        word = self.name(node, place)
        if word not in words:
            self.fault(place, node, f"must be {' or '.join(words)}", word)
        return word

    def number(self, node: Node, place: str, key: Key = PLAIN) -> float:
        if not isinstance(node, Scalar):
            self.fault(place, node, "must be a number", self.shown(node))
            return 0.0
        try:
            if (node.quoted and is_plain(node.text)) or NAN.fullmatch(node.text):
                raise ValueError("is not a number")
            value = parse_quantity(node.text, key.unit, self.named)
        except ValueError as error:
            reason = str(error)
            if name := _VARIABLE.search(reason):
                reason = f"must be a number: this key cannot vary with {name[1]}"
            self.fault(place, node, reason.replace("is not", "must be"), self.shown(node))
            return 0.0
        limit = NUMBERS[key.kind]
        if limit and not KEEPS[limit](value):
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

    plain = word.lower().replace("-", "_")
    if same := [x for x in known if x.lower() == plain]:
        return f"; did you mean {same[0]}?"
    if guess and len(word) <= LONGEST_GUESS:
        close = get_close_matches(word, [x for x in known if len(x) <= LONGEST_GUESS], n=1)
        if close:
            return f"; did you mean {close[0]}?"
    known = list(nearest_first(word, known)) if guess else known
    shown = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return f"; known: {shown}" if known else ""
