"""Independent solutions of planar mechanism dynamics, to hold the program's results against.

Nothing here shares code or method with the program: lecture formulas are written out by hand,
Lagrangians are derived symbolically from Cartesian coordinates, Newton-Euler balances forces body
by body, and exact motions come from elliptic functions.

Units are SI and radians. Angles are counter-clockwise and relative to the link that a link hangs
from, or from the +X axis where it hangs from the ground. One equation of motion holds throughout,

    M qdd + C qd + G = tau + Psi^T lambda        gap(q) = 0        Psi = d gap/dq

with M, C (n, n), G, q, qd, qdd, tau (n,), Psi (2c, n), lambda and gap (2c,) for c closures. C is
the Christoffel one, so that Mdot - 2C is skew-symmetric. lambda is the force in the closing pin on
the link that the closure names first; that link's point minus the other's is the gap.

Contents: 2R arm; four-bar; general trees (Lagrange, Newton-Euler, 30 digits); exact motions.
"""

import functools
import itertools
import math
from typing import NamedTuple

import mpmath
import numpy as np
from mpmath import mp, mpf

# ---------------------------------------------------------------------------------------------
# The 2R arm, lecture equations (24)-(27)
# ---------------------------------------------------------------------------------------------


class TwoLink(NamedTuple):
    """A 2R arm: m kg, l and r m (r from the joint to the centre of gravity), I kg m^2, g m/s^2."""

    m1: float
    l1: float
    r1: float
    I1: float
    m2: float
    l2: float  # the tip: no part in the dynamics
    r2: float
    I2: float
    g: float = 9.81


def two_link_terms(p, q, qd):
    """M (2, 2), C (2, 2) and G (2,) of the 2R arm, gravity g along -Y.

    Lecture (24)-(27), with two misprints put right: in the kinetic energy (24) the second link has
    l1^2 theta1dot^2 (not r2^2 theta1dot^2), and the second entry of G in (27) has its factor r2.
    """
    q1, q2 = q
    q1d, q2d = qd
    c1, c12 = math.cos(q1), math.cos(q1 + q2)
    c2, s2 = math.cos(q2), math.sin(q2)

    M11 = p.m1 * p.r1**2 + p.I1 + p.m2 * (p.l1**2 + p.r2**2 + 2 * p.l1 * p.r2 * c2) + p.I2
    M12 = p.m2 * (p.r2**2 + p.l1 * p.r2 * c2) + p.I2
    M22 = p.m2 * p.r2**2 + p.I2
    M = np.array([[M11, M12], [M12, M22]])

    h = p.m2 * p.l1 * p.r2 * s2
    C = np.array([[-h * q2d, -h * (q1d + q2d)], [h * q1d, 0.0]])

    G1 = (p.m1 * p.r1 + p.m2 * p.l1) * p.g * c1 + p.m2 * p.r2 * p.g * c12
    G2 = p.m2 * p.r2 * p.g * c12
    return M, C, np.array([G1, G2])


def two_link_torque(p, q, qd, qdd):
    """Joint torques tau (2,), N m: tau = M qdd + C qd + G."""
    M, C, G = two_link_terms(p, q, qd)
    return M @ qdd + C @ qd + G


def two_link_acceleration(p, q, qd, tau):
    """Joint accelerations qdd (2,), rad/s^2: M qdd = tau - C qd - G, by Cramer's rule."""
    M, C, G = two_link_terms(p, q, qd)
    f1, f2 = tau - C @ qd - G
    (M11, M12), (_, M22) = M
    return np.array([M22 * f1 - M12 * f2, M11 * f2 - M12 * f1]) / (M11 * M22 - M12**2)


def two_link_tree(p):
    """The 2R arm as a tree (see the section on trees)."""
    return [
        {"m": p.m1, "l": p.l1, "r": p.r1, "I": p.I1, "parent": None, "at": 0j},
        {"m": p.m2, "l": p.l2, "r": p.r2, "I": p.I2, "parent": 0, "at": complex(p.l1)},
    ]


# ---------------------------------------------------------------------------------------------
# The four-bar, broken at O3: a 2R chain (crank 1, coupler 2) and a 1R chain (rocker 3)
# ---------------------------------------------------------------------------------------------


class FourBar(NamedTuple):
    """Crank 1 on the origin, coupler 2 on its tip, rocker 3 on the ground point (d, e)."""

    m1: float
    l1: float
    r1: float
    I1: float
    m2: float
    l2: float
    r2: float
    I2: float
    m3: float
    l3: float
    r3: float
    I3: float
    d: float
    e: float = 0.0
    g: float = 9.81


class FourBarTerms(NamedTuple):
    """Terms of the broken four-bar at one state, q = (theta1, phi2, phi1)."""

    M: np.ndarray  # (3, 3) kg m^2
    C: np.ndarray  # (3, 3) N m s
    G: np.ndarray  # (3,) N m
    gap: np.ndarray  # (2,) m, tip of the coupler minus tip of the rocker
    Psi: np.ndarray  # (2, 3) m, d gap/dq
    Psidot: np.ndarray  # (2, 3) m/s


def four_bar_terms(p, q, qd):
    """Terms of the broken four-bar: q = (crank from +X, coupler from crank, rocker from +X).

    The 2R arm's (24)-(27) for crank and coupler, a pendulum for the rocker (whose kinetic energy
    is 1/2 (m3 r3^2 + I3) phi1dot^2, with the square), and their tips' distance,

        gap = [l1 cos theta1 + l2 cos(theta1 + phi2) - l3 cos phi1 - d,
               l1 sin theta1 + l2 sin(theta1 + phi2) - l3 sin phi1 - e]
    """
    theta1, phi2, phi1 = q
    theta1d, phi2d, phi1d = qd
    c1, s1 = math.cos(theta1), math.sin(theta1)
    c12, s12 = math.cos(theta1 + phi2), math.sin(theta1 + phi2)
    c2, s2 = math.cos(phi2), math.sin(phi2)
    c3, s3 = math.cos(phi1), math.sin(phi1)

    M11 = p.m1 * p.r1**2 + p.I1 + p.m2 * (p.l1**2 + p.r2**2 + 2 * p.l1 * p.r2 * c2) + p.I2
    M12 = p.m2 * (p.r2**2 + p.l1 * p.r2 * c2) + p.I2
    M22 = p.m2 * p.r2**2 + p.I2
    M33 = p.m3 * p.r3**2 + p.I3
    M = np.array([[M11, M12, 0.0], [M12, M22, 0.0], [0.0, 0.0, M33]])

    h = p.m2 * p.l1 * p.r2 * s2
    C = np.array([[-h * phi2d, -h * (theta1d + phi2d), 0.0], [h * theta1d, 0.0, 0.0], [0.0] * 3])

    G1 = (p.m1 * p.r1 + p.m2 * p.l1) * p.g * c1 + p.m2 * p.r2 * p.g * c12
    G2 = p.m2 * p.r2 * p.g * c12
    G3 = p.m3 * p.r3 * p.g * c3
    G = np.array([G1, G2, G3])

    gap = np.array(
        [p.l1 * c1 + p.l2 * c12 - p.l3 * c3 - p.d, p.l1 * s1 + p.l2 * s12 - p.l3 * s3 - p.e]
    )
    Psi = np.array(
        [
            [-p.l1 * s1 - p.l2 * s12, -p.l2 * s12, p.l3 * s3],
            [p.l1 * c1 + p.l2 * c12, p.l2 * c12, -p.l3 * c3],
        ]
    )
    w1, w12, w3 = theta1d, theta1d + phi2d, phi1d
    Psidot = np.array(
        [
            [-p.l1 * c1 * w1 - p.l2 * c12 * w12, -p.l2 * c12 * w12, p.l3 * c3 * w3],
            [-p.l1 * s1 * w1 - p.l2 * s12 * w12, -p.l2 * s12 * w12, p.l3 * s3 * w3],
        ]
    )
    return FourBarTerms(M, C, G, gap, Psi, Psidot)


def four_bar_acceleration(p, q, qd, tau):
    """qdd (3,) rad/s^2 and pin force lambda (2,) N from joint torques tau (3,): lecture (33).

        M qdd = f - Psi^T (Psi M^-1 Psi^T)^-1 (Psi M^-1 f + Psidot qd),    f = tau - C qd - G

    lambda is the force of the rocker on the coupler at the pin O3.
    """
    M, C, G, _, Psi, Psidot = four_bar_terms(p, q, qd)
    f = tau - C @ qd - G
    Minv_f = np.linalg.solve(M, f)
    Minv_PsiT = np.linalg.solve(M, Psi.T)
    lam = -np.linalg.solve(Psi @ Minv_PsiT, Psi @ Minv_f + Psidot @ qd)
    return Minv_f + Minv_PsiT @ lam, lam


def four_bar_torque(p, q, qd, qdd):
    """Crank torque tau1 N m and pin force lambda (2,) N from a motion that keeps the loop closed.

        M qdd + C qd + G = S^T tau1 + Psi^T lambda,    S = [1, 0, 0]

    The passive rows (coupler, rocker) give lambda, then the crank's row gives tau1.
    """
    M, C, G, _, Psi, _ = four_bar_terms(p, q, qd)
    inertial = M @ qdd + C @ qd + G
    lam = np.linalg.solve(Psi[:, 1:].T, inertial[1:])
    return inertial[0] - Psi[:, 0] @ lam, lam


def four_bar_position(p, theta1, assembly="open"):
    """Closed q = (theta1, phi2, phi1) by Freudenstein's equation, phi2 and phi1 in [-pi, pi].

    With (x, y) from the rocker's pivot D to the crank's tip A, |P - A| = l2 for the rocker's tip P:

        x cos phi1 + y sin phi1 = (x^2 + y^2 + l3^2 - l2^2) / (2 l3)

    `open` has P to the left of the line from A to D, `crossed` to the right. ValueError if the
    links do not reach.
    """
    x, y = p.l1 * math.cos(theta1) - p.d, p.l1 * math.sin(theta1) - p.e
    k = (x**2 + y**2 + p.l3**2 - p.l2**2) / (2 * p.l3)
    spread = math.acos(k / math.hypot(x, y))
    phi1 = math.atan2(y, x) + {"open": -spread, "crossed": spread}[assembly]
    alpha2 = math.atan2(p.l3 * math.sin(phi1) - y, p.l3 * math.cos(phi1) - x)
    return np.array([theta1, wrap(alpha2 - theta1), wrap(phi1)])


def wrap(angle):
    """The same angle in [-pi, pi]."""
    return math.remainder(angle, math.tau)


def four_bar_coefficients(p, q):
    """Velocity coefficients k = dq/dtheta1 (3,) and their derivatives k' = d2q/dtheta1^2 (3,).

    qd = k theta1d and qdd = k theta1dd + k' theta1d^2. From the loop, with coupler angle alpha2,
    l1 e^(i theta1) + l2 e^(i alpha2) = d + i e + l3 e^(i phi1), differentiated once and twice, the
    component along the rocker gives the coupler's coefficient and the one along the coupler
    the rocker's.
    """
    theta1, phi2, phi1 = q
    alpha2 = theta1 + phi2
    s23 = math.sin(alpha2 - phi1)

    k2 = -p.l1 * math.sin(theta1 - phi1) / (p.l2 * s23)
    k3 = -p.l1 * math.sin(theta1 - alpha2) / (p.l3 * s23)

    c13, c12, c23 = math.cos(theta1 - phi1), math.cos(theta1 - alpha2), math.cos(alpha2 - phi1)
    k2_prime = (p.l3 * k3**2 - p.l1 * c13 - p.l2 * k2**2 * c23) / (p.l2 * s23)
    k3_prime = (p.l3 * k3**2 * c23 - p.l1 * c12 - p.l2 * k2**2) / (p.l3 * s23)
    return np.array([1.0, k2 - 1.0, k3]), np.array([0.0, k2_prime, k3_prime])


def four_bar_reduction(p, theta1, assembly="open"):
    """Effective inertia J kg m^2, dJ/dtheta1 and dPE/dtheta1 N m of the four-bar as one coordinate.

    KE = 1/2 J(theta1) theta1d^2, with J the sum of the three links' m v^2 + I w^2 at theta1d = 1.
    """
    q = four_bar_position(p, theta1, assembly)
    (_, k2_relative, k3), (_, k2_prime, k3_prime) = four_bar_coefficients(p, q)
    k2 = 1.0 + k2_relative
    _, phi2, phi1 = q
    c2, s2 = math.cos(phi2), math.sin(phi2)

    J1 = p.m1 * p.r1**2 + p.I1
    J2 = p.m2 * (p.l1**2 + p.r2**2 * k2**2 + 2 * p.l1 * p.r2 * k2 * c2) + p.I2 * k2**2
    J3 = (p.m3 * p.r3**2 + p.I3) * k3**2

    dJ2 = 2 * (p.m2 * p.r2**2 + p.I2) * k2 * k2_prime
    dJ2 += 2 * p.m2 * p.l1 * p.r2 * (k2_prime * c2 - k2 * s2 * (k2 - 1.0))
    dJ3 = 2 * (p.m3 * p.r3**2 + p.I3) * k3 * k3_prime

    dy1 = p.r1 * math.cos(theta1)
    dy2 = p.l1 * math.cos(theta1) + p.r2 * k2 * math.cos(theta1 + phi2)
    dy3 = p.r3 * k3 * math.cos(phi1)
    dPE = p.g * (p.m1 * dy1 + p.m2 * dy2 + p.m3 * dy3)
    return J1 + J2 + J3, dJ2 + dJ3, dPE


def four_bar_reduced_acceleration(p, theta1, theta1d, tau1, assembly="open"):
    """Crank acceleration theta1dd, rad/s^2: J theta1dd + 1/2 dJ theta1d^2 + dPE = tau1."""
    J, dJ, dPE = four_bar_reduction(p, theta1, assembly)
    return (tau1 - dJ * theta1d**2 / 2 - dPE) / J


def four_bar_tree(p):
    """The broken four-bar as a tree and its one closure (see the section on trees)."""
    tree = [
        {"m": p.m1, "l": p.l1, "r": p.r1, "I": p.I1, "parent": None, "at": 0j},
        {"m": p.m2, "l": p.l2, "r": p.r2, "I": p.I2, "parent": 0, "at": complex(p.l1)},
        {"m": p.m3, "l": p.l3, "r": p.r3, "I": p.I3, "parent": None, "at": complex(p.d, p.e)},
    ]
    return tree, [((1, complex(p.l2)), (2, complex(p.l3)))]


# ---------------------------------------------------------------------------------------------
# Any planar tree of links, by Lagrange
#
# A tree is a list of dicts, each link after the one that it hangs from:
#   m kg, I kg m^2 about the centre of gravity, r m the centre of gravity in the link frame
#   (complex, or float along the link), l m the length (no part in the dynamics), parent the
#   index of the link that it hangs from or None for the ground, at m its joint (complex) in the
#   parent's link frame or in the ground frame; axis, where it slides, the unit vector (complex) of
#   that frame along which it does, and along which its own x axis lies; rotor, of a motor at its
#   joint, the ratio of the gear (rad/m where it slides) and the inertia kg m^2 of what spins.
# gamma = gx + i gy is the acceleration of gravity, m/s^2: -9.81j points along -Y.
# ---------------------------------------------------------------------------------------------


class LagrangeTerms(NamedTuple):
    """Terms at one state; arrays of float, or of mpf (dtype object) from the mpmath backend."""

    M: np.ndarray  # (n, n) kg m^2
    C: np.ndarray  # (n, n) N m s
    G: np.ndarray  # (n,) N m
    KE: float  # J
    PE: float  # J, zero at the origin
    gap: np.ndarray  # (2c,) m, first point minus second point, x and y of each closure
    Psi: np.ndarray  # (2c, n) m
    Psidot_qd: np.ndarray  # (2c,) m/s^2


def sympy_terms(tree, gamma, closures=(), backend="numpy", digits=30, lines=()):
    """A function terms(q, qd) -> LagrangeTerms, derived symbolically from Cartesian coordinates.

    A closure is a pair of points that coincide, each (link index or None, point), the point in
    the link frame or the ground frame; a line is such a pair and the direction, in the frame of
    the second, of the line through it that the first stays on. The `mpmath` backend takes every
    float as exact and evaluates at `digits` digits. The derivation is done once for each shape of
    tree.
    """
    number, dtype = {"numpy": (float, float), "mpmath": (mpf, object)}[backend]
    parents = tuple(link["parent"] for link in tree)
    slides = tuple("axis" in link for link in tree)
    driven = tuple("rotor" in link for link in tree)
    ends = tuple((first[0], second[0]) for first, second in closures)
    on_lines = tuple((first[0], second[0]) for first, second, _ in lines)
    evaluate = _lagrange(parents, slides, driven, ends, on_lines, backend)

    # in the order of the symbols in _lagrange
    points = [gamma, *(link["r"] for link in tree), *(link["at"] for link in tree)]
    points += [link.get("axis", 1.0 + 0j) for link in tree]
    points += [point for closure in closures for _, point in closure]
    points += [each for (_, a), (_, b), along in lines for each in (a, b, along)]
    values = [link["m"] for link in tree] + [link["I"] for link in tree]
    values += [coordinate for point in points for coordinate in (point.real, point.imag)]
    values += [x for link in tree if "rotor" in link for x in link["rotor"]]

    n, rows = len(tree), 2 * len(ends) + len(lines)
    shapes = [(n, n), (n, n), (n,), (), (), (rows,), (rows, n), (rows,)]
    cuts = np.cumsum([math.prod(shape) for shape in shapes])[:-1]

    def terms(q, qd):
        with mp.workdps(digits):
            flat = evaluate(*([number(x) for x in xs] for xs in (q, qd, values)))
        parts = np.split(np.array(flat, dtype=dtype), cuts)
        return LagrangeTerms(
            *(part.reshape(shape)[()] for part, shape in zip(parts, shapes, strict=True))
        )

    return terms


@functools.cache
def _lagrange(parents, slides, driven, ends, on_lines, backend):
    """All terms of a tree of this shape as one function (q, qd, values) -> flat list.

    With centres of gravity (x, y) and absolute rates w,

        KE = sum 1/2 m (xdot^2 + ydot^2) + 1/2 I w^2        PE = -sum m (gx x + gy y)
        KE += sum 1/2 J (w of the carrying link + ratio qd)^2 of rotors
        M_ij = d2KE / dqd_i dqd_j        G_i = dPE / dq_i
        C_ij = sum_k 1/2 (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) qd_k
    """
    import sympy as sp

    n = len(parents)
    q, qd, m, I = (sp.symbols(f"{name}:{n}") for name in ("q", "qd", "m", "I"))
    count = 1 + 3 * n + 2 * len(ends) + 3 * len(on_lines)
    gamma, *points = (sp.symbols(f"x{i} y{i}") for i in range(count))
    r, at, axes, closing = points[:n], points[n : 2 * n], points[2 * n : 3 * n], points[3 * n :]
    values = [*m, *I, *gamma, *(coordinate for point in points for coordinate in point)]
    rotors = {i: sp.symbols(f"N{i} J{i}") for i in range(n) if driven[i]}
    values += [x for pair in rotors.values() for x in pair]

    def on_ground(link, point):
        """Ground coordinates of a point of a link (or of the ground)."""
        if link is None:
            return point
        (x, y), (x0, y0), (c, s) = point, joint[link], turn[link]
        return x0 + c * x - s * y, y0 + s * x + c * y

    def rate(expression):
        """d/dt of an expression in q, by the chain rule."""
        return sum(sp.diff(expression, q[j]) * qd[j] for j in range(n))

    # of each link's frame: the angle of its joints, the axes of slides, origin, cosine and sine
    alpha, fixed, joint, turn = [], [], [], []
    for i, parent in enumerate(parents):
        angle = sp.Integer(0) if parent is None else alpha[parent]
        c, s = (1, 0) if parent is None else fixed[parent]
        x, y = on_ground(parent, at[i])
        u, v = axes[i] if slides[i] else (1, 0)
        u, v = c * u - s * v, s * u + c * v
        fixed.append((u, v))
        alpha.append(angle if slides[i] else angle + q[i])
        c, s = sp.cos(alpha[i]), sp.sin(alpha[i])
        turn.append((c * u - s * v, s * u + c * v))
        along = q[i] if slides[i] else 0
        joint.append((x + along * turn[i][0], y + along * turn[i][1]))

    KE = PE = sp.Integer(0)
    for i in range(n):
        x, y = on_ground(i, r[i])
        KE += m[i] * (rate(x) ** 2 + rate(y) ** 2) / 2 + I[i] * rate(alpha[i]) ** 2 / 2
        PE -= m[i] * (gamma[0] * x + gamma[1] * y)
    for i, (ratio, inertia) in rotors.items():
        carrier = 0 if parents[i] is None else rate(alpha[parents[i]])
        KE += inertia * (carrier + ratio * qd[i]) ** 2 / 2

    M = sp.hessian(KE, qd)
    dM = [sp.diff(M, q[k]) for k in range(n)]
    C = [
        sum((dM[k][i, j] + dM[j][i, k] - dM[i][j, k]) * qd[k] for k in range(n)) / 2
        for i in range(n)
        for j in range(n)
    ]
    G = [sp.diff(PE, q[i]) for i in range(n)]

    gap = []
    for c, (first, second) in enumerate(ends):
        a, b = on_ground(first, closing[2 * c]), on_ground(second, closing[2 * c + 1])
        gap += [a[0] - b[0], a[1] - b[1]]
    for c, (first, second) in enumerate(on_lines):
        one, other, (dx, dy) = closing[2 * len(ends) + 3 * c :][:3]
        a, b = on_ground(first, one), on_ground(second, other)
        c, s = (1, 0) if second is None else turn[second]
        nx, ny = -(s * dx + c * dy), c * dx - s * dy  # the line's direction, a quarter turn on
        gap.append(nx * (a[0] - b[0]) + ny * (a[1] - b[1]))
    Psi = [[sp.diff(row, q[j]) for j in range(n)] for row in gap]
    Psidot_qd = [sum(rate(row[j]) * qd[j] for j in range(n)) for row in Psi]

    flat = [*M, *C, *G, KE, PE, *gap, *(entry for row in Psi for entry in row), *Psidot_qd]
    return sp.lambdify((q, qd, values), flat, modules=backend, cse=True)


# ---------------------------------------------------------------------------------------------
# Any planar tree of links, by Newton and Euler
# ---------------------------------------------------------------------------------------------


class _Frame(NamedTuple):
    """A link in motion: its angle, and the motion of its joint; by default the ground."""

    angle: float = 0
    c: float = 1  # cos and sin of the angle
    s: float = 0
    w: float = 0  # rad/s
    wd: float = 0  # rad/s^2
    ax: float = 0  # acceleration of the joint, m/s^2
    ay: float = 0

    def turned(self, point):
        """A vector of the link frame along the ground axes."""
        return self.c * point.real - self.s * point.imag, self.s * point.real + self.c * point.imag

    def acceleration(self, x, y):
        """Acceleration of the link's point at (x, y) from its joint: a + wd x r - w^2 r."""
        return self.ax - self.wd * y - self.w**2 * x, self.ay + self.wd * x - self.w**2 * y


def newton_euler(tree, gamma, q, qd, qdd, namespace=math):
    """Joint torques, a list of n scalars in N m, by recursive Newton-Euler.

    Outward, the acceleration of every link; inward, the balance of each link about its joint:

        F = m (a - gamma) + sum of the children's F
        tau = I wd + r x m (a - gamma) + sum of the children's (tau + at x F)

    `namespace` gives cos and sin: math for floats, mpmath.mp for mpf.
    """
    frames = {None: _Frame()}
    for i, link in enumerate(tree):
        carrier = frames[link["parent"]]
        angle = carrier.angle + q[i]
        frames[i] = _Frame(
            angle,
            namespace.cos(angle),
            namespace.sin(angle),
            carrier.w + qd[i],
            carrier.wd + qdd[i],
            *carrier.acceleration(*carrier.turned(link["at"])),
        )

    n = len(tree)
    Fx, Fy, tau = (dict.fromkeys([None, *range(n)], 0) for _ in range(3))
    for i in reversed(range(n)):
        link, frame, parent = tree[i], frames[i], tree[i]["parent"]
        x, y = frame.turned(link["r"])
        ax, ay = frame.acceleration(x, y)
        fx, fy = link["m"] * (ax - gamma.real), link["m"] * (ay - gamma.imag)
        Fx[i] += fx
        Fy[i] += fy
        tau[i] += link["I"] * frame.wd + x * fy - y * fx

        x, y = frames[parent].turned(link["at"])
        Fx[parent] += Fx[i]
        Fy[parent] += Fy[i]
        tau[parent] += tau[i] + x * Fy[i] - y * Fx[i]
    return [tau[i] for i in range(n)]


def newton_euler_mp(tree, gamma, q, qd, qdd, digits=30):
    """Joint torques as newton_euler gives them, an array (n,) of mpf; every float is exact."""
    with mp.workdps(digits):
        state = ([mpf(x) for x in xs] for xs in (q, qd, qdd))
        return np.array(newton_euler(tree, gamma, *state, namespace=mp), dtype=object)


def mp_terms(tree, gamma, q, qd, digits=30):
    """M (n, n), C (n, n) and G (n,) as arrays of mpf; every float is exact.

    With the Jacobian J_j = z x (s - p_j) of each centre of gravity s for the joints p_j below it,

        M = sum m J^T J + I        C = sum m J^T Jdot        G = -sum J^T m gamma

    That C is the Christoffel one: J_i . dJ_j/dq_k is already symmetric in j and k.
    """
    n = len(tree)
    M, C, G = (np.full(shape, mpf(0), dtype=object) for shape in ((n, n), (n, n), n))
    frames = {None: _Frame()}
    path = {None: []}
    p, v = {None: (0, 0)}, {None: (0, 0)}  # positions and velocities of the joints

    def moved(i, point):
        """Position and velocity of a point of a link."""
        (x, y), w = frames[i].turned(point), frames[i].w
        return (p[i][0] + x, p[i][1] + y), (v[i][0] - w * y, v[i][1] + w * x)

    with mp.workdps(digits):
        for b, link in enumerate(tree):
            parent = link["parent"]
            path[b] = [*path[parent], b]
            p[b], v[b] = moved(parent, link["at"])
            if "axis" in link:
                (c, s), w = frames[parent].turned(link["axis"]), frames[parent].w
                frames[b] = _Frame(frames[parent].angle, c, s, w)
                x, xd = mpf(q[b]), mpf(qd[b])
                p[b] = p[b][0] + x * c, p[b][1] + x * s
                v[b] = v[b][0] + xd * c - x * w * s, v[b][1] + xd * s + x * w * c
            else:
                angle, w = frames[parent].angle + mpf(q[b]), frames[parent].w + mpf(qd[b])
                c, s = frames[parent].turned(mp.expj(mpf(q[b])))
                frames[b] = _Frame(angle, c, s, w)

            s, sd = moved(b, link["r"])
            J = {j: (p[j][1] - s[1], s[0] - p[j][0]) for j in path[b]}
            Jdot = {j: (v[j][1] - sd[1], sd[0] - v[j][0]) for j in path[b]}
            turns = dict.fromkeys(path[b], 1)
            for j in path[b]:
                if "axis" in tree[j]:
                    c, d, w = frames[j].c, frames[j].s, frames[j].w
                    J[j], Jdot[j], turns[j] = (c, d), (-w * d, w * c), 0
            for i in path[b]:
                G[i] -= link["m"] * (J[i][0] * gamma.real + J[i][1] * gamma.imag)
                for j in path[b]:
                    M[i, j] += link["m"] * (J[i][0] * J[j][0] + J[i][1] * J[j][1])
                    M[i, j] += link["I"] * turns[i] * turns[j]
                    C[i, j] += link["m"] * (J[i][0] * Jdot[j][0] + J[i][1] * Jdot[j][1])
            if "rotor" in link:  # turns with what carries it, and `ratio` times as far as the joint
                ratio, inertia = link["rotor"]
                spin = {j: mpf(1) for j in path[parent] if "axis" not in tree[j]} | {b: mpf(ratio)}
                for i, j in itertools.product(spin, spin):
                    M[i, j] += inertia * spin[i] * spin[j]
    return M, C, G


# ---------------------------------------------------------------------------------------------
# Exact motions
# ---------------------------------------------------------------------------------------------

GUARD_DIGITS = 15  # worked with beyond the digits asked for


def pendulum_frequency(m, r, I, g=9.81, digits=30):
    """omega0 = sqrt(m g r / (I + m r^2)), rad/s: a compound pendulum's small oscillations."""
    with mp.workdps(digits + GUARD_DIGITS):
        return mpmath.sqrt(mpf(m) * g * r / (I + mpf(m) * r * r))


def pendulum_period(omega0, amplitude, digits=30):
    """Period 4 K(k^2) / omega0 s of the swing, k = sin(amplitude / 2)."""
    with mp.workdps(digits + GUARD_DIGITS):
        return 4 * mpmath.ellipk(mpmath.sin(mpf(amplitude) / 2) ** 2) / omega0


def pendulum_exact(omega0, amplitude, t, digits=30):
    """Angle rad and rate rad/s at time t of a pendulum let go at rest, |amplitude| < pi.

    thetadd = -omega0^2 sin theta, theta from the downward vertical. With k = sin(amplitude / 2),

        sin(theta / 2) = k sn(omega0 t + K)        thetad = 2 k omega0 cn(omega0 t + K)
    """
    with mp.workdps(digits + GUARD_DIGITS):
        k = mpmath.sin(mpf(amplitude) / 2)
        u = mpf(omega0) * t + mpmath.ellipk(k**2)
        sn, cn = (mpmath.ellipfun(kind, u, m=k**2) for kind in ("sn", "cn"))
        return 2 * mpmath.asin(k * sn), 2 * k * omega0 * cn


def n_four_bar_stiffness(N, g=9.81, digits=30):
    """kappa = 3 (3N + 1) g / (2 (4N + 1)), 1/s^2, of the N-four-bar benchmark.

    N squares of side 1 m in a row, of 2N + 1 uniform rods of 1 kg, on N + 1 ground pivots. As one
    coordinate: J = (N + 1)/3 + N and PE = g ((N + 1)/2 + N) sin theta.
    """
    with mp.workdps(digits + GUARD_DIGITS):
        return 3 * (3 * N + 1) * mpf(g) / (2 * (4 * N + 1))


def n_four_bar_exact(N, t, g=9.81, digits=30):
    """Crank angle theta rad and rate thetad rad/s at time t of the N-four-bar benchmark.

    thetadd = -kappa cos theta, theta(0) = pi/2, thetad(0) = -1: it turns over and over, passing
    the lowest point at the rate W = sqrt(1 + 4 kappa). With the parameter m = 4 kappa / W^2,

        theta = -pi/2 - 2 am(W t / 2 - K)        thetad = -W dn(W t / 2 - K)
    """
    with mp.workdps(digits + GUARD_DIGITS):
        kappa = n_four_bar_stiffness(N, g, digits)
        W = mpmath.sqrt(1 + 4 * kappa)
        m = 4 * kappa / W**2
        K = mpmath.ellipk(m)
        u = W * mpf(t) / 2 - K
        turns = mpmath.nint(u / (2 * K))  # am(u + 2K) = am(u) + pi
        sn, cn, dn = (mpmath.ellipfun(kind, u - 2 * K * turns, m=m) for kind in ("sn", "cn", "dn"))
        return -mp.pi / 2 - 2 * (mp.pi * turns + mpmath.atan2(sn, cn)), -W * dn


# ---------------------------------------------------------------------------------------------
# The seven-body mechanism, as Hairer and Wanner write it (Solving ODEs II, section VII.7)
# ---------------------------------------------------------------------------------------------

# start: beta, Theta, gamma, Phi, delta, Omega, epsilon; accelerations of the first two there
SEVEN_BODY_START = (
    -0.0617138900142764496358948458001,
    0.0,
    0.455279819163070380255912382449,
    0.222668390165885884674473185609,
    0.487364979543842550225598953530,
    -0.222668390165885884674473185609,
    1.23054744454982119249735015568,
)
SEVEN_BODY_ACCELERATIONS = (14222.4439199541138705911625887, -10666.8329399655854029433719415)


def seven_body_terms(q, qd, torque=0.033):
    """M (7, 7), the forces f (7,), the constraints' Jacobian (6, 7) and -d/dt(Jacobian) qd."""
    _, theta, gamma, phi, _, omega, _ = q
    bd, td, _, pd, dd, od, ed = qd
    m = (None, 0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498)
    I = (None, 2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)
    rr, ra, d, da, ss, sa, sb, sc, sd = (
        0.007,
        0.00092,
        0.028,
        0.0115,
        0.035,
        0.01874,
        0.01043,
        0.018,
        0.02,
    )
    e, ea, zt, ta, tb, zf, fa, u, ua, ub = (
        0.02,
        0.01421,
        0.04,
        0.02308,
        0.00916,
        0.02,
        0.01421,
        0.04,
        0.01228,
        0.00449,
    )
    xb, yb, xc, yc, c0, free = -0.03635, 0.03273, 0.014, 0.072, 4530.0, 0.07785
    M = np.zeros((7, 7))
    M[0, 0] = m[1] * ra**2 + m[2] * (rr**2 - 2 * da * rr * np.cos(theta) + da**2) + I[1] + I[2]
    M[1, 0] = M[0, 1] = m[2] * (da**2 - da * rr * np.cos(theta)) + I[2]
    M[1, 1] = m[2] * da**2 + I[2]
    M[2, 2] = m[3] * (sa**2 + sb**2) + I[3]
    M[3, 3] = m[4] * (e - ea) ** 2 + I[4]
    M[4, 3] = M[3, 4] = m[4] * ((e - ea) ** 2 + zt * (e - ea) * np.sin(phi)) + I[4]
    M[4, 4] = m[4] * (zt**2 + 2 * zt * (e - ea) * np.sin(phi) + (e - ea) ** 2)
    M[4, 4] += m[5] * (ta**2 + tb**2) + I[4] + I[5]
    M[5, 5] = m[6] * (zf - fa) ** 2 + I[6]
    M[6, 5] = M[5, 6] = m[6] * ((zf - fa) ** 2 - u * (zf - fa) * np.sin(omega)) + I[6]
    M[6, 6] = m[6] * ((zf - fa) ** 2 - 2 * u * (zf - fa) * np.sin(omega) + u**2)
    M[6, 6] += m[7] * (ua**2 + ub**2) + I[6] + I[7]
    xd = sd * np.cos(gamma) + sc * np.sin(gamma) + xb
    yd = sd * np.sin(gamma) - sc * np.cos(gamma) + yb
    length = np.hypot(xd - xc, yd - yc)
    force = -c0 * (length - free) / length
    fx, fy = force * (xd - xc), force * (yd - yc)
    f = np.array(
        [
            torque - m[2] * da * rr * td * (td + 2 * bd) * np.sin(theta),
            m[2] * da * rr * bd**2 * np.sin(theta),
            fx * (sc * np.cos(gamma) - sd * np.sin(gamma))
            + fy * (sd * np.cos(gamma) + sc * np.sin(gamma)),
            m[4] * zt * (e - ea) * dd**2 * np.cos(phi),
            -m[4] * zt * (e - ea) * pd * (pd + 2 * dd) * np.cos(phi),
            -m[6] * u * (zf - fa) * ed**2 * np.cos(omega),
            m[6] * u * (zf - fa) * od * (od + 2 * ed) * np.cos(omega),
        ]
    )
    # every term of the constraints is a length times the cosine or sine of a sum of angles
    turns = [
        (rr, (0,), 0.0), (-d, (0, 1), 0.0),  # to F, by K1 and K2
        (ss, (2,), -np.pi / 2), (e, (3, 4), -np.pi / 2), (zt, (4,), 0.0),
        (zf, (5, 6), 0.0), (u, (6,), -np.pi / 2),
    ]  # fmt: skip
    sides = ((2,), (3, 4), (5, 6))
    Psi, bend = np.zeros((6, 7)), np.zeros(6)
    for c, side in enumerate(sides):
        for k in (0, 1, *side):
            length, angles, ahead = turns[k]
            sign = 1.0 if k < 2 else -1.0
            angle, rate = q[list(angles)].sum() + ahead, qd[list(angles)].sum()
            point = sign * length * np.exp(1j * angle)
            Psi[2 * c, list(angles)] -= point.imag
            Psi[2 * c + 1, list(angles)] += point.real
            bend[2 * c : 2 * c + 2] += np.array([point.real, point.imag]) * rate**2
    return M, f, Psi, bend


def seven_body_rates(t, y):
    """dy/dt of (q, qd), the constraints differentiated twice."""
    q, qd = y[:7], y[7:]
    M, f, Psi, bend = seven_body_terms(q, qd)
    system = np.block([[M, Psi.T], [Psi, np.zeros((6, 6))]])
    return np.concatenate([qd, np.linalg.solve(system, np.concatenate([f, bend]))[:7]])
