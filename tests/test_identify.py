"""Parameters from torques along a motion: exact without noise, covered with it; bad data named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import FRESH, ROOT, Outcome
from engine_cases import ROBOTS

import robodyn as rd
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.parameters import identification
from robodyn.parameters.base_parameters import base_parameters, random_states
from robodyn.parameters.identification import identify
from robodyn.parameters.zero_phase import rates
from robodyn.scene.description import from_text
from robodyn.scene.rewrite import rewritten
from robodyn.scene.scene_values import SceneValues

Run = Callable[..., Outcome]
ARM = "robots/2r.yaml"


def other(mech: Mechanism, seed: int = 0) -> Mechanism:
    """The mechanism with masses, centres, inertias, dampers and springs changed by up to 20 %."""
    rng, scene = np.random.default_rng(seed), mech.description
    for name, (place, *_) in identification.own_numbers(scene).items():
        number = identification.number_at(scene, place) * (1.0 + rng.uniform(-0.2, 0.2))
        if name.startswith("links") and name.endswith("damping"):
            number += 0.05
        scene = identification.replaced(scene, place, number)
    return build(scene)


def torques(mech: Mechanism, states: list[np.ndarray]) -> np.ndarray:
    return rd.inverse_dynamics(mech, *states)[:, list(mech.actuated)]


def values(mech: Mechanism) -> dict[str, float]:
    return {x.text: x.value for x in base_parameters(mech)}


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_base_parameters_are_found_without_noise(path: Path) -> None:
    mech = rd.load(path)
    true, states = other(mech), random_states(mech, 120, seed=2)
    found = rd.identify(mech, *states, torques(true, states))
    expected = values(true)
    size = max(map(abs, expected.values()))
    assert {x.name for x in found.estimates} == set(expected)
    for x in found.estimates:
        assert abs(x.value - expected[x.name]) < 1e-9 * size
    assert not found.kept
    if not found.faults:
        text, known = path.read_text(), SceneValues(path.read_text(), str(path))
        changed = identification.changes(mech.description, found.description, known)
        again = build(from_text(rewritten(text, str(path), changed), str(path)))
        left = torques(again, states) - torques(true, states)
        assert np.abs(left).max() < 1e-9 * np.abs(torques(true, states)).max()


def test_moments_about_own_joints_are_written() -> None:
    """J goes with I, and with the mass and the centre that it is about."""
    text = (ROOT / "robots/2r.yaml").read_text().replace("I: 0.082", "J: 0.2764")
    mech = build(from_text(text, "2r.yaml"))
    true, states = other(mech), random_states(mech, 120, seed=2)
    found = rd.identify(mech, *states, torques(true, states))
    known = SceneValues(text, "2r.yaml")
    changed = identification.changes(mech.description, found.description, known)
    assert "links.upper arm.J" in changed
    again = build(from_text(rewritten(text, "2r.yaml", changed), "2r.yaml"))
    left = torques(again, states) - torques(true, states)
    assert np.abs(left).max() < 1e-9 * np.abs(torques(true, states)).max()


def test_named_numbers_are_found_without_noise() -> None:
    """m and r of one link together: the torques are not linear in them."""
    mech = rd.load(ARM)
    names = ["links.forearm.m", "links.forearm.r", "links.forearm.I", "links.upper arm.damping"]
    wanted = [1.3, 0.31, 0.05, 0.4]
    where = [identification.number_called(mech.description, name).place for name in names]
    true = build(identification.with_numbers(mech.description, where, np.array(wanted)))
    states = random_states(mech, 60, seed=3)
    found = identify(mech, *states, torques(true, states), of=names)
    assert [x.value for x in found.estimates] == pytest.approx(wanted, rel=1e-9)
    assert [x.scene for x in found.estimates] == [0.9, 0.25, 0.031, 0.0]


def test_numbers_that_the_data_do_not_tell_stay() -> None:
    mech = rd.load(ARM)
    states = random_states(mech, 60, seed=3)
    names = ["links.upper arm.m", "links.upper arm.r", "links.upper arm.I"]
    found = identify(mech, *states, torques(mech, states), of=names)
    assert [x.name for x in found.estimates] == names[:2]
    assert found.kept == ("links.upper arm.I",)


def test_joints_at_rest_keep_their_combinations() -> None:
    """The forearm alone moves, and slowly: gravity tells moments, nothing else does."""
    mech = rd.load(ARM)
    q = np.stack([np.full(50, 0.3), np.linspace(0, 2, 50)], axis=-1)
    still = [q, np.zeros_like(q), np.zeros_like(q)]
    true = other(mech)
    found = rd.identify(mech, *still, torques(true, still))
    told = {x.name for x in found.estimates}
    assert {"mx2", "my2"} <= told
    assert {"J1 + l1^2 m2", "d1", "J2", "d2"} <= set(found.kept)
    assert values(true)["mx2"] == pytest.approx(
        next(x.value for x in found.estimates if x.name == "mx2"), rel=1e-9
    )


def test_standard_errors_cover_the_truth_as_often_as_they_say() -> None:
    """200 draws of noise, other at each joint: 95 % intervals hold the truth in 92 to 98 %."""
    mech = rd.load(ARM)
    true, states = other(mech), random_states(mech, 150, seed=4)
    plain, expected = torques(true, states), values(true)
    names = ["links.forearm.m", "links.forearm.r"]
    where = [identification.number_called(mech.description, name).place for name in names]
    half = identification.with_numbers(mech.description, where, np.array([1.1, 0.22]))
    half_torques = torques(build(half), states)
    inside: list[bool] = []
    named: list[bool] = []
    for seed in range(200 if FRESH else 100):
        noise = np.random.default_rng(seed).normal(size=plain.shape) * [0.5, 0.05]
        found = rd.identify(mech, *states, plain + noise)
        inside += [abs(x.value - expected[x.name]) < 1.96 * x.error for x in found.estimates]
        found = identify(mech, *states, half_torques + noise, of=names)
        pairs = zip(found.estimates, (1.1, 0.22), strict=True)
        named += [abs(x.value - y) < 1.96 * x.error for x, y in pairs]
    assert 0.92 < np.mean(inside) < 0.98
    assert 0.91 < np.mean(named) < 0.985


def test_physical_numbers_are_kept_to() -> None:
    """Few and noisy rows make a negative inertia; with `physical` there is none."""
    mech = rd.load(ARM)
    states = [x[:12] for x in random_states(mech, 40, seed=5)]
    noise = np.random.default_rng(1).normal(size=(12, 2))
    tau = torques(mech, states) + 3.0 * noise
    assert rd.identify(mech, *states, tau).faults
    found = rd.identify(mech, *states, tau, physical=True)
    assert not found.faults
    assert all(x.m > 0.0 and x.I > 0.0 and x.damping >= 0.0 for x in found.description.links)
    assert not any(0.0 < x.damping < 1e-12 for x in found.description.links)  # at its bound
    good = torques(other(mech), states)
    free, bound = (rd.identify(mech, *states, good, physical=x) for x in (False, True))
    assert [x.value for x in bound.estimates] == [x.value for x in free.estimates]


def test_named_numbers_are_physical_too() -> None:
    mech = rd.load(ARM)
    states = [x[:12] for x in random_states(mech, 40, seed=5)]
    true = identification.with_numbers(
        mech.description,
        [identification.number_called(mech.description, "links.forearm.damping").place],
        np.array([-0.5]),  # as no scene has it
    )
    tau, names = torques(build(true), states), ["links.forearm.damping", "links.forearm.m"]
    free, bound = (identify(mech, *states, tau, of=names, physical=x) for x in (False, True))
    assert free.estimates[0].value == pytest.approx(-0.5, rel=1e-9)
    assert free.faults == ("links.forearm.damping = -0.5",)
    assert 0.0 <= bound.estimates[0].value < 1e-6
    assert bound.estimates[1].value > 0.0


def test_rates_are_not_shifted() -> None:
    t = np.linspace(0.0, 4.0, 2001)
    x = np.sin(3.0 * t)[:, None]
    assert np.abs(rates(t, x, 1)[:, 0] - 3.0 * np.cos(3.0 * t)).max() < 1e-9
    noisy = x + 1e-3 * np.random.default_rng(0).normal(size=x.shape)
    inner = slice(200, -200)
    for order, expected in ((1, 3.0 * np.cos(3.0 * t)), (2, -9.0 * np.sin(3.0 * t))):
        found = rates(t, noisy, order, cutoff=5.0)[:, 0]
        assert np.abs(found - expected)[inner].max() < (0.02, 0.5)[order - 1]


STICKY = """\
gravity: 9.81
links: [{name: a, m: 1, l: 1, r: 0.4, I: 0.1, friction: {torque: 0.5, static: 0.9}}]
"""


def stops(mech: Mechanism, points: list[list[float]]) -> tuple[np.ndarray, list[np.ndarray]]:
    """t (T,) and q, qd, qdd (T, n) through points at 0, 1, 2, .. s, with a stop at each."""
    times = np.arange(len(points), dtype=float)
    motion = rd.reference_motion(mech, points, times=times, profile="cycloidal")
    t = np.linspace(0.0, times[-1], 100 * len(points) - 99)
    return t, list(motion.states(t))


PAUSES = [0.0, 0.0, 1.0, 1.0, -0.5, -0.5]


@pytest.mark.parametrize("rated", [True, False])
def test_pauses_say_nothing_of_sliding_friction(robodyn: Run, tmp_path: Path, rated: bool) -> None:
    """The torque that holds it lies 0.35 N m off, anywhere within the static friction."""
    scene = tmp_path / "sticky.yaml"
    scene.write_text(STICKY)
    t, (q, qd, qdd) = stops(rd.load(scene), [[x] for x in PAUSES])
    rests = np.abs(qd) <= 1e-3 * np.abs(qd).max()
    slips = np.where(np.abs(qd) > 1e-9, 0.5 * np.sign(qd), 0.35)
    tau = (0.4**2 + 0.1) * qdd + 0.4 * 9.81 * np.cos(q) + slips
    names, columns = (
        ("t,q1,qd1,qdd1,tau1", (t, q, qd, qdd, tau)) if rated else ("t,q1,tau1", (t, q, tau))
    )
    rows = np.column_stack(columns).tolist()
    text = "\n".join([names, *(",".join(map(repr, row)) for row in rows)])
    call = ("identify", scene, "-", "--of", "links.a.m,links.a.friction.torque")
    done = robodyn(*call, stdin=text)
    told = json.loads(done.out)
    mass, friction = told["parameters"]
    close = 1e-9 if rated else 1e-5
    assert [mass["value"], friction["value"]] == pytest.approx([1.0, 0.5], rel=close)
    count = told["at_rest"]["tau1"]
    assert abs(count - rests.sum()) <= (0 if rated else 10)
    assert f"at rest are left out: {count} of 501 for tau1" in done.err
    told = json.loads(robodyn(*call, "--rest", 0.5, stdin=text).out)
    assert abs(told["at_rest"]["tau1"] - (np.abs(qd) <= 0.5).sum()) <= (0 if rated else 10)
    assert told["parameters"][1]["value"] == pytest.approx(0.5, rel=close)


@pytest.mark.filterwarnings("ignore:a joint with dry friction is at rest")
def test_a_joint_at_rest_leaves_the_equations_of_others() -> None:
    text = (
        (ROOT / ARM).read_text().replace("I: 0.082", "I: 0.082, friction: {torque: 1, static: 2}")
    )
    mech = build(from_text(text, "test"))
    t, states = stops(mech, [[x, y] for x, y in zip(PAUSES, [0, 1, 0.5, -1, 0, 0.7], strict=True)])
    tau = torques(mech, states)
    pause = np.abs(states[1][:, 0]) <= 1e-9
    tau[pause, 0] += 1.5
    found = identify(mech, *states, tau, t, ["links.forearm.m", "links.upper arm.friction.torque"])
    assert [x.value for x in found.estimates] == pytest.approx([0.9, 1.0], rel=1e-9)
    assert found.at_rest[:, 0][pause].all()
    assert not found.at_rest[:, 1].any()
    with pytest.raises(InputError, match="rest = -1"):
        identify(mech, *states, tau, t, rest=-1.0)
    alone = build(from_text(STICKY, "test"))
    t, states = stops(alone, [[x] for x in PAUSES])
    with pytest.raises(InputError, match="static friction rest, rows are left out"):
        identify(alone, *states, torques(alone, states), t, rest=1e3)


@pytest.mark.filterwarnings("ignore:a joint with dry friction is at rest")
def test_friction_of_a_joint_that_follows_is_felt_by_the_driven_one() -> None:
    """Where the crank of a four-bar stands still the rocker's static friction holds it, too."""
    text = (ROOT / "robots/four-bar.yaml").read_text()
    text = text.replace("name: rocker,", "name: rocker, friction: {torque: 0.4, static: 0.7},")
    mech = build(from_text(text, "test"))
    t, states = stops(mech, [[x] for x in PAUSES])
    tau = torques(mech, states)
    tau[np.abs(states[1][:, 0]) <= 1e-9] += 0.2
    found = identify(mech, *states, tau, t, ["links.coupler.m", "links.rocker.friction.torque"])
    masses = {x.name: x.m for x in mech.description.links}
    assert [x.value for x in found.estimates] == pytest.approx([masses["coupler"], 0.4], rel=1e-7)


def test_rates_at_uneven_times() -> None:
    """As at even ones, also where two rows are close together."""
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.002, 0.008, 1500))
    t[200:1300:100] = t[199:1299:100] + 1e-6
    noisy = (np.sin(3.0 * t) + 1e-3 * rng.normal(size=1500))[:, None]
    inner = slice(200, -200)
    for order, expected in ((1, 3.0 * np.cos(3.0 * t)), (2, -9.0 * np.sin(3.0 * t))):
        found = rates(t, noisy, order, cutoff=5.0)[:, 0]
        assert np.abs(found - expected)[inner].max() < (0.03, 0.7)[order - 1]


# -- the command ----------------------------------------------------------------------------------


def written(path: Path, mech: Mechanism, count: int = 200, rates: bool = True) -> Path:
    """A file of a motion, and of the torques that it needs."""
    t = np.linspace(0.0, 2.0, count)
    q = np.stack([np.sin((k + 2) * t + k) for k in range(mech.n)], axis=-1)
    qd = np.stack([(k + 2) * np.cos((k + 2) * t + k) for k in range(mech.n)], axis=-1)
    qdd = np.stack([-((k + 2) ** 2) * np.sin((k + 2) * t + k) for k in range(mech.n)], axis=-1)
    tau = rd.inverse_dynamics(mech, q, qd, qdd)
    parts = {"q": q, "qd": qd, "qdd": qdd, "tau": tau}
    if not rates:
        del parts["qd"], parts["qdd"]
    names = [f"{name}{k + 1}" for name in parts for k in range(mech.n)]
    rows = np.column_stack([t, *parts.values()]).tolist()
    lines = [",".join(["t", *names]), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return written(tmp_path / "data.csv", other(rd.load(ROOT / ARM)))


def test_the_scene_is_written_with_what_was_found(robodyn: Run, data: Path, tmp_path: Path) -> None:
    out, left = tmp_path / "new.yaml", tmp_path / "left.csv"
    done = robodyn("identify", ROOT / ARM, data, "-o", out, "--residuals", left)
    assert done.code == 0, done.err
    true, found = other(rd.load(ROOT / ARM)), rd.load(out)
    assert values(found) == pytest.approx(values(true), rel=1e-9, abs=1e-9)
    text = out.read_text()
    assert [x for x in text.splitlines() if x.startswith("#")] == [
        x for x in (ROOT / ARM).read_text().splitlines() if x.startswith("#")
    ]
    told = json.loads(done.out)
    assert told["rows"] == 200
    assert set(told["rms"]) == {"tau1", "tau2"}
    header, first, *_ = left.read_text().splitlines()
    assert header.endswith("tau1,tau2,residual1,residual2")
    assert first.startswith(data.read_text().splitlines()[1])
    assert abs(float(first.split(",")[-1])) < 1e-9


def test_scene_and_residuals_go_to_a_pipe_in_place_of_results(robodyn: Run, data: Path) -> None:
    done = robodyn("identify", ROOT / ARM, data, "-o", "-")
    assert rd.load(ROOT / ARM).name in done.out
    assert "condition" not in done.out
    done = robodyn("identify", ROOT / ARM, data, "--residuals", "-")
    assert len(done.rows) == 200
    done = robodyn("identify", ROOT / ARM, data, "--residuals", "-", "-o", "-")
    assert done.code == 2


def test_what_only_rounding_excites_stays(robodyn: Run, tmp_path: Path) -> None:
    """A crank at a constant speed; its rates are found, so that qdd is no exact zero."""
    file = tmp_path / "turn.csv"
    mech = rd.load(ROOT / "robots/pendulum.yaml")
    t = np.linspace(0.0, 1.0, 101)
    q = 6.0 * t[:, None]
    tau = rd.inverse_dynamics(mech, q, np.full_like(q, 6.0), np.zeros_like(q))
    rows = np.column_stack([t, q, tau]).tolist()
    file.write_text("t,q1,tau1\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    done = robodyn("identify", ROOT / "robots/pendulum.yaml", file)
    assert json.loads(done.out)["kept"] == ["J1"]
    done = robodyn(
        *("identify", ROOT / "robots/pendulum.yaml", file), "--of", "links.rod.I,links.rod.m"
    )
    assert json.loads(done.out)["kept"] == ["links.rod.I"]


def test_one_number_is_changed_where_one_is_named(robodyn: Run, data: Path, tmp_path: Path) -> None:
    out = tmp_path / "new.yaml"
    done = robodyn("identify", ROOT / ARM, data, "--of", "links.forearm.m", "-o", out)
    assert done.code == 0
    before, after = (p.read_text().splitlines() for p in (ROOT / ARM, out))
    changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert len(changed) == 1
    assert changed[0][0].split("m: ")[0] == changed[0][1].split("m: ")[0]


def test_rates_that_lack_are_found_and_told(robodyn: Run, tmp_path: Path) -> None:
    true = other(rd.load(ROOT / ARM))
    file = written(tmp_path / "data.csv", true, 2001, rates=False)
    done = robodyn("identify", ROOT / ARM, file)
    assert "Note: qd and qdd of q1, q2: by quintic splines" in done.err
    found = {x["name"]: x["value"] for x in json.loads(done.out)["parameters"]}
    assert found == pytest.approx(values(true), rel=1e-6, abs=1e-6)
    done = robodyn("identify", ROOT / ARM, file, "--cutoff", 40)
    assert "Butterworth low-pass (order 4, 40 Hz) forward and backward" in done.err
    done = robodyn("identify", ROOT / ARM, file, "--cutoff", 4000)
    assert (done.code, "--cutoff = 4000.0: must be between 0 and" in done.err) == (2, True)


def test_a_table_for_people(robodyn: Run, data: Path) -> None:
    done = robodyn("identify", ROOT / ARM, data, "--format", "table")
    assert "standard error" in done.out
    assert "J1 + l1^2 m2" in done.out


def edited(data: Path, change: Callable[[list[str]], list[str]]) -> Path:
    data.write_text("\n".join(change(data.read_text().splitlines())) + "\n")
    return data


def test_no_excitation_is_named(robodyn: Run, tmp_path: Path) -> None:
    scene = tmp_path / "flat.yaml"
    scene.write_text((ROOT / ARM).read_text().replace("gravity: 9.81", "gravity: 0"))
    rows = "".join(f"{k},0.1,0.2,0,0,0,0,0,0\n" for k in range(20))
    done = robodyn("identify", scene, "-", stdin="t,q1,q2,qd1,qd2,qdd1,qdd2,tau1,tau2\n" + rows)
    assert done.code == 2
    told = "no excitation: the motion tells nothing of J1 + l1^2 m2, d1, mx2, my2, J2, d2"
    assert told in done.err


def test_numbers_that_torques_do_not_tell_are_refused(robodyn: Run, data: Path) -> None:
    done = robodyn("identify", ROOT / ARM, data, "--of", "links.forearm.l")
    assert done.code == 2
    assert "links.forearm.l: torques are not linear in it, as in masses" in done.err
    way = f"robodyn fit {ROOT / ARM} --vary 'links.forearm.l=LOW:HIGH' --match {data}"
    assert f"{way} --columns tau1,tau2 (" in done.err
    done = robodyn("identify", ROOT / ARM, data, "--of", "links.forearm.z")
    assert "links.forearm.z: is no mass, moment, damping" in done.err
    done = robodyn("identify", ROOT / ARM, data, "--of", "links.forearm.m,")
    assert (done.code, "--of = links.forearm.m,: a name is" in done.err) == (2, True)
    mech = rd.load(ROOT / ARM)
    states = random_states(mech, 20)
    tau = torques(mech, states)
    with pytest.raises(InputError, match="twice"):
        identify(mech, *states, tau, of=["links[1].m", "links.forearm.m"])


def test_data_of_another_mechanism_are_told(robodyn: Run, data: Path) -> None:
    def swapped(lines: list[str]) -> list[str]:
        rng = np.random.default_rng(0)
        rows = [",".join([*x.split(",")[:-2], *map(str, rng.normal(size=2))]) for x in lines[1:]]
        return [lines[0], *rows]

    done = robodyn("identify", ROOT / ARM, edited(data, swapped))
    assert "% of tau1, " in done.err
    assert "% of tau2 are not told by" in done.err


def test_torques_of_one_joint_alone_may_be_those_of_another_mechanism(
    robodyn: Run, tmp_path: Path
) -> None:
    """A slide for a joint: what the first torque tells is most of all torques."""
    mech = rd.load(ROOT / ARM)
    data = written(tmp_path / "arm.csv", mech)
    done = robodyn("identify", ROOT / "robots/rp-arm.yaml", data)
    done.fails(2, "arm.csv: tau2 = 69.", "50 % at most", "These are data of another mechanism")


def test_smooth_data_of_another_mechanism_are_refused(robodyn: Run, tmp_path: Path) -> None:
    """What no parameters tell, and is no noise; noise, and friction that lacks, are told."""
    t = np.linspace(0.0, 2.0, 401)
    q = np.sin(t[:, None] * [3.0, 4.0])
    qd, qdd = np.cos(t[:, None] * [3.0, 4.0]) * [3.0, 4.0], -q * [9.0, 16.0]
    mech, noise = rd.load(ROOT / ARM), np.random.default_rng(0).normal(size=(401, 2))

    def told(tau: np.ndarray, file: str = "a.csv") -> Outcome:
        names = "t,q1,q2,qd1,qd2,qdd1,qdd2,tau1,tau2"
        table = np.column_stack([t, q, qd, qdd, tau])
        np.savetxt(tmp_path / file, table, delimiter=",", header=names, comments="")
        return robodyn("identify", ROOT / ARM, tmp_path / file)

    tau = torques(mech, [q, qd, qdd])
    assert told(tau).err == ""
    told(np.sin(t[:, None] * [31.0, 23.0])).fails(2, "a.csv: tau1 = ", "% of its rms is left",
                                                  "50 % at most", "another mechanism")  # fmt: skip
    for more in (30.0 * noise, 30.0 * np.sign(qd)):
        done = told(tau + more)
        assert done.code == 0
        assert "Warning" in done.err
    assert "below 0 by" in told(tau - 2.0 * qd + 0.1 * noise).err


def test_data_of_another_four_bar_do_not_close(robodyn: Run, tmp_path: Path) -> None:
    bar, rows = ROOT / "robots/four-bar.yaml", tmp_path / "bar.csv"
    robodyn("trajectory", bar, "--speed", "30rpm", "--turns", "1", "-o", rows).succeeds()
    table = robodyn("torque", bar, rows).succeeds().out
    done = robodyn("identify", bar, "-", "--set", "links.rocker.l=0.85", stdin=table)
    limit = "the loops are open: gap in position = 0.05 m: 3.25e-06 m at most"
    done.fails(2, "stdin: line 2", limit, "a closed motion of this mechanism")


@pytest.mark.parametrize("size", [0.0, 1e-200])
def test_torques_of_nothing_make_masses_of_nothing(robodyn: Run, data: Path, size: float) -> None:
    def scaled(lines: list[str]) -> list[str]:
        parts = [x.split(",") for x in lines[1:]]
        rows = [",".join([*x[:-2], *(repr(float(y) * size) for y in x[-2:])]) for x in parts]
        return [lines[0], *rows]

    done = robodyn("identify", ROOT / ARM, edited(data, scaled))
    assert done.code == 0
    assert max(abs(x["value"]) for x in json.loads(done.out)["parameters"]) < 1e-12


def test_a_free_joint_tells_its_part(robodyn: Run, tmp_path: Path) -> None:
    path = ROOT / "robots/cart-pole.yaml"
    mech = rd.load(path)
    rng = np.random.default_rng(1)
    q, qd, force = rng.normal(size=(3, 60, 2))
    force[:, 1] = 0.0
    true = other(mech)
    qdd = rd.forward_dynamics(true, q, qd, force)
    rows = np.column_stack([q, qd, qdd, force[:, 0]])
    lines = "".join(",".join(map(repr, x)) + "\n" for x in rows.tolist())
    header = "q1,q2,qd1,qd2,qdd1,qdd2,tau1\n"
    left = tmp_path / "left.csv"
    done = robodyn("identify", path, "-", "--residuals", left, stdin=header + lines)
    found = {x["name"]: x["value"] for x in json.loads(done.out)["parameters"]}
    assert found == pytest.approx(values(true), rel=1e-9, abs=1e-12)
    assert left.read_text().splitlines()[0].endswith("tau1,residual1")


def test_a_cutoff_for_nothing_and_a_leap_of_time_are_told(robodyn: Run, tmp_path: Path) -> None:
    mech = rd.load(ROOT / ARM)
    done = robodyn("identify", ROOT / ARM, written(tmp_path / "a.csv", mech), "--cutoff", "-3")
    assert (done.code, "--cutoff = -3.0: is for rates that lack" in done.err) == (2, True)
    data = edited(written(tmp_path / "b.csv", mech, rates=False), lambda x: [*x[:50], *x[90:]])
    done = robodyn("identify", ROOT / ARM, data)
    assert (done.code, "line 51: t leaps by" in done.err) == (2, True)
    assert "5 steps of 0.0" in done.err
    data = edited(written(tmp_path / "c.csv", mech, rates=False), lambda x: [*x[:9], *x[11:]])
    done = robodyn("identify", ROOT / ARM, data, "--cutoff", "20")
    assert (done.code, "by even steps of 0.0101523 s, a Butterworth" in done.err) == (0, True)


def test_noise_in_angles_is_named_before_another_mechanism(robodyn: Run, tmp_path: Path) -> None:
    """Encoder data at uneven times: 1 mrad of noise."""
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.008, 1500))[:, None]
    a, w = np.array([[0.8, 0.7], [0.3, 0.2]]), np.array([[2.0, 3.0], [5.0, 7.0]])
    p = np.array([[0.0, np.pi / 2], [1.0, 0.0]])
    angles = [w[k] * t + p[k] for k in range(2)]
    q = sum(a[k] * np.sin(angles[k]) for k in range(2))
    qd = sum(a[k] * w[k] * np.cos(angles[k]) for k in range(2))
    qdd = sum(-a[k] * w[k] ** 2 * np.sin(angles[k]) for k in range(2))
    tau = rd.inverse_dynamics(rd.load(ROOT / ARM), q, qd, qdd)
    rows = np.hstack([t, q + 1e-3 * rng.normal(size=q.shape), tau]).tolist()
    data = tmp_path / "noisy.csv"
    lines = ["t,q1,q2,tau1,tau2", *(",".join(map(repr, row)) for row in rows)]
    data.write_text("\n".join(lines) + "\n")
    first = "rates found from q follow its noise: give --cutoff, such as 10 (Hz); "
    done = robodyn("identify", ROOT / ARM, data)
    assert (done.code, first + "if it leaves more than 50 %" in done.err) == (2, True)
    done = robodyn("identify", ROOT / ARM, data, "--of", "links.forearm.m")
    assert (done.code, first + "or noise, friction" in done.err) == (0, True)
    done = robodyn("identify", ROOT / ARM, data, "--cutoff", 5)
    told = json.loads(done.out)
    assert "by even steps of 0.005" in done.err
    assert told["rms"]["tau2"] < 0.1 * told["rms_torque"]["tau2"]
    found = {x["name"]: x["value"] for x in told["parameters"]}
    assert found["mx2"] == pytest.approx(0.225, rel=0.02)
    assert found["J2"] == pytest.approx(0.08725, rel=0.02)
