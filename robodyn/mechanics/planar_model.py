"""The numeric model of a planar mechanism.

`mechanism.py` builds it from a description, and has the formulas of its constants.  Nothing here
imports numpy before `Mechanism.arrays` is read, so a command that evaluates one state in plain
floats starts fast.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from robodyn.elements.base import Element, whole
from robodyn.elements.base import conserves as conserves
from robodyn.elements.contacts import STICKS, Mode
from robodyn.elements.joints import DryFriction, Range, Rotor
from robodyn.elements.link_rows import PlanarPoint as PlanarPoint
from robodyn.elements.pin_friction import PinFriction
from robodyn.elements.springs import JointDamper
from robodyn.errors import InputError, MassError, printable
from robodyn.mechanics.model_parts import ClosureRow as ClosureRow
from robodyn.mechanics.model_parts import Inertias as Inertias
from robodyn.mechanics.model_parts import OnDemand as OnDemand
from robodyn.mechanics.model_parts import Terms as Terms
from robodyn.scene.scene import Description, Signal, Table
from robodyn.scene.welds import Welded

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from robodyn.mechanics.link_tree import Tree
    from robodyn.mechanics.standing import Holds


Kind = TypeVar("Kind", bound=Element)


class Spin(NamedTuple):
    """Something that spins beside the links, such as a rotor; it adds inertia r r^T to M."""

    inertia: float  # kg m^2
    carrier: int | None  # the link on which it sits; None: the ground
    rates: Mapping[int, float]  # r in joints: its rate is the sum of coefficients times qd
    terms: Sequence[tuple[int, float]]  # r in x


@dataclass(frozen=True, eq=False, repr=False)
class Mechanism:
    """A planar mechanism as numbers; immutable, compared by identity.

    q_i is the angle (rad) of link i relative to the link it hangs from, or to +X; for a sliding
    joint, the displacement (m) of its origin along the axis.  Coordinates x = J q are the angles
    alpha_k of directions E_k = exp(i alpha_k), and displacements s_k.  A link that slides has the
    direction of the link it slides on, `frames`: X_k = s_k E_frame there, else X_k = E_k.  Every
    point is linear in X.
    """

    name: str
    source: str
    description: Description
    link_names: tuple[str, ...]
    parent: tuple[int | None, ...]
    order: tuple[int, ...]  # the links, each after the one it hangs from
    A: Sequence[tuple[int, int, complex]]  # (j, k, A_jk) with j above k or j = k, kg m^2
    B: tuple[complex, ...]  # kg m
    gamma: complex  # gravity as gx + i gy, m/s^2
    energy_offset: float  # potential energy of the constants, J
    rows: tuple[ClosureRow, ...]
    actuated: tuple[int, ...]
    pivots: Sequence[PlanarPoint]  # each link's own joint
    tips: Sequence[PlanarPoint]
    centres: Sequence[PlanarPoint]  # centres of gravity, payload not included
    weights: tuple[complex, ...]  # of gravity and constant forces, N m
    moments: tuple[float, ...]  # constant torques on links, N m
    elements: Sequence[Element] = ()  # all that acts but weights and constant moments
    added: tuple[Element, ...] = ()  # those that the description does not have, in no mode
    ranges: tuple[Range, ...] = ()  # from where to where joints go, of those that have ends
    mode: Mode | None = None  # whose equations its own are; None: it has none, or may change it
    slides: tuple[int, ...] = ()  # the joints that are prismatic
    frames: tuple[int | None, ...] = ()  # of each link whose E it has; None: the ground's, 1
    unit: float = 1.0  # length that displacements are compared with angles by, m
    numeric: Mechanism | None = None  # of one with formulas for numbers: that with the numbers
    tree: Tree = field(kw_only=True)  # the links as the scene has them

    def to_dict(self) -> dict[str, object]:
        """Return the scene as a mapping for `robodyn.load`: SI units, radians, link names."""
        from robodyn.scene.plain_scene import plain_scene

        return plain_scene(self.description)

    def of(self, kind: type[Kind]) -> tuple[Kind, ...]:
        """Return the elements of a kind, in order."""
        return tuple(x for x in self.elements if isinstance(x, kind))

    def name_of(self, element: Element) -> str:
        """Return the name of an element: its kind and number, from 1."""
        alike = (x for x in self.elements if x.word == element.word)
        return f"{element.word} {next(k for k, x in enumerate(alike, start=1) if x is element)}"

    def with_added(self, *elements: Element) -> Mechanism:
        """Return the mechanism with further elements and those that stand for them."""
        more = tuple(whole(elements))
        return replace(self, elements=(*self.elements, *more), added=(*self.added, *more))

    @cached_property
    def damping(self) -> tuple[float, ...]:
        """The damping at each joint (n), N m s/rad, or N s/m."""
        found: list[float | None] = [None] * self.n
        for x in self.of(JointDamper):
            before = found[x.joint]
            found[x.joint] = x.damping if before is None else before + x.damping
        return tuple(0.0 if x is None else x for x in found)

    @cached_property
    def dry(self) -> dict[int, DryFriction]:
        """Dry friction by joint: see `modes.py`."""
        return {x.joint: x for x in self.of(DryFriction)}

    @cached_property
    def rubbing(self) -> tuple[PinFriction, ...]:
        """Friction by the forces in pins and slides: see `dynamics/friction_rounds.py`."""
        return self.of(PinFriction)

    def rubbing_place(self, friction: PinFriction) -> str:
        """Return the place of such friction in the scene."""
        joint = friction.joint
        if joint is None:
            return f"closures[{friction.closure}].friction"
        scene = self.description.apart or self.description
        name = self.link_names[joint]
        place = next((i for i, x in enumerate(scene.listed) if x.name == name), joint)
        return f"links[{place}] ({name}).friction"

    def check_rubbing(self, what: str) -> None:
        """Raise InputError if there is friction by pin forces, which `what` lack."""
        for friction in self.rubbing:
            limit = f"is of the force in a pin or slide, and {what} have no such friction; torque, "
            limit += "accel, reactions, energy and simulate by DOP853, RK45 or Radau do"
            value = f"{friction.coefficient:g}"
            place = f"{self.rubbing_place(friction)}.coefficient"
            raise InputError(place, where=self.source, value=value, limit=limit)

    @cached_property
    def sticks(self) -> tuple[int, ...]:
        """The joints that dry friction can hold at rest."""
        return tuple(x.at for x in self.elements if x.contact == STICKS and x.at is not None)

    @cached_property
    def steady_moments(self) -> tuple[tuple[int, float], ...]:
        """The constant torques of the scene, (link, N m)."""
        each = (x.steady_moment for _, x in self.description.elements)
        return tuple(x for x in each if x is not None)

    @cached_property
    def contacts(self) -> frozenset[str]:
        """Which of STICKS, HARD and COMPLIANT occur (`elements/contacts.py`)."""
        return frozenset(x.contact for x in self.elements if x.contact)

    @cached_property
    def parted(self) -> tuple[tuple[int, PlanarPoint], ...]:
        """Elements whose ends must not coincide: index, and the vector between the ends."""
        each = ((place, x.parted(self.tree)) for place, x in enumerate(self.elements))
        return tuple((place, between) for place, between in each if between is not None)

    @cached_property
    def stores(self) -> bool:
        """Whether elements have a potential."""
        return any(x.stored() is not None for x in self.elements)

    @cached_property
    def bells(self) -> tuple[tuple[int, float, float], ...]:
        """Joints with friction that peaks at low rates: joint, width and reach (`Element.bell`)."""
        each = ((x.at, x.bell) for x in self.elements)
        return tuple((k, *bell) for k, bell in each if k is not None and bell is not None)

    @cached_property
    def spins(self) -> tuple[Spin, ...]:
        """Rotors and other parts that spin beside the links."""
        found = []
        for x in self.of(Rotor):
            carried = [] if x.carrier is None else self.turns_by(x.carrier)
            rates = dict.fromkeys(carried, 1.0) | {x.joint: x.ratio}
            found.append(Spin(x.inertia, self.parent[x.joint], rates, x.spin))
        return tuple(found)

    @cached_property
    def above(self) -> tuple[int | None, ...]:
        """The coordinate to which each joint's own is added: x_k = q_k + x_above; or None."""
        slides = set(self.slides)
        return tuple(
            None if j is None or k in slides else self.frames[j] for k, j in enumerate(self.parent)
        )

    @cached_property
    def n(self) -> int:
        """Number of links, which is the number of joints and of coordinates."""
        return len(self.parent)

    @cached_property
    def passive(self) -> tuple[int, ...]:
        """The joints without a torque of their own."""
        actuated = set(self.actuated)
        return tuple(i for i in range(self.n) if i not in actuated)

    def path(self, link: int | None) -> list[int]:
        """Return the links from the ground to `link`, included; [] for the ground."""
        path: list[int] = []
        while link is not None:
            path.append(link)
            link = self.parent[link]
        return path[::-1]

    @cached_property
    def lines(self) -> tuple[tuple[int, int], ...]:
        """The rows whose lines are carried by links, with the link of their E."""
        return tuple((r, row.line) for r, row in enumerate(self.rows) if row.line is not None)

    @cached_property
    def held(self) -> tuple[int, ...]:
        """The rows of held joints."""
        return tuple(r for r, row in enumerate(self.rows) if row.held)

    @cached_property
    def first_coupling(self) -> int:
        """The row of the first coupling; rows of closures come before, held ones after."""
        return len(self.rows) - len(self.held) - len(self.description.couplings)

    @cached_property
    def laws(self) -> tuple[int, ...]:
        """The rows of couplings with a law."""
        return tuple(r for r, row in enumerate(self.rows) if row.law is not None)

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """The rows of couplings whose law depends on time."""
        laws = ((r, self.rows[r].law) for r in self.laws)
        return tuple(r for r, law in laws if law is not None and "t" in law.names)

    @cached_property
    def has_angles(self) -> bool:
        """Whether rows have terms linear in x."""
        return any(row.angles for row in self.rows)

    def turns_by(self, link: int) -> list[int]:
        """Return the joints whose angles add up to that of a link's frame."""
        found, k = [], self.frames[link]
        while k is not None:
            found.append(k)
            k = self.above[k]
        return found[::-1]

    @cached_property
    def inertias(self) -> dict[int, float]:
        """Diagonal inertia of each coordinate, rotors included (kg m^2, or kg if it slides).

        Zero entries are omitted.
        """
        found = {j: float(value.real) for j, k, value in self.A if j == k}
        for spin in self.spins:
            for k, c in spin.terms:
                found[k] = found.get(k, 0.0) + spin.inertia * c * c
        return {k: value for k, value in found.items() if value > 0.0}

    @cached_property
    def has_state_forces(self) -> bool:
        """Whether forces other than gravity, constant loads and joint dampers act."""
        return any(x.acts and not x.steady for x in self.elements)

    @cached_property
    def changes_energy(self) -> bool:
        """Whether the scene itself changes the energy: dampers, friction, turning loads."""
        return any(x.changes_energy for x in self.elements)

    @cached_property
    def switches(self) -> bool:
        """Whether its equations of motion change during a run: dry friction, stops, limits."""
        return bool(self.contacts or self.ranges)

    @cached_property
    def signals(self) -> tuple[Signal, ...]:
        """All laws, expressions and tables of springs and loads."""
        return tuple(signal for x in self.elements for signal in x.signals)

    @cached_property
    def has_tables(self) -> bool:
        """Whether any signal is a table, whose rows a series step must not pass."""
        return any(isinstance(signal, Table) for signal in self.signals)

    @property
    def rated(self) -> bool:
        """Whether laws or loads depend on rates."""
        return any(name.startswith(("v", "qd")) for x in self.signals for name in x.names)

    @cached_property
    def timed(self) -> bool:
        """Whether forces, or laws of couplings, depend on time."""
        return bool(self.driven) or any("t" in signal.names for signal in self.signals)

    @cached_property
    def arrays(self) -> Arrays:
        """The constants as dense numpy arrays; numpy is imported here."""
        return _arrays(self)

    @cached_property
    def massless(self) -> tuple[int, ...]:
        """The links for which the scene gives no m, r and I."""
        links = self.description.links if isinstance(self.A, Inertias) else ()
        return tuple(k for k, link in enumerate(links) if not link.has_mass)

    @cached_property
    def still(self) -> dict[int, Holds]:
        """The links that never move, each with what holds it."""
        from robodyn.mechanics.standing import standing  # numpy

        return self.numeric.still if self.numeric else standing(self)

    @cached_property
    def unknown_holds(self) -> Holds:
        """The couplings and closures that carry the weight of links without a mass."""
        from robodyn.mechanics.standing import Holds, unknown_holds  # numpy

        if not self.massless:
            return Holds()
        return unknown_holds(self.description, self.massless, self.still)

    def check_masses(self, still: bool = False) -> None:
        """Raise MassError if a link that needs a mass has none.

        The mass of a link that never moves is needed only with `still`.
        """
        lacking = {k for k in self.massless if still or k not in self.still}
        if lacking:
            scene = self.description.apart or self.description
            welded = Welded(scene)
            own = {x.name: welded.link(k) for k, x in enumerate(scene.bodies)}
            each = enumerate(scene.listed)
            lacks = ((i, x.name) for i, x in each if not x.has_mass and own[x.name] in lacking)
            place, name = next(lacks)
            raise MassError(f"links[{place}] ({name})", where=self.source)

    def __repr__(self) -> str:
        from robodyn.tables.short_repr import named

        parts = [f"{self.n} link{'s' * (self.n > 1)} ({named(self.link_names)})"]
        if closures := len(self.description.closures):
            parts.append(f"{closures} closure{'s' * (closures > 1)}")
        if self.actuated != tuple(range(self.n)):
            driven = named(self.link_names[k] for k in self.actuated) or "no joint"
            parts.append(f"actuated: {driven}")
        return f"<Mechanism {printable(self.name)}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        from robodyn.notebook.inline import mechanism_html

        return mechanism_html(self)

    def __getstate__(self) -> dict[str, object]:
        made = self.__dict__.keys() - self.__dataclass_fields__.keys()  # on demand, and again
        return {key: value for key, value in self.__dict__.items() if key not in made}


class Arrays(NamedTuple):
    """The constants of a mechanism as read-only dense arrays; n links, r closure rows."""

    A: NDArray[np.complex128]  # (n, n) Hermitian, kg m^2
    B: NDArray[np.complex128]  # (n,) kg m
    J: NDArray[np.float64]  # (n, n), x = J q
    P: NDArray[np.complex128]  # (r, n), gap = Re(conj(E_line) P X) + angles x + offset
    angles: NDArray[np.float64]  # (r, n) m
    units: NDArray[np.float64]  # (n,) 1, or the length that displacements are compared by, m
    offset: NDArray[np.float64]  # (r,) m
    ground: NDArray[np.complex128]  # (r,) m, what is added to P X in the frame of a line
    damping: NDArray[np.float64]  # (n,) N m s/rad
    weights: NDArray[np.complex128]  # (n,) N m
    moments: NDArray[np.float64]  # (n,) N m
    rotors: NDArray[np.float64]  # (m,) inertias of m rotors, kg m^2
    spins: NDArray[np.float64]  # (m, n), their rates are spins @ qd


def _arrays(mechanism: Mechanism) -> Arrays:
    import numpy as np

    n, r = mechanism.n, len(mechanism.rows)
    if isinstance(mechanism.A, Inertias):
        A = mechanism.A.dense()
    else:
        A = np.zeros((n, n), complex)
        for j, k, value in mechanism.A:
            A[j, k] = value
            A[k, j] = value.conjugate()
    J = np.eye(n)
    for k in mechanism.order:
        above = mechanism.above[k]
        if above is not None:
            J[k] += J[above]
    units = np.ones(n)
    units[list(mechanism.slides)] = mechanism.unit
    P = np.zeros((r, n), complex)
    angles = np.zeros((r, n))
    for row, entry in enumerate(mechanism.rows):
        for k, coefficient in entry.P:
            P[row, k] = coefficient
        for k, turn in entry.angles:
            angles[row, k] = turn
    spins = np.zeros((len(mechanism.spins), n))
    for i, spin in enumerate(mechanism.spins):
        for k, c in spin.rates.items():
            spins[i, k] = c
    arrays = Arrays(
        A=A,
        B=np.array(mechanism.B, complex),
        J=J,
        P=P,
        angles=angles,
        units=units,
        offset=np.array([row.offset for row in mechanism.rows], float),
        ground=np.array([row.ground for row in mechanism.rows], complex),
        damping=np.array(mechanism.damping, float),
        weights=np.array(mechanism.weights, complex),
        moments=np.array(mechanism.moments, float),
        rotors=np.array([spin.inertia for spin in mechanism.spins], float),
        spins=spins,
    )
    for array in arrays:
        array.flags.writeable = False
    return arrays


def joint_index(mechanism: Mechanism) -> Mapping[str, int]:
    """Return the joint (from 0) of each link name."""
    return {name: k for k, name in enumerate(mechanism.link_names)}
