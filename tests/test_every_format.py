"""Every scene that is shipped or shown goes through every command, in every form it writes."""

from __future__ import annotations

import re
import shlex
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from conftest import ROOT, Outcome
from documents import blocks
from named_case import case

from robodyn import cli, load
from robodyn.cli import bench
from robodyn.dynamics import evaluators
from robodyn.mechanics.mechanism import Mechanism
from robodyn.tables.csv_fields import finite

Run = Callable[..., Outcome]
ROBOTS = {path.stem: path.read_text() for path in sorted((ROOT / "robots").glob("*.yaml"))}
SHOWN = {f"{page} {k}": text for k, (page, text) in enumerate(blocks("yaml"))}
# a scene without masses has kinematics alone
SCENES = {x: text for x, text in (ROBOTS | SHOWN).items() if re.search(r"\bm: ", text)}
TABLES = {path.name: path.read_text() for path in (ROOT / "robots").glob("*.csv")}
GAS = "q1,F\n0,-100\n6.283185307179586,-900\n12.566370614359172,-100\n"  # of the engine
# what a command needs beside the scene: a pose, rows of a motion, a number of the scene
WORDS = {
    "torque": "{rows}",
    "accel": "{rows}",
    "reactions": "{rows}",
    "points": "{rows} --columns points,links",
    "assemble": "{pose}",
    "terms": "{pose}",
    "energy": "{rows}",
    "simulate": "{pose} --time 0.01 --points 3 --quiet",
    "trajectory": "--via {rows} --points 3",
    "sweep": "{pose} --vary {number}=1,2 --kind torque --quiet",
    "bench": "{pose} --evaluators",
    "equilibrium": "{pose}",
    "linearize": "{pose}",
    "regressor": "{rows}",
    "identify": "{rows} --of {number}",
    "fit": "{rows} --vary {number}=0.0001:9 --minimize rx1 --starts 1 --quiet",
    "equations": "",
    "draw": "{pose} -o {folder}/picture",
    "animate": "{rows} -o {folder}/motion.html",
    "check": "",
    "export": "",
}
FIRST = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
# what a command may refuse: a free joint, a table in an equation, a mechanism that never rests,
# gravity that varies
REFUSED = {
    "cart-pole": ("torque", "sweep", "fit", "trajectory"),
    "engine 3": ("equations",),
    "gearbox 5": ("equilibrium",),
    "scene 8": ("equilibrium", "linearize"),
    "lift": ("equilibrium", "linearize"),
    "recovery-truck": ("equations", "equilibrium", "linearize"),
    "shaken-pendulum": ("equilibrium", "linearize", "identify", "fit", "trajectory"),
}
RUBS = ("bench", "linearize", "regressor", "identify", "fit", "equations")
REFUSED |= {name: RUBS for name, text in SCENES.items() if "coefficient: " in text}


def formats(command: str) -> list[str]:
    """Return the forms that a command with a MODEL writes, or [""] if it has one form.

    A command without a MODEL has none.
    """
    group: Any = typer.main.get_command(cli._application([command]))
    known = {x.human_readable_name: x for x in group.commands[command].params}
    if not any("MODEL" in name for name in known):
        return []
    return list(known["format"].type.choices) if "format" in known else [""]


FORMATS = {name: found for name in cli.COMMANDS if (found := formats(name))}


def test_every_command_with_a_model_is_called() -> None:
    assert FORMATS.keys() == WORDS.keys()
    assert {form for found in FORMATS.values() for form in found} > {"table", "csv", "json"}


@pytest.mark.parametrize("name", SCENES)
def test_every_command_writes_every_form(
    robodyn: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    measure_once(monkeypatch)
    scene, rows = tmp_path / "scene.yaml", tmp_path / "rows.csv"
    scene.write_text(SCENES[name])
    for table, rows_of_it in (TABLES | {"gas.csv": GAS}).items():
        (tmp_path / table).write_text(rows_of_it)
    tried = re.search(r"^# try: (--q.\S+)", SCENES[name], re.MULTILINE)
    mechanism = load(scene)
    pose = tried[1] if tried else "--q=" + ",".join("1" for _ in mechanism.actuated)
    rates = ",".join("0.5" for _ in pose.split(","))
    motion = f"{scene} {pose} --qd {rates} --time 0.05 --points 6 --quiet -o {rows}"
    robodyn("simulate", *shlex.split(motion)).succeeds()
    first = mechanism.description.links[0]
    number = shlex.quote(f"links.{first.name}.{'m' if first.slides else 'I'}")
    known = {"pose": pose, "rows": rows, "number": number, "folder": tmp_path}
    for command, forms in FORMATS.items():
        words = shlex.split(WORDS[command].format(**known))
        found: dict[str, Outcome] = {}
        for form in forms:
            with case(command, form):
                given = robodyn(command, scene, *words, *(["--format", form] if form else []))
                if given.code and command in ("export", *REFUSED.get(name, ())):
                    given.fails(given.code, str(scene))
                    continue
                assert given.code == 0, given.err
                found[form] = given
                check_form(form, given, tmp_path / "picture")
        if {"table", "csv", "json"} <= found.keys():
            with case(command):
                check_alike(found)


def measure_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `bench` time single calls, and show the same times in every form."""
    repeat, measure = evaluators.repeat, evaluators.measure_evaluators
    kept: list[Any] = []

    def measured(mechanism: Mechanism) -> Iterator[Any]:
        kept.extend([] if kept else measure(mechanism))
        return iter(kept)

    monkeypatch.setattr(evaluators, "BATCHES", (1,))
    monkeypatch.setattr(evaluators, "repeat", lambda call, **_: repeat(call, number=1, repeat=1))
    monkeypatch.setattr(bench, "measure_evaluators", measured)


def check_form(form: str, given: Outcome, picture: Path) -> None:
    """Assert that what was written is in that form."""
    match form:
        case "json":
            assert given.json
        case "csv":
            assert given.rows
        case "table":
            assert given.out.strip()
            assert not re.search(r"[{}]|None|nan", given.out)  # as Python would write it
        case "python":
            compile(given.out, "equations", "exec")
        case "urdf" | "mjcf":
            assert len(ET.fromstring(given.out)) > 0
        case "png" | "svg" | "pdf":
            assert picture.read_bytes().startswith(FIRST[form])


def check_alike(found: dict[str, Outcome]) -> None:
    """Assert that a table, CSV and JSON have the same rows."""
    rows, parts = found["csv"].rows, found["json"].json
    parts = parts["branches"] if isinstance(parts, dict) else parts
    assert len(rows) == len(parts)
    table = found["table"].out
    shown = set(table.split())
    for row, part in zip(rows, parts, strict=True):
        for text in filter(None, row.values()):
            number = finite(text)
            assert (text if number is None else number) in set(leaves(part))
            assert text in table if number is None else f"{number:.6g}" in shown


def leaves(part: Any) -> Iterator[Any]:
    """Yield the numbers and words of a JSON value."""
    if isinstance(part, dict | list):
        for inner in part.values() if isinstance(part, dict) else part:
            yield from leaves(inner)
    else:
        yield part
