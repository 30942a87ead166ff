"""A recorded graph written into a kernel: the third way to run it, beside Python text and arrays.

The sine and the cosine of an angle are written together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from robodyn.engines import sines
from robodyn.engines.assembler import Kernel, Word
from robodyn.engines.expression import INPUTS, Expression, Value, needed

_CIRCULAR = ("sin", "cos")
_INSTRUCTIONS: dict[str, Callable[..., Word]] = {
    "+": Kernel.add,
    "-": Kernel.subtract,
    "*": Kernel.multiply,
    "/": Kernel.divide,
    "neg": Kernel.negate,
    "atan2": sines.arctangent,
}


class Segment:
    """Nodes of one graph in one kernel.  What is written stays known to later `write`s.

    `inputs` gives the word of each variable and parameter by its name.
    """

    def __init__(
        self,
        kernel: Kernel,
        inputs: Mapping[str, Word] | Callable[[str], Word],
    ) -> None:
        self.kernel = kernel
        self.input = inputs if callable(inputs) else inputs.__getitem__
        self.words: dict[int, Word] = {}

    def write(self, outputs: Sequence[Value]) -> list[Word]:
        """The words of the outputs, W lanes each."""
        order = needed(outputs, self.words)
        for node in order:
            if node.op not in _CIRCULAR:
                self.words[node.index] = self._node(node)
            elif node.index not in self.words:
                pair = sines.sine_cosine(self.kernel, self.word(node.args[0]))
                for op, word in zip(_CIRCULAR, pair, strict=True):
                    self.words.setdefault(node.graph.node(op, node.args).index, word)
        return [self.word(output) for output in outputs]

    def constants(self, outputs: Sequence[Value]) -> None:
        """Write what `outputs` need of parameters alone: before a loop, once."""
        self.write([node for node in needed(outputs) if node.constant])

    def word(self, value: Value | str) -> Word:
        """The word of a node that is written, or of a number."""
        if isinstance(value, Expression):
            return self.words[value.index]
        return self.kernel.number(float(value))

    def _node(self, node: Expression) -> Word:
        k = self.kernel
        if node.op in INPUTS:
            return self.input(str(node.args[0]))
        a, *rest = map(self.word, node.args)
        if (write := _INSTRUCTIONS.get(node.op)) is not None:
            return write(k, a, *rest)
        match node.op:
            case "sqrt" | "abs" | "floor" as name:
                return k.intrinsic("fabs" if name == "abs" else name, a)
            case "keep":
                return a
            case "choose":
                b, x, y = rest
                return k.select(k.less(a, b), x, y)
            case "rough":
                return sines.rough_power(k, a, float(node.args[1]))  # type: ignore[arg-type]
        return sines.each_lane(k, node.op, a, *rest)  # exp, log, pow, tanh
