"""Settings of an integration: method, tolerances, and how loops are kept closed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from operator import index
from typing import Literal, get_args, overload

import numpy as np

from robodyn.errors import InputError
from robodyn.tables.arrays import Array

DEFAULT_DURATION = 10.0  # s, of a motion that no other is told of
DEFAULT_POINTS = 1001  # rows of one


class EvenTimes:
    """A sequence of `count` times 0, step, 2 step, ..., `end`; slices are arrays."""

    def __init__(self, step: float, count: int, end: float) -> None:
        self.step, self.count, self.end = step, count, end

    def __len__(self) -> int:
        return self.count

    @overload
    def __getitem__(self, k: int) -> float: ...
    @overload
    def __getitem__(self, k: slice) -> Array: ...
    def __getitem__(self, k: int | slice) -> float | Array:
        if isinstance(k, slice):
            begin, end, _ = k.indices(self.count)
            times = np.arange(begin, end, dtype=float) * self.step
            if end == self.count and len(times):
                times[-1] = self.end
            return times
        if not -self.count <= k < self.count:
            raise IndexError(k)
        k %= self.count
        return self.end if k == self.count - 1 else k * self.step


MAX_EVALUATIONS = 2_000_000
MOST = 2**62  # that are counted
BAUMGARTE = 20.0  # 1/s
# as they are told
NUMBERS = {
    "rtol": "rtol",
    "atol": "atol",
    "baumgarte": "baumgarte_rate",
    "max_step": "max_step",
    "max_evaluations": "max_evals",
}
Method = Literal["DOP853", "RK45", "Radau", "taylor"]
Stabilize = Literal["projection", "baumgarte", "none"]
METHODS: tuple[str, ...] = get_args(Method)
REMOVED = {"RK23": "RK45", "BDF": "Radau", "LSODA": "Radau"}  # what to take in place of each
ORDERS = (4, 60)  # of the Taylor series
CHOICES = {"method": METHODS, "stabilize": get_args(Stabilize)}
NO_ENGINE = "is no option any more: the method taylor is machine code, with the extra `fast`"
SCIPY_RTOL = 3e-14  # scipy's methods take nothing smaller


@dataclass(eq=False, repr=False)
class Settings:
    """Method, tolerances and limits of an integration."""

    method: str = "DOP853"
    rtol: float = 1e-9
    atol: float = 1e-9
    stabilize: str = "projection"
    baumgarte: float = BAUMGARTE
    max_evaluations: int = MAX_EVALUATIONS
    order: int | None = None  # of the Taylor series; None: by the tolerance
    max_step: float = np.inf  # s

    @property
    def smallest_rtol(self) -> float:
        """The smallest rtol that the method accepts."""
        return 1e-16 if self.method == "taylor" else SCIPY_RTOL

    def check(self) -> None:
        """Raise InputError for an invalid setting."""
        try:
            self._check()
        except TypeError:  # what is no number is not compared
            for name, argument in NUMBERS.items():
                if not isinstance(value := getattr(self, name), Real):
                    raise InputError(argument, value=value, limit="must be a number") from None
            raise

    def _check(self) -> None:
        for name, words in CHOICES.items():
            if (value := getattr(self, name)) not in words:
                limit = f"must be of {', '.join(words)}"
                if name == "method" and str(value) in REMOVED:
                    limit = f"was removed: take {REMOVED[str(value)]}"
                raise InputError(name, value=value, limit=limit)
        if not self.smallest_rtol <= self.rtol < 1.0:
            limit = f"must be in [{self.smallest_rtol:g}, 1)"
            raise InputError("rtol", value=self.rtol, limit=limit)
        for name, value in (("atol", self.atol), ("baumgarte_rate", self.baumgarte)):
            if not 0.0 < value < np.inf:
                raise InputError(name, value=value, limit="must be > 0 and finite")
        if not self.max_step > 0.0:
            raise InputError("max_step", value=self.max_step, limit="must be > 0")
        if self.order is not None and not hasattr(self.order, "__index__"):
            raise InputError("order", value=self.order, limit="must be a whole number")
        if self.order is not None and not ORDERS[0] <= self.order <= ORDERS[1]:
            limit = f"must be in [{ORDERS[0]}, {ORDERS[1]}]"
            raise InputError("order", value=self.order, limit=limit)
        taylor = self.method == "taylor"
        if not taylor and self.order is not None:
            raise InputError("order", limit="is for the method taylor alone")
        if taylor and self.stabilize == "baumgarte":
            limit = "the Taylor series goes with projection or none"
            raise InputError("stabilize", value=self.stabilize, limit=limit)
        if not self.max_evaluations >= 1:
            raise InputError("max_evals", value=self.max_evaluations, limit="must be >= 1")
        self.order = None if self.order is None else index(self.order)  # no number of numpy's
        self.max_evaluations = int(min(self.max_evaluations, MOST))  # of 1e6 and inf too


def check_run(settings: Settings, t_end: float, times: Array | EvenTimes | None) -> None:
    """Raise InputError if settings, end time or output times are invalid."""
    settings.check()
    if not math.isfinite(t_end):
        raise InputError("time", value=t_end, limit="must be finite")
    if abs(t_end) > settings.max_step * settings.max_evaluations:
        limit = f"{t_end:g} s would take more steps than max_evals, {settings.max_evaluations}"
        raise InputError("max_step", value=settings.max_step, limit=limit)
    if isinstance(times, np.ndarray):
        _check_times(times, t_end)


def _check_times(times: Array, t_end: float) -> None:
    if times.ndim != 1:
        raise InputError("t_eval", limit="must be a list of finite times")
    if not len(times):
        return
    direction = -1.0 if t_end < 0.0 else 1.0
    first, last = float(times[0]) * direction, float(times[-1]) * direction
    ordered = len(times) < 2 or (np.diff(times) * direction > 0.0).all()
    if ordered and first >= 0.0 and last <= t_end * direction:  # so all are finite
        return
    if not np.isfinite(times).all():
        raise InputError("t_eval", limit="must be a list of finite times")
    raise InputError("t_eval", limit=f"must go from 0 towards {t_end:g} and not beyond")
