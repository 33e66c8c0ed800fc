"""Files of detectors, read in one go."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from shapefit.io import LandmarkSet, open_landmarks
from shapefit.io.options import InputOptions


def read(*paths: Path, **options: Any) -> tuple[LandmarkSet, tuple[str, ...]]:
    """Return all images of these files, and the warnings."""
    with open_landmarks(list(paths), InputOptions(**options)) as source:
        (images,) = source.chunks(1_000_000)
        return images, source.notes


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
