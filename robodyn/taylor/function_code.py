"""Machine code of linear functions of the state: their slopes' bounds, and their polynomials."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from robodyn.engines.assembler import ADDRESS, SCALAR, WHOLE, Kernel, Module, Word
from robodyn.engines.machine_sums import WIDE, alike
from robodyn.taylor.coordinate_code import SUMS, CoordinateCode, computed

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene


def write_function(scene: Scene, module: Module) -> None:
    """Functions of a piece of a step: of coordinates, and of forms of the state.

    event_begin(block, h, used, parts) of the piece from the step's start to h after it, and
    event_about(block, x, half, binomials, used, parts) of that about x: what SUMS names, and the
    n_m, of each coordinate that is `used` (n), in `parts`, each wide(order).

    event_slope(form, parts, h, span, slope): `slope` is how much a function changes along the piece
    at the slope n_1, and how far that goes from there at most, where s goes so far.

    event_rows(form, parts, h, rows): the coefficients of its polynomial in s, from the order 1 on.
    """
    vectors = Module(WIDE)
    vectors.functions = module.functions
    slides, n = scene.mechanism.slides, scene.mechanism.n
    for kind in sorted({kind for kind, _ in alike(slides, n)}):
        CoordinateCode(scene, vectors, kind).write()
    for name, given in (("begin", [SCALAR]), ("about", [SCALAR, SCALAR, ADDRESS])):
        types = ADDRESS, *given, ADDRESS, ADDRESS
        _write_coordinates(scene, Kernel(module, f"event_{name}", types, "void"), name)
    _write_slope(scene, module)
    _write_rows(scene, vectors)


def wide(order: int) -> int:
    """How many numbers there are of a coordinate's piece."""
    return len(SUMS) + computed(order) + WIDE


def _write_coordinates(scene: Scene, k: Kernel, name: str) -> None:
    block, *given, used, parts = k.arguments
    first = k.at(block, scene.whole["rows"])
    for slides, joints in alike(scene.mechanism.slides, scene.mechanism.n):
        called = f"{CoordinateCode.name(slides)}_{name}"
        with k.loop(k.whole(joints[-1] + 1), k.whole(joints[0])) as j:
            series, own = k.at(first, k.add(j, j)), _own(scene, k, parts, j)
            with k.when(k.compare("ne", k.load(k.at(used, j), WHOLE), k.whole(0))):
                k.call(called, series, *given, k.at(own, len(SUMS)), own)
    k.done()


def _own(scene: Scene, k: Kernel, parts: Word, j: Word) -> Word:
    """Where what is known of a coordinate stands."""
    return k.at(parts, k.multiply(j, k.whole(wide(scene.order))))


def _weighed(
    scene: Scene, k: Kernel, form: Word, parts: Word, h: Word
) -> Iterator[tuple[Word, Word, Word]]:
    """The weights of each coordinate, and of its rate by s, that a function has; and its own."""
    n = scene.mechanism.n
    with k.loop(k.whole(n)) as j:
        by, by_rate = (k.load(k.at(k.at(form, 2 + i * n), j), SCALAR) for i in (2, 3))
        used = (k.compare("une", weight, k.scalar(0.0)) for weight in (by, by_rate))
        with k.when(k.either(*used)):
            yield by, k.divide(by_rate, h), _own(scene, k, parts, j)


def _write_slope(scene: Scene, module: Module) -> None:
    types = ADDRESS, ADDRESS, SCALAR, SCALAR, ADDRESS
    k = Kernel(module, "event_slope", types, "void")
    form, parts, h, span, slope = k.arguments
    change, reach = k.slot(k.multiply(k.load(k.at(form, 1)), h)), k.slot(k.number(0.0))
    for by, by_rate, own in _weighed(scene, k, form, parts, h):
        first, second, off, bend = (k.load(k.at(own, i)) for i in range(len(SUMS)))
        more = k.add(k.multiply(by, first), k.multiply(by_rate, second))
        k.set(change, k.add(k.get(change), more))
        by, by_rate = (k.intrinsic("fabs", weight) for weight in (by, by_rate))
        more = k.add(k.multiply(by, off), k.multiply(by_rate, bend))
        k.set(reach, k.add(k.get(reach), more))
    for i, slot in enumerate((change, reach)):
        k.store(k.multiply(k.get(slot), span), k.at(slope, i))
    k.done()


def _write_rows(scene: Scene, module: Module) -> None:
    k = Kernel(module, "event_rows", (ADDRESS, ADDRESS, SCALAR, ADDRESS), "void")
    form, parts, h, rows = k.arguments
    begins = range(0, computed(scene.order), WIDE)
    for i in begins:
        k.store(k.number(0.0), k.at(rows, i))
    k.store(k.multiply(k.load(k.at(form, 1), SCALAR), h), k.at(rows, 1))
    for by, by_rate, own in _weighed(scene, k, form, parts, h):
        for i in begins:
            found = k.at(own, len(SUMS) + i)
            orders = k.vector([1.0 / max(m, 1) for m in range(i, i + WIDE)])
            way = k.multiply(k.multiply(k.load(found), orders), k.spread(by))
            rate = k.multiply(k.load(k.at(found, 1)), k.spread(by_rate))
            place = k.at(rows, i)
            k.store(k.add(k.load(place), k.add(way, rate)), place)
    k.done()
