"""A controller along the steps of a run: what it holds, where it jumps, how it tracks."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Sequence
from itertools import product

import numpy as np

from robodyn.control.recorded_law import RecordedLaw
from robodyn.control.tracking import ReferenceTable
from robodyn.errors import InputError
from robodyn.mechanics.kinks import Pieces
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.run_control import JointTracking
from robodyn.tables.arrays import Array

ROUNDED = 1.0 + 1e-15  # a row's time may miss that of a sample by rounding


class Tracked:
    """What the accepted steps of a run tell of the tracking error e and its rate ed.

    Between the ends of a step e is taken for the cubic that has both there.
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
        """Those that act at t, in the state y = (q, qd, ...)."""
        found: Sequence[float] = self.law(t, *y[: 2 * self.mechanism.n + self.states])
        return found[: self.reference.joints]

    def errors(self, t: Array, y: Array) -> Array:
        """q_ref - q (k, actuated) at times t (k,) and states y (k, n or more)."""
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
        """Keep the largest of sizes (k, actuated) at times t (k, actuated), and its time."""
        if len(size):
            worst = size.argmax(axis=0), np.arange(size.shape[1])
            larger = size[worst] > self._largest
            self._largest = np.where(larger, size[worst], self._largest)
            self._at = np.where(larger, t[worst], self._at)

    def tracking(self) -> list[JointTracking]:
        """Of each actuated joint."""
        mean = self._square / self._duration if self._duration else self._largest**2
        names = [self.mechanism.link_names[k] for k in self.mechanism.actuated]
        columns = (np.sqrt(mean), self._largest, self._at, self._torque)
        rows = zip(names, *(column.tolist() for column in columns), strict=True)
        return [JointTracking(*row) for row in rows]


def _extremes(cubic: tuple[Array, Array, Array, Array]) -> list[tuple[Array, Array]]:
    """Where in each step its cubic has an extreme, and how large; zero where there is none."""
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
    """A law that acts all the time."""

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
    """A law that is sampled, its torques held from one sample to the next.

    Its own states are summed up: z + zd/rate at the next sample.
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
        """The last sample at t."""
        return max(bisect_right(self.times, t * ROUNDED) - 1, 0)

    def at(self, t: float) -> Sequence[float]:
        """The torques held at t."""
        joints = self.reference.joints
        k = self.sample(t) * joints
        return self.values[k : k + joints]

    def torques(self, t: float, y: Sequence[float]) -> Sequence[float]:
        return self.at(t)
