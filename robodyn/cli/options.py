"""The options and arguments that commands share, each defined once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Option

from robodyn.cli.files import model_argument, output_file, read_scene, rows_argument
from robodyn.cli.large_angles import tell_large_angles
from robodyn.dynamics.named_points import named_point
from robodyn.elements.loads import Force as PointForce
from robodyn.errors import DescriptionError, InputError
from robodyn.scene import yaml_tree
from robodyn.scene.quantities import parse_vector, value_from
from robodyn.scene.scene import Description
from robodyn.scene.scene_values import SceneValues, read_numbers
from robodyn.tables.csv_fields import shown

if TYPE_CHECKING:
    from robodyn.mechanics.mechanism import Mechanism

Text = str | None  # of an option that may be left out
Number = float | None
Format = Literal["table", "csv", "json"]  # how a result is written
StructuredFormat = Literal["table", "json"]  # how a result with matrices or parts is written
_SET = "A number of the scene in place of its own: links.forearm.m=1.1; repeatable."


def option(
    help: str, metavar: str | None = None, *, default: object = None, flag: str = "", **more: Any
) -> Any:
    """A field of a group of options, or a parameter of a command, that is an option.

    Its name is the flag, max_step --max-step, where no other one is told.
    """
    declared = Option(..., *filter(None, [flag]), metavar=metavar, help=help, **more)
    return field(default=default, metadata={"option": declared})


def switch(help: str) -> Any:
    """An option without a value, as `option`."""
    return option(help, default=False)


def refuse(limit: str, **given: object) -> None:
    """InputError, which says why, for an option that is given: max_qd is --max-qd."""
    for name, value in given.items():
        if value is not None:
            flag = "--" + name.strip("_").replace("_", "-")
            told = ", ".join(value) if isinstance(value, list) else value
            raise InputError(flag, value=shown(str(told)), limit=limit)


@dataclass(eq=False, repr=False)
class Model:
    """The scene that a command is about."""

    model: Annotated[str, model_argument("Scene file (YAML), or the name of an example: 2r.")]
    numbers: list[str] | None = option(_SET, "NAME=VALUE", flag="--set")

    def load(self) -> Mechanism:
        """The mechanism; InputError for a faulty scene, naming --set where that made it so."""
        from robodyn.mechanics.mechanism import build

        mechanism = build(self.values().base if self.numbers else self._read)
        tell_large_angles(mechanism, self.values)
        return mechanism

    def values(self) -> SceneValues:
        """The numbers of the scene, those of --set in place of its own."""
        return self._values

    @cached_property
    def _values(self) -> SceneValues:
        written = self._read.written
        values = SceneValues(written, self.model)
        if not (names := [name for name, _ in self.given]):
            return values
        try:
            values.check(names, pairs=True)
        except InputError as error:
            error.what = f"--set {error.what}"
            raise
        if clash := values.clash(names):
            raise InputError("--set", value=" and ".join(clash), limit="are one number")
        try:
            return read_numbers(written.text, self.model, self.given, written.tables)
        except DescriptionError as error:
            given = " ".join(f"--set {text}" for text in self.numbers or ())
            faults = [fault._replace(line=None) for fault in error.faults]
            raise DescriptionError(f"{self.model} with {given}", faults) from None

    @cached_property
    def _read(self) -> Description:
        """The scene file as it is, with the tables that it names: read once a command."""
        return read_scene(self.model)

    def put(self) -> dict[str, float | tuple[float, ...]]:
        """Return the values of --set by the names of numbers, for rewriting the scene."""
        values, found = self.values(), {}
        for name, _ in self.given:
            node = values.place(name)[1]
            count = len(node.items) if isinstance(node, yaml_tree.Sequence) else 0
            entries = tuple(values.number(f"{name}[{k}]") for k in range(count))
            found[name] = entries or values.number(name)
        return found

    @property
    def given(self) -> tuple[tuple[str, str], ...]:
        """The names and values of --set."""
        pairs = []
        for text in self.numbers or ():
            name, _, value = (part.strip() for part in text.partition("="))
            if not name or not value:
                limit = "write NAME=VALUE, such as links.forearm.m=1.1"
                raise InputError("--set", value=shown(text), limit=limit)
            pairs.append((name, value))
        return tuple(pairs)


_ROWS = "CSV file of states (columns q1.., qd1.., ...), or - for stdin; rows stream through."
States = Annotated[Text, rows_argument("STATES", _ROWS)]


def vector(flag: str, help: str) -> object:
    """An option that is a vector."""
    return Option(flag, metavar="VECTOR", help=help)


_WHICH = "all joints, or the actuated ones of a closed mechanism"
_Q = f"Joint angles, rad, or 30deg, pi/2; displacements, m: {_WHICH} (the rest is assembled)."
_QD = f"Joint rates, rad/s or 30deg; m/s: {_WHICH}. Default: at rest."
_QDD = f"Joint accelerations, rad/s^2 or m/s^2: {_WHICH}. Default: zero."
_TAU = "Joint torques, N m, or forces, N: all joints, or the actuated ones. Default: "
EACH = "one value, or one an actuated joint"

Q = Annotated[Text, vector("--q", _Q)]
Qd = Annotated[Text, vector("--qd", _QD)]
Qdd = Annotated[Text, vector("--qdd", _QDD)]
Tau = Annotated[Text, vector("--tau", f"{_TAU}zero.")]
HoldingTau = Annotated[Text, vector("--tau", f"{_TAU}those that hold it there.")]
_TABLE = "Default: table on a terminal, csv in a pipe."
OutputFormat = Annotated[Format | None, Option("--format", help=_TABLE)]
_DIFFERENTIATE = (
    "Finds the rates and accelerations that a table lacks by splines (quintic, ends not-a-knot) "
    "through t; takes 6 rows or more, all of them into memory; angles must run on past a turn, "
    "see --unwrap."
)
Differentiate = Annotated[bool, Option("--differentiate", help=_DIFFERENTIATE)]
_READ = "Columns that are read get other names: q1=pos1,qd1=vel1 reads pos1 as q1."
Read = Annotated[Text, Option("--read", metavar="NEW=OLD,..", help=_READ)]
_UNWRAP = (
    "Take whole turns off angles that jump by more than half a turn between rows, as logs within "
    "180 degrees do."
)
Unwrap = Annotated[bool, Option("--unwrap", help=_UNWRAP)]
_AT_TIME = "The time of laws, tables and loads, s, where no column t tells it. Default: 0."
AtTime = Annotated[Text, Option("--at-time", metavar="S", help=_AT_TIME)]


def time_from(text: str | None) -> float:
    """The time that --at-time tells, s; 0 if it is left out."""
    return 0.0 if text is None else value_from(text, "s", "--at-time")


_COLUMNS = (
    "Exactly these columns, in this order: of the input, or of all that can be computed, such as "
    "t,tau1,power,tip2_x; see `robodyn guide columns`."
)
Columns = Annotated[Text, Option("--columns", metavar="NAMES", help=_COLUMNS)]
_PARTS = "Default: table on a terminal, json in a pipe."
OutputStructured = Annotated[StructuredFormat | None, Option("--format", help=_PARTS)]
Out = Annotated[Text, output_file("--out", "-o", help="Write here, all or nothing.")]
_DEGREES = "Angles and their rates in degrees, in columns such as q1_deg."
Degrees = Annotated[bool, Option("--degrees", help=_DEGREES)]
_SIZE = "Of the picture, inches, such as 8x5."
Size = Annotated[Text, Option("--size", metavar="WxH", help=_SIZE)]
Quiet = Annotated[bool, Option("--quiet", help="No progress, no summary.")]
_FORCE = "A force, N, ground axes, at a point (coupler@0.5,0.2=10,-5), beside those of the scene; "
Force = Annotated[
    list[str] | None, Option("--force", metavar="POINT=FX,FY", help=_FORCE + "repeatable.")
]


def load_with(model: Model, forces: Sequence[str] | None) -> Mechanism:
    """The mechanism of a scene file as if its `loads` ended with these forces, POINT=FX,FY."""
    return with_forces(model.load(), forces)


def with_forces(mechanism: Mechanism, forces: Sequence[str] | None) -> Mechanism:
    """The mechanism with these forces, POINT=FX,FY, at the end of its loads."""
    if not forces:
        return mechanism
    from robodyn.mechanics.mechanism import build

    loads = list(mechanism.description.loads)
    for text in forces:
        point, _, force = text.rpartition("=")
        if not point:
            limit = "must be POINT=FX,FY, such as coupler@0.5,0.2=10,-5 (N)"
            raise InputError("--force", value=shown(text), limit=limit)
        where = f"--force {shown(point)}"
        values = parse_vector(force, where=where, unit="N")
        if len(values) != 2:
            raise InputError(where, value=shown(force), limit="must be FX,FY (N, ground axes)")
        loads.append(PointForce(named_point(mechanism, point, "--force").own, complex(*values)))
    return build(mechanism.description._replace(loads=tuple(loads)))
