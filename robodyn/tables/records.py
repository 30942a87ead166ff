"""Named tuples that are made at once: a command's start would wait for those of `typing`."""

from __future__ import annotations

from collections.abc import Iterable
from operator import itemgetter
from typing import Any, ClassVar, Self, dataclass_transform


@dataclass_transform(frozen_default=True)
class Record(tuple[Any, ...]):
    """A tuple whose entries have the names, types and defaults that a class of it declares.

    Used as `typing.NamedTuple` is, with the same methods.  A class of such a class has its fields
    and more; what is annotated as a ClassVar is no field.
    """

    __slots__ = ()
    _fields: ClassVar[tuple[str, ...]] = ()
    _field_defaults: ClassVar[dict[str, Any]] = {}
    _rest: ClassVar[tuple[Any, ...]]  # the defaults, of the last ones
    _needed: ClassVar[int]  # how many have none

    def __init_subclass__(cls) -> None:
        own = [x for x, kind in cls.__annotations__.items() if "ClassVar[" not in str(kind)]
        cls._fields = tuple(dict.fromkeys((*cls._fields, *own)))
        cls.__match_args__ = cls._fields  # type: ignore[attr-defined, misc]
        given = {x: vars(cls)[x] for x in own if x in vars(cls)}
        values = {x: y for x, y in cls._field_defaults.items() if x not in own} | given
        cls._field_defaults = {x: values[x] for x in cls._fields if x in values}
        cls._rest = tuple(cls._field_defaults.values())
        cls._needed = len(cls._fields) - len(cls._rest)
        if cls._fields[cls._needed :] != tuple(cls._field_defaults):
            raise TypeError(f"{cls.__name__}: a field with a default stands before one without")
        for place, name in enumerate(cls._fields):
            setattr(cls, name, property(itemgetter(place)))

    def __new__(cls, *given: Any, **named: Any) -> Self:
        """The record of these values; TypeError where they are not its own."""
        if named or not cls._needed <= len(given) <= len(cls._fields):
            left, values = cls._fields[len(given) :], cls._field_defaults | named
            if len(given) > len(cls._fields) or not named.keys() <= {*left} <= values.keys():
                raise TypeError(f"{cls.__name__} takes {', '.join(cls._fields)}, each once")
            given += tuple([values[name] for name in left])
        return tuple.__new__(cls, given + cls._rest[len(given) - cls._needed :])

    def __getnewargs__(self) -> tuple[Any, ...]:
        return tuple(self)

    def __repr__(self) -> str:
        told = ", ".join(f"{name}={value!r}" for name, value in self._asdict().items())
        return f"{type(self).__name__}({told})"

    @classmethod
    def _make(cls, values: Iterable[Any]) -> Self:
        return cls(*values)

    def _asdict(self) -> dict[str, Any]:
        return dict(zip(self._fields, self, strict=True))

    def _replace(self, **values: Any) -> Self:
        made = self._make(map(values.pop, self._fields, self))
        if values:
            raise TypeError(f"{type(self).__name__} has no {', '.join(values)}")
        return made
