"""The kernel language: functions of machine code, written as LLVM's IR text.

A `Word` is the value of an instruction: numbers in W lanes, a mask over them, a whole number, or an
address.  `Instructions` collects the instructions of one function.  A `Kernel` adds loops and
branches.  Each method writes an instruction or a control structure and returns its word.  Recorded
graphs and sines are added by `segment.py`.

    with kernel.loop(count) as i:              # i = 0 .. count - 1
        x = kernel.load(kernel.at(data, i))
        with kernel.when(kernel.any(kernel.less(x, limit))):
            ...

Variables that change over a loop are slots: `kernel.slot`, `kernel.get`, `kernel.set`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

WHOLE, SCALAR, ADDRESS, TRUTH = "i64", "double", "ptr", "i1"


class Word(NamedTuple):
    """A value, with its name in the text and its LLVM type."""

    text: str
    type: str

    def __str__(self) -> str:
        return f"{self.type} {self.text}"


class Module:
    """The text of one object file: kernels, and declarations of C library functions they call."""

    def __init__(self, lanes: int, short: bool = False, together: int = 0) -> None:
        self.lanes = lanes
        self.together = together  # vectors of eight numbers that a loop sums; 0: `sum_rows` does
        self.short = short  # whether what is long is written once, and called
        self.functions: dict[str, str] = {}  # by name: definitions and declarations

    @property
    def text(self) -> str:
        return "\n\n".join(self.functions.values()) + "\n"

    def declare(self, name: str, result: str, *arguments: str) -> None:
        line = f"declare {result} @{name}({', '.join(arguments)})"
        self.functions.setdefault(name, line)


class Instructions:
    """The instructions of one function under construction."""

    def __init__(
        self, module: Module, name: str, arguments: Sequence[str], result: str = WHOLE
    ) -> None:
        self.module, self.name, self.result = module, name, result
        self.lanes = module.lanes
        self.numbers = f"<{self.lanes} x double>" if self.lanes > 1 else SCALAR
        self.mask = f"<{self.lanes} x i1>" if self.lanes > 1 else TRUTH
        self.wholes = f"<{self.lanes} x i64>" if self.lanes > 1 else WHOLE
        self.arguments = [Word(f"%a{i}", type) for i, type in enumerate(arguments)]
        self._slots: list[str] = []
        self._lines: list[str] = []
        self._count = 0

    # -- text ------------------------------------------------------------------------------------

    def fresh(self) -> str:
        self._count += 1
        return str(self._count)

    def op(self, type: str, text: str) -> Word:
        """Write an instruction with a result of `type`; return its word."""
        word = Word(f"%v{self.fresh()}", type)
        self._lines.append(f"  {word.text} = {text}")
        return word

    def line(self, text: str) -> None:
        self._lines.append(f"  {text}")

    def done(self, value: Word | None = None) -> None:
        """Write the return instruction and add the function to its module."""
        self.line("ret void" if value is None else f"ret {value}")
        arguments = ", ".join(map(str, self.arguments))
        head = f"define {self.result} @{self.name}({arguments}) nounwind {{\nentry:"
        slots = [f"  {line}" for line in self._slots]
        self.module.functions[self.name] = "\n".join([head, *slots, *self._lines, "}"])

    # -- constants -------------------------------------------------------------------------------

    def number(self, value: float) -> Word:
        """Return a word with the same number in every lane."""
        return self._everywhere(self.scalar(value))

    def scalar(self, value: float) -> Word:
        """Return a single number, exact to the bit."""
        return Word("0x" + struct.pack(">d", value).hex().upper(), SCALAR)

    def whole(self, value: int) -> Word:
        """Return a whole number."""
        return Word(str(value), WHOLE)

    def whole_lanes(self, value: int) -> Word:
        """Return a word with the same whole number in every lane."""
        return self._everywhere(self.whole(value))

    def all_lanes(self, value: bool) -> Word:
        """Return a mask with the same value in every lane."""
        return self._everywhere(Word(str(value).lower(), TRUTH))

    def vector(self, values: Sequence[float]) -> Word:
        """Return a word with one number per lane."""
        return Word(f"<{', '.join(str(self.scalar(value)) for value in values)}>", self.numbers)

    def _everywhere(self, one: Word) -> Word:
        if self.lanes == 1:
            return one
        return Word(f"<{', '.join([str(one)] * self.lanes)}>", f"<{self.lanes} x {one.type}>")

    # -- calls -----------------------------------------------------------------------------------

    def call(self, function: str | Word, *arguments: Word) -> None:
        """Call a function without result, by name or by address."""
        target = function.text if isinstance(function, Word) else f"@{function}"
        self.line(f"call void {target}({', '.join(map(str, arguments))})")

    def result_of(self, type: str, name: str, *arguments: Word) -> Word:
        """Call the function `name` and return its result of `type`."""
        return self.op(type, f"call {type} @{name}({', '.join(map(str, arguments))})")

    # -- arithmetic ------------------------------------------------------------------------------

    def binary(self, op: str, a: Word, b: Word) -> Word:
        """Write a binary instruction, such as `fadd contract`, on words of one type."""
        return self.op(a.type, f"{op} {a}, {b.text}")

    def add(self, a: Word, b: Word) -> Word:
        return self.binary(_KIND["add"][_floats(a)], a, b)

    def subtract(self, a: Word, b: Word) -> Word:
        return self.binary(_KIND["sub"][_floats(a)], a, b)

    def multiply(self, a: Word, b: Word) -> Word:
        return self.binary(_KIND["mul"][_floats(a)], a, b)

    def divide(self, a: Word, b: Word) -> Word:
        return self.binary("fdiv", a, b)

    def negate(self, a: Word) -> Word:
        return self.op(a.type, f"fneg {a}")

    def intrinsic(self, name: str, *args: Word) -> Word:
        """Call an LLVM intrinsic on numbers: sqrt, fabs, ..."""
        type = args[0].type
        suffix = "f64" if type == SCALAR else f"v{type[1:].split()[0]}f64"
        full = f"llvm.{name}.{suffix}"
        self.module.declare(full, type, *(a.type for a in args))
        return self.result_of(type, full, *args)

    def convert(self, op: str, a: Word, type: str) -> Word:
        """Write a conversion: bitcast, sitofp, zext, ..."""
        return self.op(type, f"{op} {a} to {type}")

    # -- masks -----------------------------------------------------------------------------------

    def compare(self, how: str, a: Word, b: Word) -> Word:
        """Compare lane by lane; `how` as in LLVM: olt, oge, une (floats), slt, eq, ult."""
        op = "fcmp" if _floats(a) else "icmp"
        type = self.mask if a.type in (self.numbers, self.wholes) and self.lanes > 1 else TRUTH
        return self.op(type, f"{op} {how} {a}, {b.text}")

    def less(self, a: Word, b: Word) -> Word:
        """Return the mask of a < b; false if one is nan."""
        return self.compare("olt", a, b)

    def select(self, mask: Word, a: Word, b: Word) -> Word:
        """Return a where the mask is set, else b."""
        return self.op(a.type, f"select {mask}, {a}, {b}")

    def both(self, a: Word, b: Word) -> Word:
        return self.binary("and", a, b)

    def either(self, a: Word, b: Word) -> Word:
        return self.binary("or", a, b)

    def invert(self, mask: Word) -> Word:
        single = mask.type == TRUTH
        return self.binary("xor", mask, Word("true", TRUTH) if single else self.all_lanes(True))

    def any(self, mask: Word) -> Word:
        """Return whether the mask is set in any lane."""
        if mask.type == TRUTH:
            return mask
        bits = self.convert("bitcast", mask, f"i{self.lanes}")
        return self.op(TRUTH, f"icmp ne {bits}, 0")

    def count(self, mask: Word) -> Word:
        """Return in how many lanes the mask is set."""
        if mask.type == TRUTH:
            return self.convert("zext", mask, WHOLE)
        bits = self.convert("bitcast", mask, f"i{self.lanes}")
        wide = self.convert("zext", bits, WHOLE)
        self.module.declare("llvm.ctpop.i64", WHOLE, WHOLE)
        return self.result_of(WHOLE, "llvm.ctpop.i64", wide)

    # -- lanes -----------------------------------------------------------------------------------

    def spread(self, value: Word, lanes: int = 0) -> Word:
        """Return a scalar copied to every lane, or to `lanes` lanes."""
        lanes = lanes or self.lanes
        if lanes == 1:
            return value
        type = f"<{lanes} x {value.type}>"
        first = self.op(type, f"insertelement {type} poison, {value}, i64 0")
        zeros = f"<{lanes} x i32> zeroinitializer"
        return self.op(type, f"shufflevector {first}, {type} poison, {zeros}")

    def shuffled(self, value: Word, places: Sequence[int]) -> Word:
        """Return a vector of the given lanes of another."""
        listed = ", ".join(f"i32 {i}" for i in places)
        text = f"shufflevector {value}, {value.type} poison, <{len(places)} x i32> <{listed}>"
        return self.op(f"<{len(places)} x {value.type.split()[-1]}", text)

    def lane(self, value: Word, i: int) -> Word:
        """Return the value in lane i."""
        if self.lanes == 1:
            return value
        return self.op(value.type.split()[-1][:-1], f"extractelement {value}, i64 {i}")

    def gathered(self, values: Sequence[Word]) -> Word:
        """Return a vector of scalars."""
        if len(values) == 1:
            return values[0]
        type = f"<{len(values)} x {values[0].type}>"
        word = Word("poison", type)
        for i, value in enumerate(values):
            word = self.op(type, f"insertelement {word}, {value}, i64 {i}")
        return word

    # -- memory ----------------------------------------------------------------------------------

    def at(self, base: Word, index: Word | int, type: str = SCALAR) -> Word:
        """Return the address of item `index` of an array of `type`."""
        index = self.whole(index) if isinstance(index, int) else index
        return self.op(ADDRESS, f"getelementptr {type}, {base}, {index}")

    def load(self, address: Word, type: str | None = None) -> Word:
        """Load a vector of numbers, or a word of another type, aligned to 8 bytes."""
        type = type or self.numbers
        return self.op(type, f"load {type}, {address}, align 8")

    def store(self, value: Word, address: Word) -> None:
        self.line(f"store {value}, {address}, align 8")

    def slot(self, start: Word) -> Word:
        """Allocate a variable with start value `start`; return its address."""
        address = self.room(start.type, 1)
        self.set(address, start)
        return address

    def room(self, type: str, count: int) -> Word:
        """Allocate `count` words of `type` on the stack."""
        word = Word(f"%s{self.fresh()}", ADDRESS)
        self._slots.append(f"{word.text} = alloca {type}, i64 {count}, align 64")
        return word

    def get(self, slot: Word, type: str | None = None) -> Word:
        return self.load(slot, type)

    def set(self, slot: Word, value: Word) -> None:
        self.store(value, slot)


_KIND = {name: (name, f"f{name} contract") for name in ("add", "sub", "mul")}


def _floats(word: Word) -> bool:
    return "double" in word.type


class Kernel(Instructions):
    """A function with loops and branches under construction."""

    def __init__(
        self, module: Module, name: str, arguments: Sequence[str], result: str = WHOLE
    ) -> None:
        super().__init__(module, name, arguments, result)
        self.block = "entry"  # the label under which instructions now go
        self._loops: list[dict[Word, tuple[str, str]]] = []  # what each carries: start and next

    def start(self, label: str) -> None:
        """Begin the basic block `label`."""
        self._lines.append(f"{label}:")
        self.block = label

    def jump(self, label: str) -> None:
        self.line(f"br label %{label}")

    def branch(self, condition: Word, yes: str, no: str) -> None:
        self.line(f"br {condition}, label %{yes}, label %{no}")

    @contextmanager
    def loop(self, stop: Word, first: Word | None = None, step: int = 1) -> Iterator[Word]:
        """Loop over whole numbers first, first + step, ... below stop."""
        before, name = self.block, self.fresh()
        head, body, after = f"head{name}", f"body{name}", f"after{name}"
        self.jump(head)
        self.start(head)
        place = len(self._lines)
        self._lines.append("")  # what is carried: where the body ends is not known yet
        self._loops.append({})
        i = self.carried(first or self.whole(0))
        self.branch(self.compare("slt", i, stop), body, after)
        self.start(body)
        yield i
        self.becomes(i, self.add(i, self.whole(step)))
        self._lines[place] = "\n".join(
            f"  {word.text} = phi {word.type} [ {start}, %{before} ], [ {now}, %{self.block} ]"
            for word, (start, now) in self._loops.pop().items()
        )
        self.jump(head)
        self.start(after)

    def carried(self, start: Word) -> Word:
        """Return a value of the innermost loop that changes with every pass."""
        word = Word(f"%c{self.fresh()}", start.type)
        self._loops[-1][word] = start.text, ""
        return word

    def becomes(self, carried: Word, value: Word) -> None:
        """Set the next pass's value of a carried word."""
        self._loops[-1][carried] = self._loops[-1][carried][0], value.text

    def each(self, count: int, write: Callable[[Word], None]) -> None:
        """Call `write(i)` in a loop over i = 0 .. count - 1."""
        with self.loop(self.whole(count)) as i:
            write(i)

    @contextmanager
    def forever(self) -> Iterator[str]:
        """Loop until a branch jumps to the label that is yielded."""
        name = self.fresh()
        again, after = f"again{name}", f"after{name}"
        self.jump(again)
        self.start(again)
        yield after
        self.jump(again)
        self.start(after)

    def leave(self, condition: Word, label: str) -> None:
        """Jump to `label` if the condition holds."""
        on = f"on{self.fresh()}"
        self.branch(condition, label, on)
        self.start(on)

    @contextmanager
    def when(self, condition: Word) -> Iterator[None]:
        """Execute the body only if the scalar condition holds."""
        name = self.fresh()
        self.branch(condition, f"then{name}", f"else{name}")
        self.start(f"then{name}")
        yield
        self.jump(f"else{name}")
        self.start(f"else{name}")

    def joined(self, value: Word, from_block: str, other: Word, other_block: str) -> Word:
        """Return the value for the block from which control arrived (phi)."""
        come = f"[ {value.text}, %{from_block} ], [ {other.text}, %{other_block} ]"
        return self.op(value.type, f"phi {value.type} {come}")
