"""The constants of a mechanism: A, B, closures and points, against their definitions."""

import math
import pickle
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from conftest import FRESH, within
from hypothesis import given, settings
from unwritten import MASSLESS

from random_mechanisms import (
    LOOPS,
    Pose,
    assert_close,
    loops,
    mechanism,
    oracle_closures,
    oracle_tree,
    seeded_scene,
    seeded_tree,
    sizes,
    trees,
)
from robodyn.elements.loads import Force
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import build, joint_index, load
from robodyn.scene.description import from_text
from robodyn.scene.scene import Closure, Coupling, Description, Link, Point

ROBOTS = sorted((Path(__file__).parent.parent / "robots").glob("*.yaml"))
examples = settings(deadline=None, max_examples=40 if FRESH else 20)


def chain(n, extra=""):
    """A serial arm of n links with distinct parameters."""
    links = [
        f"  - {{name: link{k}, m: {1 + 0.1 * k}, l: {0.5 + 0.01 * k}, r: 0.2, I: 0.05}}"
        for k in range(n)
    ]
    return "\n".join(["gravity: 9.81", "links:", *links]) + "\n" + extra


def weights(tree):
    """rho (n, n): s_b = const + sum_k rho_bk E_k, DESIGN section 3, walking down from each body."""
    rho = np.zeros((len(tree), len(tree)), complex)
    for b, body in enumerate(tree):
        rho[b, b] = body["r"]
        link = b
        while tree[link]["parent"] is not None:
            rho[b, tree[link]["parent"]] = tree[link]["at"]
            link = tree[link]["parent"]
    return rho


class TestConstants:
    @examples
    @given(trees())
    def test_A_and_B_are_sums_over_the_bodies(self, scene):
        """A = sum_b m_b conj(rho_b) rho_b^T + diag(I_b), B = sum_b m_b rho_b."""
        mech = scene.mechanism
        tree = oracle_tree(mech.description)
        rho = weights(tree)
        m, I = (np.array([link[key] for link in tree]) for key in ("m", "I"))
        size = sizes(mech.description)
        assert_close(mech.arrays.A, rho.conj().T @ (m[:, None] * rho) + np.diag(I), size.inertia)
        entries = np.zeros((mech.n, mech.n), complex)  # the same, one by one
        for j, k, value in mech.A:
            entries[j, k], entries[k, j] = value, value.conjugate()
        assert_close(mech.arrays.A, entries, size.inertia)
        assert_close(mech.arrays.B * abs(mech.gamma), m @ rho * abs(mech.gamma), size.gravity)

    @examples
    @given(trees())
    def test_J_has_ones_on_the_path_from_the_ground(self, scene):
        mech = scene.mechanism
        pose = Pose(oracle_tree(mech.description), scene.q)
        path = [[float(k in pose.path(i)) for k in range(scene.n)] for i in range(scene.n)]
        assert mech.arrays.J.tolist() == path
        assert_close(mech.arrays.J @ scene.q, pose.alpha, np.abs(scene.q).sum(), 1e-15)

    @examples
    @given(trees())
    def test_order_puts_every_link_after_the_one_it_hangs_from(self, scene):
        order = scene.mechanism.order
        assert sorted(order) == list(range(scene.n))
        for k, parent in enumerate(scene.mechanism.parent):
            assert parent is None or order.index(parent) < order.index(k)

    def test_links_may_hang_from_links_further_down_the_file(self):
        """The same arm written from the hand to the shoulder has the same constants, reversed."""
        forward = mechanism(chain(3)).arrays
        lines = chain(3).splitlines()
        tips = ["[0, 0]", "link0", "link1"]
        links = [line[:-1] + f", from: {tip}}}" for line, tip in zip(lines[2:], tips, strict=True)]
        backward = mechanism("\n".join([*lines[:2], *links[::-1]])).arrays
        assert np.array_equal(backward.A, forward.A[::-1, ::-1])
        assert np.array_equal(backward.B, forward.B[::-1])
        assert np.array_equal(backward.J, forward.J[::-1, ::-1])

    def test_only_links_on_one_path_couple(self):
        star = mechanism(
            "links:\n"
            + "".join(
                f"  - {{name: ray{k}, m: 1, l: 1, r: 0.5, I: 0.1, from: [{k}, 0]}}\n"
                for k in range(20)
            )
        )
        assert len(star.A) == 20
        assert len(mechanism(chain(20)).A) == 20 * 21 // 2

    def test_payload_is_a_point_mass_at_the_tip(self):
        """m = 1 at r = 0.2, I = 0.3, and 0.5 kg at l = 0.7: I_O = 0.3 + 0.04 + 0.245."""
        mech = mechanism("links: [{name: a, m: 1, l: 0.7, r: 0.2, I: 0.3, payload: 0.5}]")
        ((_, _, inertia),), (moment,) = mech.A, mech.B
        assert inertia == pytest.approx(0.585, rel=1e-15)
        assert moment == pytest.approx(0.55, rel=1e-15)

    def test_constants_that_overflow_are_an_input_error(self):
        huge = "links: [{name: a, m: 1e300, l: 1e300, r: 1e300, I: 1}]"
        with pytest.raises(InputError, match=r"scene\.yaml: links: .* overflow"):
            mechanism(huge)

    def test_long_chains_are_built_in_little_time_and_memory(self):
        mech = mechanism(chain(300))
        assert mech.n == 300
        assert mech.arrays.J.sum() == 300 * 301 / 2


class TestPoints:
    @examples
    @given(trees())
    def test_pivots_tips_and_centres_lie_where_the_links_are(self, scene):
        mech = scene.mechanism
        pose = Pose(oracle_tree(mech.description), scene.q)
        E = np.exp(1j * (mech.arrays.J @ scene.q))
        links = mech.description.links
        expected = {
            "pivots": pose.joints,
            "tips": [pose.position((k, link.l)) for k, link in enumerate(links)],
            "centres": [pose.position((k, link.r)) for k, link in enumerate(links)],
        }
        for name, positions in expected.items():
            found = [
                point.constant + sum(value * E[k] for k, value in point.terms)
                for point in getattr(mech, name)
            ]
            assert_close(found, positions, 10.0, 1e-15)

    @examples
    @given(loops())
    def test_closures_are_linear_in_E(self, scene):
        """gap = Re(sum_k P_k E_k) + offset, along the direction of each row, at any angles."""
        mech = scene.mechanism
        q = scene.q + np.arange(1, scene.n + 1)  # open loops
        pose = Pose(oracle_tree(mech.description), q)
        sides = oracle_closures(mech.description)
        E = np.exp(1j * (mech.arrays.J @ q))
        for row in mech.rows:
            first, second = sides[row.closure]
            gap = pose.position(first) - pose.position(second)
            expected = (np.conj(row.direction) * gap).real
            found = sum((value * E[k]).real for k, value in row.P) + row.offset
            assert_close(found, expected, sizes(mech.description).loop, 1e-14)
            assert abs(row.direction) == pytest.approx(1.0, rel=1e-15)

    def test_a_slider_keeps_the_component_normal_to_its_line(self):
        mech = mechanism(
            "links: [{name: rod, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
            "closures: [{point: rod, on: {through: [0, 0.25], along: [3, 0]}}]"
        )
        (row,) = mech.rows
        assert (row.direction, tuple(row.P), row.offset) == (1j, ((0, -1j),), -0.25)

    def test_links_that_both_sides_share_take_no_part_in_a_closure(self):
        scene = seeded_scene(0, LOOPS["loop in a tree"])
        assert {k for row in scene.mechanism.rows for k, _ in row.P} == {0, 1, 4}
        carried = mechanism(
            "links:\n"
            "  - {name: base, m: 1, l: 1, r: 0.5, I: 0.1}\n"
            "  - {name: left, m: 1, l: 1, r: 0.5, I: 0.1, from: base}\n"
            "  - {name: right, m: 1, l: 1, r: 0.5, I: 0.1, from: base}\n"
            "closures: [[left, right]]"
        )
        assert {k for row in carried.rows for k, _ in row.P} == {1, 2}

    @pytest.mark.parametrize("through", ["[0, 0]", "[3, 1]"])
    def test_a_closure_of_points_that_cannot_move_apart_is_refused(self, through):
        line = f"{{through: {through}, along: [1, 0]}}"
        slider = f"{{point: {{link: link0, at: [0, 0]}}, on: {line}}}"
        with pytest.raises(InputError, match=r"closures\[0\]: joins points that cannot move apart"):
            mechanism(chain(2, f"closures: [{slider}]\nactuated: [link1]\n"))


def whole_paths(links, closures, couplings):
    """The joints that are actuated where a scene does not say, from sets of joints."""
    groups, in_loops = [], set()
    for closure in closures:
        sides = []
        for point in (closure.first, closure.second):
            passed = {}
            while point.link is not None:
                passed[point.link] = point.at
                point = links[point.link].hangs_from
            sides.append(passed)
        one, two = sides
        loop = {k for k in {*one, *two} if one.get(k, 0) != two.get(k, 0)}
        in_loops |= loop
        groups.append(loop)
    groups += [{x.joint, *(k for k, _ in x.terms)} for x in couplings]
    for group in list(groups):
        met = [other for other in groups if other & group]
        groups = [x for x in groups if x not in met] + [set().union(group, *met)]
    followers = {x.joint for x in couplings}
    driven = set(range(len(links))) - in_loops - followers
    for group in groups:
        if group & in_loops and not group & driven:
            driven |= set(sorted(group - followers)[:1])
    return tuple(sorted(driven))


class TestActuated:
    def test_default_is_every_joint_of_an_open_chain(self):
        mech = mechanism(chain(4))
        assert mech.actuated == (0, 1, 2, 3)
        assert mech.passive == ()

    def test_default_is_the_first_joint_of_a_loop(self):
        assert load(ROBOTS[0].parent / "four-bar.yaml").actuated == (0,)

    @pytest.mark.parametrize(
        ("name", "expected"),
        [
            ("chain closed to the ground", (0,)),
            ("slider-crank", (0,)),
            ("six-bar, dyad on the coupler", (0,)),  # two loops that share links are one group
            ("loop in a tree", (0, 2, 3)),  # its loop is 0, 1, 4
        ],
    )
    def test_default_of_mixed_mechanisms(self, name, expected):
        text = seeded_scene(0, LOOPS[name]).text
        silent = "\n".join(line for line in text.splitlines() if "actuated" not in line)
        assert mechanism(silent).actuated == expected

    def test_links_that_carry_a_whole_loop_are_not_in_it(self):
        """A four-bar on an arm: the arm's joint and the first of the loop are driven."""
        mech = mechanism(
            "links:\n"
            "  - {name: arm, m: 1, l: 1, r: 0.5, I: 0.1}\n"
            "  - {name: crank, m: 1, l: 0.35, r: 0.2, I: 0.1}\n"
            "  - {name: coupler, m: 1, l: 0.95, r: 0.5, I: 0.1}\n"
            "  - {name: rocker, m: 1, l: 0.8, r: 0.4, I: 0.1, from: {link: arm, at: [2.1, 0]}}\n"
            "closures: [[coupler, rocker]]"
        )
        assert mech.actuated == (0, 1)

    def test_groups_of_loops_in_random_trees(self):
        """Against sets of whole paths: a loop's joints are those on the path to one side only."""
        rng = np.random.default_rng(11)
        for _ in range(150):
            n = int(rng.integers(2, 12))
            links = [
                Link(f"a{k}", 1.0, 1.0, 0.5j, 0.1, Point(above, complex(rng.integers(0, 2))))
                for k, above in enumerate(
                    None if rng.random() < 0.3 or not k else int(rng.integers(0, k))
                    for k in range(n)
                )
            ]

            def end(n=n):
                k = int(rng.integers(-1, n))
                return Point(None if k < 0 else k, complex(rng.integers(0, 2)))

            closures = [Closure(end(), end()) for _ in range(int(rng.integers(0, 4)))]
            gears = rng.permutation(n)[: 2 * int(rng.integers(0, 2))].tolist()
            couplings = [Coupling(gears[0], ((gears[1], 2.0),), 0.0)] if gears else []
            scene = Description(
                "x", "x", 0j, tuple(links), tuple(closures), (), None, None,
                couplings=tuple(couplings),
            )  # fmt: skip
            try:
                mech = build(scene)
            except InputError:
                continue
            assert mech.actuated == whole_paths(links, closures, couplings)

    def test_passive_are_the_others(self):
        mech = seeded_scene(1, LOOPS["five-bar"]).mechanism
        assert (mech.actuated, mech.passive) == ((0, 2), (1, 3))


class TestObject:
    def test_arrays_are_made_once_and_cannot_be_written(self):
        arrays = seeded_scene(2, LOOPS["four-bar"]).mechanism.arrays
        for name in ("A", "B", "J", "P", "offset", "damping"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(arrays, name)[...] = 0.0
        mech = seeded_tree(2, 3).mechanism
        assert mech.arrays is mech.arrays

    def test_is_immutable_and_compared_by_identity(self):
        mech, twin = seeded_tree(3, 2).mechanism, seeded_tree(3, 2).mechanism
        with pytest.raises(AttributeError):
            mech.gamma = 0j
        assert mech != twin
        assert len({mech, twin}) == 2

    def test_travels_to_another_process(self):
        mech = seeded_scene(4, LOOPS["slider-crank"]).mechanism
        arrays = mech.arrays
        copy = pickle.loads(pickle.dumps(mech))
        assert tuple(copy.A) == tuple(mech.A)
        assert copy.description == mech.description
        assert np.array_equal(copy.arrays.P, arrays.P)

    def test_what_grows_with_the_square_of_the_links_is_made_on_demand(self):
        """3,000 links: their A alone has 4.5 million entries."""
        lines = (
            chain(3000)
            + "\nloads:\n"
            + "".join(
                f"  - {{link: link{k}, at: [0.5, 0], force: [1, 2]}}\n" for k in range(0, 3000, 3)
            )
        )
        described = from_text(lines, "x.yaml")
        tracemalloc.start()
        mech = build(described)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 3000 * 5000
        assert mech.n == len(mech.weights) == 3000

    def test_closures_along_a_long_chain_take_the_time_of_links_and_closures(self):
        """1,800 sliders on 2,000 links: their rows have two million numbers."""
        sliders = (
            f"  - {{point: link{k}, on: {{through: [0, {k}], along: [1, 0]}}}}\n"
            for k in range(200, 2000)
        )
        described = from_text(chain(2000, "closures:\n" + "".join(sliders)), "x.yaml")
        tracemalloc.start()
        with within(2.0):  # traced; a tenth of this without
            mech = build(described)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 3800 * 5000
        assert mech.actuated == (0,)
        assert len(mech.rows[-1].P) == 2000

    def test_constant_forces_are_weights(self):
        """PE = const - Re(weights . E): each force times the way to its point."""
        text = chain(4) + (
            "\nloads:\n  - {link: link2, at: [0.3, 0.1], force: [3, -2]}\n"
            "  - {link: link3, at: [0, 0.2], force: [1, 5], frame: link}\n"
        )
        mech, bare = mechanism(text), mechanism(chain(4))
        assert [force.turns for force in mech.of(Force)] == [False, True]
        coefficients = dict(mech.tree.point(mech.of(Force)[0].point).terms)
        for k, (weight, other) in enumerate(zip(mech.weights, bare.weights, strict=True)):
            expected = other + (3 + 2j) * coefficients.get(k, 0j)
            assert weight == pytest.approx(expected, rel=1e-14)

    def test_joint_index_maps_names_to_joints(self):
        mech = load(ROBOTS[0].parent / "four-bar.yaml")
        assert joint_index(mech) == {"crank": 0, "coupler": 1, "rocker": 2}

    def test_loading_needs_no_numpy(self):
        code = (
            "import sys, robodyn.mechanics.mechanism as m\n"
            f"m.load({str(ROBOTS[0])!r})\n"
            "sys.exit('numpy' in sys.modules)"
        )
        assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


class TestExamples:
    @pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
    def test_every_scene_loads_and_its_parameters_differ(self, path):
        """Equal parameters would hide a swap; only lengths of these two must be equal."""
        mech = load(path)
        links = mech.description.links
        masses = () if path.stem in MASSLESS else ("m", "r", "I")
        for key in masses + (() if path.stem in ("parallelogram", "peaucellier") else ("l",)):
            assert len({getattr(link, key) for link in links}) == mech.n
        assert all(math.isfinite(value.real) for _, _, value in mech.A)

    def test_the_examples_are_there(self):
        names = {path.stem for path in ROBOTS}
        assert names >= {"2r", "3r", "pendulum", "four-bar", "parallelogram", "slider-crank"}
        assert "five-bar" in names


def test_a_closure_at_a_links_own_joint_leaves_the_link_free():
    text = (Path(__file__).parent.parent / "robots/four-bar.yaml").read_text()
    text = text.replace("actuated: [crank]", "").replace(
        "closures:\n  - [coupler, rocker]",
        "  - {name: arm, m: 0.2, l: 0.3, r: 0.1, I: 0.01}\n"
        "closures:\n  - [coupler, {link: arm, at: [0, 0]}]",
    )
    assert build(from_text(text, "arm.yaml")).actuated == (0, 3)
