"""CSV is read and written in blocks: where they end changes nothing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shapefit.io import landmark_writer, read_results, sources
from shapefit.io.csv import text as csv_sections
from shapefit.io.csv import writing as csv_writing
from shapefit.io.csv.text import Section, read_numbers, read_rows, split_columns
from shapefit.io.records import LandmarkSet
from tests.io.files import save

VIEWS = """\
item,landmark,x,y,confidence,sequence
a,head,1,2,0.5,s
"a ""b""
c",foot,3.5,-4e-1,1,s

é,foot,,nan,0,"t,
u"
a,foot,5,6,1,s
"""

SIZES = [1, 2, 3, 5, 7, 11, 23, 64, 150, 1000]


@pytest.fixture(params=SIZES)
def small_blocks(request, monkeypatch):
    monkeypatch.setattr(sources, "BLOCK_BYTES", request.param)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_blocks_may_end_anywhere(csv, read_views, small_blocks, end):
    views = read_views(csv(VIEWS.replace("\n", end)))
    assert views.items == ("a", f'a "b"{end}c', "é")
    assert views.landmark_names == ("head", "foot")
    assert views.sequences == ("s", "s", f"t,{end}u")
    nan = np.nan
    expected = [[[1, 5], [2, 6]], [[nan, 3.5], [nan, -0.4]], [[nan, nan], [nan, nan]]]
    np.testing.assert_array_equal(views.landmarks, expected)
    np.testing.assert_array_equal(views.confidence, [[0.5, 1], [0, 1], [0, 0]])


def test_lines_are_counted_over_blocks(csv, problems, read_views, small_blocks):
    path = csv(VIEWS + "a,head,1,2,-1,s\nb,head,?,2,1,s\nb,foot,1,2,1,t\n")
    told = [line.removeprefix(f"{path}:") for line in problems(read_views, path)]
    assert [line.partition(";")[0] for line in told] == [
        "9: item 'a', landmark 'head' is also on line 2",
        "9: confidence is '-1'",
        "10: x is '?'",
        "11: sequence is 't'",
    ]


@pytest.mark.parametrize(
    ("rows", "line", "found"),
    [
        ("\na,h,1,2\nb,h,1\nc,h,1,2,3\n", 4, "has 3 cells for 4 columns"),
        ("a,h,1,2\nb,h,1\nc,h,1,2,3\n", 3, "has 3 cells for 4 columns"),
        ("a,h,1,2\nb,h,1,2,3\nc,h,1\n", 3, "has 5 cells for 4 columns"),
        ("a,h,1,2\nb,h,1,2\rc,h,1,2\n", 3, "a line ends in CR alone, others in LF"),
        ("a,h,1,2\nb,\0,1,2\n", 3, "is not text (a zero byte)"),
        ('a,h,1,2\nb,5" nail,1,2\nc,h,1,2\n', 3, "cannot be read as CSV"),
        ('a,h,1,2\nb,"h"h,1,2\nc,h,1,2\n', 3, "a bad cell"),
        ('a,h,1,2\nb,h,1,"2\n', 3, "a quote is never closed"),
    ],
)
def test_faults_are_found_in_all_blocks(csv, problems, read_views, small_blocks, rows, line, found):
    path = csv("item,landmark,x,y\n" + rows)
    assert problems(read_views, path)[0].startswith(f"{path}:{line}: {found}")


def test_a_quote_that_is_never_closed_does_not_hold_the_whole_file(csv, problems, monkeypatch):
    held = []
    decode = csv_sections._decode

    def watched(data, *rest):
        held.append(len(data))
        return decode(data, *rest)

    monkeypatch.setattr(csv_sections, "_decode", watched)
    path = csv('item,landmark,x,y,z\n"a,h,1,2,3\n' + "b,h,1,2,3\n" * 1_000_000)
    (line,) = problems(read_results, path)
    assert line.startswith(f"{path}:2: a bad cell (field larger than field limit")
    assert max(held) <= csv_sections.MOST_BYTES + sources.BLOCK_BYTES


plain = st.text(st.sampled_from("ab1. é'\t\u2028\x0b"), min_size=1, max_size=4)


@given(st.lists(st.lists(plain, min_size=3, max_size=3), min_size=1, max_size=5))
def test_plain_sections_are_split_as_they_are_read(rows):
    text = "".join(f"{','.join(row)}\n" for row in rows)
    section = Section(text.encode(), text, 7)
    assert [list(row) for row in zip(*split_columns(section, 3), strict=True)] == rows
    assert list(read_rows(section, "name")) == list(enumerate(rows, start=7))


@given(st.text(st.sampled_from('aaa,,,\n\n"\r'), max_size=12))
@settings(max_examples=300)
def test_what_is_split_is_never_read_in_another_way(text):
    section = Section(text.encode(), text, 1)
    columns = split_columns(section, 2) if text else None
    if columns is not None:
        rows = [row for _, row in read_rows(section, "name")]
        assert [list(row) for row in zip(*columns, strict=True)] == rows


@pytest.mark.parametrize(
    "text",
    [
        *("1", "-0.0", "+1", "1.", ".5", "007", "1e5", "1E+5", " 1\t", "inf", "-Infinity", "1e400"),
        *("5e-324", "1.7976931348623157e308", "18446744073709551617"),
        "0.1000000000000000055511151231257827",
    ],
)
def test_numbers_are_those_of_python(text):
    for cells in ([text], [text, "2"], ["", text]):
        numbers = read_numbers(cells)
        assert not numbers.strange.any()
        assert float(text) in numbers.values


@pytest.mark.parametrize("text", ["", " ", "nan", "NaN", "-nan"])
def test_nothing_and_nan_are_nan(text):
    numbers = read_numbers(["1", text])
    assert np.isnan(numbers.values[1])
    assert not numbers.strange.any()


@pytest.mark.parametrize(
    "text",
    ["one", "1_000", "１", "null", "true", "[1]", "1,2", "{}", '"1"', "1 2", "0x10", "1d5", "--1"],
)
def test_what_is_no_number_is_strange(text):
    for cells in ([text], ["1", text, ""], ["", text]):
        numbers = read_numbers(cells)
        assert [cells[row] for row in np.flatnonzero(numbers.strange)] == [text]


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=20))
def test_numbers_come_back_to_the_last_bit(values):
    for as_python in (False, True):
        name = csv_writing.cells_of(["a"], np.zeros(1, np.int64))
        row = csv_writing.rows_of([name], np.array([values]), [], as_python=as_python)
        cells = bytes(row).decode().removesuffix("\n").split(",")[1:]
        assert read_numbers(cells).values.tobytes() == np.array(values).tobytes()
        if as_python:
            assert cells == list(map(repr, values))


@pytest.mark.parametrize("rows", [1, 5, 12, 13, 1000])
def test_records_are_written_in_blocks_of_whole_items(tmp_path, monkeypatch, landmarks, rows):
    save(tmp_path / "whole.csv", landmarks)
    monkeypatch.setattr(csv_writing, "BLOCK_ROWS", rows)
    save(tmp_path / "parts.csv", landmarks)
    assert (tmp_path / "parts.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_items_without_landmarks_write_a_header(tmp_path):
    with landmark_writer(tmp_path / "none.csv") as writer:
        writer.append(
            LandmarkSet(landmarks=np.empty((2, 2, 0)), landmark_names=(), items=("a", "b"))
        )
    assert (tmp_path / "none.csv").read_text() == "item,landmark,x,y\n"
