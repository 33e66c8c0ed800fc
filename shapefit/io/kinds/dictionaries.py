"""Read and write dictionary files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.procrustes import coincide
from shapefit.io.layout import DICTIONARY
from shapefit.io.sources import is_csv_target
from shapefit.io.writing import record_writer


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
        hdf5_checks.check_named(reader, [fields["atom_items"] or ()], "atom_item", "k")
        hdf5_checks.check_indices(reader, "edges", "p")
        hdf5_checks.check_indices(reader, "mesh_faces", "q")
        if fields["objective_trace"] is None:
            fields["objective_trace"] = np.empty(0)
        provenance = {name: str(value) for name, value in reader.attributes.items()}
        return Dictionary(**fields, unit=reader.unit, provenance=provenance)


def write_dictionary(path: Path, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5; the provenance becomes root attributes.

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    if is_csv_target(path):
        raise input_error(path, "a dictionary cannot be CSV", "give it a name in .h5")
    with record_writer(path, DICTIONARY) as writer:
        writer.append(dictionary)
        writer.attributes.update(dictionary.provenance)
