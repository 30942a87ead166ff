"""Points, angles, transmission and ranges, against geometry of their own."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from conftest import FOUR_BAR, ROOT, Outcome, relative_error
from mpmath import mp, mpc, mpf

import oracles
import robodyn as rd
from random_mechanisms import LOOPS, Scene, mechanism, seeded_scene, seeded_tree, sliding
from robodyn.dynamics.named_points import (
    link_turns,
    named_points,
    point_jacobian,
    unit_rates,
)
from robodyn.dynamics.transmission import (
    rate_ratios,
    ratio_named,
    transmission_angles,
    transmission_loops,
)
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.trajectories.joint_ranges import joint_ranges

Run = Callable[..., Outcome]
BAR = "robots/four-bar.yaml"


# -- names -----------------------------------------------------------------------------------------

NAMED = """
gravity: 9.81
links:
  - {name: crank, m: 1, l: 0.2, r: 0.1, I: 0.01}
  - {name: coupler, m: 1, l: 0.5, r: [0.2, 0.1], I: 0.01, from: tip1}
  - {name: rocker, m: 1, l: 0.4, r: 0.2, I: 0.01, from: [0.5, 0]}
closures: [[E, tip3]]
springs: [{between: [[0, 1], centre2], stiffness: 10, length: 0.1}]
loads: [{point: P, force: [1, -2]}, {point: "rocker@0.1,-0.2", force: [3, 0], frame: link}]
points: {P: {link: coupler, at: [0.3, 0.2]}, Q: P, E: "coupler@0.5, 0", O: joint2}
"""
PLAIN = """
gravity: 9.81
links:
  - {name: crank, m: 1, l: 0.2, r: 0.1, I: 0.01}
  - {name: coupler, m: 1, l: 0.5, r: [0.2, 0.1], I: 0.01}
  - {name: rocker, m: 1, l: 0.4, r: 0.2, I: 0.01, from: [0.5, 0]}
closures: [[coupler, rocker]]
springs: [{between: [[0, 1], {link: coupler, at: [0.2, 0.1]}], stiffness: 10, length: 0.1}]
loads:
  - {link: coupler, at: [0.3, 0.2], force: [1, -2]}
  - {link: rocker, at: [0.1, -0.2], force: [3, 0], frame: link}
"""


def test_names_stand_for_points_everywhere_in_a_scene() -> None:
    named, plain = mechanism(NAMED).description, mechanism(PLAIN).description
    assert named._replace(points=()) == plain
    assert dict(named.points) == {
        "P": (1, 0.3 + 0.2j),
        "Q": (1, 0.3 + 0.2j),
        "E": (1, 0.5 + 0j),
        "O": (1, 0j),
    }


def test_points_by_their_names() -> None:
    mech = mechanism(NAMED)
    found = named_points(mech, ["crank", "B=coupler@0.1,0.2", "coupler@1,2,centre3", "P"])
    assert [(x.name, x.own) for x in found] == [
        ("crank", (0, 0.2)),
        ("B", (1, 0.1 + 0.2j)),
        ("point3", (1, 1 + 2j)),
        ("centre3", (2, 0.2)),
        ("P", (1, 0.3 + 0.2j)),
    ]
    assert [x.name for x in named_points(mech, ["crank,tip3,B=coupler@1,2"])][1:] == ["tip3", "B"]
    assert [x.name for x in named_points(mech)] == ["P", "Q", "E", "O"]
    assert [x.name for x in named_points(mechanism(PLAIN))] == ["tip1", "tip2", "tip3"]


def test_a_link_named_like_a_point_is_the_link() -> None:
    mech = mechanism(
        "links:\n  - {name: tip2, m: 1, l: 1, r: 0, I: 0}\n"
        "  - {name: 'b,c=d', m: 1, l: 2, r: 0, I: 0}\n"
    )
    assert named_points(mech, ["tip2"])[0].own == (0, 1.0)
    assert named_points(mech, ["b,c=d"])[0].own == (1, 2.0)
    assert named_points(mech, ["P=b,c=d"])[0].own == (1, 2.0)
    assert named_points(mech, ["b,c=d@0.5,-1"])[0][:2] == ("point1", (1, 0.5 - 1j))
    assert named_points(mech, ["P=b,c=d@0.5,-1"])[0][:2] == ("P", (1, 0.5 - 1j))
    assert [x.own for x in named_points(mech, ["Q=tip2@1,2,tip2"])] == [(0, 1 + 2j), (0, 1.0)]


def test_a_name_of_a_link_may_begin_and_end_with_spaces() -> None:
    mech = mechanism("links: [{name: ' a ', m: 1, l: 1, r: 0, I: 0}]\n")
    assert [x.own for x in named_points(mech, [" a ", "P= a ", "Q= a @1,2"])] == [
        *[(0, 1.0)] * 2,
        (0, 1 + 2j),
    ]
    assert named_points(mech, [" tip1 "])[0].name == "tip1"


@pytest.mark.parametrize("of", [None, 5, [1], ["tip1", None]])
def test_what_is_no_name(of: object) -> None:
    with pytest.raises(InputError, match=r"of = .*must be (the name of a point|a text)"):
        rd.points(rd.load(ROOT / "robots/2r.yaml"), [0.0, 1.0], of=of)  # type: ignore[arg-type]


@pytest.mark.parametrize("states", [("ab",), ([0, 1], "ab"), ([0, 1], [0, 1], [{}, 1])])
def test_what_is_no_state(states: tuple) -> None:
    with pytest.raises(InputError, match="must be numbers"):
        rd.points(rd.load(ROOT / "robots/2r.yaml"), *states)


@pytest.mark.parametrize(
    "text", ["", "tip", "tip0", "tip4", "Tip1", "elbow", "centre99999999", "P,"]
)
def test_points_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match=r"--of.*names no point"):
        named_points(mechanism(NAMED), [text], "--of")


# -- motion ----------------------------------------------------------------------------------------


def motion_in_mp(mech: Mechanism, k: int, at: complex, q: list, qd: list, qdd: list) -> list:
    """Place, velocity and acceleration of a point of link k along q + qd t + qdd t^2/2."""
    links = mech.description.links

    def frame(j: int, angles: list) -> tuple:
        """The origin and the direction of link j."""
        above, link = links[j].hangs_from, links[j]
        origin, turn = (mpc(0), mpc(1)) if above.link is None else frame(above.link, angles)
        origin += turn * mpc(above.at)
        if link.axis is not None:
            turn *= mpc(link.axis) / abs(mpc(link.axis))
            return origin + turn * angles[j], turn
        return origin, turn * mp.expj(angles[j])

    def place(t: mpf) -> mpc:
        angles = [a + b * t + c * t * t / 2 for a, b, c in zip(q, qd, qdd, strict=True)]
        origin, turn = frame(k, angles)
        return origin + turn * mpc(at)

    def parts(order: int) -> list[float]:
        x = mp.diff(lambda t: place(t).real, 0, order)
        y = mp.diff(lambda t: place(t).imag, 0, order)
        return [float(x), float(y)]

    with mp.workdps(40):
        return [parts(order) for order in range(3)]


SCENES: list[Scene] = [
    *(seeded_tree(seed, 3 + seed) for seed in range(3)),
    *(seeded_scene(seed, shape) for seed, shape in enumerate(list(LOOPS.values())[:4])),
    *(sliding(seed, seeded_tree(20 + seed, 4), seed) for seed in range(4)),
]


@pytest.mark.parametrize("scene", SCENES)
def test_points_move_as_their_places_do(scene: Scene) -> None:
    mech, rng = scene.mechanism, np.random.default_rng(scene.n)
    offsets = rng.normal(size=(scene.n, 2)).tolist()
    of = [f"link{k}@{x!r},{y!r}" for k, (x, y) in enumerate(offsets)]
    found = rd.points(mech, *scene.states, of)
    assert found.names == tuple(f"point{k + 1}" for k in range(scene.n))
    moved = np.stack(found[1:], axis=-2)
    turned = np.stack(link_turns(mech, *scene.states), axis=-1)
    for k, (x, y) in enumerate(offsets):
        state = [[mpf(float(v)) for v in values] for values in scene.states]
        expected = motion_in_mp(mech, k, complex(x, y), *state)
        assert relative_error(moved[k], expected) < 1e-13
        ahead = np.array(motion_in_mp(mech, k, 1.0, *state)) - motion_in_mp(mech, k, 0.0, *state)
        angle, w, wd = turned[k]  # of the link's own x axis
        e = np.array([math.cos(angle), math.sin(angle)])
        across = np.array([-e[1], e[0]])
        assert np.abs(ahead - [e, w * across, wd * across - w * w * e]).max() < 1e-12 * (1 + w * w)
    these = [x.point for x in named_points(mech, of)]
    J = point_jacobian(mech, these, scene.q)
    assert relative_error(J @ scene.qd, moved[:, 1]) < 1e-13


def test_the_jacobian_of_a_closed_mechanism_in_its_actuated_joints() -> None:
    mech = rd.load(ROOT / "robots/five-bar.yaml")
    rng = np.random.default_rng(4)
    q = rd.assemble(mech, np.radians([120.0, 60.0]) + 0.2 * rng.normal(size=(5, 2)))
    rates = rng.normal(size=(5, 2))
    qd = rd.loop_velocities(mech, q, rates)
    of = ["P=tip2", "Q=centre4"]
    J = (
        point_jacobian(mech, [x.point for x in named_points(mech, of)], q)
        @ unit_rates(mech, q, t=0.0)[:, None]
    )
    assert J.shape == (5, 2, 2, 2)
    assert (
        relative_error(np.einsum("tpxa,ta->tpx", J, rates), rd.points(mech, q, qd, of=of).velocity)
        < 1e-12
    )


def test_a_coupler_curve_by_circles(robodyn: Run) -> None:
    """The point at (0.3, 0.1) of the coupler, by two circles for its pin, over a whole turn."""
    angles = [0.1 * k for k in range(63)]
    table = "q1,qd1,note\n" + "".join(f"{a!r},2.5,x\n" for a in angles)
    rows = robodyn("points", BAR, "-", "--of", "P=coupler@0.3,0.1", stdin=table).succeeds().rows
    for a, row in zip(angles, rows, strict=True):
        q = oracles.four_bar_position(FOUR_BAR, a, "open")
        turn = np.exp(1j * (q[0] + q[1]))
        place = 0.35 * np.exp(1j * a) + turn * (0.3 + 0.1j)
        assert abs(complex(float(row["P_x"]), float(row["P_y"])) - place) < 1e-13
        k, k_prime = oracles.four_bar_coefficients(FOUR_BAR, q)
        w = 2.5 * (k[0] + k[1])
        velocity = 0.35j * 2.5 * np.exp(1j * a) + 1j * w * turn * (0.3 + 0.1j)
        assert abs(complex(float(row["P_vx"]), float(row["P_vy"])) - velocity) < 1e-12
        wd = 2.5**2 * (k_prime[0] + k_prime[1])
        bent = -0.35 * 2.5**2 * np.exp(1j * a) + (1j * wd - w**2) * turn * (0.3 + 0.1j)
        assert abs(complex(float(row["P_ax"]), float(row["P_ay"])) - bent) < 1e-11
        assert row["note"] == "x"


def test_the_ellipses_of_a_trammel(robodyn: Run) -> None:
    mech = rd.load(ROOT / "robots/elliptic-trammel.yaml")
    bar = mech.description.links[1]
    q = rd.assemble(mech, np.linspace(0.0, 6.0, 40)[:, None])
    for part in (0.25, 0.6, 1.4):
        at = part * bar.l
        x = rd.points(mech, q, of=[f"bar@{at!r},0"]).position[:, 0] / [bar.l - at, at]
        assert np.abs(x**2 @ [1, 1] - 1).max() < 1e-12


# -- transmission ----------------------------------------------------------------------------------


def angles_of(mech: Mechanism, q: np.ndarray) -> np.ndarray:
    return transmission_angles(mech, list(transmission_loops(mech).values()), q)


def test_the_transmission_angle_of_a_four_bar() -> None:
    a, b, c, d = 0.35, 0.95, 0.80, 1.1
    mech = rd.load(ROOT / BAR)
    theta = np.linspace(-3.0, 3.0, 25)
    q = rd.assemble(mech, theta[:, None])
    diagonal = a * a + d * d - 2 * a * d * np.cos(theta)
    expected = np.arccos((b * b + c * c - diagonal) / (2 * b * c))
    assert np.abs(angles_of(mech, q)[:, 0] - expected).max() < 1e-13


def test_the_transmission_angle_is_at_the_middle_joint_however_the_loop_is_cut() -> None:
    text = """
links:
  - {name: crank, m: 1, l: 0.35, r: 0.15, I: 0.01}
  - {name: coupler, m: 1, l: 0.95, r: 0.45, I: 0.01}
  - {name: rocker, m: 1, l: 0.8, r: 0.4, I: 0.01, from: coupler}
closures: [[rocker, [1.1, 0]]]
"""
    cut, whole = mechanism(text), rd.load(ROOT / BAR)
    theta = np.linspace(-3.0, 3.0, 25)[:, None]
    one, two = (angles_of(mech, rd.assemble(mech, theta)) for mech in (cut, whole))
    assert np.abs(np.sin(one) - np.sin(two)).max() < 1e-12


def test_the_transmission_angle_of_a_slider_crank_and_of_a_slot() -> None:
    mech = rd.load(ROOT / "robots/slider-crank.yaml")
    theta = np.linspace(0.1, 6.0, 20)
    crank, rod = (link.l for link in mech.description.links)
    line = mech.description.closures[0].second.at.imag
    q = rd.assemble(mech, theta[:, None])
    expected = (crank * np.sin(theta) - line) / rod  # the rod's slope to the slider's way
    assert np.abs(np.abs(np.cos(angles_of(mech, q)[:, 0])) - np.abs(expected)).max() < 1e-12
    slotted = rd.load(ROOT / "robots/whitworth.yaml")
    q = rd.assemble(slotted, theta[:, None])
    assert np.abs(angles_of(slotted, q)[:, 0] - np.pi / 2).max() < 1e-7


def test_the_ratio_of_rates_is_freudensteins() -> None:
    mech = rd.load(ROOT / BAR)
    theta = np.linspace(-3.0, 3.0, 25)
    q = rd.assemble(mech, theta[:, None])
    two, three, four = q[:, 0], q[:, 0] + q[:, 1], q[:, 2]
    expected = 0.35 * np.sin(two - three) / (0.80 * np.sin(four - three))
    ratios = [ratio_named(mech, "rocker/crank")]
    assert relative_error(rate_ratios(mech, ratios, q, 0.0 * q, t=0.0)[:, 0], expected) < 1e-13


def test_a_ratio_of_what_slides() -> None:
    """A pin on a crank moves its slot at -l sin(q) times the crank's rate: none at q = 0."""
    mech = rd.load(ROOT / "robots/scotch-yoke.yaml")
    names = mech.link_names
    ratio = [ratio_named(mech, f"{names[0]}/{names[-1]}")]
    q = rd.assemble(mech, [[0.0], [1.0]])
    found = rate_ratios(mech, ratio, q, 0.0 * q, t=0.0)[:, 0]
    assert np.isnan(found).tolist() == [True, False]


# -- ranges ----------------------------------------------------------------------------------------


def test_a_dead_centre_near_a_missed_change_point_is_solved_to_rounding() -> None:
    """The crank's end by the law of cosines, in 40 digits: 1e-7 m short of a change point."""
    bar = "{{name: {}, m: 1, l: {}, r: 0.1, I: 0.1{}}}"
    ground = 0.6 + 1e-7
    bars = [
        bar.format("crank", 0.3, ""),
        bar.format("coupler", 0.5, ""),
        bar.format("rocker", 0.4, f", from: [{ground!r}, 0]"),
    ]
    mech = mechanism(
        f"links: [{', '.join(bars)}]\nclosures: [[coupler, rocker]]\nactuated: [crank]\n"
    )
    with mp.workdps(40):
        a, b, c, d = (mpf(x) for x in (0.3, 0.5, 0.4, ground))
        end = float(mp.acos((a * a + d * d - (b + c) ** 2) / (2 * a * d)))
    (found,) = joint_ranges(mech, rd.assemble(mech, [math.pi / 3]))
    assert (found.low_end, found.high_end) == ("dead centre", "dead centre")
    assert found.high == pytest.approx(end, abs=1e-12)
    assert found.low == pytest.approx(-end, abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_the_range_of_a_crank_is_the_law_of_cosines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    while True:
        a, b, c, d = rng.uniform(0.2, 1.0, 4).tolist()
        cosines = [(a * a + d * d - side**2) / (2 * a * d) for side in (b + c, b - c)]
        if min(b + c - abs(a - d), a + d - abs(b - c)) > 0.05:
            break
    mech = mechanism(
        f"links:\n  - {{name: a, m: 1, l: {a!r}, r: 0, I: 0}}\n"
        f"  - {{name: b, m: 1, l: {b!r}, r: 0, I: 0}}\n"
        f"  - {{name: c, m: 1, l: {c!r}, r: 0, I: 0, from: [{d!r}, 0]}}\nclosures: [[b, c]]\n"
    )
    least = math.acos(cosines[1]) if abs(cosines[1]) < 1 else 0.0
    most = math.acos(cosines[0]) if abs(cosines[0]) < 1 else math.pi
    start = 0.5 * (least + most)
    (found,) = joint_ranges(mech, rd.assemble(mech, [start]))
    if least == 0.0 and most == math.pi:
        assert found.low_end == found.high_end == "full turn"
        assert found.high - found.low == pytest.approx(2 * math.pi)
        return
    low, high = (
        (-most if least == 0.0 else least),
        (2 * math.pi - least if most == math.pi else most),
    )
    assert (found.low_end, found.high_end) == ("dead centre", "dead centre")
    assert np.abs(np.array([found.low - low, found.high - high])).max() < 1e-11


def test_limits_of_any_joint_end_a_range(robodyn: Run, scene: Callable) -> None:
    text = (ROOT / BAR).read_text()
    mech = rd.load(ROOT / BAR)
    q = rd.assemble(mech, [2.2]).tolist()
    limits = f"limits: {{min: {q[2] - 0.2!r}, max: {q[2] + 0.1!r}}}, name: rocker"
    path = scene(text.replace("name: rocker", limits))
    rows = robodyn("assemble", path, "--q", 2.2, "--range").rows
    assert [row["branch"] for row in rows] == ["open"]  # the other is beyond the limits
    assert [rows[0][x] for x in ("joint", "low_end", "high_end")] == [
        "q1",
        "limit of q3",
        "limit of q3",
    ]
    ends = rd.assemble(mech, [[float(rows[0]["low"])], [float(rows[0]["high"])]])[:, 2] - q[2]
    assert np.abs(np.sort(ends) - [-0.2, 0.1]).max() < 1e-12


def test_a_range_that_begins_at_a_dead_centre(robodyn: Run, scene: Callable) -> None:
    """a = 0.5, b + c = 1.3, g = 1.2: all is in a line at 90 degrees, where both branches meet."""
    path = scene(
        "links:\n  - {name: a, m: 1, l: 0.5, r: 0, I: 0}\n  - {name: b, m: 1, l: 0.6, r: 0, I: 0}\n"
        "  - {name: c, m: 1, l: 0.7, r: 0, I: 0, from: [1.2, 0]}\nclosures: [[b, c]]\n"
    )
    for at in ("90deg", "-90deg"):
        rows = robodyn("assemble", path, f"--q={at}", "--range").rows
        assert [row["branch"] for row in rows] == ["open", "crossed"]
        for row in rows:
            ends = [float(row["low"]), float(row["high"])]
            assert ends == pytest.approx([-math.pi / 2, math.pi / 2], abs=1e-9)


def test_joints_outside_of_loops_turn_and_slide_freely(robodyn: Run) -> None:
    rows = robodyn("assemble", "robots/rp-arm.yaml", "--q", "0.5,0.2", "--range").succeeds().rows
    assert [row["low_end"] for row in rows] == ["full turn", "nothing"]
    assert rows[1]["low"] == rows[1]["high"] == ""
    assert float(rows[0]["low"]) == pytest.approx(0.5 - math.pi)


# -- the command -----------------------------------------------------------------------------------


def test_everything_at_once(robodyn: Run) -> None:
    state = ("--q", "60deg", "--qd", 5, "--qdd", 2)
    options = ("--columns", "points,links,transmission,rocker/crank,jacobian")
    row = robodyn("points", BAR, *state, "--of", "rocker", *options).succeeds().row
    mech = rd.load(ROOT / BAR)
    q = rd.assemble(mech, [math.pi / 3])
    qd = rd.loop_velocities(mech, q, [5.0])
    assert row["rocker_vx"] == pytest.approx(5 * row["rocker_Jx1"])
    assert row["angle2"] == pytest.approx(q[0] + q[1])
    assert row["w3"] == pytest.approx(qd[2])
    assert row["rocker/crank"] == pytest.approx(qd[2] / 5)
    assert row["transmission1"] == pytest.approx(q[2] - q[0] - q[1])
    assert row["wd1"] == 2.0


@pytest.mark.parametrize("command", ["torque", "accel", "reactions", "energy", "points"])
def test_a_family_of_points_has_all_tips_in_every_command(robodyn: Run, command: str) -> None:
    given = (command, BAR, "--q", 1, "--qd", 2, "--columns")
    row = robodyn(*given, "jacobian,points").succeeds().row
    mech = rd.load(ROOT / BAR)
    names, places, *_ = rd.points(mech, rd.assemble(mech, [1.0]), np.zeros(3), np.zeros(3))
    assert names == ("tip1", "tip2", "tip3")
    for name, (x, y) in zip(names, places, strict=True):
        assert (row[f"{name}_x"], row[f"{name}_y"]) == pytest.approx((x, y))
        assert row[f"{name}_vx"] == pytest.approx(2 * row[f"{name}_Jx1"])
    # one that is named besides changes nothing
    other = robodyn(*given, "centre2_x,jacobian").succeeds().row
    assert [x for x in other if "_J" in x] == [x for x in row if "_J" in x]


def test_points_refuses_points_of_the_input_alone(robodyn: Run) -> None:
    states = "q1,qd1,note\n1,2,a\n"
    chosen = ("points", BAR, "-", "--columns", "tip2_x,q,note")
    found = robodyn(*chosen, stdin=states).succeeds()
    assert found.out.splitlines()[0] == "tip2_x,q1,q2,q3,note"
    again = robodyn("points", BAR, "-", "--columns", "tip2_x", stdin="q1,tip2_x\n1,2\n")
    assert (again.code, "name, --of NAME=POINT" in again.err) == (2, True)


def test_units_on_a_terminal(robodyn: Run) -> None:
    out = robodyn(
        "points", BAR, "--q", 1, "--of", "P=tip1", "--columns", "points,links", "--format", "table"
    ).out
    for part in (
        "P_x [m]",
        "P_vy [m/s]",
        "P_ax [m/s²]",
        "angle1 [rad]",
        "w2 [rad/s]",
        "wd3 [rad/s²]",
    ):
        assert part in out


def test_a_ratio_is_empty_where_the_divisor_stands_still(robodyn: Run) -> None:
    """The rod of a slider-crank with the crank across its line: at a quarter of a turn."""
    turn = ("trajectory", "slider-crank", "--turns", 1, "--speed", "60rpm", "--points", 5)
    points = ("points", "slider-crank", "-", "--columns")
    rows = robodyn(*turn).succeeds().out
    found = robodyn(*points, "tip2_ax,crank/rod", stdin=rows).succeeds()
    rod = robodyn(*points, "rod/crank", stdin=rows).succeeds()
    inverse = [float(line.split(",")[-1]) for line in rod.out.splitlines()[1:]]
    cells = [line.split(",")[-1] for line in found.out.splitlines()[1:]]
    assert [cell == "" for cell in cells] == [False, True, False, True, False]
    assert float(cells[0]) == pytest.approx(1 / inverse[0], rel=1e-12)
    told = robodyn(*points, "tip2_ax,crank/rod", "--format", "json", stdin=rows).succeeds().json
    assert [row["crank/rod"] is None for row in told] == [False, True, False, True, False]
    assert all(math.isfinite(row["tip2_ax"]) for row in told)


def test_ratios_and_angles_that_are_not_there(robodyn: Run) -> None:
    given = ("points", "robots/2r.yaml", "--q", "1,2", "--columns", "q1,forearm/upper arm")
    assert robodyn(*given).succeeds().out.endswith(",\n")
    row = robodyn(*given, "--qd", "2,1").succeeds().row
    assert row["forearm/upper arm"] == 1.5
