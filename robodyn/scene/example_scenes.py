"""The example scenes that come with robodyn: the files of `robots/`, installed beside the code."""

from __future__ import annotations

from pathlib import Path

from robodyn.errors import InputError

_HERE = Path(__file__).resolve().parent.parent
# an installed package has them inside; a checkout beside it
_PLACES = (_HERE / "robots", _HERE.parent / "robots")


def scene_names() -> list[str]:
    """The names of the scenes, in alphabetical order."""
    return sorted(path.stem for path in _directory().glob("*.yaml"))


def scene_text(name: str) -> str:
    """The file of a scene; InputError, with the names that there are, for any other."""
    if name not in scene_names():
        raise InputError("NAME", value=name, limit=f"must be one of {', '.join(scene_names())}")
    return example_file(name).read_text(encoding="utf-8")


def example_file(name: str) -> Path:
    """Where the scene of this name is."""
    return _directory() / f"{name}.yaml"


def summary(text: str) -> str:
    """What a scene is, by the first line of its comment."""
    return text.partition("\n")[0].lstrip("# ").rstrip()


def example_options(text: str) -> str:
    """The options that the comment of a scene says to try, such as `--q 60deg`."""
    marked = [line for line in text.splitlines() if line.startswith("# try: ")]
    return marked[0].removeprefix("# try: ") if marked else ""


def _directory() -> Path:
    for place in _PLACES:
        if place.is_dir():
            return place
    limit = f"neither in {_PLACES[0]} nor in {_PLACES[1]}: install robodyn again"
    raise InputError("the example scenes are missing", limit=limit)
