"""BVH is read back by our reader: joints are where the landmarks of the result were."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shapefit.geometry.rotations import random_rotations
from shapefit.io import read_shapes
from shapefit.io.skeletons import PEOPLE
from shapefit.io.writers.bvh import find_angles
from shapefit.records import Shapes
from tests.io.files import save

MILLIMETRE = 1e-3

LIMBS = "UpLeg Leg Foot Arm ForeArm Hand"
RIGHT, LEFT = (
    [f"{side}{limb}" for limb in LIMBS.split()] for side in ("Right", "Left")
)
NAMES = ["Hips", *RIGHT[:3], *LEFT[:3], "Spine2", "Head", *RIGHT[3:], *LEFT[3:]]
"""Of the joints of PEOPLE."""


def places(path, names):
    """Return the joints (f, 3, p) of these names in a file, and its frame rate."""
    back = read_shapes([path])
    columns = [back.landmark_names.index(name) for name in names]
    return back.as_columns()[:, :, columns], back.frame_rate


def test_rigid_bones_come_back_to_a_millimetre(tmp_path, project):
    shapes = read_shapes([project / "sample_data/people_test.h5"])
    summary = save(tmp_path / "man.bvh", shapes)
    assert re.search(
        r"joints of \w+ 0\.0 mm from the landmarks on average", summary.note
    )
    sequences = np.array(shapes.sequences)
    assert len(summary.written) == 8
    for path in summary.written:
        points, rate = places(path, NAMES)
        assert rate == 24
        truth = shapes.as_columns()[sequences == path.stem.removeprefix("man_")]
        np.testing.assert_allclose(points, truth, atol=0.02 * MILLIMETRE)


def test_a_result_is_in_metres_and_rests_in_a_t(tmp_path, scene):
    """At rest arms point to the sides, the left one to +x; legs down, head up."""
    summary = save(tmp_path / "man.bvh", scene.result)
    points, rate = places(tmp_path / "man.bvh", NAMES)
    assert rate == 25
    np.testing.assert_allclose(points, scene.y_up, atol=0.02 * MILLIMETRE)
    assert "in m by the size of the training shapes, y up, the axis z" in summary.note
    text = (tmp_path / "man.bvh").read_text(encoding="utf-8")
    rest = re.findall(r"(?:JOINT|ROOT) (\S+)\s*\{\s*OFFSET (\S+) (\S+) (\S+)", text)
    bones = {name: np.array(offset, float) for name, *offset in rest}
    assert {
        "Spine",
        "Neck",
        "LeftShoulder",
        "RightShoulder",
        "LeftHipJoint",
    } <= bones.keys()
    for names, direction in (
        (("LeftArm", "LeftForeArm", "LeftHand"), (1, 0, 0)),
        (("RightArm", "RightForeArm", "RightHand"), (-1, 0, 0)),
        (("LeftLeg", "LeftFoot", "RightLeg", "RightFoot"), (0, -1, 0)),
        (("LeftUpLeg",), (2**-0.5, -(2**-0.5), 0)),
        (("Spine2", "Head"), (0, 1, 0)),
    ):
        for name in names:
            length = np.linalg.norm(bones[name])
            np.testing.assert_allclose(
                bones[name], length * np.array(direction), atol=1e-5
            )


@pytest.mark.parametrize("rate", [24.7, 59.94, 119.88])
def test_the_time_of_a_frame_is_exact_to_ten_digits(tmp_path, shapes, rate):
    save(tmp_path / "man.bvh", shapes.replaced(frame_rate=rate))
    (line,) = re.findall(r"Frame Time: (\S+)", (tmp_path / "man.bvh").read_text())
    assert 1 / float(line) == pytest.approx(rate, rel=1e-9)


def test_the_note_says_how_far_bones_that_stretch_are_from_the_landmarks(
    tmp_path, scene, shapes
):
    shapes.shapes[2, PEOPLE.index("lwrist")] += [0, 0, 10]  # cm
    summary = save(tmp_path / "man.bvh", shapes, up="z")
    points, _ = places(tmp_path / "man.bvh", ["LeftHand"])
    truth = scene.y_up[..., PEOPLE.index("lwrist")] + [
        [0, 0, 0],
        [0, 0, 0],
        [0, 0.1, 0],
        [0, 0, 0],
    ]
    far = np.linalg.norm(points[..., 0] - truth, axis=1).max()
    assert far > 20 * MILLIMETRE
    assert f"{1000 * far:.1f} at most" in summary.note


def test_gaps_are_bridged_and_what_has_no_place_is_left_out(tmp_path, shapes):
    shapes.shapes[1, 3] = np.nan
    shapes.shapes[:, 8] = np.nan
    save(tmp_path / "man.bvh", shapes)
    points, _ = places(tmp_path / "man.bvh", ["RightFoot"])
    ends = shapes.as_columns()[..., 3] / 100
    np.testing.assert_allclose(
        points[1, :, 0], (ends[0] + ends[2]) / 2, atol=20 * MILLIMETRE
    )
    assert "Head" not in read_shapes([tmp_path / "man.bvh"]).landmark_names


@pytest.fixture
def animal(rng) -> Shapes:
    body = np.array([[0, 0, 0.0], [-1, 0, 0], [1, 0.2, 0], [1, -0.2, 0]]).T / 10
    edges = np.array([[0, 1], [0, 2], [0, 3]])
    names, sequences = ("the back", "tail", "left {ear}", "nose{}"), ("rat",) * 6
    moved = random_rotations(6, rng) @ body
    return Shapes(
        moved.swapaxes(1, 2),
        landmark_names=names,
        items=tuple("012345"),
        sequences=sequences,
        edges=edges,
        unit="m",
        frame_rate=30.0,
    )


def test_other_classes_keep_their_names(tmp_path, animal):
    save(tmp_path / "rat.bvh", animal)
    points, _ = places(tmp_path / "rat.bvh", ["the_back", "tail", "left_ear_", "nose_"])
    np.testing.assert_allclose(points, animal.as_columns(), atol=0.02 * MILLIMETRE)


def test_without_edges_or_shapes_it_is_refused(tmp_path, animal, problems):
    nowhere = animal.replaced(
        shapes=np.full_like(animal.as_columns(), np.nan).swapaxes(1, 2)
    )
    for shapes in (animal.replaced(edges=None), nowhere):
        (line,) = problems(save, tmp_path / "rat.bvh", shapes)
        assert line.startswith("rat.bvh: no edge joins two landmarks that have a place")
        assert "write TRC or C3D" in line
    assert not list(tmp_path.iterdir())


def test_angles_are_those_of_the_rotations_and_change_little(rng):
    R = random_rotations(50, rng)
    back = Rotation.from_euler("ZXY", find_angles(R[None])[0]).as_matrix()
    np.testing.assert_allclose(back, R, atol=1e-12)
    slow = np.radians(np.linspace(0, 1000, 400))
    through = np.stack([0.3 * np.sin(slow), slow, slow / 3], axis=1)
    angles = find_angles(Rotation.from_euler("ZXY", through).as_matrix()[None])[0]
    assert np.abs(np.diff(angles, axis=0)).max() < np.radians(6)
