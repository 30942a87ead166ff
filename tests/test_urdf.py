"""URDF read back: the same M and G by a reader of its own; what it cannot say is refused."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from named_case import case

import robodyn
from model_readers import read_mjcf, read_urdf
from random_mechanisms import (
    LOOPS,
    assert_close,
    mechanism,
    seeded_scene,
    seeded_tree,
    trees,
)
from robodyn.errors import InputError
from robodyn.export.mjcf import mjcf
from robodyn.export.model_xml import RESERVED, Names, link_names, number, refuse_unsaid
from robodyn.export.urdf import urdf, urdf_notes
from robodyn.mechanics.mechanism import build
from robodyn.scene.description import Description, Link

ARMS = ("pendulum", "2r", "3r")
examples = settings(deadline=None, max_examples=40)


def assert_same_terms(mech, q):
    """M and G of the file, its joints found by their names."""
    model = read_urdf(urdf(mech))
    names = [name.replace(" ", "_") for name in mech.link_names]
    assert sorted(model.joints) == sorted(names)
    there = [model.joints.index(name) for name in names]
    gravity = np.array([mech.gamma.real, mech.gamma.imag, 0.0])
    M, G = model.terms(dict(zip(names, q, strict=True)), gravity)
    inertia = np.abs(mech.arrays.A).sum()
    weight = abs(mech.gamma) * np.abs(mech.arrays.B).sum()
    assert_close(M[np.ix_(there, there)], robodyn.mass_matrix(mech, q), inertia, 1e-14)
    assert_close(G[there], robodyn.gravity_vector(mech, q), weight, 1e-14)
    return model


@examples
@given(trees(most=7))
def test_trees_keep_M_and_G(scene):
    assert_same_terms(scene.mechanism, scene.q)


@pytest.mark.parametrize("name", ARMS)
def test_the_arms_of_robots_keep_M_and_G(name):
    mech = robodyn.load(ROOT / f"robots/{name}.yaml")
    for q in np.random.default_rng(1).uniform(-4, 4, (5, mech.n)):
        assert_same_terms(mech, q)


def test_links_that_stand_before_the_one_they_hang_from():
    mech = mechanism(
        "gravity: [1.5, -9]\n"
        "links:\n"
        "  - {name: hand, m: 0.4, l: 0.2, r: [0.1, -0.03], I: 0.002, from: arm, payload: 0.3}\n"
        "  - {name: arm, m: 1.1, l: 0.7, r: 0.3, I: 0.05, from: [0.2, 0.4]}\n"
    )
    assert_same_terms(mech, np.array([0.7, -1.9]))


SLIDES = """
gravity: [1.5, -9]
links:
  - {name: a, joint: prismatic, axis: [1, 0.5], m: 0.8, l: 0.1, r: [0.03, 0.1], I: 0.002,
     from: [0, 0.1], damping: 3}
  - {name: b, m: 0.3, l: 0.4, r: [0.1, 0.02], I: 0.0005, damping: 0.01}
  - {name: c, joint: prismatic, axis: [0, -1], m: 1.5, l: 0.5, r: 0.25, I: 0.03,
     from: {link: b, at: [0.1, 0.2]}, payload: 0.3}
  - {name: d, joint: prismatic, axis: [1, 1], m: 0.7, l: 0.2, r: 0.25, I: 0.02}
  - {name: e, m: 0.3, l: 0.2, r: [0.1, 0.02], I: 0.0005}
couplings: ["q3 = 0.2 q2 + 0.1"]
"""


def test_prismatic_joints():
    mech = mechanism(SLIDES)
    for q in np.random.default_rng(1).uniform(-0.5, 0.5, (5, mech.n)):
        model = assert_same_terms(mech, q)
    slides = {body.joint: body for body in model.bodies if body.slides}
    assert slides.keys() == {"a", "c", "d"}
    assert all(body.axis.tolist() == [1, 0, 0] for body in slides.values())
    assert slides["a"].damping == 3.0
    assert model.sums == [({"c": 1.0, "b": -0.2}, 0.1)]
    assert "no limit" not in urdf(robodyn.load(ROOT / "robots/2r.yaml"))
    assert_same_terms(robodyn.load(ROOT / "robots/rp-arm.yaml"), np.array([0.7, 0.3]))


@pytest.mark.parametrize("seed", range(5))
def test_joints_are_unlimited_and_turn_about_z(seed):
    model = read_urdf(urdf(seeded_tree(seed, 5).mechanism))
    for body in model.bodies:
        assert body.joint is None or body.axis.tolist() == [0, 0, 1]
        assert body.place[2] == body.centre[2] == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_damping_and_payload(seed):
    description = seeded_tree(seed, 5).mechanism.description
    model = read_urdf(urdf(seeded_tree(seed, 5).mechanism))
    damping = {body.joint: body.damping for body in model.bodies if body.joint}
    assert damping == {link.name: link.damping for link in description.links}
    payloads = {body.parent: body for body in model.bodies if body.joint is None}
    carrying = {f"{link.name}_link": link for link in description.links if link.payload}
    assert payloads.keys() == carrying.keys()
    for name, body in payloads.items():
        assert (body.mass, body.place.tolist()) == (
            carrying[name].payload,
            [carrying[name].l, 0, 0],
        )
        assert not body.inertia.any()


@pytest.mark.parametrize("seed", range(3))
def test_inertias_are_those_of_bodies(seed):
    """Principal moments >= 0, each at most the sum of the other two."""
    for body in read_urdf(urdf(seeded_tree(seed, 4).mechanism)).bodies:
        least, middle, most = np.linalg.eigvalsh(body.inertia)
        assert 0.0 <= least <= middle <= most <= least + middle


def test_a_link_without_mass_has_no_inertial():
    text = "gravity: 9.81\nlinks:\n  - {name: rod, m: 0, l: 0.5, r: 0.2, I: 0, payload: 2}\n"
    rod = mechanism(text)
    assert urdf(rod).count("<inertial>") == 1  # the payload's
    assert_same_terms(rod, np.array([0.3]))


def test_numbers_read_back_exactly():
    mech = mechanism(
        "links:\n"
        "  - {name: a, m: 0.1, l: 0.30000000000000004, r: [1e-20, -0.0], I: 1e300,"
        " from: [0.1, 3e-7], payload: 1}\n"
    )
    text = urdf(mech)
    rod, payload = read_urdf(text).bodies
    assert rod.centre.tolist() == [1e-20, 0, 0]
    assert rod.place.tolist() == [0.1, 3e-7, 0]
    assert (rod.mass, rod.inertia[2, 2], payload.place[0]) == (0.1, 1e300, 0.30000000000000004)
    assert "-0.0" not in text


@pytest.mark.parametrize("name", LOOPS)
def test_loops_are_refused(name):
    with pytest.raises(InputError, match=r"closures.*trees") as caught:
        urdf(seeded_scene(0, LOOPS[name]).mechanism)
    assert caught.value.exit_code == 2


def test_a_coupled_joint_mimics_another():
    arm = (ROOT / "robots/3r.yaml").read_text()
    mech = mechanism(arm + 'couplings: ["q2 = -0.3 q1 + 0.1", "q3 = q1"]\n')
    model = assert_same_terms(mech, np.array([0.1, 0.2, 0.3]))
    assert model.sums == [
        ({"forearm": 1.0, "upper_arm": 0.3}, 0.1),
        ({"hand": 1.0, "upper_arm": -1.0}, 0.0),
    ]


@pytest.mark.parametrize(
    ("couplings", "place"),
    [
        ("q2 = 30deg", r"couplings\[0\]"),
        ("q3 = q1 - q2", r"couplings\[0\]"),
        ('["q2 = -q1", "q3 = q2"]', r"couplings\[1\]"),
    ],
)
def test_other_couplings_are_refused(couplings, place):
    arm = (ROOT / "robots/3r.yaml").read_text()
    with pytest.raises(InputError, match=f"{place}: .*mimic"):
        urdf(mechanism(f"{arm}couplings: {couplings}\n"))


@pytest.mark.parametrize(
    ("key", "entry"),
    [
        ("springs", "{joint: a, stiffness: 5, angle: 0.4}"),
        ("springs", "{between: [a, [1, 1]], stiffness: 5, length: 0.4}"),
        ("loads", "{link: a, torque: 1.5}"),
    ],
)
def test_springs_and_loads_are_refused(key, entry):
    mech = mechanism(f"links: [{{name: a, m: 1, l: 1, r: 0.5, I: 0.1}}]\n{key}: [{entry}]\n")
    with pytest.raises(InputError, match=f"{key}: URDF has no {key}; MJCF has") as caught:
        urdf(mech)
    assert caught.value.exit_code == 2


def test_rotors_are_refused():
    """A gear alone is none, and the rotor's damping is that of its joint."""
    arm = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1, motor: {ratio: 5, inertia: %s}}]"
    with pytest.raises(InputError, match=r"links\[0\] \(a\)\.motor: URDF has no inertia of rotors"):
        urdf(mechanism(arm % "1e-4"))
    assert 'damping="0.5"' in urdf(mechanism(arm % "0, damping: 0.02"))


def test_the_comment_tells_what_urdf_cannot():
    mech = robodyn.load(ROOT / "robots/2r.yaml")
    text = urdf(mech)
    comment = text[text.index("<!--") : text.index("-->")]
    for part in (
        "planar 2R arm",
        "X-Y",
        "Gravity is 0.0 -9.81 0.0",
        "q1  upper_arm (link upper",
        "guide",
    ):
        assert part in comment
    assert comment.count("driven") == 2


ENDS = """
gravity: 9.81
links:
  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1, limits: {min: -30deg, max: 1.2},
     friction: {torque: 0.5, static: 0.8}}
  - {name: b, m: 1, l: 1, r: 0.5, I: 0.1, limits: {min: -1, stiffness: 5},
     motor: {ratio: -50, inertia: 0, torque_max: 0.3, speed_max: 500}}
  - {name: c, m: 1, l: 1, r: 0.5, I: 0.1, motor: {ratio: 2, inertia: 0, torque_max: 0.5}}
  - {name: d, joint: prismatic, axis: [1, 0], m: 1, l: 1, r: 0.5, I: 0.1,
     limits: {max: 0.5, restitution: 0.4}, friction: {force: 0.2, static: 0.2}}
"""


def test_ends_of_joints_what_motors_give_and_dry_friction():
    mech = mechanism(ENDS)
    bodies = {
        body.joint: body for body in assert_same_terms(mech, np.array([0.3, 1, 2, 0.4])).bodies
    }
    assert bodies["a"].range == (-np.pi / 6, 1.2)
    assert bodies["b"].range == (-1.0, 1e9)
    assert bodies["c"].range is None
    assert bodies["d"].range == (-1e9, 0.5)
    assert [bodies[name].friction for name in "abcd"] == [0.5, 0.0, 0.0, 0.2]
    found = ElementTree.fromstring(urdf(mech)).findall("joint/limit")
    most = [(float(x.get("effort")), float(x.get("velocity"))) for x in found]
    assert most == [(1e9, 1e9), (15.0, 10.0), (1.0, 1e9), (1e9, 1e9)]
    told = list(urdf_notes(mech))
    assert [note.split(":")[0] for note in told] == ["joint a", "joint a", "joint b", "joint d"]
    assert "at rest too, not 0.8" in told[1]


# Names that tools take, comments that are XML, and refusal of what is not said.


FORMATS = pytest.mark.parametrize("write", [urdf, mjcf])


def named(*names):
    """An arm with links of these names."""
    arm = robodyn.load(ROOT / "robots/3r.yaml").description
    link = arm.links[0]
    links = (link._replace(name=name) for name in names)
    return build(arm._replace(name=names[0], links=tuple(links)))


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["upper arm", "forearm"], ["upper_arm", "forearm"]),
        (["a b", "a_b", "a-b"], ["a_b_2", "a_b", "a_b_3"]),
        (["Kurbel Ø 5", "bielle n° 2", "manivelle à main"], None),
        (["1st", "2nd"], ["link_1st", "link_2nd"]),
        (["连杆", "--", "<&>"], ["link1", "link2", "link3"]),
        (["world", "universe", "root_joint"], ["world_2", "universe_2", "root_joint_2"]),
        (["class", "_x", "x_"], ["class", "_x", "x_"]),
        (["a.b", "a/b"], ["a_b", "a_b_2"]),
    ],
)
def test_names_of_links(names, expected):
    found = link_names(named(*names), Names())
    if expected is not None:
        assert found == expected
    assert len(set(found)) == len(found)
    assert all(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name) for name in found)


@given(st.lists(st.text(min_size=1), min_size=1, max_size=6, unique=True))
def test_any_names_make_models_that_can_be_read(names):
    mech = named(*names)
    for model in (read_urdf(urdf(mech)), read_mjcf(mjcf(mech))):
        assert len(model.joints) == mech.n
        every = [*model.joints, *(body.name for body in model.bodies)]
        assert all(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name) for name in every)
        assert not RESERVED & set(every)


def test_names_of_urdf_all_differ():
    """Joints and links too: some readers put both into one table."""
    arm = named("a", "a_link", "a_link_link", "ground", "a_payload")
    links = tuple(link._replace(payload=0.5) for link in arm.description.links)
    model = read_urdf(urdf(build(arm.description._replace(links=links))))
    root = ElementTree.fromstring(urdf(build(arm.description._replace(links=links))))
    names = [element.get("name") for element in root if element.tag in ("link", "joint")]
    assert len(names) == 1 + 2 * 2 * arm.n
    assert len(set(names)) == len(names)
    assert set(model.joints) == {"a", "a_link", "a_link_link", "ground", "a_payload"}


A_COMMENT_HOLDS_ANY_NAME = [
    "--",
    "---",
    "a--b----c-",
    "-->",
    "<!--",
    "]]>",
    "&amp;",
    "\x00\x1b\ud800",
    "a\nb",
    "-",
]


@FORMATS
def test_a_comment_holds_any_name(write):
    for name in A_COMMENT_HOLDS_ANY_NAME:
        with case(name):
            text = write(named(name))
            root = ElementTree.fromstring(text)
            assert "--" not in text.split("<!--", 1)[1].split("-->", 1)[0]
            assert text.count("<!--") == text.count("-->") == 1
            assert len(root) > 1


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_read_back_exactly_model_xml(value):
    assert float(number(value)) == value
    assert number(-0.0) == "0.0"


class LaterLink(Link):
    backlash: float = 0.0


class LaterDescription(Description):
    magnets: tuple = ()


def later(magnets=(), backlash=0.0):
    """A description with keys that a later scene format may add."""
    arm = robodyn.load(ROOT / "robots/2r.yaml").description
    values = arm._asdict()
    first = arm.links[0]._asdict()
    values["links"] = (LaterLink(**first, backlash=backlash), *arm.links[1:])
    return LaterDescription(**values, magnets=magnets)


def test_keys_that_are_not_said_are_refused_where_they_hold_something():
    refuse_unsaid(build(later()), "XYZ", {})
    with pytest.raises(InputError, match=r"2r\.yaml: magnets: XYZ cannot say it"):
        refuse_unsaid(build(later(magnets=("one",))), "XYZ", {})
    with pytest.raises(InputError, match=r"magnets: for a reason"):
        refuse_unsaid(build(later(magnets=("one",))), "XYZ", {"magnets": "for a reason"})
    with pytest.raises(InputError, match=r"links\[0\] \(upper arm\)\.backlash = 0\.2: XYZ"):
        refuse_unsaid(build(later(backlash=0.2)), "XYZ", {})
    refuse_unsaid(build(later(("one",), 0.2)), "XYZ", {}, ["magnets", "backlash"])


@FORMATS
def test_the_writers_refuse_what_they_do_not_know(write):
    write(build(later()))
    for scene, key in ((later(magnets=("one",)), "magnets"), (later(backlash=0.2), "backlash")):
        with pytest.raises(InputError, match=f"{key}.*cannot say it"):
            write(build(scene))


@FORMATS
def test_friction_by_speed_is_refused(write):
    text = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1, friction: {torque: %s, speed: 0.1}}]"
    write(mechanism(text % 0))
    with pytest.raises(InputError, match=r"links\[0\] \(a\)\.friction: .*tanh"):
        write(mechanism(text % 0.5))
