"""What kind of loop each closure makes: Grashof's classes of four-bars, slider-cranks, others."""

from __future__ import annotations

from robodyn.mechanics.mechanism import Mechanism

EQUAL = 1e-12  # lengths that differ by less than this part count as equal


def loop_class(mechanism: Mechanism, closure: int) -> str:
    """The class of a closure's loop: `crank-rocker (Grashof)`, `slider-crank ...`, `6-link loop`.

    A four-bar's class is told for the joints of its links as they stand in the scene: the links
    that hang from the ground are its cranks or rockers.
    """
    row = next(row for row in mechanism.rows if row.closure == closure)
    sliding = [k for k, _ in (*row.P, *row.angles) if k in mechanism.slides]
    if sliding or row.line is not None:
        turning = {k for k, _ in row.P if k not in mechanism.slides} | ({row.line} - {None})
        joints = f"{len(turning)} turning" + f" and {len(sliding)} sliding" * bool(sliding)
        return f"{'loop with a slot' if row.line is not None else 'loop'} of {joints} links"
    offset = _ground_length(mechanism, closure)
    links = [k for k, _ in row.P]
    lengths = [abs(p) for _, p in row.P]
    if mechanism.description.closures[closure].along is not None:
        if len(links) != 2:
            return f"slider loop of {len(links)} links"
        crank, rod = lengths
        turns = crank + abs(row.offset) <= rod * (1 + EQUAL)
        return "slider-crank, crank " + ("turns fully" if turns else "rocks")
    if len(links) != 3 or offset == 0.0:
        return f"{len(links) + (offset > 0.0)}-link loop"
    sides = mechanism.description.closures[closure]
    pinned = (
        {sides.first.link, sides.second.link}
        if None in (sides.first.link, sides.second.link)
        else set()
    )
    grounded = [mechanism.parent[k] is None or k in pinned for k in links]
    if grounded.count(True) != 2:
        return "4-link loop"
    return _four_bar(lengths, grounded, offset)


def _four_bar(lengths: list[float], grounded: list[bool], ground: float) -> str:
    shortest, *middle, longest = sorted([*lengths, ground])
    difference = shortest + longest - sum(middle)
    if abs(difference) <= EQUAL * longest:
        return "change point"
    if difference > 0.0:
        return "triple-rocker (not Grashof)"
    if ground == shortest:
        return "double-crank (Grashof)"
    return (
        "crank-rocker (Grashof)" if grounded[lengths.index(shortest)] else "double-rocker (Grashof)"
    )


def _ground_length(mechanism: Mechanism, closure: int) -> float:
    """The length of the ground's side of the loop, m."""
    rows = [row for row in mechanism.rows if row.closure == closure]
    return float(sum(row.offset**2 for row in rows) ** 0.5)
