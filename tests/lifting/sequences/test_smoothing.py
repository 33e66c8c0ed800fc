"""The inference over a sequence against its objective written out densely, and a frame
by itself.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.arrays import Floats
from shapefit.lifting.sequences import smoothing
from shapefit.lifting.sequences.smoothing import (
    Lengths,
    Observations,
    find_precisions,
    mean_lengths,
    smooth,
)
from shapefit.timeline import Timeline
from tests.gaussians import covariance_of_root
from tests.lifting.sequences.conftest import without_bones
from tests.lifting.sequences.dense_objective import Objective


@pytest.mark.parametrize("p", [1, 3, 5])
class TestPrecisions:
    """Precisions are inverses of grown covariances, in place, where there are any."""

    @pytest.fixture
    def covariances(self, rng, p):
        """Of the first image they are not known."""
        root = rng.standard_normal((70, 2, 3 * p, 3 * p))
        covariances = covariance_of_root(root)
        covariances[0] = np.nan
        return covariances

    @pytest.fixture
    def more(self, rng):
        """Variance that is added."""
        return rng.uniform(0.1, 1, (70, 2))

    @pytest.fixture
    def there(self, rng):
        """Which of the modes are there."""
        return rng.random((70, 2)) < 0.8

    @pytest.fixture
    def factor(self, rng):
        factor = rng.uniform(0.5, 2, (70, 2))
        factor[0] = 0
        return factor

    def test_they_are_inverses(self, covariances, factor, more, there, p):
        known = np.nan_to_num(covariances)
        identity = np.eye(3 * p)
        grown = factor[..., None, None] * known + more[..., None, None] * identity

        found, log_det = find_precisions(covariances, factor, more, there)

        product = (found @ grown)[there]
        expected = np.broadcast_to(identity, product.shape)
        assert_allclose(product, expected, atol=1e-8)
        assert_allclose(log_det[there], np.linalg.slogdet(grown)[1][there])

    def test_the_others_stay(self, covariances, factor, more, there):
        others = covariances[~there].copy()
        found, _ = find_precisions(covariances, factor, more, there)
        assert_array_equal(found[~there], others)


def with_gaps(model, frames):
    """The model of frames of which some are missing, after the fourth for a second."""
    position = np.cumsum([0.0, 1, 3, 1, 24, 2, 1, 1, 5])[:frames]
    return replace(model, timeline=Timeline(position, 24.0))


def with_known_lengths(model, body):
    """The model of bones of which three are usually longer or shorter than they are."""
    usual = mean_lengths(body, model.bones) * [1.3, 1, 0.8, np.nan]
    is_known = np.array([1.0, 1, 1, 0])
    precision = np.diag(is_known) - 0.2 * np.outer(is_known, is_known)
    return replace(model, usual=Lengths(usual, precision / 0.002**2))


NOISE = 0.1
DAMPING = 0.1
LONGEST_STEP = 0.5


@pytest.mark.parametrize("case", ["free", "known lengths", "far", "gaps"])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 9])
class TestFirstStep:
    """It is that of the dense system, damped, half a unit at most."""

    @pytest.fixture
    def visible(self, images, body, case, frames):
        visible = images(body[:frames], noise=0.02, depth=0.1)
        if case == "far":
            return replace(visible, start=visible.start + 2)
        return visible

    @pytest.fixture
    def case_model(self, model, body, case, frames):
        if case == "known lengths":
            return with_known_lengths(model, body)
        return with_gaps(model, frames) if case == "gaps" else model

    @pytest.fixture
    def judge(self, visible, case_model):
        return Objective(visible, case_model, NOISE)

    @pytest.fixture
    def lengths(self, visible, case_model):
        """From which smoothing starts."""
        return mean_lengths(visible.start, case_model.bones)

    def test_the_energy_before_it(self, visible, case_model, judge, lengths):
        before = smooth(visible, case_model, NOISE, max_rounds=0)
        expected = judge.energy(judge.start, lengths)
        assert before.energy == pytest.approx(expected)

    def test_points_and_lengths_after_it(
        self, visible, case_model, judge, lengths, case
    ):
        y = judge.start
        system = judge.system(y, DAMPING)
        step = np.linalg.solve(system, judge.gradient(y, lengths))
        point_step, length_step = np.split(step, [y.size])
        shrink = min(1.0, LONGEST_STEP / np.abs(point_step).max())
        if case == "far":
            assert shrink < 0.5

        after = smooth(visible, case_model, NOISE, max_rounds=1)

        points = y.ravel() - shrink * point_step
        assert_allclose(after.points.ravel(), points, atol=1e-6)
        assert_allclose(after.lengths, lengths - shrink * length_step, atol=1e-6)


class TestEnd:
    """It is a minimum of the dense objective."""

    NOISE = 0.02

    @pytest.fixture(autouse=True)
    def to_the_end(self, monkeypatch):
        """Go on until hardly anything is gained."""
        monkeypatch.setattr(smoothing, "MIN_FRAME_GAIN", 1e-9)

    @pytest.fixture
    def visible(self, images, body):
        return images(body, noise=0.02)

    @pytest.fixture
    def judge(self, visible, model):
        return Objective(visible, model, self.NOISE)

    @pytest.fixture
    def found(self, visible, model):
        return smooth(visible, model, self.NOISE, max_rounds=200)

    @pytest.fixture
    def y(self, found, visible):
        return found.points.reshape(len(visible), -1)

    def test_it_says_whether_it_has_come_there(self, found, visible, model):
        cut_short = smooth(visible, model, self.NOISE, max_rounds=2)
        assert found.converged
        assert not cut_short.converged

    def test_its_energy_is_that_of_its_points(self, found, judge, y):
        assert found.energy == pytest.approx(judge.energy(y, found.lengths))

    def test_the_gradient_vanishes(self, found, judge, y, visible, model):
        lengths = mean_lengths(visible.start, model.bones)
        at_start = np.abs(judge.gradient(judge.start, lengths)).max()
        at_end = np.abs(judge.gradient(y, found.lengths)).max()
        assert at_end < 1e-4 * at_start

    @pytest.mark.parametrize("seed", range(5))
    def test_every_other_motion_has_more_energy(self, found, judge, y, seed):
        away = 0.01 * np.random.default_rng(seed).standard_normal(y.shape)
        assert judge.energy(y + away, found.lengths) > found.energy


def only_mode(visible):
    """The images with their first modes alone."""
    names = ("log_share", "mean", "precision", "log_det")
    first = {name: getattr(visible, name)[:, :1].copy() for name in names}
    return replace(visible, **first)


def correlations_of(covariance, frames):
    """Return the correlations (t, 3, p) of coordinates xy, xz and yz of each landmark
    of each frame.
    """
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    blocks = correlation.reshape(frames, 3, 5, frames, 3, 5)
    landmark_correlations = np.einsum("tajtbj->tabj", blocks)
    return landmark_correlations[:, [0, 0, 1], [1, 2, 2]]


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("frames", [1, 2, 5])
def test_deviations_are_those_of_the_dense_hessian(images, body, model, frames, gaps):
    """Of the whole energy, by differences of its gradient: bones that are too short
    count, too, by which the bars are not those with directions of bones held.
    """
    noise = 0.03
    visible = only_mode(images(body[:frames], noise=0.02))
    loose = replace(model, bone_tolerance=np.full(4, 0.1))
    if gaps:
        loose = with_gaps(loose, frames)

    found = smooth(visible, loose, noise, max_rounds=100)

    judge = Objective(visible, loose, noise)
    y = found.points.reshape(frames, -1)
    covariance = np.linalg.inv(judge.hessian(y, found.lengths))
    blocks = covariance.reshape(frames, 15, frames, 15)
    frame_covariances = np.einsum("tatb->tab", blocks)
    sd = np.sqrt(np.diag(covariance))
    assert_allclose(found.covariance, frame_covariances, atol=1e-5)
    assert_allclose(found.deviation.ravel(), sd, rtol=1e-3)
    correlations = correlations_of(covariance, frames)
    assert_allclose(found.correlation, correlations, atol=1e-3)
    with_directions_held = np.linalg.inv(judge.matrix(y))
    ratio = np.sqrt(np.diag(with_directions_held)) / sd
    assert frames == 1 or np.abs(ratio - 1).max() > 0.02


def log_det(matrices: Floats) -> Floats:
    return np.linalg.slogdet(matrices)[1]


@pytest.mark.parametrize("apart", [1.0, 4.0])
@pytest.mark.parametrize("weighted", [False, True])
class TestFrameByItself:
    """It has the covariance of its mixture: two modes so many standard deviations
    apart, and the landmarks, which are Gaussians multiplied in NumPy.
    """

    LOG_SHARE = np.log([0.6, 0.4])
    RESIDUAL_VARIANCE = 0.2**2

    @pytest.fixture
    def mode_covariances(self, rng):
        samples = 0.2 * rng.standard_normal((2, 15, 40))
        return np.stack([np.cov(mode_samples) for mode_samples in samples])

    @pytest.fixture
    def mode_means(self, rng, mode_covariances, apart):
        distance = np.array([[0.0], [apart * 0.2]])
        return rng.standard_normal(15) + distance

    @pytest.fixture
    def landmarks(self, mode_means):
        return mode_means[0, :10] + 0.05

    @pytest.fixture
    def landmark_weight(self, weighted):
        """Precision of what the landmarks say beside the modes."""
        return 30.0 if weighted else 0.0

    @pytest.fixture
    def found(self, model, mode_covariances, mode_means, landmarks, landmark_weight):
        visible = Observations(
            landmarks=landmarks.reshape(1, 2, 5),
            trust=np.ones((1, 5)),
            start=mode_means[:1].reshape(1, 3, 5),
            residual_variance=self.RESIDUAL_VARIANCE,
            log_share=self.LOG_SHARE[None],
            mean=mode_means[None],
            precision=np.linalg.inv(mode_covariances)[None],
            log_det=log_det(mode_covariances)[None],
            growth=np.ones(1),
        )
        noise = (1 / self.RESIDUAL_VARIANCE + landmark_weight) ** -0.5
        return smooth(visible, without_bones(model), noise, max_rounds=50)

    @pytest.fixture
    def covariance(self, mode_covariances, mode_means, landmarks, landmark_weight):
        """Of the mixture of both modes times the landmarks."""
        weight = np.diag(np.repeat([landmark_weight, 0.0], [10, 5]))
        w = np.append(landmarks, np.zeros(5))
        means = []
        covariances = []
        log_shares = []
        for share, mean, C in zip(
            self.LOG_SHARE, mode_means, mode_covariances, strict=True
        ):
            P = np.linalg.inv(C)
            product = np.linalg.inv(P + weight)
            middle = product @ (P @ mean + weight @ w)
            from_mode = middle - mean
            from_landmarks = middle - w
            mode_term = from_mode @ P @ from_mode
            landmark_term = from_landmarks @ weight @ from_landmarks
            narrowing = log_det(product) - log_det(C)
            log_shares.append(share + 0.5 * (narrowing - mode_term - landmark_term))
            means.append(middle)
            covariances.append(product)
        shares = np.exp(log_shares - np.logaddexp.reduce(log_shares))
        off = np.stack(means) - shares @ np.stack(means)
        between = np.einsum("k,ka,kb->ab", shares, off, off)
        return np.tensordot(shares, np.stack(covariances), axes=1) + between

    def test_covariance(self, found, covariance):
        assert_allclose(found.covariance[0], covariance, atol=1e-8)

    def test_deviations(self, found, covariance):
        sd = np.sqrt(np.diag(covariance))
        assert_allclose(found.deviation.ravel(), sd, rtol=1e-6)

    def test_correlations(self, found, covariance):
        """Of y and z of one landmark."""
        landmark = 3
        y = 5 + landmark
        z = 10 + landmark
        sd = np.sqrt(np.diag(covariance))
        expected = covariance[y, z] / (sd[y] * sd[z])
        assert found.correlation[0, 2, landmark] == pytest.approx(expected, abs=1e-6)
