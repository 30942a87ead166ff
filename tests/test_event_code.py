"""Events found in machine code: the same as those found from Python, and where it hands over."""

import ctypes
from collections import Counter
from typing import Any

import mpmath
import numpy as np
import pytest
from example_starts import start
from numpy.typing import NDArray

import robodyn
from robodyn.engines import machine
from robodyn.events.functions import event_functions
from robodyn.events.rounding import EPS
from robodyn.events.told import Events
from robodyn.events.watch import EventWatch
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism
from robodyn.taylor import Status
from robodyn.taylor.compiled import CompiledEngine
from robodyn.taylor.coordinate_code import binomials, computed
from robodyn.taylor.function_code import wide
from robodyn.taylor.watched_code import looks

Array = NDArray[np.float64]

pytestmark = pytest.mark.skipif(not machine.available(), reason="needs llvmlite")
SCENES = ("2r", "cart-pole", "four-bar", "rp-arm", "whitworth", "pendulum", "3r")


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[bool]:
    """How often machine code was asked for events, by whether it was sure of them."""
    counted: Counter[bool] = Counter()
    watched = CompiledEngine._watched

    def watch(self: CompiledEngine, *given: Any) -> Any:
        chunk = watched(self, *given)
        counted[chunk is not None] += 1
        return chunk

    monkeypatch.setattr(CompiledEngine, "_watched", watch)
    return counted


def from_python(monkeypatch: pytest.MonkeyPatch, *given: Any, **named: Any) -> robodyn.Motion:
    with monkeypatch.context() as patch:
        patch.setattr(EventWatch, "forms", lambda *_: None)
        return robodyn.simulate(*given, **named)


def same_events(monkeypatch: pytest.MonkeyPatch, *given: Any, **named: Any) -> list[Any]:
    """Pairs of the events that machine code and Python find, at the same times."""
    motion = robodyn.simulate(*given, **named)
    other = from_python(monkeypatch, *given, **named)
    assert motion.report.events == other.report.events
    pairs = list(zip(motion.events, other.events, strict=True))
    for one, same in pairs:
        assert one.name == same.name
        assert abs(one.t - same.t) <= 1e-12 * abs(given[3]) + same.apart
    return pairs


def random_forms(rng: np.random.Generator, mechanism: Mechanism, motion: Any) -> dict[str, str]:
    """Linear functions with levels that the motion comes by."""
    given = {}
    for i in range(8):
        names = [f"{name}{j + 1}" for name in ("q", "qd") for j in range(mechanism.n)] + ["t"]
        chosen = rng.choice(len(names), rng.integers(1, 3), replace=False)
        weights = rng.uniform(-2.0, 2.0, len(chosen))
        columns = np.column_stack([motion.q, motion.qd, motion.t])[:, chosen] @ weights
        level = rng.uniform(columns.min(), columns.max())
        terms = " + ".join(
            f"{w!r}*{names[k]}" for k, w in zip(chosen, weights.tolist(), strict=True)
        )
        given[f"e{i}"] = f"{terms} {rng.choice(['-', '>', '<'])} {float(level)!r}"
    return given


@pytest.mark.parametrize("scene", SCENES)
def test_the_same_events(scene: str, calls: Counter[bool], monkeypatch: pytest.MonkeyPatch) -> None:
    """Random linear functions, against the signs that Python finds; forwards and backwards."""
    rng = np.random.default_rng(SCENES.index(scene))
    found = 0
    for rate, end, rtol in ((0.0, 3.0, 1e-9), (2.5, -3.0, 1e-9), (-4.0, 2.0, 1e-6)):
        given = *start(scene, rate), end
        how = {"method": "taylor", "engine": "compiled", "rtol": rtol, "atol": rtol}
        events = random_forms(rng, given[0], robodyn.simulate(*given, **how))
        pairs = same_events(monkeypatch, *given, **how, events=events)
        for one, same in pairs:
            assert one.apart <= 4.0 * same.apart + 1e-15
            scale = 1.0 + np.abs(same.y).max()
            moved = np.abs(one.t - same.t) * 1e3 + 1e-11
            np.testing.assert_allclose(one.y, same.y, rtol=0.0, atol=moved * scale)
        found += len(pairs)
    assert found >= 15
    assert calls[True] > calls[False]  # those where it was sure


@pytest.mark.parametrize("order", [9, 14, 21])
def test_the_slope_of_a_function_stays_within_its_bounds(order: int) -> None:
    """Along random pieces of a step; its polynomial is what its angles and rates are."""
    rng, polynomial = np.random.default_rng(order), np.polynomial.polynomial
    bounded = 0
    for name in ("cart-pole", "2r", "rp-arm", "3r"):
        mechanism, q, qd = start(name, 1.5)
        n, still = mechanism.n, Actuation((0.0,) * mechanism.n)
        engine = CompiledEngine(mechanism, still, rtol=1e-9, atol=1e-9, order=order)
        end = engine.advance(0.0, np.concatenate([q, qd]), 3.0, np.zeros(0), 1).t[0]
        scene, code, block, address = engine._made(None)
        looks(scene, code.code)
        at, number = ctypes.c_void_p, ctypes.c_double
        types = {
            "begin": (at, number, at, at),
            "about": (at, number, number, at, at, at),
            "slope": (at, at, number, number, at),
            "rows": (at, at, number, at),
        }
        call = {
            kind: code.code.function(f"event_{kind}", *given, result=None)
            for kind, given in types.items()
        }
        width = len(scene.loop.columns)
        z = block[scene.whole["rows"] :][: (order + 2) * width].reshape(-1, width)[:, : 2 * n]
        for j in set(range(n)) - set(mechanism.slides):  # of size 1, as far as the series goes
            turn = (z[:, 2 * j] + 1j * z[:, 2 * j + 1]) * end ** np.arange(order + 2)
            square = np.convolve(turn, turn.conj())[1 : order + 2]
            assert np.abs(square).max() <= 16.0 * EPS * np.abs(turn).sum() ** 2
        for trial in range(30):
            wild = trial >= 20  # a series that leaves much out
            if wild:
                way = rng.normal(size=(n, order + 2)) * np.geomspace(1.0, 1e-2, order + 2)
                way /= end ** np.arange(order + 2)
                for j in range(n):
                    turn = np.ones(order + 2, complex)
                    for m in range(order + 1):
                        slope_of = way[j, 1 : m + 2] * np.arange(1, m + 2)
                        turn[m + 1] = 1j * (slope_of @ turn[m::-1]) / (m + 1)
                    z[:, 2 * j], z[:, 2 * j + 1] = turn.real, turn.imag
            form, rows, slope = np.zeros(3 + 4 * n), np.zeros(computed(order)), np.zeros(2)
            parts, used = np.full(n * wide(order), np.nan), np.ones(n, np.int64)
            form[1] = rng.normal()
            form[2 + 2 * n : -1] = rng.normal(size=2 * n) * rng.integers(0, 2, 2 * n)
            cut = np.sort(rng.uniform(0.0, end, 2)) if rng.integers(0, 2) else np.array([0.0, end])
            x, half = cut.mean(), 0.5 * (cut[1] - cut[0])
            arrays = binomials(order), used, parts, form, slope, rows
            table, uses, to, given, slopes_at, rows_at = (a.ctypes.data for a in arrays)
            begins = rng.integers(0, 2) and not cut[0]
            if begins:
                x, half = 0.0, cut[1]
                call["begin"](address, half, uses, to)
            else:
                call["about"](address, x, half, table, uses, to)
            call["slope"](given, to, half, 1.0, slopes_at)
            call["rows"](given, to, half, rows_at)
            s = np.linspace(0.0 if begins else -1.0, 1.0, 41)
            t = x + half * s
            values, slopes = form[1] * t, np.full(len(t), form[1])
            for j in range(n):
                turn = [z[:, 2 * j] + 1j * z[:, 2 * j + 1]]
                turn += [polynomial.polyder(turn[0], m) for m in (1, 2)]
                e, ed, edd = (polynomial.polyval(t, x) for x in turn)
                way, rate = np.unwrap(np.angle(e)), (ed / e).imag
                change = (edd / e - (ed / e) ** 2).imag
                if j in mechanism.slides:
                    way, rate, change = e.imag, ed.imag, edd.imag
                by, by_rate = form[2 + 2 * n + j], form[2 + 3 * n + j]
                values += by * way + by_rate * rate
                slopes += by * rate + by_rate * change
            off = np.abs(half * slopes - slope[0])
            assert not (off > slope[1] * (1.0 + 1e-9) + 1e-15).any()  # not a number: no bound
            bounded += wild and slope[1] < np.inf
            if wild:
                continue
            largest = np.abs(form).max() * (1.0 + np.abs(qd).max())
            assert slope[1] < (4.0 if begins else 1.0) * largest
            rows[0] = values[0 if begins else 20]
            size = 1.0 + np.abs(values).max()
            missed = np.abs(polynomial.polyval(s, rows) - values).max()
            assert missed <= (1e-5 if order == 9 or begins else 1e-8) * size
    assert bounded >= 10


def test_a_pendulum_by_elliptic_integrals(calls: Counter[bool]) -> None:
    """Turning points and passages of the lowest point, found in machine code alone."""
    pendulum, *_ = start("pendulum", 0.0)
    link = 0.4, 0.26, 0.0088
    frequency = mpmath.sqrt(link[0] * 9.81 * link[1] / (link[2] + link[0] * link[1] ** 2))
    amplitude = 2.0
    quarter = mpmath.ellipk(mpmath.sin(amplitude / 2) ** 2) / frequency
    low = -float(mpmath.pi / 2)
    motion = robodyn.simulate(
        pendulum, [low + amplitude], [0.0], 20.0, method="taylor", engine="compiled",
        rtol=1e-14, atol=1e-14, events={"turns": "qd1", "low": "q1 + 90deg"},
    )  # fmt: skip
    assert calls == {True: calls[True]}
    assert len(motion.events) == int(20.0 / quarter) > 50
    for k, event in enumerate(motion.events, 1):
        assert event.name == ("turns", "low")[k % 2]
        assert abs(event.t - float(k * quarter)) < 1e-11


def test_two_in_one_step(calls: Counter[bool], monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels just below where a pendulum, or an arm, turns: machine code finds both passages."""
    for scene, level in (("pendulum", 1e-2), ("pendulum", 1e-5), ("2r", 1e-3), ("rp-arm", 1e-4)):
        for rtol, end in ((1e-6, 4.0), (1e-9, -4.0), (1e-13, 4.0)):
            given = *start(scene, 1.0), end
            how = {"method": "taylor", "engine": "compiled", "rtol": rtol, "atol": rtol}
            turns = robodyn.simulate(*given, **how, events={"turns": "qd1"}).events
            assert turns
            events = {
                f"e{i}": f"q1 - {float(turn.y[0]) * (1.0 - level)!r}"
                for i, turn in enumerate(turns[:6])
            }
            same_events(monkeypatch, *given, **how, events=events)
    assert calls == {True: calls[True]}


def test_what_it_is_not_sure_of(calls: Counter[bool], monkeypatch: pytest.MonkeyPatch) -> None:
    """A height that the pendulum comes back to and touches: Python looks, and tells the same."""
    pendulum, *_ = start("pendulum", 0.0)
    given = pendulum, [0.3], [0.0], 8.0
    how = {"method": "taylor", "engine": "compiled", "rtol": 1e-13, "atol": 1e-13}
    events = {"top": "q1 - 0.3", "turns": "qd1", "low": "q1 < -90deg"}
    motion = robodyn.simulate(*given, **how, events=events)
    other = from_python(monkeypatch, *given, **how, events=events)
    assert calls[False] > 0
    assert motion.report.events == other.report.events
    assert motion.report.remarks == other.report.remarks
    for one, same in zip(motion.events, other.events, strict=True):
        assert one.name == same.name
        assert abs(one.t - same.t) <= 1e-12 + same.apart


def test_what_is_not_linear_goes_to_python(calls: Counter[bool]) -> None:
    """Forms of expressions: their coefficients, and of what is no sum there is none."""
    mechanism, q, qd = start("2r", 0.0)
    texts = {
        "-q1 + 2*(qd2 - t)/4 > 90deg": [-np.pi / 2, -0.5, -1.0, 0.0, 0.0, 0.5],
        "(3 - 1)*q2": [0.0, 0.0, 0.0, 2.0, 0.0, 0.0],
        "q1*qd1": None, "sin(q1)": None, "abs(q1) - 1": None, "1/q1": None, "q1 % 2": None,
    }  # fmt: skip
    for text, expected in texts.items():
        (function,) = event_functions(mechanism, {"e": text})
        if expected is None:
            assert function.linear is None
        else:
            np.testing.assert_allclose(function.linear[:6], expected, rtol=1e-15)
    named = {"method": "taylor", "engine": "compiled", "events": {"e": "q1*qd1"}}
    assert robodyn.simulate(mechanism, q, qd, 2.0, **named).events
    assert not calls


@pytest.mark.parametrize("tol", [1e-4, 1e-9])
def test_a_step_next_to_a_change_point_is_made_again(tol: float) -> None:
    """It ends where it did: there too no shorter one would land on a good state."""
    met = 0
    for rate, bound in ((20.0, 3.0), (20.0, -3.0), (-60.0, 3.0), (5.0, -3.0)):
        mechanism, q, qd = start("parallelogram", rate)
        engine = CompiledEngine(mechanism, Actuation((0.0,) * 3), rtol=tol, atol=tol)
        y = np.concatenate([q, qd])
        chunk = engine.advance(0.0, y, bound, np.zeros(0), 64)
        met += chunk.status is Status.SINGULAR
        times, states = np.append(0.0, chunk.t), np.concatenate([y[None], chunk.y])
        for j in range(len(chunk.t)):
            again = engine.dense(times[j], states[j], times[j + 1])
            found = again(np.linspace(times[j], times[j + 1], 9))
            np.testing.assert_allclose(found[[0, -1]], states[j : j + 2], rtol=1e-10)
        np.testing.assert_allclose(engine.within(chunk.t[-1:]), chunk.y[-1:], rtol=1e-10)
    assert met == 4


def test_no_more_events_are_held_than_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are made when they are asked for, the first of them; all are counted."""
    monkeypatch.setattr("robodyn.events.told.MOST", 100)
    pendulum, *_ = start("pendulum", 0.0)
    named = {"method": "taylor", "engine": "compiled", "rtol": 1e-4, "atol": 1e-4}
    given = pendulum, [0.3], [0.0], 600.0
    motion = robodyn.simulate(*given, **named, events={"turns": "qd1"})
    events = motion.events
    assert isinstance(events, Events)
    packed = sum(map(len, events._record.packed))
    assert len(events) == 100 <= packed < 2000
    assert motion.report.events["turns"] > 700
    assert "the first 100 events are kept" in motion.report.remarks
    assert len(list(events)) == len(events) == 100
    assert events[:3] == list(events)[:3]
    assert events[-1] is list(events)[-1]
    both = robodyn.simulate(*given, **named, events={"back": "qd1 < 0", "down": "q1 < -90deg"})
    assert [e.name for e in both.events[:4]] == ["down", "back", "down", "back"]
    assert (np.diff([e.t for e in both.events]) > 0.0).all()
    assert sum(both.report.events.values()) > 700
