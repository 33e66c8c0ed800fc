"""Read and write dictionary files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.procrustes import coincide
from shapefit.io.checks import Place, check_finite, check_mesh, input_problems, place_in_memory
from shapefit.io.formats import HDF5, check_holds, own_format, record_writer
from shapefit.io.layout import DICTIONARY, FIELDS

AGAIN = "make the dictionary again"

POSITIVE = {"acceleration": "acceleration", "bone_tolerance": "deviation", "edge_length": "length"}
"""Datasets whose numbers are not negative, and what they are."""


def read_dictionary(path: Path, *, old: bool = False) -> Dictionary:
    """Read a dictionary, with `old` one of version 1, too. Raises InputError for what is wrong."""
    if own_format(path) is not HDF5:
        from shapefit.io.detect import detect_format

        check_holds(path, DICTIONARY.kind, detect_format(path))
    from shapefit.io.hdf5_records import Hdf5Reader

    with Hdf5Reader(path, DICTIONARY, old=old) as reader:
        fields, place = reader.fields(), reader.place
        check_dictionary(fields, place)
        for name, kind in POSITIVE.items():
            values = fields[name]
            if values is not None and not (np.isfinite(values).all() and (values >= 0).all()):
                raise input_error(place(name, None), f"holds what is no {kind}", AGAIN)
        if (C := fields["edge_covariance"]) is not None and C.size:
            _check_covariance(place, "edge_covariance", C)
        if (table := fields["p_value_table"]) is not None and not is_table(table):
            raise input_error(place("p_value_table", None), "holds no moments of a prior", AGAIN)
        if fields["objective_trace"] is None:
            fields["objective_trace"] = np.empty(0)
        fields["prior"] = _take_prior(fields, place)
        stated = reader.stated
        provenance = {name: str(value) for name, value in reader.attributes.items()}
        return Dictionary(
            **fields, unit=stated["unit"], frame_rate=stated["frame_rate"], provenance=provenance
        )


def is_table(table: Floats) -> bool:
    """Whether rows (t, 4) hold scales, numbers of landmarks, excesses and shares of variance."""
    return len(table) > 0 and bool(np.isfinite(table).all() and (table[:, [0, 1, 3]] > 0).all())


def _take_prior(fields: dict[str, Any], place: Place) -> Mixture | None:
    """Take the parts of the prior out of the fields; None without one."""
    names = ("prior_weights", "prior_means", "prior_covariances")
    parts = [fields.pop(name) for name in names]
    absent = [name for name, part in zip(names, parts, strict=True) if part is None]
    if len(absent) == len(names):
        return None
    if absent:
        raise input_error(place(absent[0], None), "is missing; the file has a prior", AGAIN)
    weights, means, covariances = parts
    fine = np.isfinite(weights).all() and (weights > 0).all() and abs(weights.sum() - 1) < 1e-6
    if not fine:
        found = "are no shares that add up to 1"
        raise input_error(place("prior_weights", None), found, AGAIN)
    if not np.isfinite(means).all():
        raise input_error(place("prior_means", None), "holds what is no number", AGAIN)
    mixture = Mixture.of_landmarks(weights, means, covariances)
    _check_covariance(place, "prior_covariances", mixture.covariances)
    return mixture


def _check_covariance(place: Place, name: str, C: Floats) -> None:
    """Raise InputError for a matrix (..., e, e) that is no covariance."""
    symmetric = np.isfinite(C).all() and np.allclose(C, C.swapaxes(-1, -2), rtol=0, atol=1e-9)
    if not symmetric or not is_positive_definite(C):
        found = "is no covariance: not symmetric, or not positive definite"
        raise input_error(place(name, None), found, AGAIN)


def is_positive_definite(C: Floats) -> bool:
    """Whether matrices (..., e, e) have Cholesky factors: ten times as fast as eigenvalues."""
    try:
        np.linalg.cholesky(C)
    except np.linalg.LinAlgError:
        return False
    return True


def check_dictionary(fields: Mapping[str, Any], place: Place) -> None:
    """Raise InputError for the fields of a dictionary with which no fit is possible."""
    atoms, mean, names = fields["atoms"], fields["mean_shape"], fields["landmark_names"]
    if atoms.size == 0:
        found = f"has the shape {atoms.swapaxes(-1, -2).shape}"
        raise input_error(place("atoms", None), found, "a dictionary needs atoms and landmarks")
    check_finite(place, "atoms", atoms, names)
    check_finite(place, "mean_shape", mean[None], names)
    if coincide(mean):
        found = "all its landmarks are at one point"
        raise input_error(place("mean_shape", None), found, "learn the dictionary again")
    if (scale := fields["atom_scale"]) is not None:
        wrong = np.flatnonzero(~(np.isfinite(scale) & (scale > 0)))
        fix = "write a positive number"
        problems = [f"{place('atom_scale', row)}: is {scale[row]}; {fix}" for row in wrong]
        if problems:
            raise input_problems(problems)
    unnamed = [row for row, item in enumerate(fields["atom_items"] or ()) if not item]
    if unnamed:
        raise input_problems(
            [f"{place('atom_item', n)}: is empty; name every item" for n in unnamed]
        )
    check_mesh(place, fields, len(names))
    if (index := fields["mirror_index"]) is not None:
        points = np.arange(len(index))
        if ((index < 0) | (index >= len(index))).any() or (index[index] != points).any():
            raise input_error(place("mirror_index", None), "does not pair the landmarks", AGAIN)


def check_given_dictionary(dictionary: Dictionary, name: str) -> None:
    """Raise InputError for what `read_dictionary` would not read from a file."""
    names = [FIELDS.get(name, name) for name in DICTIONARY.datasets]
    fields = {name: getattr(dictionary, name, None) for name in names}
    check_dictionary(fields, place_in_memory(name))


def write_dictionary(path: Path, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5; the provenance becomes root attributes.

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, DICTIONARY) as writer:
        writer.append(dictionary)
        writer.attributes.update(dictionary.provenance)
