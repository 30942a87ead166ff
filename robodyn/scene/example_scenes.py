"""The example scenes that come with robodyn: the files of `robots/`, installed beside the code."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from robodyn.errors import InputError

MOST_LISTED = 1000  # files of a folder that are looked at for a like name

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
    return (_directory() / f"{name}.yaml").read_text(encoding="utf-8")


def scene_table(name: str) -> tuple[str, str] | None:
    """The name and the text of the table that a scene reads; None if it has none."""
    path = _directory() / f"{name}.csv"
    return (path.name, path.read_text(encoding="utf-8")) if path.is_file() else None


def example_file(name: str) -> Path | None:
    """The example that a bare word names, None where it names none: no folder, no suffix."""
    bare = Path(name).name == name and not Path(name).suffix
    return _directory() / f"{name}.yaml" if bare and name in scene_names() else None


def like(missing: Path) -> str:
    """Return suggestions for a missing file: a scene beside it, or an example."""
    if missing.stem in scene_names():
        return f"; the example of this name is {missing.stem}, without a folder or .yaml"
    beside = [path.stem for path in islice(missing.parent.glob("*.yaml"), MOST_LISTED)]
    near = [str(missing.with_name(f"{x}.yaml")) for x in _closest(missing.stem, beside)]
    near += [f"the example {x}" for x in _closest(missing.stem, scene_names())]
    return f"; did you mean {' or '.join(near)}?" if near else ""


def _closest(name: str, known: list[str]) -> list[str]:
    """The one of these that is most like a name in whatever case; one of two letters may differ."""
    from difflib import get_close_matches  # only a faulty name pays for the import

    lower, least = {x.lower(): x for x in known}, 0.5 if len(name) == 2 else 0.6
    return [lower[x] for x in get_close_matches(name.lower(), lower, n=1, cutoff=least)]


def summary(text: str) -> str:
    """Return the first line of a scene's comment."""
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
