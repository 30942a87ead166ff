"""Chunks of a sweep against single simulations, the same for any workers, on a real cluster."""

import itertools
import math
import socket
import threading
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from conftest import FRESH, ROOT

from robodyn import (
    assemble,
    inverse_dynamics,
    kinetic_energy,
    potential_energy,
    simulate,
)
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.elements.joints import SmoothFriction
from robodyn.engines import machine
from robodyn.errors import DescriptionError, InputError, RobodynError
from robodyn.loops import loop_rates
from robodyn.loops.change_points import MISSES
from robodyn.mechanics.mechanism import build
from robodyn.scene.description import from_text
from robodyn.scene.scene_values import SceneValues
from robodyn.sweeps import sweep_chunks, sweep_workers
from robodyn.sweeps.sweep_chunks import Rows, run_chunk
from robodyn.sweeps.sweep_plan import Axis, Plan, Variation, check, spaced
from robodyn.sweeps.sweep_request import SweepRequest, lacks_machine_code, plan_of
from robodyn.sweeps.sweep_workers import results

METHODS = ["DOP853"]  # one by one; and in lanes
if machine.available():
    METHODS.append("taylor")


def text(name: str) -> str:
    return (ROOT / f"robots/{name}.yaml").read_text()


def plan(name: str, *axes: Axis, sample: int | None = None, seed: int = 0, **options) -> Plan:
    scene = text(name)
    joints = len(build(from_text(scene, name)).actuated)
    zero = (0.0,) * joints
    given = {"q": zero, "qd": zero, "tau": zero, "qdd": zero, "t_end": 1.0} | options
    return Plan(scene, name, Variation(axes, sample, seed), **given)


def whole(plan: Plan, **options) -> Rows:
    parts = [*results(plan, **options)]
    outcomes = [*itertools.chain.from_iterable(part.outcomes for part in parts)]
    return Rows(np.concatenate([part.values for part in parts]), outcomes)


@cache
def alone(method: str) -> Rows:
    """`TestWorkers.SMALL` by one process."""
    return whole(replace(TestWorkers.SMALL, method=method), workers=1)


def column(plan: Plan, rows: Rows, name: str) -> np.ndarray:
    return rows.values[:, plan.columns().index(name)]


SWING = plan(
    "2r",
    Axis("links.forearm.m", spaced(0.5, 1.5, 3)),
    Axis("links.upper arm.l", (0.7, 0.8)),
    Axis("q1", spaced(-1.0, 1.0, 3)),
    Axis("qd2", (0.5,)),
    Axis("tau2", (0.0, 0.4)),
)


@pytest.mark.parametrize("method", METHODS)
class TestMotions:
    def test_rows_are_single_simulations(self, method) -> None:
        swing = replace(SWING, method=method)
        rows = whole(swing)
        assert rows.outcomes == ["finished"] * 36
        scene = SceneValues(swing.scene, "x")
        names = [axis.name for axis in swing.variation.axes]
        assert swing.columns()[:5] == names
        for row in rows.values:
            at = dict(zip(names, row[:5], strict=True))
            arm = build(scene.replaced({name: at[name] for name in names[:2]}))
            motion = simulate(
                arm, [at["q1"], 0], [0, at["qd2"]], 1.0, tau=[0, at["tau2"]], rtol=1e-11, atol=1e-11
            )
            end = [1.0, *motion.q[-1], *motion.qd[-1]]
            assert row[5:10] == pytest.approx(end, abs=2e-7)

    def test_loops_and_what_cannot_be_assembled(self, method) -> None:
        four_bar = plan(
            "four-bar",
            Axis("links.crank.l", (0.35, 1.2)),
            Axis("q1", spaced(0.0, 3.0, 5)),
            qd=(2.0,),
            method=method,
        )
        rows = whole(four_bar)
        scene = SceneValues(four_bar.scene, "x")
        assert {"finished", "cannot assemble"} == set(rows.outcomes)
        for row, outcome in zip(rows.values, rows.outcomes, strict=True):
            bar = build(scene.replaced({"links.crank.l": row[0]}))
            try:
                q = assemble(bar, [row[1]])
            except RobodynError:
                assert outcome == "cannot assemble"
                assert np.isnan(row[2:]).all()
                continue
            assert outcome == "finished"
            qd = loop_rates.loop_velocities(bar, q, [2.0], t=0.0)
            motion = simulate(bar, q, qd, 1.0, rtol=1e-11, atol=1e-11)
            assert row[3:9] == pytest.approx([*motion.q[-1], *motion.qd[-1]], abs=1e-6)

    def test_energies_are_those_of_single_simulations(self, method) -> None:
        """That of what stands still at another height counts too."""
        lever = plan("whitworth", Axis("q1", (0.5, 1.5)), results=("extremes",), method=method)
        rows, mech = whole(lever), build(from_text(lever.scene, "x"))
        assert abs(mech.energy_offset) > 1.0
        for row, *ends in zip(
            rows.values, column(lever, rows, "energy_min"), column(lever, rows, "energy_max"),
            strict=True,
        ):  # fmt: skip
            q, qd = assemble(mech, row[:1]), np.zeros(mech.n)
            motion = simulate(mech, q, qd, 1.0, t_eval=np.linspace(0.0, 1.0, 201))
            energy = kinetic_energy(mech, motion.q, motion.qd)
            energy = energy + potential_energy(mech, motion.q)
            assert ends == pytest.approx([energy.min(), energy.max()], abs=1e-4)

    def test_rotors_have_energy(self, method) -> None:
        """1/2 (I + m r^2 + ratio^2 J) w^2 of a free wheel, and no more or less."""
        scene = "links: [{name: wheel, m: 2, l: 1, r: 0.1, I: 0.3, "
        scene += "motor: {ratio: 20, inertia: 1e-3}}]"
        options = {"results": ("extremes",), "method": method, "t_end": 1.0}
        wheel = Plan(
            scene, "x", Variation((Axis("qd1", (1.0, 3.0)),), None, 0),
            q=(0.0,), qd=(0.0,), tau=(0.0,), qdd=(0.0,), **options,
        )  # fmt: skip
        expected = 0.5 * (0.3 + 2 * 0.1**2 + 20**2 * 1e-3) * np.array([1.0, 9.0])
        rows = whole(wheel)
        for name in ("energy_min", "energy_max"):
            assert column(wheel, rows, name) == pytest.approx(expected, rel=1e-9)

    def test_springs_go_together(self, method, monkeypatch) -> None:
        if method == "taylor":
            monkeypatch.setattr("robodyn.sweeps.sweep_chunks.single", None)
        axes = Axis("springs[0].stiffness", (100.0, 350.0)), Axis("q1", (1.0, 2.0))
        crank = plan("spring-slider-crank", *axes, t_end=0.5, method=method)
        rows = whole(crank)
        for row in rows.values:
            scene = SceneValues(crank.scene, "x").replaced({"springs[0].stiffness": row[0]})
            motion = simulate(build(scene), assemble(build(scene), [row[1]]), [0, 0], 0.5)
            assert row[3:7] == pytest.approx([*motion.q[-1], *motion.qd[-1]], abs=1e-6)

    def test_friction_and_gears_go_together(self, method, monkeypatch) -> None:
        if method == "taylor":
            monkeypatch.setattr("robodyn.sweeps.sweep_chunks.single", None)
        axes = Axis("links.crank.damping", (0.0, 0.1)), Axis("q1", (1.0,))
        crank = plan("spring-slider-crank", *axes, t_end=0.3, method=method)
        rubbing = crank.scene.replace(
            "name: crank,", "name: crank, friction: {torque: 1, speed: 0.1},"
        )
        assert rubbing != crank.scene
        geared = plan("geared-five-bar", Axis("q1", (0.3, 0.5)), t_end=0.3, method=method)
        for each in (replace(crank, scene=rubbing), geared):
            rows = whole(each)
            assert rows.outcomes == ["finished"] * 2
            assert column(each, rows, "drift").max() < 1e-6
            mechanism = build(SceneValues(each.scene, "x").base)
            assert mechanism.of(SmoothFriction) or mechanism.description.couplings
            start = assemble(mechanism, [rows.values[0, list(each.columns()).index("q1")]])
            motion = simulate(mechanism, start, 0.0 * start, 0.3, rtol=1e-11, atol=1e-11)
            found = [column(each, rows, f"q{k + 1}_end")[0] for k in range(mechanism.n)]
            assert found == pytest.approx(motion.q[-1], abs=1e-7)

    def test_a_spring_that_has_no_direction_is_told(self, method) -> None:
        links = ", ".join(f"{{name: {x}, m: 1, l: 1, r: 0.5, I: 0.1}}" for x in "ab")
        ends = "[{link: a, at: [1, 0]}, {link: b, at: [0, 0]}]"
        spring = f"{{between: {ends}, stiffness: 10, length: 1}}"
        arm = plan("2r", Axis("q1", (0.1, 0.2)), t_end=0.1, method=method)
        rows = whole(replace(arm, scene=f"links: [{links}]\nsprings: [{spring}]\n"))
        assert rows.outcomes == ["singular"] * 2

    def test_change_points_are_passed(self, method) -> None:
        bars = plan("parallelogram", Axis("q1", (1.0, 2.0)), qd=(3.0,), t_end=2.0, method=method)
        rows = whole(bars)
        assert rows.outcomes == ["finished"] * 2
        assert column(bars, rows, "drift").max() < 1e-6

    def test_a_sample_and_its_methods_agree(self, method) -> None:
        drawn = plan(
            "2r", Axis("q1", low=-1.0, high=1.0), Axis("gravity", (3.7, 9.81)), sample=30, seed=4
        )
        expected = whole(drawn).values
        found = whole(replace(drawn, method=method)).values
        assert found == pytest.approx(expected, rel=1e-7, abs=1e-8, nan_ok=True)
        assert (np.unique(found[:, 1]) == [3.7, 9.81]).all()

    def test_only_the_results_that_are_wanted(self, method) -> None:
        few = replace(SWING, method=method, results=("final", "flip"))
        assert few.columns()[5:] == ["t_end", "q1_end", "q2_end", "qd1_end", "qd2_end", "flip",
                                     "outcome"]  # fmt: skip
        everything = whole(replace(SWING, method=method))
        assert whole(few).values[:, :10] == pytest.approx(everything.values[:, :10], abs=1e-12)


def test_flips_count_from_where_gravity_pulls() -> None:
    """A pendulum pushed over the top, with gravity along -Y, along +X, and none at all."""
    scene = "gravity: {}\nlinks: [{{name: a, m: 1, l: 1, r: 0.5, I: 0.1}}]\n"
    found = []
    for gravity, q in (("9.81", -math.pi / 2), ("[9.81, 0]", 0.0), ("0", 0.7)):
        turn = Plan(
            scene.format(gravity), "x", Variation((Axis("q1", (q, q + 0.5)),)), (0.0,), (9.0,),
            t_end=2.0, rtol=1e-12, atol=1e-12,
        )  # fmt: skip
        found.append(column(turn, whole(turn), "flip"))
    assert found[0] == pytest.approx(found[1], abs=1e-10)
    assert found[0][1] < found[0][0]  # nearer to upright
    assert found[2] == pytest.approx([math.pi / 9.0] * 2, abs=1e-12)


def test_torques_are_inverse_dynamics() -> None:
    axes = Axis("links.coupler.m", (1.0, 2.0)), Axis("q1", spaced(0.0, 6.0, 13))
    bar = plan("four-bar", *axes, Axis("qdd1", (0.0, 3.0)), qd=(5.0,), kind="torque")
    rows = whole(bar)
    assert bar.columns() == ["links.coupler.m", "q1", "qdd1", "tau1", "fx1", "fy1", "outcome"]
    assert set(rows.outcomes) == {"finished"}
    for row in rows.values:
        mechanism = build(SceneValues(bar.scene, "x").replaced({"links.coupler.m": row[0]}))
        q = assemble(mechanism, [row[1]])
        qd = loop_rates.loop_velocities(mechanism, q, [5.0], t=0.0)
        qdd = loop_rates.loop_accelerations(mechanism, q, qd, [row[2]], t=0.0)
        assert row[3] == pytest.approx(inverse_dynamics(mechanism, q, qd, qdd)[0], rel=1e-9)


class TestWorkers:
    SMALL = replace(
        plan(
            "2r",
            Axis("q1", low=-3.0, high=3.0),
            Axis("links.forearm.m", (0.5, 0.9)),
            sample=70,
            seed=1,
            t_end=0.3,
        ),
        chunk=20,
    )

    @pytest.mark.parametrize("method", METHODS)
    def test_any_number_gives_the_same(self, method) -> None:
        small = replace(self.SMALL, method=method)
        assert small.chunks == 4
        expected = alone(method)
        for workers in (2, 3) if FRESH or method == "taylor" else (2,):
            found = whole(small, workers=workers)
            assert found.values.tobytes() == expected.values.tobytes()
            assert found.outcomes == expected.outcomes

    def test_a_later_beginning_gives_the_rest(self) -> None:
        expected = alone(self.SMALL.method).values
        assert whole(self.SMALL, begin=2).values.tobytes() == expected[40:].tobytes()
        assert [*results(self.SMALL, begin=4)] == []

    def test_few_chunks_are_under_way(self, monkeypatch) -> None:
        taken: list[int] = []
        many = replace(self.SMALL, chunk=1)
        monkeypatch.setattr(sweep_workers, "run_chunk", lambda plan, k: taken.append(k))

        class Now:
            def result(self) -> None:
                return None

        def submit(function, *arguments):
            function(*arguments)
            return Now()

        for number, _ in enumerate(sweep_workers._ordered(submit, many, 0, 4)):
            assert len(taken) <= number + 4
        assert taken == [*range(70)]

    def test_an_error_of_a_worker_comes_through(self) -> None:
        with pytest.raises(RobodynError, match="version"):
            whole(replace(self.SMALL, version="0.0"), workers=2)

    def test_tables_are_read_once(self, tmp_path) -> None:
        """Workers do not look for the file; what holds the arm at 0.3 is the spring, 10 * 0.3."""
        table, path = tmp_path / "F.csv", tmp_path / "sprung.yaml"
        table.write_text("x,F\n-9,-90\n9,90\n")
        path.write_text(
            "links: [{name: a, m: 1, l: 1, r: 0, I: 1}]\n"
            "springs: [{joint: a, table: F.csv, angle: 0}]\n"
        )
        request = SweepRequest(["links.a.m=1:2:40"], kind="torque", q="0.3")
        sprung = replace(plan_of(SceneValues(path.read_text(), str(path)), (), request), chunk=10)
        table.unlink()
        for workers in (1, 2):
            rows = whole(sprung, workers=workers)
            assert column(sprung, rows, "tau1").tolist() == [3.0] * 40

    def test_lanes_are_taken_where_there_is_machine_code(self, monkeypatch) -> None:
        def chosen(name: str, varied: str, **options: Any) -> Plan:
            request = SweepRequest([varied], **options)
            return plan_of(SceneValues(text(name), name), (), request)

        for name in ("2r", "spring-slider-crank"):
            assert chosen(name, "q1=0.1,0.2").method == METHODS[-1]
        assert chosen("2r", "q1=0.1,0.2", event=["x=q1"], result="events").method == "DOP853"
        monkeypatch.setattr(machine, "available", lambda: False)
        alone = chosen("2r", "q1=0.1,0.2")
        assert alone.method == "DOP853"
        assert lacks_machine_code(alone)
        assert not lacks_machine_code(chosen("2r", "q1=0.1,0.2", event=["x=q1"], result="events"))
        with pytest.raises(RobodynError, match="fast"):  # a worker without the extra
            run_chunk(replace(alone, method="taylor"), 0)


def test_what_no_point_could_have_is_refused() -> None:
    with pytest.raises(DescriptionError, match="must be >= 0"):
        check(plan("2r", Axis("links.forearm.m", low=-0.5, high=1.0), sample=5))
    assert check(SWING).n == 2


def test_warnings_of_others_are_handed_on(recwarn: Any) -> None:
    with sweep_chunks._misses() as said:
        warnings.warn("of another package", UserWarning, stacklevel=1)
        warnings.warn(f"{MISSES} here; else", RobodynWarning, stacklevel=1)
    assert said == [f"{MISSES} here"]
    assert [str(x.message) for x in recwarn] == ["of another package"]


def test_a_chunk_is_part_of_the_whole() -> None:
    parts = replace(SWING, chunk=7)
    expected = run_chunk(SWING, 0).values
    assert whole(parts, workers=1).values == pytest.approx(expected, abs=1e-12, nan_ok=True)


@pytest.mark.skipif("compiled" not in METHODS, reason="needs llvmlite")
@pytest.mark.parametrize(
    ("name", "axes"),
    [
        ("2r", (Axis("q1", low=-3.0, high=3.0), Axis("links.forearm.m", (0.9, 1.0, 1.1)))),
        ("four-bar", (Axis("q1", low=-3.0, high=3.0), Axis("tau1", (0.0, 0.5, 1.0)))),
        (
            "spring-slider-crank",
            (Axis("q1", low=0.5, high=2.0), Axis("springs[0].damping", (0.0, 1.0))),
        ),
    ],
)
def test_no_digit_depends_on_the_chunk_or_the_lane(name, axes) -> None:
    """A number that is 0 or 1 at a point, or the same at all of a chunk, is no other code."""
    drawn = replace(plan(name, *axes, sample=37, seed=3), method="taylor", t_end=0.5)
    expected = whole(replace(drawn, chunk=37), workers=1)
    for chunk in (1, 5, 16):
        found = whole(replace(drawn, chunk=chunk), workers=1)
        assert found.outcomes == expected.outcomes
        assert np.array_equal(found.values, expected.values, equal_nan=True)


def _late(plan: Plan, number: int) -> Rows:
    raise TimeoutError("too late")


class TestCluster:
    """A scheduler and workers of Dask in processes of their own."""

    @pytest.fixture(scope="class")
    def cluster(self) -> Iterator[Any]:
        pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from distributed import LocalCluster

            cluster: Any = LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
            )
        yield cluster
        cluster.close()

    @pytest.fixture
    def address(self, cluster: Any) -> str:
        return cluster.scheduler_address

    @pytest.mark.filterwarnings("ignore")
    def test_gives_what_one_process_gives(self, address) -> None:
        expected = alone(TestWorkers.SMALL.method)
        found = whole(TestWorkers.SMALL, scheduler=address)
        assert found.values.tobytes() == expected.values.tobytes()
        assert found.outcomes == expected.outcomes

    @pytest.mark.filterwarnings("ignore")
    def test_on_the_command_line(self, address, robodyn) -> None:
        options = ("sweep", "robots/2r.yaml", "--vary", "q1=0,1,2", "--time", 0.2, "--quiet")
        here = robodyn(*options)
        there = robodyn(*options, "--scheduler", address)
        assert there.code == 0
        assert there.out == here.out

    @pytest.mark.filterwarnings("ignore")
    def test_errors_come_through(self, address) -> None:
        with pytest.raises(RobodynError, match="version"):
            whole(replace(TestWorkers.SMALL, version="0.0"), scheduler=address)

    @pytest.mark.filterwarnings("ignore")
    def test_no_scheduler_is_an_error(self) -> None:
        pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
        with pytest.raises(RobodynError, match="no Dask scheduler answers"):
            whole(TestWorkers.SMALL, scheduler="nonsense://127.0.0.1:1")

    def test_a_scheduler_that_accepts_and_stays_silent_is_given_up(self) -> None:
        pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
        with socket.create_server(("127.0.0.1", 0)) as server:
            address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
            late = threading.Timer(30.0, server.close)
            late.start()
            with pytest.raises(RobodynError, match=r"no Dask scheduler answers there: .*imed out"):
                whole(TestWorkers.SMALL, scheduler=address, patience=0.5)
            assert late.is_alive()
            late.cancel()

    @pytest.mark.filterwarnings("ignore")
    def test_a_timeout_of_a_chunk_is_no_lack_of_workers(self, address, monkeypatch) -> None:
        monkeypatch.setattr("robodyn.sweeps.sweep_workers.run_chunk", _late)
        with pytest.raises(RobodynError, match="TimeoutError: too late"):
            whole(TestWorkers.SMALL, scheduler=address)

    def test_a_failure_that_comes_as_the_wait_ends_is_told(self) -> None:
        class Failing:
            status = "pending"

            def result(self, timeout: float | None = None) -> None:
                if self.status == "error":
                    raise TimeoutError("too late")
                self.status = "error"  # between the end of the wait and the look at it
                raise TimeoutError

        watch: Any = None
        with pytest.raises(RobodynError, match="TimeoutError: too late"):
            sweep_workers._Remote(Failing(), watch).result()

    def test_a_missing_extra_is_told(self, monkeypatch) -> None:
        monkeypatch.setitem(__import__("sys").modules, "distributed", None)
        with pytest.raises(InputError, match=r"\.\[cluster\]"):
            whole(TestWorkers.SMALL, scheduler="tcp://127.0.0.1:1")

    # these take the cluster's workers away, and come last

    @staticmethod
    def leave(cluster: Any) -> None:
        cluster.scale(0)
        until = time.monotonic() + 60.0
        while cluster.scheduler.workers:
            assert time.monotonic() < until
            time.sleep(0.05)

    @pytest.mark.filterwarnings("ignore")
    def test_workers_that_come_back_go_on(self, cluster) -> None:
        expected = alone(TestWorkers.SMALL.method)
        told: list[str] = []

        def tell(text: str) -> None:
            told.append(text)
            if "lost" in text:
                cluster.scale(1)

        found = results(
            TestWorkers.SMALL, scheduler=cluster.scheduler_address, patience=60.0, tell=tell
        )
        rows = [next(found)]
        self.leave(cluster)
        rows += found
        assert "lost all" in told[0]
        assert np.concatenate([x.values for x in rows]).tobytes() == expected.values.tobytes()

    @pytest.mark.filterwarnings("ignore")
    def test_all_workers_lost_is_told_and_ends(self, cluster) -> None:
        told: list[str] = []
        address = cluster.scheduler_address
        rows = results(TestWorkers.SMALL, scheduler=address, patience=2.0, tell=told.append)
        next(rows)
        self.leave(cluster)
        begun = time.monotonic()
        with pytest.raises(RobodynError) as caught:
            list(rows)
        assert 2.0 <= time.monotonic() - begun < 30.0
        assert "none came within 2 s" in str(caught.value)
        assert address in str(caught.value)
        assert told == ["the cluster has lost all its workers: waiting 2 s for another (patience)"]


def test_extremes_of_bounces_in_closed_form() -> None:
    """A rate jumps at a stop: what lies within a step begins after the impact."""
    scene = """gravity: 9.81
links:
  - {name: ball, joint: prismatic, axis: [0, 1], m: 1, l: 0, r: 0, I: 0,
     limits: {min: 0, restitution: 0.5}}
"""
    drops, e, t_end = (0.1, 0.3, 1.1), 0.5, 2.0
    variation = Variation((Axis("q1", drops), Axis("links.ball.limits.restitution", (0.5, 1.0))))
    given = {"q": (0.0,), "qd": (0.0,), "tau": (0.0,), "t_end": t_end}
    falls = Plan(scene, "ball", variation, results=("extremes", "flip", "drift"), **given)
    rows = whole(falls, workers=1)
    v = -np.sqrt(2.0 * 9.81 * np.repeat(drops, 2))
    wanted = {"q1_min": 0.0, "q1_max": np.repeat(drops, 2), "qd1_min": v, "drift": 0.0}
    wanted |= {"qd1_max": -v * np.tile([e, 1.0], 3)}
    for name, value in wanted.items():
        np.testing.assert_allclose(column(falls, rows, name), value, rtol=1e-9, atol=1e-9)
