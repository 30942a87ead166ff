"""Manners of the command line: its help, what it imports, scenes by name."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

import pytest
import typer
from conftest import Outcome

from robodyn import cli
from robodyn.cli import command_groups

Run = Callable[..., Outcome]


def function_of(command: str) -> Any:
    return getattr(import_module(f"robodyn.cli.{command}"), command)


def test_the_summaries_are_those_of_the_docstrings() -> None:
    for name, text in command_groups.SUMMARIES.items():
        told = inspect.getdoc(function_of(name)) or ""
        assert text == " ".join(told.split("\n\n")[0].split()), name


def test_the_list_of_commands_is_grouped_and_whole(robodyn: Run) -> None:
    out = robodyn("--help").succeeds().out
    assert "..." not in out.partition("States:")[2]
    shown = out.partition("States:")[2]
    for name, text in command_groups.SUMMARIES.items():
        words = r"\s+".join(map(re.escape, text.split()))
        assert re.search(rf"^  {name} +{words}$", shown, re.M)
    headings = re.findall(r"^(\w+):$", out, re.M)
    assert headings == ["Options", *command_groups.GROUPS]


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_option_stands_once_under_its_heading(robodyn: Run, name: str) -> None:
    out = robodyn(name, "--help").succeeds().out
    options: dict[str, list[str]] = {}
    for heading, body in re.findall(r"^(\w[^\n:]*):\n((?:  .*\n|\n(?=  ))+)", out, re.M):
        options[heading] = re.findall(r"^  (?:-\w, )?(--[\w-]+)", body, re.M)
    told = [flag for heading in options for flag in options[heading]]
    group: Any = typer.main.get_command(cli._application([name]))
    known = [p.opts[0] for p in group.commands[name].params if p.param_type_name == "option"]
    assert sorted(told) == sorted([*known, "--help"])
    if name in ("simulate", "sweep", "trajectory"):
        assert set(options["Options"]) <= {"--set", "--delimiter", "--help"}
        assert list(options)[-1] == "Output"
    if name == "simulate":
        wanted = ["Arguments", "Options", "Start", "Torques", "Control", "Integration", "Output"]
        assert list(options) == wanted


def imported(*words: str) -> set[str]:
    line = [sys.executable, "-X", "importtime", "-m", "robodyn", *words]
    told = subprocess.run(line, capture_output=True, text=True).stderr
    return set(re.findall(r"\| +([\w.]+)$", told, re.M))


@pytest.mark.parametrize("words", [["--version"], [], ["--help"]])
def test_nothing_is_imported_that_is_not_shown(words: list[str]) -> None:
    found = imported(*words)
    assert "robodyn.cli" in found
    assert not {"numpy", "yaml", "rich", "scipy", "robodyn.scene"} & found
    assert not {f"robodyn.cli.{name}" for name in cli.COMMANDS} & found
