"""COCO annotations and results, the latter as AlphaPose writes them, too."""

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.foreign.people import read_coco_annotations

from .conftest import read_images as read

MOUSE = {"id": 1, "name": "mouse", "keypoints": ["nose", "tail"], "skeleton": [[1, 2]]}
FLY = {"id": 5, "name": "fly", "keypoints": ["head", "nose"]}


def annotations(*entries, categories=(MOUSE, FLY), images=2):
    return {
        "images": [{"id": n, "file_name": f"day/{n}.png"} for n in range(images)],
        "categories": list(categories),
        "annotations": [{"id": n, **entry} for n, entry in enumerate(entries)],
    }


def entry(image, category, *keypoints, **further):
    return {"image_id": image, "category_id": category, "keypoints": list(keypoints), **further}


def test_visibility_decides_and_categories_are_joined(written):
    path = written(
        "a.json",
        annotations(entry(1, 5, 1, 2, 2, 3, 4, 1), entry(0, 1, 5, 6, 0, 7, 8, 2)),
    )
    images, _ = read(path)
    assert images.landmark_names == ("nose", "tail", "head")
    assert images.items == ("a/0/0", "a/1/0")
    nan = np.nan
    expected = [[[nan, 7, nan], [nan, 8, nan]], [[3, nan, 1], [4, nan, 2]]]
    np.testing.assert_array_equal(images.landmarks, expected)
    assert images.confidence is None


def test_edges_count_from_1_within_their_category(written):
    path = written("a.json", annotations(entry(0, 1, 1, 2, 2, 3, 4, 2), categories=(FLY, MOUSE)))
    recording = read_coco_annotations((path,))
    assert recording.landmark_names == ("head", "nose", "tail")
    assert recording.edges == ((1, 2),)
    assert recording.frame_count == 2


def test_what_annotations_lack_is_counted(written):
    path = written(
        "a.json",
        annotations({"image_id": 0, "bbox": []}, entry(9, 1, 1, 2, 2, 3, 4, 2)),
    )
    images, notes = read(path)
    assert images.items == ("a/9/0",)
    assert [note.partition(": ")[2] for note in notes] == [
        "1 annotation without keypoints left out",
        "1 image of annotations not listed among the images",
    ]


@pytest.mark.parametrize(
    "identity",
    [{"track_id": 3}, {"attributes": {"track_id": 3}}, {"attributes": {"object_id": 3}}],
)
def test_track_ids_are_identities(written, identity):
    path = written(
        "a.json",
        annotations(*(entry(n, 1, 1, 2, 2, 3, 4, 2, **identity) for n in range(2))),
    )
    assert set(read(path)[0].sequences) == {"a/id 3"}


def result(image, *keypoints, **further):
    return {"image_id": image, "category_id": 1, "keypoints": list(keypoints), **further}


def test_results_without_names_are_coco_17(written):
    path = written("r.json", [result(7, *[1, 2, 0.5] * 17), result(3, *[0, 0, 0] * 17)])
    images, (note,) = read(path)
    assert images.items == ("r/7/0",)
    assert images.landmark_names[16] == "right_ankle"
    assert "1 individuals without a landmark" in note


@pytest.mark.parametrize(("largest", "divisor"), [(0.9, 1), (1.2, 1), (5.4, 6)])
def test_the_scale_of_alphapose(written, largest, divisor):
    entries = [result(f"{n}.jpg", *[1, 2, largest] * 17, idx=[0.0]) for n in range(3)]
    images, notes = read(written("alphapose-results.json", entries))
    assert images.items[2] == "alphapose-results/id 0/2"
    np.testing.assert_allclose(images.confidence, largest / divisor)
    assert len(notes) == (divisor != 1)


@pytest.mark.parametrize(
    ("names", "motion"),
    [
        (["frame_000.jpg", "frame_001.jpg", "frame_007.jpg"], True),
        (["000000000785.jpg", "000000040083.jpg", "000000397133.jpg"], False),
        (["beach.jpg", "dog.jpg", "street.jpg"], False),
    ],
)
def test_images_of_different_files_are_no_motion(written, names, motion):
    content = {
        "images": [{"id": n, "file_name": name} for n, name in enumerate(names)],
        "annotations": [{"image_id": n, "keypoints": [1.0, 2.0, 2] * 17} for n in range(3)],
        "categories": [],
    }
    path = written("all.json", content)
    if motion:
        assert len(set(read(path, track="motion")[0].sequences)) == 1
    else:
        with pytest.raises(InputError, match=r"without numbers of frames: no motion; set `track"):
            read(path, track="motion")
    assert len(set(read(path, track="nearest")[0].sequences)) == 1
