"""`robodyn check`: what was read, the loop's class, and a self-test that can fail."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, TWO_LINK, Outcome
from terminals import on_terminal

import oracles
from robodyn.dynamics import closed_form
from robodyn.dynamics.identities import condition_numbers
from robodyn.mechanics.model_parts import Inertias

Run = Callable[..., Outcome]
ROBOTS = sorted(path.stem for path in (ROOT / "robots").glob("*.yaml"))


@pytest.mark.parametrize("name", ROBOTS)
def test_every_shipped_scene_passes(robodyn: Run, name: str) -> None:
    text = (ROOT / f"robots/{name}.yaml").read_text()
    given = robodyn("check", f"robots/{name}.yaml")
    assert given.code == 0, given.err
    found = given.json
    assert found["passed"] is True
    assert found["states"] >= 100
    assert found["identities"]
    assert max(found["identities"].values()) <= found["bound"] <= 1e-8
    assert (found["closing"] is None) == (found["loops"] == [] and "couplings" not in text)


def test_a_long_chain_passes_at_few_states(robodyn: Run, scene: Callable[[str], Path]) -> None:
    link = "  - {{name: link{}, m: 1, l: 0.5, r: 0.2, I: 0.05}}\n"
    path = scene("gravity: 9.81\nlinks:\n" + "".join(link.format(k) for k in range(400)))
    given = robodyn("check", path)
    assert given.code == 0, given.err
    found = given.json
    assert found["passed"] is True
    assert 1 <= found["states"] <= 10  # M has 160,000 entries a state


def test_a_fault_in_a_long_chain_is_found(
    robodyn: Run, scene: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where matrices are summed along the tree and definite by their factors: one wrong entry."""
    link = "  - {{name: link{}, m: 1, l: 0.5, r: [0.2, 0.1], I: 0.05}}\n"
    path = scene("gravity: 9.81\nlinks:\n" + "".join(link.format(k) for k in range(120)))
    right = Inertias.dense

    def wrong(given: Inertias) -> np.ndarray:
        A: np.ndarray = right(given)
        A[7, 90] *= 1.01
        A[90, 7] *= 1.01
        return A

    monkeypatch.setattr(Inertias, "dense", wrong)
    given = robodyn("check", path)
    assert given.code == 1
    for name in ("KE = 1/2 qd^T M qd", "C qd = Mdot qd - dKE/dq"):
        assert (given.json["identities"][name] > 1e-9) == (name[0] == "K")


def test_condition_numbers_of_large_matrices() -> None:
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(closed_form.LONG, closed_form.LONG)))[0]
    wide = Q * np.geomspace(1e-7, 3.0, len(Q)) @ Q.T
    singular = Q * np.r_[0.0, np.ones(len(Q) - 1)] @ Q.T
    found = condition_numbers(np.array([wide, np.eye(len(Q))]))
    np.testing.assert_allclose(found, [3e7, 1.0], rtol=1e-3)
    assert condition_numbers(singular[None])[0] > 1e14


@pytest.mark.parametrize(
    ("name", "mobility", "actuated", "loops"),
    [
        ("2r", 2, ["upper arm", "forearm"], []),
        ("3r", 3, ["upper arm", "forearm", "hand"], []),
        ("pendulum", 1, ["rod"], []),
        ("four-bar", 1, ["crank"], ["crank-rocker"]),
        ("parallelogram", 1, ["crank"], ["change point"]),
        ("slider-crank", 1, ["crank"], ["slider-crank"]),
        ("five-bar", 2, ["left crank", "right crank"], ["5"]),
        ("watt-six-bar", 1, ["crank"], ["crank-rocker", "6"]),
        ("stephenson-six-bar", 1, ["crank"], ["crank-rocker", "5"]),
    ],
)
def test_mobility_and_loops(
    robodyn: Run, name: str, mobility: int, actuated: list[str], loops: list[str]
) -> None:
    found = robodyn("check", f"robots/{name}.yaml").json
    assert (found["mobility"], found["actuated"]) == (mobility, actuated)
    assert len(found["loops"]) == len(loops)
    for kind, word in zip(found["loops"], loops, strict=True):
        assert word in kind


def test_what_the_file_says_is_not_repeated(robodyn: Run) -> None:
    """What is shown is computed, or a default that the file may leave out."""
    names = {"name", "actuated", "loops", "mobility", "cond_M", "cond_Psi", "states", "closing"}
    names |= {"start", "identities", "singular", "bound", "passed"}
    for name in ("slider-crank", "spring-slider-crank", "geared-five-bar"):
        found = robodyn("check", f"robots/{name}.yaml").json
        assert found.keys() == names


GRASHOF = [
    # crank, coupler, rocker, ground: the shortest link decides, if the chain is Grashof's at all
    ((0.35, 0.95, 0.80, 1.10), "crank-rocker"),
    ((0.80, 0.95, 0.35, 1.10), "crank-rocker"),
    ((0.90, 0.95, 0.80, 0.30), "double-crank"),
    ((0.90, 0.30, 0.80, 1.10), "double-rocker"),
    ((0.70, 0.60, 0.65, 1.40), "triple-rocker"),
    ((0.30, 0.70, 0.30, 0.70), "change point"),
    ((0.40, 0.90, 0.70, 0.60), "change point"),
]


def shape(four_bar_text: str, lengths: tuple[float, ...]) -> str:
    crank, coupler, rocker, ground = lengths
    for old, new in (
        ("l: 0.35", f"l: {crank}"),
        ("l: 0.95", f"l: {coupler}"),
        ("l: 0.80", f"l: {rocker}"),
        ("[1.1, 0.0]", f"[0.0, {ground}]"),
    ):
        assert four_bar_text.count(old) == 1
        four_bar_text = four_bar_text.replace(old, new)
    return four_bar_text


@pytest.mark.parametrize(("lengths", "kind"), GRASHOF)
def test_grashof(
    robodyn: Run,
    scene: Callable[[str], Path],
    four_bar_text: str,
    lengths: tuple[float, ...],
    kind: str,
) -> None:
    given = robodyn("check", scene(shape(four_bar_text, lengths)))
    assert given.json["loops"][0].startswith(kind)
    assert given.json["mobility"] == 1
    assert given.code == 0, given.err
    share = given.json["closing"]
    low, high = abs(lengths[1] - lengths[2]), lengths[1] + lengths[2]
    # the crank's tip is at this distance from the rocker's pivot, the dyad spans low to high
    angles = np.linspace(-math.pi, math.pi, 10_001)
    distance = np.abs(lengths[0] * np.exp(1j * angles) - lengths[3])
    assert share == pytest.approx(((distance > low) & (distance < high)).mean(), abs=0.08)


@pytest.mark.parametrize(("rod", "word"), [(0.32, "turns"), (0.11, "rocks")])
def test_a_slider_crank_turns_or_rocks(
    robodyn: Run, scene: Callable[[str], Path], rod: float, word: str
) -> None:
    """Crank 0.10 and offset 0.02: a rod of 0.12 is the shortest that lets the crank turn."""
    text = (ROOT / "robots/slider-crank.yaml").read_text()
    given = robodyn("check", scene(text.replace("l: 0.32", f"l: {rod}")))
    assert word in given.json["loops"][0]


def test_conditioning_of_m(robodyn: Run) -> None:
    """Over all q2 (M knows no q1) the condition number of the lecture's M spans this range."""
    conditions = [
        np.linalg.cond(oracles.two_link_terms(TWO_LINK, [0, q2], [0, 0])[0])
        for q2 in np.linspace(0, math.pi, 1000)
    ]
    low, high = robodyn("check", "robots/2r.yaml").json["cond_M"]
    assert low == pytest.approx(min(conditions), rel=0.05)
    assert high == pytest.approx(max(conditions), rel=0.05)


def test_conditioning_of_psi(robodyn: Run) -> None:
    conditions = []
    for theta1 in np.linspace(-math.pi, math.pi, 1000):
        q = oracles.four_bar_position(FOUR_BAR, theta1)
        Psi = oracles.four_bar_terms(FOUR_BAR, q, [0, 0, 0]).Psi
        conditions.append(np.linalg.cond(Psi))
    low, high = robodyn("check", "robots/four-bar.yaml").json["cond_Psi"]
    assert low == pytest.approx(min(conditions), rel=0.05)
    assert high == pytest.approx(max(conditions), rel=0.05)


def test_a_singular_m_leaves_the_json_strict(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    """Infinity is no JSON; a massless coupler makes M singular, and the mechanism works."""
    text = four_bar_text.replace("m: 1.3, l: 0.95, r: 0.45, I: 0.102", "m: 0, l: 0.95, r: 0, I: 0")
    given = robodyn("check", scene(text))
    assert given.code == 0, given.err
    assert given.json["passed"] is True
    assert given.json["cond_M"] is None or None in given.json["cond_M"]


def test_closures_that_depend_on_one_another_pass(robodyn: Run) -> None:
    """Every sampled state is closed to rounding: the redundant row must not count as a fourth."""
    given = robodyn("check", "tests/hard_cases/third-crank.yaml")
    assert given.code == 0, given.err
    found = given.json
    assert (found["mobility"], found["passed"]) == (1, True)
    assert found["states"] >= 100
    assert max(found["identities"].values()) <= 1e-12
    assert given.err.splitlines() == [
        "Warning: the closures depend on one another: the pin forces are not unique "
        "(least norm given)",
        "Note: 1 of the closures' equations are redundant",
    ]


def test_a_massless_last_link_is_explained(robodyn: Run) -> None:
    """M is singular everywhere: no acceleration, and the rest of the report all the same."""
    scene = "tests/hard_cases/massless-tip.yaml"
    given = robodyn("check", scene).fails(1, "M is singular", scene, "wire", "give it")
    assert "does not hold" not in given.err
    found = given.json
    assert found["passed"] is False
    assert "link wire" in found["singular"]
    unknown = [name for name, residual in found["identities"].items() if residual is None]
    assert [name[:5] for name in unknown] == ["M qdd", "power"]
    known = [x for x in found["identities"].values() if x is not None]
    assert len(known) == 7
    assert max(known) <= found["bound"]
    table = robodyn("check", scene, "--format", "table").fails(1, "wire").out
    assert table.count("M is singular") == 2
    assert table.count("holds") == 7


def test_the_identities_are_those_of_the_design(robodyn: Run) -> None:
    told = " ".join(robodyn("check", "robots/four-bar.yaml").json["identities"])
    for part in ("M = M^T", "KE", "2C skew", "G = dPE/dq", "Psi", "Psidot", "power", "lambda"):
        assert part in told


def test_a_wrong_coriolis_matrix_is_found_out(
    robodyn: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The self-test must be able to fail: here C is made 1 % too large."""
    from robodyn.dynamics import closed_form

    right = closed_form.coriolis_matrix
    monkeypatch.setattr(closed_form, "coriolis_matrix", lambda *given: 1.01 * right(*given))
    given = robodyn("check", "robots/2r.yaml").fails(1, "Mdot - 2C")
    assert given.json["passed"] is False
    assert given.json["identities"]["Mdot - 2C skew-symmetric"] > 1e-4


def test_the_same_scene_gives_the_same_report(robodyn: Run) -> None:
    first, second = (robodyn("check", "robots/five-bar.yaml").out for _ in range(2))
    assert first == second


def test_the_table(robodyn: Run) -> None:
    given = robodyn("check", "robots/four-bar.yaml", "--format", "table").succeeds().out
    for word in (
        *(
            "crank-rocker four-bar",
            "actuated",
            "mobility",
            "Grashof",
            "condition of M",
            "condition of Psi",
            "residual",
            "holds",
        ),
    ):
        assert word in given
    assert "FAILS" not in given
    assert "\x1b" not in given


def test_the_table_fits_a_terminal() -> None:
    lines = on_terminal("check", "robots/2r.yaml").splitlines()
    assert max(len(re.sub(r"\x1b\[[0-9;]*m", "", line)) for line in lines) <= 80
    assert any(re.fullmatch(r" *actuated +upper arm, forearm", line) for line in lines)


@pytest.mark.parametrize("name", ["[red]arm", "[/red]arm", "[/]", "[bold]", ":smile:"])
def test_names_are_shown_as_they_are(robodyn: Run, scene: Callable[[str], Path], name: str) -> None:
    path = scene(
        f"name: '{name}'\nlinks:\n"
        f"  - {{name: '{name}', m: 1, l: 1, r: 0.5, I: 0.1}}\n"
        "  - {name: b, m: 1, l: 1, r: 0.5, I: 0.1}\n"
    )
    table = robodyn("check", path, "--format", "table").succeeds().out
    assert table.splitlines()[0].strip() == name
    assert re.search(rf"actuated +{re.escape(name)}, b\n", table)


def test_out(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "check.json"
    assert robodyn("check", "robots/2r.yaml", "-o", file).succeeds().out == ""
    assert file.read_text() == robodyn("check", "robots/2r.yaml").succeeds().out


def test_a_loop_that_never_closes_does_not_pass(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    path = scene(four_bar_text.replace("[1.1, 0.0]", "[11, 0.0]"))
    given = robodyn("check", path)
    assert given.json["closing"] == 0.0
    assert given.json["passed"] is not True
    given.fails(1, "clos")


def test_more_actuators_than_freedoms_leave_the_mobility(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    """Random angles of crank and rocker do not fit each other; there is a freedom all the same."""
    path = scene(four_bar_text.replace("actuated: [crank]", "actuated: [crank, rocker]"))
    assert robodyn("check", path).json["mobility"] == 1


BARE = "m: 1, l: 1, r: 0.5, I: 0.1"
POLE_BESIDE_A_COUPLING = f"""gravity: 9.81
links:
  - {{name: cart, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0}}
  - {{name: wheel, m: 1, l: 0.1, r: 0, I: 0.01}}
  - {{name: pole, {BARE}, from: cart}}
couplings: ["q2 = -10*q1"]
actuated: [cart]
"""
LOOP_ON_A_CART = """gravity: 9.81
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0}
  - {name: crank, m: 1, l: 0.35, r: 0.15, I: 0.01}
  - {name: coupler, m: 1, l: 0.95, r: 0.5, I: 0.1}
  - {name: rocker, m: 1, l: 0.8, r: 0.4, I: 0.1, from: "cart@1.1,0"}
closures: [[coupler, rocker]]
actuated: [crank]
"""
FIVE_LINKS = f"""gravity: 9.81
links: [{", ".join(f"{{name: {x}, {BARE}}}" for x in "abcd")}]
closures: [[d, [1.5, 0.5]]]
"""
TWO_LOOPS = f"""gravity: 9.81
links: [{", ".join(f"{{name: {x}, {BARE}}}" for x in "abcde")}]
closures: [[c, [1.5, 0.5]], [e, [0.5, -0.5]]]
actuated: [c]
"""


@pytest.mark.parametrize(
    ("text", "mobility"),
    [(POLE_BESIDE_A_COUPLING, 2), (LOOP_ON_A_CART, 2), (FIVE_LINKS, 2), (TWO_LOOPS, 1)],
)
def test_joints_that_nothing_drives_are_drawn_at_random(
    robodyn: Run, scene: Callable[[str], Path], text: str, mobility: int
) -> None:
    """Mobility by Gruebler: joints less two a pin and one a coupling."""
    found = robodyn("check", scene(text)).succeeds().json
    assert (found["mobility"], found["passed"]) == (mobility, True)
    assert found["states"] > 20


def test_all_faults_of_a_scene_are_told_one_a_line(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    path = scene("gravty: 9.81\nlinks:\n  - {name: a, m: -1, l: yes, r: [1], I: nan}\n")
    failed = robodyn("check", path).fails(2)
    assert failed.out == ""
    assert failed.err.splitlines() == [
        f"Error: {path}:1: gravty: is an unknown key; did you mean gravity?",
        f"       {path}:3: links[0] (a).m = -1: must be >= 0",
        f"       {path}:3: links[0] (a).l = yes: must be a number: yes is no unit or function",
        f"       {path}:3: links[0] (a).r = 1 values: must be two numbers, [x, y]",
        f"       {path}:3: links[0] (a).I = nan: must be a number",
    ]


@pytest.mark.parametrize("more", ["damping: 1e308", "friction: {torque: 1e308, speed: 0.01}"])
def test_terms_beyond_all_numbers_are_told_quietly(robodyn, scene, more):
    """Every state's motion is doubtful then, and there is no closure whose forces could be."""
    path = scene(f"links: [{{name: a, m: 1, l: 1, r: 0.5, I: 0.1, {more}}}]")
    given = robodyn("check", path).fails(1, "the result is not finite", "the scene is too large")
    assert "encountered" not in given.err


def test_lengths_whose_squares_are_no_numbers(robodyn, scene, four_bar_text):
    path = scene(four_bar_text.replace("l: 0.95", "l: 1e-320"))
    given = robodyn("check", path)
    assert given.code in (0, 1)
    assert "defect" not in given.err
    assert "encountered" not in given.err


def test_chains_with_more_closures_than_joints(robodyn, scene):
    """Every tip of a chain pinned to one point: closes nowhere, and is not searched for long."""
    for n, told in ((30, "close at none"), (300, "takes too long")):
        links = "".join(f"  - {{name: a{k}, m: 1, l: 1, r: 0.5, I: 0.1}}\n" for k in range(n))
        pins = "".join(f"  - [a{k}, [0.5, 0.5]]\n" for k in range(n))
        given = robodyn("check", scene(f"links:\n{links}closures:\n{pins}"))
        assert told in given.err
        assert given.code == (1 if n == 30 else 0)


@pytest.mark.parametrize(
    ("right", "told"),
    [
        ("0.5", True),
        ("0.5 + q1", False),
        ("0.5 rad + 0 rad/s t", True),
        ("0.5 rad + 0.1 rad/s t", False),
    ],
)
def test_a_coupling_that_is_constant_is_told_of_welds(
    robodyn: Run, scene: Callable[[str], Path], right: str, told: bool
) -> None:
    links = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 1}, {name: b, m: 1, l: 1, r: 0.5, I: 1}]\n"
    given = robodyn("check", scene(links + f'couplings: ["q2 = {right}"]\n'))
    assert given.code == 0
    note = "Note: a coupling keeps q2 (b) constant: `joint: fixed` with an `angle` says that"
    assert (note in given.err) is told


def test_friction_by_forces_is_shown_a_line_a_contact(robodyn: Run) -> None:
    told = robodyn("check", "robots/shaper.yaml", "--format", "table").out
    lines = [" ".join(line.split()) for line in told.splitlines()]
    assert "friction of crank coefficient 0.08, radius 0.025 m, speed 0.05 rad/s" in lines
    assert "friction of loop 1 coefficient 0.12, speed 0.005 m/s" in lines
    found = robodyn("check", "robots/shaper.yaml").json["friction"]
    assert [(x["joint"], x["loop"]) for x in found] == [
        ("crank", None), ("lever", None), ("link", None), (None, 1), (None, 2)
    ]  # fmt: skip
    assert found[0]["radius"] == 0.025
    assert found[3]["radius"] is None
