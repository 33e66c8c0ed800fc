"""Frames that are dropped and unsorted in files of every kind: right numbers and times
in the files that are written in the end.
"""

import csv

import numpy as np
import pytest

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
NAMED = {
    "caliscope": OF_MEDIAPIPE,
    **{
        name: {f"p{n}": COCO[n] for n in range(COUNT)}
        for name in ("deeplabcut", "table", "our_csv")
    },
    **{
        name: {f"point{n}": COCO[n] for n in range(COUNT)}
        for name in ("deeplabcut_hdf5", "slp", "nwb", "movement")
    },
}
"""What landmarks are called in files that name them -> what they are."""


def body(frame: int) -> np.ndarray:
    """Landmarks (17, 2) of a person who walks."""
    return np.round(figure([frame])[0].T, 2)


def write_as(path, *suffixes):
    """Convert a file to others beside it, named by their suffixes."""
    outputs = [path.with_name(f"out.{suffix}") for suffix in suffixes]
    for output in outputs:
        names = {"files": (path,), "output": output}
        assert list(convert(load_config("convert", None, [], names)))
    return outputs


def check_trc(path):
    """All frames are there, at their times; those that nobody gave are empty."""
    rows = parse_trc(path)[3]
    np.testing.assert_allclose(np.diff(rows[:, 1]), 1 / RATE, atol=1e-6)
    filled = np.isfinite(rows[:, 2:]).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(filled), STEPS)
    poses = read_trc((path,))
    np.testing.assert_array_equal(poses.frame[filled], STEPS)


def check_csv(path):
    """Frames by item, with the time where the file has it."""
    rows = [*csv.DictReader(path.open(encoding="utf-8"))]
    frames = {row["item"]: int(row["frame"]) for row in rows}
    numbers = np.array([*frames.values()])
    np.testing.assert_array_equal(numbers - numbers[0], STEPS)
    if "time" in rows[0]:
        times = {row["item"]: float(row["time"]) for row in rows}
        seconds = np.array([*times.values()])
        np.testing.assert_allclose(seconds - seconds[0], TIMES, atol=1e-6)


def check_mot(path):
    """A row for each frame that has a shape, at its time."""
    table = path.read_text(encoding="utf-8").split("endheader\n")[1]
    times = [float(line.split("\t")[0]) for line in table.split("\n")[1:-1]]
    np.testing.assert_allclose(np.diff(times), np.diff(STEPS) / RATE, atol=1e-6)


@pytest.mark.parametrize("make", IMAGES.values(), ids=IMAGES)
def test_frames_and_times_of_images_reach_the_files(tmp_path, make):
    sorted_alone = make in (nwb, movement)  # times that fall are refused
    path = make(tmp_path / "v", FRAMES if sorted_alone else GIVEN, body)
    keys = {"method": "sequences", "image_size": [640, 480], "frame_rate": RATE}
    if make.__name__ not in NAMED or make.__name__ == "caliscope":
        keys["keypoints"] = None if make.__name__ == "caliscope" else "coco_17"
    rename = NAMED.get(make.__name__, {})
    if make.__name__ == "yolo":
        keys |= {"image_size": [1000, 1000]}
    fit_file(path, "people", tmp_path / "fit.h5", rename=rename, **keys)
    result = read_results(tmp_path / "fit.h5")
    np.testing.assert_array_equal(result.frames - result.frames[0], STEPS)
    assert len({*result.sequences}) == 1
    trc, mot, table = write_as(tmp_path / "fit.h5", "trc", "mot", "csv")
    check_trc(trc)
    check_mot(mot)
    check_csv(table)


@pytest.mark.parametrize("named", [False, True])
def test_an_empty_file_of_labels_is_an_image_of_nobody(tmp_path, named):
    folder = yolo(tmp_path / "v", FRAMES, body)
    (folder / f"image_{FRAMES[2]}.txt").write_text("")
    keys = {"image_size": [1000, 1000], "keypoints": "coco_17"}
    given = folder
    if named:
        given = folder / "*.txt"
    fit_file(given, "people", tmp_path / "fit.h5", **keys)
    result = read_results(tmp_path / "fit.h5")
    steps = np.delete(FRAMES, 2) - FRAMES[0]
    np.testing.assert_array_equal(result.frames - result.frames[0], steps)


def markers(suffix):
    """Return a maker of TRC or of Vicon's CSV of a person who walks."""

    def make(folder, frames):
        names = COCO
        rows = []
        for frame in frames:
            points = np.insert(body(frame) * (1, -1), 2, 5.0, axis=1).ravel()
            rows.append(points.tolist())
        if suffix == "trc":
            axes = "\t".join(
                f"{axis}{n}" for n in range(1, COUNT + 1) for axis in "XYZ"
            )
            lines = [
                "PathFileType\t4\t(X/Y/Z)\tw.trc",
                "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
                f"{RATE:g}\t{RATE:g}\t{len(frames)}\t{COUNT}\tmm",
                "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
                f"\t\t{axes}",
            ]
            lines += [
                "\t".join(map(str, [frame, f"{frame / RATE:.6f}", *row]))
                for frame, row in zip(frames, rows, strict=True)
            ]
        else:
            lines = ["Trajectories", f"{RATE:g}", ",," + ",,,".join(names) + ",,"]
            lines += ["Frame,Sub Frame" + ",X,Y,Z" * COUNT, ",," + "mm," * 3 * COUNT]
            lines += [
                ",".join(map(str, [frame, 0, *row]))
                for frame, row in zip(frames, rows, strict=True)
            ]
        return text(folder / f"w.{suffix}", "\n".join(lines) + "\n")

    return make


@pytest.mark.parametrize(
    ("make", "has_joints"),
    [(markers("trc"), True), (markers("csv"), True), (amc, False)],
    ids=["TRC", "Vicon", "AMC"],
)
def test_frames_and_times_of_motion_reach_the_files(tmp_path, make, has_joints):
    path = make(tmp_path / "v", GIVEN)
    whole, table = write_as(path, "h5", "csv")
    shapes = read_shapes([whole], gaps=True)
    np.testing.assert_array_equal(shapes.frames - shapes.frames[0], STEPS)
    check_csv(table)
    if has_joints:
        trc, mot = write_as(path, "trc", "mot")
        check_trc(trc)
        check_mot(mot)
