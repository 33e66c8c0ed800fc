"""Where the models of fitted images stand: in the frame and unit that `export` asks for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from shapefit.arrays import Floats
from shapefit.config.commands.fit_sections import ExportConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import ResultSet
from shapefit.meshes.dense import (
    around_centroid,
    camera_frame,
    metric_scale,
)
from shapefit.pipelines.export.carried_mesh import Pose

Known = TypeVar("Known")


def required(values: Known | None) -> Known:
    """Return what a record may lack and the fit at hand has."""
    assert values is not None
    return values


@dataclass(frozen=True)
class ModelPlacement:
    """size * S + origin, in the frame of the object size * R^T S, for n images with a shape.

    S are points in normalised units around the centroid of their landmarks, in the directions of
    the camera.
    """

    options: ExportConfig
    pose: Pose
    dictionary: Dictionary
    found: ResultSet

    def landmarks(self) -> Floats:
        """Return the fitted landmarks (n, 3, p)."""
        s, T = required(self.found.scale), required(self.found.translation)
        return self._place(around_centroid(self.found.shapes, s, T))

    def carry(self, atoms: Floats) -> Floats:
        """Return points (n, 3, q) of the atoms (k, 3, q), mixed, with one rotation per image."""
        one, none = np.ones(len(self.found)), np.zeros((len(self.found), 2))
        c, R = required(self.found.coefficients), required(self.found.rotation)
        return self._place(camera_frame(atoms, c, R, one, none))

    def _place(self, points: Floats) -> Floats:
        size = self._size()[:, None, None]
        if self.options.frame == "object":
            return size * (required(self.found.rotation).swapaxes(1, 2) @ points)
        return size * points + self._origin()[:, :, None]

    def _size(self) -> Floats:
        """Length (n,) of a normalised unit, in the unit of the landmarks or of the dictionary."""
        if self.options.unit == "landmarks":
            return required(self.found.scale)
        c, s = required(self.found.coefficients), required(self.dictionary.atom_scale)
        return metric_scale(self.dictionary.atoms, c, s)

    def _origin(self) -> Floats:
        """Where (n, 3) the centroid of the landmarks is in the frame of the camera.

        In pixels its depth is 0. In the unit of the dictionary its place is known where the camera
        is a perspective one, else it is 0.
        """
        origin = np.zeros((len(self.found), 3))
        if self.options.unit == "landmarks":
            origin[:, :2] = required(self.found.translation)
        elif self.pose.perspective:
            origin = np.asarray(self.found.columns["position"], dtype=float)
        return origin
