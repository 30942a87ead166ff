"""The command line: one module a subcommand; the only place that prints or exits.

Exit codes: 0 done, 1 the computation could not be done, 2 the input is wrong.  stdout carries
data only.  A command's module is imported when it is called, and it imports only what it runs.
"""

from __future__ import annotations

import functools
import gc
import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer

from robodyn import __version__
from robodyn.cli import signals
from robodyn.errors import InputError, RobodynError

COMMANDS = (
    *("torque", "accel", "reactions", "simulate", "trajectory"),
    *("terms", "equations", "assemble", "energy", "check", "bench", "sweep", "export"),
    *("plot", "draw", "animate", "init", "schema"),
)


def main() -> NoReturn:
    """Run the command line on this process's arguments and exit."""
    signals.answer(signals.end)
    gc.set_threshold(100_000, 50, 100)  # importing scipy would collect for 30 ms, for nothing
    code = run(sys.argv[1:])
    try:
        for stream in (sys.stdout, sys.stderr):
            # after a signal what is left is let go: its pipe may have a reader that waits
            if stream is not None and not signals.received:
                stream.flush()
    except BrokenPipeError:
        code = _without_reader()
    if sys.gettrace() or sys.getprofile():
        sys.exit(code)
    os._exit(code)  # nothing is left to do, and taking down scipy's modules takes 50 ms


def run(arguments: list[str]) -> int:
    """Run the command line on `arguments`; the exit code."""
    debug = "--debug" in arguments
    arguments = [word for word in arguments if word != "--debug"]
    if sys.stdout is None:
        print("Error: stdout is closed: results have no place to go", file=sys.stderr)
        return 1
    try:
        _application(arguments)(arguments, prog_name="robodyn")
    except KeyboardInterrupt:
        return 130
    except SystemExit as stop:
        if type(sys.stdout).__name__ == "PacifyFlushWrapper":  # typer's mark of a closed pipe
            return _without_reader()
        return stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    except RobodynError as error:
        if debug:
            raise
        print(_prefixed(str(error)), file=sys.stderr)
        return error.exit_code
    except OSError as error:
        if debug:
            raise
        named = f"{error.filename}: " if error.filename else ""
        print(f"Error: {named}{error.strerror or error}", file=sys.stderr)
        return 1
    except Exception as error:  # the outermost boundary: a defect of robodyn's own
        if signals.received:  # compiled code makes another error of a signal
            return 128 + signals.received[-1]
        if debug:
            raise
        kind = type(error).__name__
        hint = "please report it with what `robodyn --debug ...` prints"
        print(f"Error: a defect of robodyn's own ({kind}: {error}); {hint}", file=sys.stderr)
        return 1
    return 0


def _prefixed(text: str) -> str:
    lines = text.splitlines() or [""]
    return "\n".join([f"Error: {lines[0]}", *(f"       {line}" for line in lines[1:])])


def _application(arguments: list[str]) -> typer.Typer:
    """The commands, only the one that is called where that is plain from the arguments."""
    called = next((word for word in arguments if not word.startswith("-")), None)
    completing = any(name.startswith("_ROBODYN_COMPLETE") for name in os.environ)
    chosen = (called,) if called in COMMANDS and not completing else COMMANDS
    application = typer.Typer(
        no_args_is_help=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        rich_markup_mode="rich" if sys.stdout.isatty() else None,
        pretty_exceptions_enable=False,
    )
    application.callback()(_root)
    for name in chosen:
        function: Callable[..., None] = getattr(import_module(f"robodyn.cli.{name}"), name)
        application.command(name)(_guarded(function))
    return application


def _guarded(function: Callable[..., None]) -> Callable[..., None]:
    """The command with the manners of a pipe: a closed one ends it quietly."""

    @functools.wraps(function)
    def guarded(*args: Any, **kwargs: Any) -> None:
        try:
            _keep_model(kwargs.get("model"), kwargs.get("out"))
            function(*args, **kwargs)
            sys.stdout.flush()
        except BrokenPipeError:
            raise typer.Exit(_without_reader()) from None
        except KeyboardInterrupt:
            raise typer.Exit(130) from None

    return guarded


def _keep_model(model: object, out: object) -> None:
    """Raise InputError where results would take the place of the scene that they come from."""
    if model is None or out is None:
        return
    if os.path.realpath(str(model)) == os.path.realpath(str(out)) and os.path.isfile(str(model)):
        raise InputError("--out", value=out, limit="is the scene itself: name another file")


def _without_reader() -> int:
    """What is still buffered has no reader: let the interpreter flush it into nothing."""
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
      robodyn torque robots/2r.yaml --q 30deg,45deg --qd 1,0.5 --qdd 0,0
      robodyn terms robots/four-bar.yaml --q 60deg --qd 5
      robodyn torque robots/2r.yaml - < states.csv > torques.csv
    """
