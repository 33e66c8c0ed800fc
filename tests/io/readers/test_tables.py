"""Tables of landmarks in the layouts that people have them in."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.io import open_shapes
from shapefit.io.detect import detect_format

from .made import read_images as read
from .made import write_array, write_long, write_mediapipe, write_wide

NAMES = [f"point{number}" for number in range(4)]


@pytest.fixture
def points(rng) -> np.ndarray:
    return np.round(rng.uniform(1, 600, (5, 1, 4, 2)), 3)


@pytest.fixture
def confidence(rng) -> np.ndarray:
    return np.round(rng.uniform(0.1, 1, (5, 1, 4)), 3)


MADE = [
    (write_wide, "a.csv", True, True),
    (write_long, "a.csv", True, False),
    (write_array, "a.npy", False, True),
    (write_array, "a.npz", False, True),
    (write_mediapipe, "a.json", False, False),
]
"""What writes a file, its name, whether it names landmarks, whether it is a video."""


@pytest.mark.parametrize(("write", "name", "named", "is_video"), MADE)
def test_points_and_confidences_are_those_of_the_file(
    tmp_path, points, confidence, write, name, named, is_video
):
    path = tmp_path / name
    write(path, points, confidence)
    images, _ = read(path)
    assert_array_equal(images.landmarks, points[:, 0])
    assert_array_equal(images.confidence, confidence[:, 0])
    assert list(images.landmark_names) == (NAMES if named else list("0123"))
    assert images.sequences == (("a",) * 5 if is_video else None)
    assert images.y_axis == "down"


WIDE = "frame,nose_x,nose_y,tail_x,tail_y\n7,1,2,30,40\n8,5,6,70,80\n"


AXES_FIRST = WIDE.replace("nose_x,nose_y,tail_x,tail_y", "x_nose,y_nose,x_tail,y_tail")


OF_EXCEL = """\
Frame;Body Part;x;y
8;nose;5,0;6,0
7;tail;30,0;40,0
7;nose;1;2
8;tail;70;80
"""


OF_A_VIDEO = "video,frame,x1,y1,x2,y2\nv,7,1,2,30,40\nv,8,5,6,70,80\n"


SAME_TABLES = [
    WIDE,
    WIDE.replace(",", "\t").upper(),
    WIDE.replace("_", "."),
    AXES_FIRST,
    "\ufeff" + WIDE.replace("\n", "\r\n"),
    OF_EXCEL,
    OF_A_VIDEO,
]


@pytest.mark.parametrize("text", SAME_TABLES)
def test_headers_that_say_the_same(table, text):
    path = table(text, "walk.csv")
    images, notes = read(path)
    order = np.argsort([name.lower() for name in images.landmark_names])
    points = images.landmarks[:, order]
    assert detect_format(path).title == "a table of landmarks"
    assert_array_equal(points, [[[1, 2], [30, 40]], [[5, 6], [70, 80]]])
    assert notes == ()
    assert len(set(images.sequences)) == 1


WITH_GAPS = """\
frame,joint,x,y,score
0,a,0,0,0
0,b,0,0,0.5
1,a,NA,3,1
1,b,3,,1
2,b,3,4,0
"""


def test_what_is_missing_or_hidden(table):
    images, _ = read(table(WITH_GAPS))
    missing = np.isnan(images.landmarks[..., 0])
    assert images.items == ("t/0", "t/2")
    assert missing.tolist() == [[True, False], [True, False]]
    assert images.confidence[1].tolist() == [0, 0]


def test_zeros_that_the_confidence_hides_are_not_warned_of(table):
    _, notes = read(table(WITH_GAPS))
    assert "(0, 0)" not in "".join(notes)


def read_table_of_shapes(path):
    """Return the shapes in a table, and the warnings."""
    with open_shapes([path]) as source:
        return source.whole(), source.notes


DEEP = "frame,a_x,a_y,a_z,b_x,b_y,b_z\n0,1,2,3,40,50,60\n"


def test_points_with_a_depth_are_shapes(table):
    shapes, _ = read_table_of_shapes(table(DEEP))
    assert shapes.shapes[0].tolist() == [[1, 2, 3], [40, 50, 60]]


def test_a_depth_beside_a_confidence_is_left_out(table):
    text = DEEP.replace("b_z", "b_z,a_visibility,b_visibility")
    images, _ = read(table(text.replace("60", "60,0.5,1")))
    assert images.landmarks[0].tolist() == [[1, 2], [40, 50]]


INDIVIDUALS = [
    ("person_id", ("0", "7"), ("t/id 0/0", "t/id 0/1", "t/id 7/0")),
    ("track_id", ("0.0", "7.0"), ("t/id 0/0", "t/id 0/1", "t/id 7/0")),
    ("id", ("2", "-1"), ("t/id 2/0", "t/id 2/1", "t/untracked/0/0")),
    ("individual", ("anna", "emil"), ("t/anna/0", "t/anna/1", "t/emil/0")),
]
"""A column, the cells of two individuals, and the items of three images."""


def long_table(column, one, other):
    return f"""\
frame,{column},joint,x,y
0,{one},a,1,2
0,{one},b,3,4
1,{one},a,5,6
0,{other},a,7,8
0,{other},b,9,10
"""


def wide_table(column, one, other):
    return f"""\
frame,{column},a_x,a_y,b_x,b_y
0,{one},1,2,3,4
1,{one},5,6,,
0,{other},7,8,9,10
"""


OF_TWO_INDIVIDUALS = [
    [[1, 2], [3, 4]],
    [[5, 6], [np.nan, np.nan]],
    [[7, 8], [9, 10]],
]


@pytest.mark.parametrize("layout", [long_table, wide_table])
@pytest.mark.parametrize(("column", "cells", "items"), INDIVIDUALS)
def test_columns_of_individuals(table, layout, column, cells, items):
    images, notes = read(table(layout(column, *cells)))
    assert images.items == items
    assert_array_equal(images.landmarks, OF_TWO_INDIVIDUALS)
    assert notes == ()


def test_tables_in_metres_are_shapes_in_metres(table):
    """As `convert -o NAME.metres.csv` writes them, with ten digits of the time."""
    rows = ["frame,time,landmark,x,y,z,sd,trusted"]
    for frame in (7, 8):
        for name in ("nose", "tail"):
            rows.append(f"{frame},{frame / 120:.10g},{name},{frame},2,3,,true")
    path = table("\n".join([*rows, ""]), "man.metres.csv")
    shapes, notes = read_table_of_shapes(path)
    assert notes == ()
    assert shapes.unit == "m"
    assert shapes.frame_rate == 120.0
    assert len(shapes) == 2
    assert shapes.shapes[1].tolist() == [[8, 2, 3], [8, 2, 3]]


def test_videos_stand_as_they_appear_and_begin_at_0(table):
    text = "video,frame,a_x,a_y,b_x,b_y\nw,9,1,2,3,4\nv,5,5,6,7,8\nw,7,9,10,11,12\n"
    images, _ = read(table(text))
    assert images.items == ("t/w/7", "t/w/9", "t/v/5")
    assert images.frames.tolist() == [0, 2, 0]


def test_of_two_columns_of_one_meaning_the_first_counts(table):
    text = WIDE.replace("tail_y", "tail_y,frame_no").replace("0\n", "0,3\n")
    images, notes = read(table(text))
    assert images.items == ("t/7", "t/8")
    assert notes[0].endswith("columns left out: frame_no")


@pytest.fixture
def of_openface(table):
    """A table with x, y in the image and X, Y, Z before the camera."""
    names = [f"{axis}_{n}" for axis in "xyXYZ" for n in range(3)]
    gaze = [f"gaze_{n}_{axis}" for n in range(2) for axis in "xyz"]
    names += gaze
    cells = ",".join(str(10 + column) for column in range(len(names)))
    return table(f"frame,{','.join(names)}\n0,{cells}\n")


def test_pixels_of_a_table_that_has_millimetres_too(of_openface):
    images, notes = read(of_openface)
    assert images.landmarks[0].tolist() == [[10, 13], [11, 14], [12, 15]]
    assert "x_0, y_0 ... are read, as 2D" in notes[0]
    assert "X_0, Y_0, Z_0 ..." in notes[0]


def test_millimetres_of_a_table_that_has_pixels_too(of_openface):
    shapes, _ = read_table_of_shapes(of_openface)
    assert shapes.shapes[0].tolist() == [[16, 19, 22], [17, 20, 23], [18, 21, 24]]


def test_columns_that_are_not_used_are_listed(table):
    text = ",item,landmark,x,y,confidense,note\n0,i,a,10,20,1,q\n1,i,b,30,40,1,r\n"
    _, (note,) = read(table(text))
    assert "left out: column 1 without a name, confidense (confidence?), note" in note


def test_cells_in_quotes_may_hold_the_delimiter(table):
    text = '"item","landmark","x","y","remark"\n'
    text += '"Smith, J. 1","a","10","20","q"\n"Smith, J. 1","b","3","4","r, s"\n'
    images, _ = read(table(text))
    assert images.items == ("Smith, J. 1",)


DLC = """\
scorer,net,net,net,net
bodyparts,nose,nose,tail,tail
coords,x,y,x,y
4,1.5,2,3,4
5,6,7,8,9.25
"""


def as_excel(text: str, delimiter: str) -> str:
    return text.replace(",", delimiter).replace(".", ",")


def after_index(text: str, names: tuple[str, ...]) -> str:
    """Return a table after a column of pandas."""
    rows = text.splitlines()
    first = [*names, *map(str, range(len(rows)))][: len(rows)]
    return "".join(f"{name},{row}\n" for name, row in zip(first, rows, strict=True))


NUMBERED_SCORERS = DLC.replace("net,net,net,net", "net,net.1,net.2,net.3")


SAVED_AGAIN = [
    DLC,
    as_excel(DLC, ";"),
    as_excel(DLC, "\t"),
    after_index(DLC, ("", "", "")),
    after_index(NUMBERED_SCORERS, ("",)),
    after_index(DLC, ("Unnamed: 0", "0", "1")),
    as_excel(after_index(DLC, ("", "", "")), ";"),
    NUMBERED_SCORERS,
    DLC.replace("\n", "\r"),
]


@pytest.mark.parametrize("text", SAVED_AGAIN)
def test_tables_of_deeplabcut_that_were_saved_again(tmp_path, text):
    path = tmp_path / "video.csv"
    path.write_text(text, newline="", encoding="utf-8")
    images, notes = read(path)
    assert notes == ()
    assert images.items == ("video/4", "video/5")
    assert images.landmark_names == ("nose", "tail")
    assert images.landmarks.tolist() == [[[1.5, 2], [3, 4]], [[6, 7], [8, 9.25]]]


def test_recordings_of_freemocap(table):
    names = [f"body_{n}_{a}" for n in ("nose", "left_hip", "right_hip") for a in "xyz"]
    rows = [
        ",".join(names),
        ",".join(["nan"] * 9),
        "0,1,2,3,4,5,6,7,8",
        "1,2,3,4,5,6,7,8,9",
    ]
    shapes, _ = read_table_of_shapes(table("\n".join(rows), "body_3d_xyz.csv"))
    assert shapes.sequences == ("body_3d_xyz",) * 2
    assert shapes.frames.tolist() == [1, 2]
    assert shapes.unit == "mm"


def test_a_recording_of_freemocap_may_have_lost_other_columns(table):
    names = [f"body_{n}_{a}" for n in ("nose", "left_hip") for a in "xyz"]
    rows = [",".join(names), "0,1,2,3,4,5", "1,2,3,4,5,6"]
    shapes, _ = read_table_of_shapes(table("\n".join(rows), "body_3d_xyz.csv"))
    assert shapes.sequences == ("body_3d_xyz",) * 2
    assert shapes.unit == "mm"
