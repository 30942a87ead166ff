"""Reads what a scene says of friction at joints, and of where joints end."""

from __future__ import annotations

from functools import partialmethod
from typing import Any

from robodyn.scene.scene import DryFriction, Friction, Limits
from robodyn.scene.yaml_tree import Node
from robodyn.scene.yaml_values import ValueReader


class ContactReader(ValueReader):
    """The kinds `friction` and `limits` of the grammar, and those of joints that slide."""

    def _friction(self, kind: str, node: Node, place: str) -> Friction | DryFriction:
        faults = len(self.faults)
        values = list(self.form(kind, node, place).items())
        if len(values) == 2:
            return Friction(*(value for _, value in values))
        (name, moving), (_, static), (_, stribeck) = values
        if static < moving and len(self.faults) == faults:
            limit = f"must be at least the {name} in motion, {moving:g}"
            self.fault(f"{place}.static", node, limit, f"{static:g}")
        return DryFriction(moving, static, stribeck)

    def _limits(self, kind: str, node: Node, place: str) -> Limits:
        faults = len(self.faults)
        values: dict[str, Any] = self.form(kind, node, place)
        low, high = values.pop("min"), values.pop("max")
        if len(self.faults) > faults:
            pass  # it is told what is wrong
        elif low is None and high is None:
            self.fault(place, node, "needs a min, a max, or both")
        elif low is not None and high is not None and not low < high:
            self.fault(f"{place}.max", node, f"must be above min, {low:g}", f"{high:g}")
        return Limits(low, high, **values)

    friction = partialmethod(_friction, "friction")
    slide_friction = partialmethod(_friction, "slide_friction")
    limits = partialmethod(_limits, "limits")
    slide_limits = partialmethod(_limits, "slide_limits")
