"""YAML text -> a plain tree that keeps what a strict reader needs: the text as written and lines.

PyYAML's constructors read `1e-3` as a string and `yes` as True, keep the last of two equal keys
and build Python objects from tags.  Here the parser's events are taken instead: a scalar stays the
text that it is, a mapping keeps every pair, a tag is a fault, and aliases cannot blow up.
"""

from __future__ import annotations

from pathlib import Path

import yaml

from robodyn.errors import DescriptionError, Fault
from robodyn.tables.input_file import MOST_BYTES

MAX_DEPTH = 40
MAX_NODES = 300_000  # with aliases counted as often as they are used
_TOO_DEEP = f"nests deeper than {MAX_DEPTH} levels"


class Scalar:
    """One scalar: its text, whether it is quoted, its line."""

    size = 1

    def __init__(self, text: str, quoted: bool, line: int) -> None:
        self.text, self.quoted, self.line = text, quoted, line


class Sequence:
    """A list of nodes."""

    def __init__(self, items: list[Node], line: int, size: int = 1) -> None:
        self.items, self.line, self.size = items, line, size


class Mapping:
    """Pairs of a key and a node, in the order of the file, equal keys kept."""

    def __init__(self, pairs: list[tuple[Scalar, Node]], line: int, size: int = 1) -> None:
        self.pairs, self.line, self.size = pairs, line, size


Node = Scalar | Sequence | Mapping

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml where PyYAML was built with it
_KINDS = ("str", "int", "float", "bool", "null", "seq", "map")
# ! is what the parser reports for a quoted scalar
_STANDARD_TAGS = {"!", *(f"tag:yaml.org,2002:{kind}" for kind in _KINDS)}


def read_text(path: Path) -> str:
    """The text of the file, or a DescriptionError that says why it has none."""
    source = str(path)

    def refuse(reason: str, line: int | None = None) -> DescriptionError:
        return DescriptionError(source, [Fault("", reason, line=line)])

    try:
        with path.open("rb") as stream:
            data = stream.read(MOST_BYTES + 1)
    except FileNotFoundError:
        from robodyn.scene.example_scenes import like  # only a faulty name pays for the import

        raise refuse(f"no such file{like(path)}") from None
    except IsADirectoryError:
        raise refuse("is a directory, not a scene file") from None
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        raise refuse(f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > MOST_BYTES:
        raise refuse(f"is larger than {MOST_BYTES // 2**20} MiB")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise refuse(f"is not UTF-8 text: byte 0x{data[error.start]:02x}", line) from None


def parse(text: str, source: str) -> Node | None:
    """The one document of `text` as a tree, None if it is empty; DescriptionError if it is none."""
    try:
        return _Composer(source).compose(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        reason = getattr(error, "problem", None) or str(error).splitlines()[0]
        line = None if mark is None else mark.line + 1
        # PyYAML 6.0.4 scans 1024 characters ahead and has a limit of its own on what it finds there
        limit = _TOO_DEEP if "nesting depth" in reason else f"is not YAML: {reason}"
        at_fault = "".join(text.splitlines()[line - 1 : line]) if line else ""
        if "\t" in at_fault[: len(at_fault) - len(at_fault.lstrip())]:
            limit = "is indented by a tab: YAML takes spaces"
        raise DescriptionError(source, [Fault("", limit, line=line)]) from None


class _Composer:
    """Builds the tree from the parser's events, within the limits above."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.anchors: dict[str, Node] = {}
        self.open: list[Sequence | Mapping] = []  # the collections around the present event
        self.keys: list[Scalar | None] = []  # the key that waits for its value, one a collection
        self.root: Node | None = None
        self.documents = 0

    def compose(self, text: str) -> Node | None:
        for event in yaml.parse(text, Loader=_Loader):
            line = 1 if event.start_mark is None else event.start_mark.line + 1
            if isinstance(event, yaml.DocumentStartEvent):
                self.documents += 1
                if self.documents > 1:
                    raise self._fault("holds more than one YAML document", line)
            elif isinstance(event, yaml.AliasEvent):
                node = self.anchors.get(event.anchor or "")
                if node is None:
                    raise self._fault(f"alias *{event.anchor} has no anchor before it", line)
                if any(node is collection for collection in self.open):
                    raise self._fault(f"alias *{event.anchor} stands inside its own anchor", line)
                self._place(node, line)
            elif isinstance(event, yaml.NodeEvent):
                tag = getattr(event, "tag", None)
                if tag is not None and tag not in _STANDARD_TAGS:
                    shown = tag.replace("tag:yaml.org,2002:", "!!")
                    raise self._fault(f"tag {shown} is refused: a scene is plain data", line)
                node = self._node(event, line)
                if event.anchor is not None:
                    self.anchors[event.anchor] = node
                if isinstance(node, Scalar):
                    self._place(node, line)
                else:
                    self.open.append(node)
                    self.keys.append(None)
                    if len(self.open) > MAX_DEPTH:
                        raise self._fault(_TOO_DEEP, line)
            elif isinstance(event, yaml.CollectionEndEvent):
                self.keys.pop()
                self._place(self.open.pop(), line)
        if isinstance(self.root, Scalar) and not self.root.text and not self.root.quoted:
            return None
        return self.root

    @staticmethod
    def _node(event: yaml.NodeEvent, line: int) -> Node:
        if isinstance(event, yaml.ScalarEvent):
            return Scalar(event.value, bool(event.style), line)
        if isinstance(event, yaml.SequenceStartEvent):
            return Sequence([], line)
        return Mapping([], line)

    def _place(self, node: Node, line: int) -> None:
        """Put a finished node into the collection around it."""
        if not self.open:
            self.root = node
            return
        around = self.open[-1]
        around.size += node.size
        if around.size > MAX_NODES:
            raise self._fault(f"expands to more than {MAX_NODES} values (aliases counted)", line)
        if isinstance(around, Sequence):
            around.items.append(node)
        elif (key := self.keys[-1]) is not None:
            around.pairs.append((key, node))
            self.keys[-1] = None
        elif isinstance(node, Scalar):
            self.keys[-1] = node
        else:
            raise self._fault("a key must be a plain name", line)

    def _fault(self, reason: str, line: int) -> DescriptionError:
        return DescriptionError(self.source, [Fault("", reason, line=line)])
