"""Right-hand sides written out by hand, as floats, for the bench to measure the generated ones by.

They are the textbook's equations: (27) of the 2R arm and (33) of the four-bar broken at one
joint, with what does not change folded into constants.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from robodyn.mechanics.mechanism import Mechanism

Rates = Callable[[float, NDArray[np.float64]], list[float]]


def two_link_rates(arm: Mechanism) -> Rates:
    """dy/dt of a 2R arm without torques: M qdd = -C qd - G by Cramer's rule."""
    upper, fore = arm.description.links
    g, r1, r2 = -arm.gamma.imag, upper.r.real, fore.r.real
    b = fore.m * upper.l * r2
    d = fore.m * r2**2 + fore.I
    a = upper.m * r1**2 + upper.I + fore.m * upper.l**2
    w1, w2 = (upper.m * r1 + fore.m * upper.l) * g, fore.m * r2 * g

    def rates(t: float, y: NDArray[np.float64]) -> list[float]:
        q1, q2, qd1, qd2 = y.tolist()
        bc, h = b * cos(q2), b * sin(q2)
        G2 = w2 * cos(q1 + q2)
        f2 = -h * qd1 * qd1 - G2
        f1 = h * qd2 * (2 * qd1 + qd2) - w1 * cos(q1) - G2
        M12 = d + bc
        M11 = a + d + 2 * bc
        det = M11 * d - M12 * M12
        return [qd1, qd2, (d * f1 - M12 * f2) / det, (M11 * f2 - M12 * f1) / det]

    return rates


def four_bar_rates(linkage: Mechanism) -> Rates:
    """dy/dt of a four-bar without torques, q = (crank, coupler relative, rocker), by (33)."""
    crank, coupler, rocker = linkage.description.links
    g, r1, r2, r3 = -linkage.gamma.imag, crank.r.real, coupler.r.real, rocker.r.real
    l1, l2, l3 = crank.l, coupler.l, rocker.l
    b = coupler.m * l1 * r2
    d = coupler.m * r2**2 + coupler.I
    a = crank.m * r1**2 + crank.I + coupler.m * l1**2
    M33 = rocker.m * r3**2 + rocker.I
    w1, w2 = (crank.m * r1 + coupler.m * l1) * g, coupler.m * r2 * g
    w3 = rocker.m * r3 * g

    def rates(t: float, y: NDArray[np.float64]) -> list[float]:
        q1, q2, q3, qd1, qd2, qd3 = y.tolist()
        q12, qd12 = q1 + q2, qd1 + qd2
        c1, s1, c12, s12 = cos(q1), sin(q1), cos(q12), sin(q12)
        c3, s3 = cos(q3), sin(q3)
        bc, h = b * cos(q2), b * sin(q2)
        # f = -C qd - G
        G2 = w2 * c12
        f1 = h * qd2 * (2 * qd1 + qd2) - w1 * c1 - G2
        f2 = -h * qd1 * qd1 - G2
        f3 = -w3 * c3
        # M^-1 of the chain of two links
        M12 = d + bc
        M11 = a + d + 2 * bc
        det = M11 * d - M12 * M12
        i11, i12, i22 = d / det, -M12 / det, M11 / det
        # Psi and Psidot qd
        p12, p22 = -l2 * s12, l2 * c12
        p11, p21 = p12 - l1 * s1, p22 + l1 * c1
        p13, p23 = l3 * s3, -l3 * c3
        v1, v12, v3 = qd1 * qd1, qd12 * qd12, qd3 * qd3
        n1 = -l1 * c1 * v1 - l2 * c12 * v12 + l3 * c3 * v3
        n2 = -l1 * s1 * v1 - l2 * s12 * v12 + l3 * s3 * v3
        # M^-1 f, M^-1 Psi^T, and the 2x2 system for the multipliers
        a1, a2, a3 = i11 * f1 + i12 * f2, i12 * f1 + i22 * f2, f3 / M33
        x11, x21, x31 = i11 * p11 + i12 * p12, i12 * p11 + i22 * p12, p13 / M33
        x12, x22, x32 = i11 * p21 + i12 * p22, i12 * p21 + i22 * p22, p23 / M33
        S11 = p11 * x11 + p12 * x21 + p13 * x31
        S12 = p11 * x12 + p12 * x22 + p13 * x32
        S22 = p21 * x12 + p22 * x22 + p23 * x32
        e1 = p11 * a1 + p12 * a2 + p13 * a3 + n1
        e2 = p21 * a1 + p22 * a2 + p23 * a3 + n2
        det = S11 * S22 - S12 * S12
        k1, k2 = (S22 * e1 - S12 * e2) / det, (S11 * e2 - S12 * e1) / det
        return [
            qd1,
            qd2,
            qd3,
            a1 - x11 * k1 - x12 * k2,
            a2 - x21 * k1 - x22 * k2,
            a3 - x31 * k1 - x32 * k2,
        ]

    return rates
