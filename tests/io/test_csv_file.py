"""Tidy tables: what is read and written, whatever the way they are spelled; what a
fault says.
"""

import csv as csv_module
import io
import os
from pathlib import Path
from threading import Thread
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from shapefit.io import (
    csv_file,
    inputs,
    open_landmarks,
    open_shapes,
    read_results,
    read_shapes,
    result_writer,
)
from shapefit.io.csv_cells import read_numbers, read_rows, split_cells
from shapefit.io.csv_file import read_csv
from shapefit.io.options import InputOptions
from shapefit.records import Landmarks, concatenate
from tests.io.files import load, save

VIEWS = """\
item,landmark,x,y,confidence,sequence
a,head,1,2,0.5,s
a,foot,3.5,-4e-1,1,s
b,foot,,nan,0,t
"""


def check_views(views):
    assert views.items == ("a", "b")
    assert views.landmark_names == ("head", "foot")
    assert views.sequences == ("s", "t")
    np.testing.assert_array_equal(views.as_columns()[0], [[1, 3.5], [2, -0.4]])
    assert np.isnan(views.as_columns()[1]).all()
    np.testing.assert_array_equal(views.confidence, [[0.5, 1], [0, 0]])


# What is read


@pytest.mark.parametrize(
    "text",
    [
        VIEWS,
        VIEWS.replace("\n", "\r\n"),
        "\ufeff" + VIEWS,
        VIEWS.rstrip("\n"),
        VIEWS.replace("\n", "\n\n") + ",,,,,\n",
        VIEWS.replace("x,y", " x , y").replace(",2,", ", 2 ,"),
        VIEWS.replace(",", ", "),
        VIEWS.replace(",", "\t,"),
        VIEWS.replace("head", '"head"').replace("3.5", '"3.5"'),
        VIEWS.replace("item,landmark", '"item","landmark"'),
    ],
)
def test_ways_to_write_the_same_table(csv, text, read_views):
    check_views(read_views(csv(text)))


def test_a_stream_a_pipe_and_another_suffix(csv, standard_input, tmp_path, read_views):
    standard_input(VIEWS)
    check_views(read_views(Path("-")))
    check_views(read_views(csv(VIEWS, "table.txt")))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = Thread(target=lambda: pipe.write_bytes(VIEWS.encode()))
    writer.start()
    check_views(read_views(pipe))
    writer.join()


names = st.text(st.sampled_from("ab1. é'\t\u2028\x0b"), min_size=1, max_size=4)
odd_names = st.text(st.sampled_from("ab \",\n\r'"), min_size=1, max_size=4)


@given(
    st.lists(names | odd_names, min_size=1, max_size=4, unique=True),
    st.lists(names | odd_names, min_size=1, max_size=3, unique=True),
    st.randoms(use_true_random=False),
    st.sampled_from([1, 7, 64, 1 << 16]),
)
@settings(max_examples=60, deadline=None)
def test_neither_order_nor_quotes_nor_blocks_count(
    tmp_path_factory, items, landmarks, random, size
):
    """Rows and columns in any order, some missing, with or without quotes: what the
    rows say.
    """
    path = tmp_path_factory.mktemp("table") / "t.csv"
    rows = [(i, j) for i in range(len(items)) for j in range(len(landmarks))]
    random.shuffle(rows)
    rows = rows[: random.randint(1, len(rows))]
    columns = ["item", "landmark", "x", "y"]
    random.shuffle(columns)
    out = io.StringIO(newline="")
    quoting = 1 if "\r" in "".join(items + landmarks) else random.choice([0, 1])
    writer = csv_module.DictWriter(out, columns, quoting=quoting, lineterminator="\n")
    writer.writeheader()
    for i, j in rows:
        writer.writerow(
            {"item": items[i], "landmark": landmarks[j], "x": i + 0.5, "y": -j}
        )
    path.write_bytes(out.getvalue().encode())
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(inputs, "BLOCK_BYTES", size)
        views = read_csv(path, "landmarks")
    assert views.items == tuple(dict.fromkeys(items[i] for i, _ in rows))
    assert views.landmark_names == tuple(dict.fromkeys(landmarks[j] for _, j in rows))
    found = {
        (views.items[i], views.landmark_names[j]): tuple(views.as_columns()[i, :, j])
        for i, j in np.argwhere(np.isfinite(views.as_columns()[:, 0])).tolist()
    }
    assert found == {(items[i], landmarks[j]): (i + 0.5, float(-j)) for i, j in rows}


@pytest.mark.parametrize("cells", ["1,", ",2", "nan,2", "1,NaN"])
def test_a_landmark_with_half_a_position_is_unseen(csv, cells, read_views):
    views = read_views(csv(f"item,landmark,x,y\na,head,{cells}\na,foot,1,2\n"))
    np.testing.assert_array_equal(views.as_columns(), [[[np.nan, 1], [np.nan, 2]]])
    assert views.confidence is views.sequences is None


@given(st.text(st.sampled_from('aaa,,,\n\n"\r'), min_size=1, max_size=12))
@example("a,a,a\na")
@settings(max_examples=300)
def test_what_is_split_is_never_read_in_another_way(text):
    cells = split_cells(text, ["left", "right"], 1)
    if cells is not None:
        rows = [row for _, row in read_rows([text], 1, "name")]
        assert len(cells.lines) == len(rows)
        for number, row in enumerate(rows):
            assert [cells.cell(column, number) for column in ("left", "right")] == row


@pytest.mark.parametrize(
    "text",
    [
        *(
            "1",
            "-0.0",
            "+1",
            "1.",
            ".5",
            "007",
            "1e5",
            "1E+5",
            " 1\t",
            "inf",
            "-Infinity",
            "1e400",
        ),
        *("5e-324", "1.7976931348623157e308", "18446744073709551617"),
        *("0.1000000000000000055511151231257827", "", " ", "nan", "NaN", "-nan"),
    ],
)
def test_numbers_are_those_of_python(text):
    for cells in ([text], [text, "2"], ["", text]):
        values, strange = read_numbers(cells)
        assert not strange.any()
        np.testing.assert_equal(values[cells.index(text)], float(text.strip() or "nan"))


@pytest.mark.parametrize(
    "text",
    [
        "one",
        "1_000",
        "１",
        "null",
        "true",
        "[1]",
        "1,2",
        "{}",
        '"1"',
        "1 2",
        "0x10",
        "1d5",
        "--1",
    ],
)
def test_what_is_no_number_is_strange(text):
    for cells in ([text], ["1", text, ""], ["", text]):
        _, strange = read_numbers(cells)
        assert [cells[row] for row in np.flatnonzero(strange)] == [text]


# What is wrong


UNSEEN = "write a finite number, or leave the cell empty where it is unknown"
WEIGHT = "write 0 (hidden) or a positive number"
COLUMNS = "item,landmark,x,y[,confidence][,sequence][,frame][,time]"
HEADER = f"write the header {COLUMNS}, with commas"
ONE_CELL = "write one cell per column"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            (
                "item,landmark,x,y,confidence\na,head,1,2,1\na,foot,one,2,1\n\nb,head,inf,2,-0.5\n"
                'b,foot,"1,5",-Infinity,\nc,head,,nan,nan\nc,,1,2,1\n,foot,1,2,1\n'
            ),
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
            "item,landmark,x,y\na,head,1,2\na,foot,1,2\nb,head,1,2\na,head,3,4\na,head,1,2\n",
            [
                f"{line}: item 'a', landmark 'head' is also on line 2; keep one of them"
                for line in (5, 6)
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
        (
            "item,landmark,x,y,x\n",
            [f"1: the header is 'item,landmark,x,y,x'; {HEADER}"],
        ),
        (
            "item,landmark,x,y\n"
            + "".join(f'"item\n{i}",head,{i},2\n' for i in range(30_000))
            + "last,head,bad,2\n",
            [f"60002: x is 'bad'; {UNSEEN}"],
        ),
    ],
)
def test_every_bad_row_is_named_with_its_line(csv, problems, read_views, text, told):
    path = csv(text)
    assert problems(read_views, path) == tuple(f"{path}:{line}" for line in told)


@pytest.mark.parametrize(
    ("rows", "line", "found"),
    [
        ('a,h,1,2\nb,"h"h,1,2\nc,h,1,2\n', 3, "a bad cell (',' expected after '\"')"),
        (
            'a,h,1,2\nb,h,1,"2\n',
            3,
            "a bad cell (unexpected end of data); put cells with commas",
        ),
        (
            'a,h,1,2\n"b,h,1,2\n' + "c,h,1,2\n" * 100_000,
            3,
            "a bad cell (field larger than",
        ),
    ],
)
def test_text_that_is_no_csv(csv, problems, read_views, rows, line, found):
    path = csv("item,landmark,x,y\n" + rows)
    assert problems(read_views, path)[0].startswith(f"{path}:{line}: {found}")


@pytest.mark.parametrize("cell", ["inf", "1e999", "abc"])
def test_shapes_must_be_finite(csv, problems, cell, read_one):
    path = csv(f"item,landmark,x,y,z\na,head,1,2,3\nb,head,1,2,{cell}\n")
    assert problems(read_one, path) == (f"{path}:3: z is '{cell}'; {UNSEEN}",)


@pytest.mark.parametrize("row", ["b,foot,1,2,", "b,foot,1,2,nan", ""])
def test_shapes_that_lack_a_landmark_are_left_out(csv, row):
    """As those of other tools are, with their number."""
    rows = [f"{n},{name},1,{n},3" for n in range(40) for name in ("head", "foot")]
    text = "\n".join(["item,landmark,x,y,z", *rows, "b,head,1,2,3", row])
    with open_shapes([csv(text)]) as source:
        assert source.count == 40
        shapes = source.whole()
        (note,) = source.notes
    assert shapes.items == tuple(map(str, range(40)))
    assert shapes.as_columns()[:, 1, 0].tolist() == [*range(40)]
    assert note.endswith(": 1 shape left out, in which a landmark is unknown")


def test_landmarks_that_few_shapes_have_are_left_out(csv):
    rows = [f"{n},{name},1,{n},3" for n in range(40) for name in ("head", "foot")]
    text = "\n".join(["item,landmark,x,y,z", *rows, "3,tail,1,2,3"])
    with open_shapes([csv(text)]) as source:
        assert source.count == 40
        assert source.head.landmark_names == ("head", "foot")
        assert "1 landmark left out, known in less than 90%" in source.notes[0]


HEAD = "item,landmark,x,y,z\n"


@pytest.mark.parametrize("value", ["1e160", "-2e300"])
def test_a_coordinate_whose_square_overflows_is_named(csv, problems, value):
    path = csv(f"{HEAD}a,head,1,2,3\na,foot,4,{value},6\n")
    for read in (lambda: read_shapes([path]), lambda: read_results(path)):
        (line,) = problems(read)
        assert line.startswith(
            f"{path}: item 'a': landmark 'foot' is (4.0, {float(value)}, 6.0); "
        )


def test_a_table_whose_rows_share_nothing(tmp_path, problems, monkeypatch):
    path = tmp_path / "diagonal.csv"
    rows = (f"item {row},landmark {row},0,0" for row in range(6_000))
    path.write_text("\n".join(["item,landmark,x,y", *rows]) + "\n")
    monkeypatch.setattr(inputs, "free_memory", lambda: 10**8)
    (line,) = problems(open_landmarks, [path])
    assert line.startswith(f"{path}: it takes ")
    assert "100 MB are free; divide the file" in line


def test_ten_problems_are_told_and_the_rest_counted(csv, problems, read_views):
    rows = "".join(f"item {i},head,x,2\n" for i in range(25))
    first, *others, last = problems(read_views, csv("item,landmark,x,y\n" + rows))
    assert ":2: x is 'x'" in first
    assert (len(others), last) == (9, "... and 15 more")


def test_what_does_not_come_as_a_stream(
    standard_input, landmark_file, tmp_path, problems, read_views
):
    standard_input("")
    fix = "write a CSV with a header line"
    assert problems(read_views, Path("-")) == (
        f"standard input: is empty (0 bytes); {fix}",
    )
    standard_input("item,landmark,x,y\na,head,?,2\n")
    assert problems(read_views, Path("-"))[0].startswith("standard input:2: x is '?'; ")
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = Thread(target=lambda: pipe.write_bytes(landmark_file.read_bytes()))
    writer.start()
    told = problems(read_views, pipe)
    writer.join()
    fix = "name the file itself, or send CSV"
    assert told == (f"{pipe}: is HDF5, which cannot come through a pipe; {fix}",)


# What is written


def test_results_as_csv(tmp_path, results):
    path = tmp_path / "result.csv"
    shapes = results.as_columns().copy()
    shapes[1] = np.nan
    shapes[0, :, 0] = (0.1, 1e-7, -123456789.123456789)
    with result_writer(path) as writer:
        writer.append(results.replaced(shapes=shapes.swapaxes(1, 2)).take([0, 1]))
        writer.append(results.replaced(shapes=shapes.swapaxes(1, 2)).take([2, 3, 4]))
    lines = path.read_text().splitlines()
    assert lines[0] == "item,landmark,x,y,z,sequence"
    assert lines[1] == "image 0,head,0.1,1e-7,-123456789.12345679,a"
    assert lines[5] == "image 1,head,,,,a"
    assert len(lines) == 1 + 5 * 4
    np.testing.assert_array_equal(read_results(path).as_columns(), shapes)


def test_items_without_landmarks_write_a_header(tmp_path):
    none = Landmarks(
        np.empty((2, 2, 0)).swapaxes(1, 2), landmark_names=(), items=("a", "b")
    )
    save(tmp_path / "none.csv", none)
    assert (tmp_path / "none.csv").read_text() == "item,landmark,x,y\n"


@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=2)
)
@example([-1.2345678901234567e-300] * 2)  # as many digits as there are
def test_numbers_come_back_to_the_last_bit(values):
    data: list[bytes] = []
    csv_file.CsvWriter(data.append).append(
        Landmarks(
            np.array([values])[..., None].swapaxes(1, 2), landmark_names="a", items="b"
        )
    )
    cells = bytes(data[-1]).decode().removesuffix("\n").split(",")[2:]
    assert read_numbers(cells)[0].tobytes() == np.array(values).tobytes()


def test_one_landmark_has_one_row_an_item(tmp_path, same):
    images = Landmarks(
        np.arange(10.0, 16).reshape(3, 2, 1).swapaxes(1, 2),
        landmark_names=("a",),
        items=("i", "j", "k"),
    )
    save(tmp_path / "one.csv", images)
    same(load(tmp_path / "one.csv"), images)


def test_minus_one_without_a_confidence_is_unseen(csv):
    header, rows = "item,landmark,x,y", ["a,nose,-1,-1", "a,tail,50,-1", "a,ear,60,70"]
    visible = load(csv("\n".join([header, *rows]))).visible()
    assert visible.tolist() == [[False, True, True]]
    scored = "\n".join([f"{header},confidence", *(f"{row},1" for row in rows)])
    assert load(csv(scored)).visible().all()


@pytest.mark.parametrize("suffix", ["h5", "csv"])
def test_fractions_of_the_image_are_refused_in_every_format(tmp_path, suffix, problems):
    images = Landmarks(
        np.linspace(0.1, 0.9, 12).reshape(2, 2, 3).swapaxes(1, 2),
        landmark_names="abc",
        items=("i", "j"),
    )
    path = tmp_path / f"views.{suffix}"
    save(path, images)
    assert "fractions of the width and height of the image" in problems(load, path)[0]
    with open_landmarks([path], InputOptions(image_size=(100.0, 200.0))) as source:
        scaled = source.whole()
    assert scaled.unit == "px"
    np.testing.assert_allclose(
        scaled.as_columns()[:, 1], 200 * images.as_columns()[:, 1]
    )
    save(path, images.replaced(landmarks=(images.as_columns() - 0.5).swapaxes(1, 2)))
    assert load(path).as_columns().min() == pytest.approx(
        -0.4
    )  # about a centre: no fractions


class TestLargeTables:
    """Beyond what is held, images go to a temporary file as soon as their rows are
    complete.
    """

    @pytest.fixture(autouse=True)
    def _small(self, monkeypatch):
        monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", 12)
        monkeypatch.setattr(inputs, "BLOCK_BYTES", 40)

    def table(self, csv, order, sequences=True):
        rows = [
            f"i{i},{'abcd'[j]},{i + j / 7},{i * j},{0.5 + j},s{i // 3}"
            for i, j in order
        ]
        return csv("\n".join(["item,landmark,x,y,confidence,sequence", *rows, ""]))

    def test_they_are_read_as_small_ones(self, csv, monkeypatch, same):
        order = [
            (i, j)
            for i in range(40)
            for j in range(4)
            if (i, j) not in ((0, 3), (1, 3))
        ]
        path = self.table(csv, order)
        with open_landmarks([path]) as source:
            parts = list(source.batches(7))
            assert source.count == 40
            assert source.notes == ()
            rows = concatenate(list(source.chosen(np.array([1, 2, 30]), 7)))
            names = [item for block in source.names() for item in block]
        monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", 10**6)
        whole = load(path)
        same(concatenate(parts), whole)
        same(rows, whole.take([1, 2, 30]))
        assert tuple(names) == whole.items

    def test_their_items_are_estimated_by_the_length_of_the_first_lines(
        self, csv, monkeypatch
    ):
        path = self.table(csv, [(i, j) for i in range(40) for j in range(4)])
        with open_landmarks([path], head=True) as source:
            assert source.count < source.estimate == pytest.approx(40, abs=4)
        rows = [f"{'i' * (100_000 if i < 11 else 1)}{i},a,1,2\n" for i in range(99)]
        monkeypatch.setattr(inputs, "BLOCK_BYTES", 1 << 20)
        monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", 80)
        path = csv("item,landmark,x,y\n" + "".join(rows))
        with open_landmarks([path], head=True) as source:
            assert source.count == source.estimate == 99  # and no fewer than were read

    ORDERS: ClassVar = {
        "melted": [(i, j) for j in range(4) for i in range(40)],
        "mixed": [((7 * k) % 40, k // 40) for k in range(160)],
        "one row late": [
            *((i, j) for i in range(40) for j in range(4) if (i, j) != (2, 3)),
            (2, 3),
        ],
    }

    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("held", [12, 50, 100])
    def test_rows_of_an_item_need_not_stand_together(
        self, csv, monkeypatch, same, order, held
    ):
        path = self.table(csv, self.ORDERS[order])
        monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", 10**6)
        whole = load(path)
        monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", held)
        with open_landmarks([path]) as source:
            assert source.count == 40
            same(concatenate(list(source.batches(7))), whole)

    def test_a_row_twice_is_named_wherever_it_stands(self, csv, problems):
        path = self.table(csv, [*self.ORDERS["melted"], (3, 1)])
        (line,) = problems(open_landmarks, [path])
        assert "is also on line 45" in line

    def test_memory_that_does_not_hold_them_is_stated(self, csv, problems, monkeypatch):
        path = self.table(csv, self.ORDERS["melted"])
        monkeypatch.setattr(inputs, "free_memory", lambda: 1000)
        monkeypatch.setattr(inputs, "ALWAYS_FITS", 1000)
        (line,) = problems(open_landmarks, [path])
        assert "of memory, and 1 kB are free; divide the file" in line

    def test_of_standard_input_their_rows_must_stand_together(
        self, csv, standard_input, problems
    ):
        order = [(i, 0) for i in range(40)] + [(i, 1) for i in range(40)]
        standard_input(self.table(csv, order).read_text())
        (line,) = problems(open_landmarks, [Path("-")])
        assert line.endswith(
            ": the rows of items do not stand together, and the table is large; "
            "name the file itself, or sort its rows by item"
        )
