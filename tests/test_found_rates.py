"""`--differentiate`: rates and accelerations from positions at times, against exact motions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import FOUR_BAR as CRANK_ROCKER
from conftest import TWO_LINK, Outcome, relative_error

import oracles
from robodyn.errors import RobodynError
from robodyn.trajectories.joint_paths import derivative, resampled

Run = Callable[..., Outcome]
ARM, FOUR_BAR, PENDULUM = "robots/2r.yaml", "robots/four-bar.yaml", "robots/pendulum.yaml"


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, qd and qdd (T, 2) of an arm, that end in the midst of moving."""
    q = np.stack([0.4 + 2.0 * np.sin(3.0 * t), np.exp(-t) * np.cos(2.0 * t)], axis=-1)
    qd1, qdd1 = 6.0 * np.cos(3.0 * t), -18.0 * np.sin(3.0 * t)
    wave, other = np.cos(2.0 * t), np.sin(2.0 * t)
    qd2 = -np.exp(-t) * (wave + 2.0 * other)
    qdd2 = np.exp(-t) * (4.0 * other - 3.0 * wave)
    return q, np.stack([qd1, qd2], axis=-1), np.stack([qdd1, qdd2], axis=-1)


def text(names: str, *columns: np.ndarray) -> str:
    rows = np.column_stack(columns).tolist()
    return "\n".join([names, *(",".join(map(repr, row)) for row in rows)]) + "\n"


def found(given: Outcome, *names: str) -> np.ndarray:
    return np.array([[float(row[name]) for name in names] for row in given.rows])


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize(("order", "power"), [(1, 5), (2, 4)])
def test_order_of_convergence(even: bool, order: int, power: int) -> None:
    """At all rows, those at the ends too; steps that differ by up to a factor of 3."""
    errors = []
    for count in (40, 80, 160):
        u = np.linspace(0.0, 1.0, count + 1)
        t = 2.0 * (u if even else u + 0.08 * np.sin(2.0 * math.pi * u))
        q, *exact = motion(t)
        errors.append(np.abs(derivative(t, q, order) - exact[order - 1]).max())
    for coarse, fine in pairwise(errors):
        assert 2.0 ** (power - 0.6) < coarse / fine < 2.0 ** (power + 1.5)


def test_a_quintic_motion_is_exact() -> None:
    rng = np.random.default_rng(4)
    t, c = np.cumsum(rng.uniform(0.01, 0.3, 25)), rng.normal(size=6)
    line = np.polynomial.Polynomial(c)
    for order, close in ((1, 1e-11), (2, 1e-9)):
        known = line.deriv(order)(t)
        assert relative_error(derivative(t, line(t)[:, None], order)[:, 0], known) < close


def test_torques_of_an_arm(robodyn: Run) -> None:
    t = np.linspace(0.0, 2.0, 401)
    q, qd, qdd = motion(t)
    known = [oracles.two_link_torque(TWO_LINK, *x) for x in zip(q, qd, qdd, strict=True)]
    for names, columns in (("t,q1,q2", (t, q)), ("q1,q2,t,qd1,qd2", (q, t, qd))):
        given = robodyn("torque", ARM, "-", "--differentiate", stdin=text(names, *columns))
        assert given.succeeds().out.startswith(f"{names},tau1,tau2\n")
        assert relative_error(found(given, "tau1", "tau2"), known) < 2e-7
    # accelerations alone are there: the rates are found
    given = robodyn(
        "torque", ARM, "-", "--differentiate", stdin=text("t,q1,q2,qdd1,qdd2", t, q, qdd)
    )
    assert relative_error(found(given.succeeds(), "tau1", "tau2"), known) < 2e-7


def positions(crank: np.ndarray) -> np.ndarray:
    """All joints of the four-bar, (T, 3), by the oracle."""
    return np.unwrap([oracles.four_bar_position(CRANK_ROCKER, x) for x in crank], axis=0)


@pytest.mark.parametrize("command", ["torque", "reactions", "points", "energy", "accel"])
@pytest.mark.parametrize("whole", [False, True])
def test_a_closed_mechanism_from_its_crank(robodyn: Run, command: str, whole: bool) -> None:
    """All that is computed of q is as if the exact rates had been given."""
    t = np.linspace(0.0, 1.0, 301)
    q = 5.0 * t + 0.4 * np.sin(4.0 * t)
    qd, qdd = 5.0 + 1.6 * np.cos(4.0 * t), -6.4 * np.sin(4.0 * t)
    exact, table = text("t,q1,qd1,qdd1", t, q, qd, qdd), text("t,q1", t, q)
    if whole:
        table = text("t,q1,q2,q3", t, positions(q))
    given = robodyn(command, FOUR_BAR, "-", "--differentiate", stdin=table).succeeds()
    known = robodyn(command, FOUR_BAR, "-", stdin=exact)
    known = known.replaces() if command == "accel" else known.succeeds()
    names = [x for x in given.rows[0] if x not in ("t", "q1", "q2", "q3")]
    assert len(names) >= 3
    assert relative_error(found(given, *names), found(known, *names)) < 1e-7


def test_what_simulate_wrote_without_its_rates(robodyn: Run) -> None:
    run = "simulate robots/2r.yaml --q 0,0 --tau 3,1 --time 1 --every 0.005 --method taylor --quiet"
    rows = robodyn(*run.split()).succeeds().rows
    table = "".join(",".join(row[x] for x in ("t", "q1", "q2")) + "\n" for row in rows)
    given = robodyn("torque", ARM, "-", "--differentiate", stdin="t,q1,q2\n" + table).succeeds()
    assert np.abs(found(given, "tau1", "tau2") - [3.0, 1.0]).max() < 1e-4


def test_loads_take_the_times(robodyn: Run, scene: Callable[[str], Path]) -> None:
    path = scene((Path(ARM)).read_text() + 'loads: [{point: forearm, force: ["5*sin(t)", -2]}]\n')
    t = np.linspace(0.0, 2.0, 401)
    q, qd, qdd = motion(t)
    given = robodyn("torque", path, "-", "--differentiate", stdin=text("q1,q2,t", q, t))
    known = robodyn("torque", path, "-", stdin=text("t,q1,q2,qd1,qd2,qdd1,qdd2", t, q, qd, qdd))
    tau = ("tau1", "tau2")
    assert relative_error(found(given.succeeds(), *tau), found(known.succeeds(), *tau)) < 2e-7


@pytest.mark.parametrize(
    ("command", "names", "options", "missing"),
    [
        ("torque", "t,q1,q2", (), "qd and qdd"),
        ("points", "q1,t,q2,x", (), "qd and qdd"),
        ("reactions", "t,q1,q2,tau1,tau2", (), "qd"),
        ("energy", "t,q1,q2", (), "qd"),
        ("torque", "q1,q2", (), ""),
        ("torque", "t,q1,q2", ("--qd", "0,0"), ""),
        ("torque", "t,q1,q2,qd1,qd2", (), ""),
        ("torque", "t,qd1,qd2", ("--q", "1,1"), ""),
    ],
)
def test_rest_is_told(
    robodyn: Run, command: str, names: str, options: Sequence[str], missing: str
) -> None:
    rows = [[0.1 * k + x for x in range(names.count(",") + 1)] for k in range(5)]
    given = robodyn(command, ARM, "-", *options, stdin=text(names, np.array(rows)))
    assert given.code == 0
    told = f"Warning: stdin: t runs on, but no {missing} given: taken as zero; --differentiate"
    assert given.err.startswith(told) if missing else given.err == ""
    assert given.err.count("\n") == bool(missing)


def test_states_at_one_time_are_no_motion(robodyn: Run) -> None:
    for t in ("0.5", "x", ""):
        table = f"t,q1,q2\n{t},1,2\n{t},3,4\n"
        robodyn("torque", ARM, "-", stdin=table).succeeds()


def test_times_too_unequal_for_floats(robodyn: Run) -> None:
    t = [0.0, 5e-324, 1e-323, 1.5e-323, 2e-323, 1.0, 2.0]
    table = text("t,q1,q2", np.array(t), np.array([[k, k * k] for k in range(7)]) / 20)
    robodyn("torque", ARM, "-", "--differentiate", stdin=table).fails(1)
    even = np.arange(7.0)
    with pytest.raises(RobodynError, match="no spline goes through the times"):
        resampled(np.array(t), even[:, None], even)


def wrapped(q: np.ndarray) -> np.ndarray:
    return (q + np.pi) % (2.0 * np.pi) - np.pi


def turning(count: int = 81) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """t, q, qd and qdd of a crank that turns beyond half a turn, at 1.33 s, line 57 of 81 rows."""
    t = np.linspace(0.0, 2.0, count)
    wave, other = np.sin(3.0 * t), np.cos(3.0 * t)
    return t, 2.5 * t + 0.3 * wave, 2.5 + 0.9 * other, -2.7 * wave


JUMP = (
    "stdin: line 57: jump of q1 (crank) = 3.13844 to -3.0954 rad: more than half a turn: --unwrap"
)


def test_angles_that_jump_are_refused_or_unwrapped(robodyn: Run) -> None:
    t, q, qd, qdd = turning()
    known = found(
        robodyn("torque", FOUR_BAR, "-", stdin=text("t,q1,qd1,qdd1", t, q, qd, qdd)), "tau1"
    )
    table = text("t,q1", t, wrapped(q))
    options = ("torque", FOUR_BAR, "-", "--differentiate")
    robodyn(*options, stdin=table).fails(2, JUMP, "; if it is meant, give qd1 or closer rows")
    torques = found(robodyn(*options, "--unwrap", stdin=table).succeeds(), "tau1")
    assert torques == pytest.approx(known, abs=2e-3)
    # rates that are given say what a step is; accelerations are found from these
    table = text("t,q1,qd1", t, wrapped(q), qd)
    assert found(robodyn(*options, stdin=table).succeeds(), "tau1") == pytest.approx(
        known, abs=2e-3
    )


def test_references_that_jump_are_refused_or_unwrapped(robodyn: Run) -> None:
    t, q, qd, _ = turning()
    law = ("--control", "computed-torque", "--kp", 100, "--kd", 20)
    run = ("simulate", FOUR_BAR, "--q", 0, "--qd", 3.4, "--points", 81, "--quiet", *law)
    for names, columns, told in (
        ("t,q1", (t, wrapped(q)), "half a turn: --unwrap"),
        ("t,q1,qd1", (t, wrapped(q), qd), "half a turn beyond what its rates tell: --unwrap"),
    ):
        table = text(names, *columns)
        robodyn(*run, "--track", "-", stdin=table).fails(2, "line 57: jump of q1 (crank)", told)
        done = robodyn(*run, "--track", "-", "--unwrap", stdin=table).succeeds()
        assert np.array(done.column("q1")) == pytest.approx(q, abs=1e-5)
    sweep = ("sweep", FOUR_BAR, "--kind", "torque", "--vary", "links.crank.m=0.5,0.6", "--quiet")
    sweep += ("--result", "max(tau1)", "--track", "-")
    table = text("t,q1", t, wrapped(q))
    robodyn(*sweep, stdin=table).fails(2, JUMP)
    tables = [table, text("t,q1", t, q)]
    outs = [robodyn(*sweep, "--unwrap", stdin=x).succeeds().column("max(tau1)") for x in tables]
    assert outs[0] == pytest.approx(outs[1], rel=1e-9)


def test_a_fast_wheel_with_rates_does_not_jump(robodyn: Run, tmp_path: Path) -> None:
    """At 100 rad/s rows 0.1 s apart are 10 rad apart; what slides has no turns."""
    wheel, cart = tmp_path / "wheel.yaml", tmp_path / "cart.yaml"
    wheel.write_text("links: [{name: wheel, m: 1, l: 0.1, r: 0, I: 0.01}]")
    slide = "joint: prismatic, axis: [1, 0]"
    cart.write_text(f"links: [{{name: cart, {slide}, m: 1, l: 0, r: 0, I: 0}}]")
    t = np.linspace(0.0, 1.0, 11)
    law = ("--control", "computed-torque", "--kp", 25, "--kd", 10, "--quiet", "--points", 11)
    run = ("--track", "-", "--q", 0, "--qd", 100, *law)
    rated = text("t,q1,qd1,qdd1", t, 100.0 * t, 0.0 * t + 100.0, 0.0 * t)
    done = robodyn("simulate", wheel, *run, stdin=rated).succeeds()
    assert np.array(done.column("q1")) == pytest.approx(100.0 * t, abs=1e-6)
    bare = text("t,q1", t, 100.0 * t)
    done = robodyn("simulate", cart, *run, stdin=bare).succeeds()
    assert np.array(done.column("q1")) == pytest.approx(100.0 * t, abs=1e-6)
    robodyn("simulate", wheel, *run, stdin=bare).fails(
        2, "line 3: jump of q1 (wheel) = 0 to 10 rad"
    )


def test_data_that_jump(robodyn: Run) -> None:
    """`identify` and `regressor` differentiate them, `fit --simulate` compares them with a run."""
    t, q, qd, qdd = turning(801)
    motion = text("t,q1,qd1,qdd1", t, q, qd, qdd)
    tau = found(robodyn("torque", FOUR_BAR, "-", stdin=motion), "tau1")
    data = text("t,q1,tau1", t, wrapped(q), tau)
    told = ("jump of q1 (crank)", "--unwrap takes whole turns off")
    number = ("identify", FOUR_BAR, "-", "--of", "links.coupler.m", "--format", "json")
    robodyn(*number, stdin=data).fails(2, *told)
    done = robodyn(*number, "--unwrap", stdin=data)
    (mass,) = done.json["parameters"]  # type: ignore[index]
    assert mass["value"] == pytest.approx(CRANK_ROCKER.m2, rel=1e-6)
    condition = ("regressor", FOUR_BAR, "-", "--condition")
    robodyn(*condition, stdin=data).fails(2, *told)
    assert robodyn(*condition, "--unwrap", stdin=data).json["rows"] == 801  # type: ignore[index]
    run = ("simulate", PENDULUM, "--q", 1.5, "--qd", 9, "--time", 1, "--points", 33, "--quiet")
    rows = robodyn(*run).succeeds()
    motion = text("t,q1", *(np.array(rows.column(x)) for x in ("t", "q1")))
    turned = text("t,q1", np.array(rows.column("t")), wrapped(np.array(rows.column("q1"))))
    line = ("fit", PENDULUM, "--simulate", "--match", "-", "--starts", 1, "--qd", 9)
    line += ("--vary", "links.rod.I=0.005:0.02")
    robodyn(*line, stdin=turned).fails(2, "jump of q1 (rod)", "--unwrap takes whole turns off")
    known, unwrapped = (
        robodyn(*line, *more, stdin=table).succeeds().json["numbers"]["links.rod.I"]  # type: ignore[index]
        for more, table in (((), motion), (("--unwrap",), turned))
    )
    assert unwrapped == pytest.approx(known, rel=1e-9)


def test_points_to_go_through_are_taken_as_they_are(robodyn: Run) -> None:
    """A way of more than half a turn may be meant: it is told."""
    run = ("trajectory", ARM, "--via", "-", "--points", 3)
    via = "t,q1,q2\n0,0,3\n1,1,-3\n"
    done = robodyn(*run, stdin=via)
    assert done.column("q2") == pytest.approx([3.0, 0.0, -3.0], abs=1e-12)
    told = (
        "Note: stdin: line 3: jump of q2 (forearm) = 3 to -3 rad: more than half a turn: --unwrap"
    )
    assert told in done.err
    done = robodyn(*run, "--unwrap", stdin=via).succeeds()
    assert done.column("q2") == pytest.approx([3.0, np.pi, 2.0 * np.pi - 3.0])
    assert "jump" not in done.err
    path = "t,x,y,angle\n0,0.6,0.6,3.1\n1,0.7,0.6,-3.1\n"
    run = ("trajectory", "robots/3r.yaml", "--from", "0,1,1", "--of", "tip3", "--path", "-")
    done = robodyn(*run, "--points", 2, "--unwrap", stdin=path).succeeds()
    turned = sum(done.column(f"q{k}")[1] - done.column(f"q{k}")[0] for k in (1, 2, 3))
    assert turned == pytest.approx(2.0 * np.pi - 6.2, abs=1e-9)
    told = "Note: stdin: line 3: jump of angle = 3.1 to -3.1 rad: more than half a turn: --unwrap"
    assert told in robodyn(*run, "--points", 2, stdin=path).err
