"""Names that tools take, comments that are XML, and refusal of what is not said."""

from __future__ import annotations

import re
from collections import namedtuple
from xml.etree import ElementTree

import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from named_case import case

import robodyn
from model_readers import read_mjcf, read_urdf
from random_mechanisms import mechanism
from robodyn.errors import InputError
from robodyn.export.mjcf import mjcf
from robodyn.export.model_xml import RESERVED, Names, link_names, number, refuse_unsaid
from robodyn.export.urdf import urdf
from robodyn.mechanics.mechanism import build
from robodyn.scene.description import Description, Link

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
def test_numbers_read_back_exactly(value):
    assert float(number(value)) == value
    assert number(-0.0) == "0.0"


class LaterLink(namedtuple("LaterLink", (*Link._fields, "backlash"))):
    slides = Link.slides


LaterDescription = namedtuple("LaterDescription", (*Description._fields, "magnets"))


def later(magnets=(), backlash=0.0):
    """A description with keys that a later scene format may add."""
    arm = robodyn.load(ROOT / "robots/2r.yaml").description
    values = arm._asdict()
    first = arm.links[0]._asdict()
    values["links"] = (LaterLink(**first, backlash=backlash), *arm.links[1:])
    return LaterDescription(**values, magnets=magnets)


def test_keys_that_are_not_said_are_refused_where_they_hold_something():
    refuse_unsaid(later(), "XYZ", {})
    with pytest.raises(InputError, match=r"2r\.yaml: magnets: XYZ cannot say it"):
        refuse_unsaid(later(magnets=("one",)), "XYZ", {})
    with pytest.raises(InputError, match=r"magnets: for a reason"):
        refuse_unsaid(later(magnets=("one",)), "XYZ", {"magnets": "for a reason"})
    with pytest.raises(InputError, match=r"links\[0\] \(upper arm\)\.backlash = 0\.2: XYZ"):
        refuse_unsaid(later(backlash=0.2), "XYZ", {})
    refuse_unsaid(later(("one",), 0.2), "XYZ", {}, ["magnets", "backlash"])


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
