"""What matters most among quantities that vary: Spearman's rank correlations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn.tables.arrays import Array


def correlations(
    header: Sequence[str], varied: int, parts: Sequence[Array]
) -> dict[str, list[float | None]]:
    """Of each column after the first `varied` ones its rank correlations with each of these.

    It is 1 where the one never falls as the other grows, -1 where it never grows, and None where
    one of them is constant.  Rows (T, columns) in which the column has no value do not count.
    """
    columns = np.concatenate([np.zeros((0, len(header))), *parts]).T
    found = {}
    for name, y in zip(header[varied:], columns[varied:], strict=True):
        there = ~np.isnan(y)
        found[name] = [_spearman(x[there], y[there]) for x in columns[:varied]]
    return found


def _spearman(x: Array, y: Array) -> float | None:
    """The correlation of the ranks of two columns, equal values sharing theirs."""
    from scipy.stats import rankdata

    if not len(x):
        return None
    a, b = (ranks - ranks.mean() for ranks in (rankdata(x), rankdata(y)))
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size else None
