"""The shaking force and moment of a turn by order, in place of its rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn.dynamics.harmonics import harmonics
from robodyn.errors import InputError
from robodyn.tables.summaries import SummaryWriter

FLAG = "--harmonics"
SHAKE = ("shake_fx", "shake_fy", "shake_m")
MOST = 10_000  # orders


class HarmonicsWriter(SummaryWriter):
    """Takes the angle of the driven joint and the columns of `SHAKE`, and tells their orders."""

    def __init__(self, *given: Any, most: int) -> None:
        super().__init__(*given)
        self._most, self._rows = most, list[np.ndarray]()

    def write_columns(self, values: np.ndarray) -> None:
        self._rows.append(values[:, self._places])

    def tell(self) -> tuple[Sequence[str], list[list[float | str | None]]]:
        rows = np.concatenate(self._rows)
        try:
            amplitudes, phases = harmonics(rows[:, 0], rows[:, 1:], self._most)
        except InputError as error:
            if error.what == "orders":
                error.what = FLAG
            else:
                error.add_place(FLAG)
            raise
        columns = ["order", *(f"{name}_{what}" for name in SHAKE for what in ("amp", "phase"))]
        each = np.stack([amplitudes, phases], axis=-1).reshape(len(amplitudes), -1)
        return columns, [[str(k), *row] for k, row in enumerate(each.tolist())]


def check(most: int) -> None:
    """Raise InputError where no orders up to `most` can be told."""
    if not 0 <= most <= MOST:
        raise InputError(FLAG, value=most, limit=f"must be in [0, {MOST}]")
