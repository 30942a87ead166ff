"""`Record` beside `typing.NamedTuple`: the same declaration does the same."""

from __future__ import annotations

import copy
import pickle
import types
from typing import NamedTuple

import pytest

from robodyn.tables.records import Record


class Named(NamedTuple):
    x: int
    y: float = 1.5
    z: tuple[int, ...] = ()

    @property
    def sum(self) -> float:
        return self.x + self.y


class Recorded(Record):
    x: int
    y: float = 1.5
    z: tuple[int, ...] = ()

    @property
    def sum(self) -> float:
        return self.x + self.y


CALLS = (((1,), {}), ((1, 2.0), {}), ((1, 2.0, (3,)), {}), ((), {"x": 1}), ((1,), {"z": (4,)}))


def test_a_record_is_what_a_named_tuple_is():
    for given, named in CALLS:
        there, here = Named(*given, **named), Recorded(*given, **named)
        assert (here.x, here.y, here.z, here.sum) == (there.x, there.y, there.z, there.sum)
        assert tuple(here) == there
        assert hash(here) == hash(there)
        assert repr(here) == repr(there).replace("Named", "Recorded")
        assert here._asdict() == there._asdict()
        assert here._fields == there._fields
        assert here._replace(y=-1.0) == there._replace(y=-1.0)
        assert type(here._replace(y=-1.0)) is type(Recorded._make(there)) is Recorded
        for again in (copy.copy(here), copy.deepcopy(here), pickle.loads(pickle.dumps(here))):
            assert again == here
            assert type(again) is Recorded
        match here:
            case Recorded(x, z=z):
                assert (x, z) == (there.x, there.z)
            case _:
                pytest.fail("a pattern by places and names does not match")


def test_what_is_no_record_is_refused():
    wrong = [((), {}), ((1, 2.0, (), 4), {}), ((1,), {"x": 1}), ((1,), {"w": 1})]
    for given, named in [*wrong, ((1, 2.0, ()), {"z": ()}), ((), {"y": 1.0})]:
        for kind in (Named, Recorded):
            with pytest.raises(TypeError):
                kind(*given, **named)
    with pytest.raises(TypeError, match="has no w"):
        Recorded(1)._replace(w=1)
    with pytest.raises(AttributeError):
        Recorded(1).x = 2
    declared = {"__annotations__": {"x": "float", "y": "int", "z": "int"}, "x": 1.0, "z": 1}
    for base in (Record, NamedTuple):
        with pytest.raises(TypeError, match="default"):
            types.new_class("Wrong", (base,), exec_body=lambda own: own.update(declared))
