"""Joints that laws of the time drive, and the error of what cannot take such a scene."""

from __future__ import annotations

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
    for c, coupling in enumerate(mechanism.description.couplings):
        if coupling.timed and coupling.law is not None:
            limit = f"is a law of the time, which {what} cannot take"
            place, law = f"couplings[{c}]", coupling.law.text
            raise InputError(place, where=mechanism.source, value=law, limit=limit)
