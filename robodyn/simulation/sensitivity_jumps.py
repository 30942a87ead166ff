"""Sensitivities from mode to mode: where joints stick, start and stop, and meet their ends.

A phase ends where its guard g is zero, at a time that depends on p by

    T = -(dg/dp)/(dg/dt)    along the motion,      s+ = dY/dp + dY/dy (s- + f- T) - f+ T

with the rates f of y = (q, qd, z) before and after, z a controller's integrals, and Y the state
after: y itself, but for an impact, whose impulses p go through M and the closures,

    qd+ = qd - sum_j r_j p_j,      W p = (1 + e) qd_J,      r_j = dqdd/dtau_j,   W its rows of J

for the joints J that are pushed.  What holds a joint is g where it gives way: with all friction of
the joints that start as torques, the forces of what is held do no work as they start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from robodyn.dynamics.dense_dynamics import responses
from robodyn.dynamics.dynamics import motion_dynamics
from robodyn.dynamics.sticking import mode_at, resting, touching
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.kinks import kink_at
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.modes import Mode, in_mode
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.simulation.impacts import impulses
from robodyn.simulation.phases import Guard, Phases
from robodyn.simulation.varied_motion import by_numbers, holding, thrown_back, torque_slopes
from robodyn.tables.arrays import Array

Shift = Callable[[], Array]

ORDER = "joints meet their ends at one instant, and what follows depends on the order"
PRESSED = "is not known where coupled joints come to rest on their ends at one instant"
SAME = 1e-9  # part of accelerations by which they do not jump, and of T by which they are one


class Modes:
    """The slopes of a run, as `make` has them for a mode, and how s jumps between two.

    A state is q, qd, `states` of the torques' own, then s: d(q, qd) of each name, then their d z.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        make: Callable[[Mode], Callable[..., Any]],
        names: tuple[str, ...],
        sizes: tuple[float, ...],
        control: Any,
        states: int,
    ) -> None:
        self.mechanism, self.make, self.names, self.sizes = mechanism, make, names, sizes
        self.control, self.states, self.count = control, states, len(names)
        self.known: dict[Mode, Callable[..., Any]] = {}
        self.enter(Mode())
        self.shift: Shift = lambda: np.zeros(self.count)
        self.guards: list[Guard] = []  # when time went on last, and which of them ended that phase
        self.ended: Guard | None = None
        self.torques: Any = None

    def enter(self, mode: Mode) -> None:
        """The run goes on in a mode."""
        if mode not in self.known:
            self.known[mode] = self.make(mode)
        self.mode = mode
        self.now = self.known[mode]

    def __call__(self, *values: float) -> Sequence[float]:
        found: Sequence[float] = self.now(*values)
        return found

    def begin(self, phases: Phases) -> Array:
        """The start of `phases`, with s: joints may meet their ends there, or be held.

        What is held loses its rate within a time that goes with it, and by impulses so.
        """
        y, given, n = phases.y.copy(), phases.given, self.mechanism.n
        self.enter(phases.integrated)
        (q, qd), (own, first, rest, s) = phases._split(given), self._parts(y)
        if phases.hits:
            sorts = resting(self.mechanism, qd), set(touching(self.mechanism, q, qd))
            tau, ends = phases._torque(0.0, given), sorted(sorts[1] - set(phases.hits))
            was = in_mode(self.mechanism, mode_at(self.mechanism, q, qd, tau, sorts[0], ends).mode)
            rates = self._rates(phases, was, 0.0, given), self._rates(phases, phases.moving, 0.0, y)
            s = self._impact(phases, s, 0.0, given[:own], y[:own], *rates)
        for joint in sorted(phases.started):
            self._refuse(s[:, n + joint], s, joint, "starts from rest, one way or the other")
        for joint, side in sorted(phases.touches):
            self._refuse(self._gaps(joint, side, s), s, joint, "rests on its end")
            if phases.limits[joint].restitution == 1.0:
                self._refuse(s[:, n + joint], s, joint, "rests on an end that takes no energy")
        self._hold(phases, s, 0.0, q)
        y[first], y[rest] = s[:, : 2 * n].ravel(), s[:, 2 * n :].ravel()
        return y

    def _hold(self, phases: Phases, s: Array, t: float, q: Array) -> None:
        """Let joints that are held have no rates, by impulses: also where several stop at once."""
        n, held = self.mechanism.n, list(phases.mode.held)
        if not held:
            return
        lost = s[:, np.add(n, held)]
        jumps = responses(self.mechanism, q, held)
        s[:, n : 2 * n] -= lost @ np.linalg.solve(jumps[:, held], jumps)
        stopping = np.abs(lost).max(axis=0) > SAME * np.abs(s).max()
        hit = {joint for joint, _ in phases.hits}
        if any(np.any(jumps[i][list(hit - {held[i]})]) for i in np.flatnonzero(stopping)):
            raise RobodynError("sensitivity", value=f"t = {t:.6g} s", limit=ORDER)

    def _refuse(self, change: Array, s: Array, joint: int, why: str) -> None:
        """Raise InputError for a number that changes what has no derivative at the start."""
        for k in np.flatnonzero(np.abs(change) > SAME * np.abs(s).max(initial=0.0)):
            limit = f"joint {self.mechanism.link_names[joint]} {why} at the start: no derivative"
            raise InputError(self.names[k], where=self.mechanism.source, limit=limit)

    def _parts(self, y: Array) -> tuple[int, slice, slice, Array]:
        """Where s begins in a state, where its d(q, qd) and its dz are, and s (k, 2n + states)."""
        wide = 2 * self.mechanism.n
        own = wide + self.states
        first = slice(own, own + wide * self.count)
        rest = slice(first.stop, first.stop + self.states * self.count)
        parts = [y[each].reshape(self.count, -1) for each in (first, rest)]
        return own, first, rest, np.concatenate(parts, axis=1)

    def _rates(self, phases: Phases, moving: Mechanism, t: float, y: Array) -> Array:
        """Of q, qd and z in a mode."""
        q, qd = phases._split(y)
        qdd = motion_dynamics(moving, q, qd, phases._torque(t, y), t).qdd
        act = phases.actuation.function(len(q))
        return np.concatenate([qd, qdd, act(max(t, phases.after), y.tolist())[len(q) :]])

    def next(self, phases: Phases, t: float, y: Array, place: int) -> Array:
        """`phases.next`, with s."""
        guard, wide = phases.guards[place], 2 * self.mechanism.n
        own, first, rest, s = self._parts(y)
        before, guards = self._rates(phases, phases.moving, t, y), phases.guards
        shift = self._shift(phases, guard, before, s, t, y)
        found = phases.next(t, y, place)
        self.enter(phases.integrated)
        after = self._rates(phases, phases.moving, t, found)
        again = self.ended is not None and guard.joint != self.ended.joint and guard in self.guards
        if not phases.idle or again:  # else what follows at once does so whenever that is
            self.shift = shift
        if not phases.idle:
            self.guards, self.ended = guards, guard
        size = max(np.abs(before).max(), np.abs(after).max())
        if np.abs(before - after).max() > SAME * size:
            if phases.hits:
                s = self._impact(phases, s, t, y[:own], found[:own], before, after)
            else:
                s = s + self.shift()[:, None] * (before - after)
        self._hold(phases, s, t, found[: self.mechanism.n])
        found[first], found[rest] = s[:, :wide].ravel(), s[:, wide:].ravel()
        return found

    def _impact(
        self, phases: Phases, s: Array, t: float, y: Array, end: Array, before: Array, after: Array
    ) -> Array:
        """What becomes of s where joints meet hard ends, all at once or one after the other."""
        n = self.mechanism.n
        hits = list(phases.hits)
        times = [self._reached(joint, side, before, s) for joint, side in hits]
        size = np.abs(times).max() + np.abs(s).max() / np.abs(before).max()
        if np.ptp(times, axis=0).max() <= SAME * size:
            s = s + times[0][:, None] * before
            s = self._turned(y, end, s, phases.struck, t)
            return s - times[0][:, None] * after
        orders = []
        for order in (hits, hits[::-1]):
            now, f, moved = y, before, s
            for joint, side in order:
                shift = self._reached(joint, side, f, moved)[:, None]
                struck = [x for x in phases.struck if x[0] not in hits or x[0] == (joint, side)]
                then = now.copy()
                then[: 2 * n] = self._thrown(now, moved, struck)[: 2 * n]
                moved = self._turned(now, then, moved + shift * f, struck, t)
                q, qd = np.split(then[: 2 * n], 2)
                f = f.copy()
                f[:n], f[n : 2 * n] = (
                    qd,
                    motion_dynamics(self.mechanism, q, qd, phases._torque(t, then), t).qdd,
                )
                moved, now = moved - shift * f, then
            orders.append(np.concatenate([now[n : 2 * n], moved.ravel()]))
        one, other = orders
        if np.abs(one - other).max() > SAME * np.abs(one).max():
            thrown = any(e for _, e in phases.struck)
            limit = f"{ORDER}: it has no derivative there" if thrown else PRESSED
            raise RobodynError("sensitivity", value=f"t = {t:.6g} s", limit=limit)
        return np.reshape(one[n:], s.shape)

    def _reached(self, joint: int, side: int, rates: Array, s: Array) -> Array:
        """T (k,) of a joint that reaches its end."""
        return np.asarray(-self._gaps(joint, side, s) / rates[joint])

    def _gaps(self, joint: int, side: int, s: Array) -> Array:
        """How far a joint moves beyond its end (k,)."""
        end = partial(_end, joint, side)
        return np.asarray(s[:, joint] - by_numbers(self.mechanism, self.names, self.sizes, end))

    def _thrown(self, y: Array, s: Array, struck: Sequence[Any]) -> Array:
        """What `thrown_back` has of those impulses that there are."""
        wide = 2 * self.mechanism.n
        q, qd = np.split(y[:wide], 2)
        ends, e = zip(*struck, strict=True)
        p, jumps = impulses(self.mechanism, q, qd, ends, e)
        pushed: list[tuple[int, float]] = []
        chosen: list[int] = []
        for k in np.flatnonzero(p > 0.0):
            own = [*chosen, int(k)]
            if np.linalg.matrix_rank(jumps[:, own], rtol=SAME) == len(own):
                chosen = own
                pushed.append((ends[k][0], round(e[k], 12)))
        if not pushed:
            return np.concatenate([y[:wide], s[:, :wide].ravel()])
        function = thrown_back(self.mechanism, self.names, self.sizes, tuple(pushed))
        return np.array(function(*y[:wide].tolist(), *s[:, :wide].ravel().tolist()))

    def _turned(self, y: Array, end: Array, s: Array, struck: Sequence[Any], t: float) -> Array:
        """s after the impulses that make the state `end` of y."""
        wide = 2 * self.mechanism.n
        values = self._thrown(y, s, struck)
        if np.abs(values[:wide] - end[:wide]).max() > SAME * np.abs(end[:wide]).max():
            limit = "is not known where joints that stand still take part in an impact"
            raise RobodynError("sensitivity", value=f"t = {t:.6g} s", limit=limit)
        return np.concatenate([values[wide:].reshape(len(s), wide), s[:, wide:]], axis=1)

    def _shift(
        self, phases: Phases, guard: Guard, rates: Array, s: Array, t: float, y: Array
    ) -> Shift:
        """T (k,), as it is before the next phase."""
        n, (kind, joint, side) = self.mechanism.n, guard
        if kind == "slips":
            return lambda: -s[:, n + joint] / rates[n + joint]
        if kind != "holds":
            return lambda: self._reached(joint, side, rates, s)
        if kink_at(phases.actuation.kinks, t) is not None:  # the torque jumps, whatever p is
            return lambda: np.zeros(self.count)
        started, mode = phases.letting_go(guard, t, y), phases.mode
        tau = phases._torque(t, y).copy()
        friction = dict(self.mechanism.dry)
        pulls = np.zeros((self.count + 1, n))
        for k, rate in started.items():
            if k in friction:
                tau[k] -= np.sign(rate) * friction[k].static
                most = by_numbers(self.mechanism, self.names, self.sizes, partial(_static, k))
                pulls[:-1, k] = -np.sign(rate) * most

        def shift() -> Array:
            ways = np.concatenate([s, rates[None]])
            pushed = pulls + self._torque_slopes(phases, t, y, ways)
            inputs = [*y[: 2 * n].tolist(), *tau.tolist(), t]
            inputs += np.concatenate([ways[:, : 2 * n], pushed], axis=1).ravel().tolist()
            forces = holding(self.mechanism, self.names, self.sizes, mode)(*inputs)
            *by, along = np.reshape(forces, (len(ways), -1)) @ [
                started.get(k, 0.0) for k in mode.held
            ]
            return np.asarray(-np.array(by) / along)

        return shift

    def _torque_slopes(self, phases: Phases, t: float, y: Array, ways: Array) -> Array:
        """d tau (k + 1, n) along ways of the state (k + 1, 2n + states), the last with time."""
        n, acting, driven = self.mechanism.n, phases.actuation, list(self.mechanism.actuated)
        found: Array = np.zeros((len(ways), n))
        t = max(t, phases.after)
        if acting.control is not None and acting.linear:
            found[:-1, driven] = np.reshape(self.control.slopes_at(t), (len(ways) - 1, -1))
        elif acting.control is not None:
            along, given = self.control.along(len(ways), timed=True), y[: ways.shape[1]]
            both = np.concatenate([given, ways[:, : 2 * n].ravel(), ways[:, 2 * n :].ravel()])
            slopes = along(t, *both.tolist())[len(driven) + self.states :]
            found[:, driven] = np.reshape(slopes[: len(ways) * len(driven)], (len(ways), -1))
        elif acting.linear:
            found[-1] = linear_piece(acting, acting.function(n), t, y.tolist(), 1.0)[1]
        elif acting.constants is None:
            self.torques = self.torques or torque_slopes(self.mechanism, acting)
            slopes = np.reshape(self.torques(*y[: 2 * n].tolist(), t), (n, -1))
            found = ways[:, : 2 * n] @ slopes[:, :-1].T
            found[-1] += slopes[:, -1]
        return found


def _end(joint: int, side: int, scene: Any) -> Any:
    return dict(scene.links[joint].limits.ends)[side]


def _static(joint: int, scene: Any) -> Any:
    return scene.links[joint].friction.static
