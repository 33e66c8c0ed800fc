"""Known lengths of bones beside those of many images, which share their errors."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.lifting.sequences import smoothing
from shapefit.lifting.sequences.clips import weigh_lengths
from shapefit.lifting.sequences.smoothing import CONSTANTS, Lengths, smooth
from tests.points import edge_lengths


class TestSharedErrors:
    """The last bone is too short alike in all frames: many copies say no more of it
    than some do.
    """

    @pytest.fixture
    def true_lengths(self, body, model):
        return edge_lengths(body[:1], model.bones)[0]

    @pytest.fixture
    def usual(self, true_lengths):
        return Lengths(true_lengths, np.eye(4) / 0.03**2)

    @pytest.fixture
    def error_of_last(self, images, body, model, true_lengths, monkeypatch):
        """Return the function that finds its error beside the others, as a log."""
        monkeypatch.setattr(smoothing, "MIN_FRAME_GAIN", 1e-9)
        short = body[:1].copy()
        short[..., 4] = 0.6 * short[..., 4] + 0.4 * short[..., 1]

        def error_of_last(usual, frames):
            still = np.repeat(short, frames, axis=0)
            visible = images(still, depth=0.2, sure=0.2)
            known = replace(model, usual=usual)
            found = smooth(visible, known, 0.1, max_rounds=50).lengths
            ratio = found / true_lengths
            return np.log(ratio[:3].mean() / ratio[3])

        return error_of_last

    def test_they_do_not_outweigh_known_lengths(self, usual, error_of_last):
        unweighed = error_of_last(usual, 200)
        weighed = error_of_last(weigh_lengths(usual, 200), 200)
        assert weighed < 0.7 * unweighed

    def test_ten_times_as_many_frames_say_no_more(self, usual, error_of_last):
        few = error_of_last(weigh_lengths(usual, 20), 20)
        many = error_of_last(weigh_lengths(usual, 200), 200)
        assert many == pytest.approx(few, rel=0.1)


def random_matrix(rng):
    """Draw a covariance (4, 4)."""
    return np.cov(rng.standard_normal((4, 20)))


@pytest.mark.parametrize("frames", [1, 20, 400])
def test_images_and_known_lengths_are_weighed_by_their_variances(rng, frames):
    """Of lengths l that t images give with variance P (1 / t + r^2), and usual ones
    with Q^-1.
    """
    P = random_matrix(rng)
    Q = random_matrix(rng)
    measured, usual = rng.standard_normal((2, 4))
    variance = P * (1 / frames + CONSTANTS.common_share**2)
    exact = np.linalg.inv(variance)
    expected = np.linalg.solve(exact + Q, exact @ measured + Q @ usual)

    weighed = weigh_lengths(Lengths(usual, Q), frames).precision

    taken_for = frames * np.linalg.inv(P)
    both = taken_for @ measured + weighed @ usual
    assert_allclose(np.linalg.solve(taken_for + weighed, both), expected)
