"""States at any time within a run, which its segments have."""

import math
import pickle

import numpy as np
import pytest

from robodyn import assemble, load, simulate
from robodyn.errors import InputError
from robodyn.runs.settings import METHODS


class TestAnyTime:
    """`Motion.at`: states between the rows."""

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("name", ["2r", "four-bar"])
    def test_they_are_those_of_rows(self, method, name):
        mech = load(f"robots/{name}.yaml")
        q = assemble(mech, [1.0], t=0.0) if mech.rows else np.array([0.3, 0.4])
        times = np.linspace(0.0, 0.7, 50)
        how = {
            "method": method,
            "rtol": 1e-8,
            "atol": 1e-8,
            "tau": "sin(9*t)" + ", 0" * (mech.n == 2),
        }
        rows = simulate(mech, q, np.zeros(mech.n), 0.7, t_eval=times, **how)
        motion = simulate(mech, q, np.zeros(mech.n), 0.7, t_eval=[0.7], **how)
        found = motion.at(times)
        assert np.abs(found[0] - rows.q).max() < 1e-13
        assert np.abs(found[1] - rows.qd).max() < 1e-11
        one = motion.at(0.35)
        assert one[0].shape == (mech.n,)
        assert motion.at(times.reshape(5, 10))[1].shape == (5, 10, mech.n)

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_bouncing_block(self, method, tmp_path):
        """q = 1 - g t^2/2, then thrown back with half of its rate."""
        path = tmp_path / "block.yaml"
        path.write_text(
            "gravity: 9.81\nlinks:\n  - {name: block, joint: prismatic, axis: [0, 1], m: 1, "
            "l: 0.1, r: 0, I: 0, limits: {min: 0, restitution: 0.5}}\n"
        )
        g, hit = 9.81, math.sqrt(2 / 9.81)
        motion = simulate(load(path), [1.0], [0.0], 0.7, method=method, until="q1 < -1")
        q, qd = motion.at([0.2, hit - 1e-3, hit + 1e-3, 0.6])
        after = np.array([1e-3, 0.6 - hit])
        known = [
            1 - g * 0.04 / 2,
            1 - g * (hit - 1e-3) ** 2 / 2,
            *(0.5 * g * hit * after - g * after**2 / 2),
        ]
        assert q[:, 0] == pytest.approx(known, abs=1e-9)
        assert qd[-1, 0] == pytest.approx(0.5 * g * hit - g * after[1], abs=1e-9)

    def test_backwards_held_torques_and_until(self):
        mech = load("robots/2r.yaml")
        back = simulate(mech, [0.3, 0.4], [1.0, 0.0], -0.5)
        assert np.array_equal(back.at(back.t)[0], back.q)
        jumps = simulate(
            mech, [0.3, 0.4], [1.0, 0.0], 1.0, tau="5*sign(sin(9*t)), 0", until="t > 0.8"
        )
        assert np.abs(jumps.at(jumps.t)[1] - jumps.qd).max() < 1e-12
        with pytest.raises(InputError, match=r"t = 0.9: must be within the run, 0 to 0.8 s"):
            jumps.at([0.1, 0.9])

    @pytest.mark.parametrize("method", ["DOP853", "taylor"])
    def test_a_joint_that_starts_on_its_stop(self, method, tmp_path):
        """Thrown off its stop at once, the block rises as q = t - g t^2/2."""
        path = tmp_path / "block.yaml"
        path.write_text(
            "gravity: 9.81\nlinks:\n  - {name: block, joint: prismatic, axis: [0, 1], m: 1, "
            "l: 0.1, r: 0, I: 0, limits: {min: 0, restitution: 0.5}}\n"
        )
        motion = simulate(load(path), [0.0], [-2.0], 0.1, method=method)
        times = np.linspace(1e-3, 0.1, 7)
        assert motion.at(times)[0][:, 0] == pytest.approx(times - 9.81 * times**2 / 2, abs=1e-9)

    def test_the_same_times_have_the_same_bytes(self):
        mech = load("robots/2r.yaml")
        times = np.linspace(0.0, 1.0, 7)
        one, two = (simulate(mech, [0.3, 0.4], [1.0, 0.0], 1.0) for _ in range(2))
        two.at(0.77)
        assert all(np.array_equal(a, b) for a, b in zip(one.at(times), two.at(times), strict=True))

    def test_a_time_that_is_no_number_is_refused(self):
        motion = simulate(load("robots/2r.yaml"), [0.3, 0.4], [1.0, 0.0], 0.1)
        for wrong in ("soon", [0.05, "soon"], None, object()):
            with pytest.raises(InputError, match=r"t = .*must be"):
                motion.at(wrong)
        with pytest.raises(InputError, match="must be within the run"):
            motion.at(math.nan)

    def test_what_has_no_steps_has_its_start(self):
        motion = simulate(load("robots/2r.yaml"), [0.3, 0.4], [1.0, 0.0], 0.0)
        assert motion.at(0.0)[0].tolist() == [0.3, 0.4]
        again = pickle.loads(pickle.dumps(motion))
        with pytest.raises(InputError, match="pickled has its rows alone"):
            again.at(0.0)
