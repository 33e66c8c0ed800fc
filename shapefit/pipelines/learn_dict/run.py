"""`learn-dict`: 3D shapes, or 2D landmarks, to a dictionary file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from shapefit.config import LearnDictConfig
from shapefit.io import (
    check_output,
    digests,
    open_landmarks,
    open_shapes,
    write_dictionary,
)
from shapefit.io.formats import check_target_format
from shapefit.io.inputs import is_stream
from shapefit.io.layout import DICTIONARY
from shapefit.io.options import input_options
from shapefit.io.source import find_kind
from shapefit.pipelines.learn_dict.from_2d import learn_from_landmarks
from shapefit.pipelines.learn_dict.from_3d import learn_from_shapes
from shapefit.pipelines.result import Result


def learn_dictionary(config: LearnDictConfig) -> Iterator[Result]:
    """Learn the dictionary and write it; one result per round.

    Files of 2D landmarks alone are learned from as such. Raises InputError for files
    that cannot be read or written, and as the ways of learning do.
    """
    check_output(config.output)
    check_target_format(config.output, DICTIONARY.kind)
    options = replace(input_options(config), landmarks=config.landmarks)
    files = (path for path in config.shapes if not is_stream(path))
    if {find_kind(path, options) for path in files} == {"landmarks"}:
        with open_landmarks(config.shapes, options) as images:
            notes = images.notes
            dictionary = yield from learn_from_landmarks(images, config)
    else:
        with open_shapes(config.shapes, options) as source:
            notes = source.notes
            shapes = source.whole()
        inputs = digests(config.shapes)
        dictionary = yield from learn_from_shapes(shapes, config, inputs)
    # its import would delay the first result
    from shapefit.lifting.posterior.p_value import with_p_value_table

    write_dictionary(config.output, with_p_value_table(dictionary))
    yield Result(warnings=notes, written=(config.output,))
