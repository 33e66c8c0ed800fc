"""The config of a fit that names none: that which suits the dictionary and the images."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import median
from shapefit.config import FitConfig, find_config, load_config
from shapefit.config.loader import find_presets
from shapefit.config.paths import STANDARD_STREAM
from shapefit.dictionary.model import SUITS
from shapefit.errors import InputError
from shapefit.io import open_landmarks
from shapefit.io.dictionaries import has_prior, read_provenance
from shapefit.io.options import input_options
from shapefit.lifting.methods import find_conflict

ENOUGH = 10
"""Frames of a sequence whose motion says something of its shapes."""

LOOKED_AT = 4096
"""Images whose sequences are counted."""

WITH_PRIOR = ("posterior", "sequences")
"""The methods of a dictionary with a prior: for single images, for whole sequences."""


class Default(NamedTuple):
    """The name of an installed config, or else a method; both None where the schema's serve."""

    config: str | None = None
    method: str | None = None


def choose_default(config: FitConfig) -> Default:
    """Return the default for the dictionary and the images of a config, which may lack its inputs.

    A dictionary names an installed config for single images and, after it, one for whole
    sequences. One that names none and has a prior over shapes is fitted by it, unless the config
    asks for what these methods do not have. Where the method is set, the config that has it is
    meant.
    """
    try:
        known = {} if config.dictionary is None else read_provenance(config.dictionary)
        prior = config.dictionary is not None and has_prior(config.dictionary)
    except InputError:  # the fit says what is wrong with it
        return Default()
    method = config.method if "method" in config.model_fields_set else None
    found = choose_by_dictionary(known, method, lambda: in_sequences(config), prior=prior)
    return found if fits(found, config) else Default()


def choose_by_dictionary(
    provenance: Mapping[str, str],
    method: str | None,
    has_sequences: Callable[[], bool],
    *,
    prior: bool,
) -> Default:
    """Choose by what a dictionary says of itself, and by whether the images are of sequences."""
    suits = [name for name in provenance.get(SUITS, "").split() if name in find_presets("fit")]
    if method is not None:
        return Default(next((name for name in suits if method_of(name) == method), None))
    if not suits and prior:
        return Default(method=WITH_PRIOR[has_sequences()])
    if len(suits) < 2:
        return Default(next(iter(suits), None))
    return Default(suits[has_sequences()])


def fits(default: Default, config: FitConfig) -> bool:
    """Whether nothing that the config asks for is in conflict with a default method."""
    if default.method is None:
        return True
    return find_conflict(config.changed(method=default.method)) is None


def method_of(name: str) -> str:
    """Return the method of an installed config."""
    config = load_config("fit", find_config("fit", Path(name)), to_show=True)
    assert isinstance(config, FitConfig)
    return config.method


def in_sequences(config: FitConfig) -> bool:
    """Whether the images are frames of sequences: at least half of them of ENOUGH or more.

    The first LOOKED_AT are counted; what comes by standard input cannot be read twice.
    """
    if not config.landmarks or STANDARD_STREAM in config.landmarks:
        return False
    options = replace(input_options(config.input, "motion"), rename={})
    try:
        with open_landmarks(config.landmarks, options) as source:
            first = next(iter(source.batches(LOOKED_AT)), None)
    except InputError:  # no frames of a video; what is wrong with files the fit says itself
        return False
    return first is not None and are_long(first.sequences)


def are_long(sequences: Sequence[str] | None) -> bool:
    """Whether at least half of the images are of sequences of ENOUGH or more."""
    if not sequences:
        return False
    _, which, counts = np.unique(sequences, return_inverse=True, return_counts=True)
    return median(counts[which]) >= ENOUGH
