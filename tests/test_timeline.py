"""Places in time, stretches between long gaps, second differences over short ones."""

import numpy as np
import pytest

from shapefit.timeline import Timeline, place_in_time


@pytest.mark.parametrize(
    ("frames", "times", "places"),
    [
        (None, None, [0, 1, 2, 3]),
        ([7, 8, 11, 12], None, [0, 1, 4, 5]),
        ([7, 8, 11, 12], [0.7, 0.8, 1.1, 1.2], [0, 1, 4, 5]),
        # a clock that trembles, and times rounded to tenths
        ([0, 1, 2, 3], [0.0, 0.13, 0.19, 0.3], [0, 1, 2, 3]),
        # times that the numbers do not follow
        ([0, 1, 2, 3], [0.0, 0.1, 2.1, 2.2], [0, 1, 21, 22]),
        (None, [5.0, 5.1, 5.4, 5.5], [0, 1, 4, 5]),
        ([0, 1, 5, 6], [0.0, np.nan, np.nan, 0.6], [0, 1, 5, 6]),
        # a clock that stands still or goes back says nothing
        ([0, 1, 5, 6], [3.0, 3.0, 1.0, 1.0], [0, 1, 5, 6]),
    ],
)
def test_frames_say_the_place_and_times_that_contradict_them(frames, times, places):
    given = None if frames is None else np.array(frames)
    stated = None if times is None else np.array(times)
    found = place_in_time(given, stated, 10.0, 4)
    np.testing.assert_allclose(found, places)


@pytest.mark.parametrize("count", [0, 1])
def test_few_images_have_a_place(count):
    assert place_in_time(None, None, 10.0, count).tolist() == [0.0] * count
    frames = np.arange(count)
    assert place_in_time(frames, frames / 10, 10.0, count).tolist() == [0.0] * count


@pytest.mark.parametrize(
    ("steps", "rate", "ends"),
    [
        ([1, 1, 1], 30.0, [4]),
        ([1, 8, 1], 30.0, [4]),  # seven are missing, for 0.23 s
        ([1, 9, 1], 30.0, [2, 4]),
        ([9, 1, 60], 30.0, [1, 3, 4]),
        ([1, 7, 1], 24.0, [4]),
        ([1, 8, 1], 24.0, [2, 4]),
        ([1, 1, 1], 2.0, [4]),  # far apart, but none is missing
        ([1, 2, 1], 2.0, [2, 4]),
        ([1, 31, 1], 120.0, [4]),
        ([1, 32, 1], 120.0, [2, 4]),
    ],
)
def test_stretches_end_where_frames_are_missing_for_a_quarter_of_a_second(
    steps, rate, ends
):
    timeline = Timeline(np.cumsum([0.0, *steps]), rate)
    assert [stretch.stop for stretch in timeline.stretches] == ends
    assert [stretch.start for stretch in timeline.stretches] == [0, *ends[:-1]]


def test_second_differences_of_frames_are_plain():
    weights = Timeline.of_frames(5).second_differences()
    assert weights.tolist() == [[1, -2, 1]] * 3 + [[0, 0, 0]] * 2
    for count in (0, 1, 2):
        found = Timeline.of_frames(count).second_differences()
        assert found.shape == (count, 3)
        assert not found.any()


def test_second_differences_over_short_gaps_know_lines_and_bends():
    position = np.array([0.0, 1, 3, 4, 8, 9])
    weights = Timeline(position, 24.0).second_differences()
    assert not weights[4:].any()
    inner = np.arange(4)[:, None] + np.arange(3)
    line = 3 * position - 7
    bend = 0.5 * position**2
    np.testing.assert_allclose((weights[:4] * line[inner]).sum(axis=1), 0, atol=1e-12)
    span = position[2:] - position[:-2]
    expected = np.sqrt(span / 2)  # span / 2 of a bend of 1, over its deviation
    np.testing.assert_allclose((weights[:4] * bend[inner]).sum(axis=1), expected)


def test_they_vary_alike_where_a_velocity_wanders(rng):
    fine = 20
    velocity = np.cumsum(rng.standard_normal((4000, 12 * fine)), axis=1)
    paths = np.cumsum(velocity, axis=1) / fine**1.5
    sd = []
    for position in ([2, 3, 4], [2, 3, 8], [2, 7, 8], [2, 6, 10]):
        weights = Timeline(np.array(position, float), 24.0).second_differences()[0]
        sd.append((paths[:, np.array(position) * fine] @ weights).std())
    assert max(sd) < 1.1 * min(sd)


def test_no_difference_reaches_over_a_long_gap():
    timeline = Timeline(np.array([0.0, 1, 2, 3, 40, 41, 42, 90, 91]), 24.0)
    weights = timeline.second_differences()
    assert np.flatnonzero(weights.any(axis=1)).tolist() == [0, 1, 4]
    assert weights[4].tolist() == [1, -2, 1]


def test_places_on_the_grid_of_all_frames():
    timeline = Timeline(np.array([0.0, 1, 3.2, 3.4, 1003.4]), 24.0)
    assert timeline.on_grid().tolist() == [0, 1, 3, 4, 1004]
    assert timeline.on_grid(5).tolist() == [0, 1, 3, 4, 10]
    assert Timeline.of_frames(3).on_grid().tolist() == [0, 1, 2]


@pytest.fixture
def rng():
    return np.random.default_rng(5)
