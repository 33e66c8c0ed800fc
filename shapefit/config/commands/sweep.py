"""The config of `sweep`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from pydantic import Field, ValidationInfo, field_validator

from shapefit.config.commands.evaluate import ErrorMetric
from shapefit.config.commands.fit import FitConfig
from shapefit.config.commands.learn_dict import LearnDictConfig
from shapefit.config.commands.project import ProjectConfig
from shapefit.config.loader import ConfigFile, read_settings
from shapefit.config.model import (
    CommandConfig,
    ConfigModel,
    FromLists,
    Plots,
    marked_keys,
    plain,
    section,
)
from shapefit.config.named_files import DictionaryPath
from shapefit.config.paths import (
    OF_THE_DATA,
    STANDARD_STREAM,
    Expected,
    InputPaths,
    OutputPath,
    PathWords,
    absolute_path,
)
from shapefit.config.settings import Settings, check
from shapefit.errors import InputError

Value = str | bool | int | float


class CorruptionConfig(ConfigModel):
    """Visible landmarks replaced by points drawn at random, to see which are found."""

    share: float = Field(default=0.0, ge=0, le=1)
    """Share of the visible landmarks of each image to replace by points drawn uniformly from the
    bounding box of these landmarks, grown on each side by a tenth of its size."""
    seed: int = Field(default=0, ge=0)
    """Seed of the choice and of the points."""


class LearnDictSection(LearnDictConfig):
    """Settings of `learn-dict` in a sweep."""

    output: OutputPath = STANDARD_STREAM
    """Dictionary file; the sweep chooses it."""


class ProjectSection(ProjectConfig):
    """Settings of `project` in a sweep."""

    output: OutputPath = STANDARD_STREAM
    """Landmark file; the sweep chooses it."""


class FitSection(FitConfig):
    """Settings of `fit` in a sweep; `-` is what the step before made."""

    landmarks: InputPaths = (STANDARD_STREAM,)
    """Files of 2D landmarks, where none are projected."""
    dictionary: DictionaryPath = STANDARD_STREAM
    """Dictionary file, where none is learned."""
    output: OutputPath = STANDARD_STREAM
    """Result file; the sweep chooses it."""


COMMANDS: dict[str, type[ConfigModel]] = {
    "learn_dict": LearnDictSection,
    "project": ProjectSection,
    "fit": FitSection,
}
SECTIONS: Mapping[str, type[ConfigModel]] = COMMANDS | {"corrupt": CorruptionConfig}

Section = TypeVar("Section", LearnDictSection, ProjectSection, CorruptionConfig, FitSection)


class Steps(NamedTuple):
    """The settings of each step for one value of the key that varies."""

    learn_dict: LearnDictSection | None
    project: ProjectSection | None
    corrupt: CorruptionConfig
    fit: FitSection


def _words(command: str) -> PathWords:
    return PathWords(f"a mapping with keys of `{command}`, or the path of its YAML")


class SweepConfig(CommandConfig):
    """Run the chain for each value of one key, and draw the error against it."""

    learn_dict: Annotated[LearnDictSection | None, _words("learn-dict")] = None
    """How to learn the dictionary; by default, the one that `fit` names."""
    project: Annotated[ProjectSection | None, _words("project")] = None
    """How to view the shapes; by default, `fit` names the landmarks."""
    corrupt: CorruptionConfig = section(CorruptionConfig)
    fit: Annotated[FitSection, _words("fit")]
    """How to lift; files that the sweep makes can be omitted and are ignored. Meshes and pictures
    are not written."""
    truth: InputPaths
    """Files of the true 3D shapes."""
    match: Annotated[str, OF_THE_DATA] = Field(default="item", min_length=1)
    """What identifies the true shape of an image: `item`, or the name of a dataset of the landmarks
    that holds items of the truth."""
    groups: Annotated[Mapping[str, str], OF_THE_DATA] = Field(default_factory=dict)
    """Groups of sequences to average over: name -> glob on sequence names."""
    metrics: Annotated[tuple[ErrorMetric, ...], FromLists, Field(min_length=1)] = ("similarity",)
    """Errors to measure, as in `eval`, each in its first unit; precision and recall are added where
    landmarks are corrupted and the fit labels outliers."""
    vary: Annotated[
        Mapping[str, Annotated[tuple[Value, ...], FromLists]],
        Expected("a mapping of one key to a list of values"),
    ]
    """The key that varies, such as {fit.lambda: [0.05, 0.1]}."""
    least_visible: int = Field(default=0, ge=0)
    """Minimum number of visible landmarks for an image to be fitted."""
    every: int = Field(default=1, ge=1)
    """Fit every n-th image of those with enough landmarks."""
    offset: int = Field(default=0, ge=0)
    """Images to skip before the first that is fitted: with `every: 2`, offsets 0 and 1 are the two
    halves of the images."""
    output: OutputPath
    """Folder to write the report and intermediate files to."""
    plots: Plots = "auto"
    """Also draw the errors (PNG and SVG); auto: where matplotlib is installed."""
    view: bool = True
    """Also draw the worst, median and best images in report.html, and write view.html of them, at
    the value with the lowest mean error."""

    @cached_property
    def key(self) -> str:
        """Return the key that varies, such as `fit.lambda`."""
        return next(iter(self.vary))

    @cached_property
    def varied_section(self) -> str:
        """Return the section of the key that varies."""
        return self.key.partition(".")[0]

    @cached_property
    def values(self) -> tuple[Value, ...]:
        """Return the values of the key that varies."""
        return self.vary[self.key]

    @cached_property
    def corrupts(self) -> bool:
        """Whether landmarks are made wrong, for some values at least."""
        return self.corrupt.share > 0 or self.varied_section == "corrupt"

    def steps(self, value: Value) -> Steps:
        """Return the settings of each step where the key that varies has this value."""
        steps = Steps(self.learn_dict, self.project, self.corrupt, self.fit)
        name, _, key = self.key.partition(".")
        return steps._replace(**{name: _changed(getattr(self, name), name, key, value)})

    @field_validator(*COMMANDS, mode="before")
    @classmethod
    def _read_file(cls, value: Any, info: ValidationInfo) -> Any:
        """Take the settings from a file where a section is a path."""
        if not isinstance(value, str | Path):
            return value
        name, data = str(info.field_name), info.data.get("data")
        made = {"output": "-", "data": str(data) if data else None}
        if name == "fit":
            made["landmarks"] = "-" if info.data.get("project") else None
            made["dictionary"] = "-" if info.data.get("learn_dict") else None
        try:
            file, model = ConfigFile(absolute_path(value)), COMMANDS[name]
            return check(model, read_settings(model, file, (), made))
        except InputError as error:
            raise ValueError("; ".join(error.problems)) from None

    @field_validator("fit")
    @classmethod
    def _has_files(cls, fit: FitSection, info: ValidationInfo) -> FitSection:
        for key, path, maker in (
            ("landmarks", fit.landmarks[0], "project"),
            ("dictionary", fit.dictionary, "learn_dict"),
        ):
            if path == STANDARD_STREAM and info.data.get(maker, "wrong") is None:
                raise ValueError(f"missing key {key!r}; name a file, or give `{maker}`")
        return fit

    @field_validator("vary")
    @classmethod
    def _can_vary(
        cls, vary: Mapping[str, tuple[Value, ...]], info: ValidationInfo
    ) -> Mapping[str, tuple[Value, ...]]:
        if len(vary) != 1:
            raise ValueError(f"expected one key with its values, found {len(vary)} keys")
        ((path, values),) = vary.items()
        name, dot, key = path.partition(".")
        if name not in SECTIONS or not dot:
            raise ValueError(
                f"expected a key of {', '.join(SECTIONS)}, such as fit.lambda, found {path!r}"
            )
        if name == "fit" and key.partition(".")[0] in ("export", "pictures"):
            raise ValueError(
                f"a sweep writes no meshes and pictures, so that {path} changes nothing"
            )
        if key.partition(".")[0] in marked_keys(SECTIONS[name], PathWords):
            raise ValueError(f"{path} is a path; only settings can vary")
        if not values or len(set(values)) < len(values):
            raise ValueError(f"expected different values of {path}, found {list(values)}")
        if name in info.data:
            _check_values(info.data[name], name, key, values)
        return vary


def _check_values(section: Section | None, name: str, key: str, values: tuple[Value, ...]) -> None:
    """Raise ValueError for values that the section does not accept."""
    if section is None:
        raise ValueError(f"`{name}` is not given, so that {name}.{key} cannot vary")
    problems = []
    for value in values:
        try:
            _changed(section, name, key, value)
        except InputError as error:
            problems += [_of_value(name, key, value, line) for line in error.problems]
    if problems:
        raise ValueError("; ".join(problems))


def _of_value(name: str, key: str, value: Value, line: str) -> str:
    """Say of a problem that it arises at this value: its own, or that of another key."""
    own = f"--set {key}="
    if line.startswith(own):
        return f"{name}.{key}={line.removeprefix(own)}"
    return f"with {name}.{key}={_as_yaml(value)}, {line}"


def _changed(section: Section, name: str, key: str, value: Value) -> Section:
    """Return the section with another value of a key; raises InputError if it does not fit."""
    model = type(section)
    settings = Settings(marked_keys(model, PathWords))
    settings.take_section(name, plain(section.model_dump(), str))
    settings.set_option(f"{key}={_as_yaml(value)}")
    return check(model, settings)


def _as_yaml(value: Value) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return f".{value}"
    return json.dumps(value)
