"""Mechanism -> the text of a scene file: in the explicit form, by its numbers.

A scene as drawn becomes one of lengths, closures and the pose that it starts in.  Read again the
text gives the same numbers; comments are no part of a mechanism.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from robodyn.errors import InputError, printable
from robodyn.mechanics.mechanism import Mechanism
from robodyn.scene.plain_scene import plain_scene
from robodyn.scene.scene import Table, signals_of

PLAIN = re.compile(r"[A-Za-z][\w-]*( [\w-]+)*")  # text that YAML has without quotes


def scene_text(mechanism: Mechanism) -> str:
    """The scene as YAML text: an entry of a list, or of what names things, on each line."""
    lines = [
        f"# {printable(mechanism.name)}: written by robodyn from {printable(mechanism.source)}"
    ]
    lines.append("# Units: m kg s N, angles in rad.")
    for key, value in plain_scene(mechanism.description).items():
        if key in ("links", "closures", "couplings", "springs", "loads"):
            lines.append(f"{key}:")
            lines += [f"  - {_flow(entry)}" for entry in value]
        elif isinstance(value, dict):
            lines.append(f"{key}:")
            lines += [f"  {_flow(name)}: {_flow(entry)}" for name, entry in value.items()]
        else:
            lines.append(f"{key}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def check_tables(mechanism: Mechanism, out: str | None) -> None:
    """Raise InputError where a scene names tables beside it, and `out` is in another folder."""
    signals = (signal for _, signal in signals_of(mechanism.description))
    table = next((x.file for x in signals if isinstance(x, Table)), None)
    here = Path(mechanism.source).parent
    if table and out not in (None, "-") and Path(str(out)).parent.resolve() != here.resolve():
        limit = f"must be in the folder of {mechanism.source}, which names {table} from there"
        raise InputError("--out", value=out, limit=limit)


def _flow(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_flow(key)}: {_flow(x)}' for key, x in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_flow, value))}]"
    if isinstance(value, str):
        return value if PLAIN.fullmatch(value) else json.dumps(value)
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(value))
