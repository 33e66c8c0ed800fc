"""Rows of tables are images, frames of a video, or single images."""

import pytest

from shapefit.io import open_shapes

from .made import read_images as read

SPECIMENS = "{},a_x,a_y,b_x,b_y\n{},1,2,30,40\n{},5,6,70,80\n"


NAMED_ROWS = [
    ("", ("MVZ_1", "MVZ_2"), "column without a name"),
    ("Taxon", ("Mus", "Rattus"), "column 'Taxon'"),
    ("subject", ("s1", "s2"), "column 'subject'"),
    ("ID", ("17", "12"), "column 'ID'"),
    ("", ("7", "8"), "column without a name"),
    ("Number", ("7", "8"), "column 'Number'"),
]
"""A column, its cells, and what is said to name the items."""


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize(("column", "cells", "named"), NAMED_ROWS)
def test_rows_without_number_or_time_are_single_images(
    table, delimiter, column, cells, named
):
    text = SPECIMENS.format(column, *cells).replace(",", delimiter)
    images, (note, *_) = read(table(text))
    assert images.items == cells
    assert images.sequences is None
    assert images.frames is None
    assert f"items are named by the {named}" in note
    assert "call it `frame`" in note


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_names_that_repeat_do_not_name_items(table, delimiter):
    text = SPECIMENS.format("species", "Mus", "Mus").replace(",", delimiter)
    images, (note, *_) = read(table(text))
    assert images.items == ("t/0", "t/1")
    assert images.sequences is None
    assert images.frames is None
    assert "single images" in note
    assert "call a column `frame`" in note


def test_names_of_which_one_is_missing_do_not_name_items(table):
    text = SPECIMENS.format("species", "Mus", "")
    images, (note, *_) = read(table(text))
    assert images.items == ("t/0", "t/1")
    assert "single images" in note


@pytest.mark.parametrize("delimiter", [",", ";"])
@pytest.mark.parametrize("column", ["item", "image", "Taxon"])
@pytest.mark.parametrize("track", ["none", "motion"])
def test_images_with_names_are_no_motion(table, delimiter, column, track):
    """Also where names are numbered: photographs of specimens are."""
    rows = [f"IMG_{n}.jpg,{landmark},{n},5" for n in range(30) for landmark in "abc"]
    text = "\n".join([f"{column},landmark,x,y", *rows])
    images, _ = read(table(text.replace(",", delimiter)), track=track)
    assert images.sequences is None
    assert images.items[:2] == ("IMG_0.jpg", "IMG_1.jpg")


HEAD = "item,landmark,x,y,z,sd_x,sequence,frame,time,trusted"


def rows_of_a_fit(times):
    """Return the rows of frames of two landmarks; `times` gives a frame the cells of
    sequence, frame and time.
    """
    return [
        f"w/{frame},{name},{frame},2,3,.1,{times(frame)},True"
        for frame in (3, 4, 9)
        for name in "ab"
    ]


def read_data_frame(path):
    with open_shapes([path]) as source:
        shapes = source.whole()
    x = shapes.shapes[:, 0, 0]
    assert shapes.items == ("w/3", "w/4", "w/9")
    assert x.tolist() == [3, 4, 9]
    return shapes


@pytest.mark.parametrize("with_index", [True, False])
def test_a_data_frame_of_a_fit_comes_back(table, with_index):
    """As pandas writes it, with and without its index."""
    rows = [HEAD, *rows_of_a_fit(lambda frame: f"walk,{frame},{frame / 25}")]
    if with_index:
        rows = [
            f"{index},{row}" for index, row in zip(["", *range(6)], rows, strict=True)
        ]
    shapes = read_data_frame(table("\n".join(rows)))
    assert shapes.sequences == ("walk",) * 3
    assert shapes.frames.tolist() == [3, 4, 9]


def test_a_data_frame_of_single_images_comes_back(table):
    """Its columns of time are empty."""
    rows = [HEAD, *rows_of_a_fit(lambda frame: ",,")]
    shapes = read_data_frame(table("\n".join(rows)))
    assert not any(shapes.sequences or ())
    assert shapes.frames is None


def test_rows_without_anything_beside_are_single_images(table):
    images, (note,) = read(table("a_x,a_y,b_x,b_y\n1,2,30,40\n5,6,70,80\n"))
    assert images.items == ("t/0", "t/1")
    assert images.sequences is None
    assert "rows are taken for single images" in note


@pytest.mark.parametrize("column", ["time", "Timestamp", "time (s)", "TIME"])
def test_rows_with_times_are_frames(table, column):
    text = f"{column},a_x,a_y,b_x,b_y\n0.5,1,2,3,4\n0.54,5,6,7,8\n0.66,9,8,7,6\n"
    images, notes = read(table(text))
    assert images.frames.tolist() == [0, 1, 4]
    assert images.frame_rate == 25
    assert images.items == ("t/0.5", "t/0.54", "t/0.66")
    assert len({*images.sequences}) == 1
    assert notes == ()
