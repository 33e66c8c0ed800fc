"""Arrays as detectors give them: with confidences, of a skeleton, one image, several people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.errors import input_error
from shapefit.io.foreign.sources import landmark_file
from shapefit.io.joined import Source
from shapefit.io.options import InputOptions
from shapefit.io.plain.arrays import of_array
from shapefit.io.records import LandmarkSet

PLACE = Path("landmarks")
WANTED = "give (n, p, 2) or (n, p, 3) with a confidence of 0 to 1, or a list of (people, p, 2 or 3)"


def is_array_of_a_detector(landmarks: Any, keypoints: str | None) -> bool:
    """Whether landmarks have a confidence or a skeleton, or are one image or several people."""
    if keypoints is not None or is_crowd(landmarks):
        return True
    array = _array(landmarks)
    return array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)


def is_crowd(landmarks: Any) -> bool:
    """Whether landmarks are a list of frames, each with the landmarks of several people."""
    return isinstance(landmarks, list) and any(np.ndim(frame) == 3 for frame in landmarks)


def detected(landmarks: Any, names: Sequence[str], options: InputOptions) -> Source[LandmarkSet]:
    """Return arrays of a detector as a source; without `options.keypoints` names (p) name them.

    Raises InputError for arrays of other shapes.
    """
    further: dict[str, Any] = {}
    if is_crowd(landmarks):
        landmarks, further = in_one_array(landmarks)
    points = _array(landmarks)
    if options.keypoints is None:
        if points.shape[-2] != len(names):
            found = f"has {points.shape[-2]} landmarks without names, not {len(names)}"
            raise input_error("landmarks", found, 'name them, as in `keypoints="coco_17"`')
        further |= {"landmark_names": tuple(names)}
    return Source([landmark_file(of_array(PLACE, points, **further), options)])


def in_one_array(frames: Sequence[ArrayLike]) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return frames (people, p, 2 or 3), with any number of people each, as one array.

    Beside it stands of which frame each is. Raises InputError where they differ in their landmarks.
    """
    arrays = [_array(frame) for frame in frames]
    whole = [array for array in arrays if array.size]
    if len({array.shape[1:] for array in whole}) != 1 or whole[0].ndim != 3:
        raise input_error("landmarks", "frames that differ in their landmarks", WANTED)
    people = [len(array) if array.size else 0 for array in arrays]
    frame = np.repeat(np.arange(len(arrays)), people)
    labels = [str(number) for number in frame]
    return np.concatenate(whole), {"frames": frame.tolist(), "labels": labels, "images": True}


def _array(landmarks: ArrayLike) -> NDArray[Any]:
    try:
        return np.asarray(landmarks, np.float64)
    except (TypeError, ValueError):
        raise input_error("landmarks", "is no array of numbers", WANTED) from None
