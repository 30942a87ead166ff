"""Sums of products written as a person would write them: common factors in front of brackets.

    m2 l1^2 + m2 r2^2 + 2 m2 l1 r2 cos(q2)  ->  m2 (l1^2 + r2^2 + 2 l1 r2 cos(q2))

Terms are collected level by level (by mass, by angle, ...), then by the symbol that most of them
share.  A factor leaves a bracket only with the same power from each of its terms, so that squares
stay whole, as above.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from math import gcd
from typing import Union

from robodyn.equations.symbolic import Atom, Number, Role, Sum

Factor = Union[Atom, "Written"]
Key = Callable[["Product"], Hashable]


@dataclass(frozen=True, slots=True)
class Product:
    """A number times powers of atoms and of sums in brackets; of these 1/2 is the square root."""

    number: Number
    factors: tuple[tuple[Factor, float], ...]


@dataclass(frozen=True, slots=True)
class Written:
    """A sum as it is to be written; no terms: zero."""

    terms: tuple[Product, ...]

    def __bool__(self) -> bool:
        return bool(self.terms)

    def atoms(self) -> Iterator[Atom]:
        """Every atom, those in brackets too."""
        for product in self.terms:
            for factor, _ in product.factors:
                if isinstance(factor, Written):
                    yield from factor.atoms()
                else:
                    yield factor


def by_role(*roles: int) -> Key:
    """Collect by the atoms of these roles."""
    return lambda product: tuple(
        factor
        for factor in product.factors
        if not isinstance(factor[0], Written) and factor[0].role in roles
    )


def as_one(product: Product) -> Hashable:
    """Collect all terms, for what they have in common."""
    return ()


def by_angle(product: Product) -> Hashable:
    """Collect by the angle of sines and cosines."""
    return tuple(
        factor.place
        for factor, _ in product.factors
        if isinstance(factor, Atom) and factor.role == Role.function and factor.speed is None
    )


by_function = by_role(Role.function)


def written(sum_: Sum, levels: Sequence[Key]) -> Written:
    """The sum, its terms collected by each of the levels in turn."""
    return Written(
        tuple(_collected([Product(x, monomial) for monomial, x in sum_.terms.items()], levels))
    )


def _collected(terms: list[Product], levels: Sequence[Key]) -> list[Product]:
    if len(terms) < 2:
        return terms
    if not levels:
        return _by_most_common(terms)
    groups: dict[Hashable, list[Product]] = {}
    for product in terms:
        groups.setdefault(levels[0](product), []).append(product)
    return [
        product
        for group in groups.values()
        for product in _bracketed(group, lambda rest: _collected(rest, levels[1:]))
    ]


def _by_most_common(terms: list[Product]) -> list[Product]:
    """Collect by the symbol that most terms share, until none is shared."""
    groups: list[tuple[int, list[Product]]] = []  # each with the place of its first term
    left = list(enumerate(terms))
    while (shared := _most_common([product for _, product in left])) is not None:
        holding = [item for item in left if _holds(item[1], shared)]
        left = [item for item in left if not _holds(item[1], shared)]
        group = _bracketed([product for _, product in holding], _by_most_common)
        groups.append((holding[0][0], group))
    groups += [(place, [product]) for place, product in left]
    return [product for _, group in sorted(groups, key=lambda item: item[0]) for product in group]


def _most_common(terms: list[Product]) -> Factor | None:
    """The factor that most of the terms hold, at least two; none that is squared anywhere."""
    counts: dict[Factor, int] = {}
    for product in terms:
        for factor, power in product.factors:
            counts[factor] = counts.get(factor, 0) + (1 if power == 1 else -len(terms))
    shared = [factor for factor, count in counts.items() if count > 1]
    return max(shared, key=lambda factor: (counts[factor], _rank(factor)), default=None)


def _holds(product: Product, factor: Factor) -> bool:
    return any(found == factor for found, _ in product.factors)


def _bracketed(
    group: list[Product], collect: Callable[[list[Product]], list[Product]]
) -> list[Product]:
    """The group as its common factor times a bracket, or as it is where there is none."""
    if len(group) < 2:
        return group
    number, common = _common(group)
    rest = collect([_divided(product, number, common) for product in group])
    if len(rest) > 1:  # what was collected may have brackets in common
        more_number, more = _common(rest)
        if more:
            rest = [_divided(product, more_number, more) for product in rest]
            number, common = number * more_number, common + more
    if not common and number == 1:
        return rest
    if len(rest) == 1:
        return [_product(number * rest[0].number, common + rest[0].factors)]
    if rest[0].number < 0:
        number, rest = -number, [Product(-x.number, x.factors) for x in rest]
    return [_product(number, (*common, (Written(tuple(rest)), 1)))]


def _common(group: list[Product]) -> tuple[Number, tuple[tuple[Factor, float], ...]]:
    """The whole number and the factors that all products of the group share."""
    first, *others = group
    common = tuple(
        factor for factor in first.factors if all(factor in product.factors for product in others)
    )
    number = 1
    if all(isinstance(product.number, int) for product in group):
        number = gcd(*(int(product.number) for product in group))
    return number, common


def _divided(product: Product, number: Number, common: tuple[tuple[Factor, float], ...]) -> Product:
    left = tuple(factor for factor in product.factors if factor not in common)
    quotient = product.number // number if isinstance(product.number, int) else product.number
    return Product(quotient, left)


def _product(number: Number, factors: tuple[tuple[Factor, float], ...]) -> Product:
    """The product with its factors in the order of writing."""
    return Product(number, tuple(sorted(factors, key=lambda factor: _rank(factor[0]))))


def _rank(factor: Factor) -> tuple[object, ...]:
    """Masses, other parameters, brackets of parameters, rates, sines and what holds them."""
    if not isinstance(factor, Written):
        return factor
    roles = {atom.role for atom in factor.atoms()}
    if roles == {Role.mass}:
        return (Role.mass + 0.5,)
    return (max(Role.length, *roles) + 0.5,)
