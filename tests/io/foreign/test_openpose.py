"""Folders of frames: people in any order, numbers in names, what may be wrong; and AlphaPose."""

import os

import numpy as np
import pytest

from shapefit.errors import InputError

from .conftest import read_images as read


def person(points: int, x: float = 10.0, **further):
    return {"pose_keypoints_2d": [x, 20.0, 0.5] * points, **further}


def frame(*people, **further):
    return {"version": 1.3, "people": list(people), **further}


def names(images):
    return list(images.items)


def test_a_folder_its_files_and_any_order_are_one_recording(written, tmp_path):
    paths = [written(f"cam/c_{n:012d}_keypoints.json", frame(person(17))) for n in (9, 10, 2)]
    images, notes = read(tmp_path / "cam")
    assert names(images) == ["cam/2/0", "cam/9/0", "cam/10/0"]
    assert images.columns["frame"].tolist() == [0, 7, 8]
    assert (names(read(*paths)[0]), notes) == (names(images), ())
    assert names(read(paths[0])[0]) == ["cam/9/0"]
    assert images.landmark_names[0] == "nose"
    assert images.y_axis == "down"
    assert images.unit == "px"


def test_zeros_are_missing_and_an_empty_list_still_counts(written, tmp_path):
    one = person(17)
    one["pose_keypoints_2d"][:3] = [0, 0, 0]
    written("cam/0.json", frame({"pose_keypoints_2d": []}, one))
    written("cam/1.json", frame())
    written("cam/2.json", {"version": 1.3})
    images, (note,) = read(tmp_path / "cam")
    assert names(images) == ["cam/0/1"]
    assert np.isnan(images.landmarks[0, :, 0]).all()
    assert images.weights()[0].tolist() == [0] + 16 * [0.5]
    assert "1 individuals without a landmark" in note


def test_nobody_anywhere_is_told(written, tmp_path):
    for n in range(3):
        written(f"cam/{n}.json", frame())
    images, notes = read(tmp_path / "cam", keypoints="body_25b")
    assert len(images) == 0
    assert notes == (f"{tmp_path / 'cam'}: nobody was found in 3 frames",)


def test_twenty_five_points_need_a_name(written, tmp_path):
    written("cam/0.json", frame(person(25)))
    with pytest.raises(InputError, match=r"body_25 and body_25b have.*keypoints=body_25`"):
        read(tmp_path / "cam")
    images, _ = read(tmp_path / "cam", keypoints="body_25")
    assert images.landmark_names[8] == "MidHip"


def test_two_skeletons_in_a_folder_are_refused_with_counts(written, tmp_path):
    written("cam/0.json", frame(person(17), person(17)))
    written("cam/1.json", frame(person(25)))
    with pytest.raises(InputError, match="2 detections with 17 and 1 detections with 25"):
        read(tmp_path / "cam")


def test_person_id_is_an_identity_where_it_is_unique(written, tmp_path):
    written("cam/0.json", frame(person(17, person_id=[4]), person(17, person_id=[7])))
    written("cam/1.json", frame(person(17, person_id=[7]), person(17, person_id=[-1])))
    assert set(names(read(tmp_path / "cam")[0])) == {
        "cam/id 4/0", "cam/id 7/0", "cam/id 7/1", "cam/untracked/1/0",
    }  # fmt: skip
    written("cam/2.json", frame(person(17, person_id=[7]), person(17, person_id=[7])))
    images, (note,) = read(tmp_path / "cam")
    assert "cam/0/1" in names(images)
    assert "numbers of people are not used, as 1 of them occur twice" in note


def test_two_cameras_in_a_folder_are_two_videos(written, tmp_path):
    for camera in "ab":
        for n in range(2):
            written(f"rig/cam_{camera}_{n}_keypoints.json", frame(person(17)))
    images, _ = read(tmp_path / "rig", track="nearest")
    assert sorted(set(images.sequences)) == ["cam_a/person 1", "cam_b/person 2"]


def test_frame_numbers_that_repeat_are_refused(written, tmp_path):
    written("cam/c_1.json", frame(person(17)))
    written("cam/c_01.json", frame(person(17)))
    with pytest.raises(InputError, match=r"cam: two files of frame 1, c_01.json and c_1.json"):
        read(tmp_path / "cam")


def test_hands_faces_and_strange_files_are_counted(written, tmp_path):
    written("cam/0.json", frame(person(17, face_keypoints_2d=[1, 2, 3])))
    written("cam/meta.json", {"camera": 1})
    _, notes = read(tmp_path / "cam")
    assert [note.partition(": ")[2] for note in notes] == [
        "1 file without people left out (meta.json)",
        "hands and faces left out, of 1 detection",
    ]


def test_a_video_or_an_empty_folder_is_told(tmp_path):
    path = tmp_path / "walk.mp4"
    path.write_bytes(b"\0\0\0\x20ftypisom" + bytes(100))
    with pytest.raises(InputError, match=r"walk.mp4: is a video.*file of landmarks"):
        read(path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"it is a folder, and holds none of these: .*OpenPose"):
        read(tmp_path / "empty")


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to(path)])
@pytest.mark.parametrize("ending", [".json", ".txt"])
def test_only_regular_files_of_a_folder_are_opened(written, tmp_path, make, ending):
    written("cam/0.json", frame(person(17)))
    if ending == ".txt":
        (tmp_path / "cam/0.json").unlink()
        (tmp_path / "cam/0.txt").write_text("0 .5 .5 .5 .5" + " .5 .5 1" * 17)
    make(tmp_path / "cam" / f"1{ending}")
    with pytest.raises(InputError, match=r"cam/1\.(json|txt): (is not a regular|leads to no) file"):
        read(tmp_path / "cam")


VERSION = "AlphaPose v0.3"


@pytest.mark.parametrize(
    ("people", "keypoints"), [("people", "pose_keypoints_2d"), ("bodies", "joints")]
)
def test_both_layouts(written, rng, people, keypoints):
    numbers = rng.uniform(0.1, 1, (3, 18, 3))
    numbers[2, 4] = 0
    images = {
        "7.jpg": {
            "version": VERSION,
            people: [{keypoints: numbers[k].ravel().tolist()} for k in (0, 1)],
        },
        "9.jpg": {"version": VERSION, people: []},
        "10.jpg": {"version": VERSION, people: [{keypoints: numbers[2].ravel().tolist()}]},
    }
    found, notes = read(written("walk.json", images))
    assert list(found.items) == ["walk/7/0", "walk/7/1", "walk/10/0"]
    assert notes == ()
    numbers[2, 4] = np.nan
    np.testing.assert_array_equal(found.landmarks, numbers[..., :2].transpose(0, 2, 1))
    np.testing.assert_array_equal(found.weights(), np.nan_to_num(numbers[..., 2]))


def test_confidences_of_models_of_coco(written):
    person = {"pose_keypoints_2d": [1.0, 2.0, 4.5] * 18}
    found, notes = read(written("walk.json", {"0.jpg": {"version": VERSION, "people": [person]}}))
    np.testing.assert_allclose(found.weights(), 0.75)
    assert "confidences divided by 6" in notes[0]
