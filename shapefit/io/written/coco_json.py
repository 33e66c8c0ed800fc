"""Write JSON in the layout of COCO's annotations, with 3D points beside those of the image."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.io.foreign.sources import FRAME
from shapefit.io.layout import METRES_PER_UNIT, Layout
from shapefit.io.options import Summary
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.io.whole.atomic import atomic_file, write_all
from shapefit.io.writing import NOTHING_APPENDED

Record = LandmarkSet | ShapeSet | ResultSet
Object = dict[str, Any]

CATEGORY = 1
SEEN, UNSEEN = 2, 0
"""COCO's v of a landmark with a place, and of one without: then x = y = 0."""

AXES = "x right, y down, z away from the camera"
"""Of results, as the images of COCO have them."""

TURNED = np.array([1.0, -1.0, -1.0])
"""What turns points whose y is up; those of images are its first two."""


class JsonWriter:
    """Appends items as annotations; images and what all have in common follow at the end."""

    def __init__(self, write: Any) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self._write = write
        self._first: Record | None = None
        self._images: dict[tuple[str, str], bytes] = {}
        self._ids: dict[tuple[str, str], int] = {}
        self._count = 0

    def append(self, record: Record) -> None:
        """Write the annotations of a record."""
        if self._first is None:
            self._first = record.take(slice(0))
            info, categories = _text(_info(record)), _text(_category(record))
            self._write(b'{"info":%s,\n"categories":[%s],\n"annotations":[' % (info, categories))
        elif record.landmark_names != self._first.landmark_names:
            raise ValueError("the landmarks of this record are not those of the first")
        for annotation in _annotations(record, self._image_of):
            self._count += 1
            comma = b"," if self._count > 1 else b""
            self._write(comma + b"\n" + _text({"id": self._count, **annotation}))

    def finish(self) -> None:
        """Write what follows the annotations."""
        if self._first is None:
            raise ValueError(NOTHING_APPENDED)
        images = b",\n".join(self._images.values())
        self._write(b'\n],\n"images":[\n%s\n]}\n' % images)
        self.summary = Summary(note=_said(self._first))

    def _image_of(self, item: str, sequence: str, frame: int | None) -> int:
        """Return the number of the image of an item; items of one frame of a video share it."""
        video, name = _image_name(item, sequence, frame)
        key = (video, name if frame is None else str(frame))
        if key not in self._ids:
            number = self._ids[key] = len(self._ids) + 1
            image: Object = {"id": number, "file_name": f"{video}/{name}" if video else name}
            if frame is not None:
                image |= {"video": video, "frame": frame}
            self._images[key] = _text(image)
        return self._ids[key]


@contextmanager
def json_output(target: Path, form: Layout) -> Iterator[JsonWriter]:
    """Give a writer to a JSON file that appears on a clean exit."""
    with atomic_file(target) as file:
        writer = JsonWriter(lambda data: write_all(file, data))
        yield writer
        writer.finish()


def _image_name(item: str, sequence: str, frame: int | None) -> tuple[str, str]:
    """Return the video and the name of the image: of `video/individual/frame`, without the second.

    Only items of recordings, which have a frame, are taken apart.
    """
    if frame is None:
        return "", item
    video, _, rest = item.partition("/")
    if sequence:
        return video, item[len(sequence) + 1 :] if item.startswith(f"{sequence}/") else rest
    label, _, _ = rest.rpartition("/")  # video/frame/index
    return video, label or rest


def _annotations(record: Record, image_of: Any) -> Iterator[Object]:
    extras = record.columns
    frames = record.per_item(FRAME)
    numbers = None if frames is None or frames.dtype.kind not in "iu" else frames.tolist()
    fields = list(_fields(record, extras))
    for row, item in enumerate(record.items):
        sequence = record.sequences[row] if record.sequences is not None else ""
        frame = None if numbers is None else numbers[row]
        found: Object = {
            "image_id": image_of(item, sequence, frame),
            "category_id": CATEGORY,
            "item": item,
        }
        if sequence:
            found["sequence"] = sequence
        for name, values in fields:
            found[name] = values[row]
        yield found


def _fields(record: Record, extras: dict[str, Any]) -> Iterator[tuple[str, Sequence[Any]]]:
    """Yield what annotations hold, by name, each with a value for every item."""
    landmarks = _landmarks(record, extras)
    if landmarks is not None:
        yield from _plane(landmarks)
        confidence = _numbers(extras.get("confidence"), record)
        if isinstance(record, LandmarkSet):
            confidence = record.confidence
        if confidence is not None:
            yield "confidence", list(confidence)
    yield "iscrowd", [0] * len(record)
    if isinstance(record, LandmarkSet):
        return
    shapes = record.shapes
    if isinstance(record, ResultSet) and record.y_axis == "up":
        shapes = TURNED[:, None] * shapes
    yield "keypoints_3d", _flat(shapes)
    if isinstance(record, ResultSet):
        if record.shape_sd is not None:
            yield "keypoints_3d_sd", _flat(record.shape_sd)
        if record.status is not None:
            yield "status", [str(status) for status in record.status]
        metres = extras.get(METRES_PER_UNIT)
        if metres is not None and metres.shape == (len(record),):
            yield METRES_PER_UNIT, metres.tolist()


def _landmarks(record: Record, extras: dict[str, Any]) -> Floats | None:
    """Return what was seen (n, p, 2), y down, nan elsewhere; None where that is not known."""
    if isinstance(record, ShapeSet):
        return None
    if isinstance(record, LandmarkSet):
        values = np.where(record.seen()[..., None], record.landmarks.swapaxes(1, 2), np.nan)
    else:
        values = extras.get("landmarks", np.empty(0))
        if values.shape != (len(record), len(record.landmark_names), 2):
            return None
    return np.asarray(values, np.float64) * (TURNED[:2] if record.y_axis == "up" else 1.0)


def _numbers(values: NDArray[Any] | None, record: Record) -> Floats | None:
    """Return a dataset (n, p), None where it is something else."""
    if values is None or values.shape != (len(record), len(record.landmark_names)):
        return None
    return np.asarray(values, np.float64)


def _plane(landmarks: Floats) -> Iterator[tuple[str, Sequence[Any]]]:
    """Yield what COCO says of landmarks (n, p, 2): x, y, v of each, and the box around them."""
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(landmarks).all(axis=2))
    points = np.where(seen[..., None], landmarks, 0.0)
    keypoints = np.concatenate([points, np.where(seen, SEEN, UNSEEN)[..., None]], axis=2)
    yield "keypoints", list(_rows(keypoints))
    yield "num_keypoints", seen.sum(axis=1).tolist()
    least = np.where(seen[..., None], landmarks, np.inf).min(axis=1, initial=np.inf)
    most = np.where(seen[..., None], landmarks, -np.inf).max(axis=1, initial=-np.inf)
    some = np.asarray(seen.any(axis=1))[:, None]
    size = np.subtract(most, least, out=np.zeros_like(most), where=some)
    yield "bbox", list(np.hstack([np.where(some, least, 0.0), size]))
    yield "area", size.prod(axis=1).tolist()


def _flat(points: Floats) -> list[Floats]:
    """Return points (n, 3, p) as x, y, z of one landmark after the other, for each item."""
    return list(_rows(points.swapaxes(1, 2)))


def _rows(values: Floats) -> Floats:
    """Return the numbers (n, p, m) of each item in one row (n, p m)."""
    n, p, m = values.shape
    return np.ascontiguousarray(values).reshape(n, p * m)


def _category(first: Record) -> Object:
    found: Object = {
        "id": CATEGORY,
        "name": "object",
        "keypoints": list(first.landmark_names),
        "skeleton": [],
    }
    if first.lines is not None:
        found["skeleton"] = (first.lines + 1).tolist()  # COCO counts from 1
    return found


def _info(first: Record) -> Object:
    info: Object = {"description": f"written by shapefit {__version__}", "version": __version__}
    if isinstance(first, ShapeSet):
        info |= {"unit_3d": first.unit, "axes_3d": "as in the shapes"}
    else:
        info |= {"unit": first.unit, "y_axis": "down"}
    if isinstance(first, ResultSet):
        info |= {"unit_3d": first.unit, "axes_3d": AXES}
    if first.frame_rate:
        info["frame_rate"] = first.frame_rate
    return info


def _said(first: Record) -> str:
    return f"unit {first.unit}" + ("" if isinstance(first, ShapeSet) else ", y down")


def _text(value: Any) -> bytes:
    return orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY)
