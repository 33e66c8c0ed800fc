"""The floor is found under planted bodies whose camera is known, and never where none
stands.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.geometry.floor import ABOVE_FLOOR, FORWARD, FilmedBody, Floor, find_floor
from shapefit.geometry.rotations import rotation_about_axis

RATE, TALL = 25.0, 1.7
LEVELS = {
    "hip": (0.1, 0.93),
    "shoulder": (0.18, 1.4),
    "elbow": (0.25, 1.15),
    "wrist": (0.25, 0.9),
}
"""Joints of a body: how far to the side, and how high, in metres."""

JOINTS = {
    f"{side}{joint}": 6 * number + place
    for number, side in enumerate("lr")
    for place, joint in enumerate((*LEVELS, "knee", "ankle"))
}


def walk(seconds=6.25, speed=0.8, step=0.5, heading=0.0):
    """Return a body (n, 3, 12) that walks on y = 0: one foot rests while the other
    passes it.
    """
    t = np.arange(round(seconds * RATE)) / RATE
    phase = t * speed / step
    points = np.zeros((len(t), 3, len(JOINTS)))
    for side, sign, late in (("l", 1, 0.0), ("r", -1, 1.0)):
        own = (phase + late) / 2
        swing = np.clip(2 * (own % 1) - 1, 0, 1)
        ankle = np.stack(
            [
                np.full(len(t), 0.1 * sign),
                ABOVE_FLOOR["ankle"] * TALL + 0.1 * np.sin(np.pi * swing),
                step * (2 * (np.floor(own) + swing) - late),
            ],
            axis=1,
        )
        points[..., JOINTS[f"{side}ankle"]] = ankle
        for joint, (aside, high) in LEVELS.items():
            along = speed * t - 0.5 * step + FORWARD * TALL
            points[..., JOINTS[f"{side}{joint}"]] = np.stack(
                [np.full(len(t), aside * sign), np.full(len(t), high), along], axis=1
            )
        points[..., JOINTS[f"{side}knee"]] = (
            ankle + points[..., JOINTS[f"{side}hip"]]
        ) / 2
    return rotation_about_axis(1, np.float64(heading)) @ points


def still(seconds=3.0):
    """Return a body that stands."""
    points = np.repeat(walk(0.04), round(seconds * RATE), axis=0)
    for side in "lr":
        points[:, 2, JOINTS[f"{side}ankle"]] = 0.0
    points[:, 2] -= points[:, 2, [JOINTS["lhip"]]] - FORWARD * TALL
    for side in "lr":
        points[:, 2, JOINTS[f"{side}ankle"]] = 0.0
    return points


def visible(points, height=1.5, pitch=12.0, roll=-5.0, away=5.0):
    """Return points (n, 3, p) as a camera has them, and the direction that is up for
    it.
    """
    turn = rotation_about_axis(2, np.float64(np.radians(-roll)))
    turn = turn @ rotation_about_axis(0, np.float64(np.radians(pitch)))
    middle = points.mean(axis=(0, 2)) * [1.0, 0.0, 1.0]
    stands = middle + np.array([0.0, height, away])
    return turn @ (points - stands[:, None]), turn[:, 1]


def body(points, sd=0.05):
    return FilmedBody(points, np.full_like(points, sd), JOINTS, TALL, RATE)


def find(points, distance_sd=0.05, **deviations) -> Floor:
    found = find_floor([body(points, **deviations)], distance_sd)
    assert found is not None
    return found


@pytest.mark.parametrize("heading", [0.0, 0.7, np.pi / 2, np.pi])
@pytest.mark.parametrize(
    "camera", [(1.5, 12.0, -5.0), (0.4, -6.0, 3.0), (2.5, 20.0, 0.0)]
)
def test_a_walk_shows_height_and_tilt(heading, camera):
    height, pitch, roll = camera
    points, up = visible(walk(heading=heading), *camera)
    floor = find(points)
    assert_allclose(floor.up, up, atol=0.02)
    assert floor.height == pytest.approx(height, abs=0.12)
    assert (floor.pitch, floor.roll) == pytest.approx((pitch, roll), abs=1.2)
    rest = floor.stand(points)[:, 1]
    ankles = rest[:, [JOINTS["lankle"], JOINTS["rankle"]]].min(axis=1)
    assert_allclose(ankles, ABOVE_FLOOR["ankle"] * TALL, atol=0.05)


def test_a_still_body_shows_them_less_well():
    points, _ = visible(still())
    standing, walking = find(points), find(visible(walk(seconds=12))[0])
    assert standing.height == pytest.approx(1.5, abs=0.15)
    assert (standing.pitch, standing.roll) == pytest.approx((12, -5), abs=1.5)
    assert standing.pitch_sd > 1.2 * walking.pitch_sd
    assert standing.pitch_sd > 2.5


def sitting():
    points = still()
    low = [JOINTS[f"{s}{joint}"] for s in "lr" for joint in LEVELS]
    points[:, 1, low] -= 0.45
    points[:, 2, low] -= 0.4
    for side in "lr":
        points[:, :, JOINTS[f"{side}knee"]] = [0.1, 0.5, 0.05]
    return points


def lying():
    return still()[:, [1, 2, 0]]


@pytest.mark.parametrize("posture", [sitting, lying])
def test_nobody_stands(posture):
    assert find_floor([body(visible(posture())[0])], 0.05) is None


@pytest.mark.parametrize(
    ("axis", "move", "stands"),
    [
        (0, lambda frame: 0.5 * frame / RATE, False),
        (
            2,
            lambda frame: 0.5 * frame / RATE,
            True,
        ),  # along the line of sight it counts a third
        (
            0,
            lambda frame: 0.1 * np.sin(np.pi / 4 * frame),
            True,
        ),  # back after 0.3 seconds
    ],
)
def test_a_foot_that_moves_bears_nobody(axis, move, stands):
    points = still()
    points[:, axis] += move(np.arange(len(points)))[:, None]
    assert (find_floor([body(visible(points)[0])], 0.05) is not None) == stands


def test_without_feet_or_bodies_there_is_no_floor():
    points, _ = visible(walk())
    joints = {name: column for name, column in JOINTS.items() if name != "lankle"}
    assert find_floor([], 0.05) is None
    assert find_floor([FilmedBody(points, points, joints, TALL, RATE)], 0.05) is None
    assert find_floor([body(np.full_like(points, np.nan))], 0.05) is None
    assert find_floor([body(visible(still(seconds=0.28))[0])], 0.05) is None  # a moment
    moved = still(seconds=2 / RATE)
    moved[1, 0] += 0.2
    two = body(visible(moved)[0])._replace(rate=RATE / 10)
    assert find_floor([two], 0.05) is None


def test_all_marks_of_a_foot_stand_on_one_floor():
    points, joints = still(), dict(JOINTS)
    for mark, high in ABOVE_FLOOR.items():
        for side in "lr":
            foot = points[..., JOINTS[f"{side}ankle"]].copy()
            foot[:, 1] = high * TALL
            joints[f"{side}{mark}"] = points.shape[2]
            points = np.concatenate([points, foot[..., None]], axis=2)
    floor = find_floor([body(visible(points)[0])._replace(joints=joints)], 0.05)
    assert floor.height == pytest.approx(find(visible(still())[0]).height, abs=0.002)


def test_a_wrong_focal_length_is_in_the_bars():
    points, _ = visible(walk(heading=np.pi / 2), pitch=20.0, away=4.0)
    assert find(points, 0.18).height_sd > 1.3 * find(points, 0.05).height_sd
    points[:, 2] *= 1.18
    stretched = find(points, 0.18)
    assert abs(stretched.height - 1.5) < 2 * stretched.height_sd


def test_bars_hold(rng):
    """Bodies that lean and are seen with errors as large as the bars say."""
    inside = []
    for _ in range(60):
        height, pitch, roll = rng.normal([1.4, 5, 0], [0.3, 8, 5])
        lean = np.radians(rng.normal(scale=3.0, size=2))
        points = walk(seconds=4, heading=rng.uniform(0, 2 * np.pi))
        points[:, 0] += lean[0] * points[:, 1]
        points[:, 2] += lean[1] * points[:, 1]
        points, _ = visible(points, height, pitch, roll)
        shared, own = rng.normal(size=(2, *points.shape)) * [[0.01], [0.01], [0.06]]
        points = points * (1 + rng.normal(scale=0.04)) + (shared[:1] + own) / np.sqrt(2)
        found = find(points, sd=0.06)
        away = np.subtract(
            (found.height, found.pitch, found.roll), (height, pitch, roll)
        )
        inside.append(np.abs(away) < 1.645 * np.array(found[4:]))
    held = np.mean(inside, axis=0)
    assert ((held > 0.8) & (held <= 1)).all(), held


def test_it_says_so_in_a_line():
    floor = Floor(np.array([0.0, 1.0, 0.0]), 1.416, 8.2, -1.3, 0.06, 2.1, 0.9)
    line = (
        "camera 1.42 m (+- 0.06) above the floor, tilted 8 degrees down (+- 2), 1 to"
        " the right"
    )
    assert str(floor) == f"{line} (+- 1)"
