"""Landmarks: images of points that a detector, or a person, has marked."""

# No `from __future__ import annotations` here: `columns_of` reads what stands beside
# the fields.

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, ClassVar

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.records.columns import LENGTH
from shapefit.records.items import Direction, Items


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Landmarks(Items):
    """n images of p landmarks.

    `extras` and `file_extras` hold what else is known of them, such as `true_rotation`
    (n, 3, 3), or `camera_matrix` (3, 3) of the file.
    """

    POINTS: ClassVar[str] = "landmarks"

    landmarks: Annotated[Floats, "n p 2", LENGTH]
    """Positions, NaN where unseen."""
    _: KW_ONLY
    confidence: Annotated[Floats | None, "n p"] = None
    """Weights >= 0, 0 = hidden; without them all count the same."""
    y_axis: Direction = "down"
    """Where y points."""

    def weights(self) -> Floats:
        """Return the weights (n, p): the confidence, else 1; 0 where unseen."""
        has_x, has_y = np.isfinite(self.landmarks).transpose(2, 0, 1)
        confidence = 1.0 if self.confidence is None else self.confidence
        return np.where(has_x & has_y, confidence, 0.0)

    def visible(self) -> Flags:
        """Return which landmarks (n, p) have a position and a confidence above 0."""
        return self.weights() > 0
