"""Paths in task space: all joints from where a point of the mechanism goes.

A point P that is led along x(u), y(u) is a closure with a guide: two slides on the ground, along Y
and along X, carry a pin on P, and for an absolute angle a link that turns there keeps P's link
aligned.  The guide's joints are the actuated ones of the mechanism so guided, and its own joints
are passive: what closes loops in closed form or by Newton's method, stays on a branch, and has
rates and accelerations, is then inverse kinematics as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robodyn.dynamics.closed_form import point_motion, scaled_jacobian
from robodyn.dynamics.placed import matvec
from robodyn.engines.singular_values import damped, svd
from robodyn.errors import AssemblyError, InputError
from robodyn.kinematics.named_points import NamedPoint
from robodyn.kinematics.point_motion import link_turns
from robodyn.loops.assembly import scene_branches
from robodyn.loops.closing import close_positions, closed_jacobians, loop_size
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.scene import Closure, Link, Point
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.trajectories.continuation import PathEndError, TravelError, Watch
from robodyn.trajectories.joint_paths import JointPath, Pieces, Values
from robodyn.trajectories.loop_path import LoopPath, Samples, WholePath, largest
from robodyn.trajectories.plane_paths import length_until
from robodyn.trajectories.redundant_path import RedundantPath
from robodyn.trajectories.reference import check_driven, started

MOVES = 1e-8  # part of the loop's size above which a singular value tells a freedom
BEYOND = 1e-7  # part of the loop's size, of a point that is out of reach
ROUNDING = 1e-9  # by which peaks are told too large
LOOKED_AT = 17  # places of the path beyond its end at which the point is out of reach
TRIES = 4  # configurations from which it is sought how near it comes
STEPS = 60
SETTLED = 1e-8  # rad, of the last step


class Task(NamedTuple):
    """A mechanism, a point of it, and the mechanism with this point guided."""

    mechanism: Mechanism
    of: NamedPoint
    guided: Mechanism
    redundant: bool  # freedoms are left over

    @property
    def coordinates(self) -> int:
        """x, y and perhaps the angle of the point's link."""
        return self.guided.n - self.mechanism.n

    def place(self, q: Array) -> Array:
        """The coordinates (..., 2 or 3) at q (..., n), m and rad."""
        xy = point_motion(self.mechanism, [self.of.point], q)[0][..., 0, :]
        if self.coordinates == 2:
            return xy
        turns = link_turns(self.mechanism, q, np.zeros_like(q), np.zeros_like(q))[0]
        return np.concatenate([xy, turns[..., self.of.own.link, None]], axis=-1)

    def with_guide(self, q: Array, place: Array) -> Array:
        """The state (n + guide) from q (n,) and its coordinates."""
        whole = np.concatenate([q, np.zeros(self.coordinates)])
        whole[list(self.guided.actuated)] = place
        return whole


def task_of(mechanism: Mechanism, of: NamedPoint, angle: bool = False) -> Task:
    """The task that leads a point, and with `angle` its link's angle.

    Raises InputError where fewer freedoms than coordinates move the point, or joints are not
    actuated.
    """
    check_driven(mechanism)
    described, n = mechanism.description, mechanism.n
    # the second is turned so that its frame is X's
    guides = ("along Y", None, 1j), ("along X", n, -1j), ("that turns", n + 1, None)
    links = [
        Link(f"guide {way}", 0.0, 0.0, 0j, 0.0, Point(on, 0j), axis=axis)
        for way, on, axis in guides[: 2 + angle]
    ]
    end = Point(n + len(links) - 1, 0j)
    if angle and mechanism.frames[of.own.link or 0] is None:
        limit = f"{mechanism.link_names[of.own.link or 0]} does not turn"
        raise InputError("angle", where=mechanism.source, limit=limit)
    closure = Closure(of.own, end, aligned=0.0 if angle else None)
    guided = build(
        described._replace(
            links=(*described.links, *links),
            closures=(*described.closures, closure),
            branches=(*scene_branches(mechanism), "open"),
            actuated=(n + 1, n, n + 2)[: len(links)],
            start=None,
            springs=(),
            loads=(),
        )
    )
    Psi, least = closed_jacobians(guided), MOVES * loop_size(guided)
    whole, own = (np.linalg.matrix_rank(x, tol=least).max() for x in (Psi, Psi[..., :n]))
    if own < whole:
        has = len(links) - int(whole - own)
        names = "x, y and the angle" if angle else "x and y"
        limit = f"moves with {has} freedom{'' if has == 1 else 's'}; {names} need {len(links)}"
        raise InputError("of", where=mechanism.source, value=shown(of.name), limit=limit)
    return Task(mechanism, of, guided, bool(n > own))


class TaskPath(WholePath):
    """The path of all joints where the point follows a path of its coordinates.

    It begins at the closed state `start` (n,), the point at the path's start; `posture` (n,) is
    what a redundant mechanism is pulled to.  Raises AssemblyError where the path leaves the
    workspace, or meets a singularity.
    """

    def __init__(
        self,
        task: Task,
        path: JointPath,
        start: Array,
        posture: Array | None = None,
        watch: Watch = lambda u: None,
    ) -> None:
        super().__init__(task.mechanism, path)
        self._task = task
        begin = task.with_guide(start, path.evaluate(np.zeros(1))[0][0])
        self._of: WholePath
        try:
            if task.redundant:
                if posture is not None:
                    posture = task.with_guide(posture, np.zeros(task.coordinates))
                self._of = RedundantPath(task.guided, path, begin, posture, watch)
            else:
                self._of = LoopPath(task.guided, path, begin, watch)
        except PathEndError as error:
            raise self._end(error) from None
        except TravelError as error:
            error.value = str(error.value).replace("rad", "m")
            raise

    def within(self, u: Array, piece: Pieces) -> Values:
        n = self.mechanism.n
        q, q1, q2 = (x[:, :n] for x in self._of.within(u, piece))
        return q, q1, q2

    def grid(self) -> Samples:
        return self._of.grid()

    def driven(self, u: Array, piece: Pieces) -> Values:
        q, q1, q2 = (x[:, self.mechanism.actuated] for x in self.within(u, piece))
        return q, q1, q2

    def peaks(self) -> Array:
        return (1.0 + ROUNDING) * self.largest(self.grid())

    def fastest(self) -> float:
        """The largest speed of the point in u, m."""
        return largest(
            lambda *at: np.linalg.norm(self.path.within(*at)[1][:, :2], axis=1, keepdims=True),
            self.grid(),
        )

    def _end(self, error: PathEndError) -> AssemblyError:
        """What is told of the end of a path: at which length, where, how far beyond is out."""
        task, u = self._task, error.u
        behind, length = length_until(self.path, u), length_until(self.path)
        beyond = self.path.evaluate(np.linspace(u, 1.0, LOOKED_AT)[1:])[0]
        missed = out_of_reach(task, error.q, beyond)
        x, y = self.path.evaluate(np.array([u]))[0][0, :2]
        at = f"{behind:.6g} m along its path of {length:.6g} m, at ({x:.6g}, {y:.6g})"
        what, limit = "meets a singularity", "the joints cannot go on from there on this branch"
        if missed > BEYOND * loop_size(task.guided):
            what = "leaves the workspace"
            limit = f"what follows is up to {missed:.6g} m out of reach"
        what = f"{task.of.name} {what} {at}"
        return AssemblyError(what, where=self.mechanism.source, limit=limit)


def out_of_reach(task: Task, q: Array, places: Array) -> float:
    """How far the point stays from the farthest of places (k, c), m; q (n + guide,) is closed.

    Levenberg and Marquardt's method on closed states whose x and y are free; what is far pulls as
    if it were at a distance like the arm's, for only the direction tells where it is nearest.
    """
    guided, rng = task.guided, np.random.default_rng(0)
    free = list(range(guided.n))[: task.mechanism.n + 2]
    xy, held = list(guided.actuated[:2]), list(guided.actuated[2:])
    begins = q + 0.3 * rng.normal(size=(TRIES, guided.n)) * guided.arrays.units
    begins[0] = q
    missed, reach = 0.0, 0.5 * loop_size(guided)
    for place in places:
        begins[:, held] = place[2:]
        here = close_positions(guided, begins, held)
        damping = np.ones(TRIES)
        for _ in range(STEPS):
            off = place[:2] - here[:, xy]
            far = np.linalg.norm(off, axis=1)
            pull = off * (reach / np.maximum(far, reach))[:, None]
            _, s, Vt = svd(scaled_jacobian(guided, here)[..., free], full=True)
            N = np.swapaxes(Vt[:, s.shape[1] :], -1, -2)
            G = N[:, xy] * guided.arrays.units[xy, None]
            way = damped(G, pull, damping * (G * G).sum(axis=(1, 2)))
            trial = here.copy()
            trial[:, free] += matvec(N, way) * guided.arrays.units[free]
            trial = close_positions(guided, trial, held)
            better = np.linalg.norm(place[:2] - trial[:, xy], axis=1) < far
            here = np.where(better[:, None], trial, here)
            damping = np.where(better, 0.1 * damping, 10.0 * damping)
            if (np.abs(way) < SETTLED).all():
                break
        missed = max(missed, float(np.linalg.norm(place[:2] - here[:, xy], axis=1).min()))
    return missed


def pose_of(task: Task, pose: Array) -> Array:
    """The closed state (n,) of a pose (n,), NaN where passive joints are not given."""
    mechanism = task.mechanism
    begin = started(mechanism, pose, pose[list(mechanism.actuated)])
    return close_positions(mechanism, begin, mechanism.actuated)
