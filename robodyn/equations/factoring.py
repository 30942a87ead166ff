"""Writes sums of products as a person would: common factors in front of brackets.

    m2 l1^2 + m2 r2^2 + 2 m2 l1 r2 cos(q2)  ->  m2 (l1^2 + r2^2 + 2 l1 r2 cos(q2))

Terms are collected level by level (by mass, by angle, ...), then by the symbol that most of them
share.  A factor is taken out of a bracket only if it has the same power in all terms, so squares
stay whole, as above.  Before that, products of sines and cosines are replaced by functions of angle
differences:

    cos(q1) cos(q1 + q2) + sin(q1) sin(q1 + q2)  ->  cos(q2)      cos(q1)^2 + sin(q1)^2  ->  1

Such sums arise where links slide, because rows then measure in the ground's frame.  The cosines of
a direction have u2x^2 + u2y^2 = 1.  A joint k whose angle is subtracted appears as ~k in a place.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from math import gcd

from robodyn.equations.symbolic import Atom, Monomial, Number, Role, Sum, collected, merged

Term = tuple[Monomial, Number]
Key = Callable[[Monomial], Hashable]
Powers = tuple[tuple[Atom, int], ...]


def by_role(*roles: int) -> Key:
    """Return a key that collects terms by the atoms of these roles."""
    return lambda factors: tuple(
        factor for factor in factors if isinstance(factor[0], Atom) and factor[0].role in roles
    )


def as_one(factors: Monomial) -> Hashable:
    """Return a key that collects all terms by what they have in common."""
    return ()


def by_angle(factors: Monomial) -> Hashable:
    """Return a key that collects terms by the angles of sines and cosines."""
    return tuple(x.place for x, _ in by_function(factors) if x.speed is None)  # type: ignore[attr-defined]


by_function = by_role(Role.function)


def written(sum_: Sum, levels: Sequence[Key]) -> Sum:
    """Return a sum with its terms collected by each of the levels in turn."""
    return Sum(dict(_collected(list(sum_.terms.items()), levels)))


def _collected(terms: list[Term], levels: Sequence[Key]) -> list[Term]:
    if len(terms) < 2:
        return terms
    if not levels:
        return _by_most_common(terms)
    groups: dict[Hashable, list[Term]] = {}
    for term in terms:
        groups.setdefault(levels[0](term[0]), []).append(term)
    return [
        term
        for group in groups.values()
        for term in _bracketed(group, lambda rest: _collected(rest, levels[1:]))
    ]


def _by_most_common(terms: list[Term]) -> list[Term]:
    """Collect terms by the symbol that most of them share, until none is shared."""
    groups: list[tuple[int, list[Term]]] = []  # each with the place of its first term
    left = list(enumerate(terms))
    while (shared := _most_common([term for _, term in left])) is not None:
        holding = [item for item in left if any(x == shared for x, _ in item[1][0])]
        places = {place for place, _ in holding}
        left = [item for item in left if item[0] not in places]
        groups.append((min(places), _bracketed([term for _, term in holding], _by_most_common)))
    groups += [(place, [term]) for place, term in left]
    return [term for _, group in sorted(groups, key=lambda item: item[0]) for term in group]


def _most_common(terms: list[Term]) -> Atom | Sum | None:
    """Return the factor that most terms (at least two) share, without squares; or None."""
    counts: dict[Atom | Sum, int] = {}
    for factors, _ in terms:
        for factor, power in factors:
            counts[factor] = counts.get(factor, 0) + (1 if power == 1 else -len(terms))
    shared = [factor for factor, count in counts.items() if count > 1]
    return max(shared, key=lambda factor: (counts[factor], _rank(factor)), default=None)


def _bracketed(group: list[Term], collect: Callable[[list[Term]], list[Term]]) -> list[Term]:
    """Return the group as its common factor times a bracket, or as it is if there is none."""
    if len(group) < 2:
        return group
    number, common = _common(group)
    rest = collect([_divided(term, number, common) for term in group])
    if len(rest) > 1:  # what was collected may have brackets in common
        more_number, more = _common(rest)
        if more:
            rest = [_divided(term, more_number, more) for term in rest]
            number, common = number * more_number, common + more
    if not common and number == 1:
        return rest
    if len(rest) == 1:
        return [(in_writing_order(common + rest[0][0]), number * rest[0][1])]
    if rest[0][1] < 0:
        number, rest = -number, [(factors, -x) for factors, x in rest]
    return [(in_writing_order((*common, (Sum(dict(rest)), 1))), number)]


def _common(group: list[Term]) -> tuple[Number, Monomial]:
    """Return the whole number and the factors that all terms of a group share."""
    (first, _), *others = group
    common = tuple(x for x in first if all(x in factors for factors, _ in others))
    whole = [number for _, number in group if isinstance(number, int)]
    return (gcd(*whole) if len(whole) == len(group) else 1), common


def _divided(term: Term, number: Number, common: Monomial) -> Term:
    left = tuple(factor for factor in term[0] if factor not in common)
    return left, term[1] // number if isinstance(term[1], int) else term[1]


def in_writing_order(factors: Monomial) -> Monomial:
    """Return the factors of a product in the order of writing."""
    return tuple(sorted(factors, key=lambda factor: _rank(factor[0])))


def _rank(factor: Atom | Sum) -> tuple[object, ...]:
    """Return a sort key: masses, other parameters, brackets, rates, sines, brackets with sines."""
    if isinstance(factor, Atom):
        return factor
    roles = {atom.role for atom in factor.atoms()}
    if roles == {Role.mass}:
        return (Role.mass + 0.5,)
    return (max(Role.length, *roles) + 0.5,)


def simplified(sum_: Sum) -> Sum:
    """Return a sum in which trigonometric identities have merged pairs of terms."""
    terms: dict[Monomial, Number] = dict(sum_.terms)
    changed = True
    while changed:
        changed = False
        for term in list(terms):
            changed |= _paired(terms, term)
    return Sum({term: number for term, number in terms.items() if number})


def by_cosines(sum_: Sum) -> Sum:
    """Replace squares of sines of axes, uy^2 = 1 - ux^2, so that equal sums look the same."""
    while True:
        found: list[Term] = []
        for term, number in sum_.terms.items():
            square = next((x for x, power in term if _is_sine(x) and power > 1), None)
            if square is None:
                found.append((term, number))
                continue
            rest, other = merged(term, ((square, -2),)), _beside(square)
            found += [(rest, number), (merged(rest, ((other, 2),)), -number)]
        if (next_ := collected(found)) == sum_:
            return sum_
        sum_ = next_


def _is_sine(atom: Atom) -> bool:
    """Return whether an atom is the sine of a joint's axis."""
    return bool(atom.role == Role.direction and atom.place[1][-1] == "y")


def _beside(sine: Atom) -> Atom:
    """Return the cosine of the same axis."""
    along = sine.place[0], sine.place[1][:-1] + "x"
    return sine._replace(place=along, name=sine.name[:-1] + "x")


def _paired(terms: dict[Monomial, Number], term: Monomial) -> bool:
    """Merge a term with its partner by an identity; return whether there was one."""
    for to_other, sign, to_both, turned in _identities(term):
        other, both = merged(term, to_other), merged(term, to_both)
        number, partner = terms[term], terms.get(other, 0) * sign
        if number * partner > 0:
            shared = max(number, partner) if number < 0 else min(number, partner)
            terms[term] -= shared
            terms[other] -= shared * sign
            terms[both] = terms.get(both, 0) + shared * turned
            return True
    return False


def _identities(term: Monomial) -> Iterator[tuple[Powers, int, Powers, int]]:
    """Yield (partner, sign, merged term, its sign) for identities that involve a term.

    Partner and merged term are given as factors by which the term is multiplied.
    """
    calls = [atom for atom, _ in term if atom.role == Role.function and atom.speed is None]
    sines = [x for x in calls if x.name == "sin"]
    for atom, power in term:
        square, other = (atom, -2), None
        if atom in sines:
            other = _other(atom)
        elif _is_sine(atom):
            other = _beside(atom)
        if other is not None and power > 1:
            yield (square, (other, 2)), 1, (square,), 1
    for one in sines:
        for two in calls:
            if (difference := difference_of(one.place, two.place)) is None:
                continue
            place, sign = difference
            pair = (one, -1), (two, -1)
            others = *pair, (_other(one), 1), (_other(two), 1)
            if two.name == "cos":
                yield others, -1, (*pair, (Atom(Role.function, place, "sin"), 1)), sign
            elif one < two:
                yield others, 1, (*pair, (Atom(Role.function, place, "cos"), 1)), 1


def _other(atom: Atom) -> Atom:
    return atom._replace(name="cos" if atom.name == "sin" else "sin")


def difference_of(one: tuple[int, ...], two: tuple[int, ...]) -> tuple[tuple[int, ...], int] | None:
    """Return the place of one angle less another, and its sign; its first joint is added.

    None if the angles are equal, or if a joint would count twice.
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
