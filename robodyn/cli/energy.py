"""`robodyn energy`: kinetic and potential energy at given states."""

from __future__ import annotations

import numpy as np

from robodyn.cli.options import Force, Model, load_with
from robodyn.cli.states import TableOptions, evaluate
from robodyn.dynamics.closed_form import kinetic_energy, potential_energy


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
      robodyn energy 2r motion.csv --extremes
    """
    mechanism = load_with(model, force)

    def compute(q: np.ndarray, qd: np.ndarray, **_: np.ndarray) -> np.ndarray:
        KE, PE = kinetic_energy(mechanism, q, qd), potential_energy(mechanism, q)
        return np.stack([KE, PE, KE + PE], axis=-1)

    evaluate(mechanism, given, given.quantities(), ["KE", "PE", "energy"], compute)
