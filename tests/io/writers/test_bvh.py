"""BVH is read back by our reader: joints are where the landmarks of the result were."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shapefit.geometry.rotations import random_rotations
from shapefit.io import read_shapes
from shapefit.io.skeletons import PEOPLE, edges_of
from shapefit.io.writers.bones import find_angles
from tests.io.files import save

MILLIMETRE = 1e-3

NAMES = {
    "pelvis": "Hips",
    "neck": "Spine2",
    "head": "Head",
    "rhip": "RightUpLeg",
    "rknee": "RightLeg",
    "rankle": "RightFoot",
    "lhip": "LeftUpLeg",
    "lknee": "LeftLeg",
    "lankle": "LeftFoot",
    "rshoulder": "RightArm",
    "relbow": "RightForeArm",
    "rwrist": "RightHand",
    "lshoulder": "LeftArm",
    "lelbow": "LeftForeArm",
    "lwrist": "LeftHand",
}


def places(path, names):
    """Return the joints (f, 3, p) of these names in a file, and its frame rate."""
    back = read_shapes([path])
    columns = [back.landmark_names.index(name) for name in names]
    return back.shapes[:, :, columns], back.frame_rate


def test_rigid_bones_come_back_to_a_millimetre(tmp_path, project):
    shapes = read_shapes([project / "sample_data/people_test.h5"])
    summary = save(tmp_path / "man.bvh", shapes)
    assert "bones of one length, joints 0.004 mm from the landmarks on average" in summary.note
    sequences = np.array(shapes.sequences)
    assert len(summary.written) == 8
    for path in summary.written:
        found, rate = places(path, [NAMES[joint] for joint in PEOPLE])
        assert rate == 24
        truth = shapes.shapes[sequences == path.stem.removeprefix("man_")]
        np.testing.assert_allclose(found, truth, atol=0.02 * MILLIMETRE)


def test_a_result_is_in_metres_with_joints_that_are_known(tmp_path, scene):
    summary = save(tmp_path / "man.bvh", scene.result)
    found, rate = places(tmp_path / "man.bvh", [NAMES[joint] for joint in PEOPLE])
    assert rate == 25
    np.testing.assert_allclose(found, scene.y_up, atol=0.02 * MILLIMETRE)
    assert "in m by the size of the training shapes, y up, the axis z" in summary.note
    text = (tmp_path / "man.bvh").read_text(encoding="utf-8")
    for name in ("Spine", "Neck", "LeftShoulder", "RightShoulder", "LeftHipJoint"):
        assert f"JOINT {name}\n" in text


def test_people_rest_in_a_t(tmp_path, scene):
    """Arms to the sides, the left one to +x; legs down, head up."""
    save(tmp_path / "man.bvh", scene.result)
    text = (tmp_path / "man.bvh").read_text()
    rest = re.findall(r"(?:JOINT|ROOT) (\S+)\s*\{\s*OFFSET (\S+) (\S+) (\S+)", text)
    bones = {name: np.array(offset, float) for name, *offset in rest}
    for names, direction in {
        ("LeftArm", "LeftForeArm", "LeftHand"): (1, 0, 0),
        ("RightArm", "RightForeArm", "RightHand"): (-1, 0, 0),
        ("LeftLeg", "LeftFoot", "RightLeg", "RightFoot"): (0, -1, 0),
        ("Spine2", "Head"): (0, 1, 0),
    }.items():
        for name in names:
            length = np.linalg.norm(bones[name])
            np.testing.assert_allclose(bones[name], length * np.array(direction), atol=1e-5)


@pytest.mark.parametrize("rate", [24.7, 59.94, 119.88])
def test_the_time_of_a_frame_is_exact_to_ten_digits(tmp_path, shapes, rate):
    save(tmp_path / "man.bvh", shapes.replaced(frame_rate=rate))
    (line,) = re.findall(r"Frame Time: (\S+)", (tmp_path / "man.bvh").read_text())
    assert 1 / float(line) == pytest.approx(rate, rel=1e-9)


def test_bones_that_stretch_are_told(tmp_path, shapes):
    stretched = shapes.shapes.copy()
    stretched[2, :, PEOPLE.index("lwrist")] += [0, 0, 10]  # cm
    summary = save(tmp_path / "man.bvh", shapes.replaced(shapes=stretched), up="z")
    found, _ = places(tmp_path / "man.bvh", ["LeftHand"])
    truth = np.stack([stretched[:, 0], stretched[:, 2], -stretched[:, 1]], axis=1) / 100
    away = np.linalg.norm(found[..., 0] - truth[..., PEOPLE.index("lwrist")], axis=1)
    assert away.max() > 20 * MILLIMETRE
    assert f"{1000 * away.max():.0f} at most" in summary.note


def test_gaps_are_bridged_and_told(tmp_path, shapes):
    points = shapes.shapes.copy()
    points[1, :, 3] = np.nan
    points[:, :, 8] = np.nan
    summary = save(tmp_path / "man.bvh", shapes.replaced(shapes=points))
    assert summary.warnings == (
        "head never have a place: left out",
        "1 frame with gaps, which are bridged in straight lines",
    )
    found, _ = places(tmp_path / "man.bvh", ["RightFoot"])
    points = shapes.shapes[..., 3] / 100
    np.testing.assert_allclose(found[1, :, 0], (points[0] + points[2]) / 2, atol=20 * MILLIMETRE)


def read_animal(rng):
    from shapefit.io.records import ShapeSet

    body = np.array([[0, 0, 0.0], [-1, 0, 0], [1, 0.2, 0], [1, -0.2, 0]]).T / 10
    moved = random_rotations(6, rng) @ body
    edges = np.array([[0, 1], [0, 2], [0, 3]])
    names, items = ("the back", "tail", "left {ear}", "nose{}"), tuple("012345")
    return ShapeSet(moved, names, items, ("rat",) * 6, edges=edges, unit="m", frame_rate=30.0)


def test_without_edges_or_shapes_it_is_refused(tmp_path, rng, problems):
    shapes = read_animal(rng)
    (line,) = problems(save, tmp_path / "rat.bvh", shapes.replaced(edges=None))
    assert line.startswith(f"{tmp_path / 'rat.bvh'}: the landmarks have no edges, so there are no")
    assert "write TRC or C3D" in line
    nowhere = shapes.replaced(shapes=np.full_like(shapes.shapes, np.nan))
    (line,) = problems(save, tmp_path / "rat.bvh", nowhere)
    assert "no two landmarks of an edge have a place in any frame" in line
    assert not list(tmp_path.iterdir())


def test_angles_are_those_of_the_rotations_and_change_little(rng):
    R = random_rotations(50, rng)
    np.testing.assert_allclose(
        Rotation.from_euler("ZXY", find_angles(R[None])[0]).as_matrix(), R, atol=1e-12
    )
    slow = np.radians(np.linspace(0, 1000, 400))
    through = np.stack([0.3 * np.sin(slow), slow, slow / 3], axis=1)
    found = find_angles(Rotation.from_euler("ZXY", through).as_matrix()[None])[0]
    assert np.abs(np.diff(found, axis=0)).max() < np.radians(6)


@pytest.mark.parametrize("names", [PEOPLE, ("LHip", "RHip", "LKnee")])
def test_edges_of_known_skeletons(names):
    edges = edges_of(names)
    assert len(edges) >= len(names) - 2
    assert edges_of((*names, "tail")) == edges
    assert edges_of((*names, *"abcdefghijklmno")) == ()
