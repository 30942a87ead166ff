"""What the equations of motion are linear in: masses, moments, dampers, friction, springs.

Of link k, its payload included, with r its centre of gravity in its own frame:

    m_k    mass                             mx_k, my_k    first moment m r
    J_k    inertia about its own joint      d_k           damping at its joint, all of it
    f_k    friction, fs_k its static one    Jr_k          inertia of the rotor at its joint
    k_i    stiffness of spring i            ds_i          damping of spring i between points

Damping of a rotor and of springs at joints is part of d_k.  Loads, laws of springs and stops have
no parameter: what they do is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from robodyn.elements.joints import DryFriction, Slipping, Stops
from robodyn.elements.springs import JointDamper, JointSpring
from robodyn.engines.planar_numbers import Planar
from robodyn.mechanics.link_tree import Bodies, bodies
from robodyn.mechanics.mechanism import Mechanism, constants, joint_damping
from robodyn.scene import scene as described
from robodyn.scene.scene import Description, Spring

INERTIAL = ("m", "mx", "my", "J")


class Parameter(NamedTuple):
    """One of what the torques are linear in."""

    name: str  # m2, mx2, ..
    value: float
    unit: str


def linear_parameters(description: Description) -> tuple[Parameter, ...]:
    """Those of a scene, with their values there, link by link, then the springs'."""
    found: list[Parameter] = []
    links, damping = description.links, joint_damping(description)
    for k, (m, first, J) in enumerate(zip(*bodies(links), strict=True)):
        link, i = links[k], k + 1
        force, rate = ("N", "s/m") if link.slides else ("N m", "s/rad")
        found += [
            Parameter(f"m{i}", m, "kg"),
            Parameter(f"mx{i}", first.real, "kg m"),
            Parameter(f"my{i}", first.imag, "kg m"),
            Parameter(f"J{i}", J, "kg m²"),
            Parameter(f"d{i}", damping[k], f"{force} {rate}"),
        ]
        if link.friction is not None:
            found.append(Parameter(f"f{i}", link.friction.torque, force))
        if isinstance(link.friction, described.DryFriction) and link.friction.stribeck is not None:
            found.append(Parameter(f"fs{i}", link.friction.static, force))
        if link.motor is not None:
            found.append(Parameter(f"Jr{i}", link.motor.inertia, "kg m²"))
    for i, spring in enumerate(description.springs, start=1):
        if spring.law is None:
            turns = isinstance(spring, described.JointSpring) and not links[spring.joint].slides
            found.append(Parameter(f"k{i}", spring.stiffness, "N m/rad" if turns else "N/m"))
        if isinstance(spring, Spring) and spring.damping:
            found.append(Parameter(f"ds{i}", spring.damping, "N s/m"))
    return tuple(found)


def with_parameters(mechanism: Mechanism, values: Mapping[str, Any]) -> Mechanism:
    """The mechanism with these values, formulas or numbers, for all of its parameters.

    It serves for torques alone: its inertias and energies are not to be asked for.
    """
    base = mechanism.description

    def damped(entry: Any, **others: Any) -> Any:
        return entry and entry._replace(damping=0.0, **others)

    links, springs, slips = [], [], []
    for i, link in enumerate(base.links, start=1):
        friction, motor = link.friction, link.motor
        if friction is not None:
            friction = friction._replace(torque=values[f"f{i}"])
        if isinstance(friction, described.DryFriction):
            static = values.get(f"fs{i}", friction.torque)
            friction = friction._replace(static=static)
            slips += [
                Slipping(k, friction.torque, static, friction.stribeck, way)
                for k, _, way in mechanism.slips
                if k == i - 1
            ]
        motor = damped(motor, inertia=values.get(f"Jr{i}"))
        links.append(link._replace(damping=values[f"d{i}"], friction=friction, motor=motor))
    for i, spring in enumerate(base.springs, start=1):
        stiffness = values.get(f"k{i}", 0.0)
        springs.append(damped(spring, stiffness=stiffness))
        if isinstance(spring, Spring):
            springs[-1] = springs[-1]._replace(damping=values.get(f"ds{i}", 0.0))
    m, mx, my, J = ([values[f"{x}{k + 1}"] for k in range(len(links))] for x in INERTIAL)
    own = Bodies(m, [Planar(x, y) for x, y in zip(mx, my, strict=True)], J)  # type: ignore[misc]
    scene = base._replace(links=tuple(links), springs=tuple(springs))
    made = constants(with_formulas(scene), own)
    stops = zip(made.damping, mechanism.damping, joint_damping(base), strict=True)
    pressed = mechanism.joint_springs[_kept(base) :]
    dampers = [JointDamper(k, d + (now - plain)) for k, (d, now, plain) in enumerate(stops)]
    exchanged = made.exchanged(
        {
            JointDamper: dampers,
            JointSpring: (*made.joint_springs, *pressed),
            Slipping: slips,
            DryFriction: (),
            Stops: (),
        }
    )
    elements = (*exchanged.elements, *mechanism.added)
    return replace(exchanged, elements=elements, actuated=mechanism.actuated, rows=mechanism.rows)


def _kept(description: Description) -> int:
    """How many springs at joints a mechanism has of its scene; those of stops follow."""
    springs = (x for x in description.springs if isinstance(x, described.JointSpring))
    return sum(bool(x.stiffness or x.law) for x in springs)


def with_formulas(value: Any) -> Any:
    """What a scene holds, with complex numbers that take formulas."""
    if isinstance(value, tuple):
        parts = map(with_formulas, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return Planar(value.real, value.imag) if isinstance(value, complex) else value
