"""What the parts of a scene's equations are called, and what its symbols mean."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from robodyn.equations.outline import Block, Definition, Entry, Equations
from robodyn.equations.parameters import Parameter
from robodyn.errors import printable
from robodyn.scene.scene import Point

Place = tuple[int, int]  # row and column


class Variable(NamedTuple):
    """Coordinates, torques or multipliers: their letter, numbers from 1, unit and meaning."""

    name: str
    numbers: str
    unit: str
    meaning: str


def title(equations: Equations[Any]) -> str:
    """The name of the scene, in one line."""
    return printable(equations.mechanism.name)


def plain_name(block: Block[Any]) -> str:
    """The block's name as it is read."""
    return block.name.replace("_", " ")


def numbers(block: Block[Any], i: int, j: int, between: str) -> str:
    """The numbers of an entry, from 1; `between` parts them where both may have two digits."""
    many = max(len(block.rows), len(block.rows[0])) > 9
    place = [i] if block.shape == "vector" else [i, j]
    return (between if many else "").join(str(k + 1) for k in place)


def listed(block: Block[Entry]) -> list[tuple[list[Place], Entry]]:
    """The entries that are not zero, each with its place; equal ones of M with both places."""
    found = []
    for i, row in enumerate(block.rows):
        for j, entry in enumerate(row):
            if not entry or (block.shape == "symmetric" and j < i):
                continue
            twin = block.shape == "symmetric" and i != j
            found.append(([(i, j), (j, i)] if twin else [(i, j)], entry))
    return found


def zeros(block: Block[Any]) -> list[Place]:
    """The places of the entries that are zero."""
    return [(i, j) for i, row in enumerate(block.rows) for j, x in enumerate(row) if not x]


def variables(equations: Equations[Any]) -> list[Variable]:
    """q1, q2, ..., tau1, ... and lambda1, ..., and what dots on q mean."""
    description = equations.mechanism.description
    links = description.links
    found = []
    for k, link in enumerate(links):
        carrier = link.hangs_from.link
        zero = "+X" if carrier is None else links[carrier].name
        found.append(Variable("q", f"{k + 1}", "rad", f"angle of {link.name} from {zero}"))
    for k in equations.mechanism.actuated:
        found.append(Variable("tau", f"{k + 1}", "N m", f"torque on {links[k].name} at its joint"))

    def body(point: Point) -> str:
        return "the ground" if point.link is None else links[point.link].name

    rows = []
    for closure in description.closures:
        first, second = body(closure.first), body(closure.second)
        if closure.along is None:
            rows += [f"force of {second} on {first}, along {axis}" for axis in "XY"]
        else:
            rows.append(f"force of the line on {first}, along the line's normal")
    for c, coupling in enumerate(description.couplings):
        driven = links[coupling.joint].name
        rows.append(f"R{c + 1} times this is the torque of coupling {c + 1} on {driven}")
    found += [Variable("lambda", f"{k + 1}", "N", meaning) for k, meaning in enumerate(rows)]
    for definitions, _ in new_definitions(equations):
        found += [Variable(x.name[0], x.name[1:], x.unit, x.meaning) for x in definitions]
    return [x._replace(meaning=printable(x.meaning)) for x in found]


def equation_of_motion(equations: Equations[Any]) -> list[str]:
    """The equation of motion in matrices, and below it what the closures demand."""
    left = " + ".join(f"{name} {rate}".strip() for name, rate in equations.terms) or "0"
    right = "".join(f" + {block.name}" for block in equations.side("right") if not block.zero)
    if not equations.side("closures"):
        return [f"{left} = tau{right}"]
    return [
        f"{left} = tau{right} + Psi^T lambda",
        "gap = 0    Psi qd = 0    Psi qdd + Psidot qd = 0",
    ]


def new_definitions(equations: Equations[Any]) -> list[tuple[list[Definition], Block[Any]]]:
    """Each block, with the names that it is the first to use."""
    told: set[str] = set()
    found = []
    for block in equations.blocks:
        found.append(([entry for entry in block.where if entry.name not in told], block))
        told.update(entry.name for entry in block.where)
    return found


def unit_and_meaning(parameter: Parameter) -> str:
    """For a comment behind its value."""
    return ", ".join(part for part in (parameter.unit, parameter.meaning) if part)


def is_coriolis(equations: Equations[Any]) -> bool:
    """Whether there is a C, of which to tell that it is the Christoffel one."""
    return ("C", "qd") in equations.terms


def left_out(equations: Equations[Any], shown: Callable[[str], str] = str) -> list[str]:
    """Sentences on the parameters that do not appear, each name as `shown` writes it."""
    told = {
        "Left out, being 0 in this scene": equations.zero,
        "Without effect on the motion": equations.unused,
    }
    return [f"{text}: {', '.join(map(shown, names))}." for text, names in told.items() if names]
