"""Text of kernels run by numpy: a word of W lanes is an array (B,), a block an array (items, B).

What the kernel language writes (`engines/assembler.py`) is translated to Python, a function to a
function and an instruction to a line, so that motions without machine code follow the same text.
An address is the number of an item in the block M; what is on the stack is a variable.  Blocks of
instructions follow one another in a loop, as their branches say.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from robodyn.sweeps.step_extremes import sums
from robodyn.tables.arrays import Array

LANES = 2  # of the text, in place of any number
_CONSTANT = re.compile(r"<(double|i64|i1) ([^,>]+), \1 \2>")
_TYPES = {"<2 x double>": "vector", "<2 x i64>": "wholes", "<2 x i1>": "mask"}
_NAME = re.compile(r"%([avsic]\d+)\b")
_WRITTEN = {
    "fadd": "{} + {}", "fsub": "{} - {}", "fmul": "{} * {}", "fdiv": "divide({}, {})",
    "add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "and": "{} & {}", "or": "{} | {}",
    "lshr": "{} >> {}", "shl": "{} << {}", "xor": "invert({})", "fneg": "-{}",
    "select": "where({}, {}, {})",
}  # fmt: skip
_LAID_OUT = "phi", "insertelement", "shufflevector", "extractelement", "insertvalue", "extractvalue"
_COMPARED = {
    "olt": "{} < {}", "ole": "{} <= {}", "ogt": "{} > {}", "oge": "{} >= {}", "oeq": "{} == {}",
    "une": "{} != {}", "slt": "{} < {}", "sge": "{} >= {}", "ne": "{} != {}",
    "ult": "invert({} >= {})", "ule": "invert({} > {})", "ugt": "invert({} <= {})",
    "uge": "invert({} < {})", "ord": "({0} == {0}) & ({1} == {1})",
    "uno": "({0} != {0}) | ({1} != {1})",
}  # fmt: skip
_CONVERTED = {
    "bitcast vector wholes": "asarray({}, float).view(int64)",
    "bitcast wholes vector": "asarray({}).view(float)",
    "sitofp wholes vector": "asarray({}).astype(float)",
    "fptosi vector wholes": "asarray({}).astype(int64)",
    "sitofp i64 double": "float({})",
    "bitcast mask i2": "{}",
}


def _any(mask: Any) -> bool:
    return bool(np.any(mask))


class ArrayMachine:
    """The functions of a text, translated as they are asked for; each takes the block M first.

    Of text whose order is a loop, `columns` tells how many series a row of coefficients has.
    """

    def __init__(self, text: str, columns: int = 0) -> None:
        self.columns = columns
        found = re.findall(r"^define [^@]+@(\w+)\((.*?)\)[^{]*\{\n(.*?)^\}", text, re.M | re.S)
        self._text = {name: (arguments, body) for name, arguments, body in found}
        self._scope: dict[str, Any] = {
            "F": self, "inf": np.inf, "nan": np.nan, "where": np.where, "divide": np.divide,
            "invert": np.logical_not, "any_lane": _any, "asarray": np.asarray, "int64": np.int64,
            "fabs": np.abs, "power": np.power, "math": np,
        }  # fmt: skip

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in self._text:
            raise AttributeError(name)
        source = _Function(name, *self._text[name]).source
        exec(compile(source, f"<{name}>", "exec"), self._scope)
        function: Callable[..., Any] = self._scope[name]
        setattr(self, name, function)
        return function

    # -- what numpy does itself --------------------------------------------------------------------

    def sine_cosine(self, M: Array, angle: Array) -> tuple[Array, Array]:
        return np.sin(angle), np.cos(angle)

    def arctangent(self, M: Array, y: Array, x: Array) -> tuple[Array, Array]:
        return (np.arctan2(y, x),) * 2  # functions of angles give two words

    def sum_rows(
        self,
        M: Array,
        x: int,
        y: int,
        out: int,
        terms: int,
        wide: int,
        same: int,
        level: Any = 1.0,
        slope: float = 0.0,
    ) -> None:
        """Rows from x on upward, one column or so many, times those from y on downward."""

        def rows(first: int, wide: int) -> Array:
            count = (len(M) - first) // self.columns
            whole = M[first : first + count * self.columns]
            return whole.reshape(count, self.columns, -1)[:terms, :wide]

        a, b = rows(x, 1 if same else wide), rows(y - (terms - 1) * self.columns, wide)[::-1]
        if slope:
            a = a * (level + slope * np.arange(terms)[:, None, None])
        M[out : out + wide] = sums(a, b)

    def polynomials(
        self, M: Array, series: int, values: int, slopes: int, rows: int, wide: int, place: int
    ) -> None:
        x, wide = M[place], wide // LANES
        value, slope = np.zeros((2, wide, M.shape[1]))
        for m in reversed(range(rows)):
            first = series + m * self.columns
            slope = slope * x + value
            value = value * x + M[first : first + wide]
        M[values : values + wide], M[slopes : slopes + wide] = value, slope


class _Function:
    """One function as Python."""

    def __init__(self, name: str, arguments: str, body: str) -> None:
        for old, new in _TYPES.items():
            body = body.replace(old, new)
        lines = _CONSTANT.sub(r"\2", body).splitlines()
        self.blocks: dict[str, list[str]] = {}
        for line in lines:
            if line.endswith(":"):
                self.blocks[line[:-1]] = here = []
            elif line:
                here.append(line.strip())
        self.stack: dict[str, str] = {}  # what an address on the stack holds
        self.label = {label: i for i, label in enumerate(self.blocks)}
        self.phis: dict[tuple[str, str], list[tuple[str, str]]] = {}  # by where from and where to
        for label, inner in self.blocks.items():
            for line in inner:
                if match := re.match(r"%(\w+) = phi \w+ (.*)", line):
                    for value, come in re.findall(r"\[ ([^,]+), %(\w+) \]", match[2]):
                        pair = (match[1], self._value(value))
                        self.phis.setdefault((come, label), []).append(pair)
        self._count_uses()
        names = ", ".join(_NAME.findall(arguments))
        text = [f"def {name}(M, {names}):", "  L = 0", "  while True:"]
        for label, inner in self.blocks.items():
            text.append(f"    {'el' if self.label[label] else ''}if L == {self.label[label]}:")
            text += [f"      {line}" for line in self._translated(label, inner)]
        self.source = "\n".join(text) + "\n"

    def _count_uses(self) -> None:
        """Where each name is used last, and which are used in one block alone."""
        self.last: dict[str, int] = {}
        homes: dict[str, set[str]] = {}
        for label, inner in self.blocks.items():
            for i, line in enumerate(inner):
                for name in _NAME.findall(line):
                    homes.setdefault(name, set()).add("phi" if " phi " in line else label)
                    self.last[name] = i
        self.local = {x for x, where in homes.items() if len(where) == 1 and "phi" not in where}

    def _translated(self, label: str, inner: list[str]) -> list[str]:
        written = [i for i, x in enumerate(inner) if x.startswith(("store", "call void"))]
        found: list[str] = []
        for i, line in enumerate(inner):
            target, is_one, rest = line.partition(" = ")
            name = target[1:] if is_one else ""
            code = self._instruction(label, name, rest if is_one else line)
            if code is None:
                continue
            if name and rest.startswith("load") and code.startswith("M["):
                last = self.last[name] if name in self.local else len(inner)
                if any(i < j <= last for j in written):
                    code += ".copy()"
            found.append(f"{name} = {code}" if name else code)
            over = {x for x in _NAME.findall(line) if x in self.local and self.last[x] == i}
            over = {x for x in over if x[0] == "v" and x not in self.stack}
            if over and not line.startswith(("br", "ret")):
                found.append(f"del {', '.join(sorted(over))}")
        return found

    def _value(self, text: str) -> str:
        """A word in Python."""
        text = text.split()[-1]
        if text.startswith("%"):
            return text[1:]
        if text.startswith("0x"):
            number: float = struct.unpack(">d", bytes.fromhex(text[2:]))[0]
            return f"({number!r})"
        return {"true": "True", "false": "False", "poison": "None"}.get(text, text)

    def _jump(self, here: str, there: str) -> str:
        moved = self.phis.get((here, there), [])
        names, values = (", ".join(x) for x in zip(*moved, strict=True)) if moved else ("", "")
        return f"{f'{names} = {values}; ' if moved else ''}L = {self.label[there]}"

    def _instruction(self, label: str, name: str, line: str) -> str | None:
        """The line of Python, or the value; None where there is nothing to do."""
        op, _, rest = line.partition(" ")
        if op == "br":
            return self._branch(label, rest)
        if op == "ret":
            return f"return {'None' if rest == 'void' else self._value(rest)}"
        if op == "call":
            return self._call(rest)
        if " to " in rest:
            (kind, word), to = rest.split(" to ")[0].split(), rest.split(" to ")[1]
            return _CONVERTED[f"{op} {kind} {to}"].format(self._value(word))
        parts = [x.strip() for x in rest.split(",")]
        if op in ("alloca", "getelementptr"):
            return self._address(op, name, parts)
        if op in ("load", "store"):
            place = self._value(parts[1])
            place = self.stack.get(place, f"M[{place}]")
            return place if op == "load" else f"{place} = {self._value(parts[0])}"
        if op in ("fcmp", "icmp"):
            how, _, parts[0] = parts[0].partition(" ")
            if parts[0].startswith("i2 "):
                return f"any_lane({self._value(parts[0])})"
            return _COMPARED[how].format(*map(self._value, parts))
        if op in _LAID_OUT:
            return self._laid_out(op, parts)
        return _WRITTEN[op].format(*map(self._value, parts))

    def _branch(self, label: str, rest: str) -> str:
        where = re.findall(r"label %(\w+)", rest)
        yes, *no = (self._jump(label, x) for x in where)
        if not no:
            return yes
        return f"if {self._value(rest.split(',')[0])}:\n        {yes}\n      else:\n        {no[0]}"

    def _address(self, op: str, name: str, parts: list[str]) -> str | None:
        """Of an item of the block, or on the stack."""
        if op == "alloca":
            count = int(parts[1].split()[1])
            self.stack[name] = name if count == 1 else f"{name}[0]"
            return None if count == 1 else f"[None] * {count}"
        base, index = self._value(parts[1]), self._value(parts[2])
        if base in self.stack:
            self.stack[name] = f"{base}[{index}]"
            return None
        return f"{base} + {index}"

    def _laid_out(self, op: str, parts: list[str]) -> str | None:
        """What moves words; all lanes are one."""
        if op == "phi":
            return None
        if op == "insertvalue":
            before = self._value(parts[-3])
            return f"({'' if before == 'None' else f'*{before}, '}{self._value(parts[-2])},)"
        if op == "extractvalue":
            return f"{self._value(parts[-2])}[{parts[-1]}]"
        return self._value(parts[1] if op == "insertelement" else parts[0])

    def _call(self, text: str) -> str:
        match = re.match(r".*?@([\w.]+)\((.*)\)$", text)
        assert match is not None
        name, inner = match[1], match[2]
        arguments = ", ".join(self._value(x) for x in inner.split(",")) if inner else ""
        if name.startswith("llvm."):
            return f"math.{name.split('.')[1]}({arguments})"
        if name in ("exp", "log", "tanh", "pow"):
            return f"math.{name.replace('pow', 'power')}({arguments})"
        return f"F.{name}(M, {arguments})"
