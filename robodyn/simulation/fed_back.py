"""What a controller feeds back of sensitivities: along a run the torques change with the state.

With its slopes u' = U s, z' = Z s of s = d(q, qd, z)/dp, z the integrals of the law.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism


class Fed:
    """The lines of torques, with d tau of `count` names, f0_0 .., and the rates of dz/dp.

    States are z, then d(q, qd) of each name, then dz of each.
    """

    def __init__(self, actuation: Actuation, n: int, count: int) -> None:
        self.actuation, self.n, self.count = actuation, n, count
        self.control: Any = actuation.control
        self.scope: dict[str, object] = {}
        if actuation.control is not None and actuation.linear:
            self.control = SampledSlopes(actuation.control, n, count)
            self.scope["_fed"] = self.control.slopes_at
        elif actuation.control is not None:
            self.scope["_fed"] = actuation.control.along(count)

    def lines(self, mechanism: Mechanism) -> list[str]:
        """Those of the torques and what follows them."""
        if self.actuation.constants is not None:
            return [f"tau{j} = {x!r}" for j, x in enumerate(self.actuation.constants)]
        if self.control is None:
            return [*self.actuation.lines]
        m, joints = self.actuation.states, mechanism.actuated
        last = m + 2 * self.n * self.count
        fed = [f"f{k}_{j}" for k in range(self.count) for j in joints]
        if self.actuation.linear:
            return [*self.actuation.lines, f"{', '.join(fed)}, = _fed(t)"]
        fed = [f"tau{j}" for j in joints] + self.actuation.own("zd") + fed
        fed += [f"zd{last + i}" for i in range(m * self.count)]
        names = [f"{name}{j}" for name in ("q", "qd") for j in range(self.n)]
        names += [f"z{i}" for i in range(last + m * self.count)]
        zeros = [f"tau{j} = 0.0" for j in mechanism.passive]
        return [f"{', '.join(fed)}, = _fed(t, {', '.join(names)})", *zeros]


class SampledSlopes:
    """A controller that is sampled, and what its torques change by: held as they are."""

    def __init__(self, control: Any, n: int, count: int) -> None:
        self.control, self.n, self.count = control, n, count
        self.law, self.joints = control.along(count), control.reference.joints

    def __getattr__(self, name: str) -> Any:
        return getattr(self.control, name)

    def begin(self, y: Sequence[float], t_end: float) -> None:
        """See `run_control.Steps`."""
        self.control.begin(y, t_end)
        self.values: list[tuple[float, ...]] = []
        self.z = self.before = [0.0] * (self.count * self.control.states)
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
        wide, control = 2 * self.n, self.control
        self.before = self.z
        s = y[wide : wide * (1 + self.count)]
        found = self.law(t, *y[:wide], *control.before, *s, *self.z)
        first = self.joints + control.states
        last = first + self.joints * self.count
        self.values.append(found[first:last])
        rates = found[last:]
        self.z = [z + zd / control.rate for z, zd in zip(self.z, rates, strict=True)]

    def slopes_at(self, t: float) -> tuple[float, ...]:
        """d tau (names times joints) of what is held at t."""
        place: int = self.control.sample(t)
        return self.values[place]
