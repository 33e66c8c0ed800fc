"""Individuals of one recording are seen at once, at the true times."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.io import read_shapes
from shapefit.pipelines.view.reading import Frames
from shapefit.pipelines.view.scene import find_recordings
from tests.pipelines.view.conftest import write_truth


def frames_of(numbers, **groups):
    """Return frames of items, a letter each, in groups that name their sequences."""
    names = [name.replace("_", "/") for name in groups]
    items = tuple("".join(groups.values()))
    starts = np.cumsum([0, *map(len, groups.values())]).tolist()
    sequences = tuple(zip(names, starts, strict=False))
    if numbers is None:
        numbers = np.full(len(items), np.nan)
    return Frames(items, sequences, 1, np.array(numbers, float))


TWO_INDIVIDUALS = {"v_1": "abc", "v_2": "de"}


TWO_VIDEOS = {"v_1": "abc", "w_1": "de"}


MIXED = {"v_1": "ab", "w_1": "c", "v_2": "de"}


RECORDINGS = {
    "same frames": (TWO_INDIVIDUALS, [7, 8, 9, 8, 9], [[0, 1]], [0, 1, 2, 1, 2]),
    "no frames": (TWO_INDIVIDUALS, None, [[0], [1]], [0, 1, 2, 0, 1]),
    "a frame unknown": (
        TWO_INDIVIDUALS,
        [7, 8, np.nan, 8, 9],
        [[0], [1]],
        [0, 1, 2, 0, 1],
    ),
    "other frames": (TWO_INDIVIDUALS, [1, 2, 3, 4, 5], [[0], [1]], [0, 1, 2, 0, 1]),
    "two videos": (TWO_VIDEOS, [7, 8, 9, 8, 9], [[0], [1]], [0, 1, 2, 0, 1]),
    "mixed": (MIXED, [7, 9, 7, 8, 9], [[0, 2], [1]], [0, 2, 0, 1, 2]),
}
"""Items of sequences, their frames, the sequences of each recording, and the times."""


@pytest.mark.parametrize(
    ("groups", "numbers", "expected", "expected_times"),
    RECORDINGS.values(),
    ids=RECORDINGS,
)
def test_individuals_of_a_video_are_seen_at_once(
    groups, numbers, expected, expected_times
):
    result = SimpleNamespace(role="result", name="r")
    recordings, times = find_recordings([result], frames_of(numbers, **groups))
    assert sorted(recordings) == expected
    assert times.tolist() == expected_times


@pytest.mark.parametrize(
    ("file_count", "expected", "expected_times"),
    [(2, [[0, 1]], [0, 1, 1, 2]), (1, [[0], [1]], [0, 1, 0, 1])],
)
def test_files_of_one_individual_each_are_seen_at_once(
    file_count, expected, expected_times
):
    files = [SimpleNamespace(role="shapes")] * file_count
    frames = frames_of([0, 1, 1, 2], anna="ab", ben="cd")
    recordings, times = find_recordings(files, frames)
    assert recordings == expected
    assert times.tolist() == expected_times


GAPS = [
    ([4, 5, 9, 10], 1, [0, 1, 5, 6]),
    ([4, 6, 8, 14], 2, [0, 1, 2, 5]),
    ([4, 7, 8, 13], 2, [0, 1, 2, 4]),  # every second of those that are there
    ([0, 1, 2, 10**9], 1, [0, 1, 2, 3]),  # no numbers of frames
    (None, 1, [0, 1, 2, 3]),
]
"""Numbers of frames, their step, and the times."""


@pytest.mark.parametrize(("numbers", "step", "expected"), GAPS)
def test_missing_frames_are_gaps_on_the_page(numbers, step, expected):
    frames = frames_of(numbers, walk="abcd")._replace(step=step)
    _, times = find_recordings([], frames)
    assert times.tolist() == expected


def test_a_page_plays_at_the_true_times(desk):
    numbers = [0, 1, 2, 60, 61, 62]
    result = desk.result(sequences=("v",) * 6, extras={"frame": np.array(numbers)})
    page = desk.scene(result, frame_rate=30.0)
    first, second, *_ = page["facts"]
    assert page["times"].tolist() == numbers
    assert first["text"] == "6 frames"
    assert second["text"] == "30 Hz"


def shapes_file(desk, name, n, **fields):
    """Write shapes of one sequence, so named."""
    items = tuple(f"{name}/{number}" for number in range(n))
    path = desk.folder / f"{name}.h5"
    fields |= {"items": items, "sequences": (name,) * n}
    return write_truth(path, desk.shapes(n), **fields)


@pytest.fixture
def two_men(desk):
    """Files of two individuals of one recording, and the page of both."""
    names = ("rhip", "rknee", "rankle", "lhip", "head")
    fields = {"landmark_names": names, "unit": "m", "frame_rate": 25.0}
    anna = shapes_file(desk, "man_anna", 4, frames=np.arange(4), **fields)
    emil = shapes_file(desk, "man_emil", 3, frames=np.arange(3) + 1, **fields)
    return [anna, emil], desk.scene(anna, emil)


def test_files_of_one_recording_are_individuals_of_one_layer(two_men):
    files, page = two_men
    (layer,) = page["layers"]
    expected = np.concatenate([read_shapes([path]).as_columns() for path in files])
    assert page["recordings"] == [[0, 1]]
    assert layer["name"] == "man_anna, man_emil"
    assert_allclose(layer["points"], expected)


@pytest.mark.parametrize("shared", [0, 2])
def test_files_of_an_item_of_the_same_name_are_layers_each(desk, shared):
    """One layer could show it once alone."""
    files = []
    for name in ("anna", "emil"):
        items = [f"{name}/{number}" for number in range(3)]
        items[shared] = "both"
        fields = {"items": items, "sequences": (name,) * 3, "frames": np.arange(3)}
        path = desk.folder / f"{name}.h5"
        files.append(write_truth(path, desk.shapes(3), **fields))

    page = desk.scene(*files)

    assert page["recordings"] == [[0, 1]]
    assert [layer["name"] for layer in page["layers"]] == ["anna", "emil"]


def test_individuals_of_one_layer_have_joint_angles(two_men):
    _, page = two_men
    (layer,) = page["layers"]
    measures = {measure["name"]: measure for measure in layer["measures"]}
    angles = measures["knee angle r"]["values"]
    assert np.isfinite(angles).all()
    assert np.ptp(angles) > 0


def test_files_with_and_without_frames_are_not_one_recording(desk):
    """A file whose frames nobody numbered is alone, whatever its place."""
    first = shapes_file(desk, "first", 3, frames=np.arange(3))
    second = shapes_file(desk, "second", 3)
    assert desk.scene(first, second)["recordings"] == [[0], [1]]
    assert desk.scene(second, first)["recordings"] == [[0], [1]]
    assert len(desk.scene(first, second)["layers"]) == 2


def test_two_results_of_one_recording_are_layers_each(desk):
    """Which may be two fits of the same people."""
    files = []
    for name in ("anna", "emil"):
        items = tuple(f"v/{name}/{number}" for number in range(3))
        fields = {"items": items, "sequences": (f"v/{name}",) * 3}
        extras = {"frame": np.arange(3)}
        files.append(desk.result(f"{name}.h5", n=3, extras=extras, **fields))

    page = desk.scene(*files)

    assert page["recordings"] == [[0, 1]]
    assert [layer["name"] for layer in page["layers"]] == ["anna", "emil"]
