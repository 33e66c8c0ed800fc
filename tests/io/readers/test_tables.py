"""Tables, arrays and lists of points in the layouts that people have them in."""

import json
from pathlib import Path

import numpy as np
import pytest

import shapefit
from shapefit.errors import InputError
from shapefit.io import open_shapes
from shapefit.io.checks import warn_of_zeros
from shapefit.io.detect import detect_format
from shapefit.io.options import InputOptions
from shapefit.io.source import find_kind

from .made import read_images as read
from .made import write_array, write_long, write_mediapipe, write_wide

NAMES = [f"point{number}" for number in range(4)]


@pytest.fixture
def points(rng) -> np.ndarray:
    return np.round(rng.uniform(1, 600, (5, 1, 4, 2)), 3)


@pytest.fixture
def confidence(rng) -> np.ndarray:
    return np.round(rng.uniform(0.1, 1, (5, 1, 4)), 3)


def table(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("write", "name", "named", "sequence"),
    [
        (write_wide, "a.csv", True, True),
        (write_long, "a.csv", True, False),
        (write_array, "a.npy", False, True),
        (write_array, "a.npz", False, True),
        (write_mediapipe, "a.json", False, False),
    ],
)
def test_points_and_confidences_are_those_of_the_file(
    tmp_path, points, confidence, write, name, named, sequence
):
    write(tmp_path / name, points, confidence)
    images, _ = read(tmp_path / name)
    np.testing.assert_array_equal(images.as_columns().transpose(0, 2, 1), points[:, 0])
    np.testing.assert_array_equal(images.confidence, confidence[:, 0])
    assert list(images.landmark_names) == (NAMES if named else list("0123"))
    assert images.y_axis == "down"
    assert (images.sequences == ("a",) * 5) if sequence else images.sequences is None


WIDE = "frame,nose_x,nose_y,tail_x,tail_y\n7,1,2,30,40\n8,5,6,70,80\n"


@pytest.mark.parametrize(
    "text",
    [
        WIDE,
        WIDE.replace(",", "\t").upper(),
        WIDE.replace("_", "."),
        "frame,x_nose,y_nose,x_tail,y_tail\n" + WIDE.partition("\n")[2],
        "\ufeff" + WIDE.replace("\n", "\r\n"),
        (
            "Frame;Body"
            " Part;x;y\n8;nose;5,0;6,0\n7;tail;30,0;40,0\n7;nose;1;2\n8;tail;70;80\n"
        ),
        "video,frame,x1,y1,x2,y2\nv,7,1,2,30,40\nv,8,5,6,70,80\n",
    ],
)
def test_headers_that_say_the_same(tmp_path, text):
    path = table(tmp_path / "walk.csv", text)
    assert detect_format(path).title == "a table of landmarks"
    images, notes = read(path)
    order = np.argsort([name.lower() for name in images.landmark_names])
    found = images.as_columns().transpose(0, 2, 1)[:, order]
    np.testing.assert_array_equal(found, [[[1, 2], [30, 40]], [[5, 6], [70, 80]]])
    assert notes == ()
    assert len(set(images.sequences)) == 1


def test_what_is_missing_or_hidden(tmp_path):
    text = "frame,joint,x,y,score\n"
    text += "0,a,0,0,0\n0,b,0,0,0.5\n1,a,NA,3,1\n1,b,3,,1\n2,b,3,4,0\n"
    images, notes = read(table(tmp_path / "t.csv", text))
    assert images.items == ("t/0", "t/2")
    assert "(0, 0)" not in "".join(notes)  # the confidence says it
    assert np.isnan(images.as_columns()[:, 0]).tolist() == [
        [True, False],
        [True, False],
    ]
    assert images.confidence[1].tolist() == [0, 0]


def test_many_landmarks_at_zero_are_a_warning(tmp_path, points):
    points[::2, :, 1] = 0
    np.save(tmp_path / "a.npy", np.tile(points[:, 0], (5, 1, 1)))
    _, (note,) = read(tmp_path / "a.npy")
    assert "15 of 100 landmarks are at exactly (0, 0)" in note
    rows = [
        f"{n},{k},{x},{y}"
        for n, own in enumerate(points[:, 0])
        for k, (x, y) in enumerate(own)
    ]
    _, (note,) = read(
        table(tmp_path / "a.csv", "\n".join(["item,landmark,x,y", *rows]))
    )
    assert "a.csv: 3 of 20 landmarks are at exactly (0, 0)" in note


@pytest.mark.parametrize("y_sign", [1, -1])
def test_landmarks_at_zero_are_missing_only_in_a_corner(points, y_sign):
    """Whoever places a landmark at the origin has others on both sides of it."""
    pixels = 1 + np.abs(points[:, 0]) * [1, y_sign]
    centred = pixels - pixels.mean(axis=1, keepdims=True)
    for images in (pixels, centred):
        images[:, 1] = 0
    assert warn_of_zeros(centred) == ()
    assert len(warn_of_zeros(pixels)) == 1
    assert warn_of_zeros(np.zeros((3, 5, 2))) != ()  # images of nobody


def test_a_depth_beside_a_confidence_is_left_out_and_without_one_it_is_a_shape(
    tmp_path,
):
    text = "frame,a_x,a_y,a_z,b_x,b_y,b_z\n0,1,2,3,40,50,60\n"
    with open_shapes([table(tmp_path / "t.csv", text)]) as source:
        (shapes,) = source.batches(9)
    assert shapes.points[0].tolist() == [[1, 2, 3], [40, 50, 60]]
    seen = text.replace("b_z", "b_z,a_visibility,b_visibility").replace(
        "60", "60,0.5,1"
    )
    images, _ = read(table(tmp_path / "t.csv", seen))
    assert images.points[0].tolist() == [[1, 2], [40, 50]]


@pytest.mark.parametrize("kind", ["npy", "json", "csv"])
def test_fractions_of_an_image_need_its_size(tmp_path, rng, kind):
    points = np.round(rng.uniform(size=(3, 33, 2)), 3)
    path = tmp_path / f"a.{kind}"
    if kind == "npy":
        np.save(path, points)
    elif kind == "json":
        write_mediapipe(path, points[:, None], np.ones((3, 1, 33)))
    else:
        names = [f"{axis}{n}" for n in range(33) for axis in "xyzv"]
        rows = np.concatenate([points, np.ones((3, 33, 2))], axis=2).reshape(3, -1)
        table(
            path,
            "\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)]),
        )
    with pytest.raises(
        InputError, match=r"fractions of the width.*`image_size=\[1920,1080"
    ):
        read(path, keypoints="mediapipe_33")
    images, _ = read(path, keypoints="mediapipe_33", image_size=(200.0, 100.0))
    np.testing.assert_allclose(
        images.as_columns().transpose(0, 2, 1), points * (200, 100)
    )
    assert images.unit == "px"
    assert images.landmark_names[0] == "nose"


def test_which_skeleton_an_array_has_must_be_said(tmp_path, rng):
    np.save(tmp_path / "a.npy", rng.uniform(1, 600, (3, 17, 2)))
    with pytest.raises(
        InputError, match="17 landmarks without names, as coco_17 and h36m_17 have"
    ):
        read(tmp_path / "a.npy")
    assert read(tmp_path / "a.npy", keypoints="coco_17")[0].landmark_names[0] == "nose"
    assert read(tmp_path / "a.npy", keypoints="numbered")[0].landmark_names[0] == "0"


@pytest.mark.parametrize(
    "wrap",
    [
        lambda body: body,
        lambda body: [body],
        lambda body: {
            "pose_landmarks": [body],
            "pose_world_landmarks": [[{"x": 9, "y": 9}]],
        },
        lambda body: [{"frame": 0, "landmarks": body}],
        lambda body: {"frames": [{"landmark": body}]},
    ],
)
def test_lists_of_mediapipe(tmp_path, wrap):
    body = [
        {"x": 10 * n, "y": 7, "z": -1, "visibility": 0.5, "name": "abc"[n]}
        for n in range(3)
    ]
    path = table(tmp_path / "walk.json", json.dumps(wrap(body)))
    images, _ = read(path)
    assert images.as_columns().tolist() == [[[0, 10, 20], [7, 7, 7]]]
    assert images.landmark_names == ("a", "b", "c")


@pytest.mark.parametrize(
    ("stated", "score"),
    [({"presence": 0.9, "visibility": 0.2}, 0.2), ({"presence": 0.9}, 0.9), ({}, 1.0)],
)
def test_the_confidence_of_mediapipe(tmp_path, stated, score):
    """How visible a point is goes before whether it is in the image; without either it
    is 1.
    """
    body = [{"x": 10 * n, "y": 7, "z": -1, **stated} for n in range(3)]
    images, _ = read(table(tmp_path / "walk.json", json.dumps([body])))
    assert images.confidence.tolist() == [[score] * 3]


LONG = (
    "frame,{},joint,x,y\n0,{},a,1,2\n0,{},b,3,4\n1,{},a,5,6\n0,{},a,7,8\n0,{},b,9,10\n"
)


@pytest.mark.parametrize(
    ("column", "cells", "names"),
    [
        ("person_id", ("0", "7"), ["id 0", "id 7"]),
        ("track_id", ("0.0", "7.0"), ["id 0", "id 7"]),
        ("id", ("2", "-1"), ["id 2", ""]),
        ("individual", ("anna", "emil"), ["anna", "emil"]),
    ],
)
def test_columns_of_individuals(tmp_path, column, cells, names):
    one, other = cells
    images, notes = read(
        table(tmp_path / "t.csv", LONG.format(column, *[one] * 3, *[other] * 2))
    )
    first, second = names
    rest = f"t/{second}/0" if second else "t/untracked/0/0"
    assert images.items == (f"t/{first}/0", f"t/{first}/1", rest)
    assert images.points[2].tolist() == [[7, 8], [9, 10]]
    assert notes == ()
    wide = f"frame,{column},a_x,a_y,b_x,b_y\n"
    wide += f"0,{one},1,2,3,4\n1,{one},5,6,,\n0,{other},7,8,9,10\n"
    same, _ = read(table(tmp_path / "t.csv", wide))
    assert same.items == images.items
    np.testing.assert_array_equal(same.points, images.points)


def test_tables_in_metres_are_shapes_in_metres(tmp_path):
    """As `convert -o NAME.metres.csv` writes them, with ten digits of the time."""
    rows = [
        f"{n},{n / 120:.10g},{name},{n},2,3,,true"
        for n in (7, 8)
        for name in ("nose", "tail")
    ]
    text = "\n".join(["frame,time,landmark,x,y,z,sd,trusted", *rows]) + "\n"
    with open_shapes([table(tmp_path / "man.metres.csv", text)]) as source:
        shapes = source.whole()
        assert source.notes == ()
    assert shapes.unit == "m"
    assert shapes.frame_rate == 120.0
    assert len(shapes) == 2
    assert shapes.points[1].tolist() == [[8, 2, 3], [8, 2, 3]]


def test_videos_stand_as_they_appear_and_begin_at_0(tmp_path):
    text = "video,frame,a_x,a_y,b_x,b_y\nw,9,1,2,3,4\nv,5,5,6,7,8\nw,7,9,10,11,12\n"
    images, _ = read(table(tmp_path / "t.csv", text))
    assert images.items == ("t/w/7", "t/w/9", "t/v/5")
    assert images.column("frame").tolist() == [0, 2, 0]


def test_of_two_columns_of_one_meaning_the_first_counts(tmp_path):
    text = WIDE.replace("tail_y", "tail_y,frame_no").replace("0\n", "0,3\n")
    images, notes = read(table(tmp_path / "t.csv", text))
    assert images.items == ("t/7", "t/8")
    assert notes[0].endswith("columns left out: frame_no")


@pytest.mark.parametrize("numbers", [("5", "6"), ("0", "1"), ("1", "2"), ("01", "02")])
@pytest.mark.parametrize("keypoints", [None, "numbered"])
def test_numbers_of_landmarks_are_names(tmp_path, numbers, keypoints):
    one, two = numbers
    text = f"frame,x{one},y{one},x{two},y{two}\n0,10,20,30,40\n"
    images, _ = read(table(tmp_path / "t.csv", text), keypoints=keypoints)
    assert images.landmark_names == numbers


@pytest.mark.parametrize("name", ["t.csv", "t.tsv", "t.h5"])
@pytest.mark.parametrize(
    ("numbers", "first", "told"),
    [
        (range(17), "nose", ""),
        (range(1, 18), "nose", "1 to 17 counted from 1: 1 is nose of coco_17"),
        (range(1, 12), "left_eye", "1 to 11 counted from 0: 1 is left_eye of coco_17"),
        (range(2, 18), "left_eye", "2 to 17 counted from 1: 2 is left_eye of coco_17"),
    ],
)
def test_numbers_of_a_skeleton(tmp_path, name, numbers, first, told):
    """What is counted from 0 and from 1 is said wherever 0 is not among the numbers."""
    path = tmp_path / name
    names = tuple(map(str, numbers))
    points = np.arange(2.0 * len(names)).reshape(1, -1, 2) + 100
    if name.endswith(".h5"):
        shapefit.write_landmarks(path, shapefit.Landmarks(points, landmark_names=names))
    else:
        rows = [f"0,{n},{x},{y}" for n, (x, y) in zip(names, points[0], strict=True)]
        text = "\n".join(["item,landmark,x,y", *rows])
        table(path, text.replace(",", "\t" if name.endswith("tsv") else ","))
    assert read(path)[0].landmark_names == names
    images, notes = read(path, keypoints="coco_17")
    assert images.landmark_names[0] == first
    assert [told in note for note in notes] == ([True] if told else [])


def test_numbers_that_a_skeleton_has_not(tmp_path):
    text = "item,landmark,x,y\n0,0,10,20\n0,17,30,40\n"
    with pytest.raises(InputError, match=r"0 to 17; give another .* coco_17 has 17"):
        read(table(tmp_path / "t.csv", text), keypoints="coco_17")


SPECIMENS = "{},a_x,a_y,b_x,b_y\n{},1,2,30,40\n{},5,6,70,80\n"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize(
    ("column", "cells", "items"),
    [
        ("", ("MVZ_1", "MVZ_2"), ("MVZ_1", "MVZ_2")),
        ("Taxon", ("Mus", "Rattus"), ("Mus", "Rattus")),
        ("subject", ("s1", "s2"), ("s1", "s2")),
        ("ID", ("17", "12"), ("17", "12")),
        ("", ("7", "8"), ("7", "8")),
        ("Number", ("7", "8"), ("7", "8")),
        ("species", ("Mus", "Mus"), ("t/0", "t/1")),
    ],
)
def test_rows_without_number_or_time_are_single_images(
    tmp_path, delimiter, column, cells, items
):
    text = SPECIMENS.format(column, *cells).replace(",", delimiter)
    images, notes = read(table(tmp_path / "t.csv", text))
    assert images.items == items
    assert images.sequences is None
    assert images.frames is None
    named = f"column '{column}'" if column else "column without a name"
    told = (
        f"items are named by the {named}" if items[0] == cells[0] else "single images"
    )
    assert told in notes[0]
    assert "call it `frame`" in notes[0] or "call a column `frame`" in notes[0]


@pytest.mark.parametrize("delimiter", [",", ";"])
@pytest.mark.parametrize("column", ["item", "image", "Taxon"])
@pytest.mark.parametrize("track", ["none", "motion"])
def test_images_with_names_are_no_motion(tmp_path, delimiter, column, track):
    """Also where names are numbered: photographs of specimens are."""
    rows = [f"IMG_{n}.jpg,{landmark},{n},5" for n in range(30) for landmark in "abc"]
    text = "\n".join([f"{column},landmark,x,y", *rows])
    path = table(tmp_path / "t.csv", text.replace(",", delimiter))
    images, _ = read(path, track=track)
    assert images.sequences is None
    assert images.items[:2] == ("IMG_0.jpg", "IMG_1.jpg")


def test_a_data_frame_of_a_fit_comes_back(tmp_path):
    """As pandas writes it, with and without its index, and with empty columns."""
    head = "item,landmark,x,y,z,sd_x,sequence,frame,time,trusted"
    rows = [
        f"w/{frame},{name},{frame},2,3,.1,walk,{frame},{frame / 25},True"
        for frame in (3, 4, 9)
        for name in "ab"
    ]
    indexed = [f"{number},{row}" for number, row in enumerate(rows)]
    single = [row.replace("walk,", ",,,#").split("#")[0] + "True" for row in rows]
    for text in ([f",{head}", *indexed], [head, *rows], [head, *single]):
        with open_shapes([table(tmp_path / "t.csv", "\n".join(text))]) as source:
            shapes = source.whole()
        assert shapes.items == ("w/3", "w/4", "w/9")
        assert shapes.as_columns()[:, 0, 0].tolist() == [3, 4, 9]
        if text[1:] == single:
            assert not any(shapes.sequences or ())
            assert shapes.column("frame") is None
        else:
            assert shapes.sequences == ("walk",) * 3
            assert shapes.column("frame").tolist() == [3, 4, 9]


def test_rows_without_anything_beside_are_single_images(tmp_path):
    text = "a_x,a_y,b_x,b_y\n1,2,30,40\n5,6,70,80\n"
    images, (note,) = read(table(tmp_path / "t.csv", text))
    assert images.items == ("t/0", "t/1")
    assert images.sequences is None
    assert "rows are taken for single images" in note


@pytest.mark.parametrize("column", ["time", "Timestamp", "time (s)", "TIME"])
def test_rows_with_times_are_frames(tmp_path, column):
    text = f"{column},a_x,a_y,b_x,b_y\n0.5,1,2,3,4\n0.54,5,6,7,8\n0.66,9,8,7,6\n"
    images, notes = read(table(tmp_path / "t.csv", text))
    assert images.column("frame").tolist() == [0, 1, 4]
    assert images.frame_rate == 25
    assert images.items == ("t/0.5", "t/0.54", "t/0.66")
    assert len({*images.sequences}) == 1
    assert notes == ()


def test_pixels_and_millimetres_of_one_table(tmp_path):
    """As OpenFace writes them: x, y in the image, X, Y, Z before the camera."""
    names = [f"{axis}_{n}" for axis in "xyXYZ" for n in range(3)]
    names += [f"gaze_{n}_{axis}" for n in range(2) for axis in "xyz"]
    cells = ",".join(map(str, range(10, 10 + len(names))))
    path = table(tmp_path / "t.csv", f"frame,{','.join(names)}\n0,{cells}\n")
    images, notes = read(path)
    assert images.as_columns()[0].tolist() == [[10, 11, 12], [13, 14, 15]]
    assert "x_0, y_0 ... are read, as 2D" in notes[0]
    assert "X_0, Y_0, Z_0 ..." in notes[0]
    with open_shapes([path]) as source:
        shapes = source.whole()
    assert shapes.as_columns()[0].tolist() == [[16, 17, 18], [19, 20, 21], [22, 23, 24]]


@pytest.mark.parametrize(
    ("column", "seen", "unseen"),
    [
        ("visible", "1", "0"),
        ("Visible", "TRUE", "FALSE"),
        ("is_visible", "yes", "no"),
        ("vis", "2", "0"),
        ("visibility", "1", "0"),
        ("occluded", "0", "1"),
        ("Occluded", "False", "True"),
        ("hidden", "n", "y"),
        ("missing", "0", "1"),
    ],
)
@pytest.mark.parametrize("layout", ["long", "wide", "image"])
@pytest.mark.parametrize("delimiter", [",", "\t"])
def test_columns_that_hide_landmarks(tmp_path, column, seen, unseen, layout, delimiter):
    if layout == "long":
        text = f"item,landmark,x,y,{column}\n"
        text += f"i,a,10,20,{seen}\ni,b,30,40,{unseen}\n"
        weights = [[1.0, 0.0]]
    elif layout == "wide":
        text = f"item,a_x,a_y,a_{column},b_x,b_y,b_{column}\n"
        text += f"i,10,20,{seen},30,40,{unseen}\n"
        weights = [[1.0, 0.0]]
    else:
        text = f"item,{column},a_x,a_y,b_x,b_y\n"
        text += f"i,{seen},10,20,30,40\nj,{unseen},1,2,3,4\n"
        weights = [[1.0, 1.0], [0.0, 0.0]]
    path = table(tmp_path / "t.csv", text.replace(",", delimiter))
    images, _ = read(path)
    np.testing.assert_array_equal(images.confidence, weights)


@pytest.mark.parametrize(
    ("column", "cell"), [("occluded", "2"), ("visible", "5"), ("visible", "-1")]
)
def test_columns_that_hide_landmarks_are_refused_by_name(tmp_path, column, cell):
    text = f"item,landmark,x,y,{column}\ni,a,10,20,{cell}\ni,b,30,40,1\n"
    with pytest.raises(
        InputError, match=f"{cell} in the column {column}; write 0 or 1"
    ):
        read(table(tmp_path / "t.csv", text))


def test_a_confidence_of_each_image(tmp_path):
    text = "frame,confidence,a_x,a_y,b_x,b_y\n0,0.98,1,2,30,40\n1,0.02,5,6,70,80\n"
    images, (note,) = read(table(tmp_path / "t.csv", text))
    assert images.confidence.tolist() == [[0.98, 0.98], [0.02, 0.02]]
    assert "column 'confidence' weights all landmarks of its image" in note
    own = (
        text.replace("a_y", "a_y,a_score")
        .replace(",2,", ",2,1,")
        .replace("6,", "6,.5,")
    )
    images, (note,) = read(table(tmp_path / "t.csv", own))
    assert images.confidence.tolist() == [[1, 1], [0.5, 1]]
    assert "columns left out: confidence" in note


def test_columns_that_are_not_used_are_listed(tmp_path):
    text = ",item,landmark,x,y,confidense,note\n0,i,a,10,20,1,q\n1,i,b,30,40,1,r\n"
    _, (note,) = read(table(tmp_path / "t.csv", text))
    assert "left out: column 1 without a name, confidense (confidence?), note" in note


def test_cells_in_quotes_may_hold_the_delimiter(tmp_path):
    text = '"item","landmark","x","y","remark"\n'
    text += '"Smith, J. 1","a","10","20","q"\n"Smith, J. 1","b","3","4","r, s"\n'
    images, _ = read(table(tmp_path / "t.csv", text))
    assert images.items == ("Smith, J. 1",)


def test_a_landmark_whose_confidence_is_left_empty_has_1(tmp_path):
    text = "frame,joint,x,y,score\n0,a,10,20,\n0,b,30,40,.5\n"
    images, _ = read(table(tmp_path / "t.csv", text))
    assert images.confidence.tolist() == [[1.0, 0.5]]


DLC = "scorer,net,net,net,net\nbodyparts,nose,nose,tail,tail\ncoords,x,y,x,y\n"
DLC += "4,1.5,2,3,4\n5,6,7,8,9.25\n"


def as_excel(text: str, delimiter: str) -> str:
    return text.replace(",", delimiter).replace(".", ",")


def after_index(text: str, names: tuple[str, ...]) -> str:
    """Return a table after a column of pandas."""
    rows = text.splitlines()
    first = [*names, *map(str, range(len(rows)))][: len(rows)]
    return "".join(f"{name},{row}\n" for name, row in zip(first, rows, strict=True))


@pytest.mark.parametrize(
    "text",
    [
        DLC,
        as_excel(DLC, ";"),
        as_excel(DLC, "\t"),
        after_index(DLC, ("", "", "")),
        after_index(DLC.replace("net,net,net,net", "net,net.1,net.2,net.3"), ("",)),
        after_index(DLC, ("Unnamed: 0", "0", "1")),
        as_excel(after_index(DLC, ("", "", "")), ";"),
        DLC.replace("net,net,net,net", "net,net.1,net.2,net.3"),
        DLC.replace("\n", "\r"),
    ],
)
def test_tables_of_deeplabcut_that_were_saved_again(tmp_path, text):
    path = tmp_path / "video.csv"
    path.write_text(text, newline="", encoding="utf-8")
    images, notes = read(path)
    assert notes == ()
    assert images.items == ("video/4", "video/5")
    assert images.landmark_names == ("nose", "tail")
    found = images.as_columns().transpose(0, 2, 1).tolist()
    assert found == [[[1.5, 2], [3, 4]], [[6, 7], [8, 9.25]]]


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_arrays_of_3d_points_are_shapes(tmp_path, rng, scale):
    points = scale * rng.uniform(-1, 1, (6, 17, 3))
    path = tmp_path / "a.npy"
    np.save(path, points)
    options = InputOptions(keypoints="coco_17")
    assert find_kind(path, options) == "shapes"
    with open_shapes([path], options) as source:
        shapes = source.whole()
    assert shapes.landmark_names[0] == "nose"
    np.testing.assert_array_equal(shapes.as_columns().transpose(0, 2, 1), points)
    with pytest.raises(InputError, match=r"third numbers run.*3D are for learn-dict"):
        read(path, keypoints="coco_17")


def test_arrays_whose_third_number_may_be_either(tmp_path, rng):
    points = rng.uniform(0, 1, (6, 17, 3))
    path = tmp_path / "a.npy"
    np.save(path, points)
    with pytest.raises(InputError, match=r"image_size.*or `format=arrays-3d` if the"):
        read(path, keypoints="coco_17")
    options = InputOptions(keypoints="coco_17", format="arrays-3d")
    assert find_kind(path, options) == "shapes"
    with open_shapes([path], InputOptions(keypoints="coco_17")) as source:
        np.testing.assert_array_equal(source.whole().points, points)


def test_recordings_of_freemocap(tmp_path):
    names = [f"body_{n}_{a}" for n in ("nose", "left_hip", "right_hip") for a in "xyz"]
    rows = ["nan," * 8 + "nan", ",".join(map(str, range(9))), ",".join("123456789")]
    path = table(tmp_path / "body_3d_xyz.csv", "\n".join([",".join(names), *rows]))
    with open_shapes([path]) as source:
        shapes = source.whole()
    assert shapes.sequences == ("body_3d_xyz",) * 2
    assert shapes.column("frame").tolist() == [1, 2]
    assert shapes.unit == "mm"
