"""Chains of dyads: in which order loops are closed, and how one or two unknown links close one.

What follows from couplings comes first, then dyads by turns (two circles, or a circle and a line,
intersected); what is left is closed by Newton's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Coupling

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

CLOSED = 1e-9  # a gap below this part of the loop's lengths counts as rounding


@dataclass(frozen=True, slots=True)
class Step:
    """One closure solved for its unknown links, in the order of the loop from its first side."""

    closure: int
    unknown: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """How a mechanism is assembled: dyads in order, then what only Newton's method closes."""

    coupled: tuple[tuple[int, int], ...]  # joints that follow from couplings: joint, coupling
    turns_with: tuple[int | None, ...]  # the unknown link that each link turns with; None: known
    steps: tuple[Step, ...]
    rest: tuple[int, ...]  # links left unknown

    @property
    def two_way(self) -> tuple[int, ...]:
        """The closures that can close in two ways."""
        return tuple(step.closure for step in self.steps if step.unknown)


@lru_cache(maxsize=64)
def assembly_plan(mechanism: Mechanism) -> Plan:
    """The order in which the closures can be solved; InputError where joints are left free."""
    turns_with: list[int | None] = [None] * mechanism.n
    coupled, open_couplings = _resolve_couplings(mechanism)
    given = {*mechanism.actuated, *(joint for joint, _ in coupled)}
    for k in mechanism.order:
        above = mechanism.parent[k]
        turns_with[k] = k if k not in given else None if above is None else turns_with[above]
    closures = mechanism.description.closures
    loops = [_unknown_in_loop(mechanism, turns_with, c) for c in range(len(closures))]
    known: set[int] = set()
    steps: list[Step] = []
    waiting = set(range(len(loops)))
    while waiting and not open_couplings:
        for c in sorted(waiting):
            unknown = tuple(k for k in loops[c] if k not in known)
            if len(unknown) <= (2 if closures[c].along is None else 1):
                steps.append(Step(c, unknown))
                known.update(unknown)
                waiting.remove(c)
                break
        else:
            break
    rest = tuple(k for k in mechanism.passive if k not in known and k not in given)
    held = set(open_couplings).union(*(loops[c] for c in waiting))
    free = [k for k in rest if k not in held]
    freedoms = mechanism.n - len(mechanism.rows)
    if len(mechanism.actuated) < freedoms and not free:
        limit = f"{freedoms} freedoms need as many actuated joints, {len(mechanism.actuated)} are "
        limit += f"named: name more in `actuated`, or give all {mechanism.n} joint angles"
        passive = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in mechanism.passive)
        raise InputError(f"cannot assemble {passive}", where=mechanism.source, limit=limit)
    if free or (rest and mechanism.description.start is None):
        names = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in free or rest)
        limit = (
            f"neither actuated nor held by a loop: give all {mechanism.n} joint angles"
            if free
            else "in loops that are no chain of two-link closures: add a `start` configuration to "
            f"the scene, or give all {mechanism.n} joint angles"
        )
        raise InputError(f"cannot assemble {names}", where=mechanism.source, limit=limit)
    return Plan(coupled, tuple(turns_with), tuple(steps), rest)


def _resolve_couplings(mechanism: Mechanism) -> tuple[tuple[tuple[int, int], ...], set[int]]:
    """The joints that follow one after another from actuated ones, each with its coupling.

    And the joints of couplings that do not follow so.
    """
    known = set(mechanism.actuated)
    found: list[tuple[int, int]] = []
    waiting = dict(enumerate(mechanism.description.couplings))
    while True:
        unknown = {c: joints_of(coupling) - known for c, coupling in waiting.items()}
        follows = next((c for c, joints in unknown.items() if len(joints) <= 1), None)
        if follows is None:
            return tuple(found), set().union(*map(joints_of, waiting.values()))
        del waiting[follows]
        found += [(joint, follows) for joint in unknown[follows]]
        known |= unknown[follows]


def joints_of(coupling: Coupling) -> set[int]:
    return {coupling.joint, *(k for k, _ in coupling.terms)}


def _unknown_in_loop(
    mechanism: Mechanism, turns_with: Sequence[int | None], closure: int
) -> list[int]:
    """Unknown links of a closure, along its loop: first side outward, second side inward."""
    row = next(row for row in mechanism.rows if row.closure == closure)
    moved = {k for k, _ in row.P}
    sides = mechanism.description.closures[closure]
    outward = [k for k in mechanism.path(sides.first.link) if k in moved]
    inward = [k for k in reversed(mechanism.path(sides.second.link)) if k in moved]
    unknown = dict.fromkeys(turns_with[k] for k in [*outward, *inward])
    return [root for root in unknown if root is not None]


def solve_dyad(
    mechanism: Mechanism, plan: Plan, step: Step, alpha: Array, side: float
) -> tuple[list[Array], Array, Array]:
    """The angles of the step's unknown links, the distance missing (0 where it closes), a sine.

    The sine is that of the angle between the unknown links, or of a link to its slider's normal.
    """
    rows = [row for row in mechanism.rows if row.closure == step.closure]
    slider = len(rows) == 1
    # gap = K + sum_u c_u E_u over the unknown links u; a slider's is turned onto its line
    turn = 1j if slider else 1.0
    offset = rows[0].offset * 1j if slider else complex(rows[0].offset, rows[1].offset)
    K: Complex = np.full(alpha.shape[:-1], offset, complex)
    c: dict[int, Complex] = {u: np.zeros(alpha.shape[:-1], complex) for u in step.unknown}
    size = sum(abs(p) for _, p in rows[0].P) + abs(offset)
    for k, p in rows[0].P:
        term = turn * p * np.exp(1j * alpha[..., k])
        root = plan.turns_with[k]
        if root in c:
            c[root] += term
        else:
            K = K + term
    sine: Array = np.ones(K.shape)
    angles: list[Array] = []
    if not step.unknown:
        missing = np.abs(K.imag if slider else K)
    elif slider:
        first, across = c[step.unknown[0]], -K.imag
        along = side * np.sqrt(np.maximum(np.abs(first) ** 2 - across**2, 0.0))
        missing = np.abs(across) - np.abs(first)
        angles = [np.angle((along + 1j * across) / first)]
        sine = np.abs(along) / np.abs(first)
    elif len(step.unknown) == 1:
        first = c[step.unknown[0]]
        missing = np.abs(np.abs(K) - np.abs(first))
        angles = [np.angle(-K / first)]
    else:
        first, second = c.values()
        ra, rb, d = np.abs(first), np.abs(second), np.abs(K)
        missing = np.maximum(d - (ra + rb), np.abs(ra - rb) - d)
        # P - A = (x + i y) along the unit vector from A to D; Heron's product keeps y exact
        with np.errstate(invalid="ignore", divide="ignore"):
            unit = np.where(d > 0.0, -K / np.where(d > 0.0, d, 1.0), 1.0)
            x = np.where(d > 0.0, ((ra - rb) * (ra + rb) / d + d) / 2.0, 0.0)
            heron = ((ra + rb) + d) * ((ra + rb) - d) * (d - (ra - rb)) * (d + (ra - rb))
            y = np.where(d > 0.0, np.sqrt(np.maximum(heron, 0.0)) / (2.0 * d), ra)
        arm = unit * (x + 1j * side * y)
        angles = [np.angle(arm / first), np.angle((-K - arm) / second)]
        sine = np.abs(d * y) / (ra * rb)
    return angles, np.where(missing > CLOSED * size, missing, 0.0), sine


def coupled_angle(coupling: Coupling, joint: int, q: Array) -> Array:
    """q_joint (...) by a coupling whose other joints are known."""
    ratios = {coupling.joint: -1.0, **dict(coupling.terms)}  # sum of ratio q = -angle
    total = np.full(q.shape[:-1], coupling.angle)
    for k, ratio in ratios.items():
        if k != joint:
            total = total + ratio * q[..., k]
    return -total / ratios[joint]
