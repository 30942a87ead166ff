"""Joints that laws of the time drive, and the error of what cannot take such a scene."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn.errors import InputError
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Description


def driven_joints(description: Description) -> frozenset[int]:
    """The joints that the time alone tells, by laws of couplings, one after another."""
    known: set[int] = set()
    timed: set[int] = set()
    waiting = list(description.couplings)
    while True:
        follows = [x for x in waiting if x.joint not in known and x.others <= known]
        if not follows:
            return frozenset(timed)
        for x in follows:
            known.add(x.joint)
            if x.timed or not timed.isdisjoint(x.others):
                timed.add(x.joint)
            waiting.remove(x)


def refuse_driven(mechanism: Mechanism, what: str) -> None:
    """Raise InputError, which names the law, if a coupling of the mechanism is a law of the time.

    `what` cannot take such a scene.
    """
    for place, law in _laws_of_time(mechanism):
        limit = f"is a law of the time, which {what} cannot take"
        raise InputError(place, where=mechanism.source, value=law, limit=limit)


def check_times(mechanism: Mechanism, timed: bool, source: str = "") -> None:
    """Raise InputError for rows, of the file `source`, if a law needs times that they lack.

    `timed` says that they have times.
    """
    for place, law in () if timed else _laws_of_time(mechanism):
        limit = f"no times of the rows: {place} = {law} is a law of the time"
        raise InputError("t", where=source, limit=limit)


def check_torques(mechanism: Mechanism) -> None:
    """Raise InputError if laws of the time lead all joints: none has a torque of its own."""
    if mechanism.driven and not mechanism.actuated:
        limit = "none: laws of the time lead the mechanism, and no joint is actuated"
        raise InputError("torques", where=mechanism.source, limit=limit)


def _laws_of_time(mechanism: Mechanism) -> Iterator[tuple[str, str]]:
    """The places and the texts of laws of the time."""
    for c, coupling in enumerate(mechanism.description.couplings):
        if coupling.timed and coupling.law is not None:
            yield f"couplings[{c}]", coupling.law.text
