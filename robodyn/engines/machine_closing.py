"""The closing of states in machine code: Newton steps of least norm, lane by lane."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robodyn.engines.assembler import Module
from robodyn.engines.expression import Expression
from robodyn.engines.formulas import Formula
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
