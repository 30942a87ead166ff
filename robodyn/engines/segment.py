"""Writes a recorded graph into a kernel of machine code.

The sine and the cosine of an angle are computed together.

Sine, cosine, arctangent and rough powers work lane by lane without branches.  An angle x up to 1e5
rad is reduced by n quarter turns, n = round(x 2/pi) < 2^16. pi/2 is split into two numbers of 37
bits and a rest, so n times each is exact, and the reduced angle is known as y + tail to 2^-110.
The polynomials are those of fdlibm (degree 13 and 14), accurate to one ulp with the tail.  Larger
angles, infinities and nan are passed to the C library, lane by lane: the result of a lane does not
depend on its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction

from robodyn.engines.assembler import SCALAR, Kernel, Word
from robodyn.engines.expression import INPUTS, Expression, Value, needed

LARGEST = 1e5  # rad
_PAIR = "{{ {0}, {0} }}"  # what functions return

_HALF_PI = Fraction(0x3243F6A8885A308D313198A2E03707344A4093822299F31D0082EFA98EC4E6C8, 2**253)
_FIRST = Fraction(int(_HALF_PI * 2**36), 2**36)
_SECOND = Fraction(int((_HALF_PI - _FIRST) * 2**73), 2**73)
_PARTS = (float(_FIRST), float(_SECOND), float(_HALF_PI - _FIRST - _SECOND))
_ROUND = 1.5 * 2.0**52  # added and taken away, it rounds to a whole number, kept in the last bits
_SIN = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COS = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
# arctangent to 0.66: x + x z P(z)/Q(z) with z = x^2, of Cephes
_ATAN_P = (
    -6.485021904942025371773e1,
    -1.228866684490136173410e2,
    -7.500855792314704667340e1,
    -1.615753718733365076637e1,
    -8.750608600031904122785e-1,
)
_ATAN_Q = (
    1.945506571482613964425e2,
    4.853903996359136964868e2,
    4.328810604912902668951e2,
    1.650270098316988542046e2,
    2.485846490142306297962e1,
    1.0,
)


def _called(
    kernel: Kernel, name: str, args: Sequence[Word], write: Callable[..., Sequence[Word]]
) -> list[Word]:
    """Return the results of a shared function, whose body `write` makes the first time."""
    if name not in kernel.module.functions:
        kernel.module.functions[name] = ""  # keeps its place
        k = Kernel(kernel.module, name, [kernel.numbers] * len(args), _PAIR.format(kernel.numbers))
        found = Word("poison", k.result)
        for i, word in enumerate(write(k, *k.arguments)):
            found = k.op(k.result, f"insertvalue {found}, {word}, {i}")
        k.done(found)
    type = _PAIR.format(kernel.numbers)
    whole = kernel.result_of(type, name, *args)
    return [kernel.op(kernel.numbers, f"extractvalue {whole}, {i}") for i in range(2)]


def sine_cosine(kernel: Kernel, angle: Word) -> Sequence[Word]:
    """Return sine and cosine of an angle."""
    if kernel.module.short:
        return _called(kernel, "sine_cosine", [angle], _sine_cosine)
    return _sine_cosine(kernel, angle)


def _sine_cosine(k: Kernel, x: Word) -> list[Word]:
    found = _reduced(k, x)
    beyond = k.compare("uge", k.intrinsic("fabs", x), k.number(LARGEST))
    before, name = k.block, k.fresh()
    k.branch(k.any(beyond), f"large{name}", f"usual{name}")
    k.start(f"large{name}")
    again = _called(k, "large_sines", [x, *found], _large)
    k.jump(f"usual{name}")
    k.start(f"usual{name}")
    return [
        k.joined(word, before, other, f"large{name}")
        for word, other in zip(found, again, strict=True)
    ]


def _large(k: Kernel, x: Word, *found: Word) -> list[Word]:
    """Replace sine and cosine of large angles by those of the C library."""
    beyond = k.compare("uge", k.intrinsic("fabs", x), k.number(LARGEST))
    names = ("sin", "cos")
    return [
        k.select(beyond, each_lane(k, name, x), word)
        for name, word in zip(names, found, strict=True)
    ]


def _reduced(kernel: Kernel, x: Word) -> tuple[Word, Word]:
    """Return sine and cosine of angles up to LARGEST."""
    k, number = kernel, kernel.number
    shifted = k.add(k.multiply(x, number(float(1 / _HALF_PI))), number(_ROUND))
    n = k.subtract(shifted, number(_ROUND))
    rest = k.subtract(x, k.multiply(n, number(_PARTS[0])))  # exact
    step = number(_PARTS[1])
    y = k.subtract(rest, k.multiply(n, step))
    tail = k.subtract(k.subtract(rest, y), k.multiply(n, step))
    tail = k.subtract(tail, k.multiply(n, number(_PARTS[2])))

    z = k.multiply(y, y)
    v = k.multiply(z, y)
    curve = polynomial(k, z, _SIN[1:])
    bent = k.subtract(k.multiply(number(0.5), tail), k.multiply(v, curve))
    inner = k.subtract(k.multiply(z, bent), tail)
    own_sine = k.subtract(y, k.subtract(inner, k.multiply(v, number(_SIN[0]))))

    half = k.multiply(number(0.5), z)
    most = k.subtract(number(1.0), half)
    lost = k.subtract(k.subtract(number(1.0), most), half)
    curve = k.multiply(z, polynomial(k, z, _COS))
    small = k.subtract(k.multiply(z, curve), k.multiply(y, tail))
    own_cosine = k.add(most, k.add(lost, small))

    quarter = k.convert("bitcast", shifted, k.wholes)
    odd = k.compare("ne", k.binary("and", quarter, k.whole_lanes(1)), k.whole_lanes(0))
    ahead = k.add(quarter, k.whole_lanes(1))
    sin = _signed(k, k.select(odd, own_cosine, own_sine), quarter)
    return sin, _signed(k, k.select(odd, own_sine, own_cosine), ahead)


def _signed(kernel: Kernel, value: Word, quarter: Word) -> Word:
    """Negate a value if the second bit of the number of quarter turns is set."""
    bit = kernel.binary("and", quarter, kernel.whole_lanes(2))
    sign = kernel.binary("shl", bit, kernel.whole_lanes(62))
    turned = kernel.binary("xor", kernel.convert("bitcast", value, kernel.wholes), sign)
    return kernel.convert("bitcast", turned, kernel.numbers)


def each_lane(kernel: Kernel, name: str, *args: Word) -> Word:
    """Call a C library function lane by lane."""
    kernel.module.declare(name, SCALAR, *[SCALAR] * len(args))
    given = ([kernel.lane(a, i) for a in args] for i in range(kernel.lanes))
    return kernel.gathered([kernel.result_of(SCALAR, name, *lane) for lane in given])


def polynomial(kernel: Kernel, x: Word, coefficients: Sequence[float]) -> Word:
    """Evaluate a polynomial by Horner's rule, constant term first."""
    total = kernel.number(coefficients[-1])
    for value in reversed(coefficients[:-1]):
        total = kernel.add(kernel.multiply(total, x), kernel.number(value))
    return total


def arctangent(kernel: Kernel, y: Word, x: Word) -> Word:
    """Return atan2(y, x) within 3 ulp; 0 for (0, 0), nan for nan or two infinities."""
    if kernel.module.short:
        return _called(kernel, "arctangent", [y, x], lambda *given: [_arctangent(*given)] * 2)[0]
    return _arctangent(kernel, y, x)


def _arctangent(kernel: Kernel, y: Word, x: Word) -> Word:
    k, number = kernel, kernel.number
    across, up = k.intrinsic("fabs", x), k.intrinsic("fabs", y)
    steep = k.less(across, up)
    low, high = k.select(steep, across, up), k.select(steep, up, across)
    nothing = k.compare("oeq", high, number(0.0))
    slope = k.divide(low, k.select(nothing, number(1.0), high))
    far = k.less(number(0.66), slope)
    turned = k.divide(k.subtract(slope, number(1.0)), k.add(slope, number(1.0)))
    t = k.select(far, turned, slope)
    z = k.multiply(t, t)
    ratio = k.divide(polynomial(k, z, _ATAN_P), polynomial(k, z, _ATAN_Q))
    angle = k.add(t, k.multiply(k.multiply(t, z), ratio))
    eighth = float(_HALF_PI / 2)
    angle = k.add(angle, k.select(far, number(eighth), number(0.0)))
    angle = k.select(steep, k.subtract(number(float(_HALF_PI)), angle), angle)
    back = k.compare("slt", k.convert("bitcast", x, k.wholes), k.whole_lanes(0))
    angle = k.select(back, k.subtract(number(float(2 * _HALF_PI)), angle), angle)
    return k.intrinsic("copysign", angle, y)


def rough_power(kernel: Kernel, x: Word, exponent: float) -> Word:
    """Return x^exponent for x >= 0 within 7 % for |exponent| <= 1, without a logarithm.

    The bits of x, read as a whole number, are its logarithm to base 2, up to scale, shift and an
    error of 9 %. Zero counts as 2^-1023; nan and infinity give nan.
    """
    k = kernel
    whole = k.convert("sitofp", k.convert("bitcast", x, k.wholes), k.numbers)
    shift = 1023 * 2.0**52 * (1.0 - exponent)
    power = k.add(k.multiply(whole, k.number(exponent)), k.number(shift))
    found = k.convert("bitcast", k.convert("fptosi", power, k.wholes), k.numbers)
    return k.add(found, k.multiply(k.number(0.0), x))


_CIRCULAR = ("sin", "cos")
_INSTRUCTIONS: dict[str, Callable[..., Word]] = {
    "+": Kernel.add,
    "-": Kernel.subtract,
    "*": Kernel.multiply,
    "/": Kernel.divide,
    "neg": Kernel.negate,
    "atan2": arctangent,
}


class Segment:
    """Writes nodes of one graph into one kernel; nodes written earlier are reused.

    `inputs` returns the word of each variable and parameter by name.
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
        """Write the outputs; return their words."""
        order = needed(outputs, self.words)
        for node in order:
            if node.op not in _CIRCULAR:
                self.words[node.index] = self._node(node)
            elif node.index not in self.words:
                pair = sine_cosine(self.kernel, self.word(node.args[0]))
                for op, word in zip(_CIRCULAR, pair, strict=True):
                    self.words.setdefault(node.graph.node(op, node.args).index, word)
        return [self.word(output) for output in outputs]

    def constants(self, outputs: Sequence[Value]) -> None:
        """Write what the outputs need of parameters alone, before a loop."""
        self.write([node for node in needed(outputs) if node.constant])

    def word(self, value: Value | str) -> Word:
        """Return the word of a written node or of a number."""
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
                return rough_power(k, a, float(node.args[1]))  # type: ignore[arg-type]
        return each_lane(k, node.op, a, *rest)  # exp, log, pow, tanh
