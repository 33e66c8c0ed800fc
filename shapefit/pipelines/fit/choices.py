"""What a fit chooses before it sees its images: the method and its family, how files
are read, and what is doubtful of the dictionary.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, median
from shapefit.config import FitConfig
from shapefit.config.commands.fit import find_conflict
from shapefit.config.paths import STANDARD_STREAM, ResultFolder
from shapefit.dictionary.model import Dictionary, describe_learning
from shapefit.errors import InputError, input_error
from shapefit.io import open_landmarks
from shapefit.io.formats import find_target_format
from shapefit.io.options import InputOptions, input_options
from shapefit.lifting.methods import AUTO, METHODS
from shapefit.pipelines.fit.family import Calibration, Family
from shapefit.pipelines.joints import LandmarkMatch, match_names
from shapefit.timeline import parse_frame_range

MIN_SEQUENCE_FRAMES = 10
"""Of a sequence whose motion says something of its shapes."""

IMAGES_INSPECTED = 4096
"""Images by which it is told whether there are sequences."""

PRIOR_OF_PEOPLE: Mapping[str, Mapping[str, float]] = {
    "posterior": {"residual_variance": 0.006, "bar_scale": 1.6},
    "sequences": {"residual_variance": 0.01, "bar_scale": 1.5},
}
"""Keys of `prior` for every dictionary that knows the usual lengths of limbs of people,
where they are not given.
"""

FLAT_SHARE = 0.01
"""Of the extent of shapes, their thickness below which they are flat."""

MIN_USUAL_ATOM_NORM = 0.05
"""Below it lambda, which is meant for atoms of 1 and more, means something else."""

MAX_USUAL_ATOM_NORM = 20.0
"""Beyond it, in the norm of normalised shapes, likewise."""


class MethodChoice(NamedTuple):
    """A config whose method is settled, with the defaults of keys that depend on it;
    line says what chose it, "" where the config did.
    """

    config: FitConfig
    line: str = ""


def choose_method(
    config: FitConfig, dictionary: Dictionary, has_sequences: Callable[[], bool]
) -> MethodChoice:
    """Choose the method that suits dictionary and images, where the config does not.

    Raises InputError where keys of the config need another one.
    """
    line = ""
    if config.method == AUTO:
        method = find_method(config, dictionary, has_sequences)
        config = config.changed(method=method)
        conflict = find_conflict(config)
        if conflict is not None:
            fault, _, fix = conflict.partition("; ")
            raise input_error("fit", fault, fix)
        has_prior = "no prior" if dictionary.prior is None else "a prior"
        line = f"{method} (the dictionary has {has_prior}; change with --method)"
    config = with_prior_of_people(config, dictionary)
    row = METHODS[config.method]
    tolerance = config.tolerance
    if tolerance is None:
        tolerance = row.tolerance
    proof = config.save.proof
    if proof is None:
        proof = not row.needs_prior
    config = config.changed(tolerance=tolerance, save={"proof": proof})
    return MethodChoice(config, line)


def find_method(
    config: FitConfig, dictionary: Dictionary, has_sequences: Callable[[], bool]
) -> str:
    """Return `convex`, `sequences` or `posterior`, by the dictionary and the images.

    `convex` without a prior, or where a key of the config needs it; else `sequences`
    for frames of sequences, and `posterior` for single images.
    """
    if dictionary.prior is None:
        return "convex"
    method = "sequences" if has_sequences() else "posterior"
    if find_conflict(config.changed(method=method)) is not None:
        return "convex"
    return method


def with_prior_of_people(config: FitConfig, dictionary: Dictionary) -> FitConfig:
    """Return the config with values for people in the keys of `prior` that are open."""
    if config.method not in PRIOR_OF_PEOPLE:
        return config
    # Imported here, as fits by other methods do not need it.
    from shapefit.lifting.posterior.usual_lengths import find_limb_lengths

    if find_limb_lengths(dictionary) is None:
        return config
    given = config.prior.model_fields_set
    values = PRIOR_OF_PEOPLE[config.method].items()
    return config.changed(prior={key: v for key, v in values if key not in given})


def are_in_sequences(config: FitConfig) -> bool:
    """Whether the images are frames of sequences, by the first of them."""
    if STANDARD_STREAM in config.landmarks:  # which cannot be read twice
        return False
    options = replace(input_options(config, "motion"), rename={})
    try:
        with open_landmarks(config.landmarks, options, head=True) as source:
            return are_long(source.first(IMAGES_INSPECTED).sequences)
    except InputError:
        # No frames of a video; what is wrong with files is reported by the fit.
        return False


def are_long(sequences: Sequence[str] | None) -> bool:
    """Whether half of the images are in sequences of MIN_SEQUENCE_FRAMES or more.

    sequences (n,), the name of that of each image; one without a name is by itself.
    """
    if not sequences:
        return False
    frame_counts = Counter(sequences)
    lengths = [frame_counts[name] if name else 1 for name in sequences]
    return median(np.array(lengths)) >= MIN_SEQUENCE_FRAMES


def choose_family(
    config: FitConfig, match: LandmarkMatch, calibration: Calibration | None = None
) -> Family:
    """Return the family of the config's method, with the options of the config.

    With a calibration nothing is left open in it.
    """
    # The maths of one family takes as long to import as that of the other.
    if config.method == "sequences":
        from shapefit.pipelines.fit.sequences import make_sequence_family

        return make_sequence_family(config, match, calibration)
    if config.method == "posterior":
        from shapefit.pipelines.fit.posterior import make_posterior_family

        return make_posterior_family(config, match, calibration)
    from shapefit.pipelines.fit.atoms import make_atom_family

    return make_atom_family(config, match)


def match_to_dictionary(
    config: FitConfig, dictionary: Dictionary, names: Sequence[str]
) -> LandmarkMatch:
    """Match landmarks of the files to those of a dictionary that suits the method.

    A table of p-values that the method needs and the dictionary lacks is drawn. Raises
    InputError where the dictionary lacks another thing that the method needs.
    """
    method = METHODS[config.method]
    if method.needs_prior and dictionary.p_value_table is None:
        from shapefit.lifting.posterior.p_value import with_p_value_table

        dictionary = with_p_value_table(dictionary)  # not learned by this version
    match = match_names(
        names, dictionary, place_of_names(config), in_place=method.needs_prior
    )
    check_needs(config.method, match.dictionary, config.dictionary)
    return match


def place_of_names(config: FitConfig) -> str:
    """Return the text by which error messages name where landmark names come from."""
    return ", ".join(map(str, config.landmarks)) + ": landmark names"


def check_needs(method: str, dictionary: Dictionary, place: str | Path) -> None:
    """Raise InputError where what a method needs of a dictionary is absent or faulty.

    place: the dictionary as the message names it.
    """
    for need in METHODS[method].needs:
        if getattr(dictionary, need.name) is None:
            fault = f"no `{need.name}`"
        else:
            fault = need.find_fault(dictionary)
        if fault:
            raise input_error(place, f"{fault}: {need.what}", need.fix)


def reading_options(config: FitConfig) -> InputOptions:
    """Return the options by which the landmark files of a fit are to be read.

    Detections are tracked where the method or the output needs motion.
    """
    track = METHODS[config.method].takes_sequences
    if not isinstance(config.output, ResultFolder):
        track = track or find_target_format(config.output).in_metres
    options = input_options(config, "motion" if track else "none")
    return replace(options, frames=parse_frame_range(config.frames), every=config.every)


def with_angle_covariance(config: FitConfig) -> FitConfig:
    """Return the config, with `save.covariance` where the output is of joint angles.

    The error bar of an angle depends on several joints.
    """
    if find_target_format(Path(str(config.output))).angles:
        return config.changed(save={"covariance": True})
    return config


def files_of(config: FitConfig) -> dict[str, Path]:
    """Return the files that results depend on beside landmarks, by their keys."""
    files = {
        "dictionary": config.dictionary,
        "camera.calibration": config.camera.calibration,
        "prior.calibration": config.prior.calibration,
    }
    return {key: path for key, path in files.items() if path is not None}


def warn_of_dictionary(config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Return warnings about a dictionary: how it was learned, and for which method."""
    warnings = [*describe_learning(dictionary)]
    method = METHODS[config.method]
    learned = dictionary.provenance.get("method")
    suits = learned is None or not method.learned or learned in method.learned
    if not suits and not config.signed:
        made = f"{config.method} is made for {' or '.join(method.learned)}"
        warnings.append(f"the dictionary was learned with `method: {learned}`; {made}")
    if not method.mixes_atoms:
        return tuple(warnings)
    if config.method == "convex" and are_flat(dictionary.atoms):
        text = "all shapes of the dictionary are flat, which `convex` recovers badly"
        warnings.append(f"{text}: compare `--method alternate`")
    size = median(np.linalg.norm(dictionary.atoms, axis=(1, 2)))
    usual = dictionary.atoms[0].size ** 0.5
    if not MIN_USUAL_ATOM_NORM <= size <= MAX_USUAL_ATOM_NORM * usual:
        text = f"the atoms have a norm of {size:.3g}, and lambda is meant for 1 to"
        fix = "divide the atoms by their size, or multiply lambda by it"
        warnings.append(f"{text} {usual:.2g}: {fix}")
    return tuple(warnings)


def are_flat(atoms: Floats) -> bool:
    """Whether all points of atoms (k, 3, p) lie in one plane, by singular values.

    False for fewer than four landmarks, which always do.
    """
    if atoms.shape[2] < 4:
        return False
    points = atoms.swapaxes(0, 1).reshape(3, -1)
    extents = np.linalg.svd(points @ points.T, compute_uv=False) ** 0.5
    return bool(extents[2] < FLAT_SHARE * extents[0])
