"""YAML text -> a plain tree that keeps what a strict reader needs: the text as written and lines.

PyYAML's constructors read `1e-3` as a string and `yes` as True, keep the last of two equal keys
and build Python objects from tags.  Here its nodes are taken instead: a scalar stays the text that
it is, a mapping keeps every pair, a tag is a fault, and aliases cannot blow up.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from yaml import ScalarNode, SequenceNode

from robodyn.errors import DescriptionError, Fault
from robodyn.tables.input_file import MOST_BYTES

MAX_DEPTH = 40
MAX_NODES = 300_000  # with aliases counted as often as they are used
# What nests no deeper than a composer may go: so few open brackets, and lines indented no further.
BRACKETS = 500
_INDENTED = re.compile(r"^[ \t?-]{200}", re.MULTILINE)
_TOO_DEEP = f"nests deeper than {MAX_DEPTH} levels"


class Scalar:
    """One scalar: its text, whether it is quoted, its line.

    It stands from the character `begin` to `end`; it is `inline` if it ends where its last
    character is, as a block does not.
    """

    __slots__ = ("begin", "end", "inline", "line", "quoted", "text")
    size = 1

    def __init__(
        self, text: str, quoted: bool, line: int, begin: int = 0, end: int = 0, inline: bool = False
    ) -> None:
        self.text, self.quoted, self.line = text, quoted, line
        self.begin, self.end, self.inline = begin, end, inline


class Sequence:
    """A list of nodes; `size` counts values, those of aliases too."""

    begin = end = 0
    inline = False

    def __init__(self, items: list[Node], line: int, size: int = 1) -> None:
        self.items, self.line, self.size = items, line, size


class Mapping:
    """Pairs of a key and a node, in the order of the file, equal keys kept."""

    begin = end = 0
    inline = False

    def __init__(self, pairs: list[tuple[Scalar, Node]], line: int, size: int = 1) -> None:
        self.pairs, self.line, self.size = pairs, line, size


Node = Scalar | Sequence | Mapping


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Composes nodes, by libyaml where PyYAML was built with it; none but written tags."""

    def resolve(self, kind: Any, value: Any, implicit: Any) -> str:
        """No tag: what a scalar means is for its place to say."""
        return ""

    def descend_resolver(self, current_node: Any, current_index: Any) -> None:
        """See `resolve`."""

    def ascend_resolver(self) -> None:
        """See `resolve`."""


_KINDS = ("str", "int", "float", "bool", "null", "seq", "map")
_STANDARD_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in _KINDS}
_BLOCKS = ("|", ">")


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
        _guard(text, source)
        root = yaml.compose(text, Loader=_Loader)
        return None if root is None else _Making(text, source).root(root)
    except RecursionError:
        raise DescriptionError(source, [Fault("", _TOO_DEEP)]) from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        reason = getattr(error, "problem", None) or str(error).splitlines()[0]
        line = None if mark is None else mark.line + 1
        limit = f"is not YAML: {reason}"
        if reason == "but found another document":
            limit = "holds more than one YAML document"
        elif mark is not None and reason == "found undefined alias":
            limit = f"alias *{_anchor(text, mark.index)} has no anchor before it"
        # PyYAML 6.0.4 scans 1024 characters ahead and has a limit of its own on what it finds there
        limit = _TOO_DEEP if "nesting depth" in reason else limit
        at_fault = "".join(text.splitlines()[line - 1 : line]) if line else ""
        if "\t" in at_fault[: len(at_fault) - len(at_fault.lstrip())]:
            limit = "is indented by a tab: YAML takes spaces"
        raise DescriptionError(source, [Fault("", limit, line=line)]) from None


def _guard(text: str, source: str) -> None:
    """Raise DescriptionError for what nests too deep, before anything is composed of it.

    The composer calls itself at each level: 200,000 open brackets end the process.  The parser
    does not, but takes as long again: it is asked where the text may be that deep.
    """
    if len(text) > MOST_BYTES:
        raise DescriptionError(source, [Fault("", f"is larger than {MOST_BYTES // 2**20} MiB")])
    if text.count("[") + text.count("{") <= BRACKETS and not _INDENTED.search(text):
        return
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                line = 1 if event.start_mark is None else event.start_mark.line + 1
                raise DescriptionError(source, [Fault("", _TOO_DEEP, line=line)])
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _anchor(text: str, at: int) -> str:
    """The name of the anchor or alias at a place of a text."""
    found = re.match(r"[&*]([^\s,\[\]{}]*)", text[at : at + 100])
    return found[1] if found else ""


class _Making:
    """Makes the tree of PyYAML's nodes, within the limits above."""

    def __init__(self, text: str, source: str) -> None:
        self.text, self.source = text, source
        self.made: dict[int, Node] = {}  # collections, by the ids of their nodes
        self.open: set[int] = set()  # those around the present node

    def root(self, node: Any) -> Node | None:
        """The tree of a document; None if it is empty."""
        found = self.of(node)
        return found if not isinstance(found, Scalar) or found.text or found.quoted else None

    def of(self, node: Any) -> Node:
        """The tree of a node; an alias has that of its anchor."""
        key = id(node)
        if key in self.made:
            return self.made[key]
        begin, end = node.start_mark, node.end_mark
        if node.tag and node.tag not in _STANDARD_TAGS:
            shown = node.tag.replace("tag:yaml.org,2002:", "!!")
            raise self.fault(f"tag {shown} is refused: a scene is plain data", node)
        line = begin.line + 1
        if type(node) is ScalarNode:
            style = node.style
            at = begin.index, end.index
            scalar = Scalar(node.value, bool(style), line, *at, style not in _BLOCKS)
            self.made[key] = scalar
            return scalar
        if key in self.open:
            name = _anchor(self.text, begin.index)
            raise self.fault(f"alias *{name} stands inside its own anchor", node)
        if len(self.open) >= MAX_DEPTH:
            raise self.fault(_TOO_DEEP, node)
        self.open.add(key)
        found: Sequence | Mapping
        if type(node) is SequenceNode:
            items = [self.of(item) for item in node.value]
            found = Sequence(items, line, 1 + sum([item.size for item in items]))
        else:
            pairs = [(self.key(name), self.of(value)) for name, value in node.value]
            found = Mapping(pairs, line, 1 + sum([value.size for _, value in pairs]))
        if found.size > MAX_NODES:
            limit = f"expands to more than {MAX_NODES} values (aliases counted)"
            raise self.fault(limit, node)
        found.begin, found.end, found.inline = begin.index, end.index, bool(node.flow_style)
        self.open.remove(key)
        self.made[key] = found
        return found

    def key(self, node: Any) -> Scalar:
        """The key of a pair."""
        found = self.of(node)
        if not isinstance(found, Scalar):
            raise self.fault("a key must be a plain name", node)
        return found

    def fault(self, reason: str, node: Any) -> DescriptionError:
        """The error that a node is."""
        return DescriptionError(self.source, [Fault("", reason, line=node.start_mark.line + 1)])
