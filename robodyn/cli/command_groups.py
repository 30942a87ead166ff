"""The help, grouped by what is asked: the commands, and the options of each.

The list of commands needs none of their modules: their summaries stand here as well, the first
paragraphs of the docstrings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import zip_longest
from typing import Any

from typer import BadParameter
from typer.core import TyperCommand, TyperGroup

USAGE_ERROR: Any = BadParameter.__base__  # click's, of which typer has its own

GROUPS = {
    "States": {
        "torque": "The torques that a motion needs, and the pin forces.",
        "accel": "The accelerations that torques cause, and the pin forces.",
        "reactions": "The force in every pin, and the shaking force and moment on the ground.",
        "points": "Where points are, how fast they move, and how they speed up.",
        "assemble": "Close the loops: all angles, rates and points.",
        "terms": "M, C, G, the closures' Psi, and the energies at a state.",
        "energy": "Kinetic energy, potential energy and their sum.",
    },
    "Motions": {
        "simulate": "The motion that torques cause, as CSV.",
        "trajectory": "A reference motion of the joints, as CSV for `torque`.",
        "sweep": "The same simulation, or torque, over a grid or a random sample, as one CSV.",
        "bench": "Speed against error of every method on one motion.",
    },
    "Analysis": {
        "equilibrium": "Where the mechanism rests: near a pose, or everywhere.",
        "linearize": "How it moves near a state: A, B, natural frequencies, damping, mode shapes.",
        "regressor": "Y(q, qd, qdd): the torques are linear in masses, moments, dampers and "
        "springs, tau = Y pi.",
        "identify": "The parameters of a mechanism from its torques along a motion, by least "
        "squares.",
        "fit": "Numbers of a scene for which columns follow a table, or are as small as they can "
        "be.",
        "equations": "The equations of motion in closed form, with their symbols.",
    },
    "Pictures": {
        "plot": "Columns of CSV files against time, or against each other; a map of one over two "
        "others.",
        "draw": "The mechanism in a pose, to scale.",
        "animate": "A motion as a moving picture, in real time.",
    },
    "Scenes": {
        "init": "Write a commented scene to start from.",
        "check": "What was read from a scene, and a self-test.",
        "schema": "The scene format as a JSON Schema (draft 2020-12).",
        "export": "The same mechanism as URDF or MJCF, for other tools.",
        "guide": "The pages of the guide, or one of them.",
    },
}
SUMMARIES = {name: text for group in GROUPS.values() for name, text in group.items()}
# which print angles, and take --degrees
_TELLING = "torque accel reactions points assemble terms energy simulate trajectory sweep "
_TELLING += "equilibrium linearize regressor identify fit check"
TELL_ANGLES = frozenset(_TELLING.split())
HEADINGS = {name: heading for heading, group in GROUPS.items() for name in group}

_OUTPUT = (
    "--every --points --sensitivity --event --events --differentiate --extremes --degrees --quiet "
    "--report --size --dpi --ascii --format --out"
)
_CONTROL = "--control --track --hold --kp --kd --ki --gain --at --tau-max --control-rate "
_CONTROL += "--control-model"
_OPTIONS = {
    "simulate": {
        "Start": "--q --qd --assemble",
        "Torques": "--force --tau --tau-from --volt",
        "Control": _CONTROL,
        "Integration": "--time --until --method --rtol --atol --max-step --accuracy "
        "--estimate-error --order --engine --stabilize --baumgarte-rate --max-evals",
        "Output": _OUTPUT,
    },
    "sweep": {
        "What varies": "--vary --sample --seed",
        "Start and torques": "--kind --q --qd --qdd --tau",
        "Control": _CONTROL,
        "Integration": "--time --rtol --atol --max-steps --engine",
        "Results": "--result --of --points --event --flip --correlations --extremes",
        "Work": "--workers --scheduler --patience",
        "Output": "--degrees --quiet --out",
    },
    "trajectory": {
        "Joints": "--from --to --via --ends --speed --turns",
        "A point in the plane": "--of --to-xy --arc --path --posture",
        "Time": "--time --profile --acceleration",
        "Sine sweep": "--amplitude --frequencies",
        "Limits": "--max-qd --max-qdd --max-tau --max-speed",
        "Output": _OUTPUT,
    },
}
_OTHERS = {"State": "--q --qd --qdd --tau --force", "Output": _OUTPUT}
OWN = "Options"  # of a command, which stand first; typer's word, too
IMPLIED = {"--harmonics": "10"}  # whole numbers that may be left out behind their option
_NUMBER = "(?i)[+-]?([0-9][0-9.]*(e[+-]?[0-9]+)?|nan|inf)"  # right or not


def group_options(command: str, parameters: Iterable[Any]) -> None:
    """Give each option its heading in the help of the command."""
    of_flag = {
        flag: heading
        for heading, flags in _OPTIONS.get(command, _OTHERS).items()
        for flag in flags.split()
    }
    for parameter in parameters:
        flags = [flag for flag in parameter.opts if flag in of_flag]
        if flags:
            parameter.rich_help_panel = of_flag[flags[0]]


def _heading(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return "Arguments"
    return getattr(parameter, "rich_help_panel", None) or OWN


class Command(TyperCommand):
    """A command whose help is grouped, in a pipe too."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """With the numbers of `IMPLIED` behind options that stand alone."""
        given: list[str] = []
        meant = False  # whether a word stands behind that may be no file, but a wrong number
        for word, following in zip_longest(args, args[1:], fillvalue=""):
            given.append(word)
            if word in IMPLIED and not re.fullmatch(_NUMBER, following):
                given.append(IMPLIED[word])
                meant = bool(following) and not following.startswith("-")
        try:
            return super().parse_args(ctx, given)
        except USAGE_ERROR as error:
            self._propose(error, getattr(error, "option_name", ""), args)
            if not meant or "unexpected extra" not in error.message:
                raise
        return super().parse_args(ctx, args)  # the option tells what is wrong

    def _propose(self, error: Any, unknown: str, words: Iterable[str]) -> None:
        """Tell how a negative number is given that an unknown option begins, or of two dashes."""
        from difflib import get_close_matches  # only a faulty option pays for the import

        from robodyn.scene.unit_arithmetic import read_value

        word = next((x for x in words if unknown and x.startswith(unknown)), "")
        flags = [flag for parameter in self.params for flag in parameter.opts]
        try:
            read_value(word.partition(",")[0])
            flag = "--q" if "--q" in flags else "--OPTION"
            error.message += f"; give a negative number with its option and =, as {flag}={word}"
        except ValueError:
            if not word.startswith("--"):
                error.possibilities = get_close_matches(f"-{word.partition('=')[0]}", flags)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        order = ["Arguments", OWN, *_OPTIONS.get(self.name or "", _OTHERS)]
        self.params.sort(key=lambda parameter: order.index(_heading(parameter)))
        super().format_help(ctx, formatter)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        told: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            if record := parameter.get_help_record(ctx):
                told.setdefault(_heading(parameter), []).append(record)
        for heading, records in told.items():
            with formatter.section(heading):
                formatter.write_dl(records)


class Commands(TyperGroup):
    """The list of commands, grouped in a pipe too."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        column = max(map(len, self.commands))
        for heading, group in GROUPS.items():
            rows = [(name.ljust(column), text) for name, text in group.items()]
            with formatter.section(heading):
                formatter.write_dl([row for row in rows if row[0].strip() in self.commands])
