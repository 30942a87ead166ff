"""What a robot model in XML needs: names that tools take, exact numbers, a comment, refusals.

Models are three-dimensional: the plane of the scene becomes X-Y, angles turn about +Z.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Mapping
from xml.etree import ElementTree

from robodyn import __version__
from robodyn.errors import InputError, printable
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.scene import Description, DryFriction, Link, Signal, signals_of, told

# what tools name themselves: MuJoCo its ground, Pinocchio its own and its root's joint
RESERVED = frozenset({"world", "universe", "root_joint"})
SAFE, UNSAFE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*"), re.compile(r"[^A-Za-z0-9_]+")
# these say how a scene is named and assembled, are said in the comment, or act on nothing
SCENE_SAID = frozenset(
    {"source", "name", "gravity", "links", "branches", "actuated", "start", "written", "points"}
)
LINK_SAID = frozenset({"name", "m", "l", "r", "I", "hangs_from", "payload", "damping", "axis"})


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
    description: Description,
    format: str,
    reasons: Mapping[str, str],
    more: Collection[str] = (),
    unsaid: Callable[[str, Signal], str] | None = None,
) -> None:
    """Raise InputError for what the scene names and the format is not made to say.

    What is said is listed, here and in `more` keys of the scene or of links; any other key is
    refused where it holds something, one that a later scene format adds too.  `reasons` tell why.
    `unsaid` tells why of what varies at a place; nothing where it is said; None: nothing is.
    Dry friction and ends of joints are told in notes, where they are not exact.
    """
    holders: list[tuple[str, Description | Link, frozenset[str]]] = [("", description, SCENE_SAID)]
    links = enumerate(description.links)
    holders += [(f"links[{k}] ({link.name}).", link, LINK_SAID) for k, link in links]
    for place, holder, said in holders:
        for key in (name for name in holder._fields if name not in {*said, *more}):
            value = getattr(holder, key)
            if isinstance(value, DryFriction):
                continue
            if value and getattr(value, "torque", True):  # friction without torque is none
                shown = value if isinstance(value, (int, float, str)) else None
                what, limit = f"{place}{key}", reasons.get(key, f"{format} cannot say it")
                raise InputError(what, where=description.source, value=shown, limit=limit)
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
