"""Posteriors given usual lengths of limbs, beside modes conditioned one by one in plain
NumPy.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize

from shapefit.arrays import Floats
from shapefit.dictionary.bodies import find_limbs, precision_of_ratios
from shapefit.dictionary.model import Dictionary
from shapefit.lifting.posterior.usual_lengths import LimbLengths, find_limb_lengths
from tests.lifting.posterior.dense import log_det
from tests.lifting.posterior.scenes import draw_images, solve
from tests.points import chain, draw_rotations, edge_lengths

P = 7
"""Landmarks."""

STEPS = 3
"""Linearisations of the lengths."""

LIMBS = np.array([[0, 1], [1, 2], [3, 4], [4, 5]])
RESIDUAL_VARIANCE = 0.003
IMAGES = 30


@pytest.fixture
def prior(draw_mixture):
    return draw_mixture(4, k=3, p=P)


@pytest.fixture
def lengths(prior):
    """Limbs somewhat longer and shorter than in the mean of the first component."""
    usual = log_lengths(prior.means[0]) + np.array([0.3, -0.2, 0.1, 0.0])
    precision = precision_of_ratios(0.02 * (np.eye(4) + 0.5))
    return LimbLengths(LIMBS, usual, precision)


def find(prior, lengths=None, modes=0):
    """The posterior of images of the prior from several views."""
    _, w, R = draw_images(prior, IMAGES, 2, RESIDUAL_VARIANCE)
    others = draw_rotations(IMAGES, 4, np.random.default_rng(3))
    starts = np.concatenate([R[:, None], others], axis=1)
    options = {"lengths": lengths, "modes": modes, "covariance": True}
    return solve(prior, w, starts, RESIDUAL_VARIANCE, **options)


def log_lengths(y):
    """Return the logarithms of the lengths of limbs, of one shape or of several."""
    if y.ndim == 2:
        return log_lengths(y[None])[0]
    return np.log(edge_lengths(y, LIMBS))


def slope_of_lengths(y):
    """The derivative (e, 3p) of the logarithms of the lengths."""
    J = np.zeros((len(LIMBS), 3, P))
    for row, (i, j) in enumerate(LIMBS):
        bone = y[:, i] - y[:, j]
        J[row, :, i] = bone / (bone @ bone)
        J[row, :, j] = -J[row, :, i]
    return J.reshape(len(LIMBS), 3 * P)


def energy(y, m, C, lengths):
    """Twice the negative log density of a mode and of the lengths of its limbs."""
    away = (y - m).ravel()
    excess = log_lengths(y) - lengths.log_length
    return away @ np.linalg.pinv(C) @ away + excess @ lengths.precision @ excess


@dataclass(frozen=True)
class Conditioned:
    """A mode given usual lengths."""

    mean: Floats
    covariance: Floats
    lost: float
    """Of its log evidence."""


def condition(m, C, lengths) -> Conditioned:
    """Condition a mode of mean m and covariance C, in information form.

    The mean depth of a mode is 0 for certain: C has no inverse but on the rest.
    """
    Q = lengths.precision
    information = np.linalg.pinv(C, rcond=1e-10)
    y = m
    for _ in range(STEPS):
        J = slope_of_lengths(y)
        excess = log_lengths(y) - lengths.log_length
        ahead = excess + J @ (m - y).ravel()
        covariance = C @ np.linalg.inv(np.eye(3 * P) + J.T @ Q @ J @ C)
        linearised_at = y
        y = m - (covariance @ J.T @ Q @ ahead).reshape(3, P)
    away = (y - m).ravel()
    strained = log_lengths(linearised_at) - lengths.log_length
    least = away @ information @ away + strained @ Q @ strained
    narrowing = log_det(np.eye(len(J)) + Q @ J @ C @ J.T)
    return Conditioned(y, covariance, (least + narrowing) / 2)


@dataclass(frozen=True)
class Combined:
    """The mixture of the conditioned modes of one image."""

    mean: Floats
    covariance: Floats
    gain: float
    """Of its log evidence."""
    best: int
    """The mode with the largest share."""
    share_of_second: float


def combine(modes, image, lengths) -> Combined:
    """Condition the modes of an image one by one, and mix them by what is left of their
    evidence.
    """
    numbers = np.flatnonzero(modes.component[image] >= 0)
    evidence = modes.log_evidence[image][numbers]
    conditioned = [
        condition(modes.mean[image, m], modes.covariance[image, m], lengths)
        for m in numbers
    ]
    left = evidence - [mode.lost for mode in conditioned]
    total = np.logaddexp.reduce(left)
    share = np.exp(left - total)
    means = np.stack([mode.mean for mode in conditioned])
    covariances = np.stack([mode.covariance for mode in conditioned])

    mean = np.tensordot(share, means, axes=1)
    apart = (means - mean).reshape(len(numbers), -1)
    within = np.tensordot(share, covariances, axes=1)
    between = np.einsum("m,mi,mj->ij", share, apart, apart)
    return Combined(
        mean=mean,
        covariance=within + between,
        gain=total - np.logaddexp.reduce(evidence),
        best=numbers[np.argmax(share)],
        share_of_second=np.sort(share)[-2] if len(share) > 1 else 0.0,
    )


class TestMixture:
    """The mixture given lengths is that of modes conditioned one by one."""

    MODES = 30

    @pytest.fixture
    def before(self, prior):
        """Without lengths, with all modes."""
        before = find(prior, modes=self.MODES)
        count = (before.modes.component >= 0).sum(axis=1)
        assert count.max() < self.MODES
        return before

    @pytest.fixture
    def combined(self, before, lengths):
        return [combine(before.modes, image, lengths) for image in range(IMAGES)]

    @pytest.fixture
    def found(self, prior, lengths):
        return find(prior, lengths)

    def test_several_images_have_more_than_one_mode(self, combined):
        has_several = [image.share_of_second > 0.05 for image in combined]
        assert sum(has_several) >= 3

    def test_means_and_covariances(self, found, combined):
        means = [image.mean for image in combined]
        covariances = [image.covariance for image in combined]
        assert_allclose(found.mean, means, atol=1e-6)
        assert_allclose(found.covariance, covariances, atol=1e-6)

    def test_deviations_and_correlations(self, found, combined):
        covariance = np.stack([image.covariance for image in combined])
        blocks = covariance.reshape(IMAGES, 3, P, 3, P)
        variance = np.einsum("napap->nap", blocks)
        xz = np.einsum("npp->np", blocks[:, 0, :, 2])
        correlation = xz / np.sqrt(variance[:, 0] * variance[:, 2])
        assert_allclose(found.deviation**2, variance, atol=1e-6)
        assert_allclose(found.correlation[:, 1], correlation, atol=1e-5)

    def test_evidence(self, found, before, combined):
        gain = [image.gain for image in combined]
        found_gain = found.log_evidence - before.log_evidence
        assert_allclose(found_gain, gain, rtol=0, atol=1e-5)

    def test_the_view_is_that_of_the_mode_with_the_largest_share(
        self, found, before, combined
    ):
        images = np.arange(IMAGES)
        best = [image.best for image in combined]
        assert_allclose(found.rotation, before.modes.rotation[images, best])
        assert found.scale == pytest.approx(before.modes.scale[images, best])


def test_a_mode_moves_to_where_both_are_likeliest(prior, lengths):
    """By a minimiser that knows no derivative of the lengths."""
    modes = find(prior, modes=1).modes
    m = modes.mean[0, 0]
    C = modes.covariance[0, 0]
    U, variances, _ = np.linalg.svd(C)
    root = U * np.sqrt(variances)

    def energy_at(x):
        return energy(m + (root @ x).reshape(3, P), m, C, lengths)

    best = minimize(energy_at, np.zeros(3 * P), method="BFGS")

    found = energy(condition(m, C, lengths).mean, m, C, lengths)

    assert found < best.fun + 1e-3
    assert found < energy(m, m, C, lengths) - 0.1


def test_the_size_of_a_body_is_free(prior, lengths):
    three_times = lengths._replace(log_length=lengths.log_length + np.log(3.0))

    found = find(prior, lengths)
    other = find(prior, three_times)

    assert_allclose(other.mean, found.mean, atol=1e-9)
    assert_allclose(other.covariance, found.covariance, atol=1e-9)


def test_firm_lengths_give_limbs_their_ratios(prior, lengths):
    """In images of one mode."""
    firm = lengths._replace(precision=1e5 * lengths.precision)

    def error_of_ratios(posterior):
        excess = log_lengths(posterior.mean) - lengths.log_length
        return np.ptp(excess, axis=1)

    before = find(prior, modes=1)
    found = find(prior, firm)

    has_one = np.isfinite(before.modes.log_evidence).sum(axis=1) == 1
    error_before = np.median(error_of_ratios(before)[has_one])
    assert np.median(error_of_ratios(found)[has_one]) < 0.15 * error_before


def test_stored_modes_are_those_without_lengths(prior, lengths):
    before = find(prior, modes=4).modes
    found = find(prior, lengths, modes=4).modes
    for name, values in before._asdict().items():
        assert_array_equal(getattr(found, name), values)


def test_lengths_that_no_mode_has_leave_numbers(prior, lengths):
    """Evidence falls by thousands; shares are what is left beside the best."""
    impossible = np.array([9.0, -9.0, 9.0, -9.0])
    found = find(prior, LimbLengths(LIMBS, impossible, 1e3 * lengths.precision))
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.log_evidence).all()


class TestLimbLengths:
    """Only limbs of people have usual lengths."""

    NAMES = ("pelvis", "lhip", "lknee", "lankle", "head")
    EDGES = np.array([[0, 1], [1, 2], [2, 3], [0, 4]])

    @pytest.fixture
    def dictionary(self):
        return Dictionary(
            atoms=np.zeros((1, 3, 5)),
            landmark_names=self.NAMES,
            mean_shape=np.zeros((3, 5)),
            edges=self.EDGES,
            edge_length=np.array([0.1, 0.4, 0.3, 0.5]),
            edge_covariance=0.01 * np.eye(4),
        )

    def test_thigh_and_shank_are_limbs(self):
        is_limb = find_limbs(self.NAMES, self.EDGES)
        assert is_limb.tolist() == [False, True, True, False]

    def test_their_lengths_are_those_of_the_dictionary(self, dictionary):
        lengths = find_limb_lengths(dictionary)
        assert lengths.limbs.tolist() == [[1, 2], [2, 3]]
        assert_allclose(np.exp(lengths.log_length), [0.4, 0.3])

    def test_their_precision_is_of_ratios(self, dictionary):
        precision = find_limb_lengths(dictionary).precision
        assert_allclose(precision.sum(axis=1), 0, atol=1e-9)

    def test_a_dictionary_without_lengths_has_none(self, dictionary):
        without_lengths = replace(dictionary, edge_length=None)
        assert find_limb_lengths(without_lengths) is None

    def test_a_dictionary_of_other_landmarks_has_none(self, dictionary):
        renamed = replace(dictionary, landmark_names=tuple("abcde"))
        assert find_limb_lengths(renamed) is None


@pytest.mark.parametrize(
    ("hip", "knee", "limb"),
    [
        ("lhip", "lknee", True),
        ("LHip", "LKnee", True),
        ("left_hip", "left_knee", True),
        ("Hip.R", "Knee.R", True),
        ("hip_right", "knee_right", True),
        ("lhip", "lankle", False),
        ("pelvis", "lknee", False),
        ("whip", "lknee", False),
    ],
)
def test_limbs_are_known_by_the_names_of_their_joints(hip, knee, limb):
    names = (hip, knee, "l_elbow", "l_wrist")
    is_limb = find_limbs(names, np.array([[0, 1], [2, 3]]))
    assert is_limb.tolist() == [limb, True]


def test_an_animal_with_paws_has_no_limbs_of_people():
    names = ("left_hip", "left_knee", "left_hind_paw")
    assert not find_limbs(names, chain(3)).any()
