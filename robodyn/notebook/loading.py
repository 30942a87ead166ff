"""A mechanism of what a person has: a file, its text, a mapping, or the name of an example."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import yaml

from robodyn.errors import DescriptionError, InputError, printable
from robodyn.mechanics.mechanism import Mechanism, build
from robodyn.scene import description
from robodyn.scene.example_scenes import example_file, scene_names
from robodyn.scene.scene import Description
from robodyn.scene.yaml_values import nearest

KINDS = "must be a path, the text of a scene, a mapping, or the name of an example, such as '2r'"


def load(scene: str | os.PathLike[str] | Mapping[str, object]) -> Mechanism:
    """The mechanism that a scene describes.

    `scene` is the path of its file, its text (with a line break in it), a mapping as the text would
    hold it, {"links": [{"name": "arm", ...}]}, or, where there is no such file, the name of an
    example, "2r".  Raises DescriptionError (an InputError) that tells every fault of the scene.
    """
    if isinstance(scene, Mapping):
        return build(_of_mapping(scene))
    if isinstance(scene, str) and "\n" in scene:
        return build(description.from_text(scene, "text"))
    if not isinstance(scene, (str, os.PathLike)):
        raise InputError("scene", value=type(scene).__name__, limit=KINDS)
    path = Path(scene)
    if isinstance(scene, str) and not path.suffix and path.name == scene and not path.exists():
        example = example_file(scene)
        if example is None:
            limit = f"is no file, and no example{nearest(scene, scene_names())}"
            raise InputError("scene", value=printable(scene), limit=limit)
        path = example
    return build(description.read(path))


def _of_mapping(scene: Mapping[str, object]) -> Description:
    try:
        text = yaml.safe_dump(_plain(scene), sort_keys=False, allow_unicode=True)
        return description.from_text(text, "mapping")
    except DescriptionError as error:  # there are no lines that anyone could look at
        faults = [fault._replace(line=None) for fault in error.faults]
        raise DescriptionError(error.source, faults) from None
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError("scene", limit=f"cannot be written as YAML: {error}") from None


def _plain(value: object) -> object:
    """Mappings, lists, numbers and texts alone, of what holds arrays and numbers of numpy too."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    as_list = getattr(value, "tolist", None)
    return value if as_list is None else _plain(as_list())
