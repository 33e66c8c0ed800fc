"""What adds up over the batches of a fit, for the summary at its end."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.pipelines.fit.summary import (
    MAX_NAMED_FILES,
    MIN_IMAGES_OF_NAME,
    MISNAMED_SHARE,
    Tally,
    find_viewed,
    format_gap,
    largest_of,
    warn_of_names,
)
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


class TestWrongNames:
    """A landmark that is an outlier in most of the images that show it is named."""

    @pytest.fixture
    def plan(self):
        """Of a file that calls the nose `face` and has the hip as two points."""
        markers = {"nose": ("face",), "hip": ("left", "right")}
        return SimpleNamespace(
            match=SimpleNamespace(
                dictionary=SimpleNamespace(landmark_names=("nose", "hip", "knee")),
                joints=SimpleNamespace(markers=markers),
            )
        )

    def warnings(self, plan, outliers, visible):
        tally = Tally(outliers=np.array(outliers), visible=np.array(visible))
        return [*warn_of_names(tally, plan)]

    def test_of_many_images_it_is_one_that_is_mostly_an_outlier(self, plan):
        half = int(MISNAMED_SHARE * 100)
        (warning,) = self.warnings(plan, [half, half + 1, 0], [100] * 3)
        assert str(warning).startswith(f"{half + 1} images in which")
        assert "left and right contradict the model" in str(warning)
        assert "`rename={left: unused_1, right: unused_2}`" in str(warning)

    def test_a_landmark_that_few_images_show_is_not_judged_by_them_alone(self, plan):
        few = int(MISNAMED_SHARE * MIN_IMAGES_OF_NAME)
        assert self.warnings(plan, [few, 0, 0], [few, 100, 100]) == []
        (warning,) = self.warnings(plan, [0, 0, few + 1], [100, 100, few + 1])
        assert "in which knee contradicts" in str(warning)

    def test_without_a_prior_nothing_is_known(self, plan):
        assert [*warn_of_names(Tally(), plan)] == []


GAPS = [
    (None, 3, ""),
    (1.23e-7, 0, ", all optimal, largest gap 1.2e-07"),
    (1.23e-7, 1200, ", 1,200 not optimal, largest gap 1.2e-07"),
    (0.5, None, ", within 5.0e-01 of the convex bound"),
]
"""The largest gap, how many images are not optimal, and what is said."""


def test_a_gap_that_rounding_leaves_below_0_counts_by_its_size():
    assert largest_of(None, np.array([-2e-16, np.nan])) == 2e-16
    assert largest_of(1e-16, np.array([-2e-16])) == 2e-16


@pytest.mark.parametrize(("largest_gap", "missed", "said"), GAPS)
def test_gaps_are_said(largest_gap, missed, said):
    assert format_gap(largest_gap, missed) == said


class TestFilesToView:
    """The next command names them, many by one glob."""

    @pytest.mark.parametrize(
        "name", ["r.h5", "r.HDF5", "r.csv", "r.metres.csv", "r.trc"]
    )
    def test_results_and_tables_are_viewed(self, name):
        assert find_viewed([Path(name)], Path(name)) == [Path(name)]

    @pytest.mark.parametrize(
        "name", ["r_angles.csv", "r.ANGLES.csv", "r.mot", "r.bvh", "r.c3d", "r.toml"]
    )
    def test_angles_and_files_of_other_programs_are_not(self, name):
        assert find_viewed([Path(name)], Path(name)) == []

    @pytest.mark.parametrize("ending", [".trc", ".csv", ".metres.csv"])
    def test_many_are_one_glob(self, ending):
        output = Path(f"/r/man{ending}")
        many = [Path(f"/r/man_{n}{ending}") for n in range(MAX_NAMED_FILES + 1)]
        assert find_viewed(many, output) == [Path(f"/r/man_*{ending}")]
        few = many[:MAX_NAMED_FILES]
        assert find_viewed(few, output) == few
