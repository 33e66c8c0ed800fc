"""The steps of a sweep at one value: learn, project, choose the images, fit."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from shapefit.config import SweepConfig
from shapefit.config.commands.fit_sections import ExportConfig, PicturesConfig
from shapefit.config.commands.sweep import Value
from shapefit.evaluation.sweep import value_text
from shapefit.io import read_dictionary
from shapefit.pipelines.fit import run as fit
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.pipelines.project import run as project
from shapefit.pipelines.sweep.images import Choice, choose_images


@dataclass(frozen=True)
class Files:
    """What the steps before `fit` made.

    `warm_up` holds images to fit before the clock runs, so that nothing is compiled while it does.
    """

    dictionary: Path
    seen: tuple[Path, ...]
    landmarks: Path
    warm_up: Path


def prepare(
    config: SweepConfig, value: Value, before: Files | None, folder: Path, work: Path
) -> Generator[Outcome, None, Files]:
    """Learn and project for the first value, and where the value matters."""
    steps = config.steps(value)

    def place(section: str) -> Path | None:
        if config.varied_section == section:
            return folder
        return None if before else work

    dictionary = before.dictionary if before else steps.fit.dictionary
    at = place("learn_dict")
    if steps.learn_dict and at:
        dictionary = at / "dictionary.h5"
        learning = steps.learn_dict.model_copy(update={"output": dictionary})
        yield from _as_preparation(
            learn_dict.run(learning), f"{setting(config, value)}: learn-dict"
        )
    at = place("project")
    seen = before.seen if before else steps.fit.landmarks
    if steps.project and at:
        seen = (at / "all_landmarks.h5",)
        seeing = steps.project.model_copy(update={"output": seen[0]})
        yield from _as_preparation(project.run(seeing), f"{setting(config, value)}: project")
    if config.varied_section in ("project", "corrupt"):
        at = folder
    elif before:
        return replace(before, dictionary=dictionary)
    else:
        at = work
    files = Files(dictionary, seen, at / "landmarks.h5", at / "warm_up.h5")
    choose_images(
        seen,
        Choice(config.least_visible, config.offset, config.every),
        steps.corrupt if config.corrupts else None,
        read_dictionary(dictionary).landmark_names,
        files.landmarks,
        files.warm_up,
    )
    return files


def _as_preparation(outcomes: Iterable[Outcome], name: str) -> Iterator[Outcome]:
    """Pass on what went wrong in a step before `fit`; its items are not the images that count."""
    for outcome in outcomes:
        failures = named(outcome.failures, name)
        yield Outcome(failures=failures, warnings=outcome.warnings, note=name)


def fit_value(
    config: SweepConfig, value: Value, files: Files, result: Path
) -> Generator[Outcome, None, set[str]]:
    """Fit the images at one value, once all it takes is compiled; return the items that failed."""
    fitting = config.steps(value).fit.model_copy(
        update={
            "landmarks": (files.warm_up,),
            "dictionary": files.dictionary,
            "output": result,
            # each value would write over the meshes and pictures of the one before
            "export": ExportConfig(),
            "pictures": PicturesConfig(),
        }
    )
    # the few images to warm up with may all be of models that the dictionary does not have
    for _ in fit.run(fitting.model_copy(update={"leave_out": None})):
        pass
    failed: set[str] = set()
    for outcome in fit.run(fitting.model_copy(update={"landmarks": (files.landmarks,)})):
        failed |= {failure.item for failure in outcome.failures}
        yield Outcome(
            done=outcome.done,
            total=outcome.total and outcome.total * len(config.values),
            failures=named(outcome.failures, setting(config, value)),
            warnings=outcome.warnings,
            note=setting(config, value),
        )
    return failed


def value_folder(config: SweepConfig, value: Value) -> Path:
    """Return the folder of the files between, of one value."""
    number = config.values.index(value) + 1
    return config.output / "work" / f"{number}_{_file_name(value)}"


def named(failures: Iterable[Failure], name: str) -> tuple[Failure, ...]:
    """Return the failures with the name of the step, or of the value, before their items."""
    return tuple(Failure(f"{name}: {failure.item}", failure.reason) for failure in failures)


def setting(config: SweepConfig, value: Value) -> str:
    """Return `key=value`, the name of one fit in messages."""
    return f"{config.key}={value_text(value)}"


def _file_name(value: Value) -> str:
    return re.sub(r"[^\w.+-]", "_", value_text(value))
