"""Sequences whose frames have gaps, or come in another order."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.io import (
    read_dictionary,
)
from tests.columns import put
from tests.io.files import load

FRAME_COUNT = 36


@pytest.fixture(scope="module")
def walk(people):
    """Images of one sequence of 36 frames at 24 Hz."""
    images = load(people.all_views)
    rows = np.flatnonzero(np.array(images.sequences) == images.sequences[0])
    return images.take(rows[:FRAME_COUNT]).replaced(frame_rate=24.0)


def at_frames(images, frames):
    return put(images, {"frame": np.asarray(frames)})


@pytest.fixture
def lifted(lift_sequences):
    """Lift images to a result."""

    def lift(images, **keys):
        result, _ = lift_sequences(images, **keys)
        return result

    return lift


@pytest.mark.parametrize(("gap", "rate"), [(8, 24), (60, 24), (20, 60)])
def test_stretches_on_both_sides_of_a_long_gap_are_lifted_apart(
    lifted, walk, gap, rate
):
    """But for lengths and size, which they have together."""
    images = walk.replaced(frame_rate=float(rate))
    rows = np.arange(FRAME_COUNT)
    frames = np.where(rows < 16, rows, rows + gap - 1)
    before = lifted(images.take(slice(0, 16)))
    after = lifted(images.take(slice(16, FRAME_COUNT)))
    apart = np.concatenate([before.shapes, after.shapes])
    with_gap = lifted(at_frames(images, frames))
    without_gap = lifted(images)
    unit = np.median(with_gap.scale)
    difference = np.abs(apart - with_gap.shapes) / unit
    difference_without = np.abs(apart - without_gap.shapes) / unit
    at_the_gap = slice(14, 18)
    assert difference.mean() < 0.006
    assert difference.max() < 0.1
    assert difference_without[at_the_gap].mean() > 1.5 * difference[at_the_gap].mean()


def assert_same_shapes(result, expected):
    assert_array_equal(result.shapes, expected.shapes)
    assert_array_equal(result.shape_sd, expected.shape_sd)


def test_frames_without_a_gap_change_no_bit(lifted, walk):
    plain = lifted(walk)
    numbered = lifted(at_frames(walk, 100 + np.arange(FRAME_COUNT)))
    assert_same_shapes(numbered, plain)
    assert numbered.frames.tolist() == [*range(100, 136)]
    assert plain.frames is None


def test_times_without_a_gap_change_no_bit(lifted, walk):
    times = np.round(7 + np.arange(FRAME_COUNT) / 24, 2)
    plain = lifted(walk)
    timed = lifted(at_frames(put(walk, {"time": times}), np.arange(FRAME_COUNT)))
    assert_same_shapes(timed, plain)
    assert timed.times[1] == 7.04


def test_images_are_lifted_in_order_of_their_frames(lifted, walk, rng):
    order = rng.permutation(FRAME_COUNT)
    frames = np.arange(FRAME_COUNT) * 3 // 2
    in_order = at_frames(walk, frames)
    expected = lifted(in_order)
    result = lifted(in_order.take(order))
    assert result.items == expected.items
    assert_array_equal(result.shapes, expected.shapes)


@pytest.mark.parametrize("share", [0.1, 0.2, 0.4])
def test_every_frame_is_refined_though_neighbours_are_missing(lifted, walk, share):
    there = np.random.default_rng(1).random(FRAME_COUNT) >= share
    rows = np.flatnonzero(there)
    result = lifted(at_frames(walk.take(rows), rows))
    assert np.isfinite(result.sequence_noise).all()


def test_frames_alone_between_long_gaps_have_the_lengths_of_the_sequence(
    people, lifted, walk
):
    rows = np.r_[0:16, 26, 35]
    edges = read_dictionary(people.dictionary).edges
    result = lifted(at_frames(walk.take(rows), rows))
    single = lifted(walk.take(rows), method="posterior")
    assert np.isfinite(result.sequence_noise).all()
    assert spread_of_lengths(result, edges) < 0.3 * spread_of_lengths(single, edges)


def spread_of_lengths(result, edges):
    """Return how far the proportions of bones in the last frames are from those of the
    first 16.
    """
    one, other = edges.T
    bones = result.shapes[:, one] - result.shapes[:, other]
    lengths = np.linalg.norm(bones, axis=2)
    shares = lengths / lengths.sum(axis=1, keepdims=True)
    usual = np.median(shares[:16], axis=0)
    return np.abs(shares[16:] - usual).mean()
