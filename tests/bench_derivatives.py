"""What derivatives cost, in one process: of qdd beside one evaluation, of motions beside a run."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

import robodyn
from robodyn.control.state_feedback import StateFeedback
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


# scene, actuated joints and rates, time, names, method
RUNS: list[tuple[Any, ...]] = [
    ("pendulum", [0.5], [0.0], 0.3, ["links.rod.m"], "taylor"),
    ("2r", [0.5, 0.8], [0.3, -0.4], 0.2, ["links.forearm.m"], "taylor"),
    ("2r", [0.5, 0.8], [0.3, -0.4], 20.0, ["links.forearm.m", "q1"], "taylor"),
    ("four-bar", [1.0], [2.0], 1.0, ["links.coupler.m"], "taylor"),
    ("2r", [0.5, 0.8], [0.3, -0.4], 2.0, ["q1"], "DOP853"),
]
RUN_BOUND = 2.0  # runs a number
# laws and what they take of each scene, the pose that they keep to, and where the run begins
GAINS = [[40.0, 3.0, 8.0, 1.0], [2.0, 30.0, 1.0, 5.0]]
PD, SLOW = {"kp": [40, 20], "kd": [8, 4]}, {"kp": 60, "kd": 9}
LAWS: list[tuple[str, str, dict[str, Any]]] = [
    ("2r", "pd", PD),
    ("2r", "pid", {**PD, "ki": [60, 30]}),
    ("2r", "pd+g", PD),
    ("2r", "computed-torque", {"kp": 40, "kd": 8}),
    ("2r", "state-feedback", {"gain": StateFeedback((0, 1), [0.3, 0.6], [1.0, 0.5], GAINS)}),
    ("four-bar", "pd", SLOW),
    ("four-bar", "pid", {**SLOW, "ki": 20}),
    ("four-bar", "pd+g", SLOW),
    ("four-bar", "computed-torque", SLOW),
    ("four-bar", "state-feedback", {"gain": StateFeedback((0,), [1.4, 0, 0], [0.0], [[60, 9]])}),
]
STARTS: dict[str, tuple[Any, ...]] = {
    "2r": ([0.3, 0.6], [0.5, 0.8], [0.3, -0.4], "links.forearm.m"),
    "four-bar": ([1.4], [1.0], [2.0], "links.coupler.m"),
}
RATE, END = 50.0, 2.0  # samples a second, s


def sensitivities(bench: Any) -> list[Any]:
    """What a run costs more with the derivatives of its motion, beside as many runs as numbers."""
    from bench import ROOT

    rows = []
    for name, driven, rates, end, names, method in RUNS:
        mechanism = load(ROOT / f"robots/{name}.yaml")
        q = robodyn.assemble(mechanism, driven)
        qd = robodyn.loop_velocities(mechanism, q, rates)
        what = f"{name}, {end:g} s, {method}"
        given = (mechanism, q, qd, end, None, method)
        rows.append(_more(bench, what, names, given, 20))
    for name, control, gains in LAWS:
        mechanism = load(ROOT / f"robots/{name}.yaml")
        pose, driven, rates, number = STARTS[name]
        q = robodyn.assemble(mechanism, driven)
        qd = robodyn.loop_velocities(mechanism, q, rates)
        keep = robodyn.ReferenceTable.set_point(pose, END)
        law = partial(robodyn.controller, mechanism, keep, control, **gains)
        acting = [("DOP853", "", law())]
        acting += [(way, f" {RATE:g}/s", law(control_rate=RATE)) for way in ("DOP853", "taylor")]
        for method, shown, tau in acting:
            what = f"{name} {control}{shown}, {method}"
            given = (mechanism, q, qd, END, tau, method)
            rows.append(_more(bench, what, [number], given, 2))
    return rows


def _more(bench: Any, what: str, names: list[str], given: tuple[Any, ...], times: int) -> Any:
    from bench import compared, in_turn

    def run(by: Any = ()) -> object:
        return robodyn.simulate(*given, sensitivity=by)

    pairs = in_turn(lambda: run(names), run, times * bench.repeats, time.process_time)
    more = [(max(x - y, 0.0), len(names) * y) for x, y in pairs]
    return compared(f"d(motion)/d({', '.join(names)}), {what}", more, 1, "runs", bound=RUN_BOUND)
