"""Real files of other tools hold what independent readers found in them."""

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shapefit.io import open_landmarks, read_shapes
from shapefit.io.detect import FORMATS, group_inputs
from shapefit.io.layout import FRAME
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.readers.items import read_poses
from shapefit.io.readers.poses import Poses

PROJECT = Path(__file__).resolve().parents[3]
REAL_DATA = Path(
    os.environ.get("SHAPEFIT_REAL_DATA", PROJECT.parent / "shared" / "data")
)
EXPECTED = REAL_DATA / "formats" / "expected.json"

ABSENT = {"path": "absent"}
ENTRIES = (
    json.loads(EXPECTED.read_text())["entries"] if EXPECTED.is_file() else [ABSENT]
)

SAME = {"lightning": "deeplabcut"}
"""Tools that write the format of another."""

OPTIONS = {"openpose": InputOptions(keypoints="body_25b")}
"""What files of a format do not say."""


def tool(entry: Mapping[str, Any]) -> str:
    first = str(entry.get("format", "")).split("-")[0]
    return SAME.get(first, first)


def is_read(entry: Mapping[str, Any]) -> bool:
    return any(name.startswith(tool(entry)) for name in FORMATS)


READ = [entry for entry in ENTRIES if is_read(entry)] or [ABSENT]


def test_no_entry_is_left_out(real_data):
    assert [entry["path"] for entry in ENTRIES if not is_read(entry)] == []


@pytest.fixture(params=READ, ids=lambda entry: entry["path"])
def entry(request, real_data) -> dict[str, Any]:
    return request.param


@pytest.fixture
def path(entry, real_data) -> Path:
    return real_data / "formats" / entry["path"]


@pytest.fixture
def options(entry) -> InputOptions:
    return OPTIONS.get(tool(entry), AS_THEY_ARE)


@pytest.fixture
def poses(entry, path, options) -> Poses:
    ((known, paths),) = group_inputs([path], options)
    return read_poses(known, paths)


@pytest.fixture
def records(entry, path, options) -> Any:
    """The items of a file."""
    if entry["kind"] == "shapes":
        return read_shapes([path], options, gaps=True)
    with open_landmarks([path], options) as source:
        (landmarks,) = source.batches(max(source.count, 1))
        return landmarks


def coordinates(records: Any) -> np.ndarray:
    return records.as_columns()


def readings(entry: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The numbers of an entry, and those of the other readings that are right, too."""
    yield entry
    sums = {key: value for key, value in entry.items() if "sum" in key}
    for other in entry.get("alternatives", ()):
        if other["accept"] is True:
            yield {**sums, **other}


def agrees(points: np.ndarray, reading: Mapping[str, Any], rtol: float) -> bool:
    """Say whether points (n, d, p) are as many and have the sums of a reading."""
    finite = np.isfinite(points).all(axis=1)
    if len(points) != reading["items"] or finite.sum() != reading["finite_points"]:
        return False
    for number, axis in enumerate("xyz"[: points.shape[1]]):
        expected = reading[f"sum_{axis}"]
        size = reading.get(f"abs_sum_{axis}", expected)
        if not close(points[:, number][finite].sum(), expected, size, rtol):
            return False
    return True


def agrees_in_confidence(poses: Poses, reading: Mapping[str, Any], rtol: float) -> bool:
    """Say whether the confidences are as many and have the sum of a reading."""
    count, total = confidences(poses)
    expected = reading["sum_confidence"]
    if expected is None:
        return count == 0
    expected_count = reading.get("confidence_points", reading["finite_points"])
    return count == expected_count and close(total, expected, total, rtol)


def close(got: float, wanted: float, size: float, rtol: float) -> bool:
    return abs(got - wanted) <= rtol * abs(size) + 1e-9


def confidences(poses: Poses) -> tuple[int, float]:
    """Number and sum of the confidences that points have."""
    if poses.confidence is None:
        return 0, 0.0
    placed = np.isfinite(poses.points).all(axis=2) & np.isfinite(poses.confidence)
    return int(placed.sum()), float(poses.confidence[placed].sum())


def test_items_and_sums(entry, records, poses):
    points = coordinates(records)
    rtol = entry["rtol"]
    agreeing = [
        reading
        for reading in readings(entry)
        if agrees(points, reading, rtol) and agrees_in_confidence(poses, reading, rtol)
    ]
    sums = np.nansum(points, axis=(0, 2))
    assert agreeing, (len(points), sums, confidences(poses), [*readings(entry)])


def test_names_and_frames(entry, records, poses):
    count = entry["landmarks"]
    counts = {reading.get("landmarks", count) for reading in readings(entry)}
    names = entry["landmark_names"]
    assert coordinates(records).shape[2] in counts
    if names is not None:
        assert list(records.landmark_names[:count]) == names


def test_units_of_motion(entry, records):
    if entry["path"].startswith("motion/"):
        expected = "m" if entry["unit"] == "m" else "unknown"
        assert records.unit == expected


def test_individuals_are_those_of_the_file(entry, poses):
    """Some are in no frame."""
    names = entry.get("individual_names")
    if names is not None:
        assert {*poses.individuals} <= {*names}


def number_in_video(label: Any) -> str | None:
    """The number of a frame in files that hold several videos; places there are not of
    the file.
    """
    if isinstance(label, list):
        return str(label[1])
    if isinstance(label, dict) and "frame_index" in label:
        return str(label["frame_index"])
    return None


def rows_of(
    spot: Mapping[str, Any], entry: Mapping[str, Any], records: Any
) -> np.ndarray:
    """The items of the frame and the individual of a spot."""
    label = spot["frame_label"]
    parts = [item.split("/") for item in records.items]
    number = number_in_video(label)
    if number is not None:
        rows = np.array([number in names[1:] for names in parts])
    elif isinstance(label, dict) and "port" in label:
        end = f"/port {label['port']}/{label['frame_index']}"
        rows = np.array([item.endswith(end) for item in records.items])
    else:
        rows = np.asarray(records.column(FRAME)) == spot["frame"]
    if isinstance(spot["individual"], str) and entry.get("individual_names"):
        rows &= np.array([spot["individual"] in names[1:] for names in parts])
    return np.flatnonzero(rows)


def has_other_readings(entry: Mapping[str, Any]) -> bool:
    return any(other["accept"] is True for other in entry.get("alternatives", ()))


def test_spots(entry, records):
    points = coordinates(records)
    rtol = entry["rtol"]
    may_differ = has_other_readings(entry)
    for spot in entry["spots"]:
        rows = rows_of(spot, entry, records)
        landmark = spot["landmark_index"]
        expected = [spot[axis] for axis in "xyz"[: points.shape[1]]]
        found = points[rows, :, landmark]
        confidence = spot.get("confidence")
        is_missing = np.isnan(found).any(axis=1).all()
        if may_differ and confidence == 0 and is_missing:
            continue  # as an accepted reading takes it
        near = np.isclose(found, expected, rtol=rtol, atol=1e-9).all(axis=1)
        assert near.any(), (spot, found)
        if confidence is not None and not may_differ:
            stated = records.confidence[rows[near], landmark]
            assert np.isclose(stated, confidence, rtol=rtol).any()
