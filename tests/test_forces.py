"""Springs, loads and friction: torques by virtual power, motions that are known exactly."""

import dataclasses
import math

import numpy as np
import pytest
from conftest import ROOT

from random_mechanisms import (
    LOOPS,
    Pose,
    Scene,
    forced,
    mechanism,
    oracle_tree,
    seeded_scene,
    seeded_tree,
)
from robodyn import (
    assemble,
    forward_dynamics,
    gravity_vector,
    inverse_dynamics,
    kinetic_energy,
    load,
    other_forces,
    pin_forces,
    potential_energy,
    reactions,
    shaking_force,
    simulate,
)
from robodyn.dynamics import identities
from robodyn.dynamics.dynamics import forward_dynamics_and_forces, inverse_dynamics_and_forces
from robodyn.engines.row_values import RowValues, rows_of
from robodyn.errors import InputError, SingularError
from robodyn.mechanics import parts
from robodyn.mechanics.actuation import Actuation, expressions, table
from robodyn.scene.scene import Description, JointSpring, Load, Moment, Point
from robodyn.simulation.extended import reference
from robodyn.simulation.right_hand_side import right_hand_side

SEEDS = range(4)
TREES = {f"tree {n}": seeded_tree(n, n) for n in (1, 2, 3, 5)}
PLAIN = TREES | {name: seeded_scene(3, shape) for name, shape in LOOPS.items()}
SCENES = [
    pytest.param(forced(seed, scene), id=f"{name} {seed}")
    for name, scene in PLAIN.items()
    for seed in SEEDS
]
SOME = SCENES[::5]
EACH_KIND = pytest.mark.parametrize("kind", ["straight-line", "sparse", "dense"])


class Forces:
    """What acts on a scene at a state, force by force, with the kinematics of `Pose`."""

    def __init__(self, scene: Scene) -> None:
        self.description: Description = scene.mechanism.description
        self.pose = Pose(oracle_tree(self.description), scene.q)
        self.qd = scene.qd

    def place(self, point: Point) -> tuple[int | None, complex]:
        return point.link, point.at

    def torques(self) -> tuple[np.ndarray, np.ndarray, float]:
        """-dPE/dq of springs and constant loads, Q of the others, PE of the former."""
        potential, other, PE = np.zeros(len(self.qd)), np.zeros(len(self.qd)), 0.0
        pose, qd = self.pose, self.qd
        for spring in self.description.springs:
            if isinstance(spring, JointSpring):
                stretched = pose.q[spring.joint] - spring.angle
                potential[spring.joint] -= spring.stiffness * stretched
                other[spring.joint] -= spring.damping * qd[spring.joint]
                PE += spring.stiffness * stretched**2 / 2
                continue
            ends = [self.place(spring.first), self.place(spring.second)]
            d = pose.position(ends[0]) - pose.position(ends[1])
            slope = pose.slope(ends[0]) - pose.slope(ends[1])
            stretched = abs(d) - spring.length
            growth = (slope * d.conjugate()).real / abs(d)  # ds/dq
            potential -= spring.stiffness * stretched * growth
            other -= spring.damping * (growth @ qd) * growth
            PE += spring.stiffness * stretched**2 / 2
        for item in self.description.loads:
            if isinstance(item, Moment):
                path = pose.path(item.link)
                potential[path] += item.torque
                PE -= item.torque * pose.alpha[item.link]
                continue
            slope = pose.slope(self.place(item.point))
            if item.turns:
                force = item.force * np.exp(1j * pose.alpha[item.point.link])
                other += (np.conj(force) * slope).real
            else:
                potential += (np.conj(item.force) * slope).real
                PE -= (np.conj(item.force) * pose.position(self.place(item.point))).real
        for k, link in enumerate(self.description.links):
            if link.friction is not None:
                other[k] -= link.friction.torque * math.tanh(qd[k] / link.friction.speed)
        return potential, other, PE

    def on_links(self) -> np.ndarray:
        """What springs between points and loads put on each link, as Fx + i Fy."""
        total, pose = np.zeros(len(self.qd), complex), self.pose
        for spring in self.description.springs:
            if isinstance(spring, JointSpring):
                continue
            ends = [self.place(spring.first), self.place(spring.second)]
            d = pose.position(ends[0]) - pose.position(ends[1])
            rate = (pose.slope(ends[0]) - pose.slope(ends[1])) @ self.qd
            sdot = (np.conj(d) * rate).real / abs(d)
            F = spring.stiffness * (abs(d) - spring.length) + spring.damping * sdot
            for (link, _), sign in zip(ends, (-1.0, 1.0), strict=True):
                if link is not None:
                    total[link] += sign * F * d / abs(d)
        for item in self.description.loads:
            if isinstance(item, Load):
                turned = np.exp(1j * pose.alpha[item.point.link]) if item.turns else 1.0
                total[item.point.link] += item.force * turned
        return total


def without(scene: Scene):
    """The mechanism of a scene without its springs and loads."""
    return mechanism(scene.text[: scene.text.index("springs:")])


class TestTorques:
    @pytest.mark.parametrize("scene", SCENES)
    def test_by_virtual_power(self, scene):
        potential, other, PE = Forces(scene).torques()
        mech, plain = scene.mechanism, without(scene)
        size = 1.0 + np.abs(potential).max() + np.abs(other).max()
        G = gravity_vector(mech, scene.q) - gravity_vector(plain, scene.q)
        assert pytest.approx(-potential, abs=1e-13 * size) == G
        damped = other_forces(mech, scene.q, scene.qd) - np.array(mech.damping) * scene.qd
        damped += np.array(plain.damping) * scene.qd
        assert damped == pytest.approx(other, abs=1e-13 * size)
        added = potential_energy(mech, scene.q) - potential_energy(plain, scene.q)
        assert added == pytest.approx(PE, abs=1e-12 * (1.0 + abs(PE)))

    @pytest.mark.parametrize("scene", SCENES)
    def test_forces_on_links(self, scene):
        expected = Forces(scene).on_links()
        found = rows_of(parts.acting, scene.mechanism).planar("on links", scene.q, scene.qd)
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()

    @pytest.mark.parametrize("scene", SOME)
    def test_of_many_states_they_are_those_of_each(self, scene):
        """Of one state they are taken in floats."""
        mech, rng = scene.mechanism, np.random.default_rng(0)
        q, qd = rng.normal(size=(2, 2, 3, scene.n))
        rows = RowValues(mech)
        for name in ("torques", "forces", "on links", "power", "gap", "PE"):
            each = [[rows(name, q[i, j], qd[i, j]) for j in range(3)] for i in (0, 1)]
            many = rows(name, q, qd)
            assert many.shape == np.shape(each)
            size = np.abs(many).max(initial=0.0)
            assert many == pytest.approx(np.array(each), rel=1e-12, abs=1e-12 * size)
            assert rows(name, q[:0], qd[:0]).shape == (0, *many.shape[1:])

    @pytest.mark.parametrize("scene", SOME)
    def test_batches_are_single_states(self, scene):
        """Many states run through generated code on arrays."""
        mech = scene.mechanism
        count = 40_000
        q, qd, qdd = (np.broadcast_to(x, (count, scene.n)) for x in scene.states)
        tau = inverse_dynamics(mech, scene.q, scene.qd, scene.qdd)
        many = inverse_dynamics(mech, q, qd, qdd)
        assert many[[0, -1]] == pytest.approx(np.array([tau, tau]), rel=1e-9, abs=1e-9)
        found = forward_dynamics(mech, q, qd, np.broadcast_to(tau, q.shape))
        assert found[[0, -1]] == pytest.approx(np.array([scene.qdd] * 2), rel=1e-8, abs=1e-8)

    @pytest.mark.parametrize("scene", SCENES)
    def test_the_identities_of_check_hold(self, scene):
        mech = scene.mechanism
        sample = identities.Sample(scene.q[None], scene.qd[None], 1.0)
        found = identities.identities(mech, sample)
        assert {item.name for item in found} >= {identities.FORCES, identities.POWER}
        assert [item.name for item in found if not item.holds] == []

    @pytest.mark.parametrize("scene", SOME)
    @pytest.mark.parametrize(
        "change",
        [
            lambda mech: {"moments": tuple(x + 0.1 for x in mech.moments)},
            lambda mech: {"springs": mech.springs[1:]},
            lambda mech: {"joint_springs": ()},
            lambda mech: {"friction": ()},
            lambda mech: {"forces": ()},
        ],
    )
    def test_the_identities_detect_what_is_wrong(self, scene, change):
        mech = scene.mechanism
        wrong = dataclasses.replace(mech, **change(mech))
        sample = identities.Sample(scene.q[None], scene.qd[None], 1.0)
        assert not all(item.holds for item in identities.identities(wrong, sample))


class TestRates:
    @EACH_KIND
    @pytest.mark.parametrize("scene", SOME)
    def test_each_evaluator_gives_the_same(self, kind, scene):
        mech = scene.mechanism
        tau = np.zeros(scene.n)
        tau[list(mech.actuated)] = 1.5
        side = right_hand_side(mech, Actuation(tuple(tau.tolist())), work=True, kind=kind)
        y = np.concatenate([scene.q, scene.qd, [0.0]])
        found = np.asarray(side.rates(0.0, y), float)
        expected = forward_dynamics(mech, scene.q, scene.qd, tau)
        assert found[scene.n : -1] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        other = other_forces(mech, scene.q, scene.qd) - np.array(mech.damping) * scene.qd
        assert found[-1] == pytest.approx((tau + other) @ scene.qd, rel=1e-10)

    @pytest.mark.parametrize("scene", SOME)
    def test_inverse_then_forward(self, scene):
        mech = scene.mechanism
        if mech.passive and len(mech.actuated) < scene.n - len(mech.rows):
            pytest.fail("the shapes are driven")
        tau = inverse_dynamics(mech, *scene.states)
        found = forward_dynamics(mech, scene.q, scene.qd, tau)
        assert found == pytest.approx(scene.qdd, rel=1e-8, abs=1e-8)


class TestMotions:
    @pytest.mark.parametrize("method", ["DOP853", "taylor", "Radau"])
    @pytest.mark.parametrize("scene", SOME[::2])
    def test_the_energy_balance(self, scene, method):
        """E(t) - E(0) is the work of torques, dampers, friction and forces that turn."""
        torques = ", ".join(["0.5*cos(t)"] * len(scene.mechanism.actuated))
        motion = simulate(scene.mechanism, scene.q, scene.qd, 0.5, tau=torques, method=method)
        assert motion.outcome.label == "finished"
        assert motion.report.energy_drift < 1e-6

    @pytest.mark.parametrize("scene", SOME[::2])
    def test_the_taylor_series_agrees_with_dop853(self, scene):
        mech = scene.mechanism
        times = np.linspace(0.0, 0.5, 6)
        rows = [[float(k)] * len(mech.actuated) for k in range(3)]
        bent = table(mech, [0.0, 0.25, 1.0], rows)
        for tau in (None, bent, expressions(mech, ",".join(["t*q1"] * len(mech.actuated)), "tau")):
            first, second = (
                simulate(
                    mech,
                    scene.q,
                    scene.qd,
                    0.5,
                    tau=tau,
                    t_eval=times,
                    method=method,
                    rtol=1e-11,
                    atol=1e-11,
                )
                for method in ("DOP853", "taylor")
            )
            assert second.q == pytest.approx(first.q, abs=1e-7)
            assert second.report.work == pytest.approx(first.report.work, abs=1e-6)

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
            E = robodyn_energy(mech, motion)
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
        motion = simulate(mech, scene.q, scene.qd, 0.25, t_eval=[0.25], rtol=1e-12, atol=1e-12)
        found = reference(mech, state, np.array([0.25]), tau)
        assert found.uncertainty < 1e-11
        assert motion.q[0] == pytest.approx(found.y[0, : scene.n], abs=1e-9)


def robodyn_energy(mech, motion):
    return kinetic_energy(mech, motion.q, motion.qd) + potential_energy(mech, motion.q)


class TestReactions:
    @pytest.mark.parametrize("scene", SCENES)
    def test_free_bodies(self, scene):
        """Newton's and Euler's equations of each link alone, with every force on it."""
        mech = scene.mechanism
        description = mech.description
        tau, lam, *_ = inverse_dynamics_and_forces(mech, *scene.states)
        R = reactions(mech, *scene.states, lam) @ [1, 1j]
        pose = Pose(oracle_tree(description), scene.q)
        n = scene.n
        force = np.zeros(n, complex)
        moment = np.zeros(n)

        def act(place, F):
            if place[0] is not None:
                force[place[0]] += F
                moment[place[0]] += (np.conj(pose.position(place)) * F).imag

        def turn(link, torque):
            if link is not None:
                moment[link] += torque

        for k, link in enumerate(description.links):
            above = link.hangs_from.link
            joint = (k, 0j)
            act(joint, R[k])
            if above is not None:
                act((above, link.hangs_from.at), -R[k])
            net = tau[k] - mech.damping[k] * scene.qd[k]
            if link.friction is not None:
                net -= link.friction.torque * math.tanh(scene.qd[k] / link.friction.speed)
            for spring in description.springs:
                if isinstance(spring, JointSpring) and spring.joint == k:
                    net -= spring.stiffness * (scene.q[k] - spring.angle)
            turn(k, net)
            turn(above, -net)
        for closure, pin in zip(description.closures, pin_forces(mech, lam), strict=True):
            F = complex(*pin)
            act((closure.first.link, closure.first.at), F)
            act((closure.second.link, closure.second.at), -F)
        for spring in description.springs:
            if isinstance(spring, JointSpring):
                continue
            ends = [(p.link, p.at) for p in (spring.first, spring.second)]
            d = pose.position(ends[0]) - pose.position(ends[1])
            rate = (pose.slope(ends[0]) - pose.slope(ends[1])) @ scene.qd
            sdot = (np.conj(d) * rate).real / abs(d)
            F = -(spring.stiffness * (abs(d) - spring.length) + spring.damping * sdot) * d / abs(d)
            act(ends[0], F)
            act(ends[1], -F)
        for item in description.loads:
            if isinstance(item, Load):
                turned = np.exp(1j * pose.alpha[item.point.link]) if item.turns else 1.0
                act((item.point.link, item.point.at), item.force * turned)
            else:
                turn(item.link, item.torque)
        accelerations = np.array([scene.qdd[pose.path(k)].sum() for k in range(n)])
        for k, link in enumerate(description.links):
            momentum, spin = 0j, link.I * accelerations[k]
            for mass, at in ((link.m, link.r), (link.payload, complex(link.l))):
                place = (k, at)
                a = pose.slope(place) @ scene.qdd + pose.bias(place, scene.qd)
                F = mass * (a - description.gravity)
                momentum += F
                spin += (np.conj(pose.position(place)) * F).imag
            size = 1.0 + np.abs(R).max()
            assert abs(force[k] - momentum) < 1e-11 * size
            assert abs(moment[k] - spin) < 1e-10 * size

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

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("springs: [{between: [a], stiffness: 1, length: 0}]", "springs[0].between = 1 points"),
            ("springs: [{between: [a, a], stiffness: 1, length: 0}]", "points of one link"),
            (
                "springs: [{between: [[0, 0], [1, 0]], stiffness: 1, length: 0}]",
                "points of the ground",
            ),
            ("springs: [{between: [a, [0, 1]], stiffness: -1, length: 0}]", "stiffness = -1"),
            ("springs: [{between: [a, [0, 1]], stiffness: 1}]", "springs[0].length: is missing"),
            ("springs: [{between: [a, c], stiffness: 1, length: 0}]", "names no link"),
            ("springs: [{joint: a, stiffness: 1}]", "springs[0].angle: is missing"),
            ("springs: [{joint: a, stiffness: 1, angle: 1m}]", "springs[0].angle"),
            ("springs: [{joint: d, stiffness: 1, angle: 1}]", "names no link"),
            ("springs: {joint: a}", "springs = a mapping: must be a list"),
            ("loads: [{link: a, at: [0, 0], force: 3}]", "loads[0].force"),
            ("loads: [{link: a, force: [1, 0]}]", "loads[0].at: is missing"),
            ("loads: [{link: a, torque: much}]", "loads[0].torque"),
            ("loads: [{link: a, torque: 1, at: [0, 0]}]", "loads[0].at: is an unknown key"),
            ("loads: [{link: a, at: [0, 0], force: [1, 0], frame: body}]", "ground or link"),
        ],
    )
    def test_each_is_named(self, text, words):
        with pytest.raises(InputError) as caught:
            mechanism(self.LINK + text + "\n")
        assert words in str(caught.value)

    @pytest.mark.parametrize("speed", ["0", "-1"])
    def test_friction_needs_a_speed(self, speed):
        with pytest.raises(InputError, match="must be > 0"):
            mechanism(
                "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1, "
                f"friction: {{torque: 1, speed: {speed}}}}}]\n"
            )

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
        found = simulate(mech, *start, method="taylor", engine="compiled", **options)
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
