"""Left and right exchanged in some frames: found where planted, and nowhere else."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.lifting.sequences.exchanges import (
    find_changes,
    find_exchanges,
    likeliest_states,
)
from shapefit.timeline import Timeline
from tests.points import with_noise

PAIRS = np.arange(12).reshape(6, 2)
"""Landmarks of the left and of the right side."""

P = 13
"""Landmarks, of which the last has no partner."""

OTHER = [*PAIRS[:, ::-1].ravel(), 12]
"""Landmark -> the one for which it may be taken."""

T = 72
"""Frames."""

TIMELINE = Timeline.of_frames(T, 24.0)


def walk(rng, noise=0.03):
    """Landmarks (T, 2, P) of a body that turns before a camera, some not found, some
    jumping.
    """
    frames = np.arange(T)
    body = rng.standard_normal((3, P))
    body[0, PAIRS[:, 0]] = 0.8
    body[0, PAIRS[:, 1]] = -0.8
    opposite_for_partners = np.array([1, -1] * 6 + [0])
    swing = 0.3 * np.sin(frames / 4)[:, None] * opposite_for_partners
    depth = body[2] + swing
    angle = 0.6 * np.sin(frames / 12)[:, None]
    x = np.cos(angle) * body[0] + np.sin(angle) * depth
    y = np.broadcast_to(body[1], x.shape)

    landmarks = with_noise(np.stack([x, y], axis=1), noise, rng)
    does_jump = rng.random((T, P)) < 0.03
    landmarks += does_jump[:, None] * rng.standard_normal(landmarks.shape)
    is_hidden = rng.random((T, P)) < 0.03
    return np.where(is_hidden[:, None], np.nan, landmarks)


def exchange(landmarks, frames):
    """Take left for right in some frames."""
    changed = landmarks.copy()
    changed[frames] = changed[frames][..., OTHER]
    return changed


FEW_FRAMES = [[], [30], [5, 6, 7, 30, 50, 51], range(20, 28), range(64, 72)]


@pytest.mark.parametrize("frames", FEW_FRAMES)
def test_exchanged_frames_are_found(rng, frames):
    frames = np.array([*frames], dtype=int)
    landmarks = exchange(walk(rng), frames)

    found = find_exchanges(landmarks, PAIRS, TIMELINE)

    assert found.continuous
    assert_array_equal(np.flatnonzero(found.exchanged), frames)


def test_of_two_halves_nobody_knows_which_is_exchanged(rng):
    landmarks = exchange(walk(rng), np.arange(36, 72))
    found = find_exchanges(landmarks, PAIRS, TIMELINE)
    assert not found.continuous
    assert not found.exchanged.any()


def hide_all(landmarks):
    return np.full_like(landmarks, np.nan)


def first_frame(landmarks):
    return landmarks[:1]


@pytest.mark.parametrize("leave", [hide_all, first_frame])
def test_nothing_is_found_where_little_is_seen(rng, leave):
    landmarks = leave(walk(rng))
    assert not find_exchanges(landmarks, PAIRS, TIMELINE).exchanged.any()


def test_nothing_is_found_without_pairs(rng):
    no_pairs = PAIRS[:0]
    assert not find_exchanges(walk(rng), no_pairs, TIMELINE).exchanged.any()


def test_the_log_likelihood_of_an_exchange_is_that_of_student():
    """At rest steps are a twentieth of the distance."""
    landmarks = np.zeros((3, 2, 2))
    landmarks[:, 1, 0] = [2.0, -2.0, -2.0]

    found = find_changes(landmarks, PAIRS[:1], np.arange(3.0))

    change = 2.5 * np.log((3 + 4 * 20**2) / 3)
    assert_allclose(found, [0, change, -change])


@pytest.mark.parametrize(("likelihood", "changed"), [(7.9, False), (8.1, True)])
def test_sides_change_where_the_log_likelihood_is_more_than_8(likelihood, changed):
    states = likeliest_states(np.array([0, likelihood]))
    assert states.tolist() == [False, changed]


@pytest.mark.parametrize("seed", range(5))
def test_bodies_that_are_seen_from_the_side_exchange_nothing(seed):
    """Pairs that cross each other while they swing."""
    landmarks = walk(np.random.default_rng(seed))
    landmarks[:, 0] *= 0.1
    assert not find_exchanges(landmarks, PAIRS, TIMELINE).exchanged.any()
