"""Kinetic and potential energy of a scene at one state, from the rows of the program."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robodyn.engines.expression import Value
from robodyn.engines.formulas import RECORDED
from robodyn.engines.frames import absolute, start
from robodyn.engines.series import Series
from robodyn.mechanics.equations_of_motion import EquationsOfMotion
from robodyn.mechanics.planar_model import Mechanism

Number = Callable[[float], Value]  # what stands for a number of the scene


def energies(
    mechanism: Mechanism, number: Number, q: Sequence[Value], qd: Sequence[Value]
) -> tuple[Value, Value]:
    """KE and PE less the mechanism's constant, J, at q, qd (n)."""
    equations = EquationsOfMotion(mechanism)
    wanted = [equations.kinetic(), equations.potential()]
    state = start(RECORDED, (q, qd), (absolute(mechanism, q), absolute(mechanism, qd)))
    numbers = [number(x) for x in equations.program.numbers]
    series = Series(equations.program, RECORDED, numbers, 1, state, slots=wanted, grounded=True)
    series.residuals(0)
    KE, PE = (series.real[slot][0] for slot in wanted)
    return KE, PE
