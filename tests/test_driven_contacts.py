"""Stops and dry friction beside laws of the time: closed forms, and scipy by phases of its own."""

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from random_mechanisms import mechanism
from robodyn import (
    assemble,
    coupling_torques,
    forward_dynamics_and_forces,
    loop_velocities,
    simulate,
)
from robodyn.dynamics.closed_form import coriolis_matrix, energies, gravity_vector, mass_matrix
from robodyn.loops.closures import closure_drift, closure_jacobian
from robodyn.runs.report import Outcome

METHODS = ["DOP853", "taylor"]
COMES_TO_REST = """
gravity: 9.81
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102, friction: {torque: 0.3, static: 0.4}}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0],
     friction: {torque: 0.1, static: 0.4}}
closures: [[coupler, rocker]]
couplings: "q1 = 1 - exp(-20 t)"
"""
BEAD = """
links:
  - {name: rod, m: 1.0, l: 1, r: 0.5, I: 0.1}
  - {name: bead, joint: prismatic, axis: [1, 0], from: {link: rod, at: [0, OFFSET]},
     m: 0.5, l: 0, r: 0, I: 0, limits: {max: 0.3, restitution: 0.6}}
couplings: "q1 = 3 rad/s t"
"""
TABLE = """
links:
  - {name: table, joint: prismatic, axis: [1, 0], m: 2, l: 0, r: 0, I: 0}
  - {name: block, joint: prismatic, axis: [1, 0], m: 0.7, l: 0, r: 0, I: 0, from: table,
     friction: {force: 2, static: 3}}
couplings: "q1 = 0.05 m sin(10 t)"
"""
# a base that is shaken, two links; the second one has a stop
ARM = """
gravity: 9.81
links:
  - {name: base, joint: prismatic, axis: [1, 0], m: 3, l: 0, r: 0, I: 0}
  - {name: upper, m: 1.1, l: 0.5, r: 0.2, I: 0.03, from: base}
  - {name: lower, m: 0.6, l: 0.4, r: 0.25, I: 0.01, from: upper,
     limits: {max: 0.4, restitution: 0.7}}
couplings: "q1 = 0.1 m sin(7 t)"
"""
# a law of joints and of the time between what sticks and what bounces
MIXED = """
gravity: 9.81
links:
  - {name: a, m: 1.0, l: 0.8, r: 0.4, I: 0.06, friction: {torque: 1.5, static: 2.5}}
  - {name: b, m: 0.9, l: 0.6, r: 0.3, I: 0.03}
  - {name: c, m: 0.4, l: 0.3, r: 0.15, I: 0.004, limits: {max: 0.5, restitution: 0.5}}
couplings: "q2 = 0.5 sin(2 t) + 0.3 q1 cos(t) + 0.1 q3^2"
"""
ROD = """
links: [{name: rod, m: 1.0, l: 1, r: 0.5, I: 0.1, friction: {torque: 2, static: 3}}]
couplings: "q1 = LAW"
"""
FOUR_BAR = """
gravity: 9.81
links:
  - {name: crank,   m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker,  m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0], LIMITS}
closures: [[coupler, rocker]]
couplings: "q1 = 5 rad/s t"
"""


def reduced(free, start, T):
    """The events and the last state of `MIXED`, in u = (q1, q3) alone, from rest of u.

    Its phases are told by friction's bounds and by impulses on u; `free` has no law.
    """
    still, moving, static, e, end = 0.0, 1.5, 2.5, 0.5, 0.5

    def along(t, u, v):
        (a, c), (ad, cd) = u, v
        f = 0.5 * math.sin(2 * t) + 0.3 * a * math.cos(t) + 0.1 * c * c
        drift = math.cos(2 * t) - 0.3 * a * math.sin(t)
        bend = -2 * math.sin(2 * t) - 0.3 * a * math.cos(t)
        bend += -2 * 0.3 * math.sin(t) * ad + 0.2 * cd * cd
        N = np.array([[1.0, 0.0], [0.3 * math.cos(t), 0.2 * c], [0.0, 1.0]])
        q, qd = np.array([a, f, c]), N @ v + [0.0, drift, 0.0]
        M = mass_matrix(free, q)
        bias = coriolis_matrix(free, q, qd) @ qd + gravity_vector(free, q) + M @ [0.0, bend, 0.0]
        return N.T @ M @ N, -N.T @ bias

    def rates(t, y, way):
        M, force = along(t, y[:2], y[2:])
        if not way:  # a is stuck
            return [0.0, y[3], 0.0, force[1] / M[1, 1]]
        return [*y[2:], *np.linalg.solve(M, force - [way * moving, 0.0])]

    def needed(t, y):  # what holds a
        M, force = along(t, y[:2], y[2:])
        return M[0, 1] * force[1] / M[1, 1] - force[0]

    def hits(t, y, way):
        return y[1] - end

    def turns(t, y, way):
        return y[2] * way if way else static - abs(needed(t, y))

    hits.terminal, hits.direction = True, 1
    turns.terminal, turns.direction = True, -1
    t, y, found = 0.0, np.array([*start, still, still]), []
    pull = needed(t, y)
    way = 0 if abs(pull) < static else -int(math.copysign(1, pull))
    while t < T:
        tight = {"rtol": 1e-12, "atol": 1e-13}
        part = solve_ivp(rates, (t, T), y, "DOP853", events=[hits, turns], args=(way,), **tight)
        t, y = part.t[-1], part.y[:, -1]
        if part.status != 1:
            break
        if len(part.t_events[0]):
            M, _ = along(t, y[:2], y[2:])
            push = np.linalg.solve(M, [0.0, 1.0])
            y[2:] -= (1 + e) * y[3] / push[1] * push
            y[1] = end
            found.append((t, "c hits its max"))
            if not way:
                found.append((t, "a starts"))
            way = int(math.copysign(1, y[2]))
        elif way:
            y[2] = 0.0
            pull = needed(t, y)
            way = 0 if abs(pull) < static else -int(math.copysign(1, pull))
            found += [] if way else [(t, "a stops")]
        else:
            way = -int(math.copysign(1, needed(t, y)))
            found.append((t, "a starts"))
            y[2] = way * 1e-14
    return found, y


def balance(mech, motion):
    """How much more energy there is in the end than work explains, and the energy in motion."""
    first, last = (np.sum(energies(mech, motion.q[k], motion.qd[k]), axis=0) for k in (0, -1))
    return abs(last - first - motion.report.work), motion.report.energy_in_motion


def named(motion, what):
    return [event.t for event in motion.events if event.name.endswith(what)]


class TestStops:
    @pytest.mark.parametrize("method", METHODS)
    def test_a_bead_bounces_at_the_end_of_a_turning_rod(self, method):
        """x'' = w^2 x; thrown back with u it returns as fast, after 2/w atanh(u/(w R))."""
        mech, w, R, e = mechanism(BEAD.replace("OFFSET", "0")), 3.0, 0.3, 0.6
        motion = simulate(mech, [0, 0.1], [w, 0], 4.0, method=method, rtol=1e-11, atol=1e-11)
        assert motion.outcome is Outcome.FINISHED
        t, u = math.acosh(R / 0.1) / w, w * math.sqrt(R * R - 0.01)
        times = [t]
        for _ in range(12):
            u *= e
            times.append(times[-1] + 2.0 / w * math.atanh(u / (w * R)))
        hits = named(motion, "hits its max")
        assert len(hits) > 15
        assert hits[:13] == pytest.approx(times, abs=1e-9)
        assert motion.q[-1] == pytest.approx([w * 4.0, R], abs=1e-9)
        missed, size = balance(mech, motion)
        assert missed < 1e-9 * size
        # pressed outwards it needs no torque of the drive
        rest = motion.q[-1], [w, 0.0]
        qdd, lam, _ = forward_dynamics_and_forces(mech, *rest, [0.0, 0.0], 4.0)
        assert qdd == pytest.approx([0, 0], abs=1e-12)
        assert coupling_torques(mech, lam[:1]) == pytest.approx([0], abs=1e-9)

    @pytest.mark.parametrize("method", METHODS)
    def test_the_drive_works_in_an_impact(self, method):
        """The rod goes on as its law tells, and the bead beside its axis kicks it."""
        mech = mechanism(BEAD.replace("OFFSET", "0.2").replace("3 rad/s t", "2 t + sin(t)"))

        def rates(t, y):  # x'' = w^2 x + w' 0.2
            w, bend = 2 + math.cos(t), -math.sin(t)
            return [y[1], w * w * y[0] + bend * 0.2]

        def end(t, y):
            return y[0] - 0.3

        end.terminal, end.direction = True, 1
        t, y, hits = 0.0, [0.1, 0.0], []
        while t < 1.2:
            part = solve_ivp(rates, (t, 1.2), y, "DOP853", rtol=1e-12, atol=1e-13, events=end)
            t, y = part.t[-1], part.y[:, -1]
            if part.status == 1:
                hits.append(t)
                y = [0.3, -0.6 * y[1]]
        tight = {"rtol": 1e-12, "atol": 1e-12, "method": method}
        motion = simulate(mech, [0, 0.1], [3, 0], 1.2, **tight)
        assert len(hits) == 2
        assert named(motion, "hits its max") == pytest.approx(hits, abs=1e-10)
        assert [motion.q[-1, 1], motion.qd[-1, 1]] == pytest.approx(y, abs=1e-9)
        missed, size = balance(mech, motion)
        assert missed < 1e-10 * size

    @pytest.mark.parametrize("method", METHODS)
    def test_an_arm_on_a_shaken_base(self, method):
        """An impulse at the lower joint alone: the double pendulum's equations by hand."""
        mech = mechanism(ARM)
        m1, l1, r1, I1 = 1.1, 0.5, 0.2, 0.03
        m2, r2, I2 = 0.6, 0.25, 0.01
        A, w, g = 0.1, 7.0, 9.81

        def inertia(a, b):  # in absolute angles
            c = m2 * l1 * r2 * math.cos(a - b)
            return np.array([[I1 + m1 * r1**2 + m2 * l1**2, c], [c, I2 + m2 * r2**2]])

        def rates(t, y):
            a, b, ad, bd = y
            s = m2 * l1 * r2 * math.sin(a - b)
            base, k1 = -A * w * w * math.sin(w * t), m1 * r1 + m2 * l1
            forces = [
                -s * bd**2 - k1 * g * math.cos(a) + k1 * base * math.sin(a),
                s * ad**2 - m2 * r2 * g * math.cos(b) + m2 * r2 * base * math.sin(b),
            ]
            return [ad, bd, *np.linalg.solve(inertia(a, b), forces)]

        def end(t, y):
            return y[1] - y[0] - 0.4

        end.terminal, end.direction = True, 1
        t, y, hits, T = 0.0, np.array([-1.2, -1.6, 0.0, 0.0]), [], 2.0
        tight = {"rtol": 1e-12, "atol": 1e-13}
        while t < T:
            part = solve_ivp(rates, (t, T), y, "DOP853", events=end, **tight)
            t, y = part.t[-1], part.y[:, -1]
            if part.status == 1:
                hits.append(t)
                push = np.linalg.solve(inertia(y[0], y[1]), [-1.0, 1.0])
                y[2:] -= 1.7 * (y[3] - y[2]) / (push[1] - push[0]) * push
                y[1] = y[0] + 0.4
        assert len(hits) == 3
        motion = simulate(mech, [0, -1.2, -0.4], [A * w, 0, 0], T, method=method, **tight)
        assert motion.outcome is Outcome.FINISHED
        assert named(motion, "hits its max") == pytest.approx(hits, abs=1e-8)
        last = [y[0], y[1] - y[0], y[2], y[3] - y[2]]
        assert [*motion.q[-1, 1:], *motion.qd[-1, 1:]] == pytest.approx(last, abs=1e-7)
        missed, size = balance(mech, motion)
        assert missed < 1e-9 * size

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("limits", ["{max: 2, restitution: 0.5}", "{max: 2}"])
    def test_nothing_throws_back_a_joint_that_a_law_leads(self, method, limits):
        mech = mechanism(FOUR_BAR.replace("LIMITS", f"limits: {limits}"))
        q = assemble(mech, [])
        motion = simulate(mech, q, loop_velocities(mech, q, []), 3.0, method=method)
        assert motion.outcome is Outcome.LIMIT
        assert motion.q[-1, 2] == pytest.approx(2.0, abs=1e-9)
        assert "q3 (rocker) passes its max, 2" in motion.report.ended_by
        assert "a law of the time leads the joint there" in motion.report.advice

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("restitution", [0, 0.5])
    def test_stops_that_leave_a_law_no_way(self, method, restitution):
        text = f"""
links:
  - {{name: a, joint: prismatic, axis: [1, 0], m: 5, l: 0, r: 0, I: 0,
     limits: {{max: 0.2, restitution: {restitution}}}}}
  - {{name: b, joint: prismatic, axis: [1, 0], m: 0.5, l: 0, r: 0, I: 0, from: a,
     limits: {{max: 0.3, restitution: {restitution}}}}}
couplings: "q2 = -q1 + 0.5 t"
"""
        motion = simulate(mechanism(text), [0, 0], [0.1, 0.4], 2.0, method=method)
        assert motion.outcome is Outcome.LAW
        assert motion.t[-1] == pytest.approx(1.0, abs=1e-9)
        told = "couplings[0] = -q1 + 0.5 t: cannot be kept at t = 1 s: the stops of"
        assert told in motion.report.advice


class TestFriction:
    @pytest.mark.parametrize("method", METHODS)
    def test_a_block_on_a_shaken_table(self, method):
        """It sticks up to 3 N, and slips under 2 N: piece by piece in closed form."""
        mech = mechanism(TABLE)
        A, w, m, moving, static = 0.05, 10.0, 0.7, 2.0, 3.0
        assert m * A * w * w > static
        T = 2.0

        def pull(t):  # what holds it while it sticks
            return -m * A * w * w * math.sin(w * t)

        t, x, ends = 0.0, 0.0, []
        while True:
            grid = np.linspace(t, T, 20001)
            gap = np.abs([pull(s) for s in grid]) - static
            over = np.flatnonzero(gap > 0.0)
            if not len(over):
                break
            first = grid[over[0]]
            if not over[0]:
                ends.pop()  # it turns back without a stop
            else:
                first = brentq(lambda s: abs(pull(s)) - static, grid[over[0] - 1], grid[over[0]])
            way = 1.0 if -pull(first) > 0 else -1.0  # the table leaves it behind, or it goes ahead

            def speed(s, t0=first, way=way):  # x2'' = -x1'' - way moving / m
                return A * w * (math.cos(w * t0) - math.cos(w * s)) - way * moving / m * (s - t0)

            grid = np.linspace(first, T, 20001)[1:]
            back = np.flatnonzero(way * np.array([speed(s) for s in grid]) < 0.0)
            last = brentq(speed, grid[back[0] - 1], grid[back[0]]) if len(back) else T
            ends += [first, last] if over[0] else [last]
            x += quad(speed, first, last, epsabs=1e-14)[0]
            t = last
            if last == T:
                break
        tight = {"rtol": 1e-11, "atol": 1e-12}
        motion = simulate(mech, [0, 0], [A * w, 0], T, method=method, **tight)
        found = sorted([*named(motion, "block starts"), *named(motion, "block stops")])
        assert len(ends) > 6
        assert found == pytest.approx([s for s in ends if s < T], abs=1e-8)
        assert motion.q[-1, 1] == pytest.approx(x, abs=1e-9)
        missed, size = balance(mech, motion)
        assert missed < 1e-9 * size

    @pytest.mark.parametrize("method", METHODS)
    def test_a_law_of_joints_and_the_time_beside_what_sticks(self, method):
        """What is stuck leaves Psi qd + d gap/dt = 0 for the others, and impacts keep it."""
        mech = mechanism(MIXED)
        q = assemble(mech, [-1.5, -0.4])
        qd = loop_velocities(mech, q, [0.0, 0.0])
        T, tight = 3.0, {"rtol": 1e-11, "atol": 1e-11}
        motion = simulate(mech, q, qd, T, method=method, **tight)
        assert motion.outcome is Outcome.FINISHED
        q1, q2, q3 = motion.q.T
        law = 0.5 * np.sin(2 * motion.t) + 0.3 * q1 * np.cos(motion.t) + 0.1 * q3**2
        np.testing.assert_allclose(q2, law, atol=1e-12)
        for t, y in [*zip(motion.t, np.hstack([motion.q, motion.qd]), strict=True)] + [
            (event.t, event.y)
            for event in motion.events  # after it
        ]:
            rate = closure_jacobian(mech, y[:3], t) @ y[3:] + closure_drift(mech, y[:3], t)
            assert np.abs(rate).max() < 1e-11
        missed, size = balance(mech, motion)
        assert missed < 1e-9 * size
        known, last = reduced(mechanism(MIXED.replace("couplings", "# ")), [-1.5, -0.4], T)
        assert {what for _, what in known} == {"a starts", "a stops", "c hits its max"}
        assert [event.name for event in motion.events] == [what for _, what in known]
        assert [event.t for event in motion.events] == pytest.approx(
            [t for t, _ in known], abs=1e-7
        )
        assert motion.q[-1, [0, 2]] == pytest.approx(last[:2], abs=1e-7)
        assert motion.qd[-1, [0, 2]] == pytest.approx(last[2:], abs=1e-6)

    @pytest.mark.parametrize("method", METHODS)
    def test_a_law_moves_a_joint_through_rest(self, method):
        """Friction of a led joint takes 2 N m over the way it goes, there and back."""
        mech = mechanism(ROD.replace("LAW", "0.4 sin(3 t)"))
        motion = simulate(mech, [0], [1.2], 2.0, method=method, rtol=1e-11, atol=1e-11)
        assert motion.outcome is Outcome.FINISHED
        way = quad(lambda t: abs(1.2 * math.cos(3 * t)), 0, 2, points=[math.pi / 6, math.pi / 2])[0]
        inertia = 0.1 + 0.25
        kinetic = 0.5 * inertia * (motion.qd[-1, 0] ** 2 - 1.2**2)
        assert motion.report.work == pytest.approx(kinetic, abs=1e-9)
        assert motion.report.energy_drift < 1e-9
        assert named(motion, "rod stops") == pytest.approx([math.pi / 6, math.pi / 2], abs=1e-8)
        # half a period, from one reversal to the next: the drive's work is what friction takes
        t = np.linspace(0, 2, 2001)
        states = 0.4 * np.sin(3 * t)[:, None], 1.2 * np.cos(3 * t)[:, None]
        _, lam, _ = forward_dynamics_and_forces(mech, *states, np.zeros((2001, 1)), t)
        torque = coupling_torques(mech, lam)[:, 0]
        expected = -3.6 * inertia * np.sin(3 * t) + 2.0 * np.sign(np.cos(3 * t))
        np.testing.assert_allclose(torque, expected, atol=1e-12)
        assert way > 0.9

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("law", ["0.3 t^4", "-0.2 t^3", "0.1*(t - 0.5)^5 + 0.003125"])
    def test_a_law_that_starts_slowly(self, method, law):
        mech = mechanism(ROD.replace("LAW", law))
        q = assemble(mech, [])
        motion = simulate(mech, q, loop_velocities(mech, q, []), 1.0, method=method)
        assert motion.outcome is Outcome.FINISHED
        assert motion.report.energy_drift < 1e-7

    @pytest.mark.parametrize("method", METHODS)
    def test_rates_below_rounding_are_quiet(self, method, recwarn):
        """A crank comes to rest as exp(-20 t): no noise of slips is followed."""
        mech = mechanism(COMES_TO_REST)
        q = assemble(mech, [])
        motion = simulate(mech, q, loop_velocities(mech, q, []), 10.0, method=method)
        assert motion.outcome is Outcome.FINISHED
        assert motion.report.steps < 100
        assert motion.report.events.get("coupler stops", 0) == 0
        assert not [x for x in recwarn if "too often" in str(x.message)]
        assert motion.q[-1, 0] == pytest.approx(1.0, abs=1e-15)
        assert motion.report.energy_drift < 1e-8

    def test_a_joint_beside_one_that_sticks_follows_the_law(self):
        """q1 sticks, and the law moves q2 from rest: it starts, and q1 keeps its place."""
        text = """
links:
  - {name: a, joint: prismatic, axis: [1, 0], m: 5, l: 0, r: 0, I: 0,
     friction: {force: 40, static: 50}}
  - {name: b, joint: prismatic, axis: [1, 0], m: 0.5, l: 0, r: 0, I: 0, from: a,
     friction: {force: 1, static: 2}}
couplings: "q2 = 0.2 q1 + 0.1 t^3"
"""
        mech = mechanism(text)
        motion = simulate(mech, [0, 0], [0, 0], 1.0, rtol=1e-10, atol=1e-10)
        assert motion.outcome is Outcome.FINISHED
        np.testing.assert_allclose(motion.q[:, 0], 0.0, atol=1e-12)
        np.testing.assert_allclose(motion.q[:, 1], 0.1 * motion.t**3, atol=1e-12)
        assert named(motion, "b starts")
        # the drive's work: friction over the way, and the block's energy
        assert motion.report.work == pytest.approx(0.5 * 0.5 * 0.3**2, abs=1e-8)
