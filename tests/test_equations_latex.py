"""The LaTeX document: compiled where there is a compiler, its formulas read by matplotlib too."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache
from itertools import accumulate
from pathlib import Path

import pytest
from conftest import FRESH
from matplotlib.mathtext import MathTextParser
from sliding_scenes import SLIDING_SCENES
from unwritten import UNWRITTEN, WITH_LAWS

from random_mechanisms import LOOPS, forced, mechanism, seeded_scene, seeded_tree
from robodyn.equations.latex import latex, measure, subscripted
from robodyn.equations.written import Equations, equations
from robodyn.mechanics.mechanism import Mechanism, load

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
NAMES = sorted({path.stem for path in ROBOTS.glob("*.yaml")} - UNWRITTEN - WITH_LAWS)
COMPILER = shutil.which("pdflatex") or shutil.which("lualatex") or shutil.which("tectonic")
PAGE = 17 / 2.54 * 72  # width of the text, big points
HOSTILE = r"""
name: 'a & b_c 100% #1 {x} ~^\ <y> | $5'
gravity: 9.81
links: [{name: 'rod_1 & $', m: 1e-7, l: 1, r: 0.5, I: 0.1}]
"""


def scenes() -> dict[str, Mechanism]:
    found = {name: load(ROBOTS / f"{name}.yaml") for name in NAMES}
    for k, (name, shape) in enumerate(LOOPS.items()):
        plain = seeded_scene(k, shape)
        found[f"random {name}"] = (forced(k, plain) if k % 2 else plain).mechanism
    found["tree"] = forced(1, seeded_tree(1, 4)).mechanism
    found |= {name: mechanism(text) for name, text in SLIDING_SCENES.items()}
    found["hostile names"] = mechanism(HOSTILE)
    links = (f"{{name: n{k}, m: 1, l: 1, r: 0.5, I: 0.1, from: [{k}, 0]}}" for k in range(12))
    found["twelve links"] = mechanism(f"gravity: 9.81\nlinks: [{', '.join(links)}]")
    return found


SCENES = scenes()


@cache
def written(name: str, numeric: bool = False) -> Equations:
    return equations(SCENES[name], numeric)


def rows(document: str) -> list[str]:
    """The rows of the displays, one formula each; entries of matrices too."""
    found = []
    for display in re.findall(r"\\begin\{align\*\}\n(.*?)\n\\end\{align\*\}", document, re.DOTALL):
        display = re.sub(r"\\(begin|end)\{bmatrix\}", "", display)
        found += [" ".join(row.split()) for row in display.split(r"\\")]
    return found


@cache
def width_of(formula: str) -> float:
    """In Computer Modern at 10 pt."""
    from matplotlib import rc_context

    with rc_context({"mathtext.fontset": "cm"}):
        return float(MathTextParser("path").parse(f"${formula}$", dpi=72).width)


# of some that differ only by their numbers, or hold no formula of another kind, `make hard` asks
ALIKE = () if FRESH else ("stephenson-six-bar", "five-bar", "parallelogram")
ASKED = [name for name in NAMES if name not in ALIKE]


@pytest.mark.parametrize("numeric", [False, True])
@pytest.mark.parametrize(
    "name", [*ASKED, "block", "turned", "random slider-crank", "random six-bar with a piston"]
)
@pytest.mark.thinned
def test_every_formula_is_read_and_fits_the_page(name: str, numeric: bool) -> None:
    """A row of a matrix with a blank of 10 pt between entries; of many rows every fifth is asked.

    And the longest ones.
    """
    found = rows(latex(written(name, numeric)))
    longest = sorted(found, key=len)[-12:]
    for row in found if FRESH else [*found[::5], *longest]:
        width = 0.0
        for part in row.split("&"):
            formula = part.replace(r"\quad", r"\ \ ").replace(r"\operatorname{diag}", "diag")
            if formula.strip():
                width += width_of(formula.strip()) + 10
        assert width <= PAGE, row


@pytest.mark.parametrize("numeric", [False, True])
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.thinned
def test_environments_and_braces_match(name: str, numeric: bool) -> None:
    document = latex(written(name, numeric))
    open_: list[str] = []
    for kind, environment in re.findall(r"\\(begin|end)\{([a-z*]+)\}", document):
        if kind == "begin":
            open_.append(environment)
        else:
            assert open_.pop() == environment
    assert open_ == []
    bare = re.sub(r"\\[{}]", "", document)
    depths = list(accumulate((x == "{") - (x == "}") for x in bare))
    assert min(depths) >= 0
    assert depths[-1] == 0
    for matrix in re.findall(r"\\begin\{bmatrix\}\n(.*?)\n\\end\{bmatrix\}", document, re.DOTALL):
        widths = {row.count("&") for row in matrix.split(r"\\")}
        assert len(widths) == 1
        columns = re.search(r"MaxMatrixCols\}\{(\d+)", document)
        assert widths.pop() < (int(columns[1]) if columns else 10)
    assert not re.search(r"\\\\\s*\[", document)  # a line break would take the bracket


@pytest.mark.parametrize("name", SCENES)
def test_the_same_entries_as_in_plain_text(name: str) -> None:
    """Read back from LaTeX, formula by formula, they are those of the text format."""
    from robodyn.equations.notation import PLAIN, one_line

    found = written(name)
    document = plain(re.sub(r"\s*\\\\\n&\\quad ", " ", latex(found)))
    for block in found.blocks:
        for row in block.rows:
            for entry in row:
                if entry.terms:
                    assert plain(one_line(PLAIN.text(entry))) in document


def plain(text: str) -> str:
    """The letters of a formula in either notation."""
    text = re.sub(r"\\dot\{q\}_\{(\d+)\}", r"qd\1", text)
    text = text.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")).replace("varphi", "phi")
    text = re.sub(r"\\(cos|sin) (q_\{\d+\})", r"\1(\2)", text)
    return re.sub(r"[\s{}\\_^\[\]()]", "", text)


@pytest.mark.skipif(COMPILER is None, reason="no LaTeX compiler on this machine")
@pytest.mark.parametrize("name", ["2r", "3r", "four-bar", "hostile names", "twelve links"])
def test_it_compiles(name: str, tmp_path: Path) -> None:
    assert COMPILER is not None
    (tmp_path / "motion.tex").write_text(latex(equations(SCENES[name])), encoding="utf-8")
    options = [] if "tectonic" in COMPILER else ["-interaction=nonstopmode", "-halt-on-error"]
    done = subprocess.run(
        [COMPILER, *options, "motion.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout
    assert "Overfull" not in done.stdout


def test_a_small_matrix_is_shown_whole_and_a_wide_one_by_its_entries() -> None:
    small, wide = latex(equations(SCENES["2r"])), latex(equations(SCENES["3r"]))
    assert r"M &= \begin{bmatrix}" in small
    assert r"M_{12} = M_{21} &= m_{2} (r_{2}^{2} + l_{1} r_{2} \cos q_{2}) + I_{2}" in wide
    assert r"C_{33} &= 0" in wide


def test_names() -> None:
    given = ["g", "m1", "r12x", "mp2", "phi1", "S01"]
    assert subscripted("beta1x") == r"\beta_{1x}"
    shown = ["g", "m_{1}", "r_{12x}", "m_{p2}", r"\varphi_{1}", "S_{01}"]
    assert [subscripted(name) for name in given] == shown


def test_small_and_large_numbers() -> None:
    document = latex(equations(mechanism(HOSTILE), numeric=True))
    assert r"2.4525\cdot 10^{-7}" not in document
    assert r"4.905\cdot 10^{-7} \cos q_{1}" in document


def test_widths_are_about_right() -> None:
    assert measure("m_{1}") == pytest.approx(1.7)
    assert measure(r"\cos(q_{1} + q_{2})") == measure(r"\sin(q_{1} + q_{2})")
    assert measure(r"\dot{q}_{1}") == measure("q_{1}")
