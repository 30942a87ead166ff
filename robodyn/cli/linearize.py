"""`robodyn linearize`: the linear model of small motions, its modes, and a gain."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import numpy as np

from robodyn.cli.equilibrium import WORDS, joint_torques, tell_what_is_left_out
from robodyn.cli.files import output_file
from robodyn.cli.options import (
    HoldingTau,
    Model,
    Out,
    OutputStructured,
    Text,
    option,
    refuse,
    switch,
)
from robodyn.cli.output import Grid, in_told_units, note, write_structure
from robodyn.cli.states import StateOptions, remarks, single_state
from robodyn.dynamics.columns import scene_units
from robodyn.errors import named_options
from robodyn.mechanics.mechanism import Mechanism
from robodyn.rest.linear_model import LinearModel
from robodyn.rest.linear_model import linearize as linear_model
from robodyn.rest.linear_model import lqr as gain_of
from robodyn.scene.quantities import parse_vector
from robodyn.tables.output_file import open_output

_X = "Weights of coordinates and rates: one, one each, or a matrix row by row. Default: 1."
_U = "Weights of the actuated joints' torques, likewise. Default: 1."
_GAIN_OUT = "Write the gain here for simulate --gain, all or nothing."
GAIN_KEYS = ("coordinates", "q", "tau", "gain")


def linearize(
    model: Model,
    state: StateOptions = StateOptions(),
    tau: HoldingTau = None,
    lqr: bool = switch("The gain of least cost (LQR) too."),
    weights_x: Text = option(_X, "VECTOR"),
    weights_u: Text = option(_U, "VECTOR"),
    gain_out: Annotated[Text, output_file("--gain-out", help=_GAIN_OUT)] = None,
    format: OutputStructured = None,
    out: Out = None,
) -> None:
    """How it moves near a state: A, B, natural frequencies, damping, mode shapes.

    (z, z')' = A (z, z') + B dtau for small changes of minimal coordinates z, the joints that are
    named in `coordinates`: actuated ones where they tell all others. Without --tau the torque that
    holds it there is taken. JSON keys: coordinates, q, qd, tau (of the actuated joints), N
    (joints' rates for each coordinate at 1), A, B, modes, stable, controllable, with --lqr gain.

    Each of `modes` is a pair of conjugate eigenvalues, or one real one: eigenvalue (its real and
    imaginary part, 1/s), frequency |s|/2pi (Hz), damping -Re(s)/|s|, shape (of the coordinates, the
    largest at 1), and lag, the imaginary part of shape. Away from equilibrium they are null, as
    stable and controllable are; stable is also null where an eigenvalue is zero and none grows.

    --lqr makes the least of the integral of x^T X x + u^T U u by tau = tau0 - gain (dz, z').

    \b
    Examples:
      robodyn linearize 2r --q -90deg,0 --format table
      robodyn linearize cart-pole --q 0,90deg --lqr --weights-x 1,10,1,1
    """
    mechanism = model.load()
    weigh = {"--weights-x": weights_x, "--weights-u": weights_u}
    if not lqr:
        without = "there is no gain without --lqr"
        refuse(without, weights_x=weights_x, weights_u=weights_u, gain_out=gain_out)
    weights = [parse_vector("1" if x is None else x, where=flag) for flag, x in weigh.items()]
    pose, rates = single_state(mechanism, state.quantities(), t=0.0)
    torques = None if tau is None else joint_torques(mechanism, tau)
    tell_what_is_left_out(mechanism)
    with remarks(), named_options(["weights_x", "weights_u"]):
        found = linear_model(mechanism, pose, rates, torques)
        content = _content(mechanism, found)
        if lqr:  # before the notes: weights may be wrong
            content["gain"] = gain_of(found, *weights).tolist()
        held = ", ".join(f"tau{k + 1} = {found.tau[k]:.9g}" for k in mechanism.actuated)
        if tau is None and held:
            far = " as far as it can" if found.remark else ""
            least = "least " if len(mechanism.actuated) > len(found.coordinates) else ""
            note(f"Note: with the {least}torque that holds it{far}, {held}")
        if found.remark:
            note(f"Note: {found.remark}")
    if gain_out is not None:
        kept = {key: content[key] for key in GAIN_KEYS}
        with open_output(gain_out) as file:
            file.write((json.dumps(kept) + "\n").encode())
    told = in_told_units(content, scene_units(mechanism))
    write_structure(format, out, told, lambda: list(_tables(mechanism, found, content)))


def _content(mechanism: Mechanism, found: LinearModel) -> dict[str, Any]:
    content: dict[str, Any] = found._asdict()
    del content["remark"]
    content["tau"] = found.tau[list(mechanism.actuated)]
    if found.modes is not None:
        content["modes"] = [
            {
                "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
                "frequency": mode.frequency,
                "damping": mode.damping,
                "shape": mode.shape.real.tolist(),
                "lag": mode.shape.imag.tolist(),
            }
            for mode in found.modes
        ]
    return {key: x.tolist() if isinstance(x, np.ndarray) else x for key, x in content.items()}


def _tables(mechanism: Mechanism, found: LinearModel, content: Mapping[str, Any]) -> Iterator[Grid]:
    states = [*found.coordinates, *(name.replace("q", "qd") for name in found.coordinates)]
    inputs = [f"tau{k + 1}" for k in mechanism.actuated]
    for name, columns in (("A", states), ("B", inputs)):
        rows = [[f"{state}'", *row] for state, row in zip(states, content[name], strict=True)]
        yield Grid(["", *columns], rows, name)
    if found.modes is not None:
        columns = ["mode", "eigenvalue [1/s]", "frequency [Hz]", "damping", *found.coordinates]
        rows = [
            [str(k), *map(_text, [mode.eigenvalue, mode.frequency, mode.damping, *mode.shape])]
            for k, mode in enumerate(found.modes, start=1)
        ]
        yield Grid(columns, rows, "modes")
        words = [WORDS[found.stable], "yes" if found.controllable else "no"]
        yield Grid(["stable", "controllable"], [words])
    if "gain" in content:
        rows = [[name, *row] for name, row in zip(inputs, content["gain"], strict=True)]
        yield Grid(["", *states], rows, "gain")


def _text(value: complex) -> str:
    value = complex(value)
    return f"{value:.6g}" if value.imag else f"{value.real:.6g}"
