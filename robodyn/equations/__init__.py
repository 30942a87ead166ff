"""The equations of motion of a scene, and what their symbols mean.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda        gap(q) = 0

`equations` writes their entries as formulas to read, by an algebra of its own; `recorded` takes
them from the formulas that robodyn computes with, for code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic

from robodyn.equations import blocks, force_terms
from robodyn.equations.factoring import Written
from robodyn.equations.outline import Block, Definition, Entry, heads
from robodyn.equations.parameters import Parameter, Parameters
from robodyn.equations.scene_symbols import SymbolicScene
from robodyn.equations.symbolic import Smooth, Symbol
from robodyn.mechanics.mechanism import Mechanism


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


def equations(
    mechanism: Mechanism, numeric: bool = False, watch: Callable[[float], object] | None = None
) -> Equations[Written]:
    """The equations of motion of the mechanism's scene, in symbols or with its numbers put in.

    `watch` is told now and then what part is done.  Raises InputError where a number that is put
    in leaves the range of floats.
    """
    n, rows = mechanism.n, len(mechanism.rows)
    columns = {"vector": 1, "diagonal": n, "matrix": n, "symmetric": (n + 1) / 2}
    known = list(heads(mechanism))
    total = sum((rows if head.side == "closures" else n) * columns[head.shape] for head in known)
    done = 0

    def entry_written() -> None:
        nonlocal done
        done += 1
        if watch is not None:
            watch(min(1.0, done / total))

    scene = SymbolicScene(mechanism, numeric, entry_written)
    found = [Block(head, *_entries(scene, head.name)) for head in known]
    atoms = {atom for block in found for entry in _formulas(block) for atom in entry.atoms()}
    speeds = {atom.speed for atom in atoms if isinstance(atom, Smooth)}
    used = {atom.name for atom in atoms | speeds if isinstance(atom, Symbol)}
    return with_parameters(mechanism, found, scene.parameters, used, numeric)


def _entries(scene: SymbolicScene, name: str) -> tuple[blocks.Rows, tuple[Definition, ...]]:
    """The entries of the block of this name, and the names that they use."""
    if name == "G":
        return force_terms.gravity_vector(scene)
    if name == "Q":
        return force_terms.other_forces(scene)
    return blocks.ENTRIES[name](scene), ()


def _formulas(block: Block[Written]) -> Iterator[Written]:
    """Every formula of a block, those of its definitions too."""
    yield from (name.value for name in block.where)
    for row in block.rows:
        yield from row
