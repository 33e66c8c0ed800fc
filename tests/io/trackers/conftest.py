"""Made points, and what an error says of a file."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks
from shapefit.io.records import LandmarkSet


@pytest.fixture
def points(rng) -> np.ndarray:
    """Seven frames of two animals of four landmarks, one of which is missing once."""
    points = rng.integers(1, 600, (7, 2, 4, 2)).astype(float)
    points[3, 1, 2] = np.nan
    return points


@pytest.fixture
def confidence(rng) -> np.ndarray:
    return np.round(rng.uniform(0.25, 1, (7, 2, 4)) * 64) / 64


@pytest.fixture
def read() -> Callable[..., LandmarkSet]:
    def read(path: Path, *options) -> LandmarkSet:
        with open_landmarks([path], *options) as source:
            (landmarks,) = source.chunks(max(source.count, 1))
            return landmarks

    return read


@pytest.fixture
def problem(read) -> Callable[[Path], str]:
    """The error of a file that must not be read, without its path."""

    def problem(path: Path) -> str:
        with pytest.raises(InputError) as error:
            read(path)
        text = str(error.value)
        assert text.startswith(str(path)), text
        return text.removeprefix(str(path))

    return problem
