"""What derivatives of qdd cost beside one evaluation, in one process."""

from __future__ import annotations

from typing import Any

import numpy as np

import robodyn
from robodyn.mechanics.mechanism import load

FEW, MANY = 2_000, 20_000  # states, of which the results of a few stay near the processor
CASES = [("2r", FEW, 5.0), ("four-bar", FEW, 8.0), ("watt-six-bar", FEW, 8.0)]
CASES += [("watt-six-bar", MANY, 8.0)]


def derivatives(bench: Any) -> list[Any]:
    """Of many states at once, by numpy or machine code as both choose themselves."""
    from bench import ROOT, compared, in_turn

    rows = []
    for name, count, bound in CASES:
        mechanism = load(ROOT / f"robots/{name}.yaml")
        rng = np.random.default_rng(1)
        given = rng.normal(size=(2, count, len(mechanism.actuated)))
        q = given[0] if not mechanism.rows else robodyn.assemble(mechanism, given[0])
        qd = given[1] if not mechanism.rows else robodyn.loop_velocities(mechanism, q, given[1])
        tau = np.zeros_like(q)

        def all_of_them(state: tuple[Any, ...] = (mechanism, q, qd, tau)) -> object:
            return robodyn.forward_dynamics_derivatives(*state)

        def one(state: tuple[Any, ...] = (mechanism, q, qd, tau)) -> object:
            return robodyn.forward_dynamics(*state)

        for _ in range(600 * FEW // count):  # until both have the code that they choose
            all_of_them()
            one()
        times = in_turn(all_of_them, one, bench.repeats)
        what = f"derivatives of qdd, {name}" + (f", {count} states" if count != FEW else "")
        rows.append(compared(what, times, count, "qdd", bound=bound))
    return rows
