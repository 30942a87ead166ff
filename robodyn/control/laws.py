"""Controllers that make the actuated joints track a reference motion.

With e = q_ref - q and ed = qd_ref - qd of the actuated joints (angles from turn to turn), and Kp,
Kd diagonal:

    pd                  tau = Kp e + Kd ed
    pd+g                tau = Kp e + Kd ed + G(q)
    pid                 tau = Kp e + Kd ed + Ki z
    computed-torque     tau = inverse dynamics of (q, qd, v),     v = qdd_ref + Kd ed + Kp e

G (the torques that hold a mechanism at rest) and the inverse dynamics are those of the model that
the controller believes; it is asked at the angles and rates that the mechanism has.  If they are
the mechanism's own, computed torque leaves edd + Kd ed + Kp e = 0 for each joint.  Torques beyond
tau_max are cut off; what speeds a motor up falls to nothing over the last part of its speed_max,

    tau (rate_max - |qd|)/(FADE rate_max),     between 0 and tau, where tau qd > 0.

pd+g may have Ki z as well.  The integral z is 0 at the start, and

    zd = e + (tau - tau') / Kp,     tau' the torque of the law before it is cut off:

while a torque is cut off, Ki z goes to what the limit leaves for it, with the time constant Kp/Ki
(back-calculation: Astrom, Murray, "Feedback Systems", 2008, 10.4).  zd is continuous.

The law state-feedback keeps to a pose (`state_feedback.py`).

A law acts continuously, or is sampled: at times k/rate the torque is computed from the state that
the run has reached, and held until the next; z grows by zd/rate from sample to sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn.control.controlled_run import Continuous, Law, Pieces, Sampled
from robodyn.control.driven_torques import driving_torques, rest_torques, torque_slopes
from robodyn.control.law_slopes import slopes_of
from robodyn.control.state_feedback import StateFeedback
from robodyn.control.tracking import ReferenceTable
from robodyn.engines.straightline import define
from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation, for_each_actuated
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.motors import rate_limits, torque_limits

LAWS = {  # what each needs, and what it takes besides
    "pd": (("kp", "kd"), ("control_model",)),
    "pd+g": (("kp", "kd"), ("ki", "control_model")),
    "computed-torque": (("kp", "kd"), ("control_model",)),
    "pid": (("kp", "kd", "ki"), ("control_model",)),
    "state-feedback": (("gain",), ()),
}
FADE = 0.05  # part of its greatest speed over which a motor's torque falls to nothing
MOST_SAMPLES = 1_000_000  # of a run: their times and torques are kept


def controller(
    mechanism: Mechanism,
    reference: ReferenceTable,
    control: str,
    kp: float | Sequence[float] | None = None,
    kd: float | Sequence[float] | None = None,
    tau_max: float | Sequence[float] | None = None,
    control_rate: float | None = None,
    control_model: Mechanism | None = None,
    ki: float | Sequence[float] | None = None,
    gain: StateFeedback | None = None,
) -> Actuation:
    """What `simulate` takes as tau so that the actuated joints track a reference.

    The reference is that of the actuated joints, or of all; state-feedback, which has a `gain` in
    place of kp and kd, takes from it the errors that are told.  control: one of `LAWS`.  kp, kd, ki
    (>= 0): one value or one an actuated joint; N m/rad, N m s/rad and N m/(rad s), of computed
    torque 1/s^2 and 1/s.  tau_max, N m: the same, or None; motors limit torques too.  control_rate:
    samples a second, or None where the law acts continuously.  control_model: the one in the law;
    None: the mechanism itself.
    Raises InputError for arguments that do not fit, RobodynError where the law needs torques of a
    closed mechanism that has fewer actuators than freedoms.
    """
    if control not in LAWS:
        raise InputError("control", value=control, limit=f"must be of {', '.join(LAWS)}")
    needed, others = LAWS[control]
    given = {"kp": kp, "kd": kd, "ki": ki}
    for name, value in (given | {"gain": gain, "control_model": control_model}).items():
        if value is None and name in needed:
            raise InputError(name, limit=f"missing: --control {control} needs it")
        if value is not None and name not in (*needed, *others):
            raise InputError(name, limit=f"is not for --control {control}")
    joints, rate = len(mechanism.actuated), control_rate
    if not joints:
        raise InputError("control", where=mechanism.source, limit="no joint is actuated")
    if reference.joints == mechanism.n != joints:
        reference = reference.of(mechanism.actuated)
    if reference.joints != joints:
        limit = f"has {reference.joints} joints, the mechanism has {joints} actuated ones"
        raise InputError("columns", where=reference.where, limit=limit)
    model = mechanism if control_model is None else _agreeing(control_model, mechanism)
    limits = torque_limits(mechanism)
    if tau_max is not None:
        most = _values(mechanism, "tau_max", tau_max, math.ulp(0.0))
        limits = [min(pair) for pair in zip(limits, most, strict=True)]
    if rate is not None and not 0.0 < rate < math.inf:
        raise InputError("control_rate", value=f"{rate:g}", limit="must be > 0 and finite")
    pieces = Pieces(reference)
    gains = {x: _values(mechanism, x, each, 0.0) for x, each in given.items() if each is not None}
    if gain is not None:
        lines, scope = _feedback(mechanism, gain)
    else:
        lines, scope = _tracking(mechanism, model, reference, pieces, control, gains)
    torques = _compile_law(mechanism, lines, scope, limits, gains)
    states = joints if "ki" in gains else 0

    def with_slopes(more: Mapping[str, object]) -> Law:
        return _compile_law(mechanism, lines, {**scope, **more}, limits, gains)

    fades = min(rate_limits(mechanism)) < math.inf
    asked_of = torque_slopes(model, control == "pd+g") if "model" in scope else None
    slopes = slopes_of(with_slopes, limits, fades, scope.get("model"), asked_of)
    n, end = mechanism.n, reference.times[-1]
    targets = "".join(f"tau{k}, " for k in mechanism.actuated)
    zeros = [f"tau{k} = 0.0" for k in mechanism.passive]
    span = (reference.where, reference.times[0], end)
    if rate is not None:
        samples = end * rate
        if samples > MOST_SAMPLES:
            limit = f"makes {samples:.6g} samples, too many: at most {MOST_SAMPLES}"
            raise InputError("control_rate", value=f"{rate:g}", limit=limit)
        kinks = tuple(k / rate for k in range(max(0, math.floor(samples)) + 2))
        held = Sampled(mechanism, reference, torques, states, rate)
        held.slopes = slopes
        code = (f"{targets}= _held(t)", *zeros)
        return Actuation(None, code, {"_held": held.at}, kinks, True, span, held)
    state = ", ".join(_each("q", n) + _each("qd", n) + _each("z", states))
    targets += "".join(f"zd{j}, " for j in range(states))
    code = (f"{targets}= _control(t, {state})", *zeros)
    jumps = reference.stops or (control == "computed-torque" and reference.jumps)
    kinks = tuple(reference.times if jumps else reference.kinks)
    acting = Continuous(mechanism, reference, torques, states, pieces, jumps)
    acting.slopes = slopes
    asked = {"_control": torques}
    return Actuation(None, code, asked, kinks, False, span, acting, states=states)


def _each(name: str, count: int) -> list[str]:
    return [f"{name}{k}" for k in range(count)]


def _agreeing(believed: Mechanism, mechanism: Mechanism) -> Mechanism:
    facts = [(f"{x.n} joints", f"actuates {_joints(x)}") for x in (believed, mechanism)]
    for here, there in zip(*facts, strict=True):
        if here != there:
            limit = f"{here}, but {there} in {mechanism.source}: they must be the same"
            raise InputError("control_model", value=believed.source, limit=limit)
    return believed


def _joints(mechanism: Mechanism) -> str:
    return ", ".join(f"q{k + 1}" for k in mechanism.actuated) or "no joint"


def _values(
    mechanism: Mechanism, name: str, given: float | Sequence[float], least: float
) -> list[float]:
    """One value an actuated joint, each at least `least`."""
    values = for_each_actuated(mechanism, given, name)
    for value in values:
        if not least <= value < math.inf:
            limit = "must be > 0 and finite" if least else "must be >= 0 and finite"
            raise InputError(name, value=f"{value:g}", limit=limit)
    return values


def _tracking(
    mechanism: Mechanism,
    model: Mechanism,
    reference: ReferenceTable,
    pieces: Pieces,
    law: str,
    gains: Mapping[str, Sequence[float]],
) -> tuple[list[str], dict[str, Any]]:
    """Lines that make the errors e0.. and the torques u0.. of the actuated joints, and their scope.

    They ask t, q0.., qd0.. and, of a law with an integral, z0...
    """
    n, joints, degree = mechanism.n, reference.joints, reference.coefficients.shape[-1] - 1
    q, qd = _each("q", n), _each("qd", n)
    names = [f"c{j}_{d}" for j in range(joints) for d in range(degree + 1)]
    lines = ["k = piece(t)", "x = t - times[k]", f"{', '.join(names)}, = coefficients[k]"]
    for j, k in enumerate(mechanism.actuated):
        powers = [f"c{j}_{d}" for d in range(degree + 1)]
        rates = [f"{float(d)!r}*{power}" for d, power in enumerate(powers)][1:]
        turns = [f"{float(d * (d - 1))!r}*{power}" for d, power in enumerate(powers)][2:]
        lines.append(f"e{j} = {_horner(powers)} - q{k}")
        asked = f"{gains['kp'][j]!r}*e{j} + {gains['kd'][j]!r}*({_horner(rates)} - qd{k})"
        if law == "computed-torque":
            asked = f"{_horner(turns)} + {asked}"
        if "ki" in gains:
            asked += f" + {gains['ki'][j]!r}*z{j}"
        lines.append(f"u{j} = {asked}")
    torques = _each("u", joints)
    scope: dict[str, Any] = {
        "piece": pieces.at,
        "times": reference.times,
        "coefficients": [
            tuple(row) for row in reference.coefficients.reshape(-1, len(names)).tolist()
        ],
    }
    if law == "computed-torque":
        scope["model"] = driving_torques(model)
        lines.append(f"{', '.join(torques)}, = model({', '.join([*q, *qd, *torques])})")
    elif law == "pd+g":
        scope["model"] = rest_torques(model)
        lines.append(f"{', '.join(_each('g', joints))}, = model({', '.join(q)})")
        lines += [f"u{j} += g{j}" for j in range(joints)]
    return lines, scope


def _feedback(mechanism: Mechanism, given: StateFeedback) -> tuple[list[str], dict[str, Any]]:
    """The same of state-feedback."""
    lines: list[str] = []
    state: list[str] = []
    for i, k in enumerate(given.coordinates):
        away = f"q{k} - {float(given.q[k])!r}"
        lines.append(f"d{i} = {away if k in mechanism.slides else f'remainder({away}, tau)'}")
        state.append(f"d{i}")
    state += [f"qd{k}" for k in given.coordinates]
    for j, (tau, row) in enumerate(zip(given.tau, given.gain, strict=True)):
        terms = "".join(f" - {float(K)!r}*{x}" for K, x in zip(row, state, strict=True))
        lines.append(f"u{j} = {float(tau)!r}{terms}")
    return lines, {"remainder": math.remainder, "tau": math.tau}


def _compile_law(
    mechanism: Mechanism,
    lines: Sequence[str],
    scope: dict[str, Any],
    limits: Sequence[float],
    gains: Mapping[str, Sequence[float]],
) -> Law:
    """The law as code: torques of the actuated joints from t, q0.., qd0.. (floats).

    The lines make the torques u0.. before they are cut off.  With gains ki of the integrals z0..
    these are asked as well, and their rates follow the torques.  Raises InputError for a kp of zero
    where the integral may have to go back.
    """
    n, code, rates = mechanism.n, [*lines], []
    fastest = rate_limits(mechanism)
    for j, (k, most) in enumerate(zip(mechanism.actuated, limits, strict=True)):
        grows, cut = f"e{j}", min(most, fastest[j]) < math.inf
        if cut:
            code.append(f"w{j} = u{j}")
        if most < math.inf:
            low, high = (f"{x!r} if w{j} {sign} {x!r}" for x, sign in ((-most, "<"), (most, ">")))
            code.append(f"u{j} = {high} else {low} else w{j}")
        if fastest[j] < math.inf:
            left = f"({fastest[j]!r} - abs(qd{k}))/{FADE * fastest[j]!r}"
            code.append(f"if u{j}*qd{k} > 0.0: u{j} *= max(0.0, min(1.0, {left}))")
        if "ki" not in gains:
            continue
        if not gains["ki"][j]:
            grows = "0.0"
        elif cut:
            if not gains["kp"][j]:
                limit = "must be > 0 where ki is: the integral of a torque cut off goes by 1/kp"
                raise InputError("kp", value="0", limit=limit)
            grows += f" + (u{j} - w{j})/{gains['kp'][j]!r}"
        rates.append(grows)
    values = ", ".join([*_each("u", len(limits)), *rates])
    names = ", ".join(["t", *_each("q", n), *_each("qd", n), *_each("z", len(rates))])
    body = "\n    ".join([*code, f"return {values},"])
    function: Law = define(f"def control({names}):\n    {body}\n", "control", scope=scope)
    return function


def _horner(coefficients: Sequence[str]) -> str:
    """The polynomial in x with these coefficients, from the constant on."""
    code = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        code = f"({coefficient} + x*{code})"
    return code
