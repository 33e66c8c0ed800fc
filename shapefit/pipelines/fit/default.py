"""`method: auto`: the method that suits the dictionary and the images."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from shapefit.arrays import median
from shapefit.config import FitConfig
from shapefit.config.paths import STANDARD_STREAM
from shapefit.dictionary.model import SUITS
from shapefit.errors import InputError, input_error
from shapefit.io import open_landmarks
from shapefit.io.dictionaries import has_prior, read_provenance
from shapefit.io.options import input_options
from shapefit.lifting.methods import AUTO, find_conflict

FRAMES = 10
"""Frames of a sequence whose motion says something of its shapes."""

COUNTED = 4096
"""Images whose sequences are counted."""

PEOPLE = "people"
OF_PEOPLE: Mapping[str, Mapping[str, float]] = {
    "posterior": {"residual_variance": 0.006, "bar_scale": 1.6},
    "sequences": {"residual_variance": 0.01, "bar_scale": 1.5},
}
"""Keys of `prior` for dictionaries of people, where they are not given."""


def choose_default(config: FitConfig) -> tuple[FitConfig, str]:
    """Return the config with a method, and a line that says which was chosen, if one was.

    Raises InputError where the config asks for what its method does not have.
    """
    provenance = read_provenance(config.dictionary)
    prior = config.method == AUTO and has_prior(config.dictionary)
    return choose_by_dictionary(config, provenance, lambda: in_sequences(config), prior=prior)


def choose_by_dictionary(
    config: FitConfig,
    provenance: Mapping[str, str],
    has_sequences: Callable[[], bool],
    *,
    prior: bool,
) -> tuple[FitConfig, str]:
    """Choose by what a dictionary says of itself, and by whether the images are of sequences."""
    line = ""
    if config.method == AUTO:
        method = ("sequences" if has_sequences() else "posterior") if prior else "convex"
        if find_conflict(config.changed(method=method)) is not None:
            method = "convex"
        config = config.changed(method=method)
        if (conflict := find_conflict(config)) is not None:
            raise input_error("fit", conflict.partition("; ")[0], conflict.partition("; ")[2])
        why = "the dictionary has a prior" if prior else "the dictionary has no prior"
        line = f"{method} ({why}; change with --method)"
    if PEOPLE in provenance.get(SUITS, "").split() and config.method in OF_PEOPLE:
        given = config.prior.model_fields_set
        values = OF_PEOPLE[config.method].items()
        config = config.changed(prior={key: value for key, value in values if key not in given})
    resolved = {"tolerance": config.solver_tolerance, "save": {"proof": config.saves_proof}}
    return config.changed(**resolved), line


def in_sequences(config: FitConfig) -> bool:
    """Whether the images are frames of sequences: at least half of them of FRAMES or more.

    The first COUNTED are counted; what comes by standard input cannot be read twice.
    """
    if not config.landmarks or STANDARD_STREAM in config.landmarks:
        return False
    options = replace(input_options(config, "motion"), rename={})
    try:
        with open_landmarks(config.landmarks, options) as source:
            first = next(iter(source.batches(COUNTED)), None)
    except InputError:  # no frames of a video; what is wrong with files the fit says itself
        return False
    return first is not None and are_long(first.sequences)


def are_long(sequences: Sequence[str] | None) -> bool:
    """Whether at least half of the images are of sequences of FRAMES or more."""
    if not sequences:
        return False
    _, which, counts = np.unique(sequences, return_inverse=True, return_counts=True)
    return median(counts[which]) >= FRAMES
