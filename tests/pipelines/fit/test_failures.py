"""`fit` of images that fail, and of inputs that are refused."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.solver import Status
from shapefit.errors import InputError
from shapefit.io import read_results
from shapefit.lifting.lift import lift
from tests.pipelines.fitted import failures, texts

NAMES = tuple(f"point{j}" for j in range(10))


def rows(points, item):
    """Return the rows of an item in a table."""
    named_points = zip(NAMES, points, strict=True)
    return "".join(f"{item},{name},{x},{y}\n" for name, (x, y) in named_points)


BAD_IMAGES = [
    ([(0, 0), (1, 2)] + 8 * [("", "")], "only 2 visible landmarks"),
    (10 * [("", "nan")], "all landmarks are hidden"),
    (10 * [(3, 4)], "one point"),
    ([(j, 2 * j) for j in range(10)], "one line"),
]


@pytest.mark.parametrize(("points", "reason"), BAD_IMAGES)
def test_one_bad_image_never_stops_the_rest(fit, dictionary, rng, points, reason):
    good = rows(rng.standard_normal((10, 2)), "good")
    bad = rows(points, "bad")
    also_good = rows(rng.standard_normal((10, 2)), "also good")
    text = f"item,landmark,x,y\n{good}{bad}{also_good}"
    result, outcomes = fit(dictionary, text)
    failed = failures(outcomes)
    assert list(failed) == ["bad"]
    assert reason in failed["bad"]
    assert list(result.status) == ["optimal", Status.DEGENERATE.value, "optimal"]
    assert np.isnan(result.shapes[1]).all()
    assert np.isfinite(result.shapes[[0, 2]]).all()


@pytest.mark.parametrize(("points", "reason"), BAD_IMAGES)
def test_landmarks_of_a_bad_image_are_stored(fit, dictionary, points, reason):
    text = "item,landmark,x,y\n" + rows(points, "bad")
    result, _ = fit(dictionary, text)
    cells = np.array(
        [[float(str(cell) or "nan") for cell in point] for point in points]
    )
    hidden = np.isnan(cells).any(axis=1, keepdims=True)
    expected = np.where(hidden, np.nan, cells)
    assert_array_equal(result.column("landmarks")[0], expected)


SCALES = [(1e306, "coordinates too large"), (1e-318, "landmarks too close together")]


@pytest.fixture
def fit_scaled(fit, dictionary, images):
    """Fit the images, of which one is so many times as large, and let every warning be
    an error.
    """

    def fit_scaled(factor, **keys):
        landmarks = images.landmarks.copy()
        landmarks[3] *= factor
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return fit(dictionary, images.replaced(landmarks=landmarks), **keys)

    return fit_scaled


def check_failures(result, outcomes, reason):
    """Assert that the scaled image failed, and which have no shape; return how many
    have one.
    """
    failed = failures(outcomes)
    whole = np.isfinite(result.shapes).all(axis=(1, 2))
    without_shape = [
        item for item, ok in zip(result.items, whole, strict=True) if not ok
    ]
    assert failed["image3"].startswith(reason)
    assert result.status[3] == Status.DEGENERATE.value
    assert set(failed) == set(without_shape)
    return whole.sum()


@pytest.mark.parametrize(("factor", "reason"), SCALES)
@pytest.mark.parametrize("keys", [{}, {"lambda": "auto", "noise": 1e305}])
def test_coordinates_beyond_arithmetic_fail_without_a_murmur(
    fit_scaled, factor, reason, keys
):
    result, outcomes = fit_scaled(factor, **keys)
    whole_count = check_failures(result, outcomes, reason)
    assert whole_count == 7


@pytest.mark.parametrize(("factor", "reason"), SCALES)
def test_ransac_of_coordinates_beyond_arithmetic(fit_scaled, factor, reason):
    """It also fails others: their atoms are far from the mean shape."""
    result, outcomes = fit_scaled(factor, outliers="ransac", outlier_threshold=10.0)
    check_failures(result, outcomes, reason)


def test_no_image_is_fitted_without_a_finite_shape(
    fit, dictionary, images, monkeypatch
):
    def lift_badly(*args, **keys):
        lifting = lift(*args, **keys)
        lifting.shapes[5:6, 2, 0] = np.inf
        return lifting

    monkeypatch.setattr("shapefit.pipelines.fit.atoms.lift", lift_badly)
    result, outcomes = fit(dictionary, images)
    reason = "the fitted shape contains NaN or infinity"
    assert failures(outcomes) == {"image5": reason}
    assert result.status[5] == Status.NUMERICAL_FAILURE.value
    for name in ("shapes", "coefficients", "rotation", "objective"):
        values = result.column(name).reshape(8, -1)
        lost = np.isnan(values).all(axis=1)
        assert np.flatnonzero(lost).tolist() == [5]


def with_a_failing_image(images):
    """Return the images, of which the third is at one point."""
    landmarks = images.landmarks.copy()
    landmarks[2] = 0.0
    return images.replaced(landmarks=landmarks)


METHODS_WITH_LAMBDA = [
    {},
    {"method": "alternate"},
    {"outliers": "l1"},
    {"method": "convex+refine"},
]


@pytest.mark.parametrize("keys", METHODS_WITH_LAMBDA, ids=str)
def test_empty_shapes_are_counted_and_have_no_rotation(fit, dictionary, images, keys):
    """An image that fails is not counted a second time."""
    views = with_a_failing_image(images)
    result, outcomes = fit(dictionary, views, **keys, **{"lambda": 1e3})
    (warning,) = [text for text in texts(outcomes) if "empty shape" in text]
    empty_shapes = result.shapes[np.arange(8) != 2]
    assert list(failures(outcomes)) == ["image2"]
    assert warning.startswith(
        "7 images with an empty shape: lambda is at or above lambda_max"
    )
    assert np.isnan(result.rotation).all()
    assert not np.ptp(empty_shapes, axis=1).any()


@pytest.mark.parametrize(
    "keys", [{}, {"method": "alternate"}, {"method": "convex+refine"}], ids=str
)
def test_empty_shapes_are_at_the_mean_of_the_landmarks(fit, dictionary, images, keys):
    """But with the loss l1, which places them at the median."""
    views = with_a_failing_image(images)
    result, _ = fit(dictionary, views, **keys, **{"lambda": 1e3})
    empty = np.arange(8) != 2
    middle = result.shapes[empty, :, :2].mean(axis=1)
    expected = images.landmarks[empty].mean(axis=1)
    assert_allclose(middle, expected)


@pytest.mark.parametrize("keys", METHODS_WITH_LAMBDA, ids=str)
def test_with_a_small_lambda_no_shape_is_empty(fit, dictionary, images, keys):
    views = with_a_failing_image(images)
    _, outcomes = fit(dictionary, views, **keys, **{"lambda": 1e-3})
    assert not any("empty shape" in text for text in texts(outcomes))


def test_a_refused_input_leaves_the_old_result(fit, tmp_path, dictionary):
    old = tmp_path / "result.h5"
    old.write_text("old")
    with pytest.raises(InputError, match=r"views\.csv:2"):
        fit(dictionary, "item,landmark,x,y\none,point0,abc,1\n")
    names = ["dictionary.h5", "result.h5", "views.csv"]
    assert old.read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == names


@pytest.mark.parametrize("option", [("--frames", "100:200"), ("--min-confidence", "5")])
def test_where_no_image_is_left_the_command_ends_with_1(project, tmp_path, option):
    from shapefit.cli.main import run

    target = tmp_path / "result.h5"
    code = run(
        ["fit", str(project / "sample_data/openpose"), *option, "-o", str(target)]
    )

    assert code == 1
    assert len(read_results(target)) == 0
