"""Manners of the command line: pipes, files, signals, help.

What only a process shows is asked of a process; the rest is run in this one.
"""

from __future__ import annotations

import io
import os
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import FRESH, ROOT, TWO_LINK, Outcome, relative_error
from terminals import on_terminal

import oracles
from robodyn import cli

Run = Callable[..., Outcome]
PATIENCE = 30.0  # s, on a busy machine; nothing here takes one second
GENERATE = """awk 'BEGIN {print "q1,q2"; for (i = 0; i < %d; i++) print i/1e4 "," i/5e3}'"""
COMMANDS = {
    "torque": "robodyn torque robots/2r.yaml --q 1,2",
    "accel": "robodyn accel robots/2r.yaml --q 1,2",
    "reactions": "robodyn reactions robots/2r.yaml --q 1,2",
    "terms": "robodyn terms robots/2r.yaml --q 1,2",
    "assemble": "robodyn assemble robots/four-bar.yaml --q 1",
    "energy": "robodyn energy robots/2r.yaml --q 1,2",
    "check": "robodyn check robots/pendulum.yaml",
    "trajectory": "robodyn trajectory robots/2r.yaml --from 0,0 --to 1,2 --time 1",
}
BATCHES = ("torque", "accel", "reactions", "energy")


MANY_ROWS = "q1,q2\n" + "".join(f"{k / 1e4},{k / 5e3}\n" for k in range(20_000))


def words(line: str) -> list[str]:
    """The arguments of a line without pipes, after `robodyn`."""
    first, *rest = shlex.split(line)
    assert first == "robodyn"
    return rest


def gravity(q1: float, q2: float) -> list[float]:
    """Torques that hold the 2R arm still."""
    return list(oracles.two_link_terms(TWO_LINK, [q1, q2], [0, 0])[2])


# Pipes


@pytest.mark.parametrize("command", BATCHES if FRESH else BATCHES[::2])
def test_head_ends_a_long_table_quietly(shell: Run, command: str) -> None:
    line = f"{GENERATE % 100_000} 2>/dev/null | robodyn {command} robots/2r.yaml - | head -1"
    given = shell(f"{line}; echo ${{PIPESTATUS[1]}} ${{PIPESTATUS[2]}}")
    header, codes = given.out.splitlines()
    assert header.startswith("q1,q2,")
    assert codes == "0 0"
    assert given.err == ""


def test_head_with_pipefail(shell: Run, tmp_path: Path) -> None:
    """The file is read by robodyn itself, so that only its own exit code counts."""
    states = tmp_path / "states.csv"
    states.write_text("q1,q2\n" + "".join(f"{k / 1e4},{-k / 5e3}\n" for k in range(100_000)))
    for format, first in (("csv", "q1,q2,tau1,tau2\n"), ("json", "[\n")):
        given = shell(f"robodyn torque robots/2r.yaml {states} --format {format} | head -1")
        assert given.succeeds().out == first


@pytest.mark.parametrize(
    "line",
    [
        *(line for name, line in COMMANDS.items() if FRESH or name not in BATCHES[1:]),
        *(f"{COMMANDS[name]} --format table" for name in ("torque", "terms")[: 1 + FRESH]),
        *("robodyn torque --help", "robodyn --version"),
    ],
)
def test_a_pipe_that_is_closed_already(shell: Run, line: str) -> None:
    given = shell(f"{{ sleep 0.1; {line}; echo $? >&2; }} | exec 0<&-")
    assert given.err == "0\n"


def test_a_pipe_of_two_commands(quick_shell: Run) -> None:
    """Energy of states that passed through torque, columns and all."""
    states = "printf 'q1,note,q2\\n0.3,a b,-0.7\\n'"
    line = f"{states} | robodyn torque robots/2r.yaml - | robodyn energy robots/2r.yaml -"
    given = quick_shell(line)
    (row,) = given.succeeds().rows
    assert list(row) == ["q1", "note", "q2", "tau1", "tau2", "KE", "PE", "energy"]
    assert row["note"] == "a b"
    assert relative_error([float(row["tau1"]), float(row["tau2"])], gravity(0.3, -0.7)) < 1e-13


def test_floats_make_the_round_trip(robodyn: Run) -> None:
    """What one command writes the next reads to the last bit."""
    state = ("--q", "0.1,0.2", "--qd", "1,-1")
    one = robodyn("torque", "robots/2r.yaml", *state, "--qdd", "0.3,0.7").succeeds()
    given = robodyn("accel", "robots/2r.yaml", "-", *state, stdin=one.out).succeeds()
    assert given.out.splitlines()[1].startswith(one.out.splitlines()[1] + ",")
    found = [float(given.rows[0][name]) for name in ("qdd1", "qdd2")]
    assert relative_error(found, [0.3, 0.7]) < 1e-13


@pytest.mark.parametrize("command", COMMANDS)
def test_json_of_every_command_is_json(robodyn: Run, command: str) -> None:
    assert robodyn(*words(COMMANDS[command]), "--format", "json").succeeds().json


def test_json_of_a_batch_is_json(robodyn: Run) -> None:
    states = "q1,q2\n0,0\n0.0001,0.0002\n0.0002,0.0004\n"
    given = robodyn("torque", "robots/2r.yaml", "-", "--format", "json", stdin=states)
    rows: Any = given.succeeds().json
    assert [row["q1"] for row in rows] == [0, 0.0001, 0.0002]
    assert relative_error([rows[2]["tau1"], rows[2]["tau2"]], gravity(0.0002, 0.0004)) < 1e-13


def test_structured_commands_speak_json_in_a_pipe(robodyn: Run) -> None:
    for command in ("terms", "check"):
        assert isinstance(robodyn(*words(COMMANDS[command])).succeeds().json, dict)


def test_degrees_and_negative_vectors(robodyn: Run) -> None:
    for q, radians in (
        ("-0.5,-1", (-0.5, -1)),
        ("-0.5 -1", (-0.5, -1)),
        ("30deg,-pi/4", (np.pi / 6, -np.pi / 4)),
        ("-90deg,2*pi/3", (-np.pi / 2, 2 * np.pi / 3)),
    ):
        given = robodyn("torque", "robots/2r.yaml", "--q", q).succeeds()
        assert relative_error(given.has("tau1", "tau2"), gravity(*radians)) < 1e-13


def test_columns_in_any_order_and_unknown_columns(robodyn: Run) -> None:
    given = robodyn("torque", "robots/2r.yaml", "-", stdin="b,q2,a,q1\nx,-0.4, y ,0.3\n")
    header, row = given.succeeds().out.splitlines()
    assert header == "b,q2,a,q1,tau1,tau2"
    assert row.startswith("x,-0.4, y ,0.3,")
    assert relative_error([float(x) for x in row.split(",")[4:]], gravity(0.3, -0.4)) < 1e-13


def test_a_bad_row_names_its_line_and_the_rows_before_it_are_delivered(robodyn: Run) -> None:
    bad = MANY_ROWS + "1,oops\n3,4\n"
    given = robodyn("torque", "robots/2r.yaml", "-", stdin=bad)
    given.fails(2, "stdin: line 20002: q2 = oops")
    assert given.out.splitlines()[-1].startswith("1.9999,3.9998,")


def test_stdin_may_be_closed(shell: Run) -> None:
    given = shell("robodyn torque robots/2r.yaml - <&-")
    assert given.fails(2, "stdin").out == ""


def test_stdout_may_be_closed(shell: Run) -> None:
    """There is nowhere to write to: a failure, but no defect of robodyn's."""
    shell("robodyn torque robots/2r.yaml --q 1,2 >&-").fails(1, "stdout")


def test_an_interrupt_while_modules_are_loaded(tmp_path: Path) -> None:
    """Ctrl-C before the command line is there ends the process without Python's traceback."""
    code = """
import os, signal, sys
class Interrupted:
    def find_spec(self, name, *_):
        if name == "typer":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupted())
from robodyn.__main__ import main
main()
"""
    command = [sys.executable, "-c", code, "--version"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_stderr_may_be_closed(shell: Run) -> None:
    assert shell("robodyn torque robots/2r.yaml --q 1,2 2>&-").succeeds().out != ""


@pytest.mark.parametrize(
    "line",
    [
        *(COMMANDS[name] for name in ("torque", "terms", "trajectory")),
        "robodyn torque -h",
    ],
)
def test_a_full_disk_is_told(shell: Run, line: str) -> None:
    shell(f"{line} >/dev/full").fails(1, "No space left on device")


def test_a_scene_may_come_through_a_pipe(quick_shell: Run) -> None:
    given = quick_shell("cat robots/2r.yaml | robodyn torque /dev/stdin --q 0.1,0.2").succeeds()
    assert relative_error(given.has("tau1", "tau2"), gravity(0.1, 0.2)) < 1e-13


@pytest.mark.parametrize("locale", ["C", "C.UTF-8"] if FRESH else ["C"])
def test_names_beyond_ascii_in_any_locale(shell: Run, tmp_path: Path, locale: str) -> None:
    path = tmp_path / "Kölbchen модель.yaml"
    path.write_text("name: Bär\nlinks: [{name: Ärmel ☃, m: 1, l: 1, r: 0.5, I: 0.1}]\n", "utf-8")
    settings = {"LC_ALL": locale, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    table = shell(f"robodyn assemble '{path}' --q 1 --format table", env=settings)
    assert table.code == 0
    assert "1 Ärmel ☃" in table.out
    shell(f"robodyn torque '{path}' --q 1,2", env=settings).fails(2, "--q", "2 values")


# Streaming


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A robodyn that reads stdin, from which we keep writing."""
    child = subprocess.Popen(
        [sys.executable, "-m", "robodyn", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        bufsize=0,
    )
    try:
        yield child
    finally:
        child.kill()
        child.wait()
        for stream in (child.stdin, child.stdout, child.stderr):
            assert stream is not None
            stream.close()


def send(child: subprocess.Popen[bytes], text: str) -> None:
    assert child.stdin is not None
    child.stdin.write(text.encode())


def receive(child: subprocess.Popen[bytes], lines: int) -> list[str]:
    """So many lines of stdout, which must come while stdin is still open."""
    assert child.stdout is not None
    data = b""
    deadline = time.monotonic() + PATIENCE
    while data.count(b"\n") < lines:
        ready, _, _ = select.select([child.stdout], [], [], deadline - time.monotonic())
        assert ready, f"only this came: {data!r}"
        piece = os.read(child.stdout.fileno(), 65536)
        assert piece, f"only this came: {data!r}"
        data += piece
    return data.decode().splitlines()


@pytest.mark.parametrize("command", BATCHES if FRESH else BATCHES[::2])
def test_a_slow_producers_rows_come_out_as_they_come_in(command: str) -> None:
    with running(command, "robots/2r.yaml", "-") as child:
        send(child, "q1,q2\n")
        assert receive(child, 1)[0].startswith("q1,q2,")
        for k in range(3):
            send(child, f"{k},0.5\n")
            (line,) = receive(child, 1)
            assert line.startswith(f"{k},0.5,")
        send(child, "9,0.5\n7,0.")  # a row of which the end has not come yet
        (line,) = receive(child, 1)
        assert line.startswith("9,0.5,")
        send(child, "25\n")
        (line,) = receive(child, 1)
        assert line.startswith("7,0.25,")


def test_json_rows_stream_too() -> None:
    with running("torque", "robots/2r.yaml", "-", "--format", "json") as child:
        send(child, "q1,q2\n1,2\n3,4\n5,6\n")
        lines = receive(child, 3)
        assert lines[0] == "["
        assert '"q1": 1' in lines[1]


def test_a_fault_is_told_before_the_input_ends() -> None:
    with running("torque", "robots/2r.yaml", "-") as child:
        send(child, "q1,q2\n1,2\nx,2\n")
        assert child.wait(PATIENCE) == 2
        assert child.stderr is not None
        assert b"line 3: q1 = x" in child.stderr.read()


# A child of a large process starts with that process's peak memory: a small one stands between.
MEASURE = """
import os, subprocess, sys
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
print(status, usage.ru_maxrss)
"""


def peak_memory(*arguments: object) -> int:
    """Peak resident memory of a robodyn, KiB."""
    robodyn = [sys.executable, "-m", "robodyn", *map(str, arguments)]
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, *robodyn], capture_output=True, cwd=ROOT, timeout=120
    )
    status, peak = map(int, done.stdout.split())
    assert status == 0, done.stderr
    return peak


@pytest.mark.parametrize("format", ["csv", "json"])
def test_memory_does_not_grow_with_the_file(tmp_path: Path, format: str) -> None:
    """50 000 rows are 2.2 MB of text; kept as Python strings and floats they would be 15 MB."""
    peaks = []
    for count in (5_000, 50_000):
        states = tmp_path / f"{count}.csv"
        rows = (f"{k},{k * 1.1e-3!r},{-k * 7.7e-4!r}\n" for k in range(count))
        states.write_text("t,q1,q2\n" + "".join(rows))
        peaks.append(peak_memory("torque", "robots/2r.yaml", states, "--format", format))
    assert peaks[1] - peaks[0] < 4 * 1024


# What a command imports

IMPORTS = """
import io, shlex, sys
from robodyn import cli
for line in sys.argv[1:]:
    sys.stdin = io.TextIOWrapper(io.BytesIO(b"q1,q2\\n1,2\\n"))
    assert cli.run(shlex.split(line)) == 0, line
print(*sorted({name.split(".")[0] for name in sys.modules}), file=sys.stderr)
"""


def imported(*lines: str) -> set[str]:
    """The packages that commands, one after the other in one process, import."""
    done = subprocess.run(
        [sys.executable, "-c", IMPORTS, *lines],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    names = set(done.stderr.split())
    assert "robodyn" in names
    return names


def test_scipy_is_for_simulations_and_rich_for_terminals() -> None:
    names = imported(
        "torque robots/2r.yaml -",
        "torque robots/2r.yaml --q 0.1,0.2 --qd 1,2 --qdd 0,0",
        "torque robots/four-bar.yaml --q 1",
        "accel robots/2r.yaml -",
        "energy robots/2r.yaml -",
        "terms robots/2r.yaml --q 1,2",
        "assemble robots/four-bar.yaml --q 1",
    )
    assert "numpy" in names
    assert not names & {"scipy", "rich", "matplotlib", "sympy"}


# --out


@pytest.mark.parametrize(
    ("line", "stdin", "code"),
    [
        ("torque robots/2r.yaml -", "q1,q2\n1,2\n3,x\n", 2),
        ("energy robots/2r.yaml -", MANY_ROWS + "1,x\n", 2),
        ("torque robots/parallelogram.yaml --q 0", "", 1),
        ("assemble robots/parallelogram.yaml --q 0 --qd 1", "", 1),
    ],
)
def test_upon_failure_out_leaves_an_older_file_as_it_was(
    robodyn: Run, tmp_path: Path, line: str, stdin: str, code: int
) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_text("precious\n")
    old.chmod(0o640)
    for file in (old, new):
        assert robodyn(*line.split(), "--out", file, stdin=stdin).fails(code).out == ""
    assert old.read_text() == "precious\n"
    assert old.stat().st_mode & 0o777 == 0o640
    assert list(tmp_path.iterdir()) == [old]


def test_out_replaces_an_older_file_and_keeps_its_mode(robodyn: Run, tmp_path: Path) -> None:
    file = tmp_path / "old"
    file.write_text("x" * 100_000)
    file.chmod(0o640)
    robodyn("torque", "robots/2r.yaml", "--q", "1,2", "-o", file).succeeds()
    assert file.read_text().startswith("tau1,tau2\n")
    assert file.stat().st_mode & 0o777 == 0o640
    assert list(tmp_path.iterdir()) == [file]


def test_out_into_a_pipe(shell: Run, tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    given = shell(f"cat '{fifo}' & robodyn torque robots/2r.yaml --q 1,2 -o '{fifo}'; wait")
    assert relative_error(given.succeeds().has("tau1", "tau2"), gravity(1, 2)) < 1e-13
    assert fifo.is_fifo()


# A full disk: the shell's limit on the size of a file fails a write in the same way


STATES = "(echo t,q1,q2; seq 3000 | sed 's/.*/&,1,2/')"
FULL = {
    "rows": f"{STATES} | robodyn torque robots/2r.yaml - -o FILE.csv",
    "json": f"{STATES} | robodyn torque robots/2r.yaml - --format json -o FILE.json",
    "text": "robodyn equations robots/four-bar.yaml --format c -o FILE.c",
    "schema": "robodyn schema -o FILE.json",
    "report": "robodyn simulate robots/2r.yaml --q 1,2 --points 9 -o FILE.csv --quiet",
    "svg": "robodyn draw robots/2r.yaml --q 1,2 -o FILE.svg",
    "png": "robodyn draw robots/2r.yaml --q 1,2 -o FILE.png",
    "html": "printf 't,q1,q2\\n0,0,0\\n9,1,2\\n' | robodyn animate robots/2r.yaml - -o FILE.html",
    "gif": "printf 't,q1,q2\\n0,0,0\\n1,1,2\\n' | robodyn animate robots/2r.yaml - -o FILE.gif",
    "sweep": "robodyn sweep robots/2r.yaml --vary q1=0:1:99 --time 0.1 -o FILE.csv --quiet",
}


@pytest.mark.parametrize("kind", [x for x in FULL if FRESH or x != "svg"])
def test_a_full_disk_is_told_with_the_files_name(
    shell: Run, quick_shell: Run, tmp_path: Path, kind: str
) -> None:
    """The text by a process of its own, the others by copies of one that has started."""
    line, run = FULL[kind], shell if kind == "text" else quick_shell
    if line.endswith(("svg", "png", "gif")):
        pytest.importorskip("matplotlib", reason="the extra `plot` is not installed")
    old = tmp_path / f"run.{line.split('FILE.')[1].split()[0]}"
    old.write_text("precious\n")
    given = run(f"ulimit -f 1; {line.replace('FILE', str(tmp_path / 'run'))}")
    assert given.code in (1, 2)
    assert re.search(rf"^Error: {re.escape(str(old))}.*: file too large", given.err, re.I | re.M)
    assert "Traceback" not in given.err
    assert old.read_text() == "precious\n"
    kept = {f"{old.name}.partial{end}" for end in ("", ".json", ".sums")}
    assert {entry.name for entry in tmp_path.iterdir()} - kept == {old.name}
    assert "simulate" in line or "sweep" in line or list(tmp_path.iterdir()) == [old]


def test_a_full_device_is_named_and_a_full_stdout_told(shell: Run) -> None:
    line = "robodyn torque robots/2r.yaml --q 1,2"
    shell(f"{line} -o /dev/full").fails(1, "/dev/full: No space left")
    shell("robodyn schema >/dev/full").fails(1, "Error: No space left")


# Signals


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU])
def test_a_signal_leaves_no_file_behind(tmp_path: Path, number: signal.Signals) -> None:
    with running("torque", "robots/2r.yaml", "-", "-o", str(tmp_path / "states.csv")) as child:
        send(child, "q1,q2\n1,2\n")
        deadline = time.monotonic() + PATIENCE
        while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.01)
        child.send_signal(number)
        assert child.wait(PATIENCE) in (128 + number, -number)
        assert child.stderr is not None
        assert child.stderr.read() == b""
    assert list(tmp_path.iterdir()) == []


def test_a_signal_that_is_ignored_stays_ignored(shell: Run, tmp_path: Path) -> None:
    file = tmp_path / "states.csv"
    given = shell(
        "trap '' HUP; (echo q1,q2; echo 1,2; sleep 2; echo 3,4) |"
        f" robodyn torque robots/2r.yaml - -o '{file}' & sleep 1; kill -HUP $!; wait $!"
    )
    assert given.code == 0
    assert len(file.read_text().splitlines()) == 3


@pytest.mark.parametrize("out", [[], ["--out", "states.csv"]])
def test_ctrl_c_ends_quietly(tmp_path: Path, out: list[str]) -> None:
    if out:
        out = ["--out", str(tmp_path / out[1])]
    with running("torque", "robots/2r.yaml", "-", *out) as child:
        send(child, "q1,q2\n1,2\n")
        if out:
            deadline = time.monotonic() + PATIENCE
            while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
                time.sleep(0.01)
        else:
            receive(child, 2)
        child.send_signal(signal.SIGINT)
        # 130, or what a shell tells as 130: CPython's own end if it comes inside of an exec(text)
        assert child.wait(PATIENCE) in (130, -signal.SIGINT)
        assert child.stderr is not None
        assert child.stderr.read() in (b"", b"\n")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_while_a_command_is_imported_ends_quietly(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "import_module", interrupted)
    code = None
    try:
        code = cli.run(["torque", "robots/2r.yaml", "--q", "1,2"])
    except KeyboardInterrupt:
        pytest.fail("it would end in a traceback")
    assert code == 130
    assert "Traceback" not in capfd.readouterr().err


# Terminals


@pytest.mark.parametrize("columns", [10**20, 0, -5])
def test_a_size_that_no_terminal_has(columns: int) -> None:
    assert "torque" in on_terminal("--help", columns=columns)


def test_a_result_on_a_terminal_is_a_table() -> None:
    shown = on_terminal("torque", "robots/2r.yaml", "--q", "1,2")
    assert "tau1 [N m]" in shown
    assert f"{gravity(1, 2)[0]:.6g}" in shown
    assert "tau1,tau2" not in shown


def test_format_forces_a_form_on_a_terminal() -> None:
    shown = on_terminal("torque", "robots/2r.yaml", "--q", "1,2", "--format", "csv")
    header, row = shown.splitlines()
    assert header == "tau1,tau2"
    assert relative_error([float(x) for x in row.split(",")], gravity(1, 2)) < 1e-13


ROWS_AS_THEY_COME = {
    "sweep": ("sweep", "robots/2r.yaml", "--vary", "q1=0:90deg:3", "--time", "1"),
    "simulate": ("simulate", "robots/2r.yaml", "--q", "1,2", "--time", "1"),
    "trajectory": ("trajectory", "robots/2r.yaml", "--from", "0,0", "--to", "1,2", "--time", "1"),
}


@pytest.mark.parametrize("name", ROWS_AS_THEY_COME)
def test_no_progress_bar_among_rows_on_a_terminal(shell: Run, name: str) -> None:
    """A bar is for rows that go elsewhere."""
    code = "import sys; from robodyn.cli import progress; progress.SILENT = 0.0; "
    code += "from robodyn import cli; sys.exit(cli.run(sys.argv[1:]))"
    spawn = "import pty, sys; pty.spawn([sys.executable, *sys.argv[1:]])"
    line = f"{sys.executable} -c {spawn!r} -c {code!r} {shlex.join(ROWS_AS_THEY_COME[name])}"
    bar = re.compile("sweeping|simulating|writing")
    for more in (), ("-o", "-"):
        shown = shell(f"{line} {' '.join(more)} < /dev/null").succeeds().out
        assert not bar.search(shown)


@pytest.mark.parametrize("columns", [80, 40])
def test_a_narrow_terminal_hides_no_digit(robodyn: Run, columns: int) -> None:
    arguments = ("accel", "robots/five-bar.yaml", "--q", "120deg,60deg")
    shown = on_terminal(*arguments, columns=columns)
    assert "…" not in shown
    for value in robodyn(*arguments).succeeds().row.values():
        assert f"{value:.6g}" in shown


def test_sentences_in_a_table_break_between_words(robodyn: Run) -> None:
    shown = re.sub(r"\x1b\[[\d;]*m", "", on_terminal("init", columns=60))
    assert max(map(len, shown.splitlines())) <= 60
    words = shown.split()
    for row in robodyn("init", "--format", "csv").succeeds().rows:
        assert f" {row['name']} {row['scene']} " in f" {' '.join(words)} "


# Help


@pytest.mark.parametrize("command", ["", *cli.COMMANDS])
def test_help_holds_an_example_also_in_a_pipe(robodyn: Run, command: str) -> None:
    shown = [robodyn(*command.split(), flag).succeeds().out for flag in ("-h", "--help")]
    assert shown[0] == shown[1]
    example = shown[0].split("Example", 1)[1].splitlines()[1].strip()
    assert example.startswith(f"robodyn {command}".strip())
    assert "\x1b" not in shown[0]


def test_help_in_a_pipe_has_no_colours(shell: Run) -> None:
    assert "\x1b" not in shell("robodyn --help | cat").succeeds().out


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_the_examples_of_the_help_work(
    robodyn: Run, quick_shell: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """Without a file of this project; those that begin with a file of states are given one."""
    text = robodyn(command, "--help").succeeds().out.replace("\\\n", " ")
    lines = [line.strip() for line in text.splitlines() if line.strip().startswith("robodyn ")]
    assert len(lines) >= 2
    for name in ("states.csv", "motion.csv"):
        (tmp_path / name).write_text("t,q1,q2,qd1,qd2\n0,0.1,0.2,0.3,0.4\n1,0.2,0.3,0.4,0.5\n")
    monkeypatch.chdir(tmp_path)
    for line in lines:
        if any(mark in line for mark in "<>") or ("| robodyn" not in line and "|" in line):
            given = quick_shell(line, cwd=tmp_path)
        else:
            given = Outcome(0, "", "")
            for part in line.split(" | "):
                given = robodyn(*words(part), stdin=given.out)
        assert (given.code, "Error" in given.err) == (0, False)
        assert given.out != ""


def test_no_command_shows_the_help_and_is_a_fault_of_usage(shell: Run) -> None:
    given = shell("robodyn")
    assert given.code == 2
    assert "Example" in given.out + given.err


def test_version(shell: Run) -> None:
    from robodyn import __version__

    assert shell("robodyn --version").succeeds().out == f"robodyn {__version__}\n"
    assert shell("python -m robodyn --version").succeeds().out == f"robodyn {__version__}\n"


# Exit codes, and never a traceback


@pytest.mark.parametrize(
    ("code", "line"),
    [
        *((0, line) for line in COMMANDS.values()),
        (1, "robodyn torque robots/parallelogram.yaml --q 0 --qd 1"),
        (1, "robodyn assemble robots/parallelogram.yaml --q 180deg --qd 1"),
        (2, "robodyn nonsense"),
        (2, "robodyn --nonsense"),
        (2, "robodyn torque"),
        (2, "robodyn torque robots/none.yaml --q 1"),
        (2, "robodyn torque robots --q 1"),
        (2, "robodyn torque /dev/null --q 1"),
        (2, "robodyn torque .venv/bin/python --q 1"),
        (2, "robodyn torque robots/2r.yaml --q 1,2 --qd"),
        (2, "robodyn torque robots/2r.yaml robots/2r.yaml"),
        (2, "robodyn torque robots/2r.yaml /dev/null"),
        (2, "robodyn torque robots/2r.yaml - </dev/urandom"),
        (2, "head -c 3000000 /dev/zero | robodyn torque robots/2r.yaml -"),
        (2, "robodyn torque robots/2r.yaml $'\\xff.csv'"),
        (2, "robodyn torque $'\\xff.yaml' --q 1"),
        (2, "robodyn torque robots/2r.yaml --q $'\\xff'"),
        (2, "robodyn torque robots/2r.yaml --q $(seq -s, 1 20000)"),
    ],
)
def test_exit_codes(robodyn: Run, shell: Run, code: int, line: str) -> None:
    given = shell(line) if any(mark in line for mark in "|<$") else robodyn(*words(line))
    assert given.code == code
    for word in ("Traceback", "defect", "RuntimeWarning"):
        assert word not in given.out + given.err
    assert len(given.err) < 2000
    if code:
        assert "Error: " in given.err
        assert given.out == ""


def test_debug_shows_the_traceback(shell: Run) -> None:
    given = shell("robodyn --debug torque robots/2r.yaml --q 1")
    assert given.code != 0
    assert "Traceback" in given.err
    assert "InputError" in given.err


@pytest.mark.parametrize(
    "line",
    [
        "simulate robots/four-bar.yaml --q 60deg --time 1 --points 5 --quiet",
        "trajectory robots/2r.yaml --from 0,0 --to 1,2 --time 1 --points 5",
        "sweep robots/2r.yaml --vary q1=0:1:3 --time 0.5 --result final,flip --quiet",
    ],
)
def test_tables_load_where_they_are_wanted(robodyn: Run, line: str) -> None:
    """One header line, the same number of fields in each row, numbers with decimal points."""
    given = robodyn(*line.split())
    table = np.genfromtxt(io.StringIO(given.out), delimiter=",", names=True, dtype=None)
    header = given.out.splitlines()[0].split(",")
    assert list(table.dtype.names) == header
    assert all(table[name].dtype.kind == "f" for name in header if name not in ("flip", "outcome"))
    assert "\r" not in given.out


def test_a_closed_stderr_costs_nothing(robodyn: Run, shell: Run) -> None:
    """Notes, errors and progress go nowhere: not among the results, and not in their way."""
    run = "robodyn simulate robots/2r.yaml --q 0,0 --time 0.1 --points 2"
    assert shell(f"{run} 2>&-").succeeds().out == robodyn(*words(run), "--quiet").out
    for refused in ("torque robots/2r.yaml --q 0,x", "check robots/2r.yaml --bad"):
        done = shell(f"robodyn {refused} 2>&-")
        assert (done.code, done.out) == (2, "")
