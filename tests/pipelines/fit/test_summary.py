"""What adds up over the batches of a fit, for the summary at its end."""

import numpy as np
import pytest

from shapefit.pipelines.fit.summary import Tally
from shapefit.records import Fit

PEOPLE = ("head", "neck", "lshoulder", "rshoulder", "lhip", "rhip", "lankle", "rankle")
N = 7
P = len(PEOPLE)


def upright_body():
    """Return points (P, 3) with y up: the head at 1.7, the ankles at 0.1."""
    heights = [1.7, 1.5, 1.4, 1.4, 1.0, 1.0, 0.1, 0.1]
    sides = [0, 0, 0.2, -0.2, 0.1, -0.1, 0.1, -0.1]
    return np.column_stack([sides, heights, np.zeros(P)])


def count_bodies(shapes, y_axis):
    """Return how many bodies a tally counts, and how many of them on their heads."""
    tally = Tally()
    tally.add_bodies(Fit(shapes, landmark_names=PEOPLE, y_axis=y_axis))
    return tally.bodies, tally.on_head


@pytest.mark.parametrize("place", [0.0, 500.0, -500.0])
class TestBodies:
    """Wherever in the image they are: one stands, one is upside down, one has no
    shape.
    """

    @pytest.fixture
    def shapes(self, place):
        standing = upright_body()
        upside_down = standing * [1, -1, 1]
        nothing = np.full((P, 3), np.nan)
        shapes = np.stack([standing, upside_down, nothing])
        return shapes + np.array([0, place, 0])

    def test_one_of_two_is_on_its_head_where_y_points_up(self, shapes):
        assert count_bodies(shapes[[0, 0, 1, 2]], "up") == (3, 1)

    def test_and_the_other_where_it_points_down(self, shapes):
        assert count_bodies(shapes[[0, 0, 1, 2]], "down") == (3, 2)


class TestBatches:
    """They add up to what all images are at once."""

    @pytest.fixture
    def record(self, rng):
        probability = rng.random((N, P))
        probability[rng.random((N, P)) < 0.2] = np.nan
        gap = rng.random(N) * 1e-6
        gap[3] = np.nan
        expected_error = rng.random(N)
        expected_error[5] = np.nan
        return Fit(
            upright_body() * rng.choice([-1, 1], (N, 1, 1)),
            landmark_names=PEOPLE,
            items=tuple(map(str, range(N))),
            sequences=("a",) * 3 + ("b",) * 4,
            y_axis="up",
            status=np.array(["optimal"] * 4 + ["iteration limit"] * 3, object),
            relative_gap=gap,
            metres_per_unit=np.full(N, 0.5),
            expected_error=expected_error,
            inlier_probability=probability,
            trusted=np.arange(N) % 3 > 0,
        )

    @pytest.fixture(params=[1, 2, 3])
    def tally(self, record, request):
        """That of batches of so many images."""
        tally = Tally()
        for start in range(0, N, request.param):
            tally.add(record.take(slice(start, start + request.param)))
        return tally

    def test_landmarks_are_counted_where_they_are_seen(self, tally, record):
        seen = np.isfinite(record.inlier_probability)
        assert tally.visible.tolist() == seen.sum(axis=0).tolist()

    def test_and_as_outliers_where_they_are_probably_such(self, tally, record):
        is_outlier = record.inlier_probability < 0.5
        assert tally.outliers.tolist() == is_outlier.sum(axis=0).tolist()

    def test_images_and_verdicts(self, tally, record):
        assert tally.images == tally.judged == N
        assert tally.trusted == record.trusted.sum()

    def test_sequences_are_counted_once(self, tally):
        assert tally.sequences == {"a", "b"}

    def test_errors_are_those_of_trusted_images_in_metres(self, tally, record):
        metres = 0.5 * record.expected_error[record.trusted]
        assert tally.errors == metres[np.isfinite(metres)].tolist()

    def test_gaps(self, tally, record):
        assert tally.solved == N - 1
        assert tally.optimal == 4
        assert tally.largest_gap == np.nanmax(record.relative_gap)

    def test_bodies(self, tally, record):
        assert tally.bodies == N
        assert tally.on_head == (record.shapes[:, 0, 1] < 0).sum()
