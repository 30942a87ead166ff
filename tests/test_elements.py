"""Each kind of element in random trees: identities, both integrators, the regressor."""

from dataclasses import replace

import numpy as np
import pytest

from random_mechanisms import seeded_tree
from robodyn import forward_dynamics, inverse_dynamics, simulate
from robodyn.dynamics.identities import BOUND, identities, sample_states
from robodyn.elements.base import SPENT, Element
from robodyn.elements.joints import DryFriction, Rotor, Slipping, SmoothFriction, Stops
from robodyn.elements.kinds import KINDS
from robodyn.elements.loads import Force, VaryingMoment
from robodyn.elements.springs import JointDamper, JointSpring, PointSpring
from robodyn.mechanics.mechanism import build
from robodyn.mechanics.modes import Mode, in_mode
from robodyn.parameters.regression_matrix import regressor
from robodyn.scene import scene as described
from robodyn.scene.scene import Law, Load, Moment, Motor, Point, Spring
from robodyn.scene.syntax import parsed

LINKS = 3


def point(rng, link):
    return Point(link, complex(*rng.uniform(-0.4, 0.4, 2)))


def on_link(description, k, **fields):
    links = list(description.links)
    links[k] = links[k]._replace(**fields)
    return description._replace(links=tuple(links))


def law(code, *names):
    return Law(code, parsed(code, str).nodes[0], frozenset(names))


def point_springs(rng, scene):
    far = Point(None, complex(2.0, *rng.uniform(1.0, 2.0, 1)))
    springs = (
        Spring(point(rng, 2), far, rng.uniform(5, 20), 0.4, rng.uniform(0.1, 1)),
        Spring(point(rng, 1), far, 0.0, 0.3, 0.0, law("9.0*x+4.0*x**3", "x")),
        Spring(point(rng, 0), far, 0.0, 0.3, 0.0, law("3.0*x+0.5*v", "x", "v")),
    )
    return scene._replace(springs=springs)


def joint_springs(rng, scene):
    springs = (
        described.JointSpring(0, rng.uniform(1, 5), rng.uniform(-1, 1)),
        described.JointSpring(2, 0.0, 0.2, 0.1, law("2.0*x+x**3", "x")),
        described.JointSpring(2, 0.0, 0.2, 0.0, law("2.0*x+0.3*v", "x", "v")),
    )
    return scene._replace(springs=springs)


def forces(rng, scene):
    loads = (
        Load(point(rng, 2), complex(*rng.uniform(-3, 3, 2))),
        Load(point(rng, 1), complex(*rng.uniform(-3, 3, 2)), True),
        Load(point(rng, 0), 1.5 + 0j, True, (None, law("2.0*q1+qd0", "q1", "qd0"))),
    )
    return scene._replace(loads=loads)


def varying_moments(rng, scene):
    return scene._replace(loads=(Moment(1, 0.0, law("1.5*q0-0.2*qd2", "q0", "qd2")),))


def dampers(rng, scene):
    scene = on_link(scene, 0, damping=rng.uniform(0.1, 1))
    return on_link(scene, 1, motor=Motor(3.0, 0.0, rng.uniform(0.01, 0.1)))


def smooth_friction(rng, scene):
    return on_link(scene, 1, friction=described.Friction(rng.uniform(0.1, 0.5), 0.8))


def dry_friction(rng, scene):
    torque = rng.uniform(0.1, 0.2)
    return on_link(scene, 1, friction=described.DryFriction(torque, torque + 0.1, 0.5))


def stops(rng, scene):
    return on_link(scene, 1, limits=described.Limits(-0.1, 0.15, rng.uniform(50, 90), 0.5))


def rotors(rng, scene):
    return on_link(scene, 2, motor=Motor(rng.uniform(5, 20), rng.uniform(0.001, 0.01)))


CASES = {
    PointSpring: point_springs,
    JointSpring: joint_springs,
    Force: forces,
    VaryingMoment: varying_moments,
    JointDamper: dampers,
    SmoothFriction: smooth_friction,
    DryFriction: dry_friction,
    Slipping: dry_friction,
    Stops: stops,
    Rotor: rotors,
}

kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
seeds = pytest.mark.parametrize("seed", range(3))


def made(kind, seed):
    """A random tree with elements of a kind."""
    rng = np.random.default_rng(seed)
    return build(CASES[kind](rng, seeded_tree(seed, LINKS).mechanism.description))


def states(seed, rows=5):
    return np.random.default_rng(100 + seed).uniform(-1.0, 1.0, (3, rows, LINKS))


def checked(mechanism):
    free = in_mode(mechanism, Mode()) if mechanism.switches else mechanism
    found = identities(free, sample_states(free, 20))
    failed = [x for x in found if x.residual is not None and not x.residual <= BOUND]
    assert not failed, failed


def runs_agree(mechanism, seed, tolerance=1e-6):
    q, qd, _ = states(seed)
    taylor, other = (
        simulate(mechanism, q[0], qd[0], 0.5, method=method, rtol=1e-11, atol=1e-11)
        for method in ("taylor", "DOP853")
    )
    assert np.abs(taylor.q[-1] - other.q[-1]).max() < tolerance
    assert np.abs(taylor.qd[-1] - other.qd[-1]).max() < tolerance


def regressed(mechanism, seed):
    q, qd, qdd = states(seed)
    found = regressor(mechanism, q, qd, qdd)
    tau = inverse_dynamics(mechanism, q, qd, qdd)[:, list(mechanism.actuated)]
    assert np.allclose(found.Y @ found.values + found.known, tau, rtol=1e-11, atol=1e-11)


def test_every_kind_has_a_case():
    assert set(CASES) == set(KINDS)


@kinds
def test_its_case_has_it(kind):
    if kind is not Slipping:  # which only a mode has
        assert made(kind, 0).of(kind)


@kinds
@seeds
def test_its_identities_hold(kind, seed):
    checked(made(kind, seed))


@kinds
@seeds
def test_both_integrators_agree(kind, seed):
    runs_agree(made(kind, seed), seed)


@kinds
@seeds
def test_torques_are_linear_in_its_parameters(kind, seed):
    regressed(made(kind, seed), seed)


class QuadraticDrag(Element):
    """-c qd^3/sqrt(qd^2 + 1e-4) at a joint."""

    joint: int
    c: float

    @property
    def acts(self):
        return SPENT

    @property
    def at(self):
        return self.joint

    def rows(self, b):
        v = b.v(self.joint)
        square = b.product(v, v)
        speed = b.power_of(b.sum((1.0, square), constant=1e-4), -0.5)
        b.torque(self.joint, b.number(-self.c), b.product(b.product(square, v), speed))


class TestANewKind:
    @pytest.fixture(params=range(3))
    def dragged(self, request):
        plain = seeded_tree(request.param, LINKS).mechanism
        elements = (*plain.elements, QuadraticDrag(1, 0.7))
        return plain, replace(plain, elements=elements), request.param

    def test_torques_have_it(self, dragged):
        plain, mechanism, seed = dragged
        q, qd, qdd = states(seed)
        more = inverse_dynamics(mechanism, q, qd, qdd) - inverse_dynamics(plain, q, qd, qdd)
        drag = 0.7 * qd[:, 1] ** 3 / np.sqrt(qd[:, 1] ** 2 + 1e-4)
        assert np.allclose(more, drag[:, None] * [0, 1, 0], atol=1e-11)
        tau = inverse_dynamics(mechanism, q, qd, qdd)[:, list(mechanism.actuated)]
        assert np.allclose(forward_dynamics(mechanism, q, qd, tau), qdd, atol=1e-9)

    def test_identities_with_the_balance_of_energy(self, dragged):
        checked(dragged[1])

    def test_both_integrators_agree(self, dragged):
        runs_agree(dragged[1], dragged[2])

    def test_it_changes_the_energy(self, dragged):
        assert dragged[1].changes_energy
        assert dragged[1].has_state_forces

    def test_the_regressor_knows_it(self, dragged):
        regressed(dragged[1], dragged[2])
