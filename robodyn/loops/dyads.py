"""Loops that one or two unknown links close: two circles, or a circle and a line, intersected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn.loops.assembly_plan import Plan, Step
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Coupling

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

CLOSED = 1e-9  # a gap below this part of the loop's lengths counts as rounding


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
    tolerance = CLOSED * size
    if not step.unknown:
        gap = np.abs(K.imag) if slider else np.abs(K)
        return [], np.where(gap > tolerance, gap, 0.0), np.ones(gap.shape)
    first = c[step.unknown[0]]
    if slider:
        across = -K.imag
        square = np.abs(first) ** 2 - across**2
        along = side * np.sqrt(np.maximum(square, 0.0))
        missing = np.abs(across) - np.abs(first)
        angle = np.angle((along + 1j * across) / first)
        closes = np.where(missing > tolerance, missing, 0.0)
        return [angle], closes, np.abs(along) / np.abs(first)
    if len(step.unknown) == 1:
        missing = np.abs(np.abs(K) - np.abs(first))
        closes = np.where(missing > tolerance, missing, 0.0)
        return [np.angle(-K / first)], closes, np.ones(missing.shape)
    second = c[step.unknown[1]]
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
    return angles, np.where(missing > tolerance, missing, 0.0), sine


def known_angles(mechanism: Mechanism, known: set[int], q: Array) -> Array:
    """Absolute angles of known links; of the others, what they turn ahead of their unknown."""
    alpha = np.zeros_like(q)
    for k in mechanism.order:
        above = mechanism.parent[k]
        if k in known:
            alpha[..., k] = q[..., k] + (0.0 if above is None else alpha[..., above])
    return alpha


def coupled_angle(coupling: Coupling, joint: int, q: Array) -> Array:
    """q_joint (...) by a coupling whose other joints are known."""
    ratios = {coupling.joint: -1.0, **dict(coupling.terms)}  # sum of ratio q = -angle
    total = np.full(q.shape[:-1], coupling.angle)
    for k, ratio in ratios.items():
        if k != joint:
            total = total + ratio * q[..., k]
    return -total / ratios[joint]
