"""The help, grouped by what is asked: the commands, and the options of each.

The list of commands imports none of their modules: it reads the summaries in their files.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path
from typing import Any

from typer import BadParameter
from typer.core import TyperCommand, TyperGroup

USAGE_ERROR: Any = BadParameter.__base__  # click's, of which typer has its own

GROUPS = {
    "States": "torque accel reactions points assemble terms energy",
    "Motions": "simulate trajectory sweep bench",
    "Analysis": "equilibrium linearize regressor identify fit equations",
    "Pictures": "plot draw animate",
    "Scenes": "init check schema export guide",
}
HEADINGS = {name: heading for heading, names in GROUPS.items() for name in names.split()}
# which print angles, and take --degrees
_TELLING = "torque accel reactions points assemble terms energy simulate trajectory sweep "
_TELLING += "equilibrium linearize regressor identify fit"
TELL_ANGLES = frozenset(_TELLING.split())

_OUTPUT = (
    "--every --points --sensitivity --event --events --differentiate --unwrap --extremes --degrees "
    "--quiet --report --size --dpi --format --out"
)
_CONTROL = "--control --track --unwrap --hold --kp --kd --ki --gain --at --tau-max --control-rate "
_CONTROL += "--control-model"
_OPTIONS = {
    "simulate": {
        "Start": "--q --qd --assemble",
        "Torques": "--force --tau --tau-from --volt",
        "Control": _CONTROL,
        "Integration": "--time --until --method --rtol --atol --max-step --accuracy "
        "--estimate-error --order --stabilize --baumgarte-rate --max-evals",
        "Output": _OUTPUT,
    },
    "sweep": {
        "What varies": "--vary --sample --seed",
        "Start and torques": "--kind --q --qd --qdd --tau",
        "Control": _CONTROL,
        "Integration": "--time --rtol --atol --max-steps",
        "Results": "--result --of --points --event --flip --correlations --extremes",
        "Work": "--workers --scheduler --patience",
        "Output": "--degrees --quiet --out",
    },
    "trajectory": {
        "Joints": "--from --to --via --unwrap --ends --speed --turns",
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


def summary(command: str) -> str:
    """The first line of its docstring."""
    source = (Path(__file__).parent / f"{command}.py").read_text("utf-8")
    return source.partition(f"\ndef {command}(")[2].split('"""')[1].partition("\n")[0]


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


def _successor(message: str) -> str:
    """Return what to type in place of a removed option or value that the message refuses, or ""."""
    from robodyn.simulation.settings import REMOVED  # only a faulty option pays for the import

    if "No such option: --ascii" in message:
        return "; it was removed: charts are plain where stdout is not UTF-8, others take -o x.svg"
    for value, successor in REMOVED.items():
        if f"'{value}' is not one of" in message:
            return f" {value} was removed: take {successor}."
    return ""


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
            error.message += _successor(error.message)
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
        for heading, names in GROUPS.items():
            listed = [name for name in names.split() if name in self.commands]
            with formatter.section(heading):
                rows = [(name.ljust(column), self.commands[name].short_help) for name in listed]
                formatter.write_dl(rows)
