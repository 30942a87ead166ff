"""Controllers that make the actuated joints track a reference motion.

With e = q_ref - q and ed = qd_ref - qd of the actuated joints (angles from turn to turn), and Kp,
Kd diagonal:

    pd                  tau = Kp e + Kd ed
    pd+g                tau = Kp e + Kd ed + G(q)
    computed-torque     tau = inverse dynamics of (q, qd, v),     v = qdd_ref + Kd ed + Kp e

G (the torques that hold a mechanism at rest) and the inverse dynamics are those of the model that
the controller believes; it is asked at the angles and rates that the mechanism has.  If they are
the mechanism's own, computed torque leaves edd + Kd ed + Kp e = 0 for each joint.  Torques beyond
tau_max are cut off.

A law acts continuously, or is sampled: at times k/rate the torque is computed from the state that
the run has reached, and held until the next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from robodyn.control.controlled_run import Continuous, Law, Pieces, Sampled
from robodyn.control.driven_torques import driving_torques, rest_torques
from robodyn.control.tracking import ReferenceTable
from robodyn.engines.straightline import define
from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.motors import torque_limits
from robodyn.mechanics.per_joint import for_each_actuated

LAWS = ("pd", "pd+g", "computed-torque")
MOST_SAMPLES = 1_000_000  # of a run: their times and torques are kept


def controller(
    mechanism: Mechanism,
    reference: ReferenceTable,
    control: str,
    kp: float | Sequence[float],
    kd: float | Sequence[float],
    tau_max: float | Sequence[float] | None = None,
    control_rate: float | None = None,
    control_model: Mechanism | None = None,
) -> Actuation:
    """What `simulate` takes as tau so that the actuated joints track a reference.

    The reference is that of the actuated joints, or of all.  control: pd, pd+g or computed-torque.
    kp, kd (>= 0): one value or one an actuated joint; N m/rad and N m s/rad, of computed torque
    1/s^2 and 1/s.  tau_max, N m: the same, or None; motors limit torques too.  control_rate:
    samples a second, or None where the law acts continuously.  control_model: the one in the law;
    None: the mechanism itself.
    Raises InputError for arguments that do not fit, RobodynError where the law needs torques of a
    closed mechanism that has fewer actuators than freedoms.
    """
    if control not in LAWS:
        raise InputError("control", value=control, limit=f"must be of {', '.join(LAWS)}")
    joints, rate = len(mechanism.actuated), control_rate
    if not joints:
        raise InputError("control", where=mechanism.source, limit="no joint is actuated")
    if reference.joints == mechanism.n != joints:
        reference = reference.of(mechanism.actuated)
    if reference.joints != joints:
        limit = f"has {reference.joints} joints, the mechanism has {joints} actuated ones"
        raise InputError("columns", where=reference.where, limit=limit)
    model = mechanism if control_model is None else _agreeing(control_model, mechanism)
    gains = [_values(mechanism, name, x, 0.0) for name, x in (("kp", kp), ("kd", kd))]
    limits = torque_limits(mechanism)
    if tau_max is not None:
        given = _values(mechanism, "tau_max", tau_max, math.ulp(0.0))
        limits = [min(pair) for pair in zip(limits, given, strict=True)]
    if rate is not None and not 0.0 < rate < math.inf:
        raise InputError("control_rate", value=f"{rate:g}", limit="must be > 0 and finite")
    pieces = Pieces(reference)
    torques = _compile_law(mechanism, model, reference, pieces, control, gains, limits)
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
        held = Sampled(mechanism, reference, torques, rate)
        lines = (f"{targets}= _held(t)", *zeros)
        return Actuation(None, lines, {"_held": held.at}, kinks, True, span, held)
    state = ", ".join(f"{name}{k}" for name in ("q", "qd") for k in range(n))
    lines = (f"{targets}= _control(t, {state})", *zeros)
    jumps = control == "computed-torque" and reference.jumps
    kinks = tuple(reference.times if jumps else reference.kinks)
    acting = Continuous(mechanism, reference, torques, pieces, jumps)
    return Actuation(None, lines, {"_control": torques}, kinks, False, span, acting)


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


def _compile_law(
    mechanism: Mechanism,
    model: Mechanism,
    reference: ReferenceTable,
    pieces: Pieces,
    law: str,
    gains: list[list[float]],
    limits: list[float],
) -> Law:
    """The law as code: torques of the actuated joints from t, q0.., qd0.. (floats)."""
    n, degree = mechanism.n, reference.coefficients.shape[-1] - 1
    q, qd = ([f"{name}{k}" for k in range(n)] for name in ("q", "qd"))
    names = [f"c{j}_{d}" for j in range(reference.joints) for d in range(degree + 1)]
    lines = ["k = piece(t)", "x = t - times[k]", f"{', '.join(names)}, = coefficients[k]"]
    asked = []
    for j, k in enumerate(mechanism.actuated):
        powers = [f"c{j}_{d}" for d in range(degree + 1)]
        rates = [f"{float(d)!r}*{power}" for d, power in enumerate(powers)][1:]
        turns = [f"{float(d * (d - 1))!r}*{power}" for d, power in enumerate(powers)][2:]
        error = f"{gains[0][j]!r}*({_horner(powers)} - q{k})"
        feedback = f"{error} + {gains[1][j]!r}*({_horner(rates)} - qd{k})"
        asked.append(f"{_horner(turns)} + {feedback}" if law == "computed-torque" else feedback)
    lines += [f"u{j} = {code}" for j, code in enumerate(asked)]
    torques = [f"u{j}" for j in range(len(asked))]
    scope: dict[str, object] = {
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
        rest = [f"g{j}" for j in range(len(asked))]
        lines.append(f"{', '.join(rest)}, = model({', '.join(q)})")
        lines += [f"u{j} += g{j}" for j in range(len(asked))]
    lines += [
        f"u{j} = {most!r} if u{j} > {most!r} else {-most!r} if u{j} < {-most!r} else u{j}"
        for j, most in enumerate(limits)
        if most < math.inf
    ]
    body = "\n    ".join([*lines, f"return {', '.join(torques)},"])
    source = f"def control(t, {', '.join([*q, *qd])}):\n    {body}\n"
    function: Law = define(source, "control", scope=scope)
    return function


def _horner(coefficients: Sequence[str]) -> str:
    """The polynomial in x with these coefficients, from the constant on."""
    code = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        code = f"({coefficient} + x*{code})"
    return code
