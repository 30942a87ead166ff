"""The command line: one module a subcommand; the only place that prints or exits.

Exit codes: 0 done, 1 the computation could not be done, 2 the input is wrong.  stdout carries
data only.  A command's module is imported when it is called.  The help is grouped by what is asked;
the list of commands imports none of their modules: it reads the summaries in their files.
"""

from __future__ import annotations

import atexit
import functools
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import MISSING, Field, fields, is_dataclass
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, NoReturn, cast, get_args, get_origin, get_type_hints

import typer
from typer import BadParameter
from typer.core import TyperCommand, TyperGroup

from robodyn import __version__
from robodyn.cli import progress
from robodyn.errors import MassError, RobodynError, printable_lines
from robodyn.tables.csv_fields import plain_digits

USAGE_ERROR: Any = BadParameter.__base__  # click's, of which typer has its own

GROUPS = {
    "States": "torque accel reactions points assemble terms energy",
    "Motions": "simulate trajectory sweep bench",
    "Analysis": "summary equilibrium linearize regressor identify fit equations",
    "Pictures": "plot draw animate",
    "Scenes": "init check schema export guide",
}
HEADINGS = {name: heading for heading, names in GROUPS.items() for name in names.split()}
# which print angles, and take --degrees
_TELLING = "torque accel reactions points assemble terms energy simulate trajectory sweep "
_TELLING += "equilibrium linearize regressor identify fit"
TELL_ANGLES = frozenset(_TELLING.split())

_OUTPUT = (
    "--every --points --sensitivity --event --events --differentiate --unwrap --columns --degrees "
    "--quiet --report --size --dpi --format --out"
)
_CONTROL = (
    "--control --track --read --unwrap --hold --kp --kd --ki --gain --at --tau-max --control-rate "
)
_CONTROL += "--control-model"
_OPTIONS = {
    "simulate": {
        "Start": "--q --qd --assemble",
        "Torques": "--force --tau --tau-from --tau-hold --volt",
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
        "Results": "--result --of --points --event --flip",
        "Work": "--workers --scheduler --patience",
        "Output": "--columns --degrees --quiet --out",
    },
    "trajectory": {
        "Joints": "--from --to --via --read --unwrap --ends --speed --turns",
        "A point in the plane": "--of --to-xy --arc --path --posture",
        "Time": "--time --profile --acceleration",
        "Sine sweep": "--amplitude --frequencies",
        "Limits": "--max-qd --max-qdd --max-tau --max-speed",
        "Output": _OUTPUT,
    },
}
_OPTIONS["fit"] = {
    "State": "--q --qd --qdd --tau --force --read",
    "Output": "--degrees --format --out",
}
_OTHERS = {"State": "--q --qd --qdd --tau --force --read", "Output": _OUTPUT}
OWN = "Options"  # of a command, which stand first; typer's word, too
IMPLIED = {"--harmonics": "10"}  # whole numbers that may be left out behind their option
_NUMBER = "(?i)[+-]?([0-9][0-9.]*(e[+-]?[0-9]+)?|nan|inf)"  # right or not


def first_line(command: str) -> str:
    """Return the first line of a command's docstring, from its file."""
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
    from robodyn.runs.settings import REMOVED  # only a faulty option pays for the import

    for option, successor in REMOVED_OPTIONS.items():
        if re.search(f"No such option: {option}(?![\\w-])", message):
            return f"; it was removed: {successor}"
    for value, successor in REMOVED.items():
        if f"'{value}' is not one of" in message:
            return f" {value} was removed: take {successor}."
    return ""


_SUMMARY = "hand the rows on, | robodyn summary"
REMOVED_OPTIONS = {
    "--ascii": "charts are plain where stdout is not UTF-8, others take -o x.svg",
    "--delimiter": "the header tells where fields end, at commas, semicolons or tabs",
    "--extremes": _SUMMARY,
    "--correlations": f"{_SUMMARY} --correlations NAMES",
    "--harmonics": f"{_SUMMARY} --harmonics",
    "--power": "name power in --columns, as --columns tau,power",
    "--residual": "name residual in --columns, as --columns tau,residual",
    "--links": "name links in --columns, as --columns points,links",
    "--transmission": "name transmission in --columns, as --columns points,transmission",
    "--jacobian": "name jacobian in --columns, as --columns points,jacobian",
    "--ratio": "name the ratio in --columns, as --columns points,rocker/crank",
}


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

        from robodyn.scene.quantities import read_value

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


# units of numbers by what stands for them in the help
OPTION_UNITS = {"S": "s", "1/S": "1/s", "RAD": "rad", "HZ": "Hz"}
COMMANDS = tuple(HEADINGS)


def main() -> NoReturn:
    """Run the command line on this process's arguments and exit."""
    try:
        progress.answer(progress.end)
        code = run(sys.argv[1:])
        for stream in (sys.stdout, sys.stderr):
            # after a signal what is left is let go: its pipe may have a reader that waits
            if stream is not None and not progress.received:
                stream.flush()
    except BrokenPipeError:
        code = _without_reader()
    except KeyboardInterrupt:
        code = 130
    if sys.gettrace() or sys.getprofile():
        sys.exit(code)
    atexit._run_exitfuncs()  # matplotlib's folder, the semaphores of processes
    os._exit(code)  # nothing is left to do, and taking down scipy's modules takes 50 ms


def run(arguments: list[str]) -> int:
    """Run the command line on `arguments`; the exit code."""
    debug = "--debug" in arguments
    arguments = [word for word in arguments if word != "--debug"]
    completing = any(name.startswith("_ROBODYN_COMPLETE") for name in os.environ)
    # what is told to nobody must go nowhere, and no file may be opened in its place
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115 (as long as the process lives)
    if completing or sys.stderr is None:  # a shell shows it in the line that is being typed
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    for size in ("COLUMNS", "LINES"):  # what no terminal has: the terminal itself is asked
        told = os.environ.get(size, "")
        if not (told.isdecimal() and len(told) < 5 and int(told)):
            os.environ.pop(size, None)
    try:
        command = _command([] if completing else arguments, completing)
        code = command(arguments, prog_name="robodyn", standalone_mode=False)
    except KeyboardInterrupt:
        return 130
    except SystemExit as stop:
        if type(sys.stdout).__name__ == "PacifyFlushWrapper":  # typer's mark of a closed pipe
            return _without_reader()
        return stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    except USAGE_ERROR as error:
        error.message = printable_lines(error.message)
        error.show()
        return int(error.exit_code)
    except Exception as error:  # the outermost boundary
        if progress.received and not isinstance(error, RobodynError | OverflowError | OSError):
            return 128 + progress.received[-1]  # compiled code makes another error of a signal
        if debug:
            raise
        if isinstance(error, MassError):
            error.limit = error.limit.replace("dynamics need", f"{_called(arguments)} needs")
        print(printable_lines(_described(error)), file=sys.stderr)
        return error.exit_code if isinstance(error, RobodynError) else 1
    return code if isinstance(code, int) else 0


def _described(error: Exception) -> str:
    match error:
        case RobodynError():
            text = "\n       ".join(str(error).splitlines())
        case OverflowError():
            text = f"a number of the scene, the state or an option is too large ({error})"
        case OSError():
            named = f"{error.filename}: " if error.filename else ""  # stdout has none
            text = f"{named}{error.strerror or error}"
        case _ if isinstance(error, MemoryError) or "failed to map segment" in str(error):
            text = "the memory that this process may use is exhausted: allow more (ulimit -v)"
        case _:
            hint = "please report it with what `robodyn --debug ...` prints"
            text = f"a defect of robodyn's own ({type(error).__name__}: {error}); {hint}"
    return f"Error: {text}"


def _called(arguments: list[str]) -> str:
    """The word that names the command, empty if there is none."""
    return next((word for word in arguments if not word.startswith("-")), "")


def _application(arguments: list[str], whole: bool = True) -> typer.Typer:
    """The command that is called; where none is, all, `whole` or as a list of their names."""
    called = _called(arguments)
    is_called = called in COMMANDS
    application = typer.Typer(
        cls=Commands,
        no_args_is_help=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        rich_markup_mode="rich" if sys.stdout.isatty() else None,
        pretty_exceptions_enable=False,
    )
    application.callback()(_root)
    asked = is_called and not {"--help", "-h"}.isdisjoint(arguments)
    for name in [called] if is_called else COMMANDS:
        function: Callable[..., None] = _listed
        if is_called or whole:
            function = _guarded(getattr(import_module(f"robodyn.cli.{name}"), name))
        application.command(
            name,
            cls=Command,
            help=_flowing(function.__doc__ or "") if asked and sys.stdout.isatty() else None,
            short_help=None if is_called else first_line(name),
            epilog=_more(name) if asked else None,
            rich_help_panel=HEADINGS[name],
        )(function)
    return application


def _flowing(text: str) -> str:
    """A docstring as typer lays it out on a terminal: without line ends, and brackets as they are.

    Else it would keep the former, and take the latter for marks of style.
    """
    from rich.markup import escape

    parts = inspect.cleandoc(text).split("\n\n")
    lines = (x if x.startswith("\b") else " ".join(x.split()) for x in parts)
    return escape("\n\n".join(lines))


def _listed() -> None:
    """Stands for a command in the list of them."""


def _more(command: str) -> str:
    from robodyn.cli.guide import page_of

    return f"More: robodyn guide {page_of(command)}"


def _command(arguments: list[str], whole: bool) -> Any:
    """The application, its options grouped, and taking the numbers of scenes, with units."""
    group: Any = typer.main.get_command(_application(arguments, whole))
    for name, command in group.commands.items():
        group_options(name, command.params)
    return group


LARGEST = 2.0**53  # whole number of an option: doubles tell larger ones no more apart


def _number(kind: type, unit: str, value: Any) -> float:
    """Parse the number of an option, which may be arithmetic with units; BadParameter if none."""
    if not isinstance(value, str):
        return cast(float, kind(value))
    if plain_digits(value):
        with suppress(ValueError):
            return cast(float, kind(value))
    from robodyn.scene.quantities import parse_quantity

    try:
        number = parse_quantity(value.strip(), unit)
    except ValueError as error:
        end = "" if str(error).endswith("?") else "."
        raise typer.BadParameter(f"{value!r} {error}{end}") from None
    if kind is float:
        return number
    if not number.is_integer():
        raise typer.BadParameter(f"{value!r} is {number:.6g}, no whole number.")
    if abs(number) > LARGEST:
        raise typer.BadParameter(f"{value!r} is {number:.6g}, above {LARGEST:.6g}.")
    return int(number)


def _guarded(function: Callable[..., None]) -> Callable[..., None]:
    """The command as typer takes it, with the manners of a pipe: a closed one ends it quietly.

    A parameter that is a dataclass stands for its fields, one option each.
    """
    from robodyn.cli import large_angles
    from robodyn.cli.options import Degrees

    groups: dict[str, Any] = {}
    options: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        kind: Any = parameter.annotation
        if isinstance(kind, type) and is_dataclass(kind):
            groups[name] = kind
            kinds = get_type_hints(kind, include_extras=True)
            options += [_declared(field.name, kinds[field.name], field) for field in fields(kind)]
        else:
            options.append(_declared(name, kind, parameter.default))
    tells_angles = function.__name__ in TELL_ANGLES
    if tells_angles:
        options.append(_declared("degrees", Degrees, False))

    @functools.wraps(function)
    def guarded(**given: Any) -> None:
        from robodyn.cli.output import degrees, numbers_overflow_in_silence

        numbers_overflow_in_silence()
        degrees.set(tells_angles and given.pop("degrees"))
        named = {name.strip("_"): value for name, value in given.items()}
        large_angles.options.set(None if named.get("quiet") else named)
        made = {
            name: group(**{field.name: given.pop(field.name) for field in fields(group)})
            for name, group in groups.items()
        }
        try:
            function(**given, **made)
            sys.stdout.flush()
        except BrokenPipeError:
            raise typer.Exit(_without_reader()) from None
        except KeyboardInterrupt:
            raise typer.Exit(130) from None

    setattr(guarded, "__signature__", inspect.Signature(options))  # noqa: B010 (no attribute to mypy)
    return guarded


def _declared(name: str, kind: Any, default: Any) -> inspect.Parameter:
    """A parameter as typer takes it; `default` may be a field, as `options.option` makes it."""
    if isinstance(default, Field):
        if told := default.metadata.get("option"):
            told.param_decls = told.param_decls or ["--" + name.strip("_").replace("_", "-")]
            kind = Annotated[kind, told]
        default = inspect.Parameter.empty if default.default is MISSING else default.default
    base, *marks = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    for number in (float, int):
        if number in (base, *get_args(base)):
            for mark in marks:
                mark.metavar = mark.metavar or number.__name__.upper()
                mark.parser = functools.partial(_number, number, OPTION_UNITS.get(mark.metavar, ""))
    where = {"default": default, "annotation": kind}
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, **where)


def _without_reader() -> int:
    """Redirect stdout to nothing: buffered output has no reader.  Return exit code 0."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ else 1)
    return 0


def _version(wanted: bool) -> None:
    if wanted:
        print(f"robodyn {__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Dynamics of planar mechanisms: M, C, G, torques and motions of arms and linkages.

    A scene (YAML) describes the mechanism; results go to stdout, as a table on a terminal
    and as CSV or JSON in a pipe.

    \b
    Examples:
      robodyn torque 2r --q 30deg,45deg --qd 1,0.5 --qdd 0,0
      robodyn terms four-bar --q 60deg --qd 5
      robodyn torque 2r - < states.csv > torques.csv
    """
