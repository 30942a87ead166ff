"""Constants of a scene: names for numbers, which every expression of the file may use.

    constants: {A: 20 mm, w: 300 rad/s, period: 2 pi/w}

A constant with a unit has its dimension wherever it stands; one without is a plain number, in the
unit of its place.  In a scene that has a constant A the name is that constant, never the ampere.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

from robodyn.errors import InputError
from robodyn.scene.quantities import is_plain, read_value
from robodyn.scene.syntax import CONSTANTS, FUNCTIONS, Node, tokens_of
from robodyn.scene.units import UNITS, Dimension, Named, Quantity, shown_dimension
from robodyn.tables.csv_fields import shown
from robodyn.tables.records import Record

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_STATE = re.compile(r"t|x|v|(q|qd|qdd|tau)[0-9]*", re.ASCII)  # variables of expressions
_NO_NUMBER = ("nan", "inf", "infinity")
OWN = ("A", "V", "W", "J")  # units whose letters constants may have


class Constant(Record):
    """A number with a name: as its file has it, its value in SI units, and its unit.

    The unit is empty where the text has none.
    """

    text: str
    value: float
    unit: str = ""


Constants = tuple[tuple[str, Constant], ...]


def not_free(name: str) -> str:
    """Why a constant must not have this name; empty where it may."""
    if not _NAME.fullmatch(name):
        return "must be a letter, then letters, digits or _"
    if _STATE.fullmatch(name):
        return "is a variable of expressions; take another name"
    if name in CONSTANTS:
        return "is a constant of the language; take another name"
    if name in FUNCTIONS:
        return "is a function; take another name"
    if name in UNITS and name not in OWN:
        return "is a unit; take another name"
    if keyword.iskeyword(name) or name.lower() in _NO_NUMBER:
        return "is a word of the language; take another name"
    return ""


def cycle(texts: Mapping[str, str]) -> list[str]:
    """Names of constants of which each is made of the next, the last the first; or nothing."""
    uses = {name: _used(text, texts) for name, text in texts.items()}
    done: set[str] = set()
    for start in texts:
        path, waiting = [start], [iter(uses[start])]
        while path:
            following = next((x for x in waiting[-1] if x not in done), None)
            if following is None:
                done.add(path.pop())
                waiting.pop()
            elif following in path:
                return [*path[path.index(following) :], following]
            else:
                path.append(following)
                waiting.append(iter(uses[following]))
    return []


def _used(text: str, names: Mapping[str, str]) -> list[str]:
    tokens = (token.text for token in tokens_of(text) if token.kind == "name")
    return list(dict.fromkeys(x for x in tokens if x in names))


def in_order(texts: Mapping[str, str]) -> list[str]:
    """The names, each behind those that it is made of; there must be no cycle."""
    found: dict[str, None] = {}
    waiting = list(texts)[::-1]
    while waiting:
        name = waiting[-1]
        missing = [x for x in _used(texts[name], texts) if x not in found]
        if name in found or not missing:
            found.setdefault(waiting.pop())
        else:
            waiting += missing
    return list(found)


def constant_of(text: str, named: Mapping[str, Node]) -> Constant:
    """The constant that a text writes, of others; ValueError with the reason if it is none."""
    found = read_value(text, named)
    unit = shown_dimension(found.measure.of) if found.measure and found.measure.sure else ""
    if "cycle" in unit:
        raise ValueError(f"is in {unit}: write it in Hz, in radians, or without a unit")
    own = repr(float(text)) if is_plain(text.strip()) else text.strip()
    return Constant(own, float(found.value), unit)


def node_of(name: str, constant: Constant) -> Node:
    """Return the node of a constant in trees of expressions."""
    if not constant.unit:
        return Named(constant.value, name)
    return Quantity(constant.value, 0, _dimension(constant.unit), name=name)


@lru_cache
def _dimension(unit: str) -> Dimension:
    found = read_value(unit).measure
    return found.of if found else {}


def numbers_of(constants: Constants) -> dict[str, Any]:
    """Return the nodes of constants as numbers without names."""
    return {
        name: Quantity(x.value, 0, _dimension(x.unit)) if x.unit else float(x.value)
        for name, x in constants
    }


def check_apart(constants: Constants, varied: Iterable[str], texts: Mapping[str, str]) -> None:
    """Raise InputError if one of the `texts`, by options, has a constant that is varied.

    `varied` are names of numbers, such as constants.w: what an option says is read once, by the
    values of the scene.
    """
    made = {name: constant.text for name, constant in constants}
    names = {x.removeprefix("constants."): x for x in varied if x.startswith("constants.")}
    for name in in_order(made):  # of what is varied, too
        of = next((names[x] for x in _used(made[name], names) if x != name), None)
        names |= {name: of} if of is not None and name not in names else {}
    for option, text in texts.items():
        for name in _used(text, names):
            limit = f"has {name}, and {names[name]} varies: write its number here, or the "
            limit += "expression in the scene"
            raise InputError(option, value=shown(text), limit=limit)


def nodes_of(constants: Constants) -> dict[str, Any]:
    """Return the nodes of constants in trees of expressions."""
    return {name: node_of(name, constant) for name, constant in constants}
