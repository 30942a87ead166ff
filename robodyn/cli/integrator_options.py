"""The options of `simulate` that say how to integrate."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Optional

import typer

from robodyn.errors import InputError
from robodyn.simulation.simulation import Engine, Method, Stabilize

NAMES = (  # what the numerics call --rtol, --max-evals, --control-rate, ...
    *("method", "rtol", "atol", "stabilize", "baumgarte_rate", "max_evals", "order", "engine"),
    *("max_step", "accuracy", "control", "control_rate", "control_model", "kp", "kd", "tau_max"),
)

Integrator = Annotated[
    Optional[Method],  # noqa: UP045 (typer reads the annotation at run time)
    typer.Option("--method", help="Integrator. Default: DOP853; with --accuracy the best."),
]
Rtol = Annotated[
    Optional[float],  # noqa: UP045
    typer.Option("--rtol", help="Relative tolerance of a step. Default: 1e-9."),
]
Atol = Annotated[
    Optional[float],  # noqa: UP045
    typer.Option("--atol", help="Absolute tolerance, rad, rad/s. Default: 1e-9."),
]
MaxStep = Annotated[
    float,
    typer.Option(
        "--max-step", metavar="S", help="No step is longer, s. Default: none.", show_default=False
    ),
]
Accuracy = Annotated[
    Optional[float],  # noqa: UP045
    typer.Option(
        "--accuracy",
        metavar="RAD",
        help="Largest error of q and qd over the whole run; chooses method and tolerance.",
    ),
]
EstimateError = Annotated[
    bool,
    typer.Option("--estimate-error", help="Run again, 100 times as tight: the error's size."),
]
Order = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--order", metavar="N", help="Order of the Taylor series. Default: by the tolerance."
    ),
]
SeriesEngine = Annotated[
    Engine,
    typer.Option("--engine", help="Of the Taylor series; auto compiles runs of over a second."),
]
Stabilizer = Annotated[Stabilize, typer.Option("--stabilize", help="What keeps loops closed.")]
BaumgarteRate = Annotated[
    float, typer.Option("--baumgarte-rate", metavar="1/S", help="Decay rate of a gap.")
]
MaxEvals = Annotated[
    int, typer.Option("--max-evals", metavar="N", help="Give up after so many evaluations.")
]


@contextmanager
def named_options() -> Iterator[None]:
    """An argument of the numerics that is refused is named as its option."""
    try:
        yield
    except InputError as error:
        if error.what in NAMES:
            error.what = "--" + error.what.replace("_", "-")
        raise
