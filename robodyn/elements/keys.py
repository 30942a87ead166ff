"""Keys of a record's mapping in files, declared beside its fields.

    length: float = key("amount", "free length", unit="m", symbol="S0: free length of {}")

The reader, the JSON Schema, the names of numbers, the symbols of equations and the guide's tables
follow from these declarations: see `grammar.py`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Final, Self, dataclass_transform

from robodyn.tables.records import Record

NEEDED: Final[Any] = object()  # the default of what a file must have
BY_DIRECTION = "by_direction"  # of a value that is one amount, or a pair by the rate's sign
WAYS = ("p", "n")  # letters of positive and of negative rates, after those of a number
ONE = "one of the three"
TOGETHER = "all or none"  # what stands for a key of several that a file has all, or none
# what stands for a key of several that exclude one another, one of which a file must have
ONES = (ONE, "I or J", "r or centre")
Sided = Any  # a text, or a pair of texts: of joints that turn, and of those that slide


class Key(Record):
    """A key of a mapping: kind of its value, default and help.

    What differs between turning and sliding joints is a pair; `of` selects.
    """

    kind: Sided  # of its value
    help: Sided
    unit: Sided = ""
    default: Any = NEEDED  # the value where a file leaves it out, and the field's default
    absent: Any = NEEDED  # the value where a file leaves it out; the field has no default
    told: Sided = ""  # the default in words
    listed: bool = False  # whether the value is a list of this kind
    hint: Sided = ""  # what a message adds where a limit is not kept
    symbol: Sided = ""  # its letters in equations, and what a legend says of it
    linear: str = ""  # its letters among the parameters that torques are linear in
    instead: str = ""  # the field that stands in its place, if that has a value
    only_with: str = ""  # the field without which torques are not linear in it
    name: Sided = ""  # in files, if it is not the field's
    only: Sided = ""  # the one word of its kind that this form may have
    ways: tuple[str, ...] = ()  # the ways to write the mapping that have it; none: all
    field: str = ""  # of the record

    @property
    def needed(self) -> bool:
        """Whether a file must have it."""
        return self.value is NEEDED and not self.told

    @property
    def value(self) -> Any:
        """The value if a file leaves it out; NEEDED if there is none."""
        return self.default if self.absent is NEEDED else self.absent

    @property
    def optional(self) -> bool:
        """Whether it is a number that is zero if a file leaves it out."""
        is_number = isinstance(self.value, (float, complex))
        return is_number and not (self.one or self.value)

    @property
    def shown_default(self) -> str:
        """The default in words, or "needed"."""
        if self.told:
            return str(self.told)
        return "needed" if self.needed else "0" if self.optional else "none"

    @property
    def one(self) -> bool:
        """Whether a file must have exactly one of several keys including this one."""
        return self.told in ONES

    @property
    def together(self) -> bool:
        """Whether a file must have all or none of several keys including this one."""
        return bool(self.told == TOGETHER)

    def of(self, slides: bool) -> Key:
        """Return the key for a sliding, or a turning joint."""
        each = zip(self._fields, self, strict=True)
        pairs = {x: y for x, y in each if isinstance(y, tuple) and x in _SIDED}
        return self._replace(**{x: y[slides] for x, y in pairs.items()})


_SIDED = frozenset(("kind", "help", "unit", "told", "hint", "symbol", "name", "only"))


def key(kind: Sided, help: Sided, **more: Any) -> Any:
    """Return the declaration of a key, as default of its field; for `more` see `Key`."""
    return Key(kind, help, **more)


class Way(Record):
    """One way to write a record as a mapping.

    `among` is the kind of value that the mapping is, `marks` are keys that distinguish it from
    other mappings of this kind, and `slides` tells whether it is for sliding joints.
    """

    name: str
    among: str
    help: str
    marks: tuple[str, ...] = ()
    slides: bool = False


def at_joints(name: str, among: str, help: Sided, marks: tuple[str, ...] = ()) -> tuple[Way, Way]:
    """Return the ways to write a record at a turning and at a sliding joint."""
    turns, slides = (help, help) if isinstance(help, str) else help
    return (
        Way(name, among, turns, marks),
        Way(f"slide_{name}", f"slide_{among}", slides, marks, True),
    )


@dataclass_transform(frozen_default=True, field_specifiers=(key,))
class Declared(Record):
    """A record whose fields may be declared by keys.

    A key annotated as ClassVar belongs to the mapping, but has no field.
    """

    ways: ClassVar[tuple[Way, ...]] = ()  # to write it; none: files do not have it
    # a record whose keys it has too, less those of some fields
    like: ClassVar[tuple[type[Declared], frozenset[str]] | None] = None
    keys: ClassVar[dict[str, Key]] = {}  # by fields, in the order of declaration

    def __init_subclass__(cls) -> None:
        own = {x: y for x in cls.__annotations__ if isinstance(y := vars(cls).get(x), Key)}
        more = {}
        if cls.like:
            more = {x: y for x, y in cls.like[0].keys.items() if x not in cls.like[1]}
        first = {x: y for x, y in own.items() if x not in more}
        keys = {x: y._replace(field=x) for x, y in (first | more | own).items()}
        cls.keys = cls.keys | keys
        for name, each in own.items():
            if each.default is NEEDED or "ClassVar[" in str(cls.__annotations__[name]):
                delattr(cls, name)
            else:
                setattr(cls, name, each.default)
        super().__init_subclass__()

    @classmethod
    def keys_of(cls, way: Way) -> dict[str, Key]:
        """Return the keys of one way to write it, by name."""
        found = {}
        base = way.name.removeprefix("slide_")
        for field, declared in cls.keys.items():
            if not declared.ways or base in declared.ways or way.name in declared.ways:
                each = declared.of(way.slides)
                name = each.name or field
                if name in way.marks:
                    each = each._replace(default=NEEDED, absent=NEEDED, told="")
                found[name] = each
        return found

    @classmethod
    def from_keys(cls, values: dict[str, Any]) -> Self:
        """Return a record from values by field."""
        return cls(**values)

    def to_keys(self) -> dict[str, Any]:
        """Return the values by field; missing ones have their default."""
        return {x: getattr(self, x) for x in self.keys if x in self._fields}

    def linear(self) -> Iterator[tuple[str, Key]]:
        """Yield the fields in which torques are linear, with their keys."""
        for field, declared in self.keys.items():
            replaced = declared.instead and getattr(self, declared.instead)
            lacks = declared.only_with and getattr(self, declared.only_with) is None
            nothing = declared.optional and not getattr(self, field)
            if declared.linear and not (replaced or lacks or nothing):
                yield field, declared

    def misfits(self, names: Mapping[str, str]) -> Iterator[tuple[str, str, object]]:
        """Yield faults of values that are valid separately: field, limit and value.

        `names` are the keys' names by field.
        """
        yield from ()
