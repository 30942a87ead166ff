"""Every column of numbers that robodyn writes, declared once: its names, unit, meaning, function.

A family is what is computed together, of a `State`.  Braces in the names of its columns stand for
what there is one of for each joint, closure or point of a scene (`PLACES`).  Whatever lists, names
or converts columns reads this file: commands, sweeps, fits, charts, tables in degrees, the guide.

A joint that slides has m and N where others have rad and N m; only who has the scene knows.

Instant centres: a point p of a link that turns at w moves with v = i w (p - c), so c = p + i v/w.
The path of a point has the curvature kappa = (v x a)/|v|^3, positive where it bends to the left.
Both belong to the geometry of a motion: of one freedom they are found at the rate 1 of its joint,
so that a mechanism at rest has them too.  With J (2, a) the Jacobian of a point by the actuated
joints, its manipulability sqrt(det J J^T) is the root of the sum of the squares of the 2 x 2 minors
of J (Cauchy and Binet), and its condition the ratio of the singular values of J.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.csv_fields import IN_DEGREES, shown

if TYPE_CHECKING:
    from robodyn.dynamics.named_points import NamedPoint
    from robodyn.dynamics.state import State
    from robodyn.mechanics.mechanism import Mechanism
    from robodyn.tables.arrays import Array

STANDS = 1e-14  # part of what a rate is the sum of, below which it is rounding


# -- what the families compute ---------------------------------------------------------------------


def _pins(state: State) -> Array:
    known = _closures(state.mechanism)
    return state.loop_forces[:, [2 * c + axis for c in known for axis in (0, 1)]]


def _kept(state: State) -> Array:
    described = state.mechanism.description
    end = state.loop_forces.shape[1] - len(described.couplings)
    return state.loop_forces[:, 2 * len(described.closures) : end]


def _couplings(state: State) -> Array:
    first = state.loop_forces.shape[1] - len(state.mechanism.description.couplings)
    return state.loop_forces[:, [first + c for c in _known_couplings(state.mechanism)]]


def _drive_power(state: State) -> Array:
    from robodyn.engines.coupling_laws import laws_of

    laws, drives = laws_of(state.mechanism), _drives(state.mechanism)
    if laws is None or not drives:
        return np.zeros((len(state.q), 0))
    numbers = [c for c, x in enumerate(state.mechanism.description.couplings) if x.law is not None]
    slopes = laws.drifts(state.q, state.t)[:, [numbers.index(c) for c in drives]]
    known = _known_couplings(state.mechanism)  # which all drives are
    return np.asarray(_couplings(state)[:, [known.index(c) for c in drives]] * slopes)


def _contacts(state: State) -> Array:
    from robodyn.dynamics.cam_contacts import contacts_on_links
    from robodyn.mechanics.placed import placed

    at = placed(state.mechanism, state.q)
    each = [x.pressed for x in contacts_on_links(state.mechanism, state.q, at, state.multipliers)]
    forces = np.stack(each, axis=-1) if each else np.zeros((len(state.q), 0))
    return np.where(np.isinf(forces), np.nan, forces)


def _pressures(state: State) -> Array:
    from robodyn.dynamics.cam_contacts import cams_of, contact_at

    mechanism = state.mechanism
    each = [contact_at(mechanism, cam, state.q).pressure for cam in cams_of(mechanism)]
    return np.stack(each, axis=-1) if each else np.zeros((len(state.q), 0))


def _radii(state: State) -> Array:
    from robodyn.dynamics.cam_contacts import cams_of, contact_at

    mechanism = state.mechanism
    each = [contact_at(mechanism, cam, state.q).curvature for cam in cams_of(mechanism)]
    bent = np.stack(each, axis=-1) if each else np.zeros((len(state.q), 0))
    with np.errstate(divide="ignore"):
        return np.where(bent == 0.0, np.nan, 1.0 / bent)


def _gap(state: State) -> Array:
    from robodyn.loops.closures import closure_gap

    gap: Array = np.linalg.norm(closure_gap(state.mechanism, state.q, state.t), axis=-1)
    return gap[:, None]


def _tau(state: State) -> Array:
    return np.asarray(state.tau[:, list(state.mechanism.actuated)])


def _power(state: State) -> Array:
    driven = list(state.mechanism.actuated)
    return np.asarray(state.tau[:, driven] * state.qd[:, driven])


def _residual(state: State) -> Array:
    return np.asarray(state.tau[:, _free(state.mechanism)])


def _ratios(state: State) -> Array:
    from robodyn.dynamics.transmission import rate_ratios, ratio_named

    ratios = [ratio_named(state.mechanism, name) for name in state.ratios]
    return rate_ratios(state.mechanism, ratios, state.q, state.qd, state.t)


def _reactions(state: State) -> Array:
    from robodyn.dynamics.reaction_forces import reactions

    forces = reactions(
        state.mechanism, state.q, state.qd, state.finite_qdd, state.multipliers, state.t
    )
    return forces.reshape(len(state.q), -1)


def _slide_moments(state: State) -> Array:
    from robodyn.dynamics.reaction_forces import slide_moments

    return slide_moments(
        state.mechanism, state.q, state.qd, state.finite_qdd, state.multipliers, state.t
    )


def _shaking(state: State) -> Array:
    from robodyn.dynamics.reaction_forces import shaking_force

    return shaking_force(state.mechanism, state.q, state.qd, state.finite_qdd, state.t)


def _links(state: State) -> Array:
    from robodyn.dynamics.named_points import link_turns

    turns = link_turns(state.mechanism, state.q, state.qd, state.qdd)
    return np.stack(turns, axis=-1).reshape(len(state.q), -1)


def _centres(state: State) -> Array:
    from robodyn.dynamics.closed_form import point_motion
    from robodyn.mechanics.placed import absolute_rates, frame_rates

    mechanism, (qd, _) = state.mechanism, state.along
    p, v, _ = point_motion(mechanism, list(mechanism.tips), state.q, qd)
    w, parts = (frame_rates(mechanism, absolute_rates(mechanism, x)) for x in (qd, np.abs(qd)))
    stands = np.abs(w) <= STANDS * parts
    w = np.where(stands, np.nan, w)[..., None]
    return (p + np.stack([-v[..., 1], v[..., 0]], axis=-1) / w).reshape(len(state.q), -1)


def _transmission(state: State) -> Array:
    from robodyn.dynamics.transmission import transmission_angles, transmission_loops

    loops = list(transmission_loops(state.mechanism).values())
    return transmission_angles(state.mechanism, loops, state.q)


def _points(state: State) -> Array:
    from robodyn.dynamics.closed_form import point_motion

    places = [point.point for point in state.points]
    motion = point_motion(state.mechanism, places, state.q, state.qd, state.qdd)
    return np.concatenate(motion, axis=-1).reshape(len(state.q), -1)


def _jacobian(state: State) -> Array:
    return state.jacobians.reshape(len(state.q), -1)


def _manipulability(state: State) -> Array:
    x, y = state.jacobians[..., 0, :], state.jacobians[..., 1, :]
    pairs = combinations(range(x.shape[-1]), 2)
    minors = [x[..., i] * y[..., j] - x[..., j] * y[..., i] for i, j in pairs]
    return np.sqrt(sum(map(np.square, minors), np.zeros(x.shape[:-1])))


def _condition(state: State) -> Array:
    found = state.jacobians
    if 0 in found.shape:
        return np.full(found.shape[:2], np.nan)
    s = np.linalg.svd(found, compute_uv=False)
    singular = s[..., -1] <= STANDS * s[..., 0]
    return np.where(singular, np.nan, s[..., 0] / np.where(singular, 1.0, s[..., -1]))


def _curvature(state: State) -> Array:
    from robodyn.dynamics.closed_form import point_motion
    from robodyn.dynamics.named_points import point_jacobian

    places, (qd, qdd) = [point.point for point in state.points], state.along
    _, v, a = point_motion(state.mechanism, places, state.q, qd, qdd)
    parts = np.abs(point_jacobian(state.mechanism, places, state.q)) @ np.abs(qd)[:, None, :, None]
    speed = np.hypot(v[..., 0], v[..., 1])
    stands = speed <= STANDS * np.hypot(parts[..., 0, 0], parts[..., 1, 0])
    speed = np.where(stands, np.nan, speed)
    return np.asarray((v[..., 0] * a[..., 1] - v[..., 1] * a[..., 0]) / speed**3)


def _places(state: State) -> Array:
    from robodyn.dynamics.closed_form import point_motion

    mechanism = state.mechanism
    points = [*mechanism.pivots, *mechanism.tips, *mechanism.centres]
    position, velocity, _ = point_motion(mechanism, points, state.q, state.qd)
    both = np.concatenate([position, velocity], axis=-1).reshape(len(state.q), 3, mechanism.n, 4)
    there = np.ones((mechanism.n, 3), bool)
    there[list(mechanism.massless), 2] = False  # which have no centre of gravity
    return np.swapaxes(both, 1, 2)[:, there].reshape(len(state.q), -1)


# -- the registry ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Family:
    """Columns that are computed together.

    `name` stands for all of them.  `columns` are their names, with braces as in `PLACES`; `units`
    has the unit of each, or one for all; `text` says what they are.  `values` gives the columns
    (T, columns) of states, NaN only if there are `gaps`; a family without it belongs to runs, or to
    results.  `needs` names what states must have but q: qdd (and qd), and tau, for what acts.
    If it `slides`, columns of joints that slide are in m and N, not in rad and N m.  `lacking` says
    why a scene has no such column.  Names that are `common` stand in tables of others too: they
    tell neither a unit nor that robodyn computed the column.
    """

    name: str
    columns: str
    units: str
    text: str
    values: Callable[[State], Array] | None = None
    needs: str = ""
    gaps: bool = False
    slides: bool = False
    lacking: str = "there is none"  # why a scene may have no such column
    common: bool = False

    @property
    def each(self) -> Iterator[tuple[str, str]]:
        """The name, with its braces, and the unit of each column."""
        words, units = self.columns.split(" "), self.units.split(", ")
        return zip(words, units if len(units) > 1 else units * len(words), strict=True)

    @property
    def kinds(self) -> list[str]:
        """The letters of its braces, the outer first."""
        return list(dict.fromkeys(re.findall(r"\{(\w)\}", self.columns)))


_MOTION = "{P}_x {P}_y {P}_vx {P}_vy {P}_ax {P}_ay"
_PARTS = " ".join(
    f"{x}_{y}{{k}}" for x in ("joint", "tip", "centre") for y in ("x", "y", "vx", "vy")
)
_PART_UNITS = ", ".join(["m, m, m/s, m/s"] * 3)
_FLYWHEEL = "mean_torque energy_fluctuation mean_speed flywheel"


_DECLARED = (
    Family("t", "t", "s", "the time", lambda s: s.t[:, None]),
    Family("q", "q{k}", "rad", "the angle of each joint", lambda s: s.q, slides=True),
    Family("qd", "qd{k}", "rad/s", "its rate", lambda s: s.qd, slides=True),
    Family("qdd", "qdd{k}", "rad/s²", "its acceleration", lambda s: s.qdd, "qdd", slides=True),
    Family("tau", "tau{a}", "N m", "the torque of each actuated joint", _tau, "tau", slides=True),
    Family("pins", "fx{c} fy{c}", "N", "the pin force of each closure", _pins, "tau"),
    Family("kept", "mz{m}", "N m", "the moment of each closure that is `aligned`", _kept, "tau"),
    Family(
        "couplings", "tc{g}", "N m", "the torque of each coupling", _couplings, "tau", slides=True
    ),
    Family(
        "drive_power",
        "drive_power{d}",
        "W",
        "the power of a drive, a law of the time",
        _drive_power,
        "tau",
        lacking="no coupling has a law of the time",
    ),
    Family(
        "contacts",
        "contact{h}",
        "N",
        "the force of each cam on its follower, positive if pressed",
        _contacts,
        "tau",
        gaps=True,
        lacking="no coupling of this scene has a cam",
    ),
    Family("motor", "motor{v}", "N m", "the torque of its motor", lambda s: s.motors[0], "tau"),
    Family(
        "motor_speed",
        "motor_speed{v}",
        "rad/s",
        "the speed of its rotor",
        lambda s: s.motors[1],
        "tau",
    ),
    Family("volt", "volt{e}", "V", "the voltage of its motor", lambda s: s.motors[2], "tau"),
    Family("amp", "amp{e}", "A", "the current of its motor", lambda s: s.motors[3], "tau"),
    Family("watt", "watt{e}", "W", "the power that its motor takes", lambda s: s.motors[4], "tau"),
    Family("power", "power{a}", "W", "the power of its torque, `tau1` `qd1`", _power, "tau"),
    Family(
        "residual",
        "residual{f}",
        "N m",
        "the torque that is left at a free joint",
        _residual,
        "tau",
        slides=True,
        lacking="no joint is free: the mechanism has as many actuators as freedoms",
    ),
    Family(
        "reactions",
        "rx{k} ry{k}",
        "N",
        "the force on each link at its own joint",
        _reactions,
        "qdd tau",
    ),
    Family(
        "slide_moments",
        "rm{s}",
        "N m",
        "the moment on each link that slides",
        _slide_moments,
        "qdd tau",
    ),
    Family(
        "shaking",
        "shake_fx shake_fy shake_m",
        "N, N, N m",
        "the force and the moment on the ground",
        _shaking,
        "qdd",
    ),
    Family(
        "points",
        _MOTION,
        "m, m, m/s, m/s, m/s², m/s²",
        "where a point is, its velocity, acceleration",
        _points,
        "qdd",
    ),
    Family("jacobian", "{P}_Jx{a} {P}_Jy{a}", "m/rad", "its way by actuated joints", _jacobian),
    Family(
        "manipulability",
        "{P}_manipulability",
        "m²/rad²",
        "sqrt(det J Jᵀ), J its Jacobian",
        _manipulability,
    ),
    Family("condition", "{P}_condition", "", "the condition number of J", _condition, gaps=True),
    Family("kappa", "{P}_kappa", "1/m", "the curvature of its path", _curvature, "qdd", gaps=True),
    Family(
        "links",
        "angle{k} w{k} wd{k}",
        "rad, rad/s, rad/s²",
        "the angle of each link, its rate, acceleration",
        _links,
        "qdd",
    ),
    Family("centres", "icx{k} icy{k}", "m", "the instant centre of each link", _centres, gaps=True),
    Family(
        "transmission",
        "transmission{l}",
        "rad",
        "the transmission angle of a loop",
        _transmission,
        lacking="no loop of this scene is closed by three pairs in a row",
    ),
    Family(
        "pressure",
        "pressure{h}",
        "rad",
        "the pressure angle of each cam",
        _pressures,
        gaps=True,
        lacking="no coupling of this scene has a cam",
    ),
    Family(
        "rho",
        "rho{h}",
        "m",
        "the radius of curvature of each cam's profile at the contact",
        _radii,
        gaps=True,
        lacking="no coupling of this scene has a cam",
    ),
    Family("ratio", "{A}/{B}", "", "the ratio of the rates of two links", _ratios, gaps=True),
    Family("KE", "KE", "J", "the kinetic energy", lambda s: s.energies[0][:, None]),
    Family("PE", "PE", "J", "the potential energy", lambda s: s.energies[1][:, None]),
    Family("energy", "energy", "J", "their sum", lambda s: np.add(*s.energies)[:, None]),
    Family("gap", "gap", "m", "how far the loops are open", _gap),
    Family("places", _PARTS, _PART_UNITS, "the joint, tip and centre of each link", _places),
    # of runs
    Family("errors", "e{a}", "rad", "`simulate --control`: q_ref - q", slides=True),
)

# of results: {X} stands for another column, whose unit is X, {E} for an event, {N} for a number
_RESULTS = (
    Family("final", "{X}_end", "X", "`sweep`: where a motion ends"),
    Family("extremes", "{X}_min {X}_max", "X", "`sweep`: the least and the largest of a motion"),
    Family("drift", "drift", "", "`sweep`: how far the energy drifts, by that in motion"),
    Family("flip", "flip", "s", "`sweep`: when a link first turns over"),
    Family("events", "{E}_count {E}_first", ", s", "`sweep --event`: how often it is, and when"),
    Family("ends", "min({X}) max({X}) range({X})", "X", "`sweep --result`: of rows, their extent"),
    Family("taken", "mean({X}) rms({X}) first({X}) last({X})", "X", "or a mean, or one of them"),
    Family("outcome", "outcome", "", "`sweep`: how a point ended", common=True),
    Family("missed", "{X}_residual", "X", "`fit --residuals`: a column less the wanted"),
    Family("slopes", "d{X}/{N}", "", "`simulate --sensitivity`: the derivative by a number"),
    Family("event", "event", "", "`simulate --events`: its name", common=True),
    Family("flywheel", _FLYWHEEL, "N m, J, rad/s, kg m²", "`torque --fluctuation`: of a turn"),
    Family("at", "min_{X} max_{X}", "X", "`summary`: t and q1 of the row of an extreme"),
    Family("order", "order", "", "`summary --harmonics`: k", common=True),
    Family("orders", "{X}_amp {X}_phase", "X, rad", "`summary --harmonics`: of each order"),
    Family("regressor", "Y{X}_{N}", "", "`regressor`: the torque of joint X by a parameter"),
    Family("branch", "branch", "", "`assemble`: which way to close the loops", common=True),
    Family(
        "range",
        "joint low low_end high high_end",
        "",
        "`assemble --range`: range of a joint",
        common=True,
    ),
    Family("stable", "stable", "", "`equilibrium`: whether the pose is", common=True),
    Family(
        "profile",
        "x y pitch_x pitch_y",
        "m",
        "`points --cam`: the profile and the pitch curve",
        common=True,
    ),
)
FAMILIES = {family.name: family for family in (*_DECLARED, *_RESULTS)}
STATE = tuple(family.name for family in _DECLARED if family.values)  # which follow from a state
LOOPS = ("pins", "kept", "couplings")
MOTORS = ("motor", "motor_speed", "volt", "amp", "watt")
FORCES = (*LOOPS, "contacts")
TORQUE = ("tau", *FORCES, *MOTORS)
MOTION = ("t", "q", "qd", "qdd", "tau", *FORCES, "energy", "gap")
REACTIONS = ("reactions", "slide_moments", *FORCES, "shaking")


def _numbers(joints: Iterable[int]) -> list[str]:
    return [str(k + 1) for k in joints]


def _aligned(mechanism: Mechanism) -> list[int]:
    closures = mechanism.description.closures
    return [c for c, closure in enumerate(closures) if closure.aligned is not None]


def _closures(mechanism: Mechanism) -> list[int]:
    """The closures whose pins carry no weight that nobody knows."""
    unknown = mechanism.unknown_holds.closures
    return [c for c in range(len(mechanism.description.closures)) if c not in unknown]


def _known_couplings(mechanism: Mechanism) -> list[int]:
    """The couplings that carry no weight that nobody knows."""
    unknown = mechanism.unknown_holds.couplings
    return [c for c in range(len(mechanism.description.couplings)) if c not in unknown]


def known_loop_forces(mechanism: Mechanism) -> list[int]:
    """The places of the columns LOOPS in `dynamics.loop_forces`."""
    closures = len(mechanism.description.closures)
    kept = 2 * closures + len(_aligned(mechanism))
    pins = [2 * c + axis for c in _closures(mechanism) for axis in (0, 1)]
    return [*pins, *range(2 * closures, kept), *(kept + c for c in _known_couplings(mechanism))]


def _drives(mechanism: Mechanism) -> list[int]:
    return [c for c, x in enumerate(mechanism.description.couplings) if x.timed]


def _free(mechanism: Mechanism) -> list[int]:
    from robodyn.dynamics.free_joints import free_joints

    return free_joints(mechanism)


def _motors(mechanism: Mechanism, electric: bool = False) -> list[int]:
    from robodyn.mechanics.motors import motors_at, powered_joints

    motors = motors_at(mechanism, powered_joints(mechanism))
    return [k for k, x in motors if x.torque_constant or not electric]


def _cams(mechanism: Mechanism) -> list[int]:
    couplings = mechanism.description.couplings
    return [c for c, coupling in enumerate(couplings) if coupling.cam is not None]


def _loops(mechanism: Mechanism) -> list[int]:
    from robodyn.dynamics.transmission import transmission_loops

    return list(transmission_loops(mechanism))


# what a letter in braces stands for: numbers from 1, or names
PLACES: dict[str, Callable[[Mechanism, Sequence[str]], Sequence[str]]] = {
    "k": lambda x, _: _numbers(range(x.n)),  # each joint, or link
    "a": lambda x, _: _numbers(x.actuated),  # each actuated joint
    "f": lambda x, _: _numbers(_free(x)),  # each free joint of a mechanism that lacks actuators
    "s": lambda x, _: _numbers(x.slides),  # each joint that slides
    "c": lambda x, _: _numbers(_closures(x)),  # each closure
    "m": lambda x, _: _numbers(_aligned(x)),  # each closure that keeps an angle
    "g": lambda x, _: _numbers(_known_couplings(x)),  # each coupling
    "d": lambda x, _: _numbers(_drives(x)),  # each coupling that is a law of the time
    "h": lambda x, _: _numbers(_cams(x)),  # each coupling that has a cam
    "v": lambda x, _: _numbers(_motors(x)),  # each actuated or driven joint with a motor
    "e": lambda x, _: _numbers(_motors(x, electric=True)),  # the same, with its constants
    "l": lambda x, _: _numbers(_loops(x)),  # each loop that has a transmission angle
    "P": lambda _, points: points,  # each point
    "A": lambda x, _: x.link_names,  # each link
    "B": lambda x, _: x.link_names,  # each other link
    "X": lambda *_: (),  # a column that results are of: see `result_names`
    "E": lambda *_: (),
    "N": lambda *_: (),
}


# -- names -----------------------------------------------------------------------------------------


def names_of(family: Family, mechanism: Mechanism, points: Sequence[NamedPoint] = ()) -> list[str]:
    """The names of a family's columns of a mechanism, its points being `points`."""
    return list(_names(family, mechanism, tuple(point.name for point in points)))


@lru_cache(maxsize=512)
def _names(family: Family, mechanism: Mechanism, points: tuple[str, ...]) -> tuple[str, ...]:
    if family.name == "gap" and not mechanism.rows:
        return ()
    places = [(f"{{{kind}}}", PLACES[kind](mechanism, points)) for kind in family.kinds]
    found: list[str] = []
    words = family.columns.split(" ")
    for item in places[0][1] if places else [""]:
        for word in words:
            name = word.replace(places[0][0], item) if places else word
            for brace, others in places[1:]:
                found += [name.replace(brace, other) for other in others if other != item]
            if len(places) < 2:
                found.append(name)
    if family.name == "places":  # a link without a mass has no centre of gravity
        lost = tuple(str(k + 1) for k in mechanism.massless)
        found = [x for x in found if not (x.startswith("centre_") and _number(x) in lost)]
    return tuple(found)


def _number(name: str) -> str:
    return name[len(name.rstrip("0123456789")) :]


def column_names(
    mechanism: Mechanism,
    families: Iterable[str],
    points: Sequence[NamedPoint] = (),
) -> list[str]:
    """The names of the columns of some families, by their names, one family after the other."""
    return [name for x in families for name in names_of(FAMILIES[x], mechanism, points)]


def of_joints(family: str, joints: Iterable[int]) -> list[str]:
    """The columns of some joints, counted from 0, of a family that has one a joint."""
    stem = FAMILIES[family].columns.partition("{")[0]
    return [f"{stem}{number}" for number in _numbers(joints)]


def result_names(family: str, of: Iterable[str] = ("",), by: str = "") -> list[str]:
    """The columns of results `of` these columns, or events, one after the other; `by` a number."""
    words = [x.replace("{E}", "{X}") for x in FAMILIES[family].columns.split(" ")]
    return [word.replace("{N}", by).replace("{X}", x) for x in of for word in words]


def declared(name: str) -> tuple[Family, str] | None:
    """The family of a column by its name alone, and its unit where nothing slides.

    A ratio has none here: what is on either side of a slash, only who has the scene knows.
    """
    if found := _declared_itself(name):
        return found
    for family, unit, inner in _results_of(name):
        if own := declared(inner):
            return family, unit.replace("X", own[1])
    return None


def _results_of(name: str) -> Iterator[tuple[Family, str, str]]:
    """The families of results that may have the column, its unit, and the column that it is of."""
    for (before, behind), family, unit in _OF_COLUMN:
        if name.startswith(before) and name.endswith(behind):
            inner = name[len(before) : len(name) - len(behind)]
            if before + inner + behind == name:  # the two do not overlap
                yield family, unit, inner


def _declared_itself(name: str) -> tuple[Family, str] | None:
    """The same of a column that is no result of another."""
    stem = name.rstrip("0123456789")
    if found := (_WHOLE if stem == name else _NUMBERED).get(stem):
        return found
    of_point = _OF_POINT.search(name)
    return _SUFFIXES[re.sub("[0-9]+$", "", of_point[1])] if of_point else None


def family_of(mechanism: Mechanism, name: str, points: Sequence[NamedPoint] = ()) -> Family | None:
    """The family that has a column of this name, of this mechanism and these points; or None."""
    found = declared(name)
    if found and name in names_of(found[0], mechanism, points):
        return found[0]
    if "/" in name:
        from robodyn.dynamics.transmission import ratio_named

        with suppress(InputError):
            ratio_named(mechanism, name)
            return FAMILIES["ratio"]
    return None


# where no scene is known: by the names of columns, or their ends
_WHOLE: dict[str, tuple[Family, str]] = {}
_NUMBERED: dict[str, tuple[Family, str]] = {}  # less their numbers
_SUFFIXES: dict[str, tuple[Family, str]] = {}  # of points, less theirs
_OF_COLUMN: list[tuple[list[str], Family, str]] = []  # results of others: what is beside X
_ends = []
for _family in (x for x in FAMILIES.values() if not x.common):
    for _word, _unit in _family.each:
        _stem = re.sub(r"\{\w\}$", "", _word)
        if "{X}" in _word and "{N}" not in _word:
            _OF_COLUMN.append((_word.split("{X}"), _family, _unit))
        elif _stem.startswith("{P}_"):
            _stem = _stem.removeprefix("{P}_")
            _SUFFIXES[_stem] = _family, _unit
            _ends.append(_stem if _word.endswith(_stem) else f"{_stem}[0-9]+")
        elif "{" not in _stem:
            (_WHOLE if _stem == _word else _NUMBERED)[_stem] = _family, _unit
_OF_POINT = re.compile(f"._({'|'.join(_ends)})$")


def guide_table(results: bool = False) -> list[tuple[str, str, str, str]]:
    """The families as rows of the guide: columns of one unit, the unit, the family's name, text.

    Or those of results, whose unit X is that of the column X.
    """
    rows: list[tuple[str, str, str, str]] = []
    for family in _RESULTS if results else _DECLARED:
        first = len(rows)
        for unit, group in groupby(family.each, key=lambda pair: pair[1]):
            names = [re.sub(r"\{([a-z])\}", "1", word) for word, _ in group]
            names = [re.sub(r"\{([A-Z])\}", r"\1", name) for name in names]
            told = ("", "") if len(rows) > first else (f"`{family.name}`", family.text)
            more = ", ..." if re.search(r"\{[a-z]\}", family.columns) else ""
            rows.append((", ".join(f"`{name}`" for name in names) + more, unit, *told))
    return rows


# -- units -----------------------------------------------------------------------------------------

SLIDING = {"rad": "m", "rad/s": "m/s", "rad/s²": "m/s²", "N m": "N", "N m s/rad": "N s/m"}
DEGREES = {"rad": "°", "rad/s": "°/s", "rad/s²": "°/s²"}
TURNING: Mapping[str, str] = {}  # the units of columns of joints that turn need not be told
# columns of joints, less their numbers, whose units depend on whether the joint slides
OF_JOINTS = {x: unit for x, (family, unit) in _NUMBERED.items() if family.slides}
# where no scene tells which joints slide: 0 stands for any joint
ANY_SCENE = {f"{x}0": f"{unit} or {SLIDING[unit]}" for x, unit in OF_JOINTS.items()}
OF_PARTS = {**OF_JOINTS, "angle": "rad"}  # keys of results with parts


def quantity_of(name: str) -> str:
    """A column's name less the number of its link or closure: `q` of `q1` and of `q1_deg`."""
    return name.removesuffix(IN_DEGREES).rstrip("0123456789") or name


def scene_units(mechanism: Mechanism) -> Mapping[str, str]:
    """The units of the columns that belong to joints which slide."""
    couplings = mechanism.description.couplings
    sliding = {"g": [c for c, x in enumerate(couplings) if x.joint in mechanism.slides]}
    return {
        f"{stem}{k + 1}": SLIDING[unit]
        for stem, unit in OF_JOINTS.items()
        for k in sliding.get(_NUMBERED[stem][0].kinds[0], mechanism.slides)
    }


def unit_of(name: str, units: Mapping[str, str] = TURNING) -> str:
    """The unit of a column, or of a result of columns, max(tau1); "" where none is known.

    `units` are those of the scene, or `ANY_SCENE`, by which q1 is in `rad or m`.
    """
    if known := _unit_by_name(name, units):
        return known
    if name.endswith(IN_DEGREES):  # no displacement is
        own = TURNING if units is ANY_SCENE else units
        return DEGREES.get(unit_of(name.removesuffix(IN_DEGREES), own), "")
    told = (
        unit_of(inner, units) if unit == "X" else unit
        for _, unit, inner in _results_of(name)
        if declared(inner.removesuffix(IN_DEGREES))
    )
    return next(filter(None, told), "")


def _unit_by_name(name: str, units: Mapping[str, str]) -> str:
    """The unit of a name as it is, "" if no column of robodyn's has it."""
    if name in units:
        return units[name]
    if name.endswith(IN_DEGREES) or not (found := _declared_itself(name)):
        return ""
    return units.get(f"{quantity_of(name)}0") or found[1]


def check_degrees(names: Iterable[str], units: Mapping[str, str]) -> None:
    """Raise InputError where --degrees would take what may be a displacement for an angle."""
    for name in names:
        turning, _, sliding = unit_of(name, units).partition(" or ")
        if turning in DEGREES and sliding:
            limit = f"may be in {turning} or in {sliding}: --model MODEL tells whether joints slide"
            raise InputError("--degrees", value=shown(name), limit=limit)


def in_degrees(name: str, units: Mapping[str, str] = TURNING) -> tuple[str, float]:
    """A column's name where angles are told in degrees, and what its values are times those."""
    if unit_of(name, units) not in DEGREES:
        return name, 1.0
    inner = name.removesuffix(")") if "(" in name else name
    return inner + IN_DEGREES + name[len(inner) :], 180.0 / math.pi


def structure_in_degrees(content: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    """A result with parts: values of angles in degrees, of `q` one by one as of q1, q2, ..."""
    units = {**OF_PARTS, **units}

    def told(value: Any, name: str) -> Any:
        match value:
            case float():
                return in_degrees(name, units)[1] * value
            case Mapping():
                return structure_in_degrees(value, units)
            case list() | tuple():
                return [told(x, f"{name}{k}") for k, x in enumerate(value, start=1)]
        return value

    of_numbers = (float, list, tuple)
    return {
        in_degrees(name, units)[0] if isinstance(x, of_numbers) else name: told(x, name)
        for name, x in content.items()
    }


def with_unit(name: str, units: Mapping[str, str] = TURNING) -> str:
    """A column's name with its unit, `tau1 [N m]`."""
    unit = unit_of(name, units)
    return f"{name} [{unit}]" if unit else name
