"""The errors that robodyn raises, and the exit code that each means.

Every error says what is wrong, where, with which value, and what is allowed.  The
numerics raise them; only the command line turns them into text and an exit code.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

LONGEST_PART = 1000  # characters of a part of a message; names of the input may be many or long
MOST_COMPARED = 2000  # names that are put in an order for a message
ALIKE = 0.6  # of two names, by difflib
LONGEST_COMPARED = 60  # characters of each
MOST_FAULTS = 200  # of a scene; it is read no further


class RobodynError(Exception):
    """Root of robodyn's errors: the computation could not be done (exit code 1).

    Its text is `where: what = value: limit`, less the parts that are not given.
    """

    exit_code = 1

    def __init__(
        self, what: str, *, where: str = "", value: object = None, limit: str = ""
    ) -> None:
        self.what = what
        self.where = where
        self.value = value
        self.limit = limit
        super().__init__(what)

    def __reduce__(self) -> tuple[object, ...]:
        """Parts to rebuild it from, for `pickle` and `copy`."""
        return _rebuilt, (type(self), self.args), self.__dict__

    def __str__(self) -> str:
        return _message(self.where, self.what, self.value, self.limit)

    def add_place(self, place: str) -> None:
        """Put `place` (a row of a table, say) before where the error already is."""
        self.where = f"{place}: {self.where}" if self.where else place


def _rebuilt(kind: type[RobodynError], args: tuple[object, ...]) -> RobodynError:
    """Return an error without a call of `__init__`: subclasses take other arguments than `args`."""
    return kind.__new__(kind, *args)


@contextmanager
def at_place(place: str, *of: str) -> Iterator[None]:
    """Add a place to errors raised within; with `of`, only to those that begin with it."""
    try:
        yield
    except RobodynError as error:
        if not of or error.what.startswith(of):
            error.add_place(place)
        raise


@contextmanager
def named_options(names: Collection[str], **others: str) -> Iterator[None]:
    """An argument of the numerics that is refused is named as its option.

    `max_qd` among the `names` is --max-qd; `others` have another name there than here.
    """
    try:
        yield
    except RobodynError as error:
        name = others.get(error.what, error.what)
        if name in names or error.what in others:
            error.what = "--" + name.replace("_", "-")
        raise


class InputError(RobodynError):
    """The input is wrong: usage, a file, or a value in it (exit code 2)."""

    exit_code = 2


class MassError(InputError):
    """A link has no mass, which what is asked for needs: `limit` says what that is."""

    def __init__(self, what: str, *, where: str = "", limit: str = "dynamics need") -> None:
        super().__init__(what, where=where, limit=f"has no mass m, which {limit}")


class Fault(NamedTuple):
    """One fault of a description: the place in the file, what is there, what is allowed."""

    place: str
    limit: str
    value: object = None
    line: int | None = None

    def text(self, source: str) -> str:
        """The fault as one line, `source:line: place = value: limit`."""
        at = source if self.line is None else f"{source}:{self.line}"
        return _message(at, self.place, self.value, self.limit)


def _message(where: str, what: str, value: object, limit: str) -> str:
    subject = what if value is None else f"{what} = {value}"
    parts = (
        part if len(part) <= LONGEST_PART else part[:LONGEST_PART] + "..."
        for part in (where, subject, limit)
    )
    return printable(": ".join(part for part in parts if part))


def nearest_first(word: str, names: Sequence[str]) -> Sequence[str]:
    """The names, those like the word first, the others (or too many) in the order they have."""
    if not word or len(names) > MOST_COMPARED:
        return names
    from difflib import SequenceMatcher  # only an error pays for the import

    matcher = SequenceMatcher(b=word)

    def unlike(name: str) -> float:
        matcher.set_seq1(name[:LONGEST_COMPARED])
        return -matcher.ratio() if matcher.ratio() >= ALIKE else 0.0

    return sorted(names, key=unlike)


def printable(text: str) -> str:
    """The text with what a terminal would obey (escapes, line ends) written out."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def printable_lines(text: str) -> str:
    """Each line of the text `printable`."""
    return "\n".join(map(printable, text.split("\n")))


class DescriptionError(InputError):
    """A scene file has faults; all of them are told, one a line, up to MOST_FAULTS."""

    def __init__(self, source: str, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        self.source = source
        super().__init__(f"{len(self.faults)} faults", where=source)

    def __str__(self) -> str:
        lines = [fault.text(self.source) for fault in self.faults[:MOST_FAULTS]]
        if len(self.faults) > MOST_FAULTS:
            lines.append(f"{self.source}: there are more faults than these {MOST_FAULTS}")
        return "\n".join(lines)


class AssemblyError(RobodynError):
    """The loops cannot be closed at this configuration (exit code 1)."""


class ResidualError(RobodynError):
    """A motion needs a torque at a joint that no actuator drives (exit code 1)."""


class SingularError(RobodynError):
    """The equations have no unique solution at this configuration (exit code 1)."""


class SingularPoseError(SingularError):
    """Like its base class; other configurations of the same mechanism have a solution."""


class SignalError(RobodynError):
    """A table or an expression of a scene has no value at a state."""


class LawError(RobodynError):
    """A law of a coupling cannot be kept, or has no value or no derivative (exit code 1)."""


def overflow() -> RobodynError:
    """Return the error for a result that is not finite."""
    return RobodynError("the result is not finite", limit="the state or the scene is too large")
