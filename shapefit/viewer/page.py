"""A scene as one HTML file that needs nothing else: code, style and data inlined.

A scene is a dict, whose keys are those that the scripts read, of n frames of p
landmarks, those of a sequence one after the other. Arrays are as `as_json` takes them;
what is absent is None.

title       its first line
items, landmarks, edges (pairs of landmarks), sides (0 middle, 1 left, 2 right of each
    landmark)
sequences   (name, first frame); recordings are those that were seen at once, times (n,)
            the time of
            each frame in its recording
grounds     of each sequence: `upright` (9) turns space so that y is up; `floor` is its
            y there
layers      results, shapes, truth: name, role; points (n, 3, p) in space, nan where
            there are none;
            fitted (n, 2, p) in the image; sd (n, 3, p) of points; camera (n, 4), focal
            lengths and principal point that take points to the image: x f / |z| + c in
            `perspective`, else x f + c; pose (n, 13), rotation, scale, translation that
            carry a mesh into space; blend, the meshes; status and reasons, words of
            frames; measures for the chart: name, values (n,), unit, sd (n,)
meshes      vertices (k, 3, q) of atoms, faces (f, 3)
observed    landmarks (n, 2, p), nan where hidden; outliers (n, p); pictures {frame:
            data URL, size}
unit        of the image, whose size is `image`; space_unit that of points, length that
            of their
            errors and how many of it are one of the former
y_down, frame_rate, rate_known; flat: there are images to show; video: frames follow
each other in
            time; rigid: shapes are shown in the frame of the object
facts       words of the header: text, its definition `title`, style; assumed and notes
            are
            sentences: what is taken for granted, what is missing
"""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Mapping
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

SCRIPTS = ("blocks", "geometry", "scene", "look", "plane", "space", "chart", "viewer")
"""In this order: each file uses only those before it."""
MISSING, LARGEST = -32768, 32767


def viewer_page(scene: Mapping[str, Any]) -> str:
    """Return the page of a scene.

    Names come from files of any origin: in the markup they are escaped, and the script
    puts them into the document as text only. The Content-Security-Policy lets run the
    script of the page alone, and forbids every request.
    """
    script = "\n".join(resource(f"scripts/{name}.js") for name in SCRIPTS)
    style = resource("palette.css") + resource("viewer.css")
    facts = (
        f'<li class="{fact.get("style", "")}" title="{escape(fact.get("title", ""))}">'
        f"{escape(fact['text'])}</li>"
        for fact in scene["facts"]
    )
    notes = (
        f"<li>{escape(note)}</li>" for note in (*scene["assumed"], *scene["notes"])
    )
    data = json.dumps(as_json(scene), allow_nan=False, separators=(",", ":"))
    parts = {
        "policy": content_security_policy(style, script),
        "style": style,
        "script": script,
        "title": escape(scene["title"]),
        "facts": "".join(facts),
        "notes": "".join(notes),
        # Nothing in it ends or opens an element.
        "page": (
            data.replace("&", r"\u0026").replace("<", r"\u003c").replace(">", r"\u003e")
        ),
    }
    return re.sub(
        r"\{\{([a-z]+)\}\}", lambda name: parts[name[1]], resource("viewer.html")
    )


def resource(name: str) -> str:
    """Return the text of a file of this package."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def content_security_policy(style: str, script: str) -> str:
    """Return the policy of a page with this one style and script: no request leaves the
    page.
    """
    hashes = (sha256(text.encode()).digest() for text in (script, style))
    of_script, of_style = (
        f"'sha256-{b64encode(one).decode('ascii')}'" for one in hashes
    )
    return (
        f"default-src 'none'; script-src {of_script}; style-src {of_style}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def encode_texts(texts: NDArray[Any] | None) -> dict[str, Any] | None:
    """Return texts (n,) as the different ones, and codes (n,) of those of the
    frames.
    """
    if texts is None:
        return None
    different, codes = np.unique(texts.astype(str), return_inverse=True)
    return {"words": different.tolist(), "codes": codes}


def blend(mesh_set: int, weights: Floats) -> dict[str, Any]:
    """Return weights (n, k), most of which are 0, of meshes of one set.

    Frame i shows the mesh sum_j weight_j V_atom_j, start[i] <= j < start[i + 1].
    """
    frame, atom = np.nonzero(weights)
    start = np.searchsorted(frame, np.arange(len(weights) + 1))
    return {
        "mesh_set": mesh_set,
        "start": start,
        "atom": atom,
        "weight": weights[frame, atom],
    }


def as_json(value: Any) -> Any:
    """Return a scene, or a part of one, as the page reads it, without what is None.

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
    return block(value, "u1" if largest < 2**8 else "u2" if largest < 2**16 else "u4")


def block(values: NDArray[Any], kind: str) -> dict[str, Any]:
    """Return an array as base64 of small integers or floats, as scripts/blocks.js reads
    it.
    """
    data = np.ascontiguousarray(values.astype(f"<{kind}")).tobytes()
    return {
        "type": kind,
        "shape": list(values.shape),
        "data": b64encode(data).decode("ascii"),
    }


def block_of_points(points: Floats) -> dict[str, Any]:
    """Return points (n, d, p) as 16-bit integers, each of the n sets on a scale of its
    own.

    A point that is not finite in 32 bits is missing.
    """
    rows = points.swapaxes(1, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(rows.astype("<f4")).all(axis=2, keepdims=True)
    some = finite.any(axis=1)
    low = np.where(
        some, np.where(finite, rows, np.inf).min(axis=1, initial=np.inf), 0.0
    )
    high = np.where(
        some, np.where(finite, rows, -np.inf).max(axis=1, initial=-np.inf), 0.0
    )
    scale = (high - low).max(axis=1, keepdims=True) / (2 * LARGEST)
    places = np.hstack([(low + high) / 2, np.where(scale > 0, scale, 1.0)]).astype(
        "<f4"
    )
    offset, scale = (
        places[:, None, :-1].astype(float),
        places[:, None, -1:].astype(float),
    )
    codes = np.rint(
        (np.where(finite, rows, offset) - offset) / np.maximum(scale, 1e-300)
    )
    codes = np.where(finite, np.clip(codes, -LARGEST, LARGEST), MISSING)
    return block(codes, "i2") | {"places": block(places, "f4")}
