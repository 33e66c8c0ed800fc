"""The evidence chooses factors of the prior and parameters of a skeleton."""

import numpy as np
import pytest

from shapefit.io.skeletons import THETA
from shapefit.pipelines.fit.evidence import choose_factors, maximise_theta, mean_gain
from shapefit.records import Landmarks

P = 12


NAMES = tuple(f"point{j}" for j in range(P))


def blank_images(count):
    return Landmarks(
        np.zeros((count, P, 2)),
        landmark_names=NAMES,
        items=tuple(map(str, range(count))),
    )


def test_of_pairs_as_likely_the_widest_is_taken_with_the_least_variance():
    noise = np.random.default_rng(0).normal(size=(4, 100))
    noise -= noise.mean(axis=1, keepdims=True)
    evidence_of = {
        (1.0, 1.0): -10 + noise[0],
        (2.0, 1.0): -5.05 + noise[1],
        (2.0, 2.0): -5 + noise[2],
        (1.0, 2.0): -7 + noise[3],
    }

    def evidence(pair, some):
        return evidence_of[pair][: len(some)]

    steps = (1.0, 2.0)
    factors = choose_factors(evidence, blank_images(100), steps, steps)
    assert factors == (2, 1)


@pytest.mark.parametrize("best", [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0), (8.0, 2.0)])
def test_a_wider_prior_or_a_larger_variance_alone_makes_all_pairs_be_tried(best):
    def evidence(pair, some):
        distance = np.abs(np.log2(pair) - np.log2(best)).sum()
        return np.full(len(some), -distance)

    assert choose_factors(evidence, blank_images(30)) == best


def test_factors_stay_where_the_next_ones_are_no_likelier():
    steps = (1, 2, 3)

    def evidence_of_largest(pair, some):
        return pair.count(3) * np.ones(len(some))

    factors = choose_factors(evidence_of_largest, blank_images(30), steps, steps)
    assert factors == (1, 1)


PRECISION = 1e4
"""Of a peak of the evidence."""


NAME = next(iter(THETA))


@pytest.mark.parametrize("offset", [-0.19, -0.12, 0.0, 0.07, 0.16, 0.21])
def test_a_top_within_the_steps_is_found(offset):
    usual = np.log(THETA[NAME].mean)
    peak = usual + offset

    def evidence(theta):
        return -0.5 * PRECISION * (np.log(theta[NAME]) - peak) ** 2

    theta = maximise_theta(evidence, [NAME], {NAME: THETA[NAME].mean})
    prior_precision = THETA[NAME].std ** -2
    weighted = PRECISION * peak + prior_precision * usual
    expected = weighted / (PRECISION + prior_precision)
    assert np.log(theta[NAME]) == pytest.approx(expected, abs=1e-9)


def test_the_error_of_a_gain_counts_that_neighbours_resemble_each_other(rng):
    correlation = 0.7
    gains = rng.standard_normal((400, 96))
    for t in range(1, 96):
        new = np.sqrt(1 - correlation**2) * gains[:, t]
        gains[:, t] = correlation * gains[:, t - 1] + new
    estimates = [mean_gain(0 * gain, gain) for gain in gains]
    means, errors = zip(*estimates, strict=True)
    stated_error = np.sqrt(np.mean(np.square(errors)))
    assert 0.7 < stated_error / np.std(means) < 1.1
