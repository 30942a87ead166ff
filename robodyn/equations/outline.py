"""Which matrices and vectors the equations of motion of a scene have, and what each is called.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0                        (1)

Their entries are formulas to read (`written.py`) or recorded arithmetic (`recorded.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Literal, NamedTuple, TypeVar

from robodyn.equations.parameters import Parameter, Parameters
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Load

if TYPE_CHECKING:
    from robodyn.equations.factoring import Written

Entry = TypeVar("Entry", covariant=True)  # true unless it is zero


class Definition(NamedTuple):
    """A name that stands for a formula in the entries."""

    name: str
    value: Written
    unit: str
    meaning: str


class Head(NamedTuple):
    """What a block of equation (1) is.

    `inputs` are what it depends on; a matrix of the left side stands before `rate`.
    """

    side: Literal["left", "right", "closures"]
    name: str
    meaning: str
    unit: str
    shape: Literal["symmetric", "matrix", "diagonal", "vector"]
    inputs: tuple[str, ...] = ("q",)
    rate: str = ""


@dataclass(frozen=True, slots=True)
class Block(Generic[Entry]):
    """One matrix or vector of equation (1), row by row; a vector has one column.

    `where` are names that its entries use.
    """

    head: Head
    rows: tuple[tuple[Entry, ...], ...]
    where: tuple[Definition, ...] = ()

    @property
    def name(self) -> str:
        return self.head.name

    @property
    def shape(self) -> str:
        return self.head.shape

    @property
    def zero(self) -> bool:
        """Whether every entry is zero."""
        return not any(entry for row in self.rows for entry in row)


def heads(mechanism: Mechanism) -> Iterator[Head]:
    """The blocks that the scene has."""
    yield Head("left", "M", "mass matrix", "kg m²", "symmetric", ("q",), "qdd")
    meaning = "Coriolis and centrifugal matrix, by Christoffel symbols"
    yield Head("left", "C", meaning, "kg m²/s", "matrix", ("q", "qd"), "qd")
    if any(mechanism.damping):
        yield Head("left", "D", "damping matrix", "N m s/rad", "diagonal", (), "qd")
    loads = mechanism.description.loads
    turning = [load for load in loads if isinstance(load, Load) and load.turns]
    acting = {
        "gravity": mechanism.gamma != 0.0,
        "springs": any(spring.stiffness for spring in mechanism.description.springs),
        "loads": len(loads) > len(turning),
    }
    potentials = [name for name, present in acting.items() if present]
    if potentials:
        meaning = "gravity vector"
        if potentials != ["gravity"]:
            meaning = f"gradient of the potential energy ({', '.join(potentials)})"
        yield Head("left", "G", meaning, "N m", "vector")
    if turning or mechanism.friction or any(spring.damping for spring in mechanism.springs):
        meaning = "torques of what has no potential"
        yield Head("right", "Q", meaning, "N m", "vector", ("q", "qd"))
    if mechanism.rows:
        yield Head("closures", "Psi", "closure Jacobian, d gap/dq", "m", "matrix")
        yield Head("closures", "Psidot_qd", "closure bias", "m/s²", "vector", ("q", "qd"))
        yield Head("closures", "gap", "closure gap, first side less second", "m", "vector")


@dataclass(frozen=True, slots=True)
class Equations(Generic[Entry]):
    """The blocks of equation (1) for one scene, and what its symbols mean.

    The sum of the blocks of `left`, each times its rate, is the left side; those of `right` are
    added to tau; `closures` are Psi, Psidot qd and gap.  `zero` names parameters that are 0 in the
    scene, `unused` those that have no effect.
    """

    mechanism: Mechanism
    blocks: tuple[Block[Entry], ...]
    parameters: tuple[Parameter, ...]
    zero: tuple[str, ...]
    unused: tuple[str, ...]

    def side(self, name: str) -> tuple[Block[Entry], ...]:
        """The blocks of the side `left` or `right`, or of the `closures`."""
        return tuple(block for block in self.blocks if block.head.side == name)

    @property
    def terms(self) -> list[tuple[str, str]]:
        """The left side's terms that are not zero: a block's name and the rate it stands before."""
        return [(block.name, block.head.rate) for block in self.side("left") if not block.zero]


def with_parameters(
    mechanism: Mechanism,
    blocks: Iterable[Block[Entry]],
    parameters: Parameters,
    used: set[str],
    numeric: bool,
) -> Equations[Entry]:
    """The equations of these blocks, which use the parameters of these names."""
    known = parameters.known.values()
    return Equations(
        mechanism=mechanism,
        blocks=tuple(blocks),
        parameters=tuple(x for x in known if x.name in used),
        zero=tuple(parameters.zero),
        unused=() if numeric else tuple(x.name for x in known if x.name not in used),
    )
