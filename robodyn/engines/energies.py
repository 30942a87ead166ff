"""Kinetic and potential energy of a scene at one state, over any kind of numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robodyn.engines import expression
from robodyn.engines.expression import Value
from robodyn.mechanics.planar_model import Mechanism

Number = Callable[[float], Value]  # what stands for a number of the scene


def energies(
    mechanism: Mechanism, number: Number, q: Sequence[Value], qd: Sequence[Value]
) -> tuple[Value, Value]:
    """KE and PE less the mechanism's constant, J, at q, qd (n)."""
    alpha, w = list(q), list(qd)
    for k in mechanism.order:
        above = mechanism.parent[k]
        if above is not None:
            alpha[k], w[k] = alpha[above] + alpha[k], w[above] + w[k]
    E = [(expression.cos(angle), expression.sin(angle)) for angle in alpha]
    KE: Value = 0.0
    PE: Value = 0.0
    for j, k, entry in mechanism.A:
        if j == k:
            KE = KE + 0.5 * number(entry.real) * w[j] * w[j]
            continue
        (a, b), (c, d) = E[j], E[k]
        along, across = a * c + b * d, a * d - b * c
        KE = KE + (number(entry.real) * along - number(entry.imag) * across) * (w[j] * w[k])
    for k, weight in enumerate(mechanism.weights):
        PE = PE - (number(weight.real) * E[k][0] - number(weight.imag) * E[k][1])
        PE = PE - number(mechanism.moments[k]) * alpha[k]
    for spring in mechanism.springs:
        place = spring.between
        x, y = number(place.constant.real), number(place.constant.imag)
        for k, term in place.terms:
            re, im = number(term.real), number(term.imag)
            x = x + (re * E[k][0] - im * E[k][1])
            y = y + (re * E[k][1] + im * E[k][0])
        longer = expression.sqrt(x * x + y * y) - number(spring.length)
        PE = PE + 0.5 * number(spring.stiffness) * longer * longer
    for hinge in mechanism.joint_springs:
        bent = q[hinge.joint] - number(hinge.angle)
        PE = PE + 0.5 * number(hinge.stiffness) * bent * bent
    return KE, PE
