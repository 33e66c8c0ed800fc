"""The config of `eval`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from shapefit.config.commands.input import TruthConfig
from shapefit.config.model import HIDDEN, FromLists
from shapefit.config.paths import UNNAMED, InputPaths, NamedFiles, OutputPath
from shapefit.errors import listed
from shapefit.evaluation.metrics import METRICS

OF_LABELS = [name for name, metric in METRICS.items() if metric.of_labels]

if TYPE_CHECKING:
    AnyMetric = str
else:
    AnyMetric = Literal[tuple(METRICS)]
    """Metrics of every fit, and of the labels of outliers, which only some fits give."""


class EvalConfig(TruthConfig):
    """Compare results with the truth."""

    COMMAND = "eval"
    OUTPUT = "_report"

    results: NamedFiles
    """Result files to compare, each with the name of its row; files in a list are named after the
    file, without folder and suffix."""
    truth: InputPaths
    """Files of the true 3D shapes."""
    output: OutputPath = UNNAMED
    """Folder to write the report to; by default NAME_report in the working directory."""
    groups: Mapping[str, str] = Field(default_factory=dict)
    """Groups of sequences to average over: name -> glob on sequence names."""
    metrics: Annotated[tuple[AnyMetric, ...], FromLists] = Field(
        default=tuple(name for name, metric in METRICS.items() if not metric.of_labels),
        min_length=1,
        description=f"Errors to measure; {listed(OF_LABELS, 'and')}, of the outlier labels, only "
        "where they are named here.",
    )
    least_visible: Annotated[int, Field(ge=0), HIDDEN] = 0
    """Minimum number of visible landmarks of an image; other images are left out and counted in a
    warning."""
    truth_frame: Literal["object", "camera", "line-of-sight"] = "object"
    """Frame of the true shapes: `object`, which the dataset `true_rotation` of the result turns
    into the camera frame; `camera` (x and y as in the image); or `line-of-sight`, the camera frame
    turned to look straight at each shape that was fitted without a camera."""
    plots: bool | Literal["auto"] = "auto"
    """Also draw the errors, sorted, by method (PNG); auto: where matplotlib is installed."""
