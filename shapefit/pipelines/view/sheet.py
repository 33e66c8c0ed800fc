"""`view RESULT -o SHEET.png`: landmarks over the fitted model, and the model from another side."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.evaluation.plots import check_can_draw, save
from shapefit.geometry.pinhole import Camera, depth_sign, project
from shapefit.io import ResultSet, read_dictionary
from shapefit.io.atomic import atomic_path
from shapefit.io.listing import find_kind
from shapefit.io.records import concatenate
from shapefit.io.skeletons import edges_of
from shapefit.io.source import open_results
from shapefit.meshes.dense import around_centroid, camera_frame
from shapefit.meshes.pictures import FittedImage, Model, contact_sheet
from shapefit.pipelines.items import ChosenItems, spread
from shapefit.pipelines.meshes import has_shape
from shapefit.pipelines.outcome import Outcome

MOST_IMAGES = 24
"""Images of a sheet, spread evenly over those that are chosen."""

BATCH = 4096


def write_sheet(config: ViewConfig, output: Path) -> Outcome:
    """Draw images of one result, with the meshes or edges of the dictionary, as PNG or SVG."""
    check_can_draw("output")
    paths = [path for files in config.files.values() for path in files]
    if len(paths) != 1 or find_kind(paths[0]) != "result":
        found = "a sheet shows one result"
        raise input_error(output, found, "give one result of `fit`, or end the name in .html")
    dictionary = None if config.dictionary is None else read_dictionary(config.dictionary)
    chosen = ChosenItems("items", config.items)
    with open_results(paths, without=()) as source:
        items = [item for batch in source.batches(BATCH) for item in batch.items if item in chosen]
        if not items:
            raise input_error("items", "no image is chosen", "leave `items` out")
        wanted = {items[place] for place in spread(MOST_IMAGES, len(items))}
        images = concatenate(
            [
                batch.take([row for row, item in enumerate(batch.items) if item in wanted])
                for batch in source.batches(BATCH)
            ]
        )
    edges = images.lines if images.lines is not None else edges_of(images.landmark_names)
    faces = None
    if dictionary is not None:
        faces = dictionary.mesh_faces if images.coefficients is not None else None
        edges = edges if dictionary.edges is None else dictionary.edges
    model = Model(images.y_axis, faces, np.asarray(edges, np.int64).reshape(-1, 2))
    drawn = [fitted_image(images.take([row]), dictionary) for row in range(len(images))]
    figure = contact_sheet(drawn, model)
    with atomic_path(output) as temporary:
        partial(save, figure, file_format=output.suffix.lower()[1:])(temporary)
    return Outcome(done=len(drawn), total=len(drawn), warnings=chosen.warnings, written=(output,))


def fitted_image(image: ResultSet, dictionary: Dictionary | None) -> FittedImage:
    """Gather one image (n = 1) of a result; the shape is all nan where the fit failed."""
    columns = image.columns
    outliers = columns["outliers"][0] == 1 if "outliers" in columns else None
    landmarks = np.asarray(columns["landmarks"][0], dtype=float).T
    (title,) = image.items
    if not has_shape(image)[0]:
        nowhere = np.full_like(image.shapes[0], np.nan)
        return FittedImage(title, landmarks, nowhere, nowhere[:2], outliers=outliers)
    mesh = None
    if dictionary is not None and dictionary.mesh_vertices is not None:
        c, R = image.coefficients, image.rotation
        if c is not None and R is not None and image.scale is not None:
            T = np.asarray(image.translation)
            mesh = camera_frame(dictionary.mesh_vertices, c, R, image.scale, T)
    return FittedImage(
        title=title,
        landmarks=landmarks,
        shape=image.shapes[0],
        seen=as_seen(image, image.shapes),
        mesh=None if mesh is None else mesh[0],
        seen_mesh=None if mesh is None else as_seen(image, mesh),
        outliers=outliers,
        sd=None if image.shape_sd is None else image.shape_sd[0],
        rotation=None if image.rotation is None else image.rotation[0],
    )


def as_seen(image: ResultSet, points: Floats) -> Floats:
    """Return where (2, q) the camera sees points (1, 3, q) of the frame and unit of the shapes."""
    columns = image.columns
    if "camera_translation" not in columns:
        return points[0, :2]
    t, focal, centre = (
        np.asarray(columns[name], dtype=float)
        for name in ("camera_translation", "focal", "principal_point")
    )
    assert image.scale is not None
    normalised = around_centroid(points, image.scale, np.asarray(image.translation))
    camera = Camera(focal, centre, depth_sign(image.y_axis))
    return np.asarray(project(camera, normalised + t[:, :, None])[0])
