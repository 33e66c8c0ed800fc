"""Lifting images: outliers, borders, atoms that an image does without, error bars."""

from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from shapefit.config.paths import find_dictionary
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    read_dictionary,
    write_dictionary,
)
from shapefit.lifting import trust
from shapefit.lifting.posterior.p_value import with_p_value_table
from shapefit.pipelines.fit.image_posterior import ImagePosterior, find_at_border
from shapefit.records import Landmarks
from tests.io.files import load
from tests.pipelines.fitted import done, failures, warnings


def spoil(views, share, rng):
    """Put a share of the visible landmarks of each image anywhere in the box of the
    others.
    """
    visible = views.visible()
    w = views.as_columns()
    rank = (
        np.where(visible, rng.random(visible.shape), np.inf)
        .argsort(axis=1)
        .argsort(axis=1)
    )
    wrong = rank < np.round(share * visible.sum(axis=1, keepdims=True))
    low, high = (f(w, axis=2, keepdims=True) for f in (np.nanmin, np.nanmax))
    landmarks = np.where(wrong[:, None], low + (high - low) * rng.random(w.shape), w)
    return views.replaced(landmarks=landmarks.swapaxes(1, 2)), wrong


class TestOutliers:
    """`outliers: ransac`: wrong landmarks are as good as hidden, and marked."""

    @pytest.fixture
    def views(self, project):
        """Views of the cars with at least 12 visible landmarks."""
        views = load(project / "sample_data" / "cars_views.h5")
        return views.take(np.isfinite(views.as_columns()[:, 0]).sum(axis=1) >= 12)

    @pytest.fixture
    def run(self, fit, tmp_path, made_cars):
        """Return what fits images; it gives the result and the failures."""

        def run(images, **keys):
            write_dictionary(tmp_path / "dict.h5", made_cars)
            result, outcomes = fit(tmp_path / "dict.h5", images, **keys)
            return result, failures(outcomes)

        return run

    @pytest.mark.parametrize("method", ["convex", "alternate", "mean-shape"])
    def test_they_are_as_good_as_hidden_but_marked(self, method, run, views, rng):
        spoilt, wrong = spoil(views, 0.3, rng)
        result, lost = run(spoilt, method=method, outliers="ransac")
        assert not lost
        labels = result.column("outliers").astype(bool)
        assert not labels[~spoilt.visible()].any()
        assert (labels & wrong).sum() > 0.85 * max(labels.sum(), wrong.sum())
        observed = np.swapaxes(spoilt.as_columns(), 1, 2)
        np.testing.assert_array_equal(result.column("landmarks"), observed)
        hidden = spoilt.replaced(
            landmarks=np.where(labels[:, None], np.nan, spoilt.as_columns()).swapaxes(
                1, 2
            )
        )
        without, _ = run(hidden, method=method)
        np.testing.assert_array_equal(result.points, without.points)
        np.testing.assert_array_equal(result.scale, without.scale)
        assert without.outliers is None

    def test_what_is_drawn_belongs_to_the_name_of_an_image(self, run, views, rng):
        spoilt, _ = spoil(views.take(slice(8)), 0.3, rng)
        keys = {"outliers": "ransac", "method": "mean-shape"}
        (whole, _), (some, _) = run(spoilt, **keys), run(spoilt.take([6, 1]), **keys)
        np.testing.assert_array_equal(
            some.column("outliers"), whole.column("outliers")[[6, 1]]
        )

    def test_images_that_cannot_be_searched_or_lifted(self, run, views, rng):
        images = views.take(slice(6))
        landmarks = images.as_columns().copy()
        visible = [np.flatnonzero(np.isfinite(landmarks[i, 0])) for i in range(6)]
        landmarks[0][:, visible[0][3:]] = np.nan  # three landmarks
        landmarks[1][:, visible[1][2:]] = np.nan
        landmarks[2][:, visible[2]] = 5.0  # all on one point
        landmarks[3][:, visible[3][5:]] = np.nan  # five landmarks of another shape
        landmarks[3][:, visible[3][:5]] = rng.uniform(0, 1e3, (2, 5))
        landmarks[4] = np.nan
        keys = {
            "outliers": "ransac",
            "outlier_threshold": 0.01,
            "method": "convex+refine",
        }
        result, lost = run(images.replaced(landmarks=landmarks.swapaxes(1, 2)), **keys)
        assert [lost.get(name, "") for name in images.items] == [
            "",
            "only 2 visible landmarks, 3 are needed",
            "all visible landmarks are at one point",
            "fewer than 4 visible landmarks, not all on one line, agree",
            "all landmarks are hidden",
            "",
        ]
        labels = result.column("outliers").astype(bool)
        assert not labels[[0, 1, 2, 4]].any()
        assert labels[3].sum() == 5
        assert np.isfinite(result.as_columns()[0]).all()
        assert np.isnan(result.as_columns()[1:5]).all()


NAMES = tuple(f"point{j}" for j in range(10))
MODELS = ("golf", "jetta", "passat", "polo", "up")
SHOWN = ("polo", "golf", "polo", "up", "jetta", "golf", "passat", "up", "polo")
THROUGH_ALL = {
    "method": "convex+refine",
    "outliers": "ransac",
    "camera": {"focal": 900, "principal_point": [100, 100]},
}


def check_same(one, other, rows=slice(None)):
    """Assert that rows of a result are another in all that a fit finds, but for axes of
    atoms.
    """
    for name in (
        "shapes",
        "rotation",
        "translation",
        "scale",
        "objective",
        "iterations",
        "status",
    ):
        np.testing.assert_array_equal(
            getattr(one, name)[rows], getattr(other, name), err_msg=name
        )
    for name in ("landmarks", "lambda", "residual"):
        np.testing.assert_array_equal(one.column(name)[rows], other.column(name))


class TestLeaveOneOut:
    """The model that an image shows has no part in its fit, whatever it looks like."""

    @pytest.fixture
    def models(self, rng):
        """Five exemplars in metres, `polo` also as its mirror image."""
        atoms = normalise(
            rng.standard_normal((3, 10)) + 0.4 * rng.standard_normal((6, 3, 10))
        )
        return Dictionary(
            atoms=atoms.points,
            landmark_names=NAMES,
            mean_shape=normalise(atoms.points.mean(axis=0)).points,
            atom_scale=rng.uniform(1, 2, 6),
            unit="m",
            atom_items=(*MODELS, "polo"),
        )

    @pytest.fixture
    def images(self, rng, models):
        """Nine images of the models; one shows two landmarks only."""
        shapes = models.atoms[[models.atom_items.index(name) for name in SHOWN]]
        landmarks = 20 * (random_rotations(9, rng) @ shapes)[:, :2] + 100
        landmarks += 0.5 * rng.standard_normal(landmarks.shape)
        landmarks[5, :, 2:] = np.nan
        return Landmarks(
            landmarks.swapaxes(1, 2),
            landmark_names=NAMES,
            items=tuple(f"image{i}" for i in range(9)),
            unit="px",
            extras={
                "true_model": np.array(SHOWN, dtype=object),
                "box": np.ones((9, 4)),
            },
        )

    @pytest.fixture
    def run(self, fit, tmp_path, models, images):
        """Return what fits images with a dictionary."""

        def run(dictionary=models, views=images, leave_one_out="true_model", **keys):
            write_dictionary(tmp_path / "dict.h5", dictionary)
            return fit(tmp_path / "dict.h5", views, leave_one_out=leave_one_out, **keys)

        return run

    @pytest.mark.parametrize(
        "keys",
        [{"method": m} for m in ("convex", "alternate", "mean-shape")] + [THROUGH_ALL],
    )
    def test_each_image_has_the_dictionary_of_the_other_models(
        self, run, models, images, keys
    ):
        """Whose mean is another one: no stage of the fit has seen the model."""
        result, outcomes = run(**keys)
        assert warnings(outcomes) == []
        items = np.array(models.atom_items)
        for model in MODELS:
            rows = [i for i in range(9) if SHOWN[i] == model]
            retained = items != model
            mean = normalise(models.atoms[retained].mean(axis=0)).points
            others = Dictionary(models.atoms[retained], NAMES, mean)
            expected, _ = run(others, images.take(rows), leave_one_out=None, **keys)
            check_same(result, expected, rows)
            if expected.coefficients is not None:
                coefficients = result.coefficients[rows][:, retained]
                np.testing.assert_array_equal(coefficients, expected.coefficients)

    def test_chunks_and_models_that_the_dictionary_lacks(
        self, run, images, monkeypatch
    ):
        shown = np.array(
            ["beetle" if name == "up" else name for name in SHOWN], dtype=object
        )
        odd = images.replaced(extras={"true_model": shown})
        whole, _ = run(views=odd, method="mean-shape")
        assert list(whole.column("omitted")) == [
            "" if name == "beetle" else name for name in shown
        ]
        monkeypatch.setattr("shapefit.pipelines.fit.family.IMAGES_PER_BLOCK", 1)
        monkeypatch.setattr("shapefit.pipelines.fit.fit.IMAGES_PER_BATCH", 2)
        parts, outcomes = run(views=odd, method="mean-shape")
        assert done(outcomes) == 9
        check_same(whole, parts)
        all_atoms, _ = run(
            views=images.take([3, 7]), leave_one_out=None, method="mean-shape"
        )
        check_same(whole, all_atoms, [3, 7])

    @pytest.mark.parametrize(
        ("items", "omit", "message"),
        [
            (
                (*MODELS, "polo"),
                "true_modle",
                "no dataset 'true_modle' .* one of: item, true_model",
            ),
            ((*MODELS, "polo"), "box", "no dataset 'box' with one name per image"),
            (
                None,
                "true_model",
                "atoms of the dictionary are of no items; .*method: exemplars",
            ),
            (("golf",) * 6, "true_model", "atoms of the dictionary are of 1 items"),
            (
                (*MODELS, "polo"),
                "item",
                "show no items of the dictionary; .* golf, jetta, passat",
            ),
        ],
    )
    def test_names_that_leave_nothing_out_are_refused(
        self, run, tmp_path, models, items, omit, message
    ):
        with pytest.raises(InputError, match=f"leave_one_out: .*{message}"):
            run(replace(models, atom_items=items), leave_one_out=omit)
        assert not (tmp_path / "result.h5").exists()


W, H = 640.0, 480.0


@pytest.mark.parametrize(
    ("points", "hidden"),
    [
        ([(300, 400), (300, 478), (320, 479), (300, 100)], "knee ankle"),
        (
            [(300, 400), (300, 470), (320, 479), (300, 100)],
            "",
        ),  # its neighbour is in the image
        ([(300, 479), (300, 470), (320, 479), (300, 100)], ""),  # no neighbours
        ([(3, 200), (2, 300), (300, 400), (5, 100)], "hip knee head"),
        ([(3, 200), (638, 300), (300, 400), (300, 100)], ""),  # of other sides
        (
            [(634, 200), (634, 300), (300, 400), (300, 100)],
            "hip knee",
        ),  # within 6.4 pixels
    ],
)
def test_neighbours_at_one_border_are_not_seen(points, hidden):
    names, edges = ("hip", "knee", "ankle", "head"), np.array([[0, 1], [1, 2], [0, 3]])

    def marked(size=None, names_of_edges=names, **columns):
        images = Landmarks(
            np.array(points, float).T[None].swapaxes(1, 2),
            landmark_names=names,
            items=("a",),
            file_extras=columns,
        )
        dictionary = SimpleNamespace(edges=edges, landmark_names=names_of_edges)
        return find_at_border(images, dictionary, size)[0]

    for result in (marked((W, H)), marked(image_size=np.array([W, H]))):
        assert [
            name for name, at in zip(names, result, strict=True) if at
        ] == hidden.split()
    assert not marked().any()
    assert not marked((W, H), tuple("abcd")).any()


def test_a_confidence_of_the_least_that_counts_is_seen():
    scores = np.array([[0.0, 0.29, 0.3, 0.31, 7.0]])
    images = Landmarks(
        np.ones((1, 2, 5)).swapaxes(1, 2),
        landmark_names=tuple("abcde"),
        items=("0",),
        confidence=scores,
    )
    people = read_dictionary(find_dictionary("people"))
    posterior = ImagePosterior(dictionary=people, min_confidence=0.3)
    assert posterior.weigh(images).tolist() == [[0, 0, 1, 1, 1]]


@pytest.fixture
def with_prior(dictionary, atoms, rng):
    """The dictionary with a prior of two Gaussians about its atoms."""
    known = read_dictionary(dictionary)
    B = 0.1 * rng.standard_normal((2, 30, 30))
    C = B @ B.swapaxes(1, 2) / 30 + 0.01 * np.eye(30)
    means = 5 * np.stack([atoms[:3].mean(axis=0), atoms[3:].mean(axis=0)])
    made = replace(known, prior=Mixture(np.array([0.7, 0.3]), means, C))
    write_dictionary(dictionary, with_p_value_table(made))
    return dictionary


def test_results_hold_error_bars_in_the_unit_of_the_landmarks(fit, with_prior, images):
    keys = {"method": "posterior", "save": {"covariance": True}}
    keys |= {"camera": {"focal": "none"}}
    found, _ = fit(with_prior, images, **keys)
    covariance = found.column("shape_covariance")
    assert covariance.shape == (8, 30, 30)
    variance = np.diagonal(covariance, axis1=1, axis2=2).reshape(8, 10, 3)
    assert found.shape_sd**2 == pytest.approx(variance)
    blocks = covariance.reshape(8, 10, 3, 10, 3)
    sd, correlation = found.shape_sd, found.column("shape_correlation")
    for row, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
        own = np.einsum("npp->np", blocks[:, :, a, :, b]) / (sd[..., a] * sd[..., b])
        assert correlation[..., row] == pytest.approx(own, abs=1e-6)
    assert ((found.column("p_value") >= 0) & (found.column("p_value") <= 1)).all()
    assert set(found.status) == {"converged"}
    larger = images.replaced(landmarks=(10 * images.as_columns()).swapaxes(1, 2))
    grown, _ = fit(with_prior, larger, **keys)
    assert grown.shape_sd == pytest.approx(10 * found.shape_sd, rel=1e-4)


def test_noise_widens_error_bars(fit, with_prior, images):
    keys = {"method": "posterior", "camera": {"focal": "none"}}
    plain, _ = fit(with_prior, images, **keys)
    noisy, _ = fit(with_prior, images, noise=2.0, **keys)
    assert np.median(noisy.shape_sd[:, :2]) > np.median(plain.shape_sd[:, :2])


def test_implausible_images_are_reported_and_keep_their_status(
    fit, with_prior, images, monkeypatch
):
    monkeypatch.setattr(trust, "LIMITS", trust.LIMITS._replace(min_p_value=0.999999))
    keys = {"camera": {"focal": "none"}}
    found, outcomes = fit(with_prior, images, method="posterior", **keys)
    (reasons,) = [reasons for out in outcomes for reasons in out.reasons]
    assert reasons.text == "implausible landmarks"
    assert set(reasons.items) == set(found.items)
    assert not found.column("trusted").any()
    assert set(found.column("reasons")) == {"implausible landmarks"}
    assert set(found.status) == {"converged"}


def test_a_known_camera_is_looked_through(fit, tmp_path, with_prior, images):
    """Images far from a long lens are those of weak perspective; a proof and a place
    come along.
    """
    keys = {"method": "posterior", "save": {"covariance": True, "proof": True}}
    weak, _ = fit(with_prior, images, camera={"focal": "none"}, **keys)
    camera = {"focal": 1e7, "principal_point": [100.0, 50.0]}
    found, outcomes = fit(with_prior, images, camera=camera, **keys)
    assert found.as_columns() == pytest.approx(weak.as_columns(), abs=1e-3)
    assert found.shape_sd == pytest.approx(weak.shape_sd, rel=1e-3, abs=1e-4)
    assert found.landmarks_fitted == pytest.approx(weak.shapes[..., :2], abs=1e-3)
    assert found.column("camera_translation")[:, 2] == pytest.approx(
        1e7 / found.scale, rel=1e-6
    )
    with h5py.File(tmp_path / "result.h5") as file:
        assert np.isfinite(
            [file[name][:].sum() for name in ("dual", "convex_objective")]
        ).all()
    assert not failures(outcomes)
    near = {"focal": 60.0, "principal_point": [80.0, 50.0]}
    other, _ = fit(with_prior, images, camera=near, **keys)
    assert np.abs(other.landmarks_fitted - other.shapes[..., :2]).max() > 0.1
    names = ("shape_covariance", "camera_translation", "focal", "principal_point")
    assert all(np.isfinite(other.column(name)).all() for name in names)
