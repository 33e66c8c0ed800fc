"""What images say of a sequence: frames without modes, and units of their own."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.lifting.sequences.smoothing import CONSTANTS, fill_missing_frames, observe


class TestFramesWithoutModes:
    """They lie between their neighbours."""

    @pytest.fixture
    def visible(self, images, body):
        return images(body)

    @pytest.fixture
    def known(self, visible):
        known = np.ones(len(visible), dtype=bool)
        known[[0, 4, 5]] = False
        return known

    def test_the_first_is_as_the_second(self, visible, known):
        filled = fill_missing_frames(visible.start, known)
        assert_allclose(filled[0], visible.start[1])

    def test_others_are_interpolated(self, visible, known):
        filled = fill_missing_frames(visible.start, known)
        between = (2 * visible.start[3] + visible.start[6]) / 3
        assert_allclose(filled[4], between)

    def test_without_any_frame_there_is_none(self, visible, known):
        with pytest.raises(ValueError, match="no frame"):
            fill_missing_frames(visible.start, np.zeros_like(known))

    def test_they_say_nothing(self, visible, known):
        n = len(visible)
        log_evidence = np.zeros((n, 2))
        log_evidence[~known] = -np.inf
        modes = np.repeat(visible.start[:, None], 2, axis=1)
        covariance = np.tile(np.eye(15), (n, 2, 1, 1))

        blind = observe(
            visible.landmarks,
            np.ones((n, 5)),
            visible.start,
            log_evidence,
            modes,
            covariance,
            0.01,
        )

        assert blind.trust[0].sum() == 0
        assert blind.precision[0, 0, 0, 0] == pytest.approx(CONSTANTS.max_deviation**-2)


class TestUnitOfEachFrame:
    """Images that are observed in a unit of each frame are those grown by it."""

    @pytest.fixture
    def growth(self, rng, body):
        return np.exp(rng.uniform(-0.2, 0.2, len(body)))

    @pytest.fixture
    def visible(self, growth, images, body):
        return images(body, noise=0.02)

    @pytest.fixture
    def grown(self, visible, growth):
        return visible.in_larger_unit(growth)

    def test_points(self, grown, visible, growth):
        unit = growth[:, None, None]
        assert_allclose(grown.start * unit, visible.start)
        assert_allclose(grown.mean * unit, visible.mean)

    def test_covariances(self, grown, visible, growth):
        square = growth[:, None, None, None] ** 2
        expected = np.linalg.inv(visible.precision) / square
        precision = grown.growth[:, None, None, None] ** 2 * grown.precision
        assert_allclose(np.linalg.inv(precision), expected)
        assert_allclose(grown.log_det, np.linalg.slogdet(expected)[1])
