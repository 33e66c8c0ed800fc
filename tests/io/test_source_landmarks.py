"""Files of landmarks as one source: batches, what goes together, what is refused."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.io import (
    open_landmarks,
)
from shapefit.io.options import InputOptions
from shapefit.records import Landmarks
from tests.io.files import save

SEPARATELY = "use files that agree, or process them separately"


PARTS = [slice(0, 1), slice(1, 1), slice(1, 4), slice(4, 5)]
"""Rows of five images, in four files."""


@pytest.fixture(params=[0, 64])
def parts(request, tmp_path, landmarks, monkeypatch):
    """Files of the parts; so many of them are open at once."""
    monkeypatch.setattr("shapefit.io.source.MAX_OPEN", request.param)
    paths = []
    for rows in PARTS:
        path = tmp_path / f"{rows}.h5"
        save(path, landmarks.take(rows))
        paths.append(path)
    return paths


def test_files_are_counted_and_described_as_one(parts):
    with open_landmarks(parts) as source:
        assert source.count == 5
        assert source.head.unit == "px"
        assert source.head.y_axis == "down"


@pytest.mark.parametrize("size", [1, 2, 3, 100])
def test_batches_run_over_the_ends_of_files(parts, landmarks, same, size):
    start = 0
    with open_landmarks(parts) as source:
        for batch in source.batches(size):
            stop = min(start + size, 5)
            same(batch, landmarks.take(slice(start, stop)))
            start = stop
    assert start == 5


FILES_TOGETHER = {
    1: [[0], [2], [2], [2], [3]],
    2: [[0], [2, 2], [2, 3]],
    3: [[0], [2, 2, 2], [3]],
    4: [[0, 2, 2, 2], [3]],
    100: [[0, 2, 2, 2, 3]],
}
"""Largest number of items -> the numbers of their files in each batch."""


@pytest.mark.parametrize(("size", "expected"), FILES_TOGETHER.items())
def test_files_that_fit_stay_whole_and_go_together(
    parts, landmarks, same, size, expected
):
    start = 0
    found = []
    with open_landmarks(parts) as source:
        for batch, file in source.batches_of_files(size):
            stop = start + len(batch)
            same(batch, landmarks.take(slice(start, stop)))
            found.append(file.tolist())
            start = stop
    assert found == expected


def test_images_of_several_files_are_chosen(parts, landmarks):
    rows = [0, 3, 4]
    with open_landmarks(parts) as source:
        batches = source.select(np.array(rows), 2)
        items = [item for batch in batches for item in batch.items]
    assert items == [landmarks.items[row] for row in rows]


@pytest.mark.parametrize("rows", [None, slice(1, None)])
def test_wrong_values_of_a_later_batch_are_named_by_their_row(
    tmp_path, landmarks, problems, rows
):
    path = tmp_path / "a.h5"
    landmarks.landmarks[3, 3, 0] = np.inf
    save(path, landmarks)
    with open_landmarks([path], rows=rows) as source:
        (line,) = problems(list, source.batches(2))
    assert line.startswith(f"{path}:/landmarks[3]: landmark 'foot' is (inf, ")


def test_some_landmarks_are_kept_in_their_order(tmp_path, landmarks):
    path = tmp_path / "a.h5"
    save(path, landmarks)
    last, *_, first = landmarks.landmark_names
    columns = [-1, 0]

    with open_landmarks([path], InputOptions(landmarks=(first, last))) as source:
        images = source.whole()

    assert images.landmark_names == (first, last)
    assert_array_equal(images.landmarks, landmarks.landmarks[:, columns])
    assert_array_equal(images.confidence, landmarks.confidence[:, columns])
    assert images.items == landmarks.items


WRONG_CHOICES = [
    (("foot", "nose"), "nose"),
    (("foot", "foot"), "landmarks: a name is there twice; name each landmark once"),
]


@pytest.mark.parametrize(("chosen", "fault"), WRONG_CHOICES)
def test_landmarks_to_keep_must_be_there_and_named_once(
    tmp_path, landmarks, problems, chosen, fault
):
    path = tmp_path / "a.h5"
    save(path, landmarks)
    (line,) = problems(open_landmarks, [path], InputOptions(landmarks=chosen))
    assert fault in line


def test_landmarks_of_low_confidence_are_hidden(tmp_path, landmarks):
    path = tmp_path / "a.h5"
    save(path, landmarks)
    with open_landmarks([path], InputOptions(min_confidence=0.5)) as source:
        images = source.whole()
    low = landmarks.confidence < 0.5
    expected = np.where(low, 0, landmarks.confidence)
    assert np.isnan(images.landmarks[low]).all()
    assert_array_equal(images.confidence, expected)


OTHER_NAMES = ("foot", "tail", "head", "right hand")


ALL_NAMES = ("head", "left hand", "right hand", "foot", "tail")


@pytest.fixture
def united(tmp_path, landmarks):
    """The images of a file without confidences and sequences, and of one of other
    landmarks.
    """
    bare = landmarks.take([0]).replaced(confidence=None, sequences=None)
    other = landmarks.take([1, 2]).replaced(landmark_names=OTHER_NAMES)
    save(tmp_path / "a.h5", bare)
    save(tmp_path / "b.h5", other)
    with open_landmarks([tmp_path / "a.h5", tmp_path / "b.h5"]) as source:
        assert source.head.landmark_names == ALL_NAMES
        return source.whole()


def test_landmarks_of_files_are_united(united, landmarks):
    first = united.landmarks[0]
    others = united.landmarks[1:]
    places = [ALL_NAMES.index(name) for name in OTHER_NAMES]
    assert_array_equal(first[:4], landmarks.landmarks[0])
    assert_array_equal(others[:, places], landmarks.landmarks[[1, 2]])


def test_landmarks_that_a_file_lacks_are_unseen(united):
    tail = united.landmarks[0, ALL_NAMES.index("tail")]
    left_hands = united.landmarks[1:, ALL_NAMES.index("left hand")]
    assert np.isnan(tail).all()
    assert np.isnan(left_hands).all()


def test_sequences_and_confidences_that_a_file_lacks(united, landmarks):
    places = [ALL_NAMES.index(name) for name in OTHER_NAMES]
    of_others = united.confidence[1:][:, places]
    assert united.sequences == ("", "a", "b")
    assert_array_equal(united.confidence[0], [1, 1, 1, 1, 0])
    assert_array_equal(of_others, landmarks.confidence[[1, 2]])


def test_what_each_camera_says_is_of_its_images(tmp_path):
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for number, path in enumerate(paths, 1):
        camera = {
            "camera_matrix": np.eye(3) * number,
            "image_size": np.array([640, 480]),
        }
        images = Landmarks(
            np.zeros((2, 3, 2)),
            landmark_names="abc",
            items=("i", "j"),
            file_extras=camera,
        )
        save(path, images)
    with open_landmarks(paths) as source:
        whole = source.whole()
    focal = whole.column("camera_matrix")[:, 0, 0]
    assert focal.tolist() == [1, 1, 2, 2]
    assert whole.column("image_size").tolist() == [640, 480]


@pytest.mark.parametrize(
    ("key", "value", "known"), [("y_axis", "up", "down"), ("unit", "m", "px")]
)
def test_landmarks_that_do_not_go_together(
    tmp_path, landmarks, problems, key, value, known
):
    one = tmp_path / "a.h5"
    two = tmp_path / "b.h5"
    save(one, landmarks.take([0]))
    save(two, landmarks.take([1]).replaced(**{key: value}))
    (line,) = problems(open_landmarks, [one, two])
    fault = f"its {key} is '{value}', that of {one} is '{known}'"
    assert line == f"{two}: {fault}; {SEPARATELY}"
