"""CSV files that are wrong: what each fault says, and where."""

import os
from pathlib import Path
from threading import Thread

import pytest

from shapefit.io import read_results


def test_every_bad_cell_is_named_with_its_line(csv, problems, read_views):
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
def test_shapes_must_be_finite(csv, problems, cell, read_one):
    path = csv(f"item,landmark,x,y,z\na,head,1,2,3\nb,head,1,2,{cell}\n")
    found = f"z is '{cell}'" if cell else "z is empty"
    assert problems(read_one, path) == (f"{path}:3: {found}; write a finite number",)


def test_results_must_not_be_infinite(csv, problems):
    path = csv("item,landmark,x,y,z\na,head,1,2,-inf\n")
    assert problems(read_results, path) == (
        f"{path}:2: z is '-inf'; write a finite number, or leave the cell empty "
        "where the item failed",
    )


def test_shapes_must_be_complete(csv, problems, read_one):
    path = csv("item,landmark,x,y,z\na,head,1,2,3\na,foot,1,2,3\nb,foot,1,2,3\n")
    (line,) = problems(read_one, path)
    assert line == (f"{path}: item 'b' has no landmark 'head'; write every landmark of every item")


def test_ten_problems_are_told_and_the_rest_counted(csv, problems, read_views):
    rows = "".join(f"item {i},head,x,2\n" for i in range(25))
    lines = problems(read_views, csv("item,landmark,x,y\n" + rows))
    assert len(lines) == 11
    assert ":2: x is 'x'" in lines[0]
    assert lines[-1] == "... and 15 more"


def test_repeated_rows(csv, problems, read_views):
    path = csv("item,landmark,x,y\na,head,1,2\na,foot,1,2\nb,head,1,2\na,head,3,4\na,head,1,2\n")
    assert problems(read_views, path) == (
        f"{path}:5: item 'a', landmark 'head' is also on line 2; keep one of them",
        f"{path}:6: item 'a', landmark 'head' is also on line 2; keep one of them",
    )


def test_an_item_in_two_sequences(csv, problems, read_views):
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
            "item;landmark;x;colour",
            [
                "the header is 'item;landmark;x;colour'; "
                "write the header item,landmark,x,y[,confidence][,sequence], with commas"
            ],
        ),
    ],
)
def test_other_columns(csv, problems, header, expected, read_views):
    path = csv(header + "\n1,2,3,4,5\n")
    assert problems(read_views, path) == tuple(f"{path}:1: {line}" for line in expected)


@pytest.mark.parametrize("row", ["b,foot,1", "b,foot,1,2,3", "b", '"b",foot,1', "b,foot,1,2,"])
@pytest.mark.parametrize("before", ["", '"x\ny",head,1,2\n', "\n\n"])
def test_rows_with_too_few_or_too_many_cells(csv, problems, row, before, read_views):
    path = csv(f"item,landmark,x,y\na,head,1,2\n{before}{row}\nc,head,1,2\n")
    cells = row.count(",") + 1
    assert problems(read_views, path) == (
        f"{path}:{3 + before.count(chr(10))}: has {cells} cells for 4 columns; "
        "write one cell per column",
    )


def test_a_comma_in_a_name_does_not_stand_for_a_cell(csv, problems, read_views):
    path = csv('item,landmark,x,y\n"a,b",head,1\n')
    (line,) = problems(read_views, path)
    assert line.startswith(f"{path}:2: has 3 cells for 4 columns; ")


def test_quotes_that_do_not_match(csv, problems, read_views):
    path = csv('item,landmark,x,y\na,head,1,2\n"b,head,1,2\n')
    (line,) = problems(read_views, path)
    assert line == f"{path}:3: has 1 cells for 4 columns; write one cell per column"
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
def test_line_ends_of_two_kinds(csv, problems, text, line, read_views):
    path = csv(text)
    assert problems(read_views, path) == (
        f"{path}:{line}: a line ends in CR alone, others in LF; end all lines in the same way",
    )


@pytest.mark.parametrize("text", ["{}item,landmark,x,y\n", "item,landmark,x,y\n{},head,1\n"])
def test_a_cell_too_long_for_a_name(csv, problems, text, read_views):
    path = csv(text.format("x" * 200_000))
    (line,) = problems(read_views, path)
    assert line.startswith(f"{path}:{text.index('{}') // 18 + 1}: a bad cell (")


def test_lines_of_a_file_with_old_line_ends_are_counted(csv, problems, read_views):
    path = csv("item,landmark,x,y\ra,head,1,2\rb,head,?,2\r")
    assert problems(read_views, path)[0].startswith(f"{path}:3: x is '?'; ")


def test_text_that_is_not_utf8(csv, problems, read_views):
    path = csv(b"item,landmark,x,y\na,head,1,2\n\xe9,head,1,2\n")
    assert problems(read_views, path) == (f"{path}:3: is not UTF-8 text; save it as CSV in UTF-8",)
    path = csv("item,landmark,x,y\na,head,1,2\n".encode("utf-16-le"))
    assert problems(read_views, path) == (
        f"{path}:1: is not text (a zero byte); save it as CSV in UTF-8",
    )


def test_empty_standard_input(standard_input, problems, read_views):
    standard_input("")
    assert problems(read_views, Path("-")) == (
        "standard input: is empty (0 bytes); write a CSV with a header line",
    )


def test_hdf5_does_not_come_through_a_pipe(landmark_file, tmp_path, problems, read_views):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = Thread(target=lambda: pipe.write_bytes(landmark_file.read_bytes()))
    writer.start()
    told = problems(read_views, pipe)
    writer.join()
    fix = "name the file itself, or send CSV"
    assert told == (f"{pipe}: is HDF5, which cannot come through a pipe; {fix}",)


def test_lines_of_standard_input_are_named(standard_input, problems, read_views):
    standard_input("item,landmark,x,y\na,head,?,2\n")
    assert problems(read_views, Path("-"))[0].startswith("standard input:2: x is '?'; ")


def test_lines_are_right_in_a_long_file_with_odd_names(csv, problems, read_views):
    rows = "".join(f'"item\n{i}",head,{i},2\n' for i in range(30_000))
    path = csv("item,landmark,x,y\n" + rows + "last,head,bad,2\n")
    (line,) = problems(read_views, path)
    assert line.startswith(f"{path}:60002: x is 'bad'; ")
