"""Laws of springs, loads that vary, dry friction and compliant stops, as formulas in symbols.

In motion a joint with dry friction is held back by

    B = sign(qd) (tf + (ts - tf) exp(-(qd/ws)^2)),

and compliant stops push it by Y, of each side

    step(x) max(0, k x + d v),

x how far it is beyond, v = x'; step(x) is 1 for x > 0, else 0.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from robodyn.equations.symbolic import Atom, Planar, Role, Sum, of, summed
from robodyn.mechanics.planar_model import Mechanism, conserves
from robodyn.scene.scene import DryFriction, JointSpring, Law, Limits, Load, Moment

SWITCHES = "sign(0) is 0, and step(x) is 1 for x > 0, else 0."


@dataclass(frozen=True)
class Formula:
    """An expression in names, each with the sum that it stands for."""

    tree: ast.expr
    names: Mapping[str, Sum]

    def atoms(self) -> Iterator[Atom]:
        """Every atom that it uses."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Name) and node.id in self.names:
                yield from self.names[node.id].atoms()

    def substituted(self, values: Mapping[str, Fraction]) -> Formula:
        """The same with numbers for the symbols that `values` names."""
        names = {name: entry.substituted(values) for name, entry in self.names.items()}
        return Formula(self.tree, names)

    @property
    def switches(self) -> bool:
        """Whether it has what `SWITCHES` explains."""
        return any(
            isinstance(x, ast.Name) and x.id in ("sign", "step") for x in ast.walk(self.tree)
        )

    def value(self, number: Callable[[Sum], Any], functions: Mapping[str, Any]) -> Any:
        """What it is, `number` telling what sums are."""
        scope = {name: number(entry) for name, entry in self.names.items()}
        code = compile(ast.fix_missing_locations(ast.Expression(self.tree)), "<formula>", "eval")
        return eval(code, {"__builtins__": {}}, {**functions, **scope})


class Definition(NamedTuple):
    """A name that stands for a formula in the entries."""

    name: str
    value: Sum | Formula
    unit: str
    meaning: str


class Loads:
    """Loads of a scene in symbols, with names for the parts that vary.

    `scene` has those that turn with a link, and the constant ones; the others are `drags`.
    """

    def __init__(self, scene: Any) -> None:
        self.names: list[tuple[Atom, str, str, Law]] = []
        kept: list[Any] = []
        self.drags: list[Any] = []
        for i, load in enumerate(scene.loads):
            if isinstance(load, Moment) and isinstance(load.varying, Law):
                told = f"torque of load {i + 1}"
                name = self._named(f"T{i + 1}", (load.link, "T"), "N m", told, load.varying)
                self.drags.append(load._replace(torque=name, varying=None))
            elif isinstance(load, Load) and load.varies:
                parts: list[Any] = [load.force.real, load.force.imag]
                for k, signal in enumerate(load.varying):
                    if isinstance(signal, Law):
                        axis = "xy"[k]
                        told = f"force of load {i + 1}, {axis}"
                        parts[k] = self._named(
                            f"F{i + 1}{axis}", (i, f"F{axis}"), "N", told, signal
                        )
                force: Any = Planar(*map(summed, parts))
                given = load._replace(force=force, varying=(None, None))
                (kept if load.turns else self.drags).append(given)
            else:
                kept.append(load)
        self.scene = scene._replace(loads=tuple(kept))

    def _named(self, name: str, place: tuple[int, str], unit: str, told: str, law: Law) -> Any:
        self.names.append((Atom(Role.force, place, name), unit, told, law))
        return of(self.names[-1][0])

    def definitions(self, block: str, write: Callable[..., Any]) -> Iterator[Definition]:
        """What the names stand for, in the block that uses them."""
        for name, unit, told, law in self.names if block == "Q" else []:
            yield Definition(name.name, write(formula_of(law, {})), unit, told)


class JointTerm(NamedTuple):
    """What acts at a joint by a formula that has a name; it is added `sign` times to its block."""

    joint: int
    block: str
    sign: int
    name: Atom
    unit: str
    meaning: str
    formula: Formula


def formula_of(law: Law, own: Mapping[str, Sum]) -> Formula:
    """The formula of an expression in t, q0.., qd0..; `own` has a spring's x and v."""
    names = {}
    for name in law.names:
        if name in own:
            names[name] = own[name]
        elif name == "t":
            names[name] = of(Atom(Role.force, (-1, ""), "t"))
        else:
            names[name] = _rate(int(name[2:])) if name[1] == "d" else _angle(int(name[1:]))
    return Formula(_plain(ast.parse(law.code, mode="eval").body), names)


def spring_terms(mechanism: Mechanism, scene: Any) -> Iterator[JointTerm]:
    """The springs at joints that have laws; `scene` has symbols for numbers."""
    for i, spring in enumerate(scene.springs):
        if isinstance(spring, JointSpring) and isinstance(spring.law, Law):
            j, potential = spring.joint, conserves(spring.law)
            own = {"x": _angle(j) - spring.angle, "v": _rate(j)}
            link, unit = _joint(mechanism, j)
            told = f"pull of spring {i + 1}, at the joint of {link}"
            name, formula = Atom(Role.force, (i, ""), f"H{i + 1}"), formula_of(spring.law, own)
            block, sign = ("G", 1) if potential else ("Q", -1)
            yield JointTerm(j, block, sign, name, unit, told, formula)


def contact_terms(
    mechanism: Mechanism, dry: Mapping[int, DryFriction], stops: Mapping[int, Limits]
) -> Iterator[JointTerm]:
    """Dry friction in motion and compliant stops, with symbols for their numbers."""
    for j, friction in dry.items():
        link, unit = _joint(mechanism, j)
        numbers = dict(mechanism.dry)[j]
        falls = numbers.stribeck is not None and numbers.static > numbers.torque
        text = "a*sign(v)"
        known: dict[str, Any] = {"a": friction.torque}
        if falls and friction.torque:
            text = "sign(v)*(a + (s - a)*exp(-(v/w)**2))"
        elif falls:
            text = "s*sign(v)*exp(-(v/w)**2)"
        if falls:
            known |= {"s": friction.static, "w": friction.stribeck}
        if falls or friction.torque:
            name = Atom(Role.force, (j, "~"), f"B{j + 1}")
            told = f"dry friction at the joint of {link}, in motion"
            formula = _written(text, {**known, "v": _rate(j)})
            yield JointTerm(j, "Q", -1, name, unit, told, formula)
    for j, stop in stops.items():
        link, unit = _joint(mechanism, j)
        known = {"q": _angle(j), "v": _rate(j), "k": stop.stiffness}
        damper = {"l": "", "h": ""}
        if stop.damping:
            known["d"] = stop.damping
            damper = {"l": " - d*v", "h": " + d*v"}
        parts = []
        for end, value, beyond in (("l", stop.low, "l - q"), ("h", stop.high, "q - h")):
            if value is None:
                continue
            known[end] = value
            if not value:
                beyond = "-q" if end == "l" else "q"
            push = f"max(0, k*({beyond}){damper[end]})"
            push = f"step({beyond})*{push}" if stop.damping else push
            parts.append(push if end == "l" else f"-({push})")
        name = Atom(Role.force, (j, "~"), f"Y{j + 1}")
        told = f"push of the stops of the joint of {link}"
        text = " + ".join(parts).replace("+ -", "- ")
        yield JointTerm(j, "Q", 1, name, unit, told, _written(text, known))


def _joint(mechanism: Mechanism, joint: int) -> tuple[str, str]:
    return mechanism.link_names[joint], "N" if joint in mechanism.slides else "N m"


def _angle(joint: int) -> Sum:
    return of(Atom(Role.angle, (joint,)))


def _rate(joint: int) -> Sum:
    return of(Atom(Role.rate, (joint,)))


def _written(text: str, known: Mapping[str, Any]) -> Formula:
    tree = ast.parse(text, mode="eval").body
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    return Formula(tree, {name: value for name, value in known.items() if name in used})


class _Plain(ast.NodeTransformer):
    """Functions by their names, powers as powers, and numbers that are computed as one number."""

    def visit_Call(self, node: ast.Call) -> ast.expr:
        assert isinstance(node.func, ast.Name)
        args = [self.visit(x) for x in node.args]
        if node.func.id == "_pow":
            return ast.BinOp(args[0], ast.Pow(), args[1])
        return ast.Call(ast.Name(node.func.id.removeprefix("_"), ast.Load()), args, [])

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        found = ast.BinOp(self.visit(node.left), node.op, self.visit(node.right))
        if isinstance(found.left, ast.Constant) and isinstance(found.right, ast.Constant):
            try:
                return ast.Constant(float(eval(ast.unparse(found), {"__builtins__": {}})))
            except (ArithmeticError, TypeError):
                return found
        return found


def _plain(tree: ast.expr) -> ast.expr:
    plain: ast.expr = _Plain().visit(tree)
    return plain
