"""Dictionaries whose atoms are the shapes that they are made of."""

import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.io import read_shapes


@pytest.fixture(scope="session")
def exemplars():
    """Return the function that makes a dictionary of shapes, each an atom in their
    common frame.
    """

    def make(shapes):
        normalised = normalise(shapes.as_columns())
        mesh = shapes.mesh_vertices
        if mesh is not None:
            centred = mesh.swapaxes(1, 2) - normalised.centroid[..., None]
            mesh = centred / normalised.scale[:, None, None]
        return Dictionary(
            atoms=normalised.points,
            landmark_names=shapes.landmark_names,
            mean_shape=normalise(normalised.points.mean(axis=0)).points,
            edges=shapes.edges,
            mesh_vertices=mesh,
            mesh_faces=shapes.mesh_faces,
            atom_scale=normalised.scale,
            unit=shapes.unit,
            atom_items=shapes.items,
        )

    return make


@pytest.fixture(scope="session")
def made_cars(project, exemplars):
    """Every made car an atom, with its mesh."""
    return exemplars(read_shapes([project / "sample_data/cars.h5"]))
