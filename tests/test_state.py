"""States by the names of columns: what each family gives, beside closed forms and other ways."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from conftest import ROOT
from unwritten import MASSLESS

import robodyn as rd
from random_mechanisms import LOOPS, mechanism, seeded_scene, seeded_tree, sliding
from robodyn.dynamics import closed_form
from robodyn.dynamics.columns import (
    FAMILIES,
    MOTORS,
    STATE,
    column_names,
    declared,
    unit_of,
)
from robodyn.dynamics.columns import (
    LOOPS as LOOP_FAMILIES,
)
from robodyn.dynamics.state import State
from robodyn.errors import InputError, ResidualError

FOUR_BAR = ROOT / "robots/four-bar.yaml"
TWO_LINKS = ROOT / "robots/2r.yaml"
l1, l2 = 0.8, 0.6


def one(mech: rd.Mechanism, q: object, names: str, **more: object) -> list[float]:
    """The columns of one state."""
    return State(mech, q, **more).columns(names.split()).tolist()  # type: ignore[arg-type]


# -- the registry ----------------------------------------------------------------------------------


WHOLE = sorted(x for x in (ROOT / "robots").glob("*.yaml") if x.stem not in MASSLESS)


@pytest.mark.parametrize("path", WHOLE, ids=lambda x: x.stem)
def test_every_column_of_a_scene_has_its_own_name_family_and_values(path) -> None:
    mech = rd.load(path)
    rng = np.random.default_rng(3)
    driven = 0.4 + 0.1 * rng.random((3, len(mech.actuated)))
    state = State(mech, *(_closed(mech, driven) if mech.rows else (rng.random((3, mech.n)),)))
    names = column_names(mech, STATE, state.points)
    assert len(set(names)) == len(names)
    if len(mech.actuated) < mech.n - len(mech.rows):  # whose motion the actuated joints leave open
        open_to = {"jacobian", "manipulability", "condition"}
        acting = {family for family in STATE if "tau" in FAMILIES[family].needs}
        names = column_names(mech, [x for x in STATE if x not in open_to | acting], state.points)
    values = state.columns(names)
    assert values.shape == (3, len(names))
    for name, column in zip(names, values.T, strict=True):
        family = FAMILIES["ratio"] if "/" in name else declared(name)[0]
        assert family.gaps or np.isfinite(column).all(), name


def _closed(mech: rd.Mechanism, driven: np.ndarray) -> tuple[np.ndarray]:
    """Poses near the middle of what the actuated joints of a scene can do."""
    from robodyn.loops.assembly import attempt

    q, missing = attempt(mech, driven, t=0.0)
    good = np.nan_to_num(missing, nan=1.0) == 0.0
    if good.any():
        return (np.resize(q[good], q.shape),)
    start = np.array(mech.description.start or np.zeros(mech.n))
    return (np.tile(rd.assemble(mech, start[list(mech.actuated)]), (3, 1)),)


def test_a_family_of_names_is_what_its_functions_give() -> None:
    """Of random loops with motors, couplings and sliders, against the functions themselves."""
    for seed in range(6):
        plain = seeded_scene(seed, LOOPS["four-bar"])
        mech, q, qd, qdd = plain.mechanism, plain.q, plain.qd, plain.qdd
        state = State(mech, q, qd, qdd)
        tau = rd.inverse_dynamics_and_forces(mech, q, qd, qdd)
        loops = column_names(mech, LOOP_FAMILIES)
        pins = rd.pin_forces(mech, tau.multipliers, q).reshape(-1)
        assert (state.columns(loops)[: len(pins)] == pins).all()
        driven = list(mech.actuated)
        assert (state.columns([f"tau{k + 1}" for k in driven]) == tau.tau[driven]).all()
        both = [f"r{x}{k + 1}" for k in range(mech.n) for x in "xy"]
        expected = rd.reactions(mech, q, qd, qdd, tau.multipliers)
        assert (state.columns(both) == expected.reshape(-1)).all()
        KE, PE = closed_form.energies(mech, q, qd)
        assert one(mech, q, "KE PE energy", qd=qd) == [KE, PE, KE + PE]
        assert not column_names(mech, MOTORS)


def test_shapes_are_those_of_the_states() -> None:
    mech = rd.load(TWO_LINKS)
    q = np.random.default_rng(1).random((2, 5, 2))
    found = State(mech, q, [1.0, 2.0]).columns(["tau1", "qd2", "KE"])
    assert found.shape == (2, 5, 3)
    assert (found[..., 1] == 2.0).all()
    assert State(mech, [0.1, 0.2]).columns(["tau2"]).shape == (1,)
    assert State(mech, q).columns([]).shape == (2, 5, 0)


def test_a_state_computes_what_is_asked_for_and_that_once(monkeypatch) -> None:
    from robodyn.dynamics import dynamics

    calls = []
    inverse = dynamics.inverse_dynamics_and_forces
    monkeypatch.setattr(
        dynamics, "inverse_dynamics_and_forces", lambda *x, **y: calls.append(1) or inverse(*x, **y)
    )
    state = State(rd.load(FOUR_BAR), rd.assemble(rd.load(FOUR_BAR), [1.0]))
    state.columns(["tip1_x", "energy", "angle2", "transmission1", "icx2"])
    assert not calls
    state.columns(["tau1", "fx1", "rx2", "power1"])
    state.columns(["ry3", "shake_m"])
    assert len(calls) == 1


def test_torques_of_the_actuated_joints_cause_what_those_of_all_do() -> None:
    mech = rd.load(FOUR_BAR)
    q = rd.assemble(mech, [1.0])
    names = ["qdd1", "qdd2", "qdd3", "fx1", "rx2"]
    assert one(mech, q, " ".join(names), tau=[1.5]) == one(
        mech, q, " ".join(names), tau=[1.5, 0, 0]
    )
    qdd = one(mech, q, "qdd1 qdd2 qdd3", tau=[1.5])
    assert one(mech, q, "tau1", qdd=qdd) == pytest.approx([1.5], rel=1e-12)
    assert one(mech, q, "tau1 rx1", qdd=qdd, tau=[1.5])[0] == 1.5
    with pytest.raises(InputError, match=r"qdd1 = .*the torques that are given too make it"):
        one(mech, q, "rx1", qdd=np.multiply(2, qdd), tau=[1.5])


def test_vectors_may_be_of_the_actuated_joints_alone() -> None:
    mech = rd.load(FOUR_BAR)
    q = rd.assemble(mech, [[1.0], [2.0]])
    qd = rd.loop_velocities(mech, q, [[3.0], [-1.0]])
    qdd = rd.loop_accelerations(mech, q, qd, [[0.5], [2.0]])
    names = ["q2", "qd3", "qdd2", "tau1", "fx1", "tip2_ay"]
    every = State(mech, q, qd, qdd).columns(names)
    few = State(mech, [[1.0], [2.0]], [[3.0], [-1.0]], [[0.5], [2.0]])
    assert (few.columns(names) == every).all()
    assert (State(mech, q, [[3.0], [-1.0]], qdd).columns(names) == every).all()
    free = rd.load(ROOT / "robots/cart-pole.yaml")
    with pytest.raises(InputError, match="q"):
        State(free, [0.1])
    with pytest.raises(InputError, match="open"):
        State(mech, [1.0, 1.0, 1.0], [2.0])
    with pytest.raises(InputError, match="qd"):
        State(mech, [1.0], [2.0, 1.0])


def test_residuals_are_columns_where_they_are_asked_for() -> None:
    mech = rd.load(ROOT / "robots/cart-pole.yaml")
    state = State(mech, [0.0, 1.0], [0.1, 0.2], [0.3, 0.4])
    expected = rd.inverse_dynamics(mech, [0, 1], [0.1, 0.2], [0.3, 0.4], residual=True)
    assert state.columns(["tau1", "residual2"]).tolist() == expected.tolist()
    with pytest.raises(ResidualError):
        one(mech, [0.0, 1.0], "tau1", qd=[0.1, 0.2], qdd=[0.3, 0.4])


def test_a_name_that_is_none_is_refused_with_the_nearest() -> None:
    state = State(rd.load(FOUR_BAR), rd.assemble(rd.load(FOUR_BAR), [1.0]))
    for name, near in (("powr1", "power1"), ("rocker/crnk", "rocker/crank"), ("tau2", "tau1")):
        with pytest.raises(InputError, match=f"{name}: is no column of a state.*{near}"):
            state.columns([name])
    with pytest.raises(InputError, match="e1: is no column of a state"):
        state.columns(["e1"])  # which a controlled run has


def test_points_and_ratios_that_a_name_holds_need_not_be_declared() -> None:
    mech = rd.load(FOUR_BAR)
    q, qd = rd.assemble(mech, [1.0]), rd.loop_velocities(mech, rd.assemble(mech, [1.0]), [2.0])
    found = one(mech, q, "centre2_x tip1_x centre3_vy rocker/crank", qd=qd)
    where = rd.points(mech, q, qd, of=["centre2", "tip1", "centre3"])
    assert found[:3] == [where.position[0, 0], where.position[1, 0], where.velocity[2, 1]]
    assert found[3] == pytest.approx(qd[2] / qd[0], rel=1e-13)


def test_units_are_told_by_names_alone() -> None:
    names = {"x_kappa": "1/m", "P_condition": "", "icy12": "m", "P_manipulability": "m²/rad²"}
    assert {name: unit_of(name) for name in names} == names


# -- instant centres -------------------------------------------------------------------------------


def test_the_instant_centre_of_a_coupler_is_where_crank_and_rocker_meet() -> None:
    """Kennedy's theorem: it lies on the lines of crank and rocker, at rest and in motion."""
    mech = rd.load(FOUR_BAR)
    for angle in np.linspace(0.3, 6.2, 9):
        q = rd.assemble(mech, [angle])
        (A, B) = (complex(*x) for x in rd.points(mech, q, of=["tip1", "tip3"]).position)
        D = 1.1 + 0j
        # s A = D + t (B - D)
        s, _ = np.linalg.solve([[A.real, -(B - D).real], [A.imag, -(B - D).imag]], [D.real, D.imag])
        qd = rd.loop_velocities(mech, q, [3.0])
        for rates in (None, qd, -qd):
            found = one(mech, q, "icx2 icy2 icx1 icy1 icx3 icy3", qd=rates)
            expected = [(s * A).real, (s * A).imag, 0.0, 0.0, D.real, 0.0]
            assert found == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_a_link_that_does_not_turn_has_no_instant_centre() -> None:
    mech = rd.load(ROOT / "robots/elliptic-trammel.yaml")
    q = rd.assemble(mech, [0.7])
    found = one(mech, q, "icx1 icy1 icx3 icy3 icx2 icy2")
    assert np.isnan(found[:4]).all()
    a, b = q[0], q[2]  # where the sliders are: the centre lies across their ways from both
    assert found[4:] == pytest.approx([a, b], rel=1e-12)
    arm = rd.load(TWO_LINKS)
    still = one(arm, [0.3, 0.4], "icx1 icy1 icx2 icy2")
    assert np.isnan(still).all()
    turned = one(arm, [0.3, 0.4], "icx2 icy2", qd=[1.0, -1.0])  # the forearm only shifts
    assert np.isnan(turned).all()


@pytest.mark.parametrize("seed", range(8))
def test_the_point_at_an_instant_centre_stands(seed: int) -> None:
    plain = seeded_tree(seed, 4) if seed % 2 else seeded_scene(seed, LOOPS["five-bar"])
    if seed in (3, 7):
        plain = sliding(seed, plain, 2)
    mech, q, qd = plain.mechanism, plain.q, plain.qd
    names = [f"{x}{k + 1}" for k in range(mech.n) for x in ("icx", "icy", "angle")]
    each = State(mech, q, qd).columns(names).reshape(-1, 3)
    for k, (link, (x, y, angle)) in enumerate(zip(mech.link_names, each, strict=True)):
        if math.isnan(x):
            assert k in mech.slides
            assert mech.frames[k] is None
            continue
        joint = rd.points(mech, q, of=f"{link}@0,0").position[0]
        own = complex(x - joint[0], y - joint[1]) * np.exp(-1j * angle)
        moved = rd.points(mech, q, qd, of=f"{link}@{float(own.real)!r},{float(own.imag)!r}")
        size = np.abs(qd).max() * (abs(own) + 1.0)
        assert np.abs(moved.velocity).max() < 1e-12 * size


# -- the curvature of paths ------------------------------------------------------------------------


def test_the_curvature_of_an_ellipse() -> None:
    """Of a trammel of Archimedes: the bar's point at s draws the half axes |l - s| and s."""
    mech, length = rd.load(ROOT / "robots/elliptic-trammel.yaml"), 0.5
    for angle, part in itertools.product([0.2, 0.9, 2.0], [0.15, 0.4]):
        q = rd.assemble(mech, [angle])
        (x, y) = rd.points(mech, q, of=f"bar@{part},0").position[0]
        a, b = length - part, part
        assert (x / a) ** 2 + (y / b) ** 2 == pytest.approx(1.0, rel=1e-12)
        u = math.atan2(y / b, x / a)
        size = a * b / math.hypot(a * math.sin(u), b * math.cos(u)) ** 3
        (found,) = State(mech, q, of=[f"P=bar@{part},0"]).columns(["P_kappa"])
        assert abs(found) == pytest.approx(size, rel=1e-12)


def test_the_curvature_of_circles_and_lines() -> None:
    arm = rd.load(TWO_LINKS)
    r = abs(l1 + l2 * np.exp(0.7j))
    assert one(arm, [0.3, 0.7], "tip2_kappa", qd=[2.0, 0.0]) == pytest.approx([1 / r], rel=1e-13)
    assert one(arm, [0.3, 0.7], "tip2_kappa", qd=[-2.0, 0.0]) == pytest.approx([-1 / r], rel=1e-13)
    assert one(arm, [0.3, 0.7], "tip2_kappa tip1_kappa", qd=[0.0, 2.0])[0] == pytest.approx(1 / l2)
    assert math.isnan(one(arm, [0.3, 0.7], "tip1_kappa", qd=[0.0, 2.0])[0])
    crank = rd.load(ROOT / "robots/slider-crank.yaml")
    q = rd.assemble(crank, [0.9])
    found = one(crank, q, "tip1_kappa tip2_kappa")
    assert found == pytest.approx([10.0, 0.0], rel=1e-12, abs=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_the_curvature_is_that_of_the_circle_through_three_places(seed: int) -> None:
    """Of a random four-bar's coupler, through poses assembled beside; error of the order h^2."""
    plain = seeded_scene(seed, LOOPS["four-bar"])
    mech, q = plain.mechanism, plain.q
    of = f"P={mech.link_names[1]}@0.13,0.07"
    h = 1e-4
    near = [_beside(mech, q, way * h) for way in (-1.0, 0.0, 1.0)]
    a, b, c = (complex(*rd.points(mech, x, of=of).position[0]) for x in near)
    area = ((b - a).conjugate() * (c - a)).imag
    expected = 2.0 * area / (abs(b - a) * abs(c - b) * abs(c - a))
    (found,) = State(mech, q, of=[of]).columns(["P_kappa"])
    assert found == pytest.approx(expected, rel=2e-5, abs=1e-5)


def _beside(mech: rd.Mechanism, q: np.ndarray, step: float) -> np.ndarray:
    """The closed pose where the actuated joint is `step` further, by Newton's method."""
    (k,) = mech.actuated
    q = q + step * np.asarray(rd.loop_velocities(mech, q, [1.0]))
    others = [j for j in range(mech.n) if j != k]
    for _ in range(6):
        Psi = rd.closure_jacobian(mech, q)[:, others]
        q = q.copy()
        q[others] -= np.linalg.solve(Psi, rd.closure_gap(mech, q))
    return q


# -- Jacobians -------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.3, -1.2, 2.5, math.pi / 2])
def test_manipulability_and_condition_of_two_links(angle: float) -> None:
    """w = l1 l2 |sin q2|; with it and |J|^2 the singular values follow."""
    arm = rd.load(TWO_LINKS)
    w, condition = one(arm, [0.4, angle], "tip2_manipulability tip2_condition")
    expected = l1 * l2 * abs(math.sin(angle))
    assert w == pytest.approx(expected, rel=1e-13)
    size = l1**2 + 2 * l2**2 + 2 * l1 * l2 * math.cos(angle)  # |J|^2 = |l1 + l2 e|^2 + l2^2
    large = (size + math.sqrt(size**2 - 4 * expected**2)) / 2
    assert condition == pytest.approx(large / expected, rel=1e-12)


def test_where_a_jacobian_is_singular() -> None:
    arm = rd.load(TWO_LINKS)
    w, condition = one(arm, [0.4, 0.0], "tip2_manipulability tip2_condition")
    assert w < 1e-15
    assert math.isnan(condition)
    bar = rd.load(FOUR_BAR)  # of one joint J J^T has rank one
    found = one(bar, rd.assemble(bar, [1.0]), "tip2_manipulability tip2_condition")
    assert found == [0.0, 1.0]


@pytest.mark.parametrize("seed", range(6))
def test_manipulability_and_condition_of_random_arms(seed: int) -> None:
    plain = seeded_tree(seed, 5)
    mech, q = plain.mechanism, plain.q
    k = mech.n
    J = np.zeros((2, k))
    h = 1e-6
    for j in range(k):  # central differences, of a cubic's error
        far = [
            rd.points(mech, q + way * h * np.eye(k)[j], of=f"tip{k}").position[0] for way in (1, -1)
        ]
        J[:, j] = (far[0] - far[1]) / (2 * h)
    expected = math.sqrt(np.linalg.det(J @ J.T)), np.linalg.cond(J)
    found = one(mech, q, f"tip{k}_manipulability tip{k}_condition")
    assert found == pytest.approx(expected, rel=1e-6)


# -- ratios ----------------------------------------------------------------------------------------


def test_the_ratio_of_a_free_joint_is_that_of_its_motion() -> None:
    """A cart-pole has one actuator and two freedoms: its rates are those given."""
    mech = rd.load(ROOT / "robots/cart-pole.yaml")
    assert one(mech, [0.1, 1.0], "pole/cart", qd=[0.5, 2.0]) == [4.0]


def test_couplings_have_columns() -> None:
    mech = mechanism(TWO_LINKS.read_text() + "couplings: [q2 = -2 q1]\n")
    q = [0.3, -0.6]
    found = one(mech, q, "tc1 tau1")
    lam = rd.inverse_dynamics_and_forces(mech, q, [0, 0], [0, 0])
    assert found == [*rd.coupling_torques(mech, lam.multipliers), lam.tau[0]]
