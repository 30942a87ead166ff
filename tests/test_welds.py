"""Welds: links without a joint, against joints that a coupling keeps where they are."""

from __future__ import annotations

import cmath
import json
import math
from pathlib import Path

import numpy as np
import pytest
from conftest import FIRST_SEED, FRESH
from read_equations import evaluated, module
from scipy.integrate import solve_ivp

import robodyn as api
from random_mechanisms import mechanism
from robodyn.scene.plain_scene import plain_scene


def tree(rng: np.random.Generator, n: int, welds: set[int]) -> tuple[str, str, list[int]]:
    """A random tree twice: with welds, and with joints that couplings keep; the moving links."""
    entries, kept, couplings = [], [], []
    number = {}
    for k in range(n):
        at, r = rng.uniform(-0.5, 0.5, (2, 2)).round(3).tolist()
        m, l, I, payload = rng.uniform(0.1, 1.0, 4).round(3).tolist()
        above = int(rng.integers(0, k)) if k else None
        place = f"{at}" if above is None else f"{{link: L{above}, at: {at}}}"
        text = f"name: L{k}, m: {m}, l: {l}, r: {r}, I: {I}, payload: {payload}, from: {place}"
        angle = round(float(rng.uniform(-3, 3)), 3)
        if k in welds:
            entries.append(f"  - {{{text}, joint: fixed, angle: {angle}}}")
            couplings.append(f"q{k + 1} = {angle}")
        else:
            number[k] = len(number)
            entries.append(f"  - {{{text}}}")
        kept.append(f"  - {{{text}}}")
    last, other = rng.choice(n, 2, replace=False)
    acts = f"""\
gravity: [1.5, -9.81]
springs:
  - {{between: [{{link: L{last}, at: [0.2, 0.1]}}, [1.3, 0.4]], stiffness: 30, length: 0.3,
      damping: 0.7}}
loads:
  - {{link: L{last}, at: [0.1, -0.2], force: [2, "1 + t"], frame: link}}
  - {{link: L{other}, at: [0.3, 0], force: [1, 2], frame: link}}
  - {{link: L{other}, at: [0.3, 0], force: [-1, 0.5]}}
  - {{link: L{last}, torque: 0.4}}
points: {{P: {{link: L{last}, at: [0.3, 0.2]}}}}
"""
    one = "links:\n" + "\n".join(entries) + "\n" + acts
    two = "links:\n" + "\n".join(kept) + "\n" + acts
    two += f"couplings: {couplings}\n"
    return one, two, sorted(number)


@pytest.mark.parametrize("seed", range(20 if FRESH else 4))
def test_a_weld_is_a_joint_that_is_kept(seed: int) -> None:
    rng = np.random.default_rng(FIRST_SEED + seed)
    for _ in range(10):
        n = int(rng.integers(2, 7))
        count = int(rng.integers(1, n))
        welds = {int(x) for x in rng.choice(np.arange(0, n), count, replace=False)}
        one, two, moving = tree(rng, n, welds)
        if not moving:
            continue
        a, b = mechanism(one), mechanism(two)
        assert a.n == len(moving)
        q, qd, qdd = rng.uniform(-2, 2, (3, a.n))
        given = np.zeros(n)
        angles = {x.joint: x.angle for x in b.description.couplings}
        for k, angle in angles.items():
            given[k] = angle
        there, rates, more = given.copy(), np.zeros(n), np.zeros(n)
        there[moving], rates[moving], more[moving] = q, qd, qdd
        b = mechanism(two + f"actuated: [{', '.join(f'L{k}' for k in moving)}]\n")
        tau = api.inverse_dynamics(a, q, qd, qdd)
        assert np.allclose(tau, api.inverse_dynamics(b, there, rates, more)[moving], rtol=1e-10)
        assert np.allclose(api.forward_dynamics(a, q, qd, tau), qdd, rtol=1e-7, atol=1e-7)
        zero = given.copy()  # a weld on the ground adds a constant
        grown = total(a, q, qd) - total(a, 0 * q, 0 * qd)
        assert grown == pytest.approx(total(b, there, rates) - total(b, zero, 0 * rates), abs=1e-10)
        for name in ("P", *(f"L{k}" for k in range(n)), f"L{n - 1}@0.1,0.3"):
            points = [
                api.points(x, at, w, z, of=name)
                for x, at, w, z in ((a, q, qd, qdd), (b, there, rates, more))
            ]
            for x, y in zip(*(each[1:] for each in points), strict=True):
                assert np.allclose(x, y, atol=1e-12), name
        assert all(found.holds for found in checked(a)), one


def checked(mech: api.Mechanism) -> list:
    from robodyn.dynamics.identities import identities, sample_states

    return identities(mech, sample_states(mech, 5))


BELL = """\
name: bell crank
gravity: 9.81
links:
  - {name: crank, m: 0.4, l: 0.12, r: 0.05, I: 0.002}
  - {name: rod, m: 0.5, l: 0.5, r: 0.25, I: 0.012}
  - {name: bell, m: 0.6, l: 0.25, r: 0.1, I: 0.006, from: [0.55, 0.1]}
  - {name: arm, m: 0.3, l: 0.2, r: 0.1, I: 0.002, joint: fixed, from: {link: bell, at: [0, 0]},
     angle: -80deg}
  - {name: push rod, m: 0.2, l: 0.4, r: 0.2, I: 0.003, from: arm}
closures:
  - [rod, bell]
  - {point: push rod, on: {through: [0, -0.1], along: [1, 0]}}
actuated: [crank]
"""


def test_code_of_a_chain_beyond_a_weld_is_that_of_its_terms() -> None:
    """Sums along the tree take places as the weld turns them."""
    link = "m: 1, l: 1, r: 0.5, I: 0.1"
    weld = "{name: w, m: 0, l: 0.5, r: 0, I: 0, joint: fixed, angle: 40deg, from: a}"
    beyond = "".join(f"  - {{name: {name}, {link}}}\n" for name in "bcde")
    mech = mechanism(f"gravity: 9.81\nlinks:\n  - {{name: a, {link}}}\n  - {weld}\n{beyond}")
    code, (q, qd, qdd) = module(mech), np.random.default_rng(1).uniform(-1.0, 1.0, (3, mech.n))
    M, C, G = (np.array(code[name](*at)) for name, at in (("M", [q]), ("C", [q, qd]), ("G", [q])))
    found = code["inverse_dynamics"](q, qd, qdd)
    np.testing.assert_allclose(found, M @ qdd + C @ qd + G, atol=1e-12)
    np.testing.assert_allclose(found, api.inverse_dynamics(mech, q, qd, qdd), atol=1e-12)


def test_a_place_that_varies_on_a_weld_has_a_name_of_its_own(robodyn, tmp_path: Path) -> None:
    """The weld's own place is c1x: Q = -F y of the point."""
    weld = "joint: fixed, from: {link: a, at: [0.7, -0.3]}, angle: 30deg, m: 0, l: 1, r: 0, I: 0"
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        f"links:\n  - {{name: a, m: 1, l: 1, r: 0.5, I: 0.1}}\n  - {{name: w, {weld}}}\n"
        'loads:\n  - {link: w, at: ["0.2 m + 0.1 m sin(q1)", 0], force: [5, 0]}\n'
    )
    along = 0.2 + 0.1 * math.sin(0.4)
    place = cmath.rect(1.0, 0.4) * (0.7 - 0.3j + along * cmath.rect(1.0, math.pi / 6.0))
    for more in ((), ("--numeric",)):
        content = json.loads(robodyn("equations", scene, "--format", "json", *more).out)
        (Q,) = evaluated(content, np.array([0.4]), np.zeros(1))["Q"].ravel()
        assert pytest.approx(-5.0 * place.imag, rel=1e-12) == Q


def test_a_bell_crank_is_one_ternary_link() -> None:
    """By hand: centre and inertia of both arms about the bell's joint."""
    turn = cmath.exp(-1j * math.radians(80))
    mass, first = 0.9, 0.6 * 0.1 + 0.3 * 0.1 * turn
    centre = first / mass
    about = 0.006 + 0.6 * 0.01 + 0.002 + 0.3 * 0.01
    I = about - mass * abs(centre) ** 2
    by_hand = BELL.replace(
        "m: 0.6, l: 0.25, r: 0.1, I: 0.006",
        f"m: {mass}, l: 0.25, r: [{centre.real!r}, {centre.imag!r}], I: {I!r}",
    )
    tip = 0.2 * turn
    start, end = by_hand.index("  - {name: arm"), by_hand.index("  - {name: push rod")
    by_hand = (by_hand[:start] + by_hand[end:]).replace(
        "from: arm", f"from: {{link: bell, at: [{tip.real!r}, {tip.imag!r}]}}"
    )
    one, two = mechanism(BELL), mechanism(by_hand)
    assert one.n == two.n == 4
    for angle in np.linspace(0, 6, 13):
        q, other = api.assemble(one, [angle]), api.assemble(two, [angle])
        shift = np.array([0, 0, 0, math.radians(80)])  # the push rod's zero is the arm's axis
        way = np.remainder(q - shift - other + np.pi, 2 * np.pi) - np.pi
        assert np.abs(way).max() < 1e-12
        qd = api.loop_velocities(one, q, [2.0])
        qdd = api.loop_accelerations(one, q, qd, [1.0])
        tau = [api.inverse_dynamics(x, at, qd, qdd) for x, at in ((one, q), (two, other))]
        assert np.allclose(*tau, rtol=1e-11)


def test_a_run_by_both_integrators(tmp_path: Path) -> None:
    """A pendulum with a weight welded on, against its own equation."""
    text = """\
gravity: 9.81
links:
  - {name: bar, m: 1, l: 0.5, r: 0.2, I: 0.03}
  - {name: bob, m: 2, l: 0.1, r: 0.05, I: 0.01, joint: fixed, angle: 40deg}
"""
    mech = mechanism(text)
    bob = 0.5 + 0.05 * np.exp(1j * math.radians(40))
    about, first = 0.03 + 0.04 + 0.01 + 2 * abs(bob) ** 2, 0.2 + 2 * bob

    def rates(t: float, y: np.ndarray) -> list[float]:
        turned = first * np.exp(1j * y[0])
        return [y[1], -9.81 * turned.real / about]

    exact = solve_ivp(rates, (0, 2), [0.3, 0.0], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    for method in ("DOP853", "taylor"):
        run = api.simulate(mech, [0.3], [0.0], 2.0, method=method, rtol=1e-11, atol=1e-12)
        assert np.allclose([run.q[-1, 0], run.qd[-1, 0]], exact, atol=1e-9)


def test_what_names_a_weld(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "bell.yaml"
    for more, told in (
        ("actuated: [arm]", "actuated[0] = arm: is fixed to what it hangs from"),
        ("start: {arm: 1}", "start.arm = arm: is fixed to what it hangs from"),
        ("springs: [{joint: arm, stiffness: 1, angle: 0}]", "it has no joint"),
    ):
        text = BELL.replace("actuated: [crank]\n", "") + more + "\n"
        file.write_text(text, encoding="utf-8")
        result = robodyn("torque", str(file), "--q", "0.3")
        assert result.code == 2
        assert told in result.err
    for wrong, told in (
        ("damping: 1", "links[3] (arm).damping: is an unknown key"),
        ("joint: welded", "must be revolute or prismatic or fixed"),
        ("from: arm", "hangs from itself: arm -> arm"),
    ):
        text = BELL.replace("joint: fixed, from: {link: bell, at: [0, 0]}", wrong)
        if wrong.startswith("damping"):
            text = text.replace("damping: 1", "joint: fixed, damping: 1")
        elif wrong.startswith("from"):
            text = text.replace("from: arm,\n", "joint: fixed, from: arm,\n", 1)
        file.write_text(text, encoding="utf-8")
        result = robodyn("check", str(file))
        assert result.code == 2
        assert told in result.err
    joined = BELL.replace("[rod, bell]", "[arm, {link: bell, at: [0, 0.1]}]")
    file.write_text(joined, encoding="utf-8")
    result = robodyn("check", str(file))
    assert result.code == 2
    assert "closures[0]" in result.err and "which welds make one" in result.err  # noqa: PT018


def test_numbers_of_a_weld_have_names(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "bell.yaml"
    file.write_text(BELL, encoding="utf-8")
    state = ["--q", "40deg", "--qd", "3", "--qdd", "2"]

    def torque(*more: str) -> float:
        return float(robodyn("torque", str(file), *state, *more).out.splitlines()[1].split(",")[0])

    for name, value in (("m", 0.3), ("r", 0.1), ("I", 0.002), ("angle", -math.radians(80))):
        step = 1e-4
        low, high = (torque("--set", f"links.arm.{name}={value + x}") for x in (-step, step))
        assert low != high
        mech = api.load(file)
        q = api.assemble(mech, [math.radians(40)])
        if name != "angle":
            found = robodyn(
                "terms", str(file), "--derivatives", "--by", f"links.arm.{name}", *state
            )
            assert found.code == 0, found.err
    told = robodyn("torque", str(file), *state, "--set", "links.arm.x=1")
    assert told.code == 2
    assert q.shape == (4,)


def test_a_scene_with_welds_is_written_and_read_again() -> None:
    mech = mechanism(BELL)
    from robodyn.scene.description import from_text

    scene = from_text(BELL, "scene.yaml")
    import json

    again = from_text(json.dumps(plain_scene(scene)), "scene.yaml")
    assert again == scene
    assert [link["name"] for link in plain_scene(scene)["links"]][3] == "arm"
    assert mech.link_names == ("crank", "rod", "bell", "push rod")


def total(mech: api.Mechanism, q: np.ndarray, qd: np.ndarray) -> float:
    return float(api.kinetic_energy(mech, q, qd) + api.potential_energy(mech, q))


def test_a_scene_of_welds_alone_is_refused(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "fixed.yaml"
    file.write_text("links: [{name: w, m: 1, l: 1, r: 0, I: 1, joint: fixed}]\n", encoding="utf-8")
    for command in (["check"], ["torque", "--q", "0"], ["draw", "-o", str(tmp_path / "x.svg")]):
        result = robodyn(command[0], str(file), *command[1:])
        assert result.code == 2
        assert "links: must name at least one link that moves" in result.err


def test_a_weld_without_a_mass_is_named(robodyn, tmp_path: Path) -> None:
    file = tmp_path / "light.yaml"
    file.write_text(
        "links:\n  - {name: a, m: 1, l: 1, r: 0.5, I: 1}\n  - {name: w, l: 1, joint: fixed}\n",
        encoding="utf-8",
    )
    result = robodyn("torque", str(file), "--q", "0.3")
    assert result.code == 2
    assert "links[1] (w): has no mass m, which torque needs" in result.err
