"""TRC: markers in all spellings of the table."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
    "50\t50\t3\t2\tmm\n"
    "Frame#\tTime\tknee\t\t\tankle\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = (
    "0\t0.00\t1\t2\t3\t4\t5\t6\n"
    "1\t0.02\t7\t8\t9\t0\t0\t0\n"
    "2\t0.04\tnan\t\t\t-1e2\t.5\t6.\n"
)
TRC = HEAD + ROWS
UNSEEN = [np.nan] * 3


MARKERS = np.array(
    [
        [[1, 2, 3], [4, 5, 6]],
        [[7, 8, 9], UNSEEN],
        [UNSEEN, [-100, 0.5, 6]],
    ]
)
"""The points of TRC in mm: three frames of a knee and an ankle."""


FORMS = {
    "plain": TRC,
    "empty lines": HEAD + "\t\t\n" + ROWS + "\n\n",
    "commas": (HEAD + "\n" + ROWS).replace("\t", ","),
    "CRLF": TRC.replace("\n", "\r\n"),
    "BOM": "\ufeff" + TRC,
    "short rows": HEAD + ROWS.replace("\t0\t0\t0", ""),
    "long rows": TRC.replace("6\n", "6\t\t\n"),
    "spaces": HEAD + ROWS.replace("0.02\t7\t8\t9", "0.02\t7\t8\t9  "),
}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_trc_in_all_its_forms(read_motion, text):
    shapes, _ = read_motion("walk.trc", text)
    assert shapes.landmark_names == ("knee", "ankle")
    assert shapes.items == ("walk/0", "walk/1", "walk/2")
    assert shapes.unit == "m"
    assert shapes.frame_rate == 50.0
    assert_allclose(shapes.shapes, MARKERS / 1000)


def test_points_after_the_named_ones_are_left_out(read_motion):
    """Cortex writes markers without names there, in some rows."""
    text = TRC.replace("4\t5\t6\n", "4\t5\t6\t\t\t\t9\t9\t9\n")
    text = text.replace("1e2\t.5\t6.", "1e2\t.5\t6.\t8\t8\t8")
    shapes, notes = read_motion("walk.trc", text)
    assert_allclose(shapes.shapes, MARKERS / 1000)
    assert any("2 points without a name left out" in note for note in notes)


def test_columns_that_the_header_counts_without_names_are_left_out(read_motion):
    head = HEAD.replace("\tX2\tY2\tZ2", "\tX2\tY2\tZ2\tX3\tY3\tZ3")
    rows = ROWS.replace("4\t5\t6\n", "4\t5\t6\t7\t8\t9\n")
    shapes, notes = read_motion("walk.trc", head + rows)
    assert_allclose(shapes.shapes, MARKERS / 1000)
    assert any("1 point without a name left out" in note for note in notes)


UNITS = [
    ("m", 1, "m"),
    ("cm", 0.01, "m"),
    ("Meters", 1, "m"),
    ("", 1, "unknown"),
    ("ell", 1, "ell"),
]
"""The unit of a file, its length in the unit of the shapes, and that unit."""


@pytest.mark.parametrize(("unit", "factor", "expected"), UNITS)
def test_lengths_are_metres_where_the_unit_is_known(
    read_motion, unit, factor, expected
):
    shapes, _ = read_motion("walk.trc", TRC.replace("mm", unit))
    assert shapes.unit == expected
    assert_allclose(shapes.shapes, factor * MARKERS)


MORE_FRAMES = HEAD.replace("\t3\t2\t", "\t9\t2\t") + ROWS


NAMES_AND_WARNINGS = [
    (MORE_FRAMES, ("knee", "ankle"), "6 frames are announced"),
    (TRC, ("knee", "ankle"), "1 points at exactly 0, 0, 0"),
    (TRC.replace("ankle", "knee"), ("knee", "knee_2"), ""),
    (TRC.replace("ankle", ""), ("knee",), "2 points without a name left out"),
    (TRC.replace("knee", "kn\udce9e"), ("knée", "ankle"), ""),
]
"""A file, its landmarks, and a part of what is said of it."""


@pytest.mark.parametrize(("text", "names", "note"), NAMES_AND_WARNINGS)
def test_names_and_warnings_of_trc(read_motion, text, names, note):
    shapes, notes = read_motion("walk.trc", text)
    assert shapes.landmark_names == names
    assert note in "\n".join(notes)
