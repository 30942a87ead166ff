"""The derivation of the equations: line by line as in the lecture, and against sympy's."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from conftest import Outcome
from derivation_oracle import Oracle, evaluated, wrong
from sliding_scenes import SLIDING_SCENES, TURNED
from unwritten import TIMED, UNWRITTEN, WITH_LAWS

from random_mechanisms import (
    LOOPS,
    forced,
    mechanism,
    motored,
    seeded_scene,
    seeded_tree,
    sliding,
)
from robodyn.equations.derivation import Carried, Derivation, Offset, Turned
from robodyn.equations.derivation_latex import derivation_latex
from robodyn.equations.derivation_text import derivation_json, derivation_text
from robodyn.equations.notation import PYTHON
from robodyn.equations.quadratic_forms import difference_of_squares, factored, forms_of
from robodyn.equations.symbolic import Atom, Role, of
from robodyn.equations.text import text
from robodyn.equations.written import equations
from robodyn.mechanics.mechanism import Mechanism, load

Run = Callable[..., Outcome]
ROBOTS = Path(__file__).resolve().parent.parent / "robots"
NAMES = sorted({path.stem for path in ROBOTS.glob("*.yaml")} - UNWRITTEN - WITH_LAWS - TIMED)
COMPILER = shutil.which("pdflatex") or shutil.which("lualatex") or shutil.which("tectonic")
LAWS = """\
gravity: 9.81
links:
  - {name: slide, joint: prismatic, axis: [1, 0], m: 2, l: 0.1, r: 0.02, I: 0.01,
     friction: {force: 0.4, static: 0.6, stribeck: 0.1}}
  - {name: arm, m: 1, l: 0.6, r: [0.3, 0.05], I: 0.03, damping: 0.1,
     limits: {min: -0.5, max: 0.6, stiffness: 80, damping: 2}}
springs:
  - {joint: arm, angle: 0.1, law: "3*x + 2*x^3"}
  - {between: [arm, [0.4, 0.9]], law: "60*x + 4*v", length: 0.2}
  - {joint: slide, stiffness: 30, length: 0.1}
loads:
  - {link: arm, torque: "0.5*sin(3*t)"}
  - {link: arm, at: [0.2, 0], force: ["q1 + t", 2], frame: link}
  - {link: slide, at: [0.1, 0], force: [1, 2], frame: link}
  - {link: arm, at: [0.3, 0.1], force: [0, "2*t"]}
"""


def steps_of(mech: Mechanism) -> dict[str, list]:
    """What is right of each name in the JSON."""
    content = json.loads(derivation_json(Derivation(equations(mech))))
    lines = [x for step in content["steps"] for x in step["lines"] if "left" in x]
    return {line["left"]: line["right"] for line in lines}


# -- against the lecture ---------------------------------------------------------------------------


def same(found: str, written: str) -> bool:
    """Whether two formulas are one; theta and phi of the slides stand for q."""
    return sp.simplify(sp.expand_trig(sp.sympify(found) - sp.sympify(written))) == 0


KE_2R = """m1*r1**2*qd1**2/2 + I1*qd1**2/2 + m2/2*(l1**2*qd1**2 + r2**2*(qd1 + qd2)**2
    + 2*l1*r2*qd1*(qd1 + qd2)*cos(q2)) + I2*(qd1 + qd2)**2/2"""  # (24), with l1^2 for its r2^2
PE_2R = "m1*g*r1*sin(q1) + m2*g*(l1*sin(q1) + r2*sin(q1 + q2))"  # (25)
M_2R = (
    "(m1*r1**2 + I1 + m2*(l1**2 + r2**2 + 2*l1*r2*cos(q2)) + I2)",
    "(m2*(r2**2 + l1*r2*cos(q2)) + I2)",
    "(m2*r2**2 + I2)",
)
TAU_2R = (  # (27), with r2 in G2
    f"{M_2R[0]}*qdd1 + {M_2R[1]}*qdd2 - 2*m2*l1*r2*sin(q2)*qd1*qd2 - m2*l1*r2*sin(q2)*qd2**2"
    " + (m1*r1 + m2*l1)*g*cos(q1) + m2*g*r2*cos(q1 + q2)",
    f"{M_2R[1]}*qdd1 + {M_2R[2]}*qdd2 + m2*l1*r2*sin(q2)*qd1**2 + m2*g*r2*cos(q1 + q2)",
)


def test_the_2r_arm_is_the_lectures() -> None:
    found = steps_of(load(ROBOTS / "2r.yaml"))
    assert same(found["KE"][-1], KE_2R)
    assert same(found["PE"][-1], PE_2R)
    assert same(found["L"][-1], f"{KE_2R} - ({PE_2R})")  # (26)
    q = sp.symbols("q1 q2 qd1 qd2 qdd1 qdd2")
    L = sp.sympify(f"{KE_2R} - ({PE_2R})")
    for i in (1, 2):
        slope, p = sp.diff(L, f"q{i}"), sp.diff(L, f"qd{i}")
        assert same(found[f"dL/dq{i}"][0], str(slope))
        assert same(found[f"dL/dqd{i}"][0], str(p))
        rate = sum(sp.diff(p, a) * b for a, b in zip(q[:4], q[2:], strict=True))
        assert same(found[f"d/dt dL/dqd{i}"][0], str(rate))
        assert same(found[f"tau{i}"][0], TAU_2R[i - 1])
    assert same(found["centripetal (C qd)1"][0], "-m2*l1*r2*qd2**2*sin(q2)")
    assert same(found["Coriolis (C qd)1"][0], "-2*m2*l1*r2*qd1*qd2*sin(q2)")
    assert same(found["centripetal (C qd)2"][0], "m2*l1*r2*qd1**2*sin(q2)")
    assert "Coriolis (C qd)2" not in found
    velocity = ["l1*qd1*sin(q2)", "l1*qd1*cos(q2) + r2*(qd1 + qd2)"]
    assert all(same(*pair) for pair in zip(found["vC2"][-1], velocity, strict=True))


def test_the_four_bar_is_the_lectures() -> None:
    found = steps_of(load(ROBOTS / "four-bar.yaml"))
    own = "m3*r3**2*qd3**2/2 + I3*qd3**2/2"  # with the square of its rate
    assert same(found["KE"][-1], f"{KE_2R} + {own}")  # (28)
    assert same(found["PE"][-1], f"{PE_2R} + m3*g*r3*sin(q3)")  # (29)
    assert same(found["L"][-1], f"{KE_2R} + {own} - ({PE_2R} + m3*g*r3*sin(q3))")  # (30)
    assert same(found["tau1"][0], TAU_2R[0])  # (32)
    assert same(found["tau2"][0], TAU_2R[1])
    assert same(found["tau3"][0], "(m3*r3**2 + I3)*qdd3 + m3*g*r3*cos(q3)")
    assert found["l1*cos(q1) + l2*cos(q1 + q2)"] == ["l3*cos(q3) + x3"]  # (31)
    assert found["l1*sin(q1) + l2*sin(q1 + q2)"] == ["l3*sin(q3)"]
    Psi = {
        "Psi11": "-l1*sin(q1) - l2*sin(q1 + q2)",
        "Psi12": "-l2*sin(q1 + q2)",
        "Psi13": "l3*sin(q3)",
        "Psi21": "l1*cos(q1) + l2*cos(q1 + q2)",
        "Psi22": "l2*cos(q1 + q2)",
        "Psi23": "-l3*cos(q3)",
    }
    assert all(same(found[name][0], entry) for name, entry in Psi.items())
    # (33): what the names make of M qdd is f - Psi^T (Psi M^-1 Psi^T)^-1 (Psi M^-1 f + Psidot qd)
    M = sp.Matrix(3, 3, lambda i, j: sp.Symbol(f"M{min(i, j) + 1}{max(i, j) + 1}"))
    M[0, 2] = M[1, 2] = M[2, 0] = M[2, 1] = 0
    Psi_ = sp.Matrix(2, 3, lambda i, j: sp.Symbol(f"Psi{i + 1}{j + 1}"))
    f, bias = sp.Matrix(sp.symbols("f1:4")), sp.Matrix(sp.symbols("Psidot_qd1:3"))
    W = Psi_ * M.inv() * Psi_.T
    wanted = f - Psi_.T * W.inv() * (Psi_ * M.inv() * f + bias)
    rows = ["M11*qdd1 + M12*qdd2", "M12*qdd1 + M22*qdd2", "M33*qdd3"]
    names = {x: found[x][0] for x in found if re.fullmatch(r"d12|dW|[NWb]\d+|lambda\d", x)}
    for k, row in enumerate(rows):
        shown = sp.sympify(found[row][0])
        for _ in range(5):
            shown = shown.subs({x: sp.sympify(y) for x, y in names.items()})
        assert sp.simplify(shown - wanted[k]) == 0


# -- against sympy, from positions -----------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_every_right_side_of_the_examples(name: str) -> None:
    assert wrong(load(ROBOTS / f"{name}.yaml")) == []


@pytest.mark.parametrize("name", ["2r", "cart-pole", "whitworth", "spring-slider-crank"])
def test_with_numbers(name: str) -> None:
    assert wrong(load(ROBOTS / f"{name}.yaml"), numeric=True) == []


@pytest.mark.parametrize("seed", range(5))
def test_trees(seed: int) -> None:
    tree = seeded_tree(seed, 2 + seed % 3)
    assert wrong(tree.mechanism) == []
    assert wrong(forced(seed, seeded_tree(seed, 2)).mechanism) == []
    assert wrong(motored(seed, seeded_tree(seed, 3)).mechanism) == []
    assert wrong(sliding(seed, seeded_tree(seed + 30, 3), seed % 3).mechanism) == []


@pytest.mark.parametrize("seed", range(5))
def test_loops(seed: int) -> None:
    shape = list(LOOPS.values())[seed]
    assert wrong(forced(seed, seeded_scene(seed, shape)).mechanism) == []
    assert wrong(motored(seed, seeded_scene(seed + 50, shape)).mechanism) == []


@pytest.mark.parametrize("name", SLIDING_SCENES)
def test_prismatic_joints_slots_and_blocks(name: str) -> None:
    assert wrong(mechanism(SLIDING_SCENES[name])) == []


WELDED = """\
gravity: [1.2, -9.81]
links:
  - {name: base, m: 1.1, l: 0.5, r: [0.2, 0.03], I: 0.02}
  - {name: bracket, joint: fixed, angle: 40deg, m: 0.4, l: 0.3, r: 0.1, I: 0.01}
  - {name: arm, m: 0.8, l: 0.4, r: [0.15, 0.02], I: 0.015, payload: 0.2, damping: 0.1,
     motor: {ratio: 6, inertia: 1e-3}}
  - {name: hook, joint: fixed, angle: 90deg, m: 0.1, l: 0.1, r: 0.04, I: 0.001}
  - {name: tool, m: 0.3, l: 0.2, r: 0.07, I: 0.003}
  - {name: rail, joint: fixed, angle: -25deg, m: 0.1, l: 0.1, r: 0.04, I: 0.001}
  - {name: slide, joint: prismatic, axis: [2, 1], m: 0.2, l: 0.1, r: 0.04, I: 0.002}
  - {name: stop, joint: fixed, angle: 170deg, m: 0.1, l: 0.1, r: 0.04, I: 0.001}
  - {name: last, m: 0.2, l: 0.3, r: 0.11, I: 0.004}
springs:
  - {between: [hook, [0.4, 0.8]], stiffness: 50, length: 0.2, damping: 1}
  - {joint: tool, stiffness: 3, angle: 0.2}
loads:
  - {link: rail, at: [0.05, 0.02], force: [3, "1 + t"], frame: link}
  - {link: bracket, at: ["0.1 + 0.1 t", 0], force: [2, -4]}
  - {link: hook, at: [0.1, 0], force: [1, 2]}
  - {link: last, torque: 0.7}
"""
FRAME = """\
gravity: 9.81
links:
  - {name: frame, joint: fixed, angle: 35deg, m: 1, l: 0.3, r: 0, I: 0.1}
  - {name: table, joint: prismatic, axis: [0, 1], m: 0.8, l: 0.3, r: 0.1, I: 0.02}
  - {name: post, joint: fixed, angle: 50deg, m: 0.3, l: 0.4, r: 0.2, I: 0.01}
  - {name: arm, m: 0.8, l: 0.4, r: 0.2, I: 0.02}
loads: [{link: post, at: [0.1, 0], force: [2, 3], frame: link}]
"""


@pytest.mark.parametrize("text", [WELDED, FRAME])
def test_links_on_turned_welds(text: str) -> None:
    assert wrong(mechanism(text)) == []


def test_laws_friction_and_stops() -> None:
    assert wrong(mechanism(LAWS)) == []


def test_changed_lines_are_found() -> None:
    """Of every line that tells a number, one that tells another is found."""
    touched: list[str] = []

    def change(steps: list) -> None:
        for line in (x for step in steps for x in step["lines"] if "left" in x):
            last = line["right"][-1]
            if last not in ("0", ["0", "0"]) and "gap" not in line["left"]:
                line["right"][-1] = (
                    f"1.01*({last})" if isinstance(last, str) else [f"{last[0]} + 0.01", last[1]]
                )
                touched.append(line["left"])

    bad = wrong(load(ROBOTS / "four-bar.yaml"), change=change)
    assert [x for x in touched if not any(y.startswith(f"{x} = ") for y in bad)] == []
    assert len(touched) >= 60


# -- form ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_result_is_what_equations_prints(name: str) -> None:
    found = equations(load(ROBOTS / f"{name}.yaml"))
    shown, plain = derivation_text(Derivation(found)), text(found)
    before, _, result = shown.partition("\nResult\n\n")
    assert result == plain.split("\n", 2)[2]
    titles = [x for x in before.split("\n") if re.match(r"\d+\. ", x)]
    assert [x.split(".")[0] for x in titles] == [str(k + 1) for k in range(len(titles))]


def test_entries_are_the_strings_of_the_result() -> None:
    shown = derivation_text(Derivation(equations(load(ROBOTS / "watt-six-bar.yaml"))))
    before, _, result = shown.partition("\nResult\n\n")
    for line in result.split("\n"):
        if re.match(r"  (Psi\d+|\(Psidot qd\)\d) .* = ", line) and not line.endswith("= 0"):
            assert line in before


@pytest.mark.parametrize("width", [60, 80, 100])
def test_lines_are_no_wider_than_asked(width: int) -> None:
    shown = derivation_text(Derivation(equations(load(ROBOTS / "2r.yaml"))), width)
    long = [x for x in shown.split("\n") if len(x) > width]
    assert [x for x in long if " = " not in x and " + " in x.strip()[1:]] == []


def test_every_symbol_is_in_the_legend() -> None:
    for name in NAMES:
        shown = derivation_text(Derivation(equations(load(ROBOTS / f"{name}.yaml"))))
        known = equations(load(ROBOTS / f"{name}.yaml")).known.known
        before, _, _ = shown.partition("\nResult\n")
        formulas = [x for x in before.split("\n") if "  " in x[:2]]
        used = {x for x in known if re.search(rf"(?<![\w]){x}(?![\w])", "\n".join(formulas))}
        for symbol in used:
            assert re.search(rf"^  {symbol} +[-\d]", shown, re.MULTILINE), (name, symbol)


def test_a_long_scene_is_folded() -> None:
    found = steps_of(load(ROBOTS / "watt-six-bar.yaml"))
    assert found["L"] == ["KE - PE"]
    assert found["dL/dqd1"] == ["M11*qd1 + M12*qd2 + M14*qd4"]
    assert "(omega4**2 - omega2**2)" in found["tau1"][0]
    assert not [x for x in found if x.startswith("centripetal")]


def test_quadratic_forms_are_products_where_they_can_be() -> None:
    q = [of(Atom(Role.rate, (k,))) for k in range(3)]

    def only(sum_):
        ((form, _),) = forms_of(sum_)
        return form

    assert factored(only(q[1] * q[1] + 2 * q[0] * q[1])) == (((1, 1),), ((0, 2), (1, 1)), 1)
    assert factored(only(q[0] * q[0] + q[1] * q[1])) is None
    assert factored(only(q[0] * q[1] + q[2] * q[2])) is None
    one, two, number = factored(only((q[0] + q[1]) * (2 * q[0] - 3 * q[2])))
    assert {one, two} == {((0, 1), (1, 1)), ((0, 2), (2, -3))}
    assert number == 1
    form = only((q[0] + q[1]) * (q[0] + q[1]) - q[0] * q[0])
    assert difference_of_squares(form, [(0,), (0, 1)]) == ((0, 1), (0,), 1)


# -- the command -----------------------------------------------------------------------------------


def test_the_command(robodyn: Run) -> None:
    done = robodyn("equations", "2r", "--steps")
    assert done.out.startswith("planar 2R arm: equations of motion, step by step\n\n1. Frames")
    numbers = robodyn("equations", "2r", "--steps", "--numeric")
    assert "KE2 = 0.288 qd1² + 0.043625 (qd1 + qd2)² + 0.18 qd1 (qd1 + qd2) cos(q2)" in numbers.out
    content = json.loads(robodyn("equations", "2r", "--steps", "--format", "json").out)
    plain = json.loads(robodyn("equations", "2r", "--format", "json").out)
    assert content.pop("steps")[0]["title"] == "1. Frames and angles"
    assert content == plain


@pytest.mark.parametrize("format", ["python", "c"])
def test_code_has_no_steps(robodyn: Run, format: str) -> None:
    done = robodyn("equations", "2r", "--steps", "--format", format)
    assert done.code == 2
    assert f"--format = {format}: goes without --steps" in done.err


def test_more_than_eight_links(robodyn: Run, scene: Callable[[str], Path]) -> None:
    rows = "".join(f"  - {{name: a{k}, m: 1, l: 1, r: 0.5, I: 0.1}}\n" for k in range(9))
    done = robodyn("equations", str(scene(f"links:\n{rows}")), "--steps")
    assert done.code == 2
    assert "--steps = 9 links: at most 8 links; the equations without --steps have no limit" in (
        done.err
    )


@pytest.mark.parametrize("name", ["2r", "four-bar", "rp-arm", "spring-slider-crank"])
def test_latex_is_whole(name: str) -> None:
    shown = derivation_latex(Derivation(equations(load(ROBOTS / f"{name}.yaml"))))
    assert shown.count(r"\begin{align*}") == shown.count(r"\end{align*}")
    assert shown.count(r"\begin{pmatrix}") == shown.count(r"\end{pmatrix}")
    bare = re.sub(r"\\[{}]", "", shown)
    assert bare.count("{") == bare.count("}")
    assert r"{}^{1}v_{C_{1}}" in shown
    mathematics = "".join(re.findall(r"\\begin\{align\*\}(.*?)\\end\{align\*\}", shown, re.DOTALL))
    assert not re.search(r"(?<![\\a-zA-Z])(qdd?|tau|lambda|omega|Psi)\d", mathematics)


def test_names_of_links_may_hold_braces_and_signs() -> None:
    """What a format or LaTeX would obey is a name as any other."""
    text_of = (
        "gravity: 9.81\nlinks:\n"
        '  - {name: "arm {1} & 50%", m: 1, l: 1, r: 0.5, I: 0.1}\n'
        '  - {name: "{}", m: 1, l: 1, r: 0.5, I: 0.1}\n'
    )
    derivation = Derivation(equations(mechanism(text_of)))
    line = "2  {}, from (l1, 0) of arm {1} & 50%: turned by q2, by q1 + q2 from +X"
    assert f"\n  {line}\n" in derivation_text(derivation)
    assert json.loads(derivation_json(derivation))["steps"][0]["lines"][1] == {"text": line}
    assert r"2  \{\}, from ($l_{1},\; 0$) of arm \{1\} \& 50\%" in derivation_latex(derivation)


@pytest.mark.skipif(COMPILER is None, reason="no LaTeX compiler")
@pytest.mark.parametrize("name", ["four-bar", "watt-six-bar", "rp-arm"])
def test_latex_compiles(name: str, tmp_path: Path) -> None:
    assert COMPILER is not None
    shown = derivation_latex(Derivation(equations(load(ROBOTS / f"{name}.yaml"))))
    (tmp_path / "steps.tex").write_text(shown, encoding="utf-8")
    options = [] if "tectonic" in COMPILER else ["-interaction=nonstopmode", "-halt-on-error"]
    done = subprocess.run([COMPILER, *options, "steps.tex"], cwd=tmp_path, capture_output=True)
    assert done.returncode == 0, done.out[-2000:]


# -- velocities told by other vectors --------------------------------------------------------------


def number(entry, names: dict) -> float:
    return evaluated(PYTHON.text(entry).replace("\u00a0", " "), names)


@pytest.mark.parametrize("name", ["2r", "watt-six-bar", "rp-arm", "hydraulic-boom", "turned"])
def test_what_stands_before_a_velocity_is_it_too(name: str) -> None:
    """R^T (v + omega x arm) and R^T (..) are what the components are, for every link."""
    mech = mechanism(TURNED) if name == "turned" else load(ROBOTS / f"{name}.yaml")
    rng = np.random.default_rng(3)
    state = [rng.uniform(-2.0, 2.0, mech.n) for _ in range(3)]
    derivation = Derivation(equations(mech))
    oracle = Oracle(mech, state, np.zeros(len(mech.actuated)))
    names = oracle.values | {x.name: x.value for x in derivation.equations.known.known.values()}

    def vector(pair) -> complex:
        return complex(*(number(x, names) for x in pair))

    def velocity(k: int) -> complex:
        return complex(*oracle.of(f"v{k + 1}"))

    def omega(k: int) -> float:
        return oracle.of(f"omega{k + 1}")

    seen = set()
    for line in (x for block in derivation.sections[1].blocks for x in block):
        *told, last = line.right
        for right in told:
            match right:
                case Offset(k, arm):
                    found = velocity(k) + 1j * omega(k) * vector(arm)
                case Turned(k, inner, None):
                    found = np.exp(-1j * state[0][k]) * vector(inner)
                case Carried(k, above, arm, slides, along, _):
                    found = velocity(above) + 1j * omega(above) * vector(arm)
                    turn = 1.0 if along is None else vector(along)
                    turn = turn if slides else np.exp(1j * state[0][k])
                    found = found / turn
                    if slides:
                        found += 1j * omega(above) * state[0][k] + state[1][k]
                case _:
                    continue
            seen.add(type(right))
            assert abs(found - vector(last)) < 1e-12 * (1.0 + abs(found)), line.left
    assert {Offset} <= seen


def test_the_text_of_velocities() -> None:
    shown = derivation_text(Derivation(equations(load(ROBOTS / "2r.yaml")))).split("\n")
    start = shown.index("  omega2 = omega1 + qd2 = qd1 + qd2")
    assert shown[start + 1 : start + 3] == [
        "  v2 = R(q2)^T (v1 + omega1 x (l1, 0)) = R(q2)^T (0, l1 qd1)"
        " = (l1 qd1 sin(q2), l1 qd1 cos(q2))",
        "  vC2 = v2 + omega2 x (r2, 0) = (l1 qd1 sin(q2), l1 qd1 cos(q2) + r2 (qd1 + qd2))",
    ]
    shown = derivation_text(Derivation(equations(load(ROBOTS / "rp-arm.yaml"))))
    assert "  v2 = v1 + omega1 x (q2, 0) + (qd2, 0) = (qd2, q2 qd1)\n" in shown
