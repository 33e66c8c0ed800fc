"""Tidy tables: what each fault says."""

import sys
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from shapefit.errors import InputError
from shapefit.io import (
    inputs,
    open_landmarks,
    open_shapes,
    read_results,
)
from tests.io.files import read_shape_file

UNSEEN = "write a finite number, or leave the cell empty where it is unknown"
WEIGHT = "write 0 (hidden) or a positive number"
COLUMNS = "item,landmark,x,y[,confidence][,sequence][,frame][,time]"
HEADER = f"write the header {COLUMNS}, with commas"
ONE_CELL = "write one cell per column"


BAD_NUMBERS = """\
item,landmark,x,y,confidence
a,head,1,2,1
a,foot,one,2,1

b,head,inf,2,-0.5
b,foot,"1,5",-Infinity,
c,head,,nan,nan
c,,1,2,1
,foot,1,2,1
"""


ROWS_TWICE = """\
item,landmark,x,y
a,head,1,2
a,foot,1,2
b,head,1,2
a,head,3,4
a,head,1,2
"""


NAMES_OF_TWO_LINES = "".join(f'"item\n{i}",head,{i},2\n' for i in range(30_000))


BAD_ROWS = [
    (
        BAD_NUMBERS,
        [
            f"3: x is 'one'; {UNSEEN}",
            f"5: x is 'inf'; {UNSEEN}",
            f"5: confidence is '-0.5'; {WEIGHT}",
            f"6: x is '1,5'; {UNSEEN}",
            f"6: y is '-Infinity'; {UNSEEN}",
            f"6: confidence is empty; {WEIGHT}",
            f"7: confidence is 'nan'; {WEIGHT}",
            "8: landmark is empty; name the landmark",
            "9: item is empty; name the item",
        ],
    ),
    (
        ROWS_TWICE,
        [
            "5: item 'a', landmark 'head' is also on line 2; keep one of them",
            "6: item 'a', landmark 'head' is also on line 2; keep one of them",
        ],
    ),
    (
        "item,landmark,x,y,sequence\na,head,1,2,s\na,foot,1,2,t\nb,foot,1,2,t\n",
        ["3: sequence is 't'; give all rows of an item one sequence"],
    ),
    (
        "item,landmark,x,y\na,h,1,2\n\nb,h,1\nc,h,1,2,3\n",
        [
            f"4: has 3 cells for 4 columns; {ONE_CELL}",
            f"5: has 5 cells for 4 columns; {ONE_CELL}",
        ],
    ),
    (
        'item,landmark,x,y\n"a,b",h,1\n',
        [f"2: has 3 cells for 4 columns; {ONE_CELL}"],
    ),
    (
        "item,landmark,x,y\n1,2,3\n4,5,6,7,8\n",
        [
            f"2: has 3 cells for 4 columns; {ONE_CELL}",
            f"3: has 5 cells for 4 columns; {ONE_CELL}",
        ],
    ),
    (
        b"item,landmark,x,y\na,head,1,2\n\xe9,head,1,2\n",
        ["3: is not UTF-8 text; save it as CSV in UTF-8"],
    ),
    (
        "item,landmark,x,why\n1,2,3,4\n",
        [f"1: the header is 'item,landmark,x,why'; {HEADER}"],
    ),
    ("item,landmark,x\n1,2,3\n", [f"1: the header is 'item,landmark,x'; {HEADER}"]),
    ("item,landmark,x,y,x\n", [f"1: the header is 'item,landmark,x,y,x'; {HEADER}"]),
    (
        f"item,landmark,x,y\n{NAMES_OF_TWO_LINES}last,head,bad,2\n",
        [f"60002: x is 'bad'; {UNSEEN}"],
    ),
]
"""A table, and what is said of it: the line, the fault and what to do."""


@pytest.mark.parametrize(("text", "told"), BAD_ROWS)
def test_every_bad_row_is_named_with_its_line(
    csv_table, problems, read_views, text, told
):
    path = csv_table(text)
    expected = tuple(f"{path}:{line}" for line in told)
    assert problems(read_views, path) == expected


NO_CSV = [
    ('a,h,1,2\nb,"h"h,1,2\nc,h,1,2\n', "a bad cell (',' expected after '\"')"),
    ('a,h,1,2\nb,h,1,"2\n', "a bad cell (unexpected end of data); put cells with"),
    ('a,h,1,2\n"b,h,1,2\n' + "c,h,1,2\n" * 100_000, "a bad cell (field larger than"),
]
"""Rows of which the second, on line 3, has quotes at wrong places, and the fault."""


@pytest.mark.parametrize(("rows", "fault"), NO_CSV)
def test_text_that_is_no_csv(csv_table, problems, read_views, rows, fault):
    path = csv_table("item,landmark,x,y\n" + rows)
    first, *_ = problems(read_views, path)
    assert first.startswith(f"{path}:3: {fault}")


@pytest.mark.parametrize("cell", ["inf", "1e999", "abc"])
def test_shapes_must_be_finite(csv_table, problems, cell, read_one):
    path = csv_table(f"{SHAPES_HEADER}\na,head,1,2,3\nb,head,1,2,{cell}\n")
    (line,) = problems(read_one, path)
    assert line == f"{path}:3: z is '{cell}'; {UNSEEN}"


SHAPES_HEADER = "item,landmark,x,y,z"


WHOLE_SHAPES = [
    f"{number},{name},1,{number},3" for number in range(40) for name in ("head", "foot")
]
"""Rows of 40 shapes, in which the y of both landmarks is the number of the shape."""


@pytest.mark.parametrize("row", ["b,foot,1,2,", "b,foot,1,2,nan", ""])
def test_shapes_that_lack_a_landmark_are_left_out(csv_table, row):
    """As those of other tools are, with their number."""
    table = "\n".join([SHAPES_HEADER, *WHOLE_SHAPES, "b,head,1,2,3", row])
    with open_shapes([csv_table(table)]) as source:
        count = source.count
        shapes = source.whole()
        (note,) = source.notes
    y_of_heads = shapes.shapes[:, 0, 1]
    assert count == 40
    assert shapes.items == tuple(map(str, range(40)))
    assert_array_equal(y_of_heads, range(40))
    assert note.endswith(": 1 shape left out, in which a landmark is unknown")


def test_landmarks_that_few_shapes_have_are_left_out(csv_table):
    table = "\n".join([SHAPES_HEADER, *WHOLE_SHAPES, "3,tail,1,2,3"])
    with open_shapes([csv_table(table)]) as source:
        assert source.count == 40
        assert source.head.landmark_names == ("head", "foot")
        assert "1 landmark left out, known in less than 90%" in source.notes[0]


@pytest.mark.parametrize("value", ["1e160", "-2e300"])
@pytest.mark.parametrize("read", [read_shape_file, read_results])
def test_a_coordinate_whose_square_overflows_is_named(csv_table, problems, read, value):
    path = csv_table(f"{SHAPES_HEADER}\na,head,1,2,3\na,foot,4,{value},6\n")
    (line,) = problems(read, path)
    position = f"(4.0, {float(value)}, 6.0)"
    assert line.startswith(f"{path}: item 'a': landmark 'foot' is {position}; ")


def test_a_table_whose_rows_share_nothing(csv_table, problems, monkeypatch):
    rows = [f"item {row},landmark {row},0,0" for row in range(6_000)]
    path = csv_table("\n".join(["item,landmark,x,y", *rows, ""]))
    monkeypatch.setattr(inputs, "free_memory", lambda: 10**8)
    (line,) = problems(open_landmarks, [path])
    assert line.startswith(f"{path}: it takes ")
    assert "100 MB are free; divide the file" in line


def test_ten_problems_are_told_and_the_rest_counted(csv_table, problems, read_views):
    rows = "".join(f"item {i},head,x,2\n" for i in range(25))
    path = csv_table("item,landmark,x,y\n" + rows)
    first, *others, last = problems(read_views, path)
    assert ":2: x is 'x'" in first
    assert len(others) == 9
    assert last == "... and 15 more"


def test_standard_input_that_is_empty(standard_input, problems, read_views):
    standard_input("")
    (line,) = problems(read_views, Path("-"))
    fix = "write a CSV with a header line"
    assert line == f"standard input: is empty (0 bytes); {fix}"


def test_faults_of_standard_input_are_named_with_their_line(
    standard_input, problems, read_views
):
    standard_input("item,landmark,x,y\na,head,?,2\n")
    first, *_ = problems(read_views, Path("-"))
    assert first.startswith("standard input:2: x is '?'; ")


def test_hdf5_does_not_come_through_a_pipe(
    fill_pipe, landmark_file, problems, read_views
):
    pipe = fill_pipe(landmark_file.read_bytes())
    (line,) = problems(read_views, pipe)
    fix = "name the file itself, or send CSV"
    assert line == f"{pipe}: is HDF5, which cannot come through a pipe; {fix}"


def test_standard_input_that_is_closed_is_told(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="standard input: is closed"):
        next(inputs.read_text_blocks(Path("-")))
