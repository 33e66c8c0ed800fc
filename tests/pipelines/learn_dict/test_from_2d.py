"""`learn-dict` of 2D landmarks: what is learned lifts them; what cannot be learned is
said.
"""

from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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
from shapefit.pipelines.result import Result
from shapefit.records import Fit, Landmarks
from tests.columns import in_rows
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file, texts

IMAGE_COUNT = 60


P = 10


@pytest.fixture(scope="module")
def class_of_shapes():
    """60 shapes (n, 3, p) before the camera, which bend in two ways."""
    rng = np.random.default_rng(20150607)
    mean = rng.standard_normal((3, P))
    bends = 0.15 * rng.standard_normal((2, 3, P))
    amounts = rng.standard_normal((IMAGE_COUNT, 2))
    bent = mean + np.einsum("nk,kip->nip", amounts, bends)
    shapes = random_rotations(IMAGE_COUNT, rng) @ bent
    return shapes - shapes.mean(axis=2, keepdims=True)


def learn_in(folder, landmarks, fields=None, **keys):
    """Write landmarks (n, 2, p), learn from them, and return outcomes."""
    images = Landmarks(
        in_rows(100.0 * landmarks + 300.0),
        landmark_names=tuple(f"p{j}" for j in range(landmarks.shape[2])),
        items=tuple(f"image{i}" for i in range(len(landmarks))),
    )
    source = folder / "images.h5"
    save(source, images.replaced(**fields or {}))
    usual = {"shapes": source, "output": folder / "dict.h5", "k": 5}
    return list(learn_dict.learn_dictionary(LearnDictConfig(**usual | keys)))


@dataclass(frozen=True)
class Learned:
    """A folder with images, the dictionary learned of them and their fit by it."""

    folder: Path
    learning: list[Result]
    result: Fit
    fitting: list[Result]

    @property
    def images(self):
        return load(self.folder / "images.h5")

    @property
    def dictionary(self):
        return read_dictionary(self.folder / "dict.h5")


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
        learning = learn_in(folder, class_of_shapes[:, :2], **keys)
        result, fitting = lift(folder)
        return Learned(folder, learning, result, fitting)

    return make


def centred(result):
    """Return the shapes (n, 3, p) about their middle, in the unit of the truth."""
    shapes = result.as_columns() / 100.0
    return shapes - shapes.mean(axis=2, keepdims=True)


def error(result, truth, sign=1):
    """Mean of ||X - X^|| / ||X||, with z times a sign, in the unit of the truth."""
    shapes = centred(result) * [[1], [1], [sign]]
    distances = np.linalg.norm(shapes - truth, axis=(1, 2))
    return float(np.mean(distances / np.linalg.norm(truth, axis=(1, 2))))


def sign_of_depth(result, truth):
    """Return the sign of z by which the shapes are nearer to the truth."""
    return min((1, -1), key=lambda sign: error(result, truth, sign))


def test_learning_is_told_and_can_be_judged(learned):
    made = learned(None)
    of_evidence = {x.done for x in made.learning if x.note.startswith("evidence")}
    told = texts(made.learning)
    lines = [outcome.line for outcome in made.learning]
    assert any("learned; hidden landmarks" in line for line in lines)
    assert of_evidence == {1}
    assert error_of_hidden(made.images, made.dictionary) < 0.1
    assert any("near and far" in text for text in told)


@pytest.mark.parametrize("flip", [None, True])
def test_what_was_learned_lifts_the_images(learned, class_of_shapes, flip):
    result = learned(flip).result
    sign = sign_of_depth(result, class_of_shapes)
    assert error(result, class_of_shapes, sign) < 0.1


def test_flip_exchanges_near_and_far(learned, class_of_shapes):
    sign = sign_of_depth(learned(None).result, class_of_shapes)
    assert sign_of_depth(learned(True).result, class_of_shapes) == -sign


def test_landmarks_that_might_be_pixels_are_seen_as_they_were_learned(learned):
    assert learned(None).result.focal is None


def description(folder):
    """What `info` says of the dictionary that was learned."""
    first, *_ = info.describe_files(InfoConfig(files=(folder / "dict.h5",)))
    return first.note


def test_no_image_is_trusted_until_near_is_told_from_far(learned):
    made = learned(None)
    in_doubt = made.result.reasons == "near and far not told apart"
    (warning,) = [text for text in texts(made.fitting) if "learned from 2D" in text]
    assert not made.result.trusted.any()
    assert in_doubt.mean() > 0.9
    assert "learned from 2D landmarks: learned; near and far open" in warning
    assert "near and far open" in description(made.folder)


def test_error_bars_cover_near_and_far(learned):
    """With z and -z as likely, 2 z^2 is added."""
    result = learned(None).result
    z = 100 * centred(result)[:, 2]
    variance = result.shape_sd[..., 2] ** 2
    variance_of_one = learned(False).result.shape_sd[..., 2] ** 2
    added = variance - variance_of_one
    assert_allclose(added, 2 * z**2, rtol=1e-3, atol=1e-3)
    assert not result.shape_correlation[..., 1:].any()


def test_a_fit_by_what_was_learned_of_2d_is_verified(learned):
    folder = learned(None).folder
    request = verify.Request(
        folder / "result.h5", folder / "dict.h5", (folder / "images.h5",)
    )
    for outcome in verify.verify_results(request):
        assert not outcome.failures


@pytest.mark.parametrize("flip", [True, False])
def test_who_states_what_is_near_has_images_trusted(learned, flip):
    made = learned(flip)
    assert made.result.trusted.mean() > 0.9
    assert "learned; near and far stated by `flip`" in description(made.folder)


@pytest.fixture
def small():
    """A dictionary of one atom, that says nothing of how it was made."""
    shape = normalise(np.random.default_rng(0).standard_normal((3, 4))).points
    return Dictionary(shape[None], tuple("abcd"), shape)


FROM_2D = {"learned_from": "landmarks"}


def test_a_dictionary_of_shapes_has_no_verdict(small):
    assert describe_learning(small) == ()
    assert not small.depth_ambiguity


def test_without_a_verdict_near_and_far_are_open(small):
    assert replace(small, provenance=FROM_2D).depth_ambiguity


def test_the_verdict_stays_with_the_dictionary(small, tmp_path):
    path = tmp_path / "dict.h5"
    verdict = {"verdict": "doubtful", "near_and_far": "told by perspective"}
    write_dictionary(path, replace(small, provenance=FROM_2D | verdict))
    (line,) = describe_learning(read_dictionary(path))
    assert line.endswith("doubtful; near and far told by perspective")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_known_camera_decides_what_is_near(learn, tmp_path, class_of_shapes, sign):
    shapes = class_of_shapes * [[sign], [1.0], [1.0]]
    size = np.linalg.norm(shapes, axis=(1, 2)).mean() / np.sqrt(P)
    distance = 4 * size
    visible = shapes[:, :2] / (1 + shapes[:, 2:] / distance)
    focal = 100 * distance
    camera = np.array([[focal, 0, 300], [0, focal, 300], [0, 0, 1.0]])
    learn(visible, {"file_extras": {"camera_matrix": camera}})
    result, _ = lift(tmp_path)
    assert "near and far told by perspective" in description(tmp_path)
    assert result.trusted.any()
    assert error(result, shapes) < 0.3
    assert error(result, shapes, sign=-1) > 0.3


def one_view(shapes, rng):
    left, *_ = np.linalg.svd(shapes[0] @ shapes[0].T)
    amounts = 0.15 * rng.standard_normal((IMAGE_COUNT, 1, 1))
    moving = shapes[:1] + amounts * shapes[1:2]
    turned = np.linalg.inv(left) @ moving
    return turned[:, :2] + 0.01 * rng.standard_normal((IMAGE_COUNT, 2, P))


def flat_class(shapes, rng):
    plane = shapes[0] * [[1], [1], [0]]
    return (random_rotations(IMAGE_COUNT, rng) @ plane)[:, :2]


def noise(_shapes, rng):
    return rng.standard_normal((IMAGE_COUNT, 2, P))


def two_images(shapes, _rng):
    return shapes[:2, :2]


def all_hidden(_shapes, _rng):
    return np.full((IMAGE_COUNT, 2, P), np.nan)


VERDICTS = [
    (one_view, "views too alike: depth is not determined"),
    (flat_class, "views too alike: depth is not determined"),
    (noise, "nothing in common: .* of one class"),
    (two_images, "too few images: 2 of 2"),
    (all_hidden, "too few images: 0 of 60"),
]


@pytest.mark.parametrize(("make", "verdict"), VERDICTS)
def test_images_that_do_not_determine_depth_end_with_the_verdict(
    learn, tmp_path, class_of_shapes, rng, make, verdict
):
    landmarks = make(class_of_shapes, rng)
    with pytest.raises(InputError, match=verdict):
        learn(landmarks)
    assert not (tmp_path / "dict.h5").exists()


def test_missing_landmarks_and_confidences_and_sequences_are_taken(
    learn, tmp_path, class_of_shapes, rng
):
    hidden = rng.random((IMAGE_COUNT, P)) < 0.1
    landmarks = np.where(hidden[:, None], np.nan, class_of_shapes[:, :2])
    half = IMAGE_COUNT // 2
    fields = {
        "confidence": np.where(hidden, 0.0, 0.9),
        "sequences": ("a",) * half + ("b",) * half,
    }
    learn(landmarks, fields)
    result, _ = lift(tmp_path)
    sign = sign_of_depth(result, class_of_shapes)
    assert error(result, class_of_shapes, sign) < 0.2


def test_bones_of_landmarks_vary_the_last_prior(learn, tmp_path, class_of_shapes):
    edges = np.column_stack([np.arange(P - 1), np.arange(1, P)])
    variances = []
    for bone_scale in (0.0, 0.3):
        prior = {"components": 1, "bone_scale": bone_scale}
        learn(class_of_shapes[:, :2], {"edges": edges}, prior=prior)
        dictionary = read_dictionary(tmp_path / "dict.h5")
        assert_array_equal(dictionary.edges, edges)
        variances.append(dictionary.prior.covariances[0].trace())
    still, varied = variances
    assert varied > 1.2 * still


def test_what_cannot_be_predicted_is_no_number():
    assert describe_prediction(0.0312).startswith("hidden landmarks predicted to 0.031")
    assert describe_prediction(float("nan")) == "no hidden landmark to predict"
