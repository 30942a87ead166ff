"""Constants of a scene: the same as numbers in their places, by name, with units, in every law."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import Outcome
from named_case import case
from test_scene_schema import obeys

import robodyn
from random_mechanisms import LOOPS, forced, seeded_scene
from robodyn import load, simulate
from robodyn.dynamics.named_numbers import named_values
from robodyn.engines import machine
from robodyn.errors import DescriptionError, InputError
from robodyn.export.mjcf import mjcf
from robodyn.export.urdf import urdf
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text
from robodyn.scene.plain_scene import plain_scene
from robodyn.scene.rewrite import rewritten
from robodyn.scene.scene_values import SceneValues
from robodyn.sweeps import lanes
from robodyn.sweeps.lanes import Aims, Motions

Run = Callable[..., Outcome]
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d*)?(?:e-?\d+)?(?![\w.])")
SCENE = """\
name: cam
constants:
  A: 20 mm
  w: 30 rad/s
  len: 10 A
  half: 0.5
  n: 3
  T0: 2 N m
  phase: 40 deg
gravity: 9.81
links:
  - {name: arm, m: 2 half kg, l: len, r: len/2, I: 0.01, damping: half/10}
  - {name: rod, joint: prismatic, axis: [1, 0], m: 0.3, l: A, r: 0, I: 0.001, from: [half, A]}
springs:
  - {joint: arm, law: "T0 sin(x) cos(phase) + half x^n", angle: half}
loads:
  - {link: arm, torque: "T0 cos(w t + phase) sqrt(half + q1^2)"}
couplings: ["q2 = A (1 - cos(n q1)) + A exp(-half)"]
"""
PLAIN = """\
name: cam
gravity: 9.81
links:
  - {name: arm, m: 1, l: 0.2, r: 0.1, I: 0.01, damping: 0.05}
  - {name: rod, joint: prismatic, axis: [1, 0], m: 0.3, l: 0.02, r: 0, I: 0.001, from: [0.5, 0.02]}
springs:
  - {joint: arm, law: "2 sin(x) cos(40 deg) + 0.5 x^3", angle: 0.5}
loads:
  - {link: arm, torque: "2 cos(30 t + 40 deg) sqrt(0.5 + q1^2)"}
couplings: ["q2 = 0.02*(1 - cos(3 q1)) + 0.02 exp(-0.5)"]
"""
BLOCK = """\
constants: {F: 3 N, w: 40 rad/s, mass: 2 kg}
links: [{name: block, joint: prismatic, axis: [1, 0], m: mass, l: 0, r: 0, I: 1}]
loads: [{link: block, at: [0, 0], force: ["F sin(w t)", 0]}]
"""


def scene(text: str) -> Mechanism:
    return build(from_text(text, "my.yaml"))


def faults(text: str) -> list[str]:
    with pytest.raises(DescriptionError) as caught:
        from_text(text, "my.yaml")
    return [f"{fault.place}: {fault.limit}" for fault in caught.value.faults]


def with_constants(line: str) -> str:
    return f"constants: {line}\n{PLAIN}"


# What they are


def test_numbers_by_names_are_the_numbers() -> None:
    """Every number of random scenes, springs and loads by a constant: not a bit differs."""
    for seed in range(8):
        loop = seeded_scene(seed, list(LOOPS.values())[seed % len(LOOPS)])
        text = forced(seed, loop).text
        constants: dict[str, str] = {}

        def named(match: re.Match[str], into: dict[str, str] = constants) -> str:
            into[f"c{len(into)}"] = match[0]
            return f"c{len(into) - 1}"

        changed = NUMBER.sub(named, text)
        whole = f"constants: {json.dumps(constants).replace(chr(34), '')}\n{changed}"
        with case(seed):
            assert len(constants) > 30
            one, other = from_text(text, "my.yaml"), from_text(whole, "my.yaml")
            assert other._replace(constants=()) == one
            assert obeys(whole)


def test_laws_with_constants_are_those_with_numbers() -> None:
    plain, named = scene(PLAIN), scene(SCENE)
    rng = np.random.default_rng(0)
    q1, qd1, qdd1 = rng.uniform(-1, 1, (3, 5, 1))
    t = rng.uniform(0, 1, 5)
    q = robodyn.assemble(named, q1)
    qd = robodyn.loop_velocities(named, q, qd1)
    qdd = robodyn.loop_accelerations(named, q, qd, qdd1)
    each = [robodyn.inverse_dynamics(x, q, qd, qdd, t=t) for x in (plain, named)]
    assert np.array_equal(each[0], each[1])


def test_constants_in_any_order_of_one_another() -> None:
    line = "{c: 2 b, b: a + 5 mm, a: 1 cm, T: 2 pi/w, w: 60 rpm, ratio: a/b}"
    found = dict(from_text(with_constants(line), "my.yaml").constants)
    values = {name: (x.value, x.unit) for name, x in found.items()}
    assert list(values) == ["c", "b", "a", "T", "w", "ratio"]
    assert values["c"] == (0.03, "m")
    assert values["w"] == (2 * math.pi, "rad/s")
    assert values["T"][0] == 1.0
    assert values["ratio"] == (0.01 / 0.015, "1")


def test_a_constant_named_as_a_unit_is_never_that_unit() -> None:
    text = PLAIN.replace("2 sin(x)", "2 A sin(x)").replace("2 cos(30 t", "A (4/3) cos(30 t")
    found = scene(f"constants: {{A: 1.5}}\n{text}")
    plain = scene(PLAIN.replace("2 sin(x)", "3 sin(x)"))
    q = robodyn.assemble(plain, [0.3])
    tau = [robodyn.inverse_dynamics(x, q, 0 * q, 0 * q) for x in (found, plain)]
    assert tau[0] == pytest.approx(tau[1], rel=1e-15)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("q1", "is a variable"),
        ("qd12", "is a variable"),
        ("t", "is a variable"),
        ("x", "is a variable"),
        ("v", "is a variable"),
        ("pi", "is a constant of the language"),
        ("e", "is a constant of the language"),
        ("sin", "is a function"),
        ("m", "is a unit"),
        ("N", "is a unit"),
        ("deg", "is a unit"),
        ("if", "is a word"),
        ("lambda", "is a word"),
        ("None", "is a word"),
        ("nan", "is a word"),
        ("2a", "must be a letter, then"),
        ("a-b", "must be a letter, then"),
    ],
)
def test_names_that_are_taken(name: str, why: str) -> None:
    (found,) = faults(with_constants(f"{{{name}: 1}}"))
    assert found.startswith(f"constants.{name}: {why}")


def test_faults() -> None:
    assert faults(with_constants("3")) == [
        "constants: must map names to numbers, {A: 20 mm, w: 300 rad/s}"
    ]
    assert faults(with_constants("{a: 2 b, b: c/2, c: a}")) == [
        "constants.a: is made of itself: a -> b -> c -> a"
    ]
    assert faults(with_constants("{a: a}")) == ["constants.a: is made of itself: a -> a"]
    assert faults(with_constants("{a: 1, a: 2}")) == ["constants.a: is given twice"]
    assert faults(with_constants("{a: [1, 2]}")) == ["constants.a: must be a number"]
    assert "b is no unit or function" in faults(with_constants("{a: 2 b}"))[0]
    assert faults(with_constants("{a: q1}"))[0].startswith("constants.a: must be a number")
    assert faults(with_constants("{a: 1/0}"))[0].startswith("constants.a: must be a number")
    (found,) = faults(with_constants("{long: 1 m}").replace("m: 1,", "m: long,"))
    assert found == "links[0] (arm).m: must be in kg, not in m"
    (found,) = faults(SCENE.replace("T0 cos(w t + phase) sqrt(half + q1^2)", "A cos(w t)"))
    assert found.startswith("loads[0].torque: must be in N m, not in m")
    (found,) = faults(SCENE.replace("w t + phase", "w t + A"))
    assert "a sum of" in found
    (found,) = faults(SCENE.replace("I: 0.001", "I: -0.001 half"))
    assert "must be >= 0" in found
    (found,) = faults(SCENE.replace("q2 = A", "q2 = lne"))
    assert "did you mean len?" in found


# As numbers of the scene


def test_they_are_numbers_of_the_scene() -> None:
    mechanism = scene(SCENE)
    values = named_values(mechanism)
    assert {"constants.A", "constants.w", "constants.len"} <= {*values.names}
    assert (values.number("constants.len"), values.unit("constants.len")) == (0.2, "m")
    assert (values.number("links.arm.l"), values.number("links.arm.r")) == (0.2, 0.1)
    other = values.replaced({"constants.A": 0.03, "constants.w": 50.0})
    assert (other.links[0].l, other.links[1].l, other.links[0].r) == (0.3, 0.03, 0.15)
    assert dict(other.constants)["w"].text == "50.0 rad/s"
    alone = values.replaced({"constants.len": 0.5})
    assert (alone.links[0].l, alone.links[1].l) == (0.5, 0.02)


def test_derivatives_by_constants_are_those_of_differences() -> None:
    """In numbers, springs and loads; in functions, exponents and products."""
    mechanism = scene(SCENE.partition("couplings")[0])
    values = named_values(mechanism)
    rng = np.random.default_rng(1)
    state = rng.uniform(0.6, 1, (3, 4, 2))
    t = rng.uniform(0, 1, 4)
    for name in (f"constants.{x}" for x in ("A", "w", "half", "T0", "phase")):
        now, h = values.number(name), 1e-4 * values.number(name)
        found = robodyn.inverse_dynamics_derivatives(mechanism, *state, t=t, numbers=[name])
        ends = [build(values.replaced({name: now + sign * h})) for sign in (1, -1)]
        tau = [robodyn.inverse_dynamics(x, *state, t=t) for x in ends]
        slope = (tau[0] - tau[1]) / (2 * h)
        with case(name):
            assert abs(slope).max() > 1e-3
            assert np.abs(found.by_numbers[..., 0] - slope).max() < 1e-5 * abs(slope).max()
    for name, old, new in (("n", "A", "A"), ("half", "l: len", "l: half^2")):
        other = scene(SCENE.partition("couplings")[0].replace(old, new))
        with pytest.raises(InputError, match="no derivative is known by it"):
            robodyn.inverse_dynamics_derivatives(other, *state, numbers=[f"constants.{name}"])


def test_sensitivity_of_an_exact_motion() -> None:
    """A mass under F sin(w t): x = F/(m w) (t - sin(w t)/w)."""
    mechanism = scene(BLOCK)
    t, F, w, m = 0.7, 3.0, 40.0, 2.0
    times = [0.0, t]
    found = robodyn.simulate(mechanism, [0.0], [0.0], t, rtol=1e-12, atol=1e-12, t_eval=times)
    assert found.q[-1, 0] == pytest.approx(F / (m * w) * (t - math.sin(w * t) / w), rel=1e-10)
    names = ["constants.F", "constants.w", "constants.mass"]
    slopes = robodyn.simulate(mechanism, [0.0], [0.0], t, t_eval=times, sensitivity=names)
    s, c = math.sin(w * t), math.cos(w * t)
    by_w = F / m * (-t / w**2 + 2 * s / w**3 - t * c / w**2)
    x = F / (m * w) * (t - s / w)
    assert slopes.sensitivity[-1, 0] == pytest.approx([x / F, by_w, -x / m], rel=1e-6)


def test_fit_finds_constants_of_a_motion() -> None:
    mechanism = scene(BLOCK)
    times = np.linspace(0.0, 0.4, 41)
    run = robodyn.simulate(mechanism, [0.0], [0.0], 0.4, t_eval=times)
    wrong = build(named_values(mechanism).replaced({"constants.w": 36.0, "constants.F": 2.0}))
    vary = {"constants.w": (30.0, 50.0), "constants.F": (1.0, 5.0)}
    found = robodyn.fit_motion(wrong, vary, ["q1"], times, target=run.q, q=[0.0])
    assert found.numbers["constants.w"] == pytest.approx(40.0, rel=1e-6)
    assert found.numbers["constants.F"] == pytest.approx(3.0, rel=1e-6)


def test_fit_by_formulas() -> None:
    """Of torques at states, exactly: the law of a spring and of a coupling."""
    mechanism = scene(SCENE.replace("loads:", "_:").partition("_:")[0] + SCENE.splitlines()[-1])
    q = robodyn.assemble(mechanism, np.linspace(0.6, 1.4, 9)[:, None])
    target = robodyn.inverse_dynamics(mechanism, q, 0 * q, 0 * q)[:, :1]
    path = q[:, 1:]
    changed = {"constants.T0": 1.5, "constants.phase": 0.5}  # the torque has their product
    wrong = build(named_values(mechanism).replaced(changed))
    vary = {"constants.T0": (1.0, 4.0)}
    found = robodyn.fit(wrong, vary, ["tau1"], q[:, :1], target=target)
    cosines = math.cos(math.radians(40.0)) / math.cos(0.5)
    assert found.numbers["constants.T0"] == pytest.approx(2.0 * cosines, rel=1e-9)
    wrong = build(named_values(mechanism).replaced({"constants.n": 2.7}))
    vary = {"constants.n": (2.5, 3.5)}
    found = robodyn.fit(wrong, vary, ["q2"], q[:, :1], target=path)
    assert found.numbers["constants.n"] == pytest.approx(3.0, rel=1e-9)


@pytest.mark.skipif(not machine.available(), reason="needs llvmlite")
def test_one_code_serves_every_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sweep by a number within a law compiles once: the number is an argument."""
    text = SCENE.replace("loads:", "_:").partition("_:")[0] + SCENE.splitlines()[-1]
    values = named_values(scene(text))
    made: list[str] = []

    def counted(key: str, *rest: Any, real: Any = lanes._made) -> Any:
        made.append("")
        return real(key, *rest)

    monkeypatch.setattr(lanes, "_made", counted)
    members = []
    for T0, A, n in ((2.0, 0.02, 3.0), (2.5, 0.03, 3.0), (1.7, 0.011, 3.0)):
        numbers = {"constants.T0": T0, "constants.A": A, "constants.n": n}
        one = build(values.replaced(numbers))
        q = robodyn.assemble(one, [[0.7]])
        y = np.hstack([q, np.zeros((1, 2))])
        members.append(Motions(one, y, np.zeros((1, 2)), np.zeros(1)))
    before = len(made)
    found = lanes.integrate(members, 0.2, Aims(1e-10, 1e-10), [True, False])
    assert len(made) - before <= 1
    for member, ends in zip(members, found, strict=True):
        assert ends is not None
        run = robodyn.simulate(member.mechanism, member.y[0, :2], np.zeros(2), 0.2, rtol=1e-11)
        assert ends.y[0, :2] == pytest.approx(run.q[-1], rel=1e-7)


# In files and equations


def test_explicit_form_keeps_them() -> None:
    one = from_text(SCENE, "my.yaml")
    written = plain_scene(one)
    assert written["constants"]["A"] == "20 mm"
    assert written["constants"]["half"] == 0.5
    assert written["links"][0]["l"] == 0.2
    again = from_text(json.dumps(written), "my.yaml")
    assert again == one


def test_rewriting_keeps_units_and_what_is_made_of_them() -> None:
    text = rewritten(SCENE, "my.yaml", {"constants.A": 0.025, "constants.half": 0.75})
    assert "A: 0.025 m\n" in text
    assert "half: 0.75\n" in text
    assert "l: len," in text
    values = SceneValues(text, "my.yaml")
    assert values.number("links.arm.l") == 0.25


def test_set_and_sweep(tmp_path: Path, robodyn: Run) -> None:
    path = tmp_path / "block.yaml"
    path.write_text(BLOCK)
    by_set = robodyn(
        "simulate", str(path), "--q", "0", "--time", "0.5", "--points", "2", "--set",
        "constants.w=3000 deg/s", "--quiet",
    )  # fmt: skip
    w = math.radians(3000.0)
    x = 3.0 / (2.0 * w) * (0.5 - math.sin(0.5 * w) / w)
    assert float(by_set.out.splitlines()[-1].split(",")[1]) == pytest.approx(x, rel=1e-8)
    swept = robodyn(
        "sweep", str(path), "--q", "0", "--time", "0.5", "--quiet",
        "--vary", "constants.w=2000deg/s,3000deg/s",
    )  # fmt: skip
    assert swept.out.splitlines()[0].startswith("constants.w,")
    assert float(swept.out.splitlines()[-1].split(",")[0]) == pytest.approx(w)
    wrong = robodyn("check", str(path), "--set", "constants.w=2 m")
    assert wrong.code == 2
    unknown = robodyn("check", str(path), "--set", "constants.u=2")
    assert unknown.code == 2
    assert "constants.u" in unknown.err


def test_equations_tell_them(tmp_path: Path, robodyn: Run) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(SCENE)
    run = robodyn("equations", str(path))
    assert run.code == 0, run.err
    text = run.out
    assert "T1 = T0c cos(w t + phase) sqrt(half + q1²)" in text
    assert "h1 = A (1 - cos(n q1)) + A exp(-half)" in text
    assert re.search(r"h1_1 = (A n|n A) sin\(n q1\)", text)
    for line in (
        r"A +0.02 +m +constant A",
        r"w +30 +rad/s +constant w",
        r"T0c +2 +N m +constant T0",
    ):
        assert re.search(line, text)
    assert "constant len" not in text  # it is in l1
    code = robodyn("equations", str(path), "--format", "python").out
    module = ModuleType("written")
    exec(code, module.__dict__)
    mechanism = scene(SCENE)
    q = robodyn_assemble(mechanism)
    tau = module.joint_torques(q, [0.4, 0.1], [0.3, -0.2], 0.6)
    for name, value in (("T0c", 2.7), ("A", 0.03), ("phase", 0.1)):
        module.__dict__[name] = value
    assert tau != module.joint_torques(q, [0.4, 0.1], [0.3, -0.2], 0.6)


def robodyn_assemble(mechanism: Mechanism) -> list[float]:
    found: list[float] = robodyn.assemble(mechanism, [[0.7]])[0].tolist()
    return found


def test_the_schema_takes_them() -> None:
    assert obeys(SCENE)
    assert obeys(BLOCK)
    assert not obeys(SCENE.replace("constants:", "konstants:"))
    assert not obeys(SCENE.replace("  A: 20 mm", "  2A: 20 mm"))
    assert not obeys(SCENE.replace("I: 0.01,", "I: -0.01,"))
    assert not obeys(PLAIN.replace("l: 0.2", "l: len"))
    assert yaml.safe_load(SCENE)["constants"]["A"] == "20 mm"


def test_models_of_other_tools_have_their_values() -> None:
    text = SCENE.partition("springs:")[0]
    plain = PLAIN.partition("springs:")[0]
    for export in (urdf, mjcf):
        one, other = (
            re.sub("<!--.*?-->", "", export(scene(x)), flags=re.DOTALL) for x in (text, plain)
        )
        assert one == other


def test_numbers_of_laws_are_decimal_in_the_steps_too(tmp_path: Path, robodyn: Run) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(PLAIN.replace("2 cos(30 t + 40 deg) sqrt(0.5 + q1^2)", "9.81 cos(0.3 t)"))
    for form in ("text", "latex"):
        steps = robodyn("equations", str(path), "--steps", "--format", form)
        assert steps.code == 0, steps.err
        assert "9.81" in steps.out
        assert "562949953421312" not in steps.out


ON_THE_LINE = """\
constants: {level: 0.3 rad, w: 4 rad/s, T: 2 N m, half: w/2, b: 0.15 m, gap: 0.2}
links: [{name: bar, m: 1, l: 0.5, r: 0.2, I: 0.05}]
points: {P: "bar@b,2*b"}
"""


def test_options_know_constants(robodyn: Run, tmp_path: Path) -> None:
    """Runs, events and points are those of the numbers that the constants are."""
    file = tmp_path / "line.yaml"
    file.write_text(ON_THE_LINE, encoding="utf-8")
    run = ["simulate", file, "--q", "0", "--time", "1", "--points", "3", "--quiet"]
    for named, plain in (
        (["--tau", "T sin(w t)"], ["--tau", "2 sin(4 t)"]),
        (["--tau", "T", "--until", "q1 > level"], ["--tau", "2", "--until", "q1 > 0.3"]),
        (["--tau", "T", "--until", "q1 > gap"], ["--tau", "2", "--until", "q1 > 0.2"]),
        (["--tau", "2", "--until", "tau1 q1 > T q1/2 + 0.1 J"],
         ["--tau", "2", "--until", "tau1 q1 > 2*q1/2 + 0.1"]),
    ):  # fmt: skip
        one, other = (robodyn(*run, *x).succeeds() for x in (named, plain))
        assert one.out == other.out
    found = robodyn("points", file, "--q", "0", "--of", "bar@b,-b", "--of", "P").succeeds().rows[0]
    assert [float(found[x]) for x in ("point1_x", "point1_y", "P_x", "P_y")] == [
        0.15, -0.15, 0.15, 0.3,
    ]  # fmt: skip
    given = robodyn("torque", file, "--q", "0", "--force", "bar@b,0=0,-20").succeeds()
    assert given.column("tau1") == [pytest.approx(3.0)]
    swept = ["--vary", "constants.level=0.1,0.2", "--result", "events", "--event", "x=q1-level"]
    rows = robodyn(
        "sweep", file, "--q", "0", "--qd", "1", "--time", "1", "--quiet", *swept
    ).succeeds()
    assert rows.column("x_first") == [pytest.approx(0.1), pytest.approx(0.2)]
    told = robodyn(*run, "--until", "q1 > T")
    told.fails(2, "--until: an event does not allow a comparison of rad and N m")


def test_what_an_option_says_does_not_vary(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "line.yaml"
    file.write_text(ON_THE_LINE, encoding="utf-8")
    run = ["simulate", file, "--q", "0", "--time", "1", "--quiet"]
    for words in (["--tau", "T sin(half t)"], ["--until", "q1 > w*1 s"], ["--event", "x=qd1 - w"]):
        told = robodyn(*run, *words, "--sensitivity", "links.bar.m,constants.w")
        told.fails(2, f"{words[0]} = ", "constants.w varies")
    robodyn(*run, "--tau", "T", "--sensitivity", "constants.w").succeeds()
    with pytest.raises(InputError, match=r"has half, and constants\.w varies"):
        simulate(load(file), [0], [0], 1.0, "T sin(half t)", sensitivity=["constants.w"])
