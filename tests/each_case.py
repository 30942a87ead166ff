"""Many cases in one test: what starting a test costs is paid once, the case that fails is told."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Sequence
from typing import Any

from named_case import case


def each(names: str | Sequence[str], cases: Collection[Any]) -> Callable[[Callable], Callable]:
    """As `pytest.mark.parametrize`, but in one test: for cases that are quick and share fixtures.

    A failure tells its case in a note below it.  A case that skips would skip those after it.
    """
    known = [x.strip() for x in names.split(",")] if isinstance(names, str) else list(names)
    assert len(cases) > 0  # else there would be nothing that can fail

    def decorate(test: Callable) -> Callable:
        @functools.wraps(test)
        def run(*arguments: Any, **fixtures: Any) -> None:
            for values in cases:
                given = dict(zip(known, values if len(known) > 1 else [values], strict=True))
                with case(given):
                    test(*arguments, **fixtures, **given)

        own = inspect.signature(test)
        left = [x for name, x in own.parameters.items() if name not in known]
        run.__signature__ = own.replace(parameters=left)  # type: ignore[attr-defined]
        return run

    return decorate
