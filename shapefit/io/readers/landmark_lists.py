"""Landmarks as lists of {x, y, ...}: those of MediaPipe, and of TensorFlow.js."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeGuard

import numpy as np

from shapefit.io.formats import FIRST, Head
from shapefit.io.readers.detections import Detection, poses_from_detections
from shapefit.io.readers.poses import (
    Images,
    Poses,
    as_numbers,
    require,
    video_name,
)
from shapefit.io.readers.text import read_json

BODIES = (
    "pose_landmarks",
    "poseLandmarks",
    "landmarks",
    "landmark",
    "keypoints",
    "hand_landmarks",
)
"""Where the bodies of a frame stand."""

SCORE_KEYS = ("visibility", "score", "confidence", "presence")
"""Where the confidence of a landmark stands."""

NUMBERS = ("frame", "frame_id", "frame_index", "frame_idx", "frame_number")
"""Where the number of a frame stands."""

NESTED = 4
"""Lists in lists that are looked into for bodies."""


def is_landmark_lists(head: Head) -> bool:
    """Whether a file is JSON with a list of {x, y, ...} in one of its first frames."""
    frames = _find_frames(head.json)[1][:FIRST]
    return any(True for frame in frames for _ in _find_bodies(frame))


def read_landmark_lists(paths: tuple[Path, ...]) -> Poses:
    """Read a JSON file of landmarks of MediaPipe: lists of {x, y, z, visibility}.

    Each body is such a list. A frame has one, or a list of them, or an object with them
    under `pose_landmarks` or the like. A file has one frame, a list of them, an object
    with `frames`, or one whose keys are the numbers of frames.
    """
    stated, frames = _find_frames(read_json(paths[0]))
    bodies = [
        (body, number)
        for number, frame in enumerate(frames)
        for body in _find_bodies(frame)
    ]
    require(bodies, "no list of landmarks")
    names = tuple(str(point.get("name") or "") for point in bodies[0][0])
    detections: list[Detection] = []
    for body, number in bodies:
        rows = [
            (point.get("x"), point.get("y"), _first_entry(point, SCORE_KEYS, 1.0))
            for point in body
        ]
        values = as_numbers(rows, f"x, y and confidence of landmarks of frame {number}")
        require(values.ndim == 2, f"landmarks of frame {number} are not x, y")
        detections.append((np.asarray(values), number, None))
    whole = len(stated) == len(frames) == len({*stated})
    numbers = [*stated] if whole else [*range(len(frames))]
    require(not stated or whole, "a frame without a number, or twice")
    first = min(numbers, default=0)
    images = Images(
        str(paths[0]),
        [video_name(paths[0])] * len(frames),
        [number - first for number in numbers],
        [*map(str, numbers)],
    )
    return poses_from_detections(
        images,
        detections,
        hide_unscored=False,
        unit=None,
        landmark_names=names if all(names) else None,
    )


def _find_frames(content: object) -> tuple[list[int], Sequence[object]]:
    """Find the frames in parsed JSON; return their stated numbers, and the frames.

    There may be fewer numbers than frames.
    """
    if isinstance(content, dict):
        numbered = [key for key in content if key.isdecimal() and key.isascii()]
        if content and len(numbered) == len(content):
            return [int(key[:18]) for key in numbered], [*content.values()]
        content = content.get("frames", [content])
    elif _is_body(content):
        content = [content]
    frames = content if isinstance(content, list) else []
    stated = [
        _first_entry(frame, NUMBERS, None)
        for frame in frames
        if isinstance(frame, dict)
    ]
    return [number for number in stated if isinstance(number, int)], frames


def _is_body(content: object) -> TypeGuard[list[object]]:
    """Whether parsed JSON is a list that has a landmark {x, y, ...}."""
    return isinstance(content, list) and any(
        isinstance(point, dict) and {"x", "y"} <= point.keys() for point in content
    )


def _find_bodies(
    frame: object, max_nesting: int = NESTED
) -> Iterator[list[dict[str, object]]]:
    """Yield the bodies of a frame, each a list of landmarks {x, y, ...}.

    max_nesting: how many levels of lists in lists are searched.
    """
    if isinstance(frame, dict):
        frame = _first_entry(frame, BODIES, ())
    if _is_body(frame):
        yield [point if isinstance(point, dict) else {} for point in frame]
    elif isinstance(frame, list) and max_nesting:
        for one in frame:
            yield from _find_bodies(one, max_nesting - 1)


def _first_entry(
    content: Mapping[str, object], keys: Sequence[str], default: object
) -> object:
    """Return the first value under these keys that is not None; else the default."""
    return next((content[key] for key in keys if content.get(key) is not None), default)
