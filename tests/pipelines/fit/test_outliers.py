"""`outliers: ransac`: wrong landmarks are as good as hidden, and marked."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.io import write_dictionary
from tests.io.files import load
from tests.pipelines.fitted import failures


def draw_share(visible, share, rng):
    """Return which landmarks are of a share of the visible ones of each image."""
    chance = np.where(visible, rng.random(visible.shape), np.inf)
    rank = chance.argsort(axis=1).argsort(axis=1)
    counts = np.round(share * visible.sum(axis=1, keepdims=True))
    return rank < counts


def spoil(views, share, rng):
    """Put a share of the visible landmarks of each image anywhere in the box of the
    others; return also which.
    """
    w = views.landmarks
    wrong = draw_share(views.visible(), share, rng)
    low = np.nanmin(w, axis=1, keepdims=True)
    high = np.nanmax(w, axis=1, keepdims=True)
    anywhere = low + (high - low) * rng.random(w.shape)
    landmarks = np.where(wrong[..., None], anywhere, w)
    return views.replaced(landmarks=landmarks), wrong


@pytest.fixture
def views(project):
    """Views of the cars with at least 12 visible landmarks."""
    views = load(project / "sample_data" / "cars_views.h5")
    visible = np.isfinite(views.landmarks[..., 0])
    return views.take(visible.sum(axis=1) >= 12)


@pytest.fixture
def run(fit, tmp_path, made_cars):
    """Return what fits images; it gives the result and the failures."""
    path = tmp_path / "dict.h5"
    write_dictionary(path, made_cars)

    def run(images, **keys):
        result, outcomes = fit(path, images, **keys)
        return result, failures(outcomes)

    return run


@pytest.mark.parametrize("method", ["convex", "alternate", "mean-shape"])
def test_wrong_landmarks_are_marked(method, run, views, rng):
    spoilt, wrong = spoil(views, 0.3, rng)
    result, lost = run(spoilt, method=method, outliers="ransac")
    marked = result.outliers.astype(bool)
    both = (marked & wrong).sum()
    assert not lost
    assert not marked[~spoilt.visible()].any()
    assert both > 0.85 * max(marked.sum(), wrong.sum())
    assert_array_equal(result.column("landmarks"), spoilt.landmarks)


@pytest.mark.parametrize("method", ["convex", "alternate", "mean-shape"])
def test_marked_landmarks_are_as_good_as_hidden(method, run, views, rng):
    spoilt, _ = spoil(views, 0.3, rng)
    result, _ = run(spoilt, method=method, outliers="ransac")
    marked = result.outliers.astype(bool)
    landmarks = np.where(marked[..., None], np.nan, spoilt.landmarks)
    without, _ = run(spoilt.replaced(landmarks=landmarks), method=method)
    assert_array_equal(result.points, without.points)
    assert_array_equal(result.scale, without.scale)
    assert without.outliers is None


def test_what_is_drawn_belongs_to_the_name_of_an_image(run, views, rng):
    spoilt, _ = spoil(views.take(slice(8)), 0.3, rng)
    keys = {"outliers": "ransac", "method": "mean-shape"}
    rows = [6, 1]
    whole, _ = run(spoilt, **keys)
    some, _ = run(spoilt.take(rows), **keys)
    assert_array_equal(some.outliers, whole.outliers[rows])


REASONS = [
    "",
    "only 2 visible landmarks, 3 are needed",
    "all visible landmarks are at one point",
    "fewer than 4 visible landmarks, not all on one line, agree",
    "all landmarks are hidden",
    "",
]
"""Why each of the next images fails."""


@pytest.fixture
def poor_views(views, rng):
    """Six images: with three landmarks, with two, with all on one point, with five of
    another shape, with none, and one that is whole.
    """
    images = views.take(slice(6))
    landmarks = images.landmarks.copy()
    visible = [np.flatnonzero(np.isfinite(image[:, 0])) for image in landmarks]
    landmarks[0, visible[0][3:]] = np.nan
    landmarks[1, visible[1][2:]] = np.nan
    landmarks[2, visible[2]] = 5.0
    landmarks[3, visible[3][5:]] = np.nan
    landmarks[3, visible[3][:5]] = rng.uniform(0, 1e3, (5, 2))
    landmarks[4] = np.nan
    return images.replaced(landmarks=landmarks)


def test_images_that_cannot_be_searched_or_lifted(run, poor_views):
    result, lost = run(
        poor_views, method="convex+refine", outliers="ransac", outlier_threshold=0.01
    )
    marked = result.outliers.astype(bool).sum(axis=1)
    assert [lost.get(name, "") for name in poor_views.items] == REASONS
    assert_array_equal(marked[:5], [0, 0, 0, 5, 0])
    assert np.isfinite(result.shapes[0]).all()
    assert np.isnan(result.shapes[1:5]).all()
