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
from robodyn.pictures.force_arrows import LONGEST, arrows, forces, metres_a_newton
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
