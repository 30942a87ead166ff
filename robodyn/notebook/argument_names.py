"""Errors that name options of commands, told of the arguments of functions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from robodyn.errors import RobodynError


@contextmanager
def named_as_arguments() -> Iterator[None]:
    """`--max-steps` is max_steps where a function is called."""
    try:
        yield
    except RobodynError as error:
        if error.what.startswith("--"):
            error.what = error.what[2:].replace("-", "_")
        raise
