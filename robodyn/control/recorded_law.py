"""A law as formulas, of which its code is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from robodyn.control.driven_torques import Floats
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.engines.source_text import float_source
from robodyn.engines.straightline import define


class RecordedLaw:
    """Torques of `joints` and the rates of a law's own states, of t, q0.., qd0.. (n) and z0...

    `lines` set further inputs.
    """

    def __init__(self, n: int, joints: int, states: int) -> None:
        self.graph, self.n, self.joints, self.states = Graph(), n, joints, states
        count = {"q": n, "qd": n, "z": states}
        self.inputs = [f"{name}{i}" for name, most in count.items() for i in range(most)]
        self.lines: list[str] = []
        self.scope: dict[str, object] = {}
        self.asked: list[Value] = []
        self.outputs: list[Value] = []

    def variables(self, name: str, count: int) -> list[Value]:
        """The inputs called so: name0, name1, ..."""
        return [self.graph.variable(f"{name}{i}") for i in range(count)]

    def ask(self, model: Floats, asked: Sequence[Value]) -> list[Value]:
        """What a model answers, a number for each joint."""
        self.scope["model"], self.asked = model, [*asked]
        return self.variables("g", self.joints)

    def code(self) -> Callable[..., Any]:
        """The law as a function of floats; the model is asked as soon as its inputs are known."""
        lines, shown = float_source([*self.asked, *self.outputs])
        last = max((x.index for x in self.asked if isinstance(x, Expression)), default=-1)
        first = sum(int(line[1 : line.index(" ")]) <= last for line in lines)
        calls = []
        if self.asked:
            given = ", ".join(shown[: len(self.asked)])
            calls.append(f"{', '.join(f'g{j}' for j in range(self.joints))}, = model({given})")
        result = f"return ({', '.join(shown[len(self.asked) :])},)"
        body = "\n    ".join([*self.lines, *lines[:first], *calls, *lines[first:], result])
        head = f"def control({', '.join(['t', *self.inputs])}):"
        return define(f"{head}\n    {body}\n", "control", scope=self.scope)
