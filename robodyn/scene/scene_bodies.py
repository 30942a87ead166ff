"""Energies, gaps and powers of the bodies as a scene describes them, found link by link.

Nothing of the numeric model is used: a wrong constant of it shows beside these.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn.dynamics.differences import along
from robodyn.scene.scene import Description, JointSpring, Load, Moment, Point, Spring

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


Places = tuple[list[Complex], list[Complex]]


def _places(description: Description, q: Array) -> Places:
    """Each link's joint and its direction, found by walking from the ground outward."""
    joints: dict[int, Complex] = {}
    directions: dict[int, Complex] = {}
    for k in _outward(description):
        point = description.links[k].hangs_from
        turn = np.exp(1j * q[..., k])
        if point.link is None:
            joints[k], directions[k] = np.full(turn.shape, point.at), turn
        else:
            above = directions[point.link]
            joints[k] = joints[point.link] + point.at * above
            directions[k] = above * turn
    order = range(len(description.links))
    return [joints[k] for k in order], [directions[k] for k in order]


def _outward(description: Description) -> list[int]:
    """The links, each after the one it hangs from."""
    known: set[int | None] = {None}
    order: list[int] = []
    for k in range(len(description.links)):
        path: list[int] = []
        link: int | None = k
        while link is not None and link not in known:
            path.append(link)
            link = description.links[link].hangs_from.link
        order += reversed(path)
        known.update(path)
    return order


def _masses(description: Description, q: Array) -> list[tuple[float, Complex]]:
    """Every mass and where it is: centres of gravity and payloads."""
    joints, directions = _places(description, q)
    found: list[tuple[float, Complex]] = []
    for link, joint, direction in zip(description.links, joints, directions, strict=True):
        found += [(link.m, joint + link.r * direction), (link.payload, joint + link.l * direction)]
    return found


def potential_energy(description: Description, q: Array) -> Array:
    """Of masses, springs, and constant forces and torques."""
    g = description.gravity.conjugate()
    PE = np.asarray(-sum(m * (g * place).real for m, place in _masses(description, q)))
    for load in description.loads:
        if isinstance(load, Moment):
            PE = PE - load.torque * _angle(description, q, load.link)
        elif not load.turns:
            PE = PE - (load.force.conjugate() * _place(description, q, load.point)).real
    for spring in description.springs:
        stretched = (
            q[..., spring.joint] - spring.angle
            if isinstance(spring, JointSpring)
            else _length(description, q, spring) - spring.length
        )
        PE = PE + 0.5 * spring.stiffness * stretched**2
    return PE


def other_power(description: Description, q: Array, qd: Array, directions: Array) -> Array:
    """The power along `directions` of dampers of springs, forces that turn, and friction."""
    power = np.zeros(q.shape[:-1])
    sharp = sharpness(description, q)

    def rate(function: Callable[[Array], Any], v: Array) -> Any:
        return along(lambda s: function(q + s * v), spins(description, v) * sharp)

    for spring in description.springs:
        if isinstance(spring, Spring) and spring.damping:
            length = partial(_length, description, spring=spring)
            speed, way = (rate(length, v) for v in (qd, directions))
            power = power - spring.damping * speed * way
    for load in description.loads:
        if isinstance(load, Load) and load.turns:
            way = rate(partial(_place, description, point=load.point), directions)
            assert load.point.link is not None
            turn = np.exp(1j * _angle(description, q, load.point.link))
            power = power + ((load.force * turn).conjugate() * way).real
    for k, link in enumerate(description.links):
        if link.friction is not None:
            smooth = np.tanh(qd[..., k] / link.friction.speed)
            power = power - link.friction.torque * smooth * directions[..., k]
    return power


def joint_damping(description: Description) -> Array:
    damping = np.array([link.damping for link in description.links])
    for spring in description.springs:
        if isinstance(spring, JointSpring):
            damping[spring.joint] += spring.damping
    return damping


def _angle(description: Description, q: Array, link: int) -> Array:
    """The link's angle from +X."""
    angle, above = np.zeros(q.shape[:-1]), link
    while True:
        angle = angle + q[..., above]
        further = description.links[above].hangs_from.link
        if further is None:
            return angle
        above = further


def _length(description: Description, q: Array, spring: Spring) -> Array:
    first, second = (_place(description, q, point) for point in (spring.first, spring.second))
    return np.asarray(np.abs(first - second))


def kinetic_energy(description: Description, q: Array, qd: Array) -> Array:
    spin = spins(description, qd)
    velocities = along(
        lambda s: np.stack([z for _, z in _masses(description, q + s * qd)], axis=-1), spin
    )
    masses = np.array([m for m, _ in _masses(description, q[:1])])
    turning = spin**2 @ np.array([link.I for link in description.links])
    return np.asarray(0.5 * (np.abs(velocities) ** 2 @ masses + turning))


def spins(description: Description, qd: Array) -> Array:
    """The links' own rates: how fast their directions turn, (..., n)."""
    found = np.array(qd)
    for k in _outward(description):
        above = description.links[k].hangs_from.link
        if above is not None:
            found[..., k] += found[..., above]
    return found


def _place(description: Description, q: Array, point: Point) -> Complex:
    return _among(_places(description, q), point)


def _among(places: Places, point: Point) -> Complex:
    joints, directions = places
    if point.link is None:
        return np.full(directions[0].shape, point.at)
    return joints[point.link] + point.at * directions[point.link]


def gap(description: Description, arms: list[float], q: Array) -> Array:
    rows: list[Array] = []
    places = _places(description, q)
    for closure in description.closures:
        apart = _among(places, closure.first) - _among(places, closure.second)
        if closure.along is None:
            rows += [apart.real, apart.imag]
        else:
            rows.append((apart * closure.along.conjugate()).imag)
    for coupling, arm in zip(description.couplings, arms, strict=True):
        others = sum(ratio * q[..., k] for k, ratio in coupling.terms) + coupling.angle
        rows.append(arm * (q[..., coupling.joint] - others))
    return np.stack(rows, axis=-1)


def sharpness(description: Description, q: Array) -> Array:
    """How much shorter steps must be where the ends of a spring are near, (T, 1)."""
    sharp = np.ones(len(q))
    reach = sum(link.l for link in description.links)
    for spring in description.springs:
        if isinstance(spring, Spring):
            length = _length(description, q, spring)
            sharp = np.maximum(sharp, 2.0 * reach / np.maximum(length, 1e-300))
    return sharp[:, None]
