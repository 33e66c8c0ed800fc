"""Depths along a sequence: a planted motion with gross errors, and what must not change."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.geometry.rotations import rotation_about
from shapefit.lifting.temporal import (
    DepthOptions,
    longest_lengths,
    refine_depths,
    refine_sequences,
    runs,
)

SETTINGS = DepthOptions(max_rounds=300)
BONES = np.array([[0, 1], [1, 2], [2, 3], [1, 4], [4, 5]])


@pytest.fixture
def body(rng):
    """A rigid body that turns once before the camera, (120, 3, 6), mean depth 0."""
    shape = rng.standard_normal((3, 6))
    shape -= shape.mean(axis=1, keepdims=True)
    turn = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    return rotation_about(np.array([0.0, 1.0, 0.0]), turn) @ shape


@pytest.fixture
def estimate(body, rng):
    """The body with one in ten depths reversed and noise on all."""
    wrong = body.copy()
    wrong[:, 2][rng.random(wrong[:, 2].shape) < 0.1] *= -1
    wrong[:, 2] += 0.02 * rng.standard_normal(wrong[:, 2].shape)

    return wrong


def gross_errors(shapes, truth):
    """Share of depths that are wrong by more than 0.2, each frame about its median error."""
    error = shapes[:, 2] - truth[:, 2]
    return (np.abs(error - np.median(error, axis=1, keepdims=True)) > 0.2).mean()


def refine(shapes, names=None, bones=BONES, settings=SETTINGS):
    return refine_sequences(shapes, names or ("a",) * len(shapes), bones, settings)


def test_planted_motion_is_found(body, estimate):
    assert gross_errors(estimate, body) > 0.08
    assert gross_errors(refine(estimate), body) < 0.02


def test_truth_with_its_lengths_and_no_acceleration_is_a_fixed_point(rng):
    start, velocity = rng.standard_normal((2, 3, 6))
    start -= start.mean(axis=1, keepdims=True)
    velocity[:] = 0.0
    velocity[0] = 0.02
    shapes = start + np.arange(20)[:, None, None] * velocity
    lengths = np.linalg.norm(start[:, BONES[:, 0]] - start[:, BONES[:, 1]], axis=0)
    found = refine_depths(shapes, BONES, lengths, SETTINGS)
    np.testing.assert_allclose(found, shapes[:, 2], atol=1e-12)


def test_constant_sequence_without_rigidity_is_unchanged(rng):
    shapes = np.repeat(rng.standard_normal((1, 3, 6)), 9, axis=0)
    found = refine(shapes, settings=DepthOptions(rigidity=0.0))
    np.testing.assert_allclose(found, shapes, atol=1e-12)


def test_landmarks_and_mean_depth_stay(estimate):
    found = refine(estimate + 5.0)
    np.testing.assert_array_equal(found[:, :2], estimate[:, :2] + 5.0)
    np.testing.assert_allclose(
        found[:, 2].mean(axis=1), estimate[:, 2].mean(axis=1) + 5.0, atol=1e-9
    )


def test_turning_the_image_and_reversing_depths_turn_the_answer(estimate):
    turn = rotation_about(np.array([0.0, 0.0, 1.0]), np.array([0.7]))[0]
    # reversing an axis of the image as well is a half turn about the other one
    flip = np.diag([-1.0, 1.0, -1.0])
    for motion in (turn, flip):
        np.testing.assert_allclose(refine(motion @ estimate), motion @ refine(estimate), atol=1e-9)


def test_unit_and_time_direction_do_not_matter(estimate):
    found = refine(estimate)
    np.testing.assert_allclose(refine(1000 * estimate), 1000 * found, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(refine(estimate[::-1])[::-1], found, atol=1e-9)


def test_sequences_do_not_hear_of_each_other(estimate, body):
    alone = refine(estimate)
    both = refine(
        np.concatenate([estimate, 3 * body, estimate]), ("a",) * 120 + ("b",) * 120 + ("a",) * 120
    )
    np.testing.assert_array_equal(both[:120], alone)
    np.testing.assert_array_equal(both[240:], alone)


def test_failed_frames_stay_failed_and_harm_none(estimate, body):
    holed = estimate.copy()
    holed[50] = np.nan
    found = refine(holed)
    assert np.isnan(found[50]).all()
    others = np.arange(120) != 50
    assert gross_errors(found[others], body[others]) < 0.02
    assert np.isnan(refine(np.full((2, 3, 6), np.nan))).all()


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_short_sequences_come_back_finite(estimate, frames):
    assert np.isfinite(refine(estimate[:frames])).all()


def test_objective_never_rises(estimate):
    lengths = longest_lengths(estimate[:, :2], BONES)
    values = []
    for rounds in range(1, 12):
        settings = DepthOptions(max_rounds=rounds)
        z = refine_depths(estimate, BONES, lengths, settings)
        values.append(objective(estimate, z, lengths, settings))
    assert (np.diff(values) <= 1e-9 * values[0]).all()
    assert values[-1] < values[0]


def objective(points, z, lengths, settings):
    r = (z - points[:, 2]) / settings.tolerance
    deep = np.concatenate([points[:, :2], z[:, None]], axis=1)
    sizes = np.linalg.norm(deep[:, :, BONES[:, 0]] - deep[:, :, BONES[:, 1]], axis=1)
    return (
        settings.tolerance**2 * (np.sqrt(1 + r**2) - 1).sum()
        + settings.smoothness / 2 * (np.diff(z, 2, axis=0) ** 2).sum()
        + settings.rigidity / 2 * ((sizes - lengths) ** 2).sum()
    )


def test_length_is_the_longest_projection():
    landmarks = np.zeros((2, 2, 2))
    landmarks[0, :, 1] = 3.0, 4.0
    landmarks[1, :, 1] = 1.0, 1.0
    assert longest_lengths(landmarks, np.array([[0, 1]])) == pytest.approx(5.0)


def test_runs_of_equal_neighbours():
    assert runs(np.array(list("aabaa"))) == [slice(0, 2), slice(2, 3), slice(3, 5)]
    assert runs(np.array([])) == []


def test_names_must_match_the_shapes(estimate):
    with pytest.raises(ValueError, match="2 sequence names for 120 shapes"):
        refine(estimate, ("a", "b"))


def test_empty_shapes_have_no_depths_to_refine():
    shapes = np.zeros((4, 3, 6)) + np.array([1.0, 2.0, 0.0])[:, None]
    refined = refine_sequences(shapes, ("a",) * 4, BONES, SETTINGS)
    np.testing.assert_array_equal(refined, shapes)
