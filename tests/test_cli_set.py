"""`--set NAME=VALUE`: a scene with other numbers is the file with these written into it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome

from robodyn import InputError, inverse_dynamics_derivatives, load
from robodyn.cli import COMMANDS
from robodyn.cli.options import Model
from robodyn.mechanics.mechanism import build
from robodyn.scene.description import from_text
from robodyn.scene.scene_values import SceneValues

Run = Callable[..., Outcome]
BAR = ROOT / "robots/four-bar.yaml"
SET = ("--set", "links.coupler.m=1.45", "--set", "links.coupler.r=[0.4, 3e-2]")
SET += ("--set", "gravity=[0.5, -9]", "--set", "links.crank.damping=0.25")


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """The four-bar with the numbers of SET in its file."""
    text = BAR.read_text(encoding="utf-8")
    for old, new in (
        ("m: 1.3,", "m: 1.45,"),
        ("r: 0.45,", "r: [0.4, 0.03],"),
        ("gravity: 9.81", "gravity: [0.5, -9]"),
        ("{name: crank,", "{name: crank, damping: 0.25,"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = tmp_path / "four-bar.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_command_with_a_model_has_it() -> None:
    for name in COMMANDS:
        function = getattr(import_module(f"robodyn.cli.{name}"), name)
        model = inspect.signature(function, eval_str=True).parameters.get("model")
        takes = model is not None and model.default is inspect.Parameter.empty
        assert takes == (name not in ("plot", "summary", "init", "schema", "guide"))
        assert not takes or (model is not None and model.annotation is Model)


@pytest.mark.parametrize(
    "line",
    [
        "torque --q 60deg --qd 5",
        "accel --q 60deg --qd 5 --tau 1",
        "reactions --q 60deg --qd 5 --force coupler=1,2",
        "points --q 60deg --of centre2",
        "energy --q 60deg --qd 2",
        "terms --q 60deg",
        "assemble --q 60deg",
        "equilibrium",
        "linearize --q 60deg --tau 3 --format json",
        "equations",
        "export --format mjcf --q 60deg",
        "simulate --q 60deg --time 0.3 --quiet --sensitivity links.coupler.m,links.coupler.r[1]",
        "sweep --kind torque --vary links.coupler.l=0.9,0.95 --q 1 --quiet",
        "trajectory --from 60deg --to 90deg --time min --max-tau 30 --points 3",
    ],
)
def test_it_is_as_written(robodyn: Run, line: str, written: Path) -> None:
    command, *options = line.split()
    given = robodyn(command, str(BAR), *SET, *options)
    wanted = robodyn(command, str(written), *options)
    out = [x.out.replace(str(BAR), "").replace(str(written), "") for x in (given, wanted)]
    assert (given.code, out[0]) == (wanted.code, out[1])
    assert len(wanted.out) > 20
    assert robodyn(command, str(BAR), *options).out != wanted.out


def test_values_are_written_as_in_scenes(robodyn: Run, scene: Callable[[str], Path]) -> None:
    links = "links: [{name: rod, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
    path = scene(links + "springs: [{joint: rod, stiffness: 3, angle: 0}]\n")
    for value, plain in (("30deg", "pi/6"), ("-pi/6", "-30deg")):
        rows = [
            robodyn("torque", path, "--q", "1", "--set", f"springs[0].angle={x}").succeeds().out
            for x in (value, plain, "0")
        ]
        assert rows[0] == rows[1] != rows[2]


def test_a_sweep_goes_on_with_the_same_numbers_alone(robodyn: Run, tmp_path: Path) -> None:
    out = str(tmp_path / "rows.csv")
    line = ("sweep", str(BAR), "--kind", "torque", "--vary", "q1=0:1:3", "--quiet")
    plain = robodyn(*line).succeeds().out
    robodyn(*line, *SET, "-o", out).succeeds()
    heavy = Path(out).read_text()
    assert heavy != plain
    assert robodyn(*line, *SET, "--workers", 2).succeeds().out == heavy


def test_numbers_by_name_need_no_file(tmp_path: Path) -> None:
    """They are the mechanism's own: of a text, or of a file that is gone since."""
    path = tmp_path / "arm.yaml"
    text = (ROOT / "robots/2r.yaml").read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    gone = load(path)
    path.unlink()
    values = SceneValues(text.replace("m: 0.9", "m: 1.7"), "no file")
    changed = build(values.replaced({"links.forearm.m": 0.9}))
    again = build(SceneValues(changed.description.written, "x").replaced({"links.forearm.l": 0.6}))
    state, names = ([0.3, 0.5], [1.0, 2.0], [0.1, 0.2]), ["links.forearm.m", "gravity"]
    known = inverse_dynamics_derivatives(load(ROOT / "robots/2r.yaml"), *state, numbers=names)
    for arm in (gone, build(from_text(text, "no file")), changed, again):
        found = inverse_dynamics_derivatives(arm, *state, numbers=names)
        assert np.array_equal(found.by_numbers, known.by_numbers)


def test_numbers_by_name_are_refused_where_the_scene_has_changed() -> None:
    arm = load(ROOT / "robots/2r.yaml")
    other = build(arm.description._replace(gravity=-3j))
    with pytest.raises(InputError, match="has more than its file"):
        inverse_dynamics_derivatives(other, [0, 0], [0, 0], [0, 0], numbers=["links.forearm.m"])


# `--force`: as the scene with the same loads, bit for bit.


Scene = Callable[[str], Path]

OPTIONS = ("coupler@0.5,-0.2=10,-5", "rocker=-3,4", "tip2=1e-3,7", "P=0.1,0.2", "P=1,1")
LOADS = """
points: {P: {link: coupler, at: [0.3, 0.1]}}
"""
ADDED = """
loads:
  - {point: {link: coupler, at: [0.5, -0.2]}, force: [10, -5]}
  - {point: rocker, force: [-3, 4]}
  - {point: coupler, force: [1.0e-3, 7]}
  - {point: {link: coupler, at: [0.3, 0.1]}, force: [0.1, 0.2]}
  - {point: {link: coupler, at: [0.3, 0.1]}, force: [1, 1]}
"""
STATES = "t,q1,qd1,qdd1\n" + "".join(f"{k / 10},{k / 3},{5 - k},{k / 7}\n" for k in range(9))


def flags(texts: Sequence[str] = OPTIONS) -> list[str]:
    return [word for text in texts for word in ("--force", text)]


@pytest.mark.parametrize(
    "command",
    [
        *("torque --q 1 --qd 5", "accel --q 1 --qd 5 --tau 2", "reactions --q 1 --qd 5"),
        *("energy --q 1 --qd 5", "torque -", "accel -", "reactions -", "energy -"),
        "simulate --q 1 --qd 5 --time 0.3",
        "simulate --q 1 --qd 5 --time 0.3 --method taylor",
        "simulate --q 1 --time 0.2 --method taylor",
    ],
)
def test_is_a_load_of_the_scene(
    robodyn: Run, scene: Scene, four_bar_text: str, command: str
) -> None:
    name, *rest = command.split()
    plain = scene(four_bar_text + LOADS)
    given = robodyn(name, plain, *rest, *flags(), stdin=STATES)
    without = robodyn(name, plain, *rest, stdin=STATES)
    loaded = robodyn(name, scene(four_bar_text + LOADS + ADDED), *rest, stdin=STATES)
    assert given.code == loaded.code == 0
    assert given.out == loaded.out != without.out


def test_beside_the_loads_of_the_scene(robodyn: Run, scene: Scene) -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    own = 'loads:\n  - {point: forearm, force: ["3*q1", 2], frame: link}\n'
    state = ("--q", "0.4,0.3", "--qd", "1,2")
    given = robodyn("torque", scene(text + own), *state, "--force", "joint2=4,5").succeeds().out
    both = scene(text + own + "  - {point: {link: forearm, at: [0, 0]}, force: [4, 5]}\n")
    assert given == robodyn("torque", both, *state).succeeds().out


def test_on_a_link_that_slides(robodyn: Run) -> None:
    """A force on the yoke along its way is what its guide's force is less."""
    yoke = ("torque", "robots/rp-arm.yaml", "--q", "0,0.2")
    tau = robodyn(*yoke).succeeds().row["tau2"]
    pulled = robodyn(*yoke, "--force", "tip2=7,0").succeeds().row["tau2"]
    assert pulled == pytest.approx(tau - 7, abs=1e-12)
