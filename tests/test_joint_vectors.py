"""All joints, or the actuated ones and the rest assembled: one answer, of one state and of many."""

import numpy as np
import pytest

import robodyn
from random_mechanisms import mechanism
from robodyn.dynamics.joint_vectors import driver_of, full, vectors
from robodyn.loops.assembly import assemble
from robodyn.loops.loop_rates import loop_accelerations, loop_velocities

# a slider-crank whose rod is too short for a whole turn, and is in line with its guide at 0
SHORT = """
links:
  - {name: crank, m: 1, l: 0.3, r: 0.15, I: 0.01}
  - {name: rod,   m: 1, l: 0.25, r: 0.12, I: 0.01, from: crank}
closures:
  - {point: rod, on: {through: [0, 0], along: [1, 0]}}
actuated: [crank]
"""
KINDS = ("q", "qd", "qdd")


def random_rows(mech, count: int):
    rng, few = np.random.default_rng(1), len(driver_of(mech).actuated)
    return {name: rng.uniform(-3, 3, (count, few)) for name in KINDS}


def alone(mech, given, k: int):
    """What one row comes to by the functions that raise, and which of them does."""
    driver = driver_of(mech)
    q = assemble(driver, given["q"][k], t=0.0)
    qd = loop_velocities(driver, q, given["qd"][k], 0.0)
    return {"q": q, "qd": qd, "qdd": loop_accelerations(driver, q, qd, given["qdd"][k], 0.0)}


KINDS_OF = {
    "short": {"open", "singular", "closed"},
    "five-bar": {"closed"},
    "parallelogram": {"closed", "singular"},
    "cart-pole": {"closed"},
    "hoeken": {"closed"},
}


def outcome(mech, given, k: int):
    try:
        return "closed", alone(mech, given, k)
    except robodyn.AssemblyError:
        return "open", {}
    except robodyn.SingularError:
        return "singular", {}


@pytest.mark.parametrize("name", KINDS_OF)
def test_rows_that_need_not_close_are_those_that_close_alone(name: str) -> None:
    mech = mechanism(SHORT) if name == "short" else robodyn.load(name)
    given = random_rows(mech, 60)
    given["q"][0] = 0.0  # where a parallelogram may change its branch
    if name == "short":
        given["q"][1] = np.arcsin(0.25 / 0.3)  # the rod is at right angles to its guide
    missing = np.zeros(60)
    motion = full(mech, {x: (y, False) for x, y in given.items()}, t=0.0, missing=missing)
    kinds = set()
    for k, short in enumerate(missing):
        kind, right = outcome(mech, given, k)
        assert kind == ("singular" if np.isnan(short) else "open" if short > 0 else "closed")
        kinds.add(kind)
        for x in right:
            np.testing.assert_allclose(motion[x][k], right[x], rtol=1e-11, atol=1e-11)
    assert kinds == KINDS_OF[name]


def test_another_width_is_refused_with_both() -> None:
    mech = robodyn.load("four-bar")
    for call in (
        lambda: vectors(mech, q=[1.0, 2.0]),
        lambda: robodyn.State(mech, [1.0, 2.0]),
        lambda: robodyn.simulate(mech, [1.0, 2.0], [0.0], 1.0),
        lambda: robodyn.draw(mech, [1.0, 2.0]),
    ):
        with pytest.raises(
            robodyn.InputError, match=r"q\.shape = \(2,\): must have 3 .* 1 \(crank"
        ):
            call()


def test_functions_take_the_actuated_joints_alone() -> None:
    mech, t = robodyn.load("four-bar"), np.linspace(0.0, 0.3, 4)
    crank = 1.0 + 2.0 * t[:, None]
    q = robodyn.assemble(mech, crank)
    qd = robodyn.loop_velocities(mech, q, np.full((4, 1), 2.0))

    def both(call):
        return call(crank, np.full((4, 1), 2.0)), call(q, qd)

    few, every = both(lambda q, qd: robodyn.simulate(mech, q[0], qd[0], 0.2, [0.5]).q)
    np.testing.assert_array_equal(few, every)
    few, every = both(lambda q, qd: robodyn.animate(mech, t, q, qd).frames)
    np.testing.assert_array_equal(few.q, every.q)

    def fitted(q, qd):
        own = robodyn.simulate(mech, q[0], qd[0], 0.3, t_eval=t).q[:, :1]
        vary = {"links.crank.m": (0.1, 2.0), "q1": (0.8, 1.2)}
        return robodyn.fit_motion(mech, vary, ["q1"], t, q[0], qd[0], target=own + 0.1, starts=1)

    few, every = both(fitted)
    assert few.rms == pytest.approx(every.rms, rel=1e-6)

    def picture(q, qd):
        figure = robodyn.draw(mech, q[1], qd[1], forces=True)
        figure.canvas.draw()
        return np.asarray(figure.canvas.buffer_rgba())

    np.testing.assert_array_equal(*both(picture))
