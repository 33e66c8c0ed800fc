"""The method `sequences` through `fit`: motion, known lengths, cameras, hidden hips."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import shapefit
from shapefit.config.paths import find_dictionaries
from shapefit.dictionary.bodies import LIMB_ENDS
from shapefit.errors import InputError
from shapefit.evaluation.metrics import similarity_error
from shapefit.geometry.rotations import rotation_about
from shapefit.io import (
    read_dictionary,
    read_shapes,
    write_dictionary,
)
from shapefit.pipelines import verify
from shapefit.pipelines.fit.sequences import (
    find_usual_lengths,
    hides_the_hips,
    restore_sides,
)
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.io.files import load


@pytest.mark.slow
def test_without_edges_sequences_go_by_smooth_motion(people, lift_sequences, tmp_path):
    dictionary = tmp_path / "dictionary.h5"
    known = read_dictionary(people.dictionary)
    bare = dict.fromkeys(("edges", "bone_tolerance", "edge_length"))
    write_dictionary(dictionary, replace(known, **bare))
    single, _ = lift_sequences(people.views, dictionary, method="posterior")
    whole, _ = lift_sequences(people.views, dictionary)
    refined = np.isfinite(whole.sequence_noise)
    assert np.isfinite(whole.shapes).all()
    assert refined.any()
    assert (whole.shape_sd[refined] > 0.4 * single.shape_sd[refined]).all()
    assert mean_acceleration(whole) < mean_acceleration(single)


def mean_acceleration(result):
    """Return the mean second difference of depths."""
    depths = result.shapes[..., 2]
    return np.abs(np.diff(depths, n=2, axis=0)).mean()


def first_sequence(images):
    """Return the images of the first sequence."""
    rows = np.flatnonzero(np.array(images.sequences) == images.sequences[0])
    return images.take(rows)


@pytest.mark.parametrize("count", [1, 3])
def test_a_thread_that_is_left_changes_nothing(people, lift_sequences, count):
    """A sequence for which a thread is left is inferred on two."""
    images = load(people.views)
    names = list(dict.fromkeys(images.sequences))[:count]
    rows = np.flatnonzero(np.isin(images.sequences, names))
    some = images.take(rows)

    one, _ = lift_sequences(some, threads=1)
    two, _ = lift_sequences(some, threads=2)

    assert np.isfinite(one.sequence_noise).any()
    for column in ("shapes", "shape_sd", "shape_correlation", "sequence_noise"):
        assert_array_equal(two.column(column), one.column(column))


@pytest.mark.parametrize(
    ("grow", "noise"), [(1.0, None), (50.0, None), (50.0, 0.0), (50.0, 0.4)]
)
def test_noise_is_stated_and_that_of_the_images_otherwise(
    people, lift_sequences, grow, noise
):
    """In the unit of the landmarks, of which the size of a body is some."""
    images = first_sequence(load(people.views))
    large = images.replaced(landmarks=grow * images.landmarks)
    result, _ = lift_sequences(large, noise=noise)
    unit = np.median(result.scale)
    expected = {None: 0.1 * unit, 0.0: 0.003 * unit}.get(noise, noise)
    assert_allclose(result.sequence_noise, expected, rtol=1e-9)


SINGLE_PRIOR = {"residual_variance": 0.01, "bar_scale": 1.5}
"""Keys with which `posterior` does what `sequences` does of single images."""


def test_sequences_of_one_image_are_single_images(people, lift_sequences):
    """But for the neighbour that the convex program starts from."""
    images = load(people.views).take(slice(0, 20))
    alone = images.replaced(sequences=tuple(map(str, range(20))))
    single, _ = lift_sequences(alone, method="posterior", prior=SINGLE_PRIOR)
    whole, _ = lift_sequences(alone, prior=SINGLE_PRIOR)
    assert_allclose(whole.points, single.points, rtol=1e-5, atol=1e-8)
    assert_allclose(whole.shape_sd, single.shape_sd, rtol=1e-5)
    assert np.isnan(whole.sequence_noise).all()


def test_an_unknown_frame_rate_is_a_warning(people, lift_sequences):
    images = load(people.views).take(slice(0, 10)).replaced(frame_rate=None)
    _, warnings = lift_sequences(images)
    assert any("frame rate is unknown" in text for text in warnings)


def test_a_frame_rate_that_is_given_is_none(people, lift_sequences):
    images = load(people.views).take(slice(0, 10)).replaced(frame_rate=None)
    result, warnings = lift_sequences(images, frame_rate=24)
    assert not any("frame rate" in text for text in warnings)
    assert result.frame_rate == 24


def test_sequences_out_of_order_are_an_error(people, lift_sequences):
    images = load(people.views).take(slice(0, 6))
    mixed = images.replaced(sequences=("a", "a", "b", "b", "a", "a"))
    with pytest.raises(InputError, match="sequence: 'a' goes on after others"):
        lift_sequences(mixed)


@pytest.fixture
def turntable(project):
    """Near bodies on a turntable: the shapes (40, 3, p) from the camera, which looks
    along -z, and its images, y up.
    """
    every = read_shapes([project / "sample_data/people_test.h5"])
    truth = first_sequence(every).take(slice(0, 40))
    points = truth.as_columns()
    centred = points - points.mean(axis=2, keepdims=True)
    angles = np.linspace(0, 3, len(truth))
    shapes = rotation_about(np.array([0.0, 1.0, 0.0]), angles) @ centred
    shapes[:, 2] -= 2.5 * np.ptp(shapes, axis=2).max()
    pixels = -900 * shapes[:, :2] / shapes[:, 2:] + 500
    images = Landmarks(
        in_rows(pixels),
        landmark_names=truth.landmark_names,
        items=truth.items,
        sequences=truth.sequences,
        y_axis="up",
        frame_rate=24.0,
    )
    return shapes, images


CAMERA = {"focal": 900.0, "principal_point": [500.0, 500.0]}


def test_a_camera_lowers_the_error_of_a_sequence(lift_sequences, turntable):
    shapes, images = turntable
    without, _ = lift_sequences(images, camera={"focal": "none"})
    result, _ = lift_sequences(images, camera=CAMERA)
    error = similarity_error(result.as_columns(), shapes).mean()
    error_without = similarity_error(without.as_columns(), shapes).mean()
    assert error < 0.95 * error_without
    assert result.camera_translation.shape == (len(images), 3)
    assert (result.shape_sd > 0).all()
    assert result.y_axis == "up"


def test_verification_follows_a_sequence_before_a_camera(
    people, lift_sequences, turntable, tmp_path
):
    _, images = turntable
    lift_sequences(images, camera=CAMERA)
    request = verify.Request(tmp_path / "result.h5", people.dictionary, ())
    for outcome in verify.verify_results(request):
        assert not outcome.failures


def with_edge_covariance(dictionary, rng):
    count = len(dictionary.edges)
    A = rng.standard_normal((count, count))
    return replace(dictionary, edge_covariance=A @ A.T + np.eye(count))


def is_limb(dictionary, edge):
    """Say whether an edge joins the ends of a limb, of either side."""
    joints = {dictionary.landmark_names[end][1:] for end in edge}
    return joints in LIMB_ENDS


def test_lengths_of_other_bodies_leave_the_size_free(people, rng):
    dictionary = with_edge_covariance(read_dictionary(people.dictionary), rng)
    lengths = find_usual_lengths(dictionary)
    limbs = np.array([is_limb(dictionary, edge) for edge in dictionary.edges])
    precision = lengths.precision
    of_limbs = precision[np.ix_(limbs, limbs)]
    usual = np.where(limbs, dictionary.edge_length, np.nan)
    assert 2 < limbs.sum() < len(limbs)
    assert_allclose(precision.sum(axis=1), 0, atol=1e-12)
    assert_array_equal(precision[~limbs], 0)
    assert np.linalg.eigvalsh(of_limbs)[1] > 1e-3
    assert_array_equal(lengths.usual, usual)


def test_without_a_covariance_no_lengths_are_usual(people):
    dictionary = read_dictionary(people.dictionary)
    assert find_usual_lengths(replace(dictionary, edge_covariance=None)) is None


FRAME_COUNT = 60


PARTNERS = np.array([1, 0, 3, 2, 5, 4, 7, 6])
"""Of each landmark, that of the other side."""


@pytest.fixture
def two_sided(rng):
    """Images of a walk whose landmarks have partners on the other side, and differing
    scores.
    """
    left = rng.normal(size=(4, 2)) + np.array([3.0, 0.0])
    body = np.stack([left, -left], axis=1).reshape(8, 2)
    sway = 0.1 * np.sin(np.arange(FRAME_COUNT) / 5)
    scores = np.linspace(0.2, 0.9, 8)
    return Landmarks(
        body + sway[:, None, None],
        landmark_names=tuple("abcdefgh"),
        items=tuple(map(str, range(FRAME_COUNT))),
        sequences=("walk",) * FRAME_COUNT,
        confidence=np.tile(scores, (FRAME_COUNT, 1)),
    )


def restore_exchanged(images, wrong):
    """Exchange the sides in these frames, and return what restores them."""
    landmarks = images.landmarks.copy()
    confidence = images.confidence.copy()
    landmarks[wrong] = landmarks[wrong][:, PARTNERS]
    confidence[wrong] = confidence[wrong][:, PARTNERS]
    exchanged = images.replaced(landmarks=landmarks, confidence=confidence)
    visible = np.ones((FRAME_COUNT, 8), bool)
    dictionary = SimpleNamespace(mirror_index=PARTNERS)
    return restore_sides(exchanged, visible, dictionary, None)


def test_exchanged_frames_are_put_back_with_their_scores(two_sided):
    wrong = np.isin(np.arange(FRAME_COUNT), range(20, 28))
    images, exchanged = restore_exchanged(two_sided, wrong)
    assert_array_equal(exchanged, wrong)
    assert_array_equal(images.landmarks, two_sided.landmarks)
    assert_array_equal(images.confidence, two_sided.confidence)


def test_of_two_halves_none_is_known_to_be_exchanged(two_sided):
    wrong = np.arange(FRAME_COUNT) >= FRAME_COUNT // 2
    _, exchanged = restore_exchanged(two_sided, wrong)
    assert np.isnan(exchanged).all()


@pytest.mark.slow
def test_a_dog_that_walks_in_a_curve_is_no_worse_than_its_images(project):
    """Its scale in the image changes by a third."""
    folder = project / "sample_data"
    truth = shapefit.read_shapes(folder / "animal_truth.h5")
    images = shapefit.read_landmarks(folder / "animal_walk.csv")
    training = shapefit.read_shapes(folder / "animal_train.h5")
    dog = shapefit.learn(training, prior={"components": "auto"})
    keys = {"min_confidence": 0.6, "frame_rate": 25, "image_size": (1280, 720)}
    errors = {}
    for method in ("posterior", "sequences"):
        result = shapefit.fit(images, dog, method=method, **keys)
        errors[method] = shapefit.evaluate(result, truth).mean("similarity")
    assert errors["sequences"] < errors["posterior"]


HIDDEN_HIPS = [
    (("lhip", "rhip"), True),
    (("lhip",), False),
    (("lknee", "rknee", "lankle", "rankle"), False),
    ((), False),
]


@pytest.fixture(scope="module")
def installed_people():
    return read_dictionary(find_dictionaries()["people"])


def shown_of(dictionary, unseen):
    """Return which landmarks are seen, of which these are not."""
    return np.array([name not in unseen for name in dictionary.landmark_names])


@pytest.mark.parametrize(("unseen", "hidden"), HIDDEN_HIPS)
def test_people_without_a_hip_are_not_refined(installed_people, unseen, hidden):
    shown = shown_of(installed_people, unseen)
    assert hides_the_hips(installed_people, shown) == hidden


def test_other_objects_have_no_hips_to_hide(installed_people):
    names = tuple(f"{name}_x" for name in installed_people.landmark_names)
    animal = replace(installed_people, landmark_names=names)
    shown = shown_of(installed_people, ("lhip", "rhip"))
    assert not hides_the_hips(animal, shown)


def test_where_nothing_is_said_to_be_hidden_hips_are_not(installed_people):
    assert not hides_the_hips(installed_people, None)


LOWER_BODY = ("hip", "knee", "ankle")


def test_a_clip_without_hips_is_its_single_images(people, lift_sequences):
    """The refined clip would differ by far more."""
    images = load(people.views).take(slice(0, 40)).replaced(sequences=("a",) * 40)
    lower = [
        name == "pelvis" or name[1:] in LOWER_BODY for name in images.landmark_names
    ]
    images.landmarks[:, lower] = np.nan
    single, _ = lift_sequences(images, method="posterior", prior=SINGLE_PRIOR)
    whole, _ = lift_sequences(images, prior=SINGLE_PRIOR)
    assert np.isnan(whole.sequence_noise).all()
    assert_allclose(whole.points, single.points, rtol=1e-5, atol=1e-8)
