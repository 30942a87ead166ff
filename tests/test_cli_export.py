"""`robodyn export`: the files, their place, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, Outcome
from each_case import each
from unwritten import MASSLESS

import oracles
from model_readers import read_mjcf, read_urdf
from robodyn.elements.joints import SmoothFriction
from robodyn.export.mjcf import mjcf
from robodyn.export.urdf import urdf
from robodyn.loops.assembly import first_pose
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.scene import signals_of

Run = Callable[..., Outcome]
SCENES = sorted(path.stem for path in (ROOT / "robots").glob("*.yaml"))
GRAVITY = "Note: URDF has no gravity: set (0.0, -9.81, 0.0) m/s^2 where it is loaded\n"


def rubbing(mechanism: Mechanism) -> str:
    """The place of the friction that no format has; empty where there is none."""
    for x in (*mechanism.of(SmoothFriction), *mechanism.rubbing):
        if x.joint is not None:
            return f"links[{x.joint}] ({mechanism.link_names[x.joint]}).friction"
    return ""


@each("name", SCENES)
def test_mjcf_of_every_scene(robodyn: Run, name: str) -> None:
    given = robodyn("export", f"robots/{name}.yaml", "--format", "mjcf")
    if name in MASSLESS:
        given.fails(2, f"robots/{name}.yaml: links[0]", "has no mass m, which export needs")
        return
    if place := rubbing(load(f"robots/{name}.yaml")):
        given.fails(2, f"robots/{name}.yaml: {place}", "MuJoCo")
        return
    mechanism = load(f"robots/{name}.yaml")
    if mechanism.laws:
        given.fails(2, f"robots/{name}.yaml: couplings[0]", "linear in joints, no laws")
        return
    if any(place.startswith("loads") for place, _ in signals_of(mechanism.description)):
        given.fails(2, f"robots/{name}.yaml: loads[0]", "MJCF has constant loads alone")
        return
    if mechanism.description.field is not None:
        given.fails(2, f"robots/{name}.yaml: gravity[1]", "MJCF has constant gravity alone")
        return
    model = read_mjcf(given.out)
    if not mechanism.rows:
        assert (given.code, given.err, model.keys) == (0, "", {})
        assert given.out == mjcf(mechanism)
        return
    begin = first_pose(mechanism, t=0.0)
    told = ", ".join(f"{x:.6g}" for x in begin)
    notes = f"Note: without --q it begins at q = {told}\n"
    if mechanism.description.points:
        notes += "Note: MJCF has no named points: the scene's `points` are left out\n"
    assert (given.code, given.err) == (0, notes)
    assert given.out == mjcf(mechanism, q=begin.tolist())
    assert list(model.keys["start"]) == list(model.begin)


@each("name", SCENES)
def test_urdf_of_every_open_scene(robodyn: Run, name: str) -> None:
    given = robodyn("export", f"robots/{name}.yaml", "--format", "urdf")
    if name in MASSLESS:
        given.fails(2, f"robots/{name}.yaml: links[0]", "has no mass m, which export needs")
        return
    mechanism = load(f"robots/{name}.yaml")
    found = mechanism.description
    refused = [key for key in ("closures", "springs", "loads") if getattr(found, key)]
    if refused:
        given.fails(2, f"robots/{name}.yaml: {refused[0]}: URDF", "MJCF")
        assert given.out == ""
    elif place := rubbing(mechanism):
        given.fails(2, f"robots/{name}.yaml: {place}", "URDF")
    elif mechanism.laws:
        given.fails(2, f"robots/{name}.yaml: couplings[0]", "no laws")
    else:
        assert (given.code, given.err) == (0, GRAVITY)
        assert given.out == urdf(mechanism)
        assert read_urdf(given.out).name == mechanism.name


def test_a_horizontal_scene_has_no_gravity_to_set(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    path = scene("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n")
    robodyn("export", path, "--format", "urdf").succeeds()


def test_the_keyframe_is_a_closed_configuration(robodyn: Run) -> None:
    arguments = ("export", "robots/four-bar.yaml", "--format", "mjcf", "--q")
    expected = oracles.four_bar_position(FOUR_BAR, np.pi / 3)
    given = robodyn(*arguments, "60deg").succeeds()
    key = read_mjcf(given.out).keys["start"]
    assert list(key) == ["crank", "coupler", "rocker"]
    assert np.allclose(list(key.values()), expected, rtol=0, atol=1e-14)
    whole = ",".join(repr(float(angle)) for angle in expected)
    key = read_mjcf(robodyn(*arguments, whole).succeeds().out).keys["start"]
    assert list(key.values()) == list(expected)


def test_the_time_step(robodyn: Run) -> None:
    arguments = ("export", "robots/four-bar.yaml", "--format", "mjcf", "--q", "60deg")
    assert 'timestep="0.001"' in robodyn(*arguments).succeeds().out
    given = robodyn(*arguments, "--timestep", "2e-4").succeeds()
    assert 'timestep="0.0002"' in given.out
    assert 'solref="0.0004 1"' in given.out


@pytest.mark.parametrize("format", ["urdf", "mjcf"])
def test_out(robodyn: Run, tmp_path: Path, format: str) -> None:
    file = tmp_path / "model.xml"
    arguments = ("export", "robots/2r.yaml", "--format", format)
    given = robodyn(*arguments, "--out", file)
    assert (given.code, given.out) == (0, "")
    assert file.read_text() == robodyn(*arguments).out


def test_notes_on_ends_of_joints(robodyn: Run, scene: Callable[[str], Path]) -> None:
    path = scene(
        "gravity: 0\nlinks: [{name: a, m: 1.5, l: 1, r: 1, I: 0.1, limits: {max: 1},"
        " friction: {torque: 1, static: 2}}]\n"
    )
    given = robodyn("export", path, "--format", "mjcf")
    assert given.code == 0
    assert given.err == (
        "Note: joint a: MuJoCo stops it at its limits, where robodyn ends a run\n"
        "Note: joint a: MuJoCo's friction is 1 N m at rest too, not 2, and what sticks creeps\n"
    )
    given = robodyn("export", path, "--format", "urdf")
    assert (given.code, given.err.count("Note: joint a: URDF")) == (0, 2)


def test_a_loop_that_cannot_close_is_refused(
    robodyn: Run, four_bar_text: str, scene: Callable[[str], Path]
) -> None:
    path = scene(four_bar_text.replace("[1.1, 0.0]", "[9.0, 0.0]"))
    for more in ("--q", "60deg"), ():
        given = robodyn("export", path, "--format", "mjcf", *more).fails(1, "cannot be closed")
        assert given.out == ""


def test_the_help_has_examples_that_work(quick_shell: Run, tmp_path: Path) -> None:
    text = quick_shell("robodyn export --help").succeeds().out
    lines = [line.strip() for line in text.splitlines() if line.strip().startswith("robodyn ")]
    assert len(lines) == 3
    (tmp_path / "robots").symlink_to(ROOT / "robots")
    for line in lines:
        assert quick_shell(line, cwd=tmp_path).code == 0
    assert read_urdf((tmp_path / "2r.urdf").read_text()).joints == ["upper_arm", "forearm"]
    assert read_mjcf((tmp_path / "four-bar.xml").read_text()).keys
    assert load(tmp_path / "lengths.yaml").n == 7


def test_a_reader_that_leaves_ends_it_quietly(shell: Run) -> None:
    given = shell("robodyn export robots/four-bar.yaml --format mjcf --q 1 | head -1").succeeds()
    assert given.out == '<?xml version="1.0" encoding="utf-8"?>\n'


@each("format", ["urdf", "mjcf"])
def test_named_points_are_left_out_with_a_note(robodyn: Run, tmp_path: Path, format: str) -> None:
    """Points act on nothing: the model is the one of the scene without them."""
    link = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
    path = tmp_path / "arm.yaml"
    path.write_text(link)
    bare = robodyn("export", path, "--format", format).out
    path.write_text(link + 'points: {P: "a@0.2,0.1"}\n')
    given = robodyn("export", path, "--format", format)
    assert (given.code, given.out) == (0, bare)
    assert "the scene's `points` are left out" in given.err
