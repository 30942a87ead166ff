"""Grashof's classes against what can turn, by the triangle inequality."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from named_case import case

from random_mechanisms import LOOPS, mechanism, seeded_scene
from robodyn.loops import assembly
from robodyn.mechanics.loop_rows import loop_class
from robodyn.mechanics.mechanism import load

ROBOTS = Path(__file__).parent.parent / "robots"
CRANK_ROCKER = (0.35, 0.95, 0.8, 1.1)


def four_bar(crank, coupler, rocker, ground, scale=1.0, turned=0.0):
    """Crank on the origin, rocker `ground` away from it in the direction `turned`."""
    lengths = [x * scale for x in (crank, coupler, rocker)]
    pivot = ground * scale * np.exp(1j * turned)
    return mechanism(
        "links:\n"
        f"  - {{name: crank, m: 1, l: {lengths[0]}, r: 0.1, I: 0.01}}\n"
        f"  - {{name: coupler, m: 1, l: {lengths[1]}, r: 0.1, I: 0.01}}\n"
        f"  - {{name: rocker, m: 1, l: {lengths[2]}, r: 0.1, I: 0.01,"
        f" from: [{float(pivot.real)!r}, {float(pivot.imag)!r}]}}\n"
        "closures: [[coupler, rocker]]\n"
    )


def turns_fully(a, b, others):
    """Whether the angle between neighbours a and b takes all values.

    Their far ends are |a - b| to a + b apart; the other two links must span all of that.
    """
    c, d = others
    return abs(a - b) >= abs(c - d) and a + b <= c + d


ANY_SIZE_AND_DIRECTION = [
    (CRANK_ROCKER, "crank-rocker (Grashof)"),
    ((0.8, 0.95, 0.35, 1.1), "crank-rocker (Grashof)"),  # the rocker is the crank
    ((0.8, 0.95, 1.1, 0.35), "double-crank (Grashof)"),
    ((0.8, 0.35, 0.95, 1.1), "double-rocker (Grashof)"),
    ((0.9, 0.5, 0.6, 1.2), "triple-rocker (not Grashof)"),
    ((0.3, 0.7, 0.3, 0.7), "change point"),  # parallelogram
    ((0.3, 0.7, 0.7, 0.3), "change point"),  # kite
    ((0.1, 0.4, 0.2, 0.3), "change point"),  # 0.1 + 0.4 = 0.2 + 0.3 but for rounding
]


class TestFourBar:
    @settings(deadline=None, max_examples=200)
    @given(*[st.integers(1, 40)] * 4)
    def test_is_named_by_what_turns(self, crank, coupler, rocker, ground):
        lengths = sorted([crank, coupler, rocker, ground])
        assume(lengths[3] < sum(lengths[:3]))  # they close at all
        found = loop_class(four_bar(crank, coupler, rocker, ground), 0)
        if lengths[0] + lengths[3] == lengths[1] + lengths[2]:
            assert found == "change point"
            return
        crank_turns = turns_fully(ground, crank, (coupler, rocker))
        rocker_turns = turns_fully(ground, rocker, (coupler, crank))
        coupler_turns = turns_fully(crank, coupler, (rocker, ground))
        expected = "triple-rocker (not Grashof)"
        if crank_turns and rocker_turns:
            expected = "double-crank (Grashof)"
        elif crank_turns or rocker_turns:
            expected = "crank-rocker (Grashof)"
        elif coupler_turns:
            expected = "double-rocker (Grashof)"
        assert found == expected

    def test_any_size_and_direction(self):
        for lengths, expected in ANY_SIZE_AND_DIRECTION:
            for scale in [1e-6, 1.0, 1e6]:
                for turned in [0.0, 2.0]:
                    with case(lengths, expected, scale, turned):
                        assert (
                            loop_class(four_bar(*lengths, scale=scale, turned=turned), 0)
                            == expected
                        )

    @pytest.mark.parametrize(
        "lengths", [CRANK_ROCKER, (0.8, 0.95, 1.1, 0.35), (0.9, 0.5, 0.6, 1.2)]
    )
    def test_a_crank_is_one_that_assembles_at_every_angle(self, lengths):
        mech = four_bar(*lengths)
        turns = assembly.reachable(mech, [0.0], 0, t=0.0) == [(-np.pi, np.pi)]
        assert turns == ("crank" in loop_class(mech, 0))

    @pytest.mark.parametrize(
        "scene",
        [
            """
links:
  - {name: rocker, m: 1, l: 0.8, r: 0.1, I: 0.01, from: [1.1, 0]}
  - {name: crank, m: 1, l: 0.35, r: 0.1, I: 0.01, from: [0, 0]}
  - {name: coupler, m: 1, l: 0.95, r: 0.1, I: 0.01, from: crank}
closures: [[rocker, coupler]]
""",
            """
links:
  - {name: crank, m: 1, l: 0.35, r: 0.1, I: 0.01}
  - {name: rocker, m: 1, l: 0.8, r: 0.1, I: 0.01, from: [1.1, 0]}
  - {name: coupler, m: 1, l: 0.95, r: 0.1, I: 0.01, from: rocker}
closures: [[crank, coupler]]
""",
            """
links:
  - {name: crank, m: 1, l: 9, r: 0.1, I: 0.01}
  - {name: coupler, m: 1, l: 8, r: 0.1, I: 0.01, from: {link: crank, at: [0.21, 0.28]}}
  - {name: rocker, m: 1, l: 7, r: 0.1, I: 0.01, from: [1.1, 0]}
closures: [[{link: coupler, at: [0.57, 0.76]}, {link: rocker, at: [0, 0.8]}]]
""",
            """
links:
  - {name: crank, m: 1, l: 0.35, r: 0.1, I: 0.01}
  - {name: coupler, m: 1, l: 0.95, r: 0.1, I: 0.01}
  - {name: rocker, m: 1, l: 0.8, r: 0.1, I: 0.01}
closures: [[rocker, [1.1, 0]]]
""",
        ],
        ids=["other order", "coupler on the rocker", "points of links", "chain to the ground"],
    )
    def test_however_the_crank_rocker_is_written(self, scene):
        assert loop_class(mechanism(scene), 0) == "crank-rocker (Grashof)"


class TestSlider:
    @pytest.mark.parametrize(
        ("crank", "rod", "offset", "expected"),
        [
            (0.1, 0.32, 0.02, "slider-crank, crank turns fully"),
            (0.1, 0.32, -0.22, "slider-crank, crank turns fully"),
            (0.3, 0.32, 0.03, "slider-crank, crank rocks"),
            (0.3, 0.32, -0.03, "slider-crank, crank rocks"),
            (0.3, 0.3, 0.0, "slider-crank, crank turns fully"),
        ],
    )
    @pytest.mark.parametrize("turned", [0.0, 2.5])
    def test_turns_fully_where_crank_and_offset_fit_into_the_rod(
        self, crank, rod, offset, expected, turned
    ):
        """|offset - crank sin(theta)| <= rod at every angle."""
        along = np.exp(1j * turned)
        through = along * (7.0 + 1j * offset)
        mech = mechanism(
            "links:\n"
            f"  - {{name: crank, m: 1, l: {crank}, r: 0.1, I: 0.01}}\n"
            f"  - {{name: rod, m: 1, l: {rod}, r: 0.1, I: 0.01}}\n"
            f"closures: [{{point: rod, on: {{through: [{float(through.real)!r},"
            f" {float(through.imag)!r}], along: [{float(along.real)!r}, {float(along.imag)!r}]}}}}]"
        )
        assert loop_class(mech, 0) == expected
        turns = assembly.reachable(mech, [0.0], 0, t=0.0) == [(-np.pi, np.pi)]
        assert turns == expected.endswith("turns fully")

    def test_of_more_links(self):
        mech = mechanism(
            "links:\n"
            + "".join(f"  - {{name: l{k}, m: 1, l: 0.5, r: 0.1, I: 0.01}}\n" for k in range(3))
            + "closures: [{point: l2, on: {through: [0, 0], along: [1, 0]}}]"
        )
        assert loop_class(mech, 0) == "slider loop of 3 links"


class TestOthers:
    @pytest.mark.parametrize(
        ("name", "closure", "expected"),
        [
            ("five-bar", 0, "5-link loop"),
            ("six-bar, dyad on the coupler", 1, "5-link loop"),
            ("six-bar with a piston", 1, "slider-crank"),
        ],
    )
    def test_loops_by_their_number_of_links(self, name, closure, expected):
        """The ground counts as a link."""
        found = loop_class(seeded_scene(0, LOOPS[name]).mechanism, closure)
        assert found.startswith(expected)

    def test_a_rocker_with_a_dyad_is_a_four_bar_of_its_own(self):
        """Links 2, 3 and 4 between two ground pivots; seed 0 draws one that is not Grashof."""
        scene = seeded_scene(0, LOOPS["six-bar, dyad on the rocker"])
        lengths = {abs(p) for row in scene.mechanism.rows if row.closure == 1 for _, p in row.P}
        offsets = [row.offset for row in scene.mechanism.rows if row.closure == 1]
        shortest, second, third, longest = sorted([*lengths, float(np.hypot(*offsets))])
        assert (shortest + longest > second + third) == (
            "not Grashof" in loop_class(scene.mechanism, 1)
        )

    @pytest.mark.parametrize(
        ("robot", "expected"),
        [
            ("four-bar", "crank-rocker (Grashof)"),
            ("parallelogram", "change point"),
            ("slider-crank", "slider-crank, crank turns fully"),
            ("five-bar", "5-link loop"),
        ],
    )
    def test_example_scenes_are_what_their_headers_say(self, robot, expected):
        assert loop_class(load(ROBOTS / f"{robot}.yaml"), 0) == expected
