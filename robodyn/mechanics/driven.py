"""Joints driven by laws of time, and errors of functions that cannot take such scenes."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from robodyn.elements.program import Given, Program
from robodyn.errors import InputError
from robodyn.mechanics.law_rows import LawRows
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.scene import Curve, Description, Law


def driven_joints(description: Description) -> frozenset[int]:
    """Return the joints that are determined by time alone, through laws of couplings."""
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


@lru_cache(maxsize=64)
def lasts(law: Law | Curve) -> bool:
    """Return whether a law does not depend on time: its partial derivative by t is zero."""
    if isinstance(law, Curve):
        return law.over != "t" or not any(any(c[1:]) for c in law.pieces)
    program = Program()
    rows = LawRows(program, lambda name: program.add(Given(name)))
    return rows.slopes(rows.value(law), ["t"]) == [0.0]


def refuse_driven(mechanism: Mechanism, what: str) -> None:
    """Raise InputError, with the law's name, if a coupling is a law of time.

    `what` is the function that cannot take such a scene.  Laws that are constant in time pass.
    """
    lasting = all(lasts(x.law) for x in mechanism.description.couplings if x.law is not None)
    for place, law in () if lasting else _laws_of_time(mechanism):
        limit = f"is a law of the time, which {what} cannot take"
        raise InputError(place, where=mechanism.source, value=law, limit=limit)


def check_times(mechanism: Mechanism, timed: bool, source: str = "") -> None:
    """Raise InputError for rows of the file `source` if a law needs times that they lack.

    `timed` tells whether the rows have times.
    """
    for place, law in () if timed else _laws_of_time(mechanism):
        limit = f"no times of the rows: {place} = {law} is a law of the time"
        raise InputError("t", where=source, limit=limit)


def check_torques(mechanism: Mechanism) -> None:
    """Raise InputError if laws of time drive all joints, so that none has a torque."""
    if mechanism.driven and not mechanism.actuated:
        place, law = next(_laws_of_time(mechanism))
        limit = "none: laws of the time lead the mechanism, and no joint is actuated "
        limit += f"({place} = {law} is a law of the time)"
        raise InputError("torques", where=mechanism.source, limit=limit)


def _laws_of_time(mechanism: Mechanism) -> Iterator[tuple[str, str]]:
    """Yield places and texts of laws of time, constant ones last."""
    laws = [(c, x.law) for c, x in enumerate(mechanism.description.couplings) if x.timed]
    for c, law in sorted(laws, key=lambda x: lasts(x[1])):
        if law is not None:
            yield f"couplings[{c}]", law.text
