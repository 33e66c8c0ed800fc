"""Texts that are read as motion, and records of C3D."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.errors import InputError
from tests.io.files import load_shapes
from tests.io.readers.made import read_images


@pytest.fixture
def read_motion(tmp_path):
    """Write a text under a name and read it as shapes, with warnings."""

    def read(name, text):
        path = tmp_path / name
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
        return load_shapes(path)

    return read


@pytest.fixture
def check_points():
    """Assert that shapes are these points (n, p, 3), up to 1e-6 of each."""

    def check(shapes, points) -> None:
        assert_allclose(shapes.shapes, points, rtol=1e-6)

    return check


@pytest.fixture
def table(tmp_path) -> Callable[..., Path]:
    """Write a table of this text, and return its path."""

    def write(text: str, name: str = "t.csv") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def points(rng):
    """Seven frames of two animals of four landmarks, one of which is missing once."""
    points = rng.integers(1, 600, (7, 2, 4, 2)).astype(float)
    points[3, 1, 2] = np.nan
    return points


@pytest.fixture
def confidence(rng):
    """Confidences that single precision holds as they are."""
    return np.round(rng.uniform(0.25, 1, (7, 2, 4)) * 64) / 64


@pytest.fixture
def read():
    """Read the images of a file."""

    def read(path, **options):
        images, _ = read_images(path, **options)
        return images

    return read


@pytest.fixture
def problem(read):
    """The error of a file that must not be read, without its path."""

    def problem(path):
        with pytest.raises(InputError) as error:
            read(path)
        text = str(error.value)
        assert text.startswith(str(path)), text
        return text.removeprefix(str(path))

    return problem
