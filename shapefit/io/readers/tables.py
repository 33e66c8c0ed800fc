"""Tables of no known tool, caliscope's CSV, and NumPy's arrays of landmarks.

A *wide* table has a row per image, and columns for each landmark; a *long* one has a row per
landmark of an image. Cells are separated by `,`, `;` or tabs; with the latter two the decimal point
may be a comma.
"""

from __future__ import annotations

import csv
import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import InputError, abbreviate, input_error, printable
from shapefit.io.checks import warn_of_zeros
from shapefit.io.inputs import check_fits
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    FRACTION,
    Poses,
    are_fractions,
    are_series,
    of_frames,
    parsing,
    require,
    video_name,
)
from shapefit.io.readers.text import Table, read_json, read_text, split_rows
from shapefit.io.skeletons import installed_skeletons
from shapefit.io.tidy_table import read_numbers

# Headers.

ROLES: Mapping[str, str] = {
    name: role
    for role, names in {
        "item": "item image filename file file_name image_name image_id img",
        "frame": "frame frame_id frame_idx frame_index frame_number frame_no fnum",
        "sequence": "sequence video clip session",
        "individual": "individual person person_id track track_id animal subject id",
        "landmark": "landmark joint bodypart body_part keypoint part node marker landmark_name "
        "joint_name keypoint_name landmark_id joint_id keypoint_id landmark_index",
        "x": "x x_px px",
        "y": "y y_px py",
        "z": "z",
        "confidence": "confidence conf likelihood score visibility probability prob v c",
    }.items()
    for name in names.split()
}
"""Name of a column, in small letters and with _ for spaces -> what it holds."""

OF_IMAGES = ("sequence", "item", "frame", "individual")
OF_POINTS = ("x", "y", "z", "confidence")

_AXIS = "x|y|z|likelihood|confidence|conf|score|visibility|prob"
_OF_LANDMARK = (
    re.compile(r"(?P<axis>x|y|z|visibility|v|c)_?(?P<number>[0-9]{1,9})", re.I),
    re.compile(rf"(?P<name>.+)[_.: -](?P<axis>{_AXIS}|v|c)", re.I),
    re.compile(rf"(?P<axis>{_AXIS})[_.: -](?P<name>.+)", re.I),
)
"""Columns of a wide table: x_12, nose_x, x_nose."""


class Header(NamedTuple):
    """A header as it was understood.

    names of all columns; roles -> column; landmarks -> their roles -> column of a wide table, None
    of a long one; names of columns without a role.
    """

    delimiter: str
    names: tuple[str, ...]
    roles: Mapping[str, int]
    landmarks: Mapping[str, Mapping[str, int]] | None
    others: tuple[str, ...]

    @property
    def axes(self) -> tuple[str, ...]:
        """The coordinates that there are columns for, and the confidence."""
        points = [self.roles] if self.landmarks is None else self.landmarks.values()
        return tuple(axis for axis in OF_POINTS if any(axis in columns for columns in points))


def parse_header(line: str) -> Header | None:
    """Return what the columns of a header hold; None where it is not that of a table of landmarks.

    A long table has columns landmark, x, y, and item or frame; a wide one has columns NAME_x and
    NAME_y, or x_NAME and y_NAME, of two landmarks at least.
    """
    for delimiter in sorted((",", ";", "\t"), key=line.count, reverse=True):
        try:
            cells = next(csv.reader([line], delimiter=delimiter), [])
        except csv.Error:
            return None
        names = tuple(cell.strip() for cell in cells)
        roles, others = _find_roles(dict(enumerate(names)))
        if {"landmark", "x", "y"} <= roles.keys() and {"item", "frame"} & roles.keys():
            return Header(delimiter, names, roles, None, tuple(filter(None, others)))
        if (header := _parse_wide(delimiter, names)) is not None:
            return header
    return None


def _find_roles(names: Mapping[int, str]) -> tuple[dict[str, int], list[str]]:
    """Return the first column of each role, and the names of those without one."""
    roles: dict[str, int] = {}
    others = []
    for column, name in names.items():
        role = ROLES.get(name.lower().replace(" ", "_"))
        if role is None or role in roles:
            others.append(name)
        else:
            roles[role] = column
    if not {"item", "frame"} & roles.keys() and "individual" in roles:
        roles["item"] = roles.pop("individual")  # an id of each row or image
    return roles, others


def _parse_wide(delimiter: str, names: tuple[str, ...]) -> Header | None:
    landmarks: dict[str, dict[str, int]] = {}
    rest: dict[int, str] = {}
    for column, name in enumerate(names):
        matches = (pattern.fullmatch(name) for pattern in _OF_LANDMARK)
        parts = next((match.groupdict() for match in matches if match), None)
        if parts is None:
            rest[column] = name
            continue
        landmark = parts.get("name") or str(int(parts["number"]))
        axis = ROLES.get(parts["axis"].lower(), "confidence")
        if axis in landmarks.setdefault(landmark, {}):
            return None
        landmarks[landmark][axis] = column
    placed = {name: axes for name, axes in landmarks.items() if {"x", "y"} <= axes.keys()}
    if len(placed) < 2:
        return None
    roles, others = _find_roles(rest)
    roles = {role: column for role, column in roles.items() if role not in OF_POINTS}
    others += [name for name in landmarks if name not in placed]
    others = [name for name in others if name and not name.lower().startswith("unnamed")]
    return Header(delimiter, names, roles, placed, tuple(others))


# Tables.


class Grid(NamedTuple):
    """What a table holds: values (n, p, axes); names (p); cells (n) of item, frame and so on."""

    values: Floats
    names: list[str]
    cells: dict[str, list[str]]


METRES = {"frame", "time", "landmark", "x", "y", "z", "sd", "trusted"}
"""Columns of the tables in metres that are written here."""


def read_any_table(paths: tuple[Path, ...]) -> Poses:
    """Read a table of no known tool.

    z beside x and y is a third coordinate, unless there is a confidence of 0 to 1: then it is the
    depth that detectors guess, which is left out. Landmarks that are numbered have no names.
    """
    path = paths[0]
    text = read_text(path)
    header = parse_header(text.partition("\n")[0])
    if header is None:
        raise input_error(path, "does not name columns of landmarks", "see docs/formats.md")
    rows = split_rows(path, text, header.delimiter)[1:]
    table = Table(path, rows, header.names, header.delimiter)
    values, names, cells = (_read_wide if header.landmarks else _read_long)(table, header)
    order = _by_number(names, 1 if header.landmarks else 0)
    values = values if order is None else values[:, order]
    scored = "confidence" in header.axes
    points, confidence = (values[..., :-1], values[..., -1]) if scored else (values, None)
    fields: dict[str, Any] = {}
    if not header.landmarks and {*header.names} >= METRES:
        columns = [header.names.index(name) for name in ("frame", "time")]
        steps = np.ptp(table.read(columns)[0], axis=0)
        rate = round(float(steps[0] / steps[1]), 6) if steps.all() else 1.0
        fields = {"unit": "m", "frame_rate": None if rate == 1 else rate}
    elif header.others:
        fields["notes"] = (f"columns left out: {abbreviate([*map(printable, header.others)])}",)
    if points.shape[2] == 3 and scored:
        points = points[..., :2]
        note = "z left out, the depth that a detector guesses beside its confidence"
        fields["notes"] = (*fields.get("notes", ()), note)
    if "z" in header.axes and points.shape[1] == 33:
        fields["skeleton"] = "mediapipe_33"
    videos = [f"{video_name(path)}/{name}" for name in cells.get("sequence", ())] or None
    if "frame" in cells:
        rows_of, fields["frame"] = _in_order(cells["frame"], videos, table)
        points, confidence = points[rows_of], None if confidence is None else confidence[rows_of]
        cells = {role: [own[row] for row in rows_of] for role, own in cells.items()}
        videos = videos and [videos[row] for row in rows_of]
    people = cells.get("individual")
    return of_bodies(
        path,
        np.where(np.isnan(points).any(axis=2, keepdims=True), np.nan, points),
        confidence,
        labels=cells.get("item") or cells.get("frame"),
        images=cells.keys() & OF_IMAGES <= {"item", "individual"} and "item" in cells,
        individuals=people and [*map(_name_individual, people)],
        landmark_names=None if order is not None else tuple(map(printable, names)),
        **fields | ({"video": videos} if videos else {}),
    )


def _by_number(names: Sequence[str], first: int) -> list[int] | None:
    """Return the order of landmarks that are called by all numbers from 0, or up to `first`, on."""
    if not all(name.isascii() and name.isdigit() and len(name) < 10 for name in names):
        return None
    numbers = [*map(int, names)]
    start = min(numbers, default=0)
    whole = start <= first and sorted(numbers) == [*range(start, start + len(names))]
    return sorted(range(len(names)), key=numbers.__getitem__) if whole else None


def _name_individual(cell: str) -> str:
    """Return an individual as files of detectors name it: 3 is `id 3`, -1 and nothing nobody."""
    values, wrong = read_numbers([cell])
    if wrong[0] or np.isnan(values[0]):
        return printable(cell)
    return f"id {values[0]:g}" if values[0] >= 0 else ""


def _read_wide(table: Table, header: Header) -> Grid:
    """Read a table with a row per image."""
    assert header.landmarks is not None
    roles = [role for role in OF_IMAGES if role in header.roles]
    numbers = sorted({at for axes in header.landmarks.values() for at in axes.values()})
    cells, texts, _ = table.read(numbers, [header.roles[role] for role in roles], finite=True)
    cells = np.column_stack([cells, np.full(len(cells), np.nan)])
    places = [
        [numbers.index(axes[axis]) if axis in axes else -1 for axis in header.axes]
        for axes in header.landmarks.values()
    ]
    return Grid(cells[:, places], [*header.landmarks], dict(zip(roles, texts, strict=True)))


def _read_long(table: Table, header: Header) -> Grid:
    """Read a table with a row per landmark of an image."""
    roles = [role for role in OF_IMAGES if role in header.roles]
    texts = [header.roles[role] for role in ("landmark", *roles)]
    numbers = [header.roles[axis] for axis in header.axes]
    cells, (landmark_cells, *keys), lines = table.read(numbers, texts, finite=True)
    landmarks: dict[str, int] = {}
    images: dict[tuple[str, ...], int] = {}
    rows: dict[tuple[int, int], int] = {}
    for row, (name, *key) in enumerate(zip(landmark_cells, *keys, strict=True)):
        image = images.setdefault(tuple(key), len(images))
        first = rows.setdefault((image, landmarks.setdefault(name, len(landmarks))), row)
        if first != row:
            problem = f"{name!r} of {' '.join(key)} is also in line {lines[first]}"
            fix = "keep one body per image, or separate them by a column `sequence`"
            raise input_error(f"{table.path}:{lines[row]}", problem, fix)
    size = len(images), len(landmarks), len(header.axes)
    check_fits(str(table.path), 8 * math.prod(size), "what it holds")
    values = np.full(size, np.nan)
    at, landmark = np.array([*rows], np.int64).reshape(-1, 2).T
    values[at, landmark] = cells
    of_images = zip(*images, strict=True) if images else ((),) * len(roles)
    by_role = {role: [*texts] for role, texts in zip(roles, of_images, strict=True)}
    return Grid(values, [*landmarks], by_role)


def _in_order(
    cells: Sequence[str], videos: Sequence[str] | None, table: Table
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the order of images by video and frame, and each one's place from the video's first.

    Videos stand as they appear. Raises InputError for frames that are no whole numbers.
    """
    values = _whole_numbers(table, cells, "number the frames, or call the column `item`")
    videos = videos or [""] * len(cells)
    numbers = {name: number for number, name in enumerate(dict.fromkeys(videos))}
    video = np.array([numbers[name] for name in videos], np.int64)
    starts = np.full(len(numbers), np.iinfo(np.int64).max)
    np.minimum.at(starts, video, values)
    order = np.lexsort((values, video))
    return order, (values - starts[video])[order]


def _whole_numbers(table: Table, cells: Sequence[str], fix: str) -> NDArray[np.int64]:
    """Return cells as whole numbers. Raises InputError for the first that is none."""
    values, wrong = read_numbers(cells)
    wrong |= ~(np.abs(values) < 2.0**53) | (values % 1 != 0)  # beyond, numbers are not told apart
    if wrong.any():
        problem = f"{cells[int(wrong.argmax())]!r} is no whole number"
        raise input_error(table.path, problem, fix)
    return values.astype(np.int64)


CALISCOPE = {
    "port": "sequence",
    "cam_id": "sequence",
    "frame_index": "frame",
    "point_id": "landmark",
    "img_loc_x": "x",
    "img_loc_y": "y",
}
"""Columns of caliscope, and what they hold."""


def read_caliscope(paths: tuple[Path, ...]) -> Poses:
    """Read caliscope's CSV of MediaPipe's landmarks: a row per point of a frame of a camera.

    A port (or cam_id) is a video. Points 0 to 32 are the body and have the names of mediapipe_33;
    hands (100, 200 and more) and face (500 and more) keep their numbers as names. A point without a
    row is missing.
    """
    path = paths[0]
    rows = split_rows(path, read_text(path))
    names = tuple(cell.strip('"') for cell in Table(path, rows[:1]).cells(0))
    roles = {CALISCOPE[name]: column for column, name in enumerate(names) if name in CALISCOPE}
    table = Table(path, rows[1:], names)
    grid = _read_long(table, Header(",", names, roles, None, ()))
    ids, frames, ports = (
        _whole_numbers(table, cells, "give camera, frame and point of each row as numbers")
        for cells in (grid.names, grid.cells["frame"], grid.cells["sequence"])
    )
    body = dict(enumerate(installed_skeletons()["mediapipe_33"].landmark_names))
    by_number = np.argsort(ids, kind="stable")
    videos = [f"{path.name.partition('.')[0]}/port {port}" for port in ports]
    order, places = _in_order([*map(str, frames)], videos, table)
    return of_frames(
        path,
        grid.values[order][:, by_number],
        labels=[str(frames[row]) for row in order],
        frame=places,
        video=[videos[row] for row in order],
        landmark_names=tuple(body.get(number, str(number)) for number in ids[by_number].tolist()),
    )


# Arrays of landmarks without names: (n, p, 2), or 3 with a confidence; (p, 2 or 3) is one image.

POINTS = ("landmarks", "keypoints", "points", "poses")
SCORES = ("confidence", "scores", "keypoint_scores", "likelihood", "visibility")
WANTED = "give (images, landmarks, 2), or 3 with a confidence of 0 to 1"


def read_array(paths: tuple[Path, ...]) -> Poses:
    """Return the images of an array of NumPy or in JSON, whose landmarks `keypoints` names.

    In a .npz the confidences may be an array (n, p) of their own.
    """
    path = paths[0]
    try:
        if path.name.lower().endswith((".json", ".json.gz")):
            return of_array(path, np.array(read_json(path), np.float64))
        if zipfile.is_zipfile(path):
            return of_array(path, *_read_archive(path))
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        check_fits(str(path), 2 * 8 * array.size)
        return of_array(path, np.array(array))
    except InputError:
        raise
    except Exception as error:  # NumPy has many kinds of error for damaged files
        problem = f"cannot be read as an array ({str(error).partition(chr(10))[0][:80]})"
        fix = f"{WANTED}; save it again with numpy.save, without objects"
        raise input_error(path, problem, fix) from error


def _read_archive(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return the points and confidences of a .npz."""
    with zipfile.ZipFile(path) as archive, np.load(path, allow_pickle=False) as arrays:
        sizes = {entry.filename.removesuffix(".npy"): entry.file_size for entry in archive.filelist}
        points = [name for name in sizes if name.lower() in POINTS]
        scores = [name for name in sizes if name.lower() in SCORES]
        points = points or [name for name in sizes if name not in scores]
        if len(points) != 1:
            names = abbreviate([*map(printable, sizes)]) or "nothing"
            raise input_error(path, f"holds {names}", "call the landmarks `landmarks`")
        check_fits(str(path), 3 * sum(sizes[name] for name in (*points, *scores[:1])))
        return arrays[points[0]], arrays[scores[0]] if scores else None


def of_array(
    path: Path, points: NDArray[Any], scores: NDArray[Any] | None = None, **fields: Any
) -> Poses:
    """Return the images of an array (n, p, 2 or 3) or (p, 2 or 3); `path` names it in messages.

    `fields` is what else `of_bodies` takes. Raises InputError for arrays of other shapes, and for
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
            problem = f"its third numbers run from {least:g} to {most:g}, so are they confidences?"
            require(scores is None and not (least < 0 or most > 1), problem)
            points, scores = points[..., :2], last
        if scores is not None:
            problem = f"has confidences of the shape {scores.shape}, and points {points.shape}"
            require(scores.shape == points.shape[:2], problem)
            scores = np.nan_to_num(scores.astype(np.float64))
    points = np.where(np.isnan(points).any(axis=2, keepdims=True), np.nan, points)
    return of_bodies(path, points, scores, **fields)


def of_bodies(
    path: Path,
    points: Floats,
    confidence: Floats | None,
    *,
    labels: Sequence[str] | None = None,
    images: bool = False,
    individuals: Sequence[str] | None = None,
    notes: tuple[str, ...] = (),
    **fields: Any,
) -> Poses:
    """Return the poses of points (n, p, 2 or 3), one body per image, NaN where one is missing.

    labels (n) are names or numbers of the images, by default their places. They are `images` that
    have nothing to do with one another, or the frames of a video, of these individuals, by default
    of one. `fields` are those of Poses. Raises InputError for confidences below 0.
    """
    n, _, dimensions = points.shape
    if confidence is not None and (confidence < 0).any():
        problem = f"has a confidence of {np.nanmin(confidence):g}"
        raise input_error(path, problem, "write 0 (hidden) or a positive number")
    if dimensions == 2 and confidence is None:
        notes += warn_of_zeros(points)
    fraction = dimensions == 2 and are_fractions(points[np.isfinite(points)])
    labels = labels or [str(row) for row in range(n)]
    defaults: dict[str, Any] = {
        "individual": individuals or ([""] * n if images else None),
        "unit": FRACTION if fraction else UNKNOWN_UNIT,
        "size_needed": fraction,
        "unordered": images and not are_series(labels),
        "notes": notes,
    }
    return of_frames(path, points, confidence, labels, **defaults | fields)
