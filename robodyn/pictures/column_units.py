"""The units of the columns that commands write and read, by their names.

A joint that slides has m and N where others have rad and N m; only who has the scene knows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from robodyn.errors import InputError
from robodyn.scene.quantities import parse_vector
from robodyn.tables.csv_fields import IN_DEGREES as IN_DEGREES
from robodyn.tables.csv_fields import shown

if TYPE_CHECKING:
    from robodyn.mechanics.mechanism import Mechanism

_COLUMNS = {
    "s": "t flip flip_time",
    "rad": "q e angle transmission",
    "rad/s": "qd motor_speed w mean_speed",
    "rad/s²": "qdd wd",
    "N m": "tau tc rm mz shake_m motor mean_torque residual",
    "N": "fx fy rx ry shake_fx shake_fy",
    "J": "KE PE energy energy_fluctuation",
    "V": "volt",
    "A": "amp",
    "W": "watt power",
    "kg m²": "flywheel",
    "m": "x y gap joint_x joint_y tip_x tip_y centre_x centre_y",
    "m/s": "joint_vx joint_vy tip_vx tip_vy centre_vx centre_vy",
}
UNITS = {name: unit for unit, names in _COLUMNS.items() for name in names.split()}
# columns without a number at the end of their name; without one, another name is a user's own
_WHOLE = "t flip flip_time mean_speed mean_torque shake_fx shake_fy shake_m KE PE energy "
_WHOLE += "energy_fluctuation flywheel gap"
WHOLE = frozenset(_WHOLE.split())
_OF_POINT = "_([va]?[xy]|J[xy][0-9]+)$"
# by the letter after the name of a point
POINTS = {"x": "m", "y": "m", "v": "m/s", "a": "m/s²", "J": "m/rad"}
ANGULAR = ("q", "e", "qd", "qdd", "tau", "residual")  # of joints
SLIDING = {"rad": "m", "rad/s": "m/s", "rad/s²": "m/s²", "N m": "N", "N m s/rad": "N s/m"}
DEGREES = {"rad": "°", "rad/s": "°/s", "rad/s²": "°/s²"}
TURNING: Mapping[str, str] = {}  # the units of columns of joints that turn need not be told
# where no scene tells which joints slide: 0 stands for any joint
ANY_SCENE = {f"{x}0": f"{UNITS[x]} or {SLIDING[UNITS[x]]}" for x in (*ANGULAR, "tc")}
OF_PARTS = {x: UNITS[x] for x in (*ANGULAR, "angle")}  # keys of results with parts


def quantity_of(name: str) -> str:
    """A column's name less the number of its link or closure: `q` of `q1` and of `q1_deg`."""
    return name.removesuffix(IN_DEGREES).rstrip("0123456789") or name


def scene_units(mechanism: Mechanism) -> Mapping[str, str]:
    """The units of the columns that belong to joints which slide."""
    slides = mechanism.slides
    units = {f"{x}{k + 1}": SLIDING[UNITS[x]] for x in ANGULAR for k in slides}
    couplings = mechanism.description.couplings
    return units | {f"tc{c + 1}": "N" for c, x in enumerate(couplings) if x.joint in slides}


def unit_of(name: str, units: Mapping[str, str] = TURNING) -> str:
    """The unit of a column, also of its end, least or largest value; "" where none is known.

    `units` are those of the scene, or `ANY_SCENE`, by which q1 is in `rad or m`.
    """
    if known := _unit_by_name(name, units):
        return known
    name = re.sub(r"^[a-z]+\((.*)\)$", r"\1", name)  # max(q1)
    if name.endswith(IN_DEGREES):  # no displacement is
        own = TURNING if units is ANY_SCENE else units
        return DEGREES.get(unit_of(name.removesuffix(IN_DEGREES), own), "")
    column = re.sub("^(min|max)_(?=t$|q1$)|_(end|min|max|residual)$", "", name)
    of_point = re.search(_OF_POINT, column)
    return _unit_by_name(column, units) or (POINTS[of_point[1][0]] if of_point else "")


def _unit_by_name(name: str, units: Mapping[str, str]) -> str:
    """The unit of a name as it is, "" if no column of robodyn's has it."""
    quantity = quantity_of(name)
    if name in units or name.endswith(IN_DEGREES) or (name == quantity) != (quantity in WHOLE):
        return units.get(name, "")
    return units.get(f"{quantity}0") or UNITS.get(quantity, "")


def check_degrees(names: Iterable[str], units: Mapping[str, str]) -> None:
    """Raise InputError where --degrees would take what may be a displacement for an angle."""
    for name in names:
        turning, _, sliding = unit_of(name, units).partition(" or ")
        if turning in DEGREES and sliding:
            limit = f"may be in {turning} or in {sliding}: --model MODEL tells whether joints slide"
            raise InputError("--degrees", value=shown(name), limit=limit)


def in_degrees(name: str, units: Mapping[str, str] = TURNING) -> tuple[str, float]:
    """A column's name where angles are told in degrees, and what its values are times those."""
    if unit_of(name, units) not in DEGREES:
        return name, 1.0
    inner = name.removesuffix(")") if "(" in name else name
    return inner + IN_DEGREES + name[len(inner) :], 180.0 / math.pi


def structure_in_degrees(content: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    """A result with parts: values of angles in degrees, of `q` one by one as of q1, q2, ..."""
    units = {**OF_PARTS, **units}

    def told(value: Any, name: str) -> Any:
        match value:
            case float():
                return in_degrees(name, units)[1] * value
            case Mapping():
                return structure_in_degrees(value, units)
            case list() | tuple():
                return [told(x, f"{name}{k}") for k, x in enumerate(value, start=1)]
        return value

    of_numbers = (float, list, tuple)
    return {
        in_degrees(name, units)[0] if isinstance(x, of_numbers) else name: told(x, name)
        for name, x in content.items()
    }


def with_unit(name: str, units: Mapping[str, str] = TURNING) -> str:
    """A column's name with its unit, `tau1 [N m]`."""
    unit = unit_of(name, units)
    return f"{name} [{unit}]" if unit else name


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
