"""Controllers that make the actuated joints track a reference motion.

With e = q_ref - q and ed = qd_ref - qd of the actuated joints (angles counted with full turns), and
Kp, Kd diagonal:

    pd                  tau = Kp e + Kd ed
    pd+g                tau = Kp e + Kd ed + G(q)
    pid                 tau = Kp e + Kd ed + Ki z
    computed-torque     tau = inverse dynamics of (q, qd, v),     v = qdd_ref + Kd ed + Kp e

G (the torques that hold a mechanism at rest) and the inverse dynamics are computed with the
controller's model, at the actual positions and rates.  If the model is exact, computed torque
leaves edd + Kd ed + Kp e = 0 for each joint.  Torques beyond tau_max are cut off; the torque that
speeds a motor up fades to zero over the last part of its speed_max,

    tau (rate_max - |qd|)/(FADE rate_max),     between 0 and tau, where tau qd > 0.

pd+g may also have Ki z.  The integral z is 0 at the start, and

    zd = e + (tau - tau') / Kp,     tau' the torque of the law before it is cut off:

while a torque is cut off, Ki z approaches what the limit leaves for it, with the time constant
Kp/Ki (back-calculation: Astrom, Murray, "Feedback Systems", 2008, 10.4). zd is continuous.

The law state-feedback keeps a pose (`state_feedback.py`).

A law acts continuously, or is sampled: at times k/rate the torque is computed from the state of the
run, and held until the next sample; z grows by zd/rate per sample.

Given the accelerations v of the actuated joints, those of the others follow from the closures,

    Psi_p qdd_p = -Psidot qd - Psi_a v,

and the torques from the inverse dynamics.  A controller is evaluated at every stage of a
simulation, so both are generated as code on floats if the closures' system is no larger than 2 x 2.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn.control.state_feedback import StateFeedback
from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics import dynamics
from robodyn.dynamics.dense_dynamics import check_actuators, required_load
from robodyn.engines import formulas, straightline
from robodyn.engines.expansion import horner
from robodyn.engines.expression import Expression, Graph, Value, choose, greatest, least
from robodyn.engines.factors import small_system
from robodyn.engines.formulas import Formula, Recorded
from robodyn.engines.straightline import define, float_source
from robodyn.errors import InputError
from robodyn.loops import loop_rates
from robodyn.loops.closing import regular_rank
from robodyn.mechanics import parts
from robodyn.mechanics.actuation import Actuation, for_each_actuated
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.kinks import Pieces
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.motors import rate_limits, torque_limits
from robodyn.mechanics.run_control import JointTracking
from robodyn.tables.arrays import Array

if TYPE_CHECKING:
    from robodyn.trajectories.reference import ReferenceMotion

Floats = Callable[..., Sequence[float]]


def rest_torques(mechanism: Mechanism) -> Floats:
    """Return a function of q (n floats) to the torques (actuated) that hold the mechanism.

    In N m.  For an open chain with passive joints these are only the actuated joints' torques.
    Raises RobodynError if a closed mechanism has fewer actuators than freedoms; the function may
    raise SingularError.
    """
    mechanism = parts.untimed(mechanism)
    if mechanism.rows:
        check_actuators(mechanism, np.zeros(mechanism.n))
    n, driven = mechanism.n, list(mechanism.actuated)
    zero = np.zeros(n)

    def otherwise(*values: float) -> Sequence[float]:
        q = np.array(values)
        if not mechanism.rows:
            load = required_load(mechanism, q, zero, zero)
        else:
            load = dynamics.inverse_dynamics(mechanism, q, zero, zero)
        torques: list[float] = load[driven].tolist()
        return torques

    return _compiled(mechanism, True, otherwise)


def driving_torques(mechanism: Mechanism) -> Floats:
    """Return a function of q, qd (n floats each) and v (actuated) to torques (actuated).

    v are accelerations of the actuated joints, rad/s^2; torques are in N m.  Raises RobodynError if
    there are fewer actuators than freedoms, and InputError if there are more, since v could then
    contradict the closures.  The function raises SingularError at a dead centre.
    """
    mechanism = parts.untimed(mechanism)
    check_actuators(mechanism, np.zeros(mechanism.n))
    n, driven = mechanism.n, list(mechanism.actuated)
    freedoms = n - (regular_rank(mechanism) if mechanism.rows else 0)
    if len(driven) > freedoms:
        limit = "needs as many actuators as freedoms: their accelerations follow from one another"
        raise InputError(
            "computed torque",
            where=mechanism.source,
            value=f"{len(driven)} actuators for a mobility of {freedoms}",
            limit=limit,
        )

    def otherwise(*values: float) -> Sequence[float]:
        q, qd, v = (np.array(x) for x in (values[:n], values[n : 2 * n], values[2 * n :]))
        if not all(np.isfinite(x).all() for x in (q, qd, v)):
            return [np.nan] * len(driven)
        qdd = loop_rates.loop_accelerations(mechanism, q, qd, v, 0.0)
        torques: list[float] = dynamics.inverse_dynamics(mechanism, q, qd, qdd)[driven].tolist()
        return torques

    return _compiled(mechanism, False, otherwise)


def _compiled(mechanism: Mechanism, rests: bool, otherwise: Floats) -> Floats:
    """Return the formula as code; `otherwise` if there is none, or a closure's pivot is small."""
    rows = len(mechanism.rows)
    determined = not rows or (rows <= 2 and len(mechanism.passive) == rows)
    if mechanism.n > formulas.MAX_GENERATED or not determined:
        return otherwise

    formula = formulas.written(mechanism, partial(_formula, mechanism, rests))
    if formula is None:
        return otherwise
    code = straightline.compile_floats(formula, "torques")
    if not rows:
        return code
    count = len(formula.outputs)

    def guarded(*values: float) -> Sequence[float]:
        try:
            found = code(*values)
        except ZeroDivisionError:
            return otherwise(*values)
        if min(found[count:]) > dynamics.PIVOT_CUT:
            return found[:count]
        return otherwise(*values)

    return guarded


def _formula(mechanism: Mechanism, rests: bool, by_direction: bool) -> Formula:
    """Return the torques of the actuated joints from q, or from q, qd and their qdd."""
    n, driven = mechanism.n, mechanism.actuated
    state = Recorded(mechanism, ("qd", "qdd"), by_direction)
    inputs = state.inputs[:n]
    if rests:
        state.relative["qd"] = state.relative["qdd"] = [0.0] * n
    else:
        inputs = state.inputs[: 2 * n] + tuple(f"qdd{k}" for k in driven)
        if mechanism.rows:
            _complete(state)
    whole = formulas.inverse_of(state)
    return Formula(inputs, tuple(whole.outputs[k] for k in driven), whole.pivots)


def _complete(state: Recorded) -> None:
    """Compute the passive joints' qdd from the others'."""
    mechanism = state.mechanism
    qdd = state.relative["qdd"]
    series = state.series([0.0] * mechanism.n)
    opening = series.residuals(0)[mechanism.n :]  # Psidot qd
    Psi = formulas.joint_jacobian(state, series)
    right: list[Value] = []
    for x, row in zip(opening, Psi, strict=True):
        total = -x
        for k in mechanism.actuated:
            total = total - row[k] * qdd[k]
        right.append(total)
    columns = [[row[p] for p in mechanism.passive] for row in Psi]
    found, _ = small_system(columns, right)
    for p, value in zip(mechanism.passive, found, strict=True):
        qdd[p] = value


class RecordedLaw:
    """Torques of `joints`, and rates of the law's own states, from t, q0.., qd0.. and z0...

    `lines` are statements that compute further inputs.
    """

    def __init__(self, n: int, joints: int, states: int) -> None:
        self.graph, self.n, self.joints, self.states = Graph(), n, joints, states
        count = {"q": n, "qd": n, "z": states}
        self.inputs = [f"{name}{i}" for name, most in count.items() for i in range(most)]
        self.lines: list[str] = []
        self.scope: dict[str, object] = {}
        self.asked: list[Value] = []
        self.outputs: list[Value] = []

    def variables(self, name: str, count: int) -> list[Value]:
        """Return the inputs name0, name1, ..."""
        return [self.graph.variable(f"{name}{i}") for i in range(count)]

    def ask(self, model: Floats, asked: Sequence[Value]) -> list[Value]:
        """Return what a model computes, one number per joint."""
        self.scope["model"], self.asked = model, [*asked]
        return self.variables("g", self.joints)

    def code(self) -> Callable[..., Any]:
        """Return the law as a function of floats.

        The model is called as soon as its inputs are known.
        """
        lines, shown = float_source([*self.asked, *self.outputs])
        last = max((x.index for x in self.asked if isinstance(x, Expression)), default=-1)
        first = sum(int(line[1 : line.index(" ")]) <= last for line in lines)
        calls = []
        if self.asked:
            given = ", ".join(shown[: len(self.asked)])
            calls.append(f"{', '.join(f'g{j}' for j in range(self.joints))}, = model({given})")
        result = f"return ({', '.join(shown[len(self.asked) :])},)"
        body = "\n    ".join([*self.lines, *lines[:first], *calls, *lines[first:], result])
        head = f"def control({', '.join(['t', *self.inputs])}):"
        return define(f"{head}\n    {body}\n", "control", scope=self.scope)


ROUNDED = 1.0 + 1e-15  # a row's time may miss that of a sample by rounding


class Tracked:
    """Statistics of the tracking error e and its rate ed, over the accepted steps of a run.

    Within a step, e is the cubic with the values of e and ed at both ends.
    """

    restarts = False

    def __init__(self, mechanism: Mechanism, reference: ReferenceTable, law: RecordedLaw) -> None:
        self.mechanism, self.reference = mechanism, reference
        self.law, self.states = law.code(), law.states
        self._forget()

    def _forget(self) -> None:
        joints = self.reference.joints
        self._last: tuple[Array, Array, Array] | None = None  # t, e, ed where a batch ended
        self._square = np.zeros(joints)  # integral of e^2
        self._duration = 0.0
        self._largest, self._at = np.full(joints, -1.0), np.zeros(joints)
        self._torque = np.zeros(joints)
        self.hardest: tuple[float, Array] | None = None

    def torques(self, t: float, y: Sequence[float]) -> Sequence[float]:
        """Return the torques at t, in the state y = (q, qd, ...)."""
        found: Sequence[float] = self.law(t, *y[: 2 * self.mechanism.n + self.states])
        return found[: self.reference.joints]

    def errors(self, t: Array, y: Array) -> Array:
        """Return q_ref - q (k, actuated) at times t (k,) and states y (k, n or more)."""
        error: Array = self.reference.at(t)[0] - y[:, list(self.mechanism.actuated)]
        return error

    def observe(self, t: Array, y: Array) -> None:
        """Take accepted steps: times (k,) and states (k, 2n or more)."""
        n, driven = self.mechanism.n, list(self.mechanism.actuated)
        rates = self.reference.at(t)[1]
        e, ed = self.errors(t, y), rates - y[:, n : 2 * n][:, driven]
        ended = ed  # as the step that ends there sees it
        if self.reference.stops:
            ended = ed + self.reference.at(t, "left")[1] - rates
        for k in range(len(t)):
            acting = np.abs(self.torques(float(t[k]), y[k].tolist()))
            if self.hardest is None or np.fmax.reduce(acting) > self._torque.max():
                self.hardest = float(t[k]), y[k]
            self._torque = np.fmax(self._torque, acting)
        self._compare(np.broadcast_to(t[:, None], e.shape), np.abs(e))
        if self._last is not None:
            t, e, ed = (np.concatenate(pair) for pair in zip(self._last, (t, e, ed), strict=True))
        else:
            ended = ended[1:]
        self._last = t[-1:], e[-1:], ed[-1:]
        h = np.diff(t)[:, None]
        rise, slope, end = np.diff(e, axis=0), ed[:-1] * h, ended * h
        # by the powers of u from 0 to 1 along each step
        cubic = e[:-1], slope, 3.0 * rise - 2.0 * slope - end, slope + end - 2.0 * rise
        for u, extreme in _extremes(cubic):
            self._compare(t[:-1, None] + u * h, np.abs(extreme))
        parts = [cubic[i] * cubic[j] / (i + j + 1) for i, j in product(range(4), repeat=2)]
        self._square += np.abs((h * sum(parts)).sum(axis=0))
        self._duration += abs(float(t[-1] - t[0]))

    def _compare(self, t: Array, size: Array) -> None:
        """Keep the largest of sizes (k, actuated) at times t (k, actuated), with its time."""
        if len(size):
            worst = size.argmax(axis=0), np.arange(size.shape[1])
            larger = size[worst] > self._largest
            self._largest = np.where(larger, size[worst], self._largest)
            self._at = np.where(larger, t[worst], self._at)

    def tracking(self) -> list[JointTracking]:
        """Return the statistics of each actuated joint."""
        mean = self._square / self._duration if self._duration else self._largest**2
        names = [self.mechanism.link_names[k] for k in self.mechanism.actuated]
        columns = (np.sqrt(mean), self._largest, self._at, self._torque)
        rows = zip(names, *(column.tolist() for column in columns), strict=True)
        return [JointTracking(*row) for row in rows]


def _extremes(cubic: tuple[Array, Array, Array, Array]) -> list[tuple[Array, Array]]:
    """Return place and value of the extremes of each step's cubic; zero if there is none."""
    begin, slope, c2, c3 = cubic
    with np.errstate(all="ignore"):  # slope + 2 c2 u + 3 c3 u^2 = 0 may have no root
        q = -(c2 + np.copysign(np.sqrt(c2**2 - 3.0 * c3 * slope), c2))
        found = []
        for u in (q / (3.0 * c3), slope / q):
            inside = (u > 0.0) & (u < 1.0)
            u = np.where(inside, u, 0.0)
            value = begin + u * (slope + u * (c2 + u * c3))
            found.append((u, np.where(inside, value, 0.0)))
    return found


class Continuous(Tracked):
    """A law that acts continuously."""

    def __init__(
        self,
        mechanism: Mechanism,
        reference: ReferenceTable,
        law: RecordedLaw,
        pieces: Pieces,
        jumps: bool,
    ) -> None:
        super().__init__(mechanism, reference, law)
        self.restarts = jumps
        self.pieces = pieces
        self.forward = True

    def begin(self, y: Sequence[float], t_end: float) -> None:
        self._forget()
        self.forward = t_end >= 0.0
        self.pieces.reset()
        self.reach(0.0, y)

    def reach(self, t: float, y: Sequence[float]) -> None:
        if self.restarts:
            self.pieces.come_to(t, self.forward)


class Sampled(Tracked):
    """A sampled law; its torques are held from one sample to the next.

    Its own states are summed: z + zd/rate at the next sample.
    """

    restarts = True

    def __init__(
        self, mechanism: Mechanism, reference: ReferenceTable, law: RecordedLaw, rate: float
    ) -> None:
        super().__init__(mechanism, reference, law)
        self.rate = rate
        self.times = array("d")
        self.values = array("d")  # torques (actuated) of each sample in turn

    def begin(self, y: Sequence[float], t_end: float) -> None:
        if t_end < 0.0:
            limit = "a torque is not held backwards: the time must not be negative"
            raise InputError("control_rate", value=f"{self.rate:g}", limit=limit)
        self._forget()
        self.times, self.values = array("d"), array("d")
        self.z = self.before = [0.0] * self.states
        self.reach(0.0, y)

    def reach(self, t: float, y: Sequence[float]) -> None:
        joints = self.reference.joints
        if self.times and t <= self.times[-1]:
            if t < self.times[-1]:
                return
            # the run went back to an event before this sample, or sees the same again
            self.times.pop()
            del self.values[-joints:]
            self.z = self.before
        self.before = self.z  # the integrals that the last sample took
        found = self.law(t, *y[: 2 * self.mechanism.n], *self.z)
        self.values.extend(found[:joints])
        self.z = [z + zd / self.rate for z, zd in zip(self.z, found[joints:], strict=True)]
        self.times.append(t)

    def sample(self, t: float) -> int:
        """Return the index of the last sample at t."""
        return max(bisect_right(self.times, t * ROUNDED) - 1, 0)

    def at(self, t: float) -> Sequence[float]:
        """Return the torques held at t."""
        joints = self.reference.joints
        k = self.sample(t) * joints
        return self.values[k : k + joints]

    def torques(self, t: float, y: Sequence[float]) -> Sequence[float]:
        return self.at(t)


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
    reference: ReferenceTable | ReferenceMotion,
    control: str,
    kp: float | Sequence[float] | None = None,
    kd: float | Sequence[float] | None = None,
    tau_max: float | Sequence[float] | None = None,
    control_rate: float | None = None,
    control_model: Mechanism | None = None,
    ki: float | Sequence[float] | None = None,
    gain: StateFeedback | None = None,
) -> Actuation:
    """Return what `simulate` takes as tau so that the actuated joints track a reference.

    The reference has the actuated joints, or all, or is a motion, whose actuated joints are
    tracked. state-feedback has a `gain` in place of kp and kd, and uses the reference only to
    report errors. control: one of `LAWS`. kp, kd, ki (>= 0): one value, or one per actuated joint;
    in N m/rad, N m s/rad and N m/(rad s), for computed torque in 1/s^2 and 1/s. tau_max (N m):
    likewise, or None; motors limit torques too. control_rate: samples per second, or None for a
    continuous law. control_model: the model in the law; None: the mechanism itself.

    Raises InputError for wrong arguments, and RobodynError if the law needs torques of a closed
    mechanism with fewer actuators than freedoms.
    """
    for x in (mechanism, control_model or mechanism):
        refuse_driven(x, "a controller")
    given = {"kp": kp, "kd": kd, "ki": ki}
    _check(control, given | {"gain": gain, "control_model": control_model}, control_rate)
    if not isinstance(reference, ReferenceTable):
        reference = ReferenceTable.along(reference)
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
    """Return an actuation whose torques and `own` rates come from a call on names in `asked`."""
    targets = [*(f"tau{k}" for k in mechanism.actuated), *own]
    lines = (f"{', '.join(targets)}, = {call}", *(f"tau{k} = 0.0" for k in mechanism.passive))
    times = law.reference.times
    span = (law.reference.where, times[0], times[-1])
    held = isinstance(law, Sampled)
    return Actuation(None, lines, (), asked, kinks, held, span, law, states=len(own))


def _check(control: str, given: Mapping[str, object], rate: float | None) -> None:
    """Raise InputError for an unknown law, for missing and for needless arguments."""
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
    """Return the reference of the actuated joints."""
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
    """Return one value per actuated joint, each at least `least`."""
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
    """Return the torques that a law demands of the actuated joints, and their errors."""
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
    """Return the torques that state-feedback demands."""
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
    """Return torques, cut off and faded, then the rates of integrals for gains ki.

    Raises InputError for a kp of zero if the integral may have to be driven back.
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
