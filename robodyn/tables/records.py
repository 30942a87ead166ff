"""Named tuples that are made at once: a command's start would wait for typing's to be checked."""

from __future__ import annotations

from collections.abc import Iterable
from operator import itemgetter
from typing import Any, ClassVar, Self, dataclass_transform


@dataclass_transform(frozen_default=True)
class Record(tuple[Any, ...]):
    """A tuple whose entries have the names, types and defaults that a class of it declares.

    Used as `typing.NamedTuple` is, with the same methods; of its classes none has another under it.
    """

    __slots__ = ()
    _fields: ClassVar[tuple[str, ...]] = ()
    _field_defaults: ClassVar[dict[str, Any]] = {}

    def __init_subclass__(cls) -> None:
        cls._fields = tuple(cls.__annotations__)
        cls._field_defaults = {x: vars(cls)[x] for x in cls._fields if x in vars(cls)}
        for place, name in enumerate(cls._fields):
            setattr(cls, name, property(itemgetter(place)))

    def __new__(cls, *given: Any, **named: Any) -> Self:
        """The record of these values; TypeError where they are not its own."""
        if len(given) != len(cls._fields):
            left = cls._fields[len(given) :]
            values = cls._field_defaults | named
            given += tuple([values[name] for name in left if name in values])
            if len(given) != len(cls._fields) or not named.keys() <= set(left):
                raise TypeError(f"{cls.__name__} takes {', '.join(cls._fields)}")
        elif named:
            raise TypeError(f"{cls.__name__} takes {', '.join(cls._fields)}, each once")
        return tuple.__new__(cls, given)

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
        return type(self)(**(self._asdict() | values))
