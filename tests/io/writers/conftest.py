"""A person who walks in a known world, and the result that a perfect fit of it would be."""

from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.geometry.cameras import TO_Y_UP
from shapefit.io.layout import METRES_FROM, METRES_PER_UNIT
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.io.skeletons import PEOPLE

HEIGHTS = {
    "pelvis": (0, 1.0),
    "rhip": (-0.1, 0.95),
    "rknee": (-0.1, 0.5),
    "rankle": (-0.1, 0.08),
    "lhip": (0.1, 0.95),
    "lknee": (0.1, 0.5),
    "lankle": (0.1, 0.08),
    "neck": (0, 1.4),
    "head": (0, 1.65),
    "rshoulder": (-0.18, 1.42),
    "relbow": (-0.3, 1.15),
    "rwrist": (-0.35, 0.9),
    "lshoulder": (0.18, 1.42),
    "lelbow": (0.3, 1.15),
    "lwrist": (0.35, 0.9),
}
"""x and height of the joints, in metres."""

STRAIGHT = ("hip", "knee", "ankle", "shoulder")
"""One above the other: from ankles to shoulders are 1.34 m."""

FOCAL, CENTRE = 1000.0, np.array([640.0, 480.0])


@dataclass(frozen=True)
class Scene:
    """world (n, 3, p), z up, in metres; result what a fit of its images with the camera finds."""

    world: np.ndarray
    result: ResultSet

    @property
    def y_up(self) -> np.ndarray:
        return TO_Y_UP["z"] @ self.world


@pytest.fixture
def scene(rng) -> Scene:
    """Four frames at 25 Hz, a tilted camera with extrinsics, y down."""
    x, z = np.array([HEIGHTS[joint] for joint in PEOPLE]).T
    free = ~np.isin(PEOPLE, [f"{side}{joint}" for side in "lr" for joint in STRAIGHT])
    body = np.stack([x, free * rng.normal(scale=0.05, size=len(x)), z])
    steps = np.array([[0.0, 0.0, 0.0], [0.1, 0.3, 0.0], [0.2, 0.6, 0.02], [0.3, 0.9, 0.0]])
    world = body + steps[..., None]
    tilt = np.radians(20)
    level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along y; z is up in the image
    c, s = np.cos(tilt), np.sin(tilt)
    R = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]) @ level
    t = np.array([0.1, 0.2, 4.0])
    return Scene(world, visible(world, R, t))


def visible(
    world: np.ndarray, R: np.ndarray, t: np.ndarray, names: tuple[str, ...] = PEOPLE
) -> ResultSet:
    """Lay out the world as a fit under perspective does; the unit of the dictionary is 0.4 m."""
    X = (R @ world + t[:, None]) / 0.4
    origin = X.mean(axis=2)
    S = X - origin[..., None]
    scale = FOCAL / origin[:, 2]
    place = CENTRE + FOCAL * origin[:, :2] / origin[:, 2:]
    shapes = scale[:, None, None] * S
    shapes[:, :2] += place[..., None]
    n = len(world)
    return ResultSet(
        shapes=shapes,
        translation=place,
        scale=scale,
        landmark_names=names,
        items=tuple(f"film/anna/{i}" for i in range(n)),
        sequences=("film/anna",) * n,
        columns={
            METRES_PER_UNIT: 0.4 / scale,
            "camera_translation": origin,
            "frame": np.arange(7, 7 + n),
            "extrinsic_rotation": R,
            "extrinsic_translation": t,
        },
        unit="px",
        y_axis="down",
        frame_rate=25.0,
        attributes={METRES_FROM: "edges"},
    )


@pytest.fixture
def shapes(scene) -> ShapeSet:
    """The same motion as shapes in centimetres."""
    result = scene.result
    return ShapeSet(
        100 * scene.world, PEOPLE, result.items, result.sequences, unit="cm", frame_rate=25.0
    )


@pytest.fixture
def without():
    """Return a result without some of its datasets."""

    def reduced(result: ResultSet, *names: str) -> ResultSet:
        return result.without(names)

    return reduced


@pytest.fixture
def facing():
    """Return the same result as it is found in landmarks whose y points this way."""

    def turned(result: ResultSet, y_axis: str) -> ResultSet:
        if y_axis == "down":
            return result
        turn = np.array([1.0, -1.0, -1.0])
        t = result.columns["camera_translation"] * turn
        return result.replaced(
            shapes=turn[:, None] * result.shapes,
            translation=result.translation * turn[:2],
            further=result.further | {"camera_translation": t},
            y_axis="up",
        )

    return turned
