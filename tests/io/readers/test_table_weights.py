"""Columns of tables that hide landmarks or weight them."""

import pytest
from numpy.testing import assert_array_equal

from shapefit.errors import InputError

from .made import read_images as read

HIDING = [
    ("visible", "1", "0"),
    ("Visible", "TRUE", "FALSE"),
    ("is_visible", "yes", "no"),
    ("vis", "2", "0"),
    ("visibility", "1", "0"),
    ("occluded", "0", "1"),
    ("Occluded", "False", "True"),
    ("hidden", "n", "y"),
    ("missing", "0", "1"),
]
"""A column, its cell for a landmark that is seen, and that for another."""


def long_table(column, seen, unseen):
    return f"item,landmark,x,y,{column}\ni,a,10,20,{seen}\ni,b,30,40,{unseen}\n"


def wide_table(column, seen, unseen):
    header = f"item,a_x,a_y,a_{column},b_x,b_y,b_{column}"
    return f"{header}\ni,10,20,{seen},30,40,{unseen}\n"


@pytest.mark.parametrize(("column", "seen", "unseen"), HIDING)
@pytest.mark.parametrize("layout", [long_table, wide_table])
@pytest.mark.parametrize("delimiter", [",", "\t"])
def test_columns_that_hide_landmarks(table, column, seen, unseen, layout, delimiter):
    text = layout(column, seen, unseen)
    images, _ = read(table(text.replace(",", delimiter)))
    assert_array_equal(images.confidence, [[1, 0]])


@pytest.mark.parametrize(("column", "seen", "unseen"), HIDING)
@pytest.mark.parametrize("delimiter", [",", "\t"])
def test_columns_that_hide_images(table, column, seen, unseen, delimiter):
    rows = f"i,{seen},10,20,30,40\nj,{unseen},1,2,3,4\n"
    text = f"item,{column},a_x,a_y,b_x,b_y\n{rows}"
    images, _ = read(table(text.replace(",", delimiter)))
    assert_array_equal(images.confidence, [[1, 1], [0, 0]])


@pytest.mark.parametrize(
    ("column", "cell"), [("occluded", "2"), ("visible", "5"), ("visible", "-1")]
)
def test_columns_that_hide_landmarks_are_refused_by_name(table, column, cell):
    path = table(f"item,landmark,x,y,{column}\ni,a,10,20,{cell}\ni,b,30,40,1\n")
    with pytest.raises(
        InputError, match=f"{cell} in the column {column}; write 0 or 1"
    ):
        read(path)


def test_a_confidence_of_each_image(table):
    text = "frame,confidence,a_x,a_y,b_x,b_y\n0,0.98,1,2,30,40\n1,0.02,5,6,70,80\n"
    images, (note,) = read(table(text))
    assert images.confidence.tolist() == [[0.98, 0.98], [0.02, 0.02]]
    assert "column 'confidence' weights all landmarks of its image" in note


def test_confidences_of_landmarks_go_before_that_of_their_image(table):
    header = "frame,confidence,a_x,a_y,a_score,b_x,b_y"
    text = f"{header}\n0,0.98,1,2,1,30,40\n1,0.02,5,6,.5,70,80\n"
    images, (note,) = read(table(text))
    assert images.confidence.tolist() == [[1, 1], [0.5, 1]]
    assert "columns left out: confidence" in note


def test_a_landmark_whose_confidence_is_left_empty_has_1(table):
    images, _ = read(table("frame,joint,x,y,score\n0,a,10,20,\n0,b,30,40,.5\n"))
    assert images.confidence.tolist() == [[1.0, 0.5]]
