"""A law as formulas, of which its code is written, and that of how it changes with the state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from robodyn.control.driven_torques import Floats
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.engines.source_text import float_source
from robodyn.engines.straightline import FloatFunction, define
from robodyn.engines.tangents import Tangents, tangents


class RecordedLaw:
    """Torques of `joints` and the rates of a law's own states, of t, q0.., qd0.. (n) and z0...

    `lines` set further inputs: each of those in `follows` goes as the input that it names, or as t.
    """

    def __init__(self, n: int, joints: int, states: int) -> None:
        self.graph, self.n, self.joints, self.states = Graph(), n, joints, states
        count = {"q": n, "qd": n, "z": states}
        self.inputs = [f"{name}{i}" for name, most in count.items() for i in range(most)]
        self.lines: list[str] = []
        self.follows: dict[str, str] = {}
        self.scope: dict[str, object] = {}
        self.asked: list[Value] = []
        self.outputs: list[Value] = []
        self._slopes: Callable[[], Floats]
        self._made: dict[tuple[int, bool], FloatFunction] = {}

    def variables(self, name: str, count: int) -> list[Value]:
        """The inputs called so: name0, name1, ..."""
        return [self.graph.variable(f"{name}{i}") for i in range(count)]

    def ask(
        self, model: Floats, slopes: Callable[[], Floats], asked: Sequence[Value]
    ) -> list[Value]:
        """What a model answers, a number for each joint; `slopes` are by each thing asked."""
        self.scope["model"], self._slopes, self.asked = model, slopes, [*asked]
        return self.variables("g", self.joints)

    def code(self) -> Callable[..., Any]:
        """The law as a function of floats."""
        return self._written("control", self.inputs, self.outputs)

    def along(self, count: int, timed: bool = False) -> FloatFunction:
        """The law, and how what it gives changes along `count` ways; of floats.

        Of t and the state, then of d(q, qd) of each way, then of their dz.  What it gives is
        followed by d tau of each way, then by their dzd.  If `timed`, the last goes on with time.
        """
        if (count, timed) not in self._made:
            self._made[count, timed] = self._along(count, timed)
        return self._made[count, timed]

    def _along(self, count: int, timed: bool) -> FloatFunction:
        ways, wide = [str(k) for k in range(count)], 2 * self.n
        by: dict[str, Tangents] = {"t": {ways[-1]: 1.0} if timed else {}}
        for i, x in enumerate(self.inputs):
            by[x] = {k: self.graph.variable(f"s{k}_{i}") for k in ways}
        by |= {x: by[y] for x, y in self.follows.items()}
        slopes: list[str] = []
        if self.asked:
            moved = tangents(self.asked, by)
            for j in range(self.joints):
                own = [f"b{j}_{i}" for i in range(len(moved))]
                slopes += own
                each = [(self.graph.variable(x), s) for x, s in zip(own, moved, strict=True)]
                by[f"g{j}"] = {k: sum(b * s[k] for b, s in each if k in s) for k in ways}
            self.scope["model_slopes"] = self._slopes()
        rows = tangents(self.outputs, by)
        parts = rows[: self.joints], rows[self.joints :]
        found = [row.get(k, 0.0) for part in parts for k in ways for row in part]
        spans = range(wide), range(wide, wide + self.states)
        names = [f"s{k}_{i}" for span in spans for k in ways for i in span]
        return self._written("along", [*self.inputs, *names], [*self.outputs, *found], slopes)

    def _written(
        self, name: str, inputs: Sequence[str], outputs: Sequence[Value], slopes: Sequence[str] = ()
    ) -> Callable[..., Any]:
        """The model is asked as soon as what it is asked is known, and for its `slopes`."""
        asked = self.asked * (1 + bool(slopes))
        lines, shown = float_source([*asked, *outputs])
        last = max((x.index for x in asked if isinstance(x, Expression)), default=-1)
        first = sum(int(line[1 : line.index(" ")]) <= last for line in lines)
        calls = []
        if asked:
            given = ", ".join(shown[: len(self.asked)])
            calls.append(f"{', '.join(f'g{j}' for j in range(self.joints))}, = model({given})")
        if slopes:
            calls.append(f"{', '.join(slopes)}, = model_slopes({given})")
        result = f"return ({', '.join(shown[len(asked) :])},)"
        body = "\n    ".join([*self.lines, *lines[:first], *calls, *lines[first:], result])
        head = f"def {name}({', '.join(['t', *inputs])}):"
        return define(f"{head}\n    {body}\n", name, scope=self.scope)
