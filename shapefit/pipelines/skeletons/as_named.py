"""A result as the truth names its landmarks: joints of the dictionary, or those of the files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shapefit.evaluation.metric_table import CORRELATION
from shapefit.io.extras import Extras
from shapefit.io.records import ResultSet
from shapefit.pipelines.skeletons.joints import (
    INPUT_CORRELATION,
    INPUT_NAMES,
    INPUT_SD,
    INPUT_SHAPES,
)

OF_JOINTS = ("landmarks", "confidence", "outliers", "corrupted", "shape_covariance")
"""Datasets with an axis of the joints, which the landmarks of the files have no part in."""


def as_named(results: ResultSet, names: Sequence[str]) -> ResultSet:
    """Return the result with the shapes of the landmarks that more of the names are of.

    Where a fit lifted a detector's landmarks with a dictionary of joints, its result has both.
    """
    extras = Extras.of(results.extras, len(results))
    if INPUT_NAMES not in extras or INPUT_SHAPES not in extras:
        return results
    own = tuple(map(str, extras[INPUT_NAMES]))
    if len(set(own) & set(names)) <= len(set(results.landmark_names) & set(names)):
        return results
    per_item = {name: values for name, values in extras.per_item.items() if name not in OF_JOINTS}
    per_item.pop(CORRELATION.name, None)
    if INPUT_CORRELATION in extras:
        per_item[CORRELATION.name] = extras[INPUT_CORRELATION]
    sd = extras.per_item.get(INPUT_SD)
    return replace(
        results,
        shapes=np.swapaxes(extras[INPUT_SHAPES], 1, 2),
        shape_sd=None if sd is None else np.swapaxes(sd, 1, 2),
        landmark_names=own,
        landmarks_fitted=None,
        dual=None,
        extras=Extras(per_item, extras.whole),
    )
