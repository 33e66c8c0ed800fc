"""Posteriors given usual lengths of limbs, beside the same by plain minimisation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from shapefit.dictionary.bodies import find_limbs, precision_of_ratios
from shapefit.dictionary.model import Dictionary
from shapefit.lifting.posterior.posterior import Modes, Posterior
from shapefit.lifting.posterior.usual_lengths import (
    LimbLengths,
    condition_modes,
    condition_on_lengths,
    find_limb_lengths,
)

P = 6
LIMBS = np.array([[0, 1], [1, 2], [3, 4], [4, 5]])
BODY = np.array(
    [
        [0.0, 0.1, 0.3, 1.0, 1.1, 1.2],
        [0.0, 1.0, 1.8, 0.0, 1.1, 2.0],
        [0.0, 0.2, 0.1, 0.1, 0.0, 0.3],
    ]
)
"""Limbs of about the usual lengths."""

LENGTHS = LimbLengths(
    LIMBS,
    np.log([1.0, 0.8, 1.1, 0.9]),
    precision_of_ratios(0.01 * (np.eye(4) + 0.5)),
)


@pytest.fixture
def modes(rng):
    """Three images of four modes, of which the first has two and the last none."""
    n, M = 3, 4
    mean = BODY + 0.1 * rng.normal(size=(n, M, 3, P))
    root = 0.1 * rng.normal(size=(n, M, 3 * P, 3 * P)) / np.sqrt(3 * P)
    covariance = root @ root.swapaxes(2, 3) + 1e-4 * np.eye(3 * P)
    log_evidence = -np.sort(rng.uniform(0, 3, size=(n, M)), axis=1)
    component = np.zeros((n, M), np.int64)
    component[0, 2:] = component[2] = -1
    log_evidence[component < 0] = -np.inf
    return Modes(
        component=component,
        rotation=rng.normal(size=(n, M, 3, 3)),
        scale=rng.uniform(1, 2, size=(n, M)),
        log_evidence=log_evidence,
        mean=mean,
        covariance=covariance,
        inlier_probability=np.ones((n, M, P)),
    )


def posterior_of(modes: Modes) -> Posterior:
    n = len(modes.component)
    return Posterior(
        mean=np.full((n, 3, P), 7.0),
        deviation=np.full((n, 3, P), 7.0),
        correlation=np.full((n, 3, P), 0.7),
        covariance=None,
        inlier_probability=np.ones((n, P)),
        rotation=np.full((n, 3, 3), 7.0),
        scale=np.full(n, 7.0),
        log_evidence=np.full(n, -5.0),
        squared_mahalanobis=np.ones(n),
        stationary=np.ones(n, bool),
        rounds=np.ones(n, np.int64),
        modes=modes,
    )


def log_lengths(y):
    bone = y[..., LIMBS[:, 0]] - y[..., LIMBS[:, 1]]
    return np.log(np.linalg.norm(bone, axis=-2))


def energy(y, m, C, lengths):
    """Twice the negative log density of a mode and of the lengths of its limbs."""
    away = (y - m).ravel()
    excess = log_lengths(y) - lengths.log_length
    return away @ np.linalg.solve(C, away) + excess @ lengths.precision @ excess


def slope_of_lengths(y, step=1e-6):
    """The derivative (e, 3p) of the logarithms of the lengths, by differences."""
    columns = []
    for change in step * np.eye(3 * P):
        change = change.reshape(3, P)
        columns.append((log_lengths(y + change) - log_lengths(y - change)) / (2 * step))
    return np.array(columns).T


def test_a_mode_moves_to_where_both_are_likeliest(modes):
    there = modes.component >= 0
    found = condition_modes(modes, there, LENGTHS)
    for y, m, C in zip(
        found.mean, modes.mean[there], modes.covariance[there], strict=True
    ):

        def value(x, m=m, C=C):
            return energy(x.reshape(3, P), m, C, LENGTHS)

        best = minimize(value, m.ravel(), method="BFGS", options={"gtol": 1e-8})
        assert value(y.ravel()) < best.fun + 1e-3
        assert value(y.ravel()) < value(m.ravel())


def test_its_covariance_and_evidence_are_those_of_the_dense_computation(modes):
    there = modes.component >= 0
    found = condition_modes(modes, there, LENGTHS)
    whole = condition_on_lengths(
        posterior_of(modes.first(1)), LENGTHS, covariance=True
    ).covariance
    first = np.flatnonzero(np.nonzero(there)[1] == 0)
    for image, row in enumerate(first):
        m, C = modes.mean[image, 0], modes.covariance[image, 0]
        J = slope_of_lengths(found.mean[row])
        precision = np.linalg.inv(C) + J.T @ LENGTHS.precision @ J
        np.testing.assert_allclose(
            whole[image], np.linalg.inv(precision), rtol=0.02, atol=2e-4
        )
        flattened = np.linalg.slogdet(precision @ C)[1]
        lost = (energy(found.mean[row], m, C, LENGTHS) + flattened) / 2
        assert found.lost_evidence[row] == pytest.approx(lost, rel=0.01, abs=0.02)


def test_limbs_of_usual_lengths_stay_where_they_are(modes):
    """Of any size: all lengths may be as many times as long as usual."""
    alone = modes.first(1)
    m = alone.mean[0, 0]
    lengths = LENGTHS._replace(log_length=log_lengths(m) - np.log(3.0))
    there = np.array([[True], [False], [False]])
    found = condition_modes(alone, there, lengths)
    np.testing.assert_allclose(found.mean[0], m, atol=1e-12)


def test_a_limb_twice_as_long_is_drawn_towards_its_length(modes):
    m = modes.mean[0, 0]
    usual = log_lengths(m) - np.array([np.log(2.0), 0, 0, 0])
    firm = LENGTHS._replace(log_length=usual, precision=1e8 * LENGTHS.precision)
    there = np.zeros((3, 4), bool)
    there[0, 0] = True
    wide = modes._replace(covariance=np.tile(0.1 * np.eye(3 * P), (3, 4, 1, 1)))
    found = condition_modes(wide, there, firm)
    ratio = np.exp(log_lengths(found.mean[0]) - usual)
    assert ratio.max() / ratio.min() == pytest.approx(1, abs=0.02)


def test_modes_are_mixed_by_what_is_left_of_their_evidence(modes):
    there = modes.component >= 0
    one = condition_modes(modes, there, LENGTHS)
    found = condition_on_lengths(posterior_of(modes), LENGTHS, covariance=True)
    for image in range(2):
        rows = np.nonzero(there)[0] == image
        evidence = modes.log_evidence[image][there[image]] - one.lost_evidence[rows]
        share = np.exp(evidence - np.logaddexp.reduce(evidence))
        mean = np.tensordot(share, one.mean[rows], 1)
        np.testing.assert_allclose(found.mean[image], mean, atol=1e-9)
        before = np.logaddexp.reduce(modes.log_evidence[image][there[image]])
        gain = np.logaddexp.reduce(evidence) - before
        assert found.log_evidence[image] == pytest.approx(-5 + gain)
        alone = [
            condition_on_lengths(
                posterior_of(Modes(*(v[image : image + 1, [m]] for v in modes))),
                LENGTHS,
                covariance=True,
            ).covariance[0]
            for m in np.flatnonzero(there[image])
        ]
        apart = (one.mean[rows] - mean).reshape(len(share), -1)
        whole = np.tensordot(share, alone, 1) + (share * apart.T) @ apart
        np.testing.assert_allclose(found.covariance[image], whole, atol=1e-9)
        variance = np.diagonal(whole).reshape(3, P)
        np.testing.assert_allclose(found.deviation[image] ** 2, variance, atol=1e-9)
        best = int(np.argmax(np.where(there[image], 0, -np.inf)))
        assert found.rotation[image].tolist() in modes.rotation[image].tolist(), best
        xy = whole[np.arange(P), np.arange(P) + P]
        xy /= np.sqrt(variance[0] * variance[1])
        np.testing.assert_allclose(found.correlation[image, 0], xy, atol=1e-9)


def test_an_image_without_a_mode_keeps_what_it_has(modes):
    found = condition_on_lengths(posterior_of(modes), LENGTHS, covariance=False)
    assert (found.mean[2] == 7).all()
    assert (found.rotation[2] == 7).all()
    assert found.log_evidence[2] == -5
    assert found.covariance is None


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
    np.testing.assert_allclose(np.exp(lengths.log_length), [0.4, 0.3])
    np.testing.assert_allclose(lengths.precision.sum(axis=1), 0, atol=1e-9)
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
