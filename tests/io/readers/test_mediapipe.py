"""Lists of landmarks as MediaPipe has them."""

import json

import pytest

from .made import read_images as read


def in_results(body):
    """As MediaPipe's results: beside landmarks in the image, others in the world."""
    in_world = [[{"x": 9, "y": 9}]]
    return {"pose_landmarks": [body], "pose_world_landmarks": in_world}


LISTS = {
    "landmarks": lambda body: body,
    "frames of landmarks": lambda body: [body],
    "results": in_results,
    "numbered frames": lambda body: [{"frame": 0, "landmarks": body}],
    "named frames": lambda body: {"frames": [{"landmark": body}]},
}


def landmarks_of(names, **fields):
    """Return landmarks in a row, with names where there are any, and further fields."""
    body = []
    for number, name in enumerate(names):
        landmark = {"x": 10 * number, "y": 7, "z": -1, **fields}
        body.append(landmark | ({"name": name} if name else {}))
    return body


@pytest.mark.parametrize("wrap", LISTS.values(), ids=LISTS)
def test_lists_of_mediapipe(table, wrap):
    body = landmarks_of("abc", visibility=0.5)
    images, _ = read(table(json.dumps(wrap(body)), "walk.json"))
    assert images.landmarks.tolist() == [[[0, 7], [10, 7], [20, 7]]]
    assert images.landmark_names == ("a", "b", "c")


SCORES = [
    ({"presence": 0.9, "visibility": 0.2}, 0.2),
    ({"presence": 0.9}, 0.9),
    ({}, 1.0),
]


@pytest.mark.parametrize(("fields", "score"), SCORES)
def test_the_confidence_of_mediapipe(table, fields, score):
    """How visible a point is goes before whether it is in the image; without either it
    is 1.
    """
    body = landmarks_of([None] * 3, **fields)
    images, _ = read(table(json.dumps([body]), "walk.json"))
    assert images.confidence.tolist() == [[score] * 3]
