"""Task space: inverse kinematics, and `robodyn trajectory` with a path of a point in the plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome, relative_error
from each_case import each
from mpmath import mp

import robodyn as api
from random_mechanisms import seeded_tree
from robodyn.dynamics.named_points import named_points, point_jacobian
from robodyn.errors import AssemblyError, InputError, SingularError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.description import from_text
from robodyn.trajectories.task_space import arc, length_until, spline_curve

Run = Callable[..., Outcome]
TO = ("--from", "0,90deg", "--of", "tip2")  # of the 2R arm, from (0.8, 0.6)
NO_WAY = ("trajectory", "robots/2r.yaml", *TO)
PROFILES = ("cubic", "quintic", "trapezoidal", "cycloidal")
PR = """
name: slider and bar
gravity: 9.81
links:
  - {name: slider, joint: prismatic, axis: [1, 0], m: 1, l: 0.1, r: 0, I: 0.01}
  - {name: bar, m: 1, l: 0.5, r: 0.2, I: 0.02, from: {link: slider, at: [0, 0]}}
"""

FOUR_LINKS = """
name: four links
gravity: 9.81
links:
  - {name: a, m: 1, l: 0.5, r: 0.2, I: 0.02}
  - {name: b, m: 1, l: 0.4, r: 0.2, I: 0.02}
  - {name: c, m: 1, l: 0.3, r: 0.1, I: 0.02}
  - {name: d, m: 1, l: 0.2, r: 0.1, I: 0.02}
"""


def scene(name: str) -> Mechanism:
    return api.load(ROOT / f"robots/{name}.yaml")


def places(seed: int, low: float, high: float, count: int = 40) -> np.ndarray:
    """Random places between two circles about the origin, (count, 2)."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(low, high, count) * np.exp(1j * rng.uniform(-np.pi, np.pi, count))
    return np.stack([z.real, z.imag], axis=-1)


def returned(mechanism: Mechanism, q: np.ndarray, of: str) -> np.ndarray:
    """Where the point is, (..., 2)."""
    return api.points(mechanism, q, of=[of]).position[..., 0, :]


def two_link(x: object, y: object, side: float, a: float = 0.8, b: float = 0.6) -> list:
    """q1, q2 of a 2R arm by the law of cosines, in mpmath's precision."""
    a, b = mp.mpf(a), mp.mpf(b)
    cosine = (x * x + y * y - a * a - b * b) / (2 * a * b)
    sine = side * mp.sqrt(1 - cosine**2)
    q1 = mp.atan2(y, x) - mp.atan2(b * sine, a + b * cosine)
    return [q1, mp.atan2(sine, cosine)]


def turned_off(q: np.ndarray, known: np.ndarray) -> float:
    """The largest angle between them but for whole turns."""
    return float(np.abs(np.exp(1j * q) - np.exp(1j * known)).max())


# Inverse kinematics in closed form


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_two_link_arm_on_both_branches(side: float) -> None:
    arm, xy = scene("2r"), places(1, 0.25, 1.35)
    known = np.array([[float(z) for z in two_link(*map(mp.mpf, p), side)] for p in xy.tolist()])
    for k, p in enumerate(xy):  # each from its own branch
        q = api.inverse_kinematics(arm, p, "tip2", near=known[k] + 0.1)
        assert np.abs(q - known[k]).max() < 1e-12
    q = api.inverse_kinematics(arm, xy, "tip2", near=known[0])
    assert turned_off(q, known) < 1e-12
    assert np.abs(np.diff(q, axis=0)).max() <= np.pi


def test_arm_with_a_boom() -> None:
    xy = places(2, 0.5, 1.5)
    q = api.inverse_kinematics(scene("rp-arm"), xy, "tip2", near=[0.0, 0.3])
    known = np.arctan2(xy[:, 1], xy[:, 0]), np.linalg.norm(xy, axis=1) - 0.45
    assert turned_off(q[:, 0], known[0]) < 1e-13
    assert np.abs(q[:, 1] - known[1]).max() < 1e-13


@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_bar_on_a_slider_as_in_the_trammel(ahead: float) -> None:
    arm = build(from_text(PR, "pr.yaml"))
    xy = np.random.default_rng(3).uniform([-1.0, -0.45], [1.0, 0.45], (30, 2))
    along = ahead * np.sqrt(0.25 - xy[:, 1] ** 2)
    start = [xy[0, 0] - along[0], math.atan2(xy[0, 1], along[0])]
    q = api.inverse_kinematics(arm, xy, "bar", near=start)
    assert np.abs(q[:, 0] - (xy[:, 0] - along)).max() < 1e-12
    assert turned_off(q[:, 1], np.arctan2(xy[:, 1], along)) < 1e-12


def test_five_bar_by_circles() -> None:
    bar = scene("five-bar")
    xy = np.random.default_rng(4).uniform([0.2, 0.5], [0.5, 0.7], (30, 2))
    start = api.assemble(bar, np.radians([120.0, 60.0]))
    q = api.inverse_kinematics(bar, xy, "left rod", near=start)
    for column, x0, a, b, side in ((0, 0.0, 0.3, 0.68, -1.0), (2, 0.7, 0.26, 0.64, 1.0)):
        pairs = [two_link(mp.mpf(x) - x0, mp.mpf(y), side, a, b) for x, y in xy.tolist()]
        known = np.array([[float(z) for z in pair] for pair in pairs])
        assert turned_off(q[:, column : column + 2], known) < 1e-12


def test_whole_hand_of_three_links() -> None:
    """The wrist by the law of cosines, then the hand's angle."""
    arm, xy, angle = scene("3r"), places(5, 0.5, 0.9), np.linspace(-2.0, 2.0, 40)
    wrist = xy - 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    elbow = two_link(*map(mp.mpf, wrist[0].tolist()), 1.0, 0.7, 0.55)
    near = [float(elbow[0]), float(elbow[1]), float(angle[0] - sum(elbow))]
    q = api.inverse_kinematics(arm, xy, "hand", angle=angle, near=near)
    pairs = [two_link(*map(mp.mpf, p), 1.0, 0.7, 0.55) for p in wrist.tolist()]
    known = np.array([[float(z) for z in pair] for pair in pairs])
    assert turned_off(q[:, :2], known) < 1e-12
    assert turned_off(q.sum(axis=1), angle) < 1e-12
    assert np.abs(returned(arm, q, "hand") - xy).max() < 1e-13


def test_without_a_pose_the_branch_is_open() -> None:
    arm = scene("2r")
    q = api.inverse_kinematics(arm, [[0.4, 0.6], [0.5, 0.6]], "tip2")
    assert q.shape == (2, 2)
    assert (q[:, 1] < 0.0).all()
    assert api.inverse_kinematics(arm, [0.4, 0.6], "tip2").shape == (2,)
    assert api.inverse_kinematics(arm, np.zeros((0, 2)), "tip2").shape == (0, 2)


def test_place_out_of_reach_is_told() -> None:
    with pytest.raises(AssemblyError, match=r"tip2 does not reach \(1.5, 0\).* 0\.1 m out"):
        api.inverse_kinematics(scene("2r"), [[0.5, 0.5], [1.5, 0.0]], "tip2")


def test_place_that_any_direction_reaches_is_singular() -> None:
    """The joint of an arm with two equal links."""
    links = "links: [{name: a, m: 1, l: 0.5, r: 0, I: 1}, {name: b, m: 1, l: 0.5, r: 0, I: 1}]"
    arm = build(from_text(links, "arm.yaml"))
    with pytest.raises(SingularError, match=r"tip2 at \(0, 0\): any direction"):
        api.inverse_kinematics(arm, [[0.5, 0.5], [0.0, 0.0]], "tip2")
    with pytest.raises(AssemblyError, match=r"tip2 does not reach \(2, 0\)"):
        api.inverse_kinematics(arm, [[2.0, 0.0], [0.0, 0.0]], "tip2")


# By Newton's method


def test_redundant_arm_returns_to_its_places() -> None:
    arm, xy = scene("3r"), places(6, 0.3, 1.3, 8)
    q = api.inverse_kinematics(arm, xy, "tip3", near=[0.2, 0.9, 0.6])
    assert np.abs(returned(arm, q, "tip3") - xy).max() < 1e-12


@pytest.mark.parametrize("seed", range(6))
def test_random_tree_returns_to_its_places(seed: int) -> None:
    drawn = seeded_tree(seed, 4)
    mechanism, rng = drawn.mechanism, np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, 4)
    link = max(range(4), key=lambda k: len(mechanism.path(k)))
    of = f"tip{link + 1}"
    if len(mechanism.path(link)) < 2:
        with pytest.raises(InputError, match="1 freedom"):
            api.inverse_kinematics(mechanism, [0.0, 0.0], of, near=q)
        return
    near = q + 0.02 * rng.normal(size=(5, 4))
    xy = returned(mechanism, near, of)
    found = api.inverse_kinematics(mechanism, xy, of, near=q)
    size = max(mechanism.unit, float(np.abs(xy).max()))
    assert np.abs(returned(mechanism, found, of) - xy).max() < 1e-12 * size


def test_coupled_joints_go_along(robodyn: Run, tmp_path: Path) -> None:
    bar = scene("geared-five-bar")
    with pytest.raises(InputError, match="moves with 1 freedom; x and y need 2"):
        api.inverse_kinematics(bar, [0.3, 0.5], f"tip{bar.n}")
    file = tmp_path / "coupled.yaml"
    text = (ROOT / "robots/3r.yaml").read_text()
    file.write_text(text + 'couplings: ["q3 = -0.5 q2 + 0.1"]\nactuated: [upper arm, forearm]\n')
    arm = api.load(file)
    xy = np.linspace([0.7, 0.8], [0.2, 0.9], 6)
    q = api.inverse_kinematics(arm, xy, "hand", near=[0.3, 1.2])
    assert np.abs(returned(arm, q, "hand") - xy).max() < 1e-12
    assert np.abs(q[:, 2] + 0.5 * q[:, 1] - 0.1).max() < 1e-14
    options = ("--from", "0.3,1.2", "--of", "hand", "--to-xy", "0.2,0.9", "--time", "1")
    t, q, qd, qdd = rows(robodyn("trajectory", str(file), *options).succeeds(), 3)
    moved = api.points(arm, q, qd, qdd, of=["hand"])
    s, _, s2 = shape_of("quintic", t)
    way = [0.2, 0.9] - moved.position[0, 0]
    assert np.abs(moved.position[:, 0] - moved.position[0, 0] - s[:, None] * way).max() < 1e-12
    assert np.abs(moved.acceleration[:, 0] - s2[:, None] * way).max() < 1e-11


def test_ends_of_joints_are_not_passed(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "stopped.yaml"
    text = (ROOT / "robots/2r.yaml").read_text()
    file.write_text(text.replace("I: 0.031", "I: 0.031, limits: {max: 95deg}"))
    given = robodyn("trajectory", str(file), *TO, "--to-xy", "0.3,0.5", "--time", "1")
    assert given.code == 1
    assert "q2 (forearm) at t = 1 s" in given.err
    assert "is beyond the joint's" in given.err


# Rows of the command

LINES = {
    "2r": ("tip2", "0,90deg", (0.4, 0.9)),
    "3r": ("tip3", "0,90deg,0", (0.1, 0.9)),
    "rp-arm": ("boom", "30deg,0.3", (0.1, 0.9)),
    "five-bar": ("left rod", "120deg,60deg", (0.4, 0.6)),
}


def rows(given: Outcome, n: int) -> list[np.ndarray]:
    """t (T,), and q, qd, qdd (T, n)."""
    names = [f"{x}{k + 1}" for x in ("q", "qd", "qdd") for k in range(n)]
    whole = np.transpose([given.column(name) for name in ("t", *names)])
    return [whole[:, 0], *np.split(whole[:, 1:], 3, axis=1)]


def shape_of(profile: str, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """s, s', s'' as the README has them."""
    if profile == "cubic":
        return 3 * u**2 - 2 * u**3, 6 * u - 6 * u**2, 6 - 12 * u
    if profile == "quintic":
        s = 10 * u**3 - 15 * u**4 + 6 * u**5
        return s, 30 * (u**2 - 2 * u**3 + u**4), 60 * u - 180 * u**2 + 120 * u**3
    if profile == "cycloidal":
        x = 2 * np.pi * u
        return u - np.sin(x) / (2 * np.pi), 1 - np.cos(x), 2 * np.pi * np.sin(x)
    v = np.minimum(u, 1 - u)
    ramp = v < 1 / 3
    s = np.where(ramp, 2.25 * v**2, 1.5 * (v - 1 / 6))
    acceleration = np.where(ramp, np.where(u < 0.5, 4.5, -4.5), 0.0)
    return np.where(u < 0.5, s, 1 - s), np.where(ramp, 4.5 * v, 1.5), acceleration


@each("name", LINES)
@each("profile", PROFILES)
def test_line_is_straight_and_has_its_profile(robodyn: Run, name: str, profile: str) -> None:
    of, pose, end = LINES[name]
    options = ("--to-xy", f"{end[0]},{end[1]}", "--time", "2", "--points", "100")
    given = robodyn(
        "trajectory", f"robots/{name}.yaml", "--from", pose, "--of", of, *options,
        "--profile", profile,
    ).succeeds()  # fmt: skip
    mechanism = scene(name)
    t, q, qd, qdd = rows(given, mechanism.n)
    moved = api.points(mechanism, q, qd, qdd, of=[of])
    s, s1, s2 = shape_of(profile, t / 2)
    way = np.array(end) - moved.position[0, 0]
    assert np.abs(moved.position[:, 0] - (moved.position[0, 0] + s[:, None] * way)).max() < 1e-12
    assert np.abs(moved.velocity[:, 0] - s1[:, None] / 2 * way).max() < 1e-12
    assert np.abs(moved.acceleration[:, 0] - s2[:, None] / 4 * way).max() < 1e-11
    assert not qd[[0, -1]].any()


def test_rates_are_the_derivatives_of_the_closed_form(robodyn: Run) -> None:
    options = ("--to-xy", "0.4,0.9", "--time", "2", "--points", "9")
    t, q, qd, qdd = rows(robodyn(*NO_WAY, *options).succeeds(), 2)
    x0, y0 = (float(x) for x in returned(scene("2r"), q[0], "tip2"))

    def joint(k: int) -> Callable:
        def at(t: object) -> object:
            u = t / 2
            s = 10 * u**3 - 15 * u**4 + 6 * u**5
            return two_link(x0 + s * (mp.mpf("0.4") - x0), y0 + s * (mp.mpf("0.9") - y0), 1)[k]

        return at

    with mp.workdps(40):
        for row, k in np.ndindex(len(t), 2):
            at = mp.mpf(float(t[row]))
            assert abs(joint(k)(at) - q[row, k]) < 1e-12
            assert abs(mp.diff(joint(k), at) - qd[row, k]) < 1e-9
            assert abs(mp.diff(joint(k), at, 2) - qdd[row, k]) < 1e-9


@pytest.mark.parametrize("extra", [(), ("--posture", "60deg,60deg,60deg")])
def test_redundant_rows_are_one_another_s_derivatives(robodyn: Run, extra: tuple) -> None:
    options = ("--of", "tip3", "--arc", "0.6,0.6:200deg", "--time", "2", *extra)
    given = robodyn("trajectory", "robots/3r.yaml", "--from", "0,90deg,0", *options).succeeds()
    t, q, qd, qdd = rows(given, 3)
    weights, h = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280]), t[1] - t[0]

    def slope(y: np.ndarray) -> np.ndarray:
        end = len(y)
        pairs = (y[5 + k : end - 3 + k] - y[3 - k : end - 5 - k] for k in range(4))
        return sum(w * pair for w, pair in zip(weights, pairs, strict=True)) / h

    assert np.abs(slope(q) - qd[4:-4]).max() < 1e-9 * np.abs(qd).max()
    assert np.abs(slope(qd) - qdd[4:-4]).max() < 3e-9 * np.abs(qdd).max()


def free_of(mechanism: Mechanism, q: np.ndarray, of: str) -> np.ndarray:
    """The unit vector (T, 3) along which a 3R arm moves without its tip."""
    point = named_points(mechanism, [of])[0].point
    J = point_jacobian(mechanism, [point], q)[:, 0]
    free = np.cross(J[:, 0], J[:, 1])
    return free / np.linalg.norm(free, axis=1, keepdims=True)


def test_redundant_arm_moves_least_or_toward_its_posture(robodyn: Run) -> None:
    arm = ("trajectory", "robots/3r.yaml", "--from", "0,90deg,0", "--of", "tip3")
    options = ("--to-xy", "0.1,0.9", "--time", "2", "--points", "50")
    mechanism, posture = scene("3r"), np.array([0.5, 1.5, 1.0])
    _, q, qd, _ = rows(robodyn(*arm, *options).succeeds(), 3)
    assert np.abs((qd * free_of(mechanism, q, "tip3")).sum(axis=1)).max() < 1e-13
    _, near, *_ = rows(robodyn(*arm, *options, "--posture", "0.5,1.5,1").succeeds(), 3)
    assert np.array_equal(near[0], q[0])
    assert np.linalg.norm(near[-1] - posture) < 0.3 * np.linalg.norm(q[-1] - posture)
    along = ((posture - near) * free_of(mechanism, near, "tip3")).sum(axis=1)
    assert abs(along[-1]) < 0.02 < 0.5 < abs(along[0])


def test_arc_keeps_its_radius(robodyn: Run) -> None:
    options = ("--arc", "0.6,0.6:360deg", "--time", "2", "--points", "73")
    t, q, qd, qdd = rows(robodyn(*NO_WAY, *options).succeeds(), 2)
    moved = api.points(scene("2r"), q, qd, qdd, of=["tip2"])
    s, s1, s2 = shape_of("quintic", t / 2)
    z = 0.2 * np.exp(2j * np.pi * s)
    w, wd = np.pi * s1, np.pi * s2 / 2
    x, v, a = (m[:, 0] @ [1, 1j] for m in moved[1:])
    assert np.abs(x - 0.6 - 0.6j - z).max() < 1e-14
    assert np.abs(v - 1j * w * z).max() < 1e-13
    assert np.abs(a - (1j * wd - w**2) * z).max() < 1e-12
    assert np.abs(q[-1] - q[0]).max() < 1e-14


POINTS = "x,y\n0.8,0.6\n0.7,0.8\n0.3,0.9\n0.2,0.6\n"


def test_path_through_points_has_its_profile_along_its_length(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_text(POINTS)
    options = ("--path", str(file), "--profile", "trapezoidal", "--time", "3", "--points", "301")
    t, q, qd, qdd = rows(robodyn(*NO_WAY, *options).succeeds(), 2)
    moved = api.points(scene("2r"), q, qd, qdd, of=["tip2"])
    x, v, a = (m[:, 0] for m in moved[1:])
    speed = np.linalg.norm(v, axis=1)
    _, s1, _ = shape_of("trapezoidal", t / 3)
    length = speed[150] * 3 / 1.5
    assert np.abs(speed - length * s1 / 3).max() < 1e-12
    cruise = slice(101, 200)
    assert np.abs((v * a).sum(axis=1)[cruise]).max() < 1e-11
    assert abs(length - np.linalg.norm(np.diff(x, axis=0), axis=1).sum()) < 1e-3 * length
    for point in np.loadtxt(POINTS.splitlines()[1:], delimiter=","):
        assert np.linalg.norm(x - point, axis=1).min() < 0.01
    assert np.abs(x[[0, -1]] - [[0.8, 0.6], [0.2, 0.6]]).max() < 1e-14


def test_path_with_times_and_angles_is_there_then(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_text("t,x,y,angle\n1,0.8,0.6,1\n2,0.7,0.8,1.4\n3,0.3,0.9,2\n5,0.2,0.6,1.3\n")
    options = ("--of", "hand", "--from", "0,1.5,0", "--path", str(file), "--every", "1")
    given = robodyn("trajectory", "robots/3r.yaml", *options).succeeds()
    t, q, qd, _ = rows(given, 3)
    assert t.tolist() == [1, 2, 3, 4, 5]
    x = returned(scene("3r"), q, "hand")
    assert np.abs(x[[0, 1, 2, 4]] - [[0.8, 0.6], [0.7, 0.8], [0.3, 0.9], [0.2, 0.6]]).max() < 1e-13
    assert np.abs(q.sum(axis=1)[[0, 1, 2, 4]] - [1, 1.4, 2, 1.3]).max() < 1e-13
    assert not qd[[0, -1]].any()


def test_curves_have_their_lengths() -> None:
    curve, length = spline_curve(np.array([[0.0, 0.0], [3.0, 4.0]]))
    assert length == pytest.approx(5.0, rel=1e-15)
    assert np.abs(curve(np.array([0.0, 0.5, 1.0]))[0] - [[0, 0], [1.5, 2], [3, 4]]).max() < 1e-15
    assert arc(np.array([1.0, 0.0]), np.zeros(2), -np.pi)[1] == pytest.approx(np.pi, rel=1e-15)
    curve, length = spline_curve(np.random.default_rng(7).uniform(-1, 1, (6, 2)))
    s = np.linspace(0.0, 1.0, 200)
    _, c1, c2 = curve(s)
    assert np.abs(np.linalg.norm(c1, axis=1) - length).max() < 1e-13 * length
    assert np.abs((c1 * c2).sum(axis=1)).max() < 1e-9 * length**2
    ahead, behind = curve(s[1:-1] + 1e-6)[0], curve(s[1:-1] - 1e-6)[0]
    assert np.abs((ahead - behind) / 2e-6 - c1[1:-1]).max() < 1e-6


# Ends of the workspace


def leaves(error: str) -> tuple[float, float]:
    """At which length, and how far out of reach."""
    length, out = (float(error.split(word)[1].split()[0]) for word in ("workspace ", " up to "))
    return length, out


def test_line_that_leaves_the_annulus_tells_where(robodyn: Run) -> None:
    for end in ((2.0, 0.9), (-0.05, 0.1)):
        given = robodyn(*NO_WAY, "--to-xy", f"{end[0]},{end[1]}", "--time", "1")
        assert given.code == 1
        length, out = leaves(given.err)
        begin, way = 0.8 + 0.6j, complex(*end) - (0.8 + 0.6j)
        unit = way / abs(way)
        across, along = (begin.conjugate() * unit).imag, (begin.conjugate() * unit).real
        inner = abs(across) < 0.2 and along < 0.0
        square = math.sqrt((0.2 if inner else 1.4) ** 2 - across**2)
        assert length == pytest.approx(-along - square if inner else square - along, rel=1e-5)
        assert out == pytest.approx(abs(complex(*end)) - 1.4 if not inner else out, rel=1e-5)
        if inner:  # the place nearest to the centre, among the 16 that are looked at
            assert out <= 0.2 - abs(across) + 1e-9
            assert out > 0.05


def test_redundant_arm_that_leaves_tells_where(robodyn: Run) -> None:
    options = ("--of", "tip3", "--from", "0,90deg,0", "--to-xy", "1,1.9", "--time", "1")
    given = robodyn("trajectory", "robots/3r.yaml", *options)
    assert given.code == 1
    length, out = leaves(given.err)
    begin = 0.7 + 0.85j
    unit = (1 + 1.9j - begin) / abs(1 + 1.9j - begin)
    along = (begin.conjugate() * unit).real
    known = -along + math.sqrt(along**2 + 1.55**2 - abs(begin) ** 2)
    assert length == pytest.approx(known, rel=1e-5)
    assert out == pytest.approx(math.hypot(1, 1.9) - 1.55, rel=1e-5)
    options = ("--of", "tip3", "--from", "0,90deg,0", "--to-xy", "300,-500", "--time", "1")
    out = leaves(robodyn("trajectory", "robots/3r.yaml", *options).err)[1]
    assert out == pytest.approx(math.hypot(300, 500) - 1.55, rel=1e-5)


def test_singularity_is_told_and_one_that_is_run_across_is_none(robodyn: Run) -> None:
    given = robodyn("trajectory", "robots/2r.yaml", "--from", "0,0", *TO[2:], "--to-xy", "0.5,0.5",
                    "--time", "1")  # fmt: skip
    assert given.code == 1
    assert "tip2 meets a singularity 0 m along its path of 1.02956 m, at (1.4, 0)" in given.err
    boom = ("trajectory", "robots/rp-arm.yaml", "--from", "0,0.3", "--of", "boom", "--time", "1")
    assert "meets a singularity 0.74998" in robodyn(*boom, "--to-xy", "-0.5,1e-6").err
    _, q, qd, _ = rows(robodyn(*boom, "--to-xy", "-0.5,0", "--points", "50").succeeds(), 2)
    assert np.abs(q[:, 0]).max() < 1e-12
    assert np.abs(qd[:, 0]).max() < 1e-9
    near = robodyn(*boom, "--to-xy", "-0.5,0.01", "--points", "50").succeeds()
    t, q, qd, qdd = rows(near, 2)
    moved = api.points(scene("rp-arm"), q, qd, qdd, of=["boom"])
    way = np.array([-0.5, 0.01]) - [0.75, 0.0]
    s, s1, s2 = shape_of("quintic", t)
    assert np.abs(moved.position[:, 0] - [0.75, 0] - s[:, None] * way).max() < 1e-12
    assert np.abs(moved.velocity[:, 0] - s1[:, None] * way).max() < 1e-11
    assert np.abs(moved.acceleration[:, 0] - s2[:, None] * way).max() < 1e-8


# The shortest time


def shortest(given: Outcome) -> float:
    assert given.code == 0, given.err
    return float(given.err.split("shortest duration: ")[1].split()[0])


@pytest.mark.parametrize(
    ("option", "limits", "name"),
    [
        ("--max-tau", (30.0, 10.0), "tau"),
        ("--max-qd", (1.0, 1.5), "qd"),
        ("--max-qdd", (4.0, 3.0), "qdd"),
    ],
)
@pytest.mark.parametrize("way", [("--to-xy", "0.3,0.9"), ("--arc", "0.6,0.6:270deg")])
@pytest.mark.thinned
def test_limits_hold_in_the_shortest_time(
    robodyn: Run, option: str, limits: tuple[float, float], name: str, way: tuple[str, str]
) -> None:
    given = robodyn(*NO_WAY, *way, "--time", "min", option, f"{limits[0]},{limits[1]}",
                    "--points", "4001")  # fmt: skip
    T = shortest(given)
    assert f"bounded by {name}" in given.err
    t, q, qd, qdd = rows(given, 2)
    assert t[-1] == T
    tau = api.inverse_dynamics(scene("2r"), q, qd, qdd)
    most = (np.abs({"tau": tau, "qd": qd, "qdd": qdd}[name]) / limits).max()
    assert most <= 1.0 + 1e-12
    assert most > 1.0 - 1e-4
    slower = robodyn(*NO_WAY, *way, "--time", f"{0.99 * T}", option, f"{limits[0]},{limits[1]}")
    assert slower.code == 1
    assert option in slower.err


def test_limits_hold_for_redundant_and_closed_mechanisms(robodyn: Run) -> None:
    for name, most in (("3r", 60.0), ("five-bar", 9.0)):
        of, pose, end = LINES[name]
        mechanism = scene(name)
        options = ("--to-xy", f"{end[0]},{end[1]}", "--time", "min", "--max-tau", f"{most}")
        given = robodyn("trajectory", f"robots/{name}.yaml", "--from", pose, "--of", of, *options)
        shortest(given)
        _, q, qd, qdd = rows(given, mechanism.n)
        tau = api.inverse_dynamics(mechanism, q, qd, qdd)
        assert most * (1.0 - 1e-3) < np.abs(tau).max() <= most * (1.0 + 1e-12)


def test_motors_limits_hold(robodyn: Run, tmp_path: Path) -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    driven = tmp_path / "driven.yaml"
    motor = "I: 0.082, motor: {ratio: 50, inertia: 2e-5, torque_max: 0.6}"
    driven.write_text(text.replace("I: 0.082", motor))
    given = robodyn("trajectory", str(driven), *TO, "--to-xy", "0.3,0.9", "--time", "min")
    shortest(given)
    _, q, qd, qdd = rows(given, 2)
    tau = api.inverse_dynamics(api.load(driven), q, qd, qdd)[:, 0]
    assert 29.9 < np.abs(tau).max() <= 30.0
    fast = robodyn("trajectory", str(driven), *TO, "--to-xy", "0.3,0.9", "--time", "0.2")
    assert fast.code == 0
    assert "of its motor" in fast.err


def test_largest_speed_of_the_point(robodyn: Run) -> None:
    line = ("--to-xy", "0.4,0.3", "--max-speed", "0.75")
    assert shortest(robodyn(*NO_WAY, *line, "--time", "min")) == pytest.approx(1.25, rel=1e-9)
    assert "bounded by the speed of tip2" in robodyn(*NO_WAY, *line, "--time", "min").err
    given = robodyn(*NO_WAY, *line, "--time", "1")
    assert given.code == 1
    assert "--max-speed: tip2 = 0.9375 m/s" in given.err
    robodyn(*NO_WAY, *line, "--time", "1.25").succeeds()


def test_length_until_a_part_of_a_path() -> None:
    from robodyn.trajectories.joint_paths import path_through

    points = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 0.0]])
    path = path_through(points, [0.0, 1.0, 2.0], "cycloidal")
    assert length_until(path) == pytest.approx(9.0, rel=1e-12)
    assert length_until(path, 0.5) == pytest.approx(5.0, rel=1e-12)
    assert length_until(path, 0.25) == pytest.approx(2.5, rel=1e-12)


# Bad input


@each(
    ("arguments", "told"),
    [
        ({"xy": [1, 2, 3], "of": "tip3"}, "xy"),
        ({"xy": [[1, math.nan]], "of": "tip3"}, "xy"),
        ({"xy": [1, 0], "of": "tip3", "angle": [1, 2, 3]}, "angle"),
        ({"xy": [1, 0], "of": "tip3"}, "near: missing"),
        ({"xy": [1, 0], "of": "tip3", "near": [0, 0]}, "points.shape"),
        ({"xy": [1, 0], "of": "nix"}, "names no point"),
        ({"xy": [1, 0], "of": "tip3,tip2"}, "names 2 points; give one"),
        ({"xy": "ab", "of": "tip3"}, "xy = 'ab': must be numbers"),
        ({"xy": [1, 0], "of": "tip3", "near": "x"}, "near = 'x': must be numbers"),
        ({"xy": [1, 0], "of": None}, "of = None: must be a text"),
        ({"xy": [1, 0], "of": "tip2", "angle": 0}, "2 freedoms; x, y and the angle need 3"),
    ],
)
def test_bad_arguments(arguments: dict, told: str) -> None:
    with pytest.raises(InputError, match=told):
        api.inverse_kinematics(scene("3r"), **arguments)


@pytest.mark.parametrize("size", [1e-6, 1e3, 1e6])
def test_a_path_does_not_depend_on_the_size_of_the_scene(
    robodyn: Run, tmp_path: Path, size: float
) -> None:
    turned = []
    for k, unit in enumerate((1.0, size)):
        arm, path = tmp_path / f"arm{k}.yaml", tmp_path / f"path{k}.csv"
        links = [f"{{name: {name}, m: 1, l: {unit!r}, r: 0, I: 0.1}}" for name in "ab"]
        arm.write_text(f"links: [{', '.join(links)}]\n")
        rows = unit * np.array([[1.0, 0.1], [1.0, 0.5], [0.7, 0.6]])
        path.write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in rows.tolist()))
        given = ("--of", "b", "--path", path, "--time", "2", "--points", "41")
        rows = robodyn("trajectory", arm, "--from", "0,90deg", *given).succeeds().rows
        turned.append([[float(row[x]) for x in ("q1", "q2", "qd1", "qd2")] for row in rows])
    assert relative_error(turned[1], turned[0]) < 1e-9


def test_redundant_hand_takes_the_short_way_to_its_angle() -> None:
    chain = build(from_text(FOUR_LINKS, "four.yaml"))
    near, angle = np.array([0.3, 0.8, 0.7, 0.9 + 4 * np.pi]), 2.8
    xy = returned(chain, near, "d") + np.array([0.02, -0.03])
    q = api.inverse_kinematics(chain, xy, "d", angle=angle, near=near)
    assert np.abs(q - near).max() < 0.5
    assert np.abs(returned(chain, q, "d") - xy).max() < 1e-13
    assert math.remainder(q.sum() - angle, 2 * np.pi) == pytest.approx(0.0, abs=1e-12)


def test_redundant_hand_with_angles_goes_toward_its_posture(robodyn: Run, tmp_path: Path) -> None:
    scene_file, path = tmp_path / "four.yaml", tmp_path / "path.csv"
    scene_file.write_text(FOUR_LINKS)
    path.write_text("t,x,y,angle\n0,0.5,0.8,2.5\n1,0.4,0.8,2.6\n2,0.4,0.9,2.4\n")
    arm = ("trajectory", str(scene_file), "--of", "d", "--from", "0.3,0.8,0.7,0.9")
    ends = []
    for more in ((), ("--posture", "0.2,1.2,0.7,0.5")):
        given = robodyn(*arm, "--path", str(path), "--every", "1", *more).succeeds()
        _, q, qd, _ = rows(given, 4)
        known = [[0.5, 0.8], [0.4, 0.8], [0.4, 0.9]]
        assert np.abs(returned(api.load(scene_file), q, "d") - known).max() < 1e-13
        assert np.abs(np.exp(1j * q.sum(axis=1)) - np.exp([2.5j, 2.6j, 2.4j])).max() < 1e-13
        assert not qd[[0, -1]].any()
        ends.append(np.linalg.norm(q[-1] - [0.2, 1.2, 0.7, 0.5]))
    assert ends[1] < ends[0]
