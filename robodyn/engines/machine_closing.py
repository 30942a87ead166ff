"""The closing of states in machine code: Newton steps of least norm, lane by lane.

And whether a step may have leapt to another branch (`loops/misses.py`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from robodyn.engines.assembler import Module
from robodyn.engines.expression import Expression, Graph
from robodyn.engines.formulas import Formula
from robodyn.engines.segment import Segment
from robodyn.loops.misses import orientation
from robodyn.loops.projection import PASSES

if TYPE_CHECKING:
    from robodyn.engines.machine_steps import Scene

SINGULAR = 1e-6  # relative pivot below which a Newton step is not trusted


def write_close(scene: Scene, module: Module, formula: Formula) -> None:
    """Newton's method as `straightline.compile_closing` has it, lane by lane."""
    k, block = scene.kernel(module, "close")
    n, rows = scene.mechanism.n, len(formula.pivots)
    outputs = [*formula.outputs, *formula.pivots]
    graph = next(x.graph for x in outputs if isinstance(x, Expression))
    names = scene.there([f"{name}{j}" for name in ("q", "qd") for j in range(n)])
    moving, passes = k.slot(k.all_lanes(True)), k.slot(k.whole(0))
    quality = k.slot(k.number(0.0))
    speeds = [k.slot(scene.get(k, block, f"to_qd{j}")) for j in range(n)]
    with k.forever() as closed:
        words = scene.segment(k, block, graph, names).write(outputs)
        now = k.get(moving, k.mask)
        pivots = words[2 * n + rows :]
        least = pivots[0]
        for pivot in pivots[1:]:
            least = k.select(k.compare("ult", pivot, least), pivot, least)
        k.set(quality, k.select(now, least, k.get(quality)))
        now = k.both(now, k.less(k.number(SINGULAR), least))
        gap = k.number(0.0)
        for word in words[2 * n : 2 * n + rows]:
            size = k.intrinsic("fabs", word)
            gap = k.select(k.compare("ugt", size, gap), size, gap)
        for slot, word in zip(speeds, words[n : 2 * n], strict=True):
            k.set(slot, k.select(now, word, k.get(slot)))
        now = k.both(now, k.compare("ugt", gap, scene.get(k, block, "rounding")))
        for j in range(n):
            before = scene.get(k, block, f"to_q{j}")
            scene.put(k, block, f"to_q{j}", k.select(now, words[j], before))
        now = k.both(now, k.compare("ugt", gap, scene.get(k, block, "converged")))
        k.set(moving, now)
        count = k.add(k.get(passes, "i64"), k.whole(1))
        k.set(passes, count)
        k.leave(k.invert(k.any(now)), closed)
        k.leave(k.compare("sge", count, k.whole(PASSES)), closed)
    for j, slot in enumerate(speeds):
        scene.put(k, block, f"to_qd{j}", k.get(slot))
    scene.put(k, block, "quality", k.get(quality))
    k.done()


def write_leaps(scene: Scene, module: Module, formula: Formula) -> None:
    """`leaps(block)`: no quality is left where a loop turns over between the step's ends."""
    k, block = scene.kernel(module, "leaps")
    names = [f"{name}{j}" for name in ("q", "qd") for j in range(scene.mechanism.n)]
    graph = next(x.graph for x in formula.outputs if isinstance(x, Expression))
    entries = [(r, j, x) for r, row in enumerate(formula.Psi) for j, x in row.items()]
    words, products = {}, Graph()
    both: list[list[dict[int, Expression]]] = []
    for side, inputs in (("from", {}), ("to", scene.there(names))):
        both.append([{} for _ in formula.Psi])
        found = scene.segment(k, block, graph, inputs).write([x for *_, x in entries])
        for (r, j, _), word in zip(entries, found, strict=True):
            words[f"{side}{r}_{j}"] = word
            both[-1][r][j] = products.variable(f"{side}{r}_{j}")
    quality = scene.get(k, block, "quality")
    for value in Segment(k, words).write(orientation(scene.mechanism, *both)):
        quality = k.select(k.less(k.number(0.0), value), quality, k.number(-1.0))
    scene.put(k, block, "quality", quality)
    k.done()
