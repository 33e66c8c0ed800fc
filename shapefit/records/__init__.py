"""Landmarks, shapes and fits: one class each, in files, in the pipelines and in `import
shapefit`.

A row of an array is a landmark, as in files: landmarks (n, p, 2), shapes (n, p, 3). The
mathematics has landmarks in columns; `as_columns` is the one door to it.
"""

from shapefit.records.fit import Fit
from shapefit.records.frames import check_frames, order_by_frame
from shapefit.records.items import UNKNOWN_UNIT, Items, Record, concatenate
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes

__all__ = [
    "UNKNOWN_UNIT",
    "Fit",
    "Items",
    "Landmarks",
    "Record",
    "Shapes",
    "check_frames",
    "concatenate",
    "order_by_frame",
]
