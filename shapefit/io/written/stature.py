"""How tall a body stands, whatever its pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shapefit.arrays import Floats
from shapefit.io.skeletons import PEOPLE, people_joints

ANKLE_TO_SHOULDER = 0.818 - 0.039
"""Share of the height of a person between the heights of ankles and shoulders (R. Drillis and R.
Contini, Body segment parameters, 1966)."""

_JOINTS = [f"{side}{joint}" for side in "lr" for joint in ("hip", "knee", "ankle", "shoulder")]

EXTENT_PERCENTILE = 95.0
"""Of the frames of a sequence: a few that went wrong do not count."""


def find_stature(shapes: Floats, names: Sequence[str]) -> Floats | None:
    """(|ankle knee| + |knee hip| + |hips shoulders|) / 0.779 along the body: (n,).

    shapes (n, 3, p); legs are the mean of both, hips and shoulders the middles of theirs. None
    where the landmarks are not those of a person with hips, knees, ankles and shoulders.
    """
    joints = people_joints(names) | {name: name for name in names if name in PEOPLE}
    column = {joint: place for place, name in enumerate(names) if (joint := joints.get(name))}
    if not set(_JOINTS) <= column.keys():
        return None

    def at(joint: str) -> Floats:
        return shapes[:, :, column[joint]]

    def apart(a: Floats, b: Floats) -> Floats:
        distance: Floats = np.linalg.norm(a - b, axis=1)
        return distance

    legs = sum(
        apart(at(f"{side}ankle"), at(f"{side}knee")) + apart(at(f"{side}knee"), at(f"{side}hip"))
        for side in "lr"
    )
    trunk = apart(at("lhip") + at("rhip"), at("lshoulder") + at("rshoulder"))
    stature: Floats = (legs + trunk) / 2 / ANKLE_TO_SHOULDER
    return stature


def find_extent(shapes: Floats) -> float:
    """Return the height of shapes (n, 3, p) with y up, that of the tallest frames; nan for none."""
    placed = np.isfinite(shapes).any(axis=(1, 2))
    if not placed.any():
        return float("nan")
    y = shapes[placed, 1]
    return float(np.percentile(np.nanmax(y, axis=1) - np.nanmin(y, axis=1), EXTENT_PERCENTILE))
