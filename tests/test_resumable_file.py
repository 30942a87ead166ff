"""A file that goes on where it was cut off: at every byte."""

from pathlib import Path

import pytest

from robodyn.errors import InputError
from robodyn.sweeps.resumable_file import ResumableFile

HEADER = b"a,b\n"
LINES = [f"{k},{k * k}\n".encode() for k in range(7)]
FACTS = {"seed": 1, "scene": "x" * 100}
CHUNK = 3


def opened(path: Path, facts=FACTS) -> ResumableFile:
    return ResumableFile(str(path), HEADER, facts, len(LINES), CHUNK)


def write(file: ResumableFile) -> None:
    for chunk in range(file.done, 3):
        file.append(b"".join(LINES[chunk * CHUNK : (chunk + 1) * CHUNK]))
    file.finish()


def test_a_file_takes_its_place(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    with opened(path) as file:
        assert file.done == 0
        assert not path.exists()
        write(file)
    assert path.read_bytes() == HEADER + b"".join(LINES)
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.csv"]


def test_it_goes_on_from_any_byte(tmp_path: Path) -> None:
    path, whole = tmp_path / "out.csv", HEADER + b"".join(LINES)
    for cut in range(len(whole) + 1):
        with opened(path) as file:
            file.append(whole[len(HEADER) : max(cut, len(HEADER))])
        partial = path.with_name("out.csv.partial")
        partial.write_bytes(whole[:cut])
        with opened(path) as file:
            lines = whole[:cut].count(b"\n") - 1
            expected = 3 if lines == 7 else max(lines, 0) // CHUNK
            assert file.done == expected
            write(file)
        assert path.read_bytes() == whole
        assert not partial.exists()
        path.unlink()


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
        assert file.done == 0


def test_rows_of_unknown_origin_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.with_name("out.csv.partial").write_bytes(HEADER + LINES[0])
    with pytest.raises(InputError, match="is missing"):
        opened(path)


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
