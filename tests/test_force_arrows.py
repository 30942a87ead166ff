"""Forces as arrows, against statics by hand and the sums that must vanish."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import ROOT
from each_case import each

import robodyn
from random_mechanisms import LOOPS, Pose, forced, oracle_tree, seeded_scene, seeded_tree
from robodyn.dynamics import dynamics
from robodyn.mechanics import mechanism
from robodyn.pictures.force_arrows import (
    LONGEST,
    Force,
    arc,
    arrows,
    forces,
    forces_at,
    metres_a_newton,
    with_prefix,
)
from robodyn.scene import description
from robodyn.scene.scene import Load, Spring


def found_at(name: str, q, qd=None, qdd=None):
    mech = robodyn.load(ROOT / f"robots/{name}.yaml")
    q = robodyn.assemble(mech, q) if mech.rows else np.array(q)
    zero = np.zeros(mech.n)
    qd, qdd = zero if qd is None else np.array(qd), zero if qdd is None else np.array(qdd)
    solution = dynamics.inverse_dynamics_and_forces(mech, q, qd, qdd)
    return mech, forces(mech, q, qd, qdd, solution.multipliers)


def test_a_pendulum_at_rest() -> None:
    mech, found = found_at("pendulum", [-1.0])
    weight = mech.description.links[0].m * 9.81
    assert [(f.kind, f.name) for f in found] == [("gravity", "m1 g"), ("pin", "r1")]
    assert found[0].force == pytest.approx(-1j * weight)
    assert found[0].place == pytest.approx(0.26 * np.exp(-1j))
    assert found[1].force == pytest.approx(1j * weight)
    assert found[1].place == 0


def test_a_spinning_pendulum_is_held_towards_its_pivot() -> None:
    mech, found = found_at("pendulum", [0.5], [40.0])
    link = mech.description.links[0]
    pull = found[1].force + found[0].force  # with the weight: m times the acceleration
    assert pull == pytest.approx(-link.m * link.r.real * 40.0**2 * np.exp(0.5j))


@each("seed", range(6))
@each("shape", ["four-bar", "slider-crank", "five-bar", "loop in a tree"])
def test_all_forces_on_a_link_make_its_acceleration(seed: int, shape: str) -> None:
    """Of a link that carries nothing but closures: gravity, its joint and its pins."""
    scene = seeded_scene(seed, LOOPS[shape])
    mech = scene.mechanism
    q, qd, qdd = scene.states
    multipliers = dynamics.inverse_dynamics_and_forces(mech, q, qd, qdd).multipliers
    found = {f.name: f for f in forces(mech, q, qd, qdd, multipliers)}
    links = mech.description.links
    pose = Pose(oracle_tree(mech.description), q)
    checked = 0
    for k, link in enumerate(links):
        if any(other.hangs_from.link == k for other in links):
            continue
        total = found[f"r{k + 1}"].force
        inertia = 0j
        for mass, at, name in (
            (link.m, link.r, f"m{k + 1} g"),
            (link.payload, complex(link.l), f"payload {k + 1} g"),
        ):
            if mass:
                place = (k, at)
                assert found[name].place == pytest.approx(pose.position(place))
                total += found[name].force
                inertia += mass * (pose.slope(place) @ qdd + pose.bias(place, qd))
        for c, closure in enumerate(mech.description.closures):
            if closure.first.link == k:
                total += found[f"f{c + 1}"].force
                at_pin = pose.position((k, closure.first.at))
                assert found[f"f{c + 1}"].place == pytest.approx(at_pin)
            elif closure.second.link == k:
                total -= found[f"f{c + 1}"].force
        assert abs(total - inertia) < 1e-9 * (1 + abs(inertia))
        checked += 1
    assert checked


@pytest.mark.parametrize("seed", range(4))
def test_springs_and_loads(seed: int) -> None:
    scene = forced(seed, seeded_tree(seed, 3))
    mech, (q, qd, qdd) = scene.mechanism, scene.states
    found = {f.name: f for f in forces(mech, q, qd, qdd, np.zeros(0))}
    pose = Pose(oracle_tree(mech.description), q)
    shown = 0
    for k, spring in enumerate(mech.description.springs, start=1):
        if not isinstance(spring, Spring):
            assert f"s{k}" not in found
            continue
        ends = [(p.link, p.at) for p in (spring.first, spring.second)]
        d = pose.position(ends[0]) - pose.position(ends[1])
        rate = (np.conj(d) * ((pose.slope(ends[0]) - pose.slope(ends[1])) @ qd)).real / abs(d)
        pull = spring.stiffness * (abs(d) - spring.length) + spring.damping * rate
        assert found[f"s{k}"].force == pytest.approx(-pull * d / abs(d))
        assert found[f"s{k}"].place == pytest.approx(pose.position(ends[0]))
        shown += 1
    for k, item in enumerate(mech.description.loads, start=1):
        if not isinstance(item, Load):
            assert f"load {k}" not in found
            continue
        turned = np.exp(1j * pose.alpha[item.point.link]) if item.turns else 1.0
        assert found[f"load {k}"].force == pytest.approx(item.force * turned)
        place = pose.position((item.point.link, item.point.at))
        assert found[f"load {k}"].place == pytest.approx(place)
        shown += 1
    assert shown >= 2


def test_forces_that_vanish_have_no_arrow() -> None:
    _, found = found_at("pendulum", [0.3])
    floating = mechanism.build(
        description.from_text("links: [{name: a, m: 1, l: 1, r: 0.5, I: 1}]", "x.yaml")
    )
    zero = np.zeros(1)
    assert forces(floating, zero, zero, zero, np.zeros(0)) == []
    scale = metres_a_newton(found, 0.5)
    assert max(abs(f.force) for f in found) * scale == pytest.approx(LONGEST * 0.5)


def test_an_arrow_that_would_lie_on_another_ends_where_it_acts() -> None:
    mech = robodyn.load(ROOT / "robots/four-bar.yaml")
    q = robodyn.assemble(mech, [np.pi / 3])
    qd = robodyn.loop_velocities(mech, q, [5.0])
    _, found = found_at("four-bar", [np.pi / 3], qd, robodyn.loop_accelerations(mech, q, qd, [0.0]))
    placed = dict(zip([f.name for f in found], arrows(found, 0.02), strict=True))
    force = {f.name: f for f in found}
    assert placed["m3 g"][0] == force["m3 g"].place
    assert placed["r3"][1] == force["r3"].place
    for name, (tail, head) in placed.items():
        assert head - tail == pytest.approx(0.02 * force[name].force)
        assert force[name].place in (tail, head)


def test_driving_torques() -> None:
    """Of a joint that turns an arc; of one that slides a force along it, of its weight here."""
    mech = robodyn.load(ROOT / "robots/rp-arm.yaml")
    q, rest = np.array([0.5, 0.3]), np.zeros(2)
    found = {f.name: f for f in forces_at(mech, q, rest)}
    weights = found["m1 g"], found["m2 g"]
    moment = -sum((f.place.conjugate() * f.force).imag for f in weights)
    assert (found["tau1"].kind, found["tau1"].force, found["tau1"].place) == ("drive", 0, 0)
    assert found["tau1"].torque == pytest.approx(moment)
    along = np.exp(0.5j)
    assert found["tau2"].torque == 0.0
    expected = -(found["m2 g"].force * along.conjugate()).real * along
    assert found["tau2"].force == pytest.approx(expected)
    given = {f.name: f for f in forces_at(mech, q, rest, tau=np.array([-3.0, 0.0]))}
    assert (given["tau1"].torque, "tau2" in given) == (-3.0, False)


def test_an_arc_turns_as_its_torque() -> None:
    for torque in (2.0, -2.0):
        z = arc(Force("drive", "tau1", 1 + 2j, 0j, torque), 0.5) - (1 + 2j)
        assert np.abs(z) == pytest.approx(0.5)
        assert (np.sign(torque) * np.angle(z[1:] / z[:-1]) > 0.0).all()


def test_no_force_at_all() -> None:
    text = "gravity: 0\nlinks: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
    mech = mechanism.build(description.from_text(text, "x.yaml"))
    assert forces_at(mech, np.ones(1), np.zeros(1)) == []


def test_prefixes() -> None:
    for value, text in (
        *((1149.6, "1.15 kN"), (999.4, "999 N"), (999.6, "1 kN"), (1e3, "1 kN"), (12.34, "12.3 N")),
        *((0.1, "0.1 N"), (0.0996, "99.6 mN"), (2.5e-5, "25 µN"), (3.21e7, "32.1 MN")),
        *((1e-3, "1 mN"), (1e6, "1 MN"), (4e15, "4e+15 N"), (4e-12, "4e-12 N")),
    ):
        assert with_prefix(value, "N") == text
