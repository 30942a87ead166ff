"""Numbers of a scene by name: replaced, against the same file written by hand."""

import time

import pytest
from conftest import ROOT
from unwritten import MASSLESS

from robodyn.errors import DescriptionError, InputError
from robodyn.scene.description import from_text
from robodyn.scene.scene_values import SceneValues, read_numbers

TEXT = """
gravity: 9.81
links:
  - {name: upper arm, m: 1.5, l: 0.8, r: 0.36, I: 0.082}
  - {name: fore, m: 0.9, l: 0.6, r: [0.25, 0.1], I: 0.031, damping: 0.2}
  - {name: side, m: 0.4, l: 0.3, r: 0.1, I: 0.01, from: {link: upper arm, at: [0.4, 0.1]}}
springs:
  - {joint: fore, stiffness: 5, angle: 30deg}
loads:
  - {link: side, at: [0.3, 0], force: [1, 2]}
"""


def scene() -> SceneValues:
    return SceneValues(TEXT, "x")


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("gravity", "gravity: 9.81", "gravity: 2.5"),
        ("links.upper arm.m", "m: 1.5", "m: 2.5"),
        ("links[0].m", "m: 1.5", "m: 2.5"),
        ("links.upper arm.l", "l: 0.8", "l: 2.5"),  # what hangs from the tip goes with it
        ("links.fore.r", "r: [0.25, 0.1]", "r: 2.5"),
        ("links.fore.r[1]", "r: [0.25, 0.1]", "r: [0.25, 2.5]"),
        ("links.upper arm.payload", "I: 0.082", "I: 0.082, payload: 2.5"),
        ("links.fore.damping", "damping: 0.2", "damping: 2.5"),
        ("links.side.from.at[0]", "at: [0.4, 0.1]", "at: [2.5, 0.1]"),
        ("springs[0].angle", "angle: 30deg", "angle: 2.5"),
        ("springs[0].damping", "angle: 30deg", "angle: 30deg, damping: 2.5"),
        ("loads[0].force[1]", "force: [1, 2]", "force: [1, 2.5]"),
    ],
)
def test_replaced_is_as_written(name: str, old: str, new: str) -> None:
    assert old in TEXT
    assert scene().replaced({name: 2.5}) == from_text(TEXT.replace(old, new), "x")


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("links.fore.r", "r: [0.25, 0.1]", "r: [0.3, 0.2]"),
        ("links.side.from.at", "at: [0.4, 0.1]", "at: [0.3, 0.2]"),
        ("loads[0].at", "at: [0.3, 0]", "at: [0.3, 0.2]"),
        ("loads[0].force", "force: [1, 2]", "force: [0.3, 0.2]"),
    ],
)
def test_a_pair_is_replaced_as_a_whole(name: str, old: str, new: str) -> None:
    assert old in TEXT
    given = ((name, "[0.3, 0.2]"),)
    assert read_numbers(TEXT, "x", given).base == from_text(TEXT.replace(old, new), "x")


def test_a_pair_is_no_number() -> None:
    """What varies is one of its numbers."""
    assert "loads[0].force" not in scene()
    assert "loads[0].force" not in scene().names
    with pytest.raises(InputError, match=r"is a pair, \[x, y\]: name one .* loads\[0\].force\[0\]"):
        scene().check(["loads[0].force"])


def test_the_tip_moves_with_the_length() -> None:
    replaced = scene().replaced({"links.upper arm.l": 1.25})
    assert replaced.links[1].hangs_from.at == 1.25


def test_values_are_replaced_again_and_again() -> None:
    values = scene()
    for mass in (0.1, 7.0, 1.5):
        assert values.replaced({"links.upper arm.m": mass}).links[0].m == mass
    assert values.replaced({"links.upper arm.m": 1.5}) == values.base


def test_names_are_listed() -> None:
    names = scene().names
    assert {"gravity", "links.fore.I", "links.side.payload", "springs[0].stiffness"} <= set(names)
    assert "links.fore.name" not in names
    assert all(name in scene() for name in names)


def test_aliases_stand_for_numbers_of_their_own() -> None:
    text = "gravity: 9.81\nlinks:\n  - &a {name: a, m: &m 1, l: 1, r: 0.5, I: 0.1}\n"
    text += "  - {name: b, m: *m, l: 1, r: 0.5, I: 0.1}\n"
    links = SceneValues(text, "x").replaced({"links.b.m": 3.0}).links
    assert [link.m for link in links] == [1.0, 3.0]


def test_an_unknown_name_and_an_impossible_value_are_refused() -> None:
    with pytest.raises(InputError, match="wing"):
        scene().replaced({"links.wing.m": 1.0})
    with pytest.raises(DescriptionError, match="must be >= 0"):
        scene().replaced({"links.fore.m": -1.0})


def test_two_names_of_one_number_clash() -> None:
    assert scene().clash(["links.fore.m", "gravity", "links.fore.l"]) is None
    assert scene().clash(["links.fore.m", "links[1].m"]) == ("links.fore.m", "links[1].m")
    assert scene().clash(["links.fore.r", "links.fore.r[0]"]) is not None


def test_units() -> None:
    path = ROOT / "robots" / "spring-slider-crank.yaml"
    values = SceneValues(path.read_text(), path.name)
    assert values.unit("links.crank.I") == "kg m²"
    assert values.unit("gravity") == "m/s²"
    assert values.unit("springs[0].stiffness") == "N/m"
    assert values.unit("closures[0].on.through[1]") == "m"
    assert values.number("springs[0].stiffness") > 0.0


@pytest.mark.parametrize("path", sorted((ROOT / "robots").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_number_of_the_scenes_can_be_set(path) -> None:
    values = SceneValues(path.read_text(), str(path))
    assert len(values.names) >= (3 if path.stem in MASSLESS else 6) * len(values.base.links)
    for name in values.names:
        changed = SceneValues(path.read_text(), str(path)).replaced({name: 0.4375})
        # the direction of a line or of an axis has no length
        assert changed != values.base or "along" in name or "axis" in name


def test_a_long_chain_is_named_in_one_pass() -> None:
    """Work that grows with the square of 4,000 links took 12 s."""
    links = "".join(f"  - {{name: a{k}, m: 1, l: 1, r: 0, I: 0}}\n" for k in range(4000))
    begun = time.process_time()
    values = SceneValues("links:\n" + links, "x")
    assert time.process_time() - begun < 6.0
    assert "links.a3999.payload" in values


def test_what_was_replaced_is_put_back() -> None:
    values = scene()
    values.replaced({"links.upper arm.l": 1.25, "gravity": 3.0})
    assert values.replaced({}) == values.base
    with pytest.raises(InputError, match="must be"):
        values.replaced({"links.fore.m": -1.0})
    assert values.replaced({}) == values.base
