"""Vectors of joints: of all joints, or of the actuated ones, and the rest that follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.columns import scene_units, unit_of
from robodyn.errors import InputError, SingularError, overflow
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.placed import STATE, finite, numbers
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


def vector(mechanism: Mechanism, name: str, values: ArrayLike) -> tuple[Array, bool]:
    """The floats of q, qd, qdd or tau, and whether they are of all joints.

    Else they are of those of `driver_of`.  A vector of another `name` is one of angles q.  Raises
    InputError for another width.
    """
    each, n = numbers(name, values), mechanism.n
    width = each.shape[-1] if each.ndim else None
    if width == n:
        return each, True
    few = driver_of(mechanism, name if name in STATE else "q").actuated
    if width != len(few):
        limit = f"must have {n} values along the last axis, one a joint"
        if 0 < len(few) < n:
            limit += f", or {len(few)} ({', '.join(mechanism.link_names[k] for k in few)})"
        raise InputError(f"{name}.shape", value=each.shape, limit=limit)
    return each, False


def vectors(mechanism: Mechanism, **given: ArrayLike | None) -> dict[str, tuple[Array, bool]]:
    """The vectors that are given, as `full` takes them; InputError if a value is not finite."""
    pairs = {k: vector(mechanism, k, x) for k, x in given.items() if x is not None}
    return {name: (finite(name, values), whole) for name, (values, whole) in pairs.items()}


def full(
    mechanism: Mechanism,
    given: Mapping[str, tuple[Array, bool]],
    branches: Sequence[str] | None = None,
    places: Mapping[str, str] = MappingProxyType({}),
    *,
    t: ArrayLike,
    missing: Array | None = None,
) -> dict[str, Array]:
    """Return q, qd and what else is given for all joints (..., n), in this order, at times t (...).

    `given` has the values of each, and whether they are of all joints; else they are of those of
    `driver_of`, and the rest is assembled, in these branches, and follows.  Torques of other joints
    are zero.  Raises InputError if values of all joints do not close the loops, with the place of
    the first of q, qd, qdd that does not; RobodynError if a result is not finite.

    With zeros `missing` (T,), states need not close: it takes by how much each stays open, m, nan
    if its configuration is singular.  Such states (T, n) have any values.
    """
    if not mechanism.rows and all(whole for _, whole in given.values()):
        return {name: values for name, (values, _) in given.items()}
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

    def follow(rates: Callable[..., Array], *known: Array) -> Array:
        if missing is None:
            return rates(driver, *known, t)
        found, times = np.zeros((len(missing), mechanism.n)), np.broadcast_to(t, missing.shape)
        closed = np.flatnonzero(missing == 0.0)
        columns = [x[closed] for x in (*known, times)]
        found[closed], regular = each_regular(
            lambda k: rates(driver, *(x[k] for x in columns)), (len(closed), mechanism.n)
        )
        missing[closed[~regular]] = np.nan
        return found

    unchecked = bool(mechanism.rows) and any(whole for _, whole in given.values())
    with np.errstate(all="ignore"):
        for name, (values, whole) in given.items():
            every = values
            if whole or (free and name != "tau"):
                pass
            elif name == "q" and missing is not None:
                every, short = assembly.attempt(driver, values, branches, t=t)
                lost = np.where(np.isfinite(every).all(axis=-1), 0.0, np.inf)
                missing[:] = np.where(short <= 0.0, lost, short)
                every[missing != 0.0] = 0.0
            elif name == "q":
                every = assembly.assemble(driver, values, branches, t=t)
            elif name == "qd":
                every = follow(loop_rates.loop_velocities, motion["q"], values)
            elif name == "qdd":
                if unchecked:
                    check()
                    unchecked = False
                every = follow(loop_rates.loop_accelerations, motion["q"], motion["qd"], values)
            else:
                every = np.zeros((*values.shape[:-1], mechanism.n))
                every[..., list(mechanism.actuated)] = values
            if missing is None and not np.isfinite(every).all():
                raise overflow()
            motion[name] = every
            if name == "q" and whole and mechanism.driven:  # a law is told before rates are sought
                check()
        if unchecked:
            check()
    return motion


def each_regular(
    compute: Callable[[slice], Array], shape: tuple[int, int]
) -> tuple[Array, NDArray[np.bool_]]:
    """Rows (T, k), computed at once or, if one is singular, one by one; and which are regular."""
    regular = np.ones(shape[0], bool)
    try:
        return compute(slice(None)), regular
    except SingularError:
        found = np.zeros(shape)
        for k in range(len(found)):
            try:
                found[k] = compute(slice(k, k + 1))[0]
            except SingularError:
                regular[k] = False
        return found, regular


def reclosed(mechanism: Mechanism, q: Array, qd: Array, *, t: float) -> tuple[Array, Array]:
    """q and qd (n,) of a start near these, which closes at t with the independent joints as given.

    InputError if the loops do not close there.
    """
    from robodyn.loops.assembly import close_positions
    from robodyn.loops.loop_rates import check_closed, loop_velocities

    driver = driver_of(mechanism)
    held = list(driver.actuated)
    q = close_positions(mechanism, q, held, t=t)
    if fault := check_closed(mechanism, q, t=t):
        raise fault[1]
    return q, loop_velocities(driver, q, qd[held], t)
