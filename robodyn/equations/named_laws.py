"""Laws as formulas in symbols, and forces at joints that cover all contact modes.

In motion a joint with dry friction is held back by

    B = sign(qd) (tf + (ts - tf) exp(-(qd/ws)^2)),

with exp(-|qd|/ws) in place of the bell for an exponential curve, and with different numbers for the
two directions if they differ.  Compliant stops push it by Y, for each side

    step(x) max(0, k x + d v),

x the penetration, v = x'; step(x) is 1 for x > 0, else 0.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from robodyn.elements.joints import EXPONENTIAL, DryFriction, Stops, of_way
from robodyn.equations.symbolic import Atom, Role, Sum, of
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.expressions import OPERATIONS, changed, names_of, value_in, walk
from robodyn.scene.scene import Law
from robodyn.scene.syntax import Node
from robodyn.scene.units import Named

_TAKEN = (  # names of equations that have no number, and words of C
    "M C D G Q E L T V W h s g gx gy Psi gap tau lambda KE PE out auto break case char const "
    "continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile "
    "while"
)
TAKEN = frozenset(_TAKEN.split())
ARITHMETIC = ("+", "-", "*", "/", "%", "**")
SWITCHES = "sign(0) is 0, and step(x) is 1 for x > 0, else 0."


@dataclass(frozen=True)
class Formula:
    """An expression in names, each with the sum that it stands for."""

    tree: Node
    names: Mapping[str, Sum]

    def atoms(self) -> Iterator[Atom]:
        """Yield every atom that it uses."""
        for node in walk(self.tree):
            if isinstance(node, str):
                yield from self.names[node].atoms()

    def substituted(self, values: Mapping[str, Fraction]) -> Formula:
        """Return the formula with numbers for the symbols in `values`."""
        names = {name: entry.substituted(values) for name, entry in self.names.items()}
        return Formula(self.tree, names)

    @property
    def switches(self) -> bool:
        """Whether it contains the functions that `SWITCHES` explains."""
        return any(type(x) is tuple and x[0] in ("sign", "step") for x in walk(self.tree))

    def value(self, number: Callable[[Sum], Any], functions: Mapping[str, Any]) -> Any:
        """Evaluate the formula; `number` gives the values of its sums."""
        values = {name: number(entry) for name, entry in self.names.items()}
        return value_in(self.tree, values, {**OPERATIONS, **functions})


class Definition(NamedTuple):
    """A name that stands for a formula in the entries.

    Names that differ by numbers alone share one line of the legend, with the letters `numbers`.
    """

    name: str
    value: Sum | Formula
    unit: str
    meaning: str
    numbers: str = ""


class JointTerm(NamedTuple):
    """A named formula that acts at a joint; `sign` times the name is added to its block."""

    joint: int
    block: str
    sign: int
    name: Atom
    defined: Definition


def symbol_of(constant: str) -> str:
    """Return the symbol of a constant of the scene: its name, with a c if it may be ambiguous.

    Symbols of equations are letters with a number, or one of `TAKEN`.
    """
    plain = constant.rstrip("c")
    return f"{constant}c" if re.search("[A-Za-z][0-9]", constant) or plain in TAKEN else constant


def with_symbols(node: Node) -> Node:
    """Return the tree with symbols for constants of the scene; exponents stay numbers."""
    if isinstance(node, Named):
        return symbol_of(node.name)
    if type(node) is not tuple:
        return node
    if node[0] in ("**", "pow") and not names_of(node[2]):
        return node[0], with_symbols(node[1]), node[2]
    return node[0], *map(with_symbols, node[1:])


def formula_of(law: Law, own: Mapping[str, Sum]) -> Formula:
    """Return the formula of an expression in t, q0.., qd0..; `own` has a spring's x and v."""

    def meant(name: str) -> Sum:
        if name == "t":
            return of(Atom(Role.force, (-1, ""), "t"))
        if name not in law.names:  # a constant
            return of(Atom(Role.force, (-1, name), name))
        return _rate(int(name[2:])) if name[1] == "d" else _angle(int(name[1:]))

    tree = changed(with_symbols(law.node), _plain)
    names = {name: own[name] if name in own else meant(name) for name in names_of(tree) | law.names}
    return Formula(tree, names)


def contact_terms(
    mechanism: Mechanism, dry: Mapping[int, DryFriction], stops: Mapping[int, Stops]
) -> Iterator[JointTerm]:
    """Yield dry friction in motion and compliant stops, with symbols for their numbers."""
    tree: Node | None
    for j, friction in dry.items():
        link, unit = _joint(mechanism, j)
        numbers = mechanism.dry[j]
        known: dict[str, Any] = {"w": friction.stribeck}
        for way in (1, -1):
            known[_of("a", way)] = of_way(friction.torque, way)
            known[_of("s", way)] = of_way(friction.static, way)
        if isinstance(numbers.torque, tuple) or isinstance(numbers.static, tuple):
            ahead = _held_back(numbers, known, 1, ("step", "v"))
            back = _held_back(numbers, known, -1, ("step", ("neg", "v")))
            tree = ahead
            if back:
                tree = ("-", ahead, back) if ahead else ("neg", back)
        else:
            tree = _held_back(numbers, known, 1, ("sign", "v"))
        if tree:
            told = f"dry friction at the joint of {link}, in motion"
            yield _contact(j, -1, "B", tree, known, unit, told)
    for j, stop in stops.items():
        link, unit = _joint(mechanism, j)
        below: Node = ("-", "l", "q") if stop.low else ("neg", "q")
        above: Node = ("-", "q", "h") if stop.high else "q"
        low, high = (_push(x, y, stop.damping) for x, y in ((below, "-"), (above, "+")))
        tree = ("neg", high) if stop.low is None else ("-", low, high)
        if stop.high is None:
            tree = low
        told = f"push of the stops of the joint of {link}"
        known = {"k": stop.stiffness, "d": stop.damping, "l": stop.low, "h": stop.high}
        yield _contact(j, 1, "Y", tree, known, unit, told)


def _of(letter: str, way: int) -> str:
    """Return the name of a number for one direction of motion."""
    return letter if way > 0 else letter.upper()


def _held_back(numbers: DryFriction, known: Mapping[str, Any], way: int, turn: Node) -> Node | None:
    """Return `turn` times dry friction in one direction, or None if there is none."""
    a, s = _of("a", way), _of("s", way)
    if numbers.stribeck is None or not of_way(numbers.static, way) > of_way(numbers.torque, way):
        return ("*", a, turn) if known[a] else None
    part: Node = ("**", ("/", "v", "w"), 2.0)
    if numbers.curve == EXPONENTIAL:
        part = "/", ("abs", "v"), "w"
    bell: Node = ("exp", ("neg", part))
    if not known[a]:
        return "*", ("*", s, turn), bell
    return "*", turn, ("+", a, ("*", ("-", s, a), bell))


def _push(beyond: Node, sign: str, damped: Any) -> Node:
    """Return the force of a compliant stop: max(0, k x), or step(x) max(0, k x +- d v)."""
    spring = "*", "k", beyond
    if not damped:
        return "max", 0.0, spring
    return "*", ("step", beyond), ("max", 0.0, (sign, spring, ("*", "d", "v")))


def _contact(
    joint: int, sign: int, letter: str, tree: Node, known: Mapping[str, Any], unit: str, told: str
) -> JointTerm:
    """Return a term of Q from its formula in symbols `known`, and in q and v of its joint."""
    known = {**known, "q": _angle(joint), "v": _rate(joint)}
    formula = Formula(tree, {name: known[name] for name in known if name in names_of(tree)})
    name = Atom(Role.force, (joint, "~"), f"{letter}{joint + 1}")
    return JointTerm(joint, "Q", sign, name, Definition(name.name, formula, unit, told))


def _joint(mechanism: Mechanism, joint: int) -> tuple[str, str]:
    return mechanism.link_names[joint], "N" if joint in mechanism.slides else "N m"


def _angle(joint: int) -> Sum:
    return of(Atom(Role.angle, (joint,)))


def _rate(joint: int) -> Sum:
    return of(Atom(Role.rate, (joint,)))


def _plain(node: tuple[Any, ...]) -> Node:
    """Write all powers alike, and fold numbers that can be computed."""
    operation, *parts = ("**", *node[1:]) if node[0] == "pow" else node
    if operation in ARITHMETIC and all(isinstance(x, float) for x in parts):
        with suppress(ArithmeticError, TypeError):
            return float(OPERATIONS[operation](*parts))
    return operation, *parts
