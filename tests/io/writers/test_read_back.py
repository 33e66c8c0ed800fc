"""What is written is read back by our readers of the same formats."""

import numpy as np
import pytest

from shapefit.io import read_shapes
from tests.io.files import save


def test_trc(tmp_path, scene):
    save(tmp_path / "man.trc", scene.result)
    back = read_shapes([tmp_path / "man.trc"])
    assert back.landmark_names == scene.result.landmark_names
    assert (back.unit, back.frame_rate) == ("m", 25)
    assert back.items == tuple(f"man/{frame}" for frame in range(7, 11))
    np.testing.assert_allclose(back.shapes, scene.y_up, atol=1e-12)


def test_c3d(tmp_path, scene):
    pytest.importorskip("ezc3d")
    save(tmp_path / "man.c3d", scene.result)
    back = read_shapes([tmp_path / "man.c3d"])
    assert back.landmark_names == scene.result.landmark_names
    assert back.frame_rate == 25
    size = {"m": 1.0, "mm": 0.001}[back.unit]
    np.testing.assert_allclose(size * back.shapes, scene.y_up, atol=1e-6)
