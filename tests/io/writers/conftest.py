"""A person who walks in a known world, and the result that a perfect fit of it would
be.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.geometry.cameras import TO_Y_UP
from shapefit.io.layout import METRES_FROM
from shapefit.io.skeletons import PEOPLE
from shapefit.records import Fit, Shapes

X = [0, -0.1, -0.1, -0.1, 0.1, 0.1, 0.1, 0, 0, -0.18, -0.3, -0.35, 0.18, 0.3, 0.35]
Z = [1.0, 0.95, 0.5, 0.08, 0.95, 0.5, 0.08, 1.4, 1.65, 1.42, 1.15, 0.9, 1.42, 1.15, 0.9]
"""To the left and height of the joints PEOPLE, in metres."""

STRAIGHT = ("hip", "knee", "ankle", "shoulder")
"""One above the other: from ankles to shoulders are 1.34 m."""

FOCAL, CENTRE = 1000.0, np.array([640.0, 480.0])


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


@pytest.fixture
def scene(rng) -> Scene:
    """Four frames at 25 Hz, a tilted camera with extrinsics, y down."""
    free = ~np.isin(PEOPLE, [f"{side}{joint}" for side in "lr" for joint in STRAIGHT])
    body = np.stack([X, free * rng.normal(scale=0.05, size=len(X)), Z])
    steps = np.array(
        [[0.0, 0.0, 0.0], [0.1, 0.3, 0.0], [0.2, 0.6, 0.02], [0.3, 0.9, 0.0]]
    )
    world = body + steps[..., None]
    level = np.array(
        [[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]
    )  # looks along y; z is up in the image
    c = np.cos(np.radians(20))
    s = np.sin(np.radians(20))
    R = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]) @ level
    return Scene(world, visible(world, R, np.array([0.1, 0.2, 4.0])))


def visible(
    world: np.ndarray, R: np.ndarray, t: np.ndarray, names: tuple[str, ...] = PEOPLE
) -> Fit:
    """Lay out the world as a fit under perspective does; the unit of the dictionary is
    0.4 m.
    """
    camera = (R @ world + t[:, None]) / 0.4
    origin = camera.mean(axis=2)
    scale = FOCAL / origin[:, 2]
    place = CENTRE + FOCAL * origin[:, :2] / origin[:, 2:]
    shapes = scale[:, None, None] * (camera - origin[..., None])
    shapes[:, :2] += place[..., None]
    n = len(world)
    return Fit(
        shapes.swapaxes(1, 2),
        translation=place,
        scale=scale,
        landmark_names=names,
        items=tuple(f"film/anna/{i}" for i in range(n)),
        sequences=("film/anna",) * n,
        metres_per_unit=0.4 / scale,
        camera_translation=origin,
        frames=np.arange(7, 7 + n),
        file_extras={"extrinsic_rotation": R, "extrinsic_translation": t},
        unit="px",
        y_axis="down",
        frame_rate=25.0,
        attributes={METRES_FROM: "edges"},
    )


@pytest.fixture
def shapes(scene) -> Shapes:
    """The same motion as shapes in centimetres."""
    points, of = 100 * scene.world, scene.result
    return Shapes(
        points.swapaxes(1, 2),
        landmark_names=PEOPLE,
        items=of.items,
        sequences=of.sequences,
        unit="cm",
        frame_rate=25.0,
    )


def parse_trc(path):
    """Return the first line, the header, the names, and the numbers (f, 2 + 3 p), nan
    if empty.

    It shares nothing with the writer and the reader of the package.
    """
    lines = path.read_text(encoding="utf-8").split("\n")
    assert lines.pop() == ""
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    cells = [line.split("\t") for line in lines[3:]]
    assert len({len(row) for row in cells}) == 1
    names, axes = cells[0][2::3], cells[1][2:]
    assert cells[0][:2] == ["Frame#", "Time"]
    assert axes == [f"{axis}{n}" for n in range(1, len(names) + 1) for axis in "XYZ"]
    rows = [[float(cell) if cell else np.nan for cell in row] for row in cells[2:]]
    return lines[0].split("\t"), header, names, np.array(rows)


def trc_points(path):
    """Return the points (f, 3, p) of a TRC file."""
    rows = parse_trc(path)[3][:, 2:]
    return rows.reshape(len(rows), -1, 3).swapaxes(1, 2)
