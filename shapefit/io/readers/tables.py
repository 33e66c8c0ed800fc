"""Tables of no known tool, of caliscope and anipose, and NumPy's arrays of landmarks.

A *wide* table has a row per image, a *long* one a row per landmark of an image. Cells
are separated by `,`, `;` or tabs; with the latter two the decimal point may be a comma.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import abbreviate, input_error, printable
from shapefit.io.checks import warn_of_zeros
from shapefit.io.csv_file import read_numbers
from shapefit.io.formats import INDIVIDUALS
from shapefit.io.inputs import check_fits, check_unpacked
from shapefit.io.readers.poses import (
    Poses,
    are_series,
    name_individual,
    of_frames,
    parsing,
    require,
    unit_of,
    video_name,
)
from shapefit.io.readers.text import Table, read_json, read_table, read_text
from shapefit.io.skeletons import installed_skeletons

# Headers.

ROLES: Mapping[str, str] = {
    name: role
    for role, names in {
        "item": "item image filename file file_name image_name image_id img",
        "frame": "frame frame_id frame_idx frame_index frame_number frame_no fnum",
        "sequence": "sequence video clip session port cam_id",
        "individual": " ".join(INDIVIDUALS),
        "landmark": (
            "landmark joint bodypart body_part keypoint part node marker landmark_name"
            " joint_name keypoint_name landmark_id joint_id keypoint_id landmark_index"
            " point_id"
        ),
        "x": "x x_px px img_loc_x",
        "y": "y y_px py img_loc_y",
        "z": "z",
        "confidence": (
            "confidence conf likelihood score visibility probability prob v c"
        ),
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
    """Names of all columns; roles -> column; landmarks of a wide table -> their roles
    -> column.
    """

    delimiter: str
    names: Sequence[str]
    roles: Mapping[str, int]
    landmarks: Mapping[str, Mapping[str, int]]
    others: Sequence[str]


def parse_header(line: str) -> Header | None:
    """Return what columns hold; None unless they are landmark, x, y, and item or frame,
    or NAME_x and NAME_y, or x_NAME and y_NAME, of two landmarks at least.
    """
    for delimiter in sorted((",", ";", "\t"), key=line.count, reverse=True):
        names = [cell.strip() for cell in line.replace('"', "").split(delimiter)]
        landmarks: dict[str, dict[str, int]] = {}
        roles: dict[str, int] = {}
        others = []
        for column, name in enumerate(names):
            role = ROLES.get(name.lower().replace(" ", "_"))
            matches = (pattern.fullmatch(name) for pattern in _OF_LANDMARK)
            match = next((match.groupdict() for match in matches if match), None)
            if match is not None and role is None:
                landmark = match.get("name") or str(int(match["number"]))
                axis = ROLES.get(match["axis"].lower(), "confidence")
                landmarks.setdefault(landmark, {}).setdefault(axis, column)
            elif role is not None and role not in roles:
                roles[role] = column
            elif name:
                others.append(name)
        if {"landmark", "x", "y"} <= roles.keys() and {"item", "frame"} & roles.keys():
            return Header(delimiter, names, roles, {}, [*others, *landmarks])
        others += [
            name for name, axes in landmarks.items() if not {"x", "y"} <= axes.keys()
        ]
        landmarks = {
            name: axes for name, axes in landmarks.items() if name not in others
        }
        if len(landmarks) > 1:
            return Header(delimiter, names, roles, landmarks, others)
    return None


# Tables.

Grid = tuple[Floats, Sequence[str], Mapping[str, Sequence[str]]]
"""What a table holds: values (n, p, axes); landmarks (p); cells (n) of item, frame and
so on.
"""

METRES = {
    "frame",
    "time",
    "landmark",
    "x",
    "y",
    "z",
    "sd",
    "trusted",
}  # as they are written here


def read_any_table(paths: tuple[Path, ...]) -> Poses:
    """Read a table of no known tool, or the 3D points that anipose writes, in its unit.

    z beside a confidence is the depth that detectors guess, which is left out, except
    anipose's; otherwise it is a third coordinate. Landmarks that are numbered have no
    names.
    """
    path, text = paths[0], read_text(paths[0])
    header = parse_header(text.partition("\n")[0])
    require(header, "it does not name columns of landmarks, see docs/formats.md")
    assert header is not None
    triangulated = any(name.endswith("_ncams") for name in header.names)
    table = read_table(path, text, header.names, header.delimiter, after=1)
    columns = header.landmarks.values() or [header.roles]
    axes = [axis for axis in OF_POINTS if any(axis in places for places in columns)]
    values, names, cells = (_read_wide if header.landmarks else _read_long)(
        table, header, axes
    )
    fields: dict[str, Any] = {}
    order = _by_number(names)
    if order is None:
        fields["landmark_names"] = tuple(map(printable, names))
    else:
        values = values[:, order]
    points, confidence = values, None
    if "confidence" in axes:
        points, confidence = values[..., :-1], values[..., -1]
    if not header.landmarks and {*header.names} >= METRES:
        steps = np.ptp(
            table.numbers([header.names.index("frame"), header.names.index("time")]), 0
        )
        rate = round(float(steps[0] / steps[1]), 6) if steps.all() else 1.0
        fields |= {"unit": "m", "frame_rate": None if rate == 1 else rate}
    elif header.others and not triangulated:
        fields["notes"] = (
            f"columns left out: {abbreviate([*map(printable, header.others)])}",
        )
    if points.shape[2] == 3 and confidence is not None and not triangulated:
        points = points[..., :2]
    if "individual" in cells:
        fields["individual"] = [*map(_individual, cells["individual"])]
    if "sequence" in cells:
        fields["video"] = [f"{video_name(path)}/{name}" for name in cells["sequence"]]
    if "frame" in cells:
        fields["frame"], rows = _frames(cells["frame"], fields.get("video"))
    labels = cells.get("item") or cells.get("frame")
    if labels and not {"frame", "sequence"} & cells.keys():
        fields = {
            "individual": [""] * len(points),
            "unordered": not are_series(labels),
            **fields,
        }
    poses = of_bodies(path, points, confidence, labels=labels, **fields)
    return poses.take(rows) if "frame" in cells else poses


def _read_wide(table: Table, header: Header, axes: Sequence[str]) -> Grid:
    """Read a table with a row per image."""
    columns = sorted(
        {at for places in header.landmarks.values() for at in places.values()}
    )
    numbers = table.numbers(columns, finite=True)
    numbers = np.column_stack([numbers, np.full(len(numbers), np.nan)])
    places = [
        [columns.index(places[axis]) if axis in places else -1 for axis in axes]
        for places in header.landmarks.values()
    ]
    roles = [role for role in OF_IMAGES if role in header.roles]
    texts = table.texts(*(header.roles[role] for role in roles))
    return numbers[:, places], [*header.landmarks], dict(zip(roles, texts, strict=True))


def _read_long(table: Table, header: Header, axes: Sequence[str]) -> Grid:
    """Read a table with a row per landmark of an image."""
    roles = [role for role in OF_IMAGES if role in header.roles]
    texts, *keys = table.texts(*(header.roles[role] for role in ("landmark", *roles)))
    numbers = table.numbers([header.roles[axis] for axis in axes], finite=True)
    landmarks: dict[str, int] = {}
    images: dict[tuple[str, ...], int] = {}
    rows: dict[tuple[int, int], int] = {}
    for row, (name, *key) in enumerate(zip(texts, *keys, strict=True)):
        image = images.setdefault(tuple(key), len(images))
        first = rows.setdefault(
            (image, landmarks.setdefault(name, len(landmarks))), row
        )
        if first != row:
            problem = (
                f"{name!r} of {' '.join(key)} is also in line {table.lines[first]}"
            )
            fix = "keep one body per image, or separate them by a column `sequence`"
            raise input_error(f"{table.path}:{table.lines[row]}", problem, fix)
    values = np.full((len(images), len(landmarks), len(axes)), np.nan)
    values[tuple(np.array([*rows], np.int64).reshape(-1, 2).T)] = numbers
    cells = zip(*images, strict=True) if images else ((),) * len(roles)
    return values, [*landmarks], dict(zip(roles, cells, strict=True))


def _by_number(names: Sequence[str]) -> Integers | None:
    """Return the order of landmarks that are called by all numbers from 0 or 1 on."""
    numbers = [int(name) if name.isdecimal() else -1 for name in names]
    start = min(numbers, default=0)
    whole = start in (0, 1) and sorted(numbers) == [*range(start, start + len(numbers))]
    return np.argsort(numbers) if whole else None


def _individual(cell: str) -> str:
    """Return an individual as files of detectors name it: 3 is `id 3`, -1 and nothing
    nobody.
    """
    (value,), wrong = read_numbers([cell])
    return printable(cell) if wrong.any() else name_individual(float(value))


def _whole_numbers(cells: Sequence[str]) -> list[int]:
    """Return cells as whole numbers. Raises ValueError for the first that is none."""
    values, _ = read_numbers(cells)
    wrong = ~(np.abs(values) < 2.0**53) | (
        values % 1 != 0
    )  # beyond, numbers are not told apart
    unfit = [cells[row] for row in np.flatnonzero(wrong)[:1].tolist()]
    require(
        not unfit,
        f"{unfit} is no whole number; number the frames, or call the column `item`",
    )
    return [*map(int, values.tolist())]


def _frames(
    cells: Sequence[str], videos: Sequence[str] | None
) -> tuple[Integers, Integers]:
    """Return the positions of frames in their videos, from the first on, and their
    order.
    """
    frames, videos = (
        np.array(_whole_numbers(cells), np.int64),
        videos or [""] * len(cells),
    )
    rank = {video: number for number, video in enumerate(dict.fromkeys(videos))}
    ranks = np.array([rank[video] for video in videos], np.intp)
    order = np.lexsort((frames, ranks))
    first = order[np.searchsorted(ranks[order], ranks)]  # of its video
    return frames - frames[first], order


def read_caliscope(paths: tuple[Path, ...]) -> Poses:
    """Read caliscope's CSV of MediaPipe's landmarks: a row per point of a frame of a
    camera.

    A port (or cam_id) is a video. Points 0 to 32 are the body and have the names of
    mediapipe_33; hands (100, 200 and more) and face (500 and more) keep their numbers
    as names.
    """
    poses = read_any_table(paths)
    ids = _whole_numbers(
        poses.landmark_names or [*map(str, range(poses.points.shape[1]))]
    )
    body = dict(enumerate(installed_skeletons()["mediapipe_33"].landmark_names))
    stem = paths[0].name.partition(".")[0]
    return replace(
        poses,
        points=poses.points[:, np.argsort(ids)],
        video=[f"{stem}/port {video.rpartition('/')[2]}" for video in poses.videos],
        landmark_names=tuple(body.get(number, str(number)) for number in sorted(ids)),
        unit="px",
        notes=(),
    )


# Arrays of landmarks without names: (n, p, 2), or 3 with a confidence; (p, 2 or 3) is
# one image.

POINTS = ("landmarks", "keypoints", "points", "poses")
SCORES = ("confidence", "scores", "keypoint_scores", "likelihood", "visibility")
COPIES = 3
"""Of an array that are in memory while it is read."""

WANTED = "give (images, landmarks, 2), or 3 with a confidence of 0 to 1"


def read_array(paths: tuple[Path, ...]) -> Poses:
    """Return the images of an array of NumPy, in .npz beside its confidences (n, p), or
    of JSON.
    """
    path = paths[0]
    if path.name.lower().endswith((".json", ".json.gz")):
        return of_array(path, np.array(read_json(path), np.float64))
    with parsing(
        path, "an array", f"{WANTED}; save it again with numpy.save, without objects"
    ):
        check_archive(path)
        arrays = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(arrays, np.lib.npyio.NpzFile):
            return of_array(path, arrays)
        scores = [name for name in arrays if name.lower() in SCORES]
        points = [name for name in arrays if name.lower() in POINTS]
        points = points or [name for name in arrays if name not in scores]
        names = abbreviate([*map(printable, arrays)]) or "nothing"
        require(len(points) == 1, f"it holds {names}; call the landmarks `landmarks`")
        return of_array(path, arrays[points[0]], arrays[scores[0]] if scores else None)


def check_archive(path: Path) -> None:
    """Raise InputError where the arrays of .npz take more memory than is free, or than
    a file of its size can hold.
    """
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    check_unpacked(path, size, path.stat().st_size)
    check_fits(str(path), COPIES * size)


def of_array(
    path: Path, points: NDArray[Any], scores: NDArray[Any] | None = None, **fields: Any
) -> Poses:
    """Return the images of an array (n, p, 2 or 3) or (p, 2 or 3); `path` names it in
    messages.

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
        points = points.astype(np.float64)
        if points.shape[2] == 3:
            require(
                scores is None, "three numbers of each landmark beside its confidence"
            )
            points, scores = points[..., :2], points[..., 2]
            least, most = (
                np.nanmin(scores, initial=np.inf),
                np.nanmax(scores, initial=-np.inf),
            )
            fits = not (least < 0 or most > 1)
            require(
                fits,
                f"third numbers run from {least:g} to {most:g}, are they confidences?",
            )
        scores = None if scores is None else np.nan_to_num(scores.astype(np.float64))
        return of_bodies(path, points, scores, **fields)


def of_bodies(
    path: Path, points: Floats, confidence: Floats | None, **fields: Any
) -> Poses:
    """Return the poses of points (n, p, 2 or 3), one body per image.

    `fields` are those of `of_frames`. Raises ValueError for confidences below 0.
    """
    require(confidence is None or not (confidence < 0).any(), "a confidence below 0")
    points = np.where(np.isnan(points).any(axis=2, keepdims=True), np.nan, points)
    if points.shape[2] == 2 and confidence is None:
        fields["notes"] = (*fields.get("notes", ()), *warn_of_zeros(points))
    return of_frames(path, points, confidence, **unit_of(points) | fields)
