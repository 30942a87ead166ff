"""`--force`: as the scene with the same loads, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from conftest import ROOT, Outcome

Run = Callable[..., Outcome]
Scene = Callable[[str], Path]

OPTIONS = ("coupler@0.5,-0.2=10,-5", "rocker=-3,4", "tip2=1e-3,7", "P=0.1,0.2", "P=1,1")
LOADS = """
points: {P: {link: coupler, at: [0.3, 0.1]}}
"""
ADDED = """
loads:
  - {point: {link: coupler, at: [0.5, -0.2]}, force: [10, -5]}
  - {point: rocker, force: [-3, 4]}
  - {point: coupler, force: [1.0e-3, 7]}
  - {point: {link: coupler, at: [0.3, 0.1]}, force: [0.1, 0.2]}
  - {point: {link: coupler, at: [0.3, 0.1]}, force: [1, 1]}
"""
STATES = "t,q1,qd1,qdd1\n" + "".join(f"{k / 10},{k / 3},{5 - k},{k / 7}\n" for k in range(9))


def flags(texts: Sequence[str] = OPTIONS) -> list[str]:
    return [word for text in texts for word in ("--force", text)]


@pytest.mark.parametrize(
    "command",
    [
        *("torque --q 1 --qd 5", "accel --q 1 --qd 5 --tau 2", "reactions --q 1 --qd 5"),
        *("energy --q 1 --qd 5", "torque -", "accel -", "reactions -", "energy -"),
        "simulate --q 1 --qd 5 --time 0.3",
        "simulate --q 1 --qd 5 --time 0.3 --method taylor",
        "simulate --q 1 --time 0.2 --method taylor",
    ],
)
def test_is_a_load_of_the_scene(
    robodyn: Run, scene: Scene, four_bar_text: str, command: str
) -> None:
    name, *rest = command.split()
    plain = scene(four_bar_text + LOADS)
    given = robodyn(name, plain, *rest, *flags(), stdin=STATES)
    without = robodyn(name, plain, *rest, stdin=STATES)
    loaded = robodyn(name, scene(four_bar_text + LOADS + ADDED), *rest, stdin=STATES)
    assert given.code == loaded.code == 0
    assert given.out == loaded.out != without.out


def test_beside_the_loads_of_the_scene(robodyn: Run, scene: Scene) -> None:
    text = (ROOT / "robots/2r.yaml").read_text()
    own = 'loads:\n  - {point: forearm, force: ["3*q1", 2], frame: link}\n'
    state = ("--q", "0.4,0.3", "--qd", "1,2")
    given = robodyn("torque", scene(text + own), *state, "--force", "joint2=4,5").succeeds().out
    both = scene(text + own + "  - {point: {link: forearm, at: [0, 0]}, force: [4, 5]}\n")
    assert given == robodyn("torque", both, *state).succeeds().out


def test_on_a_link_that_slides(robodyn: Run) -> None:
    """A force on the yoke along its way is what its guide's force is less."""
    yoke = ("torque", "robots/rp-arm.yaml", "--q", "0,0.2")
    tau = robodyn(*yoke).succeeds().row["tau2"]
    pulled = robodyn(*yoke, "--force", "tip2=7,0").succeeds().row["tau2"]
    assert pulled == pytest.approx(tau - 7, abs=1e-12)
