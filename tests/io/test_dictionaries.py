"""What a dictionary says of its training shapes must be numbers that a fit can use."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import shapefit
from shapefit.errors import InputError
from shapefit.io import read_dictionary, read_shapes, write_dictionary

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
