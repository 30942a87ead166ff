"""Products of sines and cosines in sums, written with the differences of their angles.

    cos(q1) cos(q1 + q2) + sin(q1) sin(q1 + q2)  ->  cos(q2)      cos(q1)^2 + sin(q1)^2  ->  1

Where links slide the rows measure in the ground's frame, and leave such sums; so do the cosines
of a direction, of which u2x^2 + u2y^2 is 1.  A joint k that an angle takes off is ~k in its place.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from robodyn.equations.symbolic import Atom, Monomial, Number, Role, Sum, merged

Powers = tuple[tuple[Atom, int], ...]


class Identity(NamedTuple):
    """`product`, and `sign` times `other`, are together `turned` times `both`."""

    product: Powers
    other: Powers
    sign: int
    both: Powers
    turned: int = 1


def simplified(sum_: Sum) -> Sum:
    """The sum with what the identities make of pairs of its terms."""
    terms: dict[Monomial, Number] = dict(sum_.terms)
    changed = True
    while changed:
        changed = False
        for term in list(terms):
            changed |= _paired(terms, term)
    return Sum({term: number for term, number in terms.items() if number})


def _paired(terms: dict[Monomial, Number], term: Monomial) -> bool:
    """Put what an identity makes of a term and its partner in their place; whether there is one."""
    for identity in _identities(term):
        rest = merged(term, tuple((atom, -power) for atom, power in identity.product))
        other = merged(rest, identity.other)
        number, partner = terms[term], terms.get(other, 0) * identity.sign
        if number * partner > 0:
            shared = max(number, partner) if number < 0 else min(number, partner)
            both = merged(rest, identity.both)
            terms[term] -= shared
            terms[other] -= shared * identity.sign
            terms[both] = terms.get(both, 0) + shared * identity.turned
            return True
    return False


def _identities(term: Monomial) -> Iterator[Identity]:
    """What may be made of this product and another one."""
    calls = [atom for atom, _ in term if atom.role == Role.function and atom.speed is None]
    sines = [x for x in calls if x.name == "sin"]
    for atom, power in term:
        if power < 2:
            continue
        if atom in sines:
            yield Identity(((atom, 2),), ((_other(atom), 2),), 1, ())
        elif atom.role == Role.direction and atom.place[1][-1] == "y":
            along = atom.place[0], atom.place[1][:-1] + "x"
            other = atom._replace(place=along, name=atom.name[:-1] + "x")
            yield Identity(((atom, 2),), ((other, 2),), 1, ())
    for one in sines:
        for two in calls:
            if (difference := _difference(one.place, two.place)) is None:
                continue
            place, sign = difference
            others = (_other(one), 1), (_other(two), 1)
            if two.name == "cos":
                sine = Atom(Role.function, place, "sin")
                yield Identity(((one, 1), (two, 1)), others, -1, ((sine, 1),), sign)
            elif one < two:
                cosine = Atom(Role.function, place, "cos")
                yield Identity(((one, 1), (two, 1)), others, 1, ((cosine, 1),))


def _other(atom: Atom) -> Atom:
    return atom._replace(name="cos" if atom.name == "sin" else "sin")


def _difference(one: tuple[int, ...], two: tuple[int, ...]) -> tuple[tuple[int, ...], int] | None:
    """The place of an angle less another, and the sign of that; its first joint is added.

    None where they are the same, or a joint would count twice.
    """
    counts: dict[int, int] = {}
    for joints, sign in ((one, 1), (two, -1)):
        for k in joints:
            joint = max(k, ~k)
            counts[joint] = counts.get(joint, 0) + (sign if k >= 0 else -sign)
    kept = sorted((joint, count) for joint, count in counts.items() if count)
    if not kept or any(abs(count) > 1 for _, count in kept):
        return None
    sign = kept[0][1]
    added = [joint for joint, count in kept if count == sign]
    taken = [~joint for joint, count in kept if count != sign]
    return (*added, *taken), sign
