"""Coordinates that are numbers, and yet none to compute with."""

import numpy as np
import pytest

from shapefit.io import read_dictionary, read_results, read_shapes

HEAD = "item,landmark,x,y,z\n"


@pytest.mark.parametrize("value", ["1e160", "-2e300"])
def test_a_coordinate_whose_square_overflows_is_named(csv, problems, value):
    path = csv(f"{HEAD}a,head,1,2,3\na,foot,4,{value},6\n")
    for read in (lambda: read_shapes([path]), lambda: read_results(path)):
        (line,) = problems(read)
        assert line.startswith(f"{path}: item 'a': landmark 'foot' is (4.0, {float(value)}, 6.0); ")


def test_the_largest_coordinate_is_read(csv):
    assert read_shapes([csv(f"{HEAD}a,head,1,2,3\na,foot,4,1e150,6\n")]).shapes.max() == 1e150


def test_vertices_and_atoms_are_named(
    shape_file, dictionary_file, shapes, dictionary, edit, problems
):
    vertices = shapes.mesh_vertices.swapaxes(1, 2).copy()
    vertices[2, 4, 0] = 1e151
    (line,) = problems(read_shapes, [edit(shape_file, mesh_vertices=vertices)])
    assert line.startswith(f"{shape_file}:/mesh_vertices[2]: vertex 4 is (1e+151, ")
    atoms = dictionary.atoms.swapaxes(1, 2).copy()
    atoms[3, 1] = 1e200
    (line,) = problems(read_dictionary, edit(dictionary_file, atoms=atoms))
    assert line.startswith(f"{dictionary_file}:/atoms[3]: landmark 'left hand' is (1e+200, ")


@pytest.mark.parametrize("mean", [np.ones((4, 3)), np.zeros((4, 3))])
def test_a_mean_shape_must_be_a_shape(dictionary_file, edit, problems, mean):
    (line,) = problems(read_dictionary, edit(dictionary_file, mean_shape=mean))
    assert line == (
        f"{dictionary_file}:/mean_shape: all its landmarks are at one point; "
        "make the dictionary again"
    )
