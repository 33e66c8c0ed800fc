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
"""Frames a second where no file states it."""
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

    @classmethod
    def of(cls, mesh_set: int, weights: Floats) -> Blend:
        """Return the blend of weights (n, k), most of which are 0."""
        frame, atom = np.nonzero(weights)
        start = np.searchsorted(frame, np.arange(len(weights) + 1))
        return cls(mesh_set, start, atom, weights[frame, atom])


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

    fitted (n, 2, p) landmarks in the image. camera (n, 4) focal lengths and principal point that
    take points to the image: x f / |z| + c in perspective, else x f + c. sd (n, 3, p) standard
    deviations in space; pose (n, 13) rotation, scale, translation that carry a mesh into it; status
    is a word for frames that have one; reasons say why a shape is not trusted, "" for none.
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
    reasons: Words | None = None
    measures: tuple[Measure, ...] = ()


@dataclass(frozen=True)
class Ground:
    """upright (9) turns space so that y is up; floor is its y there, None where it is not known."""

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

    sequences are (name, first frame); recordings the sequences that were seen at once, times (n,)
    the time of each frame in its recording; one ground a sequence. observed (n, 2, p) are the
    landmarks, nan where hidden; outliers (n, p). sides: each landmark is in the middle (0), on the
    left (1) or on the right (2). space_unit is that of points, length that of their errors and how
    many of it are one of the former, unit that of the image, whose width and height are `image`.
    flat: there are images to show; video: frames follow each other in time; rigid: shapes are shown
    in the frame of the object. assumed is what the fit took for granted, notes what is missing.
    """

    title: str
    items: Sequence[str]
    sequences: Sequence[tuple[str, int]]
    recordings: Sequence[Sequence[int]]
    times: Integers
    grounds: Sequence[Ground]
    landmarks: Sequence[str]
    edges: Sequence[Sequence[int]]
    layers: Sequence[Layer]
    unit: str
    space_unit: str
    length: tuple[str, float]
    y_down: bool
    frame_rate: float
    rate_known: bool
    flat: bool
    video: bool
    rigid: bool
    observed: Floats | None = None
    outliers: NDArray[np.bool_] | None = None
    sides: Sequence[int] | None = None
    meshes: Sequence[MeshSet] = ()
    pictures: Mapping[int, Picture] = field(default_factory=dict)
    image: Sequence[float] | None = None
    facts: tuple[Fact, ...] = ()
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def as_json(value: Any) -> Any:
    """Return a scene, or a part of one, as the page reads it: fields by their names.

    Arrays are blocks: points (n, d, p) on a scale of each set, other floats in 32 bits, integers
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
        finite = np.isfinite(rows.astype("<f4")).all(axis=2, keepdims=True)
    some = finite.any(axis=1)
    low = np.where(some, np.where(finite, rows, np.inf).min(axis=1, initial=np.inf), 0.0)
    high = np.where(some, np.where(finite, rows, -np.inf).max(axis=1, initial=-np.inf), 0.0)
    scale = (high - low).max(axis=1, keepdims=True) / (2 * LARGEST)
    places = np.hstack([(low + high) / 2, np.where(scale > 0, scale, 1.0)]).astype("<f4")
    offset, scale = places[:, None, :-1].astype(float), places[:, None, -1:].astype(float)
    codes = np.rint((np.where(finite, rows, offset) - offset) / np.maximum(scale, 1e-300))
    codes = np.where(finite, np.clip(codes, -LARGEST, LARGEST), MISSING)
    return block(codes, "i2") | {"places": block(places, "f4")}
