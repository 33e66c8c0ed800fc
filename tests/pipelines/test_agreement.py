"""Images told in another way have the same shapes: files, orders, units, threads, chunks."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.io import write_dictionary
from shapefit.io.records import LandmarkSet
from tests.io.files import save
from tests.pipelines.fitted import fit_file
from tests.pipelines.verify.conftest import TERMS

NAMES = tuple("abcdefgh")
N, K = 9, 5


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Images with hidden landmarks and confidences, and what fits them with a dictionary."""
    folder = tmp_path_factory.mktemp("agreement")
    rng = np.random.default_rng(3)
    atoms = normalise(rng.standard_normal((K, 3, 8))).points
    write_dictionary(folder / "d.h5", Dictionary(atoms, NAMES, atoms.mean(axis=0)))
    points = 50 * rng.standard_normal((N, 2, 8)) + 300
    points[rng.random((N, 8)).argsort(axis=1)[:, None].repeat(2, axis=1) == 0] = np.nan
    images = LandmarkSet(
        landmarks=points,
        confidence=rng.uniform(0.2, 1, (N, 8)).round(3),
        landmark_names=NAMES,
        items=tuple(f"image {number}" for number in range(N)),
    )

    def fit(images=images, suffix=".h5", **keys):
        path = folder / f"views{suffix}"
        save(path, images)
        return fit_file(path, folder / "d.h5", folder / "result.h5", **keys)[0]

    return images, fit


def exactly(found, expected):
    """Assert that the results agree to the last bit."""
    assert found.items == expected.items
    for field in ("shapes", "landmarks_fitted", "coefficients", "rotation", "objective", "status"):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))


@settings(
    deadline=None, max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(order=st.permutations(range(8)), loss=st.sampled_from(list(TERMS)))
def test_the_order_of_landmarks_has_no_part_in_the_result(bench, order, loss):
    images, fit = bench
    expected = fit(**TERMS[loss], solver={"tolerance": 1e-8})
    names = tuple(NAMES[place] for place in order)
    found = fit(images.arrange(names), **TERMS[loss], solver={"tolerance": 1e-8})
    back = np.argsort(order)
    assert found.landmark_names in (names, NAMES)
    fitted = found.landmarks_fitted
    fitted = fitted[..., back] if found.landmark_names == names else fitted
    np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-7)
    if loss == "squared":  # the others have more than one answer
        seen = np.isfinite(images.landmarks[:, :1]).repeat(2, axis=1)  # and so may these
        np.testing.assert_allclose(fitted[seen], expected.landmarks_fitted[seen], atol=0.05)


@settings(
    deadline=None, max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(order=st.permutations(range(N)), loss=st.sampled_from(list(TERMS)))
def test_the_order_of_images_has_no_part_in_the_optimum(bench, order, loss):
    images, fit = bench
    expected = fit(**TERMS[loss], solver={"tolerance": 1e-8})
    found = fit(images.take(order), **TERMS[loss], solver={"tolerance": 1e-8})
    assert found.items == tuple(images.items[row] for row in order)
    np.testing.assert_allclose(found.objective, expected.objective[list(order)], rtol=1e-7)


@pytest.mark.parametrize("loss", list(TERMS))
@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e6, 0.0), (1.0, 1e5), (0.037, -40.0)])
def test_units_and_origin_move_with_the_shapes(bench, loss, scale, shift):
    images, fit = bench
    keys = {**TERMS[loss], "solver": {"tolerance": 1e-8}}
    expected = fit(**keys)
    moved = images.replaced(landmarks=scale * images.landmarks + shift)
    found = fit(moved, **keys)
    np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-6)
    np.testing.assert_allclose(found.scale, scale * expected.scale, rtol=1e-9)
    fitted = scale * expected.landmarks_fitted + shift
    if loss == "squared":
        seen = np.isfinite(images.landmarks[:, :1]).repeat(2, axis=1)  # the others may differ
        size = 0.001 * scale * np.nanstd(images.landmarks) + 1e-9 * abs(shift)
        np.testing.assert_allclose(found.landmarks_fitted[seen], fitted[seen], atol=size)


def test_confidence_zero_is_unseen(bench):
    images, fit = bench
    seen = np.isfinite(images.landmarks[:, 0])
    confidence = np.where(seen, images.confidence, 0.0)
    anywhere = np.where(seen[:, None], images.landmarks, 7.0)
    exactly(fit(images.replaced(landmarks=anywhere, confidence=confidence)), fit())
