"""The parts of a scene's equations of motion, with their names and symbols.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

Entries are formulas to read (`written.py`) or recorded arithmetic (`recorded.py`).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Generic, Literal, NamedTuple, TypeVar

from robodyn.elements.contacts import COMPLIANT, STICKS
from robodyn.equations.named_laws import SWITCHES, Definition, Formula
from robodyn.equations.parameters import Parameter, Parameters
from robodyn.errors import printable
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Point

Entry = TypeVar("Entry", covariant=True)  # true unless it is zero
Place = tuple[int, int]  # row and column


class Variable(NamedTuple):
    """Coordinates, torques or multipliers: letter, numbers from 1, unit and meaning."""

    name: str
    numbers: str
    unit: str
    meaning: str


class Head(NamedTuple):
    """Description of a block of the equations.

    `inputs` are its arguments.  A matrix of the left side stands before `rate`.  The `sum` is the
    vector of joint torques, with pin forces if there are any.
    """

    side: Literal["left", "right", "closures", "sum"]
    name: str
    meaning: str
    unit: str
    shape: Literal["symmetric", "matrix", "diagonal", "vector"]
    inputs: tuple[str, ...] = ("q",)
    rate: str = ""


@dataclass(frozen=True, slots=True)
class Block(Generic[Entry]):
    """A matrix or vector of the equations, row by row; a vector has one column.

    `where` lists the names that its entries use.
    """

    head: Head
    rows: tuple[tuple[Entry, ...], ...]
    where: tuple[Definition, ...] = ()

    @property
    def name(self) -> str:
        return self.head.name

    @property
    def plain_name(self) -> str:
        """The name in plain text."""
        return "dgap/dt" if self.name == "gap_t" else self.name.replace("_", " ")

    @property
    def vector(self) -> bool:
        return self.head.shape == "vector"

    @property
    def zeros(self) -> list[Place]:
        """The indices of zero entries."""
        return [(i, j) for i, row in enumerate(self.rows) for j, x in enumerate(row) if not x]

    @property
    def zero(self) -> bool:
        """Whether every entry is zero."""
        return not self.listed()

    def listed(self) -> list[tuple[list[Place], Entry]]:
        """Return the nonzero entries with their indices; symmetric pairs share an entry."""
        symmetric = self.head.shape == "symmetric"
        return [
            ([(i, j), (j, i)] if symmetric and i < j else [(i, j)], entry)
            for i, row in enumerate(self.rows)
            for j, entry in enumerate(row)
            if entry and not (symmetric and j < i)
        ]

    def numbers(self, i: int, j: int, between: str) -> str:
        """Return the indices of an entry from 1, separated by `between` if they may be long."""
        many = max(len(self.rows), len(self.rows[0])) > 9
        return (between if many else "").join(str(k + 1) for k in ([i] if self.vector else [i, j]))


def load_unit(mechanism: Mechanism) -> str:
    """Return the unit of joint loads: N m, or N for sliding joints."""
    return _units(mechanism, "N m", "N")


def _units(mechanism: Mechanism, *units: str) -> str:
    """Return the first unit if all joints turn, the last if all slide, else all of them."""
    slides = len(mechanism.slides)
    if slides in (0, mechanism.n):
        return units[-1 if slides else 0]
    return f"{', '.join(units[:-1])} or {units[-1]}"


def heads(mechanism: Mechanism) -> Iterator[Head]:
    """Yield the blocks that the scene has; only those of closures if links have no masses.

    Raises MassError if there are no closures then.
    """
    unit = partial(_units, mechanism)
    if not mechanism.rows:
        mechanism.check_masses()
    if not mechanism.massless:
        yield from _heads_of_motion(mechanism)
    if mechanism.rows:
        t = ("t",) if mechanism.driven else ()
        at = ("q", *t)
        yield Head("closures", "Psi", "closure Jacobian, d gap/dq", unit("m", "1"), "matrix", at)
        yield Head("closures", "Psidot_qd", "closure bias", "m/s²", "vector", ("q", "qd", *t))
        yield Head("closures", "gap", "closure gap, first side less second", "m", "vector", at)
        if t:
            yield Head("closures", "gap_t", "d gap/dt of laws of the time", "m/s", "vector", at)


def _heads_of_motion(mechanism: Mechanism) -> Iterator[Head]:
    """Yield the blocks that act besides tau."""
    unit, load = partial(_units, mechanism), load_unit(mechanism)
    yield Head("left", "M", "mass matrix", unit("kg m²", "kg m", "kg"), "symmetric", ("q",), "qdd")
    meaning = "Coriolis and centrifugal matrix, by Christoffel symbols"
    rates = unit("kg m²/s", "kg m/s", "kg/s")
    yield Head("left", "C", meaning, rates, "matrix", ("q", "qd"), "qd")
    if any(mechanism.damping):
        damping = unit("N m s/rad", "N s/m")
        yield Head("left", "D", "damping matrix", damping, "diagonal", (), "qd")
    elements = mechanism.elements
    acting = {
        "gravity": mechanism.gamma != 0.0,
        "springs": any(x.stored() is not None for x in elements),
        "loads": any(x.steady for x in elements) or any(mechanism.moments),
    }
    potentials = [name for name, present in acting.items() if present]
    if potentials:
        meaning = "gravity vector"
        if potentials != ["gravity"]:
            meaning = f"gradient of the potential energy ({', '.join(potentials)})"
        yield Head("left", "G", meaning, load, "vector")
    spends = any(x.changes_energy and x.spent() is not None for x in elements)
    if spends or mechanism.contacts & {STICKS, COMPLIANT}:
        meaning = f"{unit('torques', 'forces')} of what has no potential"
        inputs = ("q", "qd", "t") if mechanism.timed else ("q", "qd")
        yield Head("right", "Q", meaning, load, "vector", inputs)


@dataclass(frozen=True, slots=True)
class Equations(Generic[Entry]):
    """The blocks of a scene's equations, and the meaning of their symbols.

    The left side is the sum of the blocks `left`, each times its rate.  Blocks `right` are added to
    tau.  `closures` are Psi, Psidot qd and gap.  `used` has the names of parameters that occur.
    """

    mechanism: Mechanism
    blocks: tuple[Block[Entry], ...]
    known: Parameters
    used: set[str]
    numeric: bool

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that occur in the entries."""
        return tuple(x for x in self.known.known.values() if x.name in self.used)

    @property
    def zero(self) -> tuple[str, ...]:
        """The names of parameters that are 0 in the scene."""
        return tuple(self.known.zero)

    @property
    def unused(self) -> tuple[str, ...]:
        """The names of parameters without effect."""
        return () if self.numeric else tuple(x for x in self.known.known if x not in self.used)

    @property
    def title(self) -> str:
        """The name of the scene, on one line."""
        return printable(self.mechanism.name)

    def side(self, name: str) -> tuple[Block[Entry], ...]:
        """Return the blocks of `left`, `right` or `closures`."""
        return tuple(block for block in self.blocks if block.head.side == name)

    @property
    def terms(self) -> list[tuple[str, str]]:
        """The nonzero terms of the left side: name of the block, and its rate."""
        return [(block.name, block.head.rate) for block in self.side("left") if not block.zero]

    @property
    def others(self) -> list[Block[Entry]]:
        """The nonzero blocks besides tau."""
        return [block for block in self.side("right") if not block.zero]

    def told(self) -> list[str]:
        """Return the equation of motion in matrices, and the conditions of the closures."""
        left = " + ".join(f"{name} {rate}".strip() for name, rate in self.terms) or "0"
        right = "".join(f" + {block.name}" for block in self.others)
        if not self.side("closures"):
            return [f"{left} = tau{right}"]
        rate = "Psi qd + dgap/dt" if self.mechanism.driven else "Psi qd"
        closed = f"gap = 0    {rate} = 0    Psi qdd + Psidot qd = 0"
        if self.mechanism.massless:
            return [closed]
        return [f"{left} = tau{right} + Psi^T lambda", closed]

    def driven(self, name: str) -> list[str]:
        """Return the joint torques: `name` with the joint's number, or 0 if not actuated."""
        joints, driven = range(self.mechanism.n), self.mechanism.actuated
        return [name.format(k + 1) if k in driven else "0" for k in joints]

    def defined(self) -> Iterator[tuple[list[Definition], Block[Entry]]]:
        """Yield each block with the definitions that it is the first to use."""
        told: set[str] = set()
        for block in self.blocks:
            yield [entry for entry in block.where if entry.name not in told], block
            told.update(entry.name for entry in block.where)

    def variables(self) -> list[Variable]:
        """Return q1, q2, ..., tau1, ... and lambda1, ..., and the meaning of dots on q."""
        description = self.mechanism.description
        links = description.links
        found = []
        for k, link in enumerate(links):
            carrier = link.hangs_from.link
            zero = "+X" if carrier is None else links[carrier].name
            if link.turn != 1.0:
                zero += f" turned by {math.degrees(cmath.phase(link.turn)):.9g} deg"
            unit, meaning = "rad", f"angle of {link.name} from {zero}"
            if link.slides:
                unit, meaning = "m", f"displacement of {link.name} along its axis"
            found.append(Variable("q", f"{k + 1}", unit, meaning))
        for k in self.mechanism.actuated:
            unit, meaning = "N m", f"torque on {links[k].name} at its joint"
            if links[k].slides:
                unit, meaning = "N", f"force on {links[k].name} along its axis"
            found.append(Variable("tau", f"{k + 1}", unit, meaning))

        def body(point: Point) -> str:
            return "the ground" if point.link is None else links[point.link].name

        rows = []
        for c, closure in enumerate(description.closures):
            first, second = body(closure.first), body(closure.second)
            if closure.along is None:
                rows += [f"force of {second} on {first}, along {axis}" for axis in "XY"]
            else:
                rows.append(f"force of the line on {first}, along the line's normal")
            if closure.aligned is not None:
                rows.append(f"L{c + 1} times this is the moment of closure {c + 1} on {first}")
        for c, coupling in enumerate(description.couplings):
            driven = links[coupling.joint]
            told = f"coupling {c + 1} on {driven.name}"
            size = "" if driven.slides else f"R{c + 1} times this is the "
            rows.append(f"{size}{'force' if driven.slides else 'torque'} of {told}")
        found += [Variable("lambda", f"{k + 1}", "N", meaning) for k, meaning in enumerate(rows)]
        if self.mechanism.timed:
            found.append(Variable("t", "", "s", "time"))
        for definitions, _ in self.defined():
            lines = (
                Variable(x.name[0], x.numbers or x.name[1:], x.unit, x.meaning) for x in definitions
            )
            found += dict.fromkeys(lines)
        return [x._replace(meaning=printable(x.meaning)) for x in found]

    def remarks(
        self,
        shown: Callable[[str], str] = str,
        christoffel: str = "C is the Christoffel one: Mdot - 2C is skew-symmetric.",
    ) -> Iterator[str]:
        """Yield sentences on C and on missing parameters, whose names `shown` formats."""
        if christoffel and ("C", "qd") in self.terms:
            yield christoffel
        named = [entry.value for block in self.blocks for entry in block.where]
        if any(isinstance(x, Formula) and x.switches for x in named):
            yield SWITCHES
        if self.zero:
            yield f"Left out, being 0 in this scene: {', '.join(map(shown, self.zero))}."
        if self.unused:
            yield f"Without effect on the motion: {', '.join(map(shown, self.unused))}."
