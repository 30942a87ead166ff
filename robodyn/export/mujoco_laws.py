"""Where joints end, dry friction, and laws of springs, as MuJoCo has them.

A compliant stop without damping is a tendon that is slack between the ends, exactly.  With damping
it is MuJoCo's limit, of the weakest impedance d that it takes: of the push f wanted it gives

    f - d a/w        d = 1e-4,

a the acceleration of the joint where nothing pushes, w = (M^-1)_jj where all joints are zero; and
the limit is told k w and b w.

A hard stop is a limit that lets a joint bounce in some time steps, as a spring and damper do that
never pull.  With the damping ratio z the joint leaves at the part

    e = exp(-2 z acos(z) / sqrt(1 - z^2))

of the speed, so z follows from the restitution.

Laws are polynomials up to the third power, from MuJoCo 3.7 on: a spring pulls by
k1 x + k2 x^2 + k3 x^3, and its damper by d1 v + d3 v^3; both are zero where the spring is free and
at rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from robodyn.elements.joints import Stops
from robodyn.equations.symbolic import Atom, Role, of, summed
from robodyn.export.model_xml import number
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import DryFriction, Law, Limits, Signal

X, V = (Atom(Role.length, (k,), name) for k, name in enumerate("xv"))
MOST = 3
LIMIT = "MJCF has polynomials k1 x + k2 x^2 + k3 x^3 + d1 v + d3 v^3 alone, and no tables"
WEAK = "0.0001 0.0001 0.001 0.5 2"  # the impedance: a limit's, the least that MuJoCo takes
STIFF = "0.9999 0.9999 0.001 0.5 2"  # the most
FAR = 1e9  # rad, m: as good as no limit
BOUNCE = 16.0  # time steps of a bounce
MOST_DAMPED = 2.5  # damping ratio that a bounce of so many steps allows


def contact_notes(mechanism: Mechanism) -> Iterator[str]:
    """What MuJoCo does otherwise than the scene at ends of joints and with dry friction."""
    for k, link in enumerate(mechanism.description.links):
        stop, friction, joint = link.limits, link.friction, f"joint {link.name}"
        if stop is None:
            pass
        elif stop.restitution is not None:
            part = f"throws back about {restitution(damping_ratio(stop.restitution)):.2g}"
            yield f"{joint}: MuJoCo's stop is soft and {part} of the speed"
        elif stop.stiffness is None:
            yield f"{joint}: MuJoCo stops it at its limits, where robodyn ends a run"
        elif stop.damping:
            yield f"{joint}: MuJoCo's stop misses 1e-4 of the force that would hold the joint"
        if isinstance(friction, DryFriction) and (friction.static or friction.torque):
            unit = "N" if k in mechanism.slides else "N m"
            told = f"{joint}: MuJoCo's friction is {friction.torque:g} {unit}"
            if friction.static > friction.torque:
                told += f" at rest too, not {friction.static:g}"
            yield f"{told}, and what sticks creeps"


def joint_contacts(mechanism: Mechanism, joint: int, timestep: float) -> dict[str, str]:
    """The attributes of a joint that has ends other than springs, or dry friction."""
    link, found = mechanism.description.links[joint], {}
    if isinstance(link.friction, DryFriction) and link.friction.torque:
        found["frictionloss"] = number(link.friction.torque)
        found |= {"solreffriction": f"{number(2.0 * timestep)} 1", "solimpfriction": STIFF}
    if link.limits is not None and not is_slack(link.limits):
        found |= {"limited": "true", "range": joint_range(link.limits)}
        found |= _limit(mechanism, joint, link.limits, timestep)
    return found


def is_slack(stop: Limits | Stops) -> bool:
    """Whether it is compliant without damping, so that a tendon slack between its ends is as it."""
    return stop.stiffness is not None and not stop.damping


def joint_range(stop: Limits | Stops) -> str:
    """From where to where a joint goes."""
    low = -FAR if stop.low is None else stop.low
    return f"{number(low)} {number(FAR if stop.high is None else stop.high)}"


def _limit(mechanism: Mechanism, joint: int, stop: Limits, timestep: float) -> dict[str, str]:
    if stop.stiffness is not None:
        import numpy as np  # only here

        from robodyn.dynamics.closed_form import mass_matrix

        unit = np.eye(mechanism.n)[joint]
        w = float(np.linalg.solve(mass_matrix(mechanism, np.zeros(mechanism.n)), unit)[joint])
        return _soft(w * stop.stiffness, w * stop.damping) | {"solimplimit": WEAK}
    rate = math.pi / (BOUNCE * timestep)  # a bounce lasts half a period
    ratio = 1.0 if stop.restitution is None else damping_ratio(stop.restitution)
    return _soft(rate**2, 2.0 * ratio * rate) | {"solimplimit": STIFF}


def _soft(stiffness: float, damping: float) -> dict[str, str]:
    return {"solreflimit": f"{number(-stiffness)} {number(-damping)}"}


def damping_ratio(part: float) -> float:
    """Of a stop that throws a joint back with this part of its speed, as far as steps allow."""
    low, high = 1e-9, MOST_DAMPED
    while high - low > 1e-12:
        ratio = 0.5 * (low + high)
        low, high = (ratio, high) if restitution(ratio) > part else (low, ratio)
    return high


def restitution(ratio: float) -> float:
    """The part of the speed that a stop of this damping ratio leaves."""
    if abs(ratio - 1.0) < 1e-9:
        return math.exp(-2.0)
    if ratio < 1.0:
        return math.exp(-2.0 * ratio * math.acos(ratio) / math.sqrt(1.0 - ratio**2))
    return math.exp(-2.0 * ratio * math.acosh(ratio) / math.sqrt(ratio**2 - 1.0))


def polynomial(law: Signal | None) -> dict[str, str] | None:
    """The attributes `stiffness` and `damping` of a spring with this law; None where none have it.

    They are numbers, as many as are needed; no law has none.
    """
    if law is None:
        return {}
    if not isinstance(law, Law):
        return None
    try:
        found = summed(eval(law.code, {"__builtins__": {}}, {"x": of(X), "v": of(V)}))
    except (ArithmeticError, NameError, TypeError):  # functions, remainders, powers that are none
        return None
    powers = ((dict(monomial), float(number)) for monomial, number in found.terms.items())
    terms = {(each.get(X, 0), each.get(V, 0)): number for each, number in powers}
    if not _SAID.issuperset(terms):
        return None
    pulls = [[terms.get((i, 0), 0.0) for i in range(1, MOST + 1)]]
    pulls.append([terms.get((0, j), 0.0) for j in range(1, MOST + 1)])
    return {
        name: " ".join(repr(c + 0.0) for c in part[: max(k + 1 for k, c in enumerate(part) if c)])
        for name, part in zip(("stiffness", "damping"), pulls, strict=True)
        if any(part)
    }


_SAID = {(i, 0) for i in range(1, MOST + 1)} | {(0, 1), (0, 3)}
