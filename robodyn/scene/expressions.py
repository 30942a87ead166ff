"""Expressions that people write, "2 N m*sin(3*t)", rewritten as Python that can do nothing else.

They are parsed and written again from a white list of syntax and names, so that nothing but
arithmetic can run.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence

from robodyn.scene.expression_units import Measure, Measuring, marked
from robodyn.scene.syntax import ARGUMENTS, CONSTANTS, FUNCTIONS
from robodyn.scene.units import Dimension

# math.pow: a root of a negative number is outside its domain, not complex
SCOPE: dict[str, object] = {f"_{name}": function for name, function in FUNCTIONS.items()}
SCOPE["_pow"] = math.pow
# what no power series in time expands where it bends or jumps
BENDS = ("abs", "min", "max", "sign", "floor", "atan2")
_BENDING: dict[type, str] = {ast.Compare: "a comparison", ast.IfExp: "`if`", ast.Mod: "%"}
NO_BENDS = "which bends or jumps: expressions of a scene are smooth; write a table"
SMOOTH = tuple(name for name in FUNCTIONS if name not in BENDS)
MAX_LENGTH = 2000  # characters of one expression
MAX_POWER = 64.0  # a constant exponent beyond this is a slip, or an attempt to stall

_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.Mod)
_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)

Rename = Callable[[str], str | None]  # a variable as code has it; None: it is none


Dimensions = Callable[[str], Dimension | None]  # of the names that code has
Change = Callable[[list[ast.expr]], list[ast.expr]]  # of expressions into others


class NotAllowedError(ValueError):
    """What an expression must not have."""


class Written:
    """Comma-separated expressions as Python code over variables renamed, and the names used.

    `known` tells which variables there are, `dimensions` what they are in; `change` makes others of
    the expressions first.  `measures` has what each is in, where units tell.  Raises
    NotAllowedError for anything but arithmetic with units that fit, comparisons, `a if b else c`,
    the functions above, pi and e; ValueError for what is no Python.
    """

    def __init__(
        self,
        text: str,
        rename: Rename,
        known: str,
        change: Change | None = None,
        dimensions: Dimensions | None = None,
    ) -> None:
        self.names: set[str] = set()  # as they are written
        self.measures: list[Measure | None] = []
        self._rename, self._known, self._text = rename, known, text
        if len(text) > MAX_LENGTH:
            raise NotAllowedError(f"more than {MAX_LENGTH} characters")
        try:
            self._marked = marked(text, lambda name: rename(name) is not None)
            nodes = self._marked.nodes
            if self._marked.quantities:
                self.measures = [self._measure(node, dimensions) for node in nodes]
            self.texts = [self._segment(node) for node in nodes]
            nodes = nodes if change is None else change(list(nodes))
            self.codes = [ast.unparse(self._write(node)) for node in nodes]
            for code in self.codes:
                compile(code, "<expression>", "eval")  # Python has limits of its own
        except NotAllowedError:
            raise
        except ArithmeticError:
            raise ValueError("a number is too large") from None
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise ValueError(getattr(error, "msg", None) or str(error)) from None

    def _no(self, node: ast.expr, what: str) -> NotAllowedError:
        """What is not allowed, and where it stands."""
        at = self._marked.places[min(getattr(node, "col_offset", 0), len(self._marked.places) - 1)]
        return NotAllowedError(f"{what}, at character {at + 1}" if at else what)

    def _measure(self, node: ast.expr, dimensions: Dimensions | None) -> Measure | None:
        def of(name: str) -> Dimension | None:
            own = self._rename(name)
            return None if own is None or dimensions is None else dimensions(own)

        try:
            return Measuring(self._marked.quantities, of).of(node)
        except ValueError as error:
            what, where = error.args
            raise self._no(where, what) from None

    def _write(self, node: ast.expr) -> ast.expr:
        match node:
            case ast.Constant(value=bool()):
                pass
            case ast.Constant(value=int() | float() as value) if math.isfinite(_float(value)):
                return ast.Constant(_float(value))
            case ast.Name(id=name) if name in self._marked.quantities:
                return ast.Constant(self._marked.quantities[name].total)
            case ast.Name(id=name):
                return self._name(node)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as op, operand=operand):
                return ast.UnaryOp(op, self._write(operand))
            case ast.BinOp(left=left, op=op, right=right) if isinstance(op, _OPERATORS):
                sides = [self._write(left), self._write(right)]
                if not isinstance(op, ast.Pow):
                    return ast.BinOp(sides[0], op, sides[1])
                if _exponent(right) > MAX_POWER:
                    raise self._no(right, f"an exponent above {MAX_POWER:g}")
                if _exponent(right).is_integer():
                    return ast.BinOp(sides[0], op, sides[1])
                return ast.Call(ast.Name("_pow"), sides, [])
            case ast.Compare(left=left, ops=[op], comparators=[right]) if isinstance(
                op, _COMPARISONS
            ):
                return ast.Compare(self._write(left), [op], [self._write(right)])
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return ast.IfExp(self._write(test), self._write(body), self._write(orelse))
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
                least, most = ARGUMENTS.get(name, (1, 1))
                if not least <= len(args) <= most:
                    raise self._no(node, f"{len(args)} arguments of {name}")
                return ast.Call(ast.Name(f"_{name}"), [self._write(x) for x in args], [])
            case ast.Call(func=ast.Name(id=name)):
                raise self._no(node, f"function {name}; known: {', '.join(FUNCTIONS)}")
        raise self._no(node, f"`{self._segment(node)[:80]}`")

    def _segment(self, node: ast.expr) -> str:
        """An expression as it is written."""
        begin, end = (self._marked.places[x] for x in (node.col_offset, node.end_col_offset or -1))
        return self._text[begin:end].strip()

    def _name(self, node: ast.Name) -> ast.expr:
        name = node.id
        if name in CONSTANTS:
            return ast.Constant(CONSTANTS[name])
        own = self._rename(name)
        if own is None:
            raise self._no(node, f"name {name}; known: {self._known}, pi, e")
        self.names.add(own)
        return ast.Name(own)


def state_names(n: int) -> tuple[Rename, str]:
    """t, q1.., qd1.. of n joints as t, q0.., qd0.., and how they are told."""

    def rename(name: str) -> str | None:
        kind = name.rstrip("0123456789")
        number = name[len(kind) :]
        if name == "t":
            return name
        known = kind in ("q", "qd") and number.isdigit() and 1 <= int(number) <= n
        return f"{kind}{int(number) - 1}" if known else None

    return rename, f"t, q1..q{n}, qd1..qd{n}"


def check_smooth(codes: Sequence[str]) -> None:
    """Raise NotAllowedError unless this is one expression, which neither bends nor jumps."""
    if len(codes) != 1:
        raise NotAllowedError("a comma: it is one expression")
    for node in ast.walk(ast.parse(codes[0], mode="eval")):
        what = _BENDING.get(type(node))
        if isinstance(node, ast.Name) and node.id[1:] in BENDS:
            what = f"{node.id[1:]}()"
        if what:
            raise NotAllowedError(f"{what}, {NO_BENDS}")


def value_of(code: str) -> float:
    """The number that code without variables is; ArithmeticError or ValueError for none."""
    return float(eval(code, {"__builtins__": {}, **SCOPE}))


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _exponent(node: ast.expr) -> float:
    while isinstance(node, ast.UnaryOp):
        node = node.operand
    value = getattr(node, "value", None)  # of a constant
    return _float(value) if isinstance(value, int | float) else 0.5  # may be any: no whole number
