"""Tables of anipose."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

ANIPOSE = (
    "nose_x,nose_y,nose_z,nose_error,nose_ncams,nose_score,"
    "tail_1_x,tail_1_y,tail_1_z,tail_1_error,tail_1_ncams,tail_1_score,"
    "M_00,center_0,fnum\n"
    "1,2,3,0.5,3,0.9,4,5,6,0.4,2,0.8,1,0,7\n"
    "1.5,2,3,0.5,3,0.9,,,,,,,1,0,8\n"
    "nan,nan,nan,nan,nan,nan,4,5,6,0.4,2,nan,1,0,9\n"
)


UNSEEN = [np.nan] * 3


POINTS = [
    [[1, 2, 3], [4, 5, 6]],
    [[1.5, 2, 3], UNSEEN],
    [UNSEEN, [4, 5, 6]],
]


CONFIDENCE = [[0.9, 0.8], [0.9, 0], [0, 1]]
"""Scores; of a point without a score 1, of one that is unseen 0."""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_points_scores_and_frame_numbers_of_anipose(read_motion, end):
    shapes, _ = read_motion("fly.csv", ANIPOSE.replace("\n", end))
    assert shapes.landmark_names == ("nose", "tail_1")
    assert shapes.items == ("fly/7", "fly/8", "fly/9")
    assert shapes.sequences == ("fly",) * 3
    assert_array_equal(shapes.shapes, POINTS)
    assert_array_equal(shapes.column("confidence"), CONFIDENCE)
