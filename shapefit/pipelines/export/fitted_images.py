"""What a picture shows of a fitted image: taken from what `fit` stores, and the mesh carried on."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.pinhole import Camera, depth_sign
from shapefit.io import ResultSet
from shapefit.meshes.dense import (
    around_centroid,
    camera_frame,
    camera_frame_sheared,
    seen_in_perspective,
)
from shapefit.meshes.ellipses import covariances
from shapefit.meshes.pictures import FittedImage
from shapefit.pipelines.export.carried_mesh import Pose, find_meshes, find_obstacle
from shapefit.pipelines.export.meshes import has_shape
from shapefit.pipelines.export.placement import required


def fitted_image(
    found: ResultSet, transforms: Transforms | None, pose: Pose, dictionary: Dictionary
) -> FittedImage:
    """Gather one image (n = 1); without mesh where that cannot follow, all nan without a shape.

    The mesh has one rotation. Where the camera sees it is another matter: there it is projected as
    the fit projects it, with a rotation per atom (convex) or in perspective, so that it lies under
    the fitted landmarks.
    """
    extras = found.columns
    outliers = np.asarray(extras["outliers"][0], dtype=bool) if "outliers" in extras else None
    landmarks = np.asarray(extras["landmarks"][0], dtype=float).T
    (title,) = found.items
    if not has_shape(found)[0]:
        nowhere = np.full_like(found.shapes[0], np.nan)
        return FittedImage(title, landmarks, nowhere, outliers=outliers)
    meshes = find_meshes(dictionary)
    carried = None if meshes is None or find_obstacle(pose) else meshes.vertices
    mesh = None if carried is None else _shared(carried, found)
    seen_shape, seen_mesh = found.shapes, mesh
    if pose.perspective:
        seen_shape = _in_perspective(found.shapes, found)
        seen_mesh = None if mesh is None else _in_perspective(mesh, found)
    elif carried is not None and not pose.one_rotation:
        seen_mesh = camera_frame_sheared(
            carried,
            required(transforms).dense(),
            *_place(found),
            orthogonal=pose.rotations == "orthogonal",
        )
    return FittedImage(
        title=title,
        landmarks=landmarks,
        shape=found.shapes[0],
        mesh_vertices=None if mesh is None else mesh[0],
        outliers=outliers,
        rotation=required(found.rotation)[0],
        seen_shape=seen_shape[0],
        seen_mesh=None if seen_mesh is None else seen_mesh[0],
        covariance=_covariance(found),
    )


def _covariance(found: ResultSet) -> Floats | None:
    """Covariance (p, 3, 3) of the landmarks of one image, where the method knows it."""
    if found.shape_sd is None:
        return None
    correlation = found.columns.get("shape_correlation")
    return covariances(
        found.shape_sd[0],
        None if correlation is None else np.asarray(correlation[0], dtype=float).T,
    )


def _place(found: ResultSet) -> tuple[Floats, Floats]:
    return required(found.scale), required(found.translation)


def _shared(atoms: Floats, found: ResultSet) -> Floats:
    """Turn mixed atoms by one rotation, in the frame and unit of the fitted shapes."""
    c, R = required(found.coefficients), required(found.rotation)
    return camera_frame(atoms, c, R, *_place(found))


def _in_perspective(points: Floats, found: ResultSet) -> Floats:
    """Project points (n, 3, q), given in the frame and unit of the fitted shapes."""
    t, focal, centre = (
        np.asarray(found.columns[name], dtype=float)
        for name in ("camera_translation", "focal", "principal_point")
    )
    camera = Camera(focal, centre, depth_sign(found.y_axis))
    return seen_in_perspective(around_centroid(points, *_place(found)) + t[:, :, None], camera)
