"""`robodyn bench`: speed against error."""

from __future__ import annotations

from itertools import chain
from typing import Annotated

import numpy as np

from robodyn.cli.figures import check_directory, check_plot
from robodyn.cli.files import output_file
from robodyn.cli.options import Model, Text, option, switch
from robodyn.cli.output import RowOptions, note
from robodyn.cli.progress import progress
from robodyn.cli.states import StateOptions, remarks, single_state
from robodyn.dynamics.evaluators import COLUMNS as names
from robodyn.dynamics.evaluators import measure_evaluators
from robodyn.errors import InputError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.pictures.chart_figure import work_precision
from robodyn.runs.benchmark import benchmark

MOST_REPEATS = 10_000
COLUMNS = (
    *("method", "tolerance", "error", "error_end", "drift", "gap"),
    *("evals", "steps", "median_ms", "least_ms", "front"),
)
_PLOT = "Draw the work-precision diagram (png, svg, pdf; the extra `plot`)."


def bench(
    model: Model,
    state: StateOptions = StateOptions(),
    duration: float = option("End time, s.", "S", default=10.0, flag="--time"),
    tau: Text = option("As in simulate.", "TORQUES"),
    repeats: int = option("Timed runs of each, taken in turn.", "N", default=3),
    evaluators: bool = switch("Measure dynamics of single states and batches instead."),
    plot: Annotated[Text, output_file("--plot", help=_PLOT)] = None,
    rows: RowOptions = RowOptions(),
) -> None:
    """Speed against error of every method on one motion.

    Each method runs at tolerances 1e-3 to 1e-13.  Errors are the largest of q and qd over 20 times
    (and at the end), against two Taylor series in extended precision, which torques must have.
    `front` marks the runs that none is both faster and better than.

    \b
    Examples:
      robodyn bench 2r --q=-1.3,-0.2 --qd 0.5,0.25
      robodyn bench four-bar --q 60deg --qd 5 --plot four-bar.png > bench.csv
      robodyn bench 2r --evaluators
    """
    mechanism = model.load()
    if not 1 <= repeats <= MOST_REPEATS:
        raise InputError("--repeats", value=repeats, limit=f"must be >= 1 and <= {MOST_REPEATS}")
    if evaluators and plot is not None:
        raise InputError("--evaluators and --plot", limit="exclude each other")
    if not (np.isfinite(duration) and duration > 0.0):
        raise InputError("--time", value=duration, limit="must be > 0 and finite")
    if plot is not None:
        check_plot(plot)
    if rows.out is not None:
        check_directory(rows.out)
    if evaluators:
        measured = measure_evaluators(mechanism)
        first = next(measured)  # what cannot be measured writes no header
        with rows.writer(names) as writer:
            for row in chain([first], measured):
                writer.write_row(row)
        return
    mechanism.check_masses()
    torques = Actuation((0.0,) * mechanism.n)
    if tau is not None:
        torques = actuation.expressions(mechanism, tau, "--tau")
    begin = np.concatenate(single_state(mechanism, state.quantities(), t=0.0))
    with remarks(), progress("measuring", silent=0.0) as watch:
        result = benchmark(mechanism, begin, duration, torques, repeats=repeats, watch=watch)
    with rows.writer(COLUMNS) as writer:
        for x in result.measurements:
            values: list[float | str] = [x.method, x.tolerance, x.error, x.error_end]
            values += [x.drift, x.gap, float(x.evaluations), float(x.steps)]
            values += [1e3 * x.median, 1e3 * x.least]
            if x.outcome != "finished":
                values[2:4], values[8:10] = [x.outcome, ""], ["", ""]
            writer.write_row([*values, "*" if x.front else ""])
    for line in result.left_out:
        note(f"left out: {line}")
    note(f"uncertainty of the reference: {result.reference.uncertainty:.2g}; no error below it")
    if plot is not None:
        title = f"{mechanism.name}, {duration:g} s"
        work_precision(result, title, plot, slides=bool(mechanism.slides))
