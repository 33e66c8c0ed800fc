"""Real files of detectors, against numbers that other programs found in them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shapefit.io.foreign.opening import open_recording
from shapefit.io.formats import find_format

from .conftest import read

pytestmark = pytest.mark.real_data

PATHS = {
    "coco/annotations_mixed_animals.json": {},
    "coco/annotations_val2017_subset.json": {},
    "coco/annotations_visibility_ternary.json": {},
    "coco/results_fakekeypoints100.json": {},
    "mediapipe/xy_HOLISTIC_first.csv": {},
    "openpose/cam01_json/": {"keypoints": "body_25b"},
    "openpose/two_people_cam01_json/": {"keypoints": "body_25b"},
    "ultralytics/image_001.txt": {},
}


def readings(entry: dict[str, Any]) -> list[dict[str, Any]]:
    """The literal contents of a file, and the other readings that its format leaves open."""
    others = [each for each in entry.get("alternatives", ()) if each["accept"] is True]
    return [entry, *({**entry, **each} for each in others)]


@pytest.mark.parametrize("path", PATHS)
def test_a_file_holds_what_others_find_in_it(real_data: Path, path: str) -> None:
    folder = real_data / "formats"
    entries = json.loads((folder / "expected.json").read_text("utf-8"))["entries"]
    entry = next(each for each in entries if each["path"] == path)
    images, _ = read(folder / path, **PATHS[path])
    known = find_format(folder / path)
    recording = open_recording(known, (folder / path,), "landmarks")
    assert recording.frames == entry["frames"]
    x, y = images.landmarks.transpose(1, 0, 2)
    placed = np.isfinite(x) & np.isfinite(y)

    def agrees(want: dict[str, Any]) -> bool:
        close = {"rtol": 0, "atol": want["rtol"] * want["abs_sum_x"]}
        confidence = want["sum_confidence"]
        return (
            len(images) == want["items"]
            and placed.sum() == want["finite_points"]
            and np.isclose(np.nansum(x), want["sum_x"], **close)
            and np.isclose(np.nansum(y), want["sum_y"], **close)
            and (images.confidence is None) == (confidence is None)
            and (confidence is None or np.isclose(images.confidence.sum(), confidence, rtol=1e-5))
        )

    assert any(agrees(want) for want in readings(entry))
    assert len(images.landmark_names) == entry["landmarks"]
    if entry["landmark_names"]:
        assert list(images.landmark_names) == entry["landmark_names"]
    for spot in entry["spots"]:
        at = images.landmarks[:, :, spot["landmark_index"]]
        here = np.isclose(at, [spot["x"], spot["y"]], atol=1e-9).all(axis=1)
        if spot["confidence"] == 0:  # missing, as the accepted reading has it
            continue
        assert here.any(), spot
        if path.startswith(("openpose", "ultralytics", "mediapipe")):
            label = spot["frame_label"]
            number = label["frame_index"] if isinstance(label, dict) else label.split(".")[-2][-3:]
            rows = np.flatnonzero(here)
            assert any(
                f"/{int(number)}" in images.items[row]
                for row in rows
                if not isinstance(label, dict) or f"port {label['port']}/" in images.items[row]
            )
