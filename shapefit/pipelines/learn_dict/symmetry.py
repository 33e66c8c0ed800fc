"""The left and the right of training shapes: symmetric models, or a model and its mirror image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.geometry.symmetry import double, lateral_axis, symmetrise
from shapefit.io import ShapeSet, match_landmarks
from shapefit.io.extras import Extras

if TYPE_CHECKING:
    from shapefit.pipelines.learn_dict.training_shapes import TrainingOptions


def apply_symmetry(shapes: ShapeSet, options: TrainingOptions) -> ShapeSet:
    """Return the shapes, or their symmetric ones, or the shapes and then their mirror images.

    A mirror image has the item and sequence of its shape. The shapes come without meshes unless
    `symmetry` is none: `mirror_index` pairs landmarks, and a mesh whose vertices have no partners
    can be mirrored as a surface only, not vertex by vertex as mixing meshes needs. Raises
    InputError where the shapes have no `mirror_index`, or one that does not pair the landmarks.
    """
    if options.symmetry == "none":
        return shapes
    index = find_partners(shapes, options)
    lateral = lateral_axis(shapes.shapes, index)
    bare = replace(shapes, mesh_vertices=None, mesh_faces=None)
    if options.symmetry == "symmetrise":
        return replace(bare, shapes=symmetrise(shapes.shapes, index, lateral))
    twice = bare.take(np.tile(np.arange(len(shapes)), 2))
    return replace(twice, shapes=double(shapes.shapes, index, lateral))


def find_partners(shapes: ShapeSet, options: TrainingOptions) -> NDArray[Any]:
    """Return the partner of each landmark. Raises InputError as `apply_symmetry` does."""
    if options.mirror is not None:
        return read_mirror(shapes.landmark_names, options.mirror)
    place = options.place
    fix = "give `mirror`, store the index of each landmark's mirror image, or set `symmetry: none`"
    index = Extras.of(shapes.extras, len(shapes)).whole.get("mirror_index")
    if index is None:
        raise input_error(place, "has no dataset `mirror_index`", fix)
    points = np.arange(len(shapes.landmark_names))
    pairs = index.shape == points.shape and index.dtype.kind in "iu"
    pairs = pairs and bool(((index >= 0) & (index < len(points))).all())
    if not pairs or (index[index] != points).any() or (index == points).all():
        raise input_error(f"{place}:/mirror_index", "does not pair the landmarks", fix)
    return index


def read_mirror(names: tuple[str, ...], mirror: Mapping[str, str]) -> NDArray[Any]:
    """Return the partner of each landmark. Raises InputError for names that are no pairs."""
    index = np.arange(len(names))
    fix = "name each landmark of a pair once"
    for pair in mirror.items():
        match_landmarks(names, pair, place="mirror")
        first, second = (names.index(name) for name in pair)
        if first == second or index[first] != first or index[second] != second:
            raise input_error("mirror", f"pairs {pair[0]} and {pair[1]}", fix)
        index[first], index[second] = second, first
    return index
