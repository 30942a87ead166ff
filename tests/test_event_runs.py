"""Events of whole runs, against closed forms, by every method."""

import math
import re
import sys
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from example_starts import start
from named_case import case

from robodyn.errors import InputError
from robodyn.loops import loop_rates
from robodyn.loops.assembly import assemble
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.runs.machine_motion import Status
from robodyn.runs.report import Outcome
from robodyn.runs.series_engine import SeriesEngine
from robodyn.runs.simulation import Motion, simulate
from robodyn.scene.quantities import parse_vector

METHODS: list[dict[str, Any]] = [
    *({"method": name} for name in ("DOP853", "RK45", "Radau", "taylor")),
]
TIGHT = {"rtol": 1e-13, "atol": 1e-13}
EXACT = [METHODS[0], METHODS[-1]]
NAMES = [" ".join(each.values()) for each in METHODS]
ROWS = [None, np.linspace(0.0, 1.0, 41), np.array([1.0])]  # of the time of a run

POINT = (
    "gravity: {g}\nlinks:\n  - {{name: arm, m: 1, l: 1, r: 1, I: 0}}\n"  # a mathematical pendulum
)
BLOCK = """gravity: 9.81
links:
  - {name: block, joint: prismatic, axis: [0, 1], m: 2, l: 0.1, r: 0, I: 0.01}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder: Path = tmp_path_factory.mktemp("scenes")

    def make(text: str) -> Mechanism:
        path = folder / f"scene{abs(hash(text))}.yaml"
        path.write_text(text)
        return load(str(path))

    return make


def times(motion: Motion, name: str) -> list[float]:
    return [event.t for event in motion.events if event.name == name]


def half_period(amplitude: float, g: float) -> float:
    return float(2 * mpmath.ellipk(mpmath.sin(amplitude / 2) ** 2) / mpmath.sqrt(g))


@pytest.mark.parametrize("how", METHODS, ids=NAMES)
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("rows", range(3))
@pytest.mark.thinned
def test_a_pendulum(made: Any, how: dict[str, Any], direction: float, rows: int) -> None:
    """Turning points and passages of the lowest point, by elliptic integrals."""
    mechanism = made(POINT.format(g=9.81))
    low, amplitude = -math.pi / 2, 1.0
    fine = how in EXACT
    tight = 1e-12 if fine else 1e-8
    half, end = half_period(amplitude, 9.81), direction * (8.0 if fine else 3.0)
    motion = simulate(
        mechanism,
        [low + amplitude],
        [0.0],
        end,
        rtol=tight,
        atol=tight,
        t_eval=None if rows == 0 else ROWS[rows] * end,
        events={"turn": "qd1", "low": "q1 + 90deg", "down": "q1 < -pi/2", "never": "q1 > 0"},
        **how,
    )
    count = int(abs(end) / half)
    within = 1e-9 if fine else 2e-4
    turns = [direction * half * k for k in range(1, count + 1)]
    assert times(motion, "turn") == pytest.approx(turns, abs=within)
    lows = [direction * half * (k + 0.5) for k in range(round(abs(end) / half))]
    assert times(motion, "low") == pytest.approx(lows, abs=within)
    assert times(motion, "down") == pytest.approx(lows[::2], abs=within)
    assert not times(motion, "never")
    forward = [event.t * direction for event in motion.events]
    assert forward == sorted(forward)
    assert motion.report.events == {
        "turn": count,
        "low": len(lows),
        "down": len(lows[::2]),
        "never": 0,
    }
    for event in motion.events:
        if event.name == "low":
            assert event.y[0] == pytest.approx(low, abs=1e-11 if fine else 1e-6)


@pytest.mark.parametrize("how", METHODS, ids=NAMES)
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.thinned
def test_uniform_rotation(made: Any, how: dict[str, Any], direction: float) -> None:
    """q1 = 3 t: hundreds of events of waves in q1, some of them many in one step."""
    mechanism = made(POINT.format(g=0))
    events = {
        "wave": "sin(60*q1)",
        "up": "sin(60*q1) > 0",
        "turn": "floor(q1/1rad) - 0.5",
        "hour": "q1 % 0.5 < 0.25",
        "pulse": "1 if abs(t - 0.77777) < 1e-9 else -1",
    }
    motion = simulate(mechanism, [0.1], [3.0], direction * 2.0, events=events, **TIGHT, **how)
    ends = sorted([0.1, 0.1 + 6.0 * direction])

    def expected(angles: np.ndarray) -> list[float]:
        inside = angles[(angles > ends[0]) & (angles < ends[1])]
        return sorted(((inside - 0.1) / 3.0).tolist(), key=abs)

    waves = expected(np.arange(-400, 400) * math.pi / 60)
    assert len(waves) > 110
    assert times(motion, "wave") == pytest.approx(waves, abs=1e-11)
    shift = 0 if direction > 0 else 1
    ups = expected(np.arange(-400 + shift, 400, 2) * math.pi / 60)
    assert times(motion, "up") == pytest.approx(ups, abs=1e-11)
    assert times(motion, "turn") == pytest.approx([0.3] if shift == 0 else [], abs=1e-12)
    falls = np.arange(-60, 60) * 0.5 + (0.25 if shift else 0.0)
    assert times(motion, "hour") == pytest.approx(expected(falls), abs=1e-11)
    pulse = [0.77777 - 1e-9, 0.77777 + 1e-9] if shift == 0 else []
    assert times(motion, "pulse") == pytest.approx(pulse, abs=1e-14)


def test_a_parabola_grazes_a_height(made: Any) -> None:
    """A block thrown up passes a height by `depth`, twice, or misses it."""
    for how in METHODS:
        for depth in [1e-9, 1e-11, 1e-13, -1e-9, -1e-11, -1e-13]:
            with case(how, depth):
                mechanism = made(BLOCK)
                speed, g = 3.0, 9.81
                level = speed**2 / (2 * g) - depth
                motion = simulate(
                    mechanism,
                    [0.0],
                    [speed],
                    0.7,
                    events={"high": f"q1 - {level!r}", "apex": "qd1"},
                    **how,
                )
                apart = math.sqrt(2 * abs(depth) / g)
                assert times(motion, "apex") == pytest.approx([speed / g], abs=1e-11)
                if depth > 0.0 and (depth > 1e-12 or motion.events[0].name == "high"):
                    expected = [speed / g - apart, speed / g + apart]
                    assert times(motion, "high") == pytest.approx(
                        expected, abs=1e-15 / apart + 1e-9
                    )
                elif depth < -1e-12:
                    assert not times(motion, "high")


def test_until(made: Any) -> None:
    """The last row is at the instant, and what comes later is not told."""
    for how in METHODS:
        for every in [False, True]:
            for direction in [1.0, -1.0]:
                with case(how, every, direction):
                    mechanism = made(POINT.format(g=0))
                    motion = simulate(
                        mechanism,
                        [0.0],
                        [2.0],
                        direction * 5.0,
                        t_eval=np.arange(0.0, 5.0, 0.3) * direction if every else None,
                        until=f"q1 {'><'[direction < 0]} {direction * 2.5}",
                        events={
                            "later": f"q1 - {direction * 2.6}",
                            "same": f"q1 - {direction * 2.5}",
                        },
                        **TIGHT,
                        **how,
                    )
                    assert motion.outcome is Outcome.EVENT
                    assert motion.t[-1] == pytest.approx(1.25 * direction, abs=1e-13)
                    assert motion.q[-1] == pytest.approx([2.5 * direction], abs=1e-12)
                    assert (np.diff(motion.t) * direction > 0.0).all()
                    if every:
                        assert motion.t[:-1] == pytest.approx(np.arange(0.0, 1.25, 0.3) * direction)
                    assert sorted(event.name for event in motion.events) == ["same", "until"]
                    assert motion.report.ended_by == "until"
                    assert motion.report.t_reached == motion.t[-1]


@pytest.mark.parametrize("how", METHODS, ids=NAMES)
def test_until_at_the_start_and_never(made: Any, how: dict[str, Any]) -> None:
    mechanism = made(POINT.format(g=0))
    motion = simulate(mechanism, [0.0], [2.0], 1.0, until="q1 > -1", **how)
    assert motion.outcome is Outcome.FINISHED
    assert motion.t[-1] == 1.0
    assert not motion.events
    assert motion.report.ended_by == ""


@pytest.mark.parametrize("how", METHODS, ids=NAMES)
def test_what_holds_from_the_end_of_the_run_on(made: Any, how: dict[str, Any]) -> None:
    mechanism = made(BLOCK)
    for until, end in (("t >= 1", 1.0), ("floor(t) >= 1", 1.0), ("-1 >= t", -1.0)):
        motion = simulate(mechanism, [0.0], [1.0], end, until=until, **how)
        assert motion.outcome is Outcome.EVENT, until
        assert times(motion, "until") == [end]
    assert simulate(mechanism, [0.0], [1.0], 1.0, until="t > 1", **how).outcome is Outcome.FINISHED


@pytest.mark.parametrize("how", METHODS, ids=NAMES)
@pytest.mark.parametrize("stabilize", ["projection", "none"])
@pytest.mark.thinned
def test_limit_positions_of_a_four_bar(how: dict[str, Any], stabilize: str) -> None:
    """The rocker stands where crank and coupler are in line; found by the cosine rule."""
    mechanism = load("robots/four-bar.yaml")
    q = assemble(mechanism, [math.radians(60)], t=0.0)
    qd = loop_rates.loop_velocities(mechanism, q, np.array([5.0]), t=0.0)
    line = "sin(q2)"  # the coupler in line with the crank
    rocker = simulate(
        mechanism,
        q,
        qd,
        1.0 if how["method"] == "Radau" else 3.0,
        rtol=1e-9,
        atol=1e-9,
        stabilize=stabilize,
        events={"line": line},
        **how,
    )
    assert rocker.outcome is Outcome.FINISHED
    assert len(rocker.events) >= 1
    for event in rocker.events:
        assert abs(math.sin(event.y[1])) < 1e-11


KINKED: dict[str, Any] = {
    "tau": "5*sign(sin(7*t)), 2*abs(cos(3*t))",
    "events": {"a": "qd1", "b": "qd2", "c": "sin(q1 + q2)", "d": "abs(q2) - 0.3 > 0"},
    "rtol": 1e-12,
    "atol": 1e-12,
}
FROM = [0.3, 0.4], [0.0, 0.0], 3.0


@pytest.fixture(scope="module")
def kinked() -> tuple[Motion, int]:
    """A motion by DOP853, and how often the sign of qd1 changes between its fine rows."""
    mechanism = load("robots/2r.yaml")
    motion = simulate(mechanism, *FROM, method="DOP853", **KINKED)
    fine = {"t_eval": np.linspace(0, 3, 6001), "method": "DOP853"}
    signs = np.sign(simulate(mechanism, *FROM, **fine, **KINKED).qd[:, 0])
    return motion, int((signs[1:-1] * signs[2:] < 0).sum())


def test_methods_agree_with_kinked_torques(kinked: tuple[Motion, int]) -> None:
    """The same events by DOP853 and by series, under a torque that jumps."""
    one, changes = kinked
    two = simulate(load("robots/2r.yaml"), *FROM, method="taylor", **KINKED)
    assert len(one.events) > 5
    assert [event.name for event in one.events] == [event.name for event in two.events]
    assert [x.t for x in one.events] == pytest.approx([x.t for x in two.events], abs=1e-8)
    for motion in (one, two):
        assert len(times(motion, "a")) == changes


@pytest.mark.parametrize("how", EXACT, ids=[NAMES[0], NAMES[-1]])
def test_held_control(robodyn: Any, how: dict[str, Any], tmp_path: Path) -> None:
    """Where a controller holds its torque between samples, a run with events is the same run."""
    reference = tmp_path / "ref.csv"
    given = ["trajectory", "robots/2r.yaml", "--from", "0,0", "--to", "90deg,45deg"]
    robodyn(*given, "--time", "1", "-o", str(reference)).succeeds()
    base = ["simulate", "robots/2r.yaml", "--q", "0,0", "--track", str(reference), "--control"]
    base += [
        "computed-torque",
        "--kp",
        "25",
        "--kd",
        "10",
        "--control-rate",
        "100Hz",
        "--every",
        "0.01",
    ]
    base += ["--quiet", "--method", how["method"]]
    plain = robodyn(*base).succeeds()
    events = tmp_path / "events.csv"
    more = ["--event", "half=q1 > 45deg", "--event", "rate=qd2", "--events", str(events)]
    watched = robodyn(*base, *more).succeeds()
    rows = [np.genfromtxt(x.out.splitlines(), delimiter=",")[1:] for x in (plain, watched)]
    assert rows[1] == pytest.approx(rows[0], abs=1e-9, nan_ok=True)
    lines = events.read_text().splitlines()
    assert lines[0] == "event,t,q1,q2,qd1,qd2"
    crossings = int(((rows[0][:-1, 1] < math.pi / 4) & (rows[0][1:, 1] > math.pi / 4)).sum())
    assert sum(line.startswith("half,") for line in lines) == crossings == 1


@pytest.mark.parametrize("how", EXACT, ids=[NAMES[0], NAMES[-1]])
@pytest.mark.parametrize(
    ("scene", "start", "rate"),
    [
        ("parallelogram", 5, 6.0),
        ("scotch-yoke", 10, 8.0),
        ("cart-pole", None, 0.0),
        ("whitworth", 30, 5.0),
        ("elliptic-trammel", 40, 3.0),
        ("hydraulic-boom", None, 0.0),
        ("slider-crank", 30, 20.0),
        ("toggle-press", None, 0.0),
    ],
)
@pytest.mark.thinned
def test_all_scenes_against_fine_rows(
    how: dict[str, Any], scene: str, start: float | None, rate: float
) -> None:
    """Every change of sign between fine rows is an event, near change points and dead centres."""
    mechanism = load(f"robots/{scene}.yaml")
    text = Path(f"robots/{scene}.yaml").read_text()
    actuated = len(mechanism.actuated)
    tried = [line.split("--q ")[1] for line in text.splitlines() if line.startswith("# try:")]
    given = parse_vector(tried[0].split()[0], where="q", unit="rad")
    if start is not None:
        given = [math.radians(start)]
    q = assemble(mechanism, given, t=0.0) if mechanism.rows else np.array(given)
    n = mechanism.n
    qd = np.zeros(n)
    if mechanism.rows:
        qd = loop_rates.loop_velocities(mechanism, q, np.full(actuated, rate), t=0.0)
    events = {f"qd{k + 1}": f"qd{k + 1}" for k in range(n)}
    events |= {f"q{k + 1}": f"sin(2*q{k + 1} - 0.3)" for k in range(n)}
    given_how: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-10, **how}
    fine = simulate(mechanism, q, qd, 1.5, t_eval=np.linspace(0, 1.5, 6001), **given_how)
    found = simulate(mechanism, q, qd, 1.5, events=events, **given_how)
    assert found.outcome == fine.outcome
    for k in range(n):
        for name, values in (
            (f"qd{k + 1}", fine.qd[:, k]),
            (f"q{k + 1}", np.sin(2 * fine.q[:, k] - 0.3)),
        ):
            if np.abs(values).max() < 1e-9:  # stays at zero but for rounding
                continue
            told = times(found, name)
            changes = np.flatnonzero(np.sign(values[1:-1]) * np.sign(values[2:]) < 0) + 1
            rows = [t for t in told if t > fine.t[1]]
            # between rows there may be a pair; every change of sign is there
            for j in changes:
                inside = [t for t in rows if fine.t[j] - 1e-9 <= t <= fine.t[j + 1] + 1e-9]
                assert len(inside) % 2 == 1, (name, fine.t[j], told)
            assert (len(rows) - len(changes)) % 2 == 0 or abs(values[-1]) < 1e-9


@pytest.mark.parametrize("how", EXACT, ids=[NAMES[0], NAMES[-1]])
def test_what_closures_keep_at_zero_is_told_to_be_zero(how: dict[str, Any]) -> None:
    """States next to a change point scatter by more than rounding: no look goes on and on."""
    mechanism = load("robots/parallelogram.yaml")
    q = assemble(mechanism, [math.radians(5)], t=0.0)
    qd = loop_rates.loop_velocities(mechanism, q, np.array([6.0]), t=0.0)
    motion = simulate(mechanism, q, qd, 0.5, events={"sum": "q2 + q3"}, max_evals=5000, **how)
    assert motion.events == []
    (remark,) = motion.report.remarks
    assert remark.startswith("sum is zero to rounding from t = 0 to ")
    assert remark.endswith(" to 0.5 s")  # in parts, where the scatter is seen


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"events": {"a": 1}}, "event a = 1: must be text"),
        ({"events": {1: "q1"}}, "name of an event = 1: must be text"),
        ({"events": ["q1"]}, "events = list: must be a mapping of names to expressions"),
        ({"until": 1}, "until = 1: must be text"),
        ({"rtol": "1e-9"}, "rtol = 1e-9: must be a number"),
        ({"max_evals": "7"}, "max_evals = 7: must be a number"),
    ],
)
def test_arguments_of_another_kind_are_refused_by_name(given: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        simulate(load("robots/pendulum.yaml"), [0.1], [0.0], 0.1, **given)


def test_a_pendulum_by_elliptic_integrals() -> None:
    """Turning points and passages of the lowest point."""
    pendulum, *_ = start("pendulum", 0.0)
    link = 0.4, 0.26, 0.0088
    frequency = mpmath.sqrt(link[0] * 9.81 * link[1] / (link[2] + link[0] * link[1] ** 2))
    amplitude = 2.0
    quarter = mpmath.ellipk(mpmath.sin(amplitude / 2) ** 2) / frequency
    low = -float(mpmath.pi / 2)
    motion = simulate(
        pendulum, [low + amplitude], [0.0], 20.0, method="taylor",
        rtol=1e-14, atol=1e-14, events={"turns": "qd1", "low": "q1 + 90deg"},
    )  # fmt: skip
    assert len(motion.events) == int(20.0 / quarter) > 50
    for k, event in enumerate(motion.events, 1):
        assert event.name == ("turns", "low")[k % 2]
        assert abs(event.t - float(k * quarter)) < 1e-11


@pytest.mark.parametrize("tol", [1e-4, 1e-9])
def test_a_step_next_to_a_change_point_is_made_again(tol: float) -> None:
    """It ends where it did: there too no shorter one would land on a good state."""
    met = 0
    for rate, bound in ((20.0, 3.0), (20.0, -3.0), (-60.0, 3.0), (5.0, -3.0)):
        mechanism, q, qd = start("parallelogram", rate)
        engine = SeriesEngine(mechanism, Actuation((0.0,) * 3), rtol=tol, atol=tol)
        y = np.concatenate([q, qd])
        chunk = engine.advance(0.0, y, bound, np.zeros(0), 64)
        met += chunk.status is Status.SINGULAR
        times, states = np.append(0.0, chunk.t), np.concatenate([y[None], chunk.y])
        for j in range(len(chunk.t)):
            again = engine.dense(times[j], states[j], times[j + 1])
            found = again(np.linspace(times[j], times[j + 1], 9))
            np.testing.assert_allclose(found[[0, -1]], states[j : j + 2], rtol=1e-10)
    assert met == 4


def test_no_more_events_are_held_than_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of them are kept; all are counted."""
    monkeypatch.setattr("robodyn.runs.watch.MOST", 100)
    pendulum, *_ = start("pendulum", 0.0)
    named = {"method": "taylor", "rtol": 1e-4, "atol": 1e-4}
    given = pendulum, [0.3], [0.0], 600.0
    motion = simulate(*given, **named, events={"turns": "qd1"})
    events = motion.events
    assert len(events) == 100
    assert motion.report.events["turns"] > 700
    assert "the first 100 events are kept" in motion.report.remarks
    both = simulate(*given, **named, events={"back": "qd1 < 0", "down": "q1 < -90deg"})
    assert [e.name for e in both.events[:4]] == ["down", "back", "down", "back"]
    assert (np.diff([e.t for e in both.events]) > 0.0).all()
    assert sum(both.report.events.values()) > 700


CALLS = 100_000  # of functions; a run with an event that passes zero once takes some 3,000


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_a_double_root_is_told_once(tmp_path: Path, method: str) -> None:
    """q = (t - 1)^2 (t - 3): it touches zero at 1, and passes it at 3."""
    path = tmp_path / "free.yaml"
    path.write_text("links: [{name: w, m: 1, l: 1, r: 0, I: 1}]\n")
    mech = load(path)
    how = {"method": method, "events": {"z": "q1"}}
    simulate(mech, [-3.0], [1.0], 5.0, tau="t-2", **how)  # imports are not counted
    calls = 0

    def count(*_: object) -> None:
        nonlocal calls
        calls += 1
        if calls > CALLS:
            raise AssertionError(f"more than {CALLS} calls")

    sys.setprofile(count)
    try:
        motion = simulate(mech, [-3.0], [7.0], 5.0, tau="6*t-10", **how)
    finally:
        sys.setprofile(None)
    assert [event.t for event in motion.events] == pytest.approx([3.0], abs=1e-9)
    (touch,) = (x for x in motion.report.remarks if "touches" in x)
    times = [float(x) for x in re.findall(r"\d+\.?\d*(?:e-?\d+)?", touch)]
    assert times == pytest.approx([1.0], abs=1e-7)
    assert motion.report.remarks == [touch]
