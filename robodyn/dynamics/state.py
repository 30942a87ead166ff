"""States of a mechanism, and whatever follows from them, by the names of columns.

    state = State(mechanism, q, qd, qdd)
    state.columns(["tau1", "power1", "tip2_x"])         # (T, 3)

Which columns there are stands in `columns.py`.  A state computes what is asked of it, once: what
the columns of two families need, they share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import chain
from string import ascii_lowercase

import numpy as np
from numpy.typing import ArrayLike

from robodyn.dynamics.closed_form import energies
from robodyn.dynamics.columns import (
    FAMILIES,
    MOTORS,
    STATE,
    Family,
    column_names,
    declared,
    family_of,
    names_of,
)
from robodyn.dynamics.joint_vectors import full, vector
from robodyn.dynamics.named_points import NamedPoint, named_points, point_jacobian, unit_rates
from robodyn.errors import InputError, overflow
from robodyn.loops.assembly_plan import with_independent
from robodyn.loops.loop_rates import check_way_on, loop_accelerations
from robodyn.mechanics.mechanism import Mechanism
from robodyn.mechanics.motors import drives, motor_values, powered_joints
from robodyn.mechanics.placed import as_states, times_of, together
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown

AGREE = 1e-6  # part of the accelerations by which those given may miss those that torques cause


class State:
    """States of a mechanism, with whatever follows from them: each computed once, when asked for.

    q, qd, and qdd or tau are (..., n) and broadcast to one another; rates and accelerations not
    given are zero; t (...), s, is the time of loads that vary.  With qdd the torques follow, with
    tau (of all joints, or of the actuated ones) the accelerations; of both, tau is the cause, and
    qdd must be what it causes.  q, qd and qdd may be of the actuated joints alone: the others are
    assembled, and follow.  A closed mechanism's must keep its closures.  `of`
    has the points whose columns there are; the scene's, else all tips, where it is empty.

    Torques that are left at free joints are an error, but where their columns are asked for.

    Inside, states are rows: q, qd, qdd, tau (T, n), t (T,) and multipliers (T, r).
    """

    def __init__(
        self,
        mechanism: Mechanism,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        qdd: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        t: ArrayLike = 0.0,
        *,
        of: str | Sequence[str] | Sequence[NamedPoint] = (),
        moving: Mechanism | None = None,
    ) -> None:
        """`moving` is what moves, in its mode, along a motion: a mode of the mechanism."""
        given: dict[str, ArrayLike] = {"q": q, "qd": np.zeros(mechanism.n) if qd is None else qd}
        if qdd is not None:
            given["qdd"] = qdd
        if tau is not None:
            given["tau"] = tau
        each = together(mechanism, _of_all_joints(mechanism, given, t))
        self.mechanism: Mechanism = mechanism
        self.moving = moving
        self.shape = each["q"].shape[:-1]
        rows = {name: x.reshape(-1, mechanism.n) for name, x in each.items()}
        self.q: Array = rows.pop("q")
        self.qd: Array = rows.pop("qd")
        self._motion = rows
        self.t: Array = np.atleast_1d(times_of(t, each["q"])).reshape(-1)
        self._of = of
        self.ratios: list[str] = []  # the names of those that were asked for
        self._residual = False  # whether torques may be left at free joints
        self._values: dict[str, Mapping[str, Array]] = {}  # of families, by their names

    def columns(self, names: Sequence[str]) -> Array:
        """The columns of these names, (..., k), in their order; NaN where one has no value.

        Raises InputError, naming the nearest, for a name that is no column of this mechanism;
        RobodynError as the functions that compute them.
        """
        families = [self._family(name) for name in names]
        if FAMILIES["residual"] in families and not self._residual:
            self._residual = True
            self.__dict__.pop("_solved", None)
        each = [self._columns(family)[name] for name, family in zip(names, families, strict=True)]
        found = np.stack(each, axis=-1) if each else np.zeros((len(self.q), 0))
        return found.reshape(*self.shape, len(names))

    def _family(self, name: str) -> Family:
        """The family of a column; points and ratios that it names are the state's from then on."""
        known = declared(name)
        points = self.points if known and "P" in known[0].kinds else []
        count = len(points)
        found = find(self.mechanism, name, points)
        if len(points) > count:
            self._forget("{P}")
        if found is None:
            names = column_names(self.mechanism, STATE, self.points)
            limit = f"is no column of a state{nearest(name, names)}"
            raise InputError("columns", value=shown(name), limit=limit)
        if found is FAMILIES["ratio"] and name not in self.ratios:
            self.ratios.append(name)
            self._forget("{A}")
        return found

    def _forget(self, place: str) -> None:
        """Drop the values of families whose columns have become more."""
        kept = {x: y for x, y in self._values.items() if place not in FAMILIES[x].columns}
        self._values = kept

    def _columns(self, family: Family) -> Mapping[str, Array]:
        """The columns (T,) of a family, by name."""
        if family.name not in self._values:
            assert family.values is not None
            ratios = family is FAMILIES["ratio"]
            points = self.points if "P" in family.kinds else []
            own = self.ratios if ratios else names_of(family, self.mechanism, points)
            self._values[family.name] = dict(zip(own, family.values(self).T, strict=True))
        return self._values[family.name]

    @cached_property
    def points(self) -> list[NamedPoint]:
        """The points that have columns: those of `of`, and those that columns named."""
        of = self._of
        points = [x for x in of if isinstance(x, NamedPoint)]
        texts = of if isinstance(of, str) else [x for x in of if isinstance(x, str)]
        return points or named_points(self.mechanism, texts)

    # what acts

    @cached_property
    def _solved(self) -> tuple[Array, Array, Array]:
        """qdd and tau (T, n), and the multipliers (T, r)."""
        from robodyn.dynamics import dynamics

        mechanism, q, qd, t = self.mechanism, self.q, self.qd, self.t
        given = self._motion.get("qdd")
        if "tau" not in self._motion:
            qdd = np.zeros_like(q) if given is None else given
            torques = dynamics.inverse_dynamics_and_forces(
                mechanism, q, qd, qdd, t, residual=self._residual
            )
            return qdd, torques.tau, torques.multipliers
        tau = self._motion["tau"]
        if self.moving is not None:
            caused = dynamics.motion_dynamics(self.moving, q, qd, tau, t)
            return caused.qdd, tau, caused.multipliers[:, : len(mechanism.rows)]
        check_way_on(mechanism, q, qd)
        caused = dynamics.forward_dynamics_and_forces(mechanism, q, qd, tau, t)
        if given is not None:
            _check_agreement(qd, given, caused.qdd)
        return caused.qdd, tau, caused.multipliers

    @cached_property
    def qdd(self) -> Array:
        """The accelerations (T, n), given or caused."""
        if "tau" in self._motion:
            return self._solved[0]
        return self._motion.get("qdd", np.zeros_like(self.q))

    @property
    def finite_qdd(self) -> Array:
        """The accelerations (T, n); RobodynError if torques cause such as are not finite."""
        if "tau" in self._motion and not np.isfinite(self.qdd).all():
            raise overflow()
        return self.qdd

    @property
    def tau(self) -> Array:
        """The torques (T, n), given or needed."""
        return self._motion["tau"] if "tau" in self._motion else self._solved[1]

    @property
    def multipliers(self) -> Array:
        """The multipliers of the closures' rows, (T, r)."""
        return self._solved[2]

    @cached_property
    def loop_forces(self) -> Array:
        """Pin forces, moments of angles that are kept, torques of couplings, side by side."""
        from robodyn.dynamics.dynamics import loop_forces

        return loop_forces(self.mechanism, self.multipliers, self.q)

    @cached_property
    def energies(self) -> tuple[Array, Array]:
        """KE and PE, (T,) each."""
        return energies(self.moving or self.mechanism, self.q, self.qd)

    @cached_property
    def motors(self) -> list[Array]:
        """Torque, speed, voltage, current and power of motors, each (T, motors)."""
        tau = list(self.tau.T)
        first = self.loop_forces.shape[1] - len(self.mechanism.description.couplings)
        for k, c in drives(self.mechanism).items():
            tau[k] = self.loop_forces[:, first + c]
        joints = powered_joints(self.mechanism)
        each = motor_values(self.mechanism, joints, tau, list(self.qd.T))
        return [np.stack(x, axis=-1) if x else np.zeros((len(self.q), 0)) for x in each]

    # where points go

    @cached_property
    def along(self) -> tuple[Array, Array]:
        """Rates and accelerations (T, n) of the path: of one freedom, those at its rate 1."""
        driver = with_independent(self.mechanism)
        if len(driver.actuated) != 1:
            return self.qd, self.qdd
        qd = unit_rates(driver, self.q, self.t)[..., 0]
        return qd, loop_accelerations(driver, self.q, qd, np.zeros((len(self.q), 1)), self.t)

    @cached_property
    def _unit_rates(self) -> Array:
        return unit_rates(self.mechanism, self.q, self.t)

    @property
    def jacobians(self) -> Array:
        """How far each point goes with each actuated joint, (T, p, 2, a)."""
        places = [point.point for point in self.points]
        moved = point_jacobian(self.mechanism, places, self.q) @ self._unit_rates[:, None]
        return np.asarray(moved)


def _of_all_joints(
    mechanism: Mechanism, given: Mapping[str, ArrayLike], t: ArrayLike
) -> Mapping[str, ArrayLike]:
    """The vectors as they are, or of all joints where q, qd or qdd are of the actuated ones."""
    values = {name: vector(mechanism, name, x) for name, x in given.items()}
    if all(whole for name, (_, whole) in values.items() if name != "tau"):
        return given
    try:
        rows = np.broadcast_shapes(*(x.shape[:-1] for x, _ in values.values()))
    except ValueError:
        return given  # which is told of all of them
    every = {
        name: (np.broadcast_to(x, (*rows, x.shape[-1])), whole)
        for name, (x, whole) in values.items()
    }
    return full(mechanism, every, t=t)


def _check_agreement(qd: Array, given: Array, caused: Array) -> None:
    """Raise InputError where the accelerations given are not those that the torques cause."""
    size = 1.0 + np.abs(caused).max(axis=-1) + np.abs(qd).max(axis=-1) ** 2
    wrong = np.argwhere(np.abs(given - caused) > AGREE * size[:, None])
    if len(wrong):
        row, k = map(int, wrong[0])
        caused_too = f"{caused[row, k]:.9g}; give one of qdd and tau"
        limit = f"the torques that are given too make it {caused_too}"
        raise InputError(f"qdd{k + 1}", value=f"{given[row, k]:.9g}", limit=limit)


def find(mechanism: Mechanism, name: str, points: list[NamedPoint]) -> Family | None:
    """The family of states that has a column of this name, or None.

    A point that the name holds need not be among the points: it is added to them.
    """
    found = family_of(mechanism, name, points)
    known = declared(name)
    if found is None and known is not None and "P" in known[0].kinds:
        with suppress(InputError, ValueError):
            (point,) = named_points(mechanism, [name.rpartition("_")[0]])
            if name in names_of(known[0], mechanism, [point]):
                points.append(point)
                found = known[0]
    return None if found is None or found.values is None else found


def motor_loads(mechanism: Mechanism, tau: ArrayLike, qd: ArrayLike) -> dict[str, Array]:
    """Torque N m, speed rad/s, voltage V, current A and power W of motors, by columns' names.

    Each is (...), of rates (..., n) and torques of all joints or of the actuated ones, which
    broadcast.  There are those of the actuated joints: `motor1`, `motor_speed1`, and `volt1`,
    `amp1`, `watt1` of a motor with its constants.  `State` has those of driven joints too.  Raises
    InputError for arrays that are not so wide, or not finite.
    """
    given = [as_states(mechanism, name, x) for name, x in (("tau", tau), ("qd", qd))]
    torques, rates = (list(np.moveaxis(x, -1, 0)) for x in np.broadcast_arrays(*given))
    each = motor_values(mechanism, mechanism.actuated, torques, rates)
    own = [f"{k + 1}" for k in mechanism.actuated]
    names = [x for x in column_names(mechanism, MOTORS) if x.lstrip("_" + ascii_lowercase) in own]
    return dict(zip(names, chain.from_iterable(each), strict=True))
