"""`learn-dict` of 2D landmarks: what is learned lifts them; what cannot be learned is
said.
"""

from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.config import InfoConfig, LearnDictConfig
from shapefit.dictionary.model import Dictionary, describe_learning
from shapefit.errors import InputError
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    read_dictionary,
    write_dictionary,
)
from shapefit.pipelines import info, verify
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.learn_dict.from_2d import describe_prediction, error_of_hidden
from shapefit.records import Landmarks
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file

N, P = 60, 10


@pytest.fixture(scope="module")
def class_of_shapes():
    """60 shapes (n, 3, p) before the camera, which bend in two ways."""
    rng = np.random.default_rng(20150607)
    mean = rng.standard_normal((3, P))
    bends = 0.15 * rng.standard_normal((2, 3, P))
    bent = mean + np.einsum("nk,kip->nip", rng.standard_normal((N, 2)), bends)
    shapes = random_rotations(N, rng) @ bent
    return shapes - shapes.mean(axis=2, keepdims=True)


def learn_in(folder, landmarks, fields=None, **changes):
    """Write landmarks (n, 2, p), learn from them, and return outcomes."""
    images = Landmarks(
        (100.0 * landmarks + 300.0).swapaxes(1, 2),
        landmark_names=tuple(f"p{j}" for j in range(landmarks.shape[2])),
        items=tuple(f"image{i}" for i in range(len(landmarks))),
    )
    save(folder / "images.h5", images.replaced(**fields or {}))
    given = {"shapes": folder / "images.h5", "output": folder / "dict.h5", "k": 5}
    return list(learn_dict.learn_dictionary(LearnDictConfig(**given | changes)))


@pytest.fixture
def learn(tmp_path):
    """Return a function that writes landmarks (n, 2, p), learns from them, and returns
    outcomes.
    """
    return partial(learn_in, tmp_path)


def lift(folder):
    """Fit the images by what was learned of them; return the result and the
    outcomes.
    """
    files = (folder / name for name in ("images.h5", "dict.h5", "result.h5"))
    return fit_file(*files, method="posterior")


@pytest.fixture(scope="module")
def learned(class_of_shapes, tmp_path_factory):
    """Return what learns from the class and lifts it, once with each value of
    `flip`.
    """

    @cache
    def make(flip):
        folder = tmp_path_factory.mktemp("learned")
        keys = {} if flip is None else {"flip": flip}
        outcomes = learn_in(folder, class_of_shapes[:, :2], **keys)
        result, of_fit = lift(folder)
        return SimpleNamespace(
            folder=folder, outcomes=outcomes, result=result, of_fit=of_fit
        )

    return make


def error(result, truth, sign):
    """Mean of ||X - X^|| / ||X||, in the unit of the truth."""
    found = (
        result.as_columns() - result.as_columns().mean(axis=2, keepdims=True)
    ) / 100.0
    apart = np.linalg.norm(found * [[1], [1], [sign]] - truth, axis=(1, 2))
    return float(np.mean(apart / np.linalg.norm(truth, axis=(1, 2))))


def test_what_was_learned_lifts_the_images_and_flip_exchanges_near_and_far(
    learned, class_of_shapes
):
    made = learned(None)
    assert any("learned; hidden landmarks" in outcome.line for outcome in made.outcomes)
    assert {
        each.done for each in made.outcomes if each.note.startswith("evidence")
    } == {1}
    images = load(made.folder / "images.h5")
    dictionary = read_dictionary(made.folder / "dict.h5")
    assert error_of_hidden(images, dictionary) < 0.1
    told = [str(text) for outcome in made.outcomes for text in outcome.warnings]
    assert any("near and far" in text for text in told)
    errors = [error(made.result, class_of_shapes, sign) for sign in (1, -1)]
    assert min(errors) < 0.1
    # landmarks that might be pixels: what was learned is seen as it was learned
    assert made.result.focal is None
    flipped = [error(learned(True).result, class_of_shapes, sign) for sign in (1, -1)]
    assert int(np.argmin(flipped)) != int(np.argmin(errors))
    assert min(flipped) < 0.1


def description(folder):
    """What `info` says of the dictionary that was learned."""
    return next(iter(info.describe_files(InfoConfig(files=(folder / "dict.h5",))))).note


def test_no_image_is_trusted_and_bars_cover_both_until_near_is_told_from_far(
    learned, class_of_shapes
):
    folder, result, outcomes = (
        learned(None).folder,
        learned(None).result,
        learned(None).of_fit,
    )
    files = [folder / name for name in ("images.h5", "dict.h5", "result.h5")]
    assert not result.column("trusted").any()
    assert not result.column("shape_correlation")[..., 1:].any()  # z is as likely -z
    assert (result.column("reasons") == "near and far not told apart").mean() > 0.9
    texts = [str(text) for each in outcomes for text in each.warnings]
    (warning,) = [text for text in texts if "learned from 2D" in text]
    assert "learned from 2D landmarks: learned; near and far open" in warning
    assert "near and far open" in description(folder)
    request = verify.Request(files[2], files[1], (files[0],))
    assert not [
        each.failures for each in verify.verify_results(request) if each.failures
    ]
    found = result.as_columns() - result.as_columns().mean(axis=2, keepdims=True)
    stated = learned(False).result.shape_sd[..., 2]
    # with z and -z as likely, 2 z^2 is added
    added = result.shape_sd[..., 2] ** 2 - stated**2
    np.testing.assert_allclose(added, 2 * found[:, 2] ** 2, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("flip", [True, False])
def test_who_states_what_is_near_has_images_trusted(learned, flip):
    made = learned(flip)
    assert made.result.column("trusted").mean() > 0.9
    assert "learned; near and far stated by `flip`" in description(made.folder)


def test_the_verdict_stays_with_the_dictionary(tmp_path):
    shape = normalise(np.random.default_rng(0).standard_normal((3, 4))).points
    made = Dictionary(shape[None], tuple("abcd"), shape)
    assert describe_learning(made) == ()
    assert not made.depth_ambiguity
    old = replace(made, provenance={"learned_from": "landmarks"})
    assert old.depth_ambiguity
    known = {"verdict": "doubtful", "near_and_far": "told by perspective"}
    write_dictionary(
        tmp_path / "dict.h5", replace(old, provenance=old.provenance | known)
    )
    (line,) = describe_learning(read_dictionary(tmp_path / "dict.h5"))
    assert line.endswith("doubtful; near and far told by perspective")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_known_camera_decides_what_is_near(learn, tmp_path, class_of_shapes, sign):
    shapes = class_of_shapes * [[sign], [1.0], [1.0]]
    size = np.linalg.norm(shapes, axis=(1, 2)).mean() / np.sqrt(P)
    visible = shapes[:, :2] / (1 + shapes[:, 2:] / (4 * size))
    camera = np.array([[400 * size, 0, 300], [0, 400 * size, 300], [0, 0, 1.0]])
    learn(visible, {"file_extras": {"camera_matrix": camera}})
    assert "near and far told by perspective" in description(tmp_path)
    found, _ = lift(tmp_path)
    assert found.column("trusted").any()
    assert error(found, shapes, 1) < 0.3 < error(found, shapes, -1)


def one_view(shapes, rng):
    turned = np.linalg.inv(np.linalg.svd(shapes[0] @ shapes[0].T)[0])
    moving = shapes[:1] + 0.15 * rng.standard_normal((N, 1, 1)) * shapes[1:2]
    return (turned @ moving)[:, :2] + 0.01 * rng.standard_normal((N, 2, P))


def flat_class(shapes, rng):
    plane = shapes[0] * [[1], [1], [0]]
    return (random_rotations(N, rng) @ plane)[:, :2]


@pytest.mark.parametrize(
    ("make", "verdict"),
    [
        (one_view, "views too alike: depth is not determined"),
        (flat_class, "views too alike: depth is not determined"),
        (
            lambda shapes, rng: rng.standard_normal((N, 2, P)),
            "nothing in common: .* of one class",
        ),
        (lambda shapes, rng: shapes[:2, :2], "too few images: 2 of 2"),
        (lambda shapes, rng: np.full((N, 2, P), np.nan), "too few images: 0 of 60"),
    ],
    ids=["one view", "planar", "noise", "two images", "all hidden"],
)
def test_images_that_do_not_determine_depth_end_with_the_verdict(
    learn, tmp_path, class_of_shapes, rng, make, verdict
):
    with pytest.raises(InputError, match=verdict):
        learn(make(class_of_shapes, rng))
    assert not (tmp_path / "dict.h5").exists()


def test_missing_landmarks_and_confidences_and_sequences_are_taken(
    learn, tmp_path, class_of_shapes, rng
):
    landmarks = class_of_shapes[:, :2].copy()
    hidden = rng.random((N, P)) < 0.1
    landmarks[np.repeat(hidden[:, None], 2, axis=1)] = np.nan
    fields = {
        "confidence": np.where(hidden, 0.0, 0.9),
        "sequences": ("a",) * (N // 2) + ("b",) * (N - N // 2),
    }
    learn(landmarks, fields)
    found, _ = lift(tmp_path)
    assert min(error(found, class_of_shapes, sign) for sign in (1, -1)) < 0.2


def test_bones_of_landmarks_vary_the_last_prior(learn, tmp_path, class_of_shapes):
    edges = np.column_stack([np.arange(P - 1), np.arange(1, P)])
    freedom = []
    for stretch in (0.0, 0.3):
        fields = {"edges": edges}
        learn(
            class_of_shapes[:, :2],
            fields,
            prior={"components": 1, "bone_scale": stretch},
        )
        made = read_dictionary(tmp_path / "dict.h5")
        np.testing.assert_array_equal(made.edges, edges)
        freedom.append(made.prior.covariances[0].trace())
    assert freedom[1] > 1.2 * freedom[0]


def test_what_cannot_be_predicted_is_no_number():
    assert describe_prediction(0.0312).startswith("hidden landmarks predicted to 0.031")
    assert describe_prediction(float("nan")) == "no hidden landmark to predict"
