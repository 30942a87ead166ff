"""Paths in task space: all joints from the motion of a point of the mechanism.

A point P that is led along x(u), y(u) is a closure with a guide: two slides on the ground, along Y
and along X, carry a pin on P; for an absolute angle, a link that turns there keeps P's link
aligned.  The guide's joints are the actuated ones of the guided mechanism, and its own joints are
passive.  So the code that closes loops, stays on a branch, and computes rates and accelerations
also does inverse kinematics.

Paths in the plane are lines, arcs, and splines, followed by arc length.  A curve is c(s), s from 0
to 1 the covered fraction of its length L, so that |dc/ds| = L. In the time T a profile s(u) leads
along it with speed L s'(u)/T. A further coordinate (an angle) moves along with the two of the
plane, and does not count in the length.

A natural cubic spline in tau has the length int |c_tau| dtau (Gauss-Legendre, on intervals short
enough for rounding accuracy). tau follows from it by Newton's method, and derivatives by length are

    dc/ds = L c_tau / |c_tau|       d2c/ds2 = L^2 (c_tautau - c_tau (c_tau . c_tautau) / |c_tau|^2)
                                              / |c_tau|^2

A mechanism with more freedoms than its path needs makes the least motion.  With A the columns of
Psi of the passive joints y (displacements in units of a length), D those of the actuated ones,
which follow p(u), the closures require A y' = -D p', and

    y' = -A^+ D p' + (1 - A^+ A) w         w = k s'(u) (posture - y)

is of least length (w = 0), or drawn toward a posture as far as the path permits: the free part
approaches it by exp(-k s), s(u) the quintic profile.  Its rate, with y' = w + A^T mu, is

    y'' = -A^+ (D p'' + Psidot q') + (1 - A^+ A) (w' + Adot^T mu)

(Adot^T mu by polarisation: Psidot q' is a quadratic form in q'.) y is integrated by DOP853 at a
much tighter tolerance than is reported, then closed by Newton's method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.closed_form import point_motion
from robodyn.dynamics.named_points import NamedPoint, link_turns, named_point
from robodyn.engines.factors import damped, svd
from robodyn.errors import AssemblyError, InputError, SingularError
from robodyn.loops.assembly import all_branches, assembly_plan, attempt, scene_branches
from robodyn.loops.closing import close_positions, closed_jacobians, loop_size, wrapped
from robodyn.loops.closures import closure_bias, scaled_jacobian
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.mechanics.placed import matvec, numbers
from robodyn.scene.scene import Closure, Link, Point
from robodyn.tables.arrays import Array, Truth
from robodyn.tables.csv_fields import shown
from robodyn.trajectories import joint_paths
from robodyn.trajectories.joint_paths import (
    JointPath,
    Legs,
    Pieces,
    Profile,
    Values,
    profile,
    spread,
)
from robodyn.trajectories.loop_path import (
    DEAD,
    FEWEST,
    MOST_NODES,
    LoopPath,
    PathEndError,
    Samples,
    TravelError,
    Watch,
    WholePath,
    corrected,
    largest,
    samples,
)
from robodyn.trajectories.reference import all_joints, check_driven, started

Curve = Callable[[Array], Values]  # c, dc/ds, d2c/ds2, each (T, m), at parts s (T,)

PARTS = 16  # of each piece of a spline, in which its length is integrated
CUSP = 1e-6  # part of the length a unit of tau, below which a spline stands still
HALVINGS = 60
PASSES = 8  # of Newton's method for the place at a length
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


class AlongCurve(JointPath):
    """The path along a curve of a given length (m) by a profile."""

    def __init__(self, curve: Curve, length: float, profile: Profile) -> None:
        self.curve, self.profile = curve, profile
        self.breaks, self.travel = np.array(profile.breaks), length

    def within(self, u: Array, piece: Pieces) -> Values:
        late, s, s1, s2 = self.profile.evaluate(u, 1.0 - u, piece)
        c, c1, c2 = self.curve(np.where(late, 1.0 - s, s))
        return c, c1 * s1[:, None], c1 * s2[:, None] + c2 * (s1 * s1)[:, None]


def arc(begin: Array, centre: Array, angle: float) -> tuple[Curve, float]:
    """Return the arc from `begin` (2,) about a centre (2,) by an angle (rad), and its length."""
    radius = complex(*(begin - centre))

    def curve(s: Array) -> Values:
        turned = radius * np.exp(1j * angle * s)
        first, second = 1j * angle * turned, -(angle**2) * turned
        c, c1, c2 = (np.stack([z.real, z.imag], axis=-1) for z in (turned, first, second))
        return c + centre, c1, c2

    return curve, abs(radius * angle)


def spline_curve(points: Array) -> tuple[Curve, float]:
    """Return the natural cubic spline through points (K, 2 or more), and its length.

    Two points give a line; successive points must differ.  Raises InputError if the spline turns
    back on itself, where the point's velocity would jump.
    """
    knots = spread(points[:, :2])
    of = joint_paths.spline(knots, points, "cubic", natural=True)
    edges = _finer(knots)

    def bent(tau: Array) -> list[Array]:
        return [of(tau, order) for order in range(3)]

    behind = np.append(0.0, np.cumsum(_lengths(bent, edges[:-1], edges[1:])))
    length = float(behind[-1])
    low, high = edges[:-2], edges[2:]
    turned = (bent(low)[1][:, :2] * bent(high)[1][:, :2]).sum(axis=1) < 0.0
    low, high = low[turned], high[turned]
    for _ in range(HALVINGS):  # to where the speed is least
        middle = 0.5 * (low + high)
        _, c1, c2 = (x[:, :2] for x in bent(middle))
        falls = (c1 * c2).sum(axis=1) < 0.0
        low, high = np.where(falls, middle, low), np.where(falls, high, middle)
    c, c1, _ = (x[:, :2] for x in bent(low))
    for x, y in c[np.linalg.norm(c1, axis=1) < CUSP * length]:
        limit = "without times (t) a path must not turn back on itself; split it there, or give t"
        raise InputError(f"the path turns back at ({x:.6g}, {y:.6g})", limit=limit)

    def curve(s: Array) -> Values:
        k = np.clip(np.searchsorted(behind, s * length, side="right") - 1, 0, len(edges) - 2)
        low, high = edges[k], edges[k + 1]
        wanted = s * length - behind[k]
        tau = low + (high - low) * wanted / (behind[k + 1] - behind[k])
        for _ in range(PASSES):
            speed = np.linalg.norm(bent(tau)[1][:, :2], axis=1)
            tau = np.clip(tau - (_lengths(bent, low, tau) - wanted) / speed, low, high)
        tau = np.where(s == 1.0, 1.0, tau)
        c, c1, c2 = bent(tau)
        square = (c1[:, :2] ** 2).sum(axis=1)[:, None]
        along = (c1[:, :2] * c2[:, :2]).sum(axis=1)[:, None]
        return c, length / np.sqrt(square) * c1, length**2 / square * (c2 - c1 * along / square)

    return curve, length


def length_until(path: JointPath, u: float = 1.0) -> float:
    """Return the distance (m) that the point of a path has covered at u."""
    edges = _finer(np.unique(np.append(np.clip(path.breaks, 0.0, u), u)))
    return float(_lengths(path.evaluate, edges[:-1], edges[1:]).sum())


def _finer(knots: Array) -> Array:
    whole = np.arange(len(knots))
    return np.interp(np.arange(PARTS * whole[-1] + 1) / PARTS, whole, knots)


def _lengths(curve: Callable[[Array], Sequence[Array]], begin: Array, end: Array) -> Array:
    """Return the lengths of smooth parts of a curve in the plane.

    The second value of `curve` is its derivative.
    """
    half = 0.5 * (end - begin)
    at = begin[:, None] + half[:, None] * (1.0 + NODES)
    speed = np.linalg.norm(curve(at.reshape(-1))[1][:, :2], axis=1).reshape(at.shape)
    return np.asarray(half * (speed @ WEIGHTS))


PULL = 10.0  # toward a posture, over the whole path
TOLERANCE = 1e-13  # of the integration, relative and in rad
LEAST_STEPS = 4  # of a piece
PROGRESS = profile("quintic")
REASON = "that is as far as they can be closed on this branch"


class RedundantPath(WholePath):
    """The path of least motion from the closed state `start` (n,), perhaps toward `posture`.

    Raises PathEndError if the loops cannot be closed on the whole path.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        path: JointPath,
        start: Array,
        posture: Array | None,
        watch: Watch = lambda u: None,
    ) -> None:
        from scipy.integrate import OdeSolution

        super().__init__(mechanism, path)
        self._driven, self._passive = list(mechanism.actuated), list(mechanism.passive)
        self._units = mechanism.arrays.units[self._passive]
        self._posture = None
        if posture is not None:
            turns = np.round((start - posture) / (2 * np.pi))
            turns[list(mechanism.slides)] = 0.0
            self._posture = (posture + 2 * np.pi * turns)[self._passive]
        if not self._regular(start):
            raise PathEndError(mechanism, 0.0, start, REASON)
        self._u, self._pieces = [0.0], list[int]()
        self._between = OdeSolution(*self._integrated(start, watch))

    def within(self, u: Array, piece: Pieces) -> Values:
        q, closed = self._closed(u, piece, self._between(u).T)
        if not closed.all():
            worst = int(np.argmin(closed))
            raise PathEndError(self.mechanism, float(u[worst]), q[worst], REASON)
        q1, q2 = self._rates(q, u, piece)
        return q, q1, q2

    def grid(self) -> Samples:
        pieces = np.array(self._pieces)
        share = max(4, -(-FEWEST // len(pieces)))
        return samples(np.array(self._u), pieces, np.full(len(pieces), share))

    def _integrated(self, here: Array, watch: Watch) -> tuple[list[float], list[Any]]:
        from scipy.integrate import DOP853

        between: list[Any] = []
        breaks = self.path.breaks.tolist()
        for piece, (u, end) in enumerate(pairwise(breaks)):
            of = np.array([piece])

            def rates(u: float, y: Array, of: Pieces = of) -> Array:
                at = np.array([u])
                q = self._whole(at, of, y[None])
                return np.asarray(self._rates(q, at, of, False)[0][0, self._passive])

            longest = (end - u) / LEAST_STEPS
            y, least = here[self._passive], TOLERANCE * float(self._units.min())
            solver: Any = DOP853(rates, u, y, end, longest, TOLERANCE, least)
            while solver.status == "running":
                solver.step()
                (q,), closed = self._closed(np.array([solver.t]), of, solver.y[None])
                if solver.status == "failed" or not closed[0] or not self._regular(q):
                    raise PathEndError(self.mechanism, self._u[-1], here, REASON)
                if len(self._u) > MOST_NODES:
                    limit = f"takes more than {MOST_NODES:,} steps"
                    raise TravelError(self.mechanism, f"{self.path.travel:.6g} rad", limit)
                self._u.append(solver.t)
                self._pieces.append(piece)
                between.append(solver.dense_output())
                watch(solver.t)
                here = q
        return self._u, between

    def _regular(self, q: Array) -> bool:
        s = np.linalg.svd(
            scaled_jacobian(self.mechanism, q, 0.0)[:, self._passive], compute_uv=False
        )
        return bool(s[-1] > DEAD * loop_size(self.mechanism))

    def _whole(self, u: Array, piece: Pieces, y: Array) -> Array:
        q = np.empty((len(u), self.mechanism.n))
        q[:, self._driven], q[:, self._passive] = self.path.evaluate(u, piece)[0], y
        return q

    def _closed(self, u: Array, piece: Pieces, y: Array) -> tuple[Array, Truth]:
        return corrected(self.mechanism, self._whole(u, piece, y), 0.0)

    def _rates(self, q: Array, u: Array, piece: Pieces, second: bool = True) -> tuple[Array, Array]:
        """Return q' and, if `second`, q'' at states q (T, n)."""
        mechanism, units = self.mechanism, self._units
        _, p1, p2 = self.path.evaluate(u, piece)
        Psi = scaled_jacobian(mechanism, q, 0.0)
        D = Psi[..., self._driven] / mechanism.arrays.units[self._driven]
        U, s, Vt = svd(Psi[..., self._passive])
        up, rows = np.swapaxes(U, -1, -2), np.swapaxes(Vt, -1, -2)

        def onto(right: Array) -> Array:
            return matvec(rows, matvec(up, right) / s)

        def free(x: Array) -> Array:
            return np.asarray(x - matvec(rows, matvec(Vt, x)))

        pull = pull1 = np.zeros_like(q[:, self._passive])
        if self._posture is not None:
            _, s1, s2 = (x[:, None] for x in PROGRESS.half(u, u < 0.0))
            away = (self._posture - q[:, self._passive]) / units
            pull = PULL * s1 * away
        q1, q2 = np.zeros_like(q), np.zeros_like(q)
        y1 = onto(-matvec(D, p1)) + free(pull)
        q1[:, self._driven], q1[:, self._passive] = p1, units * y1
        if second:
            if self._posture is not None:
                pull1 = PULL * (s2 * away - s1 * y1)
            mu = matvec(U, matvec(Vt, y1 - pull) / s)
            size = np.abs(q1).max(axis=1)[:, None, None]
            way = np.where(size > 0.0, size, 1.0) * (
                units[:, None] * np.eye(mechanism.n)[self._passive]
            )
            two = [closure_bias(mechanism, q[:, None], q1[:, None] + x, 0.0) for x in (way, -way)]
            bent = matvec((two[0] - two[1]) / (4.0 * np.where(size > 0.0, size, 1.0)), mu)
            y2 = onto(-matvec(D, p2) - closure_bias(mechanism, q, q1, 0.0)) + free(pull1 + bent)
            q2[:, self._driven], q2[:, self._passive] = p2, units * y2
        return q1, q2


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
        """The number of coordinates: x, y, and perhaps the angle of the point's link."""
        return self.guided.n - self.mechanism.n

    def place(self, q: Array) -> Array:
        """Return the coordinates (..., 2 or 3) at q (..., n), m and rad."""
        xy = point_motion(self.mechanism, [self.of.point], q)[0][..., 0, :]
        if self.coordinates == 2:
            return xy
        turns = link_turns(self.mechanism, q, np.zeros_like(q), np.zeros_like(q))[0]
        return np.concatenate([xy, turns[..., self.of.own.link, None]], axis=-1)

    def with_guide(self, q: Array, place: Array) -> Array:
        """Return the state (n + guide) from q (n,) and its coordinates."""
        whole = np.concatenate([q, np.zeros(self.coordinates)])
        whole[list(self.guided.actuated)] = place
        return whole


def task_of(mechanism: Mechanism, of: NamedPoint, angle: bool = False) -> Task:
    """Return the task that leads a point, and with `angle` its link's angle.

    Raises InputError if fewer freedoms than coordinates move the point, or if joints are not
    actuated.
    """
    refuse_driven(mechanism, "a path of a point")
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
    """The path of all joints for a point that follows a path of its coordinates.

    It begins at the closed state `start` (n,) with the point at the path's start.  A redundant
    mechanism is drawn toward `posture` (n,).  Raises AssemblyError if the path leaves the workspace
    or meets a singularity.
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
        """The largest speed of the point by u, m."""
        return largest(
            lambda *at: np.linalg.norm(self.path.within(*at)[1][:, :2], axis=1, keepdims=True),
            self.grid(),
        )

    def _end(self, error: PathEndError) -> AssemblyError:
        """Return the error for the end of a path: the covered length, the place, and the excess."""
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
    """Return the distance between the point and the farthest of places (k, c), m.

    q (n + guide,) is closed.  Uses Levenberg-Marquardt steps on closed states with free x and y.
    Distant places count as if they were at arm's length, since only their direction matters.
    """
    guided, rng = task.guided, np.random.default_rng(0)
    free = list(range(guided.n))[: task.mechanism.n + 2]
    xy, held = list(guided.actuated[:2]), list(guided.actuated[2:])
    begins = q + 0.3 * rng.normal(size=(TRIES, guided.n)) * guided.arrays.units
    begins[0] = q
    missed, reach = 0.0, 0.5 * loop_size(guided)
    for place in places:
        begins[:, held] = place[2:]
        here = close_positions(guided, begins, held, t=0.0)
        damping = np.ones(TRIES)
        for _ in range(STEPS):
            off = place[:2] - here[:, xy]
            far = np.linalg.norm(off, axis=1)
            pull = off * (reach / np.maximum(far, reach))[:, None]
            _, s, Vt = svd(scaled_jacobian(guided, here, 0.0)[..., free], full=True)
            N = np.swapaxes(Vt[:, s.shape[1] :], -1, -2)
            G = N[:, xy] * guided.arrays.units[xy, None]
            way = damped(G, pull, damping * (G * G).sum(axis=(1, 2)))
            trial = here.copy()
            trial[:, free] += matvec(N, way) * guided.arrays.units[free]
            trial = close_positions(guided, trial, held, t=0.0)
            better = np.linalg.norm(place[:2] - trial[:, xy], axis=1) < far
            here = np.where(better[:, None], trial, here)
            damping = np.where(better, 0.1 * damping, 10.0 * damping)
            if (np.abs(way) < SETTLED).all():
                break
        missed = max(missed, float(np.linalg.norm(place[:2] - here[:, xy], axis=1).min()))
    return missed


def pose_of(task: Task, pose: Array) -> Array:
    """Return the closed state (n,) of a pose (n,) with NaN for passive joints not given."""
    mechanism = task.mechanism
    begin = started(mechanism, pose, pose[list(mechanism.actuated)])
    return close_positions(mechanism, begin, mechanism.actuated, t=0.0)


MOST_WAYS = 8  # of dyads with two branches each, of which the nearest is looked for


def inverse_kinematics(
    mechanism: Mechanism,
    xy: ArrayLike,
    of: str,
    angle: ArrayLike | None = None,
    near: ArrayLike | None = None,
) -> Array:
    """Return the joints q (..., n) that bring the point `of` to places xy (..., 2), m.

    q is in rad, or m.  `angle` (...) also asks for the absolute angle of the point's link, rad.
    The places follow one another along one branch: the branch nearest to the pose `near` (n, or
    actuated) at the first place, or that of the scene's `assembly` (`open` for the point itself).
    Chains of dyads are solved in closed form.  Otherwise, and for redundant mechanisms (by least
    motion), Newton's method follows straight lines from `near` and from place to place.

    Raises InputError for wrong arguments, AssemblyError if a place is out of reach, and
    SingularError if links on the way may have any direction.
    """
    named = named_point(mechanism, of, "of")
    places = numbers("xy", xy)
    if places.ndim == 0 or places.shape[-1] != 2 or not np.isfinite(places).all():
        raise InputError("xy", value=places.shape, limit="must be (..., 2), finite: x and y, m")
    shape = places.shape[:-1]
    if angle is not None:
        try:
            turned = np.broadcast_to(numbers("angle", angle), shape)[..., None]
        except ValueError:
            turned = np.array([np.nan])
        if not np.isfinite(turned).all():
            raise InputError("angle", limit=f"must be {shape}, one a place, and finite")
        places = np.concatenate([places, turned], axis=-1)
    task = task_of(mechanism, named, angle is not None)
    pose = None
    if near is not None:
        pose = pose_of(task, all_joints(mechanism, numbers("near", near)[None])[0])
    q = along_branch(task, places.reshape(-1, places.shape[-1]), pose)
    return q.reshape(*shape, mechanism.n)


def along_branch(task: Task, places: Array, pose: Array | None) -> Array:
    """Return q (K, n) at places (K, c), on the branch nearest to a closed pose (n,)."""
    n = task.mechanism.n
    if not len(places):
        return np.zeros((0, n))
    if not is_dyads(task):
        if pose is None:
            raise InputError("near", limit="missing: give the pose that it begins from")
        return _followed(task, places, pose)
    branches = _nearest_branches(task, places[0], pose)
    whole, missing = attempt(task.guided, places, branches, t=0.0)
    if not (missing <= 0.0).all():
        k = int(np.argmin(missing <= 0.0))
        at = f"({places[k, 0]:.9g}, {places[k, 1]:.9g})"
        if np.isnan(missing[k]):
            what = f"singular configuration: {task.of.name} at {at}"
            limit = "any direction of the links leads there: choose a place beside it"
            raise SingularError(what, where=task.mechanism.source, limit=limit)
        what = f"{task.of.name} does not reach {at}"
        limit = f"place {k + 1} is {missing[k]:.9g} m out of reach"
        raise AssemblyError(what, where=task.mechanism.source, limit=limit)
    q: Array = whole[:, :n]
    turning = [k for k in range(n) if k not in task.mechanism.slides]
    first = q[:1, turning].copy()
    if pose is not None:
        first -= 2 * np.pi * np.round((first - pose[turning]) / (2 * np.pi))
    q[:, turning] = np.unwrap(np.concatenate([first, q[:, turning]]), axis=0)[1:]
    return q


def is_dyads(task: Task) -> bool:
    """Return whether there is a closed form."""
    if task.redundant or task.mechanism.description.couplings:  # couplings count turns
        return False
    try:
        plan = assembly_plan(task.guided)
    except InputError:
        return False
    return not plan.rest and len(plan.two_way) <= MOST_WAYS


def _nearest_branches(task: Task, place: Array, pose: Array | None) -> tuple[str, ...]:
    """Return the words of the closing branch nearest to a pose at a place."""
    words = scene_branches(task.guided)
    if pose is None:
        return words
    best, n = np.inf, task.mechanism.n
    for trial in all_branches(task.guided):
        q, missing = attempt(task.guided, place, trial, t=0.0)
        away = float(np.linalg.norm(wrapped(task.mechanism, q[:n] - pose)))
        if missing <= 0.0 and away < best:
            best, words = away, trial
    return words


def _followed(task: Task, places: Array, pose: Array) -> Array:
    """Return q by Newton's method along straight lines from the pose and between places."""
    points = np.concatenate([task.place(pose)[None], places])
    points[0, 2:] -= 2 * np.pi * np.round((points[0, 2:] - places[0, 2:]) / (2 * np.pi))
    moved = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 0.0)
    stations = points[moved]
    if len(stations) == 1:
        return np.repeat(pose[None], len(places), axis=0)
    knots = spread(stations)
    path = TaskPath(task, Legs(stations, knots, profile("constant")), pose)
    q: Array = path.evaluate(knots)[0][np.cumsum(moved)[1:] - 1]
    return q
