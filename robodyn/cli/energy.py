"""`robodyn energy`: kinetic and potential energy at given states."""

from __future__ import annotations

from robodyn.cli.options import Force, Model, load_with
from robodyn.cli.states import TableOptions, state_rows


def energy(
    model: Model,
    given: TableOptions = TableOptions(),
    force: Force = None,
) -> None:
    """Kinetic energy, potential energy and their sum.

    PE is zero where all masses are at the height of the origin.  Rows of STATES pass through.

    \b
    Examples:
      robodyn energy 2r --q 30deg,45deg --qd 1,0.5
      robodyn energy 2r motion.csv | cut -d, -f1,6-
      robodyn energy 2r motion.csv | robodyn summary
    """
    mechanism = load_with(model, force)

    state_rows(mechanism, given, given.quantities(), ["KE", "PE", "energy"])
