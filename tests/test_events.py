"""Events: every crossing is found, none is invented, and what rounding hides is said."""

import math
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
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
from robodyn.errors import InputError
from robodyn.events import single_zeros
from robodyn.events.functions import EventFunction, event_function, event_functions
from robodyn.events.pieces import Step
from robodyn.events.single_zeros import Budget
from robodyn.events.watch import EventWatch
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.expressions import FUNCTIONS
from robodyn.simulation.simulation import simulate
from robodyn.taylor.compiled import CompiledEngine

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def pendulum() -> Mechanism:
    return load("robots/pendulum.yaml")


def turning(t: Array) -> Array:
    """q1 = t, qd1 = 1."""
    return np.stack([t, np.ones_like(t)], axis=-1)


def watched(
    mechanism: Mechanism,
    text: str,
    ends: list[float],
    states: Callable[[Array], Array] = turning,
) -> EventWatch:
    """The events of one expression along steps between `ends`."""
    watch = EventWatch(event_functions(mechanism, {"e": text}), ends[-1] - ends[0])
    for begin, end in pairwise(ends):
        watch.step(Step(begin, end, states(np.array([end]))[0], states))
    return watch


def by_series(
    mechanism: Mechanism, text: str, ends: list[float], boxed: bool = False
) -> EventWatch:
    """The same, of steps looked at together."""
    from robodyn.events.single_zeros import NODES

    times = np.array(ends)
    watch = EventWatch(event_functions(mechanism, {"e": text}), ends[-1] - ends[0])
    at = times[:-1, None] + np.diff(times)[:, None] * NODES
    sampled = turning(at.ravel()).reshape(*at.shape, 2)
    last = turning(times[1:])
    half = 0.5 * np.diff(times)
    middle, reach = turning(times[:-1] + half), np.zeros((len(half), 2))
    reach[:, 0] = np.abs(half) + 1e-12 if boxed else np.inf
    watch.series(
        times,
        np.stack([middle, reach], axis=1),
        sampled.__getitem__,
        last,
        lambda j: Step(ends[j], ends[j + 1], last[j], turning),
        False,
        lambda _, t: turning(t),
    )
    return watch


def by_boxes(mechanism: Mechanism, text: str, ends: list[float]) -> EventWatch:
    """The same, of steps whose boxes tell."""
    return by_series(mechanism, text, ends, True)


def check(watch: EventWatch, roots: list[float], within: float = 1e-12) -> None:
    found = [event.t for event in watch.found]
    assert len(found) == len(roots), (found, roots)
    for t, root, event in zip(found, roots, watch.found, strict=True):
        assert abs(t - root) <= within * max(1.0, abs(root)) + event.apart, (t, root, event.apart)


ONE = [0.0, 3.0]  # ends of steps
SOME = [0.0, 0.4, 1.0, 1.3, 2.9, 3.0]
BACK = [0.0, -0.4, -1.0, -1.3, -2.9, -3.0]
PART = math.sqrt(math.log(1e7) / 50)
PARTS = [ONE, SOME, [x / 64 for x in range(193)]]


@pytest.mark.parametrize("look", [watched, by_series, by_boxes])
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
    if watch.found:
        check(watch, [first - gap / 2, first + gap / 2], 1e-12)
    else:
        assert gap < 1e-7
        assert watch.grazes["e"] == pytest.approx([first], abs=1e-6)


@pytest.mark.parametrize("look", [watched, by_series, by_boxes])
@pytest.mark.parametrize("ends", PARTS)
@pytest.mark.parametrize("depth", [10.0**-k for k in range(2, 20)])
@pytest.mark.thinned
def test_grazes(pendulum: Mechanism, look: Callable, ends: list[float], depth: float) -> None:
    """sin t comes within `depth` of a level, from below and above: none, two, or a graze said."""
    level = 1.0 - depth
    near = 1.0 - level  # what is left of it
    watch = look(pendulum, f"sin(q1) > {level!r}", ends)
    root = math.asin(level) if near > 1e-9 else math.pi / 2 - math.sqrt(2 * near)
    assert len(watch.found) <= 1
    if near > 1e-14:
        check(watch, [root])
    elif not watch.found:
        assert watch.grazes["e"] == pytest.approx([math.pi / 2], abs=1e-6)
    watch = look(pendulum, f"sin(q1) - {1.0 + depth!r}", ends)
    check(watch, [])
    assert watch.grazes or depth > 5e-16
    assert not watch.grazes or depth < 1e-13


@pytest.mark.parametrize("look", [watched, by_series, by_boxes])
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


@pytest.mark.parametrize("look", [watched, by_series, by_boxes])
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


@pytest.mark.parametrize("look", [watched, by_series, by_boxes])
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
    for look in (watched, by_series, by_boxes):
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
    for look in (watched, by_series, by_boxes):
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


@pytest.mark.xfail(strict=True, reason="waits for: one root finder", raises=TimeoutError)
def test_what_changes_too_often_is_said_soon(pendulum: Mechanism) -> None:
    """Of functions called at most 300,000: a run without the event calls some 10,000."""
    left = 300_000

    def count(*_: object) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            sys.setprofile(None)
            raise TimeoutError("not a word so far")

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
        for look in (watched, by_series):
            with case(text, look):
                watch = look(pendulum, text, [0.0, 1.0, 2.0])
                assert not watch.found
                assert not watch.grazes


def test_nothing_is_watched(pendulum: Mechanism) -> None:
    watch, none = EventWatch([], 2.0), np.zeros((0, 2))
    times, boxes = np.array([0.0, 1.0, 2.0]), np.zeros((2, 2, 2))
    nothing = (lambda _: none, none, lambda _: None, True, lambda *_: none)
    assert watch.series(times, boxes, *nothing) is None


# Boxes that tell steps without an event: they hold the state, and no value leaves its bounds.


UNARY = [name for name in FUNCTIONS if name not in ("atan2", "min", "max", "hypot")]
SCENES = (
    "2r", "four-bar", "cart-pole", "whitworth", "pendulum", "3r", "rp-arm", "hydraulic-boom",
    "slider-crank", "geared-five-bar", "stephenson-six-bar", "balanced-arm", "toggle-press",
)  # fmt: skip


def expression(rng: np.random.Generator, depth: int) -> str:
    """Of t, q1, q2, qd1 and qd2, with all that an event may have."""

    def part() -> str:
        return expression(rng, depth - 1)

    if depth == 0 or rng.random() < 0.1:
        number = f"{rng.uniform(-2, 2):.3f}"
        return str(rng.choice(["t", "q1", "q2", "qd1", "qd2", number]))
    kind = rng.integers(0, 8)
    if kind == 0:
        return f"{rng.choice(UNARY)}({part()})"
    if kind == 1:
        return f"({part()})**{rng.choice(['2', '3', '-1', '0.5', '-2', '1.5', '0'])}"
    if kind == 2:
        return f"{rng.choice(['atan2', 'min', 'max', 'hypot', 'log'])}({part()}, {part()})"
    if kind == 3:
        test = f"{part()} {rng.choice(['<', '>='])} {part()}" if rng.random() < 0.8 else part()
        return f"({part()} if {test} else {part()})"
    if kind == 4:
        return f"(exp({part()}))**({part()})"
    return f"({part()} {rng.choice(['+', '-', '*', '/', '%'])} {part()})"


def made(mechanism: Mechanism, rng: np.random.Generator, depth: int) -> EventFunction:
    while True:
        text = expression(rng, depth)
        if re.search(r"\b(t|qd?[12])\b", text):
            with suppress(InputError):  # it has a part such as (-1)^0.5
                return event_function(mechanism, "e", text, text)


@pytest.mark.parametrize("seed", range(20 if FRESH else 8))
def test_no_value_in_a_box_is_further_off(seed: int) -> None:
    """Random expressions in random boxes, against many points of each, its corners among them."""
    rng = np.random.default_rng(seed)
    arm = load("robots/2r.yaml")
    certain = 0
    for _ in range(25):
        function = made(arm, rng, int(rng.integers(1, 5)))
        middle = rng.uniform(-3, 3, (30, 5))
        reach = 10.0 ** rng.uniform(-6, 0, (30, 1)) * rng.uniform(0, 1, (30, 5))
        begin, end = (middle + sign * reach for sign in rng.permutation([-1, 1]))
        box = begin[:, 0], end[:, 0], middle[:, 1:], reach[:, 1:]
        within = rng.uniform(-1, 1, (200, 30, 5))
        within[:100] = np.sign(within[:100])
        points = (middle + reach * within).reshape(-1, 5)
        with np.errstate(all="ignore"):
            steady = np.ones(30, bool)  # no switch passes zero
            for part in (*function.switches, function):
                assert part.around is not None
                value, off = (np.broadcast_to(x, 30) for x in part.around(*box))
                there = part.values(points[:, 0], points[:, 1:]).reshape(200, 30)
                sure = steady & np.isfinite(off)
                noise = 1e-13 * (1.0 + np.abs(value)) + 1e-13 * np.abs(off)
                assert (np.abs(there - value) <= off + noise)[:, sure].all(), function
                steady &= np.abs(value) > off
                assert (np.sign(there) == np.sign(value))[:, steady].all()
        certain += int(steady.sum())
    assert certain > 100  # it does tell something


RTOLS = (1e-6, 1e-9, 1e-13)


@pytest.mark.parametrize(
    ("scene", "rtol"),
    [
        (scene, rtol)
        for k, scene in enumerate(SCENES)
        for rtol in (RTOLS if FRESH else [RTOLS[k % 3]])
    ],
)
def test_the_state_stays_in_its_box(scene: str, rtol: float) -> None:
    mechanism, *_ = start(scene, 0.0)
    still = Actuation((0.0,) * mechanism.n)
    engine = CompiledEngine(mechanism, still, rtol=rtol, atol=rtol)
    engine.keeps = True
    for rate in (0.0, 2.0, -9.0):
        _, q, qd = start(scene, rate)
        y = np.concatenate([q, qd])
        for end in (0.7, -0.7):
            chunk = engine.advance(0.0, y, end, np.zeros(0), 8)
            boxes = chunk.kept.boxes.copy()
            times, states = np.append(0.0, chunk.t), np.concatenate([y[None], chunk.y])
            assert len(times) > 1
            widths = boxes[:, 1, mechanism.n :] / (1.0 + np.abs(states[1:, mechanism.n :]))
            assert np.median(widths) < 2.0
            for j, box in enumerate(boxes):
                dense = engine.dense(times[j], states[j], times[j + 1])
                within = dense(np.linspace(times[j], times[j + 1], 12)[1:])
                within = np.concatenate([within, states[j : j + 2]])
                assert (np.abs(within - box[0]) <= box[1] * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.thinned
@pytest.mark.filterwarnings("ignore:.* passes zero too often")
def test_boxes_change_no_event(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same events without them."""
    rng = np.random.default_rng(100 + seed)
    scene = ("2r", "four-bar", "cart-pole")[seed % 3]
    mechanism, q, qd = start(scene, 3.0)
    functions = [made(mechanism, rng, int(rng.integers(1, 4))) for _ in range(3)]
    budget = partial(Budget, left=200)  # what changes sign without end would take long
    monkeypatch.setattr("robodyn.events.watch.Budget", budget)
    texts = {"a": "q1 > 3.5", "b": "qd1", "c": "sin(3*q2) > 0.2", "d": "q1*qd2 - t"}

    def found() -> tuple[list[Any], list[Any]]:
        from robodyn.simulation import simulation

        def watched(*_: Any) -> EventWatch:
            return watches[-1]

        named = [replace(each, name=f"e{i}") for i, each in enumerate(functions)]
        own = [event_function(mechanism, name, text, "") for name, text in texts.items()]
        watches = [EventWatch([*own, *named], 0.6)]
        monkeypatch.setattr(simulation, "watched_events", watched)
        motion = simulate(mechanism, q, qd, 0.6, method="taylor", events=texts)
        watch = watches[-1]
        return motion.events, [watch.grazes, watch.lost, watch.happened, watch.signs]

    with_boxes, known = found()
    monkeypatch.setattr(
        "robodyn.events.watch.by_boxes", lambda function, *box: np.zeros(len(box[0]), np.int64)
    )
    without, same = found()  # matrices of other sizes round in other ways
    assert same == known
    for one, other in zip(with_boxes, without, strict=True):
        assert one.name == other.name
        assert abs(one.t - other.t) <= 1e-14 + other.apart


def test_boxes_tell_most_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is far from an event costs no look at the series."""
    looks: list[int] = []
    look = single_zeros.single_zeros
    monkeypatch.setattr(
        single_zeros,
        "single_zeros",
        lambda f, *given: looks.append(len(given[0].begin)) or look(f, *given),
    )
    mechanism, q, qd = start("four-bar", 5.0)
    steps = 0
    for text, most in (("q1 < -200deg", 0.0), ("qd1 > 0", 0.1), ("sin(q2)", 0.2)):
        looks.clear()
        motion = simulate(mechanism, q, qd, 5.0, method="taylor", events={"e": text})
        steps = motion.report.steps
        assert sum(looks) <= most * steps, (text, looks, steps)
    assert steps > 50
    assert math.isfinite(motion.t[-1])


# Zeros of functions that are not linear: all steps together, one by one, and by another search.


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
def test_against_a_search_on_the_motion(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random levels: as many zeros, and at the same times; by each step alone they are the same."""
    rng = np.random.default_rng(5)
    named: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-12, "method": method}
    located, count = single_zeros._located, 0
    singly: list[int] = []
    monkeypatch.setattr(
        single_zeros,
        "_located",
        lambda f, steps, at, *c: singly.append(len(at)) or located(f, steps, at, *c),
    )
    for scene, rate in (("2r", 0.0), ("2r", 3.0), ("four-bar", 4.0)):
        given = *start(scene, rate), END
        grid = robodyn.simulate(*given, **named, t_eval=np.linspace(0.0, END, POINTS))
        events = {}
        for i, text in enumerate(TEXTS):
            f = values(text.format(c=0.0), grid.t, grid.q, grid.qd)
            events[f"e{i}"] = text.format(c=round(float(rng.uniform(f.min(), f.max())), 3))
        motion = robodyn.simulate(*given, **named, events=events)
        with monkeypatch.context() as patch:
            patch.setattr(single_zeros, "single_zeros", unknown)
            alone = robodyn.simulate(*given, **named, events=events)
        assert motion.report.remarks == alone.report.remarks
        for name, text in events.items():
            with case(method, scene, rate, text):
                one, other = ([x for x in m.events if x.name == name] for m in (motion, alone))
                times = searched(text, grid.t, values(text, grid.t, grid.q, grid.qd))
                assert len(one) == len(other) == len(times)
                for event, same, t in zip(one, other, times, strict=True):
                    assert abs(event.t - same.t) <= 1e-12 * END + event.apart
                    assert abs(event.t - t) <= 1e-12 * END + event.apart
                    assert event.apart < 1e-9
                count += len(times)
    assert count > 60
    assert sum(singly) > 0.8 * count  # most of them together


def unknown(function: Any, steps: single_zeros.Steps, *_: Any) -> single_zeros.Zeros:
    """Nothing is known of any step: each is looked at by itself."""
    none = np.zeros(len(steps.begin), np.int64)
    return single_zeros.Zeros(none, none, *single_zeros.NONE)
