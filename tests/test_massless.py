"""Links without masses: kinematics are those with masses; what needs a mass says which has none."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import ROOT
from jsonschema import Draft202012Validator

import robodyn as api
from random_mechanisms import mechanism
from robodyn.errors import MassError
from robodyn.scene.scene_schema import scene_schema

MASSES = re.compile(r"m: [0-9.]+, *(l: [0-9.]+), *r: (?:[0-9.]+|\[[^\]]*\]), *I: [0-9.e-]+")
MODELS = ("four-bar", "five-bar", "stephenson-six-bar", "3r", "hoeken")


def without(name: str) -> str:
    """A scene of the examples without masses."""
    text = (ROOT / f"robots/{name}.yaml").read_text(encoding="utf-8")
    text = re.sub(r"\s*#.*", "", text)
    text = re.sub(r"(?m)^  - \{name: ([^,]+), +", r"  - {name: \1, ", text)
    text, count = MASSES.subn(r"\1", text)
    assert count
    return text


@pytest.mark.parametrize("name", MODELS)
def test_kinematics_are_those_with_masses(name: str) -> None:
    light, whole = mechanism(without(name)), api.load(name)
    rng = np.random.default_rng(3)
    actuated = 1.0 + 0.1 * rng.uniform(-1, 1, len(whole.actuated))
    if whole.rows:
        q, other = (api.assemble(x, actuated) for x in (light, whole))
        assert np.array_equal(q, other)
        qd = api.loop_velocities(light, q, actuated)
        assert np.array_equal(qd, api.loop_velocities(whole, q, actuated))
        assert np.array_equal(api.closure_jacobian(light, q), api.closure_jacobian(whole, q))
    else:
        q, qd = rng.uniform(-1, 1, (2, whole.n))
    for one, other in zip(*(api.points(x, q, qd)[1:] for x in (light, whole)), strict=True):
        assert np.array_equal(one, other)
    assert light.massless == tuple(range(light.n))


@pytest.mark.parametrize(
    "ask",
    [
        lambda m: api.mass_matrix(m, np.ones(3)),
        lambda m: api.coriolis_matrix(m, np.ones(3), np.ones(3)),
        lambda m: api.gravity_vector(m, np.ones(3)),
        lambda m: api.kinetic_energy(m, np.ones(3), np.ones(3)),
        lambda m: api.potential_energy(m, np.ones(3)),
        lambda m: api.inverse_dynamics(m, np.ones(3), np.ones(3), np.ones(3)),
        lambda m: api.forward_dynamics(m, np.ones(3), np.ones(3), np.ones(3)),
        lambda m: api.simulate(m, np.ones(3), np.zeros(3), 1.0),
        lambda m: api.simulate(m, np.ones(3), np.zeros(3), 1.0, method="taylor"),
        lambda m: api.reactions(m, np.ones(3), np.ones(3), np.ones(3), []),
        lambda m: api.equilibria(m),
        lambda m: api.regressor(m, np.ones((1, 3)), np.ones((1, 3)), np.ones((1, 3))),
    ],
)
def test_what_needs_a_mass_names_the_link(ask) -> None:
    text = without("3r")
    with pytest.raises(MassError, match=r"links\[0\] \(upper arm\): has no mass m"):
        ask(mechanism(text))
    one = (ROOT / "robots/3r.yaml").read_text(encoding="utf-8")
    one = re.sub(
        r"(name: hand), +m: [0-9.]+, +(l: [0-9.]+), r: [0-9.]+, I: [0-9.]+", r"\1, \2", one
    )
    with pytest.raises(MassError, match=r"links\[2\] \(hand\): has no mass m"):
        ask(mechanism(one))


COMMANDS = {
    "torque": ["--q", "1"],
    "accel": ["--q", "1"],
    "energy": ["--q", "1"],
    "reactions": ["--q", "1"],
    "simulate": ["--q", "1", "--time", "1"],
    "linearize": ["--q", "1"],
    "equilibrium": [],
    "bench": ["--q", "1"],
    "regressor": ["--q", "1"],
    "export": ["--q", "1", "--format", "mjcf"],
    "sweep": ["--vary", "q1=0.3:0.36:3", "--kind", "torque"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_that_need_a_mass_say_so(robodyn, tmp_path: Path, command: str) -> None:
    file = tmp_path / "light.yaml"
    file.write_text(without("four-bar"), encoding="utf-8")
    result = robodyn(command, str(file), *COMMANDS[command])
    assert result.code == 2
    assert f"links[0] (crank): has no mass m, which {command} needs" in result.err
    assert not result.out


def test_commands_that_need_none(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "light.yaml"
    file.write_text(without("four-bar"), encoding="utf-8")
    for command in (
        ["assemble", "--q", "1"],
        ["assemble", "--q", "1", "--range"],
        ["points", "--q", "1", "--qd", "2"],
        ["check"],
        ["trajectory", "--from", "1", "--to", "2", "--time", "1"],
        ["draw", "--q", "1", "-o", str(tmp_path / "x.svg")],
    ):
        result = robodyn(command[0], str(file), *command[1:])
        assert result.code == 0, (command, result.err)
    header = robodyn("assemble", str(file), "--q", "1").out.splitlines()[0]
    assert "tip_x1" in header
    assert "centre" not in header
    found = robodyn("terms", str(file), "--q", "1", "--qd", "2").json
    assert set(found) == {"q", "qd", "Psi", "Psidot_qd", "gap"}
    told = robodyn("equations", str(file)).out
    assert "gap = 0    Psi qd = 0" in told
    assert " M" not in told.split("q1")[0]
    refused = robodyn("points", str(file), "--q", "1", "--of", "centre2")
    assert refused.code == 2
    assert "which link 2 has not: it has no mass m" in refused.err


@pytest.mark.parametrize("format", ["text", "latex", "python", "c", "json"])
def test_equations_are_those_of_closures(robodyn, tmp_path: Path, format: str) -> None:
    file = tmp_path / "light.yaml"
    file.write_text(without("3r"), encoding="utf-8")
    refused = robodyn("equations", str(file), "--format", format)
    assert refused.code == 2
    assert "links[0] (upper arm): has no mass m, which equations needs" in refused.err
    file.write_text(without("four-bar"), encoding="utf-8")
    code = robodyn("equations", str(file), "--format", format)
    assert code.code == 0, code.err
    if format == "python":
        written: dict = {}
        exec(code.out, written)
        assert not {"M", "C", "G", "joint_torques"} & {*written}
        mech = api.load(file)
        q, qd = np.random.default_rng(2).uniform(-1, 1, (2, 3))
        assert written["Psi"](q) == pytest.approx(api.closure_jacobian(mech, q), rel=1e-13)
        assert written["gap"](q) == pytest.approx(api.closure_gap(mech, q), rel=1e-13)
        h = 1e-6
        two = [np.array(written["Psi"](q + s * h * qd)) @ qd for s in (1, -1)]
        assert written["Psidot_qd"](q, qd) == pytest.approx((two[0] - two[1]) / (2 * h), rel=1e-8)


def test_some_of_the_three_are_not_enough(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "light.yaml"
    file.write_text("links: [{name: a, l: 1, m: 1}]\n", encoding="utf-8")
    result = robodyn("check", str(file))
    assert result.code == 2
    assert "links[0] (a).r: is missing: give m, r, I, or none of them" in result.err
    assert "links[0] (a).I: is missing" in result.err
    schema = Draft202012Validator(scene_schema())
    for given, fits in (("", True), ("m: 1", False), ("m: 1, r: 0, I: 1", True), ("r: 0", False)):
        scene = yaml.safe_load(f"links: [{{name: a, l: 1{', ' * bool(given)}{given}}}]")
        assert schema.is_valid(scene) is fits, given


def test_peaucelliers_linkage_draws_a_straight_line() -> None:
    """C on a circle through O, and OC OP = 0.5^2 - 0.25^2: P is at 0.625 (1, tan(q1/2))."""
    mech = api.load("peaucellier")
    for q1 in np.radians([-67, -40, -10, 0, 25, 60, 67]):
        q = api.assemble(mech, [q1])
        qd = api.loop_velocities(mech, q, [1.5])
        qdd = api.loop_accelerations(mech, q, qd, [0.0])
        (_, p, v, a) = api.points(mech, q, qd, qdd, of="P")
        rate = 0.75 / np.cos(q1 / 2) ** 2  # of tan(q1/2)
        assert p[..., 0, :] == pytest.approx(0.625 * np.array([1, np.tan(q1 / 2)]), abs=1e-12)
        assert v[..., 0, :] == pytest.approx(0.625 * np.array([0, rate]), abs=1e-11)
        bent = 1.5 * rate * np.tan(q1 / 2)
        assert a[..., 0, :] == pytest.approx(0.625 * np.array([0, bent]), abs=1e-9)


STILL = {
    "a post that a coupling keeps": """\
links:
  - {name: post, l: 0.5, MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02}
couplings: ["q1 = 80deg"]
""",
    "a post on a post, the second by a gear": """\
links:
  - {name: post, l: 0.5, MASS}
  - {name: shelf, l: 0.3, MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02}
couplings: ["q2 = -2 q1 + 0.1", "q1 = 0.3"]
""",
    "a weld on a weld on the ground": """\
links:
  - {name: base, l: 0.5, joint: fixed, MASS}
  - {name: bracket, l: 0.2, joint: fixed, angle: 30deg, MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02}
""",
    "a weld on a slide that a law keeps": """\
links:
  - {name: table, joint: prismatic, axis: [0, 1], l: 0.5, MASS}
  - {name: bracket, l: 0.2, joint: fixed, angle: 30deg, MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02}
couplings: ["q1 = 0.2 m"]
""",
    "two links in a frame that carries a four-bar": """\
links:
  - {name: left, l: 0.9, MASS}
  - {name: right, l: 1.0, from: [1.0, 0.0], MASS}
  - {name: arm, m: 1.0, l: 0.63, r: 0.2, I: 0.01, from: left}
  - {name: rod, m: 2.0, l: 0.94, r: 0.2, I: 0.1, from: arm}
  - {name: rocker, m: 1.0, l: 0.54, r: 0.2, I: 0.1, from: [1.0, 0.0]}
closures: [[left, right], [rod, rocker]]
actuated: [arm]
start: {left: 63deg, right: 127deg, arm: -45deg, rod: -76deg, rocker: 80deg}
""",
    "a triangle on a triangle": """\
links:
  - {name: left, l: 0.9, MASS}
  - {name: right, l: 1.0, from: [1.0, 0.0], MASS}
  - {name: strut, l: 0.7, from: left, MASS}
  - {name: stay, l: 1.1, from: [1.0, 0.0], MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02, from: strut}
closures: [[left, right], [strut, stay]]
actuated: [arm]
start: {left: 63deg, right: 127deg, strut: 20deg, stay: 70deg}
""",
    "a plate on three legs": """\
links:
  - {name: left, l: 0.9, MASS}
  - {name: plate, l: 1.0, MASS}
  - {name: right, l: 0.8, from: [1.1, 0.2], MASS}
  - {name: middle, l: 0.7, from: [0.4, -0.3], MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02, from: plate}
closures: [[plate, right], [{link: plate, at: [0.4, 0.3]}, middle]]
actuated: [arm]
start: {left: 30deg, plate: -30deg, right: 60deg, middle: 60deg}
""",
    "a law of the time whose rate is zero": """\
links:
  - {name: post, l: 0.5, MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02}
couplings: ["q1 = 2 rad + 0 rad/s t"]
""",
    "a strut between two points of the ground": """\
links:
  - {name: strut, l: 1.3, from: [0.5, 0], MASS}
  - {name: arm, m: 1.2, l: 0.4, r: 0.2, I: 0.02, from: {link: strut, at: [0.4, 0]}}
closures: [[strut, [1.8, 0]]]
actuated: [arm]
start: {strut: 0}
""",
}


LARGER = ("a triangle on a triangle", "a plate on three legs")  # two loops hold these


def table(outcome) -> dict[str, list[float]]:
    """The columns that a command wrote."""
    return {name: outcome.column(name) for name in outcome.rows[0]}


GRAVITY = "gravity: [1.1, -9.81]\n"


@pytest.mark.parametrize("name", STILL)
def test_the_mass_of_a_link_that_stands_still_acts_on_nothing_that_moves(
    robodyn, tmp_path: Path, name: str
) -> None:
    """Every column is that with any masses, but for the forces that carry their weight."""
    light, heavy = tmp_path / "light.yaml", tmp_path / "heavy.yaml"
    light.write_text(GRAVITY + STILL[name].replace(", MASS", ""), encoding="utf-8")
    heavy.write_text(
        GRAVITY + STILL[name].replace("MASS", "m: 7, r: [0.1, 0.2], I: 3"), encoding="utf-8"
    )
    lost = {"tc1", "tc2"} if "coupl" in STILL[name] else set()
    lost |= {"fx1", "fy1"} if "closures" in STILL[name] else set()
    lost |= {"fx2", "fy2"} if name in LARGER else set()
    for command in (
        ["torque", "--q=-20deg", "--qd", "2", "--qdd", "3"],
        ["accel", "--q=-20deg", "--qd", "2", "--tau", "3"],
        ["simulate", "--q=-20deg", "--time", "0.3", "--points", "3", "--columns", "t,q,qd"],
        ["linearize", "--q=-20deg"],
    ):
        one, other = (robodyn(command[0], str(x), *command[1:]) for x in (light, heavy))
        assert one.code == other.code == 0, (command, one.err, other.err)
        if command[0] == "linearize":
            assert one.json["A"] == pytest.approx(np.array(other.json["A"]), rel=1e-9)
            continue
        ones, others = table(one), table(other)
        assert {*others} - {*ones} == ({x for x in others if x in lost}), command
        for column in ones:
            assert ones[column] == pytest.approx(others[column], rel=1e-7, abs=1e-9), column
    code = robodyn("equations", str(light), "--format", "python")
    assert code.code == 0, code.err
    if lost:
        result = robodyn("reactions", str(light), "--q=-20deg")
        assert result.code == 2
        assert "has no mass m, which reactions needs" in result.err
    light.write_text(STILL[name].replace(", MASS", ""), encoding="utf-8")  # nothing weighs
    heavy.write_text(STILL[name].replace("MASS", "m: 7, r: [0.1, 0.2], I: 3"), encoding="utf-8")
    for command in ("reactions", "torque"):
        state = ["--q=-20deg", "--qd", "2", "--qdd", "3"]
        one, other = (table(robodyn(command, str(x), *state)) for x in (light, heavy))
        assert [*one] == [*other]
        for column in one:
            if not column.startswith("shake_m"):
                assert one[column] == pytest.approx(other[column], rel=1e-9, abs=1e-9), column


@pytest.mark.parametrize(
    "text",
    [
        # equal cranks about one point turn together
        "links:\n  - {name: a, l: 0.5}\n  - {name: b, l: 0.5, from: [0, 0]}\n"
        "closures: [[a, b]]\nactuated: [a]\n",
        # a frame on what turns
        "links:\n  - {name: wheel, m: 1, l: 0.5, r: 0.1, I: 0.1}\n"
        "  - {name: a, l: 0.5}\n  - {name: b, l: 0.6, from: 'wheel@0.1,0.1'}\nclosures: [[a, b]]\n"
        "actuated: [wheel]\n",
        # a joint that the time drives
        'links: [{name: a, l: 0.5}]\ncouplings: ["q1 = 2 rad/s t"]\n',
        # a plate on three legs, equal and parallel
        "links:\n  - {name: a, l: 0.9}\n  - {name: plate, l: 1.0}\n"
        "  - {name: b, l: 0.9, from: [1.0, 0]}\n  - {name: c, l: 0.9, from: [0.4, 0.3]}\n"
        "closures: [[plate, b], [{link: plate, at: [0.4, 0.3]}, c]]\nactuated: [a]\n",
        # what a coupling keeps upon what turns
        "links:\n  - {name: wheel, m: 1, l: 0.5, r: 0.1, I: 0.1}\n  - {name: a, l: 0.5}\n"
        'couplings: ["q2 = 0.3"]\n',
    ],
)
def test_a_link_that_moves_needs_its_mass(robodyn, tmp_path: Path, text: str) -> None:
    file = tmp_path / "light.yaml"
    file.write_text(text, encoding="utf-8")
    state = [] if " t" in text else ["--q", "0.3"]
    result = robodyn("torque", str(file), *state)
    assert result.code == 2
    assert " (a): has no mass m, which torque needs" in result.err


@pytest.mark.parametrize(
    "text",
    [
        # bars of equal length, which turn about one point on one branch of the triangle below
        "links:\n  - {name: left, l: 0.5}\n  - {name: right, l: 0.5, from: [0.6, 0]}\n"
        "  - {name: a, l: 0.7, from: left}\n  - {name: b, l: 0.7, from: [0.3, 0.4]}\n"
        "closures: [[left, right], [a, b]]\n",
        # laws that hardly move, and that move for a short time
        'links: [{name: a, l: 0.5}]\ncouplings: ["q1 = 2 rad + 1e-9 rad/s t"]\n',
        "links: [{name: a, l: 0.5}]\n"
        'couplings: ["q1 = 2 rad + 0.1 rad exp(-(t - 2 s)^2/(1e-3 s)^2)"]\n',
        # what cannot close
        "links:\n  - {name: a, l: 0.5, from: [2, 0]}\n  - {name: b, l: 0.1}\nclosures: [[a, b]]\n",
    ],
)
def test_what_may_move_in_some_pose_does_not_stand_still(text: str) -> None:
    found = mechanism(text)
    assert not found.still.keys() & {found.link_names.index("a")}


def test_random_trusses_stand_still() -> None:
    """A pin with two bars to pins that are fixed is fixed; a bar between two such stands still."""
    rng, count = np.random.default_rng(3), 0
    for _ in range(30):
        pins = [f"P{i}" for i in range(rng.integers(6, 9))]
        fixed, bars = {*pins[:3]}, list[tuple[str, str]]()
        for i, pin in enumerate(pins[3:], start=3):
            first, second = rng.choice(pins[:i], 2, replace=False)
            bars += [(first, pin), (second, pin)][: 1 + (rng.random() < 0.75)]
            if bars[-1][0] == second and {first, second} <= fixed:
                fixed.add(pin)
        named = {pin for bar in bars for pin in bar}
        places = {pin: rng.uniform(0, 2, 2).tolist() for pin in pins if pin in named}
        links = [{"name": f"L{k}", "pins": [*map(str, x)]} for k, x in enumerate(bars)]
        ground = [pin for pin in pins[:3] if pin in named]
        still = {k for k, bar in enumerate(bars) if {*bar} <= fixed}
        if len(still) < len(bars):  # else it is no mechanism
            scene = yaml.safe_dump({"pins": places, "links": links, "ground": ground})
            assert set(mechanism(scene).still) == still
            count += len(still)
    assert count > 60


def test_a_sweep_whose_ends_move_needs_the_mass(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "light.yaml"
    text = "constants: {w: 0 rad/s}\nlinks: [{name: a, l: 0.5}, {name: b, m: 1, l: 1, r: 0, I: 1}]"
    file.write_text(f'{text}\ncouplings: ["q1 = w t"]\n', encoding="utf-8")
    motion = ["sweep", str(file), "--q", "0.1", "--time", "0.1", "--quiet", "--vary"]
    result = robodyn(*motion, "constants.w=0,1")
    assert result.code == 2
    assert "links[0] (a): has no mass m, which sweep needs" in result.err
    assert robodyn(*motion, "links.b.m=1,2").code == 0


def test_what_moves_is_named_not_what_stands(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "light.yaml"
    text = "links:\n  - {name: base, l: 1, joint: fixed}\n  - {name: arm, l: 1}\n"
    file.write_text(text, encoding="utf-8")
    result = robodyn("torque", str(file), "--q", "0.3")
    assert "links[1] (arm): has no mass m, which torque needs" in result.err
