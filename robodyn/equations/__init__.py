"""The equations of motion of a scene in symbols, and what its symbols mean.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

Each matrix and vector is a `Block` of `blocks.py`; another term of either side is one
more block in `_left` or `_right`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from robodyn.equations.blocks import (
    Block,
    closures,
    coriolis_matrix,
    damping_matrix,
    mass_matrix,
)
from robodyn.equations.forces import gravity_vector, other_forces
from robodyn.equations.parameters import Parameter
from robodyn.equations.scene_symbols import SymbolicScene
from robodyn.equations.symbolic import Smooth, Symbol
from robodyn.mechanism import Mechanism


@dataclass(frozen=True, slots=True)
class Equations:
    """The blocks of equation (1) for one scene, and what its symbols mean.

    The sum of the blocks of `left`, each times its rate, is the left side; those of `right` are
    added to tau; `closures` are Psi, Psidot qd and gap.  `zero` names parameters that are 0 in the
    scene, `unused` those that have no effect.
    """

    mechanism: Mechanism
    left: tuple[Block, ...]
    right: tuple[Block, ...]
    closures: tuple[Block, ...]
    parameters: tuple[Parameter, ...]
    zero: tuple[str, ...]
    unused: tuple[str, ...]

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All of them."""
        return self.left + self.right + self.closures

    @property
    def terms(self) -> list[tuple[str, str]]:
        """The left side's terms that are not zero: a block's name and the rate it stands before."""
        return [(block.name, block.rate) for block in self.left if not block.zero]


def equations(mechanism: Mechanism, numeric: bool = False) -> Equations:
    """The equations of motion of the mechanism's scene, in symbols or with its numbers put in.

    Raises InputError where a number that is put in leaves the range of floats.
    """
    scene = SymbolicScene(mechanism, numeric)
    left, right, closing = tuple(_left(scene)), tuple(_right(scene)), tuple(closures(scene))
    atoms = {atom for block in left + right + closing for atom in block.atoms()}
    speeds = {atom.speed for atom in atoms if isinstance(atom, Smooth)}
    used = {atom.name for atom in atoms | speeds if isinstance(atom, Symbol)}
    known = scene.parameters.known.values()
    return Equations(
        mechanism=mechanism,
        left=left,
        right=right,
        closures=closing,
        parameters=tuple(x for x in known if x.name in used),
        zero=tuple(scene.parameters.zero),
        unused=() if numeric else tuple(x.name for x in known if x.name not in used),
    )


def _left(scene: SymbolicScene) -> Iterator[Block]:
    """The terms of the left side, those that the scene has."""
    yield mass_matrix(scene)
    yield coriolis_matrix(scene)
    if any(scene.mechanism.damping):
        yield damping_matrix(scene)
    gravity = gravity_vector(scene)
    if gravity is not None:
        yield gravity


def _right(scene: SymbolicScene) -> Iterator[Block]:
    """The terms beside tau, those that the scene has."""
    others = other_forces(scene)
    if others is not None:
        yield others
