"""What a page shows, as records: frames, layers, meshes, pictures; and their JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.viewer.blocks import (
    block_of_bits,
    block_of_coarse_floats,
    block_of_floats,
    block_of_integers,
    block_of_points,
    smallest_kind,
)

Role = Literal["result", "truth", "shapes"]


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
    role: Role
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
    """The image under the landmarks of a frame: base64, and its size in the original pixels."""

    media_type: str
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


USUAL_RATE, RATE_OF_IMAGES = 25.0, 2.0
"""Frames a second where no file says it: of sequences, and of images that are none."""


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
        "moments": None if scene.moments is None else block_of_integers(scene.moments, "u4"),
        "items": list(scene.items),
        "sequences": [{"name": name, "start": start} for name, start in scene.sequences],
        "seen": None if scene.seen is None else _points(scene.seen),
        "outliers": None if scene.outliers is None else block_of_bits(scene.outliers),
        "layers": [_layer(layer) for layer in scene.layers],
        "meshes": [_mesh(mesh) for mesh in scene.meshes],
        "pictures": {
            str(frame): {
                "data": f"data:{picture.media_type};base64,{picture.data}",
                "size": picture.size,
            }
            for frame, picture in scene.pictures.items()
        },
    }


def shown_unit(unit: str) -> str:
    """Return a unit as the page has it: nothing for one that is not known."""
    return "" if unit == "unknown" else unit


def _points(points: Floats) -> dict[str, Any]:
    return block_of_points(points.swapaxes(1, 2))


def _layer(layer: Layer) -> dict[str, Any]:
    document: dict[str, Any] = {
        "name": layer.name,
        "role": layer.role,
        "points": _points(layer.points),
        "measures": [
            {
                "name": measure.name,
                "scale": measure.scale,
                "bad": measure.bad,
                "unit": shown_unit(measure.unit),
                "limit": measure.limit,
                "values": block_of_coarse_floats(measure.values),
            }
            for measure in layer.measures
        ],
    }
    if layer.fitted is not None:
        document["fitted"] = _points(layer.fitted)
    if layer.sd is not None:
        document["sd"] = _points(layer.sd)
    for name, values in (("pose", layer.pose), ("camera", layer.camera)):
        if values is not None:
            document[name] = block_of_floats(values)
    for name, texts in (("status", layer.status), ("doubts", layer.doubts)):
        if texts is not None:
            words, codes = np.unique(np.array(texts, dtype=str), return_inverse=True)
            kind = smallest_kind(len(words))
            document[name] = {"words": words.tolist(), "codes": block_of_integers(codes, kind)}
    if layer.blend is not None:
        document["mesh"] = _blend(layer.blend)
    return document


def _blend(blend: Blend) -> dict[str, Any]:
    kind = smallest_kind(int(blend.atom.max(initial=0)))
    return {
        "of": blend.mesh_set,
        "start": block_of_integers(blend.start, "u4"),
        "atom": block_of_integers(blend.atom, kind),
        "weight": block_of_floats(blend.weight),
    }


def _mesh(mesh: MeshSet) -> dict[str, Any]:
    kind = smallest_kind(mesh.vertices.shape[2])
    return {"vertices": _points(mesh.vertices), "faces": block_of_integers(mesh.faces, kind)}
