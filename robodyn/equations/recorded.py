"""The equations of motion as recorded arithmetic on named numbers, for generated code.

The scene's numbers are variables m1, l2, ... of a graph, or exact fractions.  The rows, evaluated
on these, record the equations of motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

from robodyn.elements.builder import NoDirection
from robodyn.engines import expression
from robodyn.engines.expression import Expression, Graph, Value
from robodyn.engines.formulas import RECORDED, WRITTEN, Recorded
from robodyn.equations.entries import Entries
from robodyn.equations.named_laws import Formula, contact_terms, with_symbols
from robodyn.equations.outline import Block, Equations, Head, heads, load_unit
from robodyn.equations.parameters import Parameters
from robodyn.equations.symbolic import Planar, Role, Sum
from robodyn.mechanics.mechanism import Mechanism, constants, too_large, with_kept
from robodyn.mechanics.parts import no_direction
from robodyn.scene.expressions import changed
from robodyn.scene.scene import Law

SHORT = replace(RECORDED, keep=lambda value: value)  # signs and factors move where they fold


def recorded(mechanism: Mechanism, numeric: bool = False) -> Equations[Value]:
    """Return the equations of motion of a mechanism's scene, with inputs q0, .., qd0, ..

    Raises InputError if a number leaves the range of floats, and SingularError if the ends of a
    spring coincide at every state.
    """
    graph = Graph()
    parameters = Parameters(mechanism)
    numbers = _Numbers(parameters, numeric, graph)
    defined = {x.name: x.value for x in parameters.laws}

    def law_value(x: Any) -> Value:
        """Return the formula of a law's name; numbers and lengths stay as they are."""
        ((monomial, _),) = x.terms.items()
        formula = defined.get(monomial[0][0].name) if monomial else None
        found: Value = numbers(x)
        if isinstance(formula, Formula):
            found = formula.value(numbers, WRITTEN)
        return found

    couplings = [
        (
            numbers(offset),
            {k: numbers(turn) for k, turn in turns.items()},
            None if law is None else law.each(law_value),
        )
        for offset, turns, law in parameters.couplings
    ]

    def state(by_direction: bool, part: Mechanism) -> Recorded:
        return Recorded(part, ("qd", "qdd"), by_direction, graph=graph, arithmetic=SHORT)

    try:
        kept = {c: numbers(row) for c, row in parameters.kept.items()}
        scene = numbers(parameters.scene)  # without masses its closures are asked for alone
        scene = scene._replace(links=tuple(x._replace(has_mass=True) for x in scene.links))
        named = with_kept(constants(scene), kept)
        ways = [Entries(named, couplings, partial(state, way)) for way in (False, True)]
        found = []
        known = list(heads(mechanism))
        for head in known if mechanism.massless else (*known, _summed(mechanism, known)):
            written = [way.of(head.name) for way in ways]
            for way in written if head.name == "Q" or head.side == "sum" else ():
                sign = 1 if head.name == "Q" else -1
                _add_contacts(way, sign, mechanism, parameters, numbers)
            rows = min(written, key=lambda rows: expression.cost(list(chain.from_iterable(rows))))
            found.append(Block(head, tuple(map(tuple, rows))))
        entries = list(chain.from_iterable(row for block in found for row in block.rows))
        nodes = expression.needed(entries)
        constant = chain(entries, (a for node in nodes for a in node.args))
        folded = [abs(float(x)) for x in constant if not isinstance(x, (str, Expression))]
        sums = sum(abs(x) for *_, x in mechanism.A) if numeric else 0.0  # as in M's entries
        if not math.isfinite(max([sums, *folded])):
            raise OverflowError
    except OverflowError:
        raise too_large(mechanism.description) from None
    except NoDirection as error:
        raise no_direction(mechanism, *error.args) from None
    used = {str(node.args[0]) for node in nodes if node.op == "var"}
    return Equations(mechanism, tuple(found), parameters, used, numeric)


def _summed(mechanism: Mechanism, heads: Sequence[Head]) -> Head:
    """Return the head of the sum that gives the joint torques."""
    left = " + ".join(f"{x.name} {x.rate}".strip() for x in heads if x.side == "left")
    right = "".join(f" - {x.name}" for x in heads if x.side == "right")
    name, told = "inverse_dynamics", "joint torques tau"
    if mechanism.rows:
        name, told = "joint_torques", "joint torques and pin forces, tau + Psi^T lambda"
    timed = ("t",) if mechanism.timed else ()
    inputs = ("q", "qd", "qdd", *timed)
    return Head("sum", name, f"{told} = {left}{right}", load_unit(mechanism), "vector", inputs)


def _add_contacts(
    Q: list[list[Any]], sign: int, mechanism: Mechanism, parameters: Parameters, numbers: _Numbers
) -> None:
    """Add dry friction and compliant stops, times a sign."""
    functions = {
        "sign": lambda x: expression.choose(x, 0.0, -1.0, expression.choose(0.0, x, 1.0, 0.0)),
        "step": lambda x: expression.choose(0.0, x, 1.0, 0.0),
        "max": expression.greatest,
        "abs": abs,
        "exp": partial(expression.call, "exp"),
    }
    for term in contact_terms(mechanism, parameters.dry, parameters.stops):
        formula, row = term.defined.value, Q[term.joint]
        assert isinstance(formula, Formula)
        value = formula.value(numbers, functions)
        row[0] = row[0] + value if sign * term.sign > 0 else row[0] - value


class _Numbers:
    """Values for sums of products of parameters: variables of a graph, or fractions."""

    def __init__(self, parameters: Parameters, numeric: bool, graph: Graph) -> None:
        self.parameters, self.numeric, self.graph = parameters, numeric, graph

    def __call__(self, item: Any) -> Any:
        """Return an entry of the scene with numbers in place of its sums."""
        if isinstance(item, Sum):
            return self._real(item)
        if isinstance(item, Law):
            return item if self.numeric else self._law(item)
        if isinstance(item, tuple):
            return item._make(map(self, item)) if hasattr(item, "_make") else tuple(map(self, item))
        if isinstance(item, Planar):
            return Planar(self(item.real), self(item.imag))
        return item

    def _law(self, law: Law) -> Law:
        """Return a law with variables of the graph for the scene's constants."""

        def leaf(x: Any) -> Any:
            return self.graph.variable(x) if isinstance(x, str) and x not in law.names else x

        return law._replace(node=changed(with_symbols(law.node), lambda node: node, leaf))

    def _real(self, sum_: Sum) -> Value:
        if self.numeric:
            sum_ = sum_.substituted(self.parameters.values)
        total: Value = 0
        for monomial, number in sum_.terms.items():
            term: Any = number
            for atom, power in monomial:
                name = atom.name
                if atom.role in (Role.angle, Role.rate):
                    name = f"{'q' if atom.role == Role.angle else 'qd'}{atom.place[0]}"
                for _ in range(power):
                    term = term * self.graph.variable(name)
            total = total + term
        return total
