"""Many small cases in one test: a failing one is named, and costs no fixtures of its own."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def case(*named: object) -> Iterator[None]:
    """Name the case in what its failure shows."""
    try:
        yield
    except BaseException as error:
        error.add_note(f"in the case {', '.join(map(repr, named))}")
        raise
