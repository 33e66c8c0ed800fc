"""A dictionary of sample cars and a few of their views, fitted with exports."""

import numpy as np
import pytest
import trimesh

from shapefit.io import (
    read_dictionary,
    read_shapes,
    write_dictionary,
)
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file


@pytest.fixture(scope="package")
def cars(made_cars, tmp_path_factory):
    """Return the path of the dictionary of the sample cars: 18 atoms, 3420 mesh vertices."""
    path = tmp_path_factory.mktemp("cars") / "cars.h5"
    write_dictionary(path, made_cars)
    return path


@pytest.fixture(scope="package")
def views(project):
    """Six views of sample cars, the landmarks in pixels, y down."""
    images = load(project / "sample_data/cars_views.h5")
    return images.take(slice(0, 108, 20))


@pytest.fixture(scope="package")
def people(project, exemplars, tmp_path_factory):
    """Return the path of a dictionary of sample people: edges, no mesh."""
    shapes = read_shapes([project / "sample_data/people_train.h5"]).take(slice(0, None, 120))
    path = tmp_path_factory.mktemp("people") / "people.h5"
    write_dictionary(path, exemplars(shapes))
    return path


@pytest.fixture
def run(tmp_path, cars, views, monkeypatch):
    """Return the function that fits with sections of the config; gives record and outcomes.

    Chunks are as small as `chunk` says, not whole stretches, so that a few images fill several.
    """
    monkeypatch.setattr("shapefit.pipelines.fit.lift.STRETCH", 1)

    def run_fit(images=views, dictionary=cars, output=tmp_path / "result.h5", **keys):
        settings = {"method": "convex+refine", "transforms": True} | keys
        save(tmp_path / "views.h5", images)
        return fit_file(tmp_path / "views.h5", dictionary, output, **settings)

    return run_fit


@pytest.fixture
def export(tmp_path, run):
    """Return the function that fits with keys of `export` to tmp_path/meshes."""

    def run_export(images=None, dictionary=None, fit_keys=None, **keys):
        given = {"images": images, "dictionary": dictionary}
        given = {name: value for name, value in given.items() if value is not None}
        section = {"folder": str(tmp_path / "meshes")} | keys
        return run(**given, **(fit_keys or {}), export=section)

    return run_export


@pytest.fixture(scope="package")
def car_atoms(cars):
    return read_dictionary(cars)


@pytest.fixture
def read(tmp_path):
    """Return the function that opens an exported file as it stands; gives its objects by name."""

    def read_objects(item, file_format="ply", ending=""):
        path = tmp_path / "meshes" / f"{item}{ending}.{file_format.split('-')[0]}"
        return dict(trimesh.load_scene(path, process=False, split_objects=True).geometry)

    return read_objects


@pytest.fixture
def read_one(read):
    """Return the function that opens an exported file with one object."""

    def read_only_object(item, file_format="ply", ending=""):
        (geometry,) = read(item, file_format, ending).values()
        return geometry

    return read_only_object


@pytest.fixture
def mixed():
    """Return sum_i c_i B_i of an image of a result."""

    def mix(atoms, found, image):
        return np.tensordot(found.coefficients[image], atoms, axes=1)

    return mix


@pytest.fixture
def metres(mixed):
    """Return the length of a normalised unit: the sizes of the atoms, by their parts."""

    def length(dictionary, found, image):
        norm = np.linalg.norm(dictionary.atoms, axis=(1, 2))
        share = found.coefficients[image] * norm
        size = share @ (dictionary.atom_scale * norm) / share.sum()
        return size / np.linalg.norm(mixed(dictionary.atoms, found, image))

    return length
