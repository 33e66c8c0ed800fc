"""CSV files: what is read and written, and what each fault says."""

from __future__ import annotations

import io
import os
import sys
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from shapefit.io import (
    landmark_writer,
    open_landmarks,
    read_results,
    read_shapes,
    result_writer,
    write_shapes,
)

VIEWS = """\
item,landmark,x,y,confidence,sequence
a,head,1,2,0.5,s
a,foot,3.5,-4e-1,1,s
b,foot,,nan,0,t
"""


@pytest.fixture
def csv(tmp_path):
    """Write a CSV file and return its path."""

    def write(text: str | bytes, name: str = "table.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.fixture
def standard_input(monkeypatch):
    def give(text: str) -> None:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))

    return give


def read_views(*paths):
    with open_landmarks(paths) as source:
        (chunk,) = source.chunks(100)
        return chunk


def read_one(path):
    return read_shapes([path])


def check_views(views):
    assert views.items == ("a", "b")
    assert views.landmark_names == ("head", "foot")
    assert views.sequences == ("s", "t")
    np.testing.assert_array_equal(views.landmarks[0], [[1, 3.5], [2, -0.4]])
    assert np.isnan(views.landmarks[1]).all()
    np.testing.assert_array_equal(views.confidence, [[0.5, 1], [0, 0]])


# What is read


def test_landmarks(csv):
    check_views(read_views(csv(VIEWS)))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("windows line ends", VIEWS.replace("\n", "\r\n")),
        ("old line ends", VIEWS.replace("\n", "\r")),
        ("byte order mark", "\ufeff" + VIEWS),
        ("no last line end", VIEWS.rstrip("\n")),
        ("empty lines", VIEWS.replace("\n", "\n\n") + ",,,,,\n"),
        ("spaces", VIEWS.replace("x,y", " x , y").replace(",2,", ", 2 ,")),
        ("spaces after all commas", VIEWS.replace(",", ", ")),
        ("spaces before all commas", VIEWS.replace(",", "\t,")),
        ("quotes", VIEWS.replace("head", '"head"').replace("3.5", '"3.5"')),
        ("another suffix", VIEWS),
    ],
)
def test_ways_to_write_the_same_table(csv, name, text):
    check_views(read_views(csv(text, "table.txt" if name == "another suffix" else "table.csv")))


def test_spaces_in_names_stay_where_the_header_has_none(csv):
    views = read_views(csv("item,landmark,x,y\n a,head ,1,2\n"))
    assert (views.items, views.landmark_names) == ((" a",), ("head ",))


def test_columns_in_any_order(csv):
    rows = [line.split(",") for line in VIEWS.splitlines()]
    check_views(
        read_views(csv("\n".join(",".join(row[i] for i in (5, 3, 0, 4, 1, 2)) for row in rows)))
    )


def test_items_keep_the_order_of_their_first_rows(csv):
    views = read_views(csv("item,landmark,x,y\nz,b,1,2\na,b,3,4\nz,a,5,6\n"))
    assert views.items == ("z", "a")
    assert views.landmark_names == ("b", "a")
    np.testing.assert_array_equal(views.landmarks[0], [[1, 5], [2, 6]])
    np.testing.assert_array_equal(views.landmarks[1], [[3, np.nan], [4, np.nan]])
    assert views.confidence is None
    assert views.sequences is None


@pytest.mark.parametrize("cells", ["1,", ",2", "nan,2", "1,NaN"])
def test_a_landmark_with_half_a_position_is_unseen(csv, cells):
    views = read_views(csv(f"item,landmark,x,y\na,head,{cells}\na,foot,1,2\n"))
    np.testing.assert_array_equal(views.landmarks, [[[np.nan, 1], [np.nan, 2]]])


def test_names_are_texts_not_numbers(csv):
    views = read_views(csv("item,landmark,x,y\n007,1.0,1,2\n7,1.0,1,2\n"))
    assert views.items == ("007", "7")
    assert views.landmark_names == ("1.0",)


def test_results_may_have_failed_items(csv):
    found = read_results(csv("item,landmark,x,y,z\na,head,1,2,3\nb,head,,,\n"))
    np.testing.assert_array_equal(found.shapes, [[[1], [2], [3]], [[np.nan]] * 3])
    assert found.coefficients is found.status is found.landmarks_fitted is None


def test_standard_input(standard_input):
    standard_input(VIEWS)
    check_views(read_views(Path("-")))


@pytest.mark.parametrize("text", ["item,landmark,x,y", "item,landmark,x,y\n\n"])
def test_a_header_alone_is_zero_images(csv, text):
    views = read_views(csv(text))
    assert len(views) == 0
    assert views.landmarks.shape == (0, 2, 0)


# What is written


def test_results_as_csv(tmp_path, results):
    path = tmp_path / "result.csv"
    shapes = results.shapes.copy()
    shapes[1] = np.nan
    shapes[0, :, 0] = (0.1, 1e-7, -123456789.123456789)
    with result_writer(path) as writer:
        writer.append(replace(results, shapes=shapes).take([0, 1]))
        writer.append(replace(results, shapes=shapes).take([2, 3, 4]))
    lines = path.read_text().splitlines()
    assert lines[0] == "item,landmark,x,y,z,sequence"
    assert lines[1] == "image 0,head,0.1,1e-7,-123456789.12345679,a"
    assert lines[5] == "image 1,head,,,,a"
    assert len(lines) == 1 + 5 * 4
    np.testing.assert_array_equal(read_results(path).shapes, shapes)


def test_standard_output(landmarks, capfdbinary):
    with landmark_writer(Path("-")) as writer:
        writer.append(landmarks.take([0]))
    lines = capfdbinary.readouterr().out.decode().splitlines()
    assert lines[0] == "item,landmark,x,y,confidence,sequence"
    assert lines[1].startswith("image 0,head,")
    assert len(lines) == 5


def test_names_with_commas_quotes_and_line_ends(tmp_path, shapes, same):
    names = ('a,"b"', "new\nline", "return\r", " blank ")
    items = ("é", "\r\n", '"', "x\ny", "'")
    odd = replace(shapes, landmark_names=names, items=items, sequences=("\r",) * 5)
    write_shapes(tmp_path / "odd.csv", odd)
    found = read_one(tmp_path / "odd.csv")
    assert found.landmark_names == names
    assert found.items == items
    assert found.sequences == odd.sequences
    np.testing.assert_array_equal(found.shapes, odd.shapes)


def test_zero_results(tmp_path, results):
    path = tmp_path / "result.csv"
    with result_writer(path) as writer:
        writer.append(results.take([]))
    assert path.read_text() == "item,landmark,x,y,z,sequence\n"
    assert len(read_results(path)) == 0


def test_columns_of_chunks_must_agree(tmp_path, landmarks):
    def write():
        with landmark_writer(tmp_path / "views.csv") as writer:
            writer.append(landmarks)
            writer.append(replace(landmarks, confidence=None))

    with pytest.raises(ValueError, match="not those of the first"):
        write()
    with (
        pytest.raises(ValueError, match="nothing was appended"),
        landmark_writer(tmp_path / "x.csv"),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


# Faults


def test_every_bad_cell_is_named_with_its_line(csv, problems):
    path = csv(
        "item,landmark,x,y,confidence\n"
        "a,head,1,2,1\n"
        "a,foot,one,2,1\n"
        "\n"
        "b,head,inf,2,-0.5\n"
        'b,foot,"1,5",-Infinity,\n'
        "c,head,,nan,nan\n"
        "c,,1,2,1\n"
        ",foot,1,2,1\n"
    )
    unseen = "write a finite number, or leave the cell empty where the landmark is unseen"
    weight = "write 0 (hidden) or a positive number"
    assert problems(read_views, path) == (
        f"{path}:3: x is 'one'; {unseen}",
        f"{path}:5: x is 'inf'; {unseen}",
        f"{path}:5: confidence is '-0.5'; {weight}",
        f"{path}:6: x is '1,5'; {unseen}",
        f"{path}:6: y is '-Infinity'; {unseen}",
        f"{path}:6: confidence is empty; {weight}",
        f"{path}:7: confidence is 'nan'; {weight}",
        f"{path}:8: landmark is empty; name the landmark",
        f"{path}:9: item is empty; name the item",
    )


@pytest.mark.parametrize("cell", ["", "nan", "inf", "1e999", "abc"])
def test_shapes_must_be_finite(csv, problems, cell):
    path = csv(f"item,landmark,x,y,z\na,head,1,2,3\nb,head,1,2,{cell}\n")
    found = f"z is '{cell}'" if cell else "z is empty"
    assert problems(read_one, path) == (f"{path}:3: {found}; write a finite number",)


def test_results_must_not_be_infinite(csv, problems):
    path = csv("item,landmark,x,y,z\na,head,1,2,-inf\n")
    assert problems(read_results, path) == (
        f"{path}:2: z is '-inf'; write a finite number, or leave the cell empty "
        "where the item failed",
    )


def test_shapes_must_be_complete(csv, problems):
    path = csv("item,landmark,x,y,z\na,head,1,2,3\na,foot,1,2,3\nb,foot,1,2,3\n")
    (line,) = problems(read_one, path)
    assert line == (f"{path}: item 'b' has no landmark 'head'; write every landmark of every item")


def test_ten_problems_are_told_and_the_rest_counted(csv, problems):
    rows = "".join(f"item {i},head,x,2\n" for i in range(25))
    lines = problems(read_views, csv("item,landmark,x,y\n" + rows))
    assert len(lines) == 11
    assert ":2: x is 'x'" in lines[0]
    assert lines[-1] == "... and 15 more"


def test_repeated_rows(csv, problems):
    path = csv("item,landmark,x,y\na,head,1,2\na,foot,1,2\nb,head,1,2\na,head,3,4\na,head,1,2\n")
    assert problems(read_views, path) == (
        f"{path}:5: item 'a', landmark 'head' stands also on line 2; keep one of them",
        f"{path}:6: item 'a', landmark 'head' stands also on line 2; keep one of them",
    )


def test_an_item_in_two_sequences(csv, problems):
    path = csv("item,landmark,x,y,sequence\na,head,1,2,s\na,foot,1,2,t\nb,foot,1,2,t\n")
    assert problems(read_views, path) == (
        f"{path}:3: sequence is 't'; give all rows of an item one sequence",
    )


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (
            "item,landmark,x,y,confidense",
            ["unknown column 'confidense'; did you mean 'confidence'?"],
        ),
        (
            "item,landmark,x,y,colour",
            ["unknown column 'colour'; the columns are item,landmark,x,y[,confidence][,sequence]"],
        ),
        (
            "item,landmark,x,z,x",
            [
                "the column 'x' repeats; keep one of them",
                "unknown column 'z'; the columns are item,landmark,x,y[,confidence][,sequence]",
                "the column 'x' repeats; keep one of them",
                "there is no column 'y'; the columns are item,landmark,x,y[,confidence][,sequence]",
            ],
        ),
        (
            "item;landmark;x;y",
            [
                "the header is 'item;landmark;x;y'; "
                "write the header item,landmark,x,y[,confidence][,sequence], with commas"
            ],
        ),
    ],
)
def test_other_columns(csv, problems, header, expected):
    path = csv(header + "\n1,2,3,4,5\n")
    assert problems(read_views, path) == tuple(f"{path}:1: {line}" for line in expected)


@pytest.mark.parametrize("row", ["b,foot,1", "b,foot,1,2,3", "b", '"b",foot,1', "b,foot,1,2,"])
@pytest.mark.parametrize("before", ["", '"x\ny",head,1,2\n', "\n\n"])
def test_rows_with_too_few_or_too_many_cells(csv, problems, row, before):
    path = csv(f"item,landmark,x,y\na,head,1,2\n{before}{row}\nc,head,1,2\n")
    cells = row.count(",") + 1
    assert problems(read_views, path) == (
        f"{path}:{3 + before.count(chr(10))}: has {cells} cells for 4 columns; "
        "write one cell a column",
    )


def test_a_comma_in_a_name_does_not_stand_for_a_cell(csv, problems):
    path = csv('item,landmark,x,y\n"a,b",head,1\n')
    (line,) = problems(read_views, path)
    assert line.startswith(f"{path}:2: has 3 cells for 4 columns; ")


def test_quotes_that_do_not_match(csv, problems):
    path = csv('item,landmark,x,y\na,head,1,2\n"b,head,1,2\n')
    (line,) = problems(read_views, path)
    assert line == f"{path}:3: has 1 cells for 4 columns; write one cell a column"
    path = csv('item,landmark,x,y\na,head,1,2\n5" nail,head,1,2\nc,head,1,2\n')
    (line,) = problems(read_views, path)
    assert line.startswith(f"{path}:3: cannot be read as CSV (")
    assert line.endswith(
        "; put cells with commas or quotes in double quotes, and double the quotes in them"
    )


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("item,landmark,x,y\ra,head,1,2\nb,head,1,2\n", 1),
        ("item,landmark,x,y\na,head,1,2\nb,head,1,2\rc,head,1,2\n", 3),
    ],
)
def test_line_ends_of_two_kinds(csv, problems, text, line):
    path = csv(text)
    assert problems(read_views, path) == (
        f"{path}:{line}: a line ends in CR alone, others in LF; end all lines in the same way",
    )


@pytest.mark.parametrize("text", ["{}item,landmark,x,y\n", "item,landmark,x,y\n{},head,1\n"])
def test_a_cell_too_long_for_a_name(csv, problems, text):
    path = csv(text.format("x" * 200_000))
    (line,) = problems(read_views, path)
    assert line.startswith(f"{path}:{text.index('{}') // 18 + 1}: a bad cell (")


def test_lines_of_a_file_with_old_line_ends_are_counted(csv, problems):
    path = csv("item,landmark,x,y\ra,head,1,2\rb,head,?,2\r")
    assert problems(read_views, path)[0].startswith(f"{path}:3: x is '?'; ")


def test_text_that_is_not_utf8(csv, problems):
    path = csv(b"item,landmark,x,y\na,head,1,2\n\xe9,head,1,2\n")
    assert problems(read_views, path) == (f"{path}:3: is not UTF-8 text; save it as CSV in UTF-8",)
    path = csv("item,landmark,x,y\na,head,1,2\n".encode("utf-16-le"))
    assert problems(read_views, path) == (
        f"{path}:1: is not text (a zero byte); save it as CSV in UTF-8",
    )


def test_empty_standard_input(standard_input, problems):
    standard_input("")
    assert problems(read_views, Path("-")) == (
        "standard input: is empty (0 bytes); write a CSV with a header line",
    )


def test_hdf5_does_not_come_through_a_pipe(landmark_file, tmp_path, problems):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = Thread(target=lambda: pipe.write_bytes(landmark_file.read_bytes()))
    writer.start()
    told = problems(read_views, pipe)
    writer.join()
    fix = "name the file itself, or send CSV"
    assert told == (f"{pipe}: is HDF5, which cannot come through a pipe; {fix}",)


def test_a_table_through_a_pipe(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = Thread(target=lambda: pipe.write_bytes(VIEWS.encode()))
    writer.start()
    check_views(read_views(pipe))
    writer.join()


def test_lines_of_standard_input_are_named(standard_input, problems):
    standard_input("item,landmark,x,y\na,head,?,2\n")
    assert problems(read_views, Path("-"))[0].startswith("standard input:2: x is '?'; ")


def test_lines_are_right_in_a_long_file_with_odd_names(csv, problems):
    rows = "".join(f'"item\n{i}",head,{i},2\n' for i in range(30_000))
    path = csv("item,landmark,x,y\n" + rows + "last,head,bad,2\n")
    (line,) = problems(read_views, path)
    assert line.startswith(f"{path}:60002: x is 'bad'; ")
