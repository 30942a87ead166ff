"""Voltages that drive motors, as torques of their joints.

With the ratio N, the torque constant kt and the resistance R

    tau = N kt (volt - kt N qd)/R
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from robodyn.errors import InputError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.planar_model import Mechanism
from robodyn.scene.syntax import Node


def voltages(
    mechanism: Mechanism,
    volt: str | Sequence[float] | Callable[[float, list[float], list[float]], Sequence[float]],
    where: str = "volt",
) -> Actuation:
    """Return what `simulate` takes as tau for motor voltages, one per actuated joint, V.

    They are constants, comma-separated expressions in t, q1.., qd1.., or a function of t, q (n), qd
    (n).  Raises InputError if an actuated joint has no motor with the needed constants, and the
    errors of torques given in this form.
    """
    links, driven, laws = mechanism.description.links, mechanism.actuated, []
    for k in driven:
        motor = links[k].motor
        if motor is None or not (motor.torque_constant and motor.resistance):
            limit = f"joint {links[k].name} needs a motor with torque_constant and resistance"
            raise InputError(where, where=mechanism.source, limit=limit)
        slope = motor.ratio * motor.torque_constant
        laws.append((slope / motor.resistance, slope))

    again = partial(voltages, volt=volt, where=where)
    if callable(volt):
        given = volt

        def torques(t: float, q: list[float], qd: list[float]) -> list[float]:
            volts = actuation.values_given(given(t, q, qd), "volt(t, q, qd)")
            values = _as_many(mechanism, volts, where)
            each = zip(driven, laws, values, strict=True)
            return [a * (x - b * qd[k]) for k, (a, b), x in each]

        return replace(actuation.callback(mechanism, torques), remade=again)

    def driving(nodes: list[Node]) -> list[Node]:
        """Return expressions of torques from those of voltages."""
        each = zip(driven, laws, _as_many(mechanism, nodes, where), strict=True)
        return [("*", a, ("-", node, ("*", b, f"qd{k}"))) for k, (a, b), node in each]

    text = volt if isinstance(volt, str) else ", ".join(repr(float(x)) for x in volt)
    found = actuation.expressions(mechanism, text, where, driving, "V")
    return replace(found, remade=again)


def _as_many(mechanism: Mechanism, given: list[Any], where: str) -> list[Any]:
    """Return the voltages; InputError unless there is one for each actuated joint."""
    count = len(mechanism.actuated)
    if len(given) != count:
        joints = ", ".join(mechanism.link_names[k] for k in mechanism.actuated)
        limit = f"must have {count}, one an actuated joint ({joints})"
        raise InputError(where, value=f"{len(given)} voltages", limit=limit)
    return given
