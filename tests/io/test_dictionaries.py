"""What a dictionary says of its training shapes must be numbers that a fit can use; its
atoms as shapes.
"""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import shapefit
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import read_dictionary, read_shapes, write_dictionary
from shapefit.io.dictionaries import atoms_of
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.records.columns import in_columns

PEOPLE = Path(shapefit.__file__).parent / "data" / "people.h5"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("acceleration", np.nan),
        ("acceleration", -0.1),
        ("bone_tolerance", -0.1),
        ("edge_length", np.inf),
        ("p_value_table", np.nan),
        ("p_value_table", -1.0),
    ],
)
def test_numbers_of_no_use_are_refused(tmp_path: Path, name: str, value: float):
    path = tmp_path / "dictionary.h5"
    write_dictionary(path, read_dictionary(PEOPLE))
    with h5py.File(path, "r+") as file:
        file[name][0] = value
    with pytest.raises(InputError, match=f"{name}.*holds .*make the dictionary again"):
        read_dictionary(path)


def test_vertices_and_atoms_are_named(
    shape_file, dictionary_file, shapes, dictionary, edit, problems
):
    vertices = shapes.mesh_vertices.copy()
    vertices[2, 4, 0] = 1e151
    (line,) = problems(read_shapes, [edit(shape_file, mesh_vertices=vertices)])
    assert line.startswith(f"{shape_file}:/mesh_vertices[2]: vertex 4 is (1e+151, ")
    atoms = dictionary.atoms.swapaxes(1, 2).copy()
    atoms[3, 1] = 1e200
    (line,) = problems(read_dictionary, edit(dictionary_file, atoms=atoms))
    assert line.startswith(
        f"{dictionary_file}:/atoms[3]: landmark 'left hand' is (1e+200, "
    )


@pytest.mark.parametrize("mean", [np.ones((4, 3)), np.zeros((4, 3))])
def test_a_mean_shape_must_be_a_shape(dictionary_file, edit, problems, mean):
    (line,) = problems(read_dictionary, edit(dictionary_file, mean_shape=mean))
    assert (
        line == f"{dictionary_file}:/mean_shape: all its landmarks are at one point; "
        "make the dictionary again"
    )


@pytest.fixture
def of_meshes(rng):
    """A dictionary of three atoms of four landmarks, each with a mesh, in metres."""
    atoms = rng.normal(size=(3, 3, 4))
    return Dictionary(
        atoms,
        landmark_names=tuple("abcd"),
        mean_shape=atoms.mean(axis=0),
        edges=np.array([[0, 1], [1, 3]]),
        unit="m",
        mesh_vertices=rng.normal(size=(3, 3, 6)),
        mesh_faces=np.array([[0, 1, 2], [3, 4, 5]]),
    )


def test_atoms_have_the_edges_and_faces_of_their_dictionary(of_meshes):
    shapes = atoms_of(of_meshes)
    assert_array_equal(shapes.edges, of_meshes.edges)
    assert_array_equal(shapes.mesh_faces, of_meshes.mesh_faces)
    assert_array_equal(in_columns(shapes.mesh_vertices), of_meshes.mesh_vertices)
    assert shapes.items == ("atom 0", "atom 1", "atom 2")


def test_atoms_of_unknown_size_have_no_unit(of_meshes):
    assert atoms_of(of_meshes).unit == UNKNOWN_UNIT


def test_atoms_and_meshes_stand_where_their_models_stood(of_meshes, rng):
    """Models (n, p, 3) in metres, which a dictionary has normalised."""
    sizes = rng.uniform(1, 2, 3)
    origins = rng.normal(size=(3, 3))
    known = replace(of_meshes, atom_scale=sizes, atom_origin=origins)

    shapes = atoms_of(known)

    assert shapes.unit == "m"
    for atom, size, origin, found in zip(
        of_meshes.atoms, sizes, origins, shapes.shapes, strict=True
    ):
        assert_allclose(found, size * (atom.T - origin))
    for mesh, size, origin, found in zip(
        of_meshes.mesh_vertices, sizes, origins, shapes.mesh_vertices, strict=True
    ):
        assert_allclose(found, size * (mesh.T - origin))
