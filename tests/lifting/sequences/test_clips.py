"""Clips of a file: error bars of frames with errors in common, the scale of their
accelerations, and growth.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.lifting.sequences.clips import (
    MIN_CLIP_FRAMES,
    Clips,
    add_common_error,
    find_acceleration_scale,
    find_judging_frames,
    is_informative,
    nearest_informative,
    relative_scales,
)
from shapefit.lifting.sequences.smoothing import CONSTANTS
from shapefit.timeline import Timeline
from tests.gaussians import covariance_of_root, deviations_and_correlations

P = 4
"""Landmarks."""


def draw_covariances(rng, *shape):
    root = rng.standard_normal((*shape, 3, 3))
    return covariance_of_root(root, floor=0.1)


def test_covariances_are_added(rng):
    sequence_covariance = draw_covariances(rng, 6, P)
    image_covariance = draw_covariances(rng, 6, P)
    constant = rng.uniform(0, 2, (6, P))
    common = (constant**2)[..., None, None] * np.eye(3)
    whole = sequence_covariance + CONSTANTS.common_share**2 * image_covariance + common

    sd, correlation = add_common_error(
        deviations_and_correlations(sequence_covariance),
        deviations_and_correlations(image_covariance),
        constant,
    )

    expected_sd, expected_correlation = deviations_and_correlations(whole)
    assert_allclose(sd, expected_sd, rtol=1e-12)
    assert_allclose(correlation, expected_correlation, rtol=1e-12)


class TestNearestInformative:
    """An image that says nothing has the bars of its neighbour in the clip, if any."""

    KNOWN = np.array([1, 0, 0, 0, 1, 0, 0, 0, 1], dtype=bool)
    CLIPS = (slice(0, 5), slice(5, 7), slice(7, 9))

    def test_of_frames_one_apart(self):
        found = nearest_informative(self.KNOWN, self.CLIPS, np.arange(9.0))
        assert found.tolist() == [0, 0, 0, 4, 4, 5, 6, 8, 8]

    def test_after_a_gap_the_last_of_the_clip_is_nearer(self):
        frames = np.arange(9.0)
        frames[1:] += 3
        found = nearest_informative(self.KNOWN, self.CLIPS, frames)
        assert found.tolist() == [0, 4, 4, 4, 4, 5, 6, 8, 8]


@pytest.mark.parametrize("lag", [1, 3])
class TestAccelerationScale:
    """It is that of the motion, beside what was expected of it."""

    @pytest.fixture
    def moving(self, rng):
        """A path whose velocity drifts, smooth over four frames."""
        steps = rng.standard_normal((400, 3, 5))
        path = np.cumsum(np.cumsum(steps, axis=0), axis=0)
        return np.apply_along_axis(np.convolve, 0, path, np.ones(4) / 4, "valid")

    @pytest.fixture
    def acceleration(self, moving):
        return np.sqrt((np.diff(moving, 2, axis=0) ** 2).mean())

    @pytest.fixture
    def expected(self, acceleration):
        """Of each landmark, five times too small."""
        return np.full(5, acceleration / 5)

    def test_noise_that_forgets_itself_within_the_lag_is_no_motion(
        self, images, body, lag
    ):
        still = np.repeat(body[:1], 400, axis=0)
        scale = find_acceleration_scale(
            images(still, noise=0.05), np.full(5, 0.03), lag
        )
        assert scale == 1

    def test_a_motion_has_its_own(self, images, moving, expected, lag):
        scale = find_acceleration_scale(images(moving), expected, lag)
        assert scale == pytest.approx(5, rel=0.25 * lag)

    def test_jumps_of_landmarks_are_no_motion(
        self, images, rng, moving, acceleration, expected, lag
    ):
        seen = images(moving)
        jumps = 100 * acceleration * rng.standard_normal(seen.landmarks.shape)
        jumps[rng.random(len(jumps)) > 0.03] = 0
        jumping = replace(seen, landmarks=seen.landmarks + jumps)
        assert find_acceleration_scale(jumping, expected, lag) < 10

    def test_three_frames_show_none(self, images, body, expected, lag):
        short = images(body[:3])
        assert find_acceleration_scale(short, expected, lag) == 1


def test_a_window_of_one_frame_smooths_nothing(rng):
    """As at low frame rates."""
    level = rng.standard_normal(20)
    all_there = np.ones(20, dtype=bool)

    found = relative_scales(np.exp(level), all_there, 0.01, Timeline.of_frames(20))

    assert_allclose(np.log(found), level - level.mean(), atol=1e-12)


@pytest.mark.parametrize("width", [2.0, 30.0])
class TestGrowth:
    """It is a line through what is near each frame, without its mean."""

    T = np.arange(20)
    TIMELINE = Timeline.of_frames(20)

    def fit_line(self, level, frame, width):
        """Return the value at a frame by weighted least squares."""
        away = self.T - frame
        weights = np.exp(-0.25 * (away / width) ** 2)
        _, value = np.polyfit(away, level, 1, w=weights)
        return value

    def test_of_levels_at_random(self, rng, width):
        level = rng.standard_normal(20)
        expected = np.array([self.fit_line(level, frame, width) for frame in self.T])
        all_there = np.ones(20, dtype=bool)

        found = relative_scales(np.exp(level), all_there, width, self.TIMELINE)

        assert_allclose(np.log(found), expected - expected.mean(), atol=2e-3)

    def test_what_is_a_line_stays_one_over_frames_that_are_not_there(self, width):
        there = np.ones(20, dtype=bool)
        there[[0, 7, 8]] = False
        nearer = np.where(there, np.exp(0.1 * self.T), np.nan)
        line = 0.1 * (self.T - self.T[there].mean())

        found = relative_scales(nearer, there, width, self.TIMELINE)

        assert_allclose(np.log(found)[1:], line[1:], atol=1e-4)


@pytest.mark.parametrize("scale", [0.01, 1.0, 500.0])
class TestInformative:
    """An image says something where its bars are narrower than a share of its size,
    whatever the unit.
    """

    N = 3

    def clips_with(self, rng, scale, width):
        """Return clips whose bars have a root mean square of so many sizes."""
        deviation = rng.uniform(0.5, 2, (self.N, 3, P))
        deviation *= (
            width * scale / np.sqrt((deviation**2).mean(axis=(1, 2)))[:, None, None]
        )
        return Clips(
            landmarks=np.zeros((self.N, 2, P)),
            trust=np.ones((self.N, P)),
            points=np.zeros((self.N, 3, P)),
            scale=np.full(self.N, scale),
            centre=np.zeros((self.N, 2)),
            modes=None,
            residual_variance=0.01,
            noise=None,
            deviation=deviation,
            position=np.arange(self.N),
        )

    def test_narrow_bars_are_informative(self, rng, scale):
        clips = self.clips_with(rng, scale, 0.99 * CONSTANTS.max_deviation)
        assert is_informative(clips).all()

    def test_wide_bars_are_not(self, rng, scale):
        clips = self.clips_with(rng, scale, 1.01 * CONSTANTS.max_deviation)
        assert not is_informative(clips).any()

    def test_nor_is_an_image_without_a_point(self, rng, scale):
        clips = self.clips_with(rng, scale, 0.5)
        clips.points[1, 2, 0] = np.nan
        assert is_informative(clips).tolist() == [True, False, True]


class TestFramesThatJudgeAStretch:
    """Whether it has moved too far."""

    def test_enough_informative_frames_of_its_own_do(self):
        informative = np.ones(12, dtype=bool)
        informative[5] = False
        stretch = slice(4, 5 + MIN_CLIP_FRAMES)
        own = [4, *range(6, 5 + MIN_CLIP_FRAMES)]
        assert len(own) == MIN_CLIP_FRAMES
        assert find_judging_frames(stretch, informative).tolist() == own

    def test_with_fewer_those_of_the_sequence_do(self):
        informative = np.ones(12, dtype=bool)
        informative[[2, 5]] = False
        stretch = slice(4, 4 + MIN_CLIP_FRAMES)
        everywhere = np.flatnonzero(informative).tolist()
        assert find_judging_frames(stretch, informative).tolist() == everywhere
