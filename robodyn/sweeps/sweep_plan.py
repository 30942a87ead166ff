"""What a sweep computes: everything that its rows depend on.

Plain values, which go to other processes and machines, and which tell one sweep from another.

Points are a grid, or a random sample, of several quantities.  A grid is the product of its axes'
values, the last axis varying fastest.  A sample draws an interval [low, high) by low + u (high -
low), a list of values by its entry floor(u count), and a normal distribution by its quantile at u,
with u from numpy's Generator(PCG64(seed)).random, one u an axis and point, point by point.  The
generator is set forward to where a block of points begins, so that a block depends on nothing but
its place.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from functools import lru_cache
from typing import Any

import numpy as np

from robodyn import __version__
from robodyn.control.tracking import ReferenceTable
from robodyn.dynamics.columns import TORQUE, column_names, result_names
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.errors import InputError
from robodyn.loops.assembly_plan import assembly_plan, with_independent
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.runs.motion_columns import TOO_FAST, as_actuation
from robodyn.runs.torques_over_time import over_run
from robodyn.scene.scene import Tables
from robodyn.scene.scene_values import SceneValues, read_numbers
from robodyn.tables.arrays import Array

LEAST = 2.0**-54  # in place of a draw of 0, whose quantile is infinite


@dataclass(frozen=True, slots=True)
class Axis:
    """One quantity that varies: over `values`, or (in samples alone) from `low` to `high`."""

    name: str
    values: tuple[float, ...] = ()
    low: float = 0.0
    high: float = 0.0
    deviation: float = 0.0  # of a normal distribution about `low`

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest value; of a normal distribution, which has none, its mean."""
        if self.deviation:
            return self.low, self.low
        return (min(self.values), max(self.values)) if self.values else (self.low, self.high)

    def drawn(self, u: Array) -> Array:
        """The values for u in [0, 1)."""
        if self.deviation:
            from statistics import NormalDist  # which takes longer than all that a grid needs

            quantile = NormalDist(self.low, self.deviation).inv_cdf
            return np.array([quantile(x) for x in np.maximum(u, LEAST).tolist()])
        if not self.values:
            return self.low + u * (self.high - self.low)
        place = np.minimum((u * len(self.values)).astype(int), len(self.values) - 1)
        values: Array = np.array(self.values)
        return np.asarray(values[place])


@dataclass(frozen=True, slots=True)
class Variation:
    """All points: of a grid, or `sample` drawn ones."""

    axes: tuple[Axis, ...]
    sample: int | None = None
    seed: int = 0

    @property
    def size(self) -> int:
        """The number of points."""
        if self.sample is not None:
            return self.sample
        return math.prod(len(axis.values) for axis in self.axes)

    def points(self, begin: int, end: int) -> Array:
        """The points of these numbers, (end - begin, axes)."""
        count = len(self.axes)
        if self.sample is not None:
            stream = np.random.PCG64(self.seed)
            stream.advance(begin * count)  # a draw each
            u = np.random.Generator(stream).random((end - begin, count))
            columns = [axis.drawn(u[:, k]) for k, axis in enumerate(self.axes)]
        else:
            columns, number = [], np.arange(begin, end)
            for axis in reversed(self.axes):
                number, place = np.divmod(number, len(axis.values))
                columns.append(np.array(axis.values)[place])
            columns.reverse()
        return np.stack(columns, axis=-1) if columns else np.zeros((end - begin, 0))


def stepped(first: float, last: float, step: float) -> tuple[float, ...]:
    """first, first + step, ... to last, which is met exactly where the steps lead there.

    Raises ValueError where they lead away from it.
    """
    if step == 0.0 or (last - first) * step < 0.0:
        raise ValueError("the step leads nowhere")
    steps = (last - first) / step
    count = math.floor(steps + 1e-9)
    values = [first + k * step for k in range(count + 1)]
    if abs(steps - count) <= 1e-9:
        values[-1] = last
    return tuple(values)


def spaced(first: float, last: float, count: int) -> tuple[float, ...]:
    """`count` values from first to last, both included."""
    values: Sequence[float] = np.linspace(first, last, count).tolist()
    return tuple(values)


CHUNKS = {"DOP853": 64, "taylor": 512}  # points of a chunk of motions
STATES = 2000  # of torques: many share the cost of a call
RESULTS = ("final", "extremes", "drift", "flip")  # families of columns
EVENTS = "events"  # one that goes with events alone


@dataclass(frozen=True, slots=True)
class Plan:
    """All that the rows of a sweep depend on: plain values, which go to other processes.

    `q`, `qd` and `qdd` are those of the independent joints (see `with_independent`), `tau` those
    of the actuated ones.  Axes named q1, tau2, ... replace them; every other axis names a number of
    the scene.
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
    method: str = "DOP853"  # of motions, one by one; or taylor: in lanes of machine code
    version: str = __version__
    chunk: int = STATES
    events: tuple[tuple[str, str], ...] = ()  # names and expressions
    numbers: tuple[tuple[str, str], ...] = ()  # of the scene, in place of its own
    tables: Tables = field(default_factory=dict)  # that the scene names, so that nobody reads them
    told: tuple[str, ...] = ()  # results of columns, see `row_results.py`
    of: tuple[str, ...] = ()  # the points of these columns
    rows: int = 0  # of a motion whose columns are told
    track: ReferenceTable | None = None  # the rows of torques, in place of one state
    control: tuple[tuple[str, Any], ...] = ()  # arguments of `controller`, by name

    @property
    def chunks(self) -> int:
        return -(-self.variation.size // self.chunk)

    @property
    def values(self) -> SceneValues:
        """The numbers of the scene, read once."""
        return _values(*self._scene)

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism of the scene as it is."""
        return _mechanism(*self._scene)

    @property
    def _scene(self) -> tuple[Any, ...]:
        return self.scene, self.source, self.numbers, tuple(self.tables.items())

    @property
    def scene_axes(self) -> tuple[int, ...]:
        """Which axes change the scene."""
        values = self.values
        return tuple(k for k, axis in enumerate(self.variation.axes) if axis.name in values)

    def columns(self) -> list[str]:
        """The names of the columns; the last, `outcome`, is text."""
        mechanism = self.mechanism
        joints = column_names(mechanism, ["q", "qd"])
        names = [axis.name for axis in self.variation.axes]
        if self.kind == "torque":
            names += self.told or column_names(mechanism, TORQUE)
            return names + result_names("outcome")
        of = {"final": ["t", *joints], "extremes": [*joints, "energy"]}
        for result in (x for x in RESULTS if x in self.results):
            names += result_names(result, of.get(result, [""]))
        names += result_names(EVENTS, [name for name, _ in self.events])
        return [*names, *self.told, *result_names("outcome")]

    def facts(self) -> dict[str, object]:
        """Everything that the rows depend on, as JSON has it."""
        facts = {x.name: getattr(self, x.name) for x in fields(self)}
        del facts["source"]  # which may be named from elsewhere
        del facts["tables"]
        for file in dict.fromkeys(file for file, *_ in self.tables):
            own = [pair for pair in self.tables.items() if pair[0][0] == file]
            facts[f"table {file}"] = hashlib.sha256(repr(own).encode()).hexdigest()[:16]
        for name in ("events", "numbers", "told", "of", "rows", "track", "control"):
            if not facts[name]:
                del facts[name]
            elif name in ("track", "control"):
                text = repr(_plain(facts[name]))
                facts[name] = hashlib.sha256(text.encode()).hexdigest()
        facts["variation"] = [asdict(axis) for axis in self.variation.axes]
        facts |= {"sample": self.variation.sample, "seed": self.variation.seed}
        return facts


@lru_cache(maxsize=8)
def _values(scene: str, source: str, numbers: Any, tables: Any) -> SceneValues:
    return read_numbers(scene, source, numbers, dict(tables))


@lru_cache(maxsize=8)
def _mechanism(*scene: Any) -> Mechanism:
    return build(_values(*scene).base)


def _plain(value: Any) -> object:
    """A reference, or arguments of a controller, as something whose text tells them apart."""
    if isinstance(value, tuple):
        return [_plain(x) for x in value]
    if isinstance(value, Mechanism):
        return value.description
    if isinstance(value, ReferenceTable):
        return value.times, value.coefficients.tolist()
    return value


def check(plan: Plan) -> Mechanism:
    """The scene's mechanism; raises InputError for what no point could have.

    Each axis is tried at both of its ends, the others at the scene's own values.  Warns of loads
    that change too fast to be sampled.
    """
    mechanism = plan.mechanism
    axes = [plan.variation.axes[k] for k in plan.scene_axes]
    ends = [build(plan.values.replaced({x.name: value})) for x in axes for value in x.ends]
    assembly_plan(mechanism if plan.track else with_independent(mechanism))
    if plan.kind == "motion" or not plan.told:  # columns that are told may need none
        for each in (mechanism, *ends):
            each.check_masses()
    if plan.kind == "motion" and mechanism.timed:
        with suppress(InputError):  # of a table that ends too early: motions tell it
            loads, at_rest = as_actuation(mechanism, None), np.zeros(2 * mechanism.n)
            if not over_run(mechanism, loads, at_rest, plan.t_end, plan.atol).resolved:
                warnings.warn(TOO_FAST, RobodynWarning, stacklevel=2)
    return mechanism
