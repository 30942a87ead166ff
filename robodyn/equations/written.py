"""The equations of motion as formulas to read, with names that elements give to quantities.

A spring from its second end to its first is S, V = dS/dt.  It pulls by K S and its damper by P S,

    K = k (1 - S0/|S|)        P = ds Re(conj(S) V)/|S|^2

as loads on its ends; these names occur in the entries.  Without a free length K = k, and S is
expanded if its links hang from one another.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from typing import Any

from robodyn.engines.arithmetic import Arithmetic
from robodyn.engines.formulas import Recorded
from robodyn.engines.series import Series
from robodyn.equations.entries import Entries, Matrix
from robodyn.equations.factoring import (
    Key,
    as_one,
    by_angle,
    by_function,
    by_role,
    simplified,
    written,
)
from robodyn.equations.named_laws import (
    Definition,
    Formula,
    contact_terms,
)
from robodyn.equations.named_rows import NamedRows, Places, divide, places_of, power
from robodyn.equations.outline import Block, Equations, Head, heads
from robodyn.equations.parameters import Parameters
from robodyn.equations.symbolic import (
    ZERO,
    Atom,
    Monomial,
    Number,
    Role,
    Sum,
    merged,
    of,
    summed,
)
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.mechanism import Mechanism, constants, too_large, with_kept

# How the terms of a block's entries are collected: by the first of these, then within by the next.
LINE = (by_role(Role.normal), by_role(Role.rate), by_function)
FORCES = (by_role(Role.gravity, Role.force), by_angle, by_function)
LONG = 55  # joints that carry each link, added up: more than in a chain of ten links
SHARED = {  # by blocks, the letter and meaning of the names of W and of W J
    "M": (
        ("W", "mass matrix by absolute angles or displacements, of links j and k"),
        ("U", "sum of Wj_i over link k and all links i that it carries"),
    ),
    "C": (
        ("Z", "Coriolis matrix by absolute angles or displacements, of links j and k"),
        ("E", "sum of Zj_i over link k and all links i that it carries"),
    ),
}
LEVELS: dict[str, Sequence[Key]] = {
    "M": (by_role(Role.mass, Role.inertia), by_angle, by_function),
    "C": (as_one, by_role(Role.rate), by_angle, by_function),
    "D": (),
    "G": FORCES,
    "Q": FORCES,
}


def equations(
    mechanism: Mechanism, numeric: bool = False, watch: Callable[[float], object] | None = None
) -> Equations[Sum]:
    """Return the equations of motion of a mechanism's scene, in symbols or in numbers.

    `watch` is called with the finished part now and then.  Raises InputError if a number leaves the
    range of floats.
    """
    parameters = Parameters(mechanism)
    n, rows = mechanism.n, len(mechanism.rows)
    columns = {"vector": 1, "diagonal": n, "matrix": n, "symmetric": (n + 1) / 2}
    known = list(heads(mechanism))
    most = sum((rows if head.side == "closures" else n) * columns[head.shape] for head in known)
    done = 0

    def write(entry: Any, levels: Sequence[Key] = LINE) -> Any:
        nonlocal done
        done += 1
        if watch is not None:
            watch(min(1.0, done / most))
        if numeric:
            entry = entry.substituted(parameters.values)
        if isinstance(entry, Formula):
            return entry
        if numeric and any(abs(number) > sys.float_info.max for number in entry.terms.values()):
            raise too_large(mechanism.description)
        return written(entry, levels)

    named = replace(with_kept(constants(parameters.scene), parameters.kept), numeric=mechanism)
    places = places_of(parameters.scene, named.tree)
    contacts = list(contact_terms(mechanism, parameters.dry, parameters.stops))
    shared = _Shared(mechanism)
    entries = Entries(named, parameters.couplings, partial(_Symbolic, places), shared.named)
    found = []
    for head in known:
        sums, levels = entries.of(head.name), LEVELS.get(head.name, LINE)
        ordered: Callable[[Any], Sum] = partial(_in_order, block=head.name)
        if shared.sums:  # the entries are sums of names
            ordered, levels = summed, ()
        added = [x for x in contacts if x.block == head.name]
        for term in added:
            sums[term.joint][0] = sums[term.joint][0] + of(term.name).times(term.sign)
        block: list[tuple[Sum, ...]] = []
        for i, row in enumerate(sums):
            mirrored = [block[j][i] for j in range(i)] if head.shape == "symmetric" else []
            more = (write(ordered(x), levels) for x in row[len(mirrored) :])
            block.append((*mirrored, *more))
        names = [*shared.definitions(head, block, write)]
        if head.name in ("G", "Q"):
            assert isinstance(entries.at, _Symbolic)
            names += entries.at.definitions(sums, write)
        names += [x.defined._replace(value=write(x.defined.value)) for x in added]
        if head.side == "closures":
            within = {atom.name for row in sums for x in row for atom in summed(x).atoms()}
            laws = (x for x in parameters.laws if x.name in within)
            names += [x._replace(value=write(x.value)) for x in laws]
        found.append(Block(head, tuple(block), tuple(names)))
    formulas: list[Any] = [entry for block in found for row in block.rows for entry in row]
    formulas += [name.value for block in found for name in block.where]
    atoms = {atom for entry in formulas for atom in entry.atoms()}
    atoms |= {atom.speed for atom in atoms if isinstance(atom.speed, Atom)}
    used = {atom.name for atom in atoms if atom.parameter}
    return Equations(mechanism, tuple(found), parameters, used, numeric)


# -- rows on symbols -------------------------------------------------------------------------------


class _Symbolic(Recorded):
    """The rows of a mechanism whose numbers are symbols, at a state of symbols."""

    def __init__(self, places: Places, mechanism: Mechanism) -> None:
        super().__init__(mechanism, ("qd",), by_direction=False, arithmetic=SYMBOLIC)
        self.places = places
        joints = range(mechanism.n)
        self.relative: dict[str, Any] = {
            "q": [of(Atom(Role.angle, (k,))) for k in joints],
            "qd": [of(Atom(Role.rate, (k,))) for k in joints],
        }

    def builder(self) -> NamedRows:
        """Return the writer of the rows; see `Recorded`."""
        self.written = NamedRows(self.mechanism, self.places)
        return self.written

    def more(self, equations: EquationsOfMotion) -> Mapping[str, Any]:
        """Return the values of the names; see `Recorded`."""
        return self.written.given

    def series(self, *given: Any, **named: Any) -> Series:
        """Return the series, which is kept; see `Recorded`."""
        self.expanded = super().series(*given, **named)
        return self.expanded

    def definitions(self, entries: Matrix, write: Callable[..., Any]) -> Iterator[Definition]:
        """Yield the definitions of the names that the entries use."""
        atoms = {atom for row in entries for entry in row for atom in summed(entry).atoms()}
        for name, value in self.written.used(self.expanded, atoms):
            if not name.is_root:
                value = _in_order(value, "S") if name.is_component else value
                value = write(value, LINE if name.is_component else ())
            yield Definition(name.atom.name, value, name.unit, name.meaning)

    def absolute(self, name: str) -> list[Any]:
        """Return the angles of links as sums, their rates as one atom each."""
        angles: list[Any] = super().absolute("q")
        return angles if name == "q" else [of(Atom(Role.rate, _joints(angle))) for angle in angles]

    def half_slopes(self, values: Sequence[Any]) -> list[list[Any]]:
        """Return half of the derivatives by absolute rates; see `Recorded`."""
        rates = [atom for rate in self.absolute("qd") for atom in rate.atoms()]
        slopes = [summed(entry).half_slopes() for entry in values]
        return [[row.get(rate, ZERO) for rate in rates] for row in slopes]


def _joints(angle: Any) -> tuple[int, ...]:
    """Return the joints of a sum of angles."""
    return tuple(sorted(atom.place[0] for atom in angle.atoms()))


def _smooth(ratio: Sum) -> Sum:
    speed, rates = ratio.atoms()
    return of(Atom(Role.function, rates.place, "tanh", speed))


SYMBOLIC = Arithmetic(
    cos=lambda angle: of(Atom(Role.function, _joints(angle), "cos")),
    sin=lambda angle: of(Atom(Role.function, _joints(angle), "sin")),
    power=power,
    divide=divide,
    functions={"tanh": _smooth},
)

# -- the order of terms ----------------------------------------------------------------------------


def _in_order(entry: Any, block: str) -> Sum:
    """Return an entry of a block with its terms ordered from the ground on, body by body."""
    entry = simplified(summed(entry))
    return in_place(Sum(_gathered(entry)) if block == "C" else entry, block)


def in_place(entry: Sum, block: str) -> Sum:
    """Return the terms of an entry in the order of writing."""
    terms = entry.terms
    angles = dict.fromkeys(x.place for term in terms for x, _ in term if x.role == Role.function)
    seen = {joints: place for place, joints in enumerate(angles)}
    return Sum({x: terms[x] for x in sorted(terms, key=lambda term: _place(block, term, seen))})


def _gathered(entry: Sum) -> dict[Monomial, Number]:
    """Return the terms with the rates before one product added: (qd1 + qd2) - qd1 is qd2."""
    found: dict[Monomial, dict[int, Number]] = {}
    for monomial, number in entry.terms.items():
        rates = next(atom for atom, _ in monomial if atom.role == Role.rate)
        joints = found.setdefault(tuple(x for x in monomial if x[0] is not rates), {})
        for joint in rates.place:
            joints[joint] = joints.get(joint, 0) + number
    gathered = {}
    for rest, joints in found.items():
        for number in set(joints.values()) - {0}:
            moved = tuple(sorted(k for k, x in joints.items() if x == number))
            gathered[merged(rest, ((Atom(Role.rate, moved), 1),))] = number
    return gathered


def _place(block: str, monomial: Monomial, seen: dict[tuple[int, ...], int]) -> tuple[Any, ...]:
    """Return the sort key of a term in an entry; `seen` orders angles.

    M is ordered by bodies, C by pairs of links, G and Q by links: gravity, loads, springs; terms at
    joints come last.  Equal keys keep the order of the rows.
    """
    atoms: dict[int, list[Atom]] = defaultdict(list)
    for atom, _ in monomial:
        atoms[atom.role].append(atom)
    bodies = atoms[Role.mass] + atoms[Role.inertia]
    body = [(x.place[0], x.name[:2] == "mp", x.role) for x in bodies]
    lengths = [x.place for x in atoms[Role.length]]
    moved = [(x.place[0], "~") for x in atoms[Role.angle]]  # displacements
    calls = [x for x in atoms[Role.function] if x.speed is None]
    angles, sines_first = [seen[x.place] for x in calls], [-ord(x.name[0]) for x in calls]
    if block == "M":
        return body, len(calls), len(moved)
    if block == "C":
        return [k for k, _ in sorted(lengths + moved)], body, sines_first, len(moved)
    if block == "S":
        return not calls, angles, [letters[-1] for _, letters in lengths]
    if block not in ("G", "Q"):
        names = [x.name for x in calls]
        return not (calls or atoms[Role.angle]), list(zip(angles, names, strict=True))
    link = max((k for x in calls for k in x.place), default=inf)
    force = min(atoms[Role.force], default=Atom(Role.force, (0,), " "))
    if force.name[0] == "F" and block == "Q":  # turns with its link
        return -1, force.place, -sum(len(x.place) for x in calls), sines_first
    if force.name[0] == "T":
        link = force.place[0]
    stretch = [-ord(x.name[-1]) for x in atoms[Role.stretch]]
    kind = 0 if body else {"F": 1, "T": 2}.get(force.name[0], 3)
    free = kind == 3 and not stretch
    if body:
        return link, kind, body, force.place, True, stretch, sorted(lengths + moved)
    return link, kind, body, force.place, not moved, stretch, [] if free else lengths


# -- names for shared parts ------------------------------------------------------------------------


class _Shared:
    """Names for the entries of W and of W J, from which M and C are formed as J^T W J.

    W is the matrix in absolute angles and displacements.  Only long chains get names: expanded,
    their text grows with the fifth power of the number of links.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        carrying: dict[int, int] = {}  # joints that carry each link
        for k in mechanism.order:
            above = mechanism.above[k]
            carrying[k] = 1 if above is None else carrying[above] + 1
        self.long = sum(carrying.values()) > LONG
        self.sums: dict[str, Sum] = {}  # of the block that is written

    def named(self, block: str, level: int, W: Matrix) -> Matrix:
        """Return W with a name for each entry of more than one symbol."""
        if not self.long:
            return W
        letter, found = SHARED[block][level][0], []
        for j, row in enumerate(W):
            found.append([*map(summed, row)])
            for k, entry in enumerate(found[j]):
                if len([*entry.atoms()]) > 1:
                    mirrored = k < j and summed(W[k][j]) == entry
                    name = letter + (f"{k + 1}_{j + 1}" if mirrored else f"{j + 1}_{k + 1}")
                    self.sums[name] = entry
                    found[j][k] = of(Atom(Role.stretch, (j, k), name))
        return found

    def definitions(
        self, head: Head, block: Sequence[Sequence[Sum]], write: Callable[..., Sum]
    ) -> Iterator[Definition]:
        """Yield the names that a block uses, in the order in which to compute them."""
        used = {atom.name for row in block for entry in row for atom in entry.atoms()}
        for name in reversed(self.sums):
            if name in used:
                used |= {atom.name for atom in self.sums[name].atoms()}
        for name, entry in self.sums.items():
            if name in used:
                (first, told), second = SHARED[head.name]
                if name[0] == first:
                    value = write(_in_order(entry, head.name), LEVELS["C"])
                else:
                    value, told = write(entry, ()), second[1]
                yield Definition(name, value, head.unit, told, "j_k")
        self.sums.clear()
