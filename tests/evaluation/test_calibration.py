"""Levels of the truth in error bars: against dense linear algebra, and planted from the
bars.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import chdtr, chdtri  # scipy.stats takes a second to import

from shapefit.evaluation.calibration import (
    SQUARED_RADII,
    ErrorBars,
    bar_scale_factors,
    find_squares,
    summarise_coverage,
)

PAIRS = ((0, 1), (0, 2), (1, 2))
BINOMIAL = 4
"""Standard errors of a binomial share within which a planted one must be."""


def draw(rng, n, p, size):
    """Estimates (n, 3, p), covariances (n, p, 3, 3), and truths drawn from them, then
    moved.
    """
    estimate = rng.standard_normal((n, 3, p))
    L = size * rng.standard_normal((n, p, 3, 3))
    C = L @ L.swapaxes(2, 3) + 0.1 * size**2 * np.eye(3)
    e = np.einsum(
        "npab,npb->nap", np.linalg.cholesky(C), rng.standard_normal((n, p, 3))
    )
    scale, shift = rng.uniform(0.1, 10, (n, 1, 1)), rng.standard_normal((n, 3, 1))
    return estimate, C, scale * (estimate + e) + shift


def deviations_of(C):
    """Standard deviations and correlations (n, 3, p) of covariances (n, p, 3, 3)."""
    sd = np.sqrt(np.einsum("npaa->nap", C))
    return sd, np.stack(
        [C[..., a, b] / (sd[:, a] * sd[:, b]) for a, b in PAIRS], axis=1
    )


def find_levels(estimate, truth, *bars):
    """The level of the ellipsoid on which the truth lies, uniform where bars are true;
    widths.
    """
    square, width = find_squares(
        estimate, truth, np.tile(np.eye(3), (len(truth), 1, 1)), *bars
    )
    return chdtr(3, square), width


def placed_by_least_squares(estimate, truth, sd):
    """The truth placed, its scale, the leverages (2, p): by a dense system over a, t_x,
    t_y.
    """
    p = estimate.shape[1]
    A = np.column_stack([truth[:2].reshape(-1), np.repeat(np.eye(2), p, axis=0)])
    A, b = (
        each / sd[:2].reshape(-1, *[1] * (each.ndim - 1))
        for each in (A, estimate[:2].ravel())
    )
    (a, *t), *_ = np.linalg.lstsq(A, b, rcond=None)
    hat = np.diag(A @ np.linalg.pinv(A)).reshape(2, p)
    depth = estimate[2].mean() - a * truth[2].mean()
    return a * truth + np.array([*t, depth])[:, None], a, hat


def test_levels_and_widths_are_those_of_dense_algebra(rng):
    estimate, C, truth = draw(rng, 12, 7, 0.2)
    sd, correlation = deviations_of(C)
    level, width = find_levels(estimate, truth, sd, correlation)
    for i in range(12):
        placed, a, hat = placed_by_least_squares(estimate[i], truth[i], sd[i])
        d = estimate[i] - placed
        d[:2] /= np.sqrt(1 - hat)
        for j in range(7):
            square = d[:, j] @ np.linalg.solve(C[i, j], d[:, j])
            assert level[i, j] == pytest.approx(chdtr(3, square))
            axes = np.sqrt(chdtri(3, 0.1) * np.linalg.eigvalsh(C[i, j]))
            assert width[i, j] == pytest.approx(np.sqrt((axes**2).mean()) / a)


def posterior_and_truth(rng, n, hidden, noise=0.03, p=15, k=42):
    """A Gaussian model of shapes and what it says of n images (n, 3, p), beside true
    shapes.

    The view is known; size and place of a shape are not. `hidden` landmarks an image
    are unseen.
    """
    mean, B = rng.standard_normal((3, p)), 0.15 * rng.standard_normal((k, 3, p))
    mean, B = (each - each.mean(axis=-1, keepdims=True) for each in (mean, B))
    map_ = np.zeros((3, p, k + 3))
    map_[:, :, :k], map_[:, :, k] = B.transpose(1, 2, 0), mean
    map_[0, :, k + 1] = map_[1, :, k + 2] = 1
    prior = np.diag([1.0] * k + [1e-8] * 3)
    estimate, truth, C = (
        np.empty((n, 3, p)),
        np.empty((n, 3, p)),
        np.empty((n, p, 3, 3)),
    )
    for i in range(n):
        truth[i] = mean + np.tensordot(rng.standard_normal(k), B, 1)
        visible = rng.permutation(p) >= hidden
        X = map_[:2, visible].reshape(-1, k + 3)
        y = (
            truth[i, :2, visible].T + noise * rng.standard_normal((2, visible.sum()))
        ).ravel()
        covariance = np.linalg.inv(X.T @ X / noise**2 + prior)
        found = covariance @ X.T @ (y - X[:, k]) / noise**2
        estimate[i] = mean + map_ @ found
        C[i] = np.einsum("api,ij,bpj->pab", map_, covariance, map_)
    return estimate, C, 2.7 * truth + rng.standard_normal((n, 3, 1))


@pytest.mark.parametrize("hidden", [0, 7])
def test_a_posterior_holds_as_much_of_the_truth_as_it_says(rng, hidden):
    """Depths that are barely known must not move the scale of x and y, which are known
    well.
    """
    n = 400
    estimate, C, truth = posterior_and_truth(rng, n, hidden)
    sd, correlation = deviations_of(C)
    level, _ = find_levels(estimate, truth, sd, correlation)
    narrow, _ = find_levels(estimate, truth, 0.8 * sd, correlation)
    for nominal in (0.5, 0.9):
        shares = (level <= nominal).mean(axis=1)
        assert shares.mean() == pytest.approx(
            nominal, abs=BINOMIAL * shares.std() / np.sqrt(n)
        )
        assert (narrow <= nominal).mean() < nominal - 0.05


def test_what_is_not_known_is_left_out(rng):
    estimate, C, truth = draw(rng, 4, 6, 0.2)
    truth[0, :, 2] = np.nan
    truth[1, :, 2:] = np.nan  # two landmarks are too few to place
    estimate[2] = np.nan
    level, width = find_levels(estimate, truth, *deviations_of(C))
    assert np.isnan(level).sum(axis=1).tolist() == [1, 6, 6, 0]
    assert (np.isnan(level) == np.isnan(width)).all()
    others = [0, 1, 3, 4, 5]
    alone, _ = find_levels(
        *(x[:1, :, others] for x in (estimate, truth, *deviations_of(C)))
    )
    assert_allclose(level[0, others], alone[0])


def test_groups_are_summed_up():
    assert [*SQUARED_RADII.values()] == pytest.approx(
        chdtri(3, [1 - level for level in SQUARED_RADII]), rel=1e-14
    )
    level = np.array([[0.2, 0.8], [0.6, np.nan], [0.95, 0.4]])
    width = {"normalised": np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 6.0]])}
    bars = ErrorBars(chdtri(3, 1 - level), width)
    assert_allclose(bars.shares(), [1, 1, 0.5])
    groups = {"13": ("a", "b"), "14": ("c",), "15": ("d",)}
    first, second = summarise_coverage("m", bars, ["a", "b", "c"], groups)
    assert (first["group"], first["counted"]) == ("13", 3)
    assert first["inside"] == pytest.approx([1 / 3, 1.0])
    assert first["median_width"] == {"normalised": 2.0}
    assert (second["counted"], second["inside"]) == (2, [0.5, 0.5])


def test_factors_undo_what_error_bars_lack(rng):
    """Errors twice as large as the bars, all of them or the larger half; few, and too
    few.
    """
    z = np.sort((rng.standard_normal((40_000, 3)) ** 2).sum(axis=1))

    def factors(squares):
        return bar_scale_factors(ErrorBars(squares[:, None], {}))

    assert list(factors(4 * z).values()) == pytest.approx([2, 2], rel=0.01)
    outer = np.where(z > np.quantile(z, 0.6), 4 * z, z)
    assert list(factors(outer).values()) == pytest.approx([1, 2], rel=0.01)
    fifth_and_ninth = np.sqrt(np.array([5, 9]) / [*SQUARED_RADII.values()])
    assert list(factors(np.arange(1.0, 10)).values()) == pytest.approx(fifth_and_ninth)
    assert factors(z[:8])["90%"] is None
