"""Error bars of frames with errors in common: the formula, and planted sequences."""

import numpy as np
import pytest
from scipy.special import chdtr

from shapefit.evaluation.calibration import mahalanobis
from shapefit.lifting.sequences.clips import PAIRS, add_common_error, nearest_known
from shapefit.lifting.sequences.smoothing import CONSTANTS, Model, observe, smooth

T, P = 9, 4
RESIDUAL_VARIANCE = 0.01


def parts_of(C):
    """Deviations and correlations (n, 3, p) of covariances (n, p, 3, 3)."""
    sd = np.sqrt(np.einsum("npaa->nap", C))
    pairs = [C[:, :, a, b] / (sd[:, a] * sd[:, b]) for a, b in PAIRS]
    return sd, np.stack(pairs, axis=1)


def draw_covariances(rng, *shape):
    A = rng.standard_normal((*shape, 3, 3))
    return A @ A.swapaxes(-1, -2) + 0.1 * np.eye(3)


def test_covariances_are_added(rng):
    S, own = draw_covariances(rng, 6, P), draw_covariances(rng, 6, P)
    constant = rng.uniform(0, 2, (6, P))
    found = add_common_error(parts_of(S), parts_of(own), constant)
    whole = S + CONSTANTS.shared**2 * own + (constant**2)[..., None, None] * np.eye(3)
    for got, expected in zip(found, parts_of(whole), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_what_is_known_exactly_has_no_correlation():
    nothing = (np.zeros((1, 3, 2)), np.full((1, 3, 2), 0.5))
    deviation, correlation = add_common_error(nothing, nothing, np.zeros((1, 2)))
    assert not deviation.any()
    assert not correlation.any()


def test_an_image_that_says_nothing_has_the_bars_of_its_neighbour():
    known = np.array([1, 0, 0, 0, 1, 0, 0, 0, 1], dtype=bool)
    clips = (slice(0, 5), slice(5, 7), slice(7, 9))
    assert nearest_known(known, clips).tolist() == [0, 0, 0, 4, 4, 5, 6, 8, 8]


def test_planted_errors_in_common_are_covered(rng):
    """Steady motion seen with independent errors, and with one more that all frames share."""
    sequences, a, levels = 600, 0.05, []
    model = Model(np.array([[0, 1]]), np.full(P, a**-2.0), np.array([1e6]))
    alone = []
    for _ in range(sequences):
        C = draw_covariances(rng, P) * 0.02
        whole = np.zeros((3, P, 3, P))
        whole[:, range(P), :, range(P)] = C
        whole = whole.reshape(3 * P, 3 * P)
        motion = np.cumsum(np.cumsum(a * rng.standard_normal((T, 3, P)), axis=0), axis=0)
        errors = rng.multivariate_normal(np.zeros(3 * P), whole, T + 1).reshape(-1, 3, P)
        means = motion + errors[:T] + CONSTANTS.shared * errors[T]
        visible = observe(
            means[:, :2], np.ones((T, P)), means, np.zeros((T, 1)), means[:, None],
            np.tile(whole, (T, 1, 1, 1)), RESIDUAL_VARIANCE,
        )  # fmt: skip
        found = smooth(visible, model, np.sqrt(RESIDUAL_VARIANCE), max_rounds=20)
        one = slice(T // 2, T // 2 + 1)
        smoothed = (found.deviation[one], found.correlation[one])
        away = (found.points - motion)[one]
        for bars, retained in (
            (add_common_error(smoothed, parts_of(C[None]), np.zeros((1, P))), levels),
            (smoothed, alone),
        ):
            retained.append(chdtr(3.0, mahalanobis(away / bars[0], bars[1]))[0])
    n = sequences * P
    for nominal in (0.5, 0.9):
        off = 4 * np.sqrt(nominal * (1 - nominal) / n)
        assert (np.array(levels) <= nominal).mean() == pytest.approx(nominal, abs=off)
        assert (np.array(alone) <= nominal).mean() < nominal - off
