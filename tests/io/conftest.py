"""Small records for the tests of files, and a look at what an error says."""

import dataclasses
import io
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Thread

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io import (
    write_dictionary,
    write_shapes,
)
from shapefit.records import Fit, Landmarks, Shapes
from tests.io.files import load, read_shape_file, save

NAMES = ("head", "left hand", "right hand", "foot")


@pytest.fixture
def shapes(rng) -> Shapes:
    return Shapes(
        rng.normal(size=(5, 4, 3)),
        landmark_names=NAMES,
        items=tuple(f"walk/{i}" for i in range(5)),
        sequences=("walk",) * 3 + ("run",) * 2,
        edges=np.array([[0, 1], [0, 2], [0, 3]]),
        mesh_vertices=rng.normal(size=(5, 6, 3)),
        mesh_faces=np.array([[0, 1, 2], [3, 4, 5]]),
        unit="m",
        mirror_index=np.array([0, 2, 1, 3]),
        extras={"weight": rng.normal(size=5)},
    )


@pytest.fixture
def landmarks(rng) -> Landmarks:
    points = rng.normal(size=(5, 4, 2))
    points[1, 2] = np.nan
    extras = {
        "true_rotation": rng.normal(size=(5, 3, 3)),
        "true_model": np.array(list("vwxyz"), dtype=object),
    }
    file_extras = {
        "camera_matrix": np.eye(3),
        "maker": np.array("José", dtype=object),
    }
    return Landmarks(
        points,
        confidence=rng.uniform(size=(5, 4)),
        landmark_names=NAMES,
        items=tuple(f"image {i}" for i in range(5)),
        sequences=("a", "a", "b", "b", "b"),
        unit="px",
        y_axis="down",
        extras=extras,
        file_extras=file_extras,
    )


@pytest.fixture
def results(rng, landmarks) -> Fit:
    attributes = {
        "method": "convex",
        "solve_seconds": 1.5,
        "count": 5,
        "version": "0.1.0",
    }
    return Fit(
        rng.normal(size=(5, 4, 3)),
        landmarks_fitted=rng.normal(size=(5, 4, 2)),
        coefficients=rng.normal(size=(5, 7)),
        rotation=rng.normal(size=(5, 3, 3)),
        translation=rng.normal(size=(5, 2)),
        scale=rng.normal(size=5),
        objective=rng.normal(size=5),
        relative_gap=rng.uniform(size=5),
        iterations=np.arange(5),
        status=np.array(["solved", "failed", "solved", "solved", "iteration limit"]),
        landmark_names=NAMES,
        items=landmarks.items,
        sequences=landmarks.sequences,
        transforms=rng.normal(size=(5, 7, 2, 3)),
        mesh_vertices=rng.normal(size=(5, 6, 3)),
        extras=landmarks.extras,
        file_extras=landmarks.file_extras,
        unit="px",
        y_axis="down",
        attributes=attributes,
    )


@pytest.fixture
def dictionary(rng) -> Dictionary:
    return Dictionary(
        atoms=rng.normal(size=(7, 3, 4)),
        landmark_names=NAMES,
        mean_shape=rng.normal(size=(3, 4)),
        edges=np.array([[0, 1], [2, 3]]),
        mesh_vertices=rng.normal(size=(7, 3, 6)),
        mesh_faces=np.array([[0, 1, 2]]),
        atom_scale=rng.uniform(1, 2, size=7),
        unit="m",
        atom_items=("golf", "golf", "polo", "jetta", "passat", "up", "Škoda"),
        objective_trace=rng.uniform(size=9),
        provenance={"version": "0.1.0", "config": '{"k": 7}', "inputs": "{}"},
    )


@pytest.fixture(scope="session")
def same() -> Callable[[object, object], None]:
    """Assert that two records agree field by field, to the last bit."""

    def check(one, other) -> None:
        assert type(one) is type(other)
        for field in dataclasses.fields(one):
            check_values(getattr(one, field.name), getattr(other, field.name))

    def check_values(value, found) -> None:
        if isinstance(value, Mapping):
            assert value.keys() == found.keys()
            for key in value:
                check_values(value[key], found[key])
        elif isinstance(value, np.ndarray):
            strict = value.dtype.kind not in "UO"
            assert_array_equal(value, found, strict=strict)
        elif dataclasses.is_dataclass(value):
            check(value, found)
        else:
            assert value == found

    return check


@pytest.fixture
def problems() -> Callable[..., tuple[str, ...]]:
    """Call a function that must raise InputError, and return the problems it tells."""

    def catch(function, *arguments) -> tuple[str, ...]:
        with pytest.raises(InputError) as caught:
            function(*arguments)
        return caught.value.problems

    return catch


@pytest.fixture
def run_python() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run a script in a fresh interpreter."""

    def run(script: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", script, *map(str, arguments)]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=120, check=False
        )

    return run


@pytest.fixture
def shape_file(tmp_path, shapes) -> Path:
    path = tmp_path / "shapes.h5"
    write_shapes(path, shapes)
    return path


@pytest.fixture
def landmark_file(tmp_path, landmarks) -> Path:
    path = tmp_path / "views.h5"
    save(path, landmarks)
    return path


@pytest.fixture
def result_file(tmp_path, results) -> Path:
    path = tmp_path / "result.h5"
    save(path, results)
    return path


@pytest.fixture
def dictionary_file(tmp_path, dictionary) -> Path:
    path = tmp_path / "dict.h5"
    write_dictionary(path, dictionary)
    return path


@pytest.fixture
def edit() -> Callable[..., Path]:
    """Replace datasets of an HDF5 file, or remove those that are None."""

    def change(path: Path, **datasets) -> Path:
        with h5py.File(path, "a") as file:
            for name, values in datasets.items():
                if name in file:
                    del file[name]
                if values is not None:
                    file[name] = values
        return path

    return change


@pytest.fixture
def csv_table(tmp_path) -> Callable[..., Path]:
    """Write a CSV file and return its path."""

    def write(text: str | bytes, name: str = "table.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.fixture
def fill_pipe(tmp_path):
    """Return a named pipe that a thread fills with these bytes."""
    writers = []

    def fill(data: bytes) -> Path:
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
        writer = Thread(target=pipe.write_bytes, args=(data,))
        writer.start()
        writers.append(writer)
        return pipe

    yield fill
    for writer in writers:
        writer.join()


@pytest.fixture
def standard_input(monkeypatch) -> Callable[[str], None]:
    """Put a text on standard input."""

    def give(text: str) -> None:
        stream = io.BytesIO(text.encode())
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(stream))

    return give


@pytest.fixture
def read_views():
    """Return what reads the few images of landmark files."""

    return load


@pytest.fixture
def read_one():
    """Return what reads a file of shapes."""
    return read_shape_file
