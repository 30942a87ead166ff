"""Base parameters: the fewest combinations of parameters that the torques depend on.

Columns of Y over random states, scaled to unit norm, are taken one after the other; one that those
before it already make, to rounding, is dropped, and its parameter joins theirs:

    Y_d = sum_k Y_k beta_kd        base_k = pi_k + sum_d beta_kd pi_d

Inertias and first moments come first, masses last, so that masses are moved to the links below, as
textbooks do.  The factors beta are products and ratios of lengths of the scene: each is told in
symbols where one is it in the scene and in another with all lengths changed a little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn.elements.springs import PointSpring
from robodyn.errors import RobodynError
from robodyn.loops.change_points import nearness
from robodyn.loops.closing import close_positions, loop_size
from robodyn.loops.closures import closure_bias, closure_gap, scaled_jacobian
from robodyn.loops.loop_rates import nearest_velocities
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.mechanics.placed import matvec
from robodyn.parameters.regression_matrix import linear_parameters, regressor
from robodyn.scene.scene import Curve, Description, Motor, Point, Table
from robodyn.tables.arrays import Array
from robodyn.tables.short_repr import short_repr

STATES = 60  # drawn to find the base, each a row a motor
SPAN = 10.0  # s, in which gravity that varies is looked at
TRIES = 20  # drawings of so many, until enough of them close
FARTHEST = 0.05  # s/L of the states that are taken
CLOSED = 1e-12  # of the loop's size, that a state's gap may have
CUT = 1e-10  # part of a column that is rounding; of the examples 2e-13 is it, and 1e-3 is not
EXCITED = 1e-7  # part of what random states do that a motion must do, to tell a number
SAME = 1e-9  # relative, by which a factor is told
MIXED = np.array([1.0, 0.739085133])  # of a value in both scenes: what they are sorted by
SIZE = 0.03  # part by which lengths are changed to tell symbols that are equal by chance


@short_repr
class Dependence(NamedTuple):
    """Which columns are `kept`, which are `dropped`, and beta (kept, dropped).

    `size` is the rms of every column.
    """

    kept: list[int]
    dropped: list[int]
    beta: Array
    size: Array


@short_repr
@dataclass(frozen=True)
class BaseParameter:
    """One combination: pi of `name` and, times `factors`, the others; its value in the scene."""

    name: str
    text: str  # J1 + l1^2 m2
    factors: tuple[tuple[str, float], ...]  # of the others
    value: float
    unit: str


def dependence(Y: Array, names: Sequence[str], cut: float = CUT) -> Dependence:
    """Return the linear dependence of the columns of Y (k, p), up to a fraction `cut` of them."""
    size = np.linalg.norm(Y, axis=0)
    most = float(size.max(initial=0.0))
    order = sorted(range(len(names)), key=lambda k: _rank(names[k]))
    kept: list[int] = []
    Q = np.zeros((len(Y), 0))
    for k in order:
        if size[k] <= cut * most:
            continue
        rest = Y[:, k] / size[k]
        for _ in range(2):  # twice is enough for all digits
            rest = rest - Q @ (Q.T @ rest)
        if (length := float(np.linalg.norm(rest))) > cut:
            kept.append(k)
            Q = np.column_stack([Q, rest / length])
    kept.sort()
    dropped = [k for k in range(len(names)) if k not in kept]
    scaled = Y[:, kept] / size[kept]
    found = np.linalg.lstsq(scaled, Y[:, dropped], rcond=None)[0]
    rms = size / np.sqrt(max(len(Y), 1))
    return Dependence(kept, dropped, found / size[kept][:, None], rms)


def _rank(name: str) -> int:
    """When a column is taken: masses last."""
    kind = name.rstrip("0123456789")
    return {"J": 0, "my": 1, "mx": 2, "m": 9, "Jr": 8}.get(kind, 5)


@lru_cache(maxsize=16)
def base_parameters(mechanism: Mechanism) -> tuple[BaseParameter, ...]:
    """The base parameters of a mechanism.

    Raises RobodynError where no states are found that close its loops.
    """
    parameters = linear_parameters(mechanism.description)
    names, values = [x.name for x in parameters], np.array([x.value for x in parameters])
    found = structural(mechanism)
    other, changed = _changed(mechanism, found)
    symbols = _Factors(_symbols(mechanism.description), _symbols(changed))
    made = []
    for i, k in enumerate(found.kept):
        factors, text = [], names[k]
        for j, d in enumerate(found.dropped):
            beta = float(found.beta[i, j])
            if abs(beta) <= SAME * max(1.0, np.abs(found.beta[:, j]).max()):
                continue
            beta2 = None if other is None else float(other.beta[i, j])
            sign, told = symbols.told(beta, beta2)
            text += f" {'+-'[sign < 0]} {told + ' ' if told else ''}{names[d]}"
            factors.append((names[d], beta))
        value = values[k] + sum(f * values[names.index(name)] for name, f in factors)
        made.append(BaseParameter(names[k], text, tuple(factors), float(value), parameters[k].unit))
    return tuple(made)


@lru_cache(maxsize=16)
def structural(mechanism: Mechanism) -> Dependence:
    """Return the linear dependence of the columns of Y at all states."""
    found = regressor(mechanism, *random_rows(mechanism))
    return dependence(found.Y.reshape(-1, len(found.names)), found.names)


def _times(mechanism: Mechanism, count: int) -> Array:
    """Times (count,) at which gravity that varies, and laws, are not the same; zeros without."""
    if mechanism.description.field is None and not mechanism.driven:
        return np.zeros(count)
    laws = [mechanism.rows[r].law for r in mechanism.driven]
    tables = [x for x in (*mechanism.signals, *laws) if isinstance(x, (Table, Curve))]
    rows = [x.x for x in tables if x.over == "t" and not x.repeats]
    low, high = max((x[0] for x in rows), default=0.0), min((x[-1] for x in rows), default=SPAN)
    return np.random.default_rng(1).uniform(low, high, count)


def excited(mechanism: Mechanism, Y: Array) -> Dependence:
    """Which of the base parameters a motion with the regressor Y (k, p) tells, by their order."""
    base = structural(mechanism)
    names = [x.name for x in linear_parameters(mechanism.description)]
    scaled = Y[:, base.kept] / base.size[base.kept]
    return dependence(scaled, [names[k] for k in base.kept], EXCITED)


def random_states(mechanism: Mechanism, count: int = STATES, seed: int = 0) -> list[Array]:
    """q, qd, qdd (count, n) of closed states, none near a singular one.

    Raises RobodynError where they are not found.
    """
    return random_rows(mechanism, count, seed)[:3]


def random_rows(mechanism: Mechanism, count: int = STATES, seed: int = 0) -> list[Array]:
    """The same, and their times (count,).

    Raises RobodynError where they are not found.
    """
    rng, n, units = np.random.default_rng(seed), mechanism.n, mechanism.arrays.units
    poses, times = np.zeros((0, n)), np.zeros(0)
    for _ in range(TRIES):
        q = rng.uniform(-np.pi, np.pi, (4 * count, n)) * units
        t = _times(mechanism, len(q)) if mechanism.driven else np.zeros(len(q))
        if mechanism.rows:
            q = close_positions(mechanism, q, t=t)
            good = np.isfinite(q).all(axis=-1)
            q, t = q[good], t[good]
            gap = np.abs(closure_gap(mechanism, q, t)).max(axis=-1)
            closed = gap <= CLOSED * loop_size(mechanism)
            q, t = q[closed], t[closed]
            if len(q):
                regular = nearness(mechanism, scaled_jacobian(mechanism, q, t)) >= FARTHEST
                q, t = q[regular], t[regular]
        poses, times = np.concatenate([poses, q])[:count], np.concatenate([times, t])[:count]
        if len(poses) == count:
            break
    if len(poses) < min(count, 8):
        limit = "no states were found that close its loops, to tell the base parameters from"
        raise RobodynError("base parameters", where=mechanism.source, limit=limit)
    qd, qdd = (rng.normal(size=poses.shape) * units for _ in range(2))
    if mechanism.rows:
        qd = nearest_velocities(mechanism, poses, qd, times)
        Psi = scaled_jacobian(mechanism, poses, times)
        opening = matvec(Psi, qdd / units) + closure_bias(mechanism, poses, qd, times)
        qdd = qdd - units * matvec(np.linalg.pinv(Psi), opening)
    return [poses, qd, qdd, times if mechanism.driven else _times(mechanism, len(poses))]


# -- factors in symbols ---------------------------------------------------------------------------

Symbol = tuple[str, float]


def _symbols(description: Description) -> list[Symbol]:
    """The lengths and ratios of a scene, by the names that equations have for them.

    Springs without free length pull as weights do, by where they are held over gravity.
    """
    links = description.links
    found: list[Symbol] = []

    def point(name: str, at: Point, held: bool = False) -> None:
        if at.link is None and not held:
            return
        if at.link is not None and at.at == links[at.link].l:
            return
        found.extend((f"{name}{axis}", x) for axis, x in (("x", at.at.real), ("y", at.at.imag)))

    for k, link in enumerate(links, start=1):
        found.append((f"l{k}", link.l))
        point(f"p{k}", link.hangs_from)
        if link.motor is not None:
            found.append((f"N{k}", link.motor.ratio))
    for c, closure in enumerate(description.closures, start=1):
        point(f"a{c}", closure.first)
        if closure.along is None:
            point(f"b{c}", closure.second)
    for c, coupling in enumerate(description.couplings, start=1):
        found += [(f"i{c}_{k + 1}", ratio) for k, ratio in coupling.terms]
    every = enumerate(description.springs, start=1)
    springs = [(i, x) for i, x in every if isinstance(x, PointSpring) and not x.length]
    for i, spring in springs:
        point(f"e{i}", spring.first, held=True)
        point(f"h{i}", spring.second, held=True)
    if springs and not description.gravity.real:
        found.append(("g", -description.gravity.imag))
    return [(name, float(x)) for name, x in found]


def _changed(
    mechanism: Mechanism, found: Dependence, alike: bool = False
) -> tuple[Dependence | None, Description]:
    """The same of the scene with other lengths, and that; None where other columns are kept.

    Of a parallelogram other columns are, unless what is `alike` stays so; that is tried last.
    """
    base = mechanism.description._replace(welds=(), apart=None)  # they are parts of its links
    rng = np.random.default_rng(1)
    parts: dict[float, float] = {}

    def near(x: float) -> float:
        part = 1.0 + float(rng.uniform(-SIZE, SIZE))
        return x * (parts.setdefault(abs(x), part) if alike else part)

    lengths = [near(link.l) for link in base.links]

    def moved(value: Any) -> Any:
        """Return scene contents with points and ratios changed; tips move with link lengths."""
        match value:
            case Point(link, at):
                if link is not None and at == base.links[link].l:
                    return Point(link, complex(lengths[link]))
                return Point(link, complex(near(at.real), near(at.imag)))
            case Motor():
                return value._replace(ratio=near(value.ratio))
            case (int() as joint, float() as ratio):
                return joint, near(ratio)
            case tuple():
                inner = map(moved, value)
                return type(value)(*inner) if hasattr(value, "_fields") else tuple(inner)
        return value

    changed = moved(base)
    pairs = zip(changed.links, lengths, strict=True)
    links = tuple(link._replace(l=length) for link, length in pairs)
    changed = changed._replace(links=links, gravity=base.gravity * near(1.0))
    try:
        other = structural(build(changed))
    except RobodynError:
        other = None
    if other is not None and other.kept == found.kept:
        return other, changed
    return (None, changed) if alike else _changed(mechanism, found, alike=True)


class _Factors:
    """What factors may be in symbols, each in the scene and in that with other lengths.

    A product of up to three lengths or ratios, of the squares of a ratio and a length, or the
    square of where a joint or a pin is on its link, over a product of up to two, or over 2; or a
    sum or difference of two of these.
    """

    def __init__(self, scene: Sequence[Symbol], changed: Sequence[Symbol]) -> None:
        pairs = zip(scene, changed, strict=True)
        both = {name: np.array([x, y]) for (name, x), (_, y) in pairs if x and y}
        above = {"": np.ones(2)} | _products(both, 3)
        for name in [x for x in both if x.endswith("x") and f"{x[:-1]}y" in both]:
            square = both[name] ** 2 + both[f"{name[:-1]}y"] ** 2
            text = f"({name}^2 + {name[:-1]}y^2)"
            above |= {text: square} | {f"{a} {text}": x * square for a, x in both.items()}
        ratios = [x for x in both if x[0] in "iN"]
        above |= {f"{i}^2 {a}^2": (both[i] * x) ** 2 for i in ratios for a, x in both.items()}
        below = {"": np.ones(2)} | _products(both, 2) | {"2": np.full(2, 2.0)}
        quotients = np.array(list(above.values()))[:, None] / np.array(list(below.values()))
        lengths = np.add.outer([len(x) for x in above], [len(x) for x in below]).ravel()
        shortest = np.argsort(lengths, kind="stable")
        values = quotients.reshape(-1, 2)[shortest]
        _, first = np.unique(np.round(np.log(np.abs(values @ MIXED)), 11), return_index=True)
        order = first[np.argsort(values[first] @ MIXED)]
        self.values = values[order]  # (k, 2), each once
        self.keys = self.values @ MIXED  # which rise
        self.lengths, places = lengths[shortest][order], shortest[order]
        self.texts = [divmod(place, len(below)) for place in places.tolist()]
        self.above, self.below = list(above), list(below)

    def told(self, beta: float, other: float | None) -> tuple[float, str]:
        """The sign of a factor, and it in symbols, or as a number; nothing where it is 1."""
        sign = 1.0 if beta > 0.0 else -1.0
        if other is None:
            return sign, "" if abs(abs(beta) - 1.0) <= SAME else f"{abs(beta):.12g}"
        wanted = np.array([beta, other])
        for way in (1.0, -1.0):
            nearest, same = self._nearest(way * wanted[None], np.abs(wanted))
            if same[0]:
                return way, self._text(int(nearest[0]))
        size = np.abs(self.values) + np.abs(wanted)
        found = []  # of two terms: beta = way (A - second B)
        for way, second in product((1.0, -1.0), repeat=2):
            k, close = self._nearest(second * (self.values - way * wanted), size)
            for i in np.flatnonzero(close).tolist():
                length = int(self.lengths[i] + self.lengths[k[i]])
                found.append((length, -way, i, int(k[i]), "+-"[second > 0.0]))
        if not found:
            return sign, f"{abs(beta):.12g}"
        _, way, i, j, second_sign = min(found)
        return -way, f"({self._text(i)} {second_sign} {self._text(j)})"

    def _nearest(self, wanted: Array, size: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Which value is next to each of (m, 2), and whether it is the same in both scenes."""
        keys = wanted @ MIXED
        k = np.searchsorted(self.keys, keys).clip(1, len(self.keys) - 1)
        k = k - (keys - self.keys[k - 1] < self.keys[k] - keys)
        close = (np.abs(self.values[k] - wanted) <= SAME * size).all(axis=-1)
        return k, close

    def _text(self, k: int) -> str:
        i, j = self.texts[k]
        text, under = str(self.above[i]), self.below[j]
        if under:
            text = f"{text or 1}/{f'({under})' if ' ' in under else under}"
        return text


def _products(symbols: dict[str, Array], most: int) -> dict[str, Array]:
    """Products of up to so many of them, as l1^2 l2."""
    found = {}
    for count in range(1, most + 1):
        for names in combinations_with_replacement(symbols, count):
            parts = [
                name if (power := names.count(name)) == 1 else f"{name}^{power}"
                for name in dict.fromkeys(names)
            ]
            found[" ".join(parts)] = np.prod([symbols[name] for name in names], axis=0)
    return found
