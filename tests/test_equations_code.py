"""The written Python and C run on their own and give robodyn's numbers."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from c_library import compiled, needs_compiler
from sliding_scenes import SLIDING_SCENES
from unwritten import UNWRITTEN

from random_mechanisms import (
    LOOPS,
    assert_close,
    forced,
    mechanism,
    seeded_scene,
    seeded_tree,
    sizes,
)
from robodyn.dynamics import closed_form
from robodyn.equations.code import c99, python
from robodyn.equations.recorded import recorded
from robodyn.loops import closures
from robodyn.mechanics.mechanism import Mechanism, load

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
NAMES = sorted({path.stem for path in ROBOTS.glob("*.yaml")} - UNWRITTEN)


def expected(mech: Mechanism, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> dict:
    """What each function of the file gives, and its arguments."""
    M, C = closed_form.mass_matrix(mech, q), closed_form.coriolis_matrix(mech, q, qd)
    G, Q = closed_form.gravity_vector(mech, q), closed_form.other_forces(mech, q, qd)
    D = np.diag(mech.damping)
    found = {"M": ((q,), M), "C": ((q, qd), C), "D": ((), D), "G": ((q,), G), "Q": ((q, qd), Q)}
    if mech.rows:
        found["Psi"] = (q,), closures.closure_jacobian(mech, q, t=0.0)
        found["Psidot_qd"] = (q, qd), closures.closure_bias(mech, q, qd, t=0.0)
        found["gap"] = (q,), closures.closure_gap(mech, q, t=0.0)
    name = "joint_torques" if mech.rows else "inverse_dynamics"
    found[name] = (q, qd, qdd), M @ qdd + C @ qd + D @ qd + G - Q
    return found


def test_python_runs_without_robodyn(tmp_path: Path) -> None:
    """In an interpreter that sees no package at all."""
    mech = load(ROBOTS / "four-bar.yaml")
    q, qd, qdd = np.random.default_rng(3).uniform(-3, 3, (3, 3))
    (tmp_path / "motion.py").write_text(python(recorded(mech)), encoding="utf-8")
    known = expected(mech, q, qd, qdd)
    known = {name: known[name] for name in known if name not in "DQ"}  # the scene has neither
    calls = {name: [x.tolist() for x in arguments] for name, (arguments, _) in known.items()}
    code = f"""
import json, sys
sys.path.insert(0, {str(tmp_path)!r})
import motion
calls = json.loads(sys.argv[1])
print(json.dumps({{name: getattr(motion, name)(*given) for name, given in calls.items()}}))
print(sorted(name for name in sys.modules if "numpy" in name or "robodyn" in name))
"""
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code, json.dumps(calls)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    found, modules = done.stdout.splitlines()
    assert modules == "[]"
    for name, values in json.loads(found).items():
        assert_close(values, known[name][1], 100.0, 1e-14)


def assert_c_gives_the_same(
    mech: Mechanism, states: tuple[np.ndarray, ...], numeric: bool, folder: Path
) -> None:
    found = recorded(mech, numeric)
    library = compiled(c99(found), folder)
    has = {block.name for block in found.blocks}
    scale = 1.0 + max(float(np.abs(y).max()) for _, y in expected(mech, *states).values())
    size = sizes(mech.description)
    for name, (arguments, values) in expected(mech, *states).items():
        if name in "DGQ" and name not in has:
            assert not values.any()
            assert not hasattr(library, name)
            continue
        out = np.full(values.shape, np.nan)
        given = [np.ascontiguousarray(x, float) for x in (*arguments, out)]
        call = getattr(library, name)
        call.restype = None
        call(*(x.ctypes.data_as(ctypes.c_void_p) for x in given))
        assert_close(given[-1], values, scale + size.torque(*states[1:]), 1e-13)


@needs_compiler
@pytest.mark.parametrize("numeric", [False, True])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.thinned
def test_c_of_the_scenes_of_robots(name: str, numeric: bool, tmp_path: Path) -> None:
    mech = load(ROBOTS / f"{name}.yaml")
    q, qd, qdd = np.random.default_rng(5).uniform(-3, 3, (3, mech.n))
    assert_c_gives_the_same(mech, (q, qd, qdd), numeric, tmp_path)


@needs_compiler
@pytest.mark.parametrize("name", SLIDING_SCENES)
def test_c_of_prismatic_joints_and_slots(name: str, tmp_path: Path) -> None:
    mech = mechanism(SLIDING_SCENES[name])
    states = np.random.default_rng(5).uniform(-1, 1, (3, mech.n))
    assert_c_gives_the_same(mech, tuple(states), name == "turned", tmp_path)


@needs_compiler
@pytest.mark.parametrize("seed", range(6))
def test_c_of_random_mechanisms(seed: int, tmp_path: Path) -> None:
    """With ground pivots x1, y1: y1 is a function of math.h as well."""
    shape = list(LOOPS.values())[2 * seed % len(LOOPS)]
    plain = seeded_scene(seed, shape) if seed % 2 else seeded_tree(seed, 1 + seed)
    scene = forced(seed, plain) if seed > 1 else plain
    assert_c_gives_the_same(scene.mechanism, scene.states, bool(seed % 3), tmp_path)


HOSTILE = r"""
name: "end */ '' \\n \\"
gravity: 9.81
links:
  - {name: '/* a \', m: 1, l: 1, r: 0.5, I: 0.1, from: [0.1, 0.2]}
  - {name: "line\nimport nothing\u2028 */", m: 1, l: 1, r: 0.5, I: 0.1}
  - {name: '??/', m: 1, l: 1, r: 0.5, I: 0.1}
"""


@needs_compiler
def test_names_cannot_end_a_comment(tmp_path: Path) -> None:
    mech = mechanism(HOSTILE)
    library = compiled(c99(recorded(mech)), tmp_path)
    assert hasattr(library, "inverse_dynamics")
    names: dict = {}
    exec(compile(python(recorded(mech)), "equations.py", "exec"), names)
    q = [0.3, 0.4, 0.5]
    assert_close(names["G"](q), closed_form.gravity_vector(mech, q), 10.0)


def test_twelve_links_have_names_of_their_own() -> None:
    """cos(q12) is not cos(q1 + q2), and M1_12 not M11_2."""
    links = "".join(
        f"  - {{name: n{k}, m: 1, l: 0.{k + 1}, r: 0.5, I: 0.1, from: {at}}}\n"
        for k, at in enumerate(["[0, 0]", "n0", *["[0, 0]"] * 9, "n1"])
    )
    mech = mechanism("gravity: 9.81\nlinks:\n" + links)
    q, qd, qdd = np.random.default_rng(2).uniform(-3, 3, (3, 12))
    names: dict = {}
    exec(compile(python(recorded(mech)), "equations.py", "exec"), names)
    for name, (arguments, values) in expected(mech, q, qd, qdd).items():
        if name in names:
            assert_close(names[name](*arguments), values, 1.0 + float(np.abs(values).max()))


def chain(n: int) -> Mechanism:
    rng = np.random.default_rng(n)
    numbers = rng.uniform(0.2, 1.5, (n, 4)).round(3)
    links = "".join(
        f"  - {{name: n{k}, m: {m}, l: {l}, r: {r}, I: {I}}}\n"
        for k, (m, l, r, I) in enumerate(numbers)
    )
    return mechanism(f"gravity: 9.81\nlinks:\n{links}")


@needs_compiler
def test_twenty_links_are_short(tmp_path: Path) -> None:
    mech = chain(20)
    found = recorded(mech)
    assert max(len(write(found).encode()) for write in (python, c99)) < 200_000
    states = tuple(np.random.default_rng(2).uniform(-3, 3, (3, 20)))
    assert_c_gives_the_same(mech, states, False, tmp_path)
    names: dict = {}
    exec(compile(python(found), "equations.py", "exec"), names)
    for name, (arguments, values) in expected(mech, *states).items():
        if name in names:
            assert_close(names[name](*arguments), values, float(np.abs(values).max()))


@pytest.mark.parametrize("seed", range(4))
def test_parameters_may_be_given_other_values(seed: int) -> None:
    """Of another scene of the same shape: no entry holds a number of the first."""
    shape = list(LOOPS.values())[3 * seed % len(LOOPS)]
    scene = forced(seed, seeded_scene(seed, shape) if seed % 2 else seeded_tree(seed, 4))
    digits = re.compile(r"\d+\.\d+")
    changed = digits.sub(lambda found: repr(1.1 * float(found[0]) + 0.01), scene.text)
    one, other = recorded(scene.mechanism), recorded(mechanism(changed))
    names: dict = {}
    exec(compile(python(one), "equations.py", "exec"), names)
    assert [x.name for x in one.parameters] == [x.name for x in other.parameters]
    names |= {x.name: x.value for x in other.parameters}
    for name, (arguments, values) in expected(other.mechanism, *scene.states).items():
        if name in names:
            size = 1.0 + float(np.abs(values).max())
            assert_close(names[name](*arguments), values, size, 1e-12)


def test_lines_are_not_too_long() -> None:
    scene = forced(1, seeded_scene(1, LOOPS["six-bar, dyad on the coupler"]))
    each = [recorded(x) for x in (scene.mechanism, chain(18))]
    comments = ("#", "/*", " *", "static")
    for write in (python, c99):
        found = [line for x in each for line in write(x).splitlines()]
        code = [line for line in found if not line.startswith(comments) and "  # " not in line]
        assert max(map(len, code)) <= 100, write
