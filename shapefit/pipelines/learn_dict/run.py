"""`learn-dict`: 3D shapes, or 2D landmarks, to a dictionary file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from shapefit.config import LearnDictConfig
from shapefit.config.commands.learn_dict import PriorConfig
from shapefit.errors import input_error
from shapefit.io import (
    ShapeSource,
    check_output,
    digests,
    open_landmarks,
    open_shapes,
    write_dictionary,
)
from shapefit.io.formats import check_target_format
from shapefit.io.inputs import check_fits, is_stream
from shapefit.io.layout import DICTIONARY
from shapefit.io.listing import find_kind
from shapefit.io.options import input_options
from shapefit.pipelines.learn_dict.from_2d import learn_from_landmarks
from shapefit.pipelines.learn_dict.from_3d import learn_from_shapes, with_p_value_table
from shapefit.pipelines.learn_dict.training_shapes import place_of
from shapefit.pipelines.outcome import Outcome


def run(config: LearnDictConfig) -> Iterator[Outcome]:
    """Learn the dictionary and write it; one outcome per round, sequence or set of exemplars.

    The first outcome lists the shapes that cannot be used. Raises InputError for files that cannot
    be read or written, keys that have no effect, and as the ways of learning do.
    """
    check_output(config.output)
    check_target_format(config.output, DICTIONARY.kind)
    landmarks = holds_landmarks(config)
    check_keys(config, landmarks=landmarks)
    options = replace(input_options(config), landmarks=config.landmarks)
    if landmarks:
        with open_landmarks(config.shapes, options) as images:
            notes = images.notes
            learning = learn_from_landmarks(images, config)
            latest = next(learning)
    else:
        with open_shapes(config.shapes, options) as source:
            notes = source.notes
            check_memory(source, config)
            shapes = source.whole()
        learning = learn_from_shapes(shapes, config, digests(config.shapes))
        latest = next(learning)
    latest = replace(latest, warnings=notes + latest.warnings)
    while True:
        try:
            following = next(learning)
        except StopIteration as stop:
            dictionary = stop.value
            break
        yield latest
        latest = following
    dictionary = with_p_value_table(dictionary)
    write_dictionary(config.output, dictionary)
    yield replace(latest, written=(config.output,))


def holds_landmarks(config: LearnDictConfig) -> bool:
    """Whether the files hold 2D landmarks, so that shapes are learned from them as well."""
    options = input_options(config)
    files = (path for path in config.shapes if not is_stream(path))
    return {find_kind(path, options) for path in files} == {"landmarks"}


def check_keys(config: LearnDictConfig, *, landmarks: bool) -> None:
    """Raise InputError for keys that have no effect on files of 2D landmarks, or of 3D shapes."""
    idle = {}
    if not landmarks and config.flip:
        idle["flip"] = "only for 2D landmarks: the files hold 3D shapes"
    if not landmarks and not config.prior.components and config.prior != PriorConfig():
        key = f"prior.{min(config.prior.model_fields_set)}"
        idle[key] = "only with `prior: {components: ...}`"
    for key, condition in idle.items():
        raise input_error(key, f"`{key}` has no effect here, {condition}", "leave it out")


def check_memory(source: ShapeSource, config: LearnDictConfig) -> None:
    """Raise InputError where sparse coding of the shapes, as measured, takes more than is free."""
    if config.method != "sparse-coding":
        return
    p, every = len(source.head.landmark_names), config.every
    step = every if isinstance(every, int) else max(every.values())
    copies = 2 if config.mirror else 1
    size = 8 * source.count * (6 * p + copies * (9 * p + 4 * config.k) // step)
    check_fits(place_of(config), size, "learning from so many shapes", "take fewer with `every`")
