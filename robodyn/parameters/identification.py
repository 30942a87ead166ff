"""Parameters of a mechanism from its torques along a motion, by least squares.

The rows Y pi = tau - known are reduced to a triangle R for each actuated joint, block by block, so
that memory holds one block however long the motion is.  Joints are weighted by what the first fit
leaves of their torques.  With r = R pi - s, what changes from the scene's pi0 is either

    base parameters    linear: columns that others make, at all states or in this motion, keep the
                       scene's numbers
    named numbers      masses, centres of gravity, .. x, by scipy's least_squares: r(pi(x))

A joint with static friction that rests is held by any force within its band, so its equation tells
nothing: rows in which it rests are left out of it.

With `physical`, where what was found is no body (m > 0, I > 0, no damping below 0), the numbers are
sought between these bounds.  The standard errors are those of independent
noise of each joint's torque.

Named numbers that torques depend on linearly, or through the centre of gravity, are
`links.forearm.m`, `.r` (`.r[0]`, `.r[1]`), `.I`, `.payload`, `.damping`, `.friction.torque`,
`.motor.inertia`, .., `springs[0].stiffness`: what data of torques tell.  Each has a place in the
description: names and indices that lead to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import point_motion
from robodyn.dynamics.free_joints import balanced_joints, balanced_mechanism
from robodyn.elements.base import Element
from robodyn.elements.keys import WAYS, Declared
from robodyn.elements.springs import JointSpring
from robodyn.engines.expression import Graph, slopes_by, substituted
from robodyn.engines.planar_numbers import Planar
from robodyn.errors import InputError
from robodyn.mechanics.driven import check_times, check_torques
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters.base_parameters import (
    EXCITED,
    base_parameters,
    dependence,
    excited,
    structural,
)
from robodyn.parameters.regression_matrix import (
    INERTIAL,
    LISTS,
    Regressor,
    linear_parameters,
    regressor,
    rows_at_rest,
    with_formulas,
)
from robodyn.scene.scene import Description, Link, Point
from robodyn.scene.scene_values import SceneValues
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

BLOCK = 1 << 14  # states whose Y is held at once
LARGEST = 1e100  # N m: squares of torques are summed
QUIET = 1e-10  # part of a joint's torques below which what is left of them weighs no more
TIGHT = 1e-14  # of scipy's tolerances
HOLD = 1e-7  # weight of the scene's own numbers, beside the data's, where these tell nothing


@short_repr
class Estimate(NamedTuple):
    """A number that was found, its standard error, and what the scene has."""

    name: str
    value: float
    error: float
    scene: float
    unit: str = ""


@short_repr
class Identification(NamedTuple):
    """The result of an identification.

    `kept` are combinations or numbers that the data do not determine, which keep the scene's
    values.  `condition` belongs to the fitted columns, each scaled to 1.  `rms` (a,) is the
    residual of the torques of actuated and free joints, `rms_torque` their size, both without the
    rows `at_rest` (T, a) that are left out of a torque's equations.
    """

    estimates: tuple[Estimate, ...]
    kept: tuple[str, ...]
    condition: float
    rows: int
    rms: Array
    rms_torque: Array
    description: Description  # the scene with the numbers that were found
    pi: Array  # its parameters, in the order of `linear_parameters`
    faults: tuple[str, ...]  # why that is no scene, if it is none
    at_rest: NDArray[np.bool_]  # (T, a)


# estimates, what is kept, the condition, the change of pi, and the scene with it
_Found = tuple[tuple[Estimate, ...], tuple[str, ...], float, Array, Description]


def identify(
    mechanism: Mechanism,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    tau: ArrayLike,
    t: ArrayLike | None = None,
    of: str | Sequence[str] = (),
    physical: bool = False,
    rest: float | None = None,
) -> Identification:
    """Parameters from the torques tau (T, a) of the actuated joints along q, qd, qdd (T, n).

    tau may be that of all joints, (T, n), zero at passive ones.  Free joints of an open chain have
    none, which tells something too.  Laws of the time need the times t (T,), loads and gravity that
    vary take 0 without.  Base parameters are found, or the numbers `of` these names, or
    of one name, such as `links.forearm.m`.  A joint with static friction whose rate is `rest`
    (rad/s, m/s) at most is at rest, and its equation left out of that row; None: 0.001 of the
    joint's largest rate.
    Raises InputError for arrays that do not fit, too few rows, and a motion that tells nothing.
    """
    check_torques(balanced_mechanism(mechanism))
    check_times(mechanism, t is not None)
    t = 0.0 if t is None else t
    states = [np.asarray(x, float) for x in (q, qd, qdd)]
    given, times = np.asarray(tau, float), np.asarray(t, float)
    n, a = mechanism.n, len(mechanism.actuated)
    for name, array in zip(("q", "qd", "qdd"), states, strict=True):
        if array.ndim != 2 or array.shape != (len(states[0]), n):
            limit = f"must be (T, {n}), a row a state, and the same for q, qd and qdd"
            raise InputError(f"{name}.shape", value=array.shape, limit=limit)
    if times.shape not in ((), (1,), (len(states[0]),)):
        raise InputError("t.shape", value=times.shape, limit="must be (T,), one a state")
    if given.shape == (len(states[0]), n) and not given[:, list(mechanism.passive)].any():
        given = given[:, list(mechanism.actuated)]
    if given.shape != (len(states[0]), a):
        limit = f"must be ({len(states[0])}, {a}): a row a state, a column an actuated joint"
        if a < n:
            limit += f"; or ({len(states[0])}, {n}), zero at passive joints"
        raise InputError("tau.shape", value=given.shape, limit=limit)
    if len(given) and not np.abs(given).max(initial=0.0) <= LARGEST:
        limit = f"must be finite, and {LARGEST:g} N m at most"
        raise InputError("tau", value=float(np.abs(given).max()), limit=limit)
    if rest is not None and not 0.0 <= rest <= LARGEST:
        raise InputError("rest", value=rest, limit="must be a rate >= 0, rad/s or m/s")
    joints = balanced_joints(mechanism)
    torques = np.zeros((len(given), len(joints)))
    torques[:, [joints.index(k) for k in mechanism.actuated]] = given
    times = np.broadcast_to(times, len(torques))
    data = _Data(mechanism, states, torques, times, rest)
    of = [of] if isinstance(of, str) else of
    found = _named(mechanism, data, of, physical) if of else _base(mechanism, data, physical)
    estimates, kept, condition, change, made = found
    made, faults = checked(made)
    left, pi = data.left(change), data.now + change
    rows, usual = data.rows, data.rms_torque
    known = made, pi, faults, data.at_rest
    return Identification(estimates, kept, condition, rows, left, usual, *known)


def predicted(
    mechanism: Mechanism, found: Identification, states: Sequence[Array], t: Array
) -> Array:
    """The torques (T, a) that the parameters found give along q, qd, qdd (T, n)."""
    return np.concatenate([Y.Y @ found.pi + Y.known for Y in _regressors(mechanism, states, t)])


def _regressors(mechanism: Mechanism, states: Sequence[Array], t: Array) -> Iterator[Regressor]:
    """The regressors of blocks of the states."""
    for begin in range(0, len(t), BLOCK):
        yield regressor(mechanism, *(x[begin : begin + BLOCK] for x in (*states, t)))


class _Data:
    """The triangles of the rows Y (pi - pi0) = tau - tau0, joints weighted.

    Rows `at_rest` (T, a) are left out; `counts` (a,) are those that stay.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        states: Sequence[Array],
        tau: Array,
        t: Array,
        rest: float | None,
    ) -> None:
        self.mechanism, self.rows = mechanism, len(tau)
        self.joints = tau.shape[1]
        self.at_rest = rows_at_rest(mechanism, states, rest)
        tau = np.where(self.at_rest, 0.0, tau)
        self.counts = (~self.at_rest).sum(axis=0)
        parameters = linear_parameters(mechanism.description)
        self.names = [x.name for x in parameters]
        self.now = np.array([x.value for x in parameters])
        p = len(parameters)
        triangles: list[Array] = [np.zeros((0, p + 1))] * self.joints
        for block, found in enumerate(_regressors(mechanism, states, t)):
            these = slice(block * BLOCK, (block + 1) * BLOCK)
            left = tau[these] - found.Y @ self.now - found.known
            for i, triangle in enumerate(triangles):
                rows = np.column_stack([found.Y[:, i], left[:, i]])[~self.at_rest[these, i]]
                triangle = np.linalg.qr(np.concatenate([triangle, rows]), mode="r")  # type: ignore
                triangles[i] = triangle
        self.triangles = triangles
        self.rms_torque = np.sqrt((tau**2).sum(axis=0) / np.maximum(self.counts, 1))
        self.weights = np.ones(self.joints)
        self._weigh()

    def _weigh(self) -> None:
        stacked = np.concatenate([x / w for x, w in zip(self.triangles, self.weights, strict=True)])
        self.R, self.s = stacked[:, :-1], stacked[:, -1]

    def enough(self, unknowns: int) -> None:
        """Raise InputError where there are not more rows than unknowns."""
        if int(self.counts.sum()) <= unknowns:
            limit = f"must be more: {unknowns} numbers are unknown, of {self.joints} torques a row"
            if self.at_rest.any():
                limit += "; where joints with static friction rest, rows are left out"
            raise InputError("rows", value=self.rows, limit=limit)

    def left(self, change: Array) -> Array:
        """The rms of each joint's torque that pi0 + change leaves."""
        squares = [((x[:, :-1] @ change - x[:, -1]) ** 2).sum() for x in self.triangles]
        found: Array = np.sqrt(np.array(squares) / np.maximum(self.counts, 1))
        return found

    def weigh(self, change: Array) -> None:
        """Weight the joints by what pi0 + change leaves of their torques."""
        usual = float(self.rms_torque.max(initial=0.0)) or 1.0
        least = QUIET * np.where(self.rms_torque > 0.0, self.rms_torque, usual)
        self.weights = np.maximum(self.left(change), least)
        self._weigh()

    def errors(self, J: Array, change: Array) -> tuple[Array, float]:
        """Standard errors of what the columns J (rows of R, k) are of, and their condition."""
        size = np.linalg.norm(J, axis=0)
        scaled = J / size
        singular = np.linalg.svd(scaled, compute_uv=False)
        free = int(self.counts.sum()) - J.shape[1]
        square = ((self.R @ change - self.s) ** 2).sum() / max(free, 1)
        inverse = np.linalg.inv(np.linalg.qr(scaled, mode="r"))
        spread = np.sqrt((inverse**2).sum(axis=1) * square) / size
        return spread, float(singular[0] / singular[-1])


def _nothing(mechanism: Mechanism, names: Sequence[str]) -> InputError:
    limit = f"the motion tells nothing of {', '.join(names)}"
    return InputError("no excitation", where=mechanism.source, limit=limit)


def _base(mechanism: Mechanism, data: _Data, physical: bool) -> _Found:
    """Base parameters: of what others make, and of what the motion does not tell, nothing moves."""
    kept, scene = structural(mechanism).kept, mechanism.description
    data.enough(len(kept))
    found = excited(mechanism, data.R)
    if not found.kept:
        raise _nothing(mechanism, [x.text for x in base_parameters(mechanism)])
    columns = [kept[k] for k in found.kept]
    change = np.zeros(len(data.names))

    def solve() -> None:
        change[columns] = np.linalg.lstsq(data.R[:, columns], data.s, rcond=None)[0]

    for _ in range(2):
        solve()
        data.weigh(change)
    solve()
    made = from_parameters(scene, data.names, data.now + change)
    if physical and checked(made)[1]:
        sought = _Numbers(data, scene, list(own_numbers(scene).values()))
        made = sought.described(sought.bounded(sought.before, hold=True))
        change = values_of(made) - data.now
    errors, condition = data.errors(data.R[:, columns], change)
    structure, base = structural(mechanism), base_parameters(mechanism)
    combined = change[kept] + structure.beta @ change[structure.dropped]
    told, moved = [base[k] for k in found.kept], combined[found.kept].tolist()
    estimates = tuple(
        Estimate(x.text, x.value + more, error, x.value, x.unit)
        for x, more, error in zip(told, moved, errors.tolist(), strict=True)
    )
    untold = tuple(base[k].text for k in found.dropped)
    return estimates, untold, condition, change, made


def _named(mechanism: Mechanism, data: _Data, of: Sequence[str], physical: bool) -> _Found:
    """Numbers of the scene."""
    scene = mechanism.description
    numbers = [number_called(scene, name) for name in of]
    where = [number.place for number in numbers]
    if len(set(where)) < len(of):
        raise InputError(", ".join(of), limit="name one number twice")
    data.enough(len(of))
    by_number = slopes(scene, where)
    usual = np.abs(by_number).T @ structural(mechanism).size  # at random states
    found = dependence(data.R @ by_number / np.where(usual > 0.0, usual, 1.0), of, EXCITED)
    if not found.kept:
        raise _nothing(mechanism, of)
    sought = _Numbers(data, scene, [numbers[k] for k in found.kept])
    x = sought.before
    for _ in range(2):
        x = sought.free(x)
        data.weigh(sought.change(x))
    x = sought.free(x)
    if physical and (x < sought.least).any():
        x = sought.bounded(x, hold=False)
    change = sought.change(x)
    errors, condition = data.errors(data.R @ sought.slopes(x), change)
    estimates = tuple(
        Estimate(of[k], value, error, before, numbers[k].unit)
        for k, value, error, before in zip(
            found.kept, x.tolist(), errors.tolist(), sought.before.tolist(), strict=True
        )
    )
    untold = tuple(of[k] for k in found.dropped)
    return estimates, untold, condition, change, sought.described(x)


class _Numbers:
    """Numbers x at places of a scene, and what fits the data best."""

    def __init__(self, data: _Data, scene: Description, numbers: Sequence[Number]) -> None:
        self.data, self.scene, self.where = data, scene, [x.place for x in numbers]
        self.before = np.array([number_at(scene, x) for x in self.where])
        self.least = np.array([x.least for x in numbers])

    def described(self, x: Array) -> Description:
        """The scene with them."""
        return with_numbers(self.scene, self.where, x)

    def change(self, x: Array) -> Array:
        """pi less the scene's."""
        found: Array = values_of(self.described(x)) - self.data.now
        return found

    def slopes(self, x: Array) -> Array:
        """d pi by x."""
        return slopes(self.described(x), self.where)

    def left(self, x: Array) -> Array:
        """Return the residual of the torques."""
        found: Array = self.data.R @ self.change(x) - self.data.s
        return found

    def free(self, x: Array) -> Array:
        """Return the numbers that fit best."""
        return self._best(x, np.full(len(x), -np.inf), np.zeros(len(x)))

    def bounded(self, x: Array, hold: bool) -> Array:
        """Return physically possible numbers that fit best.

        With `hold`, numbers that the data do not determine stay close to their values.
        """
        data = self.data
        size = np.sqrt(data.rows * ((data.rms_torque / data.weights) ** 2).sum())
        usual = np.where(self.before == 0.0, 1.0, np.abs(self.before))
        return self._best(x, self.least, (HOLD * size if hold else 0.0) / usual)

    def _best(self, x: Array, least: Array, weight: Array) -> Array:
        """Numbers not below `least` that leave the least, by scipy; and that of the scene's own."""
        from scipy.optimize import least_squares

        def left(x: Array) -> Array:
            return np.concatenate([self.left(x), weight * (x - self.before)])

        def slopes(x: Array) -> Array:
            return np.concatenate([self.data.R @ self.slopes(x), np.diag(weight)])

        tight: Any = dict.fromkeys(("ftol", "xtol", "gtol"), TIGHT)
        begin, bounds = np.maximum(x, least), (least, np.inf)
        found = least_squares(left, begin, slopes, bounds=bounds, x_scale="jac", **tight)
        return np.where(found.active_mask < 0, least, found.x)


Place = tuple[str | int, ...]

ROUNDED = 1e-12  # that numbers without noise are off by
LEAST = 1e-9  # of a mass or an inertia, beside the scene's largest, that counts as positive


class Number(NamedTuple):
    """A number of a scene: where it stands, its unit, and the least that a body can have there.

    Those that are `alone` make up pi: they are fitted where no names are given.  One that adds to
    a `parameter`, as it is, names that.
    """

    place: Place
    unit: str
    least: float = 0.0
    alone: bool = True
    parameter: str = ""


def numbers(description: Description) -> dict[str, Number]:
    """All of them by name."""
    found: dict[str, Number] = {}
    most = {key: max(getattr(x, key) for x in description.links) or 1.0 for key in ("m", "I")}
    for k, link in enumerate(description.links):
        at: Place = ("links", k)
        i = k + 1
        damping = "N s/m" if link.slides else "N m s/rad"
        own = {
            "m": Number((*at, "m"), "kg", LEAST * most["m"]),
            "I": Number((*at, "I"), "kg m²", LEAST * most["I"]),
            "payload": Number((*at, "payload"), "kg", alone=False),
            "damping": Number((*at, "damping"), damping, parameter=f"d{i}"),
            "r": Number((*at, "r", "real"), "m", -np.inf, alone=False),
            "r[0]": Number((*at, "r", "real"), "m", -np.inf),
            "r[1]": Number((*at, "r", "imag"), "m", -np.inf),
        }
        for name, x in zip(link._fields, link, strict=True):
            for field, key in x.keys.items() if isinstance(x, Declared) else ():
                there, its = key.of(link.slides), (*at, name, field)
                called = f"{name}.{there.name or field}"
                if key.linear and isinstance(getattr(x, field), tuple):  # by direction
                    for way, letter in enumerate(WAYS):
                        named = f"{key.linear}{letter}{i}"
                        own[f"{called}[{way}]"] = Number((*its, way), there.unit, parameter=named)
                elif key.linear:
                    own[called] = Number(its, there.unit, parameter=f"{key.linear}{i}")
                elif field == "damping" and not isinstance(x, Element):  # of a rotor
                    own[f"{name}.{field}"] = Number(its, there.unit, alone=False)
        for prefix in (f"links.{link.name}", f"links[{k}]"):
            found |= {f"{prefix}.{key}": number for key, number in own.items()}
    for name in LISTS:
        for i, element in enumerate(getattr(description, name)):
            where = name, i
            slides = element.at is not None and description.links[element.at].slides
            for field, key in element.linear():
                there = key.of(slides)
                number = Number((*where, field), there.unit, parameter=f"{key.linear}{i + 1}")
                found[f"{name}[{i}].{there.name or field}"] = number
            if isinstance(element, JointSpring) and (element.damping or element.law is None):
                unit = JointSpring.keys["damping"].of(slides).unit
                found[f"{name}[{i}].damping"] = Number((*where, "damping"), unit, alone=False)
    return found


def number_called(description: Description, name: str) -> Number:
    """The number of this name; InputError for one that torques do not tell."""
    known = numbers(description)
    if name not in known:
        named = [x for x in known if not x.startswith("links[")]
        limit = "is no mass, moment, damping, friction or stiffness of the scene"
        raise InputError(name, where=description.source, limit=limit + nearest(name, named))
    return known[name]


def number_at(value: Any, place: Place) -> float:
    """Return the number at a place."""
    for step in place:
        value = value[step] if isinstance(step, int) else getattr(value, step)
    return float(value)


def replaced(value: Any, place: Place, number: Any) -> Any:
    """Return the value with another number, or entry, at a place."""
    if not place:
        return number
    step, rest = place[0], place[1:]
    if isinstance(value, complex | Planar):
        both = (number, value.imag) if step == "real" else (value.real, number)
        return type(value)(*both)
    if isinstance(step, int):
        return (*value[:step], replaced(value[step], rest, number), *value[step + 1 :])
    return value._replace(**{step: replaced(getattr(value, step), rest, number)})


def with_numbers(description: Description, where: Sequence[Place], numbers: Array) -> Description:
    """The description with these numbers there."""
    for place, number in zip(where, numbers.tolist(), strict=True):
        description = replaced(description, place, number)
    return description


def values_of(description: Description) -> Array:
    """pi of a description."""
    return np.array([x.value for x in linear_parameters(description)])


def slopes(description: Description, where: Sequence[Place]) -> Array:
    """d pi by the numbers there, (p, k)."""
    graph, scene = Graph(), with_formulas(description)
    names = [f"p{k}" for k in range(len(where))]
    for place, name in zip(where, names, strict=True):
        scene = replaced(scene, place, number_at(description, place) + graph.variable(name))
    pi: list[Any] = [x.value for x in linear_parameters(scene)]
    found = substituted(slopes_by(pi, names), dict.fromkeys(names, 0.0))
    return np.array(found, float).reshape(len(pi), len(where))


def own_numbers(description: Description) -> dict[str, Number]:
    """Return the numbers that make up pi, each once: the default of what is fitted."""
    known = numbers(description).items()
    return {name: x for name, x in known if x.alone and not name.startswith("links[")}


def from_parameters(description: Description, names: Sequence[str], pi: Array) -> Description:
    """The description whose parameters are pi: payloads, and dampers beside joints, stay.

    The names are those of `linear_parameters`.
    """
    now = dict(zip(names, pi.tolist(), strict=True))
    before = {x.name: x.value for x in linear_parameters(description)}
    made = description
    for number in own_numbers(description).values():
        if (name := number.parameter) in now:
            value = number_at(description, number.place) + (now[name] - before[name])
            made = replaced(made, number.place, value)
    for k, link in enumerate(made.links):
        parts = [f"{x}{k + 1}" for x in INERTIAL]
        if any(now[name] != before[name] for name in parts):
            mass, x, y, J = (now[name] for name in parts)
            m = mass - link.payload
            r = (complex(x, y) - link.l * link.payload) / m if m else link.r
            inertia = J - link.payload * link.l**2 - m * abs(r) ** 2
            made = replaced(made, ("links", k), link._replace(m=m, r=r, I=inertia))
    return made


def checked(description: Description) -> tuple[Description, tuple[str, ...]]:
    """The description without what rounding made negative; why it is no scene, if it is none."""
    faults = []
    for name, (place, *_) in own_numbers(description).items():
        number = number_at(description, place)
        if place[-1] in ("real", "imag") or number >= 0.0:
            continue
        if number > -ROUNDED:
            description = replaced(description, place, 0.0)
        else:
            faults.append(f"{name} = {number:.6g}")
    return description, tuple(faults)


def changes(
    before: Description, after: Description, known: SceneValues
) -> dict[str, float | Sequence[float]]:
    """Return the numbers to write into a file with `known` to turn `before` into `after`."""
    found: dict[str, float | Sequence[float]] = {}
    for name, (place, *_) in numbers(before).items():
        if name.startswith("links[") or name.endswith("]"):
            continue
        number = number_at(after, place)
        if name.endswith(".I") and name not in known:
            one, other = (_about_joint(x.links[int(place[1])]) for x in (before, after))
            if one != other:
                found[f"{name.removesuffix('I')}J"] = other
            continue
        if not name.endswith(".r"):
            if number != number_at(before, place):
                found[name] = number
            continue
        k = int(place[1])
        r = after.links[k].r
        if r == before.links[k].r:
            continue
        if f"{name.removesuffix('r')}centre[0]" in known:
            x, y = _as_drawn(before, Point(k, r))
            found |= {f"{name.removesuffix('r')}centre[{i}]": z for i, z in enumerate((x, y))}
        elif f"{name}[0]" in known:
            found |= {f"{name}[0]": r.real, f"{name}[1]": r.imag}
        else:
            alone = abs(r.imag) <= ROUNDED * abs(r) and r.real >= 0.0
            found[name] = r.real if alone else (r.real, r.imag)
    return found


def _about_joint(link: Link) -> float:
    """J = I + m |r|^2 of a link, about its own joint."""
    return link.I + link.m * (link.r.real * link.r.real + link.r.imag * link.r.imag)


def _as_drawn(description: Description, point: Point) -> tuple[float, float]:
    """Position of a point, m, in the pose of a scene's `start`."""
    mechanism = build(description)
    pose = np.array(description.start, float)
    (z,) = point_motion(mechanism, [mechanism.tree.point(point)], pose)[0]
    return float(z[0]), float(z[1])
