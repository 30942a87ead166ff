"""Poses at rest: Newton's method on the balance, kept to regions in which it can be trusted.

Steps along the closures are Newton's, shortened by Levenberg's and Marquardt's rule until the
forces shrink; where that ends at a pose that is not at rest (a level arm, say, whose weight turns
it most) they are -|K|^-1 r instead, |K| with the absolute values of the eigenvalues, which go
downhill and past saddles.  Dry friction and hard stops hold nothing here; compliant stops push.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice, product
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robodyn.dynamics.closed_form import gravity_vector, other_forces, potential_energy
from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.dynamics.sticking import held_forces
from robodyn.elements.contacts import Mode
from robodyn.engines.factors import damped
from robodyn.errors import AssemblyError, InputError, RobodynError, SingularError
from robodyn.loops.assembly import assemble, attempt
from robodyn.loops.closing import close_positions, half_turn, loop_size, random_states
from robodyn.loops.closures import closure_gap
from robodyn.loops.loop_rates import check_closed
from robodyn.mechanics.driven import refuse_driven
from robodyn.mechanics.mechanism import Mechanism, joint_index
from robodyn.mechanics.modes import beyond, end_word, in_mode, pressed
from robodyn.mechanics.parts import check_lasting_gravity, without_rubbing
from robodyn.rest.balance import Balance, balance, balances, free_motions, single
from robodyn.rest.linear_model import eigenvalues, stable_by
from robodyn.scene.yaml_values import nearest
from robodyn.tables.arrays import Array
from robodyn.tables.csv_fields import shown
from robodyn.tables.short_repr import short_repr

LONGEST = 0.3  # rad of a step
PASSES = 100  # steps of one kind
SHRINKS = 0.99  # a Newton step leaves no more of the forces, or is shortened
SETTLED = 1e-7  # rad; a Newton step below it is the last but one
AT_REST = 1e-9  # part of what acts that may be left over
LEAST, MOST = 1e-3, 1e6  # damping that is begun with, and given up with, as parts of what acts
LEVEL = 1e-9  # part of the largest stiffness below which an eigenvalue counts as zero
CLOSED = 1e-9  # part of the loop's size that a pose may be open
SAME = 1e-6  # rad by which poses may differ that are one
STARTS = 30  # in vain before no more are tried, or 10 for each pose that is found
MOST_EVALUATIONS = 10_000  # of the balance, over all starts
DRAWN = (STARTS, 300, 900, 900, 900)  # starts, so many at once: paths to many take no longer
TOGETHER = 30  # starts followed at once
MOST_STARTS = sum(DRAWN)
MOST_TURNS = 10  # of a joint with springs, from their free angles
MOST_LEVEL = 12  # poses that rest beside themselves, after which there is no end of them

Found = tuple[Array, Balance, Mechanism]  # a pose at rest, its balance, and what acts there


@short_repr
class Rest(NamedTuple):
    """A pose at rest: q (n,), PE (J), and tau (n,), what was given and what holds held joints.

    `stable` is whether a small push leads only a little away: True where PE has a minimum along
    the closures (or, where forces have no potential, where no small motion grows), None where that
    is not decided by the second derivatives.
    """

    q: Array
    potential_energy: float
    tau: Array
    stable: bool | None


def equilibrium(
    mechanism: Mechanism,
    near: ArrayLike | None = None,
    hold: str | Sequence[str] = (),
    tau: ArrayLike | None = None,
) -> Rest:
    """A pose at rest near the closed pose `near` (n,), by default the scene's start or any other.

    N^T (tau - h) = 0 with gap(q) = 0 (`balance.py`), under the torques tau of all joints or of the
    actuated ones, by default zero.
    Joints of the links named in `hold` stay where they are, and their torques are found.  Dry
    friction is left out.  Raises InputError for values that do not fit and a pose that does not
    close, RobodynError where no pose at rest is found, or it is beyond the end of a joint.
    """
    mechanism = without_rubbing(mechanism)  # at rest such friction is none
    refuse_driven(mechanism, "equilibrium")
    check_lasting_gravity(mechanism, "a pose at rest")
    joints, torques = _joints(mechanism, hold), single(mechanism, "tau", tau)
    begin = _near(mechanism, near)
    found, _ = next(_poses(mechanism, joints, [begin], torques))
    if isinstance(found, float):
        raise _none(mechanism, begin, torques, found)
    q = found[0]
    if ends := beyond(mechanism, q.tolist(), turns=True):
        raise _beyond(mechanism, q, ends[0])
    return _rest(mechanism, joints, found, torques)


def equilibria(
    mechanism: Mechanism,
    near: ArrayLike | None = None,
    hold: str | Sequence[str] = (),
    tau: ArrayLike | None = None,
    watch: Callable[[float], object] | None = None,
) -> list[Rest]:
    """The poses at rest that are found from many random starts, each once, the lowest PE first.

    Held joints stay where they are in `near`.  Starts are as the scene is assembled, where the
    actuated joints tell the others.  Angles lie within half a turn of zero, but for joints whose
    turns count; those with springs are searched as `searched_turns` tells.  `watch` is told now
    and then what part of the most starts is tried.  Raises RobodynError where there is none, or no
    end of them, else as `equilibrium`.
    """
    mechanism = without_rubbing(mechanism)
    refuse_driven(mechanism, "equilibrium")
    check_lasting_gravity(mechanism, "a pose at rest")
    joints, torques = _joints(mechanism, hold), single(mechanism, "tau", tau)
    sprung = {x.at for x in mechanism.elements if x.free is not None}
    counting = {*sprung, *(x.joint for x in mechanism.ranges), *mechanism.slides}
    coupled = {k for x in mechanism.description.couplings for k in x.joints}
    turning = [k for k in range(mechanism.n) if k not in counting]
    alone = [k for k in turning if k not in coupled]
    there: list[Found] = []
    level, last, least = 0, 0, math.inf
    passed: RobodynError | None = None  # the first pose at rest beyond an end
    begin = _near(mechanism, near)
    turns = searched_turns(mechanism, begin, hold, torques)
    in_vain = STARTS + 10 * sum(high - low for low, high in turns.values())
    evaluations = 0
    starts = _starts(mechanism, joints, begin, turns, watch)
    for tried, (found, count) in enumerate(_poses(mechanism, joints, starts, torques)):
        if tried - last > in_vain + 10 * len(there):
            break
        if evaluations > MOST_EVALUATIONS:
            remark = f"the search ended after {tried} starts: there may be more poses at rest"
            warnings.warn(remark, RobodynWarning, stacklevel=2)
            break
        evaluations += count
        if isinstance(found, float):
            least = min(least, found)
            continue
        if ends := beyond(mechanism, found[0].tolist(), turns=True):
            passed = passed or _beyond(mechanism, found[0], ends[0])
            continue
        # whole turns alone are taken away, and half a turn is positive
        found[0][alone] -= math.tau * np.ceil((found[0][alone] - math.pi - SAME) / math.tau)
        if any(_same(mechanism, turning, found[0] - q) for q, *_ in there):
            continue
        there.append(found)
        last = tried
        level += float(np.abs(np.linalg.eigvals(found[1].stiffness)).min(initial=np.inf)) <= (
            LEVEL * _size(mechanism, found[1], torques)
        )
        if level > MOST_LEVEL:
            limit = "it moves from one to the next without any force; hold a joint"
            raise RobodynError("no end of poses at rest", where=mechanism.source, limit=limit)
    if not there:
        raise passed or _none(mechanism, None, torques, least)
    rests = [_rest(mechanism, joints, found, torques) for found in there]
    return sorted(rests, key=lambda rest: (round(rest.potential_energy, 9), *rest.q))


def searched_turns(
    mechanism: Mechanism,
    near: ArrayLike | None = None,
    hold: str | Sequence[str] = (),
    tau: ArrayLike | None = None,
) -> dict[int, tuple[int, int]]:
    """Return the first and the last turn of joints, by joint, that `equilibria` searches.

    Turn k reaches half a turn to either side of 2 pi k rad.  Listed are joints that turn and have
    springs, which make turns differ, with the joints coupled to them.  The springs' free angles are
    searched, and from there on as far as the springs pull less than twice what all else does at
    the worst of STARTS random poses, MOST_TURNS turns at most.
    """
    held, torques = _joints(mechanism, hold), single(mechanism, "tau", tau)
    barred = {x.joint for x in mechanism.ranges if len(x.ends) == 2}
    barred |= {*held, *mechanism.slides}
    frees: dict[int, list[float]] = {}  # of each joint where what makes turns differ is free
    for x in mechanism.elements:
        if x.at is not None and x.free is not None and x.at not in barred:
            frees.setdefault(x.at, []).append(x.free)
    if not frees:
        return {}
    begin = _near(mechanism, near)
    poses = list(islice(_starts(mechanism, held, begin, {}), STARTS))
    motions = [free_motions(mechanism, pose) for pose in poses]
    found: dict[int, tuple[int, int]] = {}
    for joint in sorted(frees):
        others = tuple(x for x in mechanism.elements if x.free is None or x.at != joint)
        bare, most = replace(mechanism, elements=others), 0.0
        for pose, N in zip(poses, motions, strict=True):
            size = float(N[joint] @ N[joint])
            with suppress(RobodynError):  # beyond the rows of a table nothing rests
                if size > LEVEL:  # what the springs have to balance along the joint's motions
                    wanted = N[joint] @ N.T @ (torques - _pulls(bare, pose)) / size
                    most = max(most, 2.0 * abs(float(wanted)))
        ends = []
        for side in (-1, 1):
            turn = max((round(x / math.tau) for x in frees[joint]), key=lambda k: side * k)
            for _ in range(MOST_TURNS):
                there = begin.copy()
                there[joint] = math.tau * turn + side * math.pi
                with suppress(RobodynError):  # beyond the rows of a table there is no pull
                    if abs((_pulls(mechanism, there) - _pulls(bare, there))[joint]) <= most:
                        turn += side
                        continue
                break
            ends.append(turn)
        found[joint] = ends[0], ends[1]
    for coupling in mechanism.description.couplings:
        ratios = {coupling.joint: 1.0, **dict(coupling.terms)}
        for sprung, joint in product(ratios, ratios):
            if sprung in found and joint not in found and joint not in barred and ratios[joint]:
                wide = abs(ratios[sprung] / ratios[joint])
                low, high = (k * wide for k in found[sprung])
                found[joint] = max(math.floor(low), -MOST_TURNS), min(math.ceil(high), MOST_TURNS)
    return found


def _pulls(mechanism: Mechanism, q: Array) -> Array:
    """The torques (..., n) that hold q (..., n) at rest, N m, pin forces and stops left out."""
    mechanism = in_mode(mechanism, Mode()) if mechanism.switches else mechanism
    return gravity_vector(mechanism, q) - other_forces(mechanism, q, np.zeros(mechanism.n))


def _joints(mechanism: Mechanism, names: str | Sequence[str]) -> tuple[int, ...]:
    """The joints of the links with these names, or with one name."""
    links = joint_index(mechanism)
    names = [names] if isinstance(names, str) else names
    for name in names:
        if name not in links:
            limit = f"names no link{nearest(name, list(links))}"
            raise InputError("hold", value=shown(name), limit=limit)
    return tuple(sorted({links[name] for name in names}))


def _beyond(mechanism: Mechanism, q: Array, end: tuple[int, int, float]) -> RobodynError:
    """The error for a pose at rest that is beyond an end of a joint."""
    joint, side, where = end
    what = f"the pose at rest has q{joint + 1} ({mechanism.link_names[joint]})"
    limit = f"beyond the joint's {end_word(side)}, {where:.9g}; hold the joint there"
    return RobodynError(what, where=mechanism.source, value=f"{q[joint]:.9g}", limit=limit)


def _none(mechanism: Mechanism, near: Array | None, tau: Array, left: float) -> RobodynError:
    """Return the error that no pose at rest was found, and what part of torques balances."""
    what, way, other = "no pose at rest", "from any start", "give torques"
    if near is not None:
        what, way, other = (
            f"{what} near q = {_shown(near)}",
            "on the way from there",
            "start elsewhere",
        )
    if not tau.any():
        limit = f"forces do not vanish {way}: {other}, or hold a joint"
        return RobodynError(what, where=mechanism.source, limit=limit)
    part = f"{100.0 * max(0.0, 1.0 - left):.3g} % of it is balanced {way} at most"
    return RobodynError("tau", where=mechanism.source, value=_shown(tau), limit=f"{what}: {part}")


def _shown(values: Array) -> str:
    return ", ".join(f"{x:g}" for x in values)


def _near(mechanism: Mechanism, near: ArrayLike | None) -> Array:
    """The start, closed: as given, else near that of the scene."""
    if near is None:
        start = mechanism.description.start or [None] * mechanism.n
        begin = np.array([x or 0.0 for x in start])
        # joints are free, zero is out of reach, or it does not determine the pose
        with suppress(InputError, AssemblyError, SingularError):
            return assemble(mechanism, begin[list(mechanism.actuated)], t=0.0)
        near = close_positions(mechanism, begin, t=0.0)
        if not _open(mechanism, near):
            return near
        return next(islice(_starts(mechanism, (), near, {}), 1, None), near)  # any that closes
    begin = single(mechanism, "near", near)
    if (fault := check_closed(mechanism, begin, t=0.0)) is not None:
        raise fault[1]
    return begin


def _starts(
    mechanism: Mechanism,
    joints: Sequence[int],
    near: Array,
    turns: Mapping[int, tuple[int, int]],
    watch: Callable[[float], object] | None = None,
) -> Iterator[Array]:
    """Random closed poses, the held joints as in `near`, others in turns if `turns` has some."""
    rng, driven = np.random.default_rng(0), list(mechanism.actuated)
    coupled = {k for x in mechanism.description.couplings for k in x.joints}
    yield near
    drawn_first = 0
    for count in DRAWN:
        drawn = random_states(mechanism, rng, count)
        for joint, low, high, _ in mechanism.ranges:
            if low is not None and high is not None:
                drawn[:, joint] = rng.uniform(low, high, count)
        shifts = {
            k: math.tau * rng.integers(*ends, count, endpoint=True) for k, ends in turns.items()
        }
        for k, shift in shifts.items():
            drawn[:, k] += shift
        drawn[:, list(joints)] = near[list(joints)]
        closed = None
        if mechanism.rows and set(joints) <= set(driven):
            with suppress(InputError):  # joints are free: the actuated ones do not tell the rest
                q, missing = attempt(mechanism, drawn[:, driven], t=0.0)
                free = np.isnan(missing)  # any direction closes: the one drawn
                drawn = np.where(np.isnan(q), drawn, q)
                q[free] = close_positions(mechanism, drawn[free], joints, t=0.0)
                free &= ~_open(mechanism, q)
                for k in set(shifts) - {*driven, *coupled}:
                    q[:, k] += shifts[k]
                closed = q[free | (missing <= 0.0)]
        if closed is None:
            q = close_positions(mechanism, drawn, joints, t=0.0)
            closed = q[~_open(mechanism, q)]
        for place, pose in enumerate(closed):
            if watch is not None:
                watch((drawn_first + count * place / len(closed)) / MOST_STARTS)
            yield pose
        drawn_first += count


def _same(mechanism: Mechanism, turning: Sequence[int], way: Array) -> bool:
    """Whether poses that differ by `way` (n,) are one."""
    way = way / mechanism.arrays.units
    way[list(turning)] = half_turn(way[list(turning)])
    return bool(np.abs(way).max() < SAME)


def _open(mechanism: Mechanism, q: Array) -> NDArray[np.bool_]:
    """Which of q (..., n) are open."""
    gap = np.abs(closure_gap(mechanism, q, 0.0)).max(axis=-1, initial=0.0)
    return np.asarray(~(gap <= CLOSED * loop_size(mechanism)))


# -- many poses at once ----------------------------------------------------------------------------


class Try(NamedTuple):
    """A pose whose balance is asked for, to be closed before; `exact` is None for one that is."""

    acting: Mechanism  # with what acts at the pose before
    q: Array  # (n,)
    exact: bool | None


# a closed pose, what acts there, and the balance; None where it does not close
Tried = tuple[Array, Mechanism, Balance] | None
Steps = Generator[Try, Tried, Found | float]
Key = TypeVar("Key")


def _poses(
    mechanism: Mechanism, joints: tuple[int, ...], starts: Iterable[Array], tau: Array
) -> Iterator[tuple[Found | float, int]]:
    """Yield the result of `_at_rest` for each start, and the number of balances it took.

    TOGETHER starts go on at once, since numpy needs as long for one pose as for many.
    """
    each = iter(starts)
    while block := list(islice(each, TOGETHER)):
        walks = [_at_rest(mechanism, joints, start, tau) for start in block]
        asked = {k: next(walk) for k, walk in enumerate(walks)}
        found: list[Found | float] = [math.inf] * len(block)
        counts = [0] * len(block)
        while asked:
            answers = _balances(mechanism, joints, asked, tau)
            for k, answer in answers.items():
                counts[k] += answer is not None
                try:
                    if isinstance(answer, Exception):
                        asked[k] = walks[k].throw(answer)
                    else:
                        asked[k] = walks[k].send(answer)
                except StopIteration as end:
                    found[k] = end.value
                    del asked[k]
        yield from zip(found, counts, strict=True)


def _balances(
    mechanism: Mechanism, joints: tuple[int, ...], asked: Mapping[int, Try], tau: Array
) -> dict[int, Tried | Exception]:
    """The answers to what is asked, or the error of each that has none."""
    answers: dict[int, Tried | Exception] = dict.fromkeys(asked)
    closed: dict[int, Array] = {}
    for (acting, exact), which in _grouped({k: (x.acting, x.exact) for k, x in asked.items()}):
        q = np.array([asked[k].q for k in which])
        if exact is not None:
            q = close_positions(acting, q, exact=exact, t=0.0)
        opened = _open(mechanism, q)
        closed |= {k: q[i] for i, k in enumerate(which) if exact is None or not opened[i]}
    acting_at = {k: _acting(mechanism, joints, q) for k, q in closed.items()}
    for acting, which in _grouped(acting_at):
        q = np.array([closed[k] for k in which])
        try:
            found: list[Balance | Exception] = [*balances(acting, q, tau)]
        except (SingularError, np.linalg.LinAlgError):  # of one of them
            found = [_one(acting, each, tau) for each in q]
        for k, at in zip(which, found, strict=True):
            answers[k] = at if isinstance(at, Exception) else (closed[k], acting, at)
    return answers


def _one(acting: Mechanism, q: Array, tau: Array) -> Balance | Exception:
    try:
        return balance(acting, q, tau)
    except (SingularError, np.linalg.LinAlgError) as error:
        return error


def _grouped(keys: Mapping[int, Key]) -> Iterator[tuple[Key, list[int]]]:
    """Each key with the numbers that have it."""
    groups: dict[Key, list[int]] = {}
    for number, key in keys.items():
        groups.setdefault(key, []).append(number)
    yield from groups.items()


# -- one pose ------------------------------------------------------------------------------------


def _acting(mechanism: Mechanism, joints: tuple[int, ...], q: Array) -> Mechanism:
    """The mechanism with joints held, and the compliant stops that push at q."""
    mode = Mode(joints, (), pressed(mechanism, q.tolist(), [0.0] * mechanism.n))
    return in_mode(mechanism, mode) if mechanism.switches or any(mode) else mechanism


def _at_rest(mechanism: Mechanism, joints: tuple[int, ...], start: Array, tau: Array) -> Steps:
    """Follow steps from `start` to a pose at rest, or else to the least part of forces left over.

    It asks for balances by yielding poses, and is sent them.
    """
    least = math.inf
    for downhill in (False, True):
        with suppress(SingularError, np.linalg.LinAlgError):
            found = yield from _steps(mechanism, joints, start, tau, downhill)
            if not isinstance(found, float):
                return found
            least = min(least, found)
    return least


def _steps(
    mechanism: Mechanism, joints: tuple[int, ...], q: Array, tau: Array, downhill: bool
) -> Steps:
    first = yield Try(_acting(mechanism, joints, q), q, None)
    assert first is not None  # it is not closed, and so does not fail to close
    (q, acting, at), damping, least = first, 0.0, math.inf
    moves = at.N.size > 0
    for _ in range(PASSES):
        if moves and not at.N.size:
            return least  # between two branches, on neither
        size = _size(mechanism, at, tau)
        least = min(least, _unbalanced(at, tau))
        if downhill:
            step = _downhill(at, size)
        else:  # K^-1 r where nothing is damped, and where K is singular the least such step
            step = damped(at.stiffness, at.force, damping * damping, LEVEL * size)
        length = float(np.abs(step).max(initial=0.0))
        settled = length <= SETTLED and not damping
        left = np.abs(at.force - at.stiffness @ step).max(initial=0.0)
        if settled and left > AT_REST * size:
            return least  # what no stiffness balances
        there = q + at.N @ (step * min(1.0, LONGEST / max(length, LONGEST)))
        tried = yield Try(acting, there, settled)
        if tried is None and downhill:
            return least
        if tried is not None:
            there, acting, nearer = tried
            if settled:  # pin forces that grow beyond bounds stiffen, and hide what is left over
                bound = AT_REST * _acts(mechanism, nearer, tau)
                rests = np.abs(nearer.force).max(initial=0.0) <= bound
                return (there, nearer, acting) if rests else least
            if downhill or np.linalg.norm(nearer.force) < SHRINKS * np.linalg.norm(at.force):
                q, at = there, nearer
                damping = damping / 10.0 if damping > LEAST * size else 0.0
                continue
        if (damping := max(10.0 * damping, 10.0 * LEAST * size)) > MOST * size:
            return least
    return least


def _unbalanced(at: Balance, tau: Array) -> float:
    """The part of the larger of what acts and the torques that is left over along free motions."""
    held = at.N.T @ tau
    left, *acts = (float(np.linalg.norm(x)) for x in (at.force, held, held - at.force))
    return left / (max(acts) or 1.0)


def _downhill(at: Balance, size: float) -> Array:
    """|K|^-1 r; along what has no stiffness as far as the longest step where a force acts."""
    w, V = np.linalg.eigh(0.5 * (at.stiffness + at.stiffness.T))
    force = V.T @ at.force
    force[(np.abs(w) <= LEVEL * size) & (np.abs(force) <= AT_REST * size)] = 0.0
    return np.asarray(V @ (force / np.maximum(np.abs(w), LEVEL * size)))


def _size(mechanism: Mechanism, at: Balance, tau: Array) -> float:
    """Return the scale of forces and stiffness, N m: the largest of what acts."""
    return max(_acts(mechanism, at, tau), float(np.abs(at.stiffness).max(initial=0.0)))


def _acts(mechanism: Mechanism, at: Balance, tau: Array) -> float:
    """The largest of forces and of their own stiffness, N m, without that of pin forces."""
    parts = [mechanism.arrays.weights, at.load.tau, at.load.by_q, tau]
    units = float(mechanism.arrays.units.max())
    return max(float(np.abs(part).max(initial=0.0)) for part in parts) * units or 1.0


def _rest(mechanism: Mechanism, joints: tuple[int, ...], found: Found, tau: Array) -> Rest:
    q, at, acting = found
    torques, PE = tau.copy(), float(potential_energy(mechanism, q))
    torques[list(joints)] += held_forces(acting, at.multipliers)
    if free_motions(mechanism, q).shape[1] - at.N.shape[1] < len(joints):
        remark = "held joints share their torques in many ways (least norm given)"
        warnings.warn(remark, RobodynWarning, stacklevel=3)
    return Rest(q, PE, torques, _stable(at, _size(mechanism, at, tau)))


def unstable(mechanism: Mechanism, q: Array, tau: Array) -> bool:
    """Return whether a small push leads away from the pose at rest q (n,) under tau (n,)."""
    try:
        at = balance(_acting(mechanism, (), q), q, tau)
    except RobodynError:  # a spring without a direction, a row beyond a table
        return False
    return _stable(at, _size(mechanism, at, tau)) is False


def _stable(at: Balance, size: float) -> bool | None:
    """By the definiteness of K; where it is not symmetric, or dampers drive, by eigenvalues."""
    N, K, load = at.N, at.stiffness, at.load
    D, M = N.T @ load.by_qd @ N, N.T @ load.by_qdd @ N
    drives = np.linalg.eigvalsh(D + D.T).min(initial=0.0) < -LEVEL * np.abs(D).max(initial=0.0)
    if not drives and np.abs(K - K.T).max(initial=0.0) <= LEVEL * size:
        least = float(np.linalg.eigvalsh(0.5 * (K + K.T)).min(initial=np.inf))
        return None if abs(least) <= LEVEL * size else least > 0.0
    if np.linalg.cond(M) * LEVEL > 1.0:
        return None
    A21, A22 = (np.asarray(-np.linalg.solve(M, x), float) for x in (K, D))
    return stable_by(eigenvalues(A21, A22)[0])
