"""Fits of numbers: derivatives against differences in 30 digits, and known answers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import FRESH, ROOT
from each_case import each
from engine_cases import AT, KINDS, ROBOTS, VARIED, random_case
from known_terms import DIGITS, Known, solve
from mpmath import mp, mpf
from named_case import case

import robodyn
from robodyn.dynamics import identities
from robodyn.dynamics.columns import TORQUE, column_names
from robodyn.dynamics.named_numbers import named_values
from robodyn.dynamics.named_points import link_turns, named_points
from robodyn.dynamics.state import State
from robodyn.errors import DescriptionError, InputError, RobodynError
from robodyn.loops.assembly_plan import assembly_plan
from robodyn.mechanics.mechanism import build, load
from robodyn.parameters import motion_fit
from robodyn.parameters.base_parameters import random_states
from robodyn.parameters.column_formulas import ColumnFormulas, LaneStates, Rows
from robodyn.scene.scene_values import read_numbers

STEP = 2.0**-10  # of a number's size; of order 4, differences are right to 1e-12


def closed(mech, given, qd, qdd, t):
    """q, qd, qdd in 30 digits from those of the actuated joints."""
    driven, n = list(mech.actuated), mech.n
    passive = [k for k in range(n) if k not in driven]
    with mp.workdps(DIGITS):
        q = np.array([mpf(float(x)) for x in robodyn.assemble(mech, given)])
        q[driven] = [mpf(float(x)) for x in given]
        zero = np.array([mpf(0)] * n)
        rows = slice(0, len(passive))

        def follow(at, right, values):
            found = zero.copy()
            found[driven] = [mpf(float(x)) for x in values]
            if passive:
                found[passive] = solve(at.Psi[rows][:, passive], right[rows] - at.Psi[rows] @ found)
            return found

        for _ in range(4):
            at = Known(mech, q, zero, t)
            if passive:
                q[passive] -= solve(at.Psi[rows][:, passive], at.gap[rows])
        rates = follow(Known(mech, q, zero, t), np.array([mpf(0)] * len(mech.rows)), qd)
        at = Known(mech, q, rates, t)
        return at, follow(at, -at.bias, qdd)


def exact_columns(mech, given, qd, qdd, t):
    """What `names_of` has, in 30 digits."""
    at, bend = closed(mech, given, qd, qdd, t)
    tau, multipliers = at.torques(bend)
    with mp.workdps(DIGITS):
        found = []
        gamma = mech.description.gravity
        for k, link in enumerate(mech.description.links):
            place = k, complex(link.l)
            moved = (
                at.pose.position(place),
                at.pose.slope(place) @ at.qd,
                at.pose.slope(place) @ bend + at.pose.bias(place, at.qd),
            )
            found += [x for z in moved for x in (z.real, z.imag)]
        found += [tau[k] for k in mech.actuated]
        found += [tau[k] * at.qd[k] for k in mech.actuated]
        pins, rows = [], iter(multipliers)
        for closure in mech.description.closures:
            F = sum(direction * next(rows) for direction in at.directions(closure))
            pins += [F.real, F.imag]
        found += pins
        found += [x for pair in at.reactions(bend, multipliers) for x in pair]
        loads = 0
        for k, link in enumerate(at.tree):
            place = k, link["r"]
            a = at.pose.slope(place) @ bend + at.pose.bias(place, at.qd)
            loads += link["m"] * (gamma - a)
        for item in mech.description.loads:
            if hasattr(item, "point"):
                loads += at.forces.turned(item)
        return np.array([*found, loads.real, loads.imag])


def names_of(mech):
    parts = ("x", "y", "vx", "vy", "ax", "ay")
    names = [f"tip{k + 1}_{part}" for k in range(mech.n) for part in parts]
    names += [f"{kind}{k + 1}" for kind in ("tau", "power") for k in mech.actuated]
    names += column_names(mech, ["pins"])
    names += [f"r{axis}{k + 1}" for k in range(mech.n) for axis in "xy"]
    return [*names, "shake_fx", "shake_fy"]


def lanes(mech, names, columns, given, qd=None, qdd=None, t=0.0, changes=None):
    formulas = ColumnFormulas(mech, names)
    given = np.asarray(given, float)
    rates = [np.zeros_like(given) if x is None else np.asarray(x, float) for x in (qd, qdd)]
    states = LaneStates(
        formulas, [formulas.column(x) for x in columns], Rows(given, *rates, np.full(len(given), t))
    )
    return states(np.zeros((1, len(names))) if changes is None else np.asarray(changes, float))


@pytest.mark.parametrize("kind", KINDS)
def test_every_column_of_random_scenes(kind: str) -> None:
    case = random_case(kind, 1, acted=True)
    mech, rng = case.mech, np.random.default_rng(7)
    given = case.q[list(mech.actuated)]
    qd, qdd = (case.qd[list(mech.actuated)], rng.normal(size=len(given)))
    t = AT if kind in VARIED else 0.0
    values = named_values(mech)
    columns = names_of(mech)
    checked = 0
    for name in rng.permutation(values.names).tolist():
        size = abs(values.number(name)) or 1.0
        steps = [size * STEP * x for x in (1.0, -1.0, 0.5, -0.5)]
        try:
            moved = [build(values.replaced({name: values.number(name) + x})) for x in steps]
            found, slopes, missing, _ = lanes(mech, [name], columns, [given], [qd], [qdd], t)
        except (InputError, DescriptionError):
            continue  # of a direction, or at the end of what it may be
        assert not missing.any()
        with mp.workdps(DIGITS):
            far, back, near, close = (exact_columns(x, given, qd, qdd, t) for x in moved)
            change = 6 * mpf(steps[0])
            expected = ((8 * (near - close) - (far - back)) / change).astype(float)
        at = exact_columns(mech, given, qd, qdd, t).astype(float)
        condition = (1.0 + case.at.condition) ** 0.5
        assert np.abs(found[0, 0] - at).max() < 1e-13 * condition * (1.0 + np.abs(at).max())
        off = np.abs(slopes[0, 0, :, 0] - expected)
        assert off.max() < 1e-11 * condition * (1.0 + np.abs(expected).max()), name
        checked += 1
        if checked == (2 if FRESH and kind not in VARIED else 1):
            return
    assert checked


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_every_column_of_the_examples(path) -> None:
    """Beside what the commands show, and its differences."""
    mech, rng = load(path), np.random.default_rng(4)
    if mech.switches or len(mech.passive) > len(mech.rows):
        with pytest.raises(InputError):
            robodyn.fit(mech, {"gravity": (0, 1)}, ["tau1"], np.zeros((3, len(mech.actuated))))
        return
    given = identities.sample_states(mech, 2).q[:, list(mech.actuated)]
    qd, qdd = rng.normal(size=(2, *given.shape))
    forces = ["reactions", "slide_moments", "shaking", "transmission", "jacobian", "places"]
    forces += ["KE", "PE", "energy"]
    columns = column_names(mech, [*TORQUE, *forces], named_points(mech))
    ratios = [f"{x}/{mech.link_names[0]}" for x in mech.link_names[1:]]
    columns += ratios
    formulas = ColumnFormulas(mech, [])
    others = column_names(mech, ["centres", "kappa", "manipulability"], named_points(mech))
    columns += (x for x in others if formulas.serves(x))

    def shown(mech):
        q = robodyn.assemble(mech, given)
        rates = robodyn.loop_velocities(mech, q, qd)
        state = q, rates, robodyn.loop_accelerations(mech, q, rates, qdd)
        return State(mech, *state).columns(columns)

    values = named_values(mech)
    for name in rng.permutation(values.names).tolist():
        h = 1e-3 * (abs(values.number(name)) or 1.0)
        try:
            near = [
                shown(build(values.replaced({name: values.number(name) + x * h})))
                for x in (1, -1, 0.5, -0.5)
            ]
            found, slopes, _, _ = lanes(mech, [name], columns, given, qd, qdd)
        except (InputError, DescriptionError, RobodynError):
            continue
        expected = shown(mech)
        there = ~np.isnan(expected).any(axis=0)  # a link that does not turn has no instant centre
        expected, found, slopes = expected[:, there], found[..., there], slopes[..., there, :]
        # some processors round more: 1.03e-12 of the toggle press
        assert np.abs(found[0] - expected).max() < 3e-12 * (1 + np.abs(expected).max())
        by = (8 * (near[2] - near[3]) - (near[0] - near[1]))[:, there] / (6 * h)
        off = np.abs(slopes[0, ..., 0] - by)
        assert (off <= 1e-6 * (1 + np.abs(by).max())).all(), name
        return
    pytest.fail("no number serves")


# -- loops that do not close -----------------------------------------------------------------------

FOUR_BAR = ROOT / "robots/four-bar.yaml"
LENGTHS = ("links.crank.l", "links.coupler.l", "links.rocker.l", "links.rocker.from[0]")


def four_bar_misses(l, theta):
    """max(D - l2 - l3, |l2 - l3| - D, 0), and its slopes by l1, l2, l3, d; of arrays of angles."""
    l1, l2, l3, d = l
    x, y = d - l1 * np.cos(theta), -l1 * np.sin(theta)
    D = np.hypot(x, y)
    far, near = D - l2 - l3, abs(l2 - l3) - D
    by_D = [(l1 - d * np.cos(theta)) / D, 0 * D, 0 * D, x / D]
    sign = np.sign(l2 - l3)
    slope = np.where(
        far > 0,
        [by_D[0], -1 + 0 * D, -1 + 0 * D, by_D[3]],
        np.where(near > 0, [-by_D[0], sign + 0 * D, -sign + 0 * D, -by_D[3]], 0.0),
    )
    return np.maximum(np.maximum(far, near), 0.0), slope.T


@pytest.mark.parametrize("l", [(0.35, 0.5, 0.8, 1.1), (0.35, 1.5, 0.6, 1.1), (0.9, 0.95, 0.8, 1.1)])
def test_what_a_four_bar_misses(l) -> None:
    mech = load(FOUR_BAR)
    own = np.array([0.35, 0.95, 0.8, 1.1])
    theta = np.linspace(0.1, 6.2, 40)
    _, slopes, missing, by = lanes(
        mech, LENGTHS, ["coupler_x", "q3"], theta[:, None], changes=[np.array(l) - own]
    )
    expected, expected_by = four_bar_misses(l, theta)
    assert (expected > 0.0).any()
    assert (expected == 0.0).any()
    assert np.abs(missing[0, :, 0] - expected).max() < 1e-14
    assert np.abs(by[0, :, 0] - expected_by).max() < 1e-13
    # columns go on where links point at one another
    off = expected > 1e-3
    for k in range(4):
        h = 1e-5
        sides = [np.array(l) - own + s * h * np.eye(4)[k] for s in (1, -1)]
        ahead, behind = (
            lanes(mech, LENGTHS, ["coupler_x", "q3"], theta[:, None], changes=[x])[0][0]
            for x in sides
        )
        assert np.abs((ahead - behind)[off] / (2 * h) - slopes[0, off, :, k]).max() < 1e-8


def test_rates_have_no_values_there() -> None:
    found = lanes(
        load(FOUR_BAR), ["links.coupler.l"], ["coupler_vx"], [[0.1], [3.0]], changes=[[-0.4]]
    )[0]
    assert np.isnan(found[0, 1, 0])
    assert np.isfinite(found[0, 0, 0])


STEPHENSON = (ROOT / "robots/stephenson-six-bar.yaml").read_text()


def test_loops_that_newtons_method_closes(scene) -> None:
    """The six-bar driven at its other end is no chain of dyads."""
    mech = robodyn.load(ROOT / "robots/stephenson-six-bar.yaml")
    driven = [[mech.link_names[-1]]]
    q = robodyn.assemble(mech, [2.0])
    angles = ", ".join(
        f"{name}: {x!r}" for name, x in zip(mech.link_names, q.tolist(), strict=True)
    )
    text = re.sub(r"actuated: .*", f"actuated: {driven[0]}".replace("'", ""), STEPHENSON)
    text = re.sub(r"^(assembly|start): .*\n", "", text, flags=re.M)
    mech = load(scene(text + f"\nstart: {{{angles}}}\n"))
    assert assembly_plan(mech).rest
    given = q[-1:] + 0.05 * np.arange(3)[:, None]
    name, columns = "links.rocker.l", ["q1", "q2", "qd3", "tau5", "shake_m"]
    states = (given, np.ones((3, 1)), np.ones((3, 1)))
    found, slopes, missing, _ = lanes(mech, [name], columns, *states)
    assert not missing.any()
    at = robodyn.assemble(mech, given)
    assert np.abs(found[0, :, :2] - at[:, :2]).max() < 1e-12
    h = 1e-4
    far, back, near, close = (
        lanes(mech, [name], columns, *states, changes=[[x]])[0][0]
        for x in (h, -h, 0.5 * h, -0.5 * h)
    )
    expected = (8 * (near - close) - (far - back)) / (6 * h)
    assert np.abs(slopes[0, ..., 0] - expected).max() < 1e-8 * (1 + np.abs(expected).max())
    assert lanes(mech, [name], ["q1"], given, changes=[[-0.4]])[2].all()


# -- known answers ---------------------------------------------------------------------------------

HALF = np.linspace(0.5 * np.pi, 1.5 * np.pi, 37)[:, None]
HOEKEN = {
    "links.coupler.l": (0.2, 1.0),
    "closures[0][0].at[0]": (0.1, 0.5),
    "closures[0][0].at[1]": (-0.1, 0.1),
    "links.rocker.l": (0.1, 0.5),
    "links.rocker.from[0]": (0.05, 0.5),
}


def line_of(mech):
    """Length of the way of Hoeken's point along its line, and aside, m."""
    q = robodyn.assemble(mech, np.linspace(0.5 * np.pi, 1.5 * np.pi, 1801)[:, None])
    return np.ptp(robodyn.points(mech, q, of="coupler").position[:, 0], axis=0)


@pytest.mark.parametrize("seed", range(3))
def test_hoekens_line_from_random_starts(seed: int) -> None:
    mech = load(ROOT / "robots/hoeken.yaml")
    wrong = build(named_values(mech).replaced({"links.rocker.l": 0.11}))
    height = np.full((len(HALF), 1), 0.4005)
    found = robodyn.fit(wrong, HOEKEN, ["coupler_y"], HALF, target=height, seed=seed)
    length, aside = line_of(found.mechanism)
    published = line_of(mech)
    assert found.starts == 30
    assert found.reached >= 3
    assert aside / length < published[1] / published[0]
    assert found.rms[0] < 2e-4 < found.rms_before[0]


def test_a_path_leads_back_to_its_four_bar() -> None:
    mech = load(FOUR_BAR)
    q = np.linspace(0.0, 2 * np.pi, 25)[:-1, None]
    at = robodyn.assemble(mech, q)
    path = robodyn.points(mech, at, of="coupler@0.4,0.3").position[:, 0]
    vary = {
        name: (0.5 * x, 1.5 * x) for name, x in zip(LENGTHS, (0.35, 0.95, 0.8, 1.1), strict=True)
    }
    names = ["P_x", "P_y"]
    found = robodyn.fit(mech, vary, names, q, target=path, of=["P=coupler@0.4,0.3"], seed=1)
    assert found.rms.max() < 1e-14
    assert list(found.numbers.values()) == pytest.approx([0.35, 0.95, 0.8, 1.1], rel=1e-12)
    # a function: the rocker's angle, whole turns aside
    del vary["links.crank.l"]
    turned = at[:, 2:] + 2 * np.pi
    found = robodyn.fit(mech, vary, ["q3"], q, target=turned, seed=1)
    assert list(found.numbers.values()) == pytest.approx([0.95, 0.8, 1.1], rel=1e-12)


def balanced_four_bar(**more):
    text = FOUR_BAR.read_text()
    given = (("gravity", "0"), ("links.crank.r", "[0.15, 0]"), ("links.rocker.r", "[0.36, 0]"))
    mech = build(read_numbers(text, str(FOUR_BAR), given).base)
    vary = {f"links.{x}.r[{k}]": (-1.0, 1.0) for x in ("crank", "rocker") for k in (0, 1)}
    q = np.linspace(0.0, 2 * np.pi, 24)[:, None]
    return robodyn.fit(mech, vary, ["shake_fx", "shake_fy"], q, np.full_like(q, 5.0), **more)


def test_counterweights_of_berkof_and_lowen() -> None:
    """m1 r1 = -m2 l1 (1 - r2/l2), m3 r3 = -m2 l3 r2/l2, of the force that vanishes."""
    found = balanced_four_bar()
    expected = [-1.3 * 0.35 * (1 - 0.45 / 0.95) / 0.6, 0.0, -1.3 * 0.8 * 0.45 / 0.95, 0.0]
    assert np.abs(np.array(list(found.numbers.values())) - expected).max() < 1e-12
    assert found.rms.max() < 1e-13 * found.rms_before.max()


def test_springs_that_balance_an_arm() -> None:
    mech = load(ROOT / "robots/balanced-arm.yaml")
    vary = {f"springs[{k}].stiffness": (0.0, 1000.0) for k in range(3)}
    wrong = build(named_values(mech).replaced(dict.fromkeys(vary, 50.0)))
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (30, 2))
    found = robodyn.fit(wrong, vary, ["tau1", "tau2"], q)
    assert list(found.numbers.values()) == pytest.approx([120.0, 20.0, 239.8], rel=1e-9)
    assert found.rms.max() < 1e-12


# -- conditions ------------------------------------------------------------------------------------


def test_a_condition_that_holds_alone() -> None:
    """tau1 = (m r g) cos q = 0.5 cos q, with r = 2 m: m = sqrt(0.25/g)."""
    rod, q = load(ROOT / "robots/pendulum.yaml"), np.linspace(-1.0, 1.0, 5)[:, None]
    vary = {"links.rod.m": (0.01, 2.0), "links.rod.r": (0.0, 2.0)}
    target = 0.5 * np.cos(q)
    found = robodyn.fit(
        rod, vary, ["tau1"], q, target=target, subject_to=["links.rod.r == 2*links.rod.m"]
    )
    assert found.numbers["links.rod.m"] == pytest.approx((0.25 / 9.81) ** 0.5, rel=1e-9)
    assert found.conditions["links.rod.r == 2*links.rod.m"] == pytest.approx(0.0, abs=1e-10)


def test_conditions_that_cost() -> None:
    """The best is where the condition begins, and where Lagrange's multipliers say."""
    least, even = "links.crank.r[0] >= -0.2", "links.crank.r[1] + links.rocker.r[1] == 0.1"
    free = balanced_four_bar()
    found = balanced_four_bar(subject_to=[least, even])
    numbers = found.numbers
    assert numbers["links.crank.r[0]"] == pytest.approx(-0.2, abs=1e-10)
    assert numbers["links.crank.r[1]"] + numbers["links.rocker.r[1]"] == pytest.approx(
        0.1, abs=1e-10
    )
    # the sum of squares is quadratic in the four numbers: solve it with both conditions
    names, mech = list(numbers), free.mechanism
    q = np.linspace(0.0, 2 * np.pi, 24)[:, None]
    _, J, _, _ = lanes(mech, names, ["shake_fx", "shake_fy"], q, np.full_like(q, 5.0))
    J = J[0].reshape(-1, 4)
    C = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 1.0]])
    K = np.block([[J.T @ J, C.T], [C, np.zeros((2, 2))]])
    start = np.array(list(free.numbers.values()))
    right = np.concatenate([J.T @ J @ start, [-0.2, 0.1]])
    assert list(numbers.values()) == pytest.approx(np.linalg.solve(K, right)[:4].tolist(), abs=1e-8)


def test_a_condition_in_columns_holds_at_every_row() -> None:
    free = balanced_four_bar()
    at = np.linspace(0.0, 2 * np.pi, 24)[:, None]

    def most(found):
        q = robodyn.assemble(found.mechanism, at)
        qd = robodyn.loop_velocities(found.mechanism, q, np.full_like(at, 5.0))
        qdd = robodyn.loop_accelerations(found.mechanism, q, qd, np.zeros_like(at))
        return robodyn.inverse_dynamics(found.mechanism, q, qd, qdd)[:, 0].max()

    limit = 0.8 * float(most(free))
    found = balanced_four_bar(subject_to=[f"tau1 <= {limit!r}"])
    assert most(found) == pytest.approx(limit, rel=1e-9)


@pytest.mark.parametrize(
    "name", ["slider-crank", "whitworth", "hydraulic-boom", "rp-arm", "hoeken"]
)
def test_turns_of_links_are_columns(name: str) -> None:
    """angle, w and wd are those of `points --columns links`; their slopes are differences."""
    mech = load(ROOT / f"robots/{name}.yaml")
    number = "links[1].l"
    columns = [f"{x}{k + 1}" for k in range(mech.n) for x in ("angle", "w", "wd")]
    q, qd, qdd = random_states(mech, 8)
    given = [x[:, list(mech.actuated)] for x in (q, qd, qdd)]
    q = robodyn.assemble(mech, given[0])
    qd = robodyn.loop_velocities(mech, q, given[1])
    qdd = robodyn.loop_accelerations(mech, q, qd, given[2])
    found, slopes, *_ = lanes(mech, [number], columns, *given)
    turns = np.stack(link_turns(mech, q, qd, qdd), axis=-1).reshape(len(q), -1)
    assert np.allclose(np.exp(1j * found[0]), np.exp(1j * turns), rtol=0.0, atol=1e-9)
    h = 1e-5 * (named_values(mech).number(number))
    ends = lanes(mech, [number], columns, *given, changes=[[h], [-h]])[0]
    differences = (ends[0] - ends[1]) / (2.0 * h)
    assert np.allclose(
        slopes[0, ..., 0], differences, rtol=1e-5, atol=1e-5 * np.abs(slopes).max() + 1e-9
    )


def test_angles_count_from_turn_to_turn() -> None:
    mech = load(ROOT / "robots/hoeken.yaml")
    q = np.linspace(2.0, 4.0, 9)[:, None]
    joints = robodyn.assemble(mech, q)
    zero = np.zeros_like(joints)
    angle = link_turns(mech, joints, zero, zero)[0][:, 1:2] + 2.0 * np.pi
    found = robodyn.fit(mech, {"links.rocker.l": (0.2, 0.3)}, ["angle2"], q, target=angle)
    assert found.rms_before[0] < 1e-12


# -- motions ---------------------------------------------------------------------------------------


def test_numbers_of_a_motion() -> None:
    mech, t = load(ROOT / "robots/2r.yaml"), np.linspace(0.0, 0.6, 13)
    true = robodyn.simulate(mech, [0.3, 0.2], [0.0, 0.0], 0.6, rtol=1e-11, atol=1e-11, t_eval=t)
    tips = robodyn.points(mech, true.q, true.qd, of="tip2")
    target = np.stack([true.q[:, 0], tips.position[:, 0, 0], tips.velocity[:, 0, 1]], axis=1)
    found = robodyn.fit_motion(
        mech,
        {"links.forearm.m": (0.5, 1.5), "q2": (-0.5, 0.5)},
        ["q1", "tip2_x", "tip2_vy"],
        t,
        [0.3, 0.0],
        target=target,
        starts=2,
    )
    assert list(found.numbers.values()) == pytest.approx([0.9, 0.2], rel=1e-8)
    assert found.rms.max() < 1e-9


def test_derivatives_of_motions_are_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a mass, a length and a start value, of angles and points, central differences of runs."""
    monkeypatch.setattr(motion_fit, "solved", lambda wanted, problem, *rest: problem)
    vary = {"links.coupler.m": (0.5, 2.0), "links.rocker.l": (0.7, 0.9), "qd1": (0.0, 6.0)}
    columns, t = ["q1", "qd3", "P_x", "P_vy"], np.linspace(0.0, 0.5, 6)
    problem = robodyn.fit_motion(
        load(FOUR_BAR), vary, columns, t, [1.0], [3.0], of=["P=coupler@0.3,0.2"]
    )
    h = 1e-4 * np.eye(3)
    exact = problem.states(np.zeros((1, 3)))[1][0]
    ends = [problem.states(np.concatenate([k * h, -k * h]))[0] for k in (1, 2)]
    one, two = ((x[:3] - x[3:]) / (2e-4 * k) for k, x in zip((1, 2), ends, strict=True))
    differences = np.moveaxis((4.0 * one - two) / 3.0, 0, -1)
    assert np.abs(exact).max(axis=(0, 1)).min() > 0.1
    assert np.abs(exact - differences).max() < 1e-5


def test_motions_with_stops_and_dry_friction(tmp_path) -> None:
    """By differences of runs; forces at states jump, and are refused by name."""
    path = tmp_path / "rod.yaml"
    text = "links:\n  - {name: rod, m: 0.4, l: 0.3, r: 0.15, I: 0.0088, limits: {max: 60deg, "
    path.write_text(f"{text}restitution: 0.6}}, friction: {{torque: 0.05, static: 0.05}}}}\n")
    rod, t = load(path), np.linspace(0.0, 0.3, 7)
    target = robodyn.simulate(rod, [0.9], [3.0], 0.3, t_eval=t).q
    path.write_text(path.read_text().replace("0.6", "0.5"))
    rod = load(path)
    vary = {"links.rod.limits.restitution": (0.2, 0.9)}
    found = robodyn.fit_motion(rod, vary, ["q1"], t, [0.9], [3.0], target=target, starts=1)
    assert list(found.numbers.values()) == pytest.approx([0.6], rel=1e-6)
    with pytest.raises(InputError, match="column = tau1: jumps where dry friction or a stop"):
        robodyn.fit(rod, {"links.rod.r": (0.1, 0.2)}, ["tau1"], t[:, None])
    x = robodyn.points(rod, t[:, None]).position[:, 0, :1]
    found = robodyn.fit(rod, {"links.rod.l": (0.1, 0.5)}, ["rod_x"], t[:, None], target=x)
    assert found.numbers["links.rod.l"] == pytest.approx(0.3)


# -- what is wrong ---------------------------------------------------------------------------------

Q = np.linspace(0.0, 6.0, 5)[:, None]


@each(
    ("change", "message"),
    [
        ({"vary": {"links.copler.l": (0.5, 1.0)}}, "links.copler.l.*links.coupler.l"),
        ({"vary": {"links.coupler.l": (1.0, 0.5)}}, "links.coupler.l=1:0.5.*LOW < HIGH"),
        ({"vary": {"links.coupler.m": (-1.0, 0.5)}}, "links.coupler.m=-1:0.5: no scene may have"),
        (
            {"vary": {"links.coupler.m": (0.5, 1e200)}},
            "0.5:1e.200: must be within -1e.30 and 1e.30",
        ),
        ({"vary": {}}, "names no number"),
        ({"vary": {"links.coupler.l": (0.1, 0.2)}}, "links.coupler.l: .*never close at every row"),
        ({"vary": {"links.coupler.l": (0.1, 0.2)}, "columns": ["tau1"]}, "never close"),
        ({"vary": {"links.coupler.l": (0.5, 1), "links[1].l": (0.5, 1)}}, "are one number"),
        ({"columns": ["couplr_x"]}, "couplr_x: is no column.*coupler_x"),
        ({"columns": ["tau2"]}, "tau2: is no column"),
        ({"columns": ["q9"]}, "q9: is no column"),
        ({"columns": []}, "none is named"),
        ({"target": np.zeros((3, 1))}, r"target = \(3, 1\).*\(5, 1\)"),
        ({"target": np.full((5, 1), 1e160)}, r"target = 1e\+160: must be 1e\+30 at most"),
        ({"q": np.zeros((0, 1))}, "one row a state"),
        ({"q": np.full((5, 1), np.nan)}, "must be finite"),
        ({"starts": 0}, "--starts = 0"),
        ({"seed": -1}, "--seed = -1"),
        ({"subject_to": ["links.coupler.l"]}, "one comparison"),
        ({"subject_to": ["links.coupler.l < = 2"]}, "has no meaning"),
        ({"subject_to": ["links.copler.l <= 2"]}, "has no meaning"),
        ({"subject_to": ["foo <= 2"]}, "name foo; known"),
        ({"subject_to": ["min(tau1, 1) <= 2"]}, "min.*bends or jumps"),
        ({"subject_to": ["(1 if tau1 else 0) <= 2"]}, "`if`.*bends or jumps"),
        ({"subject_to": ["links.coupler.l >= 3"]}, "links.coupler.l >= 3: is kept by none"),
    ],
)
def test_wrong_arguments_are_named(change, message: str) -> None:
    given = {"vary": {"links.coupler.l": (0.8, 1.1)}, "columns": ["coupler_x"], "q": Q} | change
    with pytest.raises(InputError, match=message):
        robodyn.fit(load(FOUR_BAR), **given)


def test_what_columns_do_not_tell() -> None:
    """Of a pendulum's m and r torques at rest tell the product, and nothing of I."""
    names = {"links.rod.m": (0.1, 2.0), "links.rod.r": (0.05, 1.0), "links.rod.I": (0.0, 1.0)}
    q = np.linspace(-1.0, 1.0, 5)[:, None]
    arguments = load(ROOT / "robots/pendulum.yaml"), names, ["tau1"], q
    found = robodyn.fit(*arguments, target=0.5 * np.sin(q + 1.0))
    assert len(found.untold) == 2
    assert "links.rod.I" in found.untold
    assert found.numbers["links.rod.I"] == found.before["links.rod.I"]


def test_bounds_of_many_sizes() -> None:
    """Beside 1e30 m the rocker's length is a part in 1e30, where scipy takes no step."""
    found = robodyn.fit(load(FOUR_BAR), {"links.rocker.l": (0.01, 1e30)}, ["tau1"], Q)
    assert found.rms[0] <= found.rms_before[0] * (1.0 + 1e-12)


def test_too_few_rows() -> None:
    vary = {"links.coupler.l": (0.8, 1.1), "links.rocker.l": (0.7, 0.9)}
    with pytest.raises(InputError, match="1 values are too few for 2 numbers"):
        robodyn.fit(load(FOUR_BAR), vary, ["coupler_x"], Q[:1])


# Runs of a fit: scenes whose loads and torques vary, free joints, dependent closures.


LOADED = """loads:
  - {link: coupler, at: [0.3, 0.1], force: ["2*cos(2*t)", "-3*q1"]}
  - {link: rocker, torque: "0.2*sin(3*t) - 0.1*qd3"}
springs: [{between: [rocker, coupler], stiffness: 1}]
"""
HANGING = """links:
  - {name: crank, m: 0.6, l: 0.35, r: 0.15, I: 0.008}
  - {name: coupler, m: 1.3, l: 0.95, r: 0.45, I: 0.102}
  - {name: rocker, m: 1.0, l: 0.80, r: 0.36, I: 0.061, from: [1.1, 0.0]}
  - {name: bob, m: 0.3, l: 0.3, r: 0.2, I: 0.01, from: coupler}
closures: [[coupler, rocker]]
actuated: [crank]
"""


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch):
    """The problem of a fit, which is not solved."""
    monkeypatch.setattr(motion_fit, "solved", lambda wanted, problem, *rest: problem)
    return robodyn.fit_motion


def test_runs_of_all_kinds(problem, tmp_path: Path) -> None:
    """Motions are those of `simulate`, derivatives differences of its motions."""
    four_bar = (ROOT / "robots/four-bar.yaml").read_text()
    texts = {"loaded": four_bar + LOADED.rsplit("springs", 1)[0], "hanging": HANGING}
    for name, text in texts.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    third = ROOT / "tests/hard_cases/third-crank.yaml"
    cart = ROOT / "robots/cart-pole.yaml"
    closed = robodyn.assemble(load(ROOT / "robots/four-bar.yaml"), [1.0])
    t = np.linspace(0.0, 0.5, 6)
    for path, q, qd, tau, vary in (
        (tmp_path / "loaded.yaml", [1.0], [2.0], "2*sin(3*t) - 0.5*qd1", ["links.rocker.l", "q1"]),
        (cart, [0.1, 1.2], [0.2, 0.3], "3*sin(2*t) - q1*qd2", ["links.pole.r", "q2", "qd2"]),
        (tmp_path / "hanging.yaml", [*closed, 0.4], None, [0.5], ["links.bob.r", "q1", "q4"]),
        (third, [-1.0, 1.0, -1.0, -1.0], [0.5], None, ["links[1].m", "qd1"]),
    ):
        with case(path.name):
            mech = load(path)
            columns = [f"{x}{k + 1}" for x in ("q", "qd") for k in range(mech.n)]
            bounds = dict.fromkeys(vary, (-3.0, 9.0)) | {
                x: (0.1, 3.0) for x in vary if x.startswith("links")
            }
            states = problem(mech, bounds, columns, t, q, qd, tau).states
            found, slopes, *_ = states(np.zeros((1, len(vary))))
            start = np.array(q) if len(q) == mech.n else robodyn.assemble(mech, q)
            rates = np.zeros(mech.n) if qd is None else np.array(qd)
            if len(rates) < mech.n:
                rates = robodyn.loop_velocities(mech, start, rates)
            run = robodyn.simulate(mech, start, rates, 0.5, tau, rtol=1e-11, atol=1e-11, t_eval=t)
            assert np.abs(found[0] - np.hstack([run.q, run.qd])).max() < 2e-8
            h = 1e-3 * np.eye(len(vary))
            ends = [np.stack([states._columns(x) for x in (*(k * h), *(-k * h))]) for k in (1, 2)]
            k = len(vary)
            one, two = ((x[:k] - x[k:]) / (2e-3 * i) for i, x in zip((1, 2), ends, strict=True))
            differences = np.moveaxis((4.0 * one - two) / 3.0, 0, -1)
            assert np.abs(slopes).max(axis=(0, 1, 2)).min() > 0.01
            assert np.abs(slopes[0] - differences).max() < 1e-6 * np.abs(slopes).max()


def test_conditions_on_motions() -> None:
    """Of numbers, and of columns at every row: the pendulum may swing no farther than 0.3 rad."""
    rod, t = load(ROOT / "robots/pendulum.yaml"), np.linspace(0.0, 1.0, 11)
    target = robodyn.simulate(rod, [0.0], [0.0], 1.0, t_eval=t).q
    vary = {"qd1": (-2.0, 2.0)}
    given = rod, vary, ["q1"], t, [-np.pi / 2]
    found = robodyn.fit_motion(
        *given, target=target, subject_to=["q1 <= 0.3 - pi/2", "rod_vx**2 <= 10"], starts=1
    )
    best = robodyn.simulate(
        rod, [-np.pi / 2], [found.numbers["qd1"]], 1.0, t_eval=t, rtol=1e-11, atol=1e-11
    )
    assert best.q.max() + np.pi / 2 == pytest.approx(0.3, abs=1e-9)
    assert found.conditions["q1 <= 0.3 - pi/2"] == pytest.approx(0.0, abs=1e-9)
    assert found.conditions["rod_vx**2 <= 10"] > 1.0
    masses = {"links.rod.m": (0.1, 3.0), "links.rod.r": (0.05, 0.3)}
    more = {"subject_to": ["links.rod.m*links.rod.r == 0.05"], "starts": 1}
    found = robodyn.fit_motion(rod, masses, ["q1"], [0.0, 0.1, 0.2], [0.0], **more)
    assert np.prod(list(found.numbers.values())) == pytest.approx(0.05, rel=1e-11)
    for text in ("tau1 <= 1", "qdd1 <= 2"):
        with pytest.raises(InputError, match=f"--subject-to = {text}: .*no column of a motion"):
            robodyn.fit_motion(*given, subject_to=[text])


def test_motions_are_integrated_in_machine_code_where_it_serves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("llvmlite", reason="the extra `fast`")
    methods: list[str] = []

    def recorded(*given, method: str, **options):
        methods.append(method)
        return robodyn.simulate(*given, method=method, **options)

    monkeypatch.setattr(motion_fit, "simulate", recorded)
    rod = load(ROOT / "robots/pendulum.yaml")
    vary = {"links.rod.m": (0.1, 3.0)}
    robodyn.fit_motion(rod, vary, ["q1"], [0.0, 0.1, 0.2], [0.5], starts=1)
    assert set(methods) == {"taylor"}
