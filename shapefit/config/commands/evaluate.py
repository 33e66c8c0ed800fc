"""The config of `eval`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from shapefit.config.commands.input import InputConfig
from shapefit.config.model import (
    AS_A_WHOLE,
    CommandConfig,
    ConfigModel,
    FromLists,
    Plots,
    section,
)
from shapefit.config.named_files import DictionaryPath, NamedFiles
from shapefit.config.paths import OF_THE_DATA, Expected, InputPaths, OutputPath
from shapefit.errors import listed
from shapefit.evaluation.metric_table import METRICS, of_fits, of_labels

if TYPE_CHECKING:
    ErrorMetric = str
    AnyMetric = str
else:
    ErrorMetric = Literal[of_fits()]
    """Metrics of every fit."""
    AnyMetric = Literal[tuple(METRICS)]
    """Those too that judge the labels of outliers, which only some fits give."""

MEAN_SHAPE = "Mean shape (oracle)"
NEAREST_ATOM = "Nearest atom (oracle)"
BEST_COMBINATION = "Best combination (oracle)"
"""Rows of the report that `floors` asks for."""

MOST_EXAMPLES = 20
"""Rows of a picture that a person still looks at."""


class FloorsConfig(ConfigModel):
    """What a dictionary can reach at all: similarity errors of the truth, without any fit."""

    dictionary: DictionaryPath
    """Dictionary whose mean shape, nearest atom and best non-negative combination get their own
    rows, each aligned with the truth as well as possible; without `floors` there are no such
    rows."""
    leave_out: Annotated[str | None, OF_THE_DATA] = Field(default=None, min_length=1)
    """Dataset of the result that names, for each image, the training shape whose atoms are ignored
    (dictionaries of exemplars), like `leave_out` of fit."""


class EvalConfig(CommandConfig):
    """Compare results with the truth."""

    COMMAND = "eval"

    results: NamedFiles
    """Result files to compare, each with the name of its row; files in a list are named after the
    file, without folder and suffix."""
    truth: InputPaths
    """Files of the true 3D shapes."""
    input: InputConfig = section(InputConfig)
    output: OutputPath
    """Folder to write the report to."""
    match: Annotated[str, OF_THE_DATA] = Field(default="item", min_length=1)
    """What identifies the true shape of an image: `item`, or the name of a dataset of the result
    that holds items of the truth."""
    groups: Annotated[Mapping[str, str], OF_THE_DATA] = Field(default_factory=dict)
    """Groups of sequences to average over: name -> glob on sequence names."""
    metrics: Annotated[tuple[AnyMetric, ...], FromLists] = Field(
        default=of_fits(),
        description=f"Errors to measure; {listed(of_labels(), 'and')}, of the outlier labels, only "
        "where they are named here.",
    )
    least_visible: int = Field(default=0, ge=0)
    """Minimum number of observed landmarks for an image to be evaluated; other images are left out
    and counted in a warning."""
    truth_frame: Annotated[Literal["object", "camera", "line-of-sight"], OF_THE_DATA] = "object"
    """Frame of the true shapes: `object`, which the dataset `true_rotation` of the result turns
    into that of the camera; `camera` (x and y as in the image); or `line-of-sight`: that of the
    camera, which is then turned to look straight at each shape, as weak perspective has it."""
    calibration: bool = True
    """Also judge error bars and plausibilities, where results have them: the share of the truth
    inside, and the error without the least plausible images."""
    floors: FloorsConfig | None = None
    """Smallest similarity errors that the dictionary allows."""
    plots: Plots = "auto"
    """Also draw the errors, and the examples (PNG and SVG); auto: where matplotlib is installed."""
    examples: Annotated[
        Annotated[int, Field(ge=0, le=MOST_EXAMPLES)] | tuple[str, ...],
        Expected(f"a whole number from 0 to {MOST_EXAMPLES} or a list of item names or globs"),
        FromLists,
        AS_A_WHOLE,
    ] = 0
    """Images to draw (landmarks, truth and every method in a novel view): a number, spread evenly
    over the images of all methods, or a list of items."""

    view: bool = True
    """Also write view.html, which shows the results and the truth, and draw the worst, median and
    best images in report.html."""

    @field_validator("metrics")
    @classmethod
    def _at_least_one(cls, metrics: tuple[AnyMetric, ...]) -> tuple[AnyMetric, ...]:
        if not metrics:
            raise ValueError("expected at least one metric, found an empty list")
        return metrics

    @field_validator("floors")
    @classmethod
    def _names_are_free(
        cls, floors: FloorsConfig | None, info: ValidationInfo
    ) -> FloorsConfig | None:
        taken = {MEAN_SHAPE, NEAREST_ATOM, BEST_COMBINATION} & info.data.get("results", {}).keys()
        if floors and taken:
            raise ValueError(f"{min(taken)!r} is the name of a row here; rename it in `results`")
        return floors
