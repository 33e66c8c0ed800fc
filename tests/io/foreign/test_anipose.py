"""The 3D CSV of anipose."""

import re

import numpy as np
import pytest

from shapefit.errors import InputError
from tests.io.files import load_shapes

HEAD = "nose_x,nose_y,nose_z,nose_error,nose_ncams,nose_score,"
HEAD += "tail_1_x,tail_1_y,tail_1_z,tail_1_error,tail_1_ncams,tail_1_score,M_00,center_0,fnum\n"
ROWS = "1,2,3,0.5,3,0.9,4,5,6,0.4,2,0.8,1,0,7\n1.5,2,3,0.5,3,0.9,,,,,,,1,0,8\n"
ROWS += "nan,nan,nan,nan,nan,nan,4,5,6,0.4,2,nan,1,0,9\n"


def read(tmp_path, text):
    path = tmp_path / "fly.csv"
    path.write_text(text)
    return load_shapes(path)


@pytest.mark.parametrize("text", [HEAD + ROWS, (HEAD + ROWS).replace("\n", "\r\n")])
def test_points_scores_and_frame_numbers(tmp_path, text):
    shapes, _ = read(tmp_path, text)
    assert shapes.landmark_names == ("nose", "tail_1")
    assert shapes.items == ("fly/7", "fly/8", "fly/9")
    assert shapes.sequences == ("fly",) * 3
    nan = [np.nan] * 3
    expected = [[[1, 2, 3], [4, 5, 6]], [[1.5, 2, 3], nan], [nan, [4, 5, 6]]]
    np.testing.assert_array_equal(shapes.shapes.swapaxes(1, 2), expected)
    np.testing.assert_array_equal(shapes.columns["confidence"], [[0.9, 0.8], [0.9, 0], [0, 1]])


def test_points_of_which_nothing_more_is_said_are_named(tmp_path):
    shapes, notes = read(tmp_path, re.sub("nose_(error|ncams|score)", r"\1", HEAD) + ROWS)
    assert shapes.landmark_names == ("tail_1",)
    assert any("points left out: nose" in note for note in notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD + ROWS.replace("0.8,1,0,7", "0.8,1,7"), ["fly.csv:2", "14 cells for 15 columns"]),
        (HEAD + ROWS.replace("1.5,", "one,"), ["fly.csv:3", "'one'"]),
        (HEAD + ROWS + ROWS, ["fly/7"]),
    ],
)
def test_errors_name_file_and_line(tmp_path, text, words):
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert all(word in str(error.value) for word in words), error.value
