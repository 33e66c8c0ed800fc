"""What `measure` finds in results of which a test has changed a column."""

from pathlib import Path

from shapefit.config import EvalConfig
from shapefit.pipelines.evaluate.measure import measure
from tests.columns import put

FILE = Path("/results/convex.h5")
METRICS = ("similarity", "camera", "rotation", "reprojection")
SHAPES = ["similarity"]


def measured(results, truth, match="item", metrics=METRICS, **keys):
    config = EvalConfig.model_construct(match=match, metrics=metrics, **keys)
    return measure(FILE, results, truth, config)


def changed(results, name, row, value):
    """Return the results with one row of a column changed."""
    values = results.column(name).copy()
    values[row] = value
    return put(results, {name: values})
