"""Each kind of element in random trees: identities, both integrators, the regressor."""

import numpy as np
import pytest

from random_mechanisms import seeded_tree
from robodyn import inverse_dynamics, simulate
from robodyn.dynamics.identities import BOUND, identities, sample_states
from robodyn.elements.contacts import Mode
from robodyn.elements.joints import (
    CompliantStop,
    DryFriction,
    HardStop,
    Rotor,
    Slipping,
    SmoothFriction,
)
from robodyn.elements.kinds import KINDS
from robodyn.elements.loads import Force, VaryingMoment
from robodyn.elements.springs import JointDamper, JointSpring, PointSpring
from robodyn.mechanics.mechanism import build
from robodyn.mechanics.modes import in_mode
from robodyn.parameters.regression_matrix import regressor
from robodyn.scene import scene as described
from robodyn.scene.scene import Law, Load, Moment, Motor, Point, Spring

LINKS = 3


def point(rng, link):
    return Point(link, complex(*rng.uniform(-0.4, 0.4, 2)))


def on_link(description, k, **fields):
    links = list(description.links)
    links[k] = links[k]._replace(**fields)
    return description._replace(links=tuple(links))


def law(code, *names):
    return Law(code, code, frozenset(names))


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


def hard_stops(rng, scene):
    return on_link(scene, 1, limits=described.Limits(-2.0, 2.5, restitution=rng.uniform(0.2, 0.8)))


def compliant_stops(rng, scene):
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
    HardStop: hard_stops,
    CompliantStop: compliant_stops,
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


@pytest.mark.parametrize("kind", [CompliantStop, DryFriction, HardStop], ids=lambda x: x.__name__)
@seeds
def test_identities_hold_in_the_modes_of_contacts(kind, seed):
    """Each state in its own: stops push at some and not at others, joints slip both ways."""
    mechanism = made(kind, seed)
    sample = sample_states(mechanism, 20)
    beyond = (sample.q[:, 1] < -0.1) | (sample.q[:, 1] > 0.15)
    assert beyond.any()
    assert not beyond.all()
    failed = [x for x in identities(mechanism, sample) if not x.holds]
    assert not failed, failed


@kinds
@seeds
def test_both_integrators_agree(kind, seed):
    runs_agree(made(kind, seed), seed)


@kinds
@seeds
def test_torques_are_linear_in_its_parameters(kind, seed):
    regressed(made(kind, seed), seed)
