"""Torques of the actuated joints alone are taken wherever those of all joints are."""

import inspect
from contextlib import suppress

import numpy as np
import pytest

import robodyn

SCENES = {"four-bar": [1.0], "cart-pole": [0.3, 0.4], "slider-crank": [0.7]}


def posed(name):
    mech = robodyn.load(name)
    q = robodyn.assemble(mech, SCENES[name]) if mech.rows else np.array(SCENES[name])
    few = np.array([0.7])
    every = np.zeros(mech.n)
    every[list(mech.actuated)] = few
    return mech, q, few, every


def motion(mech, tau):
    """q, qd, qdd (T, n) and torques of some states, whether or not they fit one another."""
    rng = np.random.default_rng(3)
    drive = rng.uniform(-1, 1, (40, len(mech.actuated)))
    if not mech.rows:
        return (*rng.uniform(-1, 1, (3, 40, mech.n)), np.outer(drive[:, 0], tau))
    q = robodyn.assemble(mech, drive)
    qd = robodyn.loop_velocities(mech, q, drive)
    return q, qd, robodyn.loop_accelerations(mech, q, qd, 2 * drive), np.outer(drive[:, 0], tau)


def drawn(figure):
    """The picture's points."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba()).astype(float)


def poses(rests):
    return np.array([x.q for x in rests])


def found_of(mech, q, tau):
    """`fit_motion` of a crank's start to a motion that is driven so."""
    t = np.linspace(0.0, 0.2, 5)
    along = robodyn.simulate(mech, q, 0 * q, 0.2, tau, t_eval=t)
    given = {"target": along.q[:, :1], "starts": 1}
    vary = {f"links.{mech.link_names[0]}.m": (0.1, 9.0)}
    return robodyn.fit_motion(mech, vary, ["q1"], t, q, 0 * q, tau, **given).rms


CALLS = {
    "forward_dynamics": lambda m, q, tau: robodyn.forward_dynamics(m, q, 0 * q, tau),
    "forward_dynamics_and_forces": lambda m, q, tau: np.concatenate(
        robodyn.forward_dynamics_and_forces(m, q, 0 * q, tau)[:2]
    ),
    "forward_dynamics_derivatives": lambda m, q, tau: (
        robodyn.forward_dynamics_derivatives(m, q, 0 * q, tau).by_q
    ),
    "motor_loads": lambda m, q, tau: robodyn.motor_loads(m, tau, 0 * q),
    "linearize": lambda m, q, tau: robodyn.linearize(m, q, tau=tau).A,
    "equilibrium": lambda m, q, tau: robodyn.equilibrium(m, q, (), tau).q,
    "equilibria": lambda m, q, tau: poses(robodyn.equilibria(m, None, (), tau)),
    "simulate": lambda m, q, tau: robodyn.simulate(m, q, 0 * q, 0.1, tau).q,
    "draw": lambda m, q, tau: drawn(robodyn.draw(m, q, 0 * q, tau=tau, forces=True)),
    "State": lambda m, q, tau: robodyn.State(m, q, tau=tau).columns(["qdd1", "energy"]),
    "identify": lambda m, q, tau: robodyn.identify(m, *motion(m, tau), physical=False).rms,
    "fit_motion": found_of,
}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("name", CALLS)
def test_they_do_the_same(scene, name):
    mech, q, few, every = posed(scene)
    found = []
    for tau in (few, every):
        try:
            values = CALLS[name](mech, q, tau.tolist())
        except robodyn.RobodynError as error:  # of the pose, or of the motion
            values = str(error)
        found.append(np.array([*values.values()]) if isinstance(values, dict) else values)
    assert "tau has" not in str(found[0])
    assert "shape" not in str(found[0])
    if isinstance(found[0], str):
        assert found[0] == found[1]
    else:
        assert np.array_equal(*found, equal_nan=True)


def test_no_function_that_takes_torques_is_left_out():
    taking = set()
    for name in dir(robodyn):
        function = getattr(robodyn, name)
        if callable(function) and name not in ("Motion", "StateFeedback"):  # which hold them
            with suppress(ValueError, TypeError):  # what has no signature takes none
                if "tau" in inspect.signature(function).parameters:
                    taking.add(name)
    assert taking == set(CALLS)
