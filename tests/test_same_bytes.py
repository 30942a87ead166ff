"""The same call gives the same bytes: whatever the process did before, and however a pipe cuts."""

from __future__ import annotations

import io
import itertools
import re
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome

import robodyn as rd
from robodyn import cli
from robodyn.engines import batches
from robodyn.runs.settings import METHODS
from robodyn.tables.arrays import Array

Run = Callable[..., Outcome]

# a crank, at rest in some of its states, on a loop that misses a change point by 1e-5 m
NEAR_MISS = (ROOT / "robots/parallelogram.yaml").read_text()
STICKING = """
gravity: 9.81
links:
  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1, friction: {torque: 0.5, static: 0.9}}
  - {name: b, m: 1, l: 1, r: 0.5, I: 0.1}
"""
LONG = "gravity: 9.81\nlinks:\n" + "".join(
    f"  - {{name: l{k}, m: 1, l: 0.2, r: 0.1, I: 0.01}}\n" for k in range(13)
)


def near_miss() -> str:
    """The text of a parallelogram whose crank is 1e-5 m too short for its change point."""
    text, made = re.subn(r"(name: crank[^}\n]*l: )0\.3\b", r"\g<1>0.3 - 1e-5", NEAR_MISS)
    assert made == 1
    return text


class Cut(io.BytesIO):
    """A pipe that hands on a header, then so many lines at a time, and last those that are left."""

    def __init__(self, text: str, counts: Sequence[int]) -> None:
        super().__init__()
        lines = iter(text.encode().splitlines(keepends=True))
        self.pieces = [b"".join(itertools.islice(lines, count)) for count in (1, *counts)]
        self.pieces.append(b"".join(lines))

    def read1(self, size: int | None = -1) -> bytes:
        return self.pieces.pop(0) if self.pieces else b""


def table(header: list[str], values: Array) -> str:
    """A CSV with these columns."""
    return "".join(
        f"{','.join(row)}\n" for row in [header, *(map(repr, x) for x in values.tolist())]
    )


def states(mechanism: rd.Mechanism, last: str) -> str:
    """A table of 210 states by the actuated joints, some at rest, and one near a change point."""
    rng = np.random.default_rng(7)
    driven = [k + 1 for k in mechanism.actuated]
    values = rng.uniform(0.3, 1.2, size=(210, 3 * len(driven)))
    values[::5, len(driven) : 2 * len(driven)] = 0.0
    values[2, : len(driven)] = 0.02
    return table([f"{name}{k}" for name in ("q", "qd", last) for k in driven], values)


@pytest.mark.parametrize("text", ["3r", "four-bar", "parallelogram", STICKING, LONG])
def test_a_pipe_may_cut_a_stream_anywhere(
    text: str, scene: Callable[[str], Path], robodyn: Run
) -> None:
    model = scene(text) if "links" in text else ROOT / f"robots/{text}.yaml"
    mechanism = rd.load(model)
    given = {last: states(mechanism, last) for last in ("qdd", "tau")}

    def piped(command: str, *counts: int) -> str:
        rows = given["tau" if command == "accel" else "qdd"]
        return robodyn(command, model, "-", stdin=Cut(rows, counts)).out

    for command in ("torque", "accel", "energy", "reactions", "points", "regressor"):
        whole = piped(command)
        assert len(whole.splitlines()) == 211
        assert piped(command, 1, 2, 1, 1, 3, 1) == whole, command


def test_a_call_does_not_depend_on_larger_ones_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large calls go through machine code, whose last digits are others."""
    monkeypatch.setattr(batches, "WORTH", 3e5)
    rng = np.random.default_rng(3)
    arm = rd.load(ROOT / "robots/3r.yaml")
    few, many = rng.normal(size=(3, 300, 3)), rng.normal(size=(3, 5000, 3))
    calls = (
        rd.inverse_dynamics,
        rd.forward_dynamics,
        lambda *x: rd.forward_dynamics_derivatives(*x)[1],
        lambda *x: rd.regressor(*x).Y,
    )
    before = [call(arm, *few) for call in calls]
    for call in calls:
        call(arm, *many)
    after = [call(arm, *few) for call in calls]
    assert all(map(np.array_equal, before, after))


@pytest.mark.parametrize("method", METHODS)
def test_a_run_does_not_depend_on_those_before(method: str, scene: Callable[[str], Path]) -> None:
    """What it met of change points, and how many steps it took, tells the next one nothing."""
    mechanism = rd.load(scene(near_miss()))
    ends = []
    for crank, rate, t_end in ((1.0, -8.0, 0.14), (0.7, -9.0, 0.1), (1.0, -8.0, 0.14)):
        q = rd.assemble(mechanism, [crank])
        qd = rd.loop_velocities(mechanism, q, [rate])
        motion = rd.simulate(mechanism, q, qd, t_end, method=method, rtol=1e-6, atol=1e-6)
        ends.append([motion.t.tolist(), motion.q.tolist(), motion.qd.tolist()])
    assert ends[0] == ends[2]


def test_a_run_by_series_does_not_depend_on_long_ones_before() -> None:
    arm = rd.load(ROOT / "robots/2r.yaml")
    short, *_, again = (
        rd.simulate(arm, [0.3, 1.4], [0.0, 0.0], t_end, method="taylor")
        for t_end in (1, *[30] * 15, 1)
    )
    assert short.t.tolist() == again.t.tolist()
    assert short.q.tolist() == again.q.tolist()


COMMANDS = """
accel four-bar --q 60deg --qd 5 --tau 1
assemble four-bar --q 60deg
check four-bar
energy 2r --q 30deg,45deg --qd 1,0.5
equations 2r
equilibrium spring-slider-crank --q 100deg
linearize 2r --q 30deg,45deg
reactions four-bar --q 60deg --qd 5
regressor 2r --q 30deg,45deg --qd 1,0.5 --qdd 1,2
terms 2r --q 30deg,45deg --qd 1,0.5
torque 2r --q 30deg,45deg --qd 1,0.5
trajectory four-bar --speed 60rpm --turns 1 --points 21
points four-bar --q 60deg --qd 5
export 2r --format mjcf --q 0,0
identify 2r DATA --of links.forearm.m
fit 2r --match DATA --columns tau1 --vary links.forearm.m=0.5:1.5 --starts 2
draw 2r --q 0.3,1 --forces -o FOLDER/drawn.svg
plot DATA --model 2r -o FOLDER/plotted.svg
animate 2r DATA -o FOLDER/moving.html
sweep 2r --vary q1=0:1:5 --q 0,0.2 --time 0.3
sweep parallelogram --vary q1=0.4:0.6:2 --qd -5 --time 0.2 --result events --event a=qd1
sweep MISS --kind torque --vary q1=0.001:0.1:7 --qd 1
simulate 2r --q 0.3,80deg --time 0.3 --points 9 --event a=qd1 --columns t,power,tip2_kappa,icx2
summary DATA
simulate 2r --q 0.3,80deg --time 0.3 --method taylor --event a=qd1 --sensitivity q1 --points 5
simulate 2r --q 0.3,80deg --time 2 --method taylor --points 5 --until qd1>10
simulate four-bar --q 60deg --qd 5 --time 0.3 --accuracy 1e-8 --points 3
simulate four-bar --q 60deg --qd 5 --time 0.3 --method taylor --estimate-error --points 3
"""


def known_of(outcome: Outcome, folder: Path) -> tuple[object, ...]:
    """Return what a call wrote: stdout, what it tells of its error, files, which are removed."""
    told = [line for line in outcome.err.splitlines() if line.startswith("error of")]
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    for path in folder.iterdir():
        path.unlink()
    return outcome.out, told, files


def test_each_command_twice(
    robodyn: Run, scene: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one process, in the other order, and after a clock that runs wild."""
    model, data, folder = scene(near_miss()), tmp_path / "data.csv", tmp_path / "written"
    folder.mkdir()
    arm = rd.load(ROOT / "robots/2r.yaml")
    t = np.linspace(0.0, 1.0, 21)[:, None]
    motion = [np.sin([2, 3] * t), [2, 3] * np.cos([2, 3] * t), [-4, -9] * np.sin([2, 3] * t)]
    names = ["t", *(f"{x}{k}" for x in ("q", "qd", "qdd", "tau") for k in (1, 2))]
    data.write_text(table(names, np.hstack([t, *motion, rd.inverse_dynamics(arm, *motion)])))
    words = {"MISS": str(model), "DATA": str(data), "FOLDER": str(folder)}
    text = re.sub("|".join(words), lambda word: words[word[0]], COMMANDS)
    lines = [shlex.split(line) for line in text.split("\n") if line]
    without = {"init", "schema", "guide", "bench"}  # no mechanism; bench tells how long it takes
    assert {line[0] for line in lines} == set(cli.COMMANDS) - without
    run = shlex.split(f"simulate {model} --q 1 --qd=-8 --time 0.14 --rtol 1e-6 --atol 1e-6")
    lines += [[*run, "--method", method] for method in METHODS]
    first = []
    for line in lines:
        outcome = robodyn(*line)
        assert outcome.code == 0, outcome.err
        first.append(known_of(outcome, folder))
    clock = itertools.count(0.0, 3.0)
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    for line, known in reversed(list(zip(lines, first, strict=True))):
        assert known_of(robodyn(*line), folder) == known, line
