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

P = 13
PAIRS = np.arange(12).reshape(6, 2)
OTHER = [*PAIRS[:, ::-1].ravel(), 12]
T = 72
TIMELINE = Timeline.of_frames(T, 24.0)


def walk(rng, noise=0.03):
    """Landmarks (T, 2, P) of a body that turns before a camera, some not found, some
    jumping.
    """
    turn = 0.6 * np.sin(np.arange(T) / 12)
    body = rng.standard_normal((3, P))
    body[0, PAIRS[:, 0]], body[0, PAIRS[:, 1]] = 0.8, -0.8
    swing = 0.3 * np.sin(np.arange(T) / 4)[:, None] * np.array([1, -1] * 6 + [0])
    x = np.cos(turn)[:, None] * body[0] + np.sin(turn)[:, None] * (body[2] + swing)
    landmarks = np.stack([x, np.broadcast_to(body[1], x.shape)], axis=1)
    landmarks += noise * rng.standard_normal(landmarks.shape)
    jumps = rng.random((T, P)) < 0.03
    landmarks += np.where(jumps[:, None], rng.standard_normal(landmarks.shape), 0.0)
    hidden = rng.random((T, P)) < 0.03
    return np.where(hidden[:, None], np.nan, landmarks)


def exchanged(landmarks, rows):
    changed = landmarks.copy()
    changed[rows] = changed[rows][..., OTHER]
    return changed


@pytest.mark.parametrize(
    ("rows", "continuous"),
    [
        ([], True),
        ([30], True),
        ([5, 6, 7, 30, 50, 51], True),
        (range(20, 28), True),
        (range(64, 72), True),
        (range(36, 72), False),
    ],
)
def test_exchanged_frames_are_found(rng, rows, continuous):
    rows = np.array([*rows], dtype=int)
    found = find_exchanges(exchanged(walk(rng), rows), PAIRS, TIMELINE)
    assert found.continuous == continuous
    expected = rows if continuous else np.array([], dtype=int)
    assert_array_equal(np.flatnonzero(found.exchanged), expected)


def test_nothing_is_found_where_little_is_seen(rng):
    hidden = np.full((T, 2, P), np.nan)
    assert not find_exchanges(hidden, PAIRS, TIMELINE).exchanged.any()
    assert not find_exchanges(walk(rng)[:1], PAIRS, TIMELINE).exchanged.any()
    assert not find_exchanges(walk(rng), PAIRS[:0], TIMELINE).exchanged.any()


def test_the_log_likelihood_of_an_exchange_is_that_of_student():
    landmarks = np.zeros((3, 2, 2))
    landmarks[:, 1, 0] = [2.0, -2.0, -2.0]
    S = 2.5 * np.log(
        (3 + 4 * 20**2) / 3
    )  # at rest steps are a twentieth of the distance
    assert_allclose(find_changes(landmarks, PAIRS[:1], np.arange(3.0)), [0, S, -S])


@pytest.mark.parametrize(("likelihood", "changed"), [(7.9, False), (8.1, True)])
def test_sides_change_where_the_log_likelihood_is_more_than_8(likelihood, changed):
    assert likeliest_states(np.array([0, likelihood])).tolist() == [False, changed]


@pytest.mark.parametrize("seed", range(5))
def test_bodies_that_are_seen_from_the_side_exchange_nothing(seed):
    """Pairs that cross each other while they swing."""
    rng = np.random.default_rng(seed)
    landmarks = walk(rng)
    landmarks[:, 0] *= 0.1
    assert not find_exchanges(landmarks, PAIRS, TIMELINE).exchanged.any()
