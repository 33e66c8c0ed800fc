"""JSON and labels of detectors: made files, and what is read from them."""

import json
import os

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.io.readers.coco import read_coco_annotations

from .made import read_images as read

NAN = np.nan


@pytest.fixture
def written(tmp_path):
    """Write contents as JSON (or text) under a name, and return the path."""

    def write(name, contents):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        text = contents if isinstance(contents, str) else json.dumps(contents)
        path.write_text(text, encoding="utf-8")
        return path

    return write


def person(points=17, **further):
    return {"pose_keypoints_2d": [10.0, 20.0, 0.5] * points, **further}


def frame(*people, **further):
    return {"version": 1.3, "people": list(people), **further}


HIDDEN = person()
HIDDEN["pose_keypoints_2d"] = [0, 0, 0, *HIDDEN["pose_keypoints_2d"][3:]]
NOBODY = {"pose_keypoints_2d": []}

MOUSE = {
    "id": 1,
    "name": "mouse",
    "keypoints": ["nose", "tail"],
    "skeleton": [[1, 2], [1, 3]],
}
FLY = {"id": 5, "name": "fly", "keypoints": ["head", "nose"]}


def annotations(*entries, categories=(MOUSE, FLY)):
    return {
        "images": [{"id": n, "file_name": f"day/{n}.png"} for n in range(2)],
        "categories": list(categories),
        "annotations": [{"id": n, **entry} for n, entry in enumerate(entries)],
    }


def entry(image, category, *keypoints, **further):
    return {
        "image_id": image,
        "category_id": category,
        "keypoints": list(keypoints),
        **further,
    }


def instance(points=17, score=0.5, **further):
    return {
        "keypoints": [[1.0, 2.0]] * points,
        "keypoint_scores": [score] * points,
        **further,
    }


META = {"keypoint_id2name": {"0": "a", "1": "b"}, "skeleton_links": [[0, 1]]}
CALISCOPE = "sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y\n"
CALISCOPE += (
    "0,1,5,0.1,0,10,20\n0,1,5,0.1,100,30,40\n0,2,5,0.1,32,50,60\n1,1,7,0.2,0,,\n"
)
RAT = "names: {0: rat}\nkpt_shape: [2, 3]\nkpt_names: {0: [nose, tail]}\n"
BOX = "0 .5 .5 .1 .1"

CASES = [
    # OpenPose: files in order of their numbers, one recording
    (
        {f"cam/c_{n:012d}_keypoints.json": frame(person()) for n in (9, 10, 2)},
        {
            "items": ["cam/2/0", "cam/9/0", "cam/10/0"],
            "frames": [0, 7, 8],
            "unit": "px",
        },
    ),
    (
        {
            "cam/0.json": frame(NOBODY, HIDDEN),
            "cam/1.json": frame(),
            "cam/2.json": {"version": 1.3},
        },
        {
            "items": ["cam/0/1"],
            "seen": [[False, *[True] * 16]],
            "confidence": [[0, *[0.5] * 16]],
            "notes": ["1 item without a landmark left out"],
        },
    ),
    (
        {f"cam/{n}.json": frame() for n in range(3)},
        {"items": []},
    ),
    (
        {
            "cam/0.json": frame(person(person_id=[4]), person(person_id=[7])),
            "cam/1.json": frame(person(person_id=[7]), person(person_id=[-1])),
        },
        {"items": ["cam/id 4/0", "cam/id 7/0", "cam/id 7/1", "cam/untracked/1/0"]},
    ),
    (
        {"cam/0.json": frame(person(person_id=[7]), person(person_id=[7]))},
        {
            "items": ["cam/0/0", "cam/0/1"],
            "notes": [
                "numbers of people are not used, as 1 of them occur twice in a frame"
            ],
        },
    ),
    # COCO: visibility decides, categories are joined
    (
        {
            "a.json": annotations(
                entry(1, 5, 1, 2, 2, 3, 4, 1), entry(0, 1, 5, 6, 0, 7, 8, 2)
            )
        },
        {
            "names": ["nose", "tail", "head"],
            "items": ["a/0/0", "a/1/0"],
            "points": [[[NAN, NAN], [7, 8], [NAN, NAN]], [[3, 4], [NAN, NAN], [1, 2]]],
            "confidence": None,
        },
    ),
    (
        {
            "a.json": annotations(
                {"image_id": 0, "bbox": []}, entry(9, 1, 1, 2, 2, 3, 4, 2)
            )
        },
        {"items": ["a/9/0"]},
    ),
    (
        {
            "a.json": annotations(
                *(entry(n, 1, 1, 2, 2, 3, 4, 2, track_id=3) for n in range(2))
            )
        },
        {"items": ["a/id 3/0", "a/id 3/1"]},
    ),
    (
        {"r.json": [entry(7, 1, *[1, 2, 0.5] * 17), entry(3, 1, *[0, 0, 0] * 17)]},
        {"items": ["r/7/0"], "notes": ["1 item without a landmark left out"]},
    ),
    *(
        (
            {
                "r.json": [
                    entry(f"{n}.jpg", 1, *[1, 2, largest] * 17, idx=[0.0])
                    for n in range(3)
                ]
            },
            {
                "items": ["r/id 0/0", "r/id 0/1", "r/id 0/2"],
                "confidence": [[largest / divisor] * 17] * 3,
            },
        )
        for largest, divisor in ((0.9, 1), (1.2, 1), (5.4, 6))
    ),
    # MMPose
    (
        {"v.json": [{"frame_id": n, "instances": [instance()] * n} for n in range(3)]},
        {"items": ["v/1/0", "v/2/0", "v/2/1"], "frames": [1, 2, 2]},
    ),
    ({"v.json": [{"instances": [instance()], **instance()}]}, {"items": ["v/0/0"]}),
    (
        {"v.json": {"meta_info": META, "instance_info": [instance(2)]}},
        {"items": ["v/0/0"], "names": ["a", "b"]},
    ),
    (
        {
            "v.json": {
                "meta_info": META,
                "instance_info": [
                    {"frame_id": 4, "instances": [instance(2, track_id=3)]}
                ],
            }
        },
        {"items": ["v/id 3/4"], "names": ["a", "b"]},
    ),
    (
        {f"set/{n}.json": [instance()] * n for n in range(3)},
        {"items": ["set/1/0", "set/2/0", "set/2/1"]},
    ),
    # caliscope: a port is a video; numbers of the body have names
    (
        {"xy.csv": CALISCOPE},
        {
            "items": ["xy/port 1/5", "xy/port 2/5"],
            "names": ["nose", "right_foot_index", "100"],
            "points": [
                [[10, 20], [NAN, NAN], [30, 40]],
                [[NAN, NAN], [50, 60], [NAN, NAN]],
            ],
        },
    ),
    # YOLO
    (
        {
            "data.yaml": RAT,
            "labels/rat_3.txt": f"# comment\n{BOX} .25 .5 2 .9 .9 0\n\n",
            "labels/rat_4.txt": "",
        },
        {
            "items": ["labels/3/0"],
            "names": ["nose", "tail"],
            "seen": [[True, False]],
            "confidence": None,
            "unit": "fraction of the image",
        },
    ),
    (
        {
            "data.yaml": "kpt_shape: [4, 2]\n",
            "labels/a.txt": f"{BOX} .2 .5 0 0 0 .5 .2 0 .8 7\n",
        },
        {"items": ["labels/id 7/a"], "seen": [[True, False, True, True]]},
    ),
    (
        {"labels/v_1.txt": f"{BOX}{' .25 .5 .75' * 16} .25 .5 1\n" * 2},
        {"items": ["labels/1/0", "labels/1/1"], "confidence": [[*[0.75] * 16, 1]] * 2},
    ),
]


@pytest.mark.parametrize(("files", "expected"), CASES)
def test_what_is_read(written, tmp_path, files, expected):
    """Files that lie in a folder are read as that folder, and one by one."""
    paths = [written(name, content) for name, content in files.items()]
    paths = [path for path in paths if path.name != "data.yaml"]
    folder = paths[0].parent
    alone = not {"rat_4.txt"} & {path.name for path in paths}  # of no kind by itself
    for given in [[folder]] * (folder != tmp_path) + [paths] * alone:
        images, notes = read(*given)
        found = {
            "items": list(images.items),
            "names": list(images.landmark_names),
            "frames": images.column("frame").tolist(),
            "unit": images.unit,
            "seen": np.isfinite(images.as_columns()).all(axis=1).tolist(),
            "notes": [note.partition(": ")[2] for note in notes],
        }
        for name, wanted in expected.items():
            if name == "points":
                assert_array_equal(images.points, wanted)
            elif name == "confidence" and wanted is not None:
                assert_allclose(images.confidence, wanted)
            elif name == "confidence":
                assert images.confidence is None
            elif name == "items" and len(given) < len(paths):
                assert sorted(found[name]) == sorted(wanted)
            else:
                assert found[name] == wanted
        if len(images.landmark_names) == 17:
            assert images.landmark_names[5] == "left_shoulder"


def test_edges_count_from_1_within_their_category(written):
    path = written(
        "a.json", annotations(entry(0, 1, 1, 2, 2, 3, 4, 2), categories=(FLY, MOUSE))
    )
    recording = read_coco_annotations((path,))
    assert recording.landmark_names == ("head", "nose", "tail")
    assert recording.edges == ((1, 2),)


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
        "annotations": [
            {"image_id": n, "keypoints": [1.0, 2.0, 2] * 17} for n in range(3)
        ],
        "categories": [],
    }
    path = written("all.json", content)
    if motion:
        assert len(set(read(path, track="motion")[0].sequences)) == 1
    else:
        with pytest.raises(
            InputError, match=r"without numbers of frames: no motion; number the im"
        ):
            read(path, track="motion")
    assert len(set(read(path, track="nearest")[0].sequences)) == 1


@pytest.mark.parametrize(
    ("count", "names", "note"),
    [
        (17, ("nose", "left_eye"), ""),
        (18, ("Nose", "Neck"), ""),
        (25, ("Nose", "Neck"), "body_25; `keypoints=body_25b`"),
        (26, ("Nose", "LEye"), ""),
        (133, ("nose", "left_eye"), ""),
    ],
)
def test_landmarks_without_names_are_those_of_the_usual_skeleton(
    written, count, names, note
):
    found, notes = read(written("cam/0.json", frame(person(count))))
    assert found.landmark_names[:2] == names
    assert len(found.landmark_names) == count
    assert note in " ".join(notes)
    assert len(notes) == bool(note)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (
            {"0.json": frame(person(), person()), "1.json": frame(person(25))},
            "2 detections with 17 and 1 detections with 25",
        ),
        (
            {"0.json": frame(), "meta.json": {"camera": 1}},
            r"meta.json: .*no list of people.; remove",
        ),
        ({"walk.mp4": "ftyp"}, r"it is a folder, and holds none of these: .*OpenPose"),
    ],
)
def test_folders_that_are_refused(written, tmp_path, files, words):
    for name, content in files.items():
        written(f"cam/{name}", content)
    with pytest.raises(InputError, match=words):
        read(tmp_path / "cam")


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to(path)])
@pytest.mark.parametrize(
    ("name", "content"), [("0.json", frame(person())), ("0.txt", BOX + " .5 .5 1" * 17)]
)
def test_only_regular_files_of_a_folder_are_opened(
    written, tmp_path, make, name, content
):
    written(f"cam/{name}", content)
    make(tmp_path / "cam" / name.replace("0", "1"))
    with pytest.raises(InputError, match=r"cam/1\.(json|txt): is not a regular file"):
        read(tmp_path / "cam")


def test_landmarks_below_the_least_confidence_are_hidden(written):
    found, (note,) = read(
        written("r.json", [entry(1, 1, 1, 2, 0.4, 3, 4, 0.6)]), min_confidence=0.5
    )
    assert np.isfinite(found.as_columns()[0]).all(axis=0).tolist() == [False, True]
    assert "1 landmark hidden, whose confidence is below `min_confidence`" in note


@pytest.mark.parametrize(
    ("confidence", "seen"), [(0, [False, False, True]), (0.5, [True, True, True])]
)
def test_placeholders_with_a_confidence_of_0_are_missing(written, confidence, seen):
    """(-1, -1) and (0, 0), also where landmarks without a confidence are placed."""
    points = [-1, -1, confidence, 0, 0, confidence, 5, 6, 1]
    found, _ = read(written("r.json", [entry(1, 1, *points)]))
    assert np.isfinite(found.as_columns()[0]).all(axis=0).tolist() == seen


# YOLO without data.yaml

TAILS = ("", " 0.9", " 0.9 7")
"""Nothing, a score, a score and a track."""

LAYOUTS = [(count, " 2", tail) for count in (4, 5, 17) for tail in TAILS]


@pytest.mark.parametrize(("count", "mark", "tail"), LAYOUTS)
def test_the_layout_of_lines_is_found(rng, tmp_path, count, mark, tail):
    points = np.round(rng.uniform(0.1, 0.9, (3, count, 2)), 3)
    for frame, person in enumerate(points):
        cells = " ".join(f"{x} {y}{mark}" for x, y in person.tolist())
        (tmp_path / f"{frame}.txt").write_text(f"0 0.5 0.5 0.2 0.4 {cells}{tail}\n")
    found, _ = read(tmp_path)
    assert np.allclose(found.points, points)
    assert (found.landmark_names[0] == "nose") == (count == 17)
