"""A scene as one HTML file that needs nothing else: code, style and data inlined.

A scene holds n frames of p landmarks, those of a sequence one after the other, by the
keys that the scripts read. What is absent is None.
"""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Any, Literal, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers

SCRIPTS = (
    "blocks",
    "geometry",
    "scene",
    "look",
    "film",
    "plane",
    "space",
    "chart",
    "viewer",
)
"""In this order: each file uses only those before it."""

MAX_CODE = 32767
"""Largest coordinate of a point in 16 bits."""

MISSING_CODE = -32768
"""Coordinate of a point that is missing."""


class Measure(TypedDict):
    """A curve of the chart: values (n,) in a unit, with standard deviations (n,)."""

    name: str
    values: Floats
    unit: str
    sd: Floats | None


class EncodedTexts(TypedDict):
    """Texts of frames: the different ones, and which one (n,) each is."""

    words: list[str]
    codes: Integers


class Blend(TypedDict):
    """How a layer mixes the meshes of one set.

    Frame i shows the mesh sum_j weight_j V_atom_j, start[i] <= j < start[i + 1].
    """

    mesh_set: int
    start: Integers
    atom: Integers
    weight: Floats


class Layer(TypedDict):
    """Shapes of one name: a result, shapes of a file, or the truth."""

    name: str
    role: Literal["result", "shapes", "landmarks", "truth"]

    points: Floats
    """(n, 3, p) in space, nan where there are none."""

    fitted: NotRequired[Floats]
    """(n, 2, p) in the image."""

    sd: NotRequired[Floats | None]
    """Standard deviations (n, 3, p) of points."""

    pose: Floats | None
    """(n, 13): rotation, scale and translation that carry a mesh into space."""

    camera: NotRequired[Floats | None]
    """(n, 4): focal lengths and principal point that take points to the image.

    In `perspective` by x f / |z| + c, else by x f + c.
    """

    perspective: bool

    status: NotRequired[EncodedTexts | None]
    """How frames ended that were not solved."""

    reasons: NotRequired[EncodedTexts | None]
    """Why frames are not trusted."""

    measures: list[Measure]
    blend: NotRequired[Blend]


class MeshSet(TypedDict):
    """Vertices (k, 3, q) of meshes that share their faces (f, 3)."""

    vertices: Floats
    faces: Integers | None


class Ground(TypedDict):
    """The ground of a sequence.

    upright (9), the rotation that turns space so that y is up; floor, its y there.
    """

    upright: list[float]
    floor: NotRequired[float]


class Picture(TypedDict):
    """A picture as data URL, and its width and height in the unit of the landmarks."""

    data: str
    size: tuple[float, float]


class Film(TypedDict):
    """A film of m frames, which the page carries."""

    kind: str
    """Its media type."""

    data: str
    """Its bytes in base64."""

    starts: Floats
    """The seconds (m + 1,) at which its frames are shown, and at which it is over."""

    places: Floats
    """Which of its frames each frame (n,) of the page is, nan for none."""


class Fact(TypedDict):
    """Some words of the header, with a definition and a style."""

    text: str
    title: NotRequired[str]
    style: NotRequired[str]


class Scene(TypedDict):
    """All that a page shows."""

    title: str
    """The first line of the page."""

    items: Sequence[str]

    sequences: Sequence[tuple[str, int]]
    """Name and first frame of each."""

    landmarks: Sequence[str]

    edges: list[list[int]]
    """Pairs of landmarks."""

    layers: list[Layer]

    unit: str
    """Of the image."""

    space_unit: str
    """Of points."""

    length: tuple[str, float]
    """Unit of the errors of points, and how many of it are one of space_unit."""

    y_down: bool

    grounds: list[Ground]
    """Of each sequence."""

    frame_rate: float
    rate_known: bool

    flat: bool
    """Whether there are images to show."""

    observed: Floats | None
    """Landmarks (n, 2, p), nan where hidden."""

    outliers: NDArray[np.bool_] | None
    """Which landmarks (n, p) are judged wrong."""

    sides: list[int] | None
    """0 middle, 1 left, 2 right for each landmark."""

    recordings: list[list[int]]
    """Sequences that were seen at once."""

    times: Integers
    """The time (n,) of each frame in its recording."""

    meshes: list[MeshSet]

    pictures: Mapping[int, Picture]
    """By frame."""

    film: Film | None

    image: list[float] | None
    """Width and height of the images."""

    video: bool
    """Whether frames follow each other in time."""

    rigid: bool
    """Whether shapes are shown in the frame of the object."""

    facts: list[Fact]
    """Words of the header."""

    about: str
    """Before distances from the camera: "about " where they rest on a guess."""

    assumed: list[str]
    """Sentences on what is taken for granted, and what sets it."""

    notes: list[str]
    """Sentences on what is missing."""


class EncodedArray(TypedDict):
    """An array as scripts/blocks.js reads it: base64 of small integers or floats."""

    type: str
    shape: list[int]
    data: str
    places: NotRequired[EncodedArray]


def viewer_page(scene: Scene) -> str:
    """Return the HTML of the page that shows a scene.

    Names come from files of any origin: in the markup they are escaped, and the script
    puts them into the document as text only. The Content-Security-Policy lets run the
    script of the page alone, and forbids every request.
    """
    script = "\n".join(resource(f"scripts/{name}.js") for name in SCRIPTS)
    style = resource("palette.css") + resource("viewer.css")
    facts = [
        f'<li class="{fact.get("style", "")}" title="{escape(fact.get("title", ""))}">'
        f"{escape(fact['text'])}</li>"
        for fact in scene["facts"]
    ]
    sentences = (*scene["assumed"], *scene["notes"])
    notes = [f"<li>{escape(sentence)}</li>" for sentence in sentences]
    data = json.dumps(as_json(scene), allow_nan=False, separators=(",", ":"))
    parts = {
        "policy": content_security_policy(
            style, script, has_film=scene["film"] is not None
        ),
        "style": style,
        "script": script,
        "title": escape(scene["title"]),
        "facts": "".join(facts),
        "notes": "".join(notes),
        "page": _without_markup(data),
    }
    template = resource("viewer.html")
    return re.sub(r"\{\{([a-z]+)\}\}", lambda name: parts[name[1]], template)


def resource(name: str) -> str:
    """Return the text of a file of this package."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _without_markup(data: str) -> str:
    """Return JSON with &, < and > as escapes, so that HTML finds no element in it."""
    data = data.replace("&", r"\u0026")
    return data.replace("<", r"\u003c").replace(">", r"\u003e")


def content_security_policy(style: str, script: str, *, has_film: bool) -> str:
    """Return the Content-Security-Policy of a page, by which it makes no requests.

    A film is played from the memory of the page.
    """
    media = " media-src blob:;" if has_film else ""
    return (
        f"default-src 'none'; script-src {_hash_of(script)}; style-src"
        f" {_hash_of(style)}; img-src data:;{media} base-uri 'none'; form-action 'none'"
    )


def _hash_of(text: str) -> str:
    """Return the SHA-256 digest of a script or style as a policy states it."""
    digest = sha256(text.encode()).digest()
    return f"'sha256-{b64encode(digest).decode('ascii')}'"


def encode_texts(texts: NDArray[np.object_] | None) -> EncodedTexts | None:
    """Encode texts (n,) as the different ones, and the index of that of each."""
    if texts is None:
        return None
    different, codes = np.unique(texts.astype(str), return_inverse=True)
    return {"words": different.tolist(), "codes": codes}


def blend_meshes(mesh_set: int, weights: Floats) -> Blend:
    """Return weights (n, k) of the meshes of one set as a sparse matrix in rows."""
    frame, atom = np.nonzero(weights)
    start = np.searchsorted(frame, np.arange(len(weights) + 1))
    return {
        "mesh_set": mesh_set,
        "start": start,
        "atom": atom,
        "weight": weights[frame, atom],
    }


def as_json(value: object) -> object:
    """Convert a scene, or a part of one, to JSON values, without what is None.

    Arrays are blocks: points (n, d, p) on a scale of each set, other floats in 32 bits,
    integers in as few bytes as they need.
    """
    if isinstance(value, Mapping):
        return {
            str(key): as_json(part) for key, part in value.items() if part is not None
        }
    if isinstance(value, list | tuple):
        return [as_json(part) for part in value]
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype.kind == "f":
        return block_of_points(value) if value.ndim == 3 else block(value, "f4")
    largest = int(value.max(initial=0))
    if largest < 2**8:
        return block(value, "u1")
    return block(value, "u2" if largest < 2**16 else "u4")


def block(values: NDArray[Any], kind: str) -> EncodedArray:
    """Encode an array in base64, as little-endian numbers of a kind such as `i2`."""
    data = np.ascontiguousarray(values.astype(f"<{kind}")).tobytes()
    return {
        "type": kind,
        "shape": list(values.shape),
        "data": b64encode(data).decode("ascii"),
    }


def block_of_points(points: Floats) -> EncodedArray:
    """Encode points (n, d, p) as 16-bit integers, each image on a scale of its own.

    A point that is not finite in 32 bits is missing.
    """
    rows = points.swapaxes(1, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(rows.astype("<f4")).all(axis=2, keepdims=True)
    has_any = finite.any(axis=1)
    low = np.where(finite, rows, np.inf).min(axis=1, initial=np.inf)
    high = np.where(finite, rows, -np.inf).max(axis=1, initial=-np.inf)
    low = np.where(has_any, low, 0.0)
    high = np.where(has_any, high, 0.0)
    scale = (high - low).max(axis=1, keepdims=True) / (2 * MAX_CODE)
    places = np.hstack([(low + high) / 2, np.where(scale > 0, scale, 1.0)])
    # the page has them in 32 bits, so these are what codes must go with
    places = places.astype("<f4")
    offset = places[:, None, :-1].astype(float)
    scale = places[:, None, -1:].astype(float)
    centred = np.where(finite, rows, offset) - offset
    codes = np.rint(centred / np.maximum(scale, 1e-300))
    codes = np.where(finite, np.clip(codes, -MAX_CODE, MAX_CODE), MISSING_CODE)
    encoded = block(codes, "i2")
    encoded["places"] = block(places, "f4")
    return encoded
