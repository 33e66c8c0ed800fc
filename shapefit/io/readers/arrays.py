"""Arrays of landmarks without names, of NumPy or in JSON: (n, p, 2), or 3 with a confidence.

One body per image, the images in order. (p, 2) and (p, 3) are one image. In a .npz the confidences
may be an array (n, p) of their own.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import InputError, abbreviate, input_error
from shapefit.io.checks import warn_of_zeros
from shapefit.io.inputs import LARGEST_BYTES, check_fits, in_words
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.detections import are_series
from shapefit.io.readers.json_file import read_json
from shapefit.io.readers.poses import (
    FRACTION,
    Poses,
    are_fractions,
    of_frames,
    parsing,
    require,
    video_name,
)


def of_bodies(
    path: Path,
    points: Floats,
    confidence: Floats | None,
    *,
    labels: Sequence[str] | None = None,
    frames: Sequence[int] | None = None,
    videos: Sequence[str] | None = None,
    images: bool = False,
    individuals: Sequence[str] | None = None,
    notes: tuple[str, ...] = (),
    **further: Any,
) -> Poses:
    """Return the poses of points (n, p, 2 or 3), one body per image, NaN where one is missing.

    labels (n) are names or numbers of the images, by default their places; frames (n) do not fall
    within a video. They are `images` that have nothing to do with one another, or the frames of a
    video, of these individuals, by default of one. `further` are fields of a Poses. Raises
    InputError for confidences below 0.
    """
    n, _, dimensions = points.shape
    points = points.copy()
    if confidence is not None and (confidence < 0).any():
        found = f"has a confidence of {np.nanmin(confidence):g}"
        raise input_error(path, found, "write 0 (hidden) or a positive number")
    if dimensions == 2:
        notes += warn_of_zeros(points) if confidence is None else ()
    fraction = dimensions == 2 and are_fractions(points[np.isfinite(points)])
    names = labels or [str(row) for row in range(n)]
    return of_frames(
        path,
        points,
        confidence,
        names,
        frame=np.arange(n) if frames is None else np.array(frames, dtype=np.int64),
        individual=individuals or ([""] * n if images else None),
        video=video_name(path) if videos is None else videos,
        size_needed=fraction,
        unordered=images and not are_series(names),
        notes=notes,
        **{"unit": FRACTION if fraction else UNKNOWN_UNIT} | further,
    )


POINTS = ("landmarks", "keypoints", "points", "poses")
SCORES = ("confidence", "scores", "keypoint_scores", "likelihood", "visibility")
WANTED = "give (images, landmarks, 2), or 3 with a confidence of 0 to 1"


def read_array(paths: tuple[Path, ...]) -> Poses:
    """Return the images of an array, whose landmarks `keypoints` names."""
    return of_array(paths[0], *_read(paths[0]))


def of_array(
    path: Path, points: NDArray[Any], scores: NDArray[Any] | None = None, **further: Any
) -> Poses:
    """Return the images of an array (n, p, 2 or 3) or (p, 2 or 3); `path` names it in messages.

    `further` is what else `of_bodies` takes. Raises InputError for arrays of other shapes, and for
    a third number that is no confidence.
    """
    if points.ndim == 2:
        points, scores = points[None], None if scores is None else scores[None]
    with parsing(path, WANTED):
        numeric = points.dtype.kind in "biuf" and points.ndim == 3 and points.shape[2] in (2, 3)
        require(numeric, f"is an array of {points.dtype} and the shape {points.shape}")
        points = points.astype(np.float64)
        points = np.where(np.isfinite(points), points, np.nan)
        if points.shape[2] == 3:
            last = points[..., 2]
            least, most = np.nanmin(last, initial=np.inf), np.nanmax(last, initial=-np.inf)
            rows = points.reshape(-1, 3)[:2]
            shown = "; ".join(" ".join(f"{value:g}" for value in row) for row in rows)
            found = f"its third numbers run from {least:g} to {most:g}, so are they confidences?"
            found += f" (the first rows are {shown})"
            require(scores is None and not (least < 0 or most > 1), found)
            points, scores = points[..., :2], last
        if scores is not None:
            found = f"has confidences of the shape {scores.shape}, and points {points.shape}"
            require(scores.shape == points.shape[:2], found)
            scores = np.nan_to_num(scores.astype(np.float64))
    points[np.isnan(points).any(axis=2)] = np.nan
    return of_bodies(path, points, scores, **further)


def _read(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return the points of a file, and the confidences where they are an array of their own."""
    try:
        if path.name.lower().endswith((".json", ".json.gz")):
            return np.array(read_json(path), dtype=np.float64), None
        if zipfile.is_zipfile(path):
            return _read_archive(path)
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        check_fits(str(path), 2 * 8 * array.size)
        return np.array(array), None
    except InputError:
        raise
    except Exception as error:  # NumPy has many kinds of error for damaged files
        found = f"cannot be read as an array ({str(error).partition(chr(10))[0][:80]})"
        fix = f"{WANTED}; save it again with numpy.save, without objects"
        raise input_error(path, found, fix) from error


def _read_archive(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return the points and confidences of a .npz; of its other arrays the heads alone are read."""
    with zipfile.ZipFile(path) as archive:
        heads = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        shapes = {name: _shape_of(path, archive, entry) for name, entry in heads.items()}
    known = [name for name in shapes if name.lower() in POINTS]
    known = known or [name for name, shape in shapes.items() if len(shape) == 3]
    if len(known) != 1:
        held = abbreviate([f"{name} {shape}" for name, shape in shapes.items()]) or "nothing"
        raise input_error(path, f"holds {held}", "call the landmarks `landmarks`")
    scores = next((name for name in shapes if name.lower() in SCORES), None)
    size = sum(heads[name].file_size for name in (known[0], scores) if name)
    if size > LARGEST_BYTES:
        found = f"its landmarks are {in_words(size)}, and they are read whole"
        fix = f"divide it into files of less than {in_words(LARGEST_BYTES)}"
        raise input_error(path, found, fix)
    check_fits(str(path), 2 * size)
    with np.load(path, allow_pickle=False) as archive:
        return archive[known[0]], archive[scores] if scores else None


def _shape_of(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> tuple[int, ...]:
    """Return the shape of an array. Raises InputError where its file has not as many bytes."""
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        newer = version != (1, 0)
        read = np.lib.format.read_array_header_2_0 if newer else np.lib.format.read_array_header_1_0
        shape, _, dtype = read(file)
    if math.prod(shape) * dtype.itemsize > entry.file_size:
        found = f"{entry.filename} has the shape {shape}, and holds {in_words(entry.file_size)}"
        raise input_error(path, found, "save it again with numpy.savez")
    return shape
