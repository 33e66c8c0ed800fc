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
    for other in entry.get("alternatives", ()):
        if other["accept"] is True:
            yield {
                **{key: value for key, value in entry.items() if "sum" in key},
                **other,
            }


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
    finite = np.isfinite(points).all(axis=1)
    scored, score = confidences(poses)
    wrong = []
    for wanted in readings(entry):
        got: dict[str, Any] = {
            "items": len(records),
            "finite_points": int(finite.sum()),
        }
        right = all(got[name] == wanted[name] for name in got)
        for number, axis in enumerate("xyz"[: points.shape[1]]):
            name = f"sum_{axis}"
            got[name] = points[:, number][finite].sum()
            size = wanted.get(f"abs_{name}", wanted[name])
            right &= close(got[name], wanted[name], size, entry["rtol"])
        if wanted["sum_confidence"] is None:
            right &= scored == 0
        else:
            right &= scored == wanted.get("confidence_points", wanted["finite_points"])
            right &= close(score, wanted["sum_confidence"], score, entry["rtol"])
        if right:
            return
        wrong.append((got, {name: wanted.get(name) for name in got}, scored, score))
    pytest.fail(f"no reading of {entry['path']} agrees: {wrong}")


def test_names_and_frames(entry, records, poses):
    counts = {wanted.get("landmarks", entry["landmarks"]) for wanted in readings(entry)}
    assert coordinates(records).shape[2] in counts
    if entry["landmark_names"] is not None:
        assert (
            list(records.landmark_names[: entry["landmarks"]])
            == entry["landmark_names"]
        )
    if entry["path"].startswith("motion/"):
        assert records.unit == ("m" if entry["unit"] == "m" else "unknown")
    if entry.get("individual_names") is not None:
        assert {*poses.individuals} <= {
            *entry["individual_names"]
        }  # some are in no frame


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
    parts = [item.split("/") for item in records.items]
    number = number_in_video(spot["frame_label"])
    if number is not None:
        rows = np.array([number in names[1:] for names in parts])
    elif isinstance(spot["frame_label"], dict) and "port" in spot["frame_label"]:
        end = "/port {port}/{frame_index}".format(**spot["frame_label"])
        rows = np.array([item.endswith(end) for item in records.items])
    else:
        rows = np.asarray(records.column(FRAME)) == spot["frame"]
    if isinstance(spot["individual"], str) and entry.get("individual_names"):
        rows &= np.array([spot["individual"] in names[1:] for names in parts])
    return np.flatnonzero(rows)


def test_spots(entry, records):
    points = coordinates(records)
    for spot in entry["spots"]:
        rows = rows_of(spot, entry, records)
        wanted = [spot[axis] for axis in "xyz"[: points.shape[1]]]
        found = points[rows, :, spot["landmark_index"]]
        near = np.isclose(found, wanted, rtol=entry["rtol"], atol=1e-9).all(axis=1)
        accepted = any(
            other["accept"] is True for other in entry.get("alternatives", ())
        )
        if (
            accepted
            and spot.get("confidence") == 0
            and np.isnan(found).any(axis=1).all()
        ):
            continue  # taken as missing, which an accepted reading does
        assert near.any(), (spot, found)
        if spot.get("confidence") is not None and not accepted:
            confidence = records.confidence[rows[near], spot["landmark_index"]]
            assert np.isclose(confidence, spot["confidence"], rtol=entry["rtol"]).any()
