"""Reactions and shaking forces against Newton and Euler for each body alone.

Every link is cut free and every force on it is written down: gravity, the reaction at its own
joint, those of the links that hang from it with the opposite sign, closure forces, joint torques
and dampers.  Accelerations are those of points, d(point)/dq_j = i (point - joint_j).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from conftest import FRESH, ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

import robodyn
from random_mechanisms import (
    LOOPS,
    Pose,
    Scene,
    assert_close,
    loops,
    mechanism,
    seeded_scene,
    seeded_tree,
    trees,
)
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.dynamics.reaction_forces import dependent_rows, not_unique, reactions, shaking_force

RTOL = 1e-11


def cross(a: complex, b: complex) -> float:
    """a x b of two vectors of the plane."""
    return a.real * b.imag - a.imag * b.real


@dataclass(frozen=True)
class Force:
    """A force (N) at a place of a link."""

    at: complex  # m, in the plane
    velocity: complex  # m/s, of the point of the link there
    value: complex


class Instant:
    """A mechanism in motion with its forces, cut into free bodies; complex vectors."""

    def __init__(self, mech, q, qd, qdd, tau, R, f) -> None:
        self.links, self.closures = mech.description.links, mech.description.closures
        self.gravity = mech.description.gravity
        tree = [
            {"parent": link.hangs_from.link, "at": link.hangs_from.at, "l": link.l}
            for link in self.links
        ]
        self.pose = Pose(tree, np.asarray(q))
        self.q, self.qd, self.qdd = (np.asarray(x, float) for x in (q, qd, qdd))
        self.R = [complex(*pair) for pair in np.asarray(R)]
        self.f = [complex(*pair) for pair in np.asarray(f)]
        self.torque = [
            tau[k] - link.damping * qd[k] for k, link in enumerate(self.links)
        ]  # on link k at its own joint

    def children(self, link: int | None) -> list[int]:
        return [k for k, other in enumerate(self.links) if other.hangs_from.link == link]

    def rate(self, link: int, values: np.ndarray) -> float:
        """Absolute angular rate of a link."""
        return float(sum(values[j] for j in self.pose.path(link)))

    def velocity(self, place) -> complex:
        return complex(self.pose.slope(place) @ self.qd)

    def acceleration(self, place) -> complex:
        return complex(self.pose.slope(place) @ self.qdd + self.pose.bias(place, self.qd))

    def masses(self, k: int) -> list[tuple[float, tuple[int, complex]]]:
        link = self.links[k]
        return [(link.m, (k, link.r)), (link.payload, (k, complex(link.l)))]

    def contacts(self, link: int | None) -> Iterator[Force]:
        """The pin forces on a link, or on the ground (None)."""

        def force(place, value) -> Force:
            return Force(self.pose.position(place), self.velocity(place), value)

        if link is not None:
            yield force((link, 0j), self.R[link])
        for child in self.children(link):
            yield force((link, self.links[child].hangs_from.at), -self.R[child])
        for closure, f in zip(self.closures, self.f, strict=True):
            # a line pushes where the point is, not at the point that the scene draws it through
            first = closure.first.link, closure.first.at
            second = closure.second.link, closure.second.at
            if first[0] == link:
                yield force(first, f)
            if second[0] == link:
                yield Force(self.pose.position(first), self.velocity(second), -f)

    def couple(self, link: int | None) -> float:
        """Joint torques and dampers on a link, or on the ground."""
        own = 0.0 if link is None else self.torque[link]
        return own - sum(self.torque[child] for child in self.children(link))

    def residuals(self) -> tuple[list[float], list[float], list[float]]:
        """What is missing to Newton's and Euler's equation and to the power of each link."""
        newton, euler, power = [], [], []
        for k in range(len(self.links)):
            centre = self.pose.position((k, self.links[k].r))
            w, wd = self.rate(k, self.qd), self.rate(k, self.qdd)
            force, moment = 0j, self.couple(k) - self.links[k].I * wd
            work = self.couple(k) * w - self.links[k].I * w * wd
            for contact in self.contacts(k):
                force += contact.value
                moment += cross(contact.at - centre, contact.value)
                work += (contact.value * contact.velocity.conjugate()).real
            for m, place in self.masses(k):
                inertial = m * (self.gravity - self.acceleration(place))
                force += inertial
                moment += cross(self.pose.position(place) - centre, inertial)
                work += (inertial * self.velocity(place).conjugate()).real
            newton.append(abs(force))
            euler.append(abs(moment))
            power.append(abs(work))
        return newton, euler, power

    def on_the_ground(self) -> list[float]:
        """Fx, Fy, M of all contacts of the ground."""
        contacts = list(self.contacts(None))
        force = sum((contact.value for contact in contacts), 0j)
        moment = self.couple(None) + sum(cross(contact.at, contact.value) for contact in contacts)
        return [force.real, force.imag, moment]

    def bodies(self) -> list[tuple[float, complex]]:
        """Masses kg and where they are, m."""
        return [
            (m, self.pose.position(place))
            for k in range(len(self.links))
            for m, place in self.masses(k)
        ]

    def momentum(self) -> np.ndarray:
        """px, py kg m/s and the angular momentum about the origin kg m^2/s."""
        total, turning = 0j, 0.0
        for k, link in enumerate(self.links):
            turning += link.I * self.rate(k, self.qd)
            for m, place in self.masses(k):
                total += m * self.velocity(place)
                turning += m * cross(self.pose.position(place), self.velocity(place))
        return np.array([total.real, total.imag, turning])

    def size(self) -> float:
        """Of the forces that are added up, N."""
        loads = [
            m * (abs(self.gravity) + abs(self.acceleration(place)))
            for k in range(len(self.links))
            for m, place in self.masses(k)
        ]
        return 1.0 + sum(loads) + sum(map(abs, self.f)) + float(np.abs(self.torque).sum())


def solved(mech, q, qd, qdd=None, tau=None) -> tuple[Instant, np.ndarray]:
    """The instant with all forces, and the shaking force; qdd or tau is given."""
    if tau is None:
        tau, multipliers, _ = robodyn.inverse_dynamics_and_forces(mech, q, qd, qdd)
    else:
        qdd, multipliers, _ = robodyn.forward_dynamics_and_forces(mech, q, qd, tau)
    R = reactions(mech, q, qd, qdd, multipliers)
    f = robodyn.pin_forces(mech, multipliers)
    return Instant(mech, q, qd, qdd, tau, R, f), shaking_force(mech, q, qd, qdd)


def in_motion(mech, q, qd, qdd) -> Instant:
    """The instant without its forces."""
    n, closures = mech.n, len(mech.description.closures)
    return Instant(mech, q, qd, qdd, np.zeros(n), np.zeros((n, 2)), np.zeros((closures, 2)))


def assert_balanced(instant: Instant, shake: np.ndarray, rtol: float = RTOL) -> None:
    """Every body alone obeys Newton and Euler, and the ground feels what touches it."""
    size = instant.size()
    for residuals in instant.residuals()[:2]:
        assert_close(residuals, np.zeros(len(residuals)), 3 * size, rtol)
    speed = 1.0 + float(np.abs(instant.qd).sum())
    assert_close(instant.residuals()[2], np.zeros(len(instant.links)), 3 * size * speed, rtol)
    assert_close(shake, instant.on_the_ground(), 5 * size, rtol)


class TestFreeBodies:
    @settings(max_examples=60 if FRESH else 25, deadline=None)
    @given(trees())
    def test_trees(self, scene: Scene) -> None:
        assert_balanced(*solved(scene.mechanism, *scene.states))

    @settings(max_examples=60 if FRESH else 25, deadline=None)
    @given(loops())
    def test_loops(self, scene: Scene) -> None:
        assert_balanced(*solved(scene.mechanism, *scene.states), rtol=1e-9)

    @settings(max_examples=30 if FRESH else 15, deadline=None)
    @given(loops(), st.integers(0, 1000))
    def test_loops_under_torques(self, scene: Scene, seed: int) -> None:
        tau = np.random.default_rng(seed).uniform(-20, 20, scene.n)
        instant, shake = solved(scene.mechanism, scene.q, scene.qd, tau=tau)
        assert_balanced(instant, shake, rtol=1e-9)

    @pytest.mark.parametrize("seed", range(5))
    def test_trees_under_torques(self, seed: int) -> None:
        scene = seeded_tree(seed, 7)
        tau = np.random.default_rng(seed).uniform(-20, 20, 7)
        assert_balanced(*solved(scene.mechanism, scene.q, scene.qd, tau=tau), rtol=1e-9)

    @pytest.mark.parametrize("name", LOOPS)
    def test_every_shape(self, name: str) -> None:
        for seed in range(3):
            scene = seeded_scene(seed, LOOPS[name])
            assert_balanced(*solved(scene.mechanism, *scene.states), rtol=1e-10)

    @pytest.mark.parametrize(
        ("name", "q"),
        [
            ("2r", [0.4, -1.1]),
            ("3r", [0.4, -1.1, 0.6]),
            ("pendulum", [0.4]),
            ("four-bar", [1.0]),
            ("slider-crank", [0.9]),
            ("five-bar", [2.1, 1.0]),
            ("parallelogram", [1.2]),
        ],
    )
    def test_the_scenes_of_robots(self, name: str, q: list[float]) -> None:
        mech = robodyn.load(ROOT / f"robots/{name}.yaml")
        q = robodyn.assemble(mech, q)
        driven = np.linspace(3, 4, len(mech.actuated))
        qd = robodyn.loop_velocities(mech, q, driven)
        qdd = robodyn.loop_accelerations(mech, q, qd, -2 * driven)
        assert_balanced(*solved(mech, q, qd, qdd))
        assert_balanced(*solved(mech, q, qd, tau=np.linspace(-1, 2, mech.n)))

    def test_links_without_mass(self) -> None:
        """A light coupler only passes on what its ends are pulled with."""
        mech = robodyn.load(ROOT / "tests/hard_cases/massless-coupler.yaml")
        q = robodyn.assemble(mech, [1.0])
        instant, shake = solved(mech, q, np.zeros(mech.n), tau=np.linspace(1, 0, mech.n))
        assert_balanced(instant, shake)

    def test_nothing_has_mass(self) -> None:
        mech = mechanism("links: [{name: bar, m: 0, l: 1, r: 0.5, I: 0.2}]\n")
        assert np.array_equal(reactions(mech, [1], [2], [3], []), [[0.0, 0.0]])
        assert_close(shaking_force(mech, [1], [2], [3]), [0.0, 0.0, -0.6], 1.0)

    def test_a_chain_of_many_links(self) -> None:
        scene = seeded_tree(3, 60)
        assert_balanced(*solved(scene.mechanism, *scene.states), rtol=1e-10)

    def test_links_in_any_order(self) -> None:
        """A link may stand before the one that it hangs from."""
        text = """
gravity: [1.3, -9.2]
links:
  - {name: hand, m: 0.4, l: 0.3, r: [0.14, 0.02], I: 0.003, from: arm, payload: 0.2}
  - {name: arm, m: 1.1, l: 0.6, r: 0.27, I: 0.04, from: [0.2, -0.1], damping: 0.3}
"""
        mech = mechanism(text)
        q, qd, qdd = np.random.default_rng(5).uniform(-3, 3, (3, 2))
        swapped = mechanism(
            "gravity: [1.3, -9.2]\nlinks:\n"
            + "".join(f"{line}\n" for line in reversed(text.splitlines()[3:]))
        )
        turned = [x[::-1] for x in (q, qd, qdd)]
        assert_balanced(*solved(swapped, *turned))
        R = reactions(mech, q, qd, qdd, [])
        assert_close(R, reactions(swapped, *turned, [])[::-1], 50.0)
        assert_close(shaking_force(mech, q, qd, qdd), shaking_force(swapped, *turned), 50.0)


class TestKnownForces:
    def test_a_pendulum(self) -> None:
        """m (-g + r wd i e - r w^2 e) is the reaction; the shaking force its opposite."""
        m, r, I, g = 0.7, 0.3, 0.02, 9.81
        mech = mechanism(f"gravity: {g}\nlinks: [{{name: bob, m: {m}, l: 1, r: {r}, I: {I}}}]\n")
        q, w, wd = 0.6, 2.5, -4.0
        e = np.exp(1j * q)
        expected = m * (r * (1j * wd - w**2) * e + 1j * g)
        ((fx, fy),) = reactions(mech, [q], [w], [wd], [])
        assert_close([fx, fy], [expected.real, expected.imag], 10.0)
        torque = (I + m * r**2) * wd + m * g * r * np.cos(q)
        shake = shaking_force(mech, [q], [w], [wd])
        assert_close(shake, [-expected.real, -expected.imag, -torque], 10.0)

    @settings(max_examples=30 if FRESH else 15, deadline=None)
    @given(loops() | trees())
    def test_at_rest_the_ground_carries_the_weight(self, scene: Scene) -> None:
        mech, still = scene.mechanism, np.zeros(scene.n)
        bodies = in_motion(mech, scene.q, still, still).bodies()
        weight = sum(m * mech.gamma for m, _ in bodies)
        moment = sum(cross(place, m * mech.gamma) for m, place in bodies)
        shake = shaking_force(mech, scene.q, still, still)
        assert_close(shake, [weight.real, weight.imag, moment], 1.0 + 10 * abs(weight))

    @pytest.mark.parametrize("name", ["four-bar", "slider-crank", "five-bar", "loop in a tree"])
    @pytest.mark.parametrize("seed", range(3))
    def test_the_change_of_momentum(self, name: str, seed: int) -> None:
        """F = weight - d(momentum)/dt, and M likewise, by central differences of order four."""
        scene = seeded_scene(seed, LOOPS[name])
        mech, (q, qd, qdd) = scene.mechanism, scene.states

        def momentum(t: float) -> np.ndarray:
            return in_motion(mech, q + qd * t + qdd * t**2 / 2, qd + qdd * t, qdd).momentum()

        h = 1e-3
        slope = 8 * (momentum(h) - momentum(-h)) - (momentum(2 * h) - momentum(-2 * h))
        weight = shaking_force(mech, q, 0 * qd, 0 * qd)
        size = 100.0 + float(np.abs(slope).max()) / (12 * h)
        assert_close(shaking_force(mech, q, qd, qdd), weight - slope / (12 * h), size, 1e-7)


class TestShapes:
    def test_leading_axes(self) -> None:
        mech = robodyn.load(ROOT / "robots/five-bar.yaml")
        crank = np.random.default_rng(1).uniform(0.5, 2.5, (2, 3, 2))
        q = robodyn.assemble(mech, crank)
        qd = robodyn.loop_velocities(mech, q, crank)
        qdd = robodyn.loop_accelerations(mech, q, qd, crank)
        lam = robodyn.inverse_dynamics_and_forces(mech, q, qd, qdd).multipliers
        R, shake = reactions(mech, q, qd, qdd, lam), shaking_force(mech, q, qd, qdd)
        assert R.shape == (2, 3, 4, 2)
        assert shake.shape == (2, 3, 3)
        for k in np.ndindex(2, 3):
            assert_close(R[k], reactions(mech, q[k], qd[k], qdd[k], lam[k]), 50.0)
            assert_close(shake[k], shaking_force(mech, q[k], qd[k], qdd[k]), 50.0)

    def test_states_broadcast(self) -> None:
        mech = robodyn.load(ROOT / "robots/2r.yaml")
        q = np.random.default_rng(1).uniform(-3, 3, (5, 2))
        R = reactions(mech, q, [1, 2], [0, 0], np.zeros((5, 0)))
        assert R.shape == (5, 2, 2)
        assert np.array_equal(R, reactions(mech, q, [1, 2], [0, 0], []))
        assert reactions(mech, q[:0], [1, 2], [0, 0], []).shape == (0, 2, 2)
        assert shaking_force(mech, q[:0], [1, 2], [0, 0]).shape == (0, 3)

    def test_what_does_not_fit_is_named(self) -> None:
        mech = robodyn.load(ROOT / "robots/four-bar.yaml")
        q = robodyn.assemble(mech, [1.0])
        with pytest.raises(robodyn.InputError, match=r"multipliers\.shape = \(3,\): must have 2"):
            reactions(mech, q, q, q, [1, 2, 3])
        with pytest.raises(robodyn.InputError, match=r"multipliers\.shape = \(\)"):
            reactions(mech, q, q, q, 1.0)
        with pytest.raises(robodyn.InputError, match="qdd"):
            reactions(mech, q, q, [1, 2], [1, 2])
        with pytest.raises(robodyn.InputError, match="qd"):
            shaking_force(mech, q, [np.nan, 1, 2], q)


HANGING = """\
gravity: 9.81
links:
  - {name: crank, m: 0.45, l: 0.3, r: 0.14, I: 0.0041}
  - {name: coupler, m: 1.1, l: 0.7, r: 0.36, I: 0.049}
  - {name: rocker, m: 0.55, l: 0.3, r: 0.16, I: 0.0052, from: [0.7, 0]}
  - {name: third, m: 0.5, l: 0.3, r: 0.15, I: 0.005, from: [0.4, 0]}
  - {name: bob, m: 0.2, l: 0.2, r: 0.1, I: 0.001, from: coupler}
  - {name: apart, m: 0.3, l: 0.2, r: 0.1, I: 0.001, from: [2, 0]}
  - {name: driver, m: 0.6, l: 0.35, r: 0.15, I: 0.008, from: [3, 0]}
  - {name: rod, m: 1.3, l: 0.95, r: 0.45, I: 0.1}
  - {name: lever, m: 1.0, l: 0.8, r: 0.36, I: 0.06, from: [4.1, 0]}
closures:
  - [coupler, rocker]
  - [rod, lever]
  - [{link: coupler, at: [0.4, 0]}, third]
actuated: [crank, bob, apart, driver]
"""


class TestNotUnique:
    """A third parallel crank: its pull may grow by any amount if the others' change with it."""

    @pytest.fixture
    def hanging(self):
        mech = mechanism(HANGING)
        q = robodyn.assemble(mech, [1.0, 0.3, -0.4, 0.8])
        return mech, q, np.zeros(mech.n)

    def test_the_loops_that_depend_are_named(self, hanging) -> None:
        mech, q, _ = hanging
        closures, links = not_unique(mech, q, t=0.0)
        assert closures == (0, 2)
        assert [mech.link_names[k] for k in links] == ["crank", "coupler", "rocker", "third"]
        assert dependent_rows(mech, q, t=0.0) == 1

    def test_they_are_those_that_change_and_all_balance(self, hanging) -> None:
        mech, q, still = hanging
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            tau, multipliers, _ = robodyn.inverse_dynamics_and_forces(mech, q, still, still)
        assert [note.category for note in told] == [RobodynWarning]
        U, s, _ = np.linalg.svd(robodyn.closure_jacobian(mech, q))
        assert s[-1] < 1e-12 < s[-2]
        found = []
        for lam in (multipliers, multipliers + 100 * U[:, -1]):
            R = reactions(mech, q, still, still, lam)
            f = robodyn.pin_forces(mech, lam)
            instant = Instant(mech, q, still, still, tau, R, f)
            assert_balanced(instant, shaking_force(mech, q, still, still))
            found.append(R)
        changed = np.flatnonzero(np.abs(found[1] - found[0]).max(axis=-1) > 1e-9)
        assert tuple(changed) == not_unique(mech, q, t=0.0)[1]

    def test_at_a_change_point(self) -> None:
        mech = robodyn.load(ROOT / "robots/parallelogram.yaml")
        assert not_unique(mech, [0, 0, 0], t=0.0) == ((0,), (0, 1, 2))
        assert not_unique(mech, [1.0, -1.0, 1.0], t=0.0) == ((), ())
        assert dependent_rows(mech, [[0, 0, 0], [1, -1, 1]], t=0.0).tolist() == [1, 0]

    def test_without_loops_all_is_unique(self) -> None:
        assert not_unique(robodyn.load(ROOT / "robots/2r.yaml"), [1, 2], t=0.0) == ((), ())
