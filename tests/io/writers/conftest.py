"""A person who walks in a known world, and the result that a perfect fit of it would
be.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest

from shapefit.geometry.cameras import TO_Y_UP
from shapefit.geometry.rotations import rotation_about_axis
from shapefit.io.layout import METRES_FROM
from shapefit.io.skeletons import PEOPLE
from shapefit.records import Fit, Shapes
from shapefit.records.columns import in_columns
from tests.columns import in_rows

X = [0, -0.1, -0.1, -0.1, 0.1, 0.1, 0.1, 0, 0, -0.18, -0.3, -0.35, 0.18, 0.3, 0.35]
Z = [1.0, 0.95, 0.5, 0.08, 0.95, 0.5, 0.08, 1.4, 1.65, 1.42, 1.15, 0.9, 1.42, 1.15, 0.9]
"""To the left and height of the joints PEOPLE, in metres."""

STRAIGHT = ("hip", "knee", "ankle", "shoulder")
"""One above the other: from ankles to shoulders are 1.34 m."""


@dataclass(frozen=True)
class Scene:
    """world (n, 3, p), z up, in metres; result what a fit of its images with the camera
    finds.
    """

    world: np.ndarray
    result: Fit

    @property
    def y_up(self) -> np.ndarray:
        return TO_Y_UP["z"] @ self.world


FOCAL = 1000.0


CENTRE = np.array([640.0, 480.0])


UNIT = 0.4
"""Metres of the unit of the dictionary."""


@pytest.fixture
def scene(rng) -> Scene:
    """Four frames at 25 Hz, a tilted camera with extrinsics, y down."""
    straight = [f"{side}{joint}" for side in "lr" for joint in STRAIGHT]
    free = ~np.isin(PEOPLE, straight)
    forward = free * rng.normal(scale=0.05, size=len(X))
    body = np.stack([X, forward, Z])
    world = body + STEPS[..., None]
    along_y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # z is up in the image
    R = rotation_about_axis(0, np.radians(20.0)) @ along_y
    result = visible(world, R, np.array([0.1, 0.2, 4.0]))
    return Scene(world, result)


def visible(
    world: np.ndarray, R: np.ndarray, t: np.ndarray, names: tuple[str, ...] = PEOPLE
) -> Fit:
    """Lay out the world as a fit under perspective does."""
    camera = (R @ world + t[:, None]) / UNIT
    origin = camera.mean(axis=2)
    depth = origin[:, 2]
    scale = FOCAL / depth
    place = CENTRE + FOCAL * origin[:, :2] / depth[:, None]
    shapes = scale[:, None, None] * (camera - origin[..., None])
    shapes[:, :2] += place[..., None]
    count = len(world)
    return Fit(
        in_rows(shapes),
        translation=place,
        scale=scale,
        landmark_names=names,
        items=tuple(f"film/anna/{i}" for i in range(count)),
        sequences=("film/anna",) * count,
        metres_per_unit=UNIT / scale,
        camera_translation=origin,
        frames=np.arange(7, 7 + count),
        file_extras={"extrinsic_rotation": R, "extrinsic_translation": t},
        unit="px",
        y_axis="down",
        frame_rate=25.0,
        attributes={METRES_FROM: "edges"},
    )


@pytest.fixture
def shapes(scene) -> Shapes:
    """The same motion as shapes in centimetres."""
    result = scene.result
    return Shapes(
        in_rows(100 * scene.world),
        landmark_names=PEOPLE,
        items=result.items,
        sequences=result.sequences,
        unit="cm",
        frame_rate=25.0,
    )


class Trc(NamedTuple):
    """What a TRC file holds, an empty cell of a point as nan."""

    first_line: list[str]
    header: dict[str, str]
    names: list[str]
    rows: np.ndarray

    @property
    def frames(self) -> np.ndarray:
        return self.rows[:, 0]

    @property
    def times(self) -> np.ndarray:
        return self.rows[:, 1]

    @property
    def points(self) -> np.ndarray:
        """The points (f, 3, p)."""
        return in_columns(self.rows[:, 2:].reshape(len(self.rows), -1, 3))

    @property
    def empty(self) -> np.ndarray:
        """The frames without any point (f,)."""
        return np.isnan(self.rows[:, 2:]).all(axis=1)


STEPS = np.array([[0, 0, 0], [0.1, 0.3, 0], [0.2, 0.6, 0.02], [0.3, 0.9, 0]])
"""Where the person is in each frame, in metres."""


def parse_trc(path) -> Trc:
    """Read a TRC file; this shares nothing with the writer or reader of the package."""
    *lines, after_last = path.read_text(encoding="utf-8").split("\n")
    assert after_last == ""
    first, keys, values, *table = [line.split("\t") for line in lines]
    header = dict(zip(keys, values, strict=True))
    widths = {len(row) for row in table}
    names_row, axes_row, *cells = table
    names = names_row[2::3]
    axes = [f"{axis}{n}" for n in range(1, len(names) + 1) for axis in "XYZ"]
    assert len(widths) == 1
    assert names_row[:2] == ["Frame#", "Time"]
    assert axes_row[2:] == axes
    rows = [[float(cell) if cell else np.nan for cell in row] for row in cells]
    return Trc(first, header, names, np.array(rows))


def trc_points(path) -> np.ndarray:
    """Return the points (f, 3, p) of a TRC file."""
    return parse_trc(path).points
