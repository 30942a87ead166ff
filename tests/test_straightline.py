"""Generated straight-line code, on floats and on arrays, against the numpy evaluation."""

import math
import threading

import numpy as np
import pytest

from random_mechanisms import (
    LOOPS,
    Shape,
    assert_close,
    mechanism,
    seeded_scene,
    seeded_tree,
    sizes,
)
from robodyn.dynamics import closed_form as cf
from robodyn.dynamics import dynamics as dyn
from robodyn.engines import array_blocks, expression, formulas, straightline
from robodyn.engines.array_blocks import ArrayFormula
from robodyn.engines.expression import Graph
from robodyn.engines.formulas import Recorded

WRITINGS = pytest.mark.parametrize("by_direction", [False, True], ids=["by angle", "by direction"])

BLOCK = array_blocks.BLOCK


@pytest.fixture
def written(monkeypatch, by_direction):
    """Formulas are written this way, whatever the mechanism."""
    monkeypatch.setattr(formulas, "by_directions", lambda mechanism: by_direction)


def chain(n):
    """The shape of a chain of n links."""
    return Shape((None, *range(n - 1)))


def on_floats(formula, *states):
    """The outputs and the pivots of a formula's code on plain floats."""
    function = straightline.compile_floats(formula, "f")
    found = function(*(float(x) for state in states for x in state))
    return np.array(found[: len(formula.outputs)]), np.array(found[len(formula.outputs) :])


def on_arrays(formula, *states):
    """The same of a formula on arrays, for states (T, n)."""
    found = [np.full((len(states[0]), len(x)), np.nan) for x in (formula.outputs, formula.pivots)]
    ArrayFormula(formula.inputs, formula.outputs + formula.pivots).fill(states, found)
    return found


def source(formula):
    """The statements and results of a formula's float code as one text."""
    lines, outputs = straightline.float_source(formula.outputs)
    return "\n".join([*lines, *outputs])


def check_inverse(scene):
    """tau and lambda of both codes against numpy's, to 1e-13 of the terms."""
    mech = scene.mechanism
    formula = formulas.inverse_formula(mech)
    tau, lam = dyn.inverse_dynamics_and_forces(mech, *scene.states)[:2]
    expected = np.concatenate([tau, lam])
    size = sizes(mech.description).torque(scene.qd, scene.qdd) + np.abs(lam).sum()
    found, _ = on_floats(formula, *scene.states)
    assert_close(found, expected, size)
    many, _ = on_arrays(formula, *(np.tile(state, (3, 1)) for state in scene.states))
    assert_close(many, np.tile(found, (3, 1)), size)


def check_forward(scene):
    """qdd and lambda of both codes against numpy's, to 1e-13 of the terms over the inertia."""
    mech = scene.mechanism
    tau = 20.0 * np.cos(np.arange(scene.n))
    qdd, lam = dyn.forward_dynamics_and_forces(mech, scene.q, scene.qd, tau)[:2]
    least = np.linalg.eigvalsh(cf.mass_matrix(mech, scene.q))[0]
    size = sizes(mech.description).torque(scene.qd, qdd) / least + np.abs(lam).sum()
    formula = formulas.forward_formula(mech)
    found, _ = on_floats(formula, scene.q, scene.qd, tau)
    assert_close(found, np.concatenate([qdd, lam]), size)
    states = (np.tile(state, (3, 1)) for state in (scene.q, scene.qd, tau))
    many, _ = on_arrays(formula, *states)
    assert_close(many, np.tile(found, (3, 1)), size)


SIMPLE = {
    name: shape for name, shape in LOOPS.items() if len(shape.closures) * 2 + len(shape.sliders) < 3
}


class TestAgainstNumpy:
    @WRITINGS
    @pytest.mark.usefixtures("written")
    def test_as_many_links_as_code_is_generated_for(self):
        """Deep formulas are parsed, and differ from numpy's by rounding only."""
        scene = seeded_scene(0, chain(formulas.MAX_GENERATED))
        check_inverse(scene)
        check_forward(scene)

    def test_the_tree_and_its_loops_decide_how_formulas_are_written(self):
        """Chains of 2 and 3 links by angles, longer ones and loops by directions."""

        def costs(mech):
            ways = [formulas.inverse_of(Recorded(mech, ("qd", "qdd"), way)) for way in (0, 1)]
            chosen = formulas.inverse_formula(mech)
            return [expression.cost(f.outputs + f.pivots) for f in (chosen, *ways)]

        for n in range(2, 13):
            chosen, by_angle, by_direction = costs(seeded_scene(1, chain(n)).mechanism)
            assert chosen == min(by_angle, by_direction)
        chosen, _, by_direction = costs(seeded_scene(0, LOOPS["four-bar"]).mechanism)
        assert chosen == by_direction


class TestForm:
    @pytest.mark.parametrize("name", SIMPLE)
    def test_inputs_and_outputs_are_in_the_order_told(self, name):
        mech = seeded_scene(0, LOOPS[name]).mechanism
        n, r = mech.n, len(mech.rows)
        for formula, names in (
            (formulas.inverse_formula(mech), ("q", "qd", "qdd")),
            (formulas.forward_formula(mech), ("q", "qd", "tau")),
        ):
            assert formula.inputs == tuple(f"{name}{k}" for name in names for k in range(n))
            assert len(formula.outputs) == n + r
        assert len(formulas.forward_formula(mech).pivots) == r

    def test_floats_come_out_as_floats(self):
        scene = seeded_scene(0, LOOPS["four-bar"])
        function = straightline.compile_floats(formulas.inverse_formula(scene.mechanism), "f")
        found = function(*(float(x) for state in scene.states for x in state))
        assert {type(x) for x in found} == {float}
        assert found[1:3] == (0.0, 0.0)  # passive joints

    @pytest.mark.parametrize("name", sorted(set(LOOPS) - set(SIMPLE)))
    def test_no_inverse_formula_for_more_than_two_closure_rows(self, name):
        assert formulas.inverse_formula(seeded_scene(0, LOOPS[name]).mechanism) is None

    def test_no_inverse_formula_where_the_actuators_do_not_match(self):
        text = seeded_scene(0, LOOPS["four-bar"]).text
        for actuated in ("[]", "[link0, link1]"):
            mech = mechanism(text.replace("[link0]", actuated))
            assert formulas.inverse_formula(mech) is None


class TestPivots:
    """Relative to a good configuration: about 1 there, zero where the closures lose rank."""

    PARALLELOGRAM = """
links:
  - {{name: crank, m: 0.45, l: {c}, r: [{c}, 0], I: 0.0041}}
  - {{name: coupler, m: 1.1, l: {b}, r: [{c}, 0], I: 0.049}}
  - {{name: rocker, m: 0.55, l: {c}, r: [0, {c}], I: 0.0052, from: [{b}, 0]}}
closures: [[coupler, rocker]]
"""

    @pytest.mark.parametrize("kind", ["inverse", "forward"])
    def test_vanish_as_the_square_of_the_distance_from_a_change_point(self, kind):
        mech = mechanism(self.PARALLELOGRAM.format(c=0.3, b=0.7))
        formula = getattr(formulas, f"{kind}_formula")(mech)
        k, least = np.array([1.0, -1.0, 1.0]), []
        for angle in (1.0, 1e-3, 1e-6):
            _, pivots = on_floats(formula, angle * k, 0 * k, 0 * k)
            least.append(min(abs(pivots)))
        assert least[0] > 1e-2
        assert least[1] == pytest.approx(least[0] / math.sin(1.0) ** 2 * 1e-6, rel=0.9)
        assert least[2] / least[1] == pytest.approx(1e-6, rel=1e-3)

    @pytest.mark.parametrize("kind", ["inverse", "forward"])
    def test_do_not_change_with_the_size_of_the_mechanism(self, kind):
        """All lengths times 100 and inertias times 10^4: the same pivots."""
        k, found = np.array([1.0, -1.0, 1.0]), []
        for scale in (1.0, 100.0):
            text = self.PARALLELOGRAM.format(c=0.3 * scale, b=0.7 * scale)
            for I in (0.0041, 0.049, 0.0052):
                text = text.replace(f"I: {I}", f"I: {I * scale**2}")
            formula = getattr(formulas, f"{kind}_formula")(mechanism(text))
            found.append(on_floats(formula, 0.8 * k, 0 * k, 0 * k)[1])
        assert found[1] == pytest.approx(found[0], rel=1e-12)

    def test_open_chains_have_none(self):
        mech = seeded_tree(0, 3).mechanism
        assert formulas.inverse_formula(mech).pivots == ()
        assert formulas.forward_formula(mech).pivots == ()


class TestWhatIsNotNamedIsNotComputed:
    """A scene pays only for what it names."""

    ARM = """
{gravity}
links:
  - {{name: a, m: 2, l: 1, r: 0.5, I: 0.25{more}}}
  - {{name: b, m: 4, l: 1, r: {r}, I: 0.25{more}}}
"""

    def arm(self, gravity="", r=0.5, more=""):
        return mechanism(self.ARM.format(gravity=gravity, r=r, more=more))

    def test_pendulum_without_gravity_is_an_inertia(self):
        """I + m r^2 = 0.25 + 1 * 0.25."""
        mech = mechanism("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.25}]")
        assert source(formulas.inverse_formula(mech)) == "0.5*qdd0"
        assert source(formulas.forward_formula(mech)) == "2.0*tau0"

    def test_damping_is_one_term(self):
        mech = mechanism("links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.25, damping: 3}]")
        assert source(formulas.inverse_formula(mech)) == "0.5*qdd0 + 3.0*qd0"
        assert source(formulas.forward_formula(mech)) == "2.0*(tau0 - 3.0*qd0)"

    @pytest.mark.parametrize(
        ("gravity", "function"), [("gravity: [0, -4]", "cos"), ("gravity: [4, 0]", "sin")]
    )
    def test_gravity_along_an_axis_is_one_term(self, gravity, function):
        mech = mechanism(f"{gravity}\nlinks: [{{name: a, m: 1, l: 1, r: 0.5, I: 0.25}}]")
        assert source(formulas.inverse_formula(mech)) in (
            f"2.0*{function}(q0) + 0.5*qdd0",
            f"0.5*qdd0 + 2.0*{function}(q0)",
        )

    def test_no_gravity_no_gravity_term(self):
        """Without gravity the shoulder's angle enters nothing."""
        for write in (formulas.inverse_formula, formulas.forward_formula):
            free, heavy = write(self.arm()), write(self.arm("gravity: 9.81"))
            assert expression.cost(free.outputs) < expression.cost(heavy.outputs)
            assert "q0" not in source(free).replace("qd0", "").replace("qdd0", "")
            assert "q0" in source(heavy).replace("qd0", "").replace("qdd0", "")

    def test_no_damping_no_damping_term(self):
        """Each damped joint costs a product and a sum, in inverse dynamics, and no more."""
        free = formulas.inverse_formula(self.arm()).outputs
        damped = formulas.inverse_formula(self.arm(more=", damping: 0.5")).outputs
        assert expression.cost(damped) == expression.cost(free) + 4.0

    def test_balanced_links_do_not_couple(self):
        """The forearm's centre of gravity on the elbow: no sine or cosine is left."""
        for write in (formulas.inverse_formula, formulas.forward_formula):
            written = source(write(self.arm(r=0)))
            assert "sin" not in written
            assert "cos" not in written
            assert "qd0*" not in written.replace("qdd0", "")

    def test_shared_sines_are_computed_once(self):
        for write in (formulas.inverse_formula, formulas.forward_formula):
            written = source(write(self.arm("gravity: 9.81")))
            for call in ("sin(q1)", "cos(q1)", "cos(q0)"):
                assert written.count(call) <= 1


class TestBlocks:
    def doubled(self):
        """The formula 2 x of one column."""
        return ArrayFormula(["x"], [2.0 * Graph().variable("x")])

    @pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, 2 * BLOCK + 3])
    def test_every_row_is_computed_once(self, count):
        graph, x = Graph(), np.arange(2.0 * count).reshape(count, 2)
        y = np.full((count, 1), np.nan)
        total = graph.variable("a") + graph.variable("b")
        ArrayFormula(["a", "b"], [3.0 * total]).fill([x], [y])
        assert np.array_equal(y[:, 0], 3.0 * x.sum(axis=1))

    def test_many_states_are_shared_among_threads(self, monkeypatch):
        monkeypatch.setattr("os.cpu_count", lambda: 4)
        count = 16 * array_blocks.BLOCK + 5
        x, y = np.arange(float(count))[:, None], np.full((count, 1), np.nan)
        threads = set()

        def double(a, b, out):
            threads.add(threading.current_thread())
            np.multiply(a, b, out)

        monkeypatch.setitem(array_blocks._CALLS, "*", double)
        self.doubled().fill([x], [y])
        assert np.array_equal(y, 2.0 * x)
        assert len(threads) == min(4, array_blocks.MAX_THREADS)

    def test_a_failure_in_any_thread_is_raised(self, monkeypatch):
        monkeypatch.setattr("os.cpu_count", lambda: 2)
        x = np.arange(8.0 * array_blocks.BLOCK)[:, None]

        def fail_late(a, b, out):
            if b[-1] == x[-1]:
                raise MemoryError("late")
            out[...] = a * b

        monkeypatch.setitem(array_blocks._CALLS, "*", fail_late)
        with pytest.raises(MemoryError, match="late"):
            self.doubled().fill([x], [np.empty_like(x)])

    def test_singular_states_raise_no_numpy_warning(self):
        y = np.empty((3, 1))
        ArrayFormula(["x"], [1.0 / Graph().variable("x")]).fill([np.zeros((3, 1))], [y])
        assert np.isinf(y).all()
