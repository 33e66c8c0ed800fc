"""Files of SLEAP: skeletons, axes, and what a user placed."""

import json

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.io.readers import made
from tests.io.readers.made import read_images
from tests.io.readers.test_trackers import by_animal


def with_skeletons(path, change) -> None:
    """Change what the metadata of a .slp file say of its skeletons."""
    with h5py.File(path, "a") as file:
        attributes = file["metadata"].attrs
        about = json.loads(attributes["json"])
        change(about)
        attributes["json"] = json.dumps(about)


@pytest.fixture
def slp_file(tmp_path, points, confidence):
    path = tmp_path / "labels.slp"
    made.write_slp(path, points, confidence)
    return path


def as_preset(about):
    """Keep the graph beside a description and a picture."""
    (graph,) = about["skeletons"]
    preset = {"nx_graph": graph, "description": None, "preview_image": None}
    about["skeletons"] = [preset]


def test_a_skeleton_of_a_preset(slp_file, read):
    plain = read(slp_file)
    with_skeletons(slp_file, as_preset)
    images = read(slp_file)
    assert images.landmark_names == plain.landmark_names
    assert plain.lines.tolist() == [[0, 1]]
    assert images.lines.tolist() == [[0, 1]]
    assert_array_equal(images.landmarks, plain.landmarks)


def test_a_preset_without_nodes_is_refused(slp_file, problem):
    with_skeletons(slp_file, as_preset)
    with_skeletons(slp_file, lambda about: about["skeletons"][0].update(nx_graph={}))
    assert "a skeleton without nodes" in problem(slp_file)


def add_skeleton(about):
    """Add a skeleton, of which two nodes are of the first."""
    about["nodes"] += [{"name": "horn"}, {"name": "hoof"}]
    nodes = [{"id": number} for number in (4, 1, 5, 0)]
    link = {"source": 4, "target": 5, "type": {"py/id": 1}}
    about["skeletons"].append({"nodes": nodes, "links": [link]})


@pytest.fixture
def of_two_skeletons(slp_file, read):
    """The images of a file whose second animal has another skeleton."""
    with_skeletons(slp_file, add_skeleton)
    with h5py.File(slp_file, "a") as file:
        rows = file["instances"][()]
        rows["skeleton"] = rows["track"]
        file["instances"][...] = rows
    return read(slp_file)


def test_two_skeletons_are_one_of_all_their_nodes(of_two_skeletons):
    names = ("point0", "point1", "point2", "point3", "horn", "hoof")
    assert of_two_skeletons.landmark_names == names
    assert of_two_skeletons.lines.tolist() == [[0, 1], [4, 5]]


def test_each_animal_has_the_landmarks_of_its_skeleton(of_two_skeletons, points):
    animals = np.array([name[-1] for name in of_two_skeletons.sequences])
    first = of_two_skeletons.landmarks[animals == "0"]
    second = of_two_skeletons.landmarks[animals == "1"]
    assert_array_equal(first[:, :4], points[:, 0])
    assert np.isnan(first[:, 4:]).all()
    assert_array_equal(second[:, [4, 1, 5, 0]], points[:, 1])


ANALYSIS_AXES = '["frame", "track", "node", "xy"]'


SCORE_AXES = '["frame", "track", "node"]'


@pytest.mark.parametrize(("frame_count", "stated"), [(5, False), (2, True)])
def test_axes_of_analysis_files(tmp_path, rng, read, frame_count, stated):
    """Two landmarks, two tracks: the occupancy tells the orders apart, and stated axes
    win.
    """
    path = tmp_path / "p.analysis.h5"
    points = rng.normal(size=(frame_count, 2, 2, 2))
    confidence = rng.uniform(0.1, 1, (frame_count, 2, 2))
    made.write_sleap_analysis(path, points, confidence)
    expected = read(path)
    with h5py.File(path, "a") as file:
        del file["tracks"]
        del file["point_scores"]
        file["tracks"] = points
        file["point_scores"] = confidence
        if stated:
            file["tracks"].attrs["dims"] = ANALYSIS_AXES
            file["point_scores"].attrs["dims"] = SCORE_AXES
    images = read(path)
    assert_array_equal(images.landmarks, expected.landmarks)
    assert_array_equal(images.confidence, expected.confidence)


def nodes_in_order(order):
    return json.dumps([{"id": number} for number in order])


def test_a_skeleton_in_the_order_of_its_file(slp_file, points, read):
    before = nodes_in_order((0, 1, 2, 3))
    after = nodes_in_order((2, 0, 3, 1))
    with h5py.File(slp_file, "a") as file:
        attributes = file["metadata"].attrs
        attributes["json"] = attributes["json"].replace(before, after)
    images = read(slp_file)
    assert images.landmark_names == ("point2", "point0", "point3", "point1")
    assert_array_equal(by_animal(images, 2), points)


def test_old_slp_files_are_shifted_by_half_a_pixel(slp_file, points, read):
    with h5py.File(slp_file, "a") as file:
        file["metadata"].attrs["format_id"] = 1.0
    assert_array_equal(by_animal(read(slp_file), 2), points - 0.5)


@pytest.fixture
def placed_file(tmp_path, points, confidence):
    """A file in which a user placed the second animal in frame 2, the first in 5."""
    path = tmp_path / "p.slp"
    made.write_slp(path, points, confidence, users={2: 1, 5: 0})
    return path


def read_placed(path):
    images, (note, *_) = read_images(path)
    told = "2 predicted instances replaced by those that a user placed"
    assert told in note
    assert len(images) == 14
    return images


def test_what_a_user_placed_of_a_track_wins(placed_file, points):
    images = read_placed(placed_file)
    expected = points.copy()
    expected[2, 1] += 1
    expected[5, 0] += 1
    assert_array_equal(by_animal(images, 2), expected)


def test_what_a_user_placed_of_a_prediction_wins(placed_file):
    with h5py.File(placed_file, "a") as file:
        table = file["instances"][:]
        users = table["instance_type"] == 0
        table["from_predicted"][users] = np.flatnonzero(users) - [1, 2]
        table["track"][users] = -1
        file["instances"][...] = table
    images = read_placed(placed_file)
    assert sorted(images.items)[-2:] == ["p/untracked/2/0", "p/untracked/5/0"]


@pytest.mark.parametrize("frame_count", [7, 2])
def test_an_analysis_file_of_tracks_and_nodes_alone(
    tmp_path, points, confidence, read, frame_count
):
    """Of two frames the order of axes is open but for the rule."""
    path = tmp_path / "tracks.h5"
    made.write_sleap_analysis(path, points[:frame_count], confidence[:frame_count])
    whole = read(path)
    with h5py.File(path, "a") as file:
        for name in set(file) - {"tracks", "node_names"}:
            del file[name]
    images = read(path)
    names = [name.replace("animal", "track_") for name in whole.sequences]
    assert_array_equal(images.landmarks, whole.landmarks)
    assert images.landmark_names == whole.landmark_names
    assert images.sequences == tuple(names)
