"""Machine code: sines, recorded graphs, batches, the cache on disk, and what stands in its way."""

from __future__ import annotations

import ctypes
import math
import os
import re
import stat
import subprocess
import sys
import threading

import mpmath
import numpy as np
import pytest
from conftest import ROOT

import robodyn as api
from machine_sines import hard_angles, run, sine_and_cosine
from random_mechanisms import LOOPS, mechanism, seeded_scene
from robodyn.dynamics import dense_dynamics, dynamics
from robodyn.engines import batches, expression, formulas, machine, segment
from robodyn.engines.assembler import Kernel, Module
from robodyn.engines.batches import Rows
from robodyn.engines.expression import Expression, Graph
from robodyn.mechanics.actuation import Actuation
from robodyn.runs import machine_motion
from robodyn.runs.machine_motion import Observer
from robodyn.runs.machine_steps import Scene

FAMILIES = pytest.mark.parametrize("family", ["", machine.PLAIN], ids=["this", "plain"])


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """Machine code is worth it for any number of states, and nothing is kept in this process."""
    monkeypatch.setattr(batches, "WORTH", 0.0)
    caches = (machine.available, machine.this_processor, dynamics._generated)
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty folder for objects."""
    folder = tmp_path / "objects"
    monkeypatch.setenv("ROBODYN_CACHE", str(folder))
    return folder


class TestSines:
    @FAMILIES
    def test_within_an_ulp_of_the_exact_ones(self, family):
        x = hard_angles(10_000)
        found = sine_and_cosine(x, family)
        with mpmath.workdps(40):
            for values, exact in zip(found, (mpmath.sin, mpmath.cos), strict=True):
                for angle, value in zip(x.tolist(), values.tolist(), strict=True):
                    error = abs(mpmath.mpf(value) - exact(mpmath.mpf(angle)))
                    assert error <= math.ulp(value), (angle, value)

    @FAMILIES
    def test_what_is_no_usual_angle_is_as_in_numpy(self, family):
        x = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e5, -1e5, 1e22, -1.7e308, 5e-324, 0.5])
        found = sine_and_cosine(x, family)
        with np.errstate(all="ignore"):
            expected = np.array([np.sin(x), np.cos(x)])
        assert np.array_equal(np.isnan(found), np.isnan(expected))
        np.testing.assert_array_max_ulp(found[:, np.isfinite(x)], expected[:, np.isfinite(x)])
        assert math.copysign(1.0, found[0, 1]) == -1.0

    def test_a_lane_does_not_depend_on_its_neighbours(self):
        x = np.linspace(-3.0, 3.0, 64)
        alone = sine_and_cosine(x)
        beside = x.copy()
        beside[::3] = np.tile([np.nan, 1e300], 11)
        kept = np.arange(64) % 3 != 0
        assert np.array_equal(alone[:, kept], sine_and_cosine(beside)[:, kept])

    @FAMILIES
    def test_arctangent(self, family):
        rng = np.random.default_rng(2)
        size = 10.0 ** rng.uniform(-8, 8, (2, 4000))
        y, x = size * rng.choice([-1.0, 1.0], size.shape)
        x[:6], y[:6] = (0.0, 0.0, 1.0, -1.0, -1.0, 2.0), (1.0, -1.0, 0.0, 0.0, -0.0, 2.0)
        found, _ = run(lambda k, w: [segment.arctangent(k, w[0], w[1])], y, x, family=family)
        np.testing.assert_array_max_ulp(found, np.arctan2(y, x), maxulp=3)


class TestGraphs:
    def test_every_operation(self):
        graph = Graph()
        x, y, p = graph.variable("x"), graph.variable("y"), graph.parameter("p", 0.7)
        outputs = [
            expression.call("exp", x) - expression.call("log", y * y + 1.5) * p,
            expression.power(y * y, 1.25) / (expression.call("tanh", x) + 2.0)
            + expression.call("sqrt", y * y),
            expression.least(x, y) - p * expression.greatest(x, 0.25),
            expression.choose(x, y, abs(x), -y)
            + (p * p - 3.0 * p) * expression.sin(expression.cos(x)),
        ]
        rng = np.random.default_rng(0)
        a, b = rng.normal(size=(2, 50))
        expected = [
            np.exp(a) - np.log(b * b + 1.5) * 0.7,
            (b * b) ** 1.25 / (np.tanh(a) + 2.0) + np.abs(b),
            np.minimum(a, b) - 0.7 * np.maximum(a, 0.25),
            np.where(a < b, abs(a), -b) + (0.49 - 2.1) * np.sin(np.cos(a)),
        ]
        rows = Rows([["x", "y"]], [outputs])
        found = np.empty((50, 4))
        assert rows.compile()([np.column_stack([a, b])], [found]).size == 0
        np.testing.assert_allclose(found.T, expected, rtol=1e-14, atol=1e-14)

    def test_parameters_are_as_good_as_constants(self):
        """What is computed of parameters alone stands before the loop, and folds as numbers do."""
        for mech in (
            api.load(ROOT / "robots/2r.yaml"),
            seeded_scene(0, LOOPS["four-bar"]).mechanism,
        ):
            for record in (formulas.inverse_formula, formulas.forward_formula):
                folded, open_ = record(mech), record(mech, parameters=True)
                costs = [expression.cost(f.outputs + f.pivots) for f in (folded, open_)]
                assert costs[1] <= 1.03 * costs[0]

    def test_scenes_of_one_shape_share_their_code(self):
        """And zeros belong to the shape."""
        text = (ROOT / "robots/2r.yaml").read_text()
        other = text.replace("1.5", "2.25").replace("0.36", "0.41").replace("9.81", "1.62")
        flat = text.replace("9.81", "0")
        written = []
        for scene in (text, other, flat):
            formula = formulas.inverse_formula(mechanism(scene), parameters=True)
            inputs = np.reshape(formula.inputs, (3, -1)).tolist()
            rows = Rows(inputs, [formula.outputs])
            written.append(rows.text(machine.this_processor()))
        assert written[0] == written[1] != written[2]

    def test_zeros_of_the_moment_are_told(self):
        graph = Graph()
        a, b, x = graph.parameter("a", 2.0), graph.parameter("b", 2.0), graph.variable("x")
        assert (a - b) * x == 0.0
        assert [node.op for node in graph.zeros] == ["-"]
        assert graph.parameter("none", 0.0) == 0.0
        assert not isinstance(graph.parameter("one", 1.0), Expression)


class TestBatches:
    def test_any_number_of_rows_wherever_they_stand(self):
        """Tails, columns of one table, rows that are one row, and no rows."""
        mech = api.load(ROOT / "robots/2r.yaml")
        table = np.random.default_rng(1).normal(size=(40, 6))
        rows = dynamics._generated("inverse", mech)
        function = rows.machine(1)
        expected = dense_dynamics.inverse(mech, table[:, :2], table[:, 2:4], table[:, 4:]).tau
        for total in range(20):
            states = [table[:total, :2], table[:total, 2:4], table[:total, 4:]]
            for arrays in (
                states,
                [np.array(x) for x in states],
                [np.asfortranarray(x) for x in states],
            ):
                found = np.full((total, 2), np.nan)
                assert function(arrays, [found]).size == 0
                np.testing.assert_allclose(found, expected[:total], rtol=1e-13, atol=1e-13)
        one = np.broadcast_to(table[0, :2], (9, 2))
        found = np.empty((9, 2))
        function([one, one, one], [found])
        assert np.ptp(found, axis=0).max() == 0.0

    def test_no_digit_depends_on_threads_or_place(self, monkeypatch):
        mech = api.load(ROOT / "robots/four-bar.yaml")
        rng = np.random.default_rng(1)
        states = rng.normal(size=(3, 1003, 3))
        whole = dynamics.forward_dynamics(mech, *states)
        monkeypatch.setattr("robodyn.engines.batches.SHARE", 300)
        monkeypatch.setattr("robodyn.engines.batches.PIECE", 77)
        assert np.array_equal(whole, dynamics.forward_dynamics(mech, *states))
        assert np.array_equal(whole[501:], dynamics.forward_dynamics(mech, *states[:, 501:]))

    def test_doubtful_states_are_told(self):
        mech = api.load(ROOT / "robots/four-bar.yaml")
        states = np.random.default_rng(1).normal(size=(3, 50, 3))
        states[0, 7] = 0.0  # stretched: the closures lose rank
        states[1, 20] = 1e200
        rows = dynamics._generated("inverse", mech)
        outputs = [np.empty((50, 3))]
        found = rows.machine(1)(list(states), outputs)
        assert {7, 20} <= set(found.tolist())
        _, by_numpy = rows.by_arrays(list(states), 1)
        assert np.array_equal(found, by_numpy)

    def test_what_is_not_finite_is_refused_by_its_place(self):
        mech = api.load(ROOT / "robots/2r.yaml")
        q, qd, qdd = np.zeros((3, 500, 2))
        qd[300, 1] = np.nan
        with pytest.raises(api.InputError, match=r"qd\[300, 1\]"):
            api.inverse_dynamics(mech, q, qd, qdd)

    def test_few_states_do_not_load_llvmlite(self, monkeypatch):
        monkeypatch.setattr(batches, "WORTH", 2e7)
        monkeypatch.setattr(machine, "make", lambda *_, **__: pytest.fail("made machine code"))
        api.inverse_dynamics(api.load(ROOT / "robots/2r.yaml"), *np.zeros((3, 5000, 2)))


def torques(mech=None):
    """Torques of 400 states of the 2R, and whether machine code gave them."""
    mech = mech or api.load(ROOT / "robots/2r.yaml")
    states = np.random.default_rng(4).normal(size=(3, 400, 2))
    tau = api.inverse_dynamics(mech, *states)
    np.testing.assert_allclose(
        tau, dense_dynamics.inverse(mech, *states).tau, rtol=1e-12, atol=1e-12
    )
    return dynamics._generated("inverse", mech).machine(1) is not None


class TestCache:
    def test_an_object_is_made_once_for_its_owner_alone(self, cache, monkeypatch):
        assert torques()
        (path,) = cache.iterdir()
        assert stat.S_IMODE(cache.stat().st_mode) == 0o700
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        monkeypatch.setattr(machine, "store", lambda *_: pytest.fail("made again"))
        assert torques()

    @pytest.mark.parametrize("content", [b"", b"no object", bytes(5000)])
    def test_a_damaged_object_is_made_anew(self, cache, content):
        assert torques()
        (path,) = cache.iterdir()
        good = path.read_bytes()
        for damaged in (content, good[:-1], good[:-1] + b"\1"):
            path.write_bytes(damaged)
            assert torques()
            assert path.read_bytes() == good

    def test_an_object_as_older_versions_kept_it_is_made_anew(self, cache):
        """A bare one; LLVM would abort the process over what is none."""
        assert torques()
        (path,) = cache.iterdir()
        good, content = path.read_bytes(), machine.load(cache, path.name)
        machine.store(cache, path.name, content[8:])
        assert torques()
        assert path.read_bytes() == good

    def test_what_others_can_write_or_own_is_not_read(self, cache, monkeypatch):
        assert torques()
        (path,) = cache.iterdir()
        name = path.name
        assert machine.load(cache, name) is not None
        path.chmod(0o666)
        assert machine.load(cache, name) is None
        path.chmod(0o600)
        cache.chmod(0o777)
        assert machine.load(cache, name) is None
        cache.chmod(0o700)
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
        assert machine.load(cache, name) is None
        assert torques()

    def test_a_link_is_not_followed(self, cache):
        assert torques()
        (path,) = cache.iterdir()
        path.rename(cache / "elsewhere")
        path.symlink_to(cache / "elsewhere")
        assert machine.load(cache, path.name) is None

    def test_no_folder_and_no_room(self, tmp_path, monkeypatch):
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("ROBODYN_CACHE", str(tmp_path / "file" / "below"))
        assert torques()
        monkeypatch.setenv("ROBODYN_CACHE", str(tmp_path / "full"))

        def full(*_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", full)
        assert torques()
        assert list((tmp_path / "full").iterdir()) == []

    def test_empty_turns_it_off(self, tmp_path, monkeypatch):
        monkeypatch.setenv("ROBODYN_CACHE", "")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        assert torques()
        assert list(tmp_path.iterdir()) == []
        monkeypatch.delenv("ROBODYN_CACHE")
        assert machine.folder() == tmp_path / "robodyn" or sys.platform != "linux"

    def test_old_objects_go(self, tmp_path, monkeypatch):
        monkeypatch.setattr(machine, "KEPT", 10)
        for k in range(30):
            machine.store(tmp_path, f"{k}", b"object")
        assert len(list(tmp_path.iterdir())) <= 11
        assert machine.load(tmp_path, "29") == b"object"

    def test_a_key_spares_the_text(self, cache):
        def write(processor):
            return "define i64 @f() {\n  ret i64 7\n}\n"

        for text in (write, lambda _: pytest.fail("written again")):
            assert machine.make(text, key="seven").function("f")() == 7

    def test_a_key_tells_the_sources_of_all_that_write_text(self):
        names = set()
        for path in (ROOT / "robodyn").rglob("*.py"):
            text = path.read_text()
            if "engines.assembler import" in text:
                names |= {path.parent.name, *re.findall(r"^from robodyn\.(\w+)", text, re.M)}
        named = names - {"tables", "errors", "dynamics"}  # which decide no text
        assert named | {"elements"} == set(machine.ROOMS)  # whose rows the mechanics writes


class TestWithout:
    """Python or numpy, silently, and right."""

    def test_llvmlite(self, monkeypatch):
        monkeypatch.setattr(machine, "find_spec", lambda name: None)
        assert not torques()

    def test_code_generation(self, monkeypatch):
        monkeypatch.setenv("ROBODYN_CACHE", "")
        monkeypatch.setattr(Rows, "text", lambda self, processor: "no text of LLVM")
        assert not torques()

    def test_llvmlite_that_does_not_load(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
        monkeypatch.setitem(sys.modules, "llvmlite", None)
        monkeypatch.setattr(machine, "find_spec", lambda name: object())
        assert not torques()

    @pytest.mark.skipif(sys.platform != "linux", reason="asks Linux to forbid it")
    def test_permission_to_run_what_was_written(self):
        """A process that may not make memory executable."""
        script = """
import ctypes, sys
sys.path[:0] = ["tests"]
import numpy as np
import robodyn
from robodyn import dynamics
from robodyn.engines import batches, machine
batches.WORTH = 0.0
if ctypes.CDLL(None).prctl(65, 1, 0, 0, 0):  # PR_SET_MDWE, since Linux 6.3
    sys.exit(77)
mech = robodyn.load("robots/2r.yaml")
states = np.random.default_rng(4).normal(size=(3, 400, 2))
tau = robodyn.inverse_dynamics(mech, *states)
assert not machine.available()
assert abs(tau[0] - robodyn.inverse_dynamics(mech, *states[:, 0])).max() < 1e-12
"""
        done = subprocess.run(
            [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True
        )
        if done.returncode == 77:
            pytest.skip("this kernel cannot forbid it")
        assert (done.returncode, done.stderr) == (0, "")

    def test_permission_is_asked_for(self, monkeypatch):
        monkeypatch.setattr(machine, "executable_memory", lambda: False)
        assert not torques()


class TestTogether:
    def test_threads_make_and_run_it_at_once(self, cache):
        found = []
        threads = [threading.Thread(target=lambda: found.append(torques())) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert found == [True] * 6

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
    def test_a_forked_process_runs_and_makes_it(self):
        script = """
import os, sys
sys.path[:0] = ["tests"]
import numpy as np
import robodyn
from robodyn.engines import batches, machine
batches.WORTH = 0.0
states = np.random.default_rng(4).normal(size=(3, 400, 2))
arm, bar = (robodyn.load(f"robots/{name}.yaml") for name in ("2r", "pendulum"))
tau = robodyn.inverse_dynamics(arm, *states)
machine._lock.acquire()  # as if another thread held it
child = os.fork()
if not child:
    same = np.array_equal(tau, robodyn.inverse_dynamics(arm, *states))
    robodyn.inverse_dynamics(bar, *states[:, :, :1])
    os._exit(0 if same else 1)
_, status = os.waitpid(child, 0)
sys.exit(os.waitstatus_to_exitcode(status))
"""
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", script],
            cwd=ROOT, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")


class TestKernelLanguage:
    @FAMILIES
    def test_rough_powers(self, family):
        x = 10.0 ** np.random.default_rng(0).uniform(-200, 200, 800)

        def write(k, words):
            return [segment.rough_power(k, words[0], -1 / 12)]

        power, _ = run(write, x, family=family)
        np.testing.assert_allclose(power, x ** (-1 / 12), rtol=0.07)
        assert np.isfinite(run(write, np.zeros(8), family=family)[0]).all()

    @FAMILIES
    def test_series_with_the_order_as_a_loop(self, family):
        """The product of two series of order 9 in each lane, from and to work arrays."""
        order = 9

        def write(processor):
            module = Module(processor.lanes)
            k = Kernel(module, "product", ("ptr", "ptr", "ptr"))
            x, y, z = k.arguments
            with k.loop(k.whole(order + 1)) as n:
                total = k.slot(k.number(0.0))
                with k.loop(k.add(n, k.whole(1))) as j:
                    factors = (x, j), (y, k.subtract(n, j))
                    a, b = (k.load(k.at(base, i, k.numbers)) for base, i in factors)
                    k.set(total, k.intrinsic("fma", a, b, k.get(total)))
                k.store(k.get(total), k.at(z, n, k.numbers))
            k.done(k.whole(0))
            return module.text

        code = machine.make(write, family=family)
        x, y = np.random.default_rng(0).normal(size=(2, order + 1, code.processor.lanes))
        z = np.full_like(x, np.nan)
        function = code.function("product", *[ctypes.c_void_p] * 3)
        function(*(array.ctypes.data for array in (x, y, z)))
        expected = [sum(x[j] * y[n - j] for j in range(n + 1)) for n in range(order + 1)]
        np.testing.assert_allclose(z, expected, rtol=1e-13, atol=1e-13)

    def test_control(self):
        """Loops in loops, slots and a branch: the sum of i j over pairs with i < j < 30."""

        def write(processor):
            module = Module(processor.lanes)
            k = Kernel(module, "pairs", ("i64",))
            total = k.slot(k.whole(0))
            count = k.arguments[0]
            with k.loop(count) as i, k.loop(count) as j, k.when(k.compare("slt", i, j)):
                k.set(total, k.add(k.get(total, "i64"), k.multiply(i, j)))
            k.done(k.get(total, "i64"))
            return module.text

        function = machine.make(write).function("pairs", ctypes.c_int64)
        assert function(30) == sum(i * j for j in range(30) for i in range(j))


@pytest.mark.parametrize("name", ["hydraulic-boom", "spring-slider-crank", "cart-pole"])
def test_a_series_does_not_depend_on_what_is_summed_together(name):
    mech = api.load(ROOT / f"robots/{name}.yaml")
    scene = Scene(mech, Actuation((0.5,) * mech.n), 12, work=True, closes=False, rate_series=True)
    found = []
    for lanes, together in ((1, 16), (1, 1), (1, 3), (2, 2), (4, 5), (8, 16), (8, 3)):

        def write(processor, together=together):
            return machine_motion.text(scene, Observer(), processor._replace(together=together))

        code = machine.make(write, lanes=lanes)
        block = np.zeros((scene.items, lanes))
        scene.fill(block, 1e-9, 1e-9)
        state = np.random.default_rng(1).uniform(0.2, 0.5, 2 * mech.n)
        block[: 2 * mech.n] = state[:, None]
        code.function("expand", ctypes.c_void_p, result=None)(block.ctypes.data)
        parts = [("rows", 14 * len(scene.loop.columns)), ("rate0_0", 13 * mech.n)]
        found.append(np.concatenate([block[scene.whole[part] :][:size] for part, size in parts]).T)
    assert np.isfinite(found[0]).all()
    for each in found[1:]:
        assert (each == found[0]).all()
