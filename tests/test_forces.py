"""Springs, loads and friction: torques by virtual power, motions that are known exactly."""

import dataclasses
import math

import numpy as np
import pytest
from conftest import ROOT

from random_mechanisms import (
    LOOPS,
    exchanged,
    forced,
    mechanism,
    seeded_scene,
    seeded_tree,
)
from robodyn import (
    assemble,
    forward_dynamics,
    forward_dynamics_derivatives,
    gravity_vector,
    inverse_dynamics,
    kinetic_energy,
    load,
    other_forces,
    potential_energy,
    reactions,
    regressor,
    shaking_force,
    simulate,
)
from robodyn.dynamics import identities
from robodyn.dynamics.dynamics import forward_dynamics_and_forces
from robodyn.elements.joints import SmoothFriction
from robodyn.elements.loads import Force
from robodyn.elements.springs import JointSpring, PointSpring
from robodyn.engines.row_values import RowValues
from robodyn.errors import SingularError
from robodyn.mechanics.actuation import Actuation
from robodyn.runs.benchmark import reference

SEEDS = range(4)
TREES = {f"tree {n}": seeded_tree(n, n) for n in (1, 2, 3, 5)}
PLAIN = TREES | {name: seeded_scene(3, shape) for name, shape in LOOPS.items()}
SCENES = [
    pytest.param(forced(seed, scene), id=f"{name} {seed}")
    for name, scene in PLAIN.items()
    for seed in SEEDS
]
SOME = SCENES[::5]
EACH_KIND = pytest.mark.parametrize("kind", ["straight-line", "dense"])


class TestTorques:
    @pytest.mark.parametrize("scene", SOME)
    def test_of_many_states_they_are_those_of_each(self, scene):
        """Of one state they are taken in floats."""
        mech, rng = scene.mechanism, np.random.default_rng(0)
        q, qd = rng.normal(size=(2, 2, 3, scene.n))
        rows = RowValues(mech)
        for name in ("torques", "forces", "power", "gap", "PE", "PE rate"):
            each = [[rows(name, q[i, j], qd[i, j]) for j in range(3)] for i in (0, 1)]
            many = rows(name, q, qd)
            assert many.shape == np.shape(each)
            size = np.abs(many).max(initial=0.0)
            assert many == pytest.approx(np.array(each), rel=1e-12, abs=1e-12 * size)
            assert rows(name, q[:0], qd[:0]).shape == (0, *many.shape[1:])

    @pytest.mark.parametrize("scene", SCENES)
    def test_the_identities_of_check_hold(self, scene):
        mech = scene.mechanism
        sample = identities.Sample(scene.q[None], scene.qd[None], 1.0, np.zeros(1))
        found = identities.identities(mech, sample)
        assert {item.name for item in found} >= {identities.FORCES, identities.POWER}
        assert [item.name for item in found if not item.holds] == []

    @pytest.mark.parametrize("scene", SOME)
    @pytest.mark.parametrize(
        "change",
        [
            lambda mech: dataclasses.replace(mech, moments=tuple(x + 0.1 for x in mech.moments)),
            lambda mech: exchanged(mech, {PointSpring: mech.of(PointSpring)[1:]}),
            lambda mech: exchanged(mech, {JointSpring: ()}),
            lambda mech: exchanged(mech, {SmoothFriction: ()}),
            lambda mech: exchanged(mech, {Force: ()}),
        ],
    )
    @pytest.mark.thinned
    def test_the_identities_detect_what_is_wrong(self, scene, change):
        mech = scene.mechanism
        wrong = change(mech)
        sample = identities.Sample(scene.q[None], scene.qd[None], 1.0, np.zeros(1))
        assert not all(item.holds for item in identities.identities(wrong, sample))


class TestMotions:
    def test_springs_alone_keep_the_energy(self):
        text = (
            "gravity: 9.81\nlinks:\n"
            "  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082}\n"
            "  - {name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031}\n"
            "springs:\n"
            "  - {between: [b, [0.5, 2.5]], stiffness: 40, length: 0.3}\n"
            "  - {joint: a, stiffness: 5, angle: 20deg}\n"
            "loads:\n  - {link: b, at: [0.6, 0], force: [3, 1]}\n  - {link: a, torque: 0.7}\n"
        )
        mech = mechanism(text)
        for method in ("DOP853", "taylor"):
            motion = simulate(mech, [0.3, 0.2], [1, 0], 20.0, method=method, rtol=1e-11, atol=1e-11)
            assert motion.report.work == 0.0
            assert motion.report.energy_drift < 1e-8
            E = kinetic_energy(mech, motion.q, motion.qd) + potential_energy(mech, motion.q)
            assert np.ptp(E) < 1e-7 * motion.report.energy_in_motion

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_damped_oscillator(self, method):
        """I qdd + c qd + k (q - a) = 0 in a horizontal plane."""
        I, c, k, a = 0.4, 0.3, 7.0, 0.25
        mech = mechanism(
            f"links: [{{name: a, m: 0, l: 1, r: 0, I: {I}}}]\n"
            f"springs: [{{joint: a, stiffness: {k}, angle: {a}, damping: {c}}}]\n"
        )
        t = np.linspace(0.0, 3.0, 31)
        motion = simulate(mech, [1.0], [0.5], 3.0, t_eval=t, method=method, rtol=1e-12, atol=1e-12)
        decay, omega = c / (2 * I), math.sqrt(k / I - (c / (2 * I)) ** 2)
        u0, v0 = 1.0 - a, 0.5
        exact = a + np.exp(-decay * t) * (
            u0 * np.cos(omega * t) + (v0 + decay * u0) / omega * np.sin(omega * t)
        )
        assert motion.q[:, 0] == pytest.approx(exact, abs=1e-10)

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_spring_without_free_length_is_a_pendulum(self, method):
        """1/2 k |p - h|^2 with |p| constant is a constant force k h at p: gravity in disguise."""
        k, h = 30.0, 0.7
        spring = f"springs: [{{between: [a, [0, {-h}]], stiffness: {k}, length: 0}}]\n"
        link = "links: [{name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.08}]\n"
        same = f"loads: [{{link: a, at: [0.8, 0], force: [0, {-k * h}]}}]\n"
        runs = [
            simulate(
                mechanism(link + text),
                [0.3],
                [2.0],
                4.0,
                t_eval=[1.0, 4.0],
                method=method,
                rtol=1e-12,
                atol=1e-12,
            )
            for text in (spring, same, f"gravity: {k * h * 0.8 / (1.5 * 0.36)!r}\n")
        ]
        for other in runs[1:]:
            assert other.q == pytest.approx(runs[0].q, abs=1e-9)

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_coulomb_friction_slows_evenly(self, method):
        """Far above its smoothing speed: qdd = -torque/I."""
        mech = mechanism(
            "links: [{name: a, m: 0, l: 1, r: 0, I: 0.5, friction: {torque: 0.2, speed: 0.01}}]\n"
        )
        motion = simulate(mech, [0.0], [3.0], 5.0, t_eval=[5.0], method=method)
        assert motion.qd[0, 0] == pytest.approx(3.0 - 0.4 * 5.0, abs=1e-8)
        held = simulate(mech, [0.0], [3.0], 12.0, t_eval=[12.0], method="Radau")
        assert abs(held.qd[0, 0]) < 1e-6

    @pytest.mark.parametrize("scene", SOME[::3])
    def test_the_extended_reference_knows_them(self, scene):
        mech = scene.mechanism
        tau = Actuation((0.0,) * scene.n)
        state = np.concatenate([scene.q, scene.qd])
        motion = simulate(mech, scene.q, scene.qd, 0.1, t_eval=[0.1], rtol=1e-12, atol=1e-12)
        found = reference(mech, state, np.array([0.1]), tau)
        assert found.uncertainty < 1e-11
        assert motion.q[0] == pytest.approx(found.y[0, : scene.n], abs=1e-9)


class TestReactions:
    def test_the_ground_carries_what_the_loads_put_on(self):
        """At rest: weight plus loads, springs to the ground included."""
        mech = mechanism(
            "gravity: 9.81\nlinks: [{name: a, m: 2, l: 1, r: 0.5, I: 0.1}]\n"
            "springs: [{between: [a, [0.4, 2.0]], stiffness: 50, length: 0.2}]\n"
            "loads: [{link: a, at: [1, 0], force: [3, -4]}, {link: a, torque: 1.5}]\n"
        )
        found = shaking_force(mech, [0.3], [0.0], [0.0])
        tip = np.exp(0.3j)
        moment = (np.conj(tip) * (3 - 4j)).imag + 1.5 - 2 * 9.81 * 0.5 * tip.real
        assert found == pytest.approx([3.0, -4.0 - 2 * 9.81, moment])

    def test_a_spring_at_a_ground_joint_is_carried_by_that_joint(self):
        """Its ends never move: it does nothing but pull at the joint."""
        link = "links: [{name: a, m: 2, l: 1, r: 0.5, I: 0.1}]\n"
        spring = (
            "springs: [{between: [{link: a, at: [0, 0]}, [0.3, 0.4]], stiffness: 50, length: 0.2}]"
        )
        state, pull = ([0.3], [1.0], [2.0]), 50 * 0.3 * np.array([0.6, 0.8])
        mech, plain = mechanism(link + spring + "\n"), mechanism(link)
        assert inverse_dynamics(mech, *state) == pytest.approx(inverse_dynamics(plain, *state))
        found = reactions(mech, *state, []) - reactions(plain, *state, [])
        assert found == pytest.approx(-pull[None])
        for method in ("DOP853", "taylor"):
            motion = simulate(mech, [0.3], [1.0], 0.5, method=method)
            assert motion.q[-1] == pytest.approx([0.8])


class TestFaults:
    LINK = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}, {name: b, m: 1, l: 1, r: 0.5, I: 0.1}]\n"

    def test_ends_that_coincide(self):
        mech = mechanism(
            self.LINK + "springs: [{between: [b, [2, 0]], stiffness: 1, length: 0.5}]\n"
        )
        with pytest.raises(SingularError, match=r"spring 1 .* coincide"):
            gravity_vector(mech, [0.0, 0.0])
        with pytest.raises(SingularError, match="coincide"):
            forward_dynamics_and_forces(mech, [0.0, 0.0], [0, 0], [0, 0])
        free = mechanism(self.LINK + "springs: [{between: [b, [2, 0]], stiffness: 1, length: 0}]\n")
        assert gravity_vector(free, [0.0, 0.0]) == pytest.approx([0.0, 0.0])

    def test_the_compiled_series_serve_them(self):
        pytest.importorskip("llvmlite")
        mech = mechanism(self.LINK + "springs: [{joint: a, stiffness: 1, angle: 0}]\n")
        start, options = ([0, 0], [0, 0], 1.0), {"t_eval": [1.0], "rtol": 1e-10, "atol": 1e-10}
        found = simulate(mech, *start, method="taylor", **options)
        assert found.q == pytest.approx(simulate(mech, *start, **options).q, abs=1e-7)


def test_a_scene_without_them_runs_no_line_of_them(monkeypatch):
    def refuse(*_):
        raise AssertionError("forces were asked for")

    monkeypatch.setattr("robodyn.engines.row_values.RowValues", refuse)
    mech = load(ROOT / "robots/2r.yaml")
    assert not mech.has_state_forces
    state = [0.1, 0.2], [0.0, 0.0], [0.0, 0.0]
    gravity_vector(mech, state[0])
    potential_energy(mech, state[0])
    inverse_dynamics(mech, *state)
    reactions(mech, *state, [])
    shaking_force(mech, *state)
    simulate(mech, [0.1, 0.2], [0, 0], 0.1)
    simulate(mech, [0.1, 0.2], [0, 0], 0.1, method="taylor")


class TestCoincidingEnds:
    """A spring without a direction is said to be one, by every way to ask."""

    TEXT = (
        "links: [{name: a, m: 1, l: 0.75, r: 0.5, I: 0.1}, "
        "{name: b, m: 1, l: 0.5, r: 0.2, I: 0.1}]\n"
        "springs: [{between: [b, [1.25, 0]], stiffness: 10, length: 0.1}]\n"
    )

    def test_in_python(self):
        mech = mechanism(self.TEXT)
        for shape in ((2,), (3, 2), (40_000, 2)):
            zero = np.zeros(shape)
            with pytest.raises(SingularError, match="coincide"):
                inverse_dynamics(mech, zero, zero, zero)
            with pytest.raises(SingularError, match="coincide"):
                forward_dynamics(mech, zero, zero, zero)

    @pytest.mark.parametrize("command", ["torque", "accel", "reactions", "terms"])
    def test_on_the_command_line(self, robodyn, scene, command):
        given = robodyn(command, scene(self.TEXT), "--q", "0,0", "--qd", "1,2")
        assert given.code == 1
        assert "the ends of spring 1 between two points coincide" in given.err

    def test_one_that_does_nothing_needs_no_direction(self):
        mech = mechanism(self.TEXT.replace("stiffness: 10", "stiffness: 0"))
        assert forward_dynamics(mech, [0.0, 0.0], [0, 0], [0, 0]) == pytest.approx([0.0, 0.0])

    ALWAYS = TEXT.replace("[b, [1.25, 0]]", "[a, {link: b, at: [0, 0]}]")

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_nor_one_whose_ends_never_part(self, method):
        mech = mechanism(self.ALWAYS.replace("stiffness: 10", "stiffness: 0"))
        assert simulate(mech, [0.3, 0.2], [1, 0], 0.1, method=method).outcome.label == "finished"

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_of_one_whose_ends_never_part(self, method):
        mech = mechanism(self.ALWAYS)
        with pytest.raises(SingularError, match=r"spring 1 .* coincide"):
            gravity_vector(mech, [0.3, 0.2])
        with pytest.raises(SingularError, match=r"spring 1 .* coincide"):
            simulate(mech, [0.3, 0.2], [1, 0], 0.1, method=method)
        assert potential_energy(mech, [0.3, 0.2]) == pytest.approx(0.5 * 10 * 0.1**2)

    def test_a_damper_without_a_direction_leaves_the_potential(self):
        mech = mechanism(self.TEXT.replace("length: 0.1", "length: 0, damping: 1"))
        assert gravity_vector(mech, [0.0, 0.0]) == pytest.approx([0.0, 0.0])
        for q in (np.zeros(2), np.zeros((3, 2))):
            with pytest.raises(SingularError, match=r"spring 1 .* coincide"):
                other_forces(mech, q, np.ones(2))

    def test_the_first_that_is_lost_is_named(self):
        far = "springs: [{between: [a, [5, 0]], stiffness: 10, length: 0.1}, "
        mech = mechanism(self.TEXT.replace("springs: [", far))
        with pytest.raises(SingularError, match=r"spring 2 "):
            gravity_vector(mech, [[0.3, 0.1], [0.0, 0.0]])

    FOLDED = (
        "links: [{name: a, m: 2, l: 1, r: 0.5, I: 0.2}, {name: b, m: 2, l: 1, r: 0.5, I: 0.2}]\n"
        "springs: [{between: [b, [0, 0]], stiffness: 300, length: 0.4}]\n"
    )
    ANGLES = 0.0, 0.3, 1.0, math.pi / 2, -2.0

    def test_ends_that_meet_but_for_rounding(self):
        """The second link lies on the first: rounding alone would tell a direction."""
        mech, zero = mechanism(self.FOLDED), np.zeros(2)
        damped = mechanism(self.FOLDED.replace("length: 0.4", "length: 0, damping: 1"))
        calls = (
            lambda q: gravity_vector(mech, q),
            lambda q: inverse_dynamics(mech, q, zero, zero),
            lambda q: forward_dynamics(mech, q, zero, zero),
            lambda q: other_forces(damped, q, zero),
            lambda q: forward_dynamics_derivatives(mech, q, zero, zero),
            lambda q: regressor(mech, q, zero, zero),
        )
        beside = np.tile([0.3, 3.0], (40_000, 1))
        for angle in self.ANGLES:
            beside[-1] = met = angle, math.pi
            for call in calls:
                for q in (met, [met, (0.3, 3.0)], beside):
                    with pytest.raises(SingularError, match=r"spring 1 .* coincide"):
                        call(q)

    def test_ends_that_are_apart_by_more(self):
        """A chord of two links of 1 m: the spring turns the second one by k (L - d) cos(half)."""
        mech = mechanism(self.FOLDED)
        for left in (1e-12, 1e-6, 0.5):
            tau = inverse_dynamics(mech, [0.3, math.pi - left], [0, 0], [0, 0])
            needed = 300 * (0.4 - 2 * math.sin(left / 2)) * math.cos(left / 2)
            assert tau == pytest.approx([0.0, needed], abs=1e-9 + 1e-14 / left)

    def test_a_displacement_has_a_direction_however_small(self):
        mech = mechanism(
            "links: [{name: a, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 0.2}]\n"
            "springs: [{between: [a, [0, 0]], stiffness: 300, length: 0.4}]\n"
        )
        for way in (1e-17, -1e-100):
            needed = -math.copysign(120.0, way)
            assert inverse_dynamics(mech, [way], [0], [0]) == pytest.approx([needed])

    def test_folded_links_on_the_command_line(self, robodyn, scene):
        path = scene(self.FOLDED)
        for angle in self.ANGLES:
            for command in ("torque", "accel", "reactions", "terms", "linearize"):
                failed = robodyn(command, path, "--q", f"{angle},180deg")
                failed.fails(1, "the ends of spring 1 between two points coincide")
        swept = robodyn(
            "sweep", path, "--kind", "torque", "--vary", "q1=0.3,1", "--q", "0,180deg", "--quiet"
        ).succeeds()
        assert [row["outcome"] for row in swept.rows] == ["singular", "singular"]
        rows = "q1,q2\n0.3,3\n1,3.141592653589793\n0.4,3\n"
        first, met, last = robodyn("torque", path, "-", stdin=rows).fails(1, "line 3").rows
        assert met == {"q1": "1", "q2": "3.141592653589793", "tau1": "", "tau2": ""}
        assert float(first["tau2"]) == pytest.approx(float(last["tau2"]), rel=1e-12)

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_run_steps_across(self, method):
        """Energy is kept on the way in and out, and the rows of the run have accelerations."""
        mech = mechanism(self.FOLDED)
        motion = simulate(mech, [0.3, math.pi], [0, 1], 0.1, method=method)
        assert motion.outcome.label == "finished"
        energy = kinetic_energy(mech, motion.q, motion.qd) + potential_energy(mech, motion.q)
        assert np.ptp(energy) < 1e-6
        assert np.isfinite(motion.qdd).all()

    def test_other_forces_broadcast(self):
        rubbing = "I: 0.1, friction: {torque: 1, speed: 0.1}}"
        mech = mechanism(f"links: [{{name: a, m: 1, l: 1, r: 0.5, {rubbing}]\n")
        assert other_forces(mech, np.zeros((3, 1)), [1.0]).shape == (3, 1)


def test_a_passive_joint_is_assembled_near_its_springs_angle():
    text = (ROOT / "robots/four-bar.yaml").read_text()
    turned = [
        mechanism(text + f"springs: [{{joint: coupler, stiffness: 5, angle: {angle}}}]\n")
        for angle in (0.4, 0.4 + 2 * math.pi)
    ]
    torques = []
    for mech, angle in zip(turned, (0.4, 0.4 + 2 * math.pi), strict=True):
        q = assemble(mech, np.linspace(0.0, 2 * np.pi, 50)[:, None])
        assert np.abs(q[:, 1] - angle).max() <= math.pi
        torques.append(inverse_dynamics(mech, q, np.zeros_like(q), np.zeros_like(q)))
    assert torques[0] == pytest.approx(torques[1], abs=1e-10)
