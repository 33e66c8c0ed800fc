"""Error bars in pictures: outlines of covariances that are turned with the view."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection

from shapefit.meshes.ellipses import covariances, seen_ellipses
from shapefit.meshes.pictures import FittedImage, Model, Pose, fit_picture, skeleton_picture
from shapefit.meshes.views import View, upright

EDGES = np.array([[0, 1], [1, 2]])


@pytest.fixture
def bars(rng):
    """Deviations and correlations (3, p) of covariances (p, 3, 3)."""
    L = rng.standard_normal((5, 3, 3))
    C = L @ L.swapaxes(1, 2)
    sd = np.sqrt(np.einsum("paa->ap", C))
    pairs = ((0, 1), (0, 2), (1, 2))
    return sd, np.stack([C[:, a, b] / (sd[a] * sd[b]) for a, b in pairs]), C


def ellipses_on(figure):
    return [[c for c in axes.collections if isinstance(c, EllipseCollection)]
            for axes in figure.axes]  # fmt: skip


def test_covariances_are_put_together(bars):
    sd, correlation, C = bars
    np.testing.assert_allclose(covariances(sd, correlation), C)
    expected = np.stack([np.diag(column**2) for column in sd.T])
    np.testing.assert_allclose(covariances(sd), expected)


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_outlines_hold_the_spread_of_turned_draws(bars, rng, y_axis):
    *_, C = bars
    rotation = View(50, 20).rotation()
    found = seen_ellipses(C, rotation, y_axis)
    for j in range(5):
        draws = np.linalg.cholesky(C[j]) @ rng.standard_normal((3, 100_000))
        x, y = (rotation @ upright(draws, y_axis))[:2]
        along = np.cos(found.angle[j]) * x + np.sin(found.angle[j]) * y
        across = -np.sin(found.angle[j]) * x + np.cos(found.angle[j]) * y
        np.testing.assert_allclose([along.std(), across.std()], found.semi_axes[j], rtol=0.02)
        assert abs(np.corrcoef(along, across)[0, 1]) < 0.02


def test_a_landmark_without_an_error_bar_has_no_outline(bars):
    *_, C = bars
    C[2] = np.nan
    found = seen_ellipses(C, np.eye(3), "up")
    assert np.isnan(found.semi_axes).any(axis=1).tolist() == [False, False, True, False, False]


def test_pictures_shade_them_where_they_are_known(rng, bars):
    *_, C = bars
    C[4] = np.nan
    shape = rng.standard_normal((3, 5))
    image = FittedImage("a", shape[:2], shape, covariance=0.01 * C)
    model = Model("up", edges=EDGES)
    plain, overlay, *turned = ellipses_on(fit_picture([image], model))
    assert not plain
    (found,) = overlay
    assert len(found.get_offsets()) == 4
    outlines = seen_ellipses(0.01 * C, np.eye(3), "up")
    np.testing.assert_allclose(found.get_widths(), 2 * outlines.semi_axes[:4, 0])
    assert all(len(on) == 1 for on in turned)
    without = fit_picture([replace(image, covariance=None)], model)
    assert not any(ellipses_on(without))


def test_examples_shade_the_methods_that_have_them(rng, bars):
    *_, C = bars
    shape = rng.standard_normal((3, 5))
    pose = Pose("a", shape[:2], {"truth": shape, "posterior": shape}, {"posterior": C})
    figure = skeleton_picture([pose], EDGES, "up")
    assert [len(on) for on in ellipses_on(figure)] == [0, 0, 1]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["one standard deviation"]
