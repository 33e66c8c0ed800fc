"""How `fit` lays out what the search over all rotations found: readings, and trees of proofs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shapefit.errors import counted
from shapefit.io import ResultSet
from shapefit.lifting.estimate import fit_translation
from shapefit.lifting.lift import Lifting


def with_readings(record: ResultSet, lifting: Lifting) -> ResultSet:
    """Add the readings of each image, in the camera frame and the unit of its landmarks."""
    readings = lifting.estimate.readings
    if readings is None:
        return record
    fitted = np.isfinite(lifting.scale)
    count = np.array([len(one) for one in readings], dtype=np.int64) * fitted
    image = np.repeat(np.arange(len(count)), count)
    kept = [one for one, is_fitted in zip(readings, fitted, strict=True) if is_fitted]
    none = record.shapes[:0]
    shapes = np.concatenate([none, *(one.shapes for one in kept)])
    part = lifting.problem.take(image)
    T = fit_translation(part, shapes[:, :2]).translation
    scale = lifting.scale[:, None]
    centroid = lifting.translation - scale * lifting.estimate.translation
    shapes = scale[image, None] * shapes
    shapes[:, :2] += (scale[image] * T + centroid[image])[:, :, None]
    return replace(
        record,
        modes=count,
        mode_objective=np.concatenate([np.zeros(0), *(one.objective for one in kept)]),
        mode_rotation=np.concatenate([np.zeros((0, 3, 3)), *(one.rotation for one in kept)]),
        mode_shapes=shapes,
    )


def with_trees(record: ResultSet, lifting: Lifting) -> ResultSet:
    """Add the trees that were kept; images without a shape have none."""
    trees = lifting.estimate.trees
    if trees is None:
        return record
    fitted = np.isfinite(lifting.scale)
    kept = [tree if is_fitted else None for tree, is_fitted in zip(trees, fitted, strict=True)]
    some = [tree for tree in kept if tree is not None]
    p = record.shapes.shape[2]
    return replace(
        record,
        tree_cells=np.array([0 if tree is None else len(tree.splits) for tree in kept]),
        tree_splits=np.concatenate([np.zeros(0, int), *(tree.splits for tree in some)]),
        tree_vertices=np.array([0 if tree is None else len(tree.vertices) for tree in kept]),
        tree_rotations=np.concatenate([np.zeros((0, 4)), *(tree.vertices for tree in some)]),
        tree_multipliers=np.concatenate(
            [np.zeros((0, 2, p)), *(tree.multipliers for tree in some)]
        ),
    )


class Ambiguous:
    """Counts the images of a run with more than one reading, and those whose list may lack some."""

    def __init__(self, within: float) -> None:
        self._within = within
        self._images = self._several = self._unsure = 0

    def add(self, lifting: Lifting) -> None:
        """Take the images of a chunk."""
        readings = lifting.estimate.readings or ()
        self._images += sum(len(one) > 0 for one in readings)
        self._several += sum(len(one) > 1 for one in readings)
        self._unsure += sum(not one.complete and len(one) > 0 for one in readings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the report says of them, with their share."""
        found = []
        if self._several:
            share = self._several / self._images
            found.append(
                f"{counted(self._several, 'image')} ({share:.1%}) can be read in more than one "
                f"way: another rotation comes within {self._within:.0%} of the optimum; see "
                "`modes` in the result"
            )
        if self._unsure:
            found.append(
                f"{counted(self._unsure, 'image')} may have further readings: raise "
                "`search.max_cells` or `search.max_seconds`"
            )
        return tuple(found)
