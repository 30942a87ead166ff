"""What derivatives cost, in one process: of qdd beside one evaluation, of motions beside a run."""

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


# scene, actuated joints and rates, time, names, method and engine
RUNS: list[tuple[Any, ...]] = [
    ("2r", [0.5, 0.8], [0.3, -0.4], 2.0, ["q1"], "taylor", "python"),
    ("2r", [0.5, 0.8], [0.3, -0.4], 0.3, ["links.forearm.m"], "taylor", "python"),
    ("pendulum", [0.5], [0.0], 0.3, ["links.rod.m"], "taylor", "python"),
    ("four-bar", [1.0], [2.0], 0.3, ["links.coupler.m"], "taylor", "python"),
    ("watt-six-bar", [1.0], [2.0], 0.6, ["q1"], "taylor", "python"),
    ("pendulum", [0.5], [0.0], 0.3, ["links.rod.m"], "taylor", "compiled"),
    ("2r", [0.5, 0.8], [0.3, -0.4], 0.2, ["links.forearm.m"], "taylor", "compiled"),
    ("2r", [0.5, 0.8], [0.3, -0.4], 20.0, ["links.forearm.m", "q1"], "taylor", "compiled"),
    ("four-bar", [1.0], [2.0], 1.0, ["links.coupler.m"], "taylor", "compiled"),
    ("2r", [0.5, 0.8], [0.3, -0.4], 2.0, ["q1"], "DOP853", "auto"),
]
RUN_BOUND = 2.0  # runs a number


def sensitivities(bench: Any) -> list[Any]:
    """What a run costs more with the derivatives of its motion, beside as many runs as numbers."""
    from bench import ROOT, compared, in_turn

    rows = []
    for name, driven, rates, end, names, method, engine in RUNS:
        mechanism = load(ROOT / f"robots/{name}.yaml")
        q = robodyn.assemble(mechanism, driven)
        qd = robodyn.loop_velocities(mechanism, q, rates)

        def run(
            by: Any = (), given: Any = (mechanism, q, qd, end), ways: Any = (method, engine)
        ) -> object:
            way = dict(zip(("method", "engine"), ways, strict=True))
            return robodyn.simulate(*given, sensitivity=by, **way)

        times = in_turn(lambda run=run, names=names: run(names), run, 20 * bench.repeats)
        more = [(max(x - y, 0.0), len(names) * y) for x, y in times]
        what = f"d(motion)/d({', '.join(names)}), {name}, {end:g} s, {method} {engine}"
        rows.append(compared(what, more, 1, "runs", bound=RUN_BOUND))
    return rows
