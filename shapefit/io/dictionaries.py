"""Read and write dictionary files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.procrustes import coincide
from shapefit.io import checks
from shapefit.io.checks import Datasets, InMemory
from shapefit.io.formats import find_reader
from shapefit.io.layout import DICTIONARY
from shapefit.io.writing import record_writer

if TYPE_CHECKING:
    from shapefit.io.hdf5_records import Hdf5Reader


def read_dictionary(path: Path) -> Dictionary:
    """Read a dictionary. Raises InputError for what is wrong with the file."""
    dictionary: Dictionary = find_reader(path, "dictionary")(path)
    return dictionary


def read_hdf5(path: Path) -> Dictionary:
    """Read a dictionary from HDF5."""
    from shapefit.io.hdf5_records import Hdf5Reader

    with Hdf5Reader(path, DICTIONARY) as reader:
        fields = reader.fields()
        check_dictionary(reader)
        for name, kind in (("edge_give", "deviation"), ("edge_length", "length")):
            values = fields[name]
            if values is not None and not (np.isfinite(values).all() and (values >= 0).all()):
                fix = "make the dictionary again"
                raise input_error(reader.place(name), f"holds what is no {kind}", fix)
        if (C := fields["edge_covariance"]) is not None and C.size:
            _check_covariance(reader, "edge_covariance", C)
        if fields["objective_trace"] is None:
            fields["objective_trace"] = np.empty(0)
        fields["prior"] = _read_prior(reader, fields)
        provenance = {name: str(value) for name, value in reader.attributes.items()}
        return Dictionary(
            **fields, unit=reader.unit, frame_rate=reader.frame_rate, provenance=provenance
        )


def read_provenance(path: Path) -> dict[str, str]:
    """Return what a dictionary says of how it was made; nothing for what is no HDF5.

    Only the attributes are read, and nothing is checked. Raises InputError as `open_hdf5` does.
    """
    from shapefit.io.hdf5_records import read_attributes

    return read_attributes(path)


def has_prior(path: Path) -> bool:
    """Whether a dictionary has a prior over shapes; not read, and raises as `read_provenance`."""
    from shapefit.io.hdf5_file import open_hdf5

    try:
        with open_hdf5(path) as file:
            return "prior_weights" in file
    except OSError:
        return False


def _read_prior(reader: Hdf5Reader, fields: dict[str, Any]) -> Mixture | None:
    """Take the parts of the prior out of the fields; None without one."""
    names = ("prior_weights", "prior_means", "prior_covariances")
    parts = [fields.pop(name) for name in names]
    absent = [name for name, part in zip(names, parts, strict=True) if part is None]
    if len(absent) == len(names):
        return None
    fix = "make the dictionary again"
    if absent:
        raise input_error(reader.place(absent[0]), "is missing; the file has a prior", fix)
    weights, means, covariances = parts
    fine = np.isfinite(weights).all() and (weights > 0).all() and abs(weights.sum() - 1) < 1e-6
    if not fine:
        raise input_error(reader.place("prior_weights"), "are no shares that add up to 1", fix)
    if not np.isfinite(means).all():
        raise input_error(reader.place("prior_means"), "holds what is no number", fix)
    mixture = Mixture.of_landmarks(weights, means, covariances)
    _check_covariance(reader, "prior_covariances", mixture.covariances)
    return mixture


def _check_covariance(reader: Hdf5Reader, name: str, C: Floats) -> None:
    """Raise InputError for a matrix (..., e, e) that is no covariance."""
    symmetric = np.isfinite(C).all() and np.allclose(C, C.swapaxes(-1, -2), rtol=0, atol=1e-9)
    if not symmetric or (np.linalg.eigvalsh(C)[..., 0] <= 0).any():
        found = "is no covariance: not symmetric, or not positive definite"
        raise input_error(reader.place(name), found, "make the dictionary again")


def check_dictionary(reader: Datasets) -> None:
    """Raise InputError for a dictionary with which no fit is possible."""
    atoms, mean = reader.read("atoms"), reader.read("mean_shape")
    if atoms.size == 0:
        found = f"has the shape {atoms.swapaxes(-1, -2).shape}"
        raise input_error(reader.place("atoms"), found, "a dictionary needs atoms and landmarks")
    checks.check_finite(reader, "atoms", [atoms])
    checks.check_finite(reader, "mean_shape", [mean[None]])
    if reader.has("mesh_vertices"):
        checks.check_finite(reader, "mesh_vertices", [reader.read("mesh_vertices")])
    if coincide(mean):
        found = "all its landmarks are at one point"
        raise input_error(reader.place("mean_shape"), found, "learn the dictionary again")
    checks.check_positive(reader, "atom_scale")
    checks.check_named(reader, [reader.read("atom_item") or ()], "atom_item")
    checks.check_indices(reader, "edges", "p")
    _check_mirror(reader)
    checks.check_indices(reader, "mesh_faces", "q")


def check_given_dictionary(dictionary: Dictionary, name: str) -> None:
    """Raise InputError for what `read_dictionary` would not read from a file."""
    check_dictionary(InMemory(name, dictionary, DICTIONARY))


def _check_mirror(reader: Datasets) -> None:
    """Raise InputError for a `mirror_index` that is not its own inverse."""
    index = reader.read("mirror_index")
    if index is None:
        return
    points = np.arange(len(index))
    if ((index < 0) | (index >= len(index))).any() or (index[index] != points).any():
        fix = "make the dictionary again"
        raise input_error(reader.place("mirror_index"), "does not pair the landmarks", fix)


def write_dictionary(path: Path, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5; the provenance becomes root attributes.

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, DICTIONARY) as writer:
        writer.append(dictionary)
        writer.attributes.update(dictionary.provenance)
