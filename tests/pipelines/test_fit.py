"""`fit` from files to files: shapes that come back, items that fail, inputs that are refused."""

from __future__ import annotations

import csv
import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.convex.solution import Status
from shapefit.convex.spectral_norm import nuclear_norm
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations, rotation_about, rotation_angle
from shapefit.io import LandmarkSet, landmark_writer, read_results, write_dictionary
from shapefit.lifting.lift import lift
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit import run

NAMES = tuple(f"point{j}" for j in range(10))
LANDMARK_ROWS = "item,landmark,x,y\n"


@pytest.fixture
def atoms(rng):
    return normalise(rng.standard_normal((6, 3, 10))).points / 5


@pytest.fixture
def dictionary(tmp_path, atoms):
    path = tmp_path / "dictionary.h5"
    write_dictionary(path, Dictionary(atoms, NAMES, normalise(atoms.mean(0)).points))
    return path


@pytest.fixture
def rotations(rng):
    return random_rotations(8, rng)


@pytest.fixture
def images(atoms, rotations):
    """One atom each, turned, 20 px large, at (100, 50)."""
    shapes = 20 * rotations @ atoms[np.arange(8) % 6]
    return LandmarkSet(
        landmarks=shapes[:, :2] + np.array([100.0, 50.0])[:, None],
        landmark_names=NAMES,
        items=tuple(f"image{i}" for i in range(8)),
        sequences=("a",) * 4 + ("b",) * 4,
        unit="px",
        y_axis="down",
        extras={"true_rotation": rotations, "camera_matrix": np.eye(3)},
    )


@pytest.fixture
def views(atoms, rng):
    """Neighbours that are alike, for warm starts; the last one alone in its stretch of 64."""
    n = 193
    turns = rotation_about(np.array([0.0, 1.0, 0.0]), np.linspace(0, 6, n))
    mixed = np.einsum("nk,kap->nap", rng.random((n, 6)) * (rng.random((n, 6)) < 0.5), atoms)
    landmarks = 20 * (turns @ mixed)[:, :2] + 0.5 * rng.standard_normal((n, 2, 10))
    return LandmarkSet(
        landmarks=landmarks, landmark_names=NAMES, items=tuple(f"view{i}" for i in range(n))
    )


def write(path: Path, images: LandmarkSet) -> Path:
    with landmark_writer(path) as writer:
        writer.append(images)
    return path


def fit(folder, dictionary, images, **keys):
    """Fit landmarks given as records, text or a path; returns results and outcomes."""
    path = images
    if isinstance(images, LandmarkSet):
        path = write(folder / "views.h5", images)
    elif isinstance(images, str):
        path = folder / "views.csv"
        path.write_text(images)
    config = FitConfig(
        landmarks=[str(path)], dictionary=str(dictionary), output=str(folder / "result.h5"), **keys
    )
    outcomes = list(run(config))
    return read_results(config.output), outcomes


def scaled(images, factor):
    return LandmarkSet(
        landmarks=images.landmarks * factor, landmark_names=NAMES, items=images.items
    )


def failures(outcomes):
    return {f.item: f.reason for outcome in outcomes for f in outcome.failures}


def rows(points, item="one", names=NAMES):
    return "".join(f"{item},{n},{x},{y}\n" for n, (x, y) in zip(names, points, strict=True))


class TestShapes:
    def test_an_exact_image_gives_its_shape_rotation_and_place(
        self, tmp_path, dictionary, images, atoms, rotations
    ):
        found, outcomes = fit(tmp_path, dictionary, images, **{"lambda": 1e-4})
        assert failures(outcomes) == {}
        truth = 20 * rotations @ atoms[np.arange(8) % 6]
        truth[:, :2] += np.array([100.0, 50.0])[:, None]
        np.testing.assert_allclose(found.shapes, truth, atol=0.02)
        np.testing.assert_allclose(found.landmarks_fitted, found.shapes[:, :2])
        assert rotation_angle(found.rotation, rotations).max() < 0.1
        assert list(found.status) == ["optimal"] * 8
        assert (found.relative_gap <= 1e-4).all()
        assert (found.unit, found.y_axis) == ("px", "down")

    def test_hidden_landmarks_are_filled_in_without_bias(
        self, tmp_path, dictionary, images, atoms, rotations
    ):
        seen = images.landmarks.copy()
        images.landmarks[np.arange(8), :, np.arange(8)] = np.nan
        images.landmarks[np.arange(8), :, np.arange(8) - 1] = np.nan
        found, _ = fit(tmp_path, dictionary, images, **{"lambda": 1e-5})
        np.testing.assert_allclose(found.landmarks_fitted, seen, atol=0.02)
        depth = 20 * (rotations @ atoms[np.arange(8) % 6])[:, 2]
        np.testing.assert_allclose(found.shapes[:, 2], depth, atol=0.1)

    def test_what_lies_under_a_confidence_of_zero_is_irrelevant(self, tmp_path, dictionary, images):
        confidence = np.ones((8, 10))
        confidence[:, 3] = 0
        first = LandmarkSet(
            landmarks=images.landmarks, confidence=confidence, landmark_names=NAMES,
            items=images.items,
        )  # fmt: skip
        garbage = images.landmarks.copy()
        garbage[:, :, 3] = 1e9
        second = LandmarkSet(
            landmarks=garbage, confidence=confidence, landmark_names=NAMES, items=images.items
        )
        a, _ = fit(tmp_path, dictionary, first)
        b, _ = fit(tmp_path, dictionary, second)
        np.testing.assert_array_equal(a.shapes, b.shapes)
        seen = np.where(confidence[:, :, None] > 0, images.landmarks.swapaxes(1, 2), np.nan)
        np.testing.assert_array_equal(a.extras["landmarks"], seen)
        np.testing.assert_array_equal(b.extras["landmarks"], seen)

    def test_permuted_landmarks_simply_work(self, tmp_path, dictionary, images):
        order = [3, 1, 4, 0, 5, 9, 2, 6, 8, 7]
        permuted = LandmarkSet(
            landmarks=images.landmarks[:, :, order],
            landmark_names=tuple(NAMES[j] for j in order),
            items=images.items,
            extras={"corrupted": np.eye(8, 10, dtype=bool)[:, order]},
        )
        a, _ = fit(tmp_path, dictionary, images)
        b, _ = fit(tmp_path, dictionary, permuted)
        np.testing.assert_array_equal(a.shapes, b.shapes)
        np.testing.assert_array_equal(b.extras["corrupted"].astype(bool), np.eye(8, 10))
        assert b.landmark_names == NAMES

    @pytest.mark.parametrize("factor", [2.0**-30, 2.0**53])
    def test_powers_of_two_scale_to_the_last_bit(self, tmp_path, dictionary, images, factor):
        a, _ = fit(tmp_path, dictionary, images)
        b, _ = fit(tmp_path, dictionary, scaled(images, factor))
        np.testing.assert_array_equal(b.shapes, a.shapes * factor)
        np.testing.assert_array_equal(b.coefficients, a.coefficients)

    @pytest.mark.parametrize("factor", [1e-9, 9.46e15])
    def test_units_from_nanometres_to_light_years(self, tmp_path, dictionary, images, factor):
        keys = {"solver": {"tolerance": 1e-11}}
        a, _ = fit(tmp_path, dictionary, images, **keys)
        b, _ = fit(tmp_path, dictionary, scaled(images, factor), **keys)
        np.testing.assert_allclose(b.shapes / factor, a.shapes, rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(b.objective, a.objective, rtol=1e-10)

    @pytest.mark.parametrize(
        "keys",
        [{"method": method} for method in METHODS if method != "pmp"]
        + [{"loss": loss} for loss in ("exact", "l1", "sparse-error")]
        + [{"method": "convex+refine", "loss": "l1"}]
        + [{"path": [1.0, 0.1, 0.01]}, {"solver": {"name": "admm"}}]
        + [{"outliers": {"method": method}} for method in ("ransac", "truncated")],
        ids=str,
    )
    def test_chunks_and_threads_do_not_change_a_bit(self, tmp_path, dictionary, views, keys):
        base, outcomes = fit(tmp_path, dictionary, views, threads=1, **keys)
        assert [outcome.done for outcome in outcomes] == [193, 0]
        for others in ({"threads": 2}, {"chunk": 1}, {"chunk": 100}, {"chunk": 192, "threads": 2}):
            again, outcomes = fit(tmp_path, dictionary, views, **others, **keys)
            assert sum(outcome.done for outcome in outcomes) == 193
            assert len(outcomes) > 2 or "chunk" not in others
            for name in ("shapes", "landmarks_fitted", "coefficients", "rotation", "objective"):
                found = getattr(again, name)
                if found is not None:
                    np.testing.assert_array_equal(found, getattr(base, name), name)
            assert again.extras.keys() == base.extras.keys()
            for name in again.extras:
                np.testing.assert_array_equal(again.extras[name], base.extras[name], name)

    def test_further_datasets_and_provenance_are_carried(self, tmp_path, dictionary, images):
        found, _ = fit(tmp_path, dictionary, images, transforms=True)
        np.testing.assert_array_equal(found.extras["true_rotation"], images.extras["true_rotation"])
        np.testing.assert_array_equal(found.extras["camera_matrix"], np.eye(3))
        assert found.sequences == images.sequences
        assert found.transforms.shape == (8, 6, 2, 3)
        assert json.loads(found.attributes["config"])["method"] == "convex"
        inputs = {Path(name).name for name in json.loads(found.attributes["inputs"])}
        assert inputs == {"views.h5", "dictionary.h5"}

    @pytest.mark.parametrize("method", METHODS)
    def test_zero_images_give_zero_results(self, tmp_path, dictionary, atoms, method):
        edges = np.array([[0, 1], [1, 2]])
        write_dictionary(dictionary, Dictionary(atoms, NAMES, atoms[0], edges=edges))
        empty = LandmarkSet(landmarks=np.empty((0, 2, 10)), landmark_names=NAMES, items=())
        found, outcomes = fit(tmp_path, dictionary, empty, method=method)
        assert found.shapes.shape == (0, 3, 10)
        assert failures(outcomes) == {}

    @pytest.mark.parametrize("method", ["convex+refine", "alternate", "alternate+", "mean-shape"])
    def test_every_method_gives_shapes_on_the_landmarks(self, tmp_path, dictionary, images, method):
        found, outcomes = fit(tmp_path, dictionary, images, method=method)
        assert failures(outcomes) == {}
        assert np.isfinite(found.shapes).all()
        assert found.attributes["method"] == method
        np.testing.assert_allclose(found.shapes[:, :2], found.landmarks_fitted)
        if method != "mean-shape":  # alternate may end in a local minimum
            assert np.median(found.extras["residual"]) < 0.05

    def test_the_paper_s_solver_agrees(self, tmp_path, dictionary, images):
        a, _ = fit(tmp_path, dictionary, images)
        b, _ = fit(tmp_path, dictionary, images, solver={"name": "admm"})
        np.testing.assert_allclose(a.objective, b.objective, rtol=2e-4)


class TestFamily:
    @pytest.mark.parametrize("loss", ["sparse-error", "l1"])
    def test_robust_losses_find_the_planted_outliers(self, tmp_path, atoms, images, loss):
        one = tmp_path / "one.h5"  # with more atoms than landmarks need, anything fits
        write_dictionary(one, Dictionary(atoms[:1], NAMES, atoms[0]))
        few = images.take([0, 6])  # the ones that show this atom
        few.landmarks[np.arange(2), 0, np.arange(2)] += 30
        wrong = np.eye(2, 10, dtype=bool)
        found, _ = fit(tmp_path, one, few, loss=loss, beta=0.2, **{"lambda": 0.01})
        judged = found.extras["outliers"].astype(bool)
        assert judged[wrong].all()
        # beta bounds the pull of an outlier, it does not end it: another may come to lie beyond
        assert (judged & ~wrong).sum() <= (1 if loss == "sparse-error" else 0)
        plain, _ = fit(tmp_path, one, few)
        assert "outliers" not in plain.extras
        good = ~wrong
        robust, squared = (
            np.linalg.norm(part.landmarks_fitted - few.landmarks, axis=1)[good].max()
            for part in (found, plain)
        )
        assert robust < (0.5 if loss == "l1" else 3.0) < squared

    def test_the_exact_loss_leaves_no_residual(self, tmp_path, dictionary, images):
        found, _ = fit(tmp_path, dictionary, images, loss="exact", solver={"tolerance": 1e-8})
        assert found.extras["residual"].max() < 1e-8

    def test_lambda_follows_the_noise(self, tmp_path, dictionary, images):
        low, _ = fit(tmp_path, dictionary, images, **{"lambda": "auto", "noise": 0.5})
        high, _ = fit(tmp_path, dictionary, images, **{"lambda": "auto", "noise": 1.0})
        np.testing.assert_allclose(high.extras["lambda"], 2 * low.extras["lambda"])
        np.testing.assert_allclose(
            low.extras["lambda"] * low.scale, low.extras["lambda"][0] * low.scale[0]
        )

    def test_a_path_gives_what_single_fits_give(self, tmp_path, dictionary, images):
        lambdas = [0.5, 0.1, 0.02]
        path, _ = fit(tmp_path, dictionary, images, path=lambdas)
        np.testing.assert_array_equal(path.extras["path_lambda"], np.tile(lambdas, (8, 1)))
        assert (path.extras["path_relative_gap"] <= 1e-4).all()
        for column, lam in enumerate(lambdas):
            single, _ = fit(tmp_path, dictionary, images, **{"lambda": lam})
            np.testing.assert_allclose(
                path.extras["path_objective"][:, column], single.objective, rtol=2e-4
            )
        assert (np.diff(path.extras["path_residual"], axis=1) < 0).all()


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
    def test_one_bad_image_never_stops_the_rest(self, tmp_path, dictionary, rng, points, reason):
        text = LANDMARK_ROWS + rows(rng.standard_normal((10, 2)), "good")
        text += rows(points, "bad") + rows(rng.standard_normal((10, 2)), "also good")
        found, outcomes = fit(tmp_path, dictionary, text)
        assert list(failures(outcomes)) == ["bad"]
        assert reason in failures(outcomes)["bad"]
        assert list(found.status) == ["optimal", Status.DEGENERATE.value, "optimal"]
        assert np.isnan(found.shapes[1]).all()
        assert np.isfinite(found.shapes[[0, 2]]).all()
        observed = [[float(c) if c != "" else np.nan for c in point] for point in points]
        hidden = np.isnan(observed).any(axis=1, keepdims=True)
        np.testing.assert_array_equal(
            found.extras["landmarks"][1], np.where(hidden, np.nan, observed)
        )

    @pytest.mark.parametrize(
        ("factor", "reason"),
        [
            (1e200, "coordinates too large"),
            (1e306, "coordinates too large"),
            (1e-200, "landmarks too close together"),
            (1e-318, "landmarks too close together"),
        ],
    )
    @pytest.mark.parametrize(
        "keys",
        [{}, {"lambda": "auto", "noise": 1e305}]
        + [{"outliers": {"method": m, "threshold": 10.0}} for m in ("ransac", "truncated")],
    )
    def test_coordinates_beyond_arithmetic_fail_without_a_murmur(
        self, tmp_path, dictionary, images, factor, reason, keys
    ):
        landmarks = images.landmarks.copy()
        landmarks[3] *= factor
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found, outcomes = fit(
                tmp_path, dictionary, replace(images, landmarks=landmarks), **keys
            )
        assert failures(outcomes).pop("image3").startswith(reason)
        assert found.status[3] == Status.DEGENERATE.value
        # ransac also fails others: their atoms are far from the mean shape
        whole = np.isfinite(found.shapes).all(axis=(1, 2))
        assert [item in failures(outcomes) for item in images.items] == (~whole).tolist()
        assert whole.sum() == 7 or keys.get("outliers", {}).get("method") == "ransac"

    def test_no_image_is_fitted_without_a_finite_shape(
        self, tmp_path, dictionary, images, monkeypatch
    ):
        def lift_badly(*args):
            lifting = lift(*args)
            lifting.shapes[5, 2, 0] = np.inf
            return lifting

        monkeypatch.setattr("shapefit.pipelines.lifting_chain.lift", lift_badly)
        found, outcomes = fit(tmp_path, dictionary, images)
        assert failures(outcomes) == {"image5": "the shape found is not finite"}
        assert found.status[5] == Status.NUMERICAL_FAILURE.value
        for values in (found.shapes, found.coefficients, found.rotation, found.objective):
            lost = np.isnan(values.reshape(8, -1)).all(axis=1)
            np.testing.assert_array_equal(lost, np.arange(8) == 5)

    def test_strict_counts_what_is_not_optimal(self, tmp_path, dictionary, images):
        keys = {"solver": {"max_iterations": 1, "tolerance": 1e-9}}
        _, outcomes = fit(tmp_path, dictionary, images, **keys)
        assert failures(outcomes) == {}
        assert any("not optimal" in w for outcome in outcomes for w in outcome.warnings)
        found, outcomes = fit(tmp_path, dictionary, images, strict=True, **keys)
        assert set(failures(outcomes)) == set(images.items)
        assert "iteration limit after 1 iteration, relative gap" in failures(outcomes)["image0"]
        assert (found.relative_gap > 1e-9).all()


class TestEmptyShapes:
    @pytest.mark.parametrize(
        "keys", [{}, {"method": "alternate"}, {"loss": "l1"}, {"method": "convex+refine"}], ids=str
    )
    def test_are_told_of_and_have_no_rotation(self, tmp_path, dictionary, images, keys):
        for lam, count in ((1e3, 7), (1e-3, 0)):
            landmarks = images.landmarks.copy()
            landmarks[2] = 0.0  # fails, and is not told of a second time
            some = replace(images, landmarks=landmarks)
            found, outcomes = fit(tmp_path, dictionary, some, **keys, **{"lambda": lam})
            assert list(failures(outcomes)) == ["image2"]
            empty = ~(np.ptp(found.shapes, axis=2) > 0).any(axis=1) & (np.arange(8) != 2)
            told = [w for outcome in outcomes for w in outcome.warnings if "empty" in w]
            if not count:
                assert not empty.any()
                assert told == []
            else:
                assert empty.sum() == count
                (warning,) = told
                assert warning.startswith("7 images with an empty shape")
                assert "lambda_max" in warning
                assert np.isnan(found.rotation).all()
                if "loss" not in keys:  # l1 places it at the median
                    middle = found.landmarks_fitted[empty].mean(axis=2)
                    np.testing.assert_allclose(middle, images.landmarks[empty].mean(axis=2))

    def test_lambda_max_is_the_border(self, tmp_path, dictionary, images, atoms):
        one = images.take([1])
        largest = nuclear_norm(normalise(one.landmarks).points @ atoms.swapaxes(1, 2)).max()
        for factor, count in ((1.01, 1), (0.99, 0)):
            _, outcomes = fit(tmp_path, dictionary, one, **{"lambda": factor * largest})
            told = [w for outcome in outcomes for w in outcome.warnings]
            assert len(told) == count


class TestInputsThatAreRefused:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "views.csv"),
            (LANDMARK_ROWS + "one,point0,abc,1\n", "views.csv:2"),
            (LANDMARK_ROWS + "one,point0,inf,1\n", "views.csv:2"),
            (LANDMARK_ROWS + "one,poimt0,1,1\n", "point0"),
            (LANDMARK_ROWS + "one,point0,1,1\none,point0,2,2\n", "views.csv:3"),
            ("item,landmark,x\none,point0,1\n", "y"),
        ],
    )
    def test_the_message_names_the_place_and_the_old_result_stays(
        self, tmp_path, dictionary, text, message
    ):
        old = tmp_path / "result.h5"
        old.write_text("old")
        with pytest.raises(InputError, match=message):
            fit(tmp_path, dictionary, text)
        assert old.read_text() == "old"
        assert sorted(p.name for p in tmp_path.iterdir()) == [
            "dictionary.h5",
            "result.h5",
            "views.csv",
        ]

    def test_a_dictionary_that_is_none(self, tmp_path, images):
        other = write(tmp_path / "other.h5", images)
        with pytest.raises(InputError, match="shapefit-dictionary"):
            fit(tmp_path, other, images)

    def test_a_missing_output_folder(self, tmp_path, dictionary, images):
        config = FitConfig(
            landmarks=[str(write(tmp_path / "views.h5", images))],
            dictionary=str(dictionary),
            output=str(tmp_path / "missing" / "result.h5"),
        )
        with pytest.raises(InputError, match="missing"):
            list(run(config))

    def test_csv_out(self, tmp_path, dictionary, images):
        config = FitConfig(
            landmarks=[str(write(tmp_path / "views.h5", images))],
            dictionary=str(dictionary),
            output=str(tmp_path / "shapes.csv"),
        )
        list(run(config))
        with config.output.open() as file:
            table = list(csv.DictReader(file))
        assert len(table) == 80
        assert list(table[0]) == ["item", "landmark", "x", "y", "z", "sequence"]
