"""Zeros of functions that are not linear: all steps together, one by one, and by another search."""

from typing import Any

import numpy as np
import pytest
from example_starts import start
from named_case import case
from numpy.typing import NDArray

import robodyn
from robodyn.events import single_zeros

Array = NDArray[np.float64]
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
