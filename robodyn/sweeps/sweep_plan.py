"""What a sweep computes: everything that its rows depend on.

Plain values, which go to other processes and machines, and which tell one sweep from another.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from robodyn import __version__
from robodyn.engines import machine
from robodyn.errors import InputError
from robodyn.loops import assembly
from robodyn.mechanics.loop_columns import loop_columns
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.mechanics.motors import motor_columns
from robodyn.scene.scene_values import SceneValues, numbers_of
from robodyn.sweeps.variation import Variation
from robodyn.taylor.compiled import serves

# points of a chunk: in numpy many share the cost of a call, compiled they are quick to share out
CHUNKS = {"python": 2000, "compiled": 512}
WORTH_MAKING = 200  # points whose time is that of making machine code
RESULTS = ("final", "extremes", "drift", "flip")
EVENTS = "events"  # a result that goes with events alone
ONE_BY_ONE = 64  # points of a chunk whose motions go so
_ENDS = ("min", "max")


@dataclass(frozen=True, slots=True)
class Plan:
    """All that the rows of a sweep depend on: plain values, which go to other processes.

    `q`, `qd`, `qdd` and `tau` are those of the actuated joints, which axes named q1, tau2, ...
    replace; every other axis names a number of the scene.
    """

    scene: str  # its text
    source: str
    variation: Variation
    q: tuple[float, ...]
    qd: tuple[float, ...]
    tau: tuple[float, ...] = ()
    qdd: tuple[float, ...] = ()
    kind: str = "motion"  # or torque
    t_end: float = 10.0
    results: tuple[str, ...] = RESULTS
    link: int = -1  # whose flip is told; -1: the last
    rtol: float = 1e-9
    atol: float = 1e-9
    most: int = 100_000  # steps of a motion
    engine: str = "python"  # or compiled
    version: str = __version__
    chunk: int = CHUNKS["python"]
    events: tuple[tuple[str, str], ...] = ()  # names and expressions
    numbers: tuple[tuple[str, str], ...] = ()  # of the scene, in place of its own

    @property
    def chunks(self) -> int:
        return -(-self.variation.size // self.chunk)

    @property
    def values(self) -> SceneValues:
        """The numbers of the scene, read once."""
        return numbers_of(self.scene, self.source, self.numbers)

    @property
    def mechanism(self) -> Mechanism:
        """That of the scene as it is."""
        return _mechanism(self.scene, self.source, self.numbers)

    @property
    def scene_axes(self) -> tuple[int, ...]:
        """Which axes change the scene."""
        values = self.values
        return tuple(k for k, axis in enumerate(self.variation.axes) if axis.name in values)

    def columns(self) -> list[str]:
        """The names of the columns; the last, `outcome`, is text."""
        mechanism = self.mechanism
        joints = range(1, mechanism.n + 1)
        names = [axis.name for axis in self.variation.axes]
        if self.kind == "torque":
            names += [f"tau{k + 1}" for k in mechanism.actuated]
            return [*names, *loop_columns(mechanism), *motor_columns(mechanism), "outcome"]
        if "final" in self.results:
            names += ["t_end", *(f"{x}{k}_end" for x in ("q", "qd") for k in joints)]
        if "extremes" in self.results:
            names += [f"{x}{k}_{end}" for x in ("q", "qd") for k in joints for end in _ENDS]
            names += [f"energy_{end}" for end in _ENDS]
        names += [name for name in ("drift", "flip") if name in self.results]
        names += [f"{name}_{what}" for name, _ in self.events for what in ("count", "first")]
        return [*names, "outcome"]

    def facts(self) -> dict[str, object]:
        """Everything that the rows depend on, as JSON has it."""
        facts = asdict(self)
        del facts["source"]  # which may be named from elsewhere
        for name in ("events", "numbers"):
            if not facts[name]:
                del facts[name]
        facts["variation"] = [asdict(axis) for axis in self.variation.axes]
        facts |= {"sample": self.variation.sample, "seed": self.variation.seed}
        return facts


@lru_cache(maxsize=8)
def _mechanism(*scene: Any) -> Mechanism:
    return build(numbers_of(*scene).base)


def best_engine(wanted: str, points: int, mechanism: Mechanism) -> str:
    """The engine that `wanted` names; auto: machine code for many points, where it serves.

    Raises InputError where machine code is wanted and there is none.
    """
    if wanted == "python" or (wanted == "auto" and points < WORTH_MAKING):
        return "python"
    there = machine.available()
    if wanted == "compiled":
        if not there:
            limit = "needs the extra `fast` (pip install 'robodyn[fast]'): take auto or python"
            raise InputError("engine", value=wanted, limit=limit)
        return wanted
    return "compiled" if there and serves(mechanism) else "python"


def check(plan: Plan) -> Mechanism:
    """The scene's mechanism; raises InputError for what no point could have.

    Each axis is tried at both of its ends, the others at the scene's own values.
    """
    mechanism = plan.mechanism
    for k in plan.scene_axes:
        axis = plan.variation.axes[k]
        for value in axis.ends:
            build(plan.values.replaced({axis.name: value}))
    assembly.assembly_plan(mechanism)
    return mechanism
