"""What a page shows (frames, layers, meshes, pictures), and the JSON of it that the page reads."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers

USUAL_RATE = 25.0
"""Frames a second where no file says it."""
MISSING, LARGEST = -32768, 32767


@dataclass(frozen=True)
class Measure:
    """A number (n,) for every frame, for the chart, with standard deviations where it has some."""

    name: str
    values: Floats
    unit: str = ""
    sd: Floats | None = None


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
class Words:
    """A text for every frame: the different ones, and codes (n,) of those of the frames."""

    words: Sequence[str]
    codes: Integers

    @classmethod
    def of(cls, texts: NDArray[Any] | None) -> Words | None:
        """Return texts (n,); None where there are none."""
        if texts is None:
            return None
        words, codes = np.unique(texts.astype(str), return_inverse=True)
        return cls(words.tolist(), codes)


@dataclass(frozen=True)
class Layer:
    """One result, the truth, or shapes: points (n, 3, p) in space, nan where there are none.

    camera (n, 4) focal lengths and principal point that take them to the image: x f / |z| + c in
    perspective, else x f + c; x and y themselves without it. fitted (n, 2, p) are given where the
    landmarks are elsewhere. sd (n, 3, p) standard deviations in space; pose (n, 13) rotation,
    scale, translation that carry a mesh into it; status is a word for frames that have one;
    doubts says why a shape is not to be trusted, "" where it is.
    """

    name: str
    role: Literal["result", "truth", "shapes"]
    points: Floats
    fitted: Floats | None = None
    sd: Floats | None = None
    pose: Floats | None = None
    camera: Floats | None = None
    perspective: bool = False
    blend: Blend | None = None
    status: Words | None = None
    doubts: Words | None = None
    measures: tuple[Measure, ...] = ()


@dataclass(frozen=True)
class Stand:
    """How the shapes of a sequence stand: upright (9) turns space so that y is up, seen from the
    camera; floor is its y there, None where it is not known.
    """

    upright: Sequence[float]
    floor: float | None = None


@dataclass(frozen=True)
class Fact:
    """A few words of the header: what is shown, or how good it is; `title` defines it on hover."""

    text: str
    title: str = ""
    style: str = ""


@dataclass(frozen=True)
class Picture:
    """The image under the landmarks of a frame: a data URL, size in the original pixels."""

    data: str
    size: tuple[int, int]


@dataclass(frozen=True)
class Scene:
    """n frames of p landmarks, those of a sequence one after the other.

    sequences maps names to the first frame of each, in order; seen (n, 2, p) are the observed
    landmarks, nan where hidden, or None; outliers (n, p). sides says of each landmark whether it is
    in the middle (0), on the left (1) or on the right (2). Sequences that were seen at once are one
    recording: recordings names the sequences of each, times (n,) the time of each frame in its own;
    None where each sequence is by itself. stands has one for each sequence. flat says that there
    are images to show, image (2) is their width and height where it is known; video that frames
    follow each other in time; rigid that shapes are shown in the frame of the object. facts say
    what is shown and how good it is, assumed what the fit took for granted, notes what is lacking.
    """

    title: str
    items: Sequence[str]
    sequences: Sequence[tuple[str, int]]
    landmarks: Sequence[str]
    edges: Sequence[Sequence[int]]
    layers: Sequence[Layer]
    unit: str
    space_unit: str
    y_down: bool
    stands: Sequence[Stand]
    frame_rate: float = USUAL_RATE
    rate_known: bool = False
    flat: bool = False
    seen: Floats | None = None
    outliers: NDArray[np.bool_] | None = None
    sides: Sequence[int] | None = None
    recordings: Sequence[Sequence[int]] | None = None
    times: Integers | None = None
    meshes: Sequence[MeshSet] = ()
    pictures: Mapping[int, Picture] = field(default_factory=dict)
    image: Sequence[float] | None = None
    video: bool = False
    rigid: bool = False
    facts: tuple[Fact, ...] = ()
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def as_json(value: Any) -> Any:
    """Return a scene, or a part of one, as the page reads it: fields by their names.

    Numbers are blocks: points (n, d, p) on a scale of each set, other floats in 32 bits, integers
    in as few bytes as they need.
    """
    if is_dataclass(value):
        named = {field.name: getattr(value, field.name) for field in fields(value)}
        return {name: as_json(each) for name, each in named.items() if each is not None}
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "f":
            return block_of_points(value) if value.ndim == 3 else block(value, "f4")
        largest = int(value.max(initial=0))
        return block(value, "u1" if largest < 2**8 else "u2" if largest < 2**16 else "u4")
    if isinstance(value, Mapping):
        return {str(key): as_json(each) for key, each in value.items()}
    return [as_json(each) for each in value] if isinstance(value, list | tuple) else value


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
