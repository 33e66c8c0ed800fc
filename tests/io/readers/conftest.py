"""Made points, files of detectors, and what an error says of a file."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import open_landmarks
from shapefit.io.options import InputOptions
from shapefit.io.records import LandmarkSet


def read_images(*paths: Path, **options: Any) -> tuple[LandmarkSet, tuple[str, ...]]:
    """Return all images of these files, and the warnings."""
    with open_landmarks(list(paths), InputOptions(**options)) as source:
        return source.whole(), source.notes


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
    return lambda path, **options: read_images(path, **options)[0]


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


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """Write contents as JSON (or text) under a name, and return the path."""

    def write(name: str, contents: Any) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        text = contents if isinstance(contents, str) else json.dumps(contents)
        path.write_text(text, encoding="utf-8")
        return path

    return write
