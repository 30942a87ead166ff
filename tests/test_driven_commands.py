"""Every command on scenes that laws of the time lead, wholly or in part: right, or refused by name.

What is right is what the same mechanism without the law tells of the same states.
"""

import csv
import json

import numpy as np
import pytest
import typer

from random_mechanisms import mechanism
from robodyn import assemble, cli, inverse_dynamics, loop_accelerations, loop_velocities

COMMANDS = set(typer.main.get_command(cli._application([])).commands)
LAW = "5 rad/s t + 0.3 sin(2 t)"
LINKS = """
gravity: 9.81
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
closures: [[coupler, rocker]]
"""
WHOLLY = LINKS + f'couplings: "q1 = {LAW}"\n'
# the crank's pivot is led as well as the crank, which a torque turns
PARTLY = """
gravity: 9.81
links:
  - {name: pivot, joint: prismatic, axis: [0, 1], m: 0.3, l: 0, r: 0, I: 0}
  - {name: arm, m: 0.5, l: 0.4, r: 0.25, I: 0.004, from: pivot, damping: 0.003}
couplings: "q1 = 0.02 m sin(30 rad/s t)"
"""
FREE = {"wholly": LINKS + "actuated: [crank]\n", "partly": PARTLY.split("couplings")[0]}
SCENES = {"wholly": WHOLLY, "partly": PARTLY}
AT = 0.3  # s

STATES = ["torque", "accel", "reactions", "points", "energy", "terms"]
RUN = {  # further commands that are right, with what they need
    "check": [],
    "simulate": ["--time", "0.2", "--points", "3"],
    "sweep": ["--vary", "links[1].m=1,2", "--time", "0.1", "--result", "final"],
    "bench": ["--time", "0.1"],
    "assemble": ["--at-time", "0.3", "--format", "json"],
    "equations": [],
    "draw": ["--at-time", "0.3", "-o", "out.svg"],
    "animate": ["motion.csv", "-o", "out.html"],
}
NAMED = {  # refused, by the law
    "equilibrium": [],
    "linearize": [],
    "export": ["--format", "mjcf"],
}
PATH = ["--from", "0", "--to", "1", "--time", "1", "--points", "3"]
DATA = {"fit": ["--vary", "links[1].m=0.2:3", "--match"], "identify": [], "regressor": []}
SCENELESS = {"init", "schema", "guide", "plot", "summary"}
POSED = {"simulate", "sweep", "bench", "assemble", "linearize"}  # which need the free joint


def test_no_command_is_left_out():
    assert {*STATES, *RUN, *NAMED, *DATA, *SCENELESS, "trajectory"} == COMMANDS


def state(kind, t=AT):
    """q, qd, qdd (n,) at t: of the free joint 0.4, 0.7, -0.2."""
    mech = mechanism(SCENES[kind])
    a = len(mech.actuated)
    q = assemble(mech, [0.4] * a, t=t)
    qd = loop_velocities(mech, q, [0.7] * a, t=t)
    return q, qd, loop_accelerations(mech, q, qd, [-0.2] * a, t=t)


def given(names, values):
    return [x for name, v in zip(names, values, strict=True) for x in (f"--{name}", text(v))]


def text(values):
    return ",".join(map(repr, np.asarray(values).tolist()))


def table(out):
    (row,) = csv.DictReader(out.splitlines())
    return {name: float(value) for name, value in row.items()}


@pytest.mark.parametrize("kind", SCENES)
class TestRight:
    @pytest.mark.parametrize("command", STATES)
    def test_states_are_those_of_the_free_mechanism(self, robodyn, scene, kind, command):
        q, qd, qdd = state(kind)
        free = mechanism(FREE[kind])
        tau = inverse_dynamics(free, q, qd, qdd)
        own = list(mechanism(SCENES[kind]).actuated)
        known = {"q": q[own], "qd": qd[own], "qdd": qdd[own], "tau": tau[own]}
        takes = {
            "torque": ["q", "qd", "qdd"], "accel": ["q", "qd", "tau"], "energy": ["q", "qd"],
            "reactions": ["q", "qd", "qdd"], "points": ["q", "qd", "qdd"], "terms": ["q", "qd"],
        }[command]  # fmt: skip
        driven = [x for name in takes if own for x in (f"--{name}", text(known[name]))]
        whole = [x for name in takes for x in (f"--{name}", text({
            "q": q, "qd": qd, "qdd": qdd, "tau": tau[list(free.actuated)]}[name]))]  # fmt: skip
        one = robodyn(command, scene(SCENES[kind]), *driven, "--at-time", str(AT))
        other = robodyn(command, scene(FREE[kind]), *whole)
        assert (one.code, other.code) == (0, 0), one.err + other.err
        if command == "terms":
            found, right = json.loads(one.out), json.loads(other.out)
            for name in ("M", "C", "G", "KE", "PE"):
                np.testing.assert_allclose(found[name], right[name], atol=1e-12)
            return
        found, right = table(one.out), table(other.out)
        right |= {"tc1": tau[0]} if command in ("torque", "accel") else {}
        shared = [name for name in found if name in right]
        assert shared
        assert [found[x] for x in shared] == pytest.approx([right[x] for x in shared], abs=1e-9)
        if command in ("torque", "accel", "reactions"):
            assert found["tc1"] == pytest.approx(tau[0], abs=1e-9)

    @pytest.mark.parametrize("command", RUN)
    def test_other_commands(self, robodyn, scene, kind, command, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        path, pose = scene(SCENES[kind]), ["--q", "0.4"] * (kind == "partly")
        if command == "animate":
            rest = ["--time", "0.2", "--points", "5", "-o", "motion.csv"]
            assert robodyn("simulate", path, *pose, *rest).code == 0
        given = robodyn(command, path, *RUN[command], *(pose if command in POSED else []))
        assert given.code == 0, given.err
        law = (lambda t: 5 * t + 0.3 * np.sin(2 * t), lambda t: 0.02 * np.sin(30 * t))
        q1 = law[kind == "partly"]
        if command == "simulate":
            rows = [*csv.DictReader(given.out.splitlines())]
            told = [(float(x["t"]), float(x["q1"])) for x in rows]
            assert len(told) == 3
            assert [x for _, x in told] == pytest.approx([q1(t) for t, _ in told], abs=1e-12)
        if command == "sweep":
            ends = [float(x["q1_end"]) for x in csv.DictReader(given.out.splitlines())]
            assert ends == pytest.approx([q1(0.1)] * 2, abs=1e-12)
        if command == "assemble":
            found = json.loads(given.out)
            q = found["branches"][0]["q"] if "branches" in found else found["q"]
            assert q[0] == pytest.approx(q1(0.3), abs=1e-12)
        if command == "check":
            assert json.loads(given.out)["passed"] is True

    @pytest.mark.parametrize("command", NAMED)
    def test_what_is_refused_names_the_law(self, robodyn, scene, kind, command):
        pose = ["--q", "0.4"] if kind == "partly" and command in POSED else []
        given = robodyn(command, scene(SCENES[kind]), *NAMED[command], *pose)
        assert given.code == 2, given.out
        assert "couplings[0] = " in given.err
        assert "law" in given.err.split("couplings[0] = ")[1]

    def test_a_trajectory(self, robodyn, scene, kind, tmp_path):
        path = scene(SCENES[kind])
        given = robodyn("trajectory", path, *PATH)
        if kind == "wholly":
            assert given.code == 2
            assert "couplings[0] = " in given.err
            return
        assert given.code == 0, given.err
        track = tmp_path / "track.csv"
        track.write_text(given.out)
        vary = ["--vary", "links.arm.m=0.5,0.7", "--result", "max(KE),max(PE)"]
        swept = robodyn("sweep", path, "--kind", "torque", "--track", str(track), *vary)
        energies = robodyn("energy", path, str(track))
        states = [*csv.DictReader(energies.out.splitlines())]
        of_own_mass = next(csv.DictReader(swept.out.splitlines()))
        for name in ("KE", "PE"):
            most = max(float(x[name]) for x in states)
            assert float(of_own_mass[f"max({name})"]) == pytest.approx(most, rel=1e-9)
        rows = [*csv.DictReader(given.out.splitlines())]
        told = [[float(x[name]) for name in ("t", "q1", "qd1", "qdd1", "q2")] for x in rows]
        exact = [
            (t, 0.02 * np.sin(30 * t), 0.6 * np.cos(30 * t), -18 * np.sin(30 * t), q2)
            for t, q2 in ((0.0, 0.0), (0.5, 0.5), (1.0, 1.0))
        ]
        np.testing.assert_allclose(told, exact, atol=1e-12)

    @pytest.mark.parametrize("command", DATA)
    def test_data_need_their_times(self, robodyn, scene, kind, command):
        rows = "q2,qd2,qdd2,tau2\n" + "0.1,0.2,0.3,0.4\n0.2,0.1,0.5,0.3\n0.3,0.1,0.1,0.1\n"
        rest = ["-", "--condition"] if command == "regressor" else [*DATA[command], "-"]
        given = robodyn(command, scene(SCENES[kind]), *rest, stdin=rows)
        assert given.code == 2, given.out
        assert "law of the time" in given.err or "laws of the time lead" in given.err


def test_a_law_that_is_constant_passes(robodyn, scene):
    """A law whose slope by t is structurally zero counts as the constant that it is."""
    for law, same in (
        ("A*sin(30 rad/s t)", "0 m"), ("0.3 m + 0 m/s t", "0.3 m"), ("0.3*cos(0*t)", "0.3 m"),
        ("0.1 m sin(q2) + A*sin(t)", "0.1 m sin(q2)"),
    ):  # fmt: skip
        text = "constants: {A: 0 mm}" + PARTLY.replace("0.02 m sin(30 rad/s t)", law)
        plain = "constants: {A: 0 mm}" + PARTLY.replace("0.02 m sin(30 rad/s t)", same)
        for command in (["equilibrium"], ["linearize", "--q", "-1.1"]):
            rest = [*command[1:], "--format", "json"]
            found, right = (robodyn(command[0], scene(x), *rest) for x in (text, plain))
            assert (found.code, right.code) == (0, 0), found.err + right.err
            found, right = json.loads(found.out), json.loads(right.out)
            for name in ("q", "tau", "A", "B"):
                if name in right:
                    np.testing.assert_allclose(found[name], right[name], atol=1e-9)
