"""The Taylor series of a torque along a motion, order by order.

An expression of t, q and qd becomes a tree of nodes; each appends its next coefficient from those
of its parts: products are convolutions, functions obey first-order differential equations.  What
has no series (comparisons, abs, min, ... and functions of Python) is refused.
"""

from __future__ import annotations

import ast
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from typing import TypeVar

from robodyn.actuation import Actuation
from robodyn.errors import InputError
from robodyn.force_formulas import force_code
from robodyn.mechanism import Mechanism

Push = Callable[[Sequence[float]], list[float]]
NodeT = TypeVar("NodeT", bound="_Node")


class TorqueSeries:
    """The series of all joint torques: of an actuation, and of a scene's springs and the like.

    What `begin` gives returns the torques (n) of one order, and where the scene has forces of its
    own those again (n) without springs, whose work is no loss of energy.
    """

    def __init__(self, actuation: Actuation, mechanism: Mechanism) -> None:
        self.kinks = actuation.kinks
        self.separate = mechanism.has_forces
        self._function = actuation.function(mechanism.n)
        self._reader = reader = _Reader(mechanism.n)
        self._given = reader.actuation(actuation)
        self._taus = self._working = self._given
        if self.separate:
            self._working, self._taus = reader.scene(mechanism, self._given)
        self._n = mechanism.n

    def begin(self, t: float, y: Sequence[float], direction: float) -> Push:
        """A function from the coefficients of the joint rates of an order to those of the torques.

        It is called with order 0 first, and so on; y = (q, qd, ...) is the state at t.
        """
        push = self._reader.begin(t, y, self._taus + self._working * self.separate)
        if self.kinks:
            for node, value, slope in zip(self._given, *self._piece(t, y, direction), strict=True):
                assert isinstance(node, _Given)
                node.coming = [value, slope]
        return push

    def agrees(self, x: float, t: float, y: Sequence[float], relative: float, small: float) -> bool:
        """Whether the series, x after where it began, gives the torques at the state y at t.

        It does not where the torque ends or bends on the way (sqrt(1 - t), sqrt(t**2)), or is
        flat where it began (tanh(1e5*t)).  What it misses by may be `small`, N m, or that part of
        its terms.
        """
        if self.kinks:  # a table, on which steps end where it bends
            return True
        try:
            torques = self._function(t, y)
        except (ArithmeticError, ValueError):  # outside the domain
            return False
        for node, torque in zip(self._given, torques, strict=True):
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

    def _piece(
        self, t: float, y: Sequence[float], direction: float
    ) -> tuple[list[float], list[float]]:
        """Of a table: the torques at t and their slopes up to its next row."""
        if direction > 0.0:
            end = self.kinks[min(bisect_right(self.kinks, t), len(self.kinks) - 1)]
        else:
            end = self.kinks[max(bisect_left(self.kinks, t) - 1, 0)]
        third = (end - t) / 3.0 or 1.0
        first, second = (self._function(t + k * third, y) for k in (1, 2))
        slopes = [(b - a) / third for a, b in zip(first, second, strict=True)]
        return [a - s * third for a, s in zip(first, slopes, strict=True)], slopes


class _Reader:
    """Builds the nodes of expressions."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.nodes: list[_Node] = []  # each after its parts
        self.time: _Given | None = None  # made where an expression names it, as these
        self.q: dict[int, _Given] = {}
        self.qd: dict[int, _Given] = {}
        self.names: dict[str, _Node] = {}

    def actuation(self, actuation: Actuation) -> list[_Node]:
        """The nodes of the joint torques (n) of an actuation; those of a table are given."""
        if actuation.constants is not None:
            return [self.constant(value) for value in actuation.constants]
        taus: list[_Node] = [self.keep(_Given()) for _ in range(self.n)]
        if actuation.kinks:
            return taus
        for line in actuation.lines:
            match ast.parse(line).body:
                case [ast.Assign(targets=[ast.Name(id=name)], value=value)]:
                    taus[int(name.removeprefix("tau"))] = self.read(value)
                case _:
                    raise _refused("a function of Python")
        return taus

    def scene(self, mechanism: Mechanism, taus: list[_Node]) -> tuple[list[_Node], list[_Node]]:
        """Those and the scene's own torques: without springs, and with them."""
        code = force_code(mechanism)
        for line in code.lines:
            name, _, text = line.partition(" = ")
            self.names[name] = self.read(ast.parse(text, mode="eval").body)

        def plus(nodes: list[_Node], texts: tuple[str, ...]) -> list[_Node]:
            parts = [self.read(ast.parse(text, mode="eval").body) for text in texts]
            pairs = zip(nodes, parts, texts, strict=True)
            return [a if text == "0.0" else self.keep(_Sum(a, b, 1.0, 1.0)) for a, b, text in pairs]

        working = plus(taus, code.other)
        return working, plus(working, code.potential)

    def begin(self, t: float, y: Sequence[float], outputs: list[_Node]) -> Push:
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

    def read(self, tree: ast.expr) -> _Node:
        """The node of an expression, after those of its parts."""
        match tree:
            case ast.Constant(value=int() | float() as value):
                return self.constant(float(value))
            case ast.Name(id="t"):
                if self.time is None:
                    self.time = self.keep(_Given())
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
                return self.keep(_Sum(self.read(operand), None, -1.0, 0.0))
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return self.keep(_Sum(self.read(left), self.read(right), 1.0, 1.0))
            case ast.BinOp(left=left, op=ast.Sub(), right=right):
                return self.keep(_Sum(self.read(left), self.read(right), 1.0, -1.0))
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return self.product(self.read(left), self.read(right))
            case ast.BinOp(left=left, op=ast.Div(), right=right):
                return self.keep(_Quotient(self.read(left), self.read(right)))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self.power(left, right)
            case ast.Call(func=ast.Name(id="_pow"), args=[left, right]):
                return self.power(left, right)
            case ast.Call(func=ast.Name(id=name), args=args):
                return self.function(name.removeprefix("_"), [self.read(x) for x in args])
        raise _refused(f"`{ast.unparse(tree)[:60]}`")

    def given(self, nodes: dict[int, _Given], joint: int) -> _Given:
        if joint not in nodes:
            nodes[joint] = self.keep(_Given())
        return nodes[joint]

    def constant(self, value: float) -> _Node:
        node = self.keep(_Given())
        node.first = value
        return node

    def product(self, a: _Node, b: _Node) -> _Node:
        return self.keep(_Product(a, b))

    def power(self, left: ast.expr, right: ast.expr) -> _Node:
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
        return self.keep(_Power(base, exponent))

    def function(self, name: str, x: list[_Node]) -> _Node:
        """sin' = cos x', exp' = exp x', and y' = x'/density for log and the inverse functions."""
        keep = self.keep
        match name:
            case "sin" | "cos" | "tan" | "sinh" | "cosh" | "tanh":
                kind = name[:3] + "h" * name.endswith("h")
                if name == "tanh":
                    return keep(_HyperbolicTangent(x[0]))
                sine = keep(_Sine(x[0], name.endswith("h")))
                cosine = keep(_Cosine(sine))
                if kind == "tan":
                    return keep(_Quotient(sine, cosine))
                return sine if kind.startswith("sin") else cosine
            case "exp":
                return keep(_Exponential(x[0]))
            case "sqrt":
                return keep(_Power(x[0], 0.5))
            case "hypot":
                total = self.product(x[0], x[0])
                for other in x[1:]:
                    total = keep(_Sum(total, self.product(other, other), 1.0, 1.0))
                return keep(_Power(total, 0.5))
            case "log" if len(x) == 1:
                return keep(_Primitive(x[0], x[0], math.log))
            case "log":
                return keep(_Quotient(self.function("log", x[:1]), self.function("log", x[1:])))
            case "atan":
                density = keep(_Sum(self.constant(1.0), self.product(x[0], x[0]), 1.0, 1.0))
                return keep(_Primitive(x[0], density, math.atan))
            case "asin" | "acos":
                under = keep(_Sum(self.constant(1.0), self.product(x[0], x[0]), 1.0, -1.0))
                root = keep(_Power(under, 0.5))
                if name == "asin":
                    return keep(_Primitive(x[0], root, math.asin))
                density = keep(_Sum(root, None, -1.0, 0.0))
                return keep(_Primitive(x[0], density, math.acos))
        raise _refused(f"function {name}")


def _refused(what: str) -> InputError:
    limit = "the Taylor series expands arithmetic and smooth functions: take --method DOP853"
    return InputError(f"torque: {what} has no series", limit=limit)


class _Node:
    """A series, known up to the order of its last coefficient."""

    def __init__(self) -> None:
        self.values: list[float] = []

    def coefficient(self, k: int) -> float:
        """The coefficient of order k, from those of the parts up to k and its own before."""
        raise NotImplementedError


class _Given(_Node):
    """A constant, or what is given from outside order by order."""

    def __init__(self) -> None:
        super().__init__()
        self.first = 0.0
        self.coming: list[float] = []

    def coefficient(self, k: int) -> float:
        if self.coming:
            return self.coming.pop(0)
        return self.first if k == 0 else 0.0


class _Sum(_Node):
    def __init__(self, a: _Node, b: _Node | None, u: float, v: float) -> None:
        super().__init__()
        self.a, self.b, self.u, self.v = a, b, u, v

    def coefficient(self, k: int) -> float:
        first = self.u * self.a.values[k]
        return first if self.b is None else first + self.v * self.b.values[k]


class _Product(_Node):
    def __init__(self, a: _Node, b: _Node) -> None:
        super().__init__()
        self.a, self.b = a, b

    def coefficient(self, k: int) -> float:
        return _convolve(self.a.values[: k + 1], self.b.values[: k + 1])


class _Quotient(_Node):
    """y b = a."""

    def __init__(self, a: _Node, b: _Node) -> None:
        super().__init__()
        self.a, self.b = a, b

    def coefficient(self, k: int) -> float:
        known = _convolve(self.values[:k], self.b.values[1 : k + 1])
        return (self.a.values[k] - known) / self.b.values[0]


class _Power(_Node):
    """x y' = exponent x' y."""

    def __init__(self, x: _Node, exponent: float) -> None:
        super().__init__()
        self.x, self.exponent = x, exponent

    def coefficient(self, k: int) -> float:
        x, y = self.x.values, self.values
        if k == 0:
            return math.pow(x[0], self.exponent)
        terms = (((self.exponent + 1.0) * m - k) * x[m] * y[k - m] for m in range(1, k + 1))
        return sum(terms) / (k * x[0])


class _Exponential(_Node):
    """y' = x' y."""

    def __init__(self, x: _Node) -> None:
        super().__init__()
        self.x = x

    def coefficient(self, k: int) -> float:
        return math.exp(self.x.values[0]) if k == 0 else _slope(self.x.values, self.values, k)


class _Sine(_Node):
    """s' = x' c; c' = -x' s, or + for the hyperbolic ones.  `_Cosine` shows the other half."""

    def __init__(self, x: _Node, hyperbolic: bool) -> None:
        super().__init__()
        self.x, self.hyperbolic = x, hyperbolic
        self.cosines: list[float] = []

    def coefficient(self, k: int) -> float:
        x = self.x.values
        if k == 0:
            sine, cosine = (math.sinh, math.cosh) if self.hyperbolic else (math.sin, math.cos)
            self.cosines = [cosine(x[0])]
            return sine(x[0])
        other = _slope(x, self.values, k)
        result = _slope(x, self.cosines, k)
        self.cosines.append(other if self.hyperbolic else -other)
        return result


class _Cosine(_Node):
    def __init__(self, sine: _Sine) -> None:
        super().__init__()
        self.sine = sine

    def coefficient(self, k: int) -> float:
        return self.sine.cosines[k]


class _HyperbolicTangent(_Node):
    """y' = x' (1 - y^2): where sinh and cosh would overflow it is flat."""

    def __init__(self, x: _Node) -> None:
        super().__init__()
        self.x = x
        self.rest: list[float] = []  # 1 - y^2

    def coefficient(self, k: int) -> float:
        if k == 0:
            self.rest = []
            return math.tanh(self.x.values[0])
        y = self.values
        self.rest.append((1.0 if k == 1 else 0.0) - _convolve(y, y))
        return _slope(self.x.values, self.rest, k)


class _Primitive(_Node):
    """density y' = x'."""

    def __init__(self, x: _Node, density: _Node, start: Callable[[float], float]) -> None:
        super().__init__()
        self.x, self.density, self.start = x, density, start

    def coefficient(self, k: int) -> float:
        x, density, y = self.x.values, self.density.values, self.values
        if k == 0:
            return self.start(x[0])
        known = sum(m * y[m] * density[k - m] for m in range(1, k))
        return (k * x[k] - known) / (k * density[0])


def _convolve(a: Sequence[float], b: Sequence[float]) -> float:
    """sum of a_m b_{k-m}; both of one length."""
    return sum(x * y for x, y in zip(a, reversed(b), strict=True))


def _slope(x: Sequence[float], y: Sequence[float], k: int) -> float:
    """Coefficient k of the integral of x' y."""
    return sum(m * x[m] * y[k - m] for m in range(1, k + 1)) / k
