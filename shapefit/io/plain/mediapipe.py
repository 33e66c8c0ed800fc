"""Landmarks as MediaPipe gives them, written as JSON: lists of {x, y, z, visibility}.

Each body is such a list. A frame has one, or a list of them, or an object with them under
`pose_landmarks` or the like. A file has one frame, a list of them, or an object with `frames`.
x and y are fractions of the image.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.detectors.detections import Detections, as_recording
from shapefit.io.detectors.json_text import read_json, without_collection
from shapefit.io.foreign.recording import FRACTION, Recording, video_name
from shapefit.io.foreign.sources import are_fractions
from shapefit.io.layout import UNKNOWN_UNIT

BODIES = (
    *("pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints"),
    *("multi_hand_landmarks", "hand_landmarks", "handLandmarks", "face_landmarks"),
)
"""Keys of bodies, the first that an object has; landmarks in metres (`world`) are not read."""

FRAMES = ("frames", "results")
SCORES = ("visibility", "score", "confidence", "presence")

_POINT = re.compile(rb'\{\s*(?:"(?:name|id)"\s*:\s*"?\w+"?,\s*)?"x"\s*:\s*[^,{}]+,\s*"y"\s*:')


def is_mediapipe(path: Path, head: bytes) -> bool:
    """Whether JSON begins with objects of x and y."""
    return head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"[") and bool(_POINT.search(head))


@without_collection
def record(paths: tuple[Path, ...]) -> Recording:
    """Return the bodies of all frames of a file. Raises InputError for what are no points."""
    path = paths[0]
    found = read_json(path)
    if isinstance(found, dict):
        found = next((found[key] for key in FRAMES if isinstance(found.get(key), list)), [found])
    elif _is_body(found):
        found = [found]
    if not isinstance(found, list):
        raise input_error(path, "is no list of frames", "give MediaPipe's landmarks")
    detections = Detections(str(path), video_name(path))
    names: list[Any] = []
    for number, frame in enumerate(found):
        for body in _bodies(frame):
            numbers = [value for point in body for value in _numbers(point)]
            detections.add(numbers, number, str(number), None)
            names = names or [point.get("name") for point in body]
    values = detections.values()
    placed = values[np.isfinite(values).all(axis=2)]
    fractions = are_fractions(placed[:, :2])
    named = all(isinstance(name, str) and name for name in names) and len({*names}) == len(names)
    return as_recording(
        detections,
        values,
        np.asarray(np.isnan(values[..., :2]).any(axis=2)),
        confidence=np.nan_to_num(values[..., 2]),
        frames=len(found),
        unit=FRACTION if fractions else UNKNOWN_UNIT,
        size_needed=fractions,
        landmark_names=tuple(names) if named and names else None,
    )


def _is_body(found: Any) -> bool:
    return isinstance(found, list) and any(isinstance(one, dict) and "x" in one for one in found)


def _bodies(frame: Any) -> Iterator[list[dict[str, Any]]]:
    """Yield the bodies of a frame; there may be none."""
    if _is_body(frame):
        yield [point if isinstance(point, dict) else {} for point in frame]
    elif isinstance(frame, list):
        for one in frame:
            yield from _bodies(one)
    elif isinstance(frame, dict):
        yield from _bodies(next((frame[key] for key in BODIES if frame.get(key)), None))


def _numbers(point: dict[str, Any]) -> list[Any]:
    """Return x, y and confidence of a point, NaN for what it does not say."""
    score = next((point[key] for key in SCORES if point.get(key) is not None), 1.0)
    known = [point.get("x"), point.get("y"), score]
    return [math.nan if value is None else value for value in known]
