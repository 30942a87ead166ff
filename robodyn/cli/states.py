"""States from the command line: vectors in options, or rows of a CSV, completed and checked.

For a closed mechanism a vector holds all joints (checked: the loops must be closed) or the
actuated ones only (the rest is assembled).  An option stands for its columns in every row.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, BinaryIO

from robodyn.cli.options import Format
from robodyn.cli.output import note, numbers_overflow_in_silence, row_writer
from robodyn.errors import InputError, RobodynError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.quantities import parse_vector
from robodyn.tables.csv_fields import shown

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Quantity:
    """One vector of a state: its name, its option's value, and whether it may be left out."""

    name: str  # q, qd, qdd or tau
    option: str | None
    required: bool = False

    def columns(self, joints: Sequence[int]) -> list[str]:
        return [f"{self.name}{k + 1}" for k in joints]


@dataclass(frozen=True, slots=True)
class Source:
    """Where a quantity comes from: an option's values, or columns; for all joints or actuated."""

    quantity: Quantity
    values: list[float] | None  # from the option
    columns: list[str]  # from the table; both empty: zero
    whole: bool  # all joints, or the actuated ones


def loop_columns(mechanism: Mechanism) -> list[str]:
    """The columns of `dynamics.loop_forces`: pin forces of closures, torques of couplings."""
    described = mechanism.description
    pins = [f"f{axis}{c + 1}" for c in range(len(described.closures)) for axis in "xy"]
    return [*pins, *(f"tc{c + 1}" for c in range(len(described.couplings)))]


def option_source(mechanism: Mechanism, quantity: Quantity) -> Source:
    """The source that the quantity's option is; zero where there is none."""
    if quantity.option is None:
        if quantity.required:
            limit = "missing: give it, or a CSV of states (- for stdin)"
            raise InputError(f"--{quantity.name}", limit=limit)
        return Source(quantity, None, [], False)
    values = parse_vector(
        quantity.option, where=f"--{quantity.name}", angles=quantity.name != "tau"
    )
    n, actuated = mechanism.n, len(mechanism.actuated)
    if len(values) not in (n, actuated):
        wanted = f"{n} values, one a joint ({', '.join(mechanism.link_names)})"
        if actuated != n:
            names = ", ".join(mechanism.link_names[k] for k in mechanism.actuated)
            wanted += f", or {actuated}, one an actuated joint ({names})"
        count = "1 value" if len(values) == 1 else f"{len(values)} values"
        raise InputError(
            f"--{quantity.name}",
            value=f"{shown(quantity.option)} ({count})",
            limit=f"needs {wanted}",
        )
    return Source(quantity, values, [], len(values) == n)


def table_source(
    mechanism: Mechanism, quantity: Quantity, header: Sequence[str], source: str
) -> Source:
    """The source in a table with this header, or in the option, which goes first."""
    everything, there = quantity.columns(range(mechanism.n)), set(header)
    if quantity.option is not None:
        taken = [name for name in everything if name in there]
        if taken:
            limit = f"{source} has the column {taken[0]}; leave one of them out"
            raise InputError(f"--{quantity.name}", value=quantity.option, limit=limit)
        return option_source(mechanism, quantity)
    driven = quantity.columns(mechanism.actuated)
    if set(everything) <= there:
        return Source(quantity, None, everything, True)
    present = [name for name in everything if name in there]
    if driven and set(driven) == set(present):
        return Source(quantity, None, driven, False)
    if not quantity.required and not present:
        return Source(quantity, None, [], False)
    missing = [name for name in everything if name not in there]
    either = "" if everything == driven else f", or only the actuated joints' {', '.join(driven)}"
    raise InputError(
        f"column {missing[0]} is missing",
        where=source,
        limit=f"needs {', '.join(everything)}{either}; the header has {', '.join(header)}",
    )


def complete(
    mechanism: Mechanism,
    sources: Sequence[Source],
    values: Sequence[Array],
    branches: Sequence[str] | None = None,
) -> list[Array]:
    """q, qd and what else there is for all joints (..., n): assembled, or checked to be closed."""
    import numpy as np

    with np.errstate(all="ignore"):
        full = _completed(mechanism, sources, values, branches)
    if not all(np.isfinite(vector).all() for vector in full):
        raise overflow()
    return full


def _completed(
    mechanism: Mechanism,
    sources: Sequence[Source],
    values: Sequence[Array],
    branches: Sequence[str] | None,
) -> list[Array]:
    import numpy as np

    from robodyn.loops import assembly, loop_rates

    full: list[Array] = []
    for source, given in zip(sources, values, strict=True):
        if not all(np.isfinite(vector).all() for vector in full):
            raise overflow()
        name = source.quantity.name
        if source.whole:
            full.append(given)
        elif name == "q":
            full.append(assembly.assemble(mechanism, given, branches))
        elif name == "qd":
            full.append(loop_rates.loop_velocities(mechanism, full[0], given))
        elif name == "qdd":
            full.append(loop_rates.loop_accelerations(mechanism, full[0], full[1], given))
        else:
            tau = np.zeros((*given.shape[:-1], mechanism.n))
            tau[..., list(mechanism.actuated)] = given
            full.append(tau)
    if mechanism.rows and any(source.whole for source in sources):
        motion = {s.quantity.name: x for s, x in zip(sources, full, strict=True)}
        fault = loop_rates.check_closed(mechanism, motion["q"], motion.get("qd"), motion.get("qdd"))
        if fault is not None:
            raise fault[1]
    return full


def single_state(mechanism: Mechanism, quantities: Sequence[Quantity]) -> list[Array]:
    """The one state that the options give, completed and checked: each vector (n,)."""
    sources = [option_source(mechanism, quantity) for quantity in quantities]
    return complete_from(mechanism, sources)


def complete_from(
    mechanism: Mechanism, sources: Sequence[Source], branches: Sequence[str] | None = None
) -> list[Array]:
    """The one state of sources that are options, completed and checked: each vector (n,)."""
    import numpy as np

    given = [np.array(_values(mechanism, source)) for source in sources]
    return complete(mechanism, sources, given, branches)


def assembled_state(
    mechanism: Mechanism, quantities: Sequence[Quantity]
) -> tuple[list[Array], tuple[float, float]]:
    """q and qd of the options brought to the nearest closed state, and how far each had to go.

    Raises AssemblyError where the loops do not close near the given angles.
    """
    import numpy as np

    from robodyn.errors import AssemblyError
    from robodyn.loops import assembly, loop_rates

    sources = [option_source(mechanism, quantity) for quantity in quantities]
    if not sources[0].whole or not mechanism.rows:
        return complete_from(mechanism, sources), (0.0, 0.0)
    given = np.array(sources[0].values)
    q = assembly.close_positions(mechanism, given)
    fault = loop_rates.check_closed(mechanism, q)
    if fault is not None:
        raise AssemblyError(f"no closed configuration found near the start: {fault[1].what}")
    if sources[1].whole:
        rates = np.array(sources[1].values)
        qd = loop_rates.nearest_velocities(mechanism, q, rates)
    else:
        rates = qd = complete_from(mechanism, [replace(sources[0], values=q.tolist()), sources[1]])[
            1
        ]
    moved = float(np.abs(q - given).max()), float(np.abs(qd - rates).max())
    return [q, qd], moved


def evaluate(
    mechanism: Mechanism,
    states: str | None,
    quantities: Sequence[Quantity] | Callable[[Sequence[str]], Sequence[Quantity]],
    columns: Sequence[str],
    compute: Callable[[list[Array]], Array],
    format: Format | None,
    out: str | None,
) -> None:
    """Compute `columns` (T, k) at the state of the options, or at each row of the CSV `states`.

    `quantities` may depend on the CSV's header, which is empty where there are options only.
    """
    import numpy as np

    if states is None:
        with remarks():
            wanted = quantities([]) if callable(quantities) else quantities
            state = single_state(mechanism, wanted)
            row = _finite(compute, [vector[None, :] for vector in state])[0].tolist()
        with row_writer(format, out, columns) as writer:
            writer.write_row(row)
        return

    from robodyn.tables.table import Reader

    with open_input(states) as (stream, name):
        reader = Reader(stream, name)
        wanted = quantities(reader.header) if callable(quantities) else quantities
        sources = [table_source(mechanism, x, reader.header, name) for x in wanted]
        chunks = reader.chunks([column for source in sources for column in source.columns])

        def results(values: Array) -> Array:
            given, begin = [], 0
            for source in sources:
                if source.columns:
                    end = begin + len(source.columns)
                    given.append(values[:, begin:end])
                    begin = end
                else:
                    row = _values(mechanism, source)
                    given.append(np.broadcast_to(np.array(row), (len(values), len(row))))
            return _finite(compute, complete(mechanism, sources, given))

        with remarks(), row_writer(format, out, columns, reader.header) as writer:
            for chunk in chunks:
                try:
                    writer.write_rows(chunk.lines, results(chunk.values))
                except RobodynError:
                    # find the row, with those before it written: again, one by one
                    for k, line in enumerate(chunk.lines):
                        try:
                            row = results(chunk.values[k : k + 1])
                        except RobodynError as error:
                            error.add_place(f"{name}: line {chunk.line_numbers[k]}")
                            raise
                        writer.write_rows([line], row)


def _values(mechanism: Mechanism, source: Source) -> list[float]:
    if source.values is not None:
        return source.values
    return [0.0] * (mechanism.n if source.whole else len(mechanism.actuated))


@contextmanager
def open_input(states: str) -> Iterator[tuple[BinaryIO, str]]:
    """The binary stream and the name of a CSV file, `-` for stdin."""
    if states == "-":
        if sys.stdin is None:
            raise InputError("is closed", where="stdin")
        if sys.stdin.isatty():
            note("reading CSV rows from the keyboard; end with Ctrl-D")
        yield sys.stdin.buffer, "stdin"
        return
    try:
        stream = open(states, "rb")  # noqa: SIM115 (closed by the with below)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("cannot be read", where=states, limit=reason.lower()) from None
    with stream:
        yield stream, states


def _finite(compute: Callable[[list[Array]], Array], states: list[Array]) -> Array:
    """What `compute` gives, or a RobodynError where numbers left the range of floats."""
    import numpy as np

    with np.errstate(all="ignore"):
        values = compute(states)
    if not np.isfinite(values).all():
        raise overflow()
    return values


def overflow() -> RobodynError:
    """The error for a result that is not finite."""
    return RobodynError("the result is not finite", limit="the state or the scene is too large")


@contextmanager
def remarks() -> Iterator[None]:
    """Warnings of the numerics as notes on stderr, each once."""
    seen: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if str(message) not in seen:
            seen.add(str(message))
            note(f"Warning: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        numbers_overflow_in_silence()
        warnings.simplefilter("ignore", ResourceWarning)  # of an import that a signal broke off
        warnings.showwarning = show
        yield
