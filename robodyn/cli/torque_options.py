"""The options of `simulate` that say where torque comes from: --tau, --tau-from, --control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, Optional

import numpy as np
import typer

from robodyn.cli.files import input_file
from robodyn.cli.integrator_options import named_options
from robodyn.cli.states import open_input
from robodyn.errors import InputError
from robodyn.mechanics import actuation
from robodyn.mechanics.actuation import Actuation
from robodyn.mechanics.mechanism import Mechanism, load
from robodyn.scene.quantities import parse_number, parse_vector
from robodyn.tables.csv_fields import shown
from robodyn.tables.table import Reader

if TYPE_CHECKING:
    from robodyn.control.tracking import ReferenceTable

DEFAULT_DURATION = 10.0  # s
Law = Literal["pd", "pd+g", "computed-torque"]  # what makes torque of the tracking error


def _text(flag: str, metavar: str, text: str) -> object:
    return typer.Option(flag, metavar=metavar, help=text, show_default=False)


Tau = Annotated[
    Optional[str],  # noqa: UP045 (typer reads the annotation at run time)
    _text(
        "--tau",
        "TORQUES",
        "Torques of the actuated joints, N m: numbers, or expressions in t, q1.., qd1..",
    ),
]
TauFrom = Annotated[
    Optional[str],  # noqa: UP045
    input_file("--tau-from", "CSV with t,tau1,.. (- for stdin), interpolated between its rows."),
]
Control = Annotated[
    Optional[Law],  # noqa: UP045
    typer.Option("--control", help="Makes the torques track a reference.", show_default=False),
]
Track = Annotated[
    Optional[str],  # noqa: UP045
    input_file(
        "--track", "The reference: CSV with t,q1,.. and perhaps qd1,.., qdd1,.. (- for stdin)."
    ),
]
_EACH = "one value, or one an actuated joint"
Kp = Annotated[
    Optional[str],  # noqa: UP045
    _text("--kp", "VECTOR", f"Gain of the error, N m/rad (computed torque 1/s^2): {_EACH}."),
]
Kd = Annotated[
    Optional[str],  # noqa: UP045
    _text("--kd", "VECTOR", f"Gain of its rate, N m s/rad (computed torque 1/s): {_EACH}."),
]
TauMax = Annotated[
    Optional[str],  # noqa: UP045
    _text("--tau-max", "VECTOR", f"Where the controller's torques are cut off, N m: {_EACH}."),
]
ControlModel = Annotated[
    Optional[str],  # noqa: UP045
    input_file("--control-model", "Scene that the controller believes. Default: MODEL."),
]
ControlRate = Annotated[
    Optional[str],  # noqa: UP045
    _text("--control-rate", "HZ", "Samples a second, each torque held. Default: continuous."),
]


@dataclass(frozen=True, slots=True)
class TorqueOptions:
    """What was given."""

    tau: str | None
    tau_from: str | None
    control: Law | None
    track: str | None
    kp: str | None
    kd: str | None
    tau_max: str | None
    control_model: str | None
    control_rate: str | None

    def given(self, *names: str) -> list[str]:
        """The options among these that are given."""
        found = [name for name in names if getattr(self, name) is not None]
        return ["--" + name.replace("_", "-") for name in found]


def torque_source(
    mechanism: Mechanism, options: TorqueOptions, duration: float | None
) -> tuple[Actuation, float]:
    """The torques, and the end time: that of the reference where none is given."""
    sources = options.given("tau", "tau_from", "control")
    if len(sources) > 1:
        raise InputError(" and ".join(sources), limit="exclude each other")
    if options.control is not None:
        return _controlled(mechanism, options, duration)
    for option in options.given("track", "kp", "kd", "tau_max", "control_model", "control_rate"):
        raise InputError(option, limit="needs --control: pd, pd+g or computed-torque")
    end = DEFAULT_DURATION if duration is None else duration
    if options.tau is not None:
        return actuation.expressions(mechanism, options.tau, "--tau"), end
    if options.tau_from is None:
        return Actuation((0.0,) * mechanism.n), end
    names = ["t", *(f"tau{k + 1}" for k in mechanism.actuated)]
    values, name = _read(options.tau_from, lambda *_: names)
    times, torques = values[:, 0].tolist(), values[:, 1:].tolist()
    return actuation.table(mechanism, times, torques, where=name, until=end), end


def _controlled(
    mechanism: Mechanism, options: TorqueOptions, duration: float | None
) -> tuple[Actuation, float]:
    from robodyn.control.laws import controller

    law = options.control
    assert law is not None
    for name in ("track", "kp", "kd"):
        if not options.given(name):
            raise InputError(f"--{name}", limit=f"missing: --control {law} needs it")
    believed = None if options.control_model is None else load(options.control_model)
    gains = {
        name: parse_vector(text, where="--" + name.replace("_", "-"), angles=False)
        for name in ("kp", "kd", "tau_max")
        if (text := getattr(options, name)) is not None
    }
    rate = None if options.control_rate is None else _frequency(options.control_rate)
    reference = _reference(mechanism, options.track or "")
    with named_options():
        torques = controller(
            mechanism, reference, law, control_rate=rate, control_model=believed, **gains
        )
    return torques, reference.times[-1] if duration is None else duration


def _frequency(text: str) -> float:
    try:
        return parse_number(text.removesuffix("Hz"))
    except ValueError as error:
        limit = f"{error}; write 100 or 100Hz"
        raise InputError("--control-rate", value=shown(text), limit=limit) from None


def _reference(mechanism: Mechanism, file: str) -> ReferenceTable:
    from robodyn.control.tracking import ReferenceTable

    if not mechanism.actuated:
        raise InputError("--control", where=mechanism.source, limit="no joint is actuated")
    joints = len(mechanism.actuated)

    def columns(header: Sequence[str], where: str) -> list[str]:
        found = ["t"]
        for name in ("q", "qd", "qdd"):
            wanted = [f"{name}{k + 1}" for k in mechanism.actuated]
            if name == "q" or set(wanted) & set(header):
                found += wanted
            elif name == "qd" and any(f"qdd{k + 1}" in header for k in mechanism.actuated):
                limit = f"qdd{mechanism.actuated[0] + 1} needs it beside itself"
                raise InputError(f"column {wanted[0]} is missing", where=where, limit=limit)
        return found

    values, name = _read(file, columns)
    q, qd, qdd = (
        values[:, k : k + joints] if k < values.shape[1] else None
        for k in range(1, 3 * joints + 1, joints)
    )
    assert q is not None
    return ReferenceTable(values[:, 0], q, qd, qdd, where=name)


def _read(
    file: str, columns: Callable[[Sequence[str], str], Sequence[str]]
) -> tuple[np.ndarray, str]:
    """Columns of a CSV file (rows, columns), chosen by its header and name; and its name."""
    with open_input(file) as (stream, name):
        reader = Reader(stream, name)
        names = columns(reader.header, name)
        blocks = [chunk.values for chunk in reader.chunks(names)]
    return np.concatenate(blocks) if blocks else np.zeros((0, len(names))), name
