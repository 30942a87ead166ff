"""Scenes rewritten with other numbers keep everything else, letter by letter."""

from __future__ import annotations

from difflib import ndiff
from pathlib import Path

import pytest
from conftest import FRESH

from robodyn.errors import DescriptionError, InputError
from robodyn.scene.rewrite import rewritten, write_scene
from robodyn.scene.scene_values import SceneValues

SCENES = sorted(Path("robots").glob("*.yaml"))

BLOCK = """\
# an arm
name: arm   # its name
gravity: 9.81  # down

links:
  - name: upper
    m: 1.5      # kg
    l: 800e-3
    r: 0.36
    I: 0.082
    friction:
      torque: 0.5
      speed: 0.01

  # the second one
  - {name: "fore arm", m: 0.9, l: 0.6,
     r: [0.25, 0], I: 0.031  # from CAD
    }
"""


def changed(before: str, after: str) -> list[str]:
    lines = ndiff(before.splitlines(), after.splitlines())
    return [line for line in lines if line[0] in "+-"]


def test_numbers_change_in_place() -> None:
    text = rewritten(BLOCK, "arm.yaml", {"links.upper.m": 2, "links[1].I": 0.04, "gravity": 1.62})
    assert changed(BLOCK, text) == [
        "- gravity: 9.81  # down",
        "+ gravity: 1.62  # down",
        "-     m: 1.5      # kg",
        "+     m: 2.0      # kg",
        "-      r: [0.25, 0], I: 0.031  # from CAD",
        "+      r: [0.25, 0], I: 0.04  # from CAD",
    ]


def test_missing_numbers_are_added_to_their_mapping() -> None:
    values = {"links.upper.damping": 0.3, "links.fore arm.payload": 0.1, "links.upper.payload": 1.0}
    text = rewritten(BLOCK, "arm.yaml", values)
    assert changed(BLOCK, text) == [
        "+     payload: 1.0",
        "+     damping: 0.3",
        "-      r: [0.25, 0], I: 0.031  # from CAD",
        "+      r: [0.25, 0], I: 0.031, payload: 0.1  # from CAD",
    ]


def test_vectors_take_the_place_of_numbers() -> None:
    values = {"links.upper.r": [0.35, 0.01], "links.fore arm.r[1]": -0.02}
    text = rewritten(BLOCK, "arm.yaml", values)
    assert "    r: [0.35, 0.01]\n" in text
    assert "r: [0.25, -0.02]" in text


def test_gravity_is_added_before_lists() -> None:
    text = "links:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 0}\n"
    assert rewritten(text, "a.yaml", {"gravity": 1.0}) == "gravity: 1.0\n" + text


def test_line_ends_and_text_before_numbers_stay() -> None:
    text = BLOCK.replace("an arm", "é \U0001f9be").replace("\n", "\r\n")
    made = rewritten(text, "arm.yaml", {"links.upper.m": 2.0, "links.upper.damping": 0.1})
    assert made == text.replace("m: 1.5 ", "m: 2.0 ", 1).replace(
        "I: 0.082\r\n", "I: 0.082\r\n    damping: 0.1\r\n"
    )


def test_aliases_are_refused_by_name() -> None:
    text = BLOCK.replace("m: 1.5 ", "m: &m 1.5 ").replace("m: 0.9", "m: *m")
    for name in ("links.upper.m", "links.fore arm.m"):
        with pytest.raises(InputError, match=f"{name}: is written by an alias"):
            rewritten(text, "arm.yaml", {name: 1.0})
    assert rewritten(text, "arm.yaml", {"links.upper.I": 1.0}) == text.replace("0.082", "1.0")


def test_wrong_names_and_values_are_refused() -> None:
    with pytest.raises(InputError, match=r"links.uper.m: is no number .* links.upper.m"):
        rewritten(BLOCK, "arm.yaml", {"links.uper.m": 1.0})
    with pytest.raises(InputError, match="are one number"):
        rewritten(BLOCK, "arm.yaml", {"links.fore arm.r": 1.0, "links.fore arm.r[0]": 1.0})
    for value in (-1.0, float("nan")):
        with pytest.raises(DescriptionError, match=r"links\[0\] \(upper\)\.m"):
            rewritten(BLOCK, "arm.yaml", {"links.upper.m": value})


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_number_of_every_scene(path: Path) -> None:
    text = path.read_text()
    values = SceneValues(text, str(path))
    assert rewritten(text, str(path), {}) == text
    for name in values.names if FRESH else [*values.names][::3]:
        place = values.place(name)[1]
        if place is None or hasattr(place, "text"):
            new = values.number(name) * 1.0009765625 or 0.125
            made = rewritten(text, str(path), {name: new})
            assert SceneValues(made, str(path)).number(name) == new
            assert len(changed(text, made)) <= 2


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    source, out = tmp_path / "arm.yaml", tmp_path / "new.yaml"
    source.write_text(BLOCK)
    write_scene(source, {"links.upper.m": 2.0}, str(out))
    assert out.read_text() == BLOCK.replace("m: 1.5 ", "m: 2.0 ")


def test_a_scene_with_tables_stays_beside_them(tmp_path: Path) -> None:
    text = BLOCK + "loads:\n  - {link: upper, torque: {table: T.csv, over: t, column: T}}\n"
    (tmp_path / "T.csv").write_text("t,T\n0,1\n1,2\n")
    source, there = tmp_path / "arm.yaml", tmp_path / "there"
    source.write_text(text)
    there.mkdir()
    write_scene(source, {"links.upper.m": 2.0}, str(tmp_path / "new.yaml"))
    with pytest.raises(InputError, match=r"must be in the folder of .* names T.csv"):
        write_scene(source, {"links.upper.m": 2.0}, str(there / "new.yaml"))
