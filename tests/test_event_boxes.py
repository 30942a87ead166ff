"""Boxes that tell steps without an event: they hold the state, and no value leaves its bounds."""

import math
import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import FRESH
from example_starts import start
from numpy.typing import NDArray

from robodyn.events import single_zeros
from robodyn.events.functions import EventFunction, event_function
from robodyn.events.signs import Budget
from robodyn.events.watch import EventWatch
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.expressions import FUNCTIONS
from robodyn.simulation.simulation import simulate
from robodyn.taylor.compiled import CompiledEngine

Array = NDArray[np.float64]

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
