"""COCO's annotations and results: categories, whole bodies, videos and identities."""

import json

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.skeletons import installed_skeletons

from .made import read_images

BODY = installed_skeletons()["coco_17"].landmark_names
WHOLE = installed_skeletons()["coco_133"].landmark_names
PARTS = {"foot_kpts": 6, "face_kpts": 68, "lefthand_kpts": 21, "righthand_kpts": 21}


@pytest.fixture
def read(tmp_path):
    """Read JSON that is written under a name; the images, and the notes."""

    def read(content, **options):
        path = tmp_path / "set.json"
        path.write_text(json.dumps(content), encoding="utf-8")
        return read_images(path, **options)

    return read


def annotated(*entries, categories, images=()):
    entries = [{"id": n, "image_id": 0, **entry} for n, entry in enumerate(entries)]
    return {
        "images": list(images) or [{"id": 0, "file_name": "a.png"}],
        "categories": categories,
        "annotations": entries,
    }


def marks(count, first=1.0, v=2):
    """x, y, v of landmarks: x counts from `first`."""
    return [number for n in range(count) for number in (first + n, 10.0 + first + n, v)]


FISH = {"id": 1, "name": "fish", "keypoints": ["nose", "fin", "tail"]}


def test_annotations_of_a_category_that_names_nothing_are_left_out(read):
    images, notes = read(
        annotated(
            {"category_id": 1, "keypoints": marks(3)},
            {"category_id": 2, "keypoints": marks(3, 50)},
            categories=[FISH, {"id": 2, "name": "crab", "keypoints": []}],
        )
    )
    assert images.landmark_names == ("nose", "fin", "tail")
    assert images.as_columns()[0, 0].tolist() == [1, 2, 3]
    assert any(
        "1 annotation of category crab left out, which names no" in n for n in notes
    )


def test_an_unknown_category_has_the_landmarks_that_all_share(read):
    shared = [FISH, {**FISH, "id": 2, "name": "shark"}]
    images, notes = read(
        annotated({"category_id": 9, "keypoints": marks(3)}, categories=shared)
    )
    assert images.landmark_names == ("nose", "fin", "tail")
    assert any(
        "category 9, which is not among the categories" in note for note in notes
    )
    other = [FISH, {"id": 2, "name": "owl", "keypoints": ["beak", "eye", "wing"]}]
    with pytest.raises(InputError, match="annotation 0 is of category 9, which is not"):
        read(annotated({"category_id": 9, "keypoints": marks(3)}, categories=other))


@pytest.mark.parametrize("lines", [[[1, 2], [2, 3]], [[0, 1], [1, 2]]])
def test_edges_count_from_1_or_from_0(read, lines):
    content = annotated(
        {"category_id": 1, "keypoints": marks(3)},
        categories=[{**FISH, "skeleton": lines}],
    )
    assert read(content)[0].column("edges").tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize("absent", [None, *PARTS])
def test_feet_face_and_hands_of_a_whole_body(read, absent):
    """In the order of the skeleton; a list that is absent is missing."""
    entry = {"category_id": 1, "keypoints": marks(17)}
    first = 18
    for part, count in PARTS.items():
        entry[part] = marks(count, first, v=0.75)
        first += count
    lost = entry.pop(absent, None)
    content = annotated(entry, categories=[{"id": 1, "name": "p", "keypoints": BODY}])
    images, notes = read(content)
    assert images.landmark_names == WHOLE
    seen = np.isfinite(images.as_columns()[0, 0])
    assert (~seen).sum() == (len(lost) // 3 if lost else 0)
    assert (
        images.as_columns()[0, 0][seen].tolist() == (np.flatnonzero(seen) + 1).tolist()
    )
    assert images.confidence[0, 0] == 1
    np.testing.assert_allclose(images.confidence[0, 17:][seen[17:]], 0.75)
    assert notes == ()


def test_further_lists_of_points_are_named(read):
    feet = {"foot_kpts": marks(6), "face_kpts": [0] * 9, "keypoints_21": marks(21)}
    content = annotated(
        {"category_id": 1, "keypoints": marks(3), "num_keypoints": 3, **feet},
        {"category_id": 1, "keypoints": marks(3), "foot_kpts": marks(6)},
        categories=[FISH],
    )
    _, notes = read(content)
    said = [note.rpartition(": ")[2] for note in notes]
    assert said == [
        "foot_kpts of 2 annotations left out",
        "keypoints_21 of 1 annotation left out",
    ]


@pytest.mark.parametrize("key", ["frame_id", "frame_index"])
@pytest.mark.parametrize("file", ["{}.jpg", "img-a{}b{}.jpg"])
def test_frames_that_images_state_are_theirs(read, key, file):
    stated = [14, 30, 12]
    content = annotated(
        *(
            {"image_id": n, "track_id": 5, "category_id": 1, "keypoints": marks(3, n)}
            for n in range(3)
        ),
        categories=[FISH],
        images=[
            {"id": n, "file_name": file.format(n, n * n), "video_id": 1, key: frame}
            for n, frame in enumerate(stated)
        ],
    )
    images, _ = read(content)
    assert images.frames.tolist() == [0, 2, 18]
    assert images.landmarks[:, 0, 0].tolist() == [2, 0, 1]


def test_133_landmarks_of_a_category_that_names_17_are_a_whole_body(read):
    images, _ = read(
        annotated(
            {"category_id": 1, "keypoints": marks(133)},
            categories=[{"id": 1, "name": "person", "keypoints": list(BODY)}],
        )
    )
    assert images.landmark_names == WHOLE
    assert images.as_columns()[0, 0].tolist() == [*range(1, 134)]


def test_fractions_instead_of_visibility_are_confidences(read):
    images, _ = read(
        annotated(
            {"category_id": 1, "keypoints": [1, 2, 0.25, 3, 4, 1, 0, 0, 0]},
            categories=[FISH],
        )
    )
    assert images.confidence[0].tolist() == [0.25, 1, 0]


def video_images(key):
    names = ("a_test", "b_test")
    return [
        {"id": 100 * n + f, "file_name": f"val/{name}/{f:06d}.jpg", **stated}
        for n, name in enumerate(names)
        for f in (0, 1, 2, 9)
        for stated in [{key: name[0]} if key else {}]
    ]


@pytest.mark.parametrize("key", ["vid_id", "video_id", None])
def test_every_video_is_a_sequence_of_its_own(read, key):
    """By its name, or by the folder of its numbered images."""
    images = video_images(key)
    entries = [
        {"image_id": image["id"], "track_id": 0, "keypoints": marks(3)}
        for image in reversed(images)
    ]
    entries = [{"category_id": 1, **entry} for entry in entries]
    found, _ = read(annotated(*entries, categories=[FISH], images=images))
    ends = ("a", "b") if key else ("a_test", "b_test")
    assert {*found.sequences} == {f"set/{end}/id 0" for end in ends}
    assert found.column("frame").tolist() == [0, 1, 2, 9] * 2


def test_identities_of_cvat_are_those_of_its_tracks(read):
    """Two people, one absent for a while and nearest to where the other was."""
    entries = [
        {
            "image_id": frame,
            "category_id": 1,
            "attributes": {"occluded": False, "track_id": who, "keyframe": True},
            "keypoints": marks(3, 10.0 * who)
            if who or frame not in range(3, 7)
            else [],
        }
        for frame in range(10)
        for who in (0, 1)
    ]
    images = [{"id": n, "file_name": f"frame_{n:06d}.PNG"} for n in range(10)]
    found, _ = read(annotated(*entries, categories=[FISH], images=images))
    assert {*found.sequences} == {"set/id 0", "set/id 1"}
    assert found.sequences.count("set/id 0") == 6


def test_results_of_several_workers_are_in_order_of_frames(read):
    entries = [
        {"image_id": frame, "keypoints": [frame, 2, 0.5] * 17}
        for frame in (0, 2, 4, 1, 3, 5)
    ]
    images, _ = read(entries)
    assert images.as_columns()[:, 0, 0].tolist() == [0, 1, 2, 3, 4, 5]
    assert images.column("frame").tolist() == [0, 1, 2, 3, 4, 5]
