"""The reference tables of the guide are what the code says: commands, values, codes, functions.

Those of the scene format are in test_scene_schema.py, units of columns in test_chart.py, and rows
of the program in test_guide.py.
"""

from __future__ import annotations

import inspect
import re

import typer
from documents import DOCUMENTS, PAGES, README, rows_below
from each_case import each

import robodyn
from robodyn import cli
from robodyn.dynamics import closed_form, dynamics
from robodyn.errors import InputError, RobodynError
from robodyn.loops import closures
from robodyn.scene import expressions, syntax, units
from robodyn.scene.quantities import parse_quantity
from robodyn.scene.syntax import VALUE_CONSTANTS

COMMANDS = typer.main.get_command(cli._application([])).commands


def usage(name: str) -> str:
    """The command with its arguments, as its help has them."""
    arguments = [x for x in COMMANDS[name].params if x.param_type_name == "argument"]
    return " ".join(
        ["robodyn", name, *(x.metavar if x.required else f"[{x.metavar}]" for x in arguments)]
    )


def test_the_commands_are_those_of_the_readme() -> None:
    """It computes what its help begins with, and writes what its --format is about."""
    rows = rows_below(README, "| command | computes | writes |")
    assert sorted(row[0].strip("`") for row in rows) == sorted(map(usage, COMMANDS))
    for command, computes, writes in rows:
        name = command.split()[1].strip("`")
        assert re.match(rf"{re.escape(computes)}(?!\w)", cli.first_line(name)), name
        formats = next((x.type for x in COMMANDS[name].params if "--format" in x.opts), None)
        choices = set(getattr(formats, "choices", []))
        assert (choices == {"table", "json"}) == (writes == "parts"), name
        assert ("png" in choices) == (writes in ("a picture", "a chart or a map")), name
        if "csv" in choices and name not in ("init", "guide"):  # whose lists are rows
            assert writes == "rows", name


@each("name", DOCUMENTS)
def test_options_of_the_guide_exist(name: str) -> None:
    options = {x for each in COMMANDS.values() for parameter in each.params for x in parameter.opts}
    options |= {"--debug", "--help", "--version", "--install-completion", "--show-completion"}
    text = re.sub(r"^```.*?^```$", "", DOCUMENTS[name], flags=re.MULTILINE | re.DOTALL)
    options |= cli.REMOVED_OPTIONS.keys() if name == "changes" else set()
    assert set(re.findall(r"(?<![\w-])--[a-z][\w-]*", text)) <= options


FORMULAS = closed_form, closures, dynamics


def test_the_equations_of_the_lecture_are_computed_where_the_guide_says() -> None:
    rows = rows_below(PAGES["lecture"], "| equation | says | computed by | shown by |")
    for _, _, function, command in rows:
        name = function.strip("`")
        assert any(callable(getattr(file, name, None)) for file in FORMULAS), name
        assert command.strip("`") in COMMANDS
    told = {int(x) for row in rows for x in re.findall(r"\d+", row[0])}
    assert told == {24, 25, 26, 27, 28, 32, 33}  # the ends of ranges


def test_values_are_read_as_the_guide_says() -> None:
    rows = rows_below(PAGES["values"], "| quantity | written | is |")
    assert len({row[0] for row in rows}) > 5
    for quantity, written, value in rows:
        unit = quantity.rpartition(", ")[2] if "," in quantity else ""
        assert parse_quantity(written.strip("`"), unit) == float(value), written


def test_units_and_functions_of_values_are_listed() -> None:
    written = PAGES["values"].split("## Numbers with units")[1].split("## Expressions")[0]
    listed = {x for text in re.findall(r"`([^`]+)`", written) for x in text.split()}
    assert {*units.UNITS, *syntax.FUNCTIONS, *VALUE_CONSTANTS} <= listed


def test_expressions_and_their_units_are_listed() -> None:
    written = PAGES["values"].split("## Expressions")[1]
    listed = next(x for x in re.findall(r"`([^`]+)`", written) if "atan2" in x)
    assert sorted(listed.split()) == sorted(syntax.FUNCTIONS)
    assert all(f"`{name}`" in written for name in syntax.CONSTANTS)
    smooth = PAGES["scene"].split("## Expressions and tables")[1].split("What bends")[0]
    words = set(re.findall(r"[a-z]+[0-9]*", smooth))
    assert set(expressions.SMOOTH) | set(syntax.CONSTANTS) <= words
    assert words.isdisjoint(expressions.BENDS)


def test_exit_codes() -> None:
    codes = [row[0] for row in rows_below(PAGES["exit-codes"], "| code | is |")]
    own = [0, RobodynError.exit_code, InputError.exit_code, 130]
    assert codes == [*map(str, own), "128 + n"]
    assert cli.USAGE_ERROR.exit_code == InputError.exit_code


def test_functions_are_called_as_the_guide_says() -> None:
    """What it names first are the parameters in their order, `mech` for the mechanism."""
    tables = "".join(PAGES["python"].split("| function | result |")[1:])
    calls = re.findall(r"`(\w+)\(([\w*].*?)\)`", tables)
    assert len(calls) > 30
    for name, arguments in calls:
        function = getattr(robodyn, name, None)
        if function is None:  # a method, which the text names with its class
            continue
        parameters = inspect.signature(function).parameters
        told = re.sub(r"\[.*?\]|\(\)|\*", "", arguments).split(", ")
        for k, argument in enumerate(x for x in told if x != "..."):
            word, _, default = argument.replace("mech", "mechanism").partition("=")
            assert word in parameters, (name, word)
            assert default or list(parameters)[k] == word, (name, word)
