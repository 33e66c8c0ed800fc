"""How far bones turn in a clip, by which the smoothing chooses how far it may go."""

from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.lifting.sequences import clips


@pytest.mark.parametrize(("degrees", "turn"), [(0, 0.0), (180, np.sqrt(0.5)), (360, 1.0)])
def test_the_turn_of_a_bone_is_that_about_its_mean(monkeypatch, rng, degrees, turn):
    """In half a turn about the vertical a bone's projection goes from 1 to -1, as a cosine."""
    frames = 2000
    angle = np.radians(np.linspace(0, degrees, frames))
    bone = np.stack([np.cos(angle), np.sin(angle) * (degrees == 360)], axis=1)
    root = rng.standard_normal((frames, 2))
    landmarks = np.stack([root, root + bone], axis=2)
    trust = np.ones((frames, 2))
    landmarks[5, :, 1], trust[5, 1] = np.nan, 0
    seen = SimpleNamespace(trust=trust, landmarks=landmarks, start=None)
    monkeypatch.setattr(clips, "first_lengths", lambda *_: np.ones(1))
    found = clips.find_turn(seen, SimpleNamespace(bones=np.array([[1, 0]])))
    assert found == pytest.approx(turn, abs=2e-3)
