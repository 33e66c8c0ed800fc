"""Frames that are dropped and unsorted in files of every kind: right numbers and times
in the files that are written in the end.
"""

import csv

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config import load_config
from shapefit.io import read_results, read_shapes
from shapefit.io.readers.markers import read_trc
from shapefit.io.skeletons import installed_skeletons
from shapefit.pipelines.convert import convert_files as convert
from tests.io.readers.numbered import (
    COUNT,
    IMAGES,
    RATE,
    amc,
    movement,
    nwb,
    text,
    yolo,
)
from tests.io.writers.conftest import parse_trc
from tests.pipelines.fitted import fit_file

from .test_gaps import COCO, figure

GIVEN = (4, 6, 5, 15, 3, 8)
"""In the order of the file."""

FRAMES = np.sort(GIVEN)
STEPS = FRAMES - FRAMES[0]
TIMES = STEPS / RATE

OF_MEDIAPIPE = dict(
    zip(installed_skeletons()["mediapipe_33"].landmark_names, COCO, strict=False)
)


def numbered_names(prefix):
    """Return landmarks of a file that have numbers -> what they are."""
    return {f"{prefix}{number}": COCO[number] for number in range(COUNT)}


NAMED = {
    "caliscope": OF_MEDIAPIPE,
    "deeplabcut": numbered_names("p"),
    "table": numbered_names("p"),
    "our_csv": numbered_names("p"),
    "deeplabcut_hdf5": numbered_names("point"),
    "slp": numbered_names("point"),
    "nwb": numbered_names("point"),
    "movement": numbered_names("point"),
}
"""What landmarks are called in files that name them -> what they are."""


SORTED_ALONE = (nwb, movement)
"""Formats in which times that fall are refused."""


KEYS = {
    "caliscope": {"keypoints": None},
    "yolo": {"keypoints": "coco_17", "image_size": [1000, 1000]},
}
"""Keys that the files of some tools need."""


def body(frame: int) -> np.ndarray:
    """Landmarks (17, 2) of a person who walks."""
    return np.round(figure([frame])[0].T, 2)


def write_as(path, *suffixes):
    """Convert a file to others beside it, named by their suffixes."""
    outputs = [path.with_name(f"out.{suffix}") for suffix in suffixes]
    for output in outputs:
        files = {"files": (path,), "output": output}
        assert list(convert(load_config("convert", None, [], files)))
    return outputs


def check_trc(path):
    """All frames are there, at their times; those that nobody gave are empty."""
    trc = parse_trc(path)
    filled = np.flatnonzero(~trc.empty)
    assert_allclose(np.diff(trc.times), 1 / RATE, atol=1e-6)
    assert_array_equal(filled, STEPS)
    assert_array_equal(read_trc((path,)).frame[filled], STEPS)


def from_first(column):
    """Return the numbers of items by those of the first."""
    numbers = np.array([*column.values()])
    return numbers - numbers[0]


def check_csv(path):
    """Frames by item, with the time where the file has it."""
    rows = [*csv.DictReader(path.open(encoding="utf-8"))]
    frames = {row["item"]: int(row["frame"]) for row in rows}
    assert_array_equal(from_first(frames), STEPS)
    if "time" in rows[0]:
        times = {row["item"]: float(row["time"]) for row in rows}
        assert_allclose(from_first(times), TIMES, atol=1e-6)


def check_mot(path):
    """A row for each frame that has a shape, at its time."""
    _, _, body = path.read_text(encoding="utf-8").partition("endheader\n")
    _labels, *rows = body.splitlines()
    times = [float(row.split("\t")[0]) for row in rows]
    assert_allclose(np.diff(times), np.diff(STEPS) / RATE, atol=1e-6)


def lift(path, folder, **keys):
    """Lift a file by people; return the result, and its file."""
    output = folder / "fit.h5"
    usual = {"image_size": [640, 480], "keypoints": "coco_17"}
    fit_file(path, "people", output, **usual | keys)
    return read_results(output), output


@pytest.mark.parametrize("make", IMAGES.values(), ids=IMAGES)
def test_frames_and_times_of_images_reach_the_files(tmp_path, make):
    name = make.__name__
    path = make(tmp_path / "v", FRAMES if make in SORTED_ALONE else GIVEN, body)
    keys = {"method": "sequences", "frame_rate": RATE}
    if name in NAMED:
        keys |= {"rename": NAMED[name], "keypoints": None}
    result, result_file = lift(path, tmp_path, **keys | KEYS.get(name, {}))
    trc, mot, table = write_as(result_file, "trc", "mot", "csv")
    assert_array_equal(result.frames - result.frames[0], STEPS)
    assert len({*result.sequences}) == 1
    check_trc(trc)
    check_mot(mot)
    check_csv(table)


@pytest.mark.parametrize("named", [False, True])
def test_an_empty_file_of_labels_is_an_image_of_nobody(tmp_path, named):
    folder = yolo(tmp_path / "v", FRAMES, body)
    empty = folder / f"image_{FRAMES[2]}.txt"
    empty.write_text("")
    files = folder / "*.txt" if named else folder
    result, _ = lift(files, tmp_path, method="convex", **KEYS["yolo"])
    expected = np.delete(FRAMES, 2) - FRAMES[0]
    assert_array_equal(result.frames - result.frames[0], expected)


def rows_of_markers(frames):
    """Return the coordinates of a person who walks 5 mm before a plane, y up."""
    rows = []
    for frame in frames:
        points = np.insert(body(frame) * (1, -1), 2, 5.0, axis=1)
        rows.append(points.ravel().tolist())
    return rows


def trc_of_markers(folder, frames):
    axes = "\t".join(f"{axis}{n}" for n in range(1, COUNT + 1) for axis in "XYZ")
    lines = [
        "PathFileType\t4\t(X/Y/Z)\tw.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        f"{RATE:g}\t{RATE:g}\t{len(frames)}\t{COUNT}\tmm",
        "Frame#\tTime\t" + "\t\t\t".join(COCO) + "\t\t",
        f"\t\t{axes}",
    ]
    for frame, row in zip(frames, rows_of_markers(frames), strict=True):
        cells = [frame, f"{frame / RATE:.6f}", *row]
        lines.append("\t".join(map(str, cells)))
    return text(folder / "w.trc", "\n".join([*lines, ""]))


def vicon_of_markers(folder, frames):
    lines = [
        "Trajectories",
        f"{RATE:g}",
        ",," + ",,,".join(COCO) + ",,",
        "Frame,Sub Frame" + ",X,Y,Z" * COUNT,
        ",," + "mm," * 3 * COUNT,
    ]
    for frame, row in zip(frames, rows_of_markers(frames), strict=True):
        lines.append(",".join(map(str, [frame, 0, *row])))
    return text(folder / "w.csv", "\n".join([*lines, ""]))


MOTION = {"TRC": trc_of_markers, "Vicon": vicon_of_markers, "AMC": amc}


WITH_JOINTS = {"TRC": trc_of_markers, "Vicon": vicon_of_markers}


@pytest.mark.parametrize("make", MOTION.values(), ids=MOTION)
def test_frames_and_times_of_motion_reach_our_files(tmp_path, make):
    path = make(tmp_path / "v", GIVEN)
    whole, table = write_as(path, "h5", "csv")
    shapes = read_shapes([whole], gaps=True)
    assert_array_equal(shapes.frames - shapes.frames[0], STEPS)
    check_csv(table)


@pytest.mark.parametrize("make", WITH_JOINTS.values(), ids=WITH_JOINTS)
def test_frames_and_times_of_motion_reach_files_of_joints(tmp_path, make):
    path = make(tmp_path / "v", GIVEN)
    trc, mot = write_as(path, "trc", "mot")
    check_trc(trc)
    check_mot(mot)
