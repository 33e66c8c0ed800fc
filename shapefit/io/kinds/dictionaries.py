"""Read and write dictionary files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.procrustes import coincide
from shapefit.io.layout import DICTIONARY
from shapefit.io.sources import is_csv_target
from shapefit.io.writing import record_writer

if TYPE_CHECKING:
    from shapefit.io.hdf5.reading import Hdf5Reader


def read_dictionary(path: Path) -> Dictionary:
    """Read a dictionary. Raises InputError for what is wrong with the file."""
    from shapefit.io.hdf5 import checks as hdf5_checks
    from shapefit.io.hdf5.reading import Hdf5Reader

    with Hdf5Reader(path, DICTIONARY) as reader:
        fields = reader.fields()
        atoms = fields["atoms"]
        if atoms.size == 0:
            found = f"has the shape {atoms.swapaxes(-1, -2).shape}"
            raise input_error(
                reader.place("atoms"), found, "a dictionary needs atoms and landmarks"
            )
        hdf5_checks.check_finite(reader, "atoms", [atoms])
        hdf5_checks.check_finite(reader, "mean_shape", [fields["mean_shape"][None]])
        if fields["mesh_vertices"] is not None:
            hdf5_checks.check_finite(reader, "mesh_vertices", [fields["mesh_vertices"]])
        if coincide(fields["mean_shape"]):
            found = "all its landmarks lie on one point"
            raise input_error(reader.place("mean_shape"), found, "make the dictionary again")
        hdf5_checks.check_positive(reader, "atom_scale")
        hdf5_checks.check_positive(reader, "acceleration")
        give = fields["edge_give"]
        if give is not None and not (np.isfinite(give).all() and (give >= 0).all()):
            fix = "make the dictionary again"
            raise input_error(reader.place("edge_give"), "holds what is no deviation", fix)
        hdf5_checks.check_named(reader, [fields["atom_items"] or ()], "atom_item", "k")
        hdf5_checks.check_indices(reader, "edges", "p")
        hdf5_checks.check_indices(reader, "mesh_faces", "q")
        if fields["objective_trace"] is None:
            fields["objective_trace"] = np.empty(0)
        fields["prior"] = _read_prior(reader, fields)
        provenance = {name: str(value) for name, value in reader.attributes.items()}
        return Dictionary(
            **fields, unit=reader.unit, frame_rate=reader.frame_rate, provenance=provenance
        )


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
    C = mixture.covariances
    symmetric = np.isfinite(C).all() and np.allclose(C, C.swapaxes(1, 2), rtol=0, atol=1e-9)
    if not symmetric or (np.linalg.eigvalsh(C)[:, 0] <= 0).any():
        found = "holds a matrix that is no covariance: not symmetric, or not positive definite"
        raise input_error(reader.place("prior_covariances"), found, fix)
    return mixture


def write_dictionary(path: Path, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5; the provenance becomes root attributes.

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    if is_csv_target(path):
        raise input_error(path, "a dictionary cannot be CSV", "give it a name in .h5")
    with record_writer(path, DICTIONARY) as writer:
        writer.append(dictionary)
        writer.attributes.update(dictionary.provenance)
