"""Scenes: the good ones as DESIGN has them; every fault of a bad one told with its place."""

from __future__ import annotations

import copy
import importlib
import math
import pickle
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from conftest import FRESH, ROOT, within
from good_scenes import ARM, EVERYTHING, LOOP
from hypothesis import given, settings
from hypothesis import strategies as st

from robodyn.errors import MOST_FAULTS, DescriptionError, InputError, RobodynError
from robodyn.mechanics.mechanism import build
from robodyn.scene import yaml_tree
from robodyn.scene.description import from_text, read
from robodyn.scene.scene import Closure, Description, Link, Point

ROBOTS = ROOT / "robots"
NAMES = [
    *("2r", "3r", "pendulum", "four-bar", "parallelogram", "slider-crank", "five-bar"),
    *("watt-six-bar", "stephenson-six-bar"),
]


def faults_of(text: str) -> list[tuple[str, object, str, int | None]]:
    """(place, value, limit, line) of every fault, each told in the error's text."""
    with pytest.raises(DescriptionError) as caught:
        from_text(text, "my.yaml")
    told = str(caught.value).splitlines()
    assert len(told) == len(caught.value.faults)
    for fault, line in zip(caught.value.faults, told, strict=True):
        assert line.startswith("my.yaml")
        for part in (fault.place, fault.limit, fault.value, fault.line):
            assert part is None or str(part) in line
    return [(x.place, x.value, x.limit, x.line) for x in caught.value.faults]


def only_fault_of(text: str) -> tuple[str, object, str, int | None]:
    faults = faults_of(text)
    assert len(faults) == 1, faults
    return faults[0]


def edited(text: str, old: str, new: str) -> str:
    """The text with one thing in it put otherwise."""
    assert text.count(old) == 1, old
    return text.replace(old, new)


# Good scenes


def test_the_2r_arm_is_the_one_of_the_design() -> None:
    arm = read(ROBOTS / "2r.yaml")
    assert arm == Description(
        source=str(ROBOTS / "2r.yaml"),
        name="planar 2R arm",
        gravity=-9.81j,
        links=(
            Link("upper arm", 1.5, 0.8, 0.36 + 0j, 0.082, Point(None, 0j)),
            Link("forearm", 0.9, 0.6, 0.25 + 0j, 0.031, Point(0, 0.8 + 0j)),
        ),
        closures=(),
        branches=(),
        actuated=None,
        start=None,
    )


def test_the_four_bar_is_the_one_of_the_design() -> None:
    four_bar = read(ROBOTS / "four-bar.yaml")
    assert four_bar == Description(
        source=str(ROBOTS / "four-bar.yaml"),
        name="crank-rocker four-bar",
        gravity=-9.81j,
        links=(
            Link("crank", 0.6, 0.35, 0.15 + 0j, 0.008, Point(None, 0j)),
            Link("coupler", 1.3, 0.95, 0.45 + 0j, 0.102, Point(0, 0.35 + 0j)),
            Link("rocker", 1.0, 0.80, 0.36 + 0j, 0.061, Point(None, 1.1 + 0j)),
        ),
        closures=(Closure(Point(1, 0.95 + 0j), Point(2, 0.8 + 0j)),),
        branches=("open",),
        actuated=(0,),
        start=None,
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_numbers_of_a_shipped_scene_are_those_that_its_yaml_has(name: str) -> None:
    path = ROBOTS / f"{name}.yaml"
    plain = yaml.safe_load(path.read_text())
    found = read(path)
    assert found.name == plain["name"]
    assert found.gravity == -1j * plain["gravity"]
    for link, entry in zip(found.links, plain["links"], strict=True):
        numbers = {key: value for key, value in entry.items() if key != "from"}
        if isinstance(entry["r"], list):
            numbers["r"] = complex(*entry["r"])
        assert numbers.items() <= link._asdict().items()
    driven = plain.get("actuated", [entry["name"] for entry in plain["links"]])
    assert [found.links[k].name for k in build(found).actuated] == driven


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_scene_has_a_sketch_units_a_source_and_distinct_numbers(name: str) -> None:
    text = (ROBOTS / f"{name}.yaml").read_text()
    header = re.match(r"(#.*\n)+", text)
    assert header
    for word in ("Units:", "Numbers:", "try: --q", "/////"):
        assert word in header[0]
    entries = yaml.safe_load(text)["links"]
    numbers = [str(entry[key]) for entry in entries for key in ("m", "r", "I")]
    if name != "parallelogram":  # its geometry demands equal lengths
        numbers += [str(entry["l"]) for entry in entries]
    assert len(set(numbers)) == len(numbers)


def test_all_shipped_scenes_are_tested() -> None:
    assert {path.stem for path in ROBOTS.glob("*.yaml")} >= set(NAMES)


def test_a_scene_that_uses_the_whole_format() -> None:
    scene = from_text(EVERYTHING, "my.yaml")
    plate, left, right, slide = scene.links
    assert scene.gravity == 0.3 - 9.7j
    assert (plate.r, plate.payload, plate.damping) == (0.21 + 0.13j, 0.4, 0.02)
    assert (left.payload, left.damping) == (0.0, 0.0)
    assert left.hangs_from == Point(0, 0.3 + 0.2j)
    assert (right.r, right.hangs_from) == (-0.1 + 0j, Point(0, 0.5 + 0j))
    assert slide.hangs_from == Point(2, 0.4 + 0j)
    assert scene.closures == (
        Closure(Point(1, 0.3 + 0j), Point(None, 0.9 + 0.1j)),
        Closure(Point(3, 0.8 + 0.05j), Point(None, 0.02j), along=0.6 + 0.8j),
    )
    assert scene.branches == ("crossed", "open")
    assert scene.actuated == (0, 2)
    assert scene.start == (math.radians(30), None, -math.pi / 4, 0.5)


def test_defaults() -> None:
    scene = from_text("links: [{name: a, m: 1, l: 2, r: 0.5, I: 0}]", "rig/my.yaml")
    assert (scene.name, scene.gravity, scene.closures, scene.start) == ("my", 0j, (), None)
    assert scene.links[0].hangs_from == Point(None, 0j)


def test_from_may_name_a_link_further_down() -> None:
    text = edited(ARM, "r: 0.36, I: 0.082", "r: 0.36, I: 0.082, from: lower")
    scene = from_text(edited(text, "I: 0.031", "I: 0.031, from: [1, 2]"), "my.yaml")
    assert [link.hangs_from for link in scene.links] == [Point(1, 0.6 + 0j), Point(None, 1 + 2j)]


@pytest.mark.parametrize("text", ["1e-3", "1E-3", "+.001", "0.001", "10e-4", "!!float 1e-3"])
def test_1e_3_is_the_number_that_it_is(text: str) -> None:
    scene = from_text(edited(ARM, "I: 0.031", f"I: {text}"), "my.yaml")
    assert scene.links[1].I == 0.001


def test_words_that_yaml_would_turn_into_something_else_stay_names() -> None:
    scene = from_text(ARM.replace("upper", "on").replace("lower", "1e3"), "my.yaml")
    assert [link.name for link in scene.links] == ["on", "1e3"]


def test_legitimate_aliases() -> None:
    text = """\
links:
  - {name: a, m: &mass 1.5, l: 0.8, r: &centre [0.3, 0.1], I: 0.08, from: &pivot [0.1, 0.2]}
  - {name: b, m: *mass, l: 0.6, r: *centre, I: 0.03, from: *pivot}
"""
    a, b = from_text(text, "my.yaml").links
    assert (a.m, a.r, a.hangs_from) == (1.5, 0.3 + 0.1j, Point(None, 0.1 + 0.2j))
    assert (b.m, b.r, b.hangs_from) == (a.m, a.r, a.hangs_from)


@pytest.mark.parametrize("text", [ARM.replace("\n", "\r\n"), "\ufeff" + ARM, f"---\n{ARM}...\n"])
def test_line_ends_byte_order_mark_and_document_marks_do_not_matter(
    text: str, scene: Callable[[str], Path]
) -> None:
    path = scene(text)
    assert read(path) == from_text(ARM, "")._replace(source=str(path))


def test_equal_descriptions_look_alike() -> None:
    one, other = from_text(ARM, "a"), from_text(ARM, "a")
    assert one == other
    assert repr(one) == repr(other)


# Files that are none


def test_a_file_that_is_absent(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"none\.yaml: no such file"):
        read(tmp_path / "none.yaml")


def test_a_directory(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=f"{tmp_path}: is a directory"):
        read(tmp_path)


def test_a_path_that_cannot_be() -> None:
    with pytest.raises(DescriptionError, match="cannot be read"):
        read("my\0.yaml")
    with pytest.raises(DescriptionError, match="cannot be read"):
        read("x" * 5000)


def test_a_file_that_is_no_utf_8_names_byte_and_line(scene: Callable[[bytes], Path]) -> None:
    path = scene(ARM.encode() + "# gez\u00e4hlt\n".encode("latin-1"))
    with pytest.raises(DescriptionError, match=rf"{path}:6: is not UTF-8 text: byte 0xe4"):
        read(path)


def test_utf_16_is_no_utf_8(scene: Callable[[bytes], Path]) -> None:
    with pytest.raises(DescriptionError, match="not UTF-8"):
        read(scene(ARM.encode("utf-16")))


def test_a_file_without_end() -> None:
    with pytest.raises(DescriptionError, match="/dev/zero: is larger than 16 MiB"):
        read("/dev/zero")


def test_control_characters_are_refused() -> None:
    _, _, limit, _ = only_fault_of(ARM + "\x00")
    assert limit.startswith("is not YAML")


def test_several_documents() -> None:
    _, _, limit, line = only_fault_of(f"{ARM}---\n{ARM}")
    assert "more than one YAML document" in limit
    assert line == 6


# YAML's traps


@pytest.mark.parametrize(
    "harm",
    [
        '!!python/object/apply:os.system ["touch {}"]',
        '!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path ["{}"]]',
        '!!python/object/new:subprocess.Popen [["touch", "{}"]]',
    ],
)
def test_tags_are_never_executed(harm: str, tmp_path: Path) -> None:
    victim = tmp_path / "touched"
    faults_of(f"name: {harm.format(victim)}\n{ARM}")
    faults_of(f"? {harm.format(victim)}\n: 1\n{ARM}")
    assert not victim.exists()


def laughs(levels: int, form: str) -> str:
    text = "a0: &a0 [ha]\n"
    for k in range(1, levels):
        text += f"a{k}: &a{k} " + form.replace("*", f"*a{k - 1}") + "\n"
    return text


@pytest.mark.parametrize(
    "text",
    [
        laughs(12, "[*, *, *, *, *, *, *, *, *, *]"),
        laughs(70, "{x: *, y: *}"),
        laughs(30, "[*, *]") + "links: *a29\n",
    ],
)
def test_aliases_that_blow_up(text: str) -> None:
    _, _, limit, line = only_fault_of(text)
    assert "aliases counted" in limit
    assert re.search(r"more than \d+ values", limit)
    assert line is not None


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "[" * 200_000,
        "links: " + "{" * 200_000,
        "[0, " * 200_000,
        "{a: " * 30_000,
        "- " * 20_000,
        "? " * 20_000,
        f"x: {'[' * 60}{']' * 60}",
        f"x: {'[' * 2000}{']' * 2000}",
    ],
)
def test_deep_nesting(text: str) -> None:
    """In the reader's words or in those of PyYAML 6.0.4, whose own limit is met before it."""
    _, _, limit, _ = only_fault_of(text)
    assert re.search(r"nests deeper than \d+ levels", limit)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 200_000,
        "{a: " * 200_000,
        '[ "]", ' * 100_000,
        "- " * 200_000,
        "- ? " * 100_000,
        "? - " * 100_000,
        "\n".join(" " * k + "- a:" for k in range(0, 900, 2)),
        "\n".join(" " * k + "a:" for k in range(900)),
    ],
)
def test_deep_texts_are_never_composed(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The composer of PyYAML before 6.0.4 ends the process at 200,000 levels."""
    monkeypatch.setattr(yaml, "compose", None)
    begun = time.process_time()
    with pytest.raises(DescriptionError, match=r"nests deeper than \d+ levels"):
        yaml_tree.parse(text, "x.yaml")
    assert time.process_time() - begun < 0.2


@pytest.mark.parametrize("loader", ["C", "Python"])
def test_what_the_guard_lets_pass_is_composed(loader: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By nodes in Python too, which nest as deep as Python's calls may."""
    if loader == "Python":
        own = type("Loader", (yaml.SafeLoader,), dict(vars(yaml_tree._Loader)))
        monkeypatch.setattr(yaml_tree, "_Loader", own)
    for brackets in (yaml_tree.MAX_DEPTH, yaml_tree.MAX_DEPTH + 1, yaml_tree.BRACKETS):
        text = "[" * brackets + "]" * brackets
        if brackets == yaml_tree.MAX_DEPTH:
            assert isinstance(yaml_tree.parse(text, "x"), yaml_tree.Sequence)
            continue
        with pytest.raises(DescriptionError, match="nests deeper"):
            yaml_tree.parse(text, "x")
    wide = "[" + "[1, 2], " * 2 * yaml_tree.BRACKETS + "]"
    found = yaml_tree.parse(wide, "x")
    assert isinstance(found, yaml_tree.Sequence)
    assert len(found.items) == 2 * yaml_tree.BRACKETS


def test_a_tree_knows_where_it_is_written() -> None:
    text = "# \u00e4\na: {x: 1.5, y: 'z'}\nb:\n  - |\n   t\n  - 3 mm  # c\n"
    root = yaml_tree.parse(text, "x")
    assert isinstance(root, yaml_tree.Mapping)
    (_, inner), (_, items) = root.pairs
    assert isinstance(inner, yaml_tree.Mapping)
    assert isinstance(items, yaml_tree.Sequence)
    written = [(x, text[x.begin : x.end]) for x in (inner, *(y for _, y in inner.pairs))]
    assert [part for _, part in written] == ["{x: 1.5, y: 'z'}", "1.5", "'z'"]
    assert all(x.inline for x, _ in written)
    assert not root.inline
    assert not items.inline
    assert [x.inline for x in items.items] == [False, True]
    assert text[items.items[1].begin : items.items[1].end] == "3 mm"


def test_a_bomb_of_aliases_ends_soon() -> None:
    begun = time.process_time()
    for text in (laughs(12, "[*, *, *, *, *, *, *, *, *, *]"), laughs(2000, "[*, *]")):
        with pytest.raises(DescriptionError, match=r"aliases counted|nests deeper"):
            yaml_tree.parse(text, "x")
    assert time.process_time() - begun < 0.2


# Faults: place, value, what is allowed, line


def test_a_start_that_is_no_mapping_tells_its_value() -> None:
    _, value, _, _ = only_fault_of(edited(LOOP, "open", "open\nstart: soon"))
    assert value == "soon"


def test_a_cycle_is_told_once_with_its_way_around() -> None:
    text = """\
links:
  - {name: a, m: 1, l: 1, r: 0, I: 0, from: c}
  - {name: b, m: 1, l: 1, r: 0, I: 0, from: a}
  - {name: c, m: 1, l: 1, r: 0, I: 0, from: b}
  - {name: d, m: 1, l: 1, r: 0, I: 0}
"""
    place, _, limit, line = only_fault_of(text)
    assert place == "links[0] (a).from"
    assert limit.endswith("a -> c -> b -> a")
    assert line == 2


def test_an_empty_link_lacks_every_key() -> None:
    assert [(place, limit) for place, _, limit, _ in faults_of("links: [{}]")] == [
        (f"links[0].{key}", "is missing") for key in ("name", "l")
    ]


def test_all_faults_are_told_at_once_in_the_order_of_the_file() -> None:
    text = """\
nam: rig
gravity: yes
links:
  - {name: a, m: -1, l: inf, r: [1, 2, 3], I: x}
  - {name: a, m: 1, l: 1, r: 0.5, I: 0.1, from: z, colour: red}
closures:
  - [a, q]
actuated: [w]
assembly: shut
start: {v: 1}
"""
    faults = faults_of(text)
    assert {(place, line) for place, _, _, line in faults} == {
        ("nam", 1),
        ("gravity", 2),
        ("links[0] (a).m", 4),
        ("links[0] (a).l", 4),
        ("links[0] (a).r", 4),
        ("links[0] (a).I", 4),
        ("links[1].name", 5),
        ("links[1] (a).colour", 5),
        ("links[1] (a).from", 5),
        ("closures[0][1]", 7),
        ("actuated[0]", 8),
        ("assembly", 9),
        ("start.v", 10),
    }
    lines = [line or 0 for *_, line in faults]
    assert lines == sorted(lines)


def test_a_long_value_is_shortened() -> None:
    place, value, limit, _ = only_fault_of(edited(ARM, "m: 1.5", f"m: {'9' * 5000}"))
    assert place == "links[0] (upper).m"
    assert "too large" in limit
    assert len(str(value)) <= 60


def test_a_message_holds_no_control_characters() -> None:
    """A name or a value of the file must not write to the terminal on its own account."""
    for text in (
        edited(ARM, "name: lower, m: 0.9", r'name: "lo\e[31mwer", m: -1'),
        edited(ARM, "name: lower, m: 0.9", r'name: "lo\nwer", m: -1'),
        edited(ARM, "m: 1.5", r'm: "\e[31m1"'),
        edited(ARM, "m: 1.5", r'm: 1.5, "\e[31mx": 1'),
    ):
        with pytest.raises(DescriptionError) as caught:
            from_text(text, "my.yaml")
        assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "change",
    [
        ("m: 1.5, l: 0.8", "m: 1e300, l: 1e300"),
        ("m: 1.5, l: 0.8, r: 0.36", "m: 1e200, l: 1, r: 1e100"),
        ("m: 1.5, l: 0.8, r: 0.36", "m: 1.5, l: 0.8, r: [1e200, 1e200]"),
        ("m: 1.5, l: 0.8", "m: 1.5, l: 1e200"),
        ("I: 0.031", "I: 0.031, from: {link: upper, at: [1e200, 1e308]}"),
        ("I: 0.031", "I: 0.031, from: [1e308, 1e308]"),
    ],
)
def test_numbers_whose_products_overflow_are_an_input_error(change: tuple[str, str]) -> None:
    with pytest.raises(InputError, match=r"my\.yaml.*too large"):
        build(from_text(edited(ARM, *change), "my.yaml"))


@pytest.mark.parametrize(
    "along", ["[3, 4]", "[0, -1e-300]", "[1.7e308, 1.7e308]", "[5e-324, 5e-324]", "[1e-200, 1]"]
)
def test_a_sliders_direction_is_a_unit_vector_or_refused(along: str) -> None:
    line = f"{{point: rocker, on: {{through: [0, 0], along: {along}}}}}"
    with refusal(DescriptionError):
        (closure,) = from_text(edited(LOOP, "[coupler, rocker]", line), "my.yaml").closures
        assert closure.along is not None
        assert abs(closure.along) == pytest.approx(1, abs=1e-15)


# Fuzz


def loads_or_is_refused(text: str) -> None:
    """Any text is a scene or a DescriptionError; what loads is finite and makes sense."""
    with refusal(DescriptionError):
        scene = from_text(text, "my.yaml")
        assert scene.links
        for link in scene.links:
            assert link.name
            assert min(link.m, link.l, link.I, link.payload, link.damping) >= 0
            assert all(map(math.isfinite, (link.m, link.l, abs(link.r), link.I)))
        with refusal(InputError):
            build(scene)


@contextmanager
def refusal(kind: type[InputError]) -> Iterator[None]:
    """An error of this very kind may be raised here, if it names the file."""
    error = None
    try:
        yield
    except kind as caught:
        error = caught
    assert error is None or (type(error) is kind and "my.yaml" in str(error))


PIECES = st.sampled_from(
    [
        *("", "-", ":", ",", "[", "]", "{", "}", "&a ", "*a", "!", "!!str ", "? ", "#", "'", '"'),
        *("\n", "  ", "---\n", "...\n", "<<: ", "|\n", ">\n", "%", "@", "`", "\t", "\0", "\ufeff"),
        *("nan", ".inf", "1e999", "1e300", "-1", "1e-3", "0", "yes", "null", "~", "[0, 0]", "[]"),
        *("{}", "[1, 2]", "plate", "left", "open", "from: left", "link", "at: [1, 2]", "start: "),
    ]
)


@st.composite
def mutations(draw: st.DrawFn) -> str:
    """A good scene with a few pieces cut out, doubled, swapped in or put in."""
    text = draw(st.sampled_from([ARM, LOOP, EVERYTHING]))
    for _ in range(draw(st.integers(1, 4))):
        begin = draw(st.integers(0, len(text)))
        end = min(len(text), begin + draw(st.integers(0, 12)))
        piece = draw(st.one_of(PIECES, st.just(text[begin:end] * 2), st.text(max_size=3)))
        text = text[:begin] + piece + text[end:]
    return text


@st.composite
def value_mutations(draw: st.DrawFn) -> str:
    """A good scene with some of its words exchanged for others."""
    parts = re.split(r"([\w.+-]+)", draw(st.sampled_from([ARM, LOOP, EVERYTHING])))
    words = st.one_of(PIECES, st.sampled_from(parts[1::2]))
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(parts) // 2 - 1))
        parts[2 * place + 1] = draw(words)
    return "".join(parts)


@settings(max_examples=300 if FRESH else 120, deadline=None)
@given(mutations())
def test_a_damaged_scene_loads_or_is_refused(text: str) -> None:
    loads_or_is_refused(text)


@settings(max_examples=300 if FRESH else 120, deadline=None)
@given(value_mutations())
def test_a_scene_with_wrong_words_loads_or_is_refused(text: str) -> None:
    loads_or_is_refused(text)


@settings(max_examples=200 if FRESH else 100, deadline=None)
@given(st.one_of(st.text(), st.text(alphabet="ab:-,[]{}&*!?#'\"\n |>%@`\t0")))
def test_any_text_is_refused_or_loads(text: str) -> None:
    loads_or_is_refused(text)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=60))
def test_any_bytes_are_refused(data: bytes) -> None:
    with tempfile.NamedTemporaryFile(suffix=".yaml") as file:
        file.write(data)
        file.flush()
        with pytest.raises(DescriptionError, match=file.name):
            read(file.name)


@pytest.mark.parametrize(
    "path",
    [
        *("errors.InputError", "errors.AssemblyError", "errors.SingularError"),
        *("trajectories.loop_path.PathEndError", "trajectories.loop_path.TravelError"),
        *("trajectories.time_scaling.LimitError", "engines.row_values.TableLeftError"),
        *("runs.accuracy.AccuracyError", "cli.simulate.UnfinishedError"),
    ],
)
def test_every_error_goes_to_another_process(path: str) -> None:
    """Whatever arguments its own `__init__` takes."""
    module, name = f"robodyn.{path}".rsplit(".", 1)
    kind = getattr(importlib.import_module(module), name)
    error = kind.__new__(kind)
    RobodynError.__init__(error, "q1", where="a.yaml", value=3.0, limit="must be < 2")
    error.add_place("row 3")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == "row 3: a.yaml: q1 = 3.0: must be < 2"


class TestManyFaults:
    """What is refused takes time by its length, and says no more than anyone reads."""

    LINKS = "links:\n" + "".join(
        f"  - {{name: link{k}, m: 1, l: 1, r: 0.5, I: 0.1, from: [0, 0]}}\n" for k in range(2000)
    )

    @pytest.mark.parametrize(
        "text",
        [
            LINKS.replace("from: [0, 0]", "from: a link that is not there"),
            LINKS.replace("from: [0, 0]", "frm: 1"),
            LINKS.replace("name: link", "name: same # "),
            LINKS + "actuated: [" + ", ".join(f"linx{k}" for k in range(2000)) + "]\n",
            LINKS + "start: {" + ", ".join(f"linx{k}: 1" for k in range(2000)) + "}\n",
            LINKS + "closures:\n" + "  - [linx, [0, 1]]\n" * 2000,
            LINKS + "couplings: [" + ", ".join(["q2 = q1"] * 8000) + "]\n",
        ],
        ids=["from", "key", "lines", "actuated", "start", "closures", "couplings"],
    )
    def test_of_many_names(self, text: str) -> None:
        with within(4.0), pytest.raises(DescriptionError) as caught:
            from_text(text, "many.yaml")
        told = str(caught.value).splitlines()
        assert len(told) <= MOST_FAULTS + 1
        if len(told) > MOST_FAULTS:
            assert told[-1] == f"many.yaml: there are more faults than these {MOST_FAULTS}"

    @pytest.mark.parametrize("text", ["links: []\n", "gravity: x\nlinks: 3\n", ""])
    def test_go_to_another_process(self, text: str) -> None:
        """A pool of processes hands an error on as a pickle."""
        with pytest.raises(DescriptionError) as caught:
            from_text(text, "faulty.yaml")
        error = caught.value
        error.add_note("row 3")
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
            again = pickle.loads(pickle.dumps(error, protocol))
            assert type(again) is DescriptionError
            assert (again.faults, again.__notes__) == (error.faults, ["row 3"])
            assert str(again) == str(error) != ""
        assert str(copy.deepcopy(error)) == str(error)

    def test_of_one_among_many(self) -> None:
        text = self.LINKS.replace("from: [0, 0]", "from: nowhere", 1)
        (place, value, limit, line) = faults_of(text)[0]
        assert (place, value, line) == ("links[0] (link0).from", "nowhere", 2)
        assert limit.startswith("names no link; known: link0, link1, link2, ")
        named = ", ".join(f"link{k}" for k in range(2000))
        found = faults_of(f"{self.LINKS}actuated: [{named}, link1]\n")
        assert [fault[:3] for fault in found] == [("actuated[2000]", "link1", "is named twice")]

    def test_a_long_name_is_not_told_in_full(self) -> None:
        text = ARM.replace("upper", "u" * 100_000).replace("m: 1.5", "m: x")
        with pytest.raises(DescriptionError) as caught:
            from_text(text, "long.yaml")
        assert len(str(caught.value)) < 3000
