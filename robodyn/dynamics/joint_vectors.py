"""Vectors of joints: of all joints, or of the actuated ones, and the rest that follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.columns import scene_units, unit_of
from robodyn.errors import InputError, overflow
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.quantities import parse_vector
from robodyn.tables.arrays import Array
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


def driver_of(mechanism: Mechanism, name: str = "q") -> Mechanism:
    """The mechanism whose actuated joints a vector of that name is of, if it is not of all joints.

    Those of q, qd and qdd determine the others: free passive joints are among them.
    """
    if name not in ("q", "qd", "qdd") or len(mechanism.actuated) == mechanism.n:
        return mechanism
    from robodyn.loops.assembly_plan import with_independent

    return with_independent(mechanism)


def full(
    mechanism: Mechanism,
    given: Mapping[str, tuple[Array, bool]],
    branches: Sequence[str] | None = None,
    places: Mapping[str, str] = MappingProxyType({}),
    *,
    t: ArrayLike,
) -> dict[str, Array]:
    """Return q, qd and what else is given for all joints (..., n), in this order, at times t (...).

    `given` has the values of each, and whether they are of all joints; else they are of those of
    `driver_of`, and the rest is assembled, in these branches, and follows.  Torques of other joints
    are zero.  Raises InputError if values of all joints do not close the loops, with the place of
    the first of q, qd, qdd that does not; RobodynError if a result is not finite.
    """
    driver = driver_of(mechanism)
    free = not mechanism.rows and len(driver.actuated) == mechanism.n  # a joint each
    if not free:
        from robodyn.loops import assembly, loop_rates
    motion: dict[str, Array] = {}

    def check() -> None:
        moving = [motion.get(name) for name in ("qd", "qdd")]
        if loop_rates.check_closed(mechanism, motion["q"], *moving, t=t) is None:
            return
        for count, name in enumerate(("q", "qd", "qdd")):
            fault = loop_rates.check_closed(mechanism, motion["q"], *moving[:count], t=t)
            if fault is not None:
                if place := places.get(name, places.get("q")):
                    fault[1].add_place(place)
                raise fault[1]

    unchecked = bool(mechanism.rows) and any(whole for _, whole in given.values())
    with np.errstate(all="ignore"):
        for name, (values, whole) in given.items():
            every = values
            if whole or (free and name != "tau"):
                pass
            elif name == "q":
                every = assembly.assemble(driver, values, branches, t=t)
            elif name == "qd":
                every = loop_rates.loop_velocities(driver, motion["q"], values, t)
            elif name == "qdd":
                if unchecked:
                    check()
                    unchecked = False
                every = loop_rates.loop_accelerations(driver, motion["q"], motion["qd"], values, t)
            else:
                every = np.zeros((*values.shape[:-1], mechanism.n))
                every[..., list(mechanism.actuated)] = values
            if not np.isfinite(every).all():
                raise overflow()
            motion[name] = every
            if name == "q" and whole and mechanism.driven:  # a law is told before rates are sought
                check()
        if unchecked:
            check()
    return motion
