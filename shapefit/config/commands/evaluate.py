"""The config of `eval`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, field_validator

from shapefit.config.model import HIDDEN, CommandConfig, FromLists
from shapefit.config.paths import UNNAMED, Description, InputPaths, NamedFiles, OutputPath
from shapefit.errors import listed
from shapefit.evaluation.metric_table import METRICS, of_fits, of_labels

if TYPE_CHECKING:
    AnyMetric = str
else:
    AnyMetric = Literal[tuple(METRICS)]
    """Metrics of every fit, and of the labels of outliers, which only some fits give."""


class EvalConfig(CommandConfig):
    """Compare results with the truth."""

    COMMAND = "eval"
    OUTPUT = "_report"

    results: NamedFiles
    """Result files to compare, each with the name of its row; files in a list are named after the
    file, without folder and suffix."""
    truth: InputPaths
    """Files of the true 3D shapes."""
    rename: Mapping[str, str] = Field(default_factory=dict)
    """Landmarks of the truth to rename: name in its files -> name in the results."""
    output: OutputPath = UNNAMED
    """Folder to write the report to; by default NAME_report in the working directory."""
    match: str = Field(default="item", min_length=1)
    """What identifies the true shape of an image: `item`; `frame`, its frame and sequence; or the
    name of a dataset of the result that holds items of the truth."""
    groups: Mapping[str, str] = Field(default_factory=dict)
    """Groups of sequences to average over: name -> glob on sequence names."""
    metrics: Annotated[tuple[AnyMetric, ...], FromLists] = Field(
        default=of_fits(),
        description=f"Errors to measure; {listed(of_labels(), 'and')}, of the outlier labels, only "
        "where they are named here.",
    )
    least_visible: Annotated[int, Field(ge=0), HIDDEN] = 0
    """Minimum number of observed landmarks for an image to be evaluated; other images are left out
    and counted in a warning."""
    truth_frame: Literal["object", "camera", "line-of-sight"] = "object"
    """Frame of the true shapes: `object`, which the dataset `true_rotation` of the result turns
    into that of the camera; `camera` (x and y as in the image); or `line-of-sight`: that of the
    camera, which is turned to look straight at each shape that was fitted without a camera."""
    plots: Annotated[bool | Literal["auto"], Description("true, false or auto")] = "auto"
    """Also draw the errors, sorted, by method (PNG); auto: where matplotlib is installed."""

    @field_validator("metrics")
    @classmethod
    def _at_least_one(cls, metrics: tuple[AnyMetric, ...]) -> tuple[AnyMetric, ...]:
        if not metrics:
            raise ValueError("expected at least one metric, found an empty list")
        return metrics
