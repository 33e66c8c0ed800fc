"""What a page shows (frames, layers, meshes, pictures), and the JSON of it that the page reads."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers

USUAL_RATE, RATE_OF_IMAGES = 25.0, 2.0
"""Frames a second where no file says it: of sequences, and of images that are none."""
MISSING, LARGEST = -32768, 32767


@dataclass(frozen=True)
class Measure:
    """A number (n,) for every frame, for the strip: its scale, and which end of it is bad.

    limit is the value beyond which a frame is doubtful, where there is one.
    """

    name: str
    values: Floats
    scale: Literal["linear", "log", "share"] = "linear"
    bad: Literal["high", "low"] = "high"
    unit: str = ""
    limit: float | None = None


@dataclass(frozen=True)
class MeshSet:
    """Meshes of one topology: vertices (k, 3, q) of the atoms, faces (f, 3)."""

    vertices: Floats
    faces: Integers


@dataclass(frozen=True)
class Blend:
    """Frame i shows the mesh sum_j weight_j V_atom_j of a set, start[i] <= j < start[i + 1]."""

    mesh_set: int
    start: Integers
    atom: Integers
    weight: Floats


@dataclass(frozen=True)
class Layer:
    """One result, the truth, or shapes: points (n, 3, p), nan where there are none.

    fitted (n, 2, p) are given where they are not x and y of the points; sd (n, 3, p) standard
    deviations; pose (n, 13) rotation, scale, translation that carry a mesh into the frame of the
    points; camera (n, 7) position of the centroid, focal lengths, principal point; status a word
    for every frame; doubts says of every frame why its shape is not to be trusted, "" where it is.
    """

    name: str
    role: Literal["result", "truth", "shapes"]
    points: Floats
    fitted: Floats | None = None
    sd: Floats | None = None
    pose: Floats | None = None
    camera: Floats | None = None
    blend: Blend | None = None
    status: Sequence[str] | None = None
    doubts: Sequence[str] | None = None
    measures: tuple[Measure, ...] = ()


@dataclass(frozen=True)
class Picture:
    """The image under the landmarks of a frame: base64 of a JPEG, size in the original pixels."""

    data: str
    size: tuple[int, int]


@dataclass(frozen=True)
class Scene:
    """n frames of p landmarks, those of a sequence one after the other.

    sequences maps names to the first frame of each, in order; seen (n, 2, p) are the observed
    landmarks, nan where hidden, or None; outliers (n, p). sides says of each landmark whether it is
    in the middle (0), on the left (1) or on the right (2), or on one side and the other where it is
    not known which is which (`sides_named`). moments (n,) are equal for frames of different
    individuals that were seen at once, and 0 for others. notes say what the page lacks.
    """

    title: str
    items: Sequence[str]
    sequences: Sequence[tuple[str, int]]
    landmarks: Sequence[str]
    edges: Integers
    layers: Sequence[Layer]
    unit: str
    y_down: bool
    frame_rate: float | None = None
    seen: Floats | None = None
    outliers: NDArray[np.bool_] | None = None
    sides: Sequence[int] = ()
    sides_named: bool = True
    moments: Integers | None = None
    meshes: Sequence[MeshSet] = ()
    pictures: Mapping[int, Picture] = field(default_factory=dict)
    notes: Sequence[str] = ()


def as_json(scene: Scene) -> dict[str, Any]:
    """Return what the page reads, ready for JSON."""
    has_images = scene.seen is not None or any(layer.role == "result" for layer in scene.layers)
    in_motion = any(name for name, _ in scene.sequences)
    return {
        "unit": shown_unit(scene.unit),
        "yDown": scene.y_down,
        "frameRate": scene.frame_rate or (USUAL_RATE if in_motion else RATE_OF_IMAGES),
        "rateKnown": scene.frame_rate is not None,
        "flat": has_images,
        "landmarks": list(scene.landmarks),
        "edges": scene.edges.tolist(),
        "sides": list(scene.sides) if any(scene.sides) else None,
        "sidesNamed": scene.sides_named,
        "moments": None if scene.moments is None else block(scene.moments, "u4"),
        "items": list(scene.items),
        "sequences": [{"name": name, "start": start} for name, start in scene.sequences],
        "seen": None if scene.seen is None else block_of_points(scene.seen),
        "outliers": None if scene.outliers is None else block(scene.outliers, "u1"),
        "layers": [_layer(layer) for layer in scene.layers],
        "meshes": [
            {
                "vertices": block_of_points(mesh.vertices),
                "faces": block(mesh.faces, smallest_kind(mesh.vertices.shape[2])),
            }
            for mesh in scene.meshes
        ],
        "pictures": {
            str(frame): {"data": f"data:image/jpeg;base64,{each.data}", "size": each.size}
            for frame, each in scene.pictures.items()
        },
    }


def shown_unit(unit: str) -> str:
    """Return a unit as the page has it: nothing for one that is not known."""
    return "" if unit == "unknown" else unit


def block(values: NDArray[Any], kind: str) -> dict[str, Any]:
    """Return an array as base64 of small integers or floats, as scripts/blocks.js reads it."""
    data = np.ascontiguousarray(values.astype(f"<{kind}")).tobytes()
    return {"type": kind, "shape": list(values.shape), "data": b64encode(data).decode("ascii")}


def block_of_points(points: Floats) -> dict[str, Any]:
    """Return points (n, d, p) as 16-bit integers, each of the n sets on a scale of its own.

    A point that is not finite in 32 bits is missing.
    """
    rows = points.swapaxes(1, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        known: NDArray[np.bool_] = np.isfinite(rows.astype("<f4")).all(axis=2, keepdims=True)
    some = known.any(axis=1)
    low = np.where(some, np.where(known, rows, np.inf).min(axis=1, initial=np.inf), 0.0)
    high = np.where(some, np.where(known, rows, -np.inf).max(axis=1, initial=-np.inf), 0.0)
    scale = (high - low).max(axis=1, keepdims=True) / (2 * LARGEST)
    places = np.hstack([(low + high) / 2, np.where(scale > 0, scale, 1.0)]).astype("<f4")
    offset, scale = places[:, None, :-1].astype(float), places[:, None, -1:].astype(float)
    codes = np.rint((np.where(known, rows, offset) - offset) / np.maximum(scale, 1e-300))
    codes = np.where(known, np.clip(codes, -LARGEST, LARGEST), MISSING)
    return block(codes, "i2") | {"places": block(places, "f4")}


def smallest_kind(largest: int) -> str:
    """Return the integer type that holds numbers up to `largest`."""
    return "u1" if largest < 2**8 else "u2" if largest < 2**16 else "u4"


def _layer(layer: Layer) -> dict[str, Any]:
    document: dict[str, Any] = {
        "name": layer.name,
        "role": layer.role,
        "points": block_of_points(layer.points),
        "measures": [
            {
                "name": measure.name,
                "scale": measure.scale,
                "bad": measure.bad,
                "unit": shown_unit(measure.unit),
                "limit": measure.limit,
                "values": block(measure.values, "f4"),
            }
            for measure in layer.measures
        ],
    }
    for name, points in (("fitted", layer.fitted), ("sd", layer.sd)):
        if points is not None:
            document[name] = block_of_points(points)
    for name, values in (("pose", layer.pose), ("camera", layer.camera)):
        if values is not None:
            document[name] = block(values, "f4")
    for name, texts in (("status", layer.status), ("doubts", layer.doubts)):
        if texts is not None:
            words, codes = np.unique(np.array(texts, dtype=str), return_inverse=True)
            kind = smallest_kind(len(words))
            document[name] = {"words": words.tolist(), "codes": block(codes, kind)}
    if (blend := layer.blend) is not None:
        document["mesh"] = {
            "of": blend.mesh_set,
            "start": block(blend.start, "u4"),
            "atom": block(blend.atom, smallest_kind(int(blend.atom.max(initial=0)))),
            "weight": block(blend.weight, "f4"),
        }
    return document
