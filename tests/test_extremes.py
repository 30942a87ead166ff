"""`robodyn summary`: extremes in place of rows, against numpy on whole tables."""

from __future__ import annotations

import csv
import io
import json
import math
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from conftest import Outcome

from robodyn import cli
from robodyn.tables.summaries import EXTREMES, Extremes
from robodyn.tables.table_writer import WRITERS, Writer

Run = Callable[..., Outcome]
ARM = "robots/2r.yaml"
EQUALLY = "Note: there is no column t of numbers: rows count equally in mean and rms\n"


def known(rows: list[dict[str, str]]) -> dict[str, list[float | None]]:
    """What is to be told of each column, from the whole table."""
    columns: dict[str, np.ndarray] = {}
    for name in rows[0]:
        try:
            values = np.array([float(row[name]) for row in rows])
        except ValueError:
            continue
        if np.isfinite(values).all():
            columns[name] = values
    told: dict[str, list[float | None]] = {}
    for name, values in columns.items():
        if name == "t":
            continue
        found: list[float | None] = []
        for row in (int(np.argmin(values)), int(np.argmax(values))):
            there = (columns[x][row] if x in columns else None for x in ("t", "q1"))
            found += [float(values[row]), *(None if x is None else float(x) for x in there)]
        weights = np.ones(len(values))
        if "t" in columns and len(values) > 1:  # of trapezoids
            steps = np.diff(columns["t"])
            weights = np.append(steps, 0.0) + np.append(0.0, steps)
        mean, square = (math.fsum(weights * x) / math.fsum(weights) for x in (values, values**2))
        told[name] = [*found, mean, math.sqrt(square)]
    return told


def told_of(robodyn: Run, *command: object, stdin: str = "", **options: str) -> Outcome:
    """The summary of a command's rows, with its own options."""
    rows = robodyn(*command, stdin=stdin).out  # with a note of columns that are replaced
    more = [word for name, value in options.items() for word in (f"--{name}", value)]
    return robodyn("summary", *more, stdin=rows)


def assert_tells(found: list[dict[str, object]], rows: list[dict[str, str]]) -> None:
    """Ends and where they are to the last digit, mean and rms to rounding."""
    expected = known(rows)
    assert {line["column"] for line in found} == set(expected)
    assert len(found) == len(expected)
    for line in found:
        assert tuple(line) == EXTREMES
        values = [None if x in ("", None) else float(str(x)) for x in list(line.values())[1:]]
        ends = expected[str(line["column"])]
        assert values[:6] == ends[:6], line["column"]
        size = max(abs(float(x)) for x in (ends[0], ends[3]) if x is not None)
        for mine, other in zip(values[6:], ends[6:], strict=True):
            assert mine is not None
            assert other is not None
            assert abs(mine - other) <= 4e-15 * size, line["column"]


def table(seed: int, count: int) -> str:
    """A table of states and more: numbers in all notations, text, quotes, empty fields."""
    rng = np.random.default_rng(seed)
    names = ["t", "q2", "note", "q1", '"a, b"', "tau1", "qd1", "qd2", "gap"]
    lines = [",".join(names)]
    for k in range(count):
        x = (10.0 ** rng.uniform(-9, 2, 8) * rng.choice([-1, 1], 8)).tolist()
        write = [repr, "{:.3e}".format, "{:.6f}".format][k * 3 // count]
        quoted = f'"{x[3]!r}"' if k % 5 == 1 else repr(x[3])
        gap = "open" if k == count - 2 else repr(x[7])  # of numbers, but for one row
        text = [repr(k * 0.1), write(x[0]), '"u, ""v"""', write(x[1]), quoted, "tau", x[5], x[6]]
        lines.append(",".join(map(str, [*text, gap])))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("command", ["torque", "energy", "reactions", "points"])
@pytest.mark.parametrize(("seed", "count"), [(1, 1), (2, 2), (3, 700)])
def test_of_random_tables(robodyn: Run, command: str, seed: int, count: int) -> None:
    given = table(seed, count)
    if command == "reactions":
        given = given.replace("tau1", "effort")
    rows = robodyn(command, ARM, "-", stdin=given).rows
    told = told_of(robodyn, command, ARM, "-", stdin=given)
    assert_tells([dict(x) for x in told.rows], rows)
    names = [row["column"] for row in told.rows]
    assert "note" not in names
    assert "t" not in names
    assert "a, b" in names
    assert ("gap" in names) == (count == 1)


def test_as_json_and_as_a_table(robodyn: Run, tmp_path: Path) -> None:
    given = table(5, 30)
    rows = robodyn("torque", ARM, "-", stdin=given).rows
    told = told_of(robodyn, "torque", ARM, "-", stdin=given, format="json")
    assert "column gap is left out: it has numbers, and open in row 29" in told.err
    as_json = json.loads(told.out)
    assert isinstance(as_json, list)
    assert_tells(as_json, rows)
    seen = told_of(robodyn, "torque", ARM, "-", stdin=given, format="table", model=ARM).out
    lines = [line.split("  ") for line in seen.splitlines() if line.strip()]
    heads = [x.strip() for x in lines[0] if x.strip()]
    assert heads[:4] == ["column", "min", "min_t [s]", "min_q1 [rad]"]
    (tau,) = ([x.strip() for x in line if x.strip()] for line in lines if "tau2 [N m]" in line)
    assert tau[1:] == [f"{x:.6g}" for x in known(rows)["tau2"] if x is not None]
    path = tmp_path / "extremes.csv"
    assert told_of(robodyn, "torque", ARM, "-", stdin=given, out=str(path)).code == 0
    assert_tells([dict(x) for x in csv.DictReader(io.StringIO(path.read_text()))], rows)


@pytest.mark.parametrize(
    "command",
    [
        "trajectory robots/four-bar.yaml --speed 60rpm --turns 1 --points 91",
        "simulate robots/four-bar.yaml --q 60deg --time 0.5 --quiet",
        "accel robots/2r.yaml --q 1,2 --tau 3,4",
        "torque robots/2r.yaml --q 1,2 --columns tau,power",
        "points robots/2r.yaml --q 1,2 --qd 3,4",
        "assemble robots/five-bar.yaml --q 2,1 --qd 3,4",
        "assemble robots/five-bar.yaml --q 2,1 --range",
        "equilibrium robots/2r.yaml --all",
    ],
)
def test_of_what_has_no_input(robodyn: Run, command: str) -> None:
    rows = robodyn(*command.split()).succeeds().rows
    told = told_of(robodyn, *command.split())
    assert (told.code, told.err) == (0, "" if len(rows) == 1 or "t" in rows[0] else EQUALLY)
    assert_tells([dict(x) for x in told.rows], rows)


def test_a_closed_turn_counts_its_first_row_once(
    robodyn: Run, scene: Callable[[str], Path]
) -> None:
    """The mean rate of a rocker that ends as it began is zero; its rms is that of the period."""
    names = {"crank": (0.04, ""), "rod": (0.12, ""), "rocker": (0.08, ", from: [0.1, 0]")}
    links = [f"{{name: {x}, m: 1, l: {l}, r: 0, I: 1{at}}}" for x, (l, at) in names.items()]
    path = scene(f"links: [{', '.join(links)}]\nclosures: [[rod, rocker]]\n")
    given = ("trajectory", path, "--speed", "60rpm", "--turns", 1, "--points", 361)
    rates = np.array(robodyn(*given).succeeds().column("qd3"))
    rows = told_of(robodyn, *given).succeeds().rows
    told = next(row for row in rows if row["column"] == "qd3")
    assert float(told["mean"]) == pytest.approx(0.0, abs=1e-13)
    assert float(told["rms"]) == pytest.approx(np.sqrt(np.mean(rates[:-1] ** 2)), rel=1e-13)
    assert math.degrees(float(told["rms"])) == pytest.approx(172.004, abs=5e-4)


@pytest.mark.parametrize("t", [(0, 1, 0, 1), (1, 1, 1, 1)])
def test_rows_of_several_runs_count_equally(robodyn: Run, t: tuple[int, ...]) -> None:
    given = "t,q1,q2,qd1,qd2\n" + "".join(f"{x},{k * k},0,0,0\n" for k, x in enumerate(t))
    told = told_of(robodyn, "energy", ARM, "-", stdin=given)
    assert told.code == 0
    assert told.err == "Note: t does not rise: rows count equally in mean and rms\n"
    (row,) = (row for row in told.rows if row["column"] == "q1")
    assert row["mean"] == "3.5"
    assert float(row["rms"]) == pytest.approx(math.sqrt(98 / 4))


def test_times_need_not_be_even_and_may_repeat(robodyn: Run) -> None:
    """At an impact two rows have one time: 1 for 3 s, then 5 for 1 s."""
    given = "t,q1,q2,qd1,qd2\n" + "".join(f"{x},0,0,0\n" for x in ("0,1", "3,1", "3,5", "4,5"))
    told = told_of(robodyn, "energy", ARM, "-", stdin=given).succeeds().rows
    (row,) = (row for row in told if row["column"] == "q1")
    assert (float(row["mean"]), float(row["rms"])) == (2.0, math.sqrt(7.0))


def test_commands_of_rows_choose_their_columns() -> None:
    others = {"terms", "linearize", "check", "identify", "equations", "export", "bench"}
    others |= {"plot", "draw", "animate", "guide", "init", "schema", "summary"}
    for name in set(cli.COMMANDS) - others:
        group: Any = typer.main.get_command(cli._application([name]))
        told = {text for parameter in group.commands[name].params for text in parameter.opts}
        assert "--columns" in told, name


def test_computed_columns_come_first(robodyn: Run) -> None:
    given = "note,x,qd1,q1,q2,qd2\na,1,2,3,4,5\n"
    told = told_of(robodyn, "energy", ARM, "-", stdin=given).succeeds()
    names = [row["column"] for row in told.rows]
    assert names == ["KE", "PE", "energy", "x", "qd1", "q1", "q2", "qd2"]


def test_a_text_is_no_value_of_a_computed_column() -> None:
    out = io.BytesIO()
    writer = Extremes(lambda names: Writer(out, names), ["method", "error", "none"])
    for row in (["a", 2.0, None], ["b", "failed", None], ["c", 1.0, None]):
        writer.write_row(row)
    writer.close()
    lines = [line.split(",") for line in out.getvalue().decode().splitlines()]
    assert lines[1:] == [
        ["error", "1.0", "", "", "2.0", "", "", "1.5", repr(math.sqrt(2.5))],
        ["none", *[""] * 8],
    ]


def test_a_word_below_numbers_is_told(robodyn: Run) -> None:
    """A column of words is none of numbers, and needs no note."""
    lines = [
        "t,x,y",
        *(f"{k},{'abc' if k == 700 else k},{'' if k else 'words'}" for k in range(900)),
    ]
    found = robodyn("summary", stdin="\n".join(lines) + "\n")
    assert found.err == "Note: column x is left out: it has numbers, and abc in row 701\n"
    assert found.code == 0
    assert [line.split(",")[0] for line in found.out.splitlines()] == ["column"]
    text = "t,x,z\n" + "".join(f"{k},{'abc' if k == 700 else k},{-k}\n" for k in range(900))
    ranks = robodyn("summary", "--correlations", "t", stdin=text)
    assert (ranks.err, ranks.out.splitlines()[1:]) == (found.err, ["z,-1.0"])


def test_where_there_is_no_t_fields_are_empty(robodyn: Run) -> None:
    one = ("torque", "robots/pendulum.yaml", "--q", "1")
    (line,) = csv.reader(told_of(robodyn, *one).succeeds().out.splitlines()[1:])
    assert line[2:4] == ["", ""]
    assert line[1] == line[4] == line[7] == line[8]
    (row,) = json.loads(told_of(robodyn, *one, format="json").succeeds().out)
    assert row["min_t"] is None
    assert row["max_q1"] is None


def test_numbers_of_every_size(robodyn: Run) -> None:
    huge = "q1,q2,x,y\n1,2,1.5e308,5e-324\n1,3,1.6e308,5e-324\n"
    told = told_of(robodyn, "torque", ARM, "-", stdin=huge).rows
    by = {row["column"]: [float(row[x]) for x in ("mean", "rms")] for row in told}
    assert by["x"] == pytest.approx([1.55e308, math.sqrt(2.405) * 1e308], rel=1e-15)
    assert by["y"] == [5e-324, 5e-324]


def test_memory_is_that_of_a_chunk() -> None:
    """A column that becomes text on the way, and 400 chunks in the memory of a few."""

    def peak(chunks: int) -> tuple[int, list[str]]:
        out = io.BytesIO()
        rng = np.random.default_rng(1)
        tracemalloc.start()
        writer = Extremes(lambda names: Writer(out, names), ["tau1", "q1"], ["t", "note", "q1"])
        for k in range(chunks):
            lines = [f"{k}.5,{'x' if k == chunks - 1 else 1.5},0.25"] * 200
            writer.write_rows(lines, rng.normal(size=(200, 2)))
        writer.close()
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size, out.getvalue().decode().splitlines()

    few, many = peak(4), peak(400)
    assert many[0] < 1.5 * few[0]
    assert [line.split(",")[0] for line in many[1]] == ["column", "q1", "tau1"]
    rng = np.random.default_rng(1)
    values = np.concatenate([rng.normal(size=(200, 2)) for _ in range(400)])
    place = int(values[:, 0].argmin())
    expected = [values[place, 0], place // 200 + 0.5, values[place, 1]]
    assert [float(x) for x in many[1][2].split(",")[1:4]] == expected


def test_an_empty_text_of_json_is_no_null() -> None:
    out = io.BytesIO()
    writer = WRITERS["json"](out, ["a", "b"])
    writer.write_row(["", None])
    writer.close()
    assert json.loads(out.getvalue()) == [{"a": "", "b": None}]


def test_a_sweep_whose_points_have_not_all_a_value(robodyn: Run) -> None:
    """Of columns with empty fields the rows that have one count."""
    given = ("sweep", ARM, "--vary", "q1=0:2:5", "--time", 0.8, "--result", "flip", "--quiet")
    rows = list(csv.DictReader(io.StringIO(robodyn(*given).succeeds().out)))
    told = {row["column"]: row for row in told_of(robodyn, *given).fails(0, EQUALLY).rows}
    assert list(told) == ["flip", "q1"]
    there = [(float(row["flip"]), float(row["q1"])) for row in rows if row["flip"]]
    assert 0 < len(there) < len(rows)
    found = [float(told["flip"][x]) for x in ("min", "min_q1", "max", "max_q1", "mean")]
    assert found == pytest.approx([*min(there), *max(there), np.mean([x for x, _ in there])])
    assert told["q1"]["mean"] == "1.0"


def test_a_sweep_whose_points_have_no_value(robodyn: Run) -> None:
    given = ("sweep", ARM, "--vary", "q1=0:2:3", "--time", 0.01, "--result", "flip", "--quiet")
    row = told_of(robodyn, *given).fails(0, EQUALLY).rows[0]
    assert row == {"column": "flip"} | dict.fromkeys(EXTREMES[1:], "")
