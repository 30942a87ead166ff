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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from robodyn.control.controlled_run import Continuous, Sampled
from robodyn.control.driven_torques import driving_torques, rest_torques
from robodyn.control.recorded_law import RecordedLaw
from robodyn.control.state_feedback import StateFeedback
from robodyn.control.tracking import ReferenceTable
from robodyn.engines.expansion import horner
from robodyn.engines.expression import Value, choose, greatest, least
from robodyn.errors import InputError
from robodyn.mechanics.actuation import Actuation, for_each_actuated
from robodyn.mechanics.kinks import Pieces
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
    given = {"kp": kp, "kd": kd, "ki": ki}
    _check(control, given | {"gain": gain, "control_model": control_model}, control_rate)
    reference = _of_actuated(mechanism, reference)
    model = mechanism if control_model is None else _agreeing(control_model, mechanism)
    limits = torque_limits(mechanism)
    if tau_max is not None:
        most = _values(mechanism, "tau_max", tau_max, math.ulp(0.0))
        limits = [min(pair) for pair in zip(limits, most, strict=True)]
    pieces = Pieces(reference.times[1:-1])
    gains = {x: _values(mechanism, x, each, 0.0) for x, each in given.items() if each is not None}
    law = RecordedLaw(mechanism.n, reference.joints, reference.joints if "ki" in gains else 0)
    errors: list[Value] = []
    if gain is not None:
        wanted = _feedback(mechanism, gain, law)
    else:
        wanted, errors = _tracking(mechanism, model, reference, pieces, control, gains, law)
    law.outputs = _limited(mechanism, law, wanted, errors, limits, gains)
    again: Callable[[Mechanism], Actuation] = partial(
        controller,
        reference=reference,
        control=control,
        tau_max=tau_max,
        control_rate=control_rate,
        control_model=model if gain is None else None,
        kp=kp,
        kd=kd,
        ki=ki,
        gain=gain,
    )
    if control_rate is not None:
        return replace(_sampled(mechanism, reference, law, control_rate), remade=again)
    jumps = reference.stops or (control == "computed-torque" and reference.jumps)
    acting = Continuous(mechanism, reference, law, pieces, jumps)
    own = [f"zd{j}" for j in range(law.states)]
    call = f"_control({', '.join(['t', *law.inputs])})"
    kinks = tuple(reference.times if jumps else reference.kinks)
    made = _actuation(mechanism, acting, own, call, {"_control": acting.law}, kinks)
    return replace(made, remade=again)


def _sampled(
    mechanism: Mechanism, reference: ReferenceTable, law: RecordedLaw, rate: float
) -> Actuation:
    samples = reference.times[-1] * rate
    if samples > MOST_SAMPLES:
        limit = f"makes {samples:.6g} samples, too many: at most {MOST_SAMPLES}"
        raise InputError("control_rate", value=f"{rate:g}", limit=limit)
    held = Sampled(mechanism, reference, law, rate)
    kinks = tuple(k / rate for k in range(max(0, math.floor(samples)) + 2))
    return _actuation(mechanism, held, [], "_held(t)", {"_held": held.at}, kinks)


def _actuation(
    mechanism: Mechanism,
    law: Continuous | Sampled,
    own: Sequence[str],
    call: str,
    asked: Mapping[str, object],
    kinks: tuple[float, ...],
) -> Actuation:
    """Torques of the actuated joints, and rates of `own` states, by a call of what is `asked`."""
    targets = [*(f"tau{k}" for k in mechanism.actuated), *own]
    lines = (f"{', '.join(targets)}, = {call}", *(f"tau{k} = 0.0" for k in mechanism.passive))
    times = law.reference.times
    span = (law.reference.where, times[0], times[-1])
    held = isinstance(law, Sampled)
    return Actuation(None, lines, asked, kinks, held, span, law, states=len(own))


def _check(control: str, given: Mapping[str, object], rate: float | None) -> None:
    """Raise InputError for a law that is none, what it lacks, and what it does not take."""
    if control not in LAWS:
        raise InputError("control", value=control, limit=f"must be of {', '.join(LAWS)}")
    needed, others = LAWS[control]
    for name, value in given.items():
        if value is None and name in needed:
            raise InputError(name, limit=f"missing: --control {control} needs it")
        if value is not None and name not in (*needed, *others):
            raise InputError(name, limit=f"is not for --control {control}")
    if rate is not None and not 0.0 < rate < math.inf:
        raise InputError("control_rate", value=f"{rate:g}", limit="must be > 0 and finite")


def _of_actuated(mechanism: Mechanism, reference: ReferenceTable) -> ReferenceTable:
    """The reference of the actuated joints."""
    joints = len(mechanism.actuated)
    if not joints:
        raise InputError("control", where=mechanism.source, limit="no joint is actuated")
    if reference.joints == mechanism.n != joints:
        reference = reference.of(mechanism.actuated)
    if reference.joints != joints:
        limit = f"has {reference.joints} joints, the mechanism has {joints} actuated ones"
        raise InputError("columns", where=reference.where, limit=limit)
    return reference


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
    control: str,
    gains: Mapping[str, Sequence[float]],
    law: RecordedLaw,
) -> tuple[list[Value], list[Value]]:
    """The torques that a law wants of the actuated joints, and their errors."""
    n, joints, powers = mechanism.n, reference.joints, reference.coefficients.shape[-1]
    q, qd, z = (law.variables(name, n) for name in ("q", "qd", "z"))
    names = [f"c{j}_{d}" for j in range(joints) for d in range(powers)]
    law.lines = ["k = piece(t)", "x = t - times[k]", f"{', '.join(names)}, = coefficients[k]"]
    rows = reference.coefficients.reshape(-1, len(names)).tolist()
    law.scope = {"piece": pieces.piece, "times": reference.times, "coefficients": rows}
    errors: list[Value] = []
    wanted: list[Value] = []
    for j, k in enumerate(mechanism.actuated):
        c, x = law.variables(f"c{j}_", powers), law.graph.variable("x")
        place, rate = horner(c, x)
        errors.append(place - q[k])
        asked = gains["kp"][j] * errors[j] + gains["kd"][j] * (rate - qd[k])
        turns = [float(d * (d - 1)) * each for d, each in enumerate(c)][2:]
        if control == "computed-torque":
            asked = horner(turns, x)[0] + asked
        if "ki" in gains:
            asked = asked + gains["ki"][j] * z[j]
        wanted.append(asked)
    if control == "computed-torque":
        wanted = law.ask(driving_torques(model), [*q, *qd, *wanted])
    elif control == "pd+g":
        held = law.ask(rest_torques(model), q)
        wanted = [u + g for u, g in zip(wanted, held, strict=True)]
    return wanted, errors


def _feedback(mechanism: Mechanism, given: StateFeedback, law: RecordedLaw) -> list[Value]:
    """The torques that state-feedback wants."""
    count, qd = len(given.coordinates), law.variables("qd", mechanism.n)
    for i, k in enumerate(given.coordinates):
        away = f"q{k} - {float(given.q[k])!r}"
        turns = k not in mechanism.slides
        law.lines.append(f"d{i} = {f'remainder({away}, turn)' if turns else away}")
    law.scope = {"remainder": math.remainder, "turn": math.tau}
    state = [*law.variables("d", count), *(qd[k] for k in given.coordinates)]
    wanted: list[Value] = []
    torques = given.tau
    if len(torques) == mechanism.n:
        torques = [torques[k] for k in mechanism.actuated]
    for tau, row in zip(torques, given.gain, strict=True):
        total: Value = float(tau)
        for K, x in zip(row, state, strict=True):
            total = total - float(K) * x
        wanted.append(total)
    return wanted


def _limited(
    mechanism: Mechanism,
    law: RecordedLaw,
    wanted: Sequence[Value],
    errors: Sequence[Value],
    limits: Sequence[float],
    gains: Mapping[str, Sequence[float]],
) -> list[Value]:
    """The torques as they are cut off and fade, then, with gains ki, the rates of the integrals.

    Raises InputError for a kp of zero where the integral may have to go back.
    """
    fastest, qd = rate_limits(mechanism), law.variables("qd", mechanism.n)
    torques: list[Value] = []
    rates: list[Value] = []
    for j, (k, most) in enumerate(zip(mechanism.actuated, limits, strict=True)):
        u = w = wanted[j]
        if most < math.inf:
            u = choose(most, w, most, choose(w, -most, -most, w))
        if fastest[j] < math.inf:
            left = (fastest[j] - abs(qd[k])) / (FADE * fastest[j])
            u = u * choose(0.0, u * qd[k], greatest(0.0, least(1.0, left)), 1.0)
        torques.append(u)
        if "ki" not in gains:
            continue
        kp = gains["kp"][j]
        if not gains["ki"][j]:
            rates.append(0.0)
        elif u is w:
            rates.append(errors[j])
        elif kp:
            rates.append(errors[j] + (u - w) / kp)
        else:
            limit = "must be > 0 where ki is: the integral of a torque cut off goes by 1/kp"
            raise InputError("kp", value="0", limit=limit)
    return [*torques, *rates]
