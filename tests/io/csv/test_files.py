"""CSV files: what is read and written."""

import os
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from shapefit.io import (
    landmark_writer,
    read_results,
    result_writer,
    write_shapes,
)
from shapefit.io.records import ResultSet
from tests.io.files import save

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
    np.testing.assert_array_equal(views.landmarks[0], [[1, 3.5], [2, -0.4]])
    assert np.isnan(views.landmarks[1]).all()
    np.testing.assert_array_equal(views.confidence, [[0.5, 1], [0, 0]])


# What is read


def test_landmarks(csv, read_views):
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
def test_ways_to_write_the_same_table(csv, name, text, read_views):
    check_views(read_views(csv(text, "table.txt" if name == "another suffix" else "table.csv")))


def test_spaces_in_names_stay_where_the_header_has_none(csv, read_views):
    views = read_views(csv("item,landmark,x,y\n a,head ,1,2\n"))
    assert (views.items, views.landmark_names) == ((" a",), ("head ",))


def test_columns_in_any_order(csv, read_views):
    rows = [line.split(",") for line in VIEWS.splitlines()]
    check_views(
        read_views(csv("\n".join(",".join(row[i] for i in (5, 3, 0, 4, 1, 2)) for row in rows)))
    )


def test_items_keep_the_order_of_their_first_rows(csv, read_views):
    views = read_views(csv("item,landmark,x,y\nz,b,1,2\na,b,3,4\nz,a,5,6\n"))
    assert views.items == ("z", "a")
    assert views.landmark_names == ("b", "a")
    np.testing.assert_array_equal(views.landmarks[0], [[1, 5], [2, 6]])
    np.testing.assert_array_equal(views.landmarks[1], [[3, np.nan], [4, np.nan]])
    assert views.confidence is None
    assert views.sequences is None


@pytest.mark.parametrize("cells", ["1,", ",2", "nan,2", "1,NaN"])
def test_a_landmark_with_half_a_position_is_unseen(csv, cells, read_views):
    views = read_views(csv(f"item,landmark,x,y\na,head,{cells}\na,foot,1,2\n"))
    np.testing.assert_array_equal(views.landmarks, [[[np.nan, 1], [np.nan, 2]]])


def test_names_are_texts_not_numbers(csv, read_views):
    views = read_views(csv("item,landmark,x,y\n007,1.0,1,2\n7,1.0,1,2\n"))
    assert views.items == ("007", "7")
    assert views.landmark_names == ("1.0",)


def test_results_may_have_failed_items(csv):
    found = read_results(csv("item,landmark,x,y,z\na,head,1,2,3\nb,head,,,\n"))
    np.testing.assert_array_equal(found.shapes, [[[1], [2], [3]], [[np.nan]] * 3])
    assert found.coefficients is found.status is found.landmarks_fitted is None


def test_standard_input(standard_input, read_views):
    standard_input(VIEWS)
    check_views(read_views(Path("-")))


@pytest.mark.parametrize("text", ["item,landmark,x,y", "item,landmark,x,y\n\n"])
def test_a_header_alone_is_zero_images(csv, text, read_views):
    views = read_views(csv(text))
    assert len(views) == 0
    assert views.landmarks.shape == (0, 2, 0)


def test_a_table_through_a_pipe(tmp_path, read_views):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = Thread(target=lambda: pipe.write_bytes(VIEWS.encode()))
    writer.start()
    check_views(read_views(pipe))
    writer.join()


# What is written


def test_results_as_csv(tmp_path, results):
    path = tmp_path / "result.csv"
    shapes = results.shapes.copy()
    shapes[1] = np.nan
    shapes[0, :, 0] = (0.1, 1e-7, -123456789.123456789)
    with result_writer(path) as writer:
        writer.append(results.replaced(shapes=shapes).take([0, 1]))
        writer.append(results.replaced(shapes=shapes).take([2, 3, 4]))
    lines = path.read_text().splitlines()
    assert lines[0] == "item,landmark,x,y,z,sequence"
    assert lines[1] == "image 0,head,0.1,1e-7,-123456789.12345679,a"
    assert lines[5] == "image 1,head,,,,a"
    assert len(lines) == 1 + 5 * 4
    np.testing.assert_array_equal(read_results(path).shapes, shapes)


def test_standard_output(landmarks, capfdbinary):
    save(Path("-"), landmarks.take([0]))
    lines = capfdbinary.readouterr().out.decode().splitlines()
    assert lines[0] == "item,landmark,x,y,confidence,sequence"
    assert lines[1].startswith("image 0,head,")
    assert len(lines) == 5


def test_names_with_commas_quotes_and_line_ends(tmp_path, shapes, same, read_one):
    names = ('a,"b"', "new\nline", "return\r", " blank ")
    items = ("é", "\r\n", '"', "x\ny", "'")
    odd = shapes.replaced(landmark_names=names, items=items, sequences=("\r",) * 5)
    write_shapes(tmp_path / "odd.csv", odd)
    found = read_one(tmp_path / "odd.csv")
    assert found.landmark_names == names
    assert found.items == items
    assert found.sequences == odd.sequences
    np.testing.assert_array_equal(found.shapes, odd.shapes)


def test_columns_of_chunks_must_agree(tmp_path, landmarks):
    def write():
        save(tmp_path / "views.csv", landmarks, landmarks.replaced(confidence=None))

    with pytest.raises(ValueError, match="not those of the first"):
        write()
    with (
        pytest.raises(ValueError, match="nothing was appended"),
        landmark_writer(tmp_path / "x.csv"),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("sequences", [None, ("one", "two")])
def test_the_number_of_readings_is_a_column(tmp_path, rng, sequences):
    record = ResultSet(
        shapes=rng.normal(size=(2, 3, 2)),
        landmark_names=("a", "b"),
        items=("x", "y"),
        sequences=sequences,
        modes=np.array([1, 3]),
    )
    save(tmp_path / "result.csv", record)
    header, *rows = (tmp_path / "result.csv").read_text(encoding="utf-8").splitlines()
    assert header.endswith(",modes")
    assert [row.rpartition(",")[2] for row in rows] == ["1", "1", "3", "3"]
    found = read_results(tmp_path / "result.csv")
    np.testing.assert_array_equal(found.shapes, record.shapes)
    assert found.sequences == sequences
    assert found.modes is None
