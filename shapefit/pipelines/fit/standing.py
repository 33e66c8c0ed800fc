"""Which way is up in the images, and whether the people in them stand on their heads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shapefit.io import LandmarkSource, ResultSet
from shapefit.io.skeletons import PEOPLE, people_joints
from shapefit.pipelines.outcome import Counted

STEEP = 0.5
"""Cosine of the angle to the vertical within which a body stands, or is on its head: 60 degrees."""


def said_of_y(source: LandmarkSource) -> str:
    """Say which way y was taken to point in the images."""
    taken = "" if source.states_y_axis else ", as no file says otherwise"
    return f"y {source.head.y_axis} in the images{taken}"


class Standing:
    """Counts the images of a run whose bodies stand, and those whose bodies are on their heads."""

    def __init__(self, landmark_names: Sequence[str]) -> None:
        joints = people_joints(landmark_names) | {n: n for n in landmark_names if n in PEOPLE}
        place = {joint: landmark_names.index(name) for name, joint in joints.items()}
        ends = [place.get(joint) for joint in ("head", "lankle", "rankle")]
        self._ends = [end for end in ends if end is not None]
        self._images = self._on_head = 0
        self._y_axis = "down"

    def add(self, record: ResultSet) -> None:
        """Take the shapes of a chunk, in the camera frame."""
        if len(self._ends) < 3:
            return
        head, *ankles = np.moveaxis(record.shapes[:, :, self._ends], 2, 0)
        body = head - sum(ankles) / 2
        body = body[np.isfinite(body).all(axis=1)]
        up = body[:, 1] * (1 if record.y_axis == "up" else -1)
        self._images += len(body)
        self._on_head += int((up < -STEEP * np.linalg.norm(body, axis=1)).sum())
        self._y_axis = record.y_axis

    @property
    def warnings(self) -> tuple[Counted, ...]:
        """A warning where most bodies are on their heads."""
        if self._on_head <= self._images / 2:
            return ()
        other = "up" if self._y_axis == "down" else "down"
        taken = f"y was taken to point {self._y_axis}; if it points {other}, set `y_axis: {other}`"
        return (Counted(self._on_head, "image", f"with people on their heads: {taken}"),)
