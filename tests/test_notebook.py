"""Notebooks and scripts: loading, short texts, pictures, tables, and the notebook of the guide."""

import ast
import io
import json
import pickle
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import RP_ARM, Outcome
from documents import GUIDE, PAGES, ROOT
from named_case import case

import robodyn as package
from robodyn.loops.assembly import first_pose
from robodyn.notebook import inline
from robodyn.pictures import chart_figure
from robodyn.pictures.drawing import drawing
from robodyn.scene.example_scenes import scene_names

Run = Callable[..., Outcome]
ARM = package.load("2r")
FOUR_BAR = package.load("four-bar")
REST = np.zeros(2)
TEXT = "links:\n  - {name: rod, m: 1.2, l: 0.6, r: 0.3, I: 0.036}\n"
ROD = {"name": "rod", "m": 1.2, "l": np.float64(0.6), "r": 0.3, "I": 0.036}


@pytest.fixture(scope="module")
def motion() -> package.Motion:
    start = package.assemble(FOUR_BAR, [1.0])
    times = np.linspace(0, 0.5, 11)
    return package.simulate(FOUR_BAR, start, [0, 0, 0], 0.5, "2*sin(3*t)", t_eval=times)


@pytest.fixture
def figures() -> None:
    pytest.importorskip("matplotlib", reason="the extra `plot`")


# Names


def test_public_names_and_no_others() -> None:
    """In a process of its own: names come when they are asked for, and numpy with them."""
    code = (
        "import sys, robodyn; names = dir(robodyn); assert 'numpy' not in sys.modules\n"
        "assert 'yaml' not in sys.modules and 'robodyn.errors' not in sys.modules\n"
        "from robodyn import *\n"
        "assert set(names) == {*robodyn.__all__, '__version__'}, names\n"
        "assert all(globals()[x] is getattr(robodyn, x) for x in robodyn.__all__)\n"
        "assert dir(robodyn) == names\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_types_are_for_those_who_check_them() -> None:
    assert (ROOT / "robodyn" / "py.typed").read_text() == ""
    tree = ast.parse((ROOT / "robodyn" / "__init__.py").read_text())
    typed = {
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("robodyn.")
        for alias in node.names
    }
    lazy = {(f"robodyn.{room}", name) for name, room in package._ROOM_OF.items()}
    assert lazy == {x for x in typed if x[1] in package.__all__ and x in lazy}


# Loading


def test_path_text_mapping_and_name(tmp_path: Path) -> None:
    path = tmp_path / "rod.yaml"
    path.write_text(TEXT)
    for scene in (path, str(path), TEXT, {"links": [ROD]}, {"links": (ROD,)}):
        mech = package.load(scene)
        assert float(package.mass_matrix(mech, [0.3])[0, 0]) == pytest.approx(0.036 + 1.2 * 0.09)
    for name in scene_names():
        known = package.load(ROOT / "robots" / f"{name}.yaml").description
        assert package.load(name).description == known._replace(source=known.source)


def test_numbers_of_a_mapping_are_kept_to_the_last_bit() -> None:
    rng = np.random.default_rng(3)
    values = [float(x) for x in rng.uniform(0.5, 1, 20) * 10.0 ** rng.integers(-12, 6, 20)]
    for value in values:
        mech = package.load({"links": [ROD | {"l": value, "r": [value / 3, value / 7]}]})
        assert mech.description.links[0].l == value
        assert mech.description.links[0].r == complex(value / 3, value / 7)


def test_a_file_goes_before_an_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "2r").write_text(TEXT)
    assert package.load("2r").link_names == ("rod",)


REFUSED = [
    ("2q", ["scene = 2q", "no example", "2r"]),
    ("no/2r", ["no/2r: no such file"]),
    ("2r.yml", ["2r.yml: no such file"]),
    (Path("2r"), ["2r: no such file"]),
    (3, ["scene = int", "mapping"]),
    (None, ["scene = NoneType"]),
    ({"links": [{"name": "arm", "m": 1}]}, ["mapping: links[0] (arm).l: is missing", "(arm).I"]),
    ({"links": [ROD | {"m": -1}]}, ["mapping: links[0] (rod).m = -1"]),
    ({"links": object()}, ["scene", "YAML"]),
    ({}, ["mapping"]),
    ("links:\n  - {name: arm}\n", ["text:2: links[0] (arm).l"]),
]


def test_what_is_no_scene() -> None:
    for scene, told in REFUSED:
        with case(scene, told):
            with pytest.raises(package.InputError) as caught:
                package.load(scene)
            assert all(x in str(caught.value) for x in told), str(caught.value)


# What is no mechanism, what is no torque


def test_no_mechanism_is_told_by_every_function() -> None:
    import inspect

    asked = 0
    for name in package.__all__:
        function = getattr(package, name)
        if inspect.isclass(function) or name in ("load", "lqr", "plot", "animate"):
            continue
        asked += 1
        assert next(iter(inspect.signature(function).parameters)) == "mechanism", name
        for wrong in ("robots/2r.yaml", Path("2r.yaml"), None, 3):
            told = "'robots/2r.yaml'" if wrong == "robots/2r.yaml" else type(wrong).__name__
            for call in (
                lambda f=function, x=wrong: f(x),
                lambda f=function, x=wrong: f(mechanism=x),
            ):
                with pytest.raises(package.InputError, match=r"robodyn\.load") as caught:
                    call()
                assert f"{name}: mechanism = {told}" in str(caught.value)
    assert asked > 30
    with pytest.raises(TypeError, match="mechanism"):
        package.mass_matrix()


def test_functions_stay_what_they_are() -> None:
    for name in ("simulate", "mass_matrix", "sweep"):
        function = getattr(package, name)
        assert pickle.loads(pickle.dumps(function)) is function
        assert function.__doc__
        assert function.__name__ == name


@pytest.mark.parametrize("given", [3.0, None, np.float64(1.0), ["a", "b"], "ab", [None, 1]])
def test_torque_functions_that_give_no_list(given: object) -> None:
    for method in ("DOP853", "Radau"):
        with pytest.raises(package.InputError, match="list of numbers") as caught:
            package.simulate(ARM, REST, REST, 0.1, lambda t, q, qd: given, method=method)
        assert "tau(t, q, qd) = " in str(caught.value)
    motor = {"ratio": 20, "inertia": 2e-5, "torque_constant": 0.05, "resistance": 2}
    mech = package.load({"links": [ROD | {"motor": motor}]})
    volts = package.voltages(mech, lambda t, q, qd: given)
    with pytest.raises(package.InputError, match=re.escape("volt(t, q, qd) = ")):
        package.simulate(mech, [0], [0], 0.1, volts)


def test_errors_within_a_torque_function_stay_its_own() -> None:
    def torque(t: float, q: list[float], qd: list[float]) -> list[float]:
        return [len(t), 0]  # type: ignore[arg-type]

    with pytest.raises(TypeError, match="has no len"):
        package.simulate(ARM, REST, REST, 0.1, torque)


# Short texts


def test_results_are_one_short_line(motion: package.Motion) -> None:
    q = np.zeros((1000, 2))
    rng = np.random.default_rng(0)
    linear = package.linearize(ARM, [-np.pi / 2, 0])
    reference = package.reference_motion(ARM, [[0, 0], [1, 1]], 2.0)
    tables = package.ReferenceTable(np.arange(99.0), rng.normal(size=(99, 2)))
    results = {
        "Mechanism": (ARM, "2 links (upper arm, forearm)"),
        "Motion": (motion, "11 rows, t = 0 to 0.5 s, finished"),
        "Torques": (package.inverse_dynamics_and_forces(ARM, q, q, q), "<array (1000, 2)>"),
        "InverseDerivatives": (package.inverse_dynamics_derivatives(ARM, q, q, q), "(1000, 2, 2)"),
        "LinearModel": (linear, "stable=True"),
        "NaturalMode": (linear.modes[0], "frequency="),
        "PointMotion": (package.points(ARM, q, q, q, of=["tip2"]), "names=['tip2']"),
        "Regressor": (package.regressor(ARM, q, q, q), "known=<array (1000, 2)>"),
        "Rest": (package.equilibrium(ARM), "stable=True"),
        "ReferenceMotion": (reference, "duration=2"),
        "ReferenceTable": (tables, "2 joints: 99 rows, t = 0 to 98 s"),
        "Identification": (
            package.identify(ARM, *rng.normal(size=(4, 50, 2)), of=["links.forearm.m"]),
            "rows=50",
        ),
        "Report": (motion.report, "outcome='finished'"),
        "Columns": (motion.to_dict(), "11 rows of"),
        "Animation": (package.animate(motion), "13 frames"),
        "StateFeedback": (package.StateFeedback((0, 1), [0, 0], [0, 0], [[1] * 4] * 2), "gain="),
    }
    for name, (result, told) in results.items():
        assert type(result).__name__ == name
        text = repr(result)
        assert told in text, text
        assert len(text.splitlines()) == 1
        assert len(text) < 500, text
    assert (
        len(repr(package.load({"links": [ROD | {"name": f"link{k}"} for k in range(200)]}))) < 200
    )
    assert "3 links (crank, coupler, rocker), 1 closure, actuated: crank>" in repr(FOUR_BAR)
    assert "\x1b" not in repr(package.load({"name": "a\x1b[2J", "links": [ROD]}))


# Pictures


@pytest.mark.parametrize("name", ["four-bar", "balanced-arm", "whitworth", "scotch-yoke"])
def test_a_mechanism_is_drawn_where_it_is(name: str) -> None:
    """Each path of the picture, by its group's matrix, is a shape of the drawing in the plane."""
    if name not in scene_names():
        pytest.skip("no such scene")
    mech = package.load(name)
    html = mech._repr_html_()
    assert html.startswith("<div>&lt;Mechanism ")
    root = ET.fromstring(html[html.index("<svg") :])
    drawn = drawing(mech, first_pose(mech, t=0.0))
    expected = [z for _, _, z in drawn.placed(0)]
    found = []
    for group in root[0]:
        matrix = re.findall(r"[-+.\de]+", group.get("transform", "matrix(1 0 0 1 0 0)")[7:])
        a, b, c, d, e, f = map(float, matrix)
        for path in group:
            assert path.get("vector-effect") == "non-scaling-stroke"
            x, y = np.array(re.findall(r"[-+.\de]+", path.get("d")), float).reshape(-1, 2).T
            found.append(a * x + c * y + e + 1j * (b * x + d * y + f))
    left, bottom, right, top = drawn.box()
    size = max(right - left, top - bottom)
    assert len(found) == len(expected) > 5
    for z in expected:
        same = [other for other in found if len(other) == len(z)]
        assert min(np.abs(other - z).max() for other in same) < 1e-4 * size


def test_a_mechanism_that_cannot_be_drawn_is_told() -> None:
    open_loop = FOUR_BAR.description.written.text.replace("l: 0.35", "l: 0.01").replace(
        "l: 0.95", "l: 0.02"
    )
    html = package.load(open_loop)._repr_html_()
    assert "<svg" not in html
    assert "<pre>" in html
    assert "closed" in html
    shown = package.load({"name": "<b>&", "links": [ROD]})._repr_html_()
    assert "<b>" not in shown


def test_a_motion_is_charted(motion: package.Motion, figures: None) -> None:
    html = motion._repr_html_()
    root = ET.fromstring(html[html.index("<svg") :])
    assert root.tag.endswith("svg")
    for k in range(motion.q.shape[1]):  # matplotlib notes each text beside its outlines
        assert f"<!-- q{k + 1} -->" in html
    assert f"<!-- q{motion.q.shape[1] + 1} -->" not in html
    assert html == motion._repr_html_()


def test_a_motion_without_matplotlib(
    motion: package.Motion, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inline, "find_spec", lambda name: None)
    html = motion._repr_html_()
    assert "<pre>" in html
    assert "tau1" in html
    assert "<svg" not in html
    monkeypatch.setattr(chart_figure, "find_spec", lambda name: None)
    for call in (lambda: package.plot(motion), lambda: package.draw(ARM)):
        with pytest.raises(package.RobodynError, match="extra `plot`"):
            call()


def test_plot_draws_the_columns(motion: package.Motion, figures: None) -> None:
    figure = package.plot(motion, y="q*,energy", title="a $ b")
    curves = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    assert set(curves) == {"q1", "q2", "q3", "energy"}
    np.testing.assert_array_equal(curves["q2"].get_ydata(), motion.q[:, 1])
    np.testing.assert_array_equal(curves["q2"].get_xdata(), motion.t)
    assert figure.axes[0].get_title() == "a $ b"
    turn = {"q1": [0.0, np.pi]}
    degrees = package.plot(turn, degrees=True, mechanism=motion.mechanism).axes[0]
    assert degrees.get_lines()[0].get_ydata().tolist() == [0.0, 180.0]
    assert package.plot(motion, motion, y=["q1"]).axes[0].get_lines()[1].get_label() == "q1 2"
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_plot_draws_maps(figures: None) -> None:
    x, y = (part.ravel() for part in np.meshgrid(np.arange(4.0), np.arange(3.0)))
    for colour in (x + y, ["ab"[int(v) % 2] for v in x], np.where(x > 1, np.nan, y)):
        figure = package.plot({"q1": x, "q2": y, "c": colour}, x="q1", y="q2", colour="c")
        assert figure.axes[0].get_xlabel() == "q1 [rad or m]"


def test_draw_is_what_the_command_draws(
    robodyn: Run, tmp_path: Path, figures: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same bytes, one pose or many, with paths, names and forces."""
    rows = package.assemble(FOUR_BAR, np.linspace(0, 2, 21)[:, None])
    table = tmp_path / "rows.csv"
    np.savetxt(table, rows, "%.17g", ",", header="q1,q2,q3", comments="")
    loaded = ("--q", "0.5,0.25", "--qd", "1,2", "--qdd", "0,1", "--forces")
    cases = [
        ("2r", ("--q", "0.5,0.25"), ([0.5, 0.25],), {}),
        ("2r", loaded, ([0.5, 0.25], [1, 2], [0, 1]), {"forces": True}),
        ("2r", ("--q", "0,0", "--labels", "names"), (), {"labels": "names"}),
        ("four-bar", ("--q", "1", "--size", "5x4"), ([1.0],), {"size": (5, 4)}),
        ("four-bar", (table, "--of", "coupler"), (rows,), {"of": ["coupler"]}),
    ]
    for name, options, given, named in cases:
        path, mech = tmp_path / "a.svg", package.load(name)
        robodyn("draw", ROOT / f"robots/{name}.yaml", *options, "-o", path).succeeds()
        drawn = io.BytesIO()
        from matplotlib import rc_context

        figure = package.draw(mech, *given, **named)
        with rc_context({"svg.hashsalt": "robodyn"}):
            figure.savefig(drawn, format="svg", metadata={"Date": None})
        assert drawn.getvalue() == path.read_bytes(), name


def test_animations(motion: package.Motion, tmp_path: Path, robodyn: Run) -> None:
    """The page is that of the command for the same rows, in a notebook too."""
    table = tmp_path / "rows.csv"
    columns = motion.to_dict()
    values, header = np.column_stack(list(columns.values())), ",".join(columns)
    np.savetxt(table, values, "%.17g", ",", header=header, comments="")
    ours, theirs = tmp_path / "ours.html", tmp_path / "theirs.html"
    moving = package.animate(motion, of=["coupler"], fps=20)
    moving.save(ours)
    given = ("animate", ROOT / "robots/four-bar.yaml", table, "--of", "coupler", "--fps", 20)
    robodyn(*given, "-o", theirs).succeeds()
    assert ours.read_text() == theirs.read_text()
    from html import unescape

    shown = moving._repr_html_()
    assert unescape(shown.split('srcdoc="')[1].split('" style=')[0]) == ours.read_text()
    again = package.animate(FOUR_BAR, motion.t, motion.q, motion.qd, of=["coupler"], fps=20)
    assert again._repr_html_() == shown


def test_gifs_and_frames(motion: package.Motion, tmp_path: Path, figures: None) -> None:
    moving = package.animate(motion, fps=10)
    moving.save(tmp_path / "a.gif")
    assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF89a")
    assert "t = 0.5" in [text.get_text() for text in moving.figure().axes[0].texts][-1]


def test_settings_of_matplotlib_stay(motion: package.Motion, figures: None) -> None:
    code = """
import os, warnings, logging
import robodyn
motion = robodyn.simulate(robodyn.load("2r"), [0, 0], [0, 0], 0.1)
motion._repr_html_()
import matplotlib
matplotlib.rcParams["lines.linewidth"] = 7
kept, filters = dict(matplotlib.rcParams), list(warnings.filters)
robodyn.plot(motion), robodyn.draw(motion.mechanism), robodyn.animate(motion).figure()
motion._repr_html_()
assert dict(matplotlib.rcParams) == kept and warnings.filters == filters
assert os.environ["MPLBACKEND"] == "svg" and matplotlib.get_backend().lower() == "svg"
assert logging.getLogger("matplotlib").level < logging.CRITICAL
"""
    environment = {**__import__("os").environ, "MPLBACKEND": "svg"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


# Tables


@pytest.mark.parametrize("case", ["loop", "slides", "stops", "control", "sensitivity"])
def test_columns_are_those_of_the_command(case: str, robodyn: Run, tmp_path: Path) -> None:
    path, options, named = tmp_path / "scene.yaml", [], {}
    path.write_text((ROOT / "robots/four-bar.yaml").read_text())
    if case in ("slides", "stops"):
        limit = "limits: {max: 0.01, restitution: 0.5}, " if case == "stops" else ""
        path.write_text(RP_ARM.replace("axis: [1, 0], ", f"axis: [1, 0], {limit}"))
    if case in ("control", "sensitivity"):
        path.write_text((ROOT / "robots/2r.yaml").read_text())
    mech = package.load(path)
    q = package.assemble(mech, [1.0]) if case == "loop" else REST
    if case == "control":
        reference = package.ReferenceTable.set_point([0.3, 0.1], 0.5)
        named = {"tau": package.controller(mech, reference, "pd", kp=[50, 50], kd=[9, 9])}
        options = ["--control", "pd", "--hold", "0.3,0.1", "--kp", "50,50", "--kd", "9,9"]
    if case == "sensitivity":
        named = {"sensitivity": ["links.forearm.m", "q1"]}
        options = ["--sensitivity", "links.forearm.m,q1"]
    start = ",".join(map(repr, q.tolist()))
    given = ("simulate", path, f"--q={start}", "--time", 0.5, "--points", 6, "--quiet")
    told = robodyn(*given, *options)
    told.succeeds()
    header, *rows = [line.split(",") for line in told.out.splitlines()]
    t = [float(row[0]) for row in rows]
    found = package.simulate(mech, q, np.zeros(mech.n), 0.5, t_eval=t, **named).to_dict()
    assert list(found) == header
    values = np.array(rows, float)
    np.testing.assert_allclose(np.column_stack(list(found.values())), values, rtol=0, atol=0)


def test_motions_without_rows() -> None:
    """Of a run whose output is wanted at no time: columns, of an arm and of a loop, but no row."""
    reference = package.ReferenceTable.set_point([0.3, 0.1], 0.1)
    led = package.controller(ARM, reference, "pd", kp=[50, 50], kd=[9, 9])
    closed = package.assemble(FOUR_BAR, [1.0])
    for mech, q, tau in ((ARM, REST, led), (ARM, REST, None), (FOUR_BAR, closed, None)):
        motion = package.simulate(mech, q, np.zeros(mech.n), 0.1, tau, t_eval=[])
        found = motion.to_dict()
        assert found.rows == 0
        assert set(found) > {"t", "energy"}
        assert "0 rows, finished" in repr(motion)
        assert "no row" in motion._repr_html_()


def test_data_frames_take_tables(motion: package.Motion) -> None:
    found = motion.to_dict()
    assert isinstance(found, dict)
    assert all(x.shape == (11,) and x.dtype == float for x in found.values())
    html = found._repr_html_()
    assert html.count("<tr>") == 11
    assert "11 rows" in html
    for name in ("pandas", "polars"):
        try:
            frames = __import__(name)
        except ImportError:
            continue
        table = frames.DataFrame(found)
        assert list(table.columns) == list(found)
        assert len(table) == 11
        package.plot(table, y="q*")


def test_sweep_is_the_command(robodyn: Run, tmp_path: Path) -> None:
    cases = [
        ({"q1": [0, 1.5, 3], "links.forearm.m": "0.5:1.5:2"}, {"time": 0.5}),
        ({"q1": "0:1:3"}, {"kind": "torque", "qd": [1, 2], "qdd": 0.5}),
        ({"gravity": "9:10"}, {"sample": 4, "seed": 3, "time": 0.2, "result": "drift,max(tau1)"}),
        ({"qd1": [9]}, {"time": 2.0, "event": "up=q1 > 1", "result": "events"}),
    ]
    for vary, options in cases:
        if options.get("qdd"):
            options["qdd"] = [0.5, 0.5]
        given = []
        for name, values in vary.items():
            text = values if isinstance(values, str) else ",".join(map(str, values))
            given += ["--vary", f"{name}={text}"]
        for name, value in options.items():
            text = value if isinstance(value, str) else re.sub(r"[\[\] ]", "", str(value))
            given += [f"--{name}", text]
        told = robodyn("sweep", ROOT / "robots/2r.yaml", *given, "--quiet")
        told.succeeds()
        header, *rows = [line.split(",") for line in told.out.splitlines()]
        found = package.sweep(ARM, vary, **options)
        assert list(found) == header
        assert found["outcome"] == [row[-1] for row in rows]
        values = [[float(x or "nan") for x in row[:-1]] for row in rows]
        np.testing.assert_array_equal(np.column_stack(list(found.values())[:-1]), values)


def test_sweep_of_a_mechanism_whose_numbers_were_changed() -> None:
    """What was put in a scene, as a fit does, stays in what a sweep makes of it."""
    from robodyn.mechanics.mechanism import build
    from robodyn.scene.scene_values import SceneValues

    values = SceneValues(ARM.description.written, ARM.source)
    changed = build(values.replaced({"links.forearm.m": 1.7, "links[0].l": 0.9}))
    found = package.sweep(changed, {"q1": [0.2]}, kind="torque")
    expected = package.inverse_dynamics(changed, [0.2, 0], REST, REST)
    assert [found["tau1"][0], found["tau2"][0]] == pytest.approx(expected.tolist(), rel=1e-12)
    assert found["tau1"][0] != package.sweep(ARM, {"q1": [0.2]}, kind="torque")["tau1"][0]


MOVED = {"q1": [0.0]}
WRONG = [
    (lambda: package.sweep(ARM, {}), "vary"),
    (lambda: package.sweep(ARM, "q1"), "vary"),
    (lambda: package.sweep(ARM, {"q9": [0]}), "vary = q9"),
    (lambda: package.sweep(ARM, {"q1": "0:1"}), "vary q1 = 0:1"),
    (lambda: package.sweep(ARM, MOVED, tim=3), "tim: is no option"),
    (lambda: package.sweep(ARM, MOVED, engine="fast"), "engine: is no option of sweep"),
    (lambda: package.sweep(ARM, MOVED, kind="x"), "kind = x"),
    (lambda: package.sweep(ARM, MOVED, max_steps=0), "max_steps = 0"),
    (lambda: package.plot(), "plot"),
    (lambda: package.plot("run.csv"), "table = str"),
    (lambda: package.plot({"a": [1, 2], "b": [1]}), "a: 2, b: 1"),
    (lambda: package.plot({"a": [1, 2]}, y="c"), "is no column"),
    (lambda: package.plot({"a": [1, 2]}, colour="a"), "colour"),
    (lambda: package.draw(ARM, [0, 0, 0]), "q"),
    (lambda: package.draw(FOUR_BAR, [0.1, 0.2, 0.3]), "open"),
    (lambda: package.draw(ARM, [0, 0], [1, 1]), "qd"),
    (lambda: package.draw(ARM, forces=True), "q: missing"),
    (lambda: package.draw(ARM, [REST, REST], forces=True), "must be one pose"),
    (lambda: package.draw(ARM, REST, poses=0), "poses = 0"),
    (lambda: package.draw(ARM, REST, of=["x"]), "of"),
    (lambda: package.animate(ARM), "t and q"),
    (lambda: package.animate("2r"), "motion = '2r': must be a Motion or a Mechanism"),
    (lambda: package.animate(ARM, [0, 1], REST), "q.shape"),
    (lambda: package.animate(ARM, [0, 1], [REST, REST], fps=0), "fps = 0"),
    (lambda: package.animate(ARM, [0, 1], [REST, REST]).save("a.avi"), "out = a.avi"),
]


def test_wrong_arguments(figures: None) -> None:
    for call, told in WRONG:
        with case(call, told):
            with pytest.raises(package.InputError) as caught:
                call()
            assert told in str(caught.value)
            assert ": --" not in f": {caught.value}"


# The notebook of the guide, and docstrings


def test_the_notebook_runs() -> None:
    """Each cell of code, with what it shows, and no outputs that are kept."""
    pytest.importorskip("matplotlib", reason="the extra `plot`")
    content = json.loads((GUIDE / "notebook.ipynb").read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    assert content["nbformat_minor"] >= 5
    assert {"cells", "metadata"} <= content.keys()
    assert len({cell["id"] for cell in content["cells"]}) == len(content["cells"])
    scope: dict[str, object] = {}
    kinds = []
    for cell in content["cells"]:
        assert cell["cell_type"] in ("code", "markdown")
        assert cell["metadata"] == {}
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            continue
        assert cell["outputs"] == []
        assert cell["execution_count"] is None
        tree = ast.parse(source)
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, cell["id"], "exec"), scope)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), cell["id"], "eval"), scope)
            kinds.append(type(value).__name__)
            for way in ("_repr_html_", "_repr_png_"):
                shown = getattr(value, way, lambda: None)()  # matplotlib's has none of html
                assert shown is None or len(shown) > 500
    assert {"Mechanism", "Motion", "Columns", "Animation", "ShownFigure"} <= set(kinds)
    assert "notebook.ipynb" in PAGES["python"]


def test_docstrings_state_the_equations_that_they_name() -> None:
    """None says `equation (1)`, or a number of the lecture, without the equation beside it."""
    named = r"\b(?:[Ee]q(?:uation)?s?\.?)\s*\((\d+)\)|\((2[4-9]|3[0-3])\)"
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "robodyn").rglob("*.py")}
    for path in (path for path, text in texts.items() if re.search(named, text)):
        for node in ast.walk(ast.parse(texts[path])):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                text = ast.get_docstring(node) or ""
                for match in re.finditer(named, text):
                    number = match[1] or match[2]
                    stated = re.search(rf"=.*\({number}\)$", text, re.MULTILINE)
                    assert stated, f"{path}: {match[0]}"
