"""Sequences of which frames are missing."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.lifting.sequences.smoothing import smooth
from shapefit.timeline import Timeline
from tests.lifting.sequences.conftest import without_bones

NOISE = 0.1
FRAME_RATE = 24.0


class TestLongGap:
    """Of 30 frames after the ninth. Stretches on both sides of it move by themselves,
    but have bones of one length: without bones they are those of two sequences.
    """

    @pytest.fixture
    def seen(self, images, body):
        return images(body, noise=0.05)

    @pytest.fixture
    def boneless(self, model):
        return without_bones(model)

    @pytest.fixture
    def with_gap(self, boneless, body):
        frames = np.arange(len(body))
        position = np.where(frames < 9, frames, frames + 30.0)
        return replace(boneless, timeline=Timeline(position, FRAME_RATE))

    def test_both_stretches_move_by_themselves(self, seen, boneless, with_gap):
        found = smooth(seen, with_gap, NOISE).points

        before = smooth(seen.part(slice(9)), boneless, NOISE).points
        behind = smooth(seen.part(slice(9, None)), boneless, NOISE).points
        assert_allclose(found, np.concatenate([before, behind]), atol=2e-3)

    def test_without_a_gap_they_move_together(self, seen, boneless, with_gap):
        found = smooth(seen, with_gap, NOISE).points
        joined = smooth(seen, boneless, NOISE).points
        difference = np.abs(joined - found)[7:11]
        assert difference.max() > 0.02


def cut_at_gaps(rows):
    """Return positions at which frames that are not neighbours are far apart."""
    is_after_gap = np.diff(rows, prepend=rows[0]) > 1
    return rows + 100.0 * np.cumsum(is_after_gap)


class TestMissingFrames:
    """Four of ten frames are missing."""

    @pytest.fixture
    def mean_error(self, images, body, model):
        """Return the function that finds the error of a way to place the frames that
        are left, over eight choices of these.
        """
        choices = [np.random.default_rng(seed).random(len(body)) for seed in range(8)]
        rows = [np.flatnonzero(choice > 0.4) for choice in choices]
        seen = [images(body[left], noise=0.05) for left in rows]

        def mean_error(place):
            errors = []
            for left, visible in zip(rows, seen, strict=True):
                position = np.asarray(place(left), dtype=float)
                timed = replace(model, timeline=Timeline(position, FRAME_RATE))
                points = smooth(visible, timed, NOISE).points
                errors.append(np.abs(points - body[left]).mean())
            return np.mean(errors)

        return mean_error

    def test_motion_over_them_is_better_than_without(self, mean_error):
        in_their_place = mean_error(lambda rows: rows)
        assert in_their_place < 0.95 * mean_error(cut_at_gaps)

    def test_it_is_better_than_to_take_what_is_left_for_neighbours(self, mean_error):
        in_their_place = mean_error(lambda rows: rows)
        as_neighbours = mean_error(lambda rows: np.arange(len(rows)))
        assert in_their_place < 0.98 * as_neighbours
