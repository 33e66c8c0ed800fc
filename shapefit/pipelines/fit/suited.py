"""The installed config that suits a dictionary: a fit takes it where it names none itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from shapefit.arrays import median
from shapefit.config import FitConfig, find_config, load_config
from shapefit.config.loader import find_presets
from shapefit.config.paths import STANDARD_STREAM
from shapefit.dictionary.model import SUITS
from shapefit.errors import InputError
from shapefit.io import open_landmarks
from shapefit.io.dictionaries import read_provenance
from shapefit.io.options import input_options

ENOUGH = 10
"""Frames of a sequence whose motion says something of its shapes."""

LOOKED_AT = 4096
"""Images whose sequences are counted."""


def find_suited(config: FitConfig) -> str | None:
    """Return the name of the installed config that suits dictionary and images; None without one.

    A dictionary names one for single images and, after it, one for whole sequences. Where
    the method is set, the one that has it is meant. `config` may lack its inputs.
    """
    try:
        known = {} if config.dictionary is None else read_provenance(config.dictionary)
    except InputError:  # the fit says what is wrong with it
        return None
    method = config.method if "method" in config.model_fields_set else None
    return choose_suited(known, method, lambda: in_sequences(config))


def choose_suited(
    provenance: Mapping[str, str], method: str | None, has_sequences: Callable[[], bool]
) -> str | None:
    """Choose among the installed configs that the provenance of a dictionary names."""
    suits = [name for name in provenance.get(SUITS, "").split() if name in find_presets("fit")]
    if method is not None:
        return next((name for name in suits if method_of(name) == method), None)
    if len(suits) < 2:
        return next(iter(suits), None)
    return suits[1 if has_sequences() else 0]


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
