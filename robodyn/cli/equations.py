"""`robodyn equations`: the equations of motion of a scene, in symbols."""

from __future__ import annotations

import shutil
import sys
from functools import partial
from typing import Literal

from robodyn.cli.options import Model, Out, option, switch
from robodyn.cli.output import note
from robodyn.cli.progress import progress
from robodyn.elements.contacts import STICKS
from robodyn.equations.code import c99, python
from robodyn.equations.derivation import Derivation, check_size
from robodyn.equations.derivation_latex import derivation_latex
from robodyn.equations.derivation_text import derivation_json, derivation_text
from robodyn.equations.latex import latex
from robodyn.equations.recorded import recorded
from robodyn.equations.text import WIDTH, as_json, text
from robodyn.equations.written import equations as equations_of
from robodyn.errors import InputError
from robodyn.tables.output_file import write_text

EquationFormat = Literal["text", "latex", "python", "c", "json"]  # how equations are written
READABLE = {"latex": latex, "json": as_json}
DERIVED = {"latex": derivation_latex, "json": derivation_json}
DERIVING = 0.8  # of the time that a long text takes, about
CODE = {"python": python, "c": c99}


def equations(
    model: Model,
    format: EquationFormat = option(
        "To read, to typeset, to run, or for a program.", default="text"
    ),
    numeric: bool = switch("Put the scene's numbers in for the symbols."),
    steps: bool = switch("Derive them first, as on a board, from velocities on."),
    out: Out = None,
) -> None:
    """The equations of motion in closed form, with their symbols.

    M qdd + C qd + D qd + G = tau + Q + Psi^T lambda, as far as the scene has these, each entry
    written out (in long chains with names for shared parts), then what the symbols mean.

    With `--steps` (8 links at most) the derivation stands before them: velocities, KE, PE, the
    Lagrangian, its derivatives, the collected torques, the loops and lambda.

    `latex` is a whole document; `python` and `c` are functions M, C, G, ... that run on their own.
    JSON keys: name, equation, q, tau, M, C, D, G, Q, Psi, Psidot_qd, gap, definitions, symbols,
    zero, unused, with `--steps` steps.

    \b
    Examples:
      robodyn equations 2r
      robodyn equations four-bar --numeric
      robodyn equations 2r --steps
      robodyn equations four-bar --format latex > four-bar.tex
      robodyn equations 3r --format c --out arm.c
    """
    if steps and format in CODE:
        limit = "goes without --steps: a derivation is text, latex or json"
        raise InputError("--format", value=format, limit=limit)
    mechanism = model.load()
    if steps:
        check_size(mechanism)
    if STICKS in mechanism.contacts:
        note("dry friction is that in motion; at rest it holds any load up to static")
    if any(x.firm for x in mechanism.ranges):
        note("hard stops and limits are left out: the equations hold between them")
    if format in CODE:
        content = CODE[format](recorded(mechanism, numeric))
    else:
        on_terminal = out is None and sys.stdout.isatty()
        width = shutil.get_terminal_size((WIDTH, 0)).columns if on_terminal else WIDTH
        with progress("writing") as watch:
            found = equations_of(mechanism, numeric, lambda part: watch(DERIVING * part))
            if steps:
                derivation = Derivation(found)
                derive = DERIVED.get(format, partial(derivation_text, width=width))
                content = derive(derivation)
            else:
                content = READABLE[format](found) if format in READABLE else text(found, width)
    write_text(content, out)
