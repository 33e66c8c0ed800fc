"""Texts that are read as motion, and records of C3D."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.io.files import load_shapes


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
        np.testing.assert_allclose(shapes.shapes, points, rtol=1e-6)

    return check


@pytest.fixture
def table(tmp_path) -> Callable[..., Path]:
    """Write a table of this text, and return its path."""

    def write(text: str, name: str = "t.csv") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write
