"""MJCF read back: M, G, gaps and their slopes by a reader of its own; what is refused."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import FRESH, ROOT
from hypothesis import given, settings
from sliding_scenes import BLOCK, COUPLED, MIXED, SLIDING
from unwritten import UNWRITTEN, WITH_LAWS

import robodyn
from model_readers import read_mjcf
from random_mechanisms import (
    LOOPS,
    Sizes,
    assert_close,
    forced,
    loops,
    mechanism,
    motored,
    seeded_scene,
    seeded_tree,
    sizes,
    sliding,
    trees,
)
from robodyn.elements.contacts import Mode
from robodyn.errors import InputError
from robodyn.export.mjcf import DEEPEST, MINIMUM, TIMESTEP, mjcf
from robodyn.export.model_xml import contact_notes, damping_ratio, restitution
from robodyn.mechanics.mechanism import build, load
from robodyn.mechanics.modes import in_mode, pressed

VARYING = {"weather-vane": "loads", "lift": "gravity"}  # what varies
REFUSED = UNWRITTEN | WITH_LAWS | {*VARYING}
ROBOTS = sorted(x for x in (ROOT / "robots").glob("*.yaml") if x.stem not in REFUSED)
EACH_ROBOT = pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
examples = settings(deadline=None, max_examples=40 if FRESH else 20)


def smooth(mech):
    """The mechanism without friction, which MJCF cannot say."""
    links = tuple(link._replace(friction=None) for link in mech.description.links)
    return build(mech.description._replace(links=links))


def reached(mech, q):
    """The sizes of terms, where displacements q make them larger."""
    size = sizes(mech.description)
    if not mech.slides:
        return size
    far = 1.0 + np.abs(q).max() / mech.unit
    return Sizes(size.inertia * far**2, size.gravity * far, size.damping, (size.loop + far) * far)


def read(mech, **options):
    """The model, and the places of robodyn's joints among its own."""
    model = read_mjcf(mjcf(mech, **options))
    names = [name.replace(" ", "_") for name in mech.link_names]
    assert sorted(model.joints) == sorted(names)
    return model, [model.joints.index(name) for name in names]


def angles(model, there, q):
    return {model.joints[j]: float(angle) for j, angle in zip(there, q, strict=True)}


def assert_same_terms(mech, q, begin=None):
    """M and G - Q at rest of the tree that opened closures leave, with the file's own gravity."""
    model, there = read(mech, q=begin)
    at, rest = angles(model, there, q), dict.fromkeys(model.joints, 0.0)
    M, G = model.terms(at, model.gravity)
    holding = (G - model.forces(at, rest))[there]
    G, Q = robodyn.gravity_vector(mech, q), robodyn.other_forces(mech, q, np.zeros_like(q))
    size = reached(mech, q)
    assert_close(M[np.ix_(there, there)], robodyn.mass_matrix(mech, q), size.inertia, 1e-14)
    assert_close(holding, G - Q, max(size.gravity, *np.abs(G), *np.abs(Q)), 1e-14)


def assert_same_closures(mech, q, begin=None):
    """Gaps and their slopes: of connects as they are, of sliders at closed q, scaled."""
    model, there = read(mech, q=begin)
    at = angles(model, there, q)
    gap, Psi = robodyn.closure_gap(mech, q), robodyn.closure_jacobian(mech, q)
    size, row = reached(mech, q).loop, 0
    connects, tendons, sums = iter(model.connects), iter(model.equal_tendons), iter(model.sums)
    for closure in mech.description.closures:
        if closure.along is None:
            (first, J1), (second, J2) = (model.site(at, name) for name in next(connects))
            assert_close((first - second)[:2], gap[row : row + 2], size, 1e-14)
            assert_close((J1 - J2)[:2][:, there], Psi[row : row + 2], size, 1e-14)
            assert (first - second)[2] == 0.0
            assert not (J1 - J2)[2].any()
            row += 2
        else:
            right, left, polynomial = next(tendons)
            error, slope = tendon_error(model, at, right, left, polynomial)
            place = model.site(at, right[1])[0]
            sites = [model.site(at, ends[0])[0] for ends in (right, left)]
            apart = np.linalg.norm(sites[0] - sites[1])
            scale = apart / np.linalg.norm(place - sites[0])  # a unit of the gap in lengths
            assert 1.0 < scale <= 2.0
            assert_close(error, scale * gap[row], apart, 1e-13)
            assert_close(slope[there], scale * Psi[row], apart, 1e-13)
            row += 1
        if closure.aligned is not None:  # the sine of an angle, times a length
            kept = mech.rows[row]
            ratios, angle = next(sums)
            error = sum(ratio * at[joint] for joint, ratio in ratios.items()) - angle
            slope = np.array([ratios.get(joint, 0.0) for joint in model.joints])
            sign = 1.0 if kept.arm * slope[there] @ Psi[row] > 0.0 else -1.0
            assert_close(sign * kept.arm * np.sin(error), gap[row], size, 1e-13)
            assert_close(sign * kept.arm * np.cos(error) * slope[there], Psi[row], size, 1e-13)
            row += 1
    angles_kept = sum(closure.aligned is not None for closure in mech.description.closures)
    for coupling in mech.rows[row:]:
        (ratios, angle) = next(
            (ratios, angle)
            for ratios, angle in model.sums
            if next(iter(ratios)) == model.joints[there[coupling_joint(mech, row)]]
        )
        error = sum(ratio * at[joint] for joint, ratio in ratios.items()) - angle
        slope = np.array([ratios.get(joint, 0.0) for joint in model.joints])
        assert_close(coupling.arm * error, gap[row], coupling.arm * np.abs(q).max(), 1e-14)
        assert_close(coupling.arm * slope[there], Psi[row], coupling.size, 1e-14)
        row += 1
    assert row == len(mech.rows)
    assert len(model.sums) == len(mech.description.couplings) + angles_kept
    assert next(connects, None) is next(tendons, None) is None


def coupling_joint(mech, row):
    """The joint that a coupling's row gives."""
    closures = sum(row.closure is not None for row in mech.rows)
    return mech.description.couplings[row - closures].joint


def tendon_error(model, at, right, left, polynomial):
    """y - y0 - a0 - a1 (x - x0) and its gradient, y0 and x0 the lengths where MuJoCo begins."""
    assert polynomial[1:] == [1, 0, 0, 0]
    (y, dy), (x, dx) = (model.length(at, ends) for ends in (right, left))
    y0, x0 = (model.length(model.begin, ends)[0] for ends in (right, left))
    return y - y0 - polynomial[0] - (x - x0), dy - dx


@pytest.mark.parametrize("name", VARYING)
def test_examples_that_it_refuses_by_name(name: str) -> None:
    what = VARYING[name]
    with pytest.raises(InputError, match=rf"{what}\[.\].* MJCF has constant {what} alone"):
        mjcf(load(ROOT / f"robots/{name}.yaml"))


class TestTerms:
    @examples
    @given(trees(most=7))
    def test_trees_keep_M_and_G(self, scene):
        assert_same_terms(scene.mechanism, scene.q)
        assert_same_terms(scene.mechanism, scene.q, begin=scene.q[::-1].tolist())

    @examples
    @given(loops())
    def test_loops_keep_M_and_G_and_their_closures(self, scene):
        assert_same_terms(scene.mechanism, scene.q, begin=scene.q.tolist())
        assert_same_closures(scene.mechanism, scene.q, begin=scene.q.tolist())

    @EACH_ROBOT
    def test_the_scenes_of_robots(self, path):
        mech = smooth(load(path))
        driven = mech.actuated if mech.rows else range(mech.n)
        q = np.random.default_rng(1).uniform(-4, 4, (5, len(driven)))
        q[:, [k in mech.slides for k in driven]] *= 0.05
        for state in robodyn.assemble(mech, q) if mech.rows else q:
            assert_same_terms(mech, state)
            assert_same_closures(mech, state)

    @EACH_ROBOT
    def test_mujoco_begins_where_loops_close(self, path):
        """Without --q too: from open loops its stiff constraints would throw it apart."""
        mech = smooth(load(path))
        begins = [None]
        if mech.rows:
            begins += [robodyn.assemble(mech, [0.02] * len(mech.actuated)).tolist()]
        for begin in begins:
            model, there = read(mech, q=begin)
            at = model.begin
            for first, second in model.connects:
                assert np.abs(model.site(at, first)[0] - model.site(at, second)[0]).max() < 1e-12
            for right, left, _ in model.equal_tendons:
                assert model.length(at, right)[0] == pytest.approx(model.length(at, left)[0])
            for ratios, angle in model.sums:
                held = sum(ratio * at[joint] for joint, ratio in ratios.items())
                assert held == pytest.approx(angle, abs=1e-12)
            if begin is not None:
                assert at == angles(model, there, begin) == model.keys["start"]

    @pytest.mark.parametrize("seed", range(3))
    def test_gaps_of_pins_hold_where_they_are_open(self, seed):
        scene = seeded_scene(seed, LOOPS["five-bar"])
        for q in np.random.default_rng(seed).uniform(-3, 3, (5, scene.mechanism.n)):
            assert_same_closures(scene.mechanism, q, begin=scene.q.tolist())

    @pytest.mark.parametrize("name", ["slider-crank", "six-bar with a piston"])
    @pytest.mark.parametrize("seed", range(3))
    def test_a_slider_is_off_its_line_to_the_side_that_its_gap_tells(self, name, seed):
        scene = seeded_scene(seed, LOOPS[name])
        mech = scene.mechanism
        model, there = read(mech, q=scene.q.tolist())
        for q in np.random.default_rng(seed).uniform(-3, 3, (10, mech.n)):
            error, _ = tendon_error(model, angles(model, there, q), *model.equal_tendons[0])
            gap = robodyn.closure_gap(mech, q)[-1]
            assert error * gap > 0.0
            assert abs(error) <= 2.0 * abs(gap) * (1 + 1e-12)


class TestCouplings:
    @pytest.mark.parametrize(
        "couplings",
        [
            *("q2 = -2 q1 + 0.1", "q1 = 0.5 q2 - 30deg", "q3 = 30deg", "q3 = q1 - 1/3 q2"),
            *('["q2 = -q1", "q3 = 20/37 q2 + 30deg"]', '["q1 = 1", "q4 = q3 + q2 - q1 - 0.25"]'),
        ],
    )
    @pytest.mark.parametrize("seed", range(3))
    def test_of_trees(self, seed, couplings):
        scene = seeded_tree(seed, 4)
        mech = mechanism(f"{scene.text}couplings: {couplings}\n")
        assert_same_terms(mech, scene.q)
        assert_same_closures(mech, scene.q)

    def test_of_a_loop(self):
        scene = seeded_scene(2, LOOPS["five-bar"])
        text = re.sub("actuated.*", "actuated: [link0]", scene.text)
        mech = mechanism(text + 'couplings: ["q3 = -2 q1 + 20deg"]\n')
        for q in np.random.default_rng(1).uniform(-3, 3, (5, mech.n)):
            assert_same_closures(mech, q)
        assert len(mech.rows) == 3

    def test_a_coupling_of_two_joints_is_written_as_it_is(self):
        """But for where it is counted from: q2 = 0.1 where q1 = 0, q2 = -0.5 where q1 = 2."""
        arm = (ROOT / "robots/2r.yaml").read_text()
        mech = mechanism(arm + "couplings: q2 = -0.3 q1 + 0.1\n")
        for q, begin in ((None, [None, "0.1"]), ([2.0, -0.25], ["2.0", "-0.25"])):
            root = ElementTree.fromstring(mjcf(mech, q=q))
            assert [joint.get("ref") for joint in root.iter("joint") if "axis" in joint.attrib] == (
                begin
            )
            equality = dict(root.find("equality/joint").attrib)
            apart, *others = map(float, equality.pop("polycoef").split())
            assert (apart, others) == (
                pytest.approx(0.0 if q is None else -0.25, abs=1e-15),
                [-0.3, 0, 0, 0],
            )
            assert equality == {"name": "coupling1", "joint1": "forearm", "joint2": "upper_arm"}
        assert root.find("default/equality") is not None


ALIGNED = """
links:
  - {name: base, joint: prismatic, axis: [1, 2], m: 0.8, l: 0, r: 0.03, I: 0.02, from: [0.1, 0]}
  - {name: arm, m: 0.3, l: 0.5, r: 0.02, I: 0.05}
  - {name: block, m: 0.3, l: 0.3, r: 0.02, I: 0.05}
  - {name: lever, m: 0.3, l: 0.3, r: 0.02, I: 0.05, from: [0.5, 0.5]}
  - {name: out, joint: prismatic, axis: [2, 1], m: 0.3, l: 0.1, r: 0.02, I: 0.05}
closures:
  - {point: block, on: {link: out, through: [0.1, 0.01], along: [3, -1]}, aligned: 30deg}
actuated: [base, arm, lever]
start: {block: 0.3, out: 0.1}
"""


class TestSlides:
    @pytest.mark.parametrize("text", [MIXED, COUPLED, BLOCK, SLIDING])
    def test_prismatic_joints_keep_M_and_G_and_forces(self, text):
        mech = smooth(mechanism(text))
        for q in np.random.default_rng(3).uniform(-2, 2, (5, mech.n)):
            assert_same_terms(mech, q)
            TestForces().assert_same_forces(mech, q, q[::-1])

    def test_pins_and_couplings_hold_where_they_are_open(self):
        for text in (COUPLED, SLIDING):
            mech = smooth(mechanism(text))
            for q in np.random.default_rng(3).uniform(-2, 2, (5, mech.n)):
                assert_same_closures(mech, q)

    def test_slots_and_angles_that_are_kept(self):
        for text in (BLOCK, ALIGNED):
            mech = mechanism(text)
            for q in np.random.default_rng(3).uniform(-0.2, 0.2, (5, len(mech.actuated))):
                assert_same_closures(mech, robodyn.assemble(mech, q))

    def test_an_angle_is_kept_in_the_turn_of_the_keyframe(self):
        mech = mechanism(BLOCK)
        q = robodyn.assemble(mech, [0.3])
        for turns in (-2, 0, 3):
            there = q + np.array([0.0, 2.0 * np.pi * turns, 0.0])
            model, places = read(mech, q=there.tolist())
            ratios, angle = model.sums[0]
            at = angles(model, places, there)
            assert sum(x * at[joint] for joint, x in ratios.items()) == pytest.approx(angle)

    def test_a_slide_lies_along_x_of_its_body(self):
        model, _ = read(smooth(mechanism(MIXED)))
        bodies = {body.joint: body for body in model.bodies}
        assert [bodies[name].slides for name in "abcde"] == [True, False, True, True, False]
        assert bodies["a"].axis.tolist() == [1, 0, 0]
        assert bodies["a"].turn[:, 0] == pytest.approx([2 / 5**0.5, 1 / 5**0.5, 0], abs=1e-15)
        assert (bodies["c"].stiffness, bodies["c"].springref, bodies["c"].damping) == (30, 0.1, 0.3)

    def test_what_never_turns_needs_no_inertia(self):
        cart = "{name: cart, joint: prismatic, axis: [1, 0], m: 1, l: 0, r: 0, I: 0}"
        pole = "{name: pole, m: 1, l: 1, r: 0.5, I: 0.1}"
        (body, _) = read(mechanism(f"links: [{cart}, {pole}]"))[0].bodies
        assert body.inertia[2, 2] == MINIMUM
        with pytest.raises(InputError, match=r"links\[1\] \(cart\)\.I = 0\.0"):
            mjcf(mechanism(f"links: [{pole}, {cart}]"))


ARM = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
LAWS = """
gravity: 9.81
links:
  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082}
  - {name: c, joint: prismatic, axis: [1, 0], m: 0.9, l: 0.6, r: 0.25, I: 0.031}
springs:
  - {joint: c, law: "100*x + 3*x**2 - x**3/2 + 2*v", length: 0.1}
  - {joint: a, law: "x*(1 + x)", angle: -1}
  - {between: [c, [1, 1]], law: "-(-40*x) + 3*v**3", length: 0.1}
  - {joint: a, law: "0.2*v", angle: 0}
"""
STOPS = """
gravity: 9.81
links:
  - {name: a, m: 1.5, l: 0.8, r: 0.36, I: 0.082, limits: {min: -30deg, max: 60deg, stiffness: 500}}
  - {name: b, m: 0.9, l: 0.6, r: 0.25, I: 0.031, limits: {max: 0.4, stiffness: 30}, damping: 0.1}
  - {name: c, joint: prismatic, axis: [1, 0], m: 0.9, l: 0.6, r: 0.25, I: 0.03,
     limits: {min: -0.2, stiffness: 1000}}
"""


class TestContacts:
    @pytest.mark.parametrize("seed", range(8))
    def test_stops_without_damping_are_exact(self, seed):
        mech = mechanism(STOPS)
        q, qd = np.random.default_rng(seed).uniform(-1.5, 1.5, (2, mech.n))
        moving = in_mode(mech, Mode((), (), pressed(mech, q.tolist(), qd.tolist())))
        model, there = read(mech)
        at, rates = angles(model, there, q), angles(model, there, qd)
        _, G = model.terms(at, model.gravity)
        wanted = robodyn.other_forces(moving, q, qd) - robodyn.gravity_vector(moving, q)
        wanted = wanted - moving.arrays.damping * qd
        theirs = (model.forces(at, rates) - G)[there]
        assert_close(theirs, wanted, max(1.0, *np.abs(wanted)), 1e-13)
        assert list(contact_notes(mech)) == []

    def test_a_damped_stop_is_a_limit_as_weak_as_can_be(self):
        arm = ARM.replace("0.1}", "0.1, limits: {max: 0.5, stiffness: 70, damping: 7}}")
        joint = ElementTree.fromstring(mjcf(mechanism(arm))).find("worldbody/body/joint")
        w = 1.0 / 0.35
        stiffness, damping = map(float, joint.get("solreflimit").split())
        assert (stiffness, damping) == pytest.approx((-70 * w, -7 * w))
        assert joint.get("range") == "-1000000000.0 0.5"
        assert joint.get("solimplimit").startswith("0.0001 0.0001 ")
        (note,) = contact_notes(mechanism(arm))
        assert "1e-4" in note

    @pytest.mark.parametrize("part", [0.0, 0.05, 0.2, 0.7, 0.99, 1.0])
    def test_a_hard_stop_has_the_damping_that_throws_back_so_much(self, part):
        z = damping_ratio(part)
        x, v = 0.0, 1.0  # of x" + 2 z x' + x = 0, until nothing is pushed
        step = 1e-4
        while x + 2.0 * z * v > 0.0:
            v -= step * (2.0 * z * v + x)
            x += step * v
        assert -v == pytest.approx(max(part, restitution(2.5)), abs=2e-3)
        text = ARM.replace("0.1}", f"0.1, limits: {{min: 0, restitution: {part}}}}}")
        (note,) = contact_notes(mechanism(text))
        assert f"about {max(part, restitution(2.5)):.2g} of" in note
        assert read(mechanism(text))[0].bodies[0].range == (0.0, 1e9)

    def test_dry_friction_is_its_level_in_motion(self):
        text = ARM.replace("0.1}", "0.1, friction: {torque: 0.5, static: 0.8, stribeck: 0.1}}")
        (body,) = read(mechanism(text))[0].bodies
        assert body.friction == 0.5
        (note,) = contact_notes(mechanism(text))
        assert "0.5 N m at rest too, not 0.8" in note


class TestForces:
    """Springs, dampers, loads: -G + Q - D qd of the scene, without friction, which is refused."""

    def assert_same_forces(self, mech, q, qd, rtol=1e-13, begin=None):
        model, there = read(mech, q=begin)
        at, rates = angles(model, there, q), angles(model, there, qd)
        _, G = model.terms(at, model.gravity)
        theirs = (model.forces(at, rates) - G)[there]
        G, Q = robodyn.gravity_vector(mech, q), robodyn.other_forces(mech, q, qd)
        resisted = mech.arrays.damping * qd
        size = max(np.abs(part).max() for part in (G, Q, resisted, 1.0))
        assert_close(theirs, Q - G - resisted, size, rtol)

    @pytest.mark.parametrize("seed", range(8))
    def test_of_rotors(self, seed):
        """On the ground an armature, on a link that turns that of a tendon; and damping."""
        n = 2 + seed % 4
        scene = motored(seed, sliding(seed, seeded_tree(seed, n), seed % n))
        assert_same_terms(scene.mechanism, scene.q)
        self.assert_same_forces(scene.mechanism, scene.q, scene.qd)

    @pytest.mark.parametrize("seed", range(8))
    def test_of_trees(self, seed):
        scene = forced(seed, seeded_tree(seed, 4))
        text = re.sub(r" friction: \{.*?\},", "", scene.text)
        assert text != scene.text
        self.assert_same_forces(mechanism(text), scene.q, scene.qd)

    @pytest.mark.parametrize("name", LOOPS)
    def test_of_loops(self, name):
        scene = forced(3, seeded_scene(3, LOOPS[name]))
        text = re.sub(r" friction: \{.*?\},", "", scene.text)
        mech, begin = mechanism(text), scene.q.tolist()
        self.assert_same_forces(mech, scene.q, scene.qd, begin=begin)
        assert_same_closures(mech, scene.q, begin)

    def test_of_laws_of_springs(self):
        mech = mechanism(LAWS)
        for seed in range(6):
            q, qd = np.random.default_rng(seed).uniform(-1.5, 1.5, (2, mech.n))
            self.assert_same_forces(mech, q, qd)
        model, _ = read(mech)
        powers = [stiffness for _, stiffness, _, _ in model.springs]
        assert powers == [(100.0, 3.0, -0.5), (1.0, 1.0), (40.0,), (0.0,)]

    @pytest.mark.parametrize("text", ["x**4", "x + 1", "x*v", "v**2", "sin(x)", "1/x", "x**0.5"])
    def test_other_laws_are_refused(self, text):
        limit = r"springs\[0\]\.law = .*: MJCF has polynomials"
        with pytest.raises(InputError, match=limit):
            mjcf(mechanism(ARM + f'springs: [{{joint: a, law: "{text}", angle: 0}}]\n'))

    def test_loads_that_vary_are_refused(self):
        with pytest.raises(InputError, match=r"loads\[0\]\.torque = .*constant loads alone"):
            mjcf(mechanism(ARM + 'loads: [{link: a, torque: "sin(t)"}]\n'))

    def test_springs_at_one_joint_act_as_one(self):
        mech = mechanism(
            "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1, damping: 0.25}]\n"
            "springs:\n"
            "  - {joint: a, stiffness: 5, angle: 0.4, damping: 0.5}\n"
            "  - {joint: a, stiffness: 2, angle: -3, damping: 0.125}\n"
            "  - {joint: a, stiffness: 0, angle: 9, damping: 1}\n"
        )
        (body,) = read(mech)[0].bodies
        assert (body.damping, body.stiffness) == (1.875, 7.0)
        assert body.springref == pytest.approx(-4 / 7, rel=1e-15)
        self.assert_same_forces(mech, np.array([7.5]), np.array([-2.0]))

    def test_one_spring_is_written_as_it_is(self):
        mech = mechanism(
            "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
            "springs: [{joint: a, stiffness: 0.3, angle: 0.1},"
            " {between: [[0.1, 0.7], a], stiffness: 4, length: 0.3, damping: 0.2}]\n"
        )
        model, _ = read(mech)
        assert (model.bodies[0].stiffness, model.bodies[0].springref) == (0.3, 0.1)
        assert model.springs == [(("spring2_first", "spring2_second"), (4.0,), (0.3, 0.3), (0.2,))]
        assert model.sites["spring2_first"][0] == "world"

    def test_a_load_may_be_called_as_a_link(self):
        mech = mechanism(
            "links: [{name: load1, m: 1, l: 1, r: 0.5, I: 0.1}]\n"
            "loads: [{link: load1, torque: 2}, {link: load1, at: [1, 0], force: [0, 3]}]\n"
        )
        model, _ = read(mech)
        assert model.motors == ["load1"]
        assert len(model.wrenches) == 2
        self.assert_same_forces(mech, np.array([0.4]), np.array([0.0]))


class TestModel:
    @pytest.mark.parametrize("seed", range(5))
    def test_damping_and_payload(self, seed):
        description = seeded_tree(seed, 5).mechanism.description
        model, _ = read(build(description))
        damping = {body.joint: body.damping for body in model.bodies if body.joint}
        assert damping == {link.name: link.damping for link in description.links}
        payloads = {body.parent: body for body in model.bodies if body.joint is None}
        for link in description.links:
            body = payloads.pop(link.name, None)
            assert (body is not None) == (link.payload > 0.0)
            if body is not None:
                assert (body.mass, body.place.tolist()) == (link.payload, [link.l, 0, 0])
                assert not body.inertia.any()
        assert not payloads

    def test_motors_are_on_actuated_joints(self):
        assert read(load(ROOT / "robots/five-bar.yaml"))[0].motors == ["left_crank", "right_crank"]
        scene = "links: [{name: a, m: 1, l: 1, r: 0.5, I: 0.1}]\nactuated: []"
        text = mjcf(mechanism(scene))
        assert "actuator" not in text

    def test_a_keyframe_has_the_angles_in_the_files_order(self):
        """Depth first: a link that hangs from the first comes before the second of the ground."""
        mech = mechanism(
            "links:\n"
            + "".join(
                f"  - {{name: {name}, m: 1, l: 1, r: 0.5, I: 0.1, from: {above}}}\n"
                for name, above in (("a", "[0, 0]"), ("b", "[1, 0]"), ("c", "a"), ("d", "b"))
            )
        )
        q = [0.1, 0.2, 0.3, 0.4]
        model, there = read(mech, q=q)
        assert model.joints == ["a", "c", "b", "d"]
        assert model.keys == {"start": dict(zip("abcd", q, strict=True))}
        assert [list(model.keys["start"].values())[j] for j in there] == q

    def test_options(self):
        root = ElementTree.fromstring(mjcf(load(ROOT / "robots/four-bar.yaml"), 0.0025))
        option = root.find("option")
        assert option.attrib == {
            "timestep": "0.0025",
            "integrator": "RK4",
            "gravity": "0.0 -9.81 0.0",
        }
        assert root.find("option/flag").attrib == {"contact": "disable"}
        assert root.find("default/equality").get("solref") == "0.005 1"
        assert not root.findall(".//geom")
        assert TIMESTEP == 1e-3
        open_chain = ElementTree.fromstring(mjcf(load(ROOT / "robots/2r.yaml")))
        tags = [element.tag for element in open_chain if isinstance(element.tag, str)]
        assert tags == ["compiler", "option", "worldbody", "actuator"]

    def test_numbers_read_back_exactly(self):
        mech = mechanism(
            "gravity: [0.1, 1e-17]\n"
            "links:\n"
            "  - {name: a, m: 0.1, l: 0.30000000000000004, r: [1e-20, -0.0], I: 1e300,"
            " from: [0.1, 3e-7], payload: 1}\n"
        )
        model, _ = read(mech)
        rod, payload = model.bodies
        assert model.gravity.tolist() == [0.1, 1e-17, 0]
        assert rod.centre.tolist() == [1e-20, 0, 0]
        assert rod.place.tolist() == [0.1, 3e-7, 0]
        assert (rod.mass, rod.inertia[2, 2], payload.place[0]) == (0.1, 1e300, 0.30000000000000004)


class TestRefusals:
    @pytest.mark.parametrize("key", ["m", "I"])
    @pytest.mark.parametrize("value", ["0", "9e-16"])
    def test_links_without_mass_or_inertia(self, key, value):
        numbers = {"m": "1", "I": "0.1"} | {key: value}
        fields = ", ".join(f"{name}: {number}" for name, number in numbers.items())
        text = (
            "links:\n"
            "  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1}\n"
            f"  - {{name: b, l: 1, r: 0.5, payload: 2, {fields}}}\n"
        )
        place = rf"links\[1\] \(b\)\.{key} = {float(value)}: MuJoCo takes nothing that moves"
        with pytest.raises(InputError, match=place) as caught:
            mjcf(mechanism(text))
        assert caught.value.exit_code == 2

    def test_the_least_mass_passes(self):
        text = f"links: [{{name: a, m: {MINIMUM!r}, l: 1, r: 0.5, I: {MINIMUM!r}}}]"
        assert read(mechanism(text))[0].bodies[0].mass == 1e-15

    def test_chains_that_xml_cannot_nest(self):
        def chain(n):
            link = "  - {{name: l{}, m: 1, l: 0.1, r: 0.05, I: 0.01, payload: 0.1}}\n"
            return mechanism("links:\n" + "".join(link.format(k) for k in range(n)))

        assert len(mjcf(chain(DEEPEST)).splitlines()) > DEEPEST
        with pytest.raises(InputError, match=f"links: more than {DEEPEST}"):
            mjcf(chain(DEEPEST + 1))
        with pytest.raises(InputError, match="links"):
            mjcf(chain(1100))
