"""The kernel language: functions of machine code, written as the text of LLVM's IR.

A `Kernel` is one function under way; each method writes an instruction (`instructions.py`) or a
control structure, and returns the word it makes.  Recorded graphs go in by `segment.py`, sines by
`sines.py`.

    with kernel.loop(count) as i:              # i = 0 .. count - 1
        x = kernel.load(kernel.at(data, i))
        with kernel.when(kernel.any(kernel.less(x, limit))):
            ...

Variables that change over a loop are slots: `kernel.slot`, `kernel.get`, `kernel.set`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from robodyn.engines.instructions import ADDRESS, SCALAR, WHOLE, Instructions, Module, Word

__all__ = ["ADDRESS", "SCALAR", "WHOLE", "Kernel", "Module", "Word"]


class Kernel(Instructions):
    """One function, and where it goes on."""

    def __init__(
        self, module: Module, name: str, arguments: Sequence[str], result: str = WHOLE
    ) -> None:
        super().__init__(module, name, arguments, result)
        self.block = "entry"  # the label under which instructions now go
        self._loops: list[dict[Word, tuple[str, str]]] = []  # what each carries: start and next

    def start(self, label: str) -> None:
        """What follows belongs to this block."""
        self._lines.append(f"{label}:")
        self.block = label

    def jump(self, label: str) -> None:
        self.line(f"br label %{label}")

    def branch(self, condition: Word, yes: str, no: str) -> None:
        self.line(f"br {condition}, label %{yes}, label %{no}")

    @contextmanager
    def loop(self, stop: Word, first: Word | None = None, step: int = 1) -> Iterator[Word]:
        """Over whole numbers first, first + step, ... below stop."""
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
        """What the innermost loop changes: its value as a pass begins, and after the last."""
        word = Word(f"%c{self.fresh()}", start.type)
        self._loops[-1][word] = start.text, ""
        return word

    def becomes(self, carried: Word, value: Word) -> None:
        """What it is in the next pass."""
        self._loops[-1][carried] = self._loops[-1][carried][0], value.text

    def each(self, count: int, write: Callable[[Word], None]) -> None:
        """Write something for 0 .. count - 1."""
        with self.loop(self.whole(count)) as i:
            write(i)

    @contextmanager
    def forever(self) -> Iterator[str]:
        """Until a branch leaves for the label that it yields."""
        name = self.fresh()
        again, after = f"again{name}", f"after{name}"
        self.jump(again)
        self.start(again)
        yield after
        self.jump(again)
        self.start(after)

    def leave(self, condition: Word, label: str) -> None:
        """Go to the label where the condition holds, and on otherwise."""
        on = f"on{self.fresh()}"
        self.branch(condition, label, on)
        self.start(on)

    @contextmanager
    def when(self, condition: Word) -> Iterator[None]:
        """Only where the condition (of all lanes) holds."""
        name = self.fresh()
        self.branch(condition, f"then{name}", f"else{name}")
        self.start(f"then{name}")
        yield
        self.jump(f"else{name}")
        self.start(f"else{name}")

    def joined(self, value: Word, from_block: str, other: Word, other_block: str) -> Word:
        """What came with the block that led here."""
        come = f"[ {value.text}, %{from_block} ], [ {other.text}, %{other_block} ]"
        return self.op(value.type, f"phi {value.type} {come}")
