"""The equations in symbols against Lagrange's, derived by sympy, and against the closed form."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from conftest import FRESH
from hypothesis import HealthCheck, given, settings
from read_equations import lines, module
from sliding_scenes import BLOCK, SLIDING_SCENES
from unwritten import TIMED, UNWRITTEN

import oracles
from random_mechanisms import (
    LOOPS,
    Scene,
    Sizes,
    assert_close,
    forced,
    loops,
    mechanism,
    oracle_tree,
    seeded_scene,
    seeded_tree,
    sizes,
    trees,
)
from robodyn.dynamics import closed_form, dynamics
from robodyn.equations.code import python
from robodyn.equations.latex import latex
from robodyn.equations.recorded import recorded
from robodyn.equations.text import as_json, text
from robodyn.equations.written import equations
from robodyn.loops import closures
from robodyn.mechanics.mechanism import Mechanism, load

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
NAMES = sorted({path.stem for path in ROBOTS.glob("*.yaml")} - UNWRITTEN - TIMED)
FEW = settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))


# Against the closed form in numbers, which other tests hold against Lagrange and Newton-Euler


def assert_same(mech: Mechanism, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> None:
    size = sizes(mech.description)
    if mech.slides or mech.description.couplings:  # what reaches further than links do
        far = 1.0 + np.abs(q).max() / mech.unit
        loop = max([size.loop, *(row.size for row in mech.rows)])
        size = Sizes(size.inertia * far**2, size.gravity * far, size.damping, loop * far)
    whole = size.torque(qd, qdd)
    for numeric in (False, True):
        found = module(mech, numeric)
        assert_close(found["M"](q), closed_form.mass_matrix(mech, q), size.inertia)
        assert_close(found["C"](q, qd), closed_form.coriolis_matrix(mech, q, qd), size.coriolis(qd))
        D = np.diag(mech.damping)
        assert_close(found["D"]() if "D" in found else np.zeros_like(D), D, 1.0)
        G, Q = closed_form.gravity_vector(mech, q), closed_form.other_forces(mech, q, qd)
        scale = max(1.0, np.abs(G).max(), np.abs(Q).max(), size.gravity)
        assert_close(found["G"](q) if "G" in found else np.zeros(mech.n), G, scale)
        assert_close(found["Q"](q, qd) if "Q" in found else np.zeros(mech.n), Q, scale, 1e-12)
        left = closed_form.mass_matrix(mech, q) @ qdd + G - Q
        left += closed_form.coriolis_matrix(mech, q, qd) @ qd + D @ qd
        name = "joint_torques" if mech.rows else "inverse_dynamics"
        assert_close(found[name](q, qd, qdd), left, whole + scale, 1e-12)
        if not mech.rows:
            assert not {"Psi", "Psidot_qd", "gap"} & set(found)
            if not mech.passive:
                tau = dynamics.inverse_dynamics(mech, q, qd, qdd)
                assert_close(found[name](q, qd, qdd), tau, whole + scale, 1e-12)
            continue
        speed = float(np.abs(qd).sum()) ** 2
        assert_close(found["Psi"](q), closures.closure_jacobian(mech, q, t=0.0), size.loop)
        bias = closures.closure_bias(mech, q, qd, t=0.0)
        assert_close(found["Psidot_qd"](q, qd), bias, size.loop * speed)
        assert_close(found["gap"](q), closures.closure_gap(mech, q, t=0.0), size.loop)


@pytest.mark.parametrize("name", NAMES)
def test_scenes_of_robots(name: str) -> None:
    mech = load(ROBOTS / f"{name}.yaml")
    rng = np.random.default_rng(7)
    for _ in range(5):
        assert_same(mech, *rng.uniform(-3, 3, (3, mech.n)))


@pytest.mark.parametrize("name", SLIDING_SCENES)
def test_prismatic_joints_slots_and_blocks(name: str) -> None:
    mech = mechanism(SLIDING_SCENES[name])
    rng = np.random.default_rng(8)
    for _ in range(3):
        assert_same(mech, *rng.uniform(-2, 2, (3, mech.n)))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("shape", LOOPS)
@pytest.mark.thinned
def test_random_loops(shape: str, seed: int) -> None:
    assert_same((scene := seeded_scene(seed, LOOPS[shape])).mechanism, *scene.states)


@pytest.mark.parametrize("seed", range(6))
def test_random_trees(seed: int) -> None:
    scene = seeded_tree(seed, 1 + seed)
    assert_same(scene.mechanism, *scene.states)


@pytest.mark.parametrize("seed", range(8))
def test_springs_loads_and_friction(seed: int) -> None:
    shape = list(LOOPS.values())[seed % len(LOOPS)]
    plain = seeded_scene(seed, shape) if seed % 2 else seeded_tree(seed, 3)
    scene = forced(seed, plain)
    assert_same(scene.mechanism, *scene.states)


@FEW
@given(trees())
def test_trees_of_numbers_that_coincide(scene: Scene) -> None:
    assert_same(scene.mechanism, *scene.states)


@FEW
@given(loops())
def test_loops_of_numbers_that_coincide(scene: Scene) -> None:
    assert_same(scene.mechanism, *scene.states)


@pytest.mark.parametrize("seed", range(3 if FRESH else 1))
def test_against_lagrange_in_numbers(seed: int) -> None:
    """Without the closed form in between."""
    scene = seeded_tree(10 + seed, 4)
    mech = scene.mechanism
    known = oracles.sympy_terms(oracle_tree(mech.description), mech.gamma)(scene.q, scene.qd)
    found, size = module(mech), sizes(mech.description)
    assert_close(found["M"](scene.q), known.M, size.inertia)
    assert_close(found["C"](scene.q, scene.qd), known.C, size.coriolis(scene.qd))
    assert_close(found["G"](scene.q), known.G, size.gravity)


# Against Lagrange's equations in symbols


def lagrange(bodies: list, height: list, gaps: list, n: int) -> dict:
    """M, C, G, Psi, Psidot qd and gap from (mass, x, y, inertia, angle) of every body."""
    q, qd = sp.symbols(f"q1:{n + 1}"), sp.symbols(f"qd1:{n + 1}")

    def rate(expression):
        return sum(sp.diff(expression, a) * v for a, v in zip(q, qd, strict=True))

    KE = sum((m * (rate(x) ** 2 + rate(y) ** 2) + I * rate(a) ** 2) / 2 for m, x, y, I, a in bodies)
    PE = sp.Symbol("g") * sum(m * y for m, y in height)
    M = sp.hessian(KE, qd)
    C = sp.Matrix(
        n,
        n,
        lambda i, j: sum(
            (sp.diff(M[i, j], q[k]) + sp.diff(M[i, k], q[j]) - sp.diff(M[j, k], q[i])) * qd[k] / 2
            for k in range(n)
        ),
    )
    Psi = sp.Matrix([[sp.diff(gap, a) for a in q] for gap in gaps])
    return {
        "M": M.tolist(),
        "C": C.tolist(),
        "G": [sp.diff(PE, a) for a in q],
        "Psi": Psi.tolist(),
        "Psidot_qd": [
            sum(rate(entry) * v for entry, v in zip(row, qd, strict=True)) for row in Psi.tolist()
        ],
        "gap": gaps,
    }


def chain(n: int, start: tuple = (0, 0), first: int = 1) -> tuple[list, tuple, list]:
    """Bodies of n links in series, the tip of the last, and each link's tip."""
    bodies, (x, y), angle, tips = [], start, 0, []
    for k in range(first, first + n):
        m, l, r, I, q = sp.symbols(f"m{k} l{k} r{k} I{k} q{k}")
        angle = angle + q
        bodies.append((m, x + r * sp.cos(angle), y + r * sp.sin(angle), I, angle))
        x, y = x + l * sp.cos(angle), y + l * sp.sin(angle)
        tips.append((x, y))
    return bodies, (x, y), tips


def derived(name: str) -> dict:
    if name in ("2r", "3r"):
        bodies, _, _ = chain(n := int(name[0]))
        return lagrange(bodies, [(m, y) for m, _, y, _, _ in bodies], [], n)
    bodies, tip, _ = chain(2)
    if name == "four-bar":
        rocker, other, _ = chain(1, (sp.Symbol("x3"), 0), 3)
        bodies += rocker
        gaps, n = [tip[0] - other[0], tip[1] - other[1]], 3
    else:
        bodies.append((sp.Symbol("mp2"), *tip, 0, 0))  # the piston
        gaps, n = [tip[1] - sp.Symbol("b1y")], 2
    return lagrange(bodies, [(m, y) for m, _, y, _, _ in bodies], gaps, n)


@pytest.mark.parametrize("name", ["2r", "3r", "four-bar", "slider-crank"])
def test_entries_are_those_of_lagrange(name: str) -> None:
    written = json.loads(as_json(equations(load(ROBOTS / f"{name}.yaml"))))
    known = derived(name)
    for block, entries in known.items():
        if not entries:
            assert block not in written
            continue
        found = sp.Matrix(written[block]) - sp.Matrix(entries)
        left = found.applyfunc(lambda entry: sp.expand(entry.rewrite(sp.exp)))
        assert left == sp.zeros(*found.shape), block


# How they are written


def test_the_2r_arm_is_the_lectures_equation_27() -> None:
    found = lines(text(equations(load(ROBOTS / "2r.yaml"))))
    for formula in (
        "M qdd + C qd + G = tau",
        "M11 = m1 r1² + I1 + m2 (l1² + r2² + 2 l1 r2 cos(q2)) + I2",
        "M12 = M21 = m2 (r2² + l1 r2 cos(q2)) + I2",
        "M22 = m2 r2² + I2",
        "C11 = -m2 l1 r2 qd2 sin(q2)",
        "C12 = -m2 l1 r2 (qd1 + qd2) sin(q2)",
        "C21 = m2 l1 r2 qd1 sin(q2)",
        "C22 = 0",
        "G1 = g ((m1 r1 + m2 l1) cos(q1) + m2 r2 cos(q1 + q2))",
        "G2 = m2 g r2 cos(q1 + q2)",
    ):
        assert formula in found


def test_the_four_bar() -> None:
    found = lines(text(equations(load(ROBOTS / "four-bar.yaml"))))
    for formula in (
        "M qdd + C qd + G = tau + Psi^T lambda",
        "tau = (tau1, 0, 0)",
        "M13 = M23 = M31 = M32 = 0",
        "G3 = m3 g r3 cos(q3)",
        "Psi11 = -l1 sin(q1) - l2 sin(q1 + q2)",
        "Psi23 = -l3 cos(q3)",
        "(Psidot qd)1 = -l1 qd1² cos(q1) - l2 (qd1 + qd2)² cos(q1 + q2) + l3 qd3² cos(q3)",
        "gap1 = l1 cos(q1) + l2 cos(q1 + q2) - l3 cos(q3) - x3",
        "gap2 = l1 sin(q1) + l2 sin(q1 + q2) - l3 sin(q3)",
    ):
        assert formula in found


def test_the_cart_pole() -> None:
    found = lines(text(equations(load(ROBOTS / "cart-pole.yaml"))))
    for formula in (
        "M qdd + C qd + D qd + G = tau + Q",
        "tau = (tau1, 0)",
        "M11 = m1 + m2",
        "M12 = M21 = -m2 r2 sin(q2)",
        "M22 = m2 r2² + I2",
        "C12 = -m2 r2 qd2 cos(q2)",
        "C11 = C21 = C22 = 0",
        "G2 = m2 g r2 cos(q2)",
        "Q1 = -ff1 tanh(qd1/wf1)",
    ):
        assert formula in found
    legend = " ".join(text(equations(load(ROBOTS / "cart-pole.yaml"))).split())
    for told in (
        "q1 m displacement of cart along its axis",
        "tau1 N force on cart along its axis",
        "ff1 0.0005 N friction at the joint of cart",
        "wf1 0.01 m/s rate that smooths",
        "M in kg m², kg m or kg,",
        "G in N m or N,",
    ):
        assert told in legend


RP = """
gravity: 9.81
links:
  - {name: upper, m: 1.5, l: 0.3, r: 0.2, I: 0.05}
  - {name: boom, joint: prismatic, axis: %s, m: 0.9, l: 0.5, r: 0.2, I: 0.03}
"""


def test_an_arm_with_a_sliding_link() -> None:
    found = lines(text(equations(mechanism(RP % "[1, 0]"))))
    squares = "l1² + r2² + 2 l1 r2 + 2 r2 q2 + 2 l1 q2 + q2²"
    for formula in (
        f"M11 = m1 r1² + I1 + m2 ({squares}) + I2",
        "M22 = m2",
        "M12 = M21 = 0",
        "C11 = m2 (l1 + r2 + q2) qd2",
        "C12 = m2 (l1 + r2 + q2) qd1",
        "C21 = -m2 (l1 + r2 + q2) qd1",
        "G2 = m2 g sin(q1)",
    ):
        assert formula in found
    turned = lines(text(equations(mechanism(RP % "[1, 0.2]"))))
    assert "M12 = M21 = m2 u2y l1" in turned
    assert "C12 = m2 (u2x l1 + r2 + q2) qd1" in turned
    assert "M12 = M21 = -m2 l1" in lines(text(equations(mechanism(RP % "[0, -1]"))))


def test_a_slot_on_a_moving_link_has_differences_of_angles() -> None:
    found = lines(text(equations(load(ROBOTS / "whitworth.yaml"))))
    for formula in (
        "gap1 = -y2 cos(q2) + l1 sin(q1 - q2)",
        "Psi11 = l1 cos(q1 - q2)",
        "Psi12 = y2 sin(q2) - l1 cos(q1 - q2)",
    ):
        assert formula in found


def test_an_angle_that_is_kept() -> None:
    found = text(equations(mechanism(BLOCK)))
    gap = "gap2 = -L1 (beta1y cos(q1 + q2 - q3) - beta1x sin(q1 + q2 - q3))"
    assert gap in lines(found)
    assert "L1 times this is the moment of closure 1 on block" in found
    straight = lines(text(equations(mechanism(BLOCK.replace("20deg", "90deg")))))
    assert "gap2 = -L1 cos(q1 + q2 - q3)" in straight


def test_numbers_put_in() -> None:
    found = lines(text(equations(load(ROBOTS / "2r.yaml"), numeric=True)))
    assert "M22 = 0.08725" in found  # 0.9 * 0.25^2 + 0.031
    assert "C12 = -0.18 (qd1 + qd2) sin(q2)" in found
    assert "G2 = 2.20725 cos(q1 + q2)" in found


ARM = """links:
  - {{name: a, m: 2, l: 1, r: {r}, I: {I}{more}}}
  - {{name: b, m: 4, l: 1, r: 0.5, I: 0.25}}
"""


def arm(head: str = "", r: object = 0.5, I: float = 0.25, more: str = "") -> Mechanism:
    return mechanism(head + ARM.format(r=r, I=I, more=more))


def test_no_gravity_no_G() -> None:
    found = equations(arm())
    assert [block.name for block in found.side("left")] == ["M", "C"]
    assert "M qdd + C qd = tau" in text(found)
    assert "g" in found.zero


def test_a_gravity_vector() -> None:
    found = lines(text(equations(arm("gravity: [0.5, -9]\n"))))
    assert "G2 = m2 gx r2 sin(q1 + q2) - m2 gy r2 cos(q1 + q2)" in found


def test_what_is_zero_drops_out() -> None:
    found = equations(arm("gravity: 9.81\n", r=0, I=0))
    assert found.zero == ("r1", "I1")
    assert found.unused == ("m1", "l2")
    assert "M11 = m2 (l1² + r2² + 2 l1 r2 cos(q2)) + I2" in lines(text(found))
    assert "Left out, being 0 in this scene: r1, I1." in text(found)


def test_a_centre_of_gravity_off_the_axis() -> None:
    found = lines(text(equations(arm("gravity: 9.81\n", r="[0.4, 0.1]"))))
    assert "G1 = g ((m1 r1x + m2 l1) cos(q1) - m1 r1y sin(q1) + m2 r2 cos(q1 + q2))" in found


def test_damping_is_one_matrix() -> None:
    found = text(equations(arm(more=", damping: 0.3, payload: 0.2")))
    assert "M qdd + C qd + D qd = tau" in found
    assert "D = diag(d1, 0)" in found
    assert "mp1" in found


def test_friction_and_a_joint_spring() -> None:
    head = "springs: [{joint: b, stiffness: 3, angle: 0.2, damping: 0.1}]\n"
    head += "loads: [{link: a, torque: 2}]\n"
    found = lines(text(equations(arm(head, more=", friction: {torque: 0.5, speed: 0.01}"))))
    assert "M qdd + C qd + D qd + G = tau + Q" in found
    assert "G1 = -T1" in found
    assert "G2 = k1 (q2 - phi1)" in found
    assert "D = diag(0, ds1)" in found
    assert "Q1 = -tf1 tanh(qd1/wf1)" in found
    numeric = lines(text(equations(arm(head, more=", friction: {torque: 0.5, speed: 0.01}"), True)))
    assert "G2 = 3 q2 - 0.6" in numeric
    assert "Q1 = -0.5 tanh(qd1/0.01)" in numeric


def test_a_spring_between_points() -> None:
    head = "springs: [{between: [b, [2, 0]], stiffness: 3, length: 0.5}]\n"
    found = lines(text(equations(arm(head))))
    assert "S1x = l1 cos(q1) + l2 cos(q1 + q2) - h1x" in found
    assert "S1 = sqrt(S1x² + S1y²)" in found
    assert "K1 = k1 (1 - S01/S1)" in found
    assert "G2 = K1 l2 (S1y cos(q1 + q2) - S1x sin(q1 + q2))" in found


def test_a_spring_whose_ends_never_move_does_nothing() -> None:
    head = "springs: [{between: [{link: a, at: [0, 0]}, [2, 0]], stiffness: 3, length: 0.5}]\n"
    found = equations(arm(head))
    assert "M qdd + C qd = tau" in text(found)
    assert found.unused == ("l2", "k1", "S01", "h1x")


def test_a_spring_without_a_free_length_is_multiplied_out() -> None:
    """On one branch S drops out, and what balances gravity shows; across branches it has a name."""
    head = "gravity: 9.81\nsprings: [{between: [a, [0, 2]], stiffness: 3, length: 0}]\n"
    found = lines(text(equations(arm(head))))
    assert "G1 = g ((m1 r1 + m2 l1) cos(q1) + m2 r2 cos(q1 + q2)) - k1 l1 h1y cos(q1)" in found
    head = "springs: [{between: [b, [0.5, 0]], stiffness: 3, length: 0}]\n"
    assert "G2 = k1 l2 (h1x sin(q1 + q2) - l1 sin(q2))" in lines(text(equations(arm(head))))
    two = seeded_scene(1, LOOPS["four-bar"])
    across = two.text + (
        "springs: [{between: [{link: link0, at: [0.1, 0]}, {link: link2, at: [0.2, 0]}], "
        "stiffness: 5, length: 0}]\n"
    )
    mech = mechanism(across)
    assert "S1x = " in text(equations(mech))
    assert_same(mech, *two.states)


def test_the_balanced_arm_has_no_G() -> None:
    """Its numbers balance exactly, as decimal numbers; in floats a little is left."""
    mech = load(ROBOTS / "balanced-arm.yaml")
    assert "G = 0" in text(equations(mech, numeric=True))
    assert 0.0 < np.abs(closed_form.gravity_vector(mech, [0.3, 0.4])).max() < 1e-13


@pytest.mark.parametrize(
    "head",
    [
        "springs: [{between: [a, [2, 1]], stiffness: 0, length: 0.3, damping: 2}]",
        "springs: [{between: [a, [2, 1]], stiffness: 3, length: 0, damping: 2}]",
        "springs: [{between: [a, [2, 1]], stiffness: 0, length: 0.3}]",
        "springs: [{joint: b, stiffness: 0, angle: 1, damping: 2}]",
        "springs: [{joint: b, stiffness: 2, angle: 0}]",
        "loads: [{link: a, at: [0, 0], force: [1, 2]}]",
        "loads: [{link: b, at: [0.5, 0], force: [0, 0], frame: link}]",
        "loads: [{link: b, at: [0.5, 0], force: [0, 3], frame: link}, {link: a, torque: 0}]",
        "couplings: ['q2 = 0.5 q1']",
    ],
)
def test_forces_with_zeros(head: str) -> None:
    mech = arm(head + "\n")
    rng = np.random.default_rng(6)
    for _ in range(2):
        assert_same(mech, *rng.uniform(-1, 1, (3, 2)))
    assert "sqrt" not in python(recorded(mech))  # no spring of these asks for its length


def test_a_coupling_is_linear_in_q() -> None:
    head = "couplings: ['q2 = -2 q1 + 0.5']\n"
    found = equations(arm(head))
    assert "gap1 = R1 (q2 - i1 q1 - psi1)" in lines(text(found))
    assert "(Psidot qd)" not in text(found)
    mech = arm("couplings: ['q2 = q1']\n")
    assert "gap1 = R1 (q2 - q1)" in lines(text(equations(mech)))
    rng = np.random.default_rng(4)
    for each in (arm(head), mech):
        assert_same(each, *rng.uniform(-3, 3, (3, 2)))


def test_what_cancels_on_paper_cancels() -> None:
    """0.3 * 0.1 and 0.1 * 0.3 are not 0.03 in floats: a balanced link has no G."""
    mech = mechanism(
        "gravity: 9.81\nlinks: [{name: a, m: 0.7, l: 0.1, r: [-0.3, 0], I: 1, payload: 2.1}]"
    )
    assert mech.B[0] != 0  # rounding
    assert "G = 0" in text(equations(mech, numeric=True))


def test_the_same_point_has_one_symbol() -> None:
    """Links 3 and 4 hang from one point of link 2, where the closure ends as well."""
    found = equations(
        mechanism(
            """
links:
  - {name: a, m: 1, l: 1, r: 0.4, I: 0.1}
  - {name: b, m: 1, l: 0.9, r: 0.3, I: 0.1}
  - {name: c, m: 1, l: 0.8, r: 0.2, I: 0.1, from: {link: b, at: [0.3, 0.2]}}
  - {name: d, m: 1, l: 0.7, r: 0.1, I: 0.1, from: {link: b, at: [0.3, 0.2]}}
  - {name: e, m: 1, l: 0.6, r: 0.5, I: 0.1, from: [1, 0.5]}
closures: [[{link: b, at: [0.3, 0.2]}, e]]
"""
        )
    )
    names = [parameter.name for parameter in found.parameters]
    assert [name for name in names if name[0] in "pabxy"] == ["p3x", "p3y", "x5", "y5"]


def long_chain(n: int, seed: int = 0) -> Mechanism:
    """Links in series; with a seed the fourth slides, the sixth has a motor and two branches."""
    rng, links = np.random.default_rng(seed), []
    for k in range(n):
        m, length, x, y, inertia = rng.uniform(0.2, 1.0, 5)
        link = f"name: n{k}, m: {m}, I: {inertia}, r: [{x}, {y}], l: {length}"
        link += ", joint: prismatic, axis: [0.6, 0.8]" if seed and k == 3 else ""
        link += ", motor: {inertia: 0.3, ratio: 5}" if seed and k == 5 else ""
        link += ", from: n5" if seed and k == n - 2 else ""
        links.append(f"  - {{{link}}}\n")
    return mechanism("gravity: 9.81\nlinks:\n" + "".join(links))


@pytest.mark.parametrize("numeric", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_long_chains_have_names_for_shared_parts(seed: int, numeric: bool) -> None:
    mech = long_chain(13, seed)
    content = json.loads(as_json(equations(mech, numeric)))
    q, qd = np.random.default_rng(5).uniform(-2, 2, (2, mech.n))
    scope: dict = {"sin": np.sin, "cos": np.cos}
    scope |= {name: entry["value"] for name, entry in content["symbols"].items()}
    scope |= {f"q{k + 1}": x for k, x in enumerate(q)}
    scope |= {f"qd{k + 1}": x for k, x in enumerate(qd)}
    for name, formula in content["definitions"].items():
        scope[name] = eval(formula, scope)
    M, C = (np.array([[eval(x, scope) for x in row] for row in content[name]]) for name in "MC")
    expected = closed_form.mass_matrix(mech, q), closed_form.coriolis_matrix(mech, q, qd)
    assert_close(M, expected[0], np.abs(expected[0]).max(), 1e-12)
    assert_close(C, expected[1], np.abs(expected[1]).max(), 1e-12)
    entries = [x for name in "MC" for row in content[name] for x in row]
    used = " ".join([*content["definitions"].values(), *entries])
    assert set(content["definitions"]) <= set(re.findall(r"\w+", used))


def test_the_text_of_a_chain_grows_with_the_cube_of_its_length() -> None:
    """Multiplied out it is about 2^5 times as long when the chain is twice as long."""
    sizes_of = [len(text(equations(long_chain(n)))) for n in (12, 24)]
    assert sizes_of[1] < 2**3.3 * sizes_of[0]
    legend = text(equations(long_chain(12))).split("\nwhere\n")[1]
    assert legend.count("mass matrix by absolute angles") == 1
    assert r"$W_{j,k}$" in latex(equations(long_chain(12)))


@pytest.mark.parametrize("width", [20, 60, 100, 200])
def test_lines_are_no_wider_than_asked(width: int) -> None:
    """But for what cannot be broken."""
    found = text(equations(load(ROBOTS / "3r.yaml")), width).split("\nwhere\n")[0]
    assert max(map(len, found.splitlines())) <= max(width, 60)
    whole = lines(text(equations(load(ROBOTS / "3r.yaml")), 1000))
    assert [line.replace(" ", "") for line in lines(found)] == [x.replace(" ", "") for x in whole]


def test_a_watch_is_told_how_far_it_is() -> None:
    parts: list[float] = []
    head = "springs: [{between: [b, [2, 0]], stiffness: 3, length: 0.5, damping: 1}]\n"
    equations(arm(head + "couplings: ['q2 = -2 q1 + 0.5']\n"), watch=parts.append)
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert len(set(parts)) > 10
