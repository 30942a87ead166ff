"""New kinds of elements, each a class of this file alone, against formulas written here.

Torques, accelerations, motions, energies, identities, the regressor, reactions and linear models
must have them right with no line elsewhere; exports and written equations refuse them by name.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from random_mechanisms import Pose, oracle_tree, seeded_tree
from robodyn import (
    equilibrium,
    forward_dynamics,
    gravity_vector,
    inverse_dynamics,
    inverse_dynamics_and_forces,
    kinetic_energy,
    linearize,
    mass_matrix,
    other_forces,
    potential_energy,
    reactions,
    shaking_force,
    simulate,
)
from robodyn.dynamics.identities import BOUND, Identity, identities, sample_states
from robodyn.dynamics.named_numbers import named_values
from robodyn.elements import kinds
from robodyn.elements.base import SPENT, STORED, Element
from robodyn.elements.builder import Grip, PointForce
from robodyn.elements.joints import Rotor
from robodyn.elements.keys import Way, key
from robodyn.elements.link_rows import PlanarPoint
from robodyn.elements.springs import JointDamper
from robodyn.equations.recorded import recorded
from robodyn.equations.written import equations
from robodyn.errors import InputError
from robodyn.export.mjcf import mjcf
from robodyn.export.urdf import urdf
from robodyn.mechanics.link_tree import Tree
from robodyn.mechanics.mechanism import Mechanism, build, joint_damping
from robodyn.parameters.regression_matrix import regressor
from robodyn.pictures.force_arrows import forces_at
from robodyn.scene import grammar
from robodyn.scene.description import from_text
from robodyn.scene.scene import Point

LINKS = 3
SEEDS = range(4)


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


class Bushing(Element):
    """-k d - c d' on a point, d the way to it from another: a force that d' turns off that way."""

    first: Grip
    second: Grip
    between: PlanarPoint
    stiffness: float
    damping: float

    @property
    def acts(self):
        return STORED

    @property
    def changes_energy(self):
        return bool(self.damping)

    def stored(self):
        return self._replace(damping=0.0)

    def spent(self):
        return self._replace(stiffness=0.0)

    def energy(self, b):
        d = b.point(self.between)
        yield b.number(0.5 * self.stiffness), b.inner(d, d)

    def rows(self, b):
        d = b.point(self.between)
        rate = b.rate(d)
        parts = ((-self.stiffness, d), (-self.damping, rate))
        for constant, slot in parts:
            if constant:
                acting = b.planar_sum((b.planar_number(complex(constant)), slot))
                b.force(PointForce(self, 1.0, acting, self.first, self.second), self.between)
        if b.work and self.damping:
            b.works(b.number(-self.damping), b.inner(rate, rate))


class TorsionBar(Element):
    """k (alpha_second - alpha_first - angle) between the angles of two links, at no joint."""

    first: int
    second: int
    stiffness: float
    angle: float

    @property
    def acts(self):
        return STORED

    def _twist(self, b):
        apart = (1.0, b.coordinate(self.second)), (-1.0, b.coordinate(self.first))
        return b.sum(*apart, constant=b.number(-self.angle))

    def energy(self, b):
        yield b.number(0.5 * self.stiffness), b.product(self._twist(b), self._twist(b))

    def rows(self, b):
        torque = b.sum((b.number(self.stiffness), self._twist(b)))
        b.moment(self.first, torque, spends=False)
        b.moment(self.second, b.sum((-1.0, torque)), spends=False)


class Flywheel(Element):
    """A rotor behind a gear at a joint that hangs from the ground, in a bearing that drags."""

    joint: int
    inertia: float
    ratio: float
    drag: float

    def also(self):
        return (
            Rotor(self.joint, self.inertia, self.ratio, None, False),
            JointDamper(self.joint, self.drag * self.ratio**2),
        )


# -- what each must do -----------------------------------------------------------------------------


@dataclass
class Case:
    """A tree without and with a new element, and what that one does by formulas of this file.

    `torques` (n,) N m at joints, `energy` J, `inertia` (n, n) kg m^2 that M has more, all at q, qd;
    `felt` are the forces, N, and the links that feel them.
    """

    plain: Mechanism
    mechanism: Mechanism
    seed: int
    torques: Callable[[np.ndarray, np.ndarray], np.ndarray]
    energy: Callable[[np.ndarray], float] = lambda q: 0.0
    inertia: Callable[[], np.ndarray] = lambda: np.zeros((LINKS, LINKS))
    felt: Callable[[Pose, np.ndarray], list[tuple[int, complex]]] = lambda pose, qd: []
    damping: float = 0.0

    def pose(self, q: np.ndarray) -> Pose:
        return Pose(oracle_tree(self.plain.description), q)


def drag(seed: int) -> Case:
    plain = seeded_tree(seed, LINKS).mechanism

    def torques(q, qd):
        return np.array([0.0, -0.7 * qd[1] ** 3 / np.sqrt(qd[1] ** 2 + 1e-4), 0.0])

    return Case(plain, plain.with_added(QuadraticDrag(1, 0.7)), seed, torques)


def bushing(seed: int) -> Case:
    """Between points of two links, or of a link and the ground."""
    plain, rng = seeded_tree(seed, LINKS).mechanism, np.random.default_rng(seed)
    tree = Tree(plain.description.links)
    links = (2, 0) if seed % 2 else (1, None)
    places = [(k, complex(*rng.uniform(-0.5, 0.5, 2))) for k in links]
    k, c = rng.uniform(5, 20), rng.uniform(0.2, 1.0)
    points = [Point(*place) for place in places]
    grips = [(tree.point(x), x.link) for x in points]
    element = Bushing(*grips, tree.difference(*points), k, c)

    def apart(pose):
        return pose.position(places[0]) - pose.position(places[1])

    def slope(pose):
        return pose.slope(places[0]) - pose.slope(places[1])

    def force(pose, qd):
        return -k * apart(pose) - c * (slope(pose) @ qd)

    def torques(q, qd):
        pose = case.pose(q)
        return (slope(pose).conj() * force(pose, qd)).real

    def felt(pose, qd):
        f = force(pose, qd)
        return [(link, sign * f) for link, sign in zip(links, (1, -1), strict=True)]

    case = Case(
        plain,
        plain.with_added(element),
        seed,
        torques,
        energy=lambda q: 0.5 * k * abs(apart(case.pose(q))) ** 2,
        felt=felt,
    )
    return case


def torsion_bar(seed: int) -> Case:
    plain = seeded_tree(seed, LINKS).mechanism
    element = TorsionBar(0, 2, 6.0, 0.4)

    def turned(q, link):
        return sum(q[k] for k in case.pose(q).turning(link))

    def twist(q):
        return turned(q, 2) - turned(q, 0) - 0.4

    def torques(q, qd):
        ways = (np.isin(range(LINKS), case.pose(q).turning(k)).astype(float) for k in (0, 2))
        first, second = ways
        return 6.0 * twist(q) * (first - second)

    case = Case(
        plain, plain.with_added(element), seed, torques, energy=lambda q: 3.0 * twist(q) ** 2
    )
    return case


def flywheel(seed: int) -> Case:
    plain = seeded_tree(seed, LINKS).mechanism
    joint = next(k for k, parent in enumerate(plain.parent) if parent is None)
    one = np.zeros(LINKS)
    one[joint] = 1.0
    return Case(
        plain,
        plain.with_added(Flywheel(joint, 0.002, 7.0, 0.01)),
        seed,
        lambda q, qd: -0.49 * one * qd,
        inertia=lambda: 0.098 * np.outer(one, one),
        damping=0.49,
    )


KINDS = {"drag": drag, "bushing": bushing, "torsion bar": torsion_bar, "flywheel": flywheel}


@pytest.fixture(params=[(name, seed) for name in KINDS for seed in SEEDS], ids=str)
def case(request) -> Case:
    name, seed = request.param
    return KINDS[name](seed)


def states(seed: int, rows: int = 5) -> np.ndarray:
    return np.random.default_rng(100 + seed).uniform(-1.0, 1.0, (3, rows, LINKS))


# -- tests -----------------------------------------------------------------------------------------


def test_torques_and_accelerations(case):
    q, qd, qdd = states(case.seed)
    tau = inverse_dynamics(case.mechanism, q, qd, qdd)
    own = np.array([case.torques(*x) for x in zip(q, qd, strict=True)])
    wanted = inverse_dynamics(case.plain, q, qd, qdd) - own + qdd @ case.inertia()
    assert np.allclose(tau, wanted, rtol=1e-12, atol=1e-11)
    assert np.allclose(inverse_dynamics(case.mechanism, q[0], qd[0], qdd[0]), tau[0], atol=1e-11)
    for k in range(len(q)):
        found = forward_dynamics(case.mechanism, q[k], qd[k], wanted[k])
        assert np.allclose(found, qdd[k], atol=1e-8 * np.abs(qdd).max())
    assert np.allclose(forward_dynamics(case.mechanism, q, qd, wanted), qdd, atol=1e-8)


def test_terms_of_the_equation(case):
    """M and the energies have what they must, and G and Q share what acts, each part once."""
    q, qd, _ = states(case.seed)
    more = mass_matrix(case.mechanism, q) - mass_matrix(case.plain, q)
    assert np.allclose(more, case.inertia(), atol=1e-12)
    KE = kinetic_energy(case.mechanism, q, qd) - kinetic_energy(case.plain, q, qd)
    assert np.allclose(KE, 0.5 * np.einsum("ti,ij,tj->t", qd, case.inertia(), qd), atol=1e-12)
    PE = potential_energy(case.mechanism, q) - potential_energy(case.plain, q)
    assert np.allclose(PE, [case.energy(x) for x in q], atol=1e-11)
    still = np.array([case.torques(x, 0.0 * x) for x in q])  # of a potential alone
    G = gravity_vector(case.mechanism, q) - gravity_vector(case.plain, q)
    assert np.allclose(G, -still, atol=1e-11)
    moved = np.array([case.torques(*x) for x in zip(q, qd, strict=True)])
    damped = np.array(case.mechanism.damping) - np.array(case.plain.damping)
    assert damped.sum() == pytest.approx(case.damping)
    assert np.allclose(other_forces(case.mechanism, q, qd), moved - still + damped * qd, atol=1e-11)


def test_identities(case):
    assert not faults(case.mechanism)


def test_both_integrators_and_the_balance_of_energy(case):
    q, qd, _ = states(case.seed)
    taylor, other = (
        simulate(case.mechanism, q[0], qd[0], 0.5, method=method, rtol=1e-11, atol=1e-11)
        for method in ("taylor", "DOP853")
    )
    assert np.abs(taylor.q[-1] - other.q[-1]).max() < 1e-6
    assert np.abs(taylor.qd[-1] - other.qd[-1]).max() < 1e-6
    assert taylor.report.energy_drift < 1e-8
    assert other.report.energy_drift < 1e-8
    begin, end = (
        kinetic_energy(case.plain, q, qd)
        + potential_energy(case.plain, q)
        + 0.5 * qd @ case.inertia() @ qd
        + case.energy(q)
        for q, qd in (
            (x[0], v[0]) for x, v in ((other.q, other.qd), (taylor.q[-1:], taylor.qd[-1:]))
        )
    )
    if case.mechanism.changes_energy:
        assert begin - end > 1e-6
    else:
        assert begin == pytest.approx(end, abs=1e-7)


def test_the_regressor(case):
    q, qd, qdd = states(case.seed)
    found = regressor(case.mechanism, q, qd, qdd)
    tau = inverse_dynamics(case.mechanism, q, qd, qdd)[:, list(case.mechanism.actuated)]
    assert np.allclose(found.Y @ found.values + found.known, tau, rtol=1e-11, atol=1e-11)
    values = dict(zip(found.names, found.values, strict=True))
    for k, damping in enumerate(case.mechanism.damping):  # all of it is a parameter, and only once
        assert values[f"d{k + 1}"] == damping


def test_reactions_and_the_force_on_the_ground(case):
    """Newton's equation of all that a link carries: less what the element puts there."""
    q, qd, qdd = states(case.seed)
    found, plain = (
        reactions(m, q, qd, qdd, inverse_dynamics_and_forces(m, q, qd, qdd).multipliers)
        for m in (case.mechanism, case.plain)
    )
    for k in range(len(q)):
        pose, wanted = case.pose(q[k]), plain[k] @ [1.0, 1j]
        for link, force in case.felt(pose, qd[k]):
            wanted[pose.path(link)] -= force
        assert np.allclose(found[k] @ [1.0, 1j], wanted, atol=1e-10)
    turning = -qdd @ case.inertia().sum(axis=0)  # of the rotor, on what carries it
    gear = 7.0 if case.inertia().any() else 1.0
    shaken, before = (shaking_force(m, q, qd, qdd) for m in (case.mechanism, case.plain))
    before[:, 2] += turning / gear
    assert np.allclose(shaken, before, atol=1e-10)


def test_linear_models(case):
    q, qd, _ = states(case.seed)
    model = linearize(case.mechanism, q[0], qd[0], tau=np.ones(LINKS))

    def slope(name, k):
        step = np.zeros((2, LINKS))
        step[name, k] = 1e-5
        ends = (
            forward_dynamics(
                case.mechanism, q[0] + s * step[0], qd[0] + s * step[1], np.ones(LINKS)
            )
            for s in (1, -1)
        )
        return np.subtract(*ends) / 2e-5

    wanted = np.column_stack([slope(name, k) for name in (0, 1) for k in range(LINKS)])
    assert np.allclose(model.A[LINKS:], wanted, atol=1e-6 * np.abs(wanted).max())


def test_poses_at_rest(case):
    rest = equilibrium(case.mechanism, np.full(LINKS, 0.1))
    loads = gravity_vector(case.plain, rest.q) - case.torques(rest.q, np.zeros(LINKS))
    assert np.allclose(loads, 0.0, atol=1e-8 * np.abs(case.plain.weights).sum())


def test_arrows_of_forces(case):
    q, qd, _ = states(case.seed)
    found = [x.force for x in forces_at(case.mechanism, q[0], qd[0], t=0.0) if x.name == "bushing"]
    felt = [force for _, force in case.felt(case.pose(q[0]), qd[0])][:1]
    assert np.allclose(sum(found), sum(felt))


def test_exports_and_equations_refuse_it_by_name(case):
    kind = case.mechanism.added[0].word
    assert kind in ("quadratic drag", "bushing", "torsion bar", "flywheel")
    for write in (mjcf, urdf, equations, recorded):
        with pytest.raises(InputError, match=f"{kind}: "):
            write(case.mechanism)
        write(case.plain)


def test_a_number_of_the_scene_is_not_varied_without_it(case):
    """What builds the scene anew with other numbers would leave it out in silence."""
    q, qd, _ = states(case.seed)
    with pytest.raises(InputError, match="not that of its scene file"):
        simulate(case.mechanism, q[0], qd[0], 0.1, sensitivity=["links.link0.m"])
    with pytest.raises(InputError, match="more than its file"):
        named_values(case.mechanism, "links.link0.m")


# -- what a wrong kind shows -----------------------------------------------------------------------


def faults(mechanism: Mechanism) -> list[Identity]:
    found = identities(mechanism, sample_states(mechanism, 20))
    return [x for x in found if x.residual is not None and not x.residual <= BOUND]


def unpaid(self, b):
    work, b.work = b.work, False
    honest(self, b)
    b.work = work


honest = Bushing.rows
WRONG = {
    "in G, and again in Q": ("spent", lambda self: self),
    "its damper in neither": ("spent", lambda self: None),
    "its damper takes energy that nobody counts": ("rows", unpaid),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("seed", SEEDS)
def test_identities_see_a_wrong_bushing(wrong, seed, monkeypatch):
    assert not faults(bushing(seed).mechanism)
    monkeypatch.setattr(Bushing, *WRONG[wrong])
    assert faults(bushing(seed).mechanism)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_damper_that_another_element_brings_counts_once(seed):
    """As D, in the regressor, and in what a controller's model or a mode keeps."""
    case = flywheel(seed)
    q, qd, qdd = states(seed)
    found = regressor(case.mechanism, q, qd, qdd)
    d = found.names.index(f"d{1 + next(k for k, x in enumerate(case.plain.parent) if x is None)}")
    assert found.values[d] - regressor(case.plain, q, qd, qdd).values[d] == pytest.approx(0.49)
    assert np.allclose(found.known, regressor(case.plain, q, qd, qdd).known + more(case, qdd))


def more(case, qdd):
    """What the rotor, which no parameter of the scene has, adds to the torques."""
    return (qdd @ case.inertia())[:, list(case.mechanism.actuated)]


class Bearing(Element):
    """A damper that a scene's file has as a load, and that is a `JointDamper` of a mechanism."""

    joint: int = key("link_name", "the link whose joint it is")
    drag: float = key("amount", "of the bearing", unit="N m s/rad", symbol="cb: drag of {}")

    ways: ClassVar[tuple[Way, ...]] = (Way("bearing", "load", "A bearing.", ("drag",)),)

    def also(self):
        yield JointDamper(self.joint, self.drag)


@pytest.fixture
def bearings():
    """Scenes may have them."""
    grammar.declare((*grammar.OTHERS, *kinds.KINDS, Bearing))
    yield
    grammar.declare((*grammar.OTHERS, *kinds.KINDS))


@pytest.mark.usefixtures("bearings")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_damper_that_an_element_of_a_file_brings_counts_once(seed):
    text = seeded_tree(seed, LINKS).text
    plain = build(from_text(text, "x"))
    text += "\nloads: [{joint: link0, drag: 0.4}]\n"
    mechanism = build(from_text(text, "x"))
    assert mechanism.damping == (plain.damping[0] + 0.4, *plain.damping[1:])
    assert joint_damping(mechanism.description) == mechanism.damping
    q, qd, qdd = states(seed)
    tau = inverse_dynamics(mechanism, q, qd, qdd)
    wanted = inverse_dynamics(plain, q, qd, qdd) + 0.4 * qd * [1.0, 0.0, 0.0]
    assert np.allclose(tau, wanted, atol=1e-11)
    found = regressor(mechanism, q, qd, qdd)
    assert found.values[found.names.index("d1")] == mechanism.damping[0]
    assert np.allclose(found.Y @ found.values + found.known, tau[:, list(mechanism.actuated)])
    assert not faults(mechanism)
