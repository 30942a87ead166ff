"""A file that goes on where it was cut off: at every byte."""

import multiprocessing
import os
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import FRESH

from robodyn.errors import InputError, RobodynError
from robodyn.sweeps.resumable_file import ResumableFile

HEADER = b"a,b\n"
LINES = [f"{k},{k * k}\n".encode() for k in range(7)]
WHOLE = HEADER + b"".join(LINES)
FACTS = {"seed": 1, "scene": "x" * 100}
CHUNK = 3


def opened(path: Path, facts=FACTS) -> ResumableFile:
    return ResumableFile(str(path), HEADER, facts, len(LINES), CHUNK)


def chunk(number: int) -> bytes:
    return b"".join(LINES[number * CHUNK : (number + 1) * CHUNK])


def write(file: ResumableFile) -> None:
    for number in range(file.done, 3):
        file.append(chunk(number))
    file.finish()


def cut_off(path: Path) -> tuple[Path, Path, Path]:
    """All chunks are there, and the file has not taken its place: rows, facts, sums."""
    with opened(path) as file:
        for number in range(file.done, 3):
            file.append(chunk(number))
    rows, facts, sums = (path.with_name(f"out.csv.partial{end}") for end in ("", ".json", ".sums"))
    assert rows.read_bytes() == WHOLE
    return rows, facts, sums


def ends_whole(path: Path, done: int, doubted: bool) -> None:
    with opened(path) as file:
        assert (file.done, file.doubted) == (done, doubted)
        write(file)
    assert path.read_bytes() == WHOLE
    assert [entry.name for entry in path.parent.iterdir()] == ["out.csv"]


def test_a_file_takes_its_place(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    with opened(path) as file:
        assert file.done == 0
        assert not path.exists()
        write(file)
    assert path.read_bytes() == HEADER + b"".join(LINES)
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.csv"]


def test_it_goes_on_from_any_byte(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    ends = [len(HEADER + b"".join(LINES[:k])) for k in (3, 6, 7)]
    for cut in range(len(WHOLE) + 1):
        rows, _, _ = cut_off(path)
        rows.write_bytes(WHOLE[:cut])
        # of one without a whole header nothing is known
        ends_whole(path, sum(end <= cut for end in ends), cut < len(WHOLE))


def test_changed_rows_are_written_again(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    for place in range(len(HEADER), len(WHOLE)):
        rows, _, _ = cut_off(path)
        changed = bytearray(WHOLE)
        changed[place] ^= 1
        rows.write_bytes(changed)
        lines = WHOLE[:place].count(b"\n") - 1
        ends_whole(path, max(0, lines) // CHUNK, True)


def test_rows_too_many_or_in_another_place_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    for text, done in (
        (WHOLE + LINES[6], 3),
        (WHOLE + b"x", 3),
        (HEADER + LINES[0] + b"".join(LINES), 0),
        (HEADER + chunk(1) + chunk(0) + chunk(2), 0),
        (HEADER + chunk(0) + chunk(2), 1),
    ):
        rows, _, _ = cut_off(path)
        rows.write_bytes(text)
        ends_whole(path, done, True)


def test_changed_digests_are_of_no_use(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    _, _, sums = cut_off(path)
    good = sums.read_bytes()
    size = len(good) // 3
    for place in range(0, len(good), 5):
        cut_off(path)
        changed = bytearray(good)
        changed[place] ^= 1
        sums.write_bytes(changed)
        ends_whole(path, place // size, True)
    cut_off(path)
    sums.write_bytes(good[size : 2 * size] + good[:size] + good[2 * size :])
    ends_whole(path, 0, True)
    cut_off(path)
    sums.write_bytes(b"9" * 15 + good[15:])
    ends_whole(path, 0, True)


def test_digests_hold_for_these_facts_alone(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    _, facts, _ = cut_off(path)
    facts.write_text(facts.read_text().replace('"seed": 1', '"seed": 2'))
    with opened(path, FACTS | {"seed": 2}) as file:
        assert (file.done, file.doubted) == (0, True)


def test_other_facts_are_refused_and_shown(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    with opened(path) as file:
        file.append(LINES[0])
    with pytest.raises(InputError) as caught:
        opened(path, FACTS | {"seed": 2})
    for part in ("out.csv.partial", "there: seed 1", "here: seed 2"):
        assert part in str(caught.value)
    assert "scene" not in str(caught.value)
    with opened(path) as file:
        assert file.done == 1


def refused(path: Path, name: str, why: str) -> None:
    """The file is refused by its name, and none is changed, made or removed."""
    before = {entry: entry.lstat().st_ino for entry in path.parent.iterdir()}
    texts = {entry: entry.read_bytes() for entry in before if entry.is_file()}
    with pytest.raises(InputError, match=why) as caught:
        opened(path)
    assert str(caught.value).startswith(f"{path.with_name(name)}: is not of this sweep: ")
    assert {entry: entry.lstat().st_ino for entry in path.parent.iterdir()} == before
    assert {entry: entry.read_bytes() for entry in texts} == texts


@pytest.mark.parametrize("text", [HEADER + LINES[0], b"somebody's\n", b""])
def test_files_of_unknown_origin_are_refused(tmp_path: Path, text: bytes) -> None:
    """Whichever of the three names they have."""
    path = tmp_path / "out.csv"
    for end, why in (
        ("", "out.csv.partial.json, which tells what it is, is missing"),
        (".sums", "out.csv.partial.json, which tells what it is, is missing"),
        (".json", "is missing or damaged"),
    ):
        other = path.with_name(f"out.csv.partial{end}")
        other.write_bytes(text)
        if text or end != ".json":
            refused(path, other.name, why)
        other.unlink()


def test_files_of_another_origin_are_refused(tmp_path: Path) -> None:
    """Though what they depend on is there, as rows in their place by a run that failed are."""
    path = tmp_path / "out.csv"
    rows, _, sums = cut_off(path)
    for text in (b"t,q1\n0,1\n", b"b,a\n" + b"".join(LINES), b"\n"):
        rows.write_bytes(text)
        refused(path, "out.csv.partial", "it has another header")
    rows.write_bytes(WHOLE)
    digests = sums.read_bytes()
    sums.unlink()
    refused(path, "out.csv.partial", "out.csv.partial.sums, its digests, is missing")
    sums.write_bytes(digests)
    ends_whole(path, 3, False)


@pytest.mark.parametrize("end", ["", ".json", ".sums"])
def test_links_are_not_followed(tmp_path: Path, end: str) -> None:
    (tmp_path / "folder").mkdir()
    path, target = tmp_path / "folder" / "out.csv", tmp_path / "precious"
    link = path.with_name(f"out.csv.partial{end}")
    for precious in (None, b"", b"precious"):
        if precious is not None:
            target.write_bytes(precious)
        link.symlink_to(target)
        refused(path, link.name, "it is a link or no regular file")
        assert target.exists() == (precious is not None)
        assert not precious or target.read_bytes() == precious
        link.unlink()
    os.mkfifo(link)
    refused(path, link.name, "no regular file")


@pytest.mark.parametrize("end", ["", ".sums"])
def test_what_takes_the_place_of_a_file_is_not_renamed(tmp_path: Path, end: str) -> None:
    path = tmp_path / "out.csv"
    other = path.with_name(f"out.csv.partial{end}")
    for text in (b"t,q1\n0,1\n", None):
        with opened(path) as file:
            for number in range(3):
                file.append(chunk(number))
            other.unlink()
            if text is not None:
                other.write_bytes(text)
            with pytest.raises(RobodynError, match=r"out.csv.partial\S*: was removed or replaced"):
                file.finish()
        assert not path.exists()
        assert text is None or other.read_bytes() == text
        for entry in tmp_path.iterdir():
            entry.unlink()


def test_facts_of_another_sweep_that_has_no_rows_stay(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    rows, facts, sums = cut_off(path)
    rows.unlink()
    for _ in range(2):
        with pytest.raises(InputError, match=r"here: seed 2; remove it, \.json and"):
            opened(path, FACTS | {"seed": 2})
        sums.unlink(missing_ok=True)
    facts.unlink()
    with opened(path, FACTS | {"seed": 2}) as file:
        write(file)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"\xff",
        b"[]",
        b"[" * 100_000,
        b'{"seed":' * 100_000,
        b'{"seed": ' + b"[" * 900 + b"]" * 900 + b"}",
        b'{"seed": ' + b"9" * 10_000 + b"}",
    ],
    ids=["empty", "cut off", "no text", "list", "brackets", "braces", "deep", "long"],
)
def test_damaged_facts_are_refused_and_nothing_is_lost(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "out.csv"
    rows, facts, sums = cut_off(path)
    known, digests = facts.read_bytes(), sums.read_bytes()
    facts.write_bytes(text)
    with pytest.raises(InputError) as caught:
        opened(path)
    assert "out.csv.partial" in str(caught.value)
    assert len(str(caught.value)) < 1000
    assert rows.read_bytes() == WHOLE
    assert sums.read_bytes() == digests
    facts.write_bytes(known)
    ends_whole(path, 3, False)


def test_two_at_a_time_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    with opened(path) as file:
        file.append(LINES[0])
        with pytest.raises(InputError, match="another process"):
            opened(path)


def test_what_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        opened(tmp_path / "none" / "out.csv")


def test_an_older_file_keeps_its_mode_and_stays_until_the_end(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    path.chmod(0o640)
    with opened(path) as file:
        assert path.read_text() == "old"
        write(file)
    assert path.stat().st_mode & 0o777 == 0o640
    assert path.read_bytes().startswith(HEADER)


# Two at once


def test_of_many_pairs_that_begin_at_once_all_files_are_whole(tmp_path: Path) -> None:
    """The one of a pair is delayed against the other, so that they meet in every phase."""
    pairs = 600 if FRESH else 180
    context = multiprocessing.get_context("spawn")
    start, told = context.Barrier(2), context.Queue()
    both = [
        context.Process(target=_race, args=(tmp_path, pairs, 1e-4 * k, start, told)) for k in (0, 1)
    ]
    for process in both:
        process.start()
    ends = sorted(told.get(timeout=120) for _ in range(2 * pairs))
    for process in both:
        process.join(60)
    assert {end for _, end in ends} <= {"done", "another process is writing it"}
    for number in range(pairs):
        assert "done" in [end for _, end in ends[2 * number : 2 * number + 2]]
        assert (tmp_path / f"{number}.csv").read_bytes() == WHOLE
    assert len(list(tmp_path.iterdir())) == pairs


def _race(folder: Path, pairs: int, delay: float, start: Any, told: Any) -> None:
    for number in range(pairs):
        start.wait(60)
        end = time.perf_counter() + delay * (number % 60)
        while time.perf_counter() < end:
            pass
        try:
            with opened(folder / f"{number}.csv") as file:
                write(file)
            told.put((number, "done"))
        except InputError as error:
            told.put((number, error.limit))
        except OSError as error:
            told.put((number, repr(error)))
