"""Read and write dictionary files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.procrustes import coincide
from shapefit.io.formats import find_reader
from shapefit.io.layout import DICTIONARY
from shapefit.io.writing import record_writer

if TYPE_CHECKING:
    from shapefit.io.hdf5.checks import Datasets


def read_dictionary(path: Path) -> Dictionary:
    """Read a dictionary. Raises InputError for what is wrong with the file."""
    dictionary: Dictionary = find_reader(path, "dictionary")(path)
    return dictionary


def read_hdf5(path: Path) -> Dictionary:
    """Read a dictionary from HDF5."""
    from shapefit.io.hdf5.reading import Hdf5Reader

    with Hdf5Reader(path, DICTIONARY) as reader:
        check_dictionary(reader)
        fields = reader.fields()
        if fields["objective_trace"] is None:
            fields["objective_trace"] = np.empty(0)
        provenance = {name: str(value) for name, value in reader.attributes.items()}
        return Dictionary(**fields, unit=reader.unit, provenance=provenance)


def check_dictionary(reader: Datasets) -> None:
    """Raise InputError for a dictionary with which no fit is possible."""
    from shapefit.io.hdf5 import checks

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
    checks.check_named(reader, [reader.read("atom_item") or ()], "atom_item", "k")
    checks.check_indices(reader, "edges", "p")
    checks.check_indices(reader, "mesh_faces", "q")


def write_dictionary(path: Path, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5; the provenance becomes root attributes.

    Raises InputError where the file cannot be written; the old one then stays as it was.
    """
    with record_writer(path, DICTIONARY) as writer:
        writer.append(dictionary)
        writer.attributes.update(dictionary.provenance)
