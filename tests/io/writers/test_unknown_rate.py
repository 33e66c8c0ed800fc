"""A motion of unknown frame rate, in formats that must state one: it stays unknown."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.io.files import load_shapes, save

WITH_A_RATE = ("trc", "c3d", "bvh")
"""Formats of motions that state a frame rate."""


@pytest.mark.parametrize("suffix", WITH_A_RATE)
def test_an_unknown_rate_is_read_back_as_unknown(tmp_path, scene, suffix):
    if suffix == "c3d":
        pytest.importorskip("ezc3d")
    path = tmp_path / f"walk.{suffix}"
    unknown = scene.result.replaced(frame_rate=None, times=None)
    summary = save(path, unknown)
    assert any("the frame rate is unknown" in text for text in summary.warnings)

    shapes, notes = load_shapes(path)

    assert shapes.frame_rate is None
    assert shapes.times is None
    assert any("1 Hz stands for an unknown frame rate" in note for note in notes)


@pytest.mark.parametrize("suffix", WITH_A_RATE)
def test_a_known_rate_is_read_back(tmp_path, scene, suffix):
    if suffix == "c3d":
        pytest.importorskip("ezc3d")
    path = tmp_path / f"walk.{suffix}"
    save(path, scene.result.replaced(frame_rate=25.0, times=None))

    shapes, notes = load_shapes(path)

    assert shapes.frame_rate == pytest.approx(25.0)
    assert not any("frame rate" in note for note in notes)


def test_frames_of_an_unknown_rate_keep_their_distances(tmp_path, scene):
    path = tmp_path / "walk.trc"
    frames = np.arange(len(scene.result)) + 3
    save(path, scene.result.replaced(frame_rate=None, times=None, frames=frames))

    shapes, _ = load_shapes(path)

    assert_array_equal(shapes.frames, frames - frames[0])


@pytest.mark.parametrize("rate", ["0", "-5"])
def test_times_count_where_the_rate_is_no_rate(tmp_path, scene, rate):
    path = tmp_path / "walk.trc"
    save(path, scene.result.replaced(frame_rate=25.0, times=None))
    first, keys, values, *rest = path.read_text().split("\n")
    values = values.replace("25", rate)
    path.write_text("\n".join([first, keys, values, *rest]))

    shapes, _ = load_shapes(path)

    assert shapes.frame_rate is None
    assert_allclose(np.diff(shapes.times), 0.04)
