"""The options and arguments that commands share, each defined once."""

from __future__ import annotations

from typing import Annotated, Literal, Optional

import typer

from robodyn.cli.files import input_argument, output_file

Format = Literal["table", "csv", "json"]  # how a result is written
StructuredFormat = Literal["table", "json"]  # how a result with matrices or parts is written
PictureFormat = Literal["text", "png", "svg", "pdf"]  # how a picture is written
Model = Annotated[str, input_argument("MODEL", "Scene file (YAML).")]
States = Annotated[
    Optional[str],  # noqa: UP045 (typer reads the annotation at run time)
    input_argument(
        "[STATES]",
        "CSV file of states (columns q1.., qd1.., ...), or - for stdin; rows stream through.",
    ),
]


def _vector(flag: str, text: str) -> object:
    return typer.Option(flag, metavar="VECTOR", help=text, show_default=False)


_WHICH = "all joints, or the actuated ones of a closed mechanism"
Q = Annotated[
    Optional[str],  # noqa: UP045
    _vector("--q", f"Joint angles, rad, or 30deg, pi/2: {_WHICH} (the rest is assembled)."),
]
Qd = Annotated[
    Optional[str],  # noqa: UP045
    _vector("--qd", f"Joint rates, rad/s or 30deg: {_WHICH}. Default: at rest."),
]
Qdd = Annotated[
    Optional[str],  # noqa: UP045
    _vector("--qdd", f"Joint accelerations, rad/s^2: {_WHICH}. Default: zero."),
]
Tau = Annotated[
    Optional[str],  # noqa: UP045
    _vector("--tau", "Joint torques, N m: all joints, or the actuated ones. Default: zero."),
]
OutputFormat = Annotated[
    Optional[Format],  # noqa: UP045
    typer.Option(
        "--format", help="Default: table on a terminal, csv in a pipe.", show_default=False
    ),
]
OutputStructured = Annotated[
    Optional[StructuredFormat],  # noqa: UP045
    typer.Option(
        "--format", help="Default: table on a terminal, json in a pipe.", show_default=False
    ),
]
Out = Annotated[
    Optional[str],  # noqa: UP045
    output_file("--out", "-o", help="Write here, all or nothing."),
]
PictureOut = Annotated[
    Optional[str],  # noqa: UP045
    output_file("--out", "-o", help="Write here, all or nothing: .png, .svg, .pdf, or .txt."),
]
OutputPicture = Annotated[
    Optional[PictureFormat],  # noqa: UP045
    typer.Option(
        "--format",
        help="Default: by the suffix of --out; on a terminal text, made of characters.",
        show_default=False,
    ),
]
Ascii = Annotated[
    bool, typer.Option("--ascii", help="Text of plain characters, not of braille dots.")
]
Size = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--size",
        metavar="WxH",
        help="Of the picture, inches (at 150 dots an inch), such as 8x5.",
        show_default=False,
    ),
]
