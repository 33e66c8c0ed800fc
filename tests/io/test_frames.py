"""The frame and the time of each item, from a file to the record and back."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.io.options import InputOptions
from shapefit.io.readers import items as reading
from shapefit.io.readers.poses import Poses
from shapefit.records import Landmarks, Shapes
from tests.io.files import load, load_shapes, save

FRAMES = [4, 5, 12, 2, 3]
TIMES = [0.1, np.nan, 0.4, 1.25, 1 / 3]


@pytest.fixture
def images(rng):
    return Landmarks(
        (rng.normal(size=(5, 2, 2)) * 100).swapaxes(1, 2),
        landmark_names=("head", "foot"),
        items=("a/4", "a/5", "a/12", "b/2", "b/3"),
        sequences=("a", "a", "a", "b", "b"),
        frames=np.array(FRAMES),
        times=np.array(TIMES),
    )


@pytest.mark.parametrize("name", ["images.h5", "images.csv"])
def test_frames_and_times_come_back(tmp_path, images, name):
    save(tmp_path / name, images)
    read = load(tmp_path / name)
    assert read.items == images.items
    assert read.frames.tolist() == FRAMES
    np.testing.assert_array_equal(read.times, TIMES)
    np.testing.assert_array_equal(read.as_columns(), images.as_columns())


def test_they_stand_behind_the_sequence_in_csv(tmp_path, images):
    save(tmp_path / "t.csv", images)
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert lines[0] == "item,landmark,x,y,sequence,frame,time"
    assert [line.split(",", 4)[4] for line in lines[1::2]] == [
        "a,4,0.1",
        'a,5,""',
        "a,12,0.4",
        "b,2,1.25",
        f"b,3,{1 / 3}",
    ]


@pytest.mark.parametrize("name", ["shapes.h5", "shapes.csv"])
def test_shapes_have_them_too(tmp_path, rng, name):
    shapes = Shapes(
        rng.normal(size=(3, 3, 2)).swapaxes(1, 2),
        landmark_names=("head", "foot"),
        items=tuple("abc"),
        sequences=("s",) * 3,
        frames=np.array([1, 5, 6]),
        times=np.array([0.5, 1.0, 1.5]),
    )
    save(tmp_path / name, shapes)
    read, _ = load_shapes(tmp_path / name)
    assert (read.frames.tolist(), read.times.tolist()) == ([1, 5, 6], [0.5, 1.0, 1.5])


@pytest.mark.parametrize("name", ["images.h5", "images.csv"])
def test_images_are_read_in_order_of_their_frames(tmp_path, images, name):
    mixed = images.take([2, 4, 0, 3, 1])
    save(tmp_path / name, mixed)
    read = load(tmp_path / name)
    assert read.items == ("a/4", "a/5", "a/12", "b/2", "b/3")
    assert read.frames.tolist() == FRAMES
    np.testing.assert_array_equal(read.as_columns(), images.as_columns())


def test_frames_of_large_tables_are_put_in_order(
    tmp_path, images, problems, monkeypatch, standard_input
):
    monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", 2)
    monkeypatch.setattr("shapefit.io.inputs.BLOCK_BYTES", 60)
    save(tmp_path / "good.csv", images)
    assert load(tmp_path / "good.csv").frames.tolist() == FRAMES
    save(tmp_path / "mixed.csv", images.take([1, 0, 2, 3, 4]))
    assert load(tmp_path / "mixed.csv").frames.tolist() == FRAMES
    standard_input((tmp_path / "mixed.csv").read_text())
    (line,) = problems(load, Path("-"))
    assert "not in order, and the table is large; name the file itself" in line


def test_single_images_beside_frames_have_the_frame_0(tmp_path, images, problems):
    save(tmp_path / "film.csv", images)
    bare = images.without(["frame"])
    single = bare.replaced(sequences=None, items=tuple("pqrst"))
    save(tmp_path / "single.csv", single)
    for order in (("film", "single"), ("single", "film")):
        both = load(*(tmp_path / f"{name}.csv" for name in order))
        frames = dict(zip(both.items, both.frames.tolist(), strict=True))
        assert [frames[item] for item in images.items] == FRAMES
        assert {frames[item] for item in single.items} == {0}
    save(tmp_path / "rows.csv", bare.replaced(items=tuple("vwxyz")))
    paths = [tmp_path / f"{name}.csv" for name in ("single", "rows", "film")]
    (line,) = problems(load, *paths)
    assert "film.csv: its dataset frame is not that of" in line


@pytest.mark.parametrize(
    ("cells", "told"),
    [
        ("1.5,0", "frame is '1.5'; write a whole number"),
        (",0", "frame is empty; write a whole number"),
        ("x,0", "frame is 'x'; write a whole number"),
        ("1e300,0", "frame is '1e300'; write a whole number"),
        ("1,inf", "time is 'inf'; write a finite number"),
        ("1,noon", "time is 'noon'; write a finite number"),
    ],
)
def test_what_is_no_frame_or_time_is_named(tmp_path, csv, problems, cells, told):
    path = csv(f"item,landmark,x,y,frame,time\na,head,30,40,{cells}\n")
    (line,) = problems(load, path)
    assert line.startswith(f"{path}:2: {told}")


def test_an_item_is_of_one_frame(csv, problems):
    path = csv("item,landmark,x,y,frame\na,head,30,40,1\na,foot,30,40,2\n")
    (line,) = problems(load, path)
    assert line == f"{path}:3: frame is '2'; give all rows of an item one frame"


def test_frames_in_hdf5_are_whole_numbers(tmp_path, images, problems):
    save(tmp_path / "i.h5", images)
    with h5py.File(tmp_path / "i.h5", "a") as file:
        del file["frame"]
        file["frame"] = np.array(TIMES)
    (line,) = problems(load, tmp_path / "i.h5")
    assert line.startswith(f"{tmp_path / 'i.h5'}:/frame: holds float64 (5,)")


def test_of_files_with_and_without_times_some_are_unknown(tmp_path, images):
    save(tmp_path / "one.h5", images.take([0, 1]))
    other = images.take([2]).without(["time"]).replaced(sequences=("c",))
    save(tmp_path / "two.h5", other)
    read = load(tmp_path / "one.h5", tmp_path / "two.h5")
    assert read.frames.tolist() == [4, 5, 12]
    np.testing.assert_array_equal(read.times, [0.1, np.nan, np.nan])


def poses(frames, **fields):
    n = len(frames)
    points = np.arange(4.0 * n).reshape(n, 2, 2) + 10
    given = {"label": [str(frame) for frame in frames], "video": "v"}
    return Poses(name="v.json", points=points, frame=np.array(frames), **given | fields)


def test_a_reader_hands_on_frames_and_times_in_any_order():
    given = poses([7, 2, 30], time=np.array([0.7, 0.2, np.nan]))
    images, _ = reading.landmarks_of(given, InputOptions())
    assert images.items == ("v/2", "v/7", "v/30")
    assert images.frames.tolist() == [2, 7, 30]
    np.testing.assert_array_equal(images.times, [0.2, 0.7, np.nan])
    np.testing.assert_array_equal(images.as_columns()[:, 0, 0], [14, 10, 18])


def test_people_are_followed_in_order_of_frames():
    still = np.tile([[10.0, 10.0], [60.0, 100.0]], (3, 1, 1))
    given = replace(poses([20, 0, 2]), points=still, individual=["", "", ""])
    images, _ = reading.landmarks_of(given, InputOptions(track="nearest"))
    assert images.frames.tolist() == [0, 2, 20]
    assert images.sequences == ("v/person 1", "v/person 1", "v/person 2")


def test_two_poses_of_one_body_in_a_frame_are_refused(problems):
    given = poses([1, 2, 2], label=["1", "2", "02"])
    (line,) = problems(reading.landmarks_of, given, InputOptions())
    fix = "keep one pose of a body per frame"
    assert line == f"v.json: holds 'v/2' and 'v/02' in one frame; {fix}"
