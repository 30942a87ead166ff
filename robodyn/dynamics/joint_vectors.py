"""Vectors of joints, as options write them: of all joints, or of the actuated ones."""

from __future__ import annotations

from collections.abc import Callable

from robodyn.dynamics.columns import scene_units, unit_of
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.quantities import parse_vector
from robodyn.tables.csv_fields import shown


def joint_units(mechanism: Mechanism, count: int, kind: str) -> list[str]:
    """The units of so many q, qd, qdd or tau (`kind`), of all joints or of the actuated ones."""
    joints = [*range(mechanism.n)] if count == mechanism.n else [*mechanism.actuated]
    known = scene_units(mechanism)
    each = [unit_of(f"{kind}{k + 1}", known) for k in joints]
    return [*each, *[""] * count][:count]


def joint_values(
    mechanism: Mechanism,
    text: str,
    kind: str,
    flag: str,
    check: Callable[[int], None] = lambda _: None,
) -> list[float]:
    """The q, qd, qdd or tau (`kind`) that an option's text has of joints, by their units.

    They are of all joints, of the actuated ones or the first of these; `check` may refuse a number
    of them, before their units are looked at.
    """

    def units(count: int) -> list[str]:
        check(count)
        return joint_units(mechanism, count, kind)

    try:
        return parse_vector(text, where=flag, unit=units)
    except InputError as error:
        if mechanism.slides and error.what != flag:  # an entry is wrong, perhaps by its unit
            sliding = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in mechanism.slides)
            error.limit = f"{error.limit}; {sliding} slides"
        raise


def vector_of_joints(mechanism: Mechanism, text: str, kind: str, flag: str) -> list[float]:
    """The same of all joints, or of the actuated ones; InputError for another number of them."""
    n, actuated = mechanism.n, len(mechanism.actuated)

    def check(given: int) -> None:
        if given in (n, actuated):
            return
        wanted = f"{n} values, one a joint ({', '.join(mechanism.link_names)})"
        if 0 < actuated < n:
            names = ", ".join(mechanism.link_names[k] for k in mechanism.actuated)
            wanted += f", or {actuated} ({names})"
        count = "1 value" if given == 1 else f"{given} values"
        raise InputError(flag, value=f"{shown(text)} ({count})", limit=f"needs {wanted}")

    return joint_values(mechanism, text, kind, flag, check)
