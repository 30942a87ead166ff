"""Events: every crossing is found, none is invented, and what rounding hides is said."""

import math
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import pytest
from conftest import FRESH
from each_case import each
from example_starts import start
from named_case import case
from numpy.typing import NDArray

import robodyn
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.runs.event_functions import event_functions
from robodyn.runs.roots import NODES
from robodyn.runs.segments import Segment
from robodyn.runs.simulation import simulate
from robodyn.runs.watch import EventWatch

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def pendulum() -> Mechanism:
    return load("robots/pendulum.yaml")


def turning(t: Array) -> Array:
    """q1 = t, qd1 = 1."""
    return np.stack([t, np.ones_like(t)], axis=-1)


def along(mechanism: Mechanism, text: str, segments: list[Segment], length: float) -> EventWatch:
    """The events of one expression along segments."""
    watch = EventWatch(event_functions(mechanism, {"e": text}), length)
    for segment in segments:
        assert watch.look(segment) is None
    return watch


def segment_of(ends: list[float], states: Callable[[Array], Array] = turning) -> Segment:
    """Steps between `ends`, along which the states are known."""
    t = np.array(ends)
    return Segment(t, states(t), lambda _, times: states(times))


def watched(
    mechanism: Mechanism,
    text: str,
    ends: list[float],
    states: Callable[[Array], Array] = turning,
) -> EventWatch:
    """The same, of steps that are looked at one by one."""
    steps = [segment_of([*pair], states) for pair in pairwise(ends)]
    return along(mechanism, text, steps, ends[-1] - ends[0])


def together(mechanism: Mechanism, text: str, ends: list[float]) -> EventWatch:
    """The same, of steps that are looked at together."""
    return along(mechanism, text, [segment_of(ends)], ends[-1] - ends[0])


def unclosed(mechanism: Mechanism, text: str, ends: list[float]) -> EventWatch:
    """The same, where states at first are known but for an error."""
    t, missed = np.array(ends), 1e-9
    times = t[:-1, None] + np.diff(t)[:, None] * NODES

    def sampled() -> Array:
        return turning(times) + missed * (times - t[:-1, None])[..., None]

    segment = Segment(t, turning(t), lambda _, at: turning(at), sampled)
    return along(mechanism, text, [segment], ends[-1] - ends[0])


def check(watch: EventWatch, roots: list[float], within: float = 1e-12) -> None:
    found = [event.t for event in watch.events]
    assert len(found) == len(roots), (found, roots)
    for t, root, event in zip(found, roots, watch.events, strict=True):
        assert abs(t - root) <= within * max(1.0, abs(root)) + event.apart, (t, root, event.apart)


ONE = [0.0, 3.0]  # ends of steps
SOME = [0.0, 0.4, 1.0, 1.3, 2.9, 3.0]
BACK = [0.0, -0.4, -1.0, -1.3, -2.9, -3.0]
PART = math.sqrt(math.log(1e7) / 50)
PARTS = [ONE, SOME, [x / 64 for x in range(193)]]


@pytest.mark.parametrize("look", [watched, together, unclosed])
@pytest.mark.parametrize("ends", PARTS)
@pytest.mark.parametrize("gap", [10.0**-k for k in range(3, 13)])
@pytest.mark.thinned
def test_close_pairs(pendulum: Mechanism, look: Callable, ends: list[float], gap: float) -> None:
    """Two roots `gap` apart: both, or, where rounding hides them, a graze is said."""
    first = 1.2345678
    watch = look(pendulum, f"(t - {first!r})*(q1 - {first + gap!r})", ends)
    check(watch, [first, first + gap])
    sharp = f"(t - {first!r})**2 - {gap / 2!r}**2"
    watch = look(pendulum, sharp, ends)
    if watch.events:
        check(watch, [first - gap / 2, first + gap / 2], 1e-12)
    else:
        assert gap < 1e-7
        assert watch.grazes["e"] == pytest.approx([first], abs=1e-6)


@pytest.mark.parametrize("look", [watched, together, unclosed])
@pytest.mark.parametrize("ends", PARTS)
@pytest.mark.parametrize("depth", [10.0**-k for k in range(2, 20)])
@pytest.mark.thinned
def test_grazes(pendulum: Mechanism, look: Callable, ends: list[float], depth: float) -> None:
    """sin t comes within `depth` of a level, from below and above: none, two, or a graze said."""
    level = 1.0 - depth
    near = 1.0 - level  # what is left of it
    watch = look(pendulum, f"sin(q1) > {level!r}", ends)
    root = math.asin(level) if near > 1e-9 else math.pi / 2 - math.sqrt(2 * near)
    assert len(watch.events) <= 1
    if near > 1e-14:
        check(watch, [root])
    elif not watch.events:
        assert watch.grazes["e"] == pytest.approx([math.pi / 2], abs=1e-6)
    watch = look(pendulum, f"sin(q1) - {1.0 + depth!r}", ends)
    check(watch, [])
    assert watch.grazes or depth > 5e-16
    assert not watch.grazes or depth < 1e-13


@pytest.mark.parametrize("look", [watched, together, unclosed])
@pytest.mark.parametrize("ends", PARTS)
@pytest.mark.parametrize(
    ("text", "roots"),
    [
        ("(q1 - 1)*(q1 - 1.5)*(q1 - 2.01)", [1.0, 1.5, 2.01]),  # at ends of steps, and within
        ("(t - 1.1)**2", []),
        ("(t - 1.1)**3", [1.1]),
        ("(t - 1.1)**4", []),
        ("(t - 1.1)**5", [1.1]),
        ("(t - 1.1)**2*(q1 - 2.2)", [2.2]),
        ("(t - 1)**3", [1.0]),
        ("(t - 1)**2", []),
        ("t - 1", [1.0]),
        ("t", []),
        ("t > 0", []),
        ("t - 3", []),
        ("-1e-300*(q1 - 2)", [2.0]),
        ("1e300*(q1 - 2)", [2.0]),
        ("1e-9*q1 - 2e-9", [2.0]),
        ("q1 - 1e-13", [1e-13]),
        ("1e9*(q1 - 2) < 0", []),
        ("1e9*(q1 - 2) > 0", [2.0]),
        ("q1 >= 120deg", [2 * math.pi / 3]),
        ("cos(200*q1)", [(k + 0.5) * math.pi / 200 for k in range(191)]),
        ("cos(200*q1) > 0", [(2 * k + 1.5) * math.pi / 200 for k in range(95)]),
        ("sin(t**4) < 0.5", [(math.pi * (2 * k + 5 / 6)) ** 0.25 for k in range(13)]),
        ("exp(5*t) - 1e5", [math.log(1e5) / 5]),
        ("1e-7 - exp(-50*(t - 1)**2)", [1 - PART, 1 + PART]),
        ("(t - 1)/1e-6 - sin((t - 1)/1e-6)", [1.0]),
        ("tanh(1e6*(t - 1.7))", [1.7]),
        ("tanh(1e9*(t - 1.7)) + 0.5", [1.7 - math.atanh(0.5) / 1e9]),
        ("0.1 - 1/(1 + (10*(t - 1.234))**2)", [1.234 - 0.3, 1.234 + 0.3]),
    ],
)
@pytest.mark.thinned
def test_smooth(
    pendulum: Mechanism, look: Callable, ends: list[float], text: str, roots: list[float]
) -> None:
    check(look(pendulum, text, ends), roots, 1e-11)


@pytest.mark.parametrize("look", [watched, together, unclosed])
@pytest.mark.parametrize("ends", PARTS)
@pytest.mark.parametrize(
    ("text", "roots"),
    [
        ("floor(q1) - 0.5", [1.0]),
        ("floor(q1) >= 1", [1.0]),
        ("floor(q1) > 1", [2.0]),
        ("floor(q1) >= 2", [2.0]),
        ("floor(10*q1) >= 7", [0.7]),
        ("floor(q1) < 1", []),
        ("abs(q1 - 1.3)", []),
        ("abs(q1 - 1.3) - 1e-9", [1.3 - 1e-9, 1.3 + 1e-9]),
        ("abs(q1 - 1.3) < 1e-7", [1.3 - 1e-7]),
        ("abs(abs(q1 - 1.5) - 1) < 1e-6", [0.5 - 1e-6, 2.5 - 1e-6]),
        ("sign(q1 - 1.3)", [1.3]),
        ("sign(q1 - 1.3) > 0", [1.3]),
        ("sign(q1 - 1.3) >= 0", [1.3]),
        ("max(q1 - 1.3, 0) > 0", [1.3]),
        ("max(q1 - 1.3, 0) >= 0", []),
        ("max(q1 - 1.3, 0)", []),
        ("min(q1, 1.3) >= 1.3", [1.3]),
        ("min(q1, 1.3) > 1.3", []),
        ("min(q1 - 1, 0) + max(q1 - 2, 0)", [2.0]),
        ("min(q1 - 1, 0) + max(q1 - 2, 0) >= 0", [1.0]),
        ("min(q1 - 0.5, 2.5 - q1) > 0", [0.5]),
        ("1 if abs(t - 1.2345) < 1e-6 else -1", [1.2345 - 1e-6, 1.2345 + 1e-6]),
        ("(1 if abs(t - 1.2345) < 1e-9 else -1) > 0", [1.2345 - 1e-9]),
        ("-1 if q1 > 1.5 else 1", [1.5]),
        ("(q1 - 1) if q1 < 2 else (2.5 - q1)", [1.0, 2.5]),
        ("(q1 - 5) if q1 < 2 else (q1 + 1)", [2.0]),
        ("1/(q1 - 1.3)", [1.3]),
        ("1/(q1 - 1.3) > 0", [1.3]),
        ("1/(q1 - 1.3)**2 > 0", []),
        ("tan(q1)", [math.pi / 2]),
        ("(q1 % 0.5) - 0.25", [0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 2.75]),
        ("q1 % 0.5 > 0.25", [0.25, 0.75, 1.25, 1.75, 2.25, 2.75]),
        ("sqrt(q1 - 1) > 0.5", [1.25]),
        ("sqrt(q1 - 1) >= 0", [1.0]),
        ("sqrt(q1 - 1) > 0", [1.0]),
        ("sqrt(q1 - 1) - 0.5", [1.25]),
        ("sqrt(2 - q1) < 0.5", [1.75]),
        ("log(q1) > 0", [1.0]),
        ("log(q1 - 2)", []),
        ("log(q1 - 1)", [2.0]),
        ("log(q1, 3) > 0.5", [math.sqrt(3)]),
        ("asin(q1) > 1", [math.sin(1)]),
        ("acos(q1/2) < 0.5", [2 * math.cos(0.5)]),
        ("(q1 - 1)**0.5 > 0.5", [1.25]),
        ("sin(q1)/q1 > 0.5", []),
        ("sin(q1)/q1 < 0.5", [1.895494267033981]),
        ("sin(q1 - 1)/(q1 - 1) - 0.5", [2.895494267033981]),
        ("atan2(sin(3*q1), cos(3*q1)) > 3", [1.0]),
        ("hypot(q1 - 1, 1e-3) < 2e-3", [1 - math.sqrt(3e-6)]),
        ("hypot(q1 - 1) < 2e-3", [1 - 2e-3]),
        ("(q1 > 1)*(q1 < 2) > 0", [1.0]),
        ("(q1 > 1) - (t > 1.5) > 0", [1.0]),
        ("-(q1 > 1) + 0.5", [1.0]),
        ("q1 - q1 > 0", []),
        ("q1 - q1 >= 0", []),
        ("q1 - q1", []),
        ("(q1 if q1 > 1 else -q1) > 0", [1.0]),
    ],
)
@pytest.mark.thinned
def test_bends_and_jumps(
    pendulum: Mechanism, look: Callable, ends: list[float], text: str, roots: list[float]
) -> None:
    watch = look(pendulum, text, ends)
    check(watch, roots)
    assert not watch.lost


@pytest.mark.parametrize("look", [watched, together, unclosed])
def test_a_root_is_as_steep_as_can_be_and_touches_no_zero(
    pendulum: Mechanism, look: Callable
) -> None:
    for ends in PARTS:
        with case(len(ends)):
            watch = look(pendulum, "sqrt(abs(q1 - 1.5)) - 0.5", ends)
            check(watch, [1.25, 1.75])
            assert not watch.grazes


@each("seed", range(60 if FRESH else 16))
def test_random_polynomials(pendulum: Mechanism, seed: int) -> None:
    """Products of factors with known roots, some of them close or double, on random steps."""
    rng = np.random.default_rng(seed)
    simple = rng.uniform(0.05, 2.95, rng.integers(1, 6)).tolist()
    simple += [simple[0] + 10.0 ** rng.uniform(-9, -3)]
    double = rng.uniform(0.05, 2.95, rng.integers(0, 3)).tolist()
    factors = [f"(q1 - {x!r})" for x in simple] + [f"(t - {x!r})**2" for x in double]
    rng.shuffle(factors)
    scale = 10.0 ** rng.uniform(-30, 30)
    ends = [0.0, *sorted(rng.uniform(0, 3, rng.integers(0, 12)).tolist()), 3.0]
    for look in (watched, together, unclosed):
        watch = look(pendulum, "*".join([repr(scale), *factors]), ends)
        check(watch, sorted(simple), 1e-11)


@each("seed", range(40 if FRESH else 6))
def test_random_waves(pendulum: Mechanism, seed: int) -> None:
    """Sums of waves against roots on a fine grid in 30 digits."""
    rng = np.random.default_rng(1000 + seed)
    a, b = rng.uniform(-2, 2, 3).tolist(), rng.uniform(1, 30, 3).tolist()
    text = " + ".join(f"{x!r}*sin({y!r}*q1)" for x, y in zip(a, b, strict=True)) + " + 0.1"

    def f(t: mpmath.mpf) -> mpmath.mpf:
        return sum(x * mpmath.sin(y * t) for x, y in zip(a, b, strict=True)) + 0.1

    grid = np.arange(3001) / 1000  # the values are beyond rounding there
    values = sum(x * np.sin(y * grid) for x, y in zip(a, b, strict=True)) + 0.1
    assert np.abs(values).min() > 1e-12
    pairs = np.flatnonzero(values[:-1] * values[1:] < 0)
    with mpmath.workdps(30):
        roots = [
            float(mpmath.findroot(f, (grid[k], grid[k + 1]), solver="anderson")) for k in pairs
        ]
    for look in (watched, together, unclosed):
        for ends in (ONE, SOME):
            check(look(pendulum, text, ends), roots)


def test_backwards(pendulum: Mechanism) -> None:
    check(watched(pendulum, "sin(5*q1) > 0", BACK), [-k * math.pi / 5 for k in (1, 3)])
    check(watched(pendulum, "floor(q1) < -1", BACK), [-1.0])
    check(watched(pendulum, "abs(q1 + 1.3) < 1e-9", BACK), [-1.3 + 1e-9])


def test_what_changes_too_often_is_said(pendulum: Mechanism) -> None:
    with pytest.warns(RobodynWarning, match="passes zero too often to be followed, as at t = 0 s"):
        watch = watched(pendulum, "sin(1e12*t)", [0.0, 1.0])
    assert watch.lost
    assert "too often" in " ".join(watch.remarks())


def test_what_changes_too_often_is_said_soon(pendulum: Mechanism) -> None:
    """Of functions called at most 300,000: a run without the event calls some 10,000."""
    left = 300_000

    def count(*_: object) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            sys.setprofile(None)
            raise TimeoutError("not a word so far")

    simulate(pendulum, [0.3], [0.0], 1.0)  # imports are not counted
    before = sys.getprofile()
    sys.setprofile(count)
    try:
        with pytest.raises(RobodynWarning, match="too often"):
            simulate(pendulum, [0.3], [0.0], 1.0, events={"x": "abs(sin(1e8*t))"})
    finally:
        sys.setprofile(before)


def test_what_has_one_sign_passes_nothing_where_it_is_zero(pendulum: Mechanism) -> None:
    """No rounding hides whether it does: nothing is said of it."""
    for text in ("abs(q1 - 1.3)**0.5", "sqrt(abs(q1 - 1.3)) - 0", "hypot(q1 - 1.3, t - 1.3)"):
        for look in (watched, together):
            with case(text, look):
                watch = look(pendulum, text, [0.0, 1.0, 2.0])
                assert not watch.events
                assert not watch.grazes


def test_nothing_is_watched(pendulum: Mechanism) -> None:
    assert EventWatch([], 2.0).look(segment_of([0.0, 1.0, 2.0])) is None


# Zeros of functions that are not linear, against another search.


END, POINTS, NEAR = 3.0, 12001, 10  # s, of a grid; points that one polynomial goes through
TEXTS = (
    "sin(q1)*qd2 - 0.3*t", "q1*qd2 - {c}", "qd1/(2 + cos(q2)) - {c}", "qd1*qd2 + sin(t) - {c}",
    "cos(3*q1 + q2)*exp(-0.2*t) - {c}", "q2**2 - {c}*qd1", "sqrt(4 + q1**2)*sin(q2) - {c}",
    "qd1**2 + qd2**2 > {c}", "abs(q1) < {c}", "(q1 - {c})*(qd2 - {c})", "atan2(sin(q1), 2) - {c}*t",
)  # fmt: skip


def values(text: str, t: Array, q: Array, qd: Array) -> Array:
    """Of the side that changes sign, by numpy alone."""
    for sign in "<>":
        text = text.replace(sign, "-")
    known = {name: getattr(np, name) for name in ("sin", "cos", "exp", "sqrt", "abs")}
    known |= {"t": t, "atan2": np.arctan2}
    known |= {f"q{k + 1}": q[:, k] for k in range(q.shape[1])}
    known |= {f"qd{k + 1}": qd[:, k] for k in range(q.shape[1])}
    return np.asarray(eval(text, known), float)


def searched(text: str, t: Array, f: Array) -> list[float]:
    """When f (a grid's values) changes its sign in the way that counts: by polynomials near it."""
    way = {"<": -1.0, ">": 1.0}.get(next(iter(set("<>") & set(text)), ""), 0.0)
    found = []
    for i in np.flatnonzero(f[:-1] * f[1:] < 0.0).tolist():
        if way * (f[i + 1] - f[i]) < 0.0:
            continue
        first = min(max(i - NEAR // 2 + 1, 0), len(t) - NEAR)
        x, y = np.arange(NEAR) - float(i - first), f[first : first + NEAR]
        others = x[:, None] - x + np.eye(NEAR)
        weights = 1.0 / others.prod(axis=1)
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            terms = weights / (middle - x)
            same = (terms @ y / terms.sum()) * f[i] > 0.0
            low, high = (middle, high) if same else (low, middle)
        found.append(float(t[i] + 0.5 * (low + high) * (t[i + 1] - t[i])))
    return found


@pytest.mark.parametrize("method", ["DOP853", "taylor"])
def test_against_a_search_on_the_motion(method: str) -> None:
    """Random levels: as many zeros, and at the same times."""
    rng = np.random.default_rng(5)
    named: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-12, "method": method}
    count = 0
    for scene, rate in (("2r", 0.0), ("2r", 3.0), ("four-bar", 4.0)):
        given = *start(scene, rate), END
        grid = robodyn.simulate(*given, **named, t_eval=np.linspace(0.0, END, POINTS))
        events = {}
        for i, text in enumerate(TEXTS):
            f = values(text.format(c=0.0), grid.t, grid.q, grid.qd)
            events[f"e{i}"] = text.format(c=round(float(rng.uniform(f.min(), f.max())), 3))
        motion = robodyn.simulate(*given, **named, events=events)
        for name, text in events.items():
            with case(method, scene, rate, text):
                one = [x for x in motion.events if x.name == name]
                times = searched(text, grid.t, values(text, grid.t, grid.q, grid.qd))
                assert len(one) == len(times)
                for event, t in zip(one, times, strict=True):
                    assert abs(event.t - t) <= 1e-12 * END + event.apart
                    assert event.apart < 1e-9
                count += len(times)
    assert count > 60
