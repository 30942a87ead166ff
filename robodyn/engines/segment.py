"""A recorded graph written into a kernel: the third way to run it, beside Python text and arrays.

Sines and cosines of one depth are written together: they share reductions, and one branch for
angles that are too large.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from robodyn.engines import bits, sines
from robodyn.engines.assembler import Kernel, Word
from robodyn.engines.expression import INPUTS, Expression, Value, needed
from robodyn.engines.sines import Circular

_CIRCULAR = ("sin", "cos")


class Segment:
    """Nodes of one graph in one kernel.  What is written stays known to later `write`s.

    `inputs` gives the word of each variable and parameter by its name; `held` nodes are computed
    elsewhere, and read wherever they are used.
    """

    def __init__(
        self,
        kernel: Kernel,
        inputs: Mapping[str, Word] | Callable[[str], Word],
        held: Mapping[int, Callable[[], Word]] | None = None,
    ) -> None:
        self.kernel = kernel
        self.input = inputs if callable(inputs) else inputs.__getitem__
        self.held = held or {}
        self.words: dict[int, Word] = {}

    def write(self, outputs: Sequence[Value]) -> list[Word]:
        """The words of the outputs, W lanes each."""
        order = needed(outputs, self.words.keys() | self.held.keys())
        if self.kernel.module.short:  # a call for each angle
            for node in order:
                if node.op not in _CIRCULAR:
                    self.words[node.index] = self._node(node)
                elif node.index not in self.words:
                    both = (node.graph.node(op, node.args) for op in _CIRCULAR)
                    self._circular([x for x in both if x.index not in self.words])
            return [self.word(output) for output in outputs]
        depths = _depths(order)
        order.sort(key=lambda node: (depths[node.index], node.op not in _CIRCULAR, node.index))
        i = 0
        while i < len(order):
            if order[i].op in _CIRCULAR:
                start, depth = i, depths[order[i].index]
                while (
                    i < len(order) and order[i].op in _CIRCULAR and depths[order[i].index] == depth
                ):
                    i += 1
                self._circular(order[start:i])
            else:
                self.words[order[i].index] = self._node(order[i])
                i += 1
        return [self.word(output) for output in outputs]

    def constants(self, outputs: Sequence[Value]) -> None:
        """Write what `outputs` need of parameters alone: before a loop, once."""
        self.write([node for node in needed(outputs) if node.constant])

    def word(self, value: Value | str) -> Word:
        """The word of a node that is written, or of a number."""
        if isinstance(value, Expression):
            held = self.held.get(value.index)
            return self.words[value.index] if held is None else held()
        return self.kernel.number(float(value))

    def _circular(self, nodes: Sequence[Expression]) -> None:
        wanted: dict[Word, set[str]] = {}
        for node in nodes:
            wanted.setdefault(self.word(node.args[0]), set()).add(node.op)
        asked = [Circular(angle, "sin" in ops, "cos" in ops) for angle, ops in wanted.items()]
        pairs = dict(zip(wanted, sines.circular(self.kernel, asked), strict=True))
        for node in nodes:
            self.words[node.index] = pairs[self.word(node.args[0])][_CIRCULAR.index(node.op)]

    def _node(self, node: Expression) -> Word:
        k = self.kernel
        if node.op in INPUTS:
            return self.input(str(node.args[0]))
        a, *rest = map(self.word, node.args)
        match node.op:
            case "+":
                return k.add(a, *rest)
            case "-":
                return k.subtract(a, *rest)
            case "*":
                return k.multiply(a, *rest)
            case "/":
                return k.divide(a, *rest)
            case "neg":
                return k.negate(a)
            case "sqrt":
                return k.intrinsic("sqrt", a)
            case "abs":
                return k.intrinsic("fabs", a)
            case "keep":
                return a
            case "choose":
                b, x, y = rest
                return k.select(k.less(a, b), x, y)
            case "atan2":
                return sines.arctangent(k, a, *rest)
            case "rough":
                return bits.rough_power(k, a, float(node.args[1]))  # type: ignore[arg-type]
        return sines.each_lane(k, node.op, a, *rest)  # exp, log, pow, tanh


def _depths(order: Sequence[Expression]) -> dict[int, int]:
    """How many sines or cosines stand on the way to each node, what is known left out."""
    depths: dict[int, int] = {}
    for node in order:
        below = [depths.get(a.index, 0) for a in node.args if isinstance(a, Expression)]
        depths[node.index] = max(below, default=0) + (node.op in _CIRCULAR)
    return depths
