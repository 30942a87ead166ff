"""The six-bars of robots/: their chains in the graph of links and joints, a whole turn, energy."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Outcome

import oracles
from robodyn import assemble, closure_gap, closure_jacobian, forward_dynamics, load, mass_matrix
from robodyn.dynamics.closed_form import coriolis_matrix, gravity_vector
from robodyn.loops.closures import closure_bias
from robodyn.scene.description import read

Run = Callable[..., Outcome]
SIX_BARS = ("watt-six-bar", "stephenson-six-bar")


def joints(name: str) -> list[tuple[int | None, int | None]]:
    """The pairs of links that a pin joins, None for the ground."""
    found = read(ROOT / f"robots/{name}.yaml")
    hanging = [(k, link.hangs_from.link) for k, link in enumerate(found.links)]
    assert all(closure.along is None for closure in found.closures)
    return hanging + [(closure.first.link, closure.second.link) for closure in found.closures]


@pytest.mark.parametrize("name", SIX_BARS)
def test_six_links_and_seven_pins_leave_one_freedom(robodyn: Run, name: str) -> None:
    """3 (6 - 1) - 2 * 7 = 1; two ternary links and four binary ones."""
    pins = joints(name)
    degree = Counter(link for pin in pins for link in pin)
    assert sorted(degree.values()) == [2, 2, 2, 2, 3, 3]
    assert 3 * (len(degree) - 1) - 2 * len(pins) == 1
    assert robodyn("check", f"robots/{name}.yaml").json["mobility"] == 1


@pytest.mark.parametrize(("name", "joined"), list(zip(SIX_BARS, (True, False), strict=True)))
def test_only_watts_ternary_links_are_joined(name: str, joined: bool) -> None:
    pins = joints(name)
    degree = Counter(link for pin in pins for link in pin)
    ternary = {link for link, number in degree.items() if number == 3}
    assert any(set(pin) == ternary for pin in pins) == joined


@pytest.mark.parametrize(("name", "plates"), list(zip(SIX_BARS, (2, 1), strict=True)))
def test_moving_ternary_links_are_triangles(name: str, plates: int) -> None:
    """Their three joints do not lie in one line."""
    found = read(ROOT / f"robots/{name}.yaml")
    places: dict[int | None, list[complex]] = {k: [0j] for k in range(len(found.links))}
    hanging = [link.hangs_from for link in found.links]
    for point in [*hanging, *(side for x in found.closures for side in (x.first, x.second))]:
        places.setdefault(point.link, []).append(point.at)
    places.pop(None)
    triangles = [points for points in places.values() if len(points) == 3]
    areas = [abs((p.conjugate() * q).imag) / 2 for _, p, q in triangles]
    assert len(areas) == plates
    assert min(areas) > 0.05


@pytest.mark.parametrize("name", SIX_BARS)
def test_the_crank_turns_fully_and_a_turn_takes_no_work(robodyn: Run, name: str) -> None:
    """At constant rate without damping energy returns, so the torque's mean over a turn is 0."""
    turn = np.linspace(0.0, 2 * math.pi, 256, endpoint=False)
    states = "q1\n" + "".join(f"{angle!r}\n" for angle in turn.tolist())
    given = robodyn("torque", f"robots/{name}.yaml", "-", "--qd", 5, stdin=states).succeeds()
    tau = np.array(given.column("tau1"))
    assert tau.shape == turn.shape
    assert abs(tau.mean()) < 1e-12 * np.abs(tau).max()


@pytest.mark.parametrize("name", SIX_BARS)
def test_energy_and_closures_are_kept_for_10_s(robodyn: Run, tmp_path: Path, name: str) -> None:
    file = tmp_path / "report.json"
    start = ("--q", "60deg", "--qd", 5, "--time", 10, "--every", 0.1)
    given = robodyn("simulate", f"robots/{name}.yaml", *start, "--quiet", "--report", file)
    energy = np.array(given.succeeds().column("energy"))
    report = json.loads(file.read_text())
    assert report["outcome"] == "finished"
    assert np.ptp(energy) < 1e-7 * np.abs(energy).max()
    assert max(given.column("gap")) < 1e-12
    assert np.ptp(given.column("q1")) > 2 * math.pi


# The seven-body mechanism against the equations of the book that it comes from.


MECH = load(ROOT / "tests/hard_cases/seven-body.yaml")
START = np.array(oracles.SEVEN_BODY_START)


def test_the_start_is_closed():
    assert np.abs(closure_gap(MECH, START)).max() < 1e-16
    assert assemble(MECH, START[:1]) == pytest.approx(START, abs=1e-12)


def test_the_accelerations_at_the_start():
    qdd = forward_dynamics(MECH, START, np.zeros(7), [0.033, *[0.0] * 6])
    assert qdd[:2] == pytest.approx(oracles.SEVEN_BODY_ACCELERATIONS, rel=1e-13)
    assert np.abs(qdd[2:]).max() < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_the_terms_of_the_book(seed):
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(-np.pi, np.pi, 7), rng.normal(size=7) * 100.0
    M, f, Psi, bend = oracles.seven_body_terms(q, qd, torque=0.0)
    assert mass_matrix(MECH, q) == pytest.approx(M, rel=1e-12, abs=1e-18)
    forces = -coriolis_matrix(MECH, q, qd) @ qd - gravity_vector(MECH, q)
    assert forces == pytest.approx(f, rel=1e-10, abs=1e-12)
    assert closure_jacobian(MECH, q) == pytest.approx(Psi, abs=1e-16)
    assert -closure_bias(MECH, q, qd, t=0.0) == pytest.approx(bend, rel=1e-12, abs=1e-10)
