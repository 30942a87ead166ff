"""Links that stand still whatever moves, and the couplings and closures that hold each.

Its mass acts on nothing but what holds it.  A link stands still if neither its angle nor its tip
has a rate in the null space of Psi, in any pose that closes.  Such poses are found from starts that
are spread over all angles, so that those of every branch are among them.

What is left out of Psi only lets more links move: laws of couplings that say more than a number.
Few poses that close, or rows of Psi that are almost dependent, decide nothing: links move then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robodyn.scene.expressions import NotLinearError, linear
from robodyn.scene.scene import Coupling, Description, Law
from robodyn.tables.arrays import Array, Complex

if TYPE_CHECKING:
    from robodyn.mechanics.planar_model import Mechanism

STARTS, STEPS = 48, 60  # of Newton's method, damped
CLOSED = 1e-12  # part of a length of the mechanism below which a gap is zero
TINY = 1e-300  # beside which nothing is zero
LEAST = 6  # poses that close, without which nothing is decided
DEPENDENT = 1e-5  # part of the largest singular value below which rows count as dependent
STILL = 1e-7  # part of the largest rate of a motion below which another is zero


class Holds(NamedTuple):
    """Couplings and closures, by their numbers."""

    couplings: frozenset[int] = frozenset()
    closures: frozenset[int] = frozenset()

    def and_those_of(self, others: list[Holds]) -> Holds:
        """These and others."""
        return Holds(
            self.couplings.union(*(x.couplings for x in others)),
            self.closures.union(*(x.closures for x in others)),
        )


def standing(mechanism: Mechanism) -> dict[int, Holds]:
    """Return the links that stand still, each with what holds it.

    Each closure is tried alone before those that share links with it: what one loop holds is found
    too where others cannot close.
    """
    from robodyn.mechanics.mechanism import build

    scene = mechanism.description
    kept = {c: x for c, y in enumerate(scene.couplings) if (x := steady(y)) is not None}
    if not (kept or scene.closures):
        return {}
    bare = tuple(
        link._replace(m=0.0, r=0j, I=0.0, payload=0.0, damping=0.0, friction=None, motor=None)
        for link in scene.links
    )
    none: dict[str, Any] = {"gravity": 0j, "field": None, "springs": (), "loads": ()}
    alone = build(scene._replace(links=bare, couplings=tuple(kept.values()), **none))
    numbers, closures = iter(kept), range(len(scene.closures))
    each = [row.closure for row in alone.rows]
    coupling = {r: next(numbers) for r, c in enumerate(each) if c is None}
    parts = [set[int](), *({c} for c in closures), *_groups(alone)]
    found: dict[int, Holds] = {}
    for part in parts:
        rows = [r for r, c in enumerate(each) if c is None or c in part]
        for k, loaded in _Rows(alone, rows).still() if rows else ():
            bear = {rows[r] for r in loaded}
            held = frozenset(c for r in bear if (c := each[r]) is not None)
            found.setdefault(k, Holds(frozenset(coupling[r] for r in bear & {*coupling}), held))
    return found


def steady(coupling: Coupling) -> Coupling | None:
    """A coupling that is linear in joints and keeps to that; None for a law that is not."""
    if coupling.law is None:
        return coupling
    if coupling.cam is not None or not isinstance(coupling.law, Law):
        return None
    try:
        parts = linear(coupling.law.node)
    except (NotLinearError, ArithmeticError):
        return None
    if parts.pop("t", 0.0):
        return None
    angle = parts.pop("", 0.0)
    terms = tuple((int(name[1:]), x) for name, x in parts.items() if x)
    return coupling._replace(terms=terms, angle=angle, law=None)


def _groups(mechanism: Mechanism) -> list[set[int]]:
    """Closures that share coordinates, also by couplings, by groups of two or more."""
    found: list[tuple[set[int], set[int | None]]] = []  # closures, coordinates
    for row in mechanism.rows:
        own = {k for k, _ in (*row.P, *row.angles)} | ({row.line} - {None})
        shared = [x for x in found if row.closure in x[0] or x[1] & own]
        apart = [x for x in found if x not in shared]
        closures = set() if row.closure is None else {row.closure}
        for x in shared:
            closures, own = closures | x[0], own | x[1]
        found = [*apart, (closures, own)]
    return [closures for closures, _ in found if len(closures) > 1]


class _Rows(NamedTuple):
    """Some rows of a mechanism, in x = J q: lengths, displacements included, in its unit."""

    mechanism: Mechanism
    rows: list[int]

    def still(self) -> Iterator[tuple[int, list[int]]]:
        """Yield the links that stand still by these rows, and the rows that bear loads on them."""
        n, unit = self.mechanism.n, self.mechanism.arrays.units
        x = np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, n)) * unit
        open_ = np.arange(STARTS)
        for _ in range(STEPS):
            gap, Psi, _ = self.at(x[open_])
            left = np.abs(gap).max(axis=-1) > CLOSED
            open_, gap, Psi = open_[left], gap[left], Psi[left]
            if not len(open_):
                break
            U, s, V = np.linalg.svd(Psi, full_matrices=False)
            damped = s / (s * s + (gap * gap).sum(axis=-1)[:, None] + TINY)
            across = np.einsum("kri,kr->ki", U, gap) * damped
            x[open_] -= np.einsum("kij,ki->kj", V, across) * unit
        closed = np.delete(x, open_, axis=0)
        if len(closed) < LEAST:
            return
        _, Psi, T = self.at(closed)
        ways = self.ways(T)
        _, s, V = np.linalg.svd(Psi)
        s = np.pad(s, ((0, 0), (0, n - s.shape[-1])))
        free = s <= DEPENDENT * s[:, :1]
        moves = np.abs(np.einsum("kpij,kmj->kpim", ways, V * free[..., None]))
        still = (moves <= STILL).all(axis=(0, 2, 3))
        bearing = np.linalg.pinv(Psi.swapaxes(-1, -2), DEPENDENT)
        load = np.abs(bearing[:, None] @ ways.swapaxes(-1, -2))
        for k in np.flatnonzero(still).tolist():
            bears = load[:, k].max(axis=(0, 2))
            yield k, np.flatnonzero(bears > STILL * bears.max()).tolist()

    def at(self, x: Array) -> tuple[Array, Array, Complex]:
        """The gap (s, r), Psi (s, r, n), and dX/dx (s, n, n)."""
        mechanism, rows = self.mechanism, self.rows
        arrays, unit, n = mechanism.arrays, mechanism.unit, mechanism.n
        E, turned = np.ones(x.shape, complex), self.turned()
        for k, d in enumerate(mechanism.frames):
            if d is not None:
                E[:, k] = np.exp(1j * x[:, d])
        slides = np.isin(np.arange(n), mechanism.slides)
        X = np.where(slides, x, 1.0) * E
        T = 1j * X[:, :, None] * turned + (slides * E)[:, :, None] * np.eye(n)
        across, change = X @ arrays.P[rows].T, arrays.P[rows] @ T
        for i, r in enumerate(rows):
            if (line := mechanism.rows[r].line) is not None:
                along = E[:, line].conj()
                across[:, i] = along * (across[:, i] + arrays.ground[r])
                change[:, i] *= along[:, None]
                change[:, i, line] -= 1j * across[:, i]
        gap = across.real + arrays.offset[rows] + x @ arrays.angles[rows].T
        Psi = change.real + arrays.angles[rows]
        return gap / unit, Psi * arrays.units / unit, T

    def turned(self) -> Array:
        """Which coordinate turns the frame of each, (n, n) of ones and zeros."""
        found = np.zeros((self.mechanism.n, self.mechanism.n))
        for k, d in enumerate(self.mechanism.frames):
            if d is not None:
                found[k, d] = 1.0
        return found

    def ways(self, T: Complex) -> Array:
        """The rates of the links' tips, and of their angles times the unit, (s, n, 3, n)."""
        mechanism, n = self.mechanism, self.mechanism.n
        tips = np.zeros((n, n), complex)
        for k, tip in enumerate(mechanism.tips):
            for j, c in tip.terms:
                tips[k, j] = c
        moved, unit = tips @ T, mechanism.unit
        turns = np.broadcast_to(self.turned() * unit, moved.shape)
        ways = np.stack([moved.real, moved.imag, turns], axis=-2)
        return ways * mechanism.arrays.units / unit


def unknown_holds(
    description: Description, massless: tuple[int, ...], found: Mapping[int, Holds]
) -> Holds:
    """What holds links without masses against gravity, whose forces nobody knows."""
    if description.gravity == 0 and description.field is None:
        return Holds()
    return Holds().and_those_of([found[k] for k in massless if k in found])
