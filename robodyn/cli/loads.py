"""Forces at points by option, beside the loads that the scene has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from typer import Option

from robodyn.cli.options import Model
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene.quantities import parse_vector
from robodyn.scene.scene import Load
from robodyn.tables.csv_fields import shown

_FORCE = "A force, N, ground axes, at a point (coupler@0.5,0.2=10,-5), beside those of the scene; "
Force = Annotated[
    list[str] | None, Option("--force", metavar="POINT=FX,FY", help=_FORCE + "repeatable.")
]


def load_with(model: Model, forces: Sequence[str] | None) -> Mechanism:
    """The mechanism of a scene file as if its `loads` ended with these forces, POINT=FX,FY."""
    mechanism = model.load()
    if not forces:
        return mechanism
    from robodyn.kinematics.named_points import named_point

    loads = list(mechanism.description.loads)
    for text in forces:
        point, _, force = text.rpartition("=")
        if not point:
            limit = "must be POINT=FX,FY, such as coupler@0.5,0.2=10,-5 (N)"
            raise InputError("--force", value=shown(text), limit=limit)
        where = f"--force {shown(point)}"
        values = parse_vector(force, where=where, unit="N")
        if len(values) != 2:
            raise InputError(where, value=shown(force), limit="must be FX,FY (N, ground axes)")
        loads.append(Load(named_point(mechanism, point, "--force").own, complex(*values)))
    return build(mechanism.description._replace(loads=tuple(loads)))
