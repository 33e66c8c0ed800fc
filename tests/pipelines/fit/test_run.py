"""`fit` from files to files: shapes that come back, images that fail, what is
stored.
"""

import json
import re
import warnings
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.convex.solver import Status, solve_newton
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.rotations import rotation_angle
from shapefit.io import (
    read_dictionary,
    write_dictionary,
)
from shapefit.lifting.lift import lift
from shapefit.lifting.methods import METHODS
from shapefit.records import Landmarks
from tests.pipelines.fitted import failures, texts

PRIORLESS = [
    name for name, m in METHODS.items() if "prior" not in {n.name for n in m.needs}
]
"""Methods that the plain dictionary of these tests serves; the others have tests of
their own.
"""

NAMES = tuple(f"point{j}" for j in range(10))


class TestShapes:
    def test_an_exact_image_gives_its_shape_rotation_and_place(
        self, fit, dictionary, images, atoms, rotations, tmp_path
    ):
        result, outcomes = fit(dictionary, images, **{"lambda": 1e-4})
        assert failures(outcomes) == {}
        with h5py.File(tmp_path / "result.h5") as file:
            assert "dual" in file
            assert "convex_objective" not in file  # which is `objective`
        truth = 20 * rotations @ atoms[np.arange(8) % 6]
        truth[:, :2] += np.array([100.0, 50.0])[:, None]
        np.testing.assert_allclose(result.as_columns(), truth, atol=0.02)
        assert rotation_angle(result.rotation, rotations).max() < 0.1
        assert list(result.status) == ["optimal"] * 8
        assert (result.relative_gap <= 1e-4).all()
        assert result.unit == "px"
        assert result.y_axis == "down"

    def test_hidden_landmarks_are_filled_in_without_bias(
        self, fit, dictionary, images, atoms, rotations
    ):
        visible = images.as_columns().copy()
        images.landmarks[np.arange(8), np.arange(8)] = np.nan
        images.landmarks[np.arange(8), np.arange(8) - 1] = np.nan
        result, _ = fit(dictionary, images, **{"lambda": 1e-5})
        np.testing.assert_allclose(result.as_columns()[:, :2], visible, atol=0.02)
        depth = 20 * (rotations @ atoms[np.arange(8) % 6])[:, 2]
        np.testing.assert_allclose(result.as_columns()[:, 2], depth, atol=0.1)

    def test_a_landmark_counts_by_its_confidence(self, fit, dictionary, images):
        """The wrong landmark 3 is followed where it is sure, and hardly where it is
        not.
        """
        images.landmarks[:, 3] += 6.0
        confidence, rest = np.ones((8, 10)), []
        for sure in (0.1, 1.0, 10.0):
            confidence[:, 3] = sure
            result, _ = fit(dictionary, images.replaced(confidence=confidence.copy()))
            residual = (result.as_columns()[:, :2] - images.as_columns())[:, :, 3]
            rest.append(np.linalg.norm(residual, axis=1))
        assert (rest[0] > 1.5 * rest[1]).all()
        assert (rest[1] > 1.5 * rest[2]).all()

    @pytest.mark.parametrize("method", PRIORLESS)
    def test_zero_images_give_zero_results(self, fit, dictionary, atoms, method):
        edges = np.array([[0, 1], [1, 2]])
        prior = read_dictionary(dictionary).prior
        write_dictionary(
            dictionary, Dictionary(atoms, NAMES, atoms[0], edges=edges, prior=prior)
        )
        empty = Landmarks(
            np.empty((0, 2, 10)).swapaxes(1, 2), landmark_names=NAMES, items=()
        )
        result, outcomes = fit(dictionary, empty, method=method)
        assert result.as_columns().shape == (0, 3, 10)
        assert failures(outcomes) == {}


def rows(points, item):
    return "".join(
        f"{item},{n},{x},{y}\n" for n, (x, y) in zip(NAMES, points, strict=True)
    )


class TestFailures:
    @pytest.mark.parametrize(
        ("points", "reason"),
        [
            ([(0, 0), (1, 2)] + 8 * [("", "")], "only 2 visible landmarks"),
            (10 * [("", "nan")], "all landmarks are hidden"),
            (10 * [(3, 4)], "one point"),
            ([(j, 2 * j) for j in range(10)], "one line"),
        ],
    )
    def test_one_bad_image_never_stops_the_rest(
        self, fit, dictionary, rng, points, reason
    ):
        text = "item,landmark,x,y\n" + rows(rng.standard_normal((10, 2)), "good")
        text += rows(points, "bad") + rows(rng.standard_normal((10, 2)), "also good")
        result, outcomes = fit(dictionary, text)
        assert list(failures(outcomes)) == ["bad"]
        assert reason in failures(outcomes)["bad"]
        assert list(result.status) == ["optimal", Status.DEGENERATE.value, "optimal"]
        assert np.isnan(result.as_columns()[1]).all()
        assert np.isfinite(result.as_columns()[[0, 2]]).all()
        observed = [
            [float(c) if c != "" else np.nan for c in point] for point in points
        ]
        hidden = np.isnan(observed).any(axis=1, keepdims=True)
        expected = np.where(hidden, np.nan, observed)
        np.testing.assert_array_equal(result.column("landmarks")[1], expected)

    @pytest.mark.parametrize(
        ("factor", "reason"),
        [(1e306, "coordinates too large"), (1e-318, "landmarks too close together")],
    )
    @pytest.mark.parametrize(
        "keys",
        [
            {},
            {"lambda": "auto", "noise": 1e305},
            {"outliers": "ransac", "outlier_threshold": 10.0},
        ],
    )
    def test_coordinates_beyond_arithmetic_fail_without_a_murmur(
        self, fit, dictionary, images, factor, reason, keys
    ):
        landmarks = images.as_columns().copy()
        landmarks[3] *= factor
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result, outcomes = fit(
                dictionary, images.replaced(landmarks=landmarks.swapaxes(1, 2)), **keys
            )
        assert failures(outcomes)["image3"].startswith(reason)
        assert result.status[3] == Status.DEGENERATE.value
        # ransac also fails others: their atoms are far from the mean shape
        whole = np.isfinite(result.as_columns()).all(axis=(1, 2))
        assert [item in failures(outcomes) for item in images.items] == (
            ~whole
        ).tolist()
        assert whole.sum() == 7 or keys.get("outliers") == "ransac"

    def test_no_image_is_fitted_without_a_finite_shape(
        self, fit, dictionary, images, monkeypatch
    ):
        def lift_badly(*args):
            lifting = lift(*args)
            lifting.shapes[5:6, 2, 0] = np.inf
            return lifting

        monkeypatch.setattr("shapefit.pipelines.fit.atoms.lift", lift_badly)
        result, outcomes = fit(dictionary, images)
        assert failures(outcomes) == {
            "image5": "the fitted shape contains NaN or infinity"
        }
        assert result.status[5] == Status.NUMERICAL_FAILURE.value
        for values in (
            result.as_columns(),
            result.coefficients,
            result.rotation,
            result.objective,
        ):
            lost = np.isnan(values.reshape(8, -1)).all(axis=1)
            np.testing.assert_array_equal(lost, np.arange(8) == 5)

    def test_what_is_not_optimal_is_counted(self, fit, dictionary, images, monkeypatch):
        two = partial(solve_newton, max_iterations=2)
        monkeypatch.setattr("shapefit.pipelines.fit.atoms.solve_newton", two)
        _, outcomes = fit(dictionary, images, tolerance=1e-9)
        assert failures(outcomes) == {}
        assert texts(outcomes) == ["8 images not optimal"]

    def test_a_search_that_gives_up_names_its_limit(
        self, fit, dictionary, images, monkeypatch
    ):
        monkeypatch.setattr(
            "shapefit.lifting.global_optimum.limit_cells", lambda k, p: 1_000
        )
        _, outcomes = fit(dictionary, images, method="global", tolerance=1e-9)
        limit = "the search ended after 1,000 cells (docs/global.md)"
        assert f"8 images not optimal: {limit}" in texts(outcomes)

    @pytest.mark.parametrize(
        ("method", "text", "optimal"),
        [
            ("convex", r"8 images, all optimal, largest gap (\S+) \(", 8),
            ("global", r"8 images, all optimal, largest gap (\S+) \(", 8),
            ("convex+refine", r"8 images, within (\S+) of the convex bound \(", None),
            ("alternate", r"8 images \(()", None),
        ],
    )
    def test_the_gap_is_seen(self, fit, dictionary, images, method, text, optimal):
        result, outcomes = fit(dictionary, images, method=method)
        line = dict(outcomes[-1].rows)["Result"]
        numbers = outcomes[-1].numbers._asdict()
        assert numbers["images"] == 8
        assert numbers["optimal"] == optimal
        gap = None if result.relative_gap is None else result.relative_gap.max()
        assert numbers["largest_gap"] == gap
        (stated,) = re.match(text, line).groups()
        assert (stated == "") == (gap is None)
        if gap is not None:
            assert float(stated) == pytest.approx(gap, rel=0.06)

    def test_images_that_are_not_optimal_are_in_the_result_line(
        self, fit, dictionary, images, monkeypatch
    ):
        images.landmarks[2] = 0.0  # fails: it has no gap
        two = partial(solve_newton, max_iterations=2)
        monkeypatch.setattr("shapefit.pipelines.fit.atoms.solve_newton", two)
        result, outcomes = fit(dictionary, images, tolerance=1e-9)
        assert dict(outcomes[-1].rows)["Result"].startswith(
            f"8 images, 7 not optimal, largest gap {np.nanmax(result.relative_gap):.1e}"
        )
        numbers = outcomes[-1].numbers._asdict()
        assert numbers["optimal"] == 0
        assert numbers["not_optimal"] == 7

    @pytest.mark.parametrize(
        "keys",
        [{}, {"method": "alternate"}, {"outliers": "l1"}, {"method": "convex+refine"}],
        ids=str,
    )
    def test_empty_shapes_are_counted_and_have_no_rotation(
        self, fit, dictionary, images, keys
    ):
        images.landmarks[2] = 0.0  # fails, and is not counted a second time
        result, outcomes = fit(dictionary, images, **keys, **{"lambda": 1e3})
        assert list(failures(outcomes)) == ["image2"]
        (warning,) = [text for text in texts(outcomes) if "empty shape" in text]
        assert warning.startswith(
            "7 images with an empty shape: lambda is at or above lambda_max"
        )
        assert np.isnan(result.rotation).all()
        empty = np.arange(8) != 2
        assert not np.ptp(result.as_columns()[empty], axis=2).any()
        if "outliers" not in keys:  # l1 places it at the median
            middle = result.as_columns()[empty, :2].mean(axis=2)
            np.testing.assert_allclose(middle, images.as_columns()[empty].mean(axis=2))
        _, outcomes = fit(dictionary, images, **keys, **{"lambda": 1e-3})
        assert not any("empty shape" in text for text in texts(outcomes))

    def test_a_refused_input_leaves_the_old_result(self, fit, tmp_path, dictionary):
        (tmp_path / "result.h5").write_text("old")
        with pytest.raises(InputError, match=r"views\.csv:2"):
            fit(dictionary, "item,landmark,x,y\none,point0,abc,1\n")
        assert (tmp_path / "result.h5").read_text() == "old"
        names = ["dictionary.h5", "result.h5", "views.csv"]
        assert sorted(path.name for path in tmp_path.iterdir()) == names


class TestRecord:
    def test_further_datasets_are_carried_but_not_taken_for_those_of_the_fit(
        self, fit, dictionary, images
    ):
        mine = {name: np.full(8, -7.0) for name in ("status", "lambda", "outliers")}
        extras = {**mine, "subject": np.full(8, -7.0)}
        result, _ = fit(dictionary, images.with_extras(extras))
        for name in ("true_rotation", "camera_matrix"):
            np.testing.assert_array_equal(result.column(name), images.column(name))
        assert list(result.status) == ["optimal"] * 8
        np.testing.assert_array_equal(result.column("lambda"), 0.1)
        assert result.outliers is None
        for name in (*(f"input_{name}" for name in mine), "subject"):
            np.testing.assert_array_equal(result.column(name), -7.0)
        assert result.sequences == images.sequences
        assert json.loads(result.attributes["config"])["method"] == "convex"
        inputs = {Path(name).name for name in json.loads(result.attributes["inputs"])}
        assert inputs == {"views.h5", "dictionary.h5"}


def test_a_refined_view_says_the_gap_of_its_convex_program(
    fit, dictionary, images, tmp_path
):
    camera = {"focal": 900.0, "principal_point": [100.0, 50.0]}
    result, outcomes = fit(dictionary, images, camera=camera)
    assert result.relative_gap is None
    with h5py.File(tmp_path / "result.h5") as file:
        largest = file["convex_relative_gap"][()].max()
    line = dict(outcomes[-1].rows)["Result"]
    assert line.startswith(f"8 images, convex programs within {largest:.1e} (")
    assert outcomes[-1].numbers.largest_gap is None
