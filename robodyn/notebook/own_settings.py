"""Figures that leave a notebook's own settings as they are, and errors that name arguments."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from robodyn.errors import RobodynError


@contextmanager
def own_settings() -> Iterator[None]:
    """Within it figures have robodyn's settings, after it all are what they were.

    Raises RobodynError where matplotlib (the extra `plot`) is not there.
    """
    from robodyn.pictures.chart_figure import check_matplotlib

    check_matplotlib("a figure")
    from matplotlib import rc_context

    logger, backend = logging.getLogger("matplotlib"), os.environ.get("MPLBACKEND")
    level = logger.level
    with rc_context(), warnings.catch_warnings():
        try:
            yield
        finally:
            logger.setLevel(level)
            if backend is None:
                os.environ.pop("MPLBACKEND", None)
            else:
                os.environ["MPLBACKEND"] = backend


@contextmanager
def named_as_arguments() -> Iterator[None]:
    """`--max-steps` is max_steps where a function is called."""
    try:
        yield
    except RobodynError as error:
        if error.what.startswith("--"):
            error.what = error.what[2:].replace("-", "_")
        raise
