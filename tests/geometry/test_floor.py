"""The floor is found under planted bodies whose camera is known, and never where none
stands.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.geometry.floor import (
    ABOVE_FLOOR,
    STATURE_SD,
    FilmedBody,
    Floor,
    find_floor,
    make_floor,
)
from tests.geometry.filmed_bodies import (
    ANKLES,
    JOINTS,
    RATE,
    TALL,
    lying,
    sitting,
    still,
    visible,
    walk,
)

DISTANCE_SD = 0.05
"""Of the distance to the camera, as a share of it."""


def filmed(points, sd=0.05):
    """Return what is known of a body before the camera."""
    return FilmedBody(points, np.full_like(points, sd), JOINTS, TALL, RATE)


def seen_by_default_camera(points):
    in_camera, _ = visible(points)
    return filmed(in_camera)


def find(points, distance_sd=DISTANCE_SD, **deviations) -> Floor:
    floor = find_floor([filmed(points, **deviations)], distance_sd)
    assert floor is not None
    return floor


class TestWalk:
    """A walk shows height and tilt of the camera."""

    CAMERAS = ((1.5, 12.0, -5.0), (0.4, -6.0, 3.0), (2.5, 20.0, 0.0))

    @pytest.mark.parametrize("heading", [0.0, 0.7, np.pi / 2, np.pi])
    @pytest.mark.parametrize("camera", CAMERAS)
    def test_height_and_tilt_are_found(self, heading, camera):
        height, pitch, roll = camera
        points, up = visible(walk(heading=heading), *camera)

        floor = find(points)

        assert_allclose(floor.up, up, atol=0.02)
        assert floor.height == pytest.approx(height, abs=0.12)
        assert floor.pitch == pytest.approx(pitch, abs=1.2)
        assert floor.roll == pytest.approx(roll, abs=1.2)

    @pytest.mark.parametrize("heading", [0.0, 0.7, np.pi / 2, np.pi])
    @pytest.mark.parametrize("camera", CAMERAS)
    def test_the_resting_foot_stands_on_it(self, heading, camera):
        points, _ = visible(walk(heading=heading), *camera)

        heights = find(points).in_floor_frame(points)[:, 1]

        lower_ankle = heights[:, ANKLES].min(axis=1)
        assert_allclose(lower_ankle, ABOVE_FLOOR["ankle"] * TALL, atol=0.05)


class TestStillBody:
    """A body that stands shows height and tilt less well than one that walks."""

    @pytest.fixture
    def standing(self):
        points, _ = visible(still())
        return find(points)

    def test_height_and_tilt_are_found(self, standing):
        assert standing.height == pytest.approx(1.5, abs=0.15)
        assert standing.pitch == pytest.approx(12, abs=1.5)
        assert standing.roll == pytest.approx(-5, abs=1.5)

    def test_its_bars_are_wider(self, standing):
        points, _ = visible(walk(seconds=12))
        walking = find(points)
        assert standing.pitch_sd > 1.2 * walking.pitch_sd
        assert standing.pitch_sd > 2.5


@pytest.mark.parametrize("posture", [sitting, lying])
def test_nobody_stands(posture):
    body = seen_by_default_camera(posture())
    assert find_floor([body], DISTANCE_SD) is None


SECONDS = np.arange(len(still())) / RATE
EVEN = 0.5 * SECONDS
BACK_AND_FORTH = 0.1 * np.sin(np.pi / 4 * RATE * SECONDS)
SIDEWAYS = 0
ALONG_THE_LINE_OF_SIGHT = 2


def find_floor_of_a_body_that_moves(axis, move):
    points = still()
    points[:, axis] += move[:, None]
    return find_floor([seen_by_default_camera(points)], DISTANCE_SD)


def test_a_foot_that_moves_bears_nobody():
    assert find_floor_of_a_body_that_moves(SIDEWAYS, EVEN) is None


def test_along_the_line_of_sight_a_motion_counts_a_third():
    assert find_floor_of_a_body_that_moves(ALONG_THE_LINE_OF_SIGHT, EVEN) is not None


def test_a_foot_that_is_back_after_a_third_of_a_second_bears_somebody():
    assert find_floor_of_a_body_that_moves(SIDEWAYS, BACK_AND_FORTH) is not None


class TestNoFloor:
    def test_without_bodies(self):
        assert find_floor([], DISTANCE_SD) is None

    def test_without_one_of_the_feet(self):
        body = seen_by_default_camera(walk())
        others = {name: place for name, place in JOINTS.items() if name != "lankle"}
        assert find_floor([body._replace(joints=others)], DISTANCE_SD) is None

    def test_of_a_body_that_is_nowhere_seen(self):
        unseen = np.full_like(walk(), np.nan)
        assert find_floor([filmed(unseen)], DISTANCE_SD) is None

    def test_of_a_moment(self):
        body = seen_by_default_camera(still(seconds=0.28))
        assert find_floor([body], DISTANCE_SD) is None

    def test_of_two_frames_far_apart(self):
        points = still(seconds=2 / RATE)
        points[1, 0] += 0.2
        body = seen_by_default_camera(points)._replace(rate=RATE / 10)
        assert find_floor([body], DISTANCE_SD) is None


def test_all_marks_of_a_foot_stand_on_one_floor():
    points = still()
    joints = dict(JOINTS)
    for mark, high in ABOVE_FLOOR.items():
        for side in "lr":
            foot = points[..., JOINTS[f"{side}ankle"]].copy()
            foot[:, 1] = high * TALL
            joints[f"{side}{mark}"] = points.shape[2]
            points = np.concatenate([points, foot[..., None]], axis=2)
    body = seen_by_default_camera(points)._replace(joints=joints)

    floor = find_floor([body], DISTANCE_SD)

    in_camera, _ = visible(still())
    by_ankles = find(in_camera)
    assert floor.height == pytest.approx(by_ankles.height, abs=0.002)


class TestWrongFocalLength:
    """A focal length that is uncertain stretches the depth, and widens the bars."""

    @pytest.fixture
    def points(self):
        """A walk across the image, seen from above."""
        in_camera, _ = visible(walk(heading=np.pi / 2), pitch=20.0, away=4.0)
        return in_camera

    def test_bars_grow_with_its_deviation(self, points):
        sure = find(points, distance_sd=0.05)
        unsure = find(points, distance_sd=0.18)
        assert unsure.height_sd > 1.3 * sure.height_sd

    def test_a_wrong_one_is_in_the_bars(self, points):
        points[:, 2] *= 1.18
        floor = find(points, distance_sd=0.18)
        assert abs(floor.height - 1.5) < 2 * floor.height_sd


def draw_leaning_walk(rng):
    """Draw a walk of a body that leans by about 3 degrees."""
    lean = np.radians(rng.normal(scale=3.0, size=2))
    points = walk(seconds=4, heading=rng.uniform(0, 2 * np.pi))
    points[:, 0] += lean[0] * points[:, 1]
    points[:, 2] += lean[1] * points[:, 1]
    return points


def with_errors(points, rng):
    """Add errors as large as bars of 0.06 say: of depth above all, half of them shared
    by all frames, and one of the distance.
    """
    deviation = np.array([[0.01], [0.01], [0.06]])
    shared, frame_errors = deviation * rng.normal(size=(2, *points.shape))
    errors = (shared[:1] + frame_errors) / np.sqrt(2)
    return points * (1 + rng.normal(scale=0.04)) + errors


def test_bars_hold(rng):
    """Bodies that lean and are seen with errors as large as the bars say."""
    is_inside = []
    for _ in range(60):
        camera = rng.normal([1.4, 5, 0], [0.3, 8, 5])
        points, _ = visible(draw_leaning_walk(rng), *camera)

        floor = find(with_errors(points, rng), sd=0.06)

        found = np.array([floor.height, floor.pitch, floor.roll])
        bars = np.array([floor.height_sd, floor.pitch_sd, floor.roll_sd])
        is_inside.append(np.abs(found - camera) < 1.645 * bars)
    held = np.mean(is_inside, axis=0)
    assert (held > 0.8).all(), held


class TestFloorOfAPlane:
    """The plane a x + y + b z + g = 0, steep to both sides."""

    ABG = np.array([0.5, -0.7, 1.6])
    KNOWN = np.zeros((3, 3))

    @pytest.fixture
    def floor(self):
        return make_floor(self.ABG, self.KNOWN)

    def test_up_is_a_direction_across_it(self, floor):
        a, b, _ = self.ABG
        along_x = [1.0, -a, 0.0]
        along_z = [0.0, -b, 1.0]
        assert np.linalg.norm(floor.up) == pytest.approx(1)
        assert_allclose(floor.up @ np.transpose([along_x, along_z]), 0, atol=1e-12)
        assert floor.up[1] > 0

    def test_its_points_are_at_height_0(self, floor, rng):
        a, b, g = self.ABG
        x, z = rng.uniform(-3, 3, (2, 20))
        points = np.stack([x, -(a * x + b * z + g), z])
        _, heights, _ = floor.in_floor_frame(points)
        assert_allclose(heights, 0, atol=1e-12)

    def test_tilts_are_those_of_its_lines_across_and_ahead(self, floor):
        a, b, _ = self.ABG
        assert np.tan(np.radians(floor.roll)) == pytest.approx(a)
        assert np.tan(np.radians(floor.pitch)) == pytest.approx(b)

    def test_deviations_are_those_of_draws(self, rng):
        """Of planes, and of the size of bodies."""
        root = 0.01 * np.array([[3.0, 0, 0], [0.5, 2, 0], [-2, 2, 1]])
        draws = self.ABG + rng.standard_normal((4000, 3)) @ root.T
        floors = [make_floor(abg, self.KNOWN) for abg in draws]
        sizes = 1 + STATURE_SD * rng.standard_normal(4000)

        found = make_floor(self.ABG, root @ root.T)

        heights = sizes * [floor.height for floor in floors]
        pitch_sd = np.std([floor.pitch for floor in floors])
        roll_sd = np.std([floor.roll for floor in floors])
        assert found.height_sd == pytest.approx(heights.std(), rel=0.05)
        assert found.pitch_sd == pytest.approx(pitch_sd, rel=0.05)
        assert found.roll_sd == pytest.approx(roll_sd, rel=0.05)


def test_it_says_so_in_a_line():
    floor = Floor(
        up=np.array([0.0, 1.0, 0.0]),
        height=1.416,
        pitch=8.2,
        roll=-1.3,
        height_sd=0.06,
        pitch_sd=2.1,
        roll_sd=0.9,
    )
    assert str(floor) == (
        "camera 1.42 m (+- 0.06) above the floor, tilted 8 degrees down (+- 2), "
        "1 to the right (+- 1)"
    )
