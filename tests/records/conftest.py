"""Small records of every kind."""

import numpy as np
import pytest

from shapefit.records import Fit, Landmarks, Shapes

NAMES = ("head", "left hand", "right hand", "foot")


@pytest.fixture
def shapes(rng) -> Shapes:
    """Five shapes of two sequences, with meshes."""
    return Shapes(
        rng.normal(size=(5, 4, 3)),
        landmark_names=NAMES,
        items=tuple(f"walk/{i}" for i in range(5)),
        sequences=("walk",) * 3 + ("run",) * 2,
        edges=np.array([[0, 1], [0, 2], [0, 3]]),
        mirror_index=np.array([0, 2, 1, 3]),
        mesh_vertices=rng.normal(size=(5, 6, 3)),
        mesh_faces=np.array([[0, 1, 2], [3, 4, 5]]),
        unit="m",
        extras={"weight": rng.normal(size=5)},
    )


@pytest.fixture
def landmarks(rng) -> Landmarks:
    """Five images of two sequences, in one of which a landmark is unseen."""
    points = rng.normal(size=(5, 4, 2))
    points[1, 2] = np.nan
    return Landmarks(
        points,
        confidence=rng.uniform(size=(5, 4)),
        landmark_names=NAMES,
        items=tuple(f"image {i}" for i in range(5)),
        sequences=("a", "a", "b", "b", "b"),
        frames=np.array([0, 1, 0, 1, 3]),
        unit="px",
        extras={"true_rotation": rng.normal(size=(5, 3, 3))},
        file_extras={"camera_matrix": np.eye(3)},
    )


@pytest.fixture
def fit(rng, landmarks) -> Fit:
    """A convex fit of these images, of which two failed."""
    return Fit(
        rng.normal(size=(5, 4, 3)),
        landmark_names=NAMES,
        items=landmarks.items,
        sequences=landmarks.sequences,
        coefficients=rng.normal(size=(5, 7)),
        status=np.array(["optimal"] * 4 + ["iteration limit"], object),
        trusted=np.array([True, False, True, True, False]),
        transform_count=np.array([2, 0, 1, 3, 0]),
        transform_atom=np.array([4, 5, 6, 0, 1, 2]),
        active_transforms=np.arange(36.0).reshape(6, 2, 3),
        attributes={"method": "convex"},
        failures={"image 1": "no landmark", "image 3": "too few"},
    )
