"""A mechanism as a function of a number of its scene, for derivatives by numbers.

The scene of the mechanism is read again with another value of the number.  Everything that changes
with it, by copies, sums or signs, gets a variable of a graph.  So what hangs from a tip moves with
the length, as in the scene.  `mechanism.constants` then makes formulas of it, without differences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

from robodyn.elements.contacts import Mode
from robodyn.engines import expression
from robodyn.engines.expression import Expression, Graph, Value, slopes_by, substituted
from robodyn.engines.formulas import KINDS, Formula, Recorded, residuals
from robodyn.engines.planar_numbers import Planar
from robodyn.errors import DescriptionError, InputError
from robodyn.mechanics.loop_rows import coupling_rows
from robodyn.mechanics.mechanism import ClosureRow, Mechanism, constants, with_kept
from robodyn.mechanics.modes import in_mode
from robodyn.scene.scene import Description
from robodyn.scene.scene_values import SceneValues
from robodyn.scene.welds import without_welds

CHANGE = 0.25  # of a number, or of 1 where it is zero
SAME = 1e-9  # relative, by which what is no multiple of a change is told


@lru_cache(maxsize=256)
def number_formula(mechanism: Mechanism, name: str, mode: Mode | None = None) -> Formula:
    """Return the formula of dR (N) by the number `name`, at q, qd, tau and unknowns u (N).

    See `residuals`.  With `mode`, in that mode.  Raises InputError for an unknown name.
    """
    graph = Graph()
    x = graph.variable(name)
    named = with_variable(mechanism, name, x, mode)
    state = Recorded(named, KINDS[1:], True, graph=graph)
    _, _, K, R = residuals(state)
    outputs = substituted(slopes_by(R, [name]), {name: 0.0})
    inputs = (*state.inputs, *(f"u{i}" for i in range(len(K))), *state.timed)
    return Formula(inputs, tuple(outputs), ())


def with_variable(mechanism: Mechanism, name: str, x: Value, mode: Mode | None = None) -> Mechanism:
    """Return the mechanism with x added to a number; with `mode`, in that mode."""
    return with_variables(mechanism, {name: x}, mode)


def with_variables(
    mechanism: Mechanism, numbers: Mapping[str, Value], mode: Mode | None = None
) -> Mechanism:
    """Return the mechanism with values added to numbers, by name."""
    values = named_values(mechanism, *numbers)
    base = values.base
    scene: Any = _comparable(base)
    turned: list[Any] = [None if c.aligned is None else 0.0 for c in base.closures]
    for name, x in numbers.items():
        try:
            size, others = _changed(values, name)
            plain, whole, half = map(_comparable, (base, *others))
            scene = _seeded(scene, plain, whole, half, size, x)
            three = ([c.aligned for c in each.closures] for each in (base, *others))
            angles = zip(*three, strict=True)
            turned = [
                now if a is None else _seeded(now, 0.0, b - a, c - a, size, x)
                for now, (a, b, c) in zip(turned, angles, strict=True)
            ]
        except _NoMultipleError:
            limit = "no derivative is known by it: it changes a mode, a limit or an exponent, or "
            limit += "numbers of the scene by no multiple of its change"
            if f"{name}[0]" in values.names:
                limit = f"is two numbers there: take {name}[0] or {name}[1]"
            raise InputError(name, where=mechanism.source, limit=limit) from None
    kept = {
        row.closure: _turned(row, turned[row.closure])
        for row in mechanism.rows
        if row.arm and row.closure is not None
    }
    made = replace(with_kept(constants(without_welds(scene)), kept), numeric=mechanism)
    couplings = _coupling_rows(mechanism, base, scene)
    rows = (*made.rows, *couplings)
    if mode is None:
        return in_mode(replace(made, rows=rows), Mode())
    # what holds joints is a matter of rates: its rows have no number of the scene
    held = in_mode(mechanism, mode).rows[len(mechanism.rows) :]
    moving = in_mode(replace(made, rows=rows), mode._replace(held=()))
    return replace(moving, rows=moving.rows + held)


def _coupling_rows(mechanism: Mechanism, base: Description, scene: Any) -> tuple[ClosureRow, ...]:
    """Return the rows of couplings with the numbers of `scene`, scaled as before."""
    if scene.couplings == base.couplings:
        return tuple(row for row in mechanism.rows if row.closure is None)
    return tuple(coupling_rows(mechanism.description._replace(couplings=scene.couplings)))


def _comparable(scene: Description) -> Description:
    """Return the scene without angles kept by closures, and without constants."""
    closures = tuple(c._replace(aligned=None) for c in scene.closures)
    return scene._replace(closures=closures, constants=())


def _turned(row: ClosureRow, by: Any) -> ClosureRow:
    """Return the row of a fixed angle that grows by a formula."""
    if not isinstance(by, Expression):
        return row
    turn = Planar(expression.cos(by), -expression.sin(by))
    ground: Any = turn * row.ground if row.ground else row.ground
    P: Any = tuple((d, turn * c) for d, c in row.P)
    return row._replace(ground=ground, P=P)


def named_values(mechanism: Mechanism, *names: str) -> SceneValues:
    """Return the numbers of the mechanism's scene; `names` must be among them.

    Raises InputError for an unknown name, and if the mechanism is no longer that of its scene.
    """
    values = _values(mechanism)
    values.check(names)
    if without_welds(values.base) != mechanism.description or mechanism.added:
        limit = "no derivative is known by it: the mechanism has more than its file (--force)"
        raise InputError(", ".join(names), where=mechanism.source, limit=limit)
    return values


@lru_cache(maxsize=8)
def _values(mechanism: Mechanism) -> SceneValues:
    return SceneValues(mechanism.description.written, mechanism.source)


class _NoMultipleError(Exception):
    """A value of the scene is not linear in a number's change."""


def _changed(values: SceneValues, name: str) -> tuple[float, tuple[Description, Description]]:
    """Return a change of a number, and the scene with all of it, and with half of it."""
    now = values.number(name)
    for sign in (1.0, -1.0):
        change = sign * CHANGE * (abs(now) or 1.0)
        try:
            both = [values.replaced({name: now + part * change}) for part in (1.0, 0.5)]
        except DescriptionError:
            continue
        return (now + change) - now, (both[0], both[1])
    raise _NoMultipleError


def _seeded(now: Any, base: Any, whole: Any, half: Any, size: float, x: Value) -> Any:
    """Return contents of a scene with x times their slope added.

    The slope is that of the change of `size` which turned `base` into `whole`.
    """
    if isinstance(base, tuple) and isinstance(whole, tuple):
        if len(base) != len(whole):
            raise _NoMultipleError
        each = zip(now, base, whole, half, strict=True)
        parts = [_seeded(*four, size, x) for four in each]
        return type(base)(*parts) if hasattr(base, "_fields") else tuple(parts)
    if isinstance(base, complex):
        try:
            return Planar(
                _seeded(now.real, base.real, whole.real, half.real, size, x),
                _seeded(now.imag, base.imag, whole.imag, half.imag, size, x),
            )
        except _NoMultipleError:
            if isinstance(now.real, Expression) or isinstance(now.imag, Expression):
                raise  # both components of one direction
            return _direction(base, whole, half, size, x)
    if base == whole:
        return now
    if not isinstance(base, float):
        raise _NoMultipleError
    slope, other = (whole - base) / size, (half - base) / (0.5 * size)
    if abs(slope - other) > SAME * abs(slope):
        raise _NoMultipleError
    near = round(slope, 9)
    return now + (near if abs(slope - near) < SAME else slope) * x


def _direction(base: complex, whole: complex, half: complex, size: float, x: Value) -> Planar:
    """Return a unit vector d/|d| with x added to a component of d."""
    for way in (1.0 + 0j, 1j):
        across = (whole.conjugate() * base).imag
        part = -across / (size * (whole.conjugate() * way).imag or math.nan)  # 1/|d|
        ends = base + size * part * way, base + 0.5 * size * part * way
        if all(
            abs(z - abs(z) * u) < SAME * abs(z) for z, u in zip(ends, (whole, half), strict=True)
        ):
            re, im = (a + part * b * x for a, b in ((base.real, way.real), (base.imag, way.imag)))
            length = expression.call("sqrt", re * re + im * im)
            return Planar(re / length, im / length)
    raise _NoMultipleError
