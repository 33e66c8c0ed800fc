"""Labels and predictions of YOLO for poses, as Ultralytics writes them: a text file per image."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import input_error
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole
from shapefit.io.readers.detections import Detection, Image, as_poses, images_in, values_of
from shapefit.io.readers.poses import FRACTION, Edges, Poses, edges_of, parsing, read_yaml, require


class Layout(NamedTuple):
    """Landmarks of a line, numbers of each, and what data.yaml calls landmarks and classes."""

    landmarks: int
    step: int
    names: tuple[str, ...] | None = None
    people: bool = False
    edges: Edges = ()


BOX = 5
"""Numbers of a line of YOLO before its landmarks: class, centre and size of a box."""

DATA = "data.yaml"


def read_yolo(paths: tuple[Path, ...]) -> Poses:
    """Read YOLO's labels of a folder, or these files: a line for each detection.

    A line is class, centre and size of a box, and x, y and mostly v of each landmark, as fractions
    of the width and height of the image; predictions may end in a score and a track. `kpt_shape`
    in the data.yaml beside the labels says how many landmarks there are, and whether v is given:
    0 is missing, 1 and 2 are placed, fractions are confidences. Without v, a landmark at 0, 0 is
    missing.
    """
    images = images_in(paths, ".txt", "classes.txt")
    rows = [(number, row) for number, image in enumerate(images.images) for row in _rows(image)]
    layout = _stated(paths[0] if paths[0].is_dir() else paths[0].parent)
    layout = layout or _guessed([row for _, row in rows], images.name)
    width = BOX + layout.landmarks * layout.step
    found = []
    for number, row in rows:
        with parsing(images.images[number].path, f"check kpt_shape in {DATA}"):
            given = f"a line of {len(row)} numbers, and {layout.landmarks} landmarks take {width}"
            require(len(row) - width in (0, 1, 2), given)
        numbers = row[BOX:width]
        if layout.step == 2:
            pairs = zip(numbers[::2], numbers[1::2], strict=True)
            numbers = [value for x, y in pairs for value in (x, y, float(x > 0 or y > 0))]
        found.append(Detection(numbers, number, row[-1] if len(row) == width + 2 else None))
    values = values_of(found, images.name)
    person = layout.people and layout.landmarks == 17
    return as_poses(
        images,
        found,
        values,
        scored=not np.isin(values[..., 2], (0, 1, 2)).all(),
        unit=FRACTION,
        landmark_names=layout.names
        or (None if person else tuple(map(str, range(layout.landmarks)))),
        edges=layout.edges,
    )


def _rows(image: Image) -> list[list[float]]:
    """Return the numbers of each line; comments and empty lines are skipped."""
    rows = []
    text = read_whole(image.path).removeprefix(BYTE_ORDER_MARK)
    for number, line in enumerate(text.splitlines(), start=1):
        with parsing(f"{image.path}:{number}", "give labels of poses"):
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
    found = f"lines of {smallest} numbers after the box, and no {DATA} with kpt_shape beside them"
    raise input_error(name, found, f"put the {DATA} of the data set beside the labels")


def _stated(folder: Path) -> Layout | None:
    """Return what the nearest data.yaml in this folder or three above it states."""
    path, content = read_yaml(folder, DATA, 3) or (folder, None)
    if not isinstance(content, dict) or (shape := content.get("kpt_shape")) is None:
        return None
    whole = isinstance(shape, list) and len(shape) == 2 and all(type(n) is int for n in shape)
    if not whole or not 0 < shape[0] < 10_000 or shape[1] not in (2, 3):
        raise input_error(path, f"kpt_shape is {shape}", "give [landmarks, 2] or [landmarks, 3]")
    count, classes = shape[0], content.get("names")
    names: Any = content.get("kpt_names")
    classes = list(classes.values()) if isinstance(classes, dict) else classes
    if isinstance(names, dict):  # a list for each class, of which the first is taken
        names = next(iter(names.values()), None)
    named = isinstance(names, list) and len(names) == len({*map(str, names)}) == count
    edges = edges_of(content.get("skeleton"), count)
    text = tuple(map(str, names)) if named else None
    return Layout(count, shape[1], text, people=classes == ["person"], edges=edges)
