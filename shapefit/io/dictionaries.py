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
from shapefit.geometry.procrustes import are_coincident
from shapefit.io.checks import PlaceNamer, check_finite, check_mesh, place_in_memory
from shapefit.io.formats import HDF5, check_our_format, our_format, record_writer
from shapefit.io.layout import DICTIONARY, UNKNOWN_UNIT
from shapefit.records.shapes import Shapes

AGAIN = "make the dictionary again"
TINY = np.nextafter(0, 1)
MIN_VALUES = {
    **dict.fromkeys(("acceleration", "bone_tolerance", "edge_length"), 0.0),
    "atom_scale": TINY,
    "p_value_table": np.array([TINY, TINY, np.finfo(float).min, TINY]),
}
"""The least that numbers of a dictionary can be; all are finite."""
PRIOR_DATASETS = ("prior_weights", "prior_means", "prior_covariances")


def read_dictionary(path: Path, *, old: bool = False) -> Dictionary:
    """Read a dictionary file, with `old` one of version 1, too.

    Raises InputError for what is wrong.
    """
    if our_format(path) is not HDF5:
        from shapefit.io.detect import detect_format

        check_our_format(path, DICTIONARY.kind, detect_format(path))
    from shapefit.io.hdf5_file import Hdf5Reader

    with Hdf5Reader(path, DICTIONARY, old=old) as reader:
        fields = reader.dictionary_fields()
        check_dictionary(fields, reader.place)
        fields["prior"] = _pop_prior(fields, reader.place)
        if fields["objective_trace"] is None:
            fields["objective_trace"] = np.empty(0)
        provenance = {name: str(value) for name, value in reader.attributes.items()}
        return Dictionary(
            **fields,
            unit=reader.unit,
            frame_rate=reader.frame_rate,
            provenance=provenance,
        )


def atoms_of(dictionary: Dictionary) -> Shapes:
    """Return the atoms of a dictionary as shapes.

    They are in the unit of the training shapes where their sizes are known, else as
    they are, about 1 in size; in the frame of the training shapes where it is known.
    """
    k, sizes = dictionary.k, dictionary.atom_scale
    numbers = (f"atom {number:0{len(str(k - 1))}d}" for number in range(k))
    atoms, vertices = dictionary.atoms, dictionary.mesh_vertices
    if dictionary.atom_origin is not None:
        origin = dictionary.atom_origin[:, :, None]
        atoms = atoms - origin
        vertices = None if vertices is None else vertices - origin
    if sizes is not None:
        atoms = atoms * sizes[:, None, None]
        vertices = None if vertices is None else vertices * sizes[:, None, None]
    return Shapes(
        atoms.swapaxes(1, 2),
        landmark_names=dictionary.landmark_names,
        items=dictionary.atom_items or tuple(numbers),
        unit=UNKNOWN_UNIT if sizes is None else dictionary.unit,
        edges=dictionary.edges,
        mesh_vertices=None if vertices is None else vertices.swapaxes(1, 2),
        mesh_faces=None if vertices is None else dictionary.mesh_faces,
    )


def check_dictionary(fields: Mapping[str, Any], place: PlaceNamer) -> None:
    """Raise InputError where a dictionary's fields are empty, invalid or not finite."""
    atoms, mean, names = fields["atoms"], fields["mean_shape"], fields["landmark_names"]
    if atoms.size == 0:
        fault = f"has the shape {atoms.swapaxes(-1, -2).shape}"
        raise input_error(
            place("atoms", None), fault, "a dictionary needs atoms and landmarks"
        )
    check_finite(place, "atoms", atoms.swapaxes(1, 2), names)
    check_finite(place, "mean_shape", mean.T[None], names)
    vertices = fields.get("mesh_vertices")
    if vertices is not None:
        vertices = vertices.swapaxes(1, 2)
    check_mesh(place, len(names), fields["edges"], vertices, fields["mesh_faces"])
    if are_coincident(mean):
        raise input_error(
            place("mean_shape", None), "all its landmarks are at one point", AGAIN
        )
    for name, least in MIN_VALUES.items():
        values = fields.get(name)
        if values is not None and not ((values >= least) & (values < np.inf)).all():
            raise input_error(place(name, None), "holds numbers that cannot be", AGAIN)
    if (index := fields["mirror_index"]) is not None:
        points = np.arange(len(index))
        if not (np.isin(index, points).all() and (index[index] == points).all()):
            raise input_error(
                place("mirror_index", None), "does not pair the landmarks", AGAIN
            )
    C = fields.get("edge_covariance")
    if C is not None and C.size and not _are_covariances(C):
        raise input_error(place("edge_covariance", None), "is no covariance", AGAIN)


def _pop_prior(fields: dict[str, Any], place: PlaceNamer) -> Mixture | None:
    """Remove the datasets of the prior from `fields`; return its mixture, or None.

    Raises InputError where they are no mixture.
    """
    parts = weights, means, covariances = [fields.pop(name) for name in PRIOR_DATASETS]
    if all(part is None for part in parts):
        return None
    fault = "its prior is no mixture: shares that add up to 1, means and covariances"
    if not any(part is None for part in parts):
        mixture = Mixture.of_landmarks(weights, means, covariances)
        shares = (weights > 0).all() and abs(weights.sum() - 1) < 1e-6
        if (
            shares
            and np.isfinite(means).all()
            and _are_covariances(mixture.covariances)
        ):
            return mixture
    raise input_error(place(PRIOR_DATASETS[0], None), fault, AGAIN)


def _are_covariances(C: Floats) -> bool:
    """Whether matrices (..., e, e) are symmetric and positive definite."""
    if not (
        np.isfinite(C).all() and np.allclose(C, C.swapaxes(-1, -2), rtol=0, atol=1e-9)
    ):
        return False
    try:
        np.linalg.cholesky(C)  # ten times as fast as eigenvalues
    except np.linalg.LinAlgError:
        return False
    return True


def check_dictionary_in_memory(dictionary: Dictionary, name: str) -> None:
    """Raise InputError where a dictionary in memory is empty, invalid or not finite.

    `name` stands for it in messages. Its prior is not checked.
    """
    columns = DICTIONARY.columns.values()
    fields = {one.field: getattr(dictionary, one.field, None) for one in columns}
    check_dictionary(fields, place_in_memory(name))


def write_dictionary(path: Path, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5; the provenance becomes root attributes.

    Raises InputError where the file cannot be written; the old one then stays as it
    was.
    """
    with record_writer(path, DICTIONARY) as writer:
        writer.append(dictionary)
        writer.attributes.update(dictionary.provenance)
