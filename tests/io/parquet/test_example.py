"""The example of docs/files.md writes a file that is read as it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from shapefit.io import open_landmarks


def test_the_example_is_read(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (project / "docs/files.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(example, "docs/files.md", "exec"), names)
    with open_landmarks([Path("landmarks.parquet")]) as source:
        images = source.whole()
    np.testing.assert_array_equal(images.landmarks, np.swapaxes(names["points"], 1, 2))
    assert images.landmark_names == ("nose", "tail", "left ear")
    assert (images.unit, images.y_axis) == ("px", "down")
    assert images.items[7] == "film/000007"
