"""The Taylor series of springs and of forces that turn with a link, over many lanes.

The equations are those of `forces.py`: with d = const + sum_k c_k E_k from end to end and s^2 =
|d|^2, a spring pulls by

    F = (-stiffness + stiffness length/s - damping (s^2)'/(2 s^2)) d

whose series are products, a power and a quotient of the series of c and s; it turns link k by
Im(conj(c_k E_k) F).  Constants are one number for all lanes, or arrays over them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.mechanics.mechanism import Mechanism, PlanarPoint

Array = NDArray[np.float64]
Number = Any  # a number, or an array over the lanes
Lanes = NDArray[Any]


def _none() -> Array:
    return np.zeros(0)


@dataclass(slots=True)
class _Pull:
    """A spring between points: its constants, and its series while they grow."""

    constant: Number  # of d, complex
    terms: list[tuple[int, Number]]
    stiffness: Number
    length: Number
    damping: Number
    d: Array = field(default_factory=_none)  # (K, 2, B)
    square: Array = field(default_factory=_none)  # (K, B) of s^2
    inverse: Array = field(default_factory=_none)  # of 1/s
    ratio: Array = field(default_factory=_none)  # of (s^2)'/(2 s^2)
    pull: Array = field(
        default_factory=_none
    )  # (K, 2, B) for each unit of d: with a potential, and without
    force: Array = field(default_factory=_none)  # (K, 2, 2, B): of these two, x and y

    @property
    def kinds(self) -> range:
        """Which of the two there are."""
        return range(2 if np.any(self.damping) else 1)


@dataclass(slots=True)
class _Turning:
    """A force that turns with a link."""

    link: int
    force: Number
    terms: list[tuple[int, Number]]


class LaneForces:
    """What acts in lanes of mechanisms of one structure besides weights and dampers of joints.

    Lane b is of `mechanisms[which[b]]`; of one mechanism all lanes are.  Friction is not served.
    """

    def __init__(self, mechanisms: Sequence[Mechanism], which: Lanes) -> None:
        self.parent = mechanisms[0].parent
        self.n = mechanisms[0].n

        def each(value: Callable[[Mechanism], complex]) -> Number:
            values = np.array([value(mechanism) for mechanism in mechanisms])
            return values[0] if (values == values[0]).all() else values[which]

        def terms(point: Callable[[Mechanism], PlanarPoint]) -> list[tuple[int, Number]]:
            moved = sorted({k for mechanism in mechanisms for k, _ in point(mechanism).terms})
            return [(k, each(lambda m, k=k: dict(point(m).terms).get(k, 0j))) for k in moved]  # type: ignore[misc]

        def spring(p: int) -> _Pull:
            return _Pull(
                each(lambda m: m.springs[p].between.constant),
                terms(lambda m: m.springs[p].between),
                each(lambda m: m.springs[p].stiffness),
                each(lambda m: m.springs[p].length),
                each(lambda m: m.springs[p].damping),
            )

        first = mechanisms[0]
        self.springs = [spring(p) for p in range(len(first.springs))]
        turning = [p for p, force in enumerate(first.forces) if force.turns]
        self.turning = [
            _Turning(
                first.forces[p].link,
                each(lambda m, p=p: m.forces[p].force),  # type: ignore[misc]
                terms(lambda m, p=p: m.forces[p].point),  # type: ignore[misc]
            )
            for p in turning
        ]
        self.joints = [
            (
                spring.joint,
                each(lambda m, p=p: m.joint_springs[p].stiffness),  # type: ignore[misc]
                each(lambda m, p=p: m.joint_springs[p].angle),  # type: ignore[misc]
            )
            for p, spring in enumerate(first.joint_springs)
        ]

    def some(self, lanes: Lanes) -> LaneForces:
        """The forces of these lanes alone."""

        def of(value: Number) -> Number:
            return value[lanes] if np.ndim(value) else value

        other = LaneForces.__new__(LaneForces)
        other.parent, other.n = self.parent, self.n
        other.springs = [
            _Pull(
                of(x.constant), [(k, of(c)) for k, c in x.terms],
                of(x.stiffness), of(x.length), of(x.damping),
            )
            for x in self.springs
        ]  # fmt: skip
        other.turning = [
            _Turning(x.link, of(x.force), [(k, of(c)) for k, c in x.terms]) for x in self.turning
        ]
        other.joints = [(k, of(stiffness), of(angle)) for k, stiffness, angle in self.joints]
        return other

    def potential(self, q: Array, c: Array, s: Array) -> Array:
        """The potential energy of the springs (B,), J; c and s (n, B) of the links' angles."""
        total = np.zeros(q.shape[1])
        for x in self.springs:
            d = np.stack(_moved(x.constant, x.terms, c, s))
            total += 0.5 * x.stiffness * (np.sqrt((d * d).sum(axis=0)) - x.length) ** 2
        for k, stiffness, angle in self.joints:
            total += 0.5 * stiffness * (q[k] - angle) ** 2
        return total

    def begin(self, orders: int, q: Array) -> None:
        """Make room for series of so many orders, from joint angles q (n, B)."""
        B = q.shape[1]
        self.q = q
        for x in self.springs:
            x.d, x.square = np.empty((orders + 1, 2, B)), np.empty((orders + 1, B))
            x.inverse, x.ratio = np.empty((2, orders, B))
            x.pull, x.force = np.empty((orders, 2, B)), np.empty((orders, 2, 2, B))

    def torques(self, k: int, W: Array, C: Array, S: Array) -> tuple[Array, Array]:
        """Coefficient k of the torques in absolute angles (n, B): of a potential, and of none.

        W (rates) is known to order k, C and S to k + 1.
        """
        held, free = np.zeros_like(C[0]), np.zeros_like(C[0])
        for x in self.springs:
            _pull(x, k, C, S)
            for kind in x.kinds:
                torque = (held, free)[kind]
                for j, c in x.terms:
                    torque[j] += _lever(c, C[k::-1, j], S[k::-1, j], x.force[: k + 1, kind])
        for y in self.turning:
            c, s = C[: k + 1, y.link], S[: k + 1, y.link]
            f = np.asarray(y.force)
            force = np.stack([f.real * c - f.imag * s, f.real * s + f.imag * c], axis=1)
            for j, arm in y.terms:
                free[j] += _lever(arm, C[k::-1, j], S[k::-1, j], force)
        for j, stiffness, angle in self.joints:
            above = self.parent[j]
            if k == 0:
                stretched = self.q[j] - angle
            else:
                stretched = W[k - 1, j] if above is None else W[k - 1, j] - W[k - 1, above]
                stretched = stretched / k
            held[j] -= stiffness * stretched
            if above is not None:
                held[above] += stiffness * stretched
        return held, free


def _pull(x: _Pull, k: int, C: Array, S: Array) -> None:
    """Coefficient k of the force of a spring."""
    for m in (0, 1) if k == 0 else (k + 1,):
        x.d[m] = _moved(x.constant if m == 0 else 0j, x.terms, C[m], S[m])
        x.square[m] = np.einsum("mab,mab->b", x.d[: m + 1], x.d[m::-1])
    if not np.any(x.length):  # the ends may meet
        x.inverse[k] = 0.0
    elif k == 0:
        x.inverse[0] = 1.0 / np.sqrt(x.square[0])
    else:  # y = z^-1/2: k z_0 y_k = sum_m (m/2 - k) z_m y_{k-m}
        weights = 0.5 * np.arange(1.0, k + 1.0)[:, None] - k
        known = np.einsum("mb,mb->b", weights * x.square[1 : k + 1], x.inverse[k - 1 :: -1])
        x.inverse[k] = known / (k * x.square[0])
    x.pull[k, 0] = x.stiffness * x.length * x.inverse[k] - (x.stiffness if k == 0 else 0.0)
    if len(x.kinds) > 1:
        x.ratio[k] = 0.5 * (k + 1) * x.square[k + 1]
        if k:
            x.ratio[k] -= np.einsum("mb,mb->b", x.square[1 : k + 1], x.ratio[k - 1 :: -1])
        x.ratio[k] /= x.square[0]
        x.pull[k, 1] = -x.damping * x.ratio[k]
    for kind in x.kinds:
        x.force[k, kind] = np.einsum("mb,mab->ab", x.pull[: k + 1, kind], x.d[k::-1])


def _moved(
    constant: Number, terms: Sequence[tuple[int, Number]], c: Array, s: Array
) -> tuple[Array, Array]:
    """x and y (B,) of const + sum_k c_k E_k."""
    x, y = (np.zeros_like(c[0]) + part for part in (np.real(constant), np.imag(constant)))
    for k, factor in terms:
        re, im = np.real(factor), np.imag(factor)
        x += re * c[k] - im * s[k]
        y += re * s[k] + im * c[k]
    return x, y


def _lever(arm: Number, c: Array, s: Array, force: Array) -> Array:
    """The last coefficient (B,) of Im(conj(arm E) F); c and s (K, B) come backwards."""
    x, y = (
        np.einsum("mb,mb->b", c, force[:, i]) - sign * np.einsum("mb,mb->b", s, force[:, 1 - i])
        for i, sign in ((1, 1.0), (0, -1.0))
    )
    return np.asarray(np.real(arm) * x - np.imag(arm) * y)
