"""`fit` and images that cannot be fitted, or whose optimum is no shape."""

import warnings
from functools import partial

import numpy as np
import pytest

from shapefit.convex.solver import Status, solve_newton
from shapefit.lifting.lift import lift
from tests.pipelines.told import failures, texts

NAMES = tuple(f"point{j}" for j in range(10))
LANDMARK_ROWS = "item,landmark,x,y\n"


def rows(points, item="one", names=NAMES):
    return "".join(f"{item},{n},{x},{y}\n" for n, (x, y) in zip(names, points, strict=True))


class TestItemsThatFail:
    @pytest.mark.parametrize(
        ("points", "reason"),
        [
            ([(0, 0), (1, 2)] + 8 * [("", "")], "only 2 visible landmarks"),
            (10 * [("", "nan")], "all landmarks are hidden"),
            (10 * [(3, 4)], "one point"),
            ([(j, 2 * j) for j in range(10)], "one line"),
        ],
    )
    def test_one_bad_image_never_stops_the_rest(self, fit, dictionary, rng, points, reason):
        text = LANDMARK_ROWS + rows(rng.standard_normal((10, 2)), "good")
        text += rows(points, "bad") + rows(rng.standard_normal((10, 2)), "also good")
        found, outcomes = fit(dictionary, text)
        assert list(failures(outcomes)) == ["bad"]
        assert reason in failures(outcomes)["bad"]
        assert list(found.status) == ["optimal", Status.DEGENERATE.value, "optimal"]
        assert np.isnan(found.shapes[1]).all()
        assert np.isfinite(found.shapes[[0, 2]]).all()
        observed = [[float(c) if c != "" else np.nan for c in point] for point in points]
        hidden = np.isnan(observed).any(axis=1, keepdims=True)
        np.testing.assert_array_equal(
            found.columns["landmarks"][1], np.where(hidden, np.nan, observed)
        )

    @pytest.mark.parametrize(
        ("factor", "reason"),
        [
            (1e306, "coordinates too large"),
            (1e-318, "landmarks too close together"),
        ],
    )
    @pytest.mark.parametrize(
        "keys",
        [{}, {"lambda": "auto", "noise": 1e305}]
        + [{"outliers": m, "outlier_threshold": 10.0} for m in ("ransac",)],
    )
    def test_coordinates_beyond_arithmetic_fail_without_a_murmur(
        self, fit, dictionary, images, factor, reason, keys
    ):
        landmarks = images.landmarks.copy()
        landmarks[3] *= factor
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found, outcomes = fit(dictionary, images.replaced(landmarks=landmarks), **keys)
        assert failures(outcomes).pop("image3").startswith(reason)
        assert found.status[3] == Status.DEGENERATE.value
        # ransac also fails others: their atoms are far from the mean shape
        whole = np.isfinite(found.shapes).all(axis=(1, 2))
        assert [item in failures(outcomes) for item in images.items] == (~whole).tolist()
        assert whole.sum() == 7 or keys.get("outliers") == "ransac"

    def test_no_image_is_fitted_without_a_finite_shape(self, fit, dictionary, images, monkeypatch):
        def lift_badly(*args):
            lifting = lift(*args)
            lifting.shapes[5, 2, 0] = np.inf
            return lifting

        monkeypatch.setattr("shapefit.pipelines.fit.lift.lift", lift_badly)
        found, outcomes = fit(dictionary, images)
        assert failures(outcomes) == {"image5": "the fitted shape contains NaN or infinity"}
        assert found.status[5] == Status.NUMERICAL_FAILURE.value
        for values in (found.shapes, found.coefficients, found.rotation, found.objective):
            lost = np.isnan(values.reshape(8, -1)).all(axis=1)
            np.testing.assert_array_equal(lost, np.arange(8) == 5)

    def test_the_widest_gap_of_what_is_not_optimal_is_reported(
        self, fit, dictionary, images, monkeypatch
    ):
        two = partial(solve_newton, max_iterations=2)
        monkeypatch.setattr("shapefit.pipelines.fit.lift.solve_newton", two)
        found, outcomes = fit(dictionary, images, tolerance=1e-9)
        assert failures(outcomes) == {}
        (warning,) = texts(outcomes)
        first, widest = found.relative_gap[0], found.relative_gap.max()
        assert first < 0.9 * widest
        assert warning.startswith("8 images not optimal, the worst: iteration limit after 2")
        assert warning.endswith(f"relative gap {widest:.2g}")


class TestEmptyShapes:
    @pytest.mark.parametrize(
        "keys",
        [{}, {"method": "alternate"}, {"outliers": "l1"}, {"method": "convex+refine"}],
        ids=str,
    )
    def test_are_told_of_and_have_no_rotation(self, fit, dictionary, images, keys):
        for lam, count in ((1e3, 7), (1e-3, 0)):
            landmarks = images.landmarks.copy()
            landmarks[2] = 0.0  # fails, and is not told of a second time
            some = images.replaced(landmarks=landmarks)
            found, outcomes = fit(dictionary, some, **keys, **{"lambda": lam})
            assert list(failures(outcomes)) == ["image2"]
            empty = ~(np.ptp(found.shapes, axis=2) > 0).any(axis=1) & (np.arange(8) != 2)
            told = [str(w) for outcome in outcomes for w in outcome.warnings if "empty" in str(w)]
            if not count:
                assert not empty.any()
                assert told == []
            else:
                assert empty.sum() == count
                (warning,) = told
                assert warning.startswith("7 images with an empty shape")
                assert "lambda_max" in warning
                assert np.isnan(found.rotation).all()
                if "outliers" not in keys:  # l1 places it at the median
                    middle = found.shapes[empty, :2].mean(axis=2)
                    np.testing.assert_allclose(middle, images.landmarks[empty].mean(axis=2))
