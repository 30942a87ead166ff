"""`robodyn torque` against the lecture's formulas, Newton-Euler and the four-bar's reduction."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR, RP_ARM, TWO_LINK, Outcome, relative_error, text
from named_case import case

import oracles
from robodyn.cli import REMOVED_OPTIONS

Run = Callable[..., Outcome]
DEG = math.pi / 180

ARM = "robots/2r.yaml"


def motion(seed: int, n: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.uniform(-3, 3, n) for _ in range(3)]


def closed_motion(
    theta1: float, rate: float, acceleration: float, branch: str = "open"
) -> list[np.ndarray]:
    """q, qd, qdd of the four-bar of robots/."""
    q = oracles.four_bar_position(FOUR_BAR, theta1, branch)
    k, k_prime = oracles.four_bar_coefficients(FOUR_BAR, q)
    return [q, k * rate, k * acceleration + k_prime * rate**2]


# One state


def test_the_example_of_the_readme(robodyn: Run) -> None:
    vectors = ["--q", "30deg,45deg", "--qd", "1,0.5", "--qdd", "0,0"]
    given = robodyn("torque", "robots/2r.yaml", *vectors)
    expected = oracles.two_link_torque(TWO_LINK, [30 * DEG, 45 * DEG], [1, 0.5], [0, 0])
    given.succeeds()
    assert given.out.splitlines()[0] == "tau1,tau2"
    assert given.out.count("\n") == 2
    assert relative_error(given.has("tau1", "tau2"), expected) < 1e-13


@pytest.mark.parametrize("seed", range(4))
def test_a_2r_arm_moves_as_equation_27_says(robodyn: Run, seed: int) -> None:
    q, qd, qdd = motion(seed, 2)
    given = robodyn(
        *("torque", "robots/2r.yaml", "--q", text(q), "--qd", text(qd), "--qdd", text(qdd))
    )
    expected = oracles.two_link_torque(TWO_LINK, q, qd, qdd)
    assert relative_error(given.succeeds().has("tau1", "tau2"), expected) < 1e-13


def test_rates_left_out_are_zero(robodyn: Run) -> None:
    gravity = oracles.two_link_terms(TWO_LINK, [0.4, -1.1], [0, 0])[2]
    given = robodyn("torque", "robots/2r.yaml", "--q", "0.4,-1.1").succeeds()
    assert relative_error(given.has("tau1", "tau2"), gravity) < 1e-13
    zeros = robodyn("torque", "robots/2r.yaml", "--q", "0.4,-1.1", "--qd", "0 0", "--qdd", "0,0")
    assert zeros.out == given.out


@pytest.mark.parametrize(
    ("written", "q"),
    [
        ("-0.5,-1", (-0.5, -1)),
        ("-0.5 -1", (-0.5, -1)),
        ("-30deg,-pi/4", (-30 * DEG, -math.pi / 4)),
        ("90deg, 2*pi/3", (90 * DEG, 2 * math.pi / 3)),
    ],
)
def test_vectors_as_people_write_them(robodyn: Run, written: str, q: tuple[float, float]) -> None:
    expected = oracles.two_link_torque(TWO_LINK, q, [0, 0], [0, 0])
    for arguments in (("--q", written), (f"--q={written}",)):
        given = robodyn("torque", "robots/2r.yaml", *arguments).succeeds()
        assert relative_error(given.has("tau1", "tau2"), expected) < 1e-13


TREE = """\
gravity: [1.3, -9.2]
links:
  - {name: hand, m: 0.4, l: 0.3, r: [0.14, 0.02], I: 0.003, from: arm}
  - {name: base, m: 2.1, l: 0.5, r: [0.2, -0.1], I: 0.07, from: [0.3, -0.2]}
  - {name: arm, m: 1.1, l: 0.6, r: 0.27, I: 0.04, from: {link: base, at: [0.4, 0.2]}, damping: 0.3}
  - {name: mast, m: 0.9, l: 0.7, r: 0.3, I: 0.05, from: base, payload: 0.8, damping: 0.1}
"""


def tree_of_the_oracle() -> tuple[list[dict[str, object]], list[int]]:
    """TREE with parents first and the payload made part of its link; its order of joints."""
    m, payload, r, l = 0.9, 0.8, 0.3, 0.7
    centre = (m * r + payload * l) / (m + payload)
    inertia = 0.05 + m * (r - centre) ** 2 + payload * (l - centre) ** 2
    base = {"m": 2.1, "r": 0.2 - 0.1j, "I": 0.07, "parent": None, "at": 0.3 - 0.2j}
    arm = {"m": 1.1, "r": 0.27, "I": 0.04, "parent": 0, "at": 0.4 + 0.2j}
    mast = {"m": m + payload, "r": centre, "I": inertia, "parent": 0, "at": 0.5 + 0j}
    hand = {"m": 0.4, "r": 0.14 + 0.02j, "I": 0.003, "parent": 1, "at": 0.6 + 0j}
    return [base, arm, mast, hand], [1, 2, 3, 0]


@pytest.mark.parametrize("batch", [False, True])
def test_a_tree_in_any_order_with_payload_and_damping(
    robodyn: Run, scene: Callable[[str], Path], batch: bool
) -> None:
    q, qd, qdd = motion(7, 4)
    tree, order = tree_of_the_oracle()
    moved = [vector[order] for vector in (q, qd, qdd)]
    expected = np.empty(4)
    expected[order] = oracles.newton_euler(tree, 1.3 - 9.2j, *moved)
    expected += np.array([0, 0, 0.3, 0.1]) * qd
    if batch:
        names = ",".join(f"{name}{k}" for name in ("q", "qd", "qdd") for k in (1, 2, 3, 4))
        given = robodyn("torque", scene(TREE), "-", stdin=f"{names}\n{text([q, qd, qdd])}\n")
    else:
        given = robodyn(
            *("torque", scene(TREE), "--q", text(q), "--qd", text(qd), "--qdd", text(qdd))
        )
    given.succeeds()
    assert relative_error(given.has("tau1", "tau2", "tau3", "tau4"), expected) < 1e-13


def test_a_long_chain_is_soon_done(process: Run, scene: Callable[[str], Path]) -> None:
    """The process fixture stops waiting after a minute; 300 links are 0.1 s of arithmetic."""
    n = 300
    links = [f"  - {{name: k{i}, m: 1.5, l: 0.8, r: 0.36, I: 0.082}}" for i in range(n)]
    path = scene("gravity: 9.81\nlinks:\n" + "\n".join(links) + "\n")
    q, qd, qdd = (vector / n for vector in motion(3, n))
    chain = [
        {
            "m": 1.5,
            "r": 0.36,
            "I": 0.082,
            "parent": i - 1 if i else None,
            "at": 0.8 + 0j if i else 0j,
        }
        for i in range(n)
    ]
    given = process("torque", path, "--q", text(q), "--qd", text(qd), "--qdd", text(qdd))
    given.succeeds()
    expected = oracles.newton_euler(chain, -9.81j, q, qd, qdd)
    assert relative_error(list(given.row.values()), expected) < 1e-11
    assert given.seconds < 3


# Closed mechanisms


@pytest.mark.parametrize("theta1", [0.3, math.pi / 3, 2.0, -1.4])
@pytest.mark.parametrize("whole", [False, True])
def test_a_four_bar_needs_this_crank_torque_and_pin_force(
    robodyn: Run, theta1: float, whole: bool
) -> None:
    q, qd, qdd = closed_motion(theta1, 5.0, -7.0)
    given = [text(x) if whole else text(x[:1]) for x in (q, qd, qdd)]
    found = robodyn(
        *("torque", "robots/four-bar.yaml", "--q", given[0], "--qd", given[1], "--qdd", given[2])
    ).succeeds()
    tau, force = oracles.four_bar_torque(FOUR_BAR, q, qd, qdd)
    assert found.out.splitlines()[0] == "tau1,fx1,fy1"
    assert relative_error(found.has("tau1", "fx1", "fy1"), [tau, *force]) < 1e-12


def test_all_joints_may_lie_on_the_other_branch(robodyn: Run) -> None:
    q, qd, qdd = closed_motion(1.0, 2.0, 1.0, "crossed")
    found = robodyn(
        *("torque", "robots/four-bar.yaml", "--q", text(q), "--qd", text(qd), "--qdd", text(qdd))
    ).succeeds()
    tau, force = oracles.four_bar_torque(FOUR_BAR, q, qd, qdd)
    assert relative_error(found.has("tau1", "fx1", "fy1"), [tau, *force]) < 1e-12


def test_a_torque_column_has_the_number_of_its_joint(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    """Driven at the rocker: torque times rate is the crank's torque times the crank's rate."""
    path = scene(four_bar_text.replace("actuated: [crank]", "actuated: [rocker]"))
    q, qd, qdd = closed_motion(1.0, 2.0, -3.0)
    found = robodyn("torque", path, "--q", text(q), "--qd", text(qd), "--qdd", text(qdd))
    assert found.succeeds().out.splitlines()[0] == "tau3,fx1,fy1"
    crank, _ = oracles.four_bar_torque(FOUR_BAR, q, qd, qdd)
    assert found.row["tau3"] == pytest.approx(crank * qd[0] / qd[2], rel=1e-11)


def test_the_pin_force_acts_on_the_side_named_first(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    one = robodyn("torque", "robots/four-bar.yaml", "--q", "60deg", "--qd", "5").succeeds()
    swapped = four_bar_text.replace("[coupler, rocker]", "[rocker, coupler]")
    # the pin lies on the other side of the line from the rocker's joint to the coupler's
    other = scene(swapped.replace("assembly: open", "assembly: crossed"))
    two = robodyn("torque", other, "--q", "60deg", "--qd", "5").succeeds()
    expected = np.array(one.has("tau1", "fx1", "fy1")) * [1, -1, -1]
    assert relative_error(two.has("tau1", "fx1", "fy1"), expected) < 1e-12


def test_a_slider_pushes_across_its_line_only(robodyn: Run) -> None:
    """Offset slider-crank; the piston is the rod's payload. Balance by Newton-Euler."""
    l1, l2, offset, theta, w = 0.10, 0.32, 0.02, 50 * DEG, 10.0
    s = (offset - l1 * math.sin(theta)) / l2  # the rod's absolute angle, then its rates
    c = math.sqrt(1 - s**2)
    w2 = -l1 * math.cos(theta) * w / (l2 * c)
    w2_dot = (l1 * math.sin(theta) * w**2 + l2 * s * w2**2) / (l2 * c)
    q, qd, qdd = [theta, math.atan2(s, c) - theta], [w, w2 - w], [0.0, w2_dot]
    m, payload, r = 0.5, 0.7, 0.14
    centre = (m * r + payload * l2) / (m + payload)
    inertia = 0.0048 + m * (r - centre) ** 2 + payload * (l2 - centre) ** 2
    tree = [
        {"m": 0.8, "r": 0.045, "I": 0.0009, "parent": None, "at": 0j},
        {"m": m + payload, "r": centre, "I": inertia, "parent": 0, "at": l1 + 0j},
    ]
    load = oracles.newton_euler(tree, -9.81j, q, qd, qdd)
    fy = load[1] / (l2 * c)  # the only force with a moment about the rod's joint
    tau = load[0] - fy * (l1 * math.cos(theta) + l2 * c)
    found = robodyn("torque", "robots/slider-crank.yaml", "--q", "50deg", "--qd", "10").succeeds()
    assert relative_error(found.has("tau1", "fx1", "fy1"), [tau, 0.0, fy]) < 1e-12


def test_a_five_bar_has_two_torques(robodyn: Run) -> None:
    """Held still, both by Lagrange's terms: freedoms^T (S^T tau - G) = 0."""
    tree = [
        {"m": 0.5, "r": 0.13, "I": 0.0044, "parent": None, "at": 0j},
        {"m": 0.85, "r": 0.33, "I": 0.037, "parent": 0, "at": 0.3 + 0j},
        {"m": 0.4, "r": 0.12, "I": 0.0028, "parent": None, "at": 0.7 + 0j},
        {"m": 0.75, "r": 0.31, "I": 0.029, "parent": 2, "at": 0.26 + 0j},
    ]
    terms = oracles.sympy_terms(tree, -9.81j, [((1, 0.68 + 0j), (3, 0.64 + 0j))])
    found = robodyn("terms", "robots/five-bar.yaml", "--q", "120deg,60deg").succeeds().json
    q = found["q"]  # of a closed configuration, which the next line makes sure of
    known = terms(q, np.zeros(4))
    assert np.abs(known.gap).max() < 1e-14
    columns = np.linalg.solve(
        np.hstack([np.eye(4)[:, [0, 2]], known.Psi.T]), known.G
    )  # tau1, tau3, lambda
    held = robodyn("torque", "robots/five-bar.yaml", "--q", "120deg,60deg").succeeds()
    assert held.out.splitlines()[0] == "tau1,tau3,fx1,fy1"
    assert relative_error(held.has("tau1", "tau3", "fx1", "fy1"), columns) < 1e-12


# Batches

STATES = "q1,q2,qd1,qd2,qdd1,qdd2"


def table(rows: np.ndarray, names: str = STATES) -> str:
    return "\n".join([names, *map(text, rows)]) + "\n"


@pytest.mark.parametrize("count", [1, 3, 1000])
def test_a_batch_is_row_by_row_what_the_formula_says(robodyn: Run, count: int) -> None:
    rows = np.random.default_rng(count).uniform(-3, 3, (count, 6))
    given = robodyn("torque", "robots/2r.yaml", "-", stdin=table(rows)).succeeds()
    found = np.transpose([given.column("tau1"), given.column("tau2")])
    expected = [oracles.two_link_torque(TWO_LINK, x[:2], x[2:4], x[4:]) for x in rows]
    assert found.shape == (count, 2)
    assert relative_error(found, expected) < 1e-13


@pytest.mark.parametrize("count", [2, 600])
def test_a_batch_of_a_four_bar(robodyn: Run, count: int) -> None:
    angles, rates = np.random.default_rng(1).uniform(-3, 3, (2, count))
    moves = [closed_motion(*pair, 0.0) for pair in zip(angles, rates, strict=True)]
    expected = [np.hstack(oracles.four_bar_torque(FOUR_BAR, *move)) for move in moves]
    stdin = table(np.transpose([rates, angles]), "qd1,q1")
    given = robodyn("torque", "robots/four-bar.yaml", "-", stdin=stdin).succeeds()
    found = np.transpose([given.column(name) for name in ("tau1", "fx1", "fy1")])
    assert relative_error(found, expected) < 1e-11


def test_columns_in_any_order_and_unknown_ones_pass_through(robodyn: Run) -> None:
    stdin = 'note,q2,t,q1,é\n"a, ""b""",0.7,00.50,-0.2, x \n,0.1,,0.3,\n'
    given = robodyn("torque", "robots/2r.yaml", "-", stdin=stdin).succeeds()
    expected = [
        oracles.two_link_torque(TWO_LINK, q, [0, 0], [0, 0]) for q in ([-0.2, 0.7], [0.3, 0.1])
    ]
    lines, source = given.out.splitlines(), stdin.splitlines()
    assert lines[0] == source[0] + ",tau1,tau2"
    for line, came, tau in zip(lines[1:], source[1:], expected, strict=True):
        assert line.startswith(came + ",")  # untouched to the last character
        found = [float(field) for field in line.removeprefix(came + ",").split(",")]
        assert relative_error(found, tau) < 1e-13


def test_an_option_stands_for_its_columns_in_every_row(robodyn: Run) -> None:
    given = robodyn(
        "torque", "robots/2r.yaml", "-", "--qd", "1,-2", stdin="q1,q2\n0.1,0.2\n0.3,0.4\n"
    )
    expected = [
        oracles.two_link_torque(TWO_LINK, q, [1, -2], [0, 0]) for q in ([0.1, 0.2], [0.3, 0.4])
    ]
    found = np.transpose([given.succeeds().column("tau1"), given.column("tau2")])
    assert relative_error(found, expected) < 1e-13


def test_torques_that_the_table_has_already_are_replaced_in_place(robodyn: Run) -> None:
    given = robodyn("torque", "robots/2r.yaml", "-", stdin="tau2,q1,q2\n99,0.1,0.2\n").replaces()
    assert given.out.splitlines()[0] == "tau2,q1,q2,tau1"
    expected = oracles.two_link_torque(TWO_LINK, [0.1, 0.2], [0, 0], [0, 0])
    assert relative_error(given.has("tau1", "tau2"), expected) < 1e-13


def test_what_goes_out_comes_in_again(robodyn: Run, tmp_path: Path) -> None:
    """accel(torque) gives the accelerations back, through two tables."""
    rows = np.random.default_rng(5).uniform(-3, 3, (50, 6))
    middle = tmp_path / "torques.csv"
    robodyn("torque", "robots/2r.yaml", "-", "-o", middle, stdin=table(rows)).succeeds()
    back = robodyn("accel", "robots/2r.yaml", middle).replaces()
    found = np.transpose([back.column("qdd1"), back.column("qdd2")])
    assert relative_error(found, rows[:, 4:]) < 1e-11


def test_a_header_alone_is_a_table_without_rows(robodyn: Run) -> None:
    given = robodyn("torque", "robots/2r.yaml", "-", stdin="q1,q2\n").succeeds()
    assert given.out == "q1,q2,tau1,tau2\n"
    assert robodyn("torque", "robots/2r.yaml", "-", "--format", "json", stdin="q1,q2").json == []


# Formats and files


def test_json(robodyn: Run) -> None:
    stdin = "name,q1,q2\nx,0.1,0.2\ny,0.3,0.4\n"
    given = robodyn("torque", "robots/2r.yaml", "-", "--format", "json", stdin=stdin).succeeds()
    expected = oracles.two_link_torque(TWO_LINK, [0.3, 0.4], [0, 0], [0, 0])
    first, second = given.json
    assert (first["name"], second["name"], second["q1"]) == ("x", "y", 0.3)
    assert relative_error([second["tau1"], second["tau2"]], expected) < 1e-13


def test_a_joint_that_slides_takes_a_force(robodyn: Run, scene: Callable[[str], Path]) -> None:
    path = scene(RP_ARM)
    given = robodyn("torque", path, "--q", "1,0.2", "--format", "table").succeeds()
    assert given.out.split("\n")[1].split("  ")[1:] == ["tau1 [N m]", " tau2 [N]"]
    rows = "q1,q2,qd1,qd2,note\n1,0.2,0,0.5,x\n"
    head = robodyn("torque", path, "-", "--format", "table", stdin=rows).succeeds().out
    for part in ("q1 [rad]", "q2 [m]", "qd2 [m/s]", "note", "tau1 [N m]", "tau2 [N] "):
        assert part in head.replace("\n", " \n")


def test_a_table_has_units_and_no_colours_in_a_pipe(robodyn: Run) -> None:
    given = robodyn("torque", "robots/2r.yaml", "--q", "1,2", "--format", "table").succeeds()
    assert "tau1 [N m]" in given.out
    assert f"{oracles.two_link_torque(TWO_LINK, [1, 2], [0, 0], [0, 0])[0]:.6g}" in given.out
    assert "\x1b" not in given.out


@pytest.mark.parametrize("format", ["csv", "json", "table"])
def test_out_writes_what_stdout_would_have(robodyn: Run, tmp_path: Path, format: str) -> None:
    arguments = ["torque", "robots/2r.yaml", "--q", "1,2", "--format", format]
    plain = robodyn(*arguments).succeeds()
    file = tmp_path / "new"
    assert robodyn(*arguments, "--out", file).succeeds().out == ""
    assert file.read_text() == plain.out
    assert robodyn(*arguments, "--out", "-").succeeds().out == plain.out


# Wrong input: exit code 2, nothing on stdout


BAD_ROWS = [
    ("3,x", ["q2 = x", "finite number"]),
    ("3,", ["q2", "empty"]),
    ("3,nan", ["q2 = nan", "finite number"]),
    ("3,-inf", ["q2 = -inf", "finite number"]),
    ("3,1e999", ["q2 = 1e999", "finite number"]),
    ("3,30deg", ["q2 = 30deg", "finite number"]),
    ("3,1_0", ["q2 = 1_0", "finite number"]),
    ("3", ["number of fields = 1", "2"]),
    ("3,4,5", ["number of fields = 3", "2"]),
    ('3,"4"5', ["quot"]),
]


def test_a_bad_row_names_its_line_after_the_rows_before_it(robodyn: Run) -> None:
    for row, parts in BAD_ROWS:
        for before in [0, 2, 500]:
            with case(row, parts, before):
                stdin = "q1,q2\n" + "1,2\n" * before + f"{row}\n5,6\n"
                failed = robodyn("torque", "robots/2r.yaml", "-", stdin=stdin)
                failed.fails(2, f"stdin: line {before + 2}: ", *parts)
                assert failed.out.count("\n") == 1 + before
                good = robodyn("torque", "robots/2r.yaml", "-", stdin="q1,q2\n" + "1,2\n" * before)
                assert failed.out == good.out


def test_lines_are_counted_as_an_editor_does(robodyn: Run) -> None:
    stdin = 'note,q1,q2\r\n\r\n"two\r\nlines",1,2\r\n\r\nx,1,y\r\n'
    robodyn("torque", "robots/2r.yaml", "-", stdin=stdin).fails(2, "line 6: q2 = y")


def test_json_cut_short_ends_its_line(robodyn: Run) -> None:
    """So that the message does not hang on the last row where both go to a terminal."""
    stdin = "q1,q2\n1,2\n3,x\n"
    failed = robodyn("torque", "robots/2r.yaml", "-", "--format", "json", stdin=stdin)
    failed.fails(2, "line 3: q2 = x")
    assert failed.out.endswith("\n")
    assert '"tau1"' in failed.out


@pytest.mark.parametrize(
    ("q", "qd", "qdd", "what"),
    [
        ((0, 1e-3, 0), (0, 0, 0), (0, 0, 0), "position"),
        ((0, 0, 0), (0, 1e-3, 0), (0, 0, 0), "velocity"),
        ((0, 0, 0), (0, 0, 0), (0, 0, 1e-2), "acceleration"),
    ],
)
def test_an_open_loop_tells_the_size_of_its_gap(
    robodyn: Run, q: tuple, qd: tuple, qdd: tuple, what: str
) -> None:
    closed = closed_motion(1.0, 2.0, 3.0)
    given = [x + np.array(shift) for x, shift in zip(closed, (q, qd, qdd), strict=True)]
    at = oracles.four_bar_terms(FOUR_BAR, given[0], given[1])
    gaps = {
        "position": at.gap,
        "velocity": at.Psi @ given[1],
        "acceleration": at.Psi @ given[2] + at.Psidot @ given[1],
    }
    size = f"{np.linalg.norm(gaps[what]):.3g}"[:4]
    vectors = [text(x) for x in given]
    one = robodyn(
        *("torque", "robots/four-bar.yaml", "--q", vectors[0]),
        *("--qd", vectors[1], "--qdd", vectors[2]),
    )
    assert one.fails(2, "open", f"gap in {what} = {size}").out == ""
    names = ",".join(f"{name}{k}" for name in ("q", "qd", "qdd") for k in (1, 2, 3))
    stdin = table(np.array([np.hstack(closed), np.hstack(given)]), names)
    many = robodyn("torque", "robots/four-bar.yaml", "-", stdin=stdin)
    many.fails(2, "stdin: line 3: ", f"gap in {what} = {size}")
    assert len(many.rows) == 1


# What cannot be done: exit code 1


def rocker_range() -> tuple[float, float]:
    """The rocker's angles, deg, at which crank and coupler lie in one line."""
    reach = [
        180 - math.degrees(math.acos((1.1**2 + 0.8**2 - side**2) / (2 * 1.1 * 0.8)))
        for side in (0.95 + 0.35, 0.95 - 0.35)
    ]
    return min(reach), max(reach)


def test_what_cannot_be_assembled_tells_distance_and_range(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    path = scene(four_bar_text.replace("actuated: [crank]", "actuated: [rocker]"))
    low, high = rocker_range()
    # rocker at 0: its tip stands 1.9 m off, crank and coupler reach 1.3 m
    failed = robodyn("torque", path, "--q", "0")
    told = (f"{math.ceil(low * 1e4) / 1e4:.8g}", f"{math.floor(high * 1e4) / 1e4:.8g}")
    failed.fails(1, str(path), "q3", "0.6 m", "rocker", *told)
    assert failed.out == ""
    batch = robodyn("torque", path, "-", stdin="q3\n2\n0\n")
    batch.fails(1, "stdin: line 3: ", "0.6 m", told[0])
    assert len(batch.rows) == 1


def test_a_dead_centre_is_named(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    path = scene(four_bar_text.replace("actuated: [crank]", "actuated: [rocker]"))
    edge = math.radians(rocker_range()[0]) - 1e-12  # what is missing there counts as rounding
    still = robodyn("torque", path, "--q", edge)
    assert still.fails(1, str(path), "dead centre").out == ""
    moving = robodyn("torque", path, "--q", edge, "--qd", "1")
    assert moving.fails(1, str(path), "dead centre").out == ""


@pytest.mark.parametrize("rate", ["0", "1"])
@pytest.mark.parametrize("angle", ["0", "180deg"])
def test_a_change_point_is_named(robodyn: Run, rate: str, angle: str) -> None:
    failed = robodyn("torque", "robots/parallelogram.yaml", "--q", angle, "--qd", rate)
    failed.fails(1, "robots/parallelogram.yaml", "change point")
    assert failed.out == ""


def test_a_change_point_in_a_batch(robodyn: Run) -> None:
    """Its row is empty, and those behind it are computed."""
    stdin = "q1\n1\n2\n0\n1\n"
    failed = robodyn("torque", "robots/parallelogram.yaml", "-", stdin=stdin)
    failed.fails(1, "stdin: line 4: ", "change point")
    first, _, singular, last = failed.rows
    assert last == first
    assert singular == dict.fromkeys(first, "") | {"q1": "0"}
    of_torque, *_, of_q1 = robodyn("summary", "-", stdin=failed.out).rows
    assert (of_q1["min"], of_torque["column"]) == ("0.0", "tau1")
    assert float(of_torque["min"]) == min(float(row["tau1"]) for row in failed.rows if row["tau1"])
    whole = ("torque", "robots/parallelogram.yaml", "-", "--fluctuation", "0.1")
    assert robodyn(*whole, stdin=stdin).fails(1, "line 4", "change point").out == ""


def test_columns_of_a_log_get_the_names_that_are_looked_for(robodyn: Run) -> None:
    log = "time,pos1,pos2,qd2,vel,tau1\n0,1,2,0,3,7\n1,1.5,2,0,3,8\n"
    read = ("--read", "t=time,q1=pos1,q2=pos2,qd1=vel,measured=tau1", "--qdd", "0,0")
    found = robodyn("torque", ARM, "-", *read, stdin=log)
    plain = robodyn("torque", ARM, "-", stdin="q1,q2,qd1,qd2\n1,2,3,0\n1.5,2,3,0\n").succeeds()
    assert found.succeeds().out.splitlines()[0] == "t,q1,q2,qd2,qd1,measured,tau1,tau2"
    for name in ("tau1", "tau2", "qd1"):
        assert found.column(name) == plain.column(name)
    assert found.column("measured") == [7.0, 8.0]
    turned = robodyn("torque", ARM, "-", "--read", "q1_deg=a", stdin="a,q2\n180,0\n").succeeds()
    known = robodyn("torque", ARM, "--q", "180deg,0").succeeds().row
    assert turned.column("tau1") == [known["tau1"]]


def test_too_few_actuators_name_the_free_joint(robodyn: Run, scene: Callable[[str], Path]) -> None:
    links = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 1}, {name: b, m: 2, l: 1, r: 0.4, I: 2}]\n"
    path = scene(links + "actuated: [a]\n")
    told = str(path), "residual2 = 2.32 N m: must be 0, as joint b is free", "--columns"
    failed = robodyn("torque", path, "--q", "1,0", "--qd", "0,0", "--qdd", "0,1").fails(1, *told)
    assert failed.out == ""
    rows = "q1,q2,qdd1,qdd2\n1,0,0,0\n1,0,0,1\n"
    failed = robodyn("torque", path, "-", stdin=rows).fails(1, "line 3", *told)
    assert [row["tau1"] for row in failed.rows] == ["0.0"]
    # M22 = 2 + 2*0.4^2, M12 = M22 + 2*0.4
    found = robodyn("torque", path, "-", "--columns", "q1,tau,residual,power", stdin=rows)
    assert found.succeeds().out.splitlines()[0] == "q1,tau1,residual2,power1"
    assert found.column("tau1") == pytest.approx([0.0, 3.12], rel=1e-15)
    assert found.column("residual2") == pytest.approx([0.0, 2.32], rel=1e-15)


def test_a_motion_that_simulate_wrote_of_fewer_actuators_than_freedoms(robodyn: Run) -> None:
    """A cart-pole pushed by 1 N: its residual is what rounding of the rows leaves."""
    options = ("--q", "0,80deg", "--tau", "1", "--time", "1", "--quiet")
    motion = robodyn("simulate", "robots/cart-pole.yaml", *options).succeeds().out
    found = robodyn("torque", "robots/cart-pole.yaml", "-", stdin=motion).replaces()
    assert "residual2" not in found.out
    assert found.column("tau1") == pytest.approx([1.0] * len(found.rows), rel=1e-14)
    chosen = ("--columns", "t,residual2")
    found = robodyn("torque", "robots/cart-pole.yaml", "-", *chosen, stdin=motion).succeeds()
    assert len(found.rows) == 1001
    assert np.abs(found.column("residual2")).max() < 1e-15
    # the pole's own equation, 0.025 + 0.1/12 kg m^2: 1e-6 rad/s^2 more are refused
    changed = motion.splitlines()
    row = changed[500].split(",")
    row[6] = repr(float(row[6]) + 1e-6)
    changed[500] = ",".join(row)
    failed = robodyn("torque", "robots/cart-pole.yaml", "-", stdin="\n".join(changed))
    failed.fails(1, "line 501", "residual2 = 3.33333e-08 N m", "pole")
    assert len(failed.rows) == 499


def test_motors_of_fewer_actuators_than_freedoms(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    """Volts that drive a cart come back from its motion."""
    motor = "motor: {ratio: 30, inertia: 1e-5, torque_constant: 0.05, resistance: 2}"
    text = Path("robots/cart-pole.yaml").read_text().replace("I: 0,", f"I: 0, {motor},")
    path = scene(text)
    options = ("--q", "0,80deg", "--volt", "6*sin(3*t)", "--time", "1", "--every", "0.1")
    motion = robodyn("simulate", path, *options, "--quiet").succeeds().out
    found = robodyn("torque", path, "-", stdin=motion).replaces()
    volts = [6 * math.sin(3 * t) for t in found.column("t")]
    assert found.column("volt1") == pytest.approx(volts, abs=1e-12)


def test_too_many_actuators_get_the_least_torque_and_a_warning(
    robodyn: Run, scene: Callable[[str], Path], four_bar_text: str
) -> None:
    path = scene(four_bar_text.replace("actuated: [crank]", "actuated: [crank, rocker]"))
    q, qd, qdd = closed_motion(1.0, 2.0, 1.0)
    given = robodyn("torque", path, "--q", text(q), "--qd", text(qd), "--qdd", text(qdd))
    assert given.code == 0
    assert given.err.startswith("Warning: 2 actuators")
    assert given.err.count("\n") == 1
    # any torques with this power make the motion; the least ones lie along the rates
    crank, _ = oracles.four_bar_torque(FOUR_BAR, q, qd, qdd)
    driven = qd[[0, 2]]
    expected = driven * crank * qd[0] / (driven @ driven)
    assert relative_error(given.has("tau1", "tau3"), expected) < 1e-11


@pytest.mark.parametrize("model", ["robots/2r.yaml", "robots/four-bar.yaml"])
@pytest.mark.parametrize("batch", [False, True])
def test_a_result_beyond_the_floats_is_an_error(robodyn: Run, model: str, batch: bool) -> None:
    """Not nan or inf with exit code 0, nor Python's warnings in place of a message."""
    n = 2 if "2r" in model else 1
    if batch:
        names = [f"{name}{k + 1}" for name in ("q", "qd") for k in range(n)]
        stdin = ",".join(names) + "\n" + ",".join(["1"] * n + ["1e200"] * n) + "\n"
        given = robodyn("torque", model, "-", stdin=stdin)
        given.fails(1, "stdin: line 2: ")
    else:
        given = robodyn("torque", model, "--q", "1,2"[: 2 * n - 1], "--qd", ",".join(["1e200"] * n))
        given.fails(1)
    assert "nan" not in given.out
    assert "inf" not in given.out


def test_angles_whose_sum_is_no_number(robodyn: Run) -> None:
    given = robodyn("torque", "robots/2r.yaml", "--q=1e308,1e308")
    assert given.fails(1, "the result is not finite").out == ""


CART = """
gravity: 9.81
links:
  - {name: cart, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0}
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: "cart@1.1,0"}
closures: [[coupler, rocker]]
actuated: [crank]
"""


def test_values_of_the_joints_that_determine_the_others_are_a_state(
    robodyn: Run, tmp_path: Path
) -> None:
    """A four-bar on a free cart at rest needs the torque of one on the ground."""
    scene = tmp_path / "cart.yaml"
    scene.write_text(CART)
    bar = "robots/four-bar.yaml"
    alone = robodyn("torque", bar, "--q", "60deg").row["tau1"]
    one = robodyn("torque", scene, "--q", "0.3,60deg")
    rows = robodyn("torque", scene, "-", stdin="q1,q2\n0.3,1.0471975511965976\n")
    assert [x.row["tau2"] for x in (one, rows)] == pytest.approx([alone, alone])
    branches = [row["q3"] for row in robodyn("assemble", scene, "--q", "0.3,60deg").rows]
    assert branches == [row["q2"] for row in robodyn("assemble", bar, "--q", "60deg").rows]
    told = "needs 4 values, one a joint (cart, crank, coupler, rocker), or 2 (cart, crank)"
    robodyn("torque", scene, "--q", "60deg").fails(2, "--q = 60deg (1 value)", told)
    robodyn("accel", scene, "--q", "0,60deg,0").fails(2, "--q = 0,60deg,0 (3 values)", told)
    robodyn("torque", bar, "--q", "1,60deg").fails(2, "--q = 1,60deg (2 values): needs 3 values")


def test_what_was_removed_names_what_took_its_place(robodyn: Run) -> None:
    for option, words in REMOVED_OPTIONS.items():
        with case(option):
            told = robodyn("torque", "robots/2r.yaml", "--q", "1,2", option).fails(2, option)
            assert words in " ".join(told.err.split())
