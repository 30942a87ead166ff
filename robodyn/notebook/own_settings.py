"""Figures that leave a notebook's own settings of matplotlib as they are."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


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
