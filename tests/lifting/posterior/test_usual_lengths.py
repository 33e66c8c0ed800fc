"""Posteriors given usual lengths of limbs, beside modes conditioned one by one in plain
NumPy.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize

from shapefit.dictionary.bodies import find_limbs, precision_of_ratios
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.posterior.usual_lengths import LimbLengths, find_limb_lengths
from tests.lifting.posterior.scenes import draw_images, solve

P = 7
STEPS = 3
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
    return LimbLengths(LIMBS, usual, precision_of_ratios(0.02 * (np.eye(4) + 0.5)))


def find(prior, lengths=None, modes=0):
    """The posterior of images of the prior from several views."""
    _, w, R = draw_images(prior, IMAGES, 2, RESIDUAL_VARIANCE)
    others = random_rotations(4 * IMAGES, np.random.default_rng(3))
    starts = np.concatenate([R[:, None], others.reshape(IMAGES, 4, 3, 3)], axis=1)
    return solve(
        prior,
        w,
        starts,
        RESIDUAL_VARIANCE,
        lengths=lengths,
        modes=modes,
        covariance=True,
    )


def log_lengths(y):
    bone = y[..., LIMBS[:, 0]] - y[..., LIMBS[:, 1]]
    return np.log(np.linalg.norm(bone, axis=-2))


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


def condition(m, C, lengths):
    """Mean, covariance and loss of log evidence of a mode, in information form.

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
    log_det = np.linalg.slogdet(np.eye(len(J)) + Q @ J @ C @ J.T)[1]
    return y, covariance, (least + log_det) / 2


def test_the_mixture_is_that_of_modes_conditioned_one_by_one(prior, lengths):
    before = find(prior, modes=30)
    found = find(prior, lengths)
    several = 0
    for image in range(IMAGES):
        there = np.flatnonzero(before.modes.component[image] >= 0)
        assert len(there) < 30
        each = [
            condition(
                before.modes.mean[image, mode],
                before.modes.covariance[image, mode],
                lengths,
            )
            for mode in there
        ]
        log_evidence = before.modes.log_evidence[image][there]
        left = log_evidence - [lost for _, _, lost in each]
        total = np.logaddexp.reduce(left)
        share = np.exp(left - total)
        several += np.sort(share)[-2:][0] > 0.05 and len(there) > 1
        mean = sum(a * y for a, (y, _, _) in zip(share, each, strict=True))
        covariance = np.zeros((3 * P, 3 * P))
        for a, (y, C, _) in zip(share, each, strict=True):
            apart = (y - mean).ravel()
            covariance += a * (C + np.outer(apart, apart))
        gain = total - np.logaddexp.reduce(log_evidence)

        assert_allclose(found.mean[image], mean, atol=1e-6)
        assert_allclose(found.covariance[image], covariance, atol=1e-6)
        variance = np.diagonal(covariance).reshape(3, P)
        assert_allclose(found.deviation[image] ** 2, variance, atol=1e-6)
        xz = covariance[np.arange(P), np.arange(P) + 2 * P]
        xz /= np.sqrt(variance[0] * variance[2])
        assert_allclose(found.correlation[image, 1], xz, atol=1e-5)
        assert found.log_evidence[image] - before.log_evidence[image] == (
            pytest.approx(gain, abs=1e-5)
        )
        best = there[np.argmax(share)]
        assert_allclose(found.rotation[image], before.modes.rotation[image, best])
        assert found.scale[image] == pytest.approx(before.modes.scale[image, best])
    assert several >= 3


def test_a_mode_moves_to_where_both_are_likeliest(prior, lengths):
    """By a minimiser that knows no derivative of the lengths."""
    modes = find(prior, modes=1).modes
    m, C = modes.mean[0, 0], modes.covariance[0, 0]
    y, _, _ = condition(m, C, lengths)
    root = np.linalg.svd(C)[0] * np.sqrt(np.linalg.svd(C)[1])

    def value(x):
        return energy(m + (root @ x).reshape(3, P), m, C, lengths)

    best = minimize(value, np.zeros(3 * P), method="BFGS")
    assert energy(y, m, C, lengths) < best.fun + 1e-3
    assert energy(y, m, C, lengths) < energy(m, m, C, lengths) - 0.1


def test_the_size_of_a_body_is_free(prior, lengths):
    longer = lengths._replace(log_length=lengths.log_length + np.log(3.0))
    found, other = find(prior, lengths), find(prior, longer)
    assert_allclose(other.mean, found.mean, atol=1e-9)
    assert_allclose(other.covariance, found.covariance, atol=1e-9)


def test_firm_lengths_give_limbs_their_ratios(prior, lengths):
    firm = lengths._replace(precision=1e5 * lengths.precision)
    modes = find(prior, modes=1)
    alone = np.isfinite(modes.modes.log_evidence).sum(axis=1) == 1
    found = find(prior, firm)
    excess = log_lengths(found.mean) - lengths.log_length
    ratio = np.ptp(excess, axis=1)
    before = np.ptp(log_lengths(modes.mean) - lengths.log_length, axis=1)
    assert np.median(ratio[alone]) < 0.15 * np.median(before[alone])


def test_stored_modes_are_those_without_lengths(prior, lengths):
    before, found = find(prior, modes=4), find(prior, lengths, modes=4)
    for name, values in before.modes._asdict().items():
        assert_array_equal(getattr(found.modes, name), values)


def test_lengths_that_no_mode_has_leave_numbers(prior, lengths):
    """Evidence falls by thousands; shares are what is left beside the best."""
    impossible = LimbLengths(
        LIMBS, np.array([9.0, -9.0, 9.0, -9.0]), 1e3 * lengths.precision
    )
    found = find(prior, impossible)
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.log_evidence).all()


def test_only_limbs_of_people_have_usual_lengths():
    names = ("pelvis", "lhip", "lknee", "lankle", "head")
    edges = np.array([[0, 1], [1, 2], [2, 3], [0, 4]])
    assert find_limbs(names, edges).tolist() == [False, True, True, False]
    dictionary = Dictionary(
        atoms=np.zeros((1, 3, 5)),
        landmark_names=names,
        mean_shape=np.zeros((3, 5)),
        edges=edges,
        edge_length=np.array([0.1, 0.4, 0.3, 0.5]),
        edge_covariance=0.01 * np.eye(4),
    )
    lengths = find_limb_lengths(dictionary)
    assert lengths.limbs.tolist() == [[1, 2], [2, 3]]
    assert_allclose(np.exp(lengths.log_length), [0.4, 0.3])
    assert_allclose(lengths.precision.sum(axis=1), 0, atol=1e-9)
    assert find_limb_lengths(replace(dictionary, edge_length=None)) is None
    renamed = replace(dictionary, landmark_names=("a", "b", "c", "d", "e"))
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
    assert find_limbs(names, np.array([[0, 1], [2, 3]])).tolist() == [limb, True]


def test_an_animal_with_paws_has_no_limbs_of_people():
    names = ("left_hip", "left_knee", "left_hind_paw")
    assert not find_limbs(names, np.array([[0, 1], [1, 2]])).any()
