"""`robodyn schema`: the scene format for editors."""

from __future__ import annotations

import json

from robodyn.cli.options import Out
from robodyn.scene.scene_schema import scene_schema
from robodyn.tables.output_file import write_text


def schema(out: Out = None) -> None:
    """The scene format as a JSON Schema (draft 2020-12).

    An editor that knows it completes keys, shows units and marks faults while a scene is written.

    \b
    Examples:
      robodyn schema -o robodyn.schema.json
      robodyn schema | python -m json.tool
    """
    write_text(json.dumps(scene_schema(), indent=2, ensure_ascii=False) + "\n", out)
