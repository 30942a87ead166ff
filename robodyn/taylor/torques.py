"""The Taylor series of a torque along a motion, order by order.

An expression of t, q and qd becomes a tree of `nodes.py`.  What has no series (comparisons, abs,
min, ... of the state, and functions of Python) is refused; those of time alone stand still between
the times at which they switch.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence
from typing import TypeVar

from robodyn import straightline
from robodyn.actuation import Actuation
from robodyn.errors import InputError
from robodyn.expression import FUNCTIONS
from robodyn.force_formulas import force_code
from robodyn.mechanics.torque_rows import linear_piece
from robodyn.mechanism import Mechanism
from robodyn.taylor.nodes import (
    Cosine,
    Exponential,
    Given,
    HyperbolicTangent,
    Node,
    Power,
    Primitive,
    Product,
    Quotient,
    Sine,
    Sum,
)

Push = Callable[[Sequence[float]], list[float]]
NodeT = TypeVar("NodeT", bound=Node)


class TorqueSeries:
    """The series of all joint torques: of an actuation, and of a scene's springs and the like.

    What `begin` gives returns the torques (n) of one order, and where the scene has forces of its
    own those again (n) without springs, whose work is no loss of energy.
    """

    def __init__(self, actuation: Actuation, mechanism: Mechanism) -> None:
        self.kinks = actuation.kinks
        self.linear = actuation.linear
        self.separate = mechanism.has_state_forces
        self.flat = bool(mechanism.friction)  # far above its speed all its derivatives vanish
        self.bends = self.separate or not self.linear
        self._function = actuation.function(mechanism.n)
        self._n = mechanism.n
        self._actuation, self._mechanism = actuation, mechanism
        self._held: tuple[float, ...] | None = None
        self._read()  # every branch must have a series
        if self.separate:
            self._forces = straightline.compile_forces(
                mechanism, {name: getattr(math, name) for name in FUNCTIONS}
            )

    def _read(self) -> None:
        """The nodes, as the switches of an expression are held."""
        self._reader = reader = _Reader(self._n, self._held)
        self._given = reader.actuation(self._actuation)
        self._taus = self._working = self._given
        if self.separate:
            self._working, self._taus = reader.scene(self._mechanism, self._given)

    def begin(self, t: float, y: Sequence[float], direction: float) -> Push:
        """A function from the coefficients of the joint rates of an order to those of the torques.

        It is called with order 0 first, and so on; y = (q, qd, ...) is the state at t.
        """
        pieces = self._actuation.pieces
        if pieces is not None and (held := pieces.at(t)) != self._held:
            self._held = held
            self._read()
        push = self._reader.begin(t, y, self._taus + self._working * self.separate)
        if self.linear:
            piece = linear_piece(self._actuation, self._function, t, y, direction)
            for node, value, slope in zip(self._given, *piece, strict=True):
                assert isinstance(node, Given)
                node.coming = [value, slope]
        return push

    def agrees(self, x: float, t: float, y: Sequence[float], relative: float, small: float) -> bool:
        """Whether the series, x after where it began, gives the torques at the state y at t.

        It does not where the torque ends or bends on the way (sqrt(1 - t), sqrt(t**2)), or is
        flat where it began (tanh(1e5*t), friction), or where a spring's ends pass one another.
        What it misses by may be `small`, N m, or that part of its terms.
        """
        nodes: list[Node] = []
        torques: list[float] = []
        try:
            if not self.linear:  # steps end where a table bends
                nodes, torques = list(self._given), self._function(t, y)
            if self.separate:
                nodes += self._reader.forces
                torques = [*torques, *self._forces(*y[: 2 * self._n])]
        except (ArithmeticError, ValueError):  # outside the domain
            return False
        for node, torque in zip(nodes, torques, strict=True):
            total = most = 0.0
            power = 1.0
            for value in node.values:
                term = value * power
                total += term
                most = max(most, abs(term))
                power *= x
            if not abs(total - torque) <= max(small, relative * most):
                return False
        return True


class _Reader:
    """Builds the nodes of expressions."""

    def __init__(self, n: int, held: Sequence[float] | None) -> None:
        self.n = n
        self.held = held  # of an expression's switches; None: whatever they are
        self.nodes: list[Node] = []  # each after its parts
        self.time: Given | None = None  # made where an expression names it, as these
        self.q: dict[int, Given] = {}
        self.qd: dict[int, Given] = {}
        self.names: dict[str, Node] = {}
        self.forces: list[Node] = []  # torques of springs (n), then of a scene's other forces (n)

    def actuation(self, actuation: Actuation) -> list[Node]:
        """The nodes of the joint torques (n) of an actuation; those of a table are given."""
        if actuation.constants is not None:
            return [self.constant(value) for value in actuation.constants]
        taus: list[Node] = [self.keep(Given()) for _ in range(self.n)]
        if actuation.linear:
            return taus
        if actuation.control is not None:
            raise _refused("a controller that acts continuously")
        for line in actuation.lines:
            match ast.parse(line).body:
                case [ast.Assign(targets=[ast.Name(id="_s")])]:
                    pass
                case [ast.Assign(targets=[ast.Name(id=name)], value=value)]:
                    taus[int(name.removeprefix("tau"))] = self.read(value)
                case _:
                    raise _refused("a function of Python")
        return taus

    def scene(self, mechanism: Mechanism, taus: list[Node]) -> tuple[list[Node], list[Node]]:
        """Those and the scene's own torques: without springs, and with them."""
        code = force_code(mechanism)
        for line in code.lines:
            name, _, text = line.partition(" = ")
            self.names[name] = self.read(ast.parse(text, mode="eval").body)

        def plus(nodes: list[Node], texts: tuple[str, ...]) -> list[Node]:
            parts = [self.read(ast.parse(text, mode="eval").body) for text in texts]
            self.forces = parts + self.forces
            pairs = zip(nodes, parts, texts, strict=True)
            return [a if text == "0.0" else self.keep(Sum(a, b, 1.0, 1.0)) for a, b, text in pairs]

        working = plus(taus, code.other)
        return working, plus(working, code.potential)

    def begin(self, t: float, y: Sequence[float], outputs: list[Node]) -> Push:
        n = self.n
        for node in self.nodes:
            node.values = []
        if self.time is not None:
            self.time.coming = [t, 1.0]
        angles = list(y[:n])
        order = 0

        def push(rates: Sequence[float]) -> list[float]:
            nonlocal order
            for j, node in self.q.items():
                node.coming = [angles[j]]
            for j, node in self.qd.items():
                node.coming = [rates[j]]
            k = order
            order += 1
            for j, rate in enumerate(rates):
                angles[j] = rate / order
            for other in self.nodes:
                other.values.append(other.coefficient(k))
            return [other.values[k] for other in outputs]

        return push

    def keep(self, node: NodeT) -> NodeT:
        self.nodes.append(node)
        return node

    def read(self, tree: ast.expr) -> Node:
        """The node of an expression, after those of its parts."""
        match tree:
            case ast.Constant(value=int() | float() as value):
                return self.constant(float(value))
            case ast.Name(id="t"):
                if self.time is None:
                    self.time = self.keep(Given())
                return self.time
            case ast.Name(id=name) if name in self.names:
                return self.names[name]
            case ast.Name(id=name) if name.startswith("qd"):
                return self.given(self.qd, int(name[2:]))
            case ast.Name(id=name) if name.startswith("q"):
                return self.given(self.q, int(name[1:]))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.read(operand)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self.keep(Sum(self.read(operand), None, -1.0, 0.0))
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return self.keep(Sum(self.read(left), self.read(right), 1.0, 1.0))
            case ast.BinOp(left=left, op=ast.Sub(), right=right):
                return self.keep(Sum(self.read(left), self.read(right), 1.0, -1.0))
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return self.product(self.read(left), self.read(right))
            case ast.BinOp(left=left, op=ast.Div(), right=right):
                return self.keep(Quotient(self.read(left), self.read(right)))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self.power(left, right)
            case ast.Subscript(slice=ast.Constant(value=int() as k)):
                return self.constant(0.0 if self.held is None else self.held[k])
            case ast.Call(func=ast.Name(id="_int"), args=[switch]):
                return self.read(switch)
            case ast.IfExp(test=ast.Call(args=[ast.Subscript(slice=index)])):
                return self.chosen(index, [tree.orelse, tree.body])
            case ast.Call(func=ast.Name(id="_pick"), args=[ast.Subscript(slice=index), *parts]):
                return self.chosen(index, parts)
            case ast.Call(func=ast.Name(id="_pow"), args=[left, right]):
                return self.power(left, right)
            case ast.Call(func=ast.Name(id=name), args=args):
                return self.function(name.removeprefix("_"), [self.read(x) for x in args])
        raise _refused(f"`{ast.unparse(tree)[:60]}`")

    def chosen(self, index: ast.expr, parts: list[ast.expr]) -> Node:
        """The part that a switch holds; of all, where it is not known, to see that they serve."""
        if self.held is None:
            return [self.read(part) for part in parts][-1]
        held = self.held[ast.literal_eval(index)]
        return self.constant(math.nan) if math.isnan(held) else self.read(parts[int(held)])

    def given(self, nodes: dict[int, Given], joint: int) -> Given:
        if joint not in nodes:
            nodes[joint] = self.keep(Given())
        return nodes[joint]

    def constant(self, value: float) -> Node:
        node = self.keep(Given())
        node.first = value
        return node

    def product(self, a: Node, b: Node) -> Node:
        return self.keep(Product(a, b))

    def power(self, left: ast.expr, right: ast.expr) -> Node:
        base = self.read(left)
        try:
            exponent = float(ast.literal_eval(right))
        except (ValueError, TypeError):
            log = self.function("log", [base])
            return self.function("exp", [self.product(self.read(right), log)])
        if exponent.is_integer() and 0.0 <= exponent <= 64.0:
            result = self.constant(1.0)
            for _ in range(int(exponent)):
                result = self.product(result, base)
            return result
        return self.keep(Power(base, exponent))

    def function(self, name: str, x: list[Node]) -> Node:
        """sin' = cos x', exp' = exp x', and y' = x'/density for log and the inverse functions."""
        keep = self.keep
        match name:
            case "sin" | "cos" | "tan" | "sinh" | "cosh" | "tanh":
                kind = name[:3] + "h" * name.endswith("h")
                if name == "tanh":
                    return keep(HyperbolicTangent(x[0]))
                sine = keep(Sine(x[0], name.endswith("h")))
                cosine = keep(Cosine(sine))
                if kind == "tan":
                    return keep(Quotient(sine, cosine))
                return sine if kind.startswith("sin") else cosine
            case "exp":
                return keep(Exponential(x[0]))
            case "sqrt":
                return keep(Power(x[0], 0.5))
            case "hypot":
                total = self.product(x[0], x[0])
                for other in x[1:]:
                    total = keep(Sum(total, self.product(other, other), 1.0, 1.0))
                return keep(Power(total, 0.5))
            case "log" if len(x) == 1:
                return keep(Primitive(x[0], x[0], math.log))
            case "log":
                return keep(Quotient(self.function("log", x[:1]), self.function("log", x[1:])))
            case "atan":
                density = keep(Sum(self.constant(1.0), self.product(x[0], x[0]), 1.0, 1.0))
                return keep(Primitive(x[0], density, math.atan))
            case "asin" | "acos":
                under = keep(Sum(self.constant(1.0), self.product(x[0], x[0]), 1.0, -1.0))
                root = keep(Power(under, 0.5))
                if name == "asin":
                    return keep(Primitive(x[0], root, math.asin))
                density = keep(Sum(root, None, -1.0, 0.0))
                return keep(Primitive(x[0], density, math.acos))
        raise _refused(f"function {name}")


def _refused(what: str) -> InputError:
    limit = "the Taylor series expands arithmetic and smooth functions: take --method DOP853"
    return InputError(f"torque: {what} has no series", limit=limit)
