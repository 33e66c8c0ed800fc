"""Places in time, stretches between long gaps, second differences over short ones."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.timeline import Timeline, begins_sequence, find_rate, place_in_time

PLACES = [
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
]
"""Frames and times of four images at 10 Hz, and their places."""


def array_or_none(values):
    return None if values is None else np.array(values)


@pytest.mark.parametrize(("frames", "times", "expected"), PLACES)
def test_frames_say_the_place_and_times_that_contradict_them(frames, times, expected):
    places = place_in_time(array_or_none(frames), array_or_none(times), 10.0, 4)
    assert_allclose(places, expected)


@pytest.mark.parametrize("count", [0, 1])
def test_few_images_have_a_place(count):
    frames = np.arange(count)
    unnumbered = place_in_time(None, None, 10.0, count)
    numbered = place_in_time(frames, frames / 10, 10.0, count)
    assert unnumbered.tolist() == [0.0] * count
    assert numbered.tolist() == [0.0] * count


def test_items_without_a_sequence_are_each_by_itself():
    begins = begins_sequence(["", "", "a", "a", "b", "", ""])
    assert begins.tolist() == [True, True, False, True, True, True]


def rate_of(seconds_per_frame, count=98, decimals=4, start=0.0):
    """Find the rate of frames in a row, whose times are rounded."""
    frames = np.arange(count)
    times = start + seconds_per_frame * frames
    return find_rate(frames, times.round(decimals))


@pytest.mark.parametrize("rate", [1.0, 24.0, 25.0, 30.0, 60.0, 120.0, 240.0])
@pytest.mark.parametrize("decimals", [6, 9])
def test_times_of_a_rate_in_use_say_it_exactly(rate, decimals):
    assert rate_of(1 / rate, decimals=decimals) == rate


@pytest.mark.parametrize("rate", [24.0, 30.0, 60.0, 120.0])
def test_times_that_are_rounded_say_the_rate_by_all_of_their_steps(rate):
    """At 30 Hz most steps are 0.0333 s, which is 30.03 Hz."""
    assert rate_of(1 / rate, decimals=4) == rate


def test_a_median_step_near_a_rate_of_television_does_not_decide():
    """At 240 Hz it is 0.00417 s, which is 239.8 Hz."""
    assert rate_of(1 / 240, decimals=5) == 240.0


@pytest.mark.parametrize("whole", [24, 30, 60, 120])
def test_a_rate_of_television_is_told_from_the_whole_one(whole):
    seconds = 1.001 / whole
    found = rate_of(seconds, decimals=6)
    assert found == pytest.approx(1 / seconds, rel=1e-9)


@pytest.mark.parametrize(("late", "seconds"), [(-1, 0.01), (5, 0.036)])
def test_a_frame_that_is_late_does_not_change_the_rate(late, seconds):
    """By a quarter of a step, or by most of one."""
    frames = np.arange(10)
    times = frames / 25
    times[late] += seconds
    assert find_rate(frames, times) == 25.0


def test_a_rate_that_is_not_in_use_is_that_of_all_steps():
    """Most steps are 0.0379 s, which is 26.385 Hz."""
    assert rate_of(1 / 26.4, decimals=4) == pytest.approx(26.4, rel=1e-4)


def test_in_a_long_recording_a_rate_near_one_in_use_is_another():
    """At 59.98 Hz a frame and a half is lost in 5000; in 500, too little to tell."""
    assert rate_of(1 / 59.98, count=5000, decimals=9) == pytest.approx(59.98)
    assert rate_of(1 / 59.98, count=500, decimals=9) == 60.0


def test_a_clock_that_starts_late_has_the_same_rate():
    assert rate_of(1 / 25, start=3600.0) == 25.0


def test_missing_frames_and_times_do_not_change_the_rate():
    frames = np.array([3, 4, 5, 9, 10, 40, 41])
    times = frames / 25
    times[[1, 4]] = np.nan
    assert find_rate(frames, times) == 25.0


def test_a_pause_of_the_clock_does_not_change_the_rate():
    """Before frame 5, for a minute."""
    frames = np.arange(10)
    times = frames / 25 + 60.0 * (frames >= 5)
    assert find_rate(frames, times) == 25.0


@pytest.mark.parametrize(
    ("frames", "times"),
    [
        (None, [0.0, 0.1]),
        ([0, 1], None),
        ([], []),
        ([0], [0.0]),
        ([0, 1, 2], [0.0, np.nan, np.nan]),
        ([0, 1, 2], [2.0, 2.0, 1.0]),  # a clock that stands still and goes back
        ([3, 3, 3], [0.0, 0.1, 0.2]),
    ],
)
def test_some_times_say_no_rate(frames, times):
    assert find_rate(array_or_none(frames), array_or_none(times)) is None


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


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_frames_have_no_second_differences(count):
    weights = Timeline.of_frames(count).second_differences()
    assert weights.shape == (count, 3)
    assert not weights.any()


SHORT_GAPS = np.array([0.0, 1, 3, 4, 8, 9])


def second_differences(values):
    """Return the four differences of values at SHORT_GAPS."""
    weights = Timeline(SHORT_GAPS, 24.0).second_differences()
    triples = np.arange(4)[:, None] + np.arange(3)
    assert not weights[4:].any()
    return (weights[:4] * values[triples]).sum(axis=1)


def test_second_differences_over_short_gaps_know_lines():
    line = 3 * SHORT_GAPS - 7
    assert_allclose(second_differences(line), 0, atol=1e-12)


def test_second_differences_over_short_gaps_know_bends():
    """Half the span of a bend of 1, over its deviation."""
    bend = 0.5 * SHORT_GAPS**2
    span = SHORT_GAPS[2:] - SHORT_GAPS[:-2]
    assert_allclose(second_differences(bend), np.sqrt(span / 2))


def test_they_vary_alike_where_a_velocity_wanders(rng):
    fine = 20
    velocity = np.cumsum(rng.standard_normal((4000, 12 * fine)), axis=1)
    paths = np.cumsum(velocity, axis=1) / fine**1.5
    deviations = []
    for position in ([2, 3, 4], [2, 3, 8], [2, 7, 8], [2, 6, 10]):
        timeline = Timeline(np.array(position, float), 24.0)
        weights = timeline.second_differences()[0]
        differences = paths[:, np.array(position) * fine] @ weights
        deviations.append(differences.std())
    assert max(deviations) < 1.1 * min(deviations)


def test_no_difference_reaches_over_a_long_gap():
    timeline = Timeline(np.array([0.0, 1, 2, 3, 40, 41, 42, 90, 91]), 24.0)
    weights = timeline.second_differences()
    rows = np.flatnonzero(weights.any(axis=1))
    assert rows.tolist() == [0, 1, 4]
    assert weights[4].tolist() == [1, -2, 1]


def test_places_on_the_grid_of_all_frames():
    timeline = Timeline(np.array([0.0, 1, 3.2, 3.4, 1003.4]), 24.0)
    assert timeline.frame_numbers().tolist() == [0, 1, 3, 4, 1004]
    assert timeline.frame_numbers(5).tolist() == [0, 1, 3, 4, 10]
    assert Timeline.of_frames(3).frame_numbers().tolist() == [0, 1, 2]


@pytest.fixture
def rng():
    return np.random.default_rng(5)
