"""Landmarks of geometric morphometrics and faces: TPS, and the .pts of 300-W.

Both number their landmarks from 1, and both name images: nothing of a video.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error, printable
from shapefit.io.formats import Head
from shapefit.io.readers.arrays import poses_from_bodies
from shapefit.io.readers.poses import (
    FormatError,
    Poses,
    image_labels,
    require,
)
from shapefit.io.readers.text import parse_floats, read_text
from shapefit.records.items import Direction

KEY = re.compile(r"\s*([A-Za-z]+3?)\s*=\s*(.*)")
"""A line of TPS that is no point: LM=12, IMAGE=a.jpg."""

TPS = re.compile(rb"\s*LM3?\s*=\s*\d+\s*(?:\n|\r|$)", re.IGNORECASE)
PTS = re.compile(rb"\s*version\s*:.*\s+n_points\s*:", re.IGNORECASE)
"""How the files begin."""


def is_tps(head: Head) -> bool:
    """Whether the first line of a file is of TPS: LM= or LM3= and a number."""
    return TPS.match(head.text) is not None


def read_tps(paths: tuple[Path, ...]) -> Poses:
    """Read the specimens of a TPS file as images, or as shapes where points are 3D.

    Each has LM= or LM3=, as many lines of a point, IMAGE= and ID=. Curves and scales
    are left out. y points up, as tpsDig measures it.
    """
    path, lines = paths[0], read_text(paths[0]).split("\n")
    specimens: list[list[list[float]]] = []
    stated: list[dict[str, str]] = []
    number = 0
    while number < len(lines):
        match = KEY.match(lines[number])
        number += 1
        if match is None:
            continue
        key = match[1].upper()
        value = match[2].strip()
        if key in ("LM", "LM3", "POINTS"):
            count = _parse_count(path, number, value)
            d = 3 if key == "LM3" else 2
            rows = lines[number : number + count]
            if key != "POINTS":
                specimens.append(_specimen_points(path, rows, number, count, d))
                stated.append({})
            number += count
        elif stated:
            stated[-1].setdefault(key, value)
    require(specimens, "no LM= or LM3=")
    sizes = {len(points[0]) for points in specimens if points}
    require(len(sizes) <= 1, "specimens in 2D and in 3D")
    d = sizes.pop() if sizes else 2
    p = max(map(len, specimens))
    points = np.full((len(specimens), p, d), np.nan)
    for row, own in enumerate(specimens):
        points[row, : len(own)] = np.array(own).reshape(-1, d)
    left_out = sorted({key for keys in stated for key in keys} - {"IMAGE", "ID"})
    notes = [f"left out: {', '.join(map(printable, left_out))}"] if left_out else []
    return _specimen_images(
        path, points, _specimen_labels(stated), y_axis="up", notes=tuple(notes)
    )


def _parse_count(path: Path, line: int, value: str) -> int:
    """Parse the number of landmarks that a line states; InputError for other text."""
    if not value.isdecimal():
        problem = f"{printable(value[:40])!r} is no number of landmarks"
        raise input_error(f"{path}:{line}", problem, "write LM=12")
    return int(value)


def _specimen_points(
    path: Path, rows: Sequence[str], line: int, count: int, d: int
) -> list[list[float]]:
    """Parse the points (count, d) in the first `count` of `rows`.

    line: the number of the line before them, for messages. Raises InputError where one
    is no point.
    """
    points = []
    for offset in range(count):
        words = rows[offset].split() if offset < len(rows) else []
        try:
            points.append(parse_floats(words, d))
        except FormatError as error:
            place = f"{path}:{line + 1 + offset}"
            fix = f"write {d} numbers for each of the {count} landmarks"
            raise input_error(place, error.problem, fix) from error
    return points


def _specimen_labels(stated: Sequence[dict[str, str]]) -> list[str]:
    """Return names of specimens, from IMAGE or else ID in `stated`, else numbers."""
    for key in ("IMAGE", "ID"):
        names = [keys.get(key, "") for keys in stated]
        if all(names) and len({*names}) == len(names):
            return image_labels(names) if key == "IMAGE" else names
    return [*map(str, range(len(stated)))]


def _specimen_images(
    path: Path,
    points: Floats,
    labels: Sequence[str],
    y_axis: Direction | None = None,
    notes: tuple[str, ...] = (),
) -> Poses:
    """Make Poses of specimens (n, p, d), whose landmarks are called 1, 2 and so on."""
    return poses_from_bodies(
        path,
        points,
        None,
        labels=labels,
        named=True,
        individual=[""] * len(points),
        unordered=True,
        landmark_names=tuple(map(str, range(1, points.shape[1] + 1))),
        y_axis=y_axis,
        notes=notes,
    )


def is_pts(head: Head) -> bool:
    """Whether a text begins with `version:` and `n_points:`, as .pts of 300-W does."""
    return PTS.match(head.text) is not None


def read_pts(paths: tuple[Path, ...]) -> Poses:
    """Read .pts files of 300-W, or those in a folder, each of one image's landmarks.

    A file has n_points, and a line of x and y of each point.
    """
    files = [*paths]
    if paths[0].is_dir():
        files = sorted(one for one in paths[0].iterdir() if one.suffix == ".pts")
    found = [_read_pts_file(path) for path in files]
    sizes = {len(own) for own in found}
    numbers = " and ".join(map(str, sorted(sizes)))
    require(len(sizes) == 1, f"files of {numbers} landmarks; give those of one kind")
    labels = [path.stem for path in files]
    return _specimen_images(paths[0], np.array(found), labels)


def _read_pts_file(path: Path) -> list[list[float]]:
    """Return the points (p, 2) of one .pts file; InputError for a damaged one."""
    text = read_text(path)
    stated = re.search(r"n_points\s*:\s*(\d+)", text)
    before, bracket, rest = text.partition("{")
    if stated is None or not bracket:
        fault, fix = "does not begin with n_points and {", "copy or make it again"
        raise input_error(path, fault, fix)
    rows = rest.split("\n")[1:]
    return _specimen_points(path, rows, before.count("\n") + 1, int(stated[1]), 2)
