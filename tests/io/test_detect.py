"""The format of a file by its content; files that are no recordings are named for what
they are.
"""

import gzip
import json
import pickle

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.errors import InputError
from shapefit.io import inputs, open_landmarks
from shapefit.io.detect import FORMATS, detect_format
from shapefit.io.options import InputOptions
from shapefit.io.source import find_kind

LONG = np.arange(3 * 2000.0).tolist()
PAIRS = np.arange(2 * 2000.0).reshape(-1, 2).tolist()
POINT = {"x": 0.5, "y": 0.25, "z": 0.0}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("openpose", {"people": [{"pose_keypoints_2d": LONG}], "version": 1.3}),
        ("openpose", {"version": 1.3}),
        ("openpose", {"people": []}),
        ("mmpose-images", [{"keypoints": PAIRS, "scores": LONG, "labels": []}]),
        ("mmpose-images", [{"keypoints": {"x": [1.0], "y": [2.0], "visible": [1.0]}}]),
        ("mediapipe", [{"keypoints": [{"y": 1, "x": 2, "score": 1, "name": "nose"}]}]),
        ("mediapipe", [[{"keypoints": [{"y": 1, "x": 2}], "score": 0.5}]]),
        ("mediapipe", {"poseLandmarks": [POINT]}),
        (
            "coco-annotations",
            {"info": {"version": "1.0"}, "annotations": [], "images": []},
        ),
        ("coco-results", [{"keypoints": LONG, "image_id": 1}]),
        ("mmpose-images", [{"keypoints": PAIRS, "keypoint_scores": LONG}]),
        ("mmpose-images", []),
        ("mmpose-video", [{"frame_id": 0, "instances": []}]),
        ("mmpose-video", {"instance_info": [], "meta_info": {}}),
        ("mediapipe", {"frames": [{"landmarks": [[POINT]]}]}),
        ("mediapipe", {"0": [{"name": "nose", **POINT}], "12": []}),
        ("arrays", [[[1, 2], [3, 4]]]),
        ("arrays", [[None, 2], [3, 4]]),
    ],
)
def test_json_by_its_keys(tmp_path, name, content):
    path = tmp_path / "0.json"
    path.write_text(json.dumps(content))
    assert detect_format(path) is FORMATS[name]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"people": [', ":1: is not whole JSON"),
        (
            '{"entries": [{"a": {"at": 0, "x": 1, "y": 2}}]}',
            "of no known kind, with entries",
        ),
        (
            '[{"shapes": [], "imagePath": ""}]',
            "imagePath, shapes: a file of LabelMe, which",
        ),
        (
            '{"version": "5.4", "flags": {}, "shapes": [{}], "imagePath": "a.jpg"}',
            "with flags, imagePath, shapes, version: a file of LabelMe, which is not",
        ),
        (
            '[{"id": 1, "annotations": [{"result": [{"value": {"x": 1, "y": 2},'
            ' "from_name": "kp", "to_name": "img"}]}], "data": {}}]',
            "with annotations, data, id: a file of Label Studio, which is not read; ex",
        ),
        (
            '{"version": 0.7, "univTime": 1.5, "bodies": [{"joints19": [1, 2, 3, 1]}]}',
            "with bodies, univTime, version: a file of CMU Panoptic, which is not",
        ),
        (
            '{"version": "2.0.0", "skeletons": [], "nodes": [], "labels": []}',
            "labels, nodes, skeletons, version: a file of SLEAP, which is not read; sa",
        ),
        (
            '{"version": "AlphaPose v0.3", "bodies": [{"joints": [1, 2, 0.5]}]}',
            "a file of AlphaPose for CMU, which is not read; write it with --format",
        ),
        (
            '{"version": "1.2", "settings": {"a": 1}}',
            "of no known kind, with settings, version; give JSON of OpenPose",
        ),
        (
            '[{"keypoints": "none", "file": "a.jpg"}]',
            "with file, keypoints (a file of COCO results has image_id and keypoints",
        ),
        ('{"people": [{"name": "Ann"}]}', "with people (a set of OpenPose files has"),
    ],
)
def test_json_that_is_not_of_a_detector(tmp_path, text, found):
    path = tmp_path / "0.json"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        detect_format(path)
    assert found in str(error.value)


@pytest.mark.parametrize(
    ("further", "name"),
    [
        ("", "csv"),
        (",confidence,sequence", "csv"),
        (",person_id", "table"),
        (",id", "table"),
    ],
)
def test_a_table_with_a_column_of_individuals_is_none_of_ours(tmp_path, further, name):
    path = tmp_path / "landmarks.csv"
    path.write_text(f"item,landmark,x,y{further}\n")
    assert detect_format(path) is FORMATS[name]


# What is no recording

TEXT = b"scorer,a,a,a\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n0,1,2,0.5\n"


def refusal(path) -> str:
    with pytest.raises(InputError) as error, open_landmarks([path]):
        pass
    text = str(error.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", ["walk.json", "walk.csv", "walk.csv.gz", "walk"])
@pytest.mark.parametrize(
    "content",
    [gzip.compress(b"\0" + TEXT), pickle.dumps({"weight": 1}, 2), b"CDF\2" + bytes(60)],
    ids=[
        "gzip of no text",
        "pickle",
        "netcdf 3",
    ],  # contents hold the time, and make no stable names
)
def test_files_that_are_not_text(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert "neither text nor of a known format; give the landmarks that a" in refusal(
        path
    )


TIDY = b"item,landmark,x,y\ni,a,250,5\ni,b,75,125\n"
WIDE = b"frame,track_id,nose_x,nose_y,hip_x,hip_y\n0,1,10,20,30,50\n0,2,11,21,31,51\n"
ARRAY = b"[[[1,2],[3,4]]]"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("t.csv", TIDY),
        ("w.csv", WIDE),
        ("d.csv", TEXT),
        ("a.json", ARRAY),
        ("bare", TIDY),
    ],
)
def test_text_that_gzip_made_smaller(tmp_path, monkeypatch, name, content):
    (tmp_path / name).write_bytes(content)
    packed = tmp_path / f"{name}.gz"
    packed.write_bytes(gzip.compress(content))
    options = InputOptions(keypoints="numbered")
    plain, found = (whole(path, options) for path in (tmp_path / name, packed))
    assert_array_equal(found.landmarks, plain.landmarks)
    assert found.items == plain.items
    assert found.sequences == plain.sequences
    assert detect_format(packed) is detect_format(tmp_path / name)
    packed.write_bytes(gzip.compress(content)[:-8])  # cut off
    assert "cannot be unpacked" in refusal(packed)
    packed.write_bytes(gzip.compress(content + b" " * 5_000_000))
    assert packed.stat().st_size < 10_000
    monkeypatch.setattr(inputs, "MAX_READ_BYTES", 1_000_000)
    if content != TIDY:  # which is read block by block
        assert "more than 1 MB of text, and it is read whole" in refusal(packed)


def whole(path, options):
    with open_landmarks([path], options) as source:
        return source.whole()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (
            "calibration.toml",
            '[cam_0]\nname = "A"\nmatrix = [[1.0, 0.0], [0.0, 1.0]]\n',
        ),
        (
            "calibration.yaml",
            "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n",
        ),
        ("calibration.json", '{"cam_0": {"matrix": [[1, 0], [0, 1]], "size": [3, 4]}}'),
        ("cameras", "[cam_0]\nmatrix = [[1.0]]\n"),
        ("cameras", "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n"),
        ("cameras", '{"cam_0": {"matrix": [[1, 0], [0, 1]], "size": [3, 4]}}'),
    ],
)
def test_a_calibration_is_no_file_of_landmarks(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content)
    assert "is a calibration of cameras, not landmarks; give it as --cal" in refusal(
        path
    )


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("scorer;a;a;a", "cannot be read as a DeepLabCut"),
        (
            "track,frame_idx,instance.score,nose.x,nose.y,nose.score",
            "the header is 'track,frame_",
        ),
    ],
)
def test_tables_of_another_kind(tmp_path, line, found):
    path = tmp_path / "walk.csv"
    path.write_text(f"{line}\n")
    assert found in refusal(path)


def test_hdf5_of_another_kind_says_what_was_looked_for(tmp_path):
    path = tmp_path / "poses.h5"
    with h5py.File(path, "w") as file:
        file["data"] = np.zeros((3, 3, 4))
    text = refusal(path)
    for name in (
        "shapefit-landmarks",
        "DeepLabCut",
        "SLEAP",
        "JABS",
        "NWB",
        "movement",
    ):
        assert name in text


def test_a_folder_in_a_format_of_files_is_refused(tmp_path):
    for name in [name for name, form in FORMATS.items() if not form.together]:
        with pytest.raises(
            InputError, match=r"it is a folder, and .* is a file; name the files"
        ):
            find_kind(tmp_path, InputOptions(format=name))


# Folders

LABEL = "0 .5 .5 .1 .1" + " .25 .5 2" * 17 + "\n"


@pytest.mark.parametrize("empty", [0, 24, 300])
def test_labels_of_a_person_who_comes_late(tmp_path, empty):
    """As a folder, and as the files that a shell names: images without anybody have
    empty files.
    """
    folder = tmp_path / "labels"
    folder.mkdir()
    for number in range(empty + 3):
        text = LABEL if number >= empty else ""
        (folder / f"clip_{number:06d}.txt").write_text(text)
    for paths in ([folder], sorted(folder.iterdir())):
        with open_landmarks(paths) as source:
            frames = source.whole().column("frame").tolist()
        assert frames == [empty, empty + 1, empty + 2]


def test_an_empty_text_beside_other_files_is_empty(tmp_path):
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "other.txt").write_text("words\n")
    with pytest.raises(InputError, match=r"notes\.txt: is empty \(0 bytes\)"):
        detect_format(tmp_path / "notes.txt")


def test_files_of_images_without_people_are_of_their_recording(tmp_path):
    """Hugging Face, Ultralytics and MMPose write an empty list."""
    person = {"keypoints": [[1.0, 2.0]] * 17, "scores": [0.25] * 17}
    for number, people in enumerate(([], [person], [], [person])):
        (tmp_path / f"{number}.json").write_text(json.dumps(people))
    paths = sorted(tmp_path.iterdir())
    for given in ([tmp_path], paths):
        with open_landmarks(given) as source:
            images = source.whole()
        assert images.column("frame").tolist() == [1, 3]
        assert (images.confidence == 0.25).all()


# What readers check, and what they do not


def test_what_a_reader_does_not_check_is_an_error_of_its_own(tmp_path, monkeypatch):
    """And not the fault of the file."""
    path = tmp_path / "r.json"
    path.write_text(json.dumps([{"image_id": 1, "keypoints": LONG}]))

    def read(paths):
        return [1, 2][5]

    known = FORMATS["coco-results"]._replace(read_poses=read)
    monkeypatch.setitem(FORMATS, "coco-results", known)
    with pytest.raises(IndexError), open_landmarks([path]):
        pass


def test_lists_of_openpose_that_are_left_out_are_said(tmp_path):
    person = {"pose_keypoints_2d": [1, 2, 0.5] * 25, "face_keypoints_2d": [1, 2, 0.5]}
    person |= {"hand_left_keypoints_2d": [], "hand_right_keypoints_2d": [3, 4, 1]}
    (tmp_path / "0.json").write_text(json.dumps({"people": [person]}))
    with open_landmarks([tmp_path / "0.json"]) as source:
        said = " ".join(source.notes)
    assert "left out: face_keypoints_2d and hand_right_keypoints_2d" in said
