"""Arrays of landmarks or shapes without names: NumPy's, and lists of JSON."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, printable
from shapefit.io.checks import warn_of_zeros
from shapefit.io.formats import Head
from shapefit.io.inputs import check_fits, check_unpacked
from shapefit.io.readers.poses import (
    FrameFields,
    Poses,
    as_numbers,
    guess_unit,
    library_reads,
    parsing,
    poses_from_frames,
    require,
)
from shapefit.io.readers.text import read_json

POINTS = ("landmarks", "keypoints", "points", "poses", "shapes")
COPIES = 3
"""Of an array that are in memory while it is read."""

SCORES = ("confidence", "scores", "keypoint_scores", "likelihood", "visibility")

WANTED = (
    "give (images, landmarks, 2), or 3 with a confidence of 0 to 1; points in 3D are"
    " for learn-dict, project and --truth"
)
SAVED_ANEW = "save it again with numpy.save, without objects"
OR_DEPTH = "; or `format=arrays-3d` if the third number is z, not a confidence"


def is_array(head: Head) -> bool:
    """Whether a file is .npy or .npz of NumPy, or JSON of lists in a list."""
    first = head.json[0] if isinstance(head.json, list) and head.json else None
    numbers = isinstance(first, list) and not any(isinstance(x, dict) for x in first)
    archive = head.bytes.startswith(b"PK\x03\x04") and head.has_suffix(".npz")
    return archive or numbers or head.bytes.startswith(b"\x93NUMPY")


def read_shape_array(paths: tuple[Path, ...]) -> Poses:
    """Read an array (n, p, 3) of 3D points from a file of NumPy or JSON."""
    return read_array(paths, 3)


def read_array(paths: tuple[Path, ...], dimensions: int | None = None) -> Poses:
    """Read an array (n, p, 2 or 3) of points from a file of NumPy or JSON.

    In .npz confidences (n, p) may stand beside it. `dimensions` says what a third
    number is, as in `poses_from_array`. Raises FormatError where it cannot tell which
    array is meant.
    """
    path = paths[0]
    if path.name.lower().endswith((".json", ".json.gz")):
        array = as_numbers(read_json(path), "the lists")
        return poses_from_array(path, array, dimensions=dimensions)
    damage, saved_anew = "it is damaged, or holds objects", f"{WANTED}; {SAVED_ANEW}"
    with library_reads(damage, saved_anew):
        check_archive(path)
        arrays = np.load(path, mmap_mode="r", allow_pickle=False)
    if not isinstance(arrays, np.lib.npyio.NpzFile):
        return poses_from_array(path, arrays, dimensions=dimensions)
    scores = [name for name in arrays if name.lower() in SCORES]
    points = [name for name in arrays if name.lower() in POINTS]
    points = points or [name for name in arrays if name not in scores]
    names = abbreviate([*map(printable, arrays)]) or "nothing"
    require(len(points) == 1, f"it holds {names}; call the landmarks `landmarks`")
    with library_reads(damage, saved_anew):
        landmarks = arrays[points[0]]
        confidence = arrays[scores[0]] if scores else None
    return poses_from_array(path, landmarks, confidence, dimensions=dimensions)


def check_archive(path: Path) -> None:
    """Raise InputError where the arrays of an .npz file take too much memory.

    That is more than is free, or than a file of its size can hold. Other files pass.
    """
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    check_unpacked(path, size, path.stat().st_size)
    check_fits(str(path), COPIES * size)


def poses_from_array(
    path: Path,
    points: NDArray[np.generic],
    scores: NDArray[np.generic] | None = None,
    dimensions: int | None = 2,
    **fields: Unpack[FrameFields],
) -> Poses:
    """Check an array (n, p, 2 or 3), or (p, 2 or 3) of one image; return it as Poses.

    `path` names it in messages; `fields` are those of `poses_from_frames`.

    A third number is z where shapes are wanted (`dimensions` 3), a confidence where
    images are (2), and without a wish (None) a confidence where all are in 0 to 1.
    Raises InputError for arrays of other shapes, and for a third number that is no
    confidence.
    """
    if points.ndim == 2:
        points, scores = points[None], None if scores is None else scores[None]
    with parsing(path, "an array of landmarks", WANTED):
        numeric = (
            points.dtype.kind in "biuf"
            and points.ndim == 3
            and points.shape[2] in (2, 3)
        )
        require(numeric, f"{points.dtype} of the shape {points.shape}")
        values = points.astype(np.float64)
        if values.shape[2] == 3:
            least = np.nanmin(values[..., 2], initial=np.inf)
            most = np.nanmax(values[..., 2], initial=-np.inf)
            as_confidence = not (least < 0 or most > 1) and scores is None
            if dimensions == 3 or (dimensions is None and not as_confidence):
                return poses_from_bodies(path, values, None, **fields)
            twice = "three numbers of each landmark beside its confidence"
            require(scores is None, twice)
            range_found = f"third numbers run from {least:g} to {most:g}"
            require(as_confidence, f"{range_found}, are they confidences?")
            scores = values[..., 2]
            values = values[..., :2]
            fields.setdefault("or_else", OR_DEPTH)
        confidence = None
        if scores is not None:
            fits = scores.dtype.kind in "biuf" and scores.shape == points.shape[:2]
            require(fits, f"confidences are {scores.dtype} of the shape {scores.shape}")
            confidence = np.nan_to_num(scores.astype(np.float64))
        return poses_from_bodies(path, values, confidence, **fields)


def poses_from_bodies(
    path: Path, points: Floats, confidence: Floats | None, **fields: Unpack[FrameFields]
) -> Poses:
    """Make Poses of points (n, p, 2 or 3), one body per image; warn of many zeros.

    `fields` are those of `poses_from_frames`. Raises FormatError for confidences below
    0.
    """
    require(confidence is None or not (confidence < 0).any(), "a confidence below 0")
    points = np.where(np.isnan(points).any(axis=2, keepdims=True), np.nan, points)
    if points.shape[2] == 2 and confidence is None:
        fields["notes"] = (*fields.get("notes", ()), *warn_of_zeros(points))
    unit = guess_unit(points)
    fields.setdefault("unit", unit["unit"])
    fields.setdefault("size_needed", unit["size_needed"])
    return poses_from_frames(path, points, confidence, **fields)
