"""TRC files as different programs write them."""

from contextlib import suppress

import numpy as np
import pytest

from shapefit.errors import InputError
from tests.io.files import load_shapes

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
    "50\t50\t3\t2\tmm\n"
    "Frame#\tTime\tknee\t\t\tankle\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = "0\t0.00\t1\t2\t3\t4\t5\t6\n1\t0.02\t7\t8\t9\t0\t0\t0\n2\t0.04\tnan\t\t\t-1e2\t.5\t6.\n"


def read(tmp_path, text, name="walk.trc"):
    path = tmp_path / name
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    return load_shapes(path)


EXPECTED = np.array(
    [[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [np.nan] * 3], [[np.nan] * 3, [-100, 0.5, 6]]]
)


@pytest.mark.parametrize(
    "text",
    [
        HEAD + ROWS,
        HEAD + "\n" + ROWS,
        HEAD + "\t\t\n" + ROWS + "\n\n",
        (HEAD + "\n" + ROWS).replace("\t", ","),
        (HEAD + ROWS).replace("\n", "\r\n"),
        "\ufeff" + HEAD + ROWS,
        HEAD.replace("knee\t\t\tankle\t\t", "knee\tankle") + ROWS,
        HEAD + ROWS.replace("\t0\t0\t0", ""),
        (HEAD + ROWS).replace("6\n", "6\t\t\n"),
        HEAD + ROWS.replace("0.02\t7\t8\t9", "0.02\t7\t8\t9  "),
    ],
)
def test_the_same_motion_in_all_their_forms(tmp_path, text):
    shapes, _ = read(tmp_path, text)
    assert shapes.landmark_names == ("knee", "ankle")
    assert shapes.items == ("walk/0", "walk/1", "walk/2")
    assert (shapes.unit, shapes.frame_rate) == ("m", 50.0)
    np.testing.assert_allclose(shapes.shapes.swapaxes(1, 2), EXPECTED / 1000)


@pytest.mark.parametrize(
    ("unit", "factor", "name"),
    [("m", 1, "m"), ("cm", 0.01, "m"), ("Meters", 1, "m"), ("", 1, "unknown"), ("ell", 1, "ell")],
)
def test_lengths_are_metres_where_the_unit_is_known(tmp_path, unit, factor, name):
    shapes, _ = read(tmp_path, (HEAD + ROWS).replace("mm", unit))
    assert shapes.unit == name
    np.testing.assert_allclose(shapes.shapes.swapaxes(1, 2), factor * EXPECTED)


def test_what_is_missing_is_counted(tmp_path):
    _, notes = read(tmp_path, HEAD.replace("\t3\t2\t", "\t9\t2\t") + ROWS)
    assert any("1 points at exactly 0, 0, 0" in note for note in notes)
    assert any("6 frames are announced" in note for note in notes)


def test_names_that_repeat_or_are_empty(tmp_path):
    shapes, notes = read(tmp_path, HEAD.replace("ankle", "knee") + ROWS)
    assert shapes.landmark_names == ("knee", "knee_2")
    assert any("knee_2" in note for note in notes)
    shapes, _ = read(tmp_path, HEAD.replace("ankle", "") + ROWS)
    assert shapes.landmark_names == ("knee", "*1")


def test_a_byte_that_is_not_utf_8(tmp_path):
    shapes, _ = read(tmp_path, (HEAD + ROWS).replace("knee", "kn\udce9e"))
    assert shapes.landmark_names[0] == "kn\\xe9e"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD + ROWS.replace("8", "x"), ["walk.trc:7", "'x' is no number"]),
        (HEAD + ROWS.replace("6\n", "6\t7\n", 1), ["walk.trc:6", "9 cells for 8 columns"]),
        (HEAD.partition("Frame#")[0], ["walk.trc", "names of markers"]),
        (HEAD.replace("knee\t\t\tankle\t\t", "").partition("\t\tX1")[0], ["walk.trc"]),
        (HEAD + ROWS + ROWS, ["walk/0", "walk.trc"]),
    ],
)
def test_errors_name_file_and_line(tmp_path, text, words):
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert all(word in str(error.value) for word in words), error.value


def test_cut_off_anywhere_it_is_read_or_refused(tmp_path):
    whole = HEAD + ROWS
    for end in range(15, len(whole), 3):
        with suppress(InputError):
            shapes, _ = read(tmp_path, whole[:end])
            assert len(shapes.landmark_names) <= 2
