"""The table of metrics: what each takes, its unit, its title in plots, and its function.

It is light: the functions are imported where they are used. Config, evaluation and plots ask it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, NamedTuple

LENGTH = "length"
"""A metric in the unit of the truth; it is given normalised by the true shape, too."""

IMAGE = "image"
"""A metric in the unit of the landmarks; it is given as a share of the object's box, too."""

SHARE = "share"
"""The unit of a share of landmarks."""


class Dataset(NamedTuple):
    """A dataset that a metric takes: its name, and its shape within one image in the file.

    `p` in the shape stands for the number of landmarks. `points` come one landmark per row in the
    file and one a column to the metric; `labels` are booleans.
    """

    name: str
    shape: tuple[int | Literal["p"], ...] = ()
    points: bool = False
    labels: bool = False


ESTIMATE = Dataset("estimate", ("p", 3), points=True)
TRUTH = Dataset("truth", ("p", 3), points=True)
"""The shapes that are compared, with the landmarks of both: every evaluation has them."""

LANDMARKS = Dataset("landmarks", ("p", 2), points=True)
FITTED = Dataset("landmarks_fitted", ("p", 2), points=True)
ROTATION = Dataset("rotation", (3, 3))
TRUE_ROTATION = Dataset("true_rotation", (3, 3))
BOX = Dataset("bounding_box", (4,))
DEVIATION = Dataset("shape_sd", ("p", 3), points=True)
CORRELATION = Dataset("shape_correlation", ("p", 3), points=True)
EXPECTED = Dataset("expected_error")
"""Error bars, and the error of the image after a similarity, where the method knows them."""

OUTLIERS = Dataset("outliers", ("p",), labels=True)
CORRUPTED = Dataset("corrupted", ("p",), labels=True)


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A number for each image: how far its estimate is from what is true.

    function   "module:function"; takes the arrays of `needs` in their order, returns (n,), nan
               where an image cannot be judged
    needs      what it takes: ESTIMATE, TRUTH, and datasets of the result file
    unit       LENGTH, IMAGE, or the name of the unit, such as deg
    title      what a plot of it is called
    of_labels  judges labels of landmarks, which only some fits give: it must be asked for by name,
               and nan is no failure
    optional   results without its datasets are not worth a warning, and nan is no failure
    """

    function: str
    needs: tuple[Dataset, ...]
    unit: str
    title: str
    of_labels: bool = False
    optional: bool = False

    @property
    def datasets(self) -> tuple[Dataset, ...]:
        """The datasets of the result file that it cannot do without."""
        return tuple(dataset for dataset in self.needs if dataset not in (ESTIMATE, TRUTH))

    def load(self) -> Callable[..., Any]:
        """Import its function and return it."""
        module, _, name = self.function.partition(":")
        function: Callable[..., Any] = getattr(import_module(module), name)
        return function


METRICS: dict[str, Metric] = {
    "similarity": Metric(
        function="shapefit.evaluation.metrics:similarity",
        needs=(ESTIMATE, TRUTH),
        unit=LENGTH,
        title="3D error up to a similarity",
    ),
    "camera": Metric(
        function="shapefit.evaluation.metrics:camera",
        needs=(ESTIMATE, TRUTH, TRUE_ROTATION),
        unit=LENGTH,
        title="3D error in the camera frame",
    ),
    "rotation": Metric(
        function="shapefit.geometry.rotations:rotation_angle",
        needs=(TRUE_ROTATION, ROTATION),
        unit="deg",
        title="Angle to the true rotation",
    ),
    "reprojection": Metric(
        function="shapefit.evaluation.metrics:reprojection",
        needs=(FITTED, LANDMARKS),
        unit=IMAGE,
        title="RMS reprojection error",
    ),
    "expected": Metric(
        function="shapefit.evaluation.metrics:expected",
        needs=(ESTIMATE, TRUTH, EXPECTED),
        unit=LENGTH,
        title="Expected 3D error up to a similarity",
        optional=True,
    ),
    "precision": Metric(
        function="shapefit.evaluation.metrics:precision",
        needs=(OUTLIERS, CORRUPTED),
        unit=SHARE,
        title="Precision of the outlier labels",
        of_labels=True,
    ),
    "recall": Metric(
        function="shapefit.evaluation.metrics:recall",
        needs=(OUTLIERS, CORRUPTED),
        unit=SHARE,
        title="Recall of the outlier labels",
        of_labels=True,
    ),
}


def of_fits() -> tuple[str, ...]:
    """Return the metrics of every fit."""
    return tuple(name for name, metric in METRICS.items() if not metric.of_labels)


def of_labels() -> tuple[str, ...]:
    """Return the metrics of the labels of outliers, which only some fits give."""
    return tuple(name for name, metric in METRICS.items() if metric.of_labels)
