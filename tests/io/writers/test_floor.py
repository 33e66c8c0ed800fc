"""Bodies stand on the floor, where their feet show it."""

import csv
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry.floor import ABOVE_FLOOR
from shapefit.geometry.pinhole import ASSUMED_FOCAL
from shapefit.io.options import BY_DEFAULT, OutputOptions
from shapefit.io.writers.motion import find_floors
from shapefit.records import Fit, concatenate
from shapefit.records.columns import in_columns
from tests.columns import put
from tests.geometry import test_floor as planted
from tests.io.files import save
from tests.io.writers.conftest import parse_trc, trc_points, visible

SOLE = ABOVE_FLOOR["ankle"] * planted.TALL
"""How high an ankle is above the floor, in metres."""
ANKLES = [planted.JOINTS["lankle"], planted.JOINTS["rankle"]]


def seen(points, name="film/anna", **camera) -> Fit:
    """Return what a fit of these bodies finds through a tilted camera."""
    points, _ = planted.visible(points, **camera)
    turned = np.diag([1.0, -1.0, -1.0]) @ points
    result = visible(turned, np.eye(3), np.zeros(3), tuple(planted.JOINTS))
    count = len(points)
    metres_per_unit = result.column("metres_per_unit")[:, None, None]
    shape_sd = np.full_like(result.shapes, 0.05) / metres_per_unit
    result = result.without(["extrinsic_rotation", "extrinsic_translation"])
    return result.replaced(
        items=tuple(f"{name}/{i}" for i in range(count)),
        sequences=(name,) * count,
        shape_sd=shape_sd,
    )


@pytest.fixture
def walk() -> Fit:
    return seen(planted.walk())


def floors_of(result, options=BY_DEFAULT):
    """Return video -> floor."""
    return find_floors(result, options, "")


def read_rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


CAMERA = r"y up from the floor; camera 1\.\d\d m \(\+- 0\.\d\d\) above the floor, ti"
"""What is said of the camera."""


def test_the_camera_above_the_floor_is_told(tmp_path, walk):
    path = tmp_path / "man.trc"
    summary = save(path, walk)
    line = CAMERA + r"lted 1\d degr"
    axes_of_file = parse_trc(path).first_line[4]
    assert re.search(line, summary.note)
    assert re.search(line, axes_of_file)


def test_feet_are_on_the_floor(tmp_path, walk):
    path = tmp_path / "man.trc"
    save(path, walk)
    heights = trc_points(path)[:, 1][:, ANKLES]
    lower = heights.min(axis=1)
    assert np.nanmedian(lower) == pytest.approx(SOLE, abs=0.02)


def test_every_format_has_the_same_floor(tmp_path, walk):
    save(tmp_path / "man.trc", walk)
    save(tmp_path / "man.metres.csv", walk)
    points = trc_points(tmp_path / "man.trc")
    rows = read_rows(tmp_path / "man.metres.csv")
    values = [[float(row[axis]) for axis in "xyz"] for row in rows]
    table = np.reshape(values, (len(points), -1, 3))
    assert_allclose(in_columns(table), points, atol=1e-6)


def test_the_trunk_tilts_from_the_true_vertical(tmp_path, walk):
    """Of a camera that is tilted by 12 degrees."""
    save(tmp_path / "man.trc", walk)
    rows = read_rows(tmp_path / "man_angles.csv")
    tilts = [float(row["trunk_tilt"]) for row in rows]
    assert np.max(tilts) < 2


def with_extrinsics(result):
    extrinsics = {
        "extrinsic_rotation": np.eye(3),
        "extrinsic_translation": np.zeros(3),
    }
    return put(result, {}, extrinsics)


AS_IN_THE_IMAGE = "y up as in the image; position from the camera"


OTHER_CAMERAS = {
    "with extrinsics": (
        with_extrinsics,
        "y up, the axis -y of the extrinsics; position from the camera",
    ),
    "weak perspective": (
        lambda walk: walk.without(["camera_translation"]),
        "y up as in the image; lowest landmark at",
    ),
    "sitting": (lambda _: seen(planted.sitting()), AS_IN_THE_IMAGE),
    "lying": (lambda _: seen(planted.lying()), AS_IN_THE_IMAGE),
}
"""What makes a result of the walk, and what is said of its axes."""


@pytest.mark.parametrize(("change", "axes"), OTHER_CAMERAS.values(), ids=OTHER_CAMERAS)
def test_other_cameras_keep_their_axes(tmp_path, walk, change, axes):
    summary = save(tmp_path / "man.trc", change(walk))
    assert axes in summary.note


@pytest.mark.parametrize("height", [0.4, 6.0])
def test_a_given_height_does_not_decide_whether_there_is_a_floor(walk, height):
    expected = floors_of(walk)["film"]
    floor = floors_of(walk, OutputOptions(height=height))["film"]
    assert floor.pitch == pytest.approx(expected.pitch, abs=1e-6)
    assert floor.pitch_sd == pytest.approx(expected.pitch_sd, abs=1e-6)


def test_the_video_of_a_walk_has_a_floor(walk):
    assert list(floors_of(walk)) == ["film"]


def test_what_is_not_trusted_shows_no_floor(walk):
    reasons = np.array(["wide error bars"] * len(walk), dtype=object)
    assert floors_of(put(walk, {"reasons": reasons})) == {}


@pytest.fixture
def landmarks_without_ankles(walk):
    """Landmarks of the walk, in which the ankles of these images are not visible."""

    def hide(images):
        landmarks = np.zeros((len(walk), len(planted.JOINTS), 2))
        landmarks[images, ANKLES] = np.nan
        return put(walk, {"landmarks": landmarks})

    return hide


def test_what_is_never_visible_shows_no_floor(walk, landmarks_without_ankles):
    assert floors_of(landmarks_without_ankles(np.s_[:])) == {}


def test_a_gap_does_not_move_the_floor(walk, landmarks_without_ankles):
    floor = floors_of(landmarks_without_ankles(np.s_[5:8]))["film"]
    assert_array_equal(floor.up, floors_of(walk)["film"].up)


def test_individuals_of_a_video_share_the_floor_and_videos_do_not(walk):
    other_person = seen(planted.walk(heading=1.0), "film/bert", away=8.0)
    other_video = seen(planted.walk(), "other/anna", height=0.5, pitch=-5.0)
    alone = floors_of(walk)
    together = floors_of(concatenate([walk, other_person, other_video]))
    assert list(together) == ["film", "other"]
    assert together["film"].height_sd < alone["film"].height_sd
    assert together["other"].height == pytest.approx(0.5, abs=0.1)


def test_an_assumed_focal_length_widens_the_bars(walk):
    count = len(walk)
    centre = np.tile([960.0, 540.0], (count, 1))

    def height_sd(focal):
        columns = {"focal": np.full((count, 2), focal), "principal_point": centre}
        return floors_of(put(walk, columns))["film"].height_sd

    assumed = height_sd(ASSUMED_FOCAL * 1920)
    known = height_sd(1800.0)
    assert assumed > 1.04 * known
