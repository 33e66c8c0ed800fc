"""Dictionaries with edges and no mesh: tubes between the fitted landmarks."""

import numpy as np
import pytest

from shapefit.io import LandmarkSet, read_dictionary, read_shapes, write_dictionary
from tests.io.files import load

FORMATS = pytest.mark.parametrize("file_format", ["obj", "ply", "ply-ascii", "glb"])


@pytest.fixture
def poses(project):
    return load(project / "sample_data/people_views.csv")


@pytest.fixture
def bones(people):
    return read_dictionary(people).edges


@FORMATS
def test_people_are_a_closed_tube_a_bone(export, people, poses, bones, read_one, file_format):
    found, outcomes = export(poses, people, format=file_format, frame="camera")
    assert outcomes[-1].note == "y down in the images; 12 meshes"
    for image, item in enumerate(found.items):
        mesh = read_one(item, file_format)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        parts = mesh.split()
        assert len(parts) == len(bones)
        middles = np.array([part.vertices.mean(axis=0) for part in parts])
        expected = found.shapes[image][:, bones].mean(axis=2).T
        apart = np.linalg.norm(middles[:, None] - expected[None], axis=2)
        assert apart.min(axis=0).max() < 1e-3


def test_people_can_be_turned_back_and_measured(export, people, poses, bones, read_one, metres):
    found, _ = export(poses, people, unit="dictionary")
    dictionary = read_dictionary(people)
    for image, item in enumerate(found.items):
        parts = read_one(item).split()
        centred = found.shapes[image].copy()
        centred[:2] -= found.translation[image][:, None]
        size = metres(dictionary, found, image) / found.scale[image]
        points = size * found.rotation[image].T @ centred
        middles = np.array([part.vertices.mean(axis=0) for part in parts])
        expected = points[:, bones].mean(axis=2).T
        apart = np.linalg.norm(middles[:, None] - expected[None], axis=2)
        assert apart.min(axis=0).max() < 1e-5


@pytest.mark.real_data
@FORMATS
def test_real_wireframes(tmp_path, export, exemplars, real_data, read_one, file_format):
    shapes = read_shapes([real_data / "cars" / "fg3dcar_shapes.h5"])
    dictionary = exemplars(shapes)
    write_dictionary(tmp_path / "wires.h5", dictionary)
    images = LandmarkSet(
        landmarks=100 * dictionary.atoms[:3, :2],
        landmark_names=shapes.landmark_names,
        items=shapes.items[:3],
    )
    found, _ = export(images, tmp_path / "wires.h5", format=file_format)
    tubes = len(np.unique(np.sort(shapes.edges, axis=1), axis=0))
    for item in found.items:
        mesh = read_one(item, file_format)
        assert np.isfinite(mesh.vertices).all()
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.body_count == tubes
