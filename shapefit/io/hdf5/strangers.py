"""What an HDF5 file of no known format holds, and what was looked for in it."""

from __future__ import annotations

from typing import Any

from shapefit.errors import abbreviate, printable
from shapefit.io.layout import LANDMARKS, SHAPES

LOOKED_FOR = (
    "DeepLabCut (a table of pandas in the root)",
    "SLEAP (tracks and node_names, or metadata, frames and instances)",
    "JABS (poseest/points)",
    "NWB (the attribute nwb_version)",
    "movement (the attribute ds_type)",
)

KERAS = {"keras_version", "model_weights", "layer_names"}


def stranger(file: Any, form: str = "") -> tuple[str, str]:
    """Return what is wrong with an open HDF5 file without the attribute `format`, and the fix.

    form is the layout that it should have, "" where any of ours would do.
    """
    entries, attributes = sorted(file), sorted(file.attrs)
    holds = abbreviate([printable(name) for name in entries]) or "nothing"
    found = f"has no root attribute format, and holds {holds}"
    if KERAS & {*entries, *attributes}:
        return found, "it is a model of Keras: give the landmarks that it found"
    own = f"set it to {form} if the file has that layout" if form else "a file of shapefit"
    if form and form not in (LANDMARKS.name, SHAPES.name):
        return found, own
    return found, f"give a file of {', '.join(LOOKED_FOR)}, or {own}"
