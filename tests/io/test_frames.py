"""The frame and the time of each item, from a file to the record and back."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.io.options import InputOptions
from shapefit.io.readers import items as reading
from shapefit.io.readers.poses import Poses
from shapefit.records import Landmarks, Shapes, order_by_frame
from tests.io.files import load, load_shapes, save

FRAMES = [4, 5, 12, 2, 3]
TIMES = [0.1, np.nan, 0.4, 1.25, 1 / 3]


@pytest.fixture
def images(rng):
    return Landmarks(
        rng.normal(size=(5, 2, 2)) * 100,
        landmark_names=("head", "foot"),
        items=("a/4", "a/5", "a/12", "b/2", "b/3"),
        sequences=("a", "a", "a", "b", "b"),
        frames=np.array(FRAMES),
        times=np.array(TIMES),
    )


@pytest.mark.parametrize("name", ["images.h5", "images.csv"])
def test_frames_and_times_come_back(tmp_path, images, name):
    path = tmp_path / name
    save(path, images)
    read = load(path)
    assert read.items == images.items
    assert read.frames.tolist() == FRAMES
    assert_array_equal(read.times, TIMES)
    assert_array_equal(read.landmarks, images.landmarks)


def test_they_stand_behind_the_sequence_in_csv(tmp_path, images):
    path = tmp_path / "t.csv"
    save(path, images)
    header, *rows = path.read_text().splitlines()
    rows_of_heads = rows[::2]
    assert header == "item,landmark,x,y,sequence,frame,time"
    assert [row.split(",", 4)[4] for row in rows_of_heads] == [
        "a,4,0.1",
        'a,5,""',
        "a,12,0.4",
        "b,2,1.25",
        f"b,3,{1 / 3}",
    ]


@pytest.mark.parametrize("name", ["shapes.h5", "shapes.csv"])
def test_shapes_have_them_too(tmp_path, rng, name):
    path = tmp_path / name
    shapes = Shapes(
        rng.normal(size=(3, 2, 3)),
        landmark_names=("head", "foot"),
        items=tuple("abc"),
        sequences=("s",) * 3,
        frames=np.array([1, 5, 6]),
        times=np.array([0.5, 1.0, 1.5]),
    )
    save(path, shapes)
    read, _ = load_shapes(path)
    assert read.frames.tolist() == [1, 5, 6]
    assert read.times.tolist() == [0.5, 1.0, 1.5]


@pytest.mark.parametrize("name", ["images.h5", "images.csv"])
def test_images_are_read_in_order_of_their_frames(tmp_path, images, name):
    path = tmp_path / name
    mixed = images.take([2, 4, 0, 3, 1])
    save(path, mixed)
    read = load(path)
    assert read.items == ("a/4", "a/5", "a/12", "b/2", "b/3")
    assert read.frames.tolist() == FRAMES
    assert_array_equal(read.landmarks, images.landmarks)


@pytest.fixture
def large(monkeypatch):
    """Let the smallest table be larger than what is held in memory."""
    monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", 2)
    monkeypatch.setattr("shapefit.io.inputs.BLOCK_BYTES", 60)


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4], [1, 0, 2, 3, 4]])
def test_frames_of_large_tables_are_put_in_order(tmp_path, images, large, order):
    path = tmp_path / "large.csv"
    save(path, images.take(order))
    assert load(path).frames.tolist() == FRAMES


def test_a_large_table_on_standard_input_must_be_in_order(
    tmp_path, images, large, problems, standard_input
):
    path = tmp_path / "mixed.csv"
    save(path, images.take([1, 0, 2, 3, 4]))
    standard_input(path.read_text())
    (line,) = problems(load, Path("-"))
    assert "not in order, and the table is large; name the file itself" in line


@pytest.fixture
def film(tmp_path, images):
    path = tmp_path / "film.csv"
    save(path, images)
    return path


@pytest.fixture
def single_images(tmp_path, images):
    """A file of images that are of no sequence, and so of no frame."""
    path = tmp_path / "single.csv"
    without_frames = images.without(["frame"])
    save(path, without_frames.replaced(sequences=None, items=tuple("pqrst")))
    return path


@pytest.mark.parametrize("film_first", [True, False])
def test_single_images_beside_frames_have_the_frame_0(
    images, film, single_images, film_first
):
    files = [film, single_images] if film_first else [single_images, film]
    both = load(*files)
    frames = dict(zip(both.items, both.frames.tolist(), strict=True))
    assert [frames[item] for item in images.items] == FRAMES
    assert [frames[item] for item in "pqrst"] == [0] * 5


def test_a_sequence_without_frames_beside_frames_is_refused(
    tmp_path, images, film, single_images, problems
):
    without_frames = tmp_path / "rows.csv"
    rows = images.without(["frame"]).replaced(items=tuple("vwxyz"))
    save(without_frames, rows)
    (line,) = problems(load, single_images, without_frames, film)
    assert "film.csv: its dataset frame is not that of" in line


NO_FRAMES_OR_TIMES = [
    ("1.5,0", "frame is '1.5'; write a whole number"),
    (",0", "frame is empty; write a whole number"),
    ("x,0", "frame is 'x'; write a whole number"),
    ("1e300,0", "frame is '1e300'; write a whole number"),
    ("inf,0", "frame is 'inf'; write a whole number"),
    ("1,inf", "time is 'inf'; write a finite number"),
    ("1,noon", "time is 'noon'; write a finite number"),
]


@pytest.mark.parametrize(("cells", "told"), NO_FRAMES_OR_TIMES)
def test_what_is_no_frame_or_time_is_named(csv_table, problems, cells, told):
    path = csv_table(f"item,landmark,x,y,frame,time\na,head,30,40,{cells}\n")
    (line,) = problems(load, path)
    assert line.startswith(f"{path}:2: {told}")


def test_an_item_is_of_one_frame(csv_table, problems):
    path = csv_table("item,landmark,x,y,frame\na,head,30,40,1\na,foot,30,40,2\n")
    (line,) = problems(load, path)
    assert line == f"{path}:3: frame is '2'; give all rows of an item one frame"


def test_frames_in_hdf5_are_whole_numbers(tmp_path, images, problems):
    path = tmp_path / "i.h5"
    save(path, images)
    with h5py.File(path, "a") as file:
        del file["frame"]
        file["frame"] = np.array(TIMES)
    (line,) = problems(load, path)
    assert line.startswith(f"{path}:/frame: holds float64 (5,)")


def test_of_files_with_and_without_times_some_are_unknown(tmp_path, images):
    timed = tmp_path / "one.h5"
    untimed = tmp_path / "two.h5"
    save(timed, images.take([0, 1]))
    third = images.take([2]).without(["time"])
    save(untimed, third.replaced(sequences=("c",)))
    read = load(timed, untimed)
    assert read.frames.tolist() == [4, 5, 12]
    assert_array_equal(read.times, [0.1, np.nan, np.nan])


def poses(frames, **fields):
    """Return poses of two landmarks in these frames of a video."""
    count = len(frames)
    points = np.arange(4.0 * count).reshape(count, 2, 2) + 10
    usual = {
        "points": points,
        "frame": np.array(frames),
        "label": [str(frame) for frame in frames],
        "video": "v",
    }
    return Poses(name="v.json", **usual | fields)


def test_a_reader_hands_on_frames_and_times_in_any_order():
    given = poses([7, 2, 30], time=np.array([0.7, 0.2, np.nan]))
    images, _ = reading.poses_to_landmarks(given, InputOptions())
    first_x = images.landmarks[:, 0, 0]
    assert images.items == ("v/2", "v/7", "v/30")
    assert images.frames.tolist() == [2, 7, 30]
    assert_array_equal(images.times, [0.2, 0.7, np.nan])
    assert_array_equal(first_x, [14, 10, 18])


def test_people_are_followed_in_order_of_frames():
    still = np.tile([[10.0, 10.0], [60.0, 100.0]], (3, 1, 1))
    given = poses([20, 0, 2], points=still, individual=["", "", ""])
    images, _ = reading.poses_to_landmarks(given, InputOptions(track="nearest"))
    assert images.frames.tolist() == [0, 2, 20]
    assert images.sequences == ("v/person 1", "v/person 1", "v/person 2")


def test_two_poses_of_one_body_in_a_frame_are_refused(problems):
    given = poses([1, 2, 2], label=["1", "2", "02"])
    (line,) = problems(reading.poses_to_landmarks, given, InputOptions())
    fix = "keep one pose of a body per frame"
    assert line == f"v.json: holds 'v/2' and 'v/02' in one frame; {fix}"


IN_ORDER = [
    ("aab", [1, 5, 0]),
    ("aba", [1, 0, 5]),
    (("", "", ""), [3, 2, 1]),
    (None, [3, 2]),
]
"""Sequences and frames of items; items of no sequence may stand in any order."""


OUT_OF_ORDER = [
    ("aba", [5, 0, 1], [2, 0, 1]),
    (("", "a", "", "a"), [3, 2, 2, 1], [0, 2, 3, 1]),
    ("aaa", [1, 1, 0], [2, 0, 1]),
]
"""Sequences and frames of items, and the order in which they are read."""


@pytest.mark.parametrize(("sequences", "frames"), IN_ORDER)
def test_what_is_in_order_stays_as_it_is(sequences, frames):
    assert order_by_frame(sequences, np.array(frames)) is None


@pytest.mark.parametrize(("sequences", "frames", "expected"), OUT_OF_ORDER)
def test_order_by_frame(sequences, frames, expected):
    order = order_by_frame(sequences, np.array(frames))
    assert order.tolist() == expected
