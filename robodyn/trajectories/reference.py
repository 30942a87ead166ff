"""Reference motions: the joints of a mechanism led through points at given times.

The path is that of the actuated joints (`joint_paths.py`).  In a closed mechanism the other joints
follow along one branch (`loop_path.py`).  With duration T and u = t/T

    q = q(u)        qd = q'(u) / T        qdd = q''(u) / T^2
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.dynamics.joint_vectors import full
from robodyn.errors import InputError, SingularError
from robodyn.loops.closing import wrapped
from robodyn.mechanics.driven import check_torques
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr
from robodyn.trajectories.joint_paths import ACCELERATION, JointPath, Legs, Spline, path_through
from robodyn.trajectories.loop_path import Clock, LoopPath, PathEndError, Watch, WholePath

LONGEST = 1e100  # s
SAME = 1e-4  # rad, by which a passive angle that is given may miss the one that is reached


@short_repr
@dataclass(frozen=True, slots=True)
class ReferenceMotion:
    """A motion of all joints from time `begin` for `duration`, s."""

    mechanism: Mechanism
    path: WholePath
    duration: float
    begin: float = 0.0

    @property
    def end(self) -> float:
        return self.begin + self.duration

    def states(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return q, qd, qdd (..., n) at times t (...) from `begin` to `end`.

        In rad, rad/s, rad/s^2, or m.  At a jump of qdd, the value after it.  Raises InputError for
        other times, and SingularError if the actuated joints do not determine the others.
        """
        times = np.asarray(t, float)
        slack = 1e-9 * self.duration + 4 * math.ulp(abs(self.end))
        if not ((times >= self.begin - slack) & (times <= self.end + slack)).all():
            limit = f"must be from {self.begin:g} to {self.end:g} s"
            raise InputError("t", limit=limit)
        u = np.clip((times.reshape(-1) - self.begin) / self.duration, 0.0, 1.0)
        u[times.reshape(-1) >= self.end] = 1.0
        try:
            values = self.path.evaluate(u)
        except SingularError:  # the time of the first belongs to it
            for part in u.tolist():
                try:
                    self.path.evaluate(np.array([part]))
                except SingularError as error:
                    error.add_place(f"t = {self.begin + part * self.duration:.6g} s")
                    raise
            raise
        q, q1, q2 = (x.reshape(*times.shape, self.mechanism.n) for x in values)
        return q + 0.0, q1 / self.duration + 0.0, q2 / self.duration**2 + 0.0  # + 0.0: no -0.0


def reference_motion(
    mechanism: Mechanism,
    points: ArrayLike,
    duration: float | None = None,
    *,
    times: ArrayLike | None = None,
    profile: str = "quintic",
    acceleration: float = ACCELERATION,
    natural: bool = False,
) -> ReferenceMotion:
    """Return the motion through points (K, actuated) or (K, n), at rest at both ends.

    In a closed mechanism, a first point with all joints selects the branch; otherwise the scene's
    `assembly` does.  `times` (K,) in s belong to the points; without them `duration` is spread in
    proportion to distances in joint space.

    `profile` is cubic or quintic (through more than two points a C2 or C4 spline; `natural`: a
    cubic spline with qdd = 0 at its ends in place of qd = 0), or trapezoidal or cycloidal, which
    stop at each point.  `acceleration` is the fraction of the time in which a trapezoidal one
    speeds up, > 0 and <= 1/2.

    Raises InputError for wrong arguments, AssemblyError if a loop cannot be closed on the way, and
    SingularError if the actuated joints do not determine the others.  Warns (RobodynWarning) of a
    change point that the loops just miss.
    """
    full = all_joints(mechanism, points)
    if (duration is None) == (times is None):
        raise InputError("duration and times", limit="give one of them")
    path = path_through(full[:, list(mechanism.actuated)], times, profile, acceleration, natural)
    if times is not None:
        stamps = np.asarray(times, float)
        return motion_along(mechanism, path, full, float(np.ptp(stamps)), float(stamps[0]))
    assert duration is not None
    return motion_along(mechanism, path, full, duration)


def motion_along(
    mechanism: Mechanism,
    path: JointPath,
    points: Array,
    duration: float,
    begin: float = 0.0,
    watch: Watch = lambda u: None,
) -> ReferenceMotion:
    """Return the motion along a path of the actuated joints, from the first of points (K, n).

    Passive positions that are not NaN must be those that the motion reaches.  `watch` is called
    with the followed part of the loops, 0 to 1.
    """
    check_duration(duration)
    clock = Clock(begin, duration) if mechanism.driven else Clock()
    try:
        whole = whole_path(mechanism, path, points, watch, clock)
    except PathEndError as error:
        error.what = f"t = {begin + error.u * duration:.6g} s: {error.what}"
        raise
    return ReferenceMotion(mechanism, whole, duration, begin)


def whole_path(
    mechanism: Mechanism,
    path: JointPath,
    points: Array,
    watch: Watch = lambda u: None,
    clock: Clock = Clock(),
) -> WholePath:
    """Return the path of all joints; `points` (K, n) as for `motion_along`."""
    if not mechanism.passive and not mechanism.rows:
        return WholePath(mechanism, path)
    driven, passive = list(mechanism.actuated), list(mechanism.passive)
    check_driven(mechanism)
    first = path.evaluate(np.zeros(1))[0][0]
    start = started(mechanism, points[0], first, clock.begin)
    start[driven] = first
    whole = LoopPath(mechanism, path, start, watch, clock)
    if remark := whole.remark:
        warnings.warn(remark, RobodynWarning, stacklevel=2)
    given = ~np.isnan(points).any(axis=1)
    if isinstance(path, Legs | Spline) and len(points) == len(path.knots) and given.any():
        # the points given in full must be on the branch of the motion
        reached = whole.evaluate(path.knots[given])[0]
        miss = wrapped(mechanism, reached - points[given])
        for at, place in np.argwhere(np.abs(miss[:, passive]) > SAME):
            number, joint = np.flatnonzero(given)[at], passive[place]
            right = f"q{joint + 1} = {reached[at, joint]:.9g}"
            raise InputError(
                f"point {number + 1}: q{joint + 1} ({mechanism.link_names[joint]})",
                value=f"{points[number, joint]:.9g}",
                limit=f"on the branch of the first point {right} there",
            )
    return whole


def check_duration(duration: float) -> None:
    if not (math.isfinite(duration) and duration > 0.0):
        raise InputError("duration", value=duration, limit="must be > 0 and finite")
    if duration > LONGEST:
        raise InputError("duration", value=duration, limit=f"must be <= {LONGEST:g} s")


def check_driven(mechanism: Mechanism) -> None:
    """Raise InputError if actuated joints are fewer than freedoms, or laws drive all joints."""
    check_torques(mechanism)
    driven, freedoms = len(mechanism.actuated), mechanism.n - len(mechanism.rows)
    if driven < freedoms:
        names = ", ".join(f"q{k + 1} ({mechanism.link_names[k]})" for k in mechanism.passive)
        what = f"the actuated joints do not determine {names}"
        limit = f"{freedoms} freedoms need as many actuated joints, {driven} are named"
        raise InputError(what, where=mechanism.source, limit=limit)


def started(mechanism: Mechanism, pose: Array, driven: Array, t: float = 0.0) -> Array:
    """Return the closed state (n,) of a pose (n,) at t; passive joints with NaN are assembled."""
    whole = not np.isnan(pose).any()
    return full(mechanism, {"q": (pose if whole else driven, whole)}, t=t)["q"].copy()


def all_joints(mechanism: Mechanism, points: ArrayLike) -> Array:
    """Return points (K, n) from (K, n) or (K, actuated), with NaN for missing passive joints."""
    given = np.array(points, dtype=float)
    n, driven = mechanism.n, list(mechanism.actuated)
    if given.ndim != 2 or given.shape[1] not in (n, len(driven)):
        limit = f"must be (K, {len(driven)}), the actuated joints, or (K, {n}), all joints"
        raise InputError("points.shape", value=given.shape, limit=limit)
    if not np.isfinite(given).all():
        raise InputError("points", limit="must be finite")
    if given.shape[1] == n:
        return given
    full = np.full((len(given), n), np.nan)
    full[:, driven] = given
    return full
