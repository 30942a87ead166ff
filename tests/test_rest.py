"""Poses at rest, linear models, modes and gains, against Lagrangians and textbooks."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy as sp
from conftest import ROOT, relative_error
from scipy.linalg import solve_continuous_are
from scipy.optimize import brentq, minimize_scalar

import robodyn as rd
from random_mechanisms import LOOPS, forced, mechanism, seeded_scene
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.rest.balance import balance


def scene(name: str) -> Mechanism:
    return rd.load(ROOT / "robots" / f"{name}.yaml")


def lagrange(kinetic, potential, forces, z, zd, at):
    """A and B by sympy of M z'' + ... = forces, its inputs the symbols u0, u1, .. that it has.

    `at` has the values of z, zd and the inputs.
    """
    inputs = sorted(set().union(*(x.free_symbols for x in forces)) - {*z, *zd}, key=str)
    L = kinetic - potential
    p = [sp.diff(L, x) for x in zd]
    M = sp.Matrix([[sp.diff(x, y) for y in zd] for x in p])
    right = sp.Matrix(
        [
            forces[i]
            + sp.diff(L, z[i])
            - sum(sp.diff(p[i], x) * y for x, y in zip(z, zd, strict=True))
            for i in range(len(z))
        ]
    )
    zdd = M.LUsolve(right)
    return [np.array(zdd.jacobian(sp.Matrix(x)).subs(at).evalf(30), float) for x in (z, zd, inputs)]


def cart_pole(at):
    """Of robots/cart-pole.yaml, its friction as it is next to rest; q1, q2, rates and u."""
    x, a, xd, ad, u = sp.symbols("x a xd ad u0")
    m, l, I, g = sp.Rational(1, 10), sp.Rational(1, 2), sp.Rational(1, 120), sp.Rational("9.8")
    pole = (xd - l * sp.sin(a) * ad) ** 2 + (l * sp.cos(a) * ad) ** 2
    T = xd**2 / 2 + m * pole / 2 + I * ad**2 / 2
    track = sp.Rational("0.0005") * sp.tanh(xd / sp.Rational("0.01"))
    forces = [u - track, -sp.Rational("2e-6") * ad]
    values = dict(zip((x, a, xd, ad, u), map(sp.Float, at), strict=True))
    return lagrange(T, m * g * l * sp.sin(a), forces, [x, a], [xd, ad], values)


def slider_crank(at):
    """Of robots/spring-slider-crank.yaml, in the crank's angle, its rate and u."""
    q, qd, u = sp.symbols("q qd u0")
    R = sp.Rational
    phi = sp.asin((-R("0.012") - R("0.09") * sp.sin(q)) / R("0.25"))
    rate = sp.diff(phi, q) * qd
    piston = R("0.09") * sp.cos(q) + R("0.25") * sp.cos(phi)
    crank = R("0.04") * sp.Matrix([sp.cos(q), sp.sin(q)])
    rod = R("0.09") * sp.Matrix([sp.cos(q), sp.sin(q)])
    rod += R("0.11") * sp.Matrix([sp.cos(phi), sp.sin(phi)])

    def square(x):
        return sum((sp.diff(y, q) * qd) ** 2 for y in x)

    T = R("0.9") * square(crank) / 2 + R("0.00066") * qd**2 / 2 + R("0.4") * square(rod) / 2
    T += R("0.00235") * rate**2 / 2 + R("0.6") * square([piston]) / 2
    V = R("9.81") * (R("0.9") * crank[1] + R("0.4") * rod[1])
    V += 350 * (R("0.46") - piston - R("0.32")) ** 2 / 2
    damper = R("1.5") * sp.diff(piston, q) ** 2 * qd
    return lagrange(
        T, V, [u - damper], [q], [qd], dict(zip((q, qd, u), map(sp.Float, at), strict=True))
    )


def assert_linear(model, zdd) -> None:
    f = len(model.coordinates)
    assert relative_error(model.A[f:], np.hstack(zdd[:2])) < 1e-11
    assert relative_error(model.B[f:], zdd[2]) < 1e-11
    assert np.array_equal(model.A[:f], np.eye(2 * f)[f:])
    assert not model.B[:f].any()


# -- linear models ---------------------------------------------------------------------------------


def test_cart_pole_is_linearized_as_its_lagrangian_moving_and_standing() -> None:
    mech = scene("cart-pole")
    moving = rd.linearize(mech, [0.2, 1.1], [0.004, -0.7], [0.3, 0.0])
    assert_linear(moving, cart_pole([0.2, 1.1, 0.004, -0.7, 0.3]))
    assert (moving.modes, moving.stable, moving.controllable) == (None, None, None)
    assert "it moves" in moving.remark
    standing = rd.linearize(mech, [0.0, math.pi / 2])
    assert_linear(standing, cart_pole([0.0, math.pi / 2, 0.0, 0.0, 0.0]))
    assert standing.coordinates == ("q1", "q2")
    assert standing.stable is False
    assert standing.controllable is True


@pytest.mark.parametrize(("qd", "tau"), [(0.0, None), (3.0, 1.7)])
def test_closed_mechanism_is_linearized_as_its_lagrangian_of_one_coordinate(qd, tau) -> None:
    mech = scene("spring-slider-crank")
    q = rd.assemble(mech, [0.7])
    model = rd.linearize(mech, q, rd.loop_velocities(mech, q, [qd]), tau and [tau, 0.0])
    assert model.coordinates == ("q1",)
    assert_linear(model, slider_crank([0.7, qd, model.tau[0]]))
    assert (model.modes is None) == (tau is not None)


@pytest.mark.parametrize("name", ["five-bar", "geared-five-bar", "whitworth", "hydraulic-boom"])
def test_linear_model_is_the_slope_of_the_motion(name: str) -> None:
    """By differences along assembled states, far from rest."""
    mech, rng = scene(name), np.random.default_rng(4)
    driven = list(mech.actuated)
    z0 = {"five-bar": [2.1, 1.0], "hydraulic-boom": [0.25]}.get(name, [0.9])
    zd0, tau = rng.uniform(-1, 1, len(z0)), np.zeros(mech.n)
    tau[driven] = rng.uniform(-1, 1, len(driven))

    def acceleration(z, zd, u):
        q = rd.assemble(mech, z)
        return rd.forward_dynamics(mech, q, rd.loop_velocities(mech, q, zd), u)[driven]

    q = rd.assemble(mech, z0)
    model = rd.linearize(mech, q, rd.loop_velocities(mech, q, zd0), tau)
    assert model.coordinates == tuple(f"q{k + 1}" for k in driven)
    f, h = len(z0), 1e-5
    for j, way in enumerate(h * np.eye(f)):
        slope = acceleration(z0 + way, zd0, tau) - acceleration(z0 - way, zd0, tau)
        assert relative_error(model.A[f:, j], slope / (2 * h)) < 1e-7
        slope = acceleration(z0, zd0 + way, tau) - acceleration(z0, zd0 - way, tau)
        assert relative_error(model.A[f:, f + j], slope / (2 * h)) < 1e-7


FOUR_BAR = """
gravity: 9.81
links:
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008, damping: 0.1}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1.0, l: 0.8, r: 0.36, I: 0.061, from: [1.1, 0]}
closures: [[coupler, rocker]]
"""


def test_two_choices_of_coordinates_have_the_same_eigenvalues_at_rest() -> None:
    crank, rocker = (mechanism(f"{FOUR_BAR}actuated: [{x}]\n") for x in ("crank", "rocker"))
    q = rd.equilibrium(crank, rd.assemble(crank, [-2.0])).q
    models = [rd.linearize(mech, q) for mech in (crank, rocker)]
    assert [x.coordinates for x in models] == [("q1",), ("q3",)]
    first, second = (np.sort_complex(np.linalg.eigvals(x.A)) for x in models)
    assert np.abs(first - second).max() < 1e-10 * np.abs(first).max()


def test_coordinates_are_other_joints_where_the_actuated_ones_do_not_tell() -> None:
    """At a dead centre of the rocker the crank goes on, and the rocker's rate tells nothing."""
    mech = mechanism(f"{FOUR_BAR}actuated: [rocker]\n")
    inner, ground = 0.95 - 0.35, 1.1
    crank = math.pi + math.acos((inner**2 + ground**2 - 0.8**2) / (2 * inner * ground))
    pin = -inner * complex(math.cos(crank), math.sin(crank))
    rocker = math.atan2(pin.imag, pin.real - ground)
    model = rd.linearize(mech, [crank, math.pi, rocker])
    assert model.coordinates in (("q1",), ("q2",))
    assert np.abs(model.N[2]).max() < 1e-9
    assert model.remark  # the rocker's torque holds nothing here


@pytest.mark.parametrize("name", LOOPS)
def test_linear_model_at_rest_is_made_of_mass_damping_and_stiffness(name: str) -> None:
    """Random loops under loads, springs and friction: M z'' + D z' + K z = 0, another way there."""
    drawn = forced(1, seeded_scene(1, LOOPS[name]))
    mech = mechanism(drawn.text)
    rest = rd.equilibrium(mech, drawn.q)
    model = rd.linearize(mech, rest.q, None, rest.tau)
    at = balance(mech, rest.q, rest.tau)
    M = at.N.T @ rd.mass_matrix(mech, rest.q) @ at.N
    D = at.N.T @ at.load.by_qd @ at.N
    f, parts = len(M), np.linalg.solve(M, -np.hstack([at.stiffness, D]))
    known = np.poly(np.vstack([np.eye(2 * f)[f:], parts]))
    assert relative_error(np.poly(model.A), known) < 1e-10
    assert model.stable == rest.stable


# -- modes -----------------------------------------------------------------------------------------

DOUBLE = """
gravity: 9.81
links:
  - {name: upper, m: 1, l: 0.7, r: 0.7, I: 0}
  - {name: lower, m: 1, l: 0.7, r: 0.7, I: 0}
"""


def test_modes_of_the_double_pendulum() -> None:
    model = rd.linearize(mechanism(DOUBLE), [-math.pi / 2, 0.0])
    known = [math.sqrt((2 + sign * math.sqrt(2)) * 9.81 / 0.7) / math.tau for sign in (-1, 1)]
    assert model.modes is not None
    assert relative_error([mode.frequency for mode in model.modes], known) < 1e-14
    assert [mode.damping for mode in model.modes] == [0.0, 0.0]
    for mode, sign in zip(model.modes, (1, -1), strict=True):  # of absolute angles 1 : +-sqrt(2)
        upper, lower = mode.shape.real
        assert (upper + lower) / upper == pytest.approx(sign * math.sqrt(2), rel=1e-13)
        assert not mode.shape.imag.any()
    assert model.stable is True


def test_damping_ratio_of_one_pendulum() -> None:
    bob = "gravity: 9.81\nlinks: [{name: bob, m: 2, l: 1, r: 0.5, I: 0.3, damping: 0.7}]\n"
    (mode,) = rd.linearize(mechanism(bob), [-math.pi / 2]).modes or []
    w = math.sqrt(2 * 9.81 * 0.5 / 0.8)
    assert mode.frequency == pytest.approx(w / math.tau, rel=1e-14)
    assert mode.damping == pytest.approx(0.7 / 0.8 / (2 * w), rel=1e-13)


def test_a_small_swing_has_the_period_of_its_mode() -> None:
    mech = scene("four-bar")
    rest = rd.equilibrium(mech, rd.assemble(mech, [-2.0])).q
    (mode,) = rd.linearize(mech, rest).modes or []
    begin, w = rd.assemble(mech, [rest[0] + 1e-5]), math.tau * mode.frequency
    motion = rd.simulate(mech, begin, [0.0] * 3, 10 / mode.frequency, rtol=1e-12, atol=1e-14)
    assert motion.q[-1, 0] - rest[0] == pytest.approx(1e-5, rel=1e-6)
    assert abs(motion.qd[-1, 0]) < 1e-5 * w * 1e-4  # 1e-4 rad of 10 turns


def test_shapes_move_rigidly_where_nothing_holds_them() -> None:
    free = mechanism("gravity: 0\nlinks: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    model = rd.linearize(free, [0.4])
    assert [mode.frequency for mode in model.modes or []] == [0.0, 0.0]
    assert model.stable is None
    balanced = rd.linearize(scene("balanced-arm"), [0.3, 0.9])
    assert balanced.stable is None
    assert [mode.frequency for mode in balanced.modes or []] == [0.0] * 4


def test_what_no_actuator_moves_is_not_controllable() -> None:
    two = """
gravity: 9.81
links:
  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}
  - {name: b, m: 1, l: 1, r: 0.5, I: 0.1, from: [0, 0]}
actuated: [a]
"""
    model = rd.linearize(mechanism(two), [-math.pi / 2, -math.pi / 2])
    assert (model.stable, model.controllable) == (True, False)
    with pytest.raises(RobodynError, match="no gain"):
        rd.lqr(model)


# -- gains -----------------------------------------------------------------------------------------


def test_gain_of_the_cart_pole_is_that_of_riccatis_equation() -> None:
    by_z, by_zd, by_u = cart_pole([0.0, math.pi / 2, 0.0, 0.0, 0.0])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [by_z, by_zd]])
    B = np.vstack([np.zeros((2, 1)), by_u])
    X, U = np.diag([1.0, 10.0, 1.0, 2.0]), np.array([[0.1]])
    known = np.linalg.solve(U, B.T @ solve_continuous_are(A, B, X, U))
    model = rd.linearize(scene("cart-pole"), [0.0, math.pi / 2])
    K = rd.lqr(model, [1.0, 10.0, 1.0, 2.0], 0.1)
    assert relative_error(K, known) < 1e-10
    assert relative_error(rd.lqr(model, X, U), known) < 1e-10
    assert np.linalg.eigvals(model.A - model.B @ K).real.max() < 0.0


@pytest.mark.parametrize(
    ("weights", "part"),
    [
        (([1.0, -1.0, 1.0, 1.0], 1.0), "weights_x = 1, -1, 1, 1: must be positive semidefinite"),
        ((1.0, 0.0), "weights_u = 0: must be positive definite"),
        (([1.0, 2.0], 1.0), "weights_x = 2 values: needs 1, 4 or, for a matrix, 16"),
        ((np.eye(4) + np.eye(4, k=1), 1.0), "symmetric"),
        ((1.0, math.nan), "finite"),
        ((1.0, [1.0, 2.0]), "weights_u = 2 values: needs 1 value"),
        ((0.0, 1.0), "weights_x = 0: no gain brings it to rest there: weigh all that moves"),
    ],
)
def test_wrong_weights_are_named(weights, part: str) -> None:
    model = rd.linearize(scene("cart-pole"), [0.0, math.pi / 2])
    with pytest.raises(RobodynError) as caught:
        rd.lqr(model, *weights)
    assert part in str(caught.value)


# -- poses at rest ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "count"), [("pendulum", 2), ("2r", 4), ("3r", 8)])
def test_all_poses_of_arms_are_found(name: str, count: int) -> None:
    rests = rd.equilibria(scene(name))
    assert len(rests) == count
    assert [rest.stable for rest in rests] == [True] + [False] * (count - 1)
    for rest in rests:
        sums = np.cumsum(rest.q)
        assert np.abs(np.cos(sums)).max() < 1e-14
    assert [x.potential_energy for x in rests] == sorted(x.potential_energy for x in rests)


def test_all_poses_of_loops_are_where_the_torque_that_holds_them_changes_sign() -> None:
    for name in ("watt-six-bar", "spring-slider-crank"):
        mech, crank = scene(name), np.linspace(-3.1, 3.1, 621)
        q = rd.assemble(mech, crank[:, None])
        rates = rd.loop_velocities(mech, q, [1.0])
        torque = (rd.gravity_vector(mech, q) * rates).sum(axis=-1)
        (places,) = np.nonzero(torque[1:] * torque[:-1] < 0.0)
        found = sorted(float(rest.q[0]) for rest in rd.equilibria(mech))
        assert len(found) == len(places) > 1
        assert np.abs(crank[places] - found).max() < 0.011


SPRUNG = """springs:
  - {between: [{link: rocker, at: [0.2, 0.1]}, [0.5, 0.9]], stiffness: 400, length: 0.3}
  - {joint: crank, stiffness: 3, angle: 0.4}
"""


def test_four_bar_with_springs_rests_where_its_energy_is_least() -> None:
    mech = mechanism(FOUR_BAR + SPRUNG)

    def energy(crank):
        return rd.potential_energy(mech, rd.assemble(mech, np.atleast_1d(crank)[..., None]))

    angles = np.linspace(-math.pi, math.pi, 4001)
    values = energy(angles)
    lowest = np.flatnonzero((values[1:-1] < values[:-2]) & (values[1:-1] < values[2:])) + 1
    found = [x for x in rd.equilibria(mech) if x.stable and abs(x.q[0]) < math.pi]
    assert len(found) == len(lowest) > 0
    for k in lowest:
        best = minimize_scalar(
            lambda x: energy(x)[0], bounds=angles[[k - 1, k + 1]], options={"xatol": 1e-10}
        )
        assert min(abs(rest.q[0] - best.x) for rest in found) < 1e-6
        near = rd.equilibrium(mech, rd.assemble(mech, [best.x + 0.05]))
        assert near.potential_energy == pytest.approx(best.fun, rel=1e-12)


def test_a_spring_at_the_crank_of_a_four_bar_is_searched_beyond_half_a_turn() -> None:
    mech = mechanism(
        FOUR_BAR
        + """springs:
  - {joint: crank, stiffness: 1.5, angle: 20deg}
  - {between: [{link: coupler, at: [0.5, 0]}, [0.3, 1.2]], stiffness: 60, length: 0.2}
"""
    )

    def energy(crank):
        """PE at any turn: the coil of the crank is wound, the rest is as within half a turn."""
        wrapped = np.remainder(crank + math.pi, math.tau) - math.pi
        q = rd.assemble(mech, np.atleast_1d(wrapped)[..., None])
        coils = [1.5 / 2 * (x - math.radians(20)) ** 2 for x in (crank, wrapped)]
        return rd.potential_energy(mech, q) + coils[0] - coils[1]

    angles = np.linspace(-9 * math.pi, 9 * math.pi, 18001)
    rise = np.diff(energy(angles))
    lowest = np.flatnonzero((rise[:-1] < 0.0) & (rise[1:] > 0.0)) + 1
    highest = np.flatnonzero((rise[:-1] > 0.0) & (rise[1:] < 0.0)) + 1
    found = rd.equilibria(mech)
    for places, stable in ((lowest, True), (highest, False)):
        rests = sorted(float(x.q[0]) for x in found if x.stable is stable)
        assert rests == pytest.approx(sorted(angles[places]), abs=4e-3)
    assert min(x.q[0] for x in found) == pytest.approx(-3.615803, abs=1e-6)
    assert found[1].potential_energy == pytest.approx(31.470165, abs=1e-6)


@pytest.mark.parametrize(("stiffness", "free"), [(0.3, 0.5), (0.15, 8.0), (3.0, -40.0)])
def test_a_pendulum_on_a_weak_coil_rests_in_many_turns(stiffness: float, free: float) -> None:
    """k (q - free) + m g r cos q = 0, by bisection on a fine grid."""
    mech = mechanism(
        "gravity: 9.81\nlinks: [{name: a, m: 0.2, l: 1, r: 0.5, I: 0.1}]\n"
        f"springs: [{{joint: a, stiffness: {stiffness}, angle: {free}}}]\n"
    )

    def torque(q):
        return stiffness * (q - free) + 0.2 * 9.81 * 0.5 * np.cos(q)

    reach = 0.2 * 9.81 * 0.5 / stiffness
    grid = np.linspace(free - reach - 0.1, free + reach + 0.1, 5001)
    (k,) = np.nonzero(torque(grid[1:]) * torque(grid[:-1]) < 0.0)
    exact = [brentq(torque, grid[i], grid[i + 1], xtol=1e-14) for i in k]
    found = sorted(rd.equilibria(mech), key=lambda x: float(x.q[0]))
    assert [float(x.q[0]) for x in found] == pytest.approx(exact, abs=1e-9)
    assert [x.stable for x in found] == [i % 2 == 0 for i in range(len(exact))]


def test_a_search_that_is_cut_short_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robodyn.rest.poses_at_rest.MOST_EVALUATIONS", 100)
    with pytest.warns(RobodynWarning, match="there may be more poses at rest"):
        assert 0 < len(rd.equilibria(scene("3r"))) < 8


def test_a_level_arm_is_no_place_to_stay() -> None:
    """Its stiffness is zero there, and Newton's method alone would not move."""
    rest = rd.equilibrium(scene("2r"), [0.0, 0.0])
    assert relative_error(rest.q, [-math.pi / 2, 0.0]) < 1e-12
    assert rest.stable is True


def test_a_start_that_no_one_gave_closes() -> None:
    """The crank cannot point along +X: the rocker is behind it, and too far."""
    mech = mechanism(FOUR_BAR.replace("l: 0.95", "l: 0.6").replace("1.1, 0", "-1.2, 0"))
    with pytest.raises(RobodynError, match="cannot be closed"):
        rd.assemble(mech, [0.0])
    rest, lowest = rd.equilibrium(mech), rd.equilibria(mech)[0]
    assert np.abs(rd.closure_gap(mech, rest.q)).max() < 1e-12
    assert rest.potential_energy == pytest.approx(lowest.potential_energy, rel=1e-9)


def test_held_joints_stay_and_tell_what_holds_them() -> None:
    mech = scene("four-bar")
    q = rd.assemble(mech, [1.0])
    rest = rd.equilibrium(mech, q, hold=["crank"])
    assert relative_error(rest.q, q) < 1e-12
    known = rd.inverse_dynamics(mech, q, np.zeros(3), np.zeros(3))
    assert relative_error(rest.tau, known) < 1e-12
    arm = scene("2r")
    rest = rd.equilibrium(arm, [0.3, -1.2], hold=["upper arm"])
    assert relative_error(rest.q, [0.3, -math.pi / 2 - 0.3]) < 1e-12
    known = 9.81 * math.cos(0.3) * (1.5 * 0.36 + 0.9 * 0.8)
    assert relative_error(rest.tau, [known, 0.0]) < 1e-12
    assert len(rd.equilibria(arm, [0.3, 0.2], hold=["upper arm"])) == 2


def test_given_torques_hold() -> None:
    rest = rd.equilibrium(scene("pendulum"), [-1.2], tau=[0.5])
    assert relative_error(rd.gravity_vector(scene("pendulum"), rest.q), [0.5]) < 1e-12
    with pytest.raises(RobodynError, match=r"tau = 5: no pose at rest near q = -1\.2: 20\.4 %"):
        rd.equilibrium(scene("pendulum"), [-1.2], tau=[5.0])  # m g r = 1.02024
    with pytest.raises(RobodynError, match=r"tau = 5: no pose at rest: 20\.4 % .* from any start"):
        rd.equilibria(scene("pendulum"), tau=[5.0])


def test_a_change_point_is_no_place_to_rest() -> None:
    """Pin forces grow without end there, and with them the stiffness that forces are small to."""
    mech = rd.load(ROOT / "tests/hard_cases/third-crank.yaml")
    for rest in rd.equilibria(mech):
        assert relative_error(abs(np.cos(rest.q)), np.zeros(4)) < 1e-9
    with pytest.raises(RobodynError, match="no pose at rest near q = 0, 0, 0, 0"):
        rd.equilibrium(mech, [0.0] * 4)


@pytest.mark.parametrize(("push", "stable"), [(2.0, True), (2.17, False)])
def test_follower_force_makes_zieglers_column_flutter(push: float, stable: bool) -> None:
    """Masses 2 m and m, springs k, rods l: beyond P = (7/2 - sqrt(2)) k/l = 2.086."""
    column = mechanism(f"""
gravity: 0
links:
  - {{name: low, m: 2, l: 1, r: 1, I: 0}}
  - {{name: high, m: 1, l: 1, r: 1, I: 0}}
springs: [{{joint: low, stiffness: 1, angle: 0}}, {{joint: high, stiffness: 1, angle: 0}}]
loads: [{{link: high, at: [1, 0], force: [-{push}, 0], frame: link}}]
""")
    rest = rd.equilibrium(column, [0.05, -0.02])
    assert relative_error(rest.q, [0.0, 0.0]) < 1e-12
    assert rest.stable is stable
    model = rd.linearize(column, rest.q)
    assert model.stable is stable
    assert any(mode.frequency and mode.damping < -1e-3 for mode in model.modes or []) != stable


def test_compliant_stops_push_and_hard_ones_bar() -> None:
    leg = "gravity: 9.81\nlinks: [{name: leg, m: 1, l: 1, r: 1, I: 0, limits: {min: -1, %s}}]\n"
    rest = rd.equilibrium(mechanism(leg % "stiffness: 200, damping: 1"), [0.0])
    q = float(rest.q[0])
    assert q < -1.0
    assert 9.81 * math.cos(q) == pytest.approx(200 * (-1 - q), rel=1e-12)
    assert rest.stable is True
    with pytest.raises(RobodynError, match="beyond the joint's min, -1"):
        rd.equilibrium(mechanism(leg % "restitution: 0.3"), [0.0])


def test_no_end_of_poses_is_told() -> None:
    with pytest.raises(RobodynError, match="no end of poses at rest"):
        rd.equilibria(scene("cart-pole"))
    assert [x.stable for x in rd.equilibria(scene("cart-pole"), hold=["cart"])] == [True, False]
    assert rd.equilibrium(scene("cart-pole"), [0.3, -1.0]).stable is None


def test_wrong_input_is_named() -> None:
    mech = scene("four-bar")
    for call, part in [
        (lambda: rd.equilibrium(mech, [0.1, 0.2, 0.3]), "the loops are open"),
        (lambda: rd.linearize(mech, [0.1, 0.2, 0.3]), "the loops are open"),
        (lambda: rd.equilibrium(mech, hold=["crnk"]), "did you mean crank?"),
        (lambda: rd.equilibrium(mech, [[0.1] * 3]), "near.shape"),
        (lambda: rd.linearize(mech, [0.1, math.inf, 0.3]), "q[1]"),
    ]:
        with pytest.raises(InputError) as caught:
            call()
        assert part in str(caught.value)
