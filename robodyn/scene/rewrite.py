"""A scene's text with other numbers in it; comments, order and layout stay as they are.

A number that the file leaves out (`payload`, `damping`, `gravity`) is added to its mapping.  What
was written is read again: every number that was given must be there, and every other one as before.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from robodyn.errors import InputError
from robodyn.scene import yaml_tree
from robodyn.scene.description import from_text
from robodyn.scene.scene import Table, signals_of
from robodyn.scene.scene_values import SceneValues, with_unit
from robodyn.tables.output_file import write_text

Change = tuple[int, int, str]  # from, to, and what takes its place


def write_scene(
    source: str | Path, values: Mapping[str, float | Sequence[float]], out: str | None
) -> None:
    """Write the scene file `source` to `out`, all or nothing, with these numbers.

    Raises as `rewritten`, and InputError where `out` cannot be created, or where the scene names
    tables beside it and `out` is in another folder.
    """
    text = rewritten(yaml_tree.read_text(Path(source)), str(source), values)
    signals = signals_of(from_text(text, str(source)))
    table = next((x.file for _, x in signals if isinstance(x, Table)), None)
    there = None if out in (None, "-") else Path(str(out)).parent
    if table and there and there.resolve() != Path(source).parent.resolve():
        limit = f"must be in the folder of {source}, which names {table} from there"
        raise InputError("the scene", where=str(out), limit=limit)
    write_text(text, out)


def rewritten(text: str, source: str, values: Mapping[str, float | Sequence[float]]) -> str:
    """The scene's text with these numbers, by name; a vector [x, y] is two of them.

    Raises InputError for a name that is none, for one that the file shares by an alias, and for a
    place that cannot be written; DescriptionError for numbers that no scene may have.
    """
    old = SceneValues(text, source)
    old.check(values, pairs=True)
    values = {old.own_name(name): value for name, value in values.items()}
    if clash := old.clash(values):
        raise InputError(" and ".join(clash), where=source, limit="are one number: give it once")
    nodes = _Nodes(text, source, old.root)
    changes = []
    for name, value in values.items():
        change = nodes.change(*old.place(name), _written(value, old.untold_unit(name)))
        if change is None:
            limit = "is written by an alias, or in a way that cannot be changed: write it out"
            raise InputError(name, where=source, limit=limit)
        changes.append(change)
    for begin, end, new in sorted(changes, key=lambda change: change[:2], reverse=True):
        text = text[:begin] + new + text[end:]
    _check(old, SceneValues(text, source), values)
    return text


def _written(value: float | Sequence[float], unit: str) -> str:
    if isinstance(value, Sequence):
        return f"[{', '.join(repr(float(x)) for x in value)}]"
    return with_unit(value, unit)


class _Nodes:
    """Positions of the values of a text: its nodes, beside those of a tree without aliases."""

    def __init__(self, text: str, source: str, root: yaml_tree.Node) -> None:
        self.text = text
        self._found: dict[int, yaml_tree.Node] = {}
        self._seen: Counter[int] = Counter()  # how often each is used: an alias is its anchor's
        parsed = yaml_tree.parse(text, source)
        assert parsed is not None
        self._pair(root, parsed)

    def _pair(self, own: yaml_tree.Node, node: yaml_tree.Node) -> None:
        self._found[id(own)] = node
        self._seen[id(node)] += 1
        if isinstance(own, yaml_tree.Sequence) and isinstance(node, yaml_tree.Sequence):
            for item, other in zip(own.items, node.items, strict=True):
                self._pair(item, other)
        elif isinstance(own, yaml_tree.Mapping) and isinstance(node, yaml_tree.Mapping):
            for (_, value), (_, other) in zip(own.pairs, node.pairs, strict=True):
                self._pair(value, other)

    def change(
        self,
        around: yaml_tree.Mapping | yaml_tree.Sequence,
        node: yaml_tree.Node | None,
        at: str | int,
        new: str,
    ) -> Change | None:
        """The change that puts `new` in this place; None where it is no place of its own."""
        if node is None:
            mapping = self._found[id(around)]
            assert isinstance(mapping, yaml_tree.Mapping)
            return self._addition(mapping, f"{at}: {new}")
        found = self._found[id(node)]
        if self._seen[id(found)] > 1 or not found.inline:
            return None
        return found.begin, found.end, new

    def _addition(self, mapping: yaml_tree.Mapping, new: str) -> Change | None:
        """The change that adds a pair after the last that ends on a line of its own."""
        if self._seen[id(mapping)] > 1:
            return None
        if mapping.inline:
            if not mapping.pairs:
                end = mapping.end - 1
                return end, end, new
            last = mapping.pairs[-1][1]
            return None if self._seen[id(last)] > 1 else (last.end, last.end, f", {new}")
        first = mapping.pairs[0][0].begin
        column = first - (self.text.rfind("\n", 0, first) + 1)
        own = [x for _, x in mapping.pairs if self._seen[id(x)] == 1 and x.inline]
        if not own:  # before the first, as "- name: .." may begin
            return first, first, new + "\n" + " " * column
        end = own[-1].end
        line = self.text.find("\n", end)
        end = len(self.text) if line < 0 else line - (self.text[line - 1] == "\r")
        newline = "\r\n" if "\r\n" in self.text else "\n"
        return end, end, newline + " " * column + new


def _check(
    old: SceneValues, new: SceneValues, values: Mapping[str, float | Sequence[float]]
) -> None:
    """Raise InputError where a number of the new text is not what it should be."""
    kept = {name: old.text(name) for name in old.names}  # numbers may be made of constants
    wanted: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, Sequence):
            kept = {x: y for x, y in kept.items() if x not in (name, f"{name}[0]", f"{name}[1]")}
            wanted |= {f"{name}[{k}]": x for k, x in enumerate(value)}
        else:
            kept = {x: y for x, y in kept.items() if x != name and not x.startswith(f"{name}[")}
            wanted[name] = value
    wrong = [x for x, text in kept.items() if x not in new or new.text(x) != text]
    wrong += [x for x, value in wanted.items() if x not in new or new.number(x) != value]
    if wrong:
        raise InputError(wrong[0], where=old.source, limit="cannot be rewritten in this file")
