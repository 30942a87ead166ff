"""What a robot model in XML needs: names that tools take, exact numbers, a comment, refusals.

Models are three-dimensional: the plane of the scene becomes X-Y, angles turn about +Z.

As MuJoCo has it, a compliant stop without damping is a tendon that is slack between the ends,
exactly.  With damping it is MuJoCo's limit, of the weakest impedance d that it takes: of the push f
wanted it gives

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
import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from xml.etree import ElementTree

import numpy as np

from robodyn import __version__
from robodyn.dynamics.closed_form import mass_matrix
from robodyn.elements.base import Element
from robodyn.elements.joints import DryFriction, Stops, of_way
from robodyn.equations.symbolic import Atom, Role, of, summed
from robodyn.errors import InputError, printable
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.expressions import value_in
from robodyn.scene.scene import (
    Description,
    Law,
    Link,
    Signal,
    signals_of,
    told,
)

# what tools name themselves: MuJoCo its ground, Pinocchio its own and its root's joint
RESERVED = frozenset({"world", "universe", "root_joint"})
SAFE, UNSAFE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*"), re.compile(r"[^A-Za-z0-9_]+")
# these say how a scene is named and assembled, are said in the comment, or act on nothing
SCENE_SAID = frozenset(
    {"source", "name", "gravity", "links", "branches", "actuated", "start", "written"}
    | {"points", "pins", "welds", "apart", "constants", "field"}
)
LINK_SAID = frozenset(
    {"name", "m", "l", "r", "I", "hangs_from", "payload", "damping", "axis"} | {"turn", "has_mass"}
)


class Names:
    """Gives out names of ASCII letters, digits and underscores, none twice and none reserved."""

    def __init__(self) -> None:
        self._taken = set(RESERVED)

    def new(self, wanted: str, otherwise: str = "link") -> str:
        """A new name like the one wanted; like `otherwise` where nothing of that is left."""
        plain = unicodedata.normalize("NFKD", wanted).encode("ascii", "ignore").decode()
        base = wanted if SAFE.fullmatch(wanted) else UNSAFE.sub("_", plain).strip("_")
        if not base:
            base = otherwise
        elif base[0].isdigit():
            base = f"link_{base}"
        name, number = base, 2
        while name in self._taken:
            name, number = f"{base}_{number}", number + 1
        self._taken.add(name)
        return name


def link_names(mechanism: Mechanism, names: Names) -> list[str]:
    """A name for each link; a link whose name is fit already keeps it, whatever the others want."""
    wanted = mechanism.link_names
    fit = {
        k: names.new(name)
        for k, name in enumerate(wanted)
        if SAFE.fullmatch(name) and name not in RESERVED
    }
    return [fit.get(k) or names.new(name, f"link{k + 1}") for k, name in enumerate(wanted)]


def number(value: float) -> str:
    """The number so that it reads back exactly, without a negative zero."""
    return repr(float(value) + 0.0)


def vector(point: complex) -> str:
    """A point of the scene's plane in three dimensions."""
    return f"{number(point.real)} {number(point.imag)} 0.0"


def comment(mechanism: Mechanism, joints: Iterable[str]) -> list[str]:
    """The lines of the comment at the top of a model: what it is, its frame and its coordinates."""
    driven = set(mechanism.actuated)
    moves, told = "every joint turns about +Z", "counter-clockwise:"
    if mechanism.slides:
        moves, told = "joints turn about +Z or slide", "counter-clockwise; or how far"
    lines = [
        f"{mechanism.name}: {mechanism.source}, written by robodyn {__version__}.",
        f"The plane of the scene is X-Y, and {moves}.  SI units, radians.",
        "Gravity is " + vector(mechanism.gamma) + " m/s^2.",
        "Each joint is the angle of its link relative to the link that it hangs from, or from +X",
        f"where that is the ground, {told}",
    ]
    if mechanism.slides:
        lines.append("it slid along its link's x axis:")
    for k, (joint, name) in enumerate(zip(joints, mechanism.link_names, strict=True)):
        remark = "" if joint == name else f" (link {name})"
        remark += ", slides" if k in mechanism.slides else ""
        lines.append(f"  q{k + 1}  {joint}{remark}{', driven' if k in driven else ''}")
    return [*lines, "What this format has otherwise than the scene: robodyn guide export."]


def refuse_unsaid(
    mechanism: Mechanism,
    format: str,
    reasons: Mapping[str, str],
    more: Collection[str] = (),
    unsaid: Callable[[str, Signal], str] | None = None,
    kinds: tuple[type[Element], ...] = (),
) -> None:
    """Raise InputError for what acts, or the scene names, and the format is not made to say.

    What is said is listed, here and in `more` keys of the scene or of links; any other key is
    refused where it holds something, one that a later scene format adds too.  `reasons` tell why.
    `unsaid` tells why of what varies at a place; nothing where it is said; None: nothing is.
    Of elements in lists that are said these `kinds` are.
    Dry friction and ends of joints are told in notes, where they are not exact.
    """
    description = mechanism.description
    for x in mechanism.added:
        raise InputError(x.word, where=mechanism.source, limit=f"{format} cannot say it")
    holders: list[tuple[str, Description | Link, frozenset[str]]] = [("", description, SCENE_SAID)]
    links = enumerate(description.links)
    holders += [(f"links[{k}] ({link.name}).", link, LINK_SAID) for k, link in links]
    for place, holder, said in holders:
        for key in (name for name in holder._fields if name not in {*said, *more}):
            value = getattr(holder, key)
            if isinstance(value, DryFriction):
                if isinstance(value.torque, tuple) or isinstance(value.static, tuple):
                    limit = f"differs with the direction; {format} has one for both"
                    raise InputError(f"{place}{key}", where=description.source, limit=limit)
                continue
            if value and getattr(value, "torque", True):  # friction without torque is none
                shown = value if isinstance(value, (int, float, str)) else None
                what, limit = f"{place}{key}", reasons.get(key, f"{format} cannot say it")
                raise InputError(what, where=description.source, value=shown, limit=limit)
    for c, coupling in enumerate(description.couplings):
        if coupling.law is not None:
            limit = f"{format} has couplings that are linear in joints, no laws"
            place, law = f"couplings[{c}]", coupling.law.text
            raise InputError(place, where=description.source, value=law, limit=limit)
    for place, element in description.elements:
        if place.partition("[")[0] in more and type(element) not in kinds:
            limit = f"{format} cannot say it"
            raise InputError(place, where=description.source, limit=limit)
    for place, signal in signals_of(description):
        limit = f"{format} cannot say it" if unsaid is None else unsaid(place, signal)
        if limit:
            raise InputError(place, where=description.source, value=told(signal), limit=limit)


def document(root: ElementTree.Element, lines: Iterable[str]) -> str:
    """The XML text of a model, its first child a comment of these lines."""
    # two hyphens would end the comment, and control characters are no XML
    text = [printable(line).replace("--", "- -").replace("--", "- -") for line in lines]
    root.insert(0, ElementTree.Comment("\n    " + "\n    ".join(text) + "\n  "))
    ElementTree.indent(root)
    written = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{written}\n'


X, V = (Atom(Role.length, (k,), name) for k, name in enumerate("xv"))
MOST = 3
LIMIT = "MJCF has polynomials k1 x + k2 x^2 + k3 x^3 + d1 v + d3 v^3 alone, and no tables"
WEAK = "0.0001 0.0001 0.001 0.5 2"  # the impedance: a limit's, the least that MuJoCo takes
STIFF = "0.9999 0.9999 0.001 0.5 2"  # the most
FAR = 1e9  # rad, m: as good as no limit
BOUNCE = 16.0  # time steps of a bounce
MOST_DAMPED = 2.5  # damping ratio that a bounce of so many steps allows


def contact_notes(mechanism: Mechanism) -> Iterator[str]:
    """Yield how MuJoCo differs from the scene at stops and with dry friction."""
    for k, link in enumerate(mechanism.description.links):
        stop, joint = link.limits, f"joint {link.name}"
        if stop is None:
            pass
        elif stop.restitution is not None:
            part = f"throws back about {restitution(damping_ratio(stop.restitution)):.2g}"
            yield f"{joint}: MuJoCo's stop is soft and {part} of the speed"
        elif stop.stiffness is None:
            yield f"{joint}: MuJoCo stops it at its limits, where robodyn ends a run"
        elif stop.damping:
            yield f"{joint}: MuJoCo's stop misses 1e-4 of the force that would hold the joint"
        moving, static = dry_friction(link)
        if static or moving:
            unit = "N" if k in mechanism.slides else "N m"
            told = f"{joint}: MuJoCo's friction is {moving:g} {unit}"
            if static > moving:
                told += f" at rest too, not {static:g}"
            yield f"{told}, and what sticks creeps"


def dry_friction(link: Link) -> tuple[float, float]:
    """The dry friction of its joint, in motion and at rest, N m or N.

    One that differs with the direction is refused before, by `refuse_unsaid`.
    """
    friction = link.friction
    if not isinstance(friction, DryFriction):
        return 0.0, 0.0
    return of_way(friction.torque, 1), of_way(friction.static, 1)


def joint_contacts(mechanism: Mechanism, joint: int, timestep: float) -> dict[str, str]:
    """The attributes of a joint that has ends other than springs, or dry friction."""
    link, found = mechanism.description.links[joint], {}
    moving, _ = dry_friction(link)
    if moving:
        found["frictionloss"] = number(moving)
        found |= {"solreffriction": f"{number(2.0 * timestep)} 1", "solimpfriction": STIFF}
    if link.limits is not None and not is_slack(link.limits):
        found |= {"limited": "true", "range": joint_range(link.limits)}
        found |= _limit(mechanism, joint, link.limits, timestep)
    return found


def is_slack(stop: Stops) -> bool:
    """Whether it is compliant without damping, so that a tendon slack between its ends is as it."""
    return stop.stiffness is not None and not stop.damping


def joint_range(stop: Stops) -> str:
    """From where to where a joint goes."""
    low = -FAR if stop.low is None else stop.low
    return f"{number(low)} {number(FAR if stop.high is None else stop.high)}"


def _limit(mechanism: Mechanism, joint: int, stop: Stops, timestep: float) -> dict[str, str]:
    if stop.stiffness is not None:
        unit = np.eye(mechanism.n)[joint]
        w = float(np.linalg.solve(mass_matrix(mechanism, np.zeros(mechanism.n)), unit)[joint])
        return _soft(w * stop.stiffness, w * stop.damping) | {"solimplimit": WEAK}
    rate = math.pi / (BOUNCE * timestep)  # a bounce lasts half a period
    ratio = 1.0 if stop.restitution is None else damping_ratio(stop.restitution)
    return _soft(rate**2, 2.0 * ratio * rate) | {"solimplimit": STIFF}


def _soft(stiffness: float, damping: float) -> dict[str, str]:
    return {"solreflimit": f"{number(-stiffness)} {number(-damping)}"}


def damping_ratio(part: float) -> float:
    """Return the damping ratio of a stop with this restitution, within limits of the step."""
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
        found = summed(value_in(law.node, {"x": of(X), "v": of(V)}))
    except (ArithmeticError, KeyError, TypeError):  # functions, remainders, powers that are none
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
