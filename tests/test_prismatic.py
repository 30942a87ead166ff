"""Prismatic joints, slots on moving links and blocks that keep their angle.

Held against a Lagrangian that sympy derives from Cartesian coordinates in 30 digits, against closed
forms of textbook mechanisms, and against the identities that every mechanism must keep.
"""

from __future__ import annotations

import cmath
import itertools
import math
import random

import numpy as np
import pytest
from conftest import FIRST_SEED, FRESH, ROOT
from known_terms import Known
from lagrangian_terms import Terms, check_accelerations, exact_acceleration
from reference_motions import moved_by_each
from sliding_scenes import BLOCK, COUPLED, MIXED, SLIDING
from sliding_trees import link, random_tree, text_of

import oracles
import robodyn
from random_mechanisms import mechanism
from robodyn.dynamics import closed_form, dynamics, identities, reaction_forces
from robodyn.errors import DescriptionError, InputError
from robodyn.loops import assembly, closing, closures, loop_rates
from robodyn.loops.loop_rates import check_closed
from robodyn.mechanics.mechanism import build
from robodyn.mechanics.placed import placed
from robodyn.scene.description import from_text
from robodyn.scene.scene import BRANCHES

SEEDS = range(FIRST_SEED, FIRST_SEED + (400 if FRESH else 90))
METHODS = "DOP853", "taylor"


OPEN = {
    "RP": (None, 0),
    "PRP": (None, 0, 1),
    "PPRR": (None, 0, 1, 2),
    "PR": (None, 0),
    "RPPR": (None, 0, 1, 2),
    "RPRP": (None, 0, 0, 2),
    "PPP": (None, 0, None),
}


@pytest.mark.parametrize("joints", OPEN)
def test_open_trees_against_the_lagrangian(joints):
    """M, C, G, energies, and accelerations by every way of computing them."""
    parents = OPEN[joints]
    for seed in range(3 if FRESH else 1):
        rng = np.random.default_rng(100 + seed)
        tree, gamma = random_tree(seed, joints, parents), complex(*rng.uniform(-10, 10, 2))
        mech = mechanism(text_of(tree, gamma))
        q, qd, tau = rng.uniform(-2.0, 2.0, (3, mech.n))
        terms = Terms(oracles.sympy_terms(tree, gamma, backend="mpmath"), q, qd)
        for name, own in (
            ("M", closed_form.mass_matrix(mech, q)),
            ("C", closed_form.coriolis_matrix(mech, q, qd)),
            ("G", closed_form.gravity_vector(mech, q)),
        ):
            exact = np.array(getattr(terms, name), float)
            assert np.abs(own - exact).max() <= 4e-15 * (1.0 + np.abs(exact).max()), name
        energies = closed_form.kinetic_energy(mech, q, qd), closed_form.potential_energy(mech, q)
        assert energies == pytest.approx((float(terms.KE), float(terms.PE)), rel=1e-13, abs=1e-13)
        check_accelerations(mech, q, qd, tau, exact_acceleration(terms, tau))


def closed_scene(kind: str, seed: int):
    """A closed scene with random numbers: its tree, closures, lines and actuated joints."""
    rng = np.random.default_rng(seed)

    def about(x):
        return float(x * rng.uniform(0.9, 1.1))

    def body(name, parent, at, l, axis=None):
        r = complex(about(0.5 * l), rng.uniform(-0.05, 0.05))
        return link(name, about(1.0), l, r, about(0.05), parent, at, axis)

    if kind == "Scotch yoke":
        tree = [body("crank", None, 0j, about(0.3)), body("yoke", None, 0.1j, 0.2, 1.0 + 0.1j)]
        line = ((0, complex(tree[0]["l"])), (1, 0.05 + 0j), 0.2 + 1j)
        return tree, (), (line,), (0,)
    if kind == "Whitworth":
        tree = [body("crank", None, 0j, about(0.2)), body("lever", None, -0.5j, 1.1)]
        tree.append(body("rod", 1, 1.1 + 0j, 0.6))
        slot = ((0, complex(tree[0]["l"])), (1, 0.02j), 1.0 + 0.05j)
        ram = ((2, 0.6 + 0j), (None, 0.4j), 1.0 + 0j)
        return tree, (), (slot, ram), (0,)
    if kind == "hydraulic boom":
        tree = [body("boom", None, 0j, 2.0), body("barrel", None, 0.4 - 0.5j, 0.6)]
        tree.append(body("rod", 1, 0.6 + 0j, 0.1, 1.0 + 0j))
        return tree, (((2, 0.1 + 0j), (0, 0.9 + 0.1j)),), (), (2,)
    if kind == "slider-crank with a piston":
        tree = [body("crank", None, 0j, about(0.2)), body("rod", 0, 0j, about(0.7))]
        tree[1]["at"] = complex(tree[0]["l"])
        tree.append(body("piston", None, 0.05j, 0.1, 1.0 + 0j))
        return tree, (((1, complex(tree[1]["l"])), (2, 0j)),), (), (0,)
    assert kind == "elliptic trammel"
    tree = [body("x", None, 0j, 0.1, 1.0 + 0j), body("bar", 0, 0j, 0.8)]
    tree.append(body("y", None, 0j, 0.1, 1j))
    return tree, (((1, 0.8 + 0j), (2, 0j)),), (), (1,)


CLOSED = (
    "Scotch yoke",
    "Whitworth",
    "hydraulic boom",
    "slider-crank with a piston",
    "elliptic trammel",
)


def closed_states(mech, seed, count=4):
    """Closed states on every branch, away from singular ones."""
    rng, found = np.random.default_rng(seed), []
    plan = assembly.assembly_plan(mech)
    while len(found) < count:
        drawn = rng.uniform(-1.5, 1.5, len(mech.actuated))
        words = ["open"] * len(mech.description.closures)
        for c in plan.two_way:
            words[c] = ("open", "crossed")[rng.integers(2)]
        q, missing = assembly.attempt(mech, drawn, words, t=0.0)
        if missing <= 0.0 and not robodyn_singular(mech, q):
            found.append(q)
    return found


def robodyn_singular(mech, q):
    Psi = closures.scaled_jacobian(mech, q, t=0.0)[:, list(mech.passive)]
    return np.linalg.svd(Psi, compute_uv=False)[-1] < 0.05 * assembly.loop_size(mech)


@pytest.mark.parametrize("kind", CLOSED)
def test_loops_against_the_lagrangian(kind):
    """The gap, Psi and its rate, and accelerations by every way, on all branches."""
    for seed in range(2 if FRESH else 1):
        tree, loops, lines, actuated = closed_scene(kind, seed)
        gamma = complex(*np.random.default_rng(seed).uniform(-10, 10, 2))
        lines_unit = [(a, b, along / abs(along)) for a, b, along in lines]
        oracle = oracles.sympy_terms(tree, gamma, loops, "mpmath", lines=lines_unit)
        mech = mechanism(text_of(tree, gamma, loops, lines, actuated))
        rng = np.random.default_rng(seed)
        for q in closed_states(mech, seed):
            qd = robodyn.loop_velocities(mech, q, rng.normal(size=len(actuated)))
            tau = np.zeros(mech.n)
            tau[list(actuated)] = rng.normal(size=len(actuated))
            terms = Terms(oracle, q, qd)
            size = assembly.loop_size(mech)
            assert np.abs(np.array(terms.gap, float)).max() <= 1e-14 * size
            own = (
                closures.closure_jacobian(mech, q, t=0.0),
                closures.closure_bias(mech, q, qd, t=0.0),
            )
            assert np.abs(own[0] - np.array(terms.Psi, float)).max() <= 1e-14 * max(1.0, size)
            exact = np.array(terms.Psidot_qd, float)
            assert np.abs(own[1] - exact).max() <= 1e-13 * size * (1.0 + np.abs(qd).max() ** 2)
            check_accelerations(mech, q, qd, tau, exact_acceleration(terms, tau), 20.0)


FACING = """
links:
  - {name: crank, m: 1, l: 0.1, r: 0.05, I: 0.01}
  - {name: rod, m: 1, l: 0.1, r: 0.05, I: 0.01}
  - {name: block, m: 1, l: 0.1, r: 0.05, I: 0.01}
closures:
  - {point: block, on: {through: [0.1, 0.01], along: [0, -1]}, aligned: 0.5}
actuated: [crank]
"""  # the line's normal is +X, as the first direction of a pin


@pytest.mark.parametrize("text", [MIXED, COUPLED, BLOCK, SLIDING, FACING])
def test_identities(text):
    """With springs, loads, friction, dampers and couplings at joints of both kinds."""
    mech = mechanism(text)
    sample = identities.sample_states(mech, 8)
    assert len(sample.q) == 8
    for identity in identities.identities(mech, sample):
        assert identity.residual is not None, identity
        assert identity.residual <= 1e-11, identity


@pytest.mark.parametrize("text", [MIXED, COUPLED, BLOCK])
def test_every_method_moves_alike(text):
    mech = mechanism(text)
    _, _, ends = moved_by_each(mech, METHODS, 0.7, 1e-9)
    assert np.abs(np.diff(ends, axis=0)).max() <= 1e-8


def test_work_is_as_exact_as_the_motion():
    """The damper's power has the series of exp(-2 a t): steps that suit exp(-a t) are too long."""
    damped = mechanism(
        "links: [{name: b, joint: prismatic, axis: [1, 0], m: 1.3, l: 1, r: 0, I: 1, damping: 10}]"
    )
    for method, tol in itertools.product(METHODS, [1e-6, 1e-9, 1e-12]):
        motion = robodyn.simulate(damped, [0.0], [2.0], 1.0, method=method, rtol=tol, atol=tol)
        lost = 2.6 * (math.exp(-20.0 / 1.3) - 1.0)  # J
        assert abs(motion.report.work - lost) <= 20.0 * tol, (method, tol)
        assert motion.report.energy_drift <= 20.0 * tol, (method, tol)


def test_a_slot_with_an_aligned_block_is_a_prismatic_joint():
    """The same mechanism written in two ways moves in the same way, with the same forces."""
    slot, slide = mechanism(BLOCK), mechanism(SLIDING)
    crank, rate = 0.4, 3.0
    first = assembly.assemble(slot, [crank], t=0.0)
    second = assembly.assemble(slide, [crank], t=0.0)
    lever = first[2]
    assert lever == pytest.approx(second[1], abs=1e-14)
    motions = []
    for mech, q in ((slot, first), (slide, second)):
        qd = robodyn.loop_velocities(mech, q, [rate])
        solution = dynamics.forward_dynamics_and_forces(mech, q, qd, np.eye(3)[0] * 0.2)
        motions.append((q, qd, solution.qdd, solution.multipliers))
    (q, qd, qdd, lam), (p, pd, pdd, mu) = motions
    assert (qd[[0, 2]], qdd[[0, 2]]) == (
        pytest.approx(pd[[0, 1]], rel=1e-12),
        pytest.approx(pdd[[0, 1]], rel=1e-12),
    )
    # the moment that keeps the block's angle, about the pin, and what the prismatic joint gives it
    kept = robodyn.kept_moments(slot, lam)[0]
    held = robodyn.slide_moments(slide, p, pd, pdd, mu)[0]
    force = dynamics.pin_forces(slot, lam, q)[0] @ [1, 1j]
    reaction = reaction_forces.reactions(slide, p, pd, pdd, mu)[2] @ [1, 1j]
    assert kept == pytest.approx(held, rel=1e-11)
    assert force == pytest.approx(reaction, rel=1e-11)


def test_the_moment_in_a_prismatic_joint_is_that_of_a_joint_that_is_held():
    """A slide at rest needs the moment that a revolute joint in its place needs to be held."""
    arm = """
gravity: 9.81
links:
  - {name: upper, m: 1.5, l: 0.3, r: 0.2, I: 0.05}
  - {name: boom, %s m: 0.9, l: 0.5, r: [0.2, 0.03], I: 0.03}
  - {name: hand, m: 0.4, l: 0.2, r: 0.1, I: 0.003, payload: 0.1}
springs:
  - {between: [hand, [1.0, 1.0]], stiffness: 50, length: 0.2, damping: 1}
loads:
  - {link: boom, at: [0.3, 0.1], force: [4, 2]}
"""
    slide = mechanism(arm % "joint: prismatic, axis: [1, 1],")
    hinge = mechanism(arm % "")
    q, qd, qdd = np.array([[0.3, 0.0, 0.5], [1.2, 0.0, -0.7], [3.0, 0.0, 2.0]])
    p = np.add(q, [0.0, math.pi / 4, 0.0])
    none = np.zeros(0)
    held = robodyn.slide_moments(slide, q, qd, qdd, none)
    assert held == pytest.approx(dynamics.inverse_dynamics(hinge, p, qd, qdd)[1:2], rel=1e-12)
    forces = reaction_forces.reactions(slide, q, qd, qdd, none)
    assert forces == pytest.approx(reaction_forces.reactions(hinge, p, qd, qdd, none), rel=1e-12)
    along = np.exp(1j * (q[0] + math.pi / 4))
    force = forces[1] @ [1, 1j]
    assert dynamics.inverse_dynamics(slide, q, qd, qdd)[1] == pytest.approx(
        (force * along.conjugate()).real, rel=1e-12
    )


def drawn_scene(seed: int) -> tuple[str, int]:
    """Links on joints of both kinds, pins, sliders, slots and blocks; and the number of links."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))

    def pair(size):
        return rng.uniform(-size, size, 2).round(3).tolist()

    def place(link):
        return f"{pair(0.5)}" if link is None else f"{{link: l{link}, at: {pair(0.5)}}}"

    rows = ["gravity: [1.0, -9.0]", "links:"]
    for k in range(n):
        parent = None if k == 0 or rng.random() < 0.3 else int(rng.integers(0, k))
        kind = f"joint: prismatic, axis: {pair(1.0)}, " if rng.random() < 0.45 else ""
        damping = f", damping: {rng.uniform(0.1, 1):.2f}" if rng.random() < 0.4 else ""
        rows.append(
            f"  - {{name: l{k}, {kind}m: {rng.uniform(0.2, 2):.3f}, l: {rng.uniform(0.2, 1):.3f}, "
            f"r: {pair(0.3)}, I: {rng.uniform(0.01, 0.3):.4f}, from: {place(parent)}{damping}}}"
        )
    loops = []
    for _ in range(int(rng.integers(0, 3))):
        first = int(rng.integers(0, n))
        second = None if rng.random() < 0.4 else int(rng.integers(0, n))
        if first == second:
            continue
        if rng.random() < 0.5:
            loops.append(f"  - [{place(first)}, {place(second)}]")
            continue
        carrier = "" if second is None else f"link: l{second}, "
        kept = f", aligned: {rng.uniform(-1, 1):.3f}" if rng.random() < 0.3 else ""
        line = f"{carrier}through: {pair(0.5)}, along: {pair(1.0)}"
        loops.append(f"  - {{point: {place(first)}, on: {{{line}}}{kept}}}")
    rows += ["closures:", *loops] if loops else []
    return "\n".join(rows) + "\n", n


def test_drawn_scenes_against_independent_mechanics():
    """Accelerations by every way, torques, and every branch that dyads close in."""
    seen = 0
    for seed in SEEDS:
        text, n = drawn_scene(seed)
        rng = np.random.default_rng(seed)
        try:
            freedoms = n - len(mechanism(text).rows)
        except InputError:  # points that cannot move apart
            continue
        if freedoms <= 0:
            continue
        driven = ", ".join(f"l{k}" for k in rng.permutation(n)[:freedoms])
        mech = mechanism(f"{text}actuated: [{driven}]\n")
        for q in closing.close_positions(mech, closing.random_states(mech, rng, 20), t=0.0):
            gap = np.abs(closures.closure_gap(mech, q, t=0.0)).max(initial=0.0)
            if gap < 1e-12 and regular(mech, q) and upright(mech, q):
                check_drawn(mech, q, rng)
                seen += 1
                break
    assert seen > len(SEEDS) / 3


def regular(mech, q) -> bool:
    Psi = closures.scaled_jacobian(mech, q, t=0.0)
    passive = Psi[:, list(mech.passive)]
    return not len(Psi) or min(np.linalg.svd(x, compute_uv=False)[-1] for x in (Psi, passive)) > 0.1


def upright(mech, q) -> bool:
    """Whether no kept angle is half a turn off, where its sine vanishes too."""
    at, found = placed(mech, q), []
    for r, row in enumerate(mech.rows):
        if row.closure is not None and row.arm:
            across = row.ground + at.X @ mech.arrays.P[r]
            line = 1.0 if row.line is None else at.E[row.line].conj()
            found.append((1j * line * across).real > 0.0)
    return all(found)


def check_drawn(mech, q, rng):
    qd, tau, driven = rng.normal(size=mech.n), np.zeros(mech.n), list(mech.actuated)
    qd = robodyn.loop_velocities(mech, q, qd[driven]) if mech.rows else qd
    tau[driven] = rng.normal(size=len(driven))
    at = Known(mech, q, qd)
    exact = at.accelerations(tau)[0].astype(float)
    check_accelerations(mech, q, qd, tau, exact, 1.0 + at.condition)
    try:
        plan = assembly.assembly_plan(mech)
    except InputError:  # loops that need a start
        return
    if not plan.two_way:
        return
    here, away = placed(mech, q).X, []
    for choice in itertools.product(BRANCHES, repeat=len(plan.two_way)):
        words = [BRANCHES[0]] * len(mech.description.closures)
        for c, word in zip(plan.two_way, choice, strict=True):
            words[c] = word
        found, missing = assembly.attempt(mech, q[driven], words, t=0.0)
        if missing <= 0.0:
            assert np.abs(closures.closure_gap(mech, found, t=0.0)).max() <= 1e-12
            away.append(np.abs(placed(mech, found).X - here).max())
    assert min(away) <= 1e-8


def geared_and_driven(seed: int) -> tuple[str, int | None]:
    """A drawn scene with motors at some joints, and perhaps a coupling; the joint that it gives."""
    text, n = drawn_scene(seed)
    rng, coupled = np.random.default_rng([seed, 1]), None
    lines = text.splitlines()
    for k in range(2, 2 + n):
        if rng.random() < 0.5:
            motor = f"{{ratio: {rng.uniform(-30, 30):.2f}, inertia: {rng.uniform(1e-4, 1e-3):.5f}}}"
            lines[k] = f"{lines[k][:-1]}, motor: {motor}}}"
    if n > 2 and rng.random() < 0.6:
        coupled, other = rng.choice(n, 2, replace=False).tolist()
        terms = f"{rng.uniform(-1, 1):.3f} q{other + 1} + {rng.uniform(-0.3, 0.3):.3f}"
        lines.append(f'couplings: ["q{coupled + 1} = {terms}"]'.replace("+ -", "- "))
    return "\n".join(lines) + "\n", coupled


def test_identities_of_drawn_scenes_with_motors_and_couplings():
    """All that `check` tells, with joints of both kinds, pins, slots, blocks, gears, motors."""
    seen = dict.fromkeys(("motor", "couplings", "on: {link", "prismatic", "aligned"), 0)
    for seed in SEEDS:
        text, coupled = geared_and_driven(seed)
        try:
            n = len(mechanism(text).parent)
            freedoms = n - len(mechanism(text).rows)
        except InputError:  # points that cannot move apart
            continue
        rng = np.random.default_rng(seed)
        order = [k for k in rng.permutation(n) if k != coupled]
        if freedoms <= 0:
            continue
        driven = ", ".join(f"l{k}" for k in order[:freedoms])
        mech = mechanism(f"{text}actuated: [{driven}]\n")
        for q in closing.close_positions(mech, closing.random_states(mech, rng, 20), t=0.0):
            gap = np.abs(closures.closure_gap(mech, q, t=0.0)).max(initial=0.0)
            if gap < 1e-12 and regular(mech, q) and upright(mech, q):
                qd = loop_rates.nearest_velocities(mech, q[None], rng.normal(size=(1, n)), t=0.0)
                sample = identities.Sample(q[None], qd, 1.0, np.zeros(1))
                for identity in identities.identities(mech, sample):
                    assert identity.residual is None or identity.holds, (seed, identity)
                for kind in seen:
                    seen[kind] += kind in text
                break
    assert min(seen.values()) >= 2, seen


# -- closed forms of textbook mechanisms -----------------------------------------------------------


def test_scotch_yoke():
    """The yoke's displacement is r cos(theta) exactly, its acceleration -r w^2 cos(theta)."""
    tree = [link("crank", 1.0, 0.3, 0.1, 0.02, None, 0j)]
    tree.append(link("yoke", 2.0, 0.2, 0.1, 0.01, None, 0j, 1.0 + 0j))
    line = ((0, 0.3 + 0j), (1, 0j), 1j)
    mech = mechanism(text_of(tree, -9.81j, (), (line,), (0,)))
    for theta in np.linspace(-3.0, 3.0, 13):
        q = assembly.assemble(mech, [theta], t=0.0)
        qd = robodyn.loop_velocities(mech, q, [2.0])
        qdd = robodyn.loop_accelerations(mech, q, qd, [0.0])
        expected = 0.3 * np.cos(theta), -0.6 * np.sin(theta), -1.2 * np.cos(theta)
        assert (q[1], qd[1], qdd[1]) == pytest.approx(expected, abs=1e-15)
        tau = dynamics.inverse_dynamics(mech, q, qd, qdd)[0]
        gravity = 9.81 * 0.1 * np.cos(theta)
        assert tau == pytest.approx(gravity + 2.0 * qdd[1] * qd[1] / 2.0, abs=1e-14)


def test_elliptic_trammel():
    """A point of the bar between its sliders runs on an ellipse."""
    tree, loops, lines, actuated = closed_scene("elliptic trammel", 0)
    mech = mechanism(text_of(tree, 0j, loops, lines, actuated))
    for theta in np.linspace(-3.0, 3.0, 9):
        q = assembly.assemble(mech, [theta], t=0.0)
        at = placed(mech, q)
        x, y = (
            closed_form.points_of(mech, [mech.pivots[1]]).place(at)[0],
            0.3 * np.exp(1j * theta),
        )
        z = x + q[0] * 0 + y
        assert (z.real / 0.5) ** 2 + (z.imag / 0.3) ** 2 == pytest.approx(1.0, abs=1e-14)


def test_whitworth_time_ratio():
    """The lever turns back where the crank is square to it: (pi + 2 a)/(pi - 2 a), sin a = r/d."""
    r, d = 0.1, 0.25
    tree = [
        link("crank", 1.0, r, 0.03, 0.02, None, 0j),
        link("lever", 1.0, 0.5, 0.2, 0.1, None, -1j * d),
    ]
    slot = ((0, complex(r)), (1, 0j), 1.0 + 0j)
    mech = mechanism(text_of(tree, 0j, (), (slot,), (0,)))
    a = math.asin(r / d)
    for theta in (-a, math.pi + a):  # the lever rests while the crank turns
        q = assembly.assemble(mech, [theta], t=0.0)
        assert robodyn.loop_velocities(mech, q, [1.0])[1] == pytest.approx(0.0, abs=1e-15)
    top, bottom = (
        robodyn.loop_velocities(mech, assembly.assemble(mech, [x], t=0.0), [1.0])[1]
        for x in (1.5707963267948966, -1.5707963267948966)
    )
    assert (top, bottom) == pytest.approx((r / (r + d), -r / (d - r)), rel=1e-14)


def test_cart_pole_mode():
    """w^2 = m g r (M + m)/((I + m r^2)(M + m) - (m r)^2) of a pole that hangs from a free cart."""
    text = """
gravity: 9.81
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 1.0, l: 0, r: 0, I: 0}
  - {name: pole, m: 0.2, l: 0.6, r: 0.3, I: 0.006}
"""
    mech = mechanism(text)
    M, m, r, I = 1.0, 0.2, 0.3, 0.006
    w = math.sqrt(m * 9.81 * r * (M + m) / ((I + m * r * r) * (M + m) - (m * r) ** 2))
    q = np.array([0.0, -math.pi / 2 + 1e-6])
    motion = robodyn.simulate(
        mech, q, [0.0, 0.0], 2 * math.pi / w, method="taylor", rtol=1e-13, atol=1e-13
    )
    assert motion.q[-1, 1] == pytest.approx(q[1], abs=1e-14)
    moved = motion.q[:, 0] + m * r / (M + m) * np.cos(motion.q[:, 1])
    assert np.ptp(moved) <= 1e-14  # the centre of gravity stays above its place


def test_rack_and_pinion():
    """A coupling of an angle and a displacement: q2 = 0.05 q1."""
    mech = mechanism("""
gravity: 0
links:
  - {name: pinion, m: 1.0, l: 0.05, r: 0, I: 0.002}
  - {name: rack, joint: prismatic, axis: [1, 0], m: 3.0, l: 0.4, r: 0.2, I: 0.01, from: [0, -0.05]}
couplings: ["q2 = 0.05 q1"]
actuated: [pinion]
""")
    q = assembly.assemble(mech, [0.7], t=0.0)
    assert q[1] == pytest.approx(0.035, abs=1e-16)
    found = dynamics.forward_dynamics_and_forces(mech, q, [0.0, 0.0], [0.1, 0.0])
    a = 0.1 / (0.002 + 3.0 * 0.05**2)
    assert found.qdd == pytest.approx([a, 0.05 * a], rel=1e-14)
    assert dynamics.coupling_torques(mech, found.multipliers) == pytest.approx([3.0 * 0.05 * a])


def test_a_torque_on_a_link_that_cannot_turn_goes_to_the_ground():
    scene = """
links:
  - {name: ram, joint: prismatic, axis: [1, 0], m: 2, l: 0.1, r: 0, I: 0.01}
loads:
  - {link: ram, torque: 1.5}
"""
    mech, still = mechanism(scene), np.zeros(1)
    none = np.zeros(0)
    assert robodyn.shaking_force(mech, still, still, still) == pytest.approx([0.0, 0.0, 1.5])
    assert robodyn.slide_moments(mech, still, still, still, none) == pytest.approx([-1.5])


@pytest.mark.parametrize("seed", range(6))
def test_potential_energy_of_loads_counts_from_where_the_guide_says(seed):
    """A torque's is zero where its link points along +X, a force's where its point is at [0, 0]."""
    rng = np.random.default_rng(seed)
    joints, parents = (("PRPPR", (None, 0, 1, 2, 3)), ("RPRPP", (None, 0, 1, None, 3)))[seed % 2]
    tree, gamma = random_tree(seed, joints, parents), complex(*rng.uniform(-10, 10, 2))
    for each in tree:  # no link turns by more than half a turn
        if "axis" in each:
            each["axis"] = cmath.exp(1j * rng.uniform(-0.6, 0.6))
    q, torques = rng.uniform(-0.6, 0.6, len(tree)), rng.uniform(-2.0, 2.0, len(tree))
    forces = [complex(*pair) for pair in rng.uniform(-2.0, 2.0, (len(tree), 2))]
    loads = ["loads:"]
    for each, torque, force in zip(tree, torques, forces, strict=True):
        loads.append(f"  - {{link: {each['name']}, torque: {torque}}}")
        loads.append(
            f"  - {{link: {each['name']}, at: [0.3, -0.2], force: [{force.real}, {force.imag}]}}"
        )
    PE = 0.0
    frames = []  # origin and direction of each link
    for each, way, torque, force in zip(tree, q.tolist(), torques.tolist(), forces, strict=True):
        origin, along = (0j, 1 + 0j) if each["parent"] is None else frames[each["parent"]]
        origin, along = origin + along * each["at"], along * each.get("axis", 1.0)
        if "axis" in each:
            origin += along * way
        else:
            along *= cmath.exp(1j * way)
        frames.append((origin, along))
        PE -= each["m"] * (gamma.conjugate() * (origin + along * each["r"])).real
        PE -= (force.conjugate() * (origin + along * (0.3 - 0.2j))).real
        PE -= torque * cmath.phase(along)
    mech = mechanism(text_of(tree, gamma) + "\n".join(loads) + "\n")
    assert closed_form.potential_energy(mech, q) == pytest.approx(PE, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize(
    ("axis", "angle"), [("[1, 0]", 0.0), ("[0, 1]", 0.5), ("[1, -1]", -0.25), ("[-3, 0]", 1.0)]
)
def test_potential_energy_of_a_torque_on_a_link_that_cannot_turn(axis, angle):
    scene = f"links: [{{name: a, joint: prismatic, axis: {axis}, m: 1, l: 1, r: 0, I: 0}}]\n"
    mech = mechanism(f"{scene}loads: [{{link: a, torque: 2}}]\n")
    found = closed_form.potential_energy(mech, [0.3])
    assert found == pytest.approx(-2.0 * angle * math.pi, rel=1e-15, abs=0.0)


def test_a_block_that_stands_half_a_turn_off_is_open():
    """There the sine of what it is off vanishes too."""
    mech = mechanism(BLOCK)
    q = assembly.assemble(mech, [0.4], t=0.0)
    assert check_closed(mech, q, t=0.0) is None
    over = np.add(q, [0.0, math.pi, 0.0])
    assert np.abs(closures.closure_gap(mech, over, t=0.0)).max() <= 1e-15
    state, error = check_closed(mech, np.stack([q, over]), t=0.0)
    assert state == 1
    assert "the loops are open" in str(error)


# -- the branches of dyads -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", CLOSED)
def test_open_is_the_point_ahead(kind):
    """With a slot or a slider the point is ahead along it, or behind where it is crossed."""
    tree, loops, lines, actuated = closed_scene(kind, 3)
    mech = mechanism(text_of(tree, 0j, loops, lines, actuated))
    plan = assembly.assembly_plan(mech)
    given = [0.3]
    for c in plan.two_way:
        places = {}
        for word in ("open", "crossed"):
            words = ["open"] * len(mech.description.closures)
            words[c] = word
            q, missing = assembly.attempt(mech, given, words, t=0.0)
            if missing > 0.0:
                return
            assert np.abs(closures.closure_gap(mech, q, t=0.0)).max() <= 1e-15
            places[word] = q
        if kind == "slider-crank with a piston":
            ahead = [places[word][2] for word in ("open", "crossed")]
            assert ahead[0] > ahead[1]
        if kind == "Whitworth" and c == 0:
            assert places["open"][1] > 0.0 > places["crossed"][1]


def test_a_start_picks_the_branch():
    """Where the scene has no `assembly`, what is nearest to its `start` is taken."""
    tree, loops, lines, actuated = closed_scene("Whitworth", 0)
    text = text_of(tree, 0j, loops, lines, actuated)
    up = mechanism(text + "start: {crank: 0, lever: 80deg, rod: 80deg}\n")
    down = mechanism(text + "start: {crank: 0, lever: 80deg, rod: -40deg}\n")
    told = mechanism(text + "assembly: [open, open]\nstart: {crank: 0, lever: 80deg, rod: 80deg}\n")
    assert assembly.scene_branches(up) != assembly.scene_branches(down)
    assert assembly.scene_branches(told) == ("open", "open")


def test_a_start_picks_the_branch_where_it_names_followers_alone():
    """By what the joints that it names can come to, over the reach of the actuated one."""
    text = (ROOT / "robots/four-bar.yaml").read_text()
    kept = [line for line in text.splitlines() if not line.startswith("assembly")]
    four = mechanism(text)
    for word in ("open", "crossed"):
        coupler, rocker = np.degrees(assembly.assemble(four, [1.0], [word], t=0.0)[1:])
        start = f"start: {{rocker: {rocker:.2f}deg}}"  # where the other branch never comes
        assert assembly.scene_branches(mechanism("\n".join([*kept, start]))) == (word,)
        unclear = mechanism("\n".join([*kept, f"start: {{coupler: {coupler:.2f}deg}}"]))
        with pytest.raises(InputError, match=r"start.*name crank"):
            assembly.scene_branches(unclear)
    text = (ROOT / "robots/five-bar.yaml").read_text()  # two joints are actuated, none is named
    kept = [line for line in text.splitlines() if not line.startswith("assembly")]
    five = mechanism("\n".join([*kept, "start: {left rod: 10deg}"]))
    with pytest.raises(InputError, match=r"start.*name left crank, right crank"):
        assembly.scene_branches(five)


# ---------------------------------------------------------------------------------------------
# What scenes may say
# ---------------------------------------------------------------------------------------------

WRITTEN = """links:
  - {name: crank, m: 1, l: 0.3, r: 0.1, I: 0.01}
  - {name: lever, m: 1, l: 1, r: 0.5, I: 0.1, from: [0, -0.4]}
  - {name: boom, joint: prismatic, axis: [1, 0.5], m: 1, l: 0.4, r: 0.2, I: 0.02, from: lever,
     damping: 3, friction: {force: 2, speed: 0.1}}
closures:
  - {point: crank, on: {link: lever, through: [0.1, 0], along: [1, 0]}, aligned: 10deg}
springs:
  - {joint: boom, stiffness: 300, length: 0.1, damping: 5}
couplings: ["q3 = 0.05 q1 + 0.2"]
"""
# words of it, and what is refused in their place whatever it is otherwise
WORDS = {
    "prismatic": ["sliding", "", "1", "[1, 0]", "revolute", "yes"],
    "axis: [1, 0.5]": ["axis: [0, 0]", "axis: [1]", "axis: 3", "axis: 30deg", "axis: [1, x]", ""],
    "link: lever": ["link: nobody", "link: crank", "link: [1]", "link: ''", "links: lever"],
    "through: [0.1, 0]": ["through: 1", "through: [1, 2, 3]", "through: [.nan, 0]", ""],
    "along: [1, 0]": ["along: [0, 0]", "along: x", "along: [1e999, 0]", "along: [yes, no]"],
    "aligned: 10deg": ["aligned: ten", "aligned: [1]", "aligned: '10'", "aligned: 10degs"],
    "friction: {force: 2, speed: 0.1}": [
        "friction: {torque: 2, speed: 0.1}", "friction: {force: -2, speed: 0.1}",
        "friction: {force: 2}", "friction: {force: 2, speed: 0}", "friction: 2",
    ],
    "length: 0.1": ["angle: 0.1", "length: 10deg", "length: .inf", ""],
    "stiffness: 300": ["stiffness: -1", "stiffness: x", ""],
    "damping: 3": ["damping: -3", "damping: 3deg", "damping: {}", "dampings: 3"],
    "0.05 q1 + 0.2": ["0.05 q1 + 20deg", "0.05 q9", "q3", "0.05 * * q1", "abs(q1)", "q3 q1"],
    "point: crank": ["point: nobody", "point: [0, 0]", "points: crank", "point: {link: crank}"],
}  # fmt: skip


def test_mutated_scenes_with_joints_that_slide_are_refused() -> None:
    """Each by the file and its line, and nothing of it is read; over a hundred of them."""
    build(from_text(WRITTEN, "my.yaml"))
    texts = [WRITTEN.replace(word, slip, 1) for word, slips in WORDS.items() for slip in slips]
    rng = random.Random(FIRST_SEED)
    keys = ["joint", "axis", "link", "through", "along", "aligned", "force", "speed", "length"]
    for key in keys:  # misspelt, given twice, or with a value that is none of its kind
        texts += [WRITTEN.replace(f"{key}:", f"{key}{rng.choice('xs_1')}:", 1)]
        texts += [WRITTEN.replace(f"{key}:", f"{key}: {wrong}, {key}:", 1) for wrong in (0, "[]")]
        texts += [WRITTEN.replace(f"{key}: ", f"{key}: {wrong}", 1) for wrong in ("!x ", "*b ")]
    assert len(texts) >= 100
    for text in texts:
        with pytest.raises(DescriptionError) as caught:
            from_text(text, "my.yaml")
        assert str(caught.value).startswith("my.yaml:"), text


SWINGING = """\
gravity: 9.81
links:
  - {name: crank, m: 0.5, l: 0.2, r: 0.1, I: 0.002}
  - {name: rod, m: 0.8, l: 0.9, r: 0.4, I: 0.05}
closures:
  - {point: [0.5, 0.1], on: {link: rod, through: [0, 0.03], along: [1, 0]}}
actuated: [crank]
"""


def test_a_rod_through_a_block_that_swings_on_the_ground():
    """The rod's line passes the block's pin: by a right triangle, and by energies."""
    swinging = mechanism(SWINGING)

    def pose(theta):
        way = 0.5 + 0.1j - cmath.rect(0.2, theta)
        along = math.sqrt(abs(way) ** 2 - 0.03**2)
        return np.array([theta, cmath.phase(way / complex(along, 0.03)) - theta])

    def height(theta):
        q = pose(theta)
        rod = cmath.rect(0.2, theta) + cmath.rect(0.4, q.sum())
        return 9.81 * (0.5 * 0.1 * math.sin(theta) + 0.8 * rod.imag)

    for theta in np.linspace(0.0, 6.0, 13):
        q = robodyn.assemble(swinging, [theta])
        assert np.abs(np.remainder(q - pose(theta) + np.pi, 2 * np.pi) - np.pi).max() < 1e-12
        tau = robodyn.inverse_dynamics(swinging, q, np.zeros(2), np.zeros(2))[0]
        step = 1e-5
        slope = (height(theta + step) - height(theta - step)) / (2 * step)
        assert tau == pytest.approx(slope, abs=1e-8)
    turn = np.array([pose(1.0 + x)[1] for x in (-1e-4, 1e-4)])
    qd = robodyn.loop_velocities(swinging, robodyn.assemble(swinging, [1.0]), [1.0])
    assert qd[1] == pytest.approx((turn[1] - turn[0]) / 2e-4, abs=1e-7)


def test_a_point_of_the_ground_on_a_line_of_the_ground_is_refused():
    text = SWINGING.replace("{link: rod, through", "{through")
    with pytest.raises(DescriptionError, match=r"closures\[0\]\.point: must be a point of a link"):
        mechanism(text)
