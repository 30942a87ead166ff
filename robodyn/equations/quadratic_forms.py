"""Writes each quadratic form of the rates once, as a product if it is one.

4 m qd1 qd2 + 2 m qd2^2  ->  2 m qd2 (2 qd1 + qd2)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from math import gcd, isqrt, lcm

from robodyn.equations.symbolic import Atom, Monomial, Number, Role, Sum, collected

Linear = tuple[tuple[int, Fraction], ...]  # joints with their numbers, in order, none of them zero
Form = tuple[tuple[tuple[int, int], Fraction], ...]  # the same of pairs of joints j <= k


def forms_of(sum_: Sum) -> list[tuple[Form, Sum]]:
    """Return the quadratic forms in a sum of terms with two rates, and the factor of each.

    A form has whole numbers without a common divisor; the first is positive.
    """
    by_rest: dict[Monomial, dict[tuple[int, int], Fraction]] = {}
    for monomial, number in sum_.terms.items():
        rates = [atom for atom, power in monomial for _ in range(_times(atom, power))]
        rest = tuple(x for x in monomial if x[0].role != Role.rate)
        pairs = by_rest.setdefault(rest, {})
        one, two = (rate_of(atom.place) for atom in rates)
        for j, x in one.items():
            for k, y in two.items():
                pair = min(j, k), max(j, k)
                pairs[pair] = pairs.get(pair, Fraction(0)) + number * x * y
    found: dict[Form, list[tuple[Monomial, Number]]] = {}
    for rest, pairs in by_rest.items():
        kept = sorted((pair, x) for pair, x in pairs.items() if x)
        if kept:
            size = _content([x for _, x in kept])
            form = tuple((pair, x / size) for pair, x in kept)
            found.setdefault(form, []).append((rest, _whole(size)))
    return [(form, collected(terms)) for form, terms in found.items()]


def rate_of(place: Iterable[int]) -> dict[int, Fraction]:
    """Return the joints whose rates an atom adds, with -1 for subtracted ones."""
    return {max(k, ~k): Fraction(1 if k >= 0 else -1) for k in place}


def factored(form: Form) -> tuple[Linear, Linear, Fraction] | None:
    """Return two linear forms and a number whose product is the form; None if there are none."""
    values = dict(form)
    joints = sorted({k for pair in values for k in pair})

    def entry(j: int, k: int) -> Fraction:
        return values.get((min(j, k), max(j, k)), Fraction(0))

    for k in joints:  # f = b (q_k + c/b), b and c without q_k
        if not entry(k, k):
            b = {j: entry(j, k) for j in joints if j != k and entry(j, k)}
            c = {pair: x for pair, x in values.items() if k not in pair}
            if (other := _quotient(c, b)) is not None:
                return _normal(b, {**other, k: Fraction(1)})
            return None
    k, *others = joints  # f = a (q_k - r1) (q_k - r2), r = (-b +- e)/2a with e^2 = b^2 - 4 a c
    a, b = entry(k, k), {j: entry(j, k) for j in others}
    under = {
        (i, j): b[i] * b[j] * (1 if i == j else 2) - 4 * a * entry(i, j)
        for n, i in enumerate(others)
        for j in others[n:]
    }
    if (e := _root(under, others)) is None:
        return None
    one, two = (
        {k: Fraction(1), **{j: (b[j] + sign * e.get(j, 0)) / (2 * a) for j in others}}
        for sign in (-1, 1)
    )
    return _normal({j: a * x for j, x in one.items()}, two)


def difference_of_squares(
    form: Form, sums: Sequence[tuple[int, ...]]
) -> tuple[tuple[int, ...], tuple[int, ...], Fraction] | None:
    """Return two sums of rates whose squares differ by the form, and its factor.

    `sums` are candidates, each a tuple of joints; () is zero.
    """
    for one in sums:
        for two in ((), *sums):
            if len(two) < len(one):
                pairs = _squared(one)
                for pair, x in _squared(two).items():
                    pairs[pair] = pairs.get(pair, 0) - x
                kept = sorted((pair, x) for pair, x in pairs.items() if x)
                if len(kept) == len(form) and [x for x, _ in kept] == [x for x, _ in form]:
                    number = form[0][1] / kept[0][1]
                    if all(x == number * y for (_, x), (_, y) in zip(form, kept, strict=True)):
                        return one, two, number
    return None


def _times(atom: Atom, power: int) -> int:
    return power if atom.role == Role.rate else 0


def _squared(joints: Sequence[int]) -> dict[tuple[int, int], int]:
    return {(j, k): 1 if j == k else 2 for j in joints for k in joints if j <= k}


def _content(numbers: Sequence[Fraction]) -> Fraction:
    """Return the number whose division leaves whole numbers without a common divisor."""
    exact = [Fraction(x) for x in numbers]
    over = lcm(*(x.denominator for x in exact))
    size = Fraction(gcd(*(int(x * over) for x in exact)), over)
    return size if exact[0] > 0 else -size


def _whole(number: Fraction) -> Number:
    return int(number) if number == int(number) else number


def _normal(
    one: Mapping[int, Fraction], two: Mapping[int, Fraction]
) -> tuple[Linear, Linear, Fraction]:
    """Return two linear forms in whole numbers, the shorter one first, and their common factor."""
    size, found = Fraction(1), []
    for each in (one, two):
        kept = sorted((k, Fraction(x)) for k, x in each.items() if x)
        content = _content([x for _, x in kept])
        size *= content
        found.append(tuple((k, x / content) for k, x in kept))
    first, second = sorted(found, key=lambda x: (len(x), sum(abs(y) for _, y in x), x))
    return first, second, size


def _quotient(
    form: Mapping[tuple[int, int], Fraction], by: Mapping[int, Fraction]
) -> dict[int, Fraction] | None:
    """Return the linear form that times `by` is `form`; None if there is none."""
    left, found = {pair: x for pair, x in form.items() if x}, dict[int, Fraction]()
    lead = min(by)
    while left:
        pair = min((x for x in left if lead in x), default=None)
        if pair is None:
            return None
        other = pair[1] if pair[0] == lead else pair[0]
        found[other] = number = left[pair] / by[lead]
        for k, x in by.items():
            place = min(k, other), max(k, other)
            left[place] = left.get(place, Fraction(0)) - number * x
            if not left[place]:
                del left[place]
    return found


def _root(
    form: Mapping[tuple[int, int], Fraction], joints: Sequence[int]
) -> dict[int, Fraction] | None:
    """Return the linear form whose square is `form`; None if there is none."""
    kept = {pair: x for pair, x in form.items() if x}
    if not kept:
        return {}
    lead = next((k for k in joints if kept.get((k, k))), None)
    if lead is None or (size := _square_root(kept[lead, lead])) is None:
        return None
    root = {lead: size}
    for k in joints:
        if k != lead:
            x = kept.get((min(k, lead), max(k, lead)), Fraction(0)) / (2 * size)
            root |= {k: x} if x else {}
    square: dict[tuple[int, int], Fraction] = {}
    for j, x in root.items():
        for k, y in root.items():
            place = min(j, k), max(j, k)
            square[place] = square.get(place, Fraction(0)) + x * y
    return root if {pair: x for pair, x in square.items() if x} == kept else None


def _square_root(x: Fraction) -> Fraction | None:
    if x < 0:
        return None
    above, below = isqrt(x.numerator), isqrt(x.denominator)
    exact = above * above == x.numerator and below * below == x.denominator
    return Fraction(above, below) if exact else None
