"""The units of the columns that commands write and read, by their names."""

from __future__ import annotations

import re

_COLUMNS = {
    "s": "t flip flip_time",
    "rad": "q e",
    "rad/s": "qd",
    "rad/s²": "qdd",
    "N m": "tau tc shake_m",
    "N": "fx fy rx ry shake_fx shake_fy",
    "J": "KE PE energy",
    "m": "gap joint_x joint_y tip_x tip_y centre_x centre_y",
    "m/s": "joint_vx joint_vy tip_vx tip_vy centre_vx centre_vy",
}
UNITS = {name: unit for unit, names in _COLUMNS.items() for name in names.split()}


def quantity_of(name: str) -> str:
    """A column's name less the number of its link or closure: `q` of `q1`."""
    return name.rstrip("0123456789") or name


def unit_of(name: str) -> str:
    """The unit of a column, also of its end, least or largest value; "" where none is known."""
    return UNITS.get(quantity_of(re.sub("_(end|min|max)$", "", name)), "")


def with_unit(name: str) -> str:
    """A column's name with its unit, `tau1 [N m]`."""
    unit = unit_of(name)
    return f"{name} [{unit}]" if unit else name
