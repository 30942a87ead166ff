"""The phases of a run with contacts: in each, joints stick or slip, and stops press or not.

Within a phase the mechanism is in one mode (`modes.py`) and its motion is smooth.  A mode lasts
while its guards, functions of the state, are positive.  The run watches guards as events; the first
one that changes sign ends the phase.

At hard stops the rates jump, by an impulse through M and the closures.  With K = [M Psi^T; Psi 0],
v the rates at which touched stops are left (negative if joints run into them) and R v's rows in qd,
the impulses p >= 0 satisfy

    v+ = v + R K^-1 R^T p,      v+ + e v >= 0,      p . (v+ + e v) = 0,

e the restitution of each stop.  For one stop, p = -(1 + e) v / (R K^-1 R^T).  Psi is taken at the
instant of impact.  The jump of qd lies in its null space, so laws of time are kept: Psi qd + d
gap/dt = 0.

A joint whose rate follows from laws of time alone is led: nothing holds it and no impulse throws it
back.  An end of its range ends the run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from robodyn.dynamics import closed_form, sticking
from robodyn.dynamics.dense_dynamics import responses
from robodyn.dynamics.dynamics import motion_dynamics
from robodyn.dynamics.sticking import AT_REST, TOGETHER, forces_between, mode_at, resting
from robodyn.elements.contacts import NEAR, End, Guard, Mode
from robodyn.elements.joints import HardStop
from robodyn.errors import InputError, SingularError
from robodyn.loops.closing import close_positions
from robodyn.loops.projection import law_error
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.kinks import kink_at
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import beyond, end_word, in_mode, pressed
from robodyn.runs.event_functions import EventFunction
from robodyn.runs.motion_columns import applied_torques
from robodyn.runs.roots import ROUNDING
from robodyn.runs.watch import Event
from robodyn.tables.arrays import Array

ONWARD = 10.0  # times what is missed: slower back than so a joint may only seem to turn back
TURNS = 30  # impacts in turn at one instant, after which they have no end
LAST = 10  # of them, those whose ends take part in all that would follow
DOUBTS = 3  # times that a joint is let leave its end
KINK = 1e-14  # of the time of a run: so much beyond a kink the torques are those that follow it
SLACK = 1e-10  # part of the rates by which a condition may be missed
SLOW = 1e-11  # part of the fastest joint's rate below which a joint that is led has none
INSTANT = 8.0  # roundings of the time that are none
LOW = 4.0 * ROUNDING  # part of where its end is: so low a bounce rounding does not show
BLUR = 0.1  # part of its rate that a joint thrown back so little may lose or gain
ENDLESS = 1e-10  # of the time of a run: bounces that end within this part of it are over at once


class Phases:
    """Moves a mechanism from mode to mode, from the state y = (q, qd, ...) at t = 0.

    `small` is the error of angles and rates that a step may make.  Raises InputError if the start
    is beyond an end, or if t_end is negative: a joint at rest does not tell where it came from.
    """

    def __init__(
        self, mechanism: Mechanism, actuation: Actuation, y: Array, t_end: float, small: float
    ) -> None:
        if t_end < 0.0:
            limit = "must not be negative: dry friction and stops have no motion backwards"
            raise InputError("time", value=t_end, limit=limit)
        self.mechanism, self.actuation, self.t_end = mechanism, actuation, t_end
        self.small = small
        self._reach(0.0)
        self.dry = mechanism.dry
        self.ends = {(x.joint, side): end for x in mechanism.ranges for side, end in x.ends}
        self.restitutions = {(x.joint, x.side): x.restitution for x in mechanism.of(HardStop)}
        self.events: list[Event] = []
        self.begun, self.idle = 0.0, 0  # when the phase began, and how many took no time before
        self.turns: list[list[End]] = []  # ends hit before, in turn, without time passing
        self.thrown: dict[int, float] = {}  # how fast a joint left its end last
        self.led_on = False  # whether a law leads a joint beyond the end that ends the run
        self.doubts = 0  # times in a row that a joint which leaves its end was to meet it
        q, qd = self._split(y)
        for joint, side, end in beyond(mechanism, q.tolist()):
            raise InputError(
                f"q{joint + 1} ({mechanism.link_names[joint]})",
                where=mechanism.source,
                value=float(q[joint]),
                limit=f"is beyond the joint's {end_word(side)}, {end:.9g}",
            )
        touches = set(sticking.touching(mechanism, q, qd, 0.0))
        hits = self._run_into(touches, qd)
        self.y = self._impact(0.0, y, hits, touches) if hits else y
        q, qd = self._split(self.y)
        pushing = pressed(mechanism, q.tolist(), qd.tolist())
        touches = set(sticking.touching(mechanism, q, qd, 0.0))
        touches -= set(self._run_into(touches, qd))  # an impact may drive a joint to its end
        self._enter(0.0, set(sticking.resting(mechanism, qd)), touches, set(pushing))

    def _split(self, y: Array) -> tuple[Array, Array]:
        n = self.mechanism.n
        return y[:n], y[n : 2 * n]

    def _torques(self, t: Array, y: Array) -> Array:
        """Return torques (k, n); at a kink where the phase begins, those after the kink."""
        return applied_torques(self.mechanism, self.actuation, np.maximum(t, self.after), y)

    def _reach(self, t: float) -> None:
        """Begin a phase at t; if t is a kink, its torques are those just after it.

        So are its loads, if t is a jump.
        """
        self.after = -math.inf
        if t == 0.0 or kink_at(self.actuation.stops, t) is not None:
            self.after = t + max(KINK * abs(self.t_end), INSTANT * math.ulp(t))
        self.loads_after = self.after if self.actuation.jumps else -math.inf

    # -- modes -------------------------------------------------------------------------------------

    def _enter(
        self,
        t: float,
        rests: set[int],
        touches: set[End],
        pushing: set[End],
        starting: Mapping[int, int] = MappingProxyType({}),
        released: int | None = None,
    ) -> None:
        """Choose the mode in which the state goes on, and its guards.

        A joint `released` by a law of time does not pause again.
        """
        self._reach(t)
        q, qd = self._split(self.y)
        self.led = sticking.led_joints(self.mechanism, q, t)
        self.slow = max(self.small, SLOW * float(np.abs(qd).max(initial=0.0)))
        self.paused = [
            joint
            for joint in self.led
            if joint in self.dry and joint != released and abs(qd[joint]) < self.slow
        ]
        rests = rests - set(self.led)
        tau, loaded = self._torques(np.array([t]), self.y[None])[0], max(t, self.loads_after)
        sorts, stops = (sorted(rests), sorted(touches)), tuple(sorted(pushing))
        self.mode, self.still = sticking.mode_at(
            self.mechanism, q, qd, tau, *sorts, stops, starting, self.paused, t=loaded
        )
        self.started = (rests | {joint for joint, _ in touches}) - set(self.still)
        self.touches = {end for end in touches if end[0] in self.still}
        sides = {joint: [s for j, s in self.touches if j == joint] for joint in self.still}
        self.bounds = {j: sticking.bounds(self.mechanism, j, sides[j]) for j in self.still}
        self.moving, self.integrated = in_mode(self.mechanism, self.mode), self.mode
        # what varies with the time may end, or have no value: that is seen where it is integrated
        if not self.mechanism.timed and sticking.stands(self.moving, q, t):
            qd[:], self.integrated = 0.0, self.mode._replace(stands=True)
        self._watch(t)

    def _watch(self, t: float) -> None:
        """Make the guards of the mode: functions that stay positive while it lasts."""
        touches = self.touches
        guards = [x for own in self.mechanism.elements for x in own.guards(self.mode, touches)]
        guards += [guard for own in self.mechanism.ranges for guard in own.guards(touches)]
        self.guards = sorted(guards, key=lambda x: (x.kind != "slips", x.joint, x.side))
        left = self._margins(np.array([t]), self.y[None])[0] if self.still else []
        self.guards += [Guard("holds", k, 0) for k, x in enumerate(left) if math.isfinite(x)]
        if self.mechanism.driven:  # joints at rest that nothing holds, and that laws may move
            free = [*self.paused, *(j for j in self.still if j not in self.mode.held)]
            self.guards += [_pause(j, self.slow) for j in free]
        self.functions = [self._function(guard, t) for guard in self.guards]

    def _function(self, guard: Guard, begun: float) -> EventFunction:
        """Return the guard of a phase that begins at `begun` as a function that ends it."""
        at, y = np.array([begun]), self.y[None]
        here, size = float(self._value(guard, at, y)[0]), float(self._size(guard, at, y)[0])
        stop = guard.kind in ("inside", "presses", "apart")
        if stop:
            size += float(self.mechanism.arrays.units[guard.joint])
        offset, missed = 0.0, 0.0
        fastest = float(np.abs(self._split(self.y)[1]).max(initial=0.0))
        least = max(self.small, INSTANT * math.ulp(begun) * fastest)
        # it is zero there, but for rounding, or for what an earlier phase let it miss
        if abs(here) <= NEAR * size or (guard.kind == "inside" and -least <= here < 0.0):
            offset = min(here, 0.0)
            if self.idle or self.doubts:  # what is below the tolerance ended a phase at once
                missed = max(least + offset, 0.0)
        # along a law that comes to rest ever more slowly the sign of a rate is noise in the end
        least_slip = SLOW * self.small if guard.kind == "slips" else 0.0

        def values(t: Array, y: Array) -> Array:
            """Return guard values, which may go below zero by `missed` without ending the phase.

            For a stop this tolerance ends when the joint turns back, so that it is met where it
            stands.
            """
            value = self._value(guard, t, y) - offset
            if not (missed and stop):
                return value + missed
            way = guard.side if guard.kind == "presses" else -guard.side
            onward = way * y[:, self.mechanism.n + guard.joint] + ONWARD * missed
            return np.maximum(value, np.minimum(value + missed, onward))

        def noise(t: Array, y: Array, _: Array) -> Array:
            size = self._size(guard, t.ravel(), y.reshape(-1, y.shape[-1]))
            return ROUNDING * size.reshape(t.shape) + least_slip

        name = f"{guard.kind} {guard.joint} {guard.side}"
        return EventFunction(values, noise, name, way=-1, strict=True, switches=())

    def _value(self, guard: Guard, t: Array, y: Array) -> Array:
        if guard.value is None:
            return self._margins(t, y)[:, guard.joint]
        n = self.mechanism.n
        return np.asarray(guard.value(y[:, :n], y[:, n : 2 * n]))

    def _size(self, guard: Guard, t: Array, y: Array) -> Array:
        n = self.mechanism.n
        if guard.size is None:
            held = [x for b in self.bounds.values() for x in (b.low, b.high) if math.isfinite(x)]
            tau, loaded = self._torques(t, y), np.maximum(t, self.loads_after)
            acting = sticking.load_sizes(self.moving, y[:, :n], y[:, n : 2 * n], tau, loaded)
            size = np.abs(self._forces(t, y)) + acting[:, list(self.mode.held)]
            return np.asarray(size.sum(axis=1) + sum(map(abs, held)))
        return np.asarray(guard.size(y[:, :n], y[:, n : 2 * n]))

    def _forces(self, t: Array, y: Array) -> Array:
        """Return the forces (k, held) that hold the held joints."""
        n, loaded = self.mechanism.n, np.maximum(t, self.loads_after)
        states = y[:, :n], y[:, n : 2 * n], self._torques(t, y)
        multipliers = motion_dynamics(self.moving, *states, loaded).multipliers
        return sticking.held_forces(self.moving, multipliers)

    def _margins(self, t: Array, y: Array) -> Array:
        standing, q = (self.mode, self.still), y[:, : self.mechanism.n]
        return sticking.margins(self.mechanism, *standing, q, self._forces(t, y), self.bounds, t)

    # -- from one to the next ----------------------------------------------------------------------

    def ends_run(self, place: int) -> str:
        """Return the message if the guard at `place` ends the run, else ""."""
        kind, joint, side, *_ = self.guards[place]
        thrown = (joint, side) in self.restitutions and joint not in self.led
        if kind != "inside" or thrown:
            return ""
        name, end = self.mechanism.link_names[joint], self.ends[joint, side]
        self.led_on = joint in self.led
        return f"q{joint + 1} ({name}) passes its {end_word(side)}, {end:.9g}"

    def next(self, t: float, y: Array, place: int) -> Array:
        """Return the state in which the next phase begins, after guard `place` failed at (t, y)."""
        self.idle = self.idle + 1 if t - self.begun <= INSTANT * math.ulp(t) else 0
        self.begun = t
        self._reach(t)
        before = self._energy(self.moving, y)
        guard, (q, qd) = self.guards[place], self._split(y := y.copy())
        joint, end = guard.joint, (guard.joint, guard.side)
        rests, touches, pushing = self._left_by(guard)
        inside = guard.kind == "inside"
        meets = inside and guard.side * qd[joint] > 0.0
        # a joint that starts from rest slips at least until its rate is more than is missed
        begins = guard.kind == "slips" and bool(self.idle) and joint in self.started
        self.doubts = self.doubts + 1 if begins or (inside and not meets) else 0
        ends = set(sticking.touching(self.mechanism, q, qd, t)) - touches
        hits = sorted({*self._run_into(ends, qd), *([end] if meets else [])})
        # a joint on its end stands there, pressed or not, unless it was thrown back just now
        self.turns = self.turns if self.idle else []
        thrown = {x for turn in self.turns for x in turn}
        stands = ends - {*hits, *thrown} if hits else set()
        # it rests where the method cannot tell how far it is thrown back
        if inside and self.doubts == DOUBTS:
            touches.add(end)
        hits = self._onto_ends(t, q, qd, touches, hits)
        standing = rests | {j for j, _ in touches}
        if own := sorted(standing - set(self.led)):
            qd[:], also = sticking.stopped(self.mechanism, q, qd, own, t)
            rests.update(also)
        self.y = y
        if hits:
            self.turns = [*self.turns, hits]
            self.y = self._impact(t, y, hits, touches | stands)
            _, qd = self._split(self.y)
        least = sticking.AT_REST * float(np.abs(qd).max(initial=0.0))
        rest = {j for j, rate in enumerate(qd.tolist()) if abs(rate) <= least}
        if hits:
            met = touches | stands | set(hits)
            rests, touches = rest & set(self.dry), {x for x in met if x[0] in rest}
        starting = self._let_go(t, y, joint) if guard.kind == "holds" else {}
        begun = self.started if self.idle and not hits else set()  # and have not moved since
        touches |= {x for x in sticking.touching(self.mechanism, q, qd, t) if x[0] in rest - begun}
        starting |= {j: way for j, way in self.mode.slips if j in (begun & rest) - rests}
        rests |= set(starting) & set(self.dry)
        if begins and self.doubts < DOUBTS:
            starting = {joint: guard.side}
        was, stood = self.mode, {*self.still, *self.paused}
        released = joint if guard.kind == "pauses" else None
        self._enter(t, rests, touches, pushing, starting, released)
        self._note(t, was, stood)
        if len(y) > 2 * self.mechanism.n:  # what is lost at once is work as well
            self.y[-1] += self._energy(self.moving, self.y) - before
        return self.y

    def _left_by(self, guard: Guard) -> tuple[set[int], set[End], set[End]]:
        """Return the contacts that remain when a guard ends the phase.

        They are the dry joints at rest, the ends that joints touch, and those that they press.
        """
        rests = {joint for joint in self.still if joint in self.dry}
        touches, pushing = set(self.touches), set(self.mode.pressed)
        match guard.kind:
            case "slips":
                rests.add(guard.joint)
            case "presses" | "apart":
                pushing ^= {(guard.joint, guard.side)}
            case "pauses":
                rests.discard(guard.joint)
                touches = {end for end in touches if end[0] != guard.joint}
        return rests, touches, pushing

    def _let_go(self, t: float, y: Array, joint: int) -> dict[int, int]:
        """Return the directions of the joints that start when what holds `joint` gives way."""
        forces, q = self._forces(np.array([t]), y[None])[0], self._split(y)[0]
        standing = sticking.Standing(self.mode, self.still)
        rates = sticking.starting_at(self.mechanism, standing, q, forces, self.bounds, joint, t)
        return {j: 1 if rate > 0.0 else -1 for j, rate in rates.items()}

    def _onto_ends(
        self, t: float, q: Array, qd: Array, touches: set[End], hits: list[End]
    ) -> list[End]:
        """Move joints that hit onto their ends, in q; return all ends hit then.

        Joints rest on the ends `touches`.
        """
        for joint, side in hits:  # rounding must not grow from bounce to bounce
            q[joint] = self.ends[joint, side]
        if hits and self.mechanism.rows:
            # closures may tie some of these joints to one another
            fixed = sticking.independent(self.mechanism, [joint for joint, _ in hits], q, t)
            q[:] = close_positions(self.mechanism, q, fixed, t=t)
            ends = set(sticking.touching(self.mechanism, q, qd, t)) - touches
            hits = sorted({*hits, *self._run_into(ends, qd)})
        return hits

    def _run_into(self, touches: set[End], qd: Array) -> list[End]:
        """Return the ends among `touches` that the rates qd (n,) run into."""
        least = sticking.AT_REST * float(np.abs(qd).max(initial=0.0))
        return sorted((joint, side) for joint, side in touches if side * qd[joint] > least)

    def _impact(self, t: float, y: Array, hits: Sequence[End], touches: set[End]) -> Array:
        """Return the state after an impact; a bounce that would end at once is skipped."""
        (q, qd), y = self._split(y), y.copy()
        tau = self._torques(np.array([t]), y[None])[0]
        # ends that throw joints at one another again and again in no time leave them no rates
        last = {end for turn in self.turns[-LAST:] for end in turn}
        endless = any(self.restitutions[end] != 1.0 for end in last)
        over = last if endless and len(self.turns) > TURNS else set()
        ends, loaded = sorted({*hits, *touches, *over}), max(t, self.loads_after)
        self._split(y)[1][:] = self._bounced(q, qd, tau, loaded, ends, over)
        for joint, side in hits:
            self._tell(t, y, joint, f"hits its {end_word(side)}")
        return y

    def _bounced(
        self, q: Array, qd: Array, tau: Array, t: float, ends: list[End], over: set[End]
    ) -> Array:
        """Return the rates (n,) after an impact at `ends`; joints at the ends `over` come to rest.

        A bounce that would repeat forever, or that rounding or steps cannot resolve, ends at rest
        at once.  Torques tau (n,) are those before the impact.
        """
        own = [self.restitutions[end] for end in ends]
        after, jumps = rates_after(self.mechanism, q, qd, ends, own, t)
        leaving = [-side * float(after[joint]) for joint, side in ends]
        tied = [
            [j for j in range(len(ends)) if j == k or (leaving[j] > 0.0 and _tied(jumps, [j], k))]
            for k in range(len(ends))
        ]
        qdd = np.zeros_like(qd)
        if max(leaving) > 0.0:
            on = [end for end in ends if not after[end[0]]]
            mode = mode_at(self.mechanism, q, after, tau, resting(self.mechanism, after), on, t=t)
            qdd = motion_dynamics(in_mode(self.mechanism, mode.mode), q, after, tau, t).qdd
        shows = []  # whether a bounce is told from rest: by any steps, and by those of the method
        for k, (joint, side) in enumerate(ends):
            back, leaves, e = side * float(qdd[joint]), leaving[k], max(own[j] for j in tied[k])
            brief = leaves < 0.5 * back * (1.0 - e) * ENDLESS * abs(self.t_end)
            low = leaves**2 < 2.0 * back * LOW * abs(q[joint])
            # steps resolve it if it is fast or the joint's first, or returns as fast as it left
            v, last = side * qd[joint], self.thrown.get(joint, 0.0)
            fast = max(abs(v), last) ** 2 >= 2.0 * back * self.small
            resolved = back <= 0.0 or fast or abs(v - last) <= BLUR * last or not last
            shows.append((not (brief or low), resolved) if leaves > 0.0 else (True, True))
            self.thrown[joint] = leaves
        kept: list[float | None] = list(own)
        for k, end in enumerate(ends):  # of ends that are tied to one another any may tell
            if end in over or not any(shows[j][0] for j in tied[k]):
                kept[k] = None
            elif not any(all(shows[j]) for j in tied[k]):
                kept[k] = 0.0
        changed = [k for k, part in enumerate(kept) if part != own[k]]
        if changed:
            least = None if any(kept[k] is None for k in changed) else 0.0
            kept = [least if _tied(jumps, changed, k) else part for k, part in enumerate(kept)]
            after, _ = rates_after(self.mechanism, q, qd, ends, kept, t)
        return after

    def _energy(self, moving: Mechanism, y: Array) -> float:
        KE, PE = closed_form.energies(moving, *self._split(y))
        return float(KE + PE)

    def _note(self, t: float, was: Mode, stood: set[int]) -> None:
        """Record events for stops met or left and joints started or stopped."""
        for joint, side in set(self.mode.pressed) - set(was.pressed):
            self._tell(t, self.y, joint, f"meets its {end_word(side)}")
        for joint, side in set(was.pressed) - set(self.mode.pressed):
            self._tell(t, self.y, joint, f"leaves its {end_word(side)}")
        for joint in self.dry:
            if (joint in stood) != (joint in self.still or joint in self.paused):
                self._tell(t, self.y, joint, "starts" if joint in stood else "stops")

    def _tell(self, t: float, y: Array, joint: int, what: str) -> None:
        name = f"{self.mechanism.link_names[joint]} {what}"
        self.events.append(Event(name, t, y[: 2 * self.mechanism.n].copy()))


def _pause(joint: int, slow: float) -> Guard:
    """Return the guard of a paused joint; it fails once the joint is faster than `slow`."""
    return Guard(
        "pauses",
        joint,
        0,
        lambda q, qd: slow - np.abs(qd[:, joint]),
        lambda q, qd: slow + np.abs(qd[:, joint]),
    )


def _tied(jumps: Array, ends: list[int], k: int) -> bool:
    """Return whether the rate of end k follows from those of `ends`, by jumps (n, ends)."""
    if k in ends:
        return True
    ranks = [np.linalg.matrix_rank(jumps[:, own], rtol=TOGETHER) for own in (ends, [*ends, k])]
    return bool(ranks[0] == ranks[1])


def rates_after(
    mechanism: Mechanism,
    q: Array,
    qd: Array,
    touches: Sequence[End],
    parts: Sequence[float | None],
    t: float,
) -> tuple[Array, Array]:
    """Return qd (n,) after an impact at q and time t, and the jump of qd (n, k) by unit impulses.

    `touches` lists (joint, side) of the k stops, `parts` their restitutions.  None means at rest
    from then on: remaining bounces are skipped, and their impulses, of any sign, act together.
    Rates of which only rounding is left are zero.  Raises SingularError if no impulses throw all
    joints back, and LawError if a law of time forbids it.
    """
    joints = [joint for joint, _ in touches]
    ways = -np.array([side for _, side in touches], float)  # in which stops are left
    jumps = (ways[:, None] * responses(mechanism, q, joints, t)).T
    W, v = ways[:, None] * jumps[joints], ways * qd[joints]
    bounced = v + np.array([e or 0.0 for e in parts]) * v
    least = np.array([-np.inf if e is None else 0.0 for e in parts])
    p = forces_between(bounced, W, least, np.full(len(v), np.inf))
    if (W @ p + bounced >= -SLACK * np.abs(v).max(initial=0.0)).all():
        after = qd + jumps @ p
        none = AT_REST * max(np.abs(qd).max(), np.abs(after).max())
        return np.where(np.abs(after) <= none, 0.0, after), jumps
    names = ", ".join(mechanism.link_names[joint] for joint in joints)
    limit = "no impulses throw all of them back"
    if mechanism.driven:
        limit = f"cannot be kept at t = {t:.9g} s: the stops of {names} leave it no way"
        raise law_error(mechanism, mechanism.driven[0], limit)
    raise SingularError(f"impact of {names}", where=mechanism.source, limit=limit)
