"""Springs, forces that turn with a link, and friction, recorded as formulas.

The same torques as in `forces.py`, where their equations stand, on the nodes of `formula_state.py`;
also written out as code of its own, for what expands or evaluates it otherwise than with floats.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from robodyn import expression
from robodyn.engines import source_text
from robodyn.expression import Value
from robodyn.formula_state import Planar, State, planar, plus, times, to_joints
from robodyn.mechanism import Mechanism, PlanarPoint


class ForceCode(NamedTuple):
    """Statements on q0.., qd0.., and the expressions of the joint torques (n) that follow.

    They call sin, cos, sqrt and tanh.
    """

    lines: tuple[str, ...]
    potential: tuple[str, ...]  # of springs
    other: tuple[str, ...]  # of what has no potential, but for dampers of joints


@lru_cache(maxsize=64)
def force_code(mechanism: Mechanism) -> ForceCode:
    """The torques of a scene's own forces as code."""
    state = State(mechanism, ("qd",), by_direction=True)
    n = mechanism.n
    try:
        torques = potential_torques(state) + other_torques(state)
    except ZeroDivisionError:  # a spring has no direction at any state: the code is to say so
        return ForceCode((), ("0.0/0.0",) * n, ("0.0/0.0",) * n)
    lines, outputs = source_text.float_source(torques)
    return ForceCode(tuple(lines), tuple(outputs[:n]), tuple(outputs[n:]))


def potential_torques(state: State) -> list[Value]:
    """-dPE/dq of the springs (n)."""
    mechanism = state.mechanism
    absolute: list[Value] = [0.0] * mechanism.n
    for spring in mechanism.springs:
        if not spring.stiffness:
            continue
        d = _place(state, spring.between)
        pull: Value = -spring.stiffness
        if spring.length:
            pull = spring.stiffness * spring.length / expression.sqrt(_square(d)) - spring.stiffness
        _act(state, spring.between, (pull * d[0], pull * d[1]), absolute)
    torques = to_joints(mechanism, absolute)
    for joint_spring in mechanism.joint_springs:
        k = joint_spring.joint
        stretched = state.relative["q"][k] - joint_spring.angle
        torques[k] = torques[k] - joint_spring.stiffness * stretched
    return torques


def other_torques(state: State) -> list[Value]:
    """The joint torques (n) of what has no potential, but for dampers of joints."""
    mechanism = state.mechanism
    absolute: list[Value] = [0.0] * mechanism.n
    rates = state.absolute("qd")
    for spring in mechanism.springs:
        if not spring.damping:
            continue
        d = _place(state, spring.between)
        speed: Value = 0.0  # Re(conj(d) ddot) = sum_k w_k Im(conj(c_k E_k) d)
        for k, c in spring.between.terms:
            speed = speed + rates[k] * _lever(state, k, c, d)
        pull = -spring.damping * speed / _square(d)
        _act(state, spring.between, (pull * d[0], pull * d[1]), absolute)
    for force in mechanism.forces:
        if force.turns:
            turned = times(planar(force.force), state.direction(force.link))
            _act(state, force.point, turned, absolute)
    torques = to_joints(mechanism, absolute)
    for k, friction in mechanism.friction:
        smooth = expression.tanh(state.relative["qd"][k] / friction.speed)
        torques[k] = torques[k] - friction.torque * smooth
    return torques


def _place(state: State, point: PlanarPoint) -> Planar:
    place = planar(point.constant)
    for k, c in point.terms:
        place = plus(place, times(planar(c), state.direction(k)))
    return place


def _square(d: Planar) -> Value:
    return d[0] * d[0] + d[1] * d[1]


def _lever(state: State, k: int, c: complex, F: Planar) -> Value:
    """Im(conj(c E_k) F)."""
    arm = times(planar(c), state.direction(k))
    return arm[0] * F[1] - arm[1] * F[0]


def _act(state: State, point: PlanarPoint, F: Planar, absolute: list[Value]) -> None:
    for k, c in point.terms:
        absolute[k] = absolute[k] + _lever(state, k, c, F)
