"""Labels and predictions of YOLO for poses, as Ultralytics writes them: a text file per image."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import input_error
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole
from shapefit.io.readers.detections import Detections, as_poses, images_in
from shapefit.io.readers.poses import (
    FRACTION,
    Edges,
    Poses,
    edges_of,
    parsing,
    read_yaml,
    require,
)

BOX = 5
"""Numbers of a line before its landmarks: class, centre and size of a box."""

FILE = "data.yaml"


class Layout(NamedTuple):
    """Landmarks of a line, numbers of each, and what data.yaml calls landmarks and classes."""

    landmarks: int
    step: int
    names: tuple[str, ...] | None = None
    people: bool = False
    edges: Edges = ()


def read_yolo(paths: tuple[Path, ...]) -> Poses:
    """Read the labels of a folder, or these files, as one recording.

    A line is class, centre and size of a box, and x, y and mostly v of each landmark, as fractions
    of the width and height of the image; predictions may end in a score and a track. `kpt_shape`
    in the data.yaml beside the labels says how many landmarks there are, and whether v is given:
    0 is missing, 1 and 2 are placed, fractions are confidences. Without v, a landmark at 0, 0 is
    missing.
    """
    images = images_in(paths, ".txt", "classes.txt")
    rows = [(frame, row) for frame in images.frames for row in _rows(frame.path)]
    layout = _stated(paths[0] if paths[0].is_dir() else paths[0].parent)
    layout = layout or _guessed([row for _, row in rows], images.name)
    width = BOX + layout.landmarks * layout.step
    detections = Detections.in_files(images)
    for frame, row in rows:
        with parsing(frame.path, f"check kpt_shape in {FILE}"):
            given = f"a line of {len(row)} numbers, and {layout.landmarks} landmarks take {width}"
            require(len(row) - width in (0, 1, 2), given)
        numbers = row[BOX:width]
        if layout.step == 2:
            pairs = zip(numbers[::2], numbers[1::2], strict=True)
            numbers = [value for x, y in pairs for value in (x, y, float(x > 0 or y > 0))]
        detections.add(numbers, frame, row[-1] if len(row) == width + 2 else None)
    values = detections.values()
    person = layout.people and layout.landmarks == 17
    return as_poses(
        detections,
        len(images.frames),
        values,
        scored=not np.isin(values[..., 2], (0, 1, 2)).all(),
        unit=FRACTION,
        landmark_names=layout.names
        or (None if person else tuple(map(str, range(layout.landmarks)))),
        skeleton="coco_17" if person else None,
        edges=layout.edges,
    )


def _rows(path: Path) -> list[list[float]]:
    """Return the numbers of each line; comments and empty lines are skipped."""
    rows = []
    text = read_whole(path).removeprefix(BYTE_ORDER_MARK)
    for number, line in enumerate(text.splitlines(), start=1):
        with parsing(f"{path}:{number}", "give labels of poses"):
            rows.append([float(cell) for cell in line.partition(b"#")[0].split()])
    return [row for row in rows if row]


def _guessed(rows: list[list[float]], name: str) -> Layout:
    """Return the layout that lines have where no data.yaml states it."""
    smallest = min((len(row) - BOX for row in rows), default=0)
    threes = [m for m in (smallest, smallest - 1, smallest - 2) if m > 0 and m % 3 == 0]
    marks = {row[place] for row in rows for place in range(BOX + 2, BOX + (threes or [0])[0], 3)}
    if threes and (marks <= {0, 1, 2} or threes[0] == 51):
        return Layout(threes[0] // 3, 3, people=threes[0] == 51)
    if smallest % 2 == 0 and smallest % 3 and not threes[1:]:
        return Layout(smallest // 2, 2)
    if not rows:
        return Layout(0, 3)
    found = f"lines of {smallest} numbers after the box, and no {FILE} with kpt_shape beside them"
    raise input_error(name, found, f"put the {FILE} of the data set beside the labels")


def _stated(folder: Path) -> Layout | None:
    """Return what the nearest data.yaml in this folder or three above it states."""
    path, found = read_yaml(folder, FILE, 3) or (folder, None)
    if not isinstance(found, dict) or (shape := found.get("kpt_shape")) is None:
        return None
    whole = isinstance(shape, list) and len(shape) == 2 and all(type(n) is int for n in shape)
    if not whole or not 0 < shape[0] < 10_000 or shape[1] not in (2, 3):
        raise input_error(path, f"kpt_shape is {shape}", "give [landmarks, 2] or [landmarks, 3]")
    count, classes = shape[0], found.get("names")
    classes = list(classes.values()) if isinstance(classes, dict) else classes
    names: Any = found.get("kpt_names")
    if isinstance(names, dict):  # a list for each class, of which the first is taken
        names = next(iter(names.values()), None)
    named = isinstance(names, list) and len(names) == len({*map(str, names)}) == count
    return Layout(
        count,
        shape[1],
        tuple(map(str, names)) if named else None,
        people=classes == ["person"],
        edges=edges_of(found.get("skeleton"), count),
    )
