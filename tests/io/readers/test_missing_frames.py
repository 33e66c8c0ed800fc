"""Files in which frames are missing, not in order, or there twice: of the formats whose
rows or files have numbers.
"""

import json

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.io import open_landmarks
from shapefit.io.options import InputOptions
from tests.io.files import load, save
from tests.io.readers import made

NAMES = ("nose", "left_hip", "right_hip", "tail")


def points_of(frames):
    """Landmarks (n, p, 2) that say in which frame they are."""
    start = np.array([[20.0, 30], [10, 80], [40, 80], [25, 140]])
    return start + 3.0 * np.array(frames)[:, None, None]


def write_deeplabcut(folder, frames):
    path = folder / "v.csv"
    head = [
        ",".join(["scorer", *["n"] * 12]),
        ",".join(["bodyparts", *(name for name in NAMES for _ in range(3))]),
        ",".join(["coords", *("x", "y", "likelihood") * 4]),
    ]
    cells = np.insert(points_of(frames), 2, 0.9, axis=2).reshape(len(frames), 12)
    rows = [
        ",".join(map(str, [frame, *row]))
        for frame, row in zip(frames, cells, strict=True)
    ]
    path.write_text("\n".join([*head, *rows, ""]))
    return path


def write_deeplabcut_hdf5(folder, frames):
    path = folder / "v.h5"
    points = points_of(frames)[:, None]
    made.write_deeplabcut_hdf5(path, points, np.ones(points.shape[:3]))
    with h5py.File(path, "a") as file:
        (key,) = file
        table = file[f"{key}/table"][()]
        table["index"] = frames
        file[f"{key}/table"][...] = table
    return path


def write_labels(folder, frames):
    path = folder / "v.csv"
    lines = write_deeplabcut(folder, frames).read_text().split("\n")
    rows = [
        f"labeled-data/walk/img{int(line.partition(',')[0]):05d}.png,"
        + line.partition(",")[2]
        for line in lines[3:-1]
    ]
    path.write_text("\n".join([*lines[:3], *rows, ""]))
    return path


def write_openpose(folder, frames):
    path = folder / "v"
    path.mkdir()
    for frame, points in zip(frames, points_of(frames), strict=True):
        scored = np.insert(np.tile(points, (5, 1))[:17], 2, 0.9, axis=1)
        people = [{"pose_keypoints_2d": scored.ravel().tolist()}]
        name = f"walk_{frame:012d}_keypoints.json"
        (path / name).write_text(json.dumps({"people": people}))
    return path


def write_table(folder, frames):
    path = folder / "v.csv"
    head = ",".join(["frame", *(f"{name}_{axis}" for name in NAMES for axis in "xy")])
    rows = [
        ",".join(map(str, [frame, *points.ravel()]))
        for frame, points in zip(frames, points_of(frames), strict=True)
    ]
    path.write_text("\n".join([head, *rows, ""]))
    return path


def write_tidy(folder, frames):
    path = folder / "v.csv"
    lines = ["item,landmark,x,y,sequence,frame"]
    for row, frame in enumerate(frames):
        for name, (x, y) in zip(NAMES, points_of([frame])[0], strict=True):
            lines.append(f"v/{row},{name},{x},{y},v,{frame}")
    path.write_text("\n".join([*lines, ""]))
    return path


WRITERS = {
    "DeepLabCut CSV": write_deeplabcut,
    "DeepLabCut HDF5": write_deeplabcut_hdf5,
    "labels of DeepLabCut": write_labels,
    "OpenPose": write_openpose,
    "table": write_table,
    "tidy CSV": write_tidy,
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize(
    "frames",
    [
        [0, 1, 2, 50, 51, 52],
        [7, 3, 4, 12, 13, 90],
        [5, 40, 41, 42, 2, 1, 0],
        [900, 901, 905],
    ],
)
def test_frames_are_those_of_the_file_in_order(tmp_path, write, frames):
    path = write(tmp_path, frames)
    options = InputOptions(track="nearest")
    with open_landmarks([path], options) as source:
        images = source.whole()
    assert len({*images.sequences}) == 1 or write is write_openpose
    expected = np.sort(frames)
    found = images.frames - images.frames[0]
    assert found.tolist() == (expected - expected[0]).tolist()
    moved = (images.as_columns()[:, 0, 0] - images.as_columns()[0, 0, 0]) / 3
    assert_allclose(moved, expected - expected[0])
    for name in ("out.h5", "out.csv"):
        save(tmp_path / name, images)
        back = load(tmp_path / name)
        assert back.frames.tolist() == images.frames.tolist()
        assert_array_equal(back.points, images.points)


@pytest.mark.parametrize(
    "write", [write_deeplabcut, write_deeplabcut_hdf5, write_labels, write_table]
)
def test_a_frame_that_is_there_twice_is_refused(tmp_path, write):
    path = write(tmp_path, [0, 1, 1, 2])
    with pytest.raises(InputError, match=r"v(\.csv|\.h5)?: .*(1|img00001)'? is also"):
        load(path)


def test_times_of_a_table_are_those_of_its_frames(tmp_path):
    path = write_table(tmp_path, [0, 1, 5, 3])
    text = path.read_text().replace("frame,", "time,", 1)
    for frame in (1, 5, 3):
        text = text.replace(f"\n{frame},", f"\n{frame / 25},")
    path.write_text(text)
    images = load(path)
    assert images.frames.tolist() == [0, 1, 3, 5]
    assert images.frame_rate == 25.0
    assert_allclose(images.times, [0, 0.04, 0.12, 0.2])


def test_labelled_images_of_several_videos_are_apart(tmp_path):
    path = write_labels(tmp_path, [3, 900, 40, 7])
    text = path.read_text()
    path.write_text(text.replace("walk/img00040", "run/img00040"))
    images = load(path)
    assert images.items == ("v/walk/img00003", "v/walk/img00007", "v/walk/img00900",
                            "v/run/img00040")  # fmt: skip
    assert images.sequences == (*["v/walk"] * 3, "v/run")
    assert images.frames.tolist() == [0, 4, 897, 0]


@pytest.mark.parametrize(
    ("frame", "fault"),
    [("1.5", "a frame that is no whole number"), ("inf", "a frame without a number")],
)
def test_frames_of_deeplabcut_are_whole_numbers(tmp_path, problems, frame, fault):
    path = write_deeplabcut(tmp_path, [0, 1, 2])
    path.write_text(path.read_text().replace("\n1,", f"\n{frame},"))
    (line,) = problems(load, path)
    assert fault in line
