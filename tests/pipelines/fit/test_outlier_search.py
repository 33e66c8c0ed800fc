"""`outliers.method` of `fit`: wrong landmarks are as good as hidden, and said to be wrong."""

import numpy as np
import pytest

from shapefit.io import write_dictionary
from tests.io.files import load
from tests.pipelines.told import failures


@pytest.fixture(scope="module")
def views(project):
    """Views of the cars with at least 12 visible landmarks."""
    views = load(project / "sample_data" / "cars_views.h5")
    return views.take(np.isfinite(views.landmarks[:, 0]).sum(axis=1) >= 12)


@pytest.fixture
def run(fit, tmp_path, made_cars):
    """Return the function that fits images of a record; it gives the result and the failures."""

    def run(images, dictionary=made_cars, **keys):
        write_dictionary(tmp_path / "dict.h5", dictionary)
        keys = {"method": "convex+refine"} | keys
        found, outcomes = fit(tmp_path / "dict.h5", images, **keys)
        return found, failures(outcomes)

    return run


def spoil(views, share, rng):
    """Put a share of the visible landmarks of each image anywhere in the box of the others."""
    visible, w = views.visible(), views.landmarks
    rank = np.where(visible, rng.random(visible.shape), np.inf).argsort(axis=1).argsort(axis=1)
    wrong = rank < np.round(share * visible.sum(axis=1, keepdims=True))
    low, high = (f(w, axis=2, keepdims=True) for f in (np.nanmin, np.nanmax))
    landmarks = np.where(wrong[:, None], low + (high - low) * rng.random(w.shape), w)
    return views.replaced(landmarks=landmarks), wrong


@pytest.mark.parametrize("lifting", ["convex", "alternate", "mean-shape"])
def test_an_outlier_is_as_good_as_hidden_but_labelled(lifting, run, views, rng):
    spoilt, wrong = spoil(views, 0.3, rng)
    found, failures = run(spoilt, method=lifting, outliers="ransac")
    assert not failures
    labels = found.columns["outliers"].astype(bool)
    visible = np.isfinite(spoilt.landmarks[:, 0])
    assert not labels[~visible].any()
    assert (labels & wrong).sum() > 0.85 * max(labels.sum(), wrong.sum())
    np.testing.assert_array_equal(  # the observed landmarks, those judged wrong too
        found.columns["landmarks"], np.swapaxes(spoilt.landmarks, 1, 2)
    )
    hidden = spoilt.replaced(landmarks=np.where(labels[:, None], np.nan, spoilt.landmarks))
    without, _ = run(hidden, method=lifting)
    np.testing.assert_array_equal(found.shapes, without.shapes)
    np.testing.assert_array_equal(found.scale, without.scale)
    assert "outliers" not in without.columns


def test_what_is_drawn_belongs_to_the_name_of_an_image(run, views, rng):
    spoilt, _ = spoil(views.take(slice(8)), 0.3, rng)
    keys = {"outliers": "ransac", "method": "mean-shape"}
    (whole, _), (some, _) = run(spoilt, **keys), run(spoilt.take([6, 1]), **keys)
    np.testing.assert_array_equal(some.columns["outliers"], whole.columns["outliers"][[6, 1]])


def test_images_that_cannot_be_searched_or_lifted(run, views, rng):
    images = views.take(slice(6))
    landmarks = images.landmarks.copy()
    visible = [np.flatnonzero(np.isfinite(landmarks[i, 0])) for i in range(6)]
    landmarks[0][:, visible[0][3:]] = np.nan  # three landmarks
    landmarks[1][:, visible[1][2:]] = np.nan
    landmarks[2][:, visible[2]] = 5.0  # all on one point
    landmarks[3][:, visible[3][5:]] = np.nan  # five landmarks of another shape
    landmarks[3][:, visible[3][:5]] = rng.uniform(0, 1e3, (2, 5))
    landmarks[4] = np.nan
    images = images.replaced(landmarks=landmarks)
    found, failures = run(images, outliers="ransac", outlier_threshold=0.01)
    name = images.items
    assert failures[name[1]] == "only 2 visible landmarks, 3 are needed"
    assert failures[name[2]] == "all visible landmarks are at one point"
    assert failures[name[3]].endswith(
        "of 5 visible landmarks agree with each other; the minimum is 4, not all on one line"
    )
    assert failures[name[4]] == "all landmarks are hidden"
    labels = found.columns["outliers"].astype(bool)
    assert not labels[[0, 1, 2, 4]].any()
    assert labels[3].sum() == 5
    assert np.isfinite(found.shapes[0]).all()
    assert np.isnan(found.shapes[1:5]).all()
