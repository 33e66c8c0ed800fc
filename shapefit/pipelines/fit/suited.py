"""The installed config that suits a dictionary: a fit takes it where it names none itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from shapefit.config import FitConfig, load_config
from shapefit.config.paths import STANDARD_STREAM
from shapefit.config.presets import ConfigFile, find_presets
from shapefit.dictionary.model import SUITS
from shapefit.errors import InputError
from shapefit.io import open_landmarks, read_dictionary
from shapefit.pipelines.reading import input_options

ENOUGH = 10
"""Frames of a sequence whose motion says something of its shapes."""

LOOKED_AT = 4096
"""Images whose sequences are counted."""


def find_suited(config: FitConfig) -> str | None:
    """Return the name of the installed config that suits dictionary and images; None without one.

    A dictionary names one for single images and, after it, one for whole sequences. Where
    the method is set, the one that has it is meant. `config` may lack its inputs.
    """
    suits = suited_by(config.dictionary)
    if "method" in config.model_fields_set:
        methods = {name: method_of(find_presets("fit")[name]) for name in suits}
        return next((name for name in suits if methods[name] == config.method), None)
    if len(suits) < 2:
        return next(iter(suits), None)
    return suits[1 if in_sequences(config) else 0]


def suited_by(dictionary: Path | None) -> tuple[str, ...]:
    """Return the configs that a dictionary names, as far as they are installed.

    A dictionary that cannot be read names none: the fit says what is wrong with it.
    """
    try:
        known = {} if dictionary is None else read_dictionary(dictionary).provenance
    except InputError:
        return ()
    named = known.get(SUITS, "").split()
    return tuple(name for name in named if name in find_presets("fit"))


def method_of(path: Path) -> str:
    """Return the method of an installed config."""
    config = load_config("fit", ConfigFile(path, is_preset=True), to_show=True)
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
            first = next(iter(source.chunks(LOOKED_AT)), None)
    except InputError:  # no frames of a video; what is wrong with files the fit says itself
        return False
    if first is None or first.sequences is None:
        return False
    _, which, counts = np.unique(first.sequences, return_inverse=True, return_counts=True)
    return bool(np.median(counts[which]) >= ENOUGH)
