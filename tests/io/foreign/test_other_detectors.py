"""MMPose, caliscope and Ultralytics files."""

import numpy as np
import pytest

from .conftest import read_images as read


def instance(points=17, score=0.5, **further):
    return {"keypoints": [[1.0, 2.0]] * points, "keypoint_scores": [score] * points, **further}


def test_mmpose_video(written):
    frames = [{"frame_id": n, "instances": [instance(), instance()][:n]} for n in range(3)]
    images, _ = read(written("v.json", frames))
    assert images.items == ("v/1/0", "v/2/0", "v/2/1")
    assert images.landmark_names[5] == "left_shoulder"
    assert (images.confidence == 0.5).all()
    assert images.columns["frame"].tolist() == [1, 2, 2]


def test_mmpose_with_names(written):
    meta = {"keypoint_id2name": {"0": "a", "1": "b"}, "skeleton_links": [[0, 1]]}
    several = [{"frame_id": 4, "instances": [instance(2, track_id=3)]}]
    for info, item in ((several, "v/id 3/4"), ([instance(2)], "v/0/0")):
        images, _ = read(written("v.json", {"meta_info": meta, "instance_info": info}))
        assert images.items == (item,)
        assert images.landmark_names == ("a", "b")


def test_mmpose_images(written, tmp_path):
    paths = [written(f"set/{n}.json", [instance()] * n) for n in range(3)]
    images, _ = read(tmp_path / "set")
    assert images.items == ("set/1/0", "set/2/0", "set/2/1")
    assert read(*paths)[0].items == images.items


HEADER = "sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y\n"


def test_caliscope(written):
    rows = ["0,1,5,0.1,0,10,20", "0,1,5,0.1,100,30,40", "0,2,5,0.1,32,50,60", "1,1,7,0.2,0,,"]
    images, _ = read(written("xy.csv", HEADER + "\n".join(rows) + "\n"))
    assert images.items == ("xy/port 1/5", "xy/port 2/5")
    assert images.landmark_names == ("nose", "right_foot_index", "100")
    nan = np.nan
    np.testing.assert_array_equal(
        images.landmarks, [[[10, nan, 30], [20, nan, 40]], [[nan, 50, nan], [nan, 60, nan]]]
    )


def test_yolo_labels_with_what_data_yaml_says(written, tmp_path):
    written("data.yaml", "names: {0: rat}\nkpt_shape: [2, 3]\nkpt_names: {0: [nose, tail]}\n")
    written("labels/rat_3.txt", "# comment\n0 .5 .5 .1 .1 .25 .5 2 .9 .9 0\n\n")
    written("labels/rat_4.txt", "")
    images, notes = read(tmp_path / "labels")
    assert images.items == ("labels/3/0",)
    assert images.landmark_names == ("nose", "tail")
    assert np.isnan(images.landmarks[0, :, 1]).all()
    assert images.confidence is None
    assert images.unit == "fraction of the image"
    assert "squeezed" in notes[0]


def test_yolo_without_visibility_and_with_tracks(written, tmp_path):
    written("data.yaml", "kpt_shape: [4, 2]\n")
    written("labels/a.txt", "0 .5 .5 .1 .1 .25 .5 0 0 0 .5 .25 0 .8 7\n")
    images, _ = read(tmp_path / "labels")
    assert images.items == ("labels/id 7/a",)
    assert np.isnan(images.landmarks[0, 0]).tolist() == [False, True, False, False]


@pytest.mark.parametrize("place", ["nan .5", ".25 nan", "nan nan"])
def test_a_yolo_landmark_without_a_coordinate_is_missing(written, tmp_path, place):
    written("data.yaml", "kpt_shape: [4, 2]\n")
    written("labels/a.txt", f"0 .5 .5 .1 .1 .25 .5 {place} .5 .25 .3 .8\n")
    images, _ = read(tmp_path / "labels")
    assert np.isnan(images.landmarks[0]).tolist() == [[False, True, False, False]] * 2


def test_yolo_predictions_of_people_without_data_yaml(written, tmp_path):
    line = "0 .5 .5 .1 .1" + " .25 .5 .75" * 16 + " .25 .5 1\n"
    written("labels/v_1.txt", line * 2)
    images, _ = read(tmp_path / "labels")
    assert images.landmark_names[0] == "nose"
    assert (images.confidence == [0.75] * 16 + [1]).all()


def test_so_many_landmarks_that_no_other_key_is_seen(written, tmp_path, rng):
    """133 landmarks are more than the beginning of a file that recognisers look at."""
    points = rng.uniform(1, 900, (133, 3))
    points[:, 2] /= 1000
    pairs = {"keypoints": points[:, :2].tolist(), "keypoint_scores": points[:, 2].tolist()}
    flat = {"keypoints": points.ravel().tolist(), "image_id": 7, "category_id": 1, "score": 1}
    for path, item in (
        (written("images/cat.json", [pairs]), "images/cat/0"),
        (tmp_path / "images", "images/cat/0"),
        (written("results.json", [flat]), "results/7/0"),
    ):
        found, _ = read(path)
        assert list(found.items) == [item]
        np.testing.assert_array_equal(found.landmarks[0].T, points[:, :2])
        np.testing.assert_array_equal(found.weights()[0], points[:, 2])
