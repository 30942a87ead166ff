"""What a controller feeds back of sensitivities: along a run the torques change with the state.

With its slopes u' = U s, z' = Z s of s = d(q, qd, z)/dp, z the integrals of the law.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism


class Fed:
    """The lines of torques that give d tau of `count` names, f0_0 .., and the rates of dz/dp.

    States are z, then d(q, qd) of each name, then dz of each.
    """

    def __init__(self, actuation: Actuation, n: int, count: int) -> None:
        self.actuation, self.n, self.count = actuation, n, count
        self.own: Any = actuation.control
        self.control: Any = actuation.control
        self.scope: dict[str, object] = {}
        if actuation.control is not None and actuation.linear:
            self.control = SampledSlopes(actuation.control, n, count)
            self.scope["_fed"] = self.control.slopes_at
        elif actuation.control is not None:
            self.scope["_fed"] = self._now

    def lines(self, mechanism: Mechanism) -> list[str]:
        """What follows the lines of the torques."""
        if self.own is None:
            return []
        m, joints = self.actuation.states, mechanism.actuated
        last = m + 2 * self.n * self.count
        fed = [f"f{k}_{j}" for k in range(self.count) for j in joints]
        fed += [f"zd{last + i}" for i in range(m * self.count)]
        if self.actuation.linear:
            return [f"{', '.join(fed)}, = _fed(t)"]
        names = [f"{name}{j}" for name in ("q", "qd") for j in range(self.n)]
        names += [f"z{i}" for i in range(last + m * self.count)]
        return [f"{', '.join(fed)}, = _fed(t, ({', '.join(names)}))"]

    def _now(self, t: float, y: Sequence[float]) -> list[float]:
        m, wide = self.actuation.states, 2 * self.n
        found = _fed(self.own, t, y[: wide + m], np.array(y[wide + m :]), self.count, m)
        joints = found.shape[1] - m
        result: list[float] = np.concatenate(
            [found[:, :joints].ravel(), found[:, joints:].ravel()]
        ).tolist()
        return result


def _fed(control: Any, t: float, state: Sequence[float], s: Any, count: int, m: int) -> Any:
    """d(u, zd) (k, joints + m) at (q, qd, z); s has d(q, qd) of each name, then dz of each."""
    slopes = control.slopes(t, state)[:, :-1]
    wide = slopes.shape[1] - m
    first = s[: wide * count].reshape(count, wide)
    rest = s[wide * count : (wide + m) * count].reshape(count, m)
    return np.concatenate([first, rest], axis=1) @ slopes.T


class SampledSlopes:
    """A controller that is sampled, and what its torques change by: held as they are."""

    def __init__(self, control: Any, n: int, count: int) -> None:
        self.control, self.n, self.count = control, n, count

    def __getattr__(self, name: str) -> Any:
        return getattr(self.control, name)

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """See `run_control.Steps`."""
        self.control.begin(y, t_end)
        self.values: list[list[float]] = []
        self.z = self.before = np.zeros((self.count, self.control.states))
        self._sample(0.0, y)

    def reach(self, t: float, y: Sequence[float]) -> None:
        """See `run_control.Steps`."""
        self.control.reach(t, y)
        if t < self.control.times[-1]:
            return
        if len(self.values) == len(self.control.times):  # that sample was taken again
            self.values.pop()
            self.z = self.before
        self._sample(t, y)

    def _sample(self, t: float, y: Sequence[float]) -> None:
        wide, m = 2 * self.n, self.control.states
        self.before = self.z
        s = np.concatenate([y[wide : wide * (1 + self.count)], self.z.ravel()])
        found = _fed(self.control, t, [*y[:wide], *self.control.before], s, self.count, m)
        joints = found.shape[1] - m
        self.values.append(found[:, :joints].ravel().tolist())
        self.z = self.z + found[:, joints:] / self.control.rate

    def slopes_at(self, t: float) -> list[float]:
        """d tau (names times joints) of what is held at t."""
        return self.values[self.control.sample(t)]
