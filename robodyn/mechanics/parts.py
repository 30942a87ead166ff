"""A mechanism with a part of what acts on it: what makes one term of its equation of motion.

Massless, weightless, without closures or dampers of joints.  Numbers may be symbols too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from robodyn.errors import SingularPoseError
from robodyn.mechanics.planar_model import Mechanism, conserves
from robodyn.scene.scene import Signal

NOTHING = 8 * sys.float_info.epsilon  # part of the lengths to a distance that is rounding


def bare(mechanism: Mechanism) -> Mechanism:
    """The links alone."""
    zero = (0.0,) * mechanism.n
    nothing = replace(mechanism, A=(), damping=zero, rows=(), weights=zero, moments=zero)
    nothing = replace(nothing, springs=(), joint_springs=(), forces=(), friction=(), slips=())
    return replace(nothing, varying_moments=(), rotors=(), energy_offset=0.0)


def stored(mechanism: Mechanism) -> Mechanism:
    """The springs with a potential, whose torques are part of G."""
    springs = tuple(x._replace(damping=0.0) for x in mechanism.springs if conserves(x.law))
    turned = tuple(x for x in mechanism.joint_springs if conserves(x.law))
    return replace(bare(mechanism), springs=springs, joint_springs=turned)


def loaded(mechanism: Mechanism) -> Mechanism:
    """The loads at points: without weights only those act that turn with a link."""
    moments = mechanism.varying_moments
    return replace(bare(mechanism), forces=mechanism.forces, varying_moments=moments)


def spent(mechanism: Mechanism) -> Mechanism:
    """What makes Q: dampers of springs, forces that turn with a link or vary, friction."""
    springs = tuple(
        x._replace(stiffness=0.0, law=None) if conserves(x.law) else x for x in mechanism.springs
    )
    turned = tuple(x for x in mechanism.joint_springs if not conserves(x.law))
    rubs = replace(loaded(mechanism), friction=mechanism.friction, slips=mechanism.slips)
    return replace(rubs, springs=springs, joint_springs=turned)


def untimed(mechanism: Mechanism) -> Mechanism:
    """All but loads that depend on the time, which a model of a controller does not know."""
    if not mechanism.timed:
        return mechanism

    def still(signals: tuple[Signal | float, ...]) -> Any:
        timed = [isinstance(x, Signal) and "t" in x.names for x in signals]
        return tuple(0.0 if t else x for x, t in zip(signals, timed, strict=True))

    forces = tuple(x._replace(signals=x.signals and still(x.signals)) for x in mechanism.forces)
    moments = tuple(x for x in mechanism.varying_moments if "t" not in x.signal.names)
    return replace(mechanism, forces=forces, varying_moments=moments)


def acting(mechanism: Mechanism) -> Mechanism:
    """Both of these."""
    springs, turned = mechanism.springs, mechanism.joint_springs
    return replace(spent(mechanism), springs=springs, joint_springs=turned)


def met_ends(mechanism: Mechanism, q: Sequence[Any], exp: Callable[[Any], Any]) -> dict[int, Any]:
    """Return whether the ends of each spring that needs a direction meet within rounding.

    Keys are places among the springs.  The n values of `q` are floats or arrays, and `exp` is the
    complex exponential of them.  Ends that are apart by less than NOTHING of the lengths which lead
    from one to the other meet.
    """
    directed = {k: x.between for k, x in enumerate(mechanism.springs) if x.directed}
    x, met = list(q), {}
    for k in mechanism.order if directed else ():
        if (above := mechanism.above[k]) is not None:
            x[k] = x[k] + x[above]
    for place, between in directed.items():
        apart, lengths = between.constant, abs(between.constant)
        for k, c in between.terms:
            turned = mechanism.frames[k]
            part = c * (x[k] if k in mechanism.slides else 1.0)
            part = part if turned is None else part * exp(1j * x[turned])
            apart, lengths = apart + part, lengths + abs(part)
        met[place] = abs(apart) <= NOTHING * lengths
    return met


def no_direction(mechanism: Mechanism, spring: int) -> SingularPoseError:
    """The error of a spring between points whose ends coincide."""
    return SingularPoseError(
        f"the ends of spring {spring + 1} between two points coincide",
        where=mechanism.source,
        limit="its force has no direction there; only length 0 without damping allows that",
    )
