"""`robodyn bench`: rows, formats, figures, and what it refuses before the work."""

import csv
import io
import math

import pytest

from robodyn.cli import bench
from robodyn.dynamics import evaluators
from robodyn.pictures import chart_figure
from robodyn.runs import benchmark

ARM = ("bench", "robots/2r.yaml", "--q=-1.3,-0.2", "--qd", "0.5,0.25", "--time", 0.2)
SHORT = (*ARM, "--repeats", 1)
CRANK = ("bench", "robots/four-bar.yaml", "--q", "60deg", "--time", 0.1, "--repeats", 1)
FIRST = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


kept = {}


def measured(mechanism, state, t_end, torques, **options):
    """A measurement of each kind, at two tolerances, serves all tests that show it."""
    kind = mechanism.name, tuple(state), t_end, benchmark.MAX_EVALUATIONS, torques.lines
    if kind not in kept:
        options["tolerances"] = (1e-4, 1e-8)
        kept[kind] = benchmark.benchmark(mechanism, state, t_end, torques, **options)
    return kept[kind]


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Two tolerances, small batches, and no call for its time alone more than once."""
    monkeypatch.setattr(bench, "benchmark", measured)
    monkeypatch.setattr(evaluators, "BATCHES", (1, 30))
    once = evaluators.repeat
    monkeypatch.setattr(evaluators, "repeat", lambda call, number, repeat: once(call, number=1))


@pytest.fixture
def idle(monkeypatch):
    """No work may begin."""

    def begins(*_, **__):
        raise AssertionError("the work began")

    monkeypatch.setattr(bench, "benchmark", begins)
    monkeypatch.setattr(bench, "measure_evaluators", begins)


def test_csv(robodyn):
    given = robodyn(*SHORT)
    assert given.code == 0
    assert given.out.splitlines()[0] == ",".join(bench.COLUMNS)
    for row in given.rows:
        numbers = {x: float(row[x]) for x in bench.COLUMNS if x not in ("method", "front")}
        assert all(math.isfinite(x) for x in numbers.values())
        assert numbers["error"] >= numbers["error_end"] > 0.0
        assert numbers["median_ms"] >= numbers["least_ms"] > 0.0
    assert {row["front"] for row in given.rows} == {"", "*"}
    assert "uncertainty of the reference" in given.err
    assert "Traceback" not in given.err


def test_json(robodyn):
    given = robodyn(*CRANK, "--format", "json")
    assert given.code == 0
    rows = given.json
    assert [list(row) for row in rows] == [list(bench.COLUMNS)] * len(rows)
    assert {row["tolerance"] for row in rows} == {1e-4, 1e-8}
    assert all(0.0 < row["gap"] < 1e-14 for row in rows)


def test_json_of_runs_that_do_not_finish(robodyn, monkeypatch):
    monkeypatch.setattr(benchmark, "MAX_EVALUATIONS", 20)
    given = robodyn(*SHORT, "--format", "json")
    ended = [row for row in given.json if row["error"] == "too many evaluations"]
    assert ended
    assert {(row["median_ms"], row["least_ms"], row["front"]) for row in ended} == {("", "", "")}
    assert "left out: " in given.err


def test_table(robodyn):
    given = robodyn(*SHORT, "--format", "table", "--time", 0.05)
    assert given.code == 0
    assert given.out.split()[:3] == ["method", "tolerance", "error"]
    assert "DOP853" in given.out


def test_out(robodyn, tmp_path):
    path = tmp_path / "rows.csv"
    given = robodyn(*SHORT, "--out", path)
    assert (given.code, given.out) == (0, "")
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    assert {"DOP853", "taylor"} <= {row["method"] for row in rows}


def test_plot(robodyn, tmp_path):
    """By the suffix, in large letters too; the figure without finished runs is an .svg."""
    pytest.importorskip("matplotlib")
    for suffix in (".png", ".SVG", ".pdf"):
        path = tmp_path / f"figure{suffix}"
        given = robodyn(*CRANK, "--plot", path)
        assert given.code == 0
        assert given.out.startswith("method,")
        assert path.read_bytes().startswith(FIRST[suffix.lower()])
        assert [each.name for each in tmp_path.iterdir()] == [path.name]
        if suffix == ".png":  # twice as sharp as charts are
            assert int.from_bytes(path.read_bytes()[16:20], "big") == 2 * 8 * chart_figure.DOTS
        if suffix == ".SVG":
            assert "<svg" in path.read_text()
        path.unlink()


def test_a_figure_that_fails_leaves_the_older_one(robodyn, tmp_path, monkeypatch):
    figure = pytest.importorskip("matplotlib.figure")
    path = tmp_path / "figure.png"
    path.write_text("older")

    def fails(self, stream, **_):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure.Figure, "savefig", fails)
    given = robodyn(*SHORT, "--plot", path)
    assert given.code == 1
    assert "Error: No space left on device" in given.err
    assert path.read_text() == "older"
    assert [each.name for each in tmp_path.iterdir()] == ["figure.png"]


def test_a_figure_without_finished_runs(robodyn, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(benchmark, "MAX_EVALUATIONS", 1)
    given = robodyn(*SHORT, "--plot", tmp_path / "figure.svg")
    assert given.code == 0, given.err
    assert (tmp_path / "figure.svg").read_bytes().startswith(FIRST[".svg"])


def test_evaluators(robodyn):
    given = robodyn("bench", "robots/2r.yaml", "--evaluators").succeeds()
    assert given.out.splitlines()[0] == ",".join(evaluators.COLUMNS)
    assert max(given.column("largest_error")) < 1e-12
    assert len(robodyn("bench", "robots/2r.yaml", "--evaluators", "--format", "json").json) == 6


def test_evaluators_without_mpmath(robodyn, monkeypatch):
    monkeypatch.setattr(evaluators, "find_spec", lambda name: None)
    given = robodyn("bench", "robots/2r.yaml", "--evaluators").fails(1, "mpmath", "pip install")
    assert given.out == ""


@pytest.mark.usefixtures("idle")
def test_without_matplotlib(robodyn, monkeypatch):
    monkeypatch.setattr(chart_figure, "find_spec", lambda name: None)
    robodyn(*ARM, "--plot", "figure.svg").fails(1, "--plot", ".[plot]")


def test_a_motion_that_ends_writes_nothing(robodyn):
    given = robodyn(*ARM, "--tau", "sqrt(0.1 - t), 0").fails(1, "cannot be followed beyond t = 0.1")
    assert given.out == ""


def test_help_has_an_example(robodyn):
    given = robodyn("bench", "--help").succeeds()
    assert "Examples:" in given.out
    assert "robodyn bench 2r " in given.out
