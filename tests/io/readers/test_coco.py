"""COCO's annotations and results: categories, whole bodies, videos and identities."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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
    """Return a file of annotations, of image 0 unless they say so."""
    annotations = []
    for number, entry in enumerate(entries):
        annotations.append({"id": number, "image_id": 0, "category_id": 1, **entry})
    return {
        "images": list(images) or [{"id": 0, "file_name": "a.png"}],
        "categories": categories,
        "annotations": annotations,
    }


def marks(count, first=1.0, v=2):
    """x, y, v of landmarks: x counts from `first`."""
    cells = []
    for number in range(count):
        cells += [first + number, 10.0 + first + number, v]
    return cells


def x_of_first_image(images):
    return images.landmarks[0, :, 0]


FISH = {"id": 1, "name": "fish", "keypoints": ["nose", "fin", "tail"]}


CRAB = {"id": 2, "name": "crab", "keypoints": []}


SHARK = {**FISH, "id": 2, "name": "shark"}


OWL = {"id": 2, "name": "owl", "keypoints": ["beak", "eye", "wing"]}


PERSON = {"id": 1, "name": "person", "keypoints": list(BODY)}


def test_annotations_of_a_category_that_names_nothing_are_left_out(read):
    fish = {"keypoints": marks(3)}
    crab = {"category_id": 2, "keypoints": marks(3, 50)}
    images, notes = read(annotated(fish, crab, categories=[FISH, CRAB]))
    note = "1 annotation of category crab left out, which names no"
    assert images.landmark_names == ("nose", "fin", "tail")
    assert x_of_first_image(images).tolist() == [1, 2, 3]
    assert any(note in line for line in notes)


OF_NO_CATEGORY = {"category_id": 9, "keypoints": marks(3)}


def test_an_unknown_category_has_the_landmarks_that_all_share(read):
    images, notes = read(annotated(OF_NO_CATEGORY, categories=[FISH, SHARK]))
    note = "category 9, which is not among the categories"
    assert images.landmark_names == ("nose", "fin", "tail")
    assert any(note in line for line in notes)


def test_an_unknown_category_among_different_ones_is_refused(read):
    content = annotated(OF_NO_CATEGORY, categories=[FISH, OWL])
    with pytest.raises(InputError, match="annotation 0 is of category 9, which is not"):
        read(content)


@pytest.mark.parametrize("lines", [[[1, 2], [2, 3]], [[0, 1], [1, 2]]])
def test_edges_count_from_1_or_from_0(read, lines):
    with_lines = {**FISH, "skeleton": lines}
    images, _ = read(annotated({"keypoints": marks(3)}, categories=[with_lines]))
    assert images.edges.tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize("absent", [None, *PARTS])
def test_feet_face_and_hands_of_a_whole_body(read, absent):
    """In the order of the skeleton; a list that is absent is missing."""
    entry = {"keypoints": marks(17)}
    first = 18
    for part, count in PARTS.items():
        if part != absent:
            entry[part] = marks(count, first, v=0.75)
        first += count
    images, notes = read(annotated(entry, categories=[PERSON]))
    x = x_of_first_image(images)
    seen = np.isfinite(x)
    confidence = images.confidence[0]
    assert images.landmark_names == WHOLE
    assert (~seen).sum() == PARTS.get(absent, 0)
    assert_array_equal(x[seen], np.flatnonzero(seen) + 1)
    assert confidence[0] == 1
    assert_allclose(confidence[17:][seen[17:]], 0.75)
    assert notes == ()


def test_points_may_stand_in_a_list_each(read):
    flat, _ = read(annotated({"keypoints": marks(3)}, categories=[FISH]))
    rows = np.reshape(marks(3), (3, 3)).tolist()
    nested, _ = read(annotated({"keypoints": rows}, categories=[FISH]))
    assert_array_equal(nested.landmarks, flat.landmarks)
    assert_array_equal(nested.confidence, flat.confidence)


@pytest.mark.parametrize("part", PARTS)
def test_a_part_of_another_number_of_points_is_refused(read, part):
    count = PARTS[part]
    entry = {"keypoints": marks(17), part: marks(count - 1)}
    fault = f"{part} of annotation 0 are not {count} landmarks"
    with pytest.raises(InputError, match=fault):
        read(annotated(entry, categories=[PERSON]))


def test_further_lists_of_points_are_named(read):
    feet = {"foot_kpts": marks(6)}
    further = {"face_kpts": [0] * 9, "keypoints_21": marks(21), "num_keypoints": 3}
    one = {"keypoints": marks(3), **feet, **further}
    other = {"keypoints": marks(3), **feet}
    _, notes = read(annotated(one, other, categories=[FISH]))
    assert [note.rpartition(": ")[2] for note in notes] == [
        "foot_kpts of 2 annotations left out",
        "keypoints_21 of 1 annotation left out",
    ]


@pytest.mark.parametrize("key", ["frame_id", "frame_index"])
@pytest.mark.parametrize("name", ["{}.jpg", "img-a{}b{}.jpg"])
def test_frames_that_images_state_are_theirs(read, key, name):
    entries = []
    images = []
    for number, frame in enumerate([14, 30, 12]):
        keypoints = marks(3, number)
        entries.append({"image_id": number, "track_id": 5, "keypoints": keypoints})
        file_name = name.format(number, number * number)
        image = {"id": number, "file_name": file_name, "video_id": 1, key: frame}
        images.append(image)
    landmarks, _ = read(annotated(*entries, categories=[FISH], images=images))
    assert landmarks.frames.tolist() == [0, 2, 18]
    assert landmarks.landmarks[:, 0, 0].tolist() == [2, 0, 1]


def test_133_landmarks_of_a_category_that_names_17_are_a_whole_body(read):
    images, _ = read(annotated({"keypoints": marks(133)}, categories=[PERSON]))
    assert images.landmark_names == WHOLE
    assert x_of_first_image(images).tolist() == [*range(1, 134)]


def test_fractions_instead_of_visibility_are_confidences(read):
    keypoints = [1, 2, 0.25, 3, 4, 1, 0, 0, 0]
    images, _ = read(annotated({"keypoints": keypoints}, categories=[FISH]))
    assert images.confidence[0].tolist() == [0.25, 1, 0]


def video_images(key):
    """Return images of two videos, which they name under a key or do not for None."""
    images = []
    for number, name in enumerate(("a_test", "b_test")):
        for frame in (0, 1, 2, 9):
            file_name = f"val/{name}/{frame:06d}.jpg"
            image = {"id": 100 * number + frame, "file_name": file_name}
            if key:
                image[key] = name[0]
            images.append(image)
    return images


@pytest.mark.parametrize(
    ("key", "names"),
    [
        ("vid_id", ("a", "b")),
        ("video_id", ("a", "b")),
        (None, ("a_test", "b_test")),
    ],
)
def test_every_video_is_a_sequence_of_its_own(read, key, names):
    """By its name, or by the folder of its numbered images."""
    images = video_images(key)
    entries = [
        {"image_id": image["id"], "track_id": 0, "keypoints": marks(3)}
        for image in reversed(images)
    ]
    landmarks, _ = read(annotated(*entries, categories=[FISH], images=images))
    assert {*landmarks.sequences} == {f"set/{name}/id 0" for name in names}
    assert landmarks.frames.tolist() == [0, 1, 2, 9] * 2


def test_identities_of_cvat_are_those_of_its_tracks(read):
    """Two people, one absent for a while and nearest to where the other was."""
    entries = []
    for frame in range(10):
        for who in (0, 1):
            attributes = {"occluded": False, "track_id": who, "keyframe": True}
            is_absent = who == 0 and frame in range(3, 7)
            keypoints = [] if is_absent else marks(3, 10.0 * who)
            entry = {"image_id": frame, "attributes": attributes}
            entries.append({**entry, "keypoints": keypoints})
    images = [{"id": n, "file_name": f"frame_{n:06d}.PNG"} for n in range(10)]
    landmarks, _ = read(annotated(*entries, categories=[FISH], images=images))
    assert {*landmarks.sequences} == {"set/id 0", "set/id 1"}
    assert landmarks.sequences.count("set/id 0") == 6


TRACKED = {"track_id": 3, "person_id": 8, "attributes": {"track_id": 9}}


@pytest.mark.parametrize(
    ("identity", "expected"),
    [
        (TRACKED, "set/id 3"),
        ({**TRACKED, "track_id": None}, "set/id 8"),
        ({"person_id": 8}, "set/id 8"),
        ({"attributes": {"track_id": 9}}, "set/id 9"),
        ({"track_id": 0, "person_id": 8}, "set/id 0"),
    ],
)
def test_the_track_is_the_identity_before_the_person(read, identity, expected):
    entries = []
    for frame in range(2):
        entry = {"image_id": frame, "keypoints": marks(3), **identity}
        entries.append(entry)
    images = [{"id": n, "file_name": f"frame_{n:06d}.png"} for n in range(2)]
    landmarks, _ = read(annotated(*entries, categories=[FISH], images=images))
    assert landmarks.sequences == (expected, expected)


def test_results_of_several_workers_are_in_order_of_frames(read):
    results = []
    for frame in (0, 2, 4, 1, 3, 5):
        results.append({"image_id": frame, "keypoints": [frame, 2, 0.5] * 17})
    images, _ = read(results)
    assert images.landmarks[:, 0, 0].tolist() == [0, 1, 2, 3, 4, 5]
    assert images.frames.tolist() == [0, 1, 2, 3, 4, 5]
