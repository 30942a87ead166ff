"""Each kind of element in random trees, written in files: identities, integrators, readers."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import yaml
from jsonschema import Draft202012Validator
from read_equations import evaluated, module

import robodyn
from random_mechanisms import seeded_tree
from robodyn import forward_dynamics, inverse_dynamics, reactions, simulate
from robodyn.dynamics.identities import BOUND, identities, sample_states
from robodyn.elements import kinds
from robodyn.elements.base import SPENT, STORED, Element
from robodyn.elements.builder import Name, PointForce
from robodyn.elements.contacts import Mode
from robodyn.elements.gravity import GravityField
from robodyn.elements.joints import (
    CompliantStop,
    DryFriction,
    HardStop,
    Rotor,
    Slipping,
    SmoothFriction,
    Stops,
)
from robodyn.elements.keys import Way, at_joints, key
from robodyn.elements.loads import Force, Moment
from robodyn.elements.pin_friction import PinFriction
from robodyn.elements.springs import JointDamper, JointSpring, PointSpring
from robodyn.elements.values import Point
from robodyn.equations.derivation import Derivation
from robodyn.equations.text import as_json, text
from robodyn.equations.written import equations
from robodyn.errors import InputError
from robodyn.export.mjcf import mjcf
from robodyn.export.urdf import urdf
from robodyn.mechanics.mechanism import build
from robodyn.mechanics.modes import in_mode
from robodyn.mechanics.placed import absolute_rates, placed
from robodyn.parameters.regression_matrix import regressor
from robodyn.scene import grammar
from robodyn.scene.description import from_text
from robodyn.scene.plain_scene import plain_scene
from robodyn.scene.scene_schema import scene_schema
from robodyn.scene.scene_values import SceneValues

LINKS = 3
NAMES = [f"link{k}" for k in range(LINKS)]


class QuadraticDrag(Element):
    """-c qd^3/sqrt(qd^2 + 1e-4) at a joint: a kind that robodyn does not have."""

    joint: int = key("link_name", "the link whose joint it is")
    c: float = key(
        "amount", "of the drag", unit="N m s²/rad²", symbol="cd: drag of {}", linear="cd"
    )

    ways: ClassVar[tuple[Way, ...]] = (Way("drag", "load", "A quadratic drag.", ("c",)),)

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def at(self) -> int:
        return self.joint

    def rows(self, b) -> None:
        v = b.v(self.joint)
        square = b.product(v, v)
        speed = b.power_of(b.sum((1.0, square), constant=1e-4), 0.5)
        speed = b.named(Name("U", "rad/s", "smoothed rate of {}"), speed)
        cube = b.product(square, v)
        b.torque(self.joint, b.number(-self.c), b.quotient(cube, speed))


class Magnet(Element):
    """-k sin(3 q) at a joint, with the potential -k/3 cos(3 q): another such kind."""

    joint: int = key("link_name", "the link whose joint it is")
    k: float = key(
        "amount", "its torque", unit="N m", symbol="km: hold of {}", linear="km", name="hold"
    )

    ways: ClassVar[tuple[Way, ...]] = (Way("magnet", "spring", "A magnet.", ("joint", "hold")),)

    @property
    def acts(self) -> str:
        return STORED

    @property
    def at(self) -> int:
        return self.joint

    def energy(self, b):
        yield b.number(-self.k / 3.0), b.function("cos", b.sum((3.0, b.q(self.joint))))

    def rows(self, b) -> None:
        turned = b.function("sin", b.sum((3.0, b.q(self.joint))))
        turned = b.named(Name("N", "", "part of its most that {} has"), turned)
        b.torque(self.joint, b.number(-self.k), turned, spends=False)


class Drag(Element):
    """-c v at a point whose velocity is v: a third."""

    point: Point = key("moving_point", "where it acts")
    c: float = key(
        "amount", "its factor", unit="N s/m", symbol="ca: drag of {}", linear="ca", name="drag"
    )

    points: ClassVar[dict[str, str]] = {"point": "c: point of {}"}
    ways: ClassVar[tuple[Way, ...]] = (Way("air", "load", "A drag.", ("point", "drag")),)

    @property
    def acts(self) -> str:
        return SPENT

    def rows(self, b) -> None:
        place = b.mechanism.tree.point(self.point)
        v = b.rate(b.point(place))
        b.force(PointForce(self, -self.c, v, (place, self.point.link)))
        if b.work:
            b.works(b.number(-self.c), b.inner(v, v))


class Seal(Element):
    """-f qd/sqrt(qd^2 + v0^2) at a joint: a friction that links name."""

    joint: int
    f: float = key("amount", "its most", unit=("N m", "N"), symbol="fs: seal at the joint of {}",
                   linear="fs")  # fmt: skip
    v0: float = key("positive", "its rate", unit=("rad/s", "m/s"), symbol="vs: rate at {}")

    ways: ClassVar[tuple[Way, ...]] = at_joints("seal", "friction", "A seal.", ("v0",))

    @property
    def acts(self) -> str:
        return SPENT

    @property
    def at(self) -> int:
        return self.joint

    def rows(self, b) -> None:
        v = b.v(self.joint)
        square = b.sum((1.0, b.product(v, v)), constant=b.number(self.v0 * self.v0))
        speed = b.named(Name("U", "rad/s", "smoothed rate of {}"), b.power_of(square, 0.5))
        b.torque(self.joint, b.number(-self.f), b.quotient(v, speed))


NEW = QuadraticDrag, Magnet, Drag, Seal


def numbers(rng, low, high, count=2):
    return rng.uniform(low, high, count).tolist()


def number(rng, low, high):
    return float(rng.uniform(low, high))


def point(rng, k):
    return {"link": NAMES[k], "at": numbers(rng, -0.4, 0.4)}


def point_springs(rng, scene):
    far = [2.0, number(rng, 1.0, 2.0)]
    stiff = {"stiffness": number(rng, 5, 20), "damping": number(rng, 0.1, 1)}
    scene["springs"] = [
        {"between": [point(rng, 2), far], "length": 0.4, **stiff},
        {"between": [point(rng, 1), far], "length": 0.3, "law": "9*x + 4*x^3"},
        {"between": [point(rng, 0), far], "length": 0.3, "law": "3*x + 0.5*v"},
        {"between": [point(rng, 0), point(rng, 2)], "length": 0.0, "stiffness": 3.0},
    ]


def joint_springs(rng, scene):
    free = number(rng, -1, 1)
    scene["springs"] = [
        {"joint": NAMES[0], "stiffness": number(rng, 1, 5), "angle": free},
        {"joint": NAMES[2], "angle": 0.2, "table": "", "law": "2*x + x^3"},
        {"joint": NAMES[2], "angle": 0.2, "law": "2*x + 0.3*v"},
        {"joint": NAMES[1], "angle": free, "stiffness": 0.0, "damping": 0.3},
    ]
    del scene["springs"][1]["table"]


def forces(rng, scene):
    scene["loads"] = [
        {**point(rng, 2), "force": numbers(rng, -3, 3)},
        {**point(rng, 1), "force": numbers(rng, -3, 3), "frame": "link"},
        {**point(rng, 0), "force": [1.5, "2*q2 + qd1"], "frame": "link"},
    ]


def moments(rng, scene):
    scene["loads"] = [
        {"link": NAMES[1], "torque": "1.5*q1 - 0.2*qd3"},
        {"link": NAMES[2], "torque": number(rng, -2, 2)},
    ]


def dampers(rng, scene):
    scene["links"][0]["damping"] = number(rng, 0.1, 1)
    scene["links"][1]["motor"] = {"ratio": 3.0, "inertia": 0.0, "damping": number(rng, 0.01, 0.1)}


def smooth_friction(rng, scene):
    scene["links"][1]["friction"] = {"torque": number(rng, 0.1, 0.5), "speed": 0.8}


def dry_friction(rng, scene):
    torque = number(rng, 0.1, 0.2)
    friction = {"torque": torque, "static": torque + 0.1, "stribeck": 0.5}
    scene["links"][1]["friction"] = friction


def pin_friction(rng, scene):
    friction = {"coefficient": number(rng, 0.05, 0.15), "radius": 0.01, "speed": 0.2}
    scene["links"][1]["friction"] = friction


def stops(rng, scene):
    ends = {"min": -0.1, "max": 0.15}
    scene["links"][1]["limits"] = {**ends, "stiffness": number(rng, 50, 90), "damping": 0.5}


def hard_stops(rng, scene):
    ends = {"min": -2.0, "max": 2.5}
    scene["links"][1]["limits"] = {**ends, "restitution": number(rng, 0.2, 0.8)}


def rotors(rng, scene):
    motor = {"ratio": number(rng, 5, 20), "inertia": number(rng, 0.001, 0.01)}
    scene["links"][2]["motor"] = motor


def gravity_fields(rng, scene):
    scene["gravity"] = [f"{number(rng, 1, 3)} + sin(2*t)", number(rng, -9, -5)]


def drags(rng, scene):
    scene["loads"] = [{"joint": NAMES[1], "c": number(rng, 0.3, 0.9)}]


def magnets(rng, scene):
    scene["springs"] = [{"joint": NAMES[2], "hold": number(rng, 0.3, 0.9)}]


def air(rng, scene):
    scene["loads"] = [{"point": point(rng, 2), "drag": number(rng, 0.3, 0.9)}]


def seals(rng, scene):
    scene["links"][1]["friction"] = {"f": number(rng, 0.3, 0.9), "v0": 0.4}


CASES = {
    PointSpring: point_springs,
    JointSpring: joint_springs,
    Force: forces,
    Moment: moments,
    JointDamper: dampers,
    SmoothFriction: smooth_friction,
    DryFriction: dry_friction,
    PinFriction: pin_friction,
    Slipping: dry_friction,
    Stops: stops,
    HardStop: hard_stops,
    CompliantStop: stops,
    Rotor: rotors,
    GravityField: gravity_fields,
    QuadraticDrag: drags,
    Magnet: magnets,
    Drag: air,
    Seal: seals,
}
# in which they act, where that is not the mode of a joint that is free
MODES = {
    DryFriction: Mode(slips=((1, 1),)),
    Slipping: Mode(slips=((1, -1),)),
    Stops: Mode(pressed=((1, 1),)),
    CompliantStop: Mode(pressed=((1, 1),)),
}

each_kind = pytest.mark.parametrize("kind", [*kinds.KINDS, *NEW], ids=lambda kind: kind.__name__)
# but of what follows from the forces in pins, which no rows of a program have
ROWED = [x for x in (*kinds.KINDS, *NEW) if x is not PinFriction]
with_rows = pytest.mark.parametrize("kind", ROWED, ids=lambda kind: kind.__name__)
seeds = pytest.mark.parametrize("seed", range(3))


@pytest.fixture(autouse=True)
def declared():
    """Scenes may have the new kinds."""
    grammar.declare((*grammar.OTHERS, *kinds.KINDS, *NEW))
    yield
    grammar.declare((*grammar.OTHERS, *kinds.KINDS))


def plain(seed):
    return from_text(seeded_tree(seed, LINKS).text, "plain.yaml")


def text_of(kind, seed):
    """A random tree with elements of a kind, as a file."""
    scene = plain_scene(plain(seed))
    for link, name in zip(scene["links"], NAMES, strict=True):
        assert link["name"] == name
    CASES[kind](np.random.default_rng(seed), scene)
    return yaml.safe_dump(scene, sort_keys=False)


def made(kind, seed):
    return build(from_text(text_of(kind, seed), "kind.yaml"))


def states(seed, rows=5):
    return np.random.default_rng(100 + seed).uniform(-1.0, 1.0, (3, rows, LINKS))


def test_every_kind_has_a_case():
    assert set(CASES) == {*kinds.KINDS, *NEW}


@each_kind
def test_its_case_has_it(kind):
    mechanism = made(kind, 0)
    if kind in MODES:
        mechanism = in_mode(mechanism, MODES[kind])
    if kind is DryFriction:  # which slips there
        kind = Slipping
    pressed = kind in (Stops, CompliantStop)
    assert mechanism.of(JointSpring if pressed else kind)


@each_kind
@seeds
def test_its_identities_hold(kind, seed):
    pressed = kind in (Stops, CompliantStop)  # one that is pressed is a spring
    mode = Mode() if pressed else MODES.get(kind, Mode())
    mechanism = in_mode(made(kind, seed), mode)
    found = identities(mechanism, sample_states(mechanism, 20))
    failed = [x for x in found if x.residual is not None and not x.residual <= BOUND]
    assert not failed, failed


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


@with_rows
@seeds
def test_both_integrators_agree(kind, seed):
    mechanism, (q, qd, _) = made(kind, seed), states(seed)
    taylor, other = (
        simulate(mechanism, q[0], qd[0], 0.5, method=method, rtol=1e-11, atol=1e-11)
        for method in ("taylor", "DOP853")
    )
    assert np.abs(taylor.q[-1] - other.q[-1]).max() < 1e-6
    assert np.abs(taylor.qd[-1] - other.qd[-1]).max() < 1e-6


@with_rows
@seeds
def test_torques_are_linear_in_its_parameters(kind, seed):
    mechanism, (q, qd, qdd) = made(kind, seed), states(seed)
    found = regressor(mechanism, q, qd, qdd)
    tau = inverse_dynamics(mechanism, q, qd, qdd)[:, list(mechanism.actuated)]
    assert np.allclose(found.Y @ found.values + found.known, tau, rtol=1e-11, atol=1e-11)
    elements = (x for _, x in mechanism.description.elements)
    letters = {y.linear for x in elements for _, y in x.linear()}
    assert letters <= {name.rstrip("0123456789") for name in found.names}


@with_rows
@seeds
def test_its_equations_in_python_are_its_rows(kind, seed):
    mechanism, written = made(kind, seed), module(made(kind, seed))["inverse_dynamics"]
    for q, qd, qdd in np.moveaxis(states(seed), 0, 1):
        tau, t = inverse_dynamics(mechanism, q, qd, qdd), [0.0] * mechanism.timed
        assert np.allclose(written(q, qd, qdd, *t), tau, rtol=1e-12, atol=1e-12)


@with_rows
@seeds
@pytest.mark.parametrize("numeric", [False, True])
def test_its_equations_to_read_are_its_rows(kind, seed, numeric):
    mechanism = made(kind, seed)
    content = json.loads(as_json(equations(mechanism, numeric)))
    for q, qd, qdd in np.moveaxis(states(seed), 0, 1):
        found = evaluated(content, q, qd)
        left = found["M"] @ qdd + (found["C"] + found["D"]) @ qd
        left += found["G"][:, 0] - found["Q"][:, 0]
        tau = inverse_dynamics(mechanism, q, qd, qdd)
        assert np.allclose(left, tau, rtol=1e-9, atol=1e-9)


def test_the_names_of_a_new_kind_are_told():
    content = json.loads(as_json(equations(made(QuadraticDrag, 0))))
    assert content["definitions"]["U1"] == "sqrt(qd2**2 + 0.0001)"
    assert content["symbols"]["cd1"]["meaning"] == "drag of load 1"
    told = text(equations(made(QuadraticDrag, 0)))
    assert re.search(r"U1 +rad/s +smoothed rate of load 1$", told, re.MULTILINE)


@each_kind
@seeds
def test_the_schema_accepts_it(kind, seed):
    errors = Draft202012Validator(scene_schema()).iter_errors(yaml.safe_load(text_of(kind, seed)))
    assert not list(errors)


@each_kind
def test_every_number_has_a_name(kind):
    """And the description changes with it."""
    text = text_of(kind, 0)
    values = SceneValues(text, "kind.yaml")
    for place, element in values.base.elements:
        slides = element.at is not None and values.base.links[element.at].slides
        for field, declared in element.keys.items():
            value = getattr(element, field, None)
            replaced = declared.instead and getattr(element, declared.instead)
            if not isinstance(value, float) or replaced or (declared.optional and not value):
                continue
            name = f"{place}.{declared.of(slides).name or field}"
            assert name in values, name
            assert values.number(name) == value
            changed = dict(values.replaced({name: 0.9 * value + 0.01}).elements)
            assert changed[place] == element._replace(**{field: 0.9 * value + 0.01})


@each_kind
def test_the_mapping_of_its_scene_reads_back(kind):
    text = text_of(kind, 0)
    scene = from_text(text, "kind.yaml")
    assert from_text(yaml.safe_dump(plain_scene(scene)), "kind.yaml") == scene


@each_kind
@pytest.mark.parametrize("write", [mjcf, urdf])
def test_an_export_writes_it_or_refuses_it_by_name(kind, write):
    mechanism = made(kind, 0)
    places = [place for place, _ in mechanism.description.elements] or ["links", "gravity"]
    try:
        model = write(mechanism)
    except InputError as refused:
        error = str(refused)
    else:
        error = ""
        assert model != write(build(plain(0)))
    heads = {place.partition("[")[0] for place in places}
    assert not error or any(error.startswith(f"kind.yaml: {head}") for head in heads), error
    assert error or kind not in NEW


def test_an_unknown_kind_is_refused_with_its_place():
    with pytest.raises(InputError, match=r"loads\[0\]: MJCF cannot say it"):
        mjcf(made(QuadraticDrag, 0))
    with pytest.raises(InputError, match=r"springs\[0\]: has a potential energy that --steps"):
        Derivation(equations(made(Magnet, 0)))


@seeds
def test_a_new_kind_is_in_the_torques(seed):
    bare, mechanism = build(plain(seed)), made(QuadraticDrag, seed)
    q, qd, qdd = states(seed)
    (drag,) = mechanism.of(QuadraticDrag)
    more = inverse_dynamics(mechanism, q, qd, qdd) - inverse_dynamics(bare, q, qd, qdd)
    expected = drag.c * qd[:, 1] ** 3 / np.sqrt(qd[:, 1] ** 2 + 1e-4)
    assert np.allclose(more, expected[:, None] * [0, 1, 0], atol=1e-11)
    tau = inverse_dynamics(mechanism, q, qd, qdd)[:, list(mechanism.actuated)]
    assert np.allclose(forward_dynamics(mechanism, q, qd, tau), qdd, atol=1e-9)
    assert mechanism.changes_energy
    assert mechanism.has_state_forces


@seeds
def test_joints_carry_the_force_of_a_new_kind(seed):
    """Those on the way to the ground, and those alone."""
    bare, mechanism = build(plain(seed)), made(Drag, seed)
    (drag,) = mechanism.of(Drag)
    above, loaded = mechanism.path(drag.point.link), np.zeros((5, LINKS, 2))
    q, qd, qdd = states(seed)
    place = mechanism.tree.point(drag.point)
    at = placed(mechanism, q)
    moving = at.rates(mechanism, absolute_rates(mechanism, qd)).X
    v = sum(c * moving[:, k] for k, c in place.terms)
    for k in above:
        loaded[:, k] = drag.c * np.stack([v.real, v.imag], axis=-1)
    none = np.zeros((5, 0))
    more = reactions(mechanism, q, qd, qdd, none) - reactions(bare, q, qd, qdd, none)
    assert np.allclose(more, loaded, atol=1e-11)


@seeds
def test_an_element_may_be_added_to_a_mechanism(seed):
    bare, (q, qd, qdd) = build(plain(seed)), states(seed)
    mechanism = bare.with_added(QuadraticDrag(1, 0.7))
    found = regressor(mechanism, q, qd, qdd)
    tau = inverse_dynamics(mechanism, q, qd, qdd)[:, list(mechanism.actuated)]
    assert np.allclose(found.Y @ found.values + found.known, tau, rtol=1e-11, atol=1e-11)


ROOT = Path(robodyn.__file__).parent
PICTURES = ("elements/", "pictures/")
CONTACTS = ("mechanics/modes.py", "dynamics/sticking.py", "runs/phases.py")


def imports(file):
    """The modules of robodyn that a file imports anywhere in it, each with the names it takes."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("robodyn"):
            yield node.module, [x.name for x in node.names]
        elif isinstance(node, ast.Import):
            yield from ((x.name, []) for x in node.names if x.name.startswith("robodyn."))


def test_what_elements_stand_on():
    """Nothing that reads them: imports inside of functions and for types count."""
    files = (ROOT / "elements").glob("*.py")
    found = {module.split(".")[1] for x in files for module, _ in imports(x)}
    assert found <= {"elements", "tables", "errors"}


@pytest.mark.parametrize("kind", kinds.KINDS, ids=lambda kind: kind.__name__)
def test_few_files_know_a_kind(kind):
    """Outside of elements, pictures and contacts: others ask properties."""
    known = {
        str(place)
        for file in ROOT.rglob("*.py")
        if not str(place := file.relative_to(ROOT)).startswith((*PICTURES, *CONTACTS))
        for module, names in imports(file)
        if kind.__name__ in names and module.split(".")[1] in ("elements", "scene")
    }
    assert len(known) <= 8, known
