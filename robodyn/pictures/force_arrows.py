"""Forces as arrows: weights, the force in every pin, loads and springs, all to one scale."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from robodyn.dynamics.dynamics import (
    forward_dynamics_and_forces,
    inverse_dynamics_and_forces,
    pin_forces,
)
from robodyn.dynamics.reaction_forces import reactions
from robodyn.elements.gravity import GravityField
from robodyn.elements.loads import Force as LoadForce
from robodyn.elements.springs import PointSpring
from robodyn.engines.row_values import rows_of
from robodyn.errors import RobodynError
from robodyn.loops.loop_rates import check_way_on
from robodyn.mechanics import parts
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, PlanarPoint
from robodyn.mechanics.placed import Placed, placed
from robodyn.pictures.drawing import at, direction
from robodyn.scene.expressions import OPERATIONS, value_in
from robodyn.scene.scene import Law, Point, Signal
from robodyn.scene.syntax import FUNCTIONS
from robodyn.tables.arrays import Array, Complex

LONGEST = 0.3  # the longest arrow, as a part of the mechanism's span
SEEN = 1e-9  # forces below this part of the largest are none
ARC = (-0.75 * np.pi, 0.75 * np.pi)  # of a torque, rad
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
CLOSE = 0.08  # arrows nearer than this part of the longest lie on one another


class Force(NamedTuple):
    """A force on a link, N, and where it acts, m, as complex numbers; or a torque at a joint."""

    kind: str  # gravity, pin, load or drive
    name: str
    place: complex
    force: complex
    torque: float = 0.0  # N m, on the link at its joint; such a one has no force


def forces(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    qdd: Array,
    multipliers: Array,
    tau: Array | None = None,
) -> list[Force]:
    """The weights, the force in every pin, loads and springs, of one motion, each (n,).

    With the joint torques tau also those of actuated joints: tau1 is that on link 1.

    r1 is the force on link 1 at its own joint (its origin where it slides), f1 that on the side of
    closure 1 named first, s1 that of spring 1 on its end named first; springs at joints and loads
    without a point have none.
    Forces that are zero but for rounding are left out.
    """
    here, tree = placed(mechanism, q), Tree(mechanism.description.links)
    X = here.X
    description, found = mechanism.description, []

    def add(kind: str, name: str, point: PlanarPoint, force: complex) -> None:
        found.append(Force(kind, name, complex(at(point, X)), force))

    for k, link in enumerate(description.links):
        add("gravity", f"m{k + 1} g", mechanism.centres[k], link.m * mechanism.gamma)
        add("gravity", f"payload {k + 1} g", mechanism.tips[k], link.payload * mechanism.gamma)
    joints = reactions(mechanism, q, qd, qdd, multipliers) @ np.array([1, 1j])
    for k, force in enumerate(joints.tolist()):
        slides = description.links[k].slides
        joint = tree.point(Point(k, 0j)) if slides else mechanism.pivots[k]
        add("pin", f"r{k + 1}", joint, force)
    pins = pin_forces(mechanism, multipliers, q) @ np.array([1, 1j])
    for c, force in enumerate(pins.tolist()):
        add("pin", f"f{c + 1}", tree.point(description.closures[c].first), force)
    springs = (f"s{k + 1}" for k, x in enumerate(description.springs) if x.at is None)
    loads = (f"load {k + 1}" for k, x in enumerate(description.loads) if isinstance(x, LoadForce))
    names: dict[type, Iterator[str]] = {PointSpring: springs, LoadForce: loads}
    rows = rows_of(parts.acting, mechanism)
    if rows.acting:
        acting = rows.planar("forces", q, qd, 0.0).tolist()
        for x, force in zip(rows.acting, acting, strict=True):
            if isinstance(x.element, GravityField):  # m g of a link, at its centre of gravity
                k = x.at[1] or 0
                own, g = description.links[k], force / x.element.masses[k]
                add("gravity", f"m{k + 1} g", mechanism.centres[k], own.m * g)
                add("gravity", f"payload {k + 1} g", mechanism.tips[k], own.payload * g)
                continue
            name = next(names.get(type(x.element), iter([x.element.word])))
            grip = x.at[0]
            if isinstance(x.element, LoadForce) and x.element.moves:
                way = _way(mechanism, x.element, q, here)
                grip = grip._replace(constant=grip.constant + way)
            add("load", name, grip, force)
    torques = np.zeros(mechanism.n) if tau is None else tau
    for k in mechanism.actuated:
        value, slides = float(torques[k]), k in mechanism.slides
        point = tree.point(Point(k, 0j)) if slides else mechanism.pivots[k]
        force = value * complex(direction(tree, k, here.E)) if slides else 0j
        place = complex(at(point, X))
        found.append(Force("drive", f"tau{k + 1}", place, force, 0.0 if slides else value))
    least = SEEN * max(abs(item.force) for item in found)
    small = SEEN * max(abs(item.torque) for item in found) + least * mechanism.unit
    return [item for item in found if abs(item.force) > least or abs(item.torque) > small]


def forces_at(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    qdd: Array | None = None,
    tau: Array | None = None,
    *,
    t: float,
) -> list[Force]:
    """The `forces` of a state q, qd (n,) at t that moves with qdd, or as joint torques tau make it.

    Those of the driving torques are among them.

    Raises RobodynError where they are not finite, and as the dynamics do.
    """
    if tau is None:
        qdd = np.zeros_like(q) if qdd is None else qdd
        tau, multipliers, *_ = inverse_dynamics_and_forces(mechanism, q, qd, qdd, t)
    else:
        check_way_on(mechanism, q[None, :], qd[None, :])
        qdd, multipliers, _ = forward_dynamics_and_forces(mechanism, q, qd, tau, t)
    with np.errstate(all="ignore"):
        found = forces(mechanism, q, qd, qdd, multipliers, tau)
    if not np.isfinite([item.force + item.torque for item in found]).all():
        raise RobodynError("the result is not finite", limit="the state or the scene is too large")
    return found


def metres_a_newton(found: Sequence[Force], span: float) -> float:
    """The scale of arrows: the largest force is LONGEST of the span."""
    return LONGEST * span / (max((abs(item.force) for item in found), default=0.0) or 1.0)


def arrows(found: Sequence[Force], scale: float) -> list[tuple[complex, complex]]:
    """The tail and the head of each force, m, at `scale` m/N.

    An arrow begins where its force acts.  One that would so lie on another ends there instead.
    """
    close = CLOSE * scale * max((abs(item.force) for item in found), default=0.0)
    placed: list[tuple[complex, complex]] = []
    for item in found:
        way = scale * item.force
        choices = [(item.place, item.place + way), (item.place - way, item.place)]
        free = (x for x in choices if not any(_cover(x, y, close) for y in placed))
        placed.append(next(free, choices[0]))
    return placed


def _cover(one: tuple[complex, complex], two: tuple[complex, complex], close: float) -> bool:
    """Whether a third of one arrow or more is that close to another."""
    z = np.linspace(*one, 13) - two[0]
    along = two[1] - two[0]
    part = np.clip((z * along.conjugate()).real / abs(along) ** 2, 0.0, 1.0)
    return bool(np.mean(np.abs(z - part * along) < close) > 1 / 3)


def arc(torque: Force, radius: float) -> Complex:
    """The points of an arc about a joint, m, in the sense of its torque."""
    turned: Complex = radius * np.exp(1j * np.linspace(*ARC, 40))
    return torque.place + (turned if torque.torque > 0.0 else turned.conj())


def with_prefix(value: float, unit: str) -> str:
    """A value > 0 to 3 digits, as `1.15 kN`; from 0.1 to 1000 without a prefix."""
    value = float(f"{value:.3g}")
    power = 0 if 0.1 <= value < 1e3 else 3 * math.floor(math.log10(value) / 3 + 1e-9)
    if power not in PREFIXES:
        return f"{value:.3g} {unit}"
    return f"{value / 10.0**power:.3g} {PREFIXES[power]}{unit}"


def _way(mechanism: Mechanism, load: LoadForce, q: Array, here: Placed) -> complex:
    """Return the distance of a force from its fixed place on the link, m, at q (n,) and t = 0."""
    values = {"t": 0.0} | {f"q{k}": x for k, x in enumerate(np.asarray(q, float).tolist())}

    def value(signal: Signal | None) -> float:
        if signal is None:
            return 0.0
        if isinstance(signal, Law):
            return float(value_in(signal.node, values, {**OPERATIONS, **FUNCTIONS}))
        return float(np.interp(values[signal.over], signal.x, signal.F))

    link = load.point.link or 0
    turned = mechanism.tree.turned(link, load.turn * complex(*map(value, load.moving)))
    frame = mechanism.frames[link]
    return turned if frame is None else turned * complex(here.E[frame])
