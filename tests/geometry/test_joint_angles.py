"""Joint angles: planted poses, what they do not depend on, and deviations against a simulation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shapefit.geometry.joint_angles import ANGLES, known_angles, measure_angles

UP = np.array([0.0, 1.0, 0.0])
TRUTH = {
    "hip_flexion_r": 40.0,
    "hip_flexion_l": -15.0,
    "knee_angle_r": 70.0,
    "knee_angle_l": 5.0,
    "ankle_angle_r": 12.0,
    "ankle_angle_l": -30.0,
    "arm_flex_r": 95.0,
    "arm_flex_l": -20.0,
    "elbow_flex_r": 110.0,
    "elbow_flex_l": 30.0,
    "trunk_tilt": 0.0,
    "head_tilt": 25.0,
}


def turned(vector, degrees):
    """Turn a vector about z, which points to the right of a body that looks along x."""
    return Rotation.from_euler("z", degrees, degrees=True).apply(vector)


def person(truth=TRUTH):
    """Return the joints of a body, x forward, y up and z to the right, in metres."""
    down, forward = np.array([0, -1.0, 0]), np.array([1.0, 0, 0])
    joints = {"head": np.array([0, 1.45, 0]) + 0.2 * turned(UP, -truth["head_tilt"])}
    for side, z in (("r", 1.0), ("l", -1.0)):
        shoulder, hip = np.array([0, 1.45, 0.2 * z]), np.array([0, 0.95, 0.1 * z])
        arm, leg = truth[f"arm_flex_{side}"], truth[f"hip_flexion_{side}"]
        elbow, knee = shoulder + 0.3 * turned(down, arm), hip + 0.45 * turned(down, leg)
        shank = leg - truth[f"knee_angle_{side}"]
        ankle = knee + 0.4 * turned(down, shank)
        foot = turned(forward, shank + truth[f"ankle_angle_{side}"])
        joints |= {
            f"{side}shoulder": shoulder,
            f"{side}elbow": elbow,
            f"{side}wrist": elbow + 0.25 * turned(down, arm + truth[f"elbow_flex_{side}"]),
            f"{side}hip": hip,
            f"{side}knee": knee,
            f"{side}ankle": ankle,
            f"{side}heel": ankle - 0.05 * foot,
            f"{side}toe": ankle + 0.2 * foot,
        }
    return joints


def measured(joints, up=UP, covariance=None):
    shapes = np.stack([np.atleast_2d(points) for points in joints.values()], axis=-1)
    columns = {name: number for number, name in enumerate(joints)}
    values, sd = measure_angles(shapes, up, columns, covariance)
    names = [angle.name for angle in known_angles(columns)]
    return dict(zip(names, values.T, strict=True)), dict(zip(names, sd.T, strict=True))


def test_planted_angles_are_found():
    found, deviations = measured(person())
    assert found.keys() == TRUTH.keys() == {angle.name for angle in ANGLES}
    for name, degrees in TRUTH.items():
        assert found[name][0] == pytest.approx(degrees, abs=1e-9), name
        assert np.isnan(deviations[name][0])


def test_angles_do_not_depend_on_frame_and_size(rng):
    turn = Rotation.random(rng=7).as_matrix()
    shift = rng.normal(size=3)
    moved = {name: 3.7 * turn @ point + shift for name, point in person().items()}
    found, _ = measured(moved, turn @ UP)
    for name, degrees in TRUTH.items():
        assert found[name][0] == pytest.approx(degrees, abs=1e-6), name


def test_left_and_right_exchange_in_a_mirror():
    swapped = {"rl"["lr".index(n[0])] + n[1:] if n != "head" else n: p for n, p in person().items()}
    mirrored = {name: point * [1, 1, -1] for name, point in swapped.items()}
    found, _ = measured(mirrored)
    for name, degrees in TRUTH.items():
        other = name[:-1] + "rl"["lr".index(name[-1])] if name[-2] == "_" else name
        assert found[other][0] == pytest.approx(degrees, abs=1e-9), name


def test_a_body_in_part_has_some_angles():
    joints = person()
    del joints["rankle"], joints["head"]
    found, _ = measured(joints)
    assert TRUTH.keys() - found.keys() == {"knee_angle_r", "ankle_angle_r", "head_tilt"}


@pytest.mark.parametrize("independent", [False, True])
def test_deviations_are_those_of_a_simulation(rng, independent):
    """Of 20,000 bodies whose joints err by a centimetre, together or each by itself."""
    joints = person(TRUTH | {"knee_angle_l": 40.0, "head_tilt": 80.0})
    for shoulder in ("rshoulder", "lshoulder"):  # a straight line has no derivative
        joints[shoulder] = joints[shoulder] + [0.1, 0, 0]
    p = len(joints)
    factor = 0.01 * (np.eye(3 * p) if independent else rng.normal(size=(3 * p, 3 * p)) / np.sqrt(p))
    whole = factor @ factor.T
    blocks = whole.reshape(p, 3, p, 3)[np.arange(p), :, np.arange(p)]
    _, stated = measured(joints, covariance=blocks[None] if independent else whole[None])
    errors = (rng.normal(size=(20_000, 3 * p)) @ factor.T).reshape(-1, p, 3)
    drawn = {name: joints[name] + errors[:, k] for k, name in enumerate(joints)}
    simulated, _ = measured(drawn)
    for name, values in simulated.items():
        assert stated[name][0] == pytest.approx(values.std(), rel=0.05), name
