"""The streamed tables: exact numbers, untouched text, prompt rows, faults with their line.

The oracles are Python's own `float`, `csv` and `json`.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import os
import random
import signal
import stat
import struct
import sys
import tracemalloc
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import BinaryIO, Literal, cast

import numpy as np
import pytest
from conftest import within
from hypothesis import given
from hypothesis import strategies as st
from named_case import case

from robodyn.errors import InputError, RobodynError
from robodyn.tables import numbers
from robodyn.tables.output_file import open_output
from robodyn.tables.table import LONGEST_ROW, READ_BYTES, Chunk, Reader
from robodyn.tables.table_writer import WRITERS, JsonWriter, Writer


class Pieces(io.RawIOBase):
    """A stream that gives the pieces that it was made of, one a read."""

    def __init__(self, pieces: Sequence[bytes]) -> None:
        self.pieces = list(pieces)

    def read1(self, size: int) -> bytes:
        return self.pieces.pop(0) if self.pieces else b""


def reader(data: bytes | Sequence[bytes], source: str = "states.csv") -> Reader:
    stream = io.BytesIO(data) if isinstance(data, bytes) else Pieces(data)
    return Reader(cast(BinaryIO, stream), source)


def table(data: bytes | Sequence[bytes], names: Sequence[str]) -> tuple[list[str], np.ndarray]:
    """All lines and all values of a table."""
    chunks = list(reader(data).chunks(names))
    lines = [line for chunk in chunks for line in chunk.lines]
    return lines, np.concatenate([np.empty((0, len(names)))] + [c.values for c in chunks])


def fault(data: bytes | Sequence[bytes], names: Sequence[str]) -> tuple[list[Chunk], InputError]:
    """The chunks before a fault, and the fault."""
    chunks = []
    with pytest.raises(InputError) as caught:  # noqa: PT012  the rows before it are the point
        for chunk in reader(data).chunks(names):
            chunks.append(chunk)
    return chunks, caught.value


def same_bits(a: object, b: object) -> bool:
    return np.asarray(a, dtype=float).tobytes() == np.asarray(b, dtype=float).tobytes()


# Reading


def test_columns_come_in_the_order_asked_for() -> None:
    source = reader(b"t, q1 ,q2\n0,1,2\n3,4,5\n")
    assert source.header == ("t", "q1", "q2")
    (chunk,) = source.chunks(["q2", "t"])
    assert chunk.lines == ["0,1,2", "3,4,5"]
    assert chunk.line_numbers[0] == 2
    assert list(chunk.line_numbers) == [2, 3]
    assert chunk.values.dtype == np.float64
    assert chunk.values.tolist() == [[2.0, 0.0], [5.0, 3.0]]


def test_no_column_asked_for() -> None:
    (chunk,) = reader(b"note\nabc\n\xc3\xa9\n").chunks([])
    assert chunk.lines == ["abc", "é"]
    assert chunk.values.shape == (2, 0)


def test_a_header_without_rows() -> None:
    for data in (b"t,q1", b"t,q1\n", b"\xef\xbb\xbft,q1\r\n\r\n"):
        source = reader(data)
        assert source.header == ("t", "q1")
        assert list(source.chunks(["q1"])) == []


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("last", [True, False])
def test_line_ends_and_byte_order_mark(end: bytes, bom: bytes, last: bool) -> None:
    data = bom + end.join([b"t,q", b"1,2", b"3,4"]) + (end if last else b"")
    for pieces in ([data], [data[i : i + 1] for i in range(len(data))]):
        lines, values = table(pieces, ["t", "q"])
        assert lines == ["1,2", "3,4"]
        assert values.tolist() == [[1, 2], [3, 4]]


def test_blank_lines_are_skipped_and_counted() -> None:
    source = reader(b"\n \nt,q\n\n1,2\n  \n\r\n3,4\n\n")
    (chunk,) = source.chunks(["q"])
    assert chunk.lines == ["1,2", "3,4"]
    assert list(chunk.line_numbers) == [5, 8]
    _, error = fault(b"t\n\n1\n\nx\n", ["t"])
    assert error.where == "states.csv: line 5"


def test_spaces_around_numbers_are_read_as_float_reads_them() -> None:
    lines, values = table(b"t,q\n 1 ,\t2\n3 , 4\n", ["t", "q"])
    assert lines == [" 1 ,\t2", "3 , 4"]
    assert values.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize("other", ["9", "text", '"quoted, text"'])  # the fast path and the slow
def test_numbers_equal_those_of_float(other: str) -> None:
    generator = random.Random(20)
    texts = ["-0.0", "0", "+1.5", "5e-324", "2.4703282292062327e-324", "2.4703282292062328e-324"]
    texts += ["1e308", "1.7976931348623157e308", "1.7976931348623158e+308", ".5", "5.", "1E5"]
    texts += ["9007199254740993", "0." + "0" * 400 + "123", "1" + "0" * 300, "1e-400", "00012"]
    texts += ["1.00000000000000011102230246251565404236316680908203125", "1.5e-00000005"]
    texts += ["1.00000000000000011102230246251565404236316680908203124"]
    texts += ["1.00000000000000011102230246251565404236316680908203126"]
    for _ in range(4000):
        (number,) = struct.unpack("d", generator.randbytes(8))
        if math.isfinite(number):
            texts += [repr(number), f"{number:.25g}", f"{number:.16e}", f"{number:.3g}"]
    for _ in range(2000):  # near the middle of two doubles, where rounding is hardest
        number = generator.uniform(0.5, 2)
        texts.append(f"{number + math.ulp(number) / 2:.17f}{generator.randrange(10**12)}")
    expected = [float(text) for text in texts]
    texts = [text for text, x in zip(texts, expected, strict=True) if math.isfinite(x)]
    data = "other,q\n" + "".join(f"{other},{text}\n" for text in texts)
    _, values = table(data.encode(), ["q"])
    assert same_bits(values[:, 0], [x for x in expected if math.isfinite(x)])


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1), st.integers(1, 4))
def test_floats_round_trip(numbers: list[float], width: int) -> None:
    rows = np.array((numbers * width)[: len(numbers) // width * width or width]).reshape(-1, width)
    out = io.BytesIO()
    names = [f"q{i}" for i in range(width)]
    Writer(out, names).write_columns(rows)
    lines, values = table(out.getvalue(), names)
    assert lines == [",".join(map(repr, row)) for row in rows.tolist()]
    assert same_bits(values, rows)


@given(st.text(st.sampled_from("0123456789.-+eE_xnaif \t,j()'"), max_size=8))
def test_a_field_is_a_number_where_float_says_so(text: str) -> None:
    fields = text.split(",")
    try:
        expected = [math.nan if "_" in field else float(field) for field in fields]
    except ValueError:
        expected = [math.nan]
    names = [f"q{i}" for i in range(len(fields) + 1)]
    data = f"{','.join(names)}\n0,{text}\n".encode()
    if all(map(math.isfinite, expected)):
        _, values = table(data, names[1:])
        assert same_bits(values[0], expected)
    else:
        fault(data, names[1:])


CELLS = st.text(st.sampled_from('ab,"\n\r 1é'), max_size=5)
TABLES = st.integers(1, 4).flatmap(
    lambda width: st.lists(st.tuples(*[CELLS] * width), min_size=1, max_size=6)
)


@given(TABLES, st.randoms(use_true_random=False), st.sampled_from(["\n", "\r\n"]), st.booleans())
def test_quoted_text_passes_untouched_in_any_pieces(
    rows: list[tuple[str, ...]], chance: random.Random, end: str, sparing: bool
) -> None:
    text = io.StringIO()
    quoting: Literal[0, 1] = csv.QUOTE_MINIMAL if sparing else csv.QUOTE_ALL
    if sparing:  # the csv module leaves a lone \r unquoted, and then cannot read it
        rows = [tuple(cell.replace("\r", "") for cell in row) for row in rows]
    output = csv.writer(text, lineterminator=end, quoting=quoting)
    names = [f"note {i}" for i in range(len(rows[0]))]
    output.writerows([[*names, "q"], *([*row, i] for i, row in enumerate(rows))])
    data = text.getvalue().encode()
    cuts = sorted(chance.choices(range(1, len(data)), k=chance.randrange(12)))
    pieces = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True) if b > a]
    source = reader(pieces)
    assert source.header == (*names, "q")
    chunks = list(source.chunks(["q"]))
    values = [value for chunk in chunks for value in chunk.values[:, 0].tolist()]
    assert values == list(range(len(rows)))
    lines = [line + end for chunk in chunks for line in chunk.lines]
    assert "".join(lines) == data.decode().split(end, 1)[1]
    starts = np.cumsum([2] + [line.count("\n") for line in lines])[:-1]
    assert [n for chunk in chunks for n in chunk.line_numbers] == starts.tolist()

    # With the json module and the csv module as oracles, what the writers make of the rows.
    for columns in (["tau"], ["q"], ["note 0", "tau"]):
        csv_out, json_out = io.BytesIO(), io.BytesIO()
        for writer in (
            Writer(csv_out, columns, source.header),
            JsonWriter(json_out, columns, source.header),
        ):
            for chunk in chunks:
                writer.write_rows(chunk.lines, np.full((len(chunk.lines), len(columns)), 0.5))
            writer.close()
        computed = dict.fromkeys(columns, "0.5")
        expected = [
            dict(zip(source.header, [*row, str(i)], strict=True)) | computed
            for i, row in enumerate(rows)
        ]
        written = io.StringIO(csv_out.getvalue().decode(), newline="")
        assert list(csv.DictReader(written, strict=True)) == expected
        objects = json.loads(json_out.getvalue())
        assert [list(item) for item in objects] == [list(item) for item in expected]
        for item, wanted in zip(objects, expected, strict=True):
            for name, value in item.items():
                number = isinstance(value, float | int)
                assert value == (float(wanted[name]) if number else wanted[name])


def test_numbers_may_be_quoted() -> None:
    lines, values = table(b'"t","q"\n"1.5","-2"\n3,"4"\n', ["t", "q"])
    assert lines == ['"1.5","-2"', '3,"4"']
    assert values.tolist() == [[1.5, -2], [3, 4]]


def test_a_quote_inside_of_a_plain_field_is_text() -> None:
    lines, values = table(b'note,q\n5" arm,1\n6" "arm",2\n', ["q"])
    assert lines == ['5" arm,1', '6" "arm",2']
    assert values.tolist() == [[1], [2]]


def test_a_quoted_comma_does_not_stand_for_a_missing_field() -> None:
    chunks, error = fault(b'note,q,x\na,1,2\n"b,3",4\n', ["x"])
    assert [chunk.lines for chunk in chunks] == [["a,1,2"]]
    assert (error.what, error.value) == ("number of fields", 2)


def test_quoted_rows_may_span_reads() -> None:
    note = "long text\n" * (READ_BYTES // 20)
    data = "note,q\n" + "".join(f'"{note}",{i}\n' for i in range(5))
    lines, values = table(data.encode(), ["q"])
    assert values[:, 0].tolist() == list(range(5))
    assert lines == [f'"{note}",{i}' for i in range(5)]


def test_long_tables_come_in_chunks_with_their_line_numbers() -> None:
    numbers = np.random.default_rng(3).normal(size=(20_000, 3))
    rows = [",".join(map(repr, row)) + "\n" for row in numbers.tolist()]
    data = "".join(["t,q1,q2\n", *rows]).encode()
    chunks = list(reader(data).chunks(["t", "q1", "q2"]))
    assert len(chunks) > 2
    assert same_bits(np.concatenate([chunk.values for chunk in chunks]), numbers)
    starts = np.cumsum([2] + [len(chunk.lines) for chunk in chunks])[:-1]
    assert [chunk.line_numbers[0] for chunk in chunks] == starts.tolist()


def test_rows_are_there_as_soon_as_they_are_written() -> None:
    source, sink = os.pipe()
    with open(source, "rb") as stream, open(sink, "wb", buffering=0) as producer:
        producer.write(b"t,q\n1,2\n3,")
        table_in = Reader(stream, "-")  # returns while the pipe is open
        chunks = table_in.chunks(["t", "q"])
        assert next(chunks).lines == ["1,2"]
        producer.write(b'4\n"5')
        assert next(chunks).lines == ["3,4"]
        producer.write(b'","6"\n"7",8\n9')
        assert next(chunks).values.tolist() == [[5, 6], [7, 8]]
        producer.write(b",10")
        producer.close()
        last = next(chunks)
        assert (last.line_numbers[0], last.values.tolist()) == (6, [[9, 10]])
        assert next(chunks, None) is None


def test_unbuffered_streams_will_do(tmp_path: Path) -> None:
    path = tmp_path / "states.csv"
    path.write_bytes(b"q\n1\n")
    with open(path, "rb", buffering=0) as stream:
        (chunk,) = Reader(cast(BinaryIO, stream), str(path)).chunks(["q"])
    assert chunk.values.tolist() == [[1.0]]


def test_memory_does_not_grow_with_the_table() -> None:
    row = b",".join([b"-0.12345678901234567"] * 7) + b"\n"
    pieces = [b"a,b,c,d,e,f,g\n", *[row * 3000] * 20]
    with open(os.devnull, "wb") as discard:
        tracemalloc.start()
        try:
            source = reader(pieces)
            writer = Writer(discard, ["tau"], source.header)
            for chunk in source.chunks(["a", "g"]):
                writer.write_rows(chunk.lines, chunk.values[:, :1])
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert peak < 8 * len(pieces[1])  # of a table of 20


# Faults of the input


@pytest.mark.parametrize("data", [b"", b"\n", b"\r\n  \n", b"\xef\xbb\xbf", b"\xef\xbb\xbf\n"])
def test_empty_input(data: bytes) -> None:
    with pytest.raises(InputError, match=r"^stdin: the input is empty: .* t,q1,q2$"):
        reader(data, "stdin")


def test_missing_columns() -> None:
    source = reader(b"t,q1,qd1\n0,0,0\n")
    with pytest.raises(InputError) as caught:
        source.chunks(["q1", "q2"])  # at once, not at the first row
    assert str(caught.value) == "states.csv: column q2 is missing: the header has t, q1, qd1"
    with pytest.raises(InputError, match="column q2, qd2 is missing"):
        source.chunks(["q2", "qd2"])
    assert len(list(source.chunks(["q1", "t"]))) == 1


def test_a_column_twice() -> None:
    for header in (b"t,q1, t", b't,"q1","q1 "'):
        with pytest.raises(InputError, match=r"line 2: column = (t|q1): .*twice"):
            reader(b"\n" + header + b"\n")
    with pytest.raises(InputError, match=r"column = '': .*twice"):
        reader(b"t,,q,\n")
    assert reader(b",q\n").header == ("", "q")


BAD_FIELDS = ["nan", "-NaN", "inf", "-Infinity", "1e400", "1_0", "abc", "0x10", "1 2", "30deg"]
BAD_FIELDS += ["\u0661\u0662", "\uff11", "-\u0967.5", "\u00b2"]  # digits of other scripts


def test_a_field_that_is_not_a_finite_number() -> None:
    for text in BAD_FIELDS:
        for note in ["text", '"a\nb"']:
            with case(text, note):
                rows = [f"1,{note},2", f"3,{note},4", f"5,{note},{text}", f"7,{note},8"]
                chunks, error = fault("\n".join(["t,note,q", *rows]).encode(), ["q", "t"])
                (chunk,) = chunks  # the good rows of the chunk come first
                assert chunk.lines == rows[:2]
                assert chunk.values.tolist() == [[2, 1], [4, 3]]
                assert error.where == f"states.csv: line {4 if note == 'text' else 6}"
                assert (error.what, error.value) == ("q", text)
                assert "finite number" in error.limit
                assert error.exit_code == 2


def test_a_field_that_nobody_needs_may_be_anything() -> None:
    lines, values = table(b"t,q\nnan,1\n,2\n", ["q"])
    assert lines == ["nan,1", ",2"]
    assert values.tolist() == [[1], [2]]


def test_an_empty_field() -> None:
    _, error = fault(b"t,q\n1,\n", ["q"])
    assert str(error) == "states.csv: line 2: q: the field is empty, not a finite number"


def test_a_long_or_unprintable_field_is_shown_fit_for_a_terminal() -> None:
    _, error = fault(b"t,q\n1,\x1b[2J" + b"x" * 100_000, ["q"])
    assert "\x1b" not in str(error)
    assert len(str(error)) < 400


@pytest.mark.parametrize(("row", "count"), [("1", 1), ("1,2", 2), ("1,2,3,", 4), ("1;2;3", 1)])
def test_a_wrong_number_of_fields(row: str, count: int) -> None:
    for names in (["a", "b", "c"], ["a"], []):
        chunks, error = fault(f"a,b,c\n1,2,3\n{row}\n1,2,3\n".encode(), names)
        assert [chunk.lines for chunk in chunks] == [["1,2,3"]]
        assert str(error) == f"states.csv: line 3: number of fields = {count}: the header has 3"


def test_rows_of_unequal_lengths_that_even_out() -> None:
    _, error = fault(b"a,b\n1\n1,2,3\n", ["a"])
    assert error.where == "states.csv: line 2"


def test_only_the_first_fault_of_a_chunk_is_told() -> None:
    chunks, error = fault(b"a,b\n1,2\nx,2\n1\n\xff\n", ["a"])
    assert [chunk.lines for chunk in chunks] == [["1,2"]]
    assert (error.where, error.value) == ("states.csv: line 3", "x")


def test_after_a_fault_there_is_nothing() -> None:
    chunks = reader(b"a\n1\nx\n2\n").chunks(["a"])
    next(chunks)
    with pytest.raises(InputError):
        next(chunks)
    assert next(chunks, None) is None


def test_text_that_is_not_utf8() -> None:
    for bad in [b"\xff", b"\xc3", b"\xed\xa0\x80", b"caf\xe9"]:
        for note in [b"x", b'"x"', "é".encode()]:
            with case(bad, note):
                data = b"\xef\xbb\xbfnote,q\n\n" + note + b",1\n" + bad + b",2\n" + note + b",3\n"
                for pieces in ([data], [data[i : i + 1] for i in range(len(data))]):
                    chunks, error = fault(pieces, ["q"])
                    assert [value for chunk in chunks for value in chunk.values.tolist()] == [[1.0]]
                    assert error.where == "states.csv: line 4"
                    assert "UTF-8" in error.limit
                with pytest.raises(InputError, match=r"states.csv: line 1: byte = 0xff: .*UTF-8"):
                    reader(b"\xfft\n1\n")


@pytest.mark.parametrize("row", [b'"a"b,2', b'"a" ,2', b'1,"2"3', b'"a""b"c,2'])
def test_text_after_a_closing_quote(row: bytes) -> None:
    chunks, error = fault(b"note,q\nx,1\n" + row + b"\n", ["q"])
    assert [chunk.lines for chunk in chunks] == [["x,1"]]
    assert str(error) == "states.csv: line 3: bad quoting: a closing quote must end its field"


def test_a_quote_that_is_never_closed() -> None:
    chunks, error = fault(b'note,q\nx,1\n"a,2\nb,3\n', ["q"])
    assert [chunk.lines for chunk in chunks] == [["x,1"]]
    assert error.where == "states.csv: line 3"
    assert "quote left open" in error.limit


LINES = b'a, ""b"" c\n' * 40_000


def test_a_quoted_field_of_many_lines_takes_time_by_its_length() -> None:
    pieces = [b'note,q\n"', *LINES.splitlines(keepends=True), b'",1\n']
    for data in (b"".join(pieces), pieces):
        with within(5.0):
            lines, values = table(data, ["q"])
        assert lines == ['"' + LINES.decode() + '",1']
        assert values.tolist() == [[1.0]]


def test_a_quote_left_open_takes_time_by_what_follows() -> None:
    pieces = [b'note,q\n"', *(3 * LINES).splitlines(keepends=True)]
    for data in (b"".join(pieces), pieces):
        with within(5.0):
            _, error = fault(data, ["q"])
        assert "quote left open" in error.limit


def test_many_columns_take_time_by_their_number() -> None:
    names = [f"c{k}" for k in range(60_000)]
    row = ",".join(["1"] * len(names))
    header = ",".join(names)
    with within(5.0):
        lines, _ = table(f"{header}\n{row}\n".encode(), names[-3:])
        assert lines == [row]
        with pytest.raises(InputError, match="column = c7: the name occurs twice"):
            reader(f"{header},c7\n".encode())
        _, error = fault(f"{header}\n{row}\n".encode(), ["q1"])
    assert len(str(error)) < 2000


@pytest.mark.parametrize("start", [b"t", b't\n1\n"'])
def test_a_row_that_never_ends_is_refused_before_it_fills_the_memory(start: bytes) -> None:
    class Endless(io.RawIOBase):
        given = 0

        def read1(self, size: int) -> bytes:
            self.given += size
            assert self.given < 4 * LONGEST_ROW
            return start if self.given == size else b"x" * (size - 1) + start[1:2]

    with pytest.raises(InputError, match="the row does not end"):
        list(Reader(cast(BinaryIO, Endless()), "/dev/zero").chunks(["t"]))


# Writing


def written(kind: str, columns: Sequence[str], header: Sequence[str], rows: list[str]) -> str:
    out = io.BytesIO()
    writer = WRITERS[kind](out, columns, header)
    values = np.arange(1.0, 1 + len(rows) * len(columns)).reshape(len(rows), len(columns))
    writer.write_rows(rows, values)
    writer.close()
    return out.getvalue().decode()


def test_csv_columns_alone() -> None:
    out = io.BytesIO()
    writer = Writer(out, ["t", 'a "b", c'])
    assert out.getvalue() == b't,"a ""b"", c"\n'  # the header does not wait for rows
    writer.write_columns(np.array([[0.0, -0.0], [0.1, 1e22], [5e-324, -1e-5]]))
    writer.write_columns(np.empty((0, 2)))
    writer.write_columns(np.array([[math.nan, -math.inf]]))
    writer.close()
    rows = "0.0,-0.0\n0.1,1e+22\n5e-324,-1e-05\n,-inf\n"  # nan is an empty field
    assert out.getvalue().decode() == 't,"a ""b"", c"\n' + rows
    assert not out.closed


def test_csv_appends_to_rows_as_they_are() -> None:
    text = written("csv", ["tau1", "tau2"], ["q", "note"], ["007, x", '1,"a,\n""b"""', " 2 ,é"])
    rows = '007, x,1.0,2.0\n1,"a,\n""b""",3.0,4.0\n 2 ,é,5.0,6.0\n'
    assert text == "q,note,tau1,tau2\n" + rows


def test_csv_replaces_columns_in_place() -> None:
    header = ["q", "tau2", "note"]
    text = written("csv", ["tau1", "tau2", "x"], header, ["07,9,n", '" 1","a,b","c""d,"', ",,"])
    rows = '07,2.0,n,1.0,3.0\n" 1",5.0,"c""d,",4.0,6.0\n,8.0,,7.0,9.0\n'
    assert text == "q,tau2,note,tau1,x\n" + rows


def test_a_table_run_through_twice_is_the_same() -> None:
    first = written("csv", ["tau"], ["q"], ["1", "2"])
    header, *rows = first.splitlines()
    assert written("csv", ["tau"], header.split(","), rows) == first


def test_json_objects() -> None:
    rows = ['9,"a,""b""",x', "9,007,-1.5e3", "9,1e400,"]
    text = written("json", ["tau", "q"], ["q", "n%", "é"], rows)
    assert text.splitlines() == [
        "[",
        '{"q": 2.0, "n%": "a,\\"b\\"", "é": "x", "tau": 1.0},',
        '{"q": 4.0, "n%": 7.0, "é": -1.5e3, "tau": 3.0},',
        '{"q": 6.0, "n%": "1e400", "é": "", "tau": 5.0}',
        "]",
    ]
    assert text.endswith("\n]\n")
    assert len(json.loads(text)) == 3


JSON_VALUES_OF_THE_INPUT = [
    ("+1", 1.0),
    (".5", 0.5),
    ("5.", 5.0),
    (" 1", 1.0),
    ("12345678901234567890", 12345678901234567890),
    *((text, text) for text in ("1_0", "nan", "inf", "true", "1e999")),
]


def test_json_values_of_the_input() -> None:
    for text, value in JSON_VALUES_OF_THE_INPUT:
        with case(text, value):
            (item,) = json.loads(written("json", ["tau"], ["x"], [text]))
            assert item["x"] == value


def test_json_columns_alone() -> None:
    out = io.BytesIO()
    writer = JsonWriter(out, ["t", "x"])
    writer.write_columns(np.empty((0, 2)))
    writer.write_columns(np.array([[0.1, -0.0]]))
    writer.write_columns(np.array([[1e22, math.nan], [math.inf, -math.inf]]))
    writer.close()
    rows = ['{"t": 0.1, "x": -0.0}', '{"t": 1e+22, "x": null}', '{"t": null, "x": null}']
    assert out.getvalue().decode() == "[\n" + ",\n".join(rows) + "\n]\n"


def test_one_row_of_numbers_and_text() -> None:
    rows: list[list[float | str]] = [[0.1, "open"], [np.float64(-0.0), 'a "b", c'], [math.nan, ""]]
    outs = {}
    for kind in ("csv", "json"):
        outs[kind] = io.BytesIO()
        writer = WRITERS[kind](outs[kind], ["x", "branch"])
        for row in rows:
            writer.write_row(row)
        writer.close()
    assert outs["csv"].getvalue() == b'x,branch\n0.1,open\n-0.0,"a ""b"", c"\nnan,\n'
    expected = [{"x": 0.1, "branch": "open"}, {"x": -0.0, "branch": 'a "b", c'}]
    assert json.loads(outs["json"].getvalue()) == [*expected, {"x": None, "branch": ""}]


def test_json_without_rows() -> None:
    out = io.BytesIO()
    JsonWriter(out, ["t"]).close()
    assert out.getvalue() == b"[\n]\n"


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_each_chunk_is_flushed(kind: str) -> None:
    raw = io.BytesIO()
    stream = io.BufferedWriter(cast(io.RawIOBase, raw), buffer_size=1 << 16)
    writer = WRITERS[kind](cast(BinaryIO, stream), ["t"], ["q"])
    size = len(raw.getvalue())
    assert size > 0
    writer.write_rows(["1"], np.array([[2.0]]))
    assert len(raw.getvalue()) > size


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_values_of_another_shape_are_a_programming_error(kind: str) -> None:
    writer = WRITERS[kind](io.BytesIO(), ["t"], ["q"])
    for values in (np.zeros((1, 2)), np.zeros(1), np.zeros((2, 1))):
        with pytest.raises(ValueError):  # noqa: PT011  zip's text is not ours
            writer.write_rows(["1"], values)


# Output files


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_an_output_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    with open_output(path) as stream:
        stream.write(b"new")
        stream.flush()
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert stream.closed
    assert names_in(tmp_path) == ["out.csv"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, BrokenPipeError])
@pytest.mark.parametrize("old", [True, False])
def test_an_output_file_that_fails_leaves_no_trace(
    tmp_path: Path, error: type[BaseException], old: bool
) -> None:
    path = tmp_path / "out.csv"
    if old:
        path.write_text("old")
    with pytest.raises(error), open_output(str(path)) as stream:  # noqa: PT012  the block is it
        stream.write(b"half")
        raise error
    assert stream.closed
    assert names_in(tmp_path) == ["out.csv"] * old
    assert not old or path.read_text() == "old"


def test_a_part_that_is_kept_takes_the_first_free_name(tmp_path: Path) -> None:
    """What is there, as links that lead nowhere and folders, stays."""
    path, told = tmp_path / "out.csv", list[str]()
    path.write_text("old")
    (tmp_path / "out.csv.partial").write_text("")
    (tmp_path / "out.csv.partial.1").symlink_to(tmp_path / "nowhere")
    (tmp_path / "out.csv.partial.2").mkdir()
    for text in (b"half", b"third", b""):
        with pytest.raises(KeyboardInterrupt), open_output(path, told.append) as stream:  # noqa: PT012
            stream.write(text)
            raise KeyboardInterrupt
    kept = [tmp_path / f"out.csv.partial.{k}" for k in (3, 4)]
    assert told == list(map(str, kept))
    assert [name.read_text() for name in (path, *kept)] == ["old", "half", "third"]
    assert (tmp_path / "out.csv.partial").read_text() == ""
    assert not (tmp_path / "nowhere").exists()
    assert len(names_in(tmp_path)) == 6


@pytest.mark.parametrize("fails", [True, False])
def test_what_takes_the_place_of_what_was_written_is_not_renamed(
    tmp_path: Path, fails: bool
) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    with (  # noqa: PT012
        pytest.raises(RobodynError, match="was removed or replaced"),
        open_output(path, lambda name: None) as stream,
    ):
        stream.write(b"new")
        (temporary,) = set(tmp_path.iterdir()) - {path}
        temporary.unlink()
        temporary.write_text("other")
        if fails:
            raise ValueError
    assert path.read_text() == "old"


def test_permissions_of_output_files(tmp_path: Path) -> None:
    new, kept = tmp_path / "new.csv", tmp_path / "kept.csv"
    kept.write_text("old")
    kept.chmod(0o604)
    before = os.umask(0o027)
    try:
        for path in (new, kept):
            with open_output(path):
                pass
    finally:
        os.umask(before)
    assert stat.S_IMODE(new.stat().st_mode) == 0o640
    assert stat.S_IMODE(kept.stat().st_mode) == 0o604


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    target, link = tmp_path / "target.csv", tmp_path / "link.csv"
    target.write_text("old")
    link.symlink_to(target)
    with open_output(link) as stream:
        stream.write(b"new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_devices_and_pipes_are_not_replaced(tmp_path: Path) -> None:
    with open_output(os.devnull) as stream:
        stream.write(b"gone")
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)
    source, sink = os.pipe()
    with open(source, "rb") as received, open(sink, "wb"):
        with open_output(f"/dev/fd/{sink}") as stream:  # as in  robodyn ... -o >(wc)
            stream.write(b"row\n")
        assert received.readline() == b"row\n"


def test_outputs_that_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    paths: list[str | Path] = ["", tmp_path, f"{tmp_path}/new/"]
    paths += [tmp_path / folder / "out.csv" for folder in ("missing", "file")]
    for path in paths:
        with pytest.raises(InputError, match="cannot be written") as caught, open_output(path):
            pytest.fail("opened")
        assert caught.value.where == str(path)
    assert names_in(tmp_path) == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write read-only files")
def test_a_read_only_file_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    path.chmod(0o444)
    with pytest.raises(InputError, match="permission denied"), open_output(path):
        pytest.fail("opened")
    assert path.read_text() == "old"


@pytest.mark.parametrize("path", [None, "-", Path("-")])
def test_standard_output(path: str | Path | None, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    buffered = io.BufferedWriter(cast(io.RawIOBase, raw))
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(buffered))
    with open_output(path) as stream:
        stream.write(b"row\n")
    assert raw.getvalue() == b"row\n"
    assert not stream.closed


def test_a_whole_command(tmp_path: Path) -> None:
    path = tmp_path / "states.csv"
    path.write_bytes(b"t,q,note\n0,1,a\n1,2,b\n")
    for _ in range(2):  # the output is the input of the second run
        with contextlib.ExitStack() as stack:
            source = Reader(stack.enter_context(open(path, "rb")), str(path))
            chunks = source.chunks(["q"])
            writer = Writer(stack.enter_context(open_output(path)), ["tau"], source.header)
            for chunk in chunks:
                writer.write_rows(chunk.lines, 2 * chunk.values)
            writer.close()
        assert path.read_text() == "t,q,note,tau\n0,1,a,2.0\n1,2,b,4.0\n"


def halfway(x: float) -> str:
    """The decimal in the middle between a float and the next, all its digits."""
    return format((Decimal(x) + Decimal(math.nextafter(x, math.inf))) / 2, "f")


ODD = [
    *("1", "1.0.0,2", "1.0,.", "1.0,-.", "1.-0,2.0", "--1.0,2.0", "1.0,2.0,3.0", "1.0,"),
    *("1.0,nan", "1.0,inf", "1.0,true", "1.0,null", "1.0,[2.0", "1.0],[2.0", "1.0,1e400"),
]


@pytest.fixture
def by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Numbers by orjson, or as if it were not installed; of however few."""
    monkeypatch.setattr(numbers, "FEW", 0)
    if request.param == "numpy":
        monkeypatch.setattr(numbers, "_orjson", lambda: None)
    else:
        pytest.importorskip("orjson", reason="of the extra `fast`")
    return str(request.param)


by_both = pytest.mark.parametrize("by", ["orjson", "numpy"], indirect=True)


@by_both
@pytest.mark.usefixtures("by")
class TestReadNumbers:
    def test_each_is_what_float_makes_of_it(self) -> None:
        rng = random.Random(1)
        texts = [
            *("-0", "-0.0", "0", "-0e5", "1e5", "1E5", "1e-05", "5e-324", "1.7976931348623157e308"),
            *("12345678901234567890", "123456789012345678901234567890", "9007199254740993"),
            *("0.1", "-1.5707963267948966", "2.5e-310", "1e+16", "18446744073709551616.5"),
            *(repr(rng.uniform(-3, 3)) for _ in range(2000)),
            *(repr(struct.unpack("<d", rng.randbytes(8))[0]) for _ in range(2000)),
            *(halfway(rng.uniform(1e-3, 1e6)) for _ in range(500)),
            *(f"{rng.uniform(-9, 9):.{rng.randrange(20)}f}" for _ in range(2000)),
        ]
        texts = [text for text in texts if math.isfinite(float(text))]
        for chosen in (texts, ["+1", *texts], [".5", "5.", "01", *texts]):
            found = numbers.read([f"{text},1.5" for text in chosen], 2, [1, 0])
            assert found is not None
            expected = np.array([[1.5, float(text)] for text in chosen])
            assert found.tobytes() == expected.tobytes()

    def test_a_sign_of_zero_stays(self) -> None:
        for text in ("-0", "1,-0", "-0,1", "-0.0", "2,-0e3"):
            width = text.count(",") + 1
            found = numbers.read([text] * 3, width, range(width))
            expected = [[float(x) for x in text.split(",")]] * 3
            assert found is not None
            assert found.tobytes() == np.array(expected).tobytes()

    def test_other_lines_are_none(self) -> None:
        for line in ODD:
            for sound in (0, 1):
                with case(line, sound):
                    assert numbers.read(["1.0,-2.0"] * sound + [line], 2, [0, 1]) is None
                    assert numbers.read([line] + ["1.0,-2.0"] * sound, 2, [0, 1]) is None
        assert numbers.read(["1.0,2.0,3.0", "4.0"], 2, [0, 1]) is None

    def test_text_beside_the_numbers_passes(self) -> None:
        rows = ["a,1.5", "b c,2.5", ",3.5"]
        found = numbers.read(rows, 2, [1])
        assert found is not None
        assert found.tolist() == [[1.5], [2.5], [3.5]]


@pytest.mark.skipif(not hasattr(signal, "SIGUSR1"), reason="there is no such signal here")
def test_a_signal_waits_for_the_end_of_an_import() -> None:
    """An exception of its handler would end a process that imports orjson by a fault."""
    passed = []

    def raises(*_: object) -> None:
        raise InterruptedError

    before = signal.signal(signal.SIGUSR1, raises)
    try:
        with pytest.raises(InterruptedError), numbers._signals_wait():  # noqa: PT012
            signal.raise_signal(signal.SIGUSR1)
            passed.append("all of the block")
        assert passed
        assert signal.getsignal(signal.SIGUSR1) is raises
    finally:
        signal.signal(signal.SIGUSR1, before)


# Floats as text: the same characters as `repr`, whatever the floats are.


RNG = np.random.default_rng(0)
COUNT = 60_000


def assert_same(values: np.ndarray) -> None:
    found = numbers.written(values)
    wanted = [",".join(map(repr, row)) for row in values.tolist()]
    assert len(found) == len(wanted)
    assert [pair for pair in zip(found, wanted, strict=True) if len(set(pair)) > 1][:5] == []


@by_both
@pytest.mark.usefixtures("by")
class TestWrittenNumbers:
    @pytest.mark.parametrize("columns", [1, 3, 12])
    def test_numbers_of_any_length(self, columns: int) -> None:
        assert_same(RNG.uniform(-3.0, 3.0, (COUNT // columns, columns)))

    def test_a_million_of_every_size(self) -> None:
        size = 10.0 ** RNG.uniform(-12.0, 18.0, (250_000, 1))
        assert_same(size * [1.0, -1.0])
        bits = RNG.integers(0, 2**64, (500_000, 1), dtype=np.uint64)
        assert_same(bits.view(float))

    def test_numbers_of_few_digits_and_their_neighbours(self) -> None:
        for digits in range(1, 17):
            whole = RNG.integers(-(10**digits), 10**digits, (3000, 1))
            few = whole / 10.0 ** RNG.integers(0, digits + 3, (3000, 1))
            assert_same(np.hstack([few, np.nextafter(few, np.inf), np.nextafter(few, -np.inf)]))

    def test_binary_fractions_and_ties(self) -> None:
        assert_same(RNG.integers(-(2**53), 2**53, (COUNT, 1)) / 2.0 ** np.arange(40, 56, 3))
        assert_same(RNG.integers(-(10**6), 10**6, (COUNT, 1)) / 2.0 ** np.arange(0, 20, 4))

    def test_powers_of_two_and_ten_and_their_neighbours(self) -> None:
        powers = np.concatenate(
            [2.0 ** np.arange(-1074, 1024), [float(f"1e{k}") for k in range(-30, 30)]]
        )
        sides = [powers, np.nextafter(powers, 0.0), np.nextafter(powers, np.inf)]
        assert_same(np.stack([*sides, -powers], axis=-1))

    def test_what_is_no_number_and_zeros(self) -> None:
        odd = [0.0, -0.0, np.nan, np.inf, -np.inf, 5e-324, 1e16, 1e-4, 1e-10, 9e-5, 1e22]
        assert_same(np.array([odd]))
        assert_same(np.array(odd)[:, None])
        assert_same(np.zeros((7, 2)))

    def test_a_view_is_read_in_its_own_order(self) -> None:
        table = RNG.uniform(-3.0, 3.0, (40, 30))
        assert_same(table.T)
        assert_same(table[::-2, 3::4])
