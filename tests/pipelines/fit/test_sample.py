"""The sample, and what it shows: skeleton, prior scale, residual variance, wrong names."""

import json
import re

import numpy as np
import pytest
from shapefit.cli.main import run

from shapefit.config import FitConfig
from shapefit.config.paths import find_dictionaries
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.io import LandmarkSet, read_dictionary, write_dictionary
from shapefit.io.skeletons import THETA, installed_skeletons, people_parts
from shapefit.pipelines import joints
from shapefit.pipelines.fit import prepare as preparing
from shapefit.pipelines.fit.prepare import (
    FIRST,
    LARGEST,
    draw_sample,
    find_scale,
    maximise_theta,
    mean_gain,
    prepare,
)
from tests.pipelines.fitted import fit_images
from tests.pipelines.told import texts

P, IMAGES = 12, 60
NAMES = tuple(f"point{j}" for j in range(P))
RESIDUAL_VARIANCE = 0.002


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A dictionary with one Gaussian, and what draws images whose truth is as wide as stated."""
    rng = np.random.default_rng(5)
    mean = rng.normal(size=(3, P))
    root = 0.12 * rng.normal(size=(3 * P, 8)) / np.sqrt(8)
    C = root @ root.T * 8 / 3 + 1e-3 * np.eye(3 * P)
    prior = Mixture(np.ones(1), mean[None], C[None])
    path = tmp_path_factory.mktemp("sample") / "dictionary.h5"
    made = Dictionary(
        mean[None] / 4, NAMES, mean, prior=prior, residual_variance=np.array([RESIDUAL_VARIANCE])
    )
    write_dictionary(path, made)

    def draw(scale, residual_variance, wrong=None, error=3.0):
        x = np.linalg.cholesky(scale * C) @ rng.normal(size=(3 * P, IMAGES))
        shapes = random_rotations(IMAGES, rng) @ (mean + x.T.reshape(IMAGES, 3, P))
        w = shapes[:, :2] + np.sqrt(residual_variance) * rng.normal(size=(IMAGES, 2, P))
        if wrong is not None:
            w[:, :, wrong] += error * rng.normal(size=(IMAGES, 2))
        items = tuple(f"image{i}" for i in range(IMAGES))
        images = LandmarkSet(landmarks=100 * w, landmark_names=NAMES, items=items)
        return images, 100 * shapes

    return path, made, draw


KEYS = {"method": "posterior", "camera": {"focal": "none"}}


def estimate(planted, images, **prior):
    path, made, _ = planted
    keys = {"landmarks": [str(path)], "dictionary": str(path), "output": "result.h5"}
    config = FitConfig(**keys, **KEYS, prior=prior)
    first = images.take(slice(0, FIRST))
    steps = prepare(config, made, images.landmark_names, lambda: first, len(images))
    with pytest.raises(StopIteration) as end:
        next(steps)
    found = end.value.value.estimates
    return found, found.values["prior"]


@pytest.mark.parametrize(
    ("scale", "variance", "given", "expected"),
    [
        (1, RESIDUAL_VARIANCE, {}, (1, RESIDUAL_VARIANCE)),
        (4, RESIDUAL_VARIANCE, {}, (4, RESIDUAL_VARIANCE)),
        (1, 8 * RESIDUAL_VARIANCE, {}, (1, 8 * RESIDUAL_VARIANCE)),
        (4, 8 * RESIDUAL_VARIANCE, {}, (4, 8 * RESIDUAL_VARIANCE)),
        # landmarks more exact than the residual variance of the dictionary keep it
        (1, RESIDUAL_VARIANCE / 20, {}, (1, RESIDUAL_VARIANCE)),
        (4, 8 * RESIDUAL_VARIANCE, {"scale": 1.5, "residual_variance": 0.1}, (1.5, 0.1)),
    ],
)
def test_the_factors_that_images_have_are_found(planted, scale, variance, given, expected):
    found, keys = estimate(planted, planted[2](scale, variance)[0], **given)
    assert (keys["scale"], keys["residual_variance"]) == pytest.approx(expected)
    changed = not given and expected != (1, RESIDUAL_VARIANCE)
    assert any("prior widened" in text or "residual var" in text for text in found.lines) == changed


def test_a_landmark_that_is_mostly_wrong_does_not_make_the_others_less_exact(planted):
    _, keys = estimate(planted, planted[2](1, RESIDUAL_VARIANCE, wrong=3)[0])
    assert (keys["scale"], keys["residual_variance"]) == (1, RESIDUAL_VARIANCE)


def test_a_landmark_that_is_mostly_wrong_is_named(planted, tmp_path):
    images, _ = planted[2](1, RESIDUAL_VARIANCE, wrong=3, error=1.5)  # of the size of the shape
    _, outcomes = fit_images(tmp_path, images, planted[0], **KEYS)
    (told,) = [each for each in texts(outcomes) if "contradicts the model" in each]
    assert int(told.split()[0]) > 45
    assert "in which point3 contradicts" in told


def test_of_pairs_as_likely_the_widest_is_taken_with_the_least_variance():
    noise = np.random.default_rng(0).normal(size=(4, 100))
    noise -= noise.mean(axis=1, keepdims=True)
    of = {
        (1.0, 1.0): -10 + noise[0],
        (2.0, 1.0): -5.05 + noise[1],
        (2.0, 2.0): -5 + noise[2],
        (1.0, 2.0): -7 + noise[3],
    }
    images = LandmarkSet(np.zeros((100, 2, P)), NAMES, tuple(map(str, range(100))))
    found = find_scale(lambda pair, some: of[pair][: len(some)], images, (1.0, 2.0), (1.0, 2.0))
    assert found == (2, 1)


@pytest.mark.parametrize("best", [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0), (8.0, 2.0)])
def test_a_wider_prior_or_a_larger_variance_alone_makes_all_pairs_be_tried(best):
    images = LandmarkSet(np.zeros((30, 2, P)), NAMES, tuple(map(str, range(30))))

    def evidence(pair, some):
        return np.full(len(some), -np.abs(np.log2(pair) - np.log2(best)).sum())

    assert find_scale(evidence, images) == best


SHARP = 1e4
NAME = next(iter(THETA))


@pytest.mark.parametrize("top", [-0.19, -0.12, 0.0, 0.07, 0.16, 0.21])
def test_a_top_within_the_steps_is_found(top):
    at = np.log(THETA[NAME].mean) + top

    def evidence(theta):
        return -0.5 * SHARP * (np.log(theta[NAME]) - at) ** 2

    theta = maximise_theta(evidence, [NAME], {NAME: THETA[NAME].mean})
    whole = SHARP + THETA[NAME].std ** -2
    expected = (SHARP * at + np.log(THETA[NAME].mean) * THETA[NAME].std ** -2) / whole
    assert np.log(theta[NAME]) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("rate", "apart"), [(None, 12), (50.0, 25), (0.5, 1)])
@pytest.mark.parametrize("n", [LARGEST, 3 * LARGEST])
def test_a_sample_is_bounded_and_of_sequences_has_pairs_that_are_a_step_apart(
    planted, n, rate, apart
):
    points, items = np.random.default_rng(1).random((n, 2, P)), tuple(map(str, range(n)))
    images = LandmarkSet(points, NAMES, items, sequences=("walk",) * n, frame_rate=rate)
    rows = np.array(draw_sample(images).items, int)
    assert LARGEST // 2 <= len(rows) <= LARGEST
    assert len(np.intersect1d(rows + apart, rows)) >= 40
    single = np.array(draw_sample(images.replaced(sequences=None)).items, int)
    assert len(single) == LARGEST
    assert len(np.unique(np.diff(single))) <= 2


def test_names_camera_and_sample_are_found_once(planted, tmp_path, monkeypatch):
    calls = []
    for module, name in (
        (joints, "find_joints"), (preparing, "match_names"), (preparing, "estimate"),
        (preparing, "choose_camera"), (preparing, "draw_sample"),
    ):  # fmt: skip
        real = getattr(module, name)

        def counted(*given, name=name, real=real, **keys):
            calls.append(name)
            return real(*given, **keys)

        monkeypatch.setattr(module, name, counted)
    fit_images(tmp_path, planted[2](2, RESIDUAL_VARIANCE)[0], planted[0], **KEYS)
    expected = ["choose_camera", "draw_sample", "estimate", "find_joints", "match_names"]
    assert sorted(calls) == expected


def test_a_fit_that_takes_long_is_announced_before_it_begins(planted, tmp_path, monkeypatch):
    clock = iter(range(0, 1000, 30))
    monkeypatch.setattr(preparing.time, "perf_counter", lambda: next(clock))
    images, _ = planted[2](1, RESIDUAL_VARIANCE)
    _, outcomes = fit_images(tmp_path, images, planted[0], **KEYS)
    assert re.match("60 images may take up to 64 minutes, 3.8 s each: give", outcomes[0].line)
    _, outcomes = fit_images(tmp_path, images.take([0]), planted[0], **KEYS)
    assert outcomes[0].line == ""


@pytest.mark.parametrize("people", [0, 1])
def test_nothing_that_could_be_seen_ends_with_1_and_without_warnings_of_numpy(
    tmp_path, recwarn, people
):
    """A detector that found nobody, and one that was sure of nobody."""
    for frame in range(6):
        body = {"pose_keypoints_2d": [300.0 + 9 * frame, 200.0, 0.05] * 25}
        text = json.dumps({"version": 1.3, "people": [body] * people})
        (tmp_path / f"f_{frame:04d}.json").write_text(text)
    assert run(["fit", str(tmp_path), "-d", "people", "-o", str(tmp_path / "o.h5"), "-q"]) == 1
    assert [str(each.message) for each in recwarn if each.category is RuntimeWarning] == []


def test_the_error_of_a_gain_counts_that_neighbours_resemble_each_other(rng):
    gains = rng.standard_normal((400, 96))
    for t in range(1, 96):
        gains[:, t] = 0.7 * gains[:, t - 1] + np.sqrt(1 - 0.7**2) * gains[:, t]
    means, errors = zip(*(mean_gain(0 * gain, gain) for gain in gains), strict=True)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) / np.std(means) < 1.1


N, SIZE, FOCAL = 60, (1920, 1080), 2000.0
BODIES = 2.5
"""Distance of the camera in heights of a body, of 4.7 units of normalised shapes."""


@pytest.fixture(scope="module")
def dictionary():
    return find_dictionaries()["people"]


@pytest.fixture(scope="module")
def poses():
    """Shapes (N, 3, 24) of the prior, y up, and the names of their landmarks."""
    people = read_dictionary(find_dictionaries()["people"])
    rng = np.random.default_rng(3)
    prior = people.prior
    chosen = rng.choice(len(prior), size=N, p=prior.weights)
    shapes = np.array(
        [
            rng.multivariate_normal(prior.means[k].ravel(), prior.covariances[k]).reshape(3, -1)
            for k in chosen
        ]
    )
    return shapes, people.landmark_names


def film(poses, skeleton):
    """Return what a detector finds of upright bodies that face all ways, from 2.5 heights away."""
    shapes, joints = poses
    theta = {name: parameter.mean for name, parameter in THETA.items()}
    parts = people_parts(installed_skeletons()[skeleton].landmark_names)
    rows = np.zeros((len(parts), len(joints)))
    for row, part in enumerate(parts.values()):
        for joint, weight in part.weights(theta).items():
            rows[row, joints.index(joint)] = weight
    rng = np.random.default_rng(4)
    turns = rotation_about(np.array([0.0, 1.0, 0.0]), rng.uniform(0, 2 * np.pi, N))
    visible = np.diag([1.0, -1.0, -1.0]) @ turns @ shapes @ rows.T
    visible[:, 2] += BODIES * 4.7
    pixels = FOCAL * visible[:, :2] / visible[:, 2:] + np.array(SIZE)[:, None] / 2
    return LandmarkSet(
        landmarks=pixels + rng.standard_normal(pixels.shape),
        landmark_names=installed_skeletons()[skeleton].landmark_names,
        items=tuple(f"image{i}" for i in range(N)),
        unit="px",
        y_axis="down",
        columns={"image_size": np.array(SIZE)},
    )


@pytest.fixture
def warnings_of(tmp_path):
    """Return what fits images by `people`: its warnings; with wrong names, none is trusted."""

    def warn(images):
        result, outcomes = fit_images(tmp_path, images, "people", method="posterior")
        warnings = texts(outcomes)
        assert result.columns["trusted"].any() != any("is it " in text for text in warnings)
        return warnings

    return warn


@pytest.mark.parametrize(("meant", "given"), [("body_25b", "body_25"), ("body_25", "body_25b")])
def test_another_skeleton_of_as_many_landmarks_is_named(warnings_of, poses, meant, given):
    images = film(poses, meant)
    assert not warnings_of(images)
    wrong = images.replaced(landmark_names=installed_skeletons()[given].landmark_names)
    (warning,) = [text for text in warnings_of(wrong) if "is it" in text]
    assert warning.startswith("no shape of this file is to be trusted")
    assert f"is it {meant}? Set `keypoints: {meant}`" in warning


@pytest.mark.parametrize("angle", [0, 90, 180])
def test_people_on_their_heads_are_counted(warnings_of, poses, angle):
    images, centre = film(poses, "body_25"), np.array(SIZE)[:, None] / 2
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turned = np.array([[c, -s], [s, c]]) @ (images.landmarks - centre) + centre
    warnings = [text for text in warnings_of(images.replaced(landmarks=turned)) if "heads" in text]
    assert len(warnings) == (angle == 180)
    assert not warnings or "on their heads: y was taken to point down" in warnings[0]
