"""What the tests of the command line share: running it, in process and for real."""

from __future__ import annotations

import csv
import gc
import io
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from quick_robodyn import path_with_it

import oracles
from robodyn import cli

ROOT = Path(__file__).resolve().parent.parent

# random tests draw the same numbers in every run; FRESH=1 draws others, as `make hard` does
settings.register_profile("fixed", derandomize=True)
settings.register_profile("fresh", derandomize=False, print_blob=True)
FRESH = bool(os.environ.get("FRESH"))
settings.load_profile("fresh" if FRESH else "fixed")
# the first seed of tests that name their seeds: all workers, which inherit it, must name the same
FIRST_SEED = int(os.environ.setdefault("FIRST_SEED", str(random.randrange(10**6)))) if FRESH else 0

# machine code that tests make is kept, but not among the user's
os.environ["ROBODYN_CACHE"] = str(Path(tempfile.gettempdir()) / f"robodyn-tests-{os.geteuid()}")

# of the processor, s: ten times what the longest test takes; a loop without end is told by it
longest = [3600.0 if FRESH else 50.0]

# the files that take the longest, the longest first; the others follow by their number of tests
LONGEST = (
    "hard_cases", "readme", "every_format", "sensitivity", "engines", "cli_simulate",
    "near_misses", "accuracy", "simulation", "sweep", "contacts", "pipes", "cli_sweep",
    "sweep_columns", "task_space", "lanes", "torque_times", "extended", "fit", "prismatic",
    "time_scaling", "right_hand_side", "equations", "taylor_steps", "cli_draw", "derivatives",
    "identify", "equations_latex", "shown_text", "motors", "regressor", "contacts_mixed",
    "assembly", "signals", "feedback", "cli_bench",
)  # fmt: skip

# the scenes of robots/ as the oracles take them
TWO_LINK = oracles.TwoLink(
    *(1.5, 0.8, 0.36, 0.082),  # upper arm m, l, r, I
    *(0.9, 0.6, 0.25, 0.031),  # forearm
)
FOUR_BAR = oracles.FourBar(
    *(0.6, 0.35, 0.15, 0.008),  # crank m, l, r, I
    *(1.3, 0.95, 0.45, 0.102),  # coupler
    *(1.0, 0.80, 0.36, 0.061),  # rocker
    *(1.1, 0.0),  # ground pivot
)

# a boom that slides out of an arm that turns
RP_ARM = """
links:
  - {name: arm, m: 1.5, l: 0.3, r: 0.2, I: 0.05}
  - {name: boom, joint: prismatic, axis: [1, 0], m: 0.9, l: 0.5, r: 0.2, I: 0.03, damping: 3}
"""
# a crank that moves a yoke to and fro by a pin in its slot
SCOTCH_YOKE = """
links:
  - {name: crank, m: 0.8, l: 0.1, r: 0.03, I: 0.002}
  - {name: yoke, joint: prismatic, axis: [1, 0], m: 1.5, l: 0.2, r: 0.1, I: 0.01, from: [0.3, 0]}
closures:
  - {point: crank, on: {link: yoke, through: [-0.3, 0], along: [0, 1]}}
actuated: [crank]
"""


def pytest_configure(config: pytest.Config) -> None:
    for number in (signal.SIGINT, signal.SIGHUP):  # as `nohup` and `&` would hand them on
        if signal.getsignal(number) == signal.SIG_IGN:
            own = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
            signal.signal(number, own)
    text = "thinned: combinations of its parameters in which each value occurs; all with FRESH=1"
    config.addinivalue_line("markers", text)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files that take long come first; fewer combinations of parameters are kept.

    A worker takes whole files in this order: a long one taken last would leave the others idle.
    """
    count = Counter(item.path for item in items)
    place = {f"test_{name}": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda x: (place.get(x.path.stem, len(place)), -count[x.path], x.path))
    _thin(config, items)


def pytest_collection_finish() -> None:
    """Garbage is looked for rarely, and not among all that was imported: it takes long."""
    gc.freeze()
    gc.set_threshold(500_000, 50, 100)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """A test that does not end fails: a fault in the package must not hang the suite."""
    if not hasattr(signal, "setitimer"):
        return (yield)

    def ended(*_: object) -> None:
        longest.append(longest[-1] / 4.0)  # where one hangs, others may
        pytest.fail(f"{item.nodeid} took more than {longest[-2]:g} s of the processor")

    before = signal.signal(signal.SIGVTALRM, ended)
    signal.setitimer(signal.ITIMER_VIRTUAL, max(longest[-1], longest[0] / 8.0))
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def _thin(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of a test marked `thinned` the diagonal of the product of its parameters.

    Value k of the longest list meets value k, modulo their count, of the next one; a third goes on
    by one each time that the second begins again. A test asked for by its name runs in full.
    """
    if FRESH or any("::" in argument for argument in config.args):
        return
    tests: dict[str, list[tuple[pytest.Item, list[tuple[int, ...]]]]] = {}
    for item in items:
        if item.get_closest_marker("thinned"):
            tests.setdefault(item.nodeid.partition("[")[0], []).append((item, _values(item)))
    left = set()
    for found in tests.values():
        values = [list(dict.fromkeys(each)) for each in zip(*(x for _, x in found), strict=True)]
        order = sorted(range(len(values)), key=lambda j: -len(values[j]))
        diagonal = []
        for k in range(len(values[order[0]])):
            chosen, place = {}, k
            for j in order:
                chosen[j] = values[j][place % len(values[j])]
                place += 0 if j == order[0] else k // len(values[j])  # else lists go in step
            diagonal.append([chosen[j] for j in range(len(values))])
        left |= {item for item, x in found if x not in diagonal}
    config.hook.pytest_deselected(items=list(left))
    items[:] = [item for item in items if item not in left]


def _values(item: pytest.Item) -> list[tuple[int, ...]]:
    """Of each list of parameters that a test has, which values it is run with."""
    found = []
    for mark in item.iter_markers("parametrize"):
        names = mark.args[0].split(",") if isinstance(mark.args[0], str) else mark.args[0]
        params = item.callspec.params  # type: ignore[attr-defined]
        found.append(tuple(id(params[name.strip()]) for name in names))
    return found


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Assert that a block takes no more of the processor: far more than it needs anywhere."""
    start = time.process_time()
    yield
    assert time.process_time() - start < seconds


def text(vector: object) -> str:
    """As options take it, every number to its last digit."""
    return ",".join(repr(float(x)) for x in np.ravel(vector))


def relative_error(actual: object, expected: object) -> float:
    """The largest difference, against the largest entry expected (at least 1)."""
    found, known = np.asarray(actual, float), np.asarray(expected, float)
    assert found.shape == known.shape
    return float(np.abs(found - known).max() / max(1.0, np.abs(known).max()))


@dataclass(frozen=True)
class Outcome:
    """What one run of the command line left: exit code, stdout, stderr."""

    code: int
    out: str
    err: str
    seconds: float = 0.0  # of the processor, so that a busy machine does not count

    @property
    def rows(self) -> list[dict[str, str]]:
        """stdout as CSV rows."""
        return list(csv.DictReader(io.StringIO(self.out)))

    @property
    def row(self) -> dict[str, float]:
        """The one row of stdout as numbers."""
        (row,) = self.rows
        return {name: float(text) for name, text in row.items()}

    @property
    def json(self) -> object:
        """stdout as strict JSON, which knows no NaN and no Infinity."""
        return json.loads(self.out, parse_constant=_no_constant)

    def column(self, name: str) -> list[float]:
        return [float(row[name]) for row in self.rows]

    def has(self, *names: str) -> list[float]:
        """The values of these columns in the one row."""
        return [self.row[name] for name in names]

    def fails(self, code: int, *parts: str) -> Outcome:
        """Assert this exit code and a message on stderr, fit for people, with all these parts."""
        assert self.code == code, (self.code, self.out, self.err)
        for part in parts:
            assert part in self.err, self.err
        assert self.err.startswith(("Error: ", "Usage: ", "Note: ", "Warning: ")), self.err
        assert self.err.endswith("\n")
        for word in ("Traceback", "defect", 'File "', "RuntimeWarning"):
            assert word not in self.err, self.err
        return self

    def succeeds(self) -> Outcome:
        """Assert exit code 0 and nothing on stderr."""
        assert self.code == 0, (self.code, self.err)
        assert self.err == ""
        return self

    def replaces(self) -> Outcome:
        """Assert exit code 0, and on stderr that columns of the input are replaced."""
        assert self.code == 0, (self.code, self.err)
        lines = self.err.splitlines()
        assert lines
        assert all(line.startswith("Note: replaced in the rows: ") for line in lines), self.err
        return self


def children_seconds() -> float:
    """The processor time that child processes took so far."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _no_constant(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


_commands: dict[object, object] = {}
_made_anew = cli._command


def _command_made_once(arguments: list[str], whole: bool) -> object:
    """The options of a command are the same each time; making them takes longer than most runs."""
    called = next((word for word in arguments if not word.startswith("-")), "")
    helps = sorted({"--help", "-h"}.intersection(arguments))
    key = called, tuple(helps), whole, sys.stdout.isatty(), cli.import_module
    if key not in _commands:
        _commands[key] = _made_anew(arguments, whole)
    return _commands[key]


@pytest.fixture
def robodyn(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Outcome]:
    """Run the command line in this process, from the project's root."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(cli, "_command", _command_made_once)

    def run(*arguments: object, stdin: str | bytes | io.BytesIO = b"") -> Outcome:
        data = stdin.encode() if isinstance(stdin, str) else stdin
        pipe = data if isinstance(data, io.BytesIO) else io.BytesIO(data)
        begin = time.process_time()
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(pipe))
        capfd.readouterr()
        code = cli.run([str(argument) for argument in arguments])
        sys.stdout.flush()
        return Outcome(code, *capfd.readouterr(), time.process_time() - begin)

    return run


@pytest.fixture
def process() -> Callable[..., Outcome]:
    """Run the command line as a process of its own, from the project's root."""

    def run(*arguments: object, stdin: str = "") -> Outcome:
        begin = children_seconds()
        done = subprocess.run(
            [sys.executable, "-m", "robodyn", *map(str, arguments)],
            input=stdin,
            capture_output=True,
            text=True,
            timeout=60,
            cwd=ROOT,
        )
        return Outcome(done.returncode, done.stdout, done.stderr, children_seconds() - begin)

    return run


@pytest.fixture
def shell() -> Callable[..., Outcome]:
    """Run a line of bash with pipefail set, `robodyn` being this project's."""

    def run(line: str, cwd: Path = ROOT, env: dict[str, str] | None = None) -> Outcome:
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        done = subprocess.run(
            ["bash", "-c", f"set -o pipefail\n{line}"],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=120,
            cwd=cwd,
            env={**os.environ, "PATH": path, **(env or {})},
        )
        return Outcome(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def quick_shell(shell: Callable[..., Outcome]) -> Callable[..., Outcome]:
    """As `shell`, but that `robodyn` is forked from a process that has imported it."""

    def run(line: str, cwd: Path = ROOT, env: dict[str, str] | None = None) -> Outcome:
        return shell(line, cwd, {"PATH": path_with_it(), **(env or {})})

    return run


@pytest.fixture
def scene(tmp_path: Path) -> Callable[[str | bytes], Path]:
    """Write a scene file; its path."""

    def write(text: str | bytes) -> Path:
        path = tmp_path / "scene.yaml"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


@pytest.fixture
def four_bar_text() -> str:
    """The scene file of the four-bar, for a change to it."""
    return (ROOT / "robots/four-bar.yaml").read_text()
