"""The camera where none is given."""

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.default_camera import FOCAL, with_camera, without_camera

SIZE = np.array([1920, 1080])
MATRIX = np.array([[2500.0, 0, 900], [0, 2500, 500], [0, 0, 1]])


def config(method="posterior", **camera):
    files = {"landmarks": ["a.h5"], "dictionary": "people", "output": "b.h5"}
    return FitConfig.model_construct(
        **FitConfig.model_construct(**files).__dict__ | {"method": method}
    ).model_copy(update={"camera": FitConfig.model_fields["camera"].annotation(**camera)})


def images(rng, size=500.0, at=(700.0, 300.0), unit="px", **whole):
    return LandmarkSet(
        landmarks=np.array(at)[:, None] + size * rng.random((6, 2, 8)),
        landmark_names=tuple("abcdefgh"),
        items=tuple("123456"),
        unit=unit,
        columns={**whole},
    )


def test_the_size_of_the_image_gives_focal_length_and_centre(rng):
    found, (line,) = with_camera(config(), images(rng, image_size=SIZE))
    assert found.camera.model == "perspective"
    assert found.camera.focal == pytest.approx(FOCAL * 1920)
    assert found.camera.principal_point == (960.0, 540.0)
    assert "1920 x 1080" in line


def test_without_a_size_the_landmarks_are_its_measure(rng):
    spread = images(rng, size=300.0)
    moved = spread.landmarks + np.linspace(0, 900, 6)[:, None, None]
    seen = LandmarkSet(
        landmarks=moved, landmark_names=spread.landmark_names, items=spread.items, unit="px"
    )
    found, _ = with_camera(config(), seen)
    assert found.camera.focal == pytest.approx(FOCAL * moved.max())
    found, _ = with_camera(config(image_size=[2000, 1500]), seen)
    assert found.camera.focal == pytest.approx(FOCAL * 2000)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"unit": "m"}, None),
        ({"unit": "unknown", "at": (-250.0, -250.0)}, None),
        ({"size": 40.0, "image_size": SIZE}, "cover little"),
        ({"at": (0.0, 0.0)}, "may be crops"),
    ],
)
def test_weak_perspective_stays_where_perspective_cannot_be_known(rng, changes, line):
    found, said = with_camera(config(), images(rng, **changes))
    assert found.camera.model == "weak-perspective"
    assert (said == ()) if line is None else (line in said[0])


def test_the_camera_of_the_files_goes_first(rng):
    found, _ = with_camera(config(), images(rng, camera_matrix=MATRIX, image_size=SIZE))
    assert found.camera.intrinsics == "camera_matrix"
    wide = MATRIX * [[0.3, 1, 1], [1, 0.3, 1], [1, 1, 1]]
    found, _ = with_camera(config(), images(rng, camera_matrix=wide, image_size=SIZE))
    assert found.camera.focal == pytest.approx(FOCAL * 1920)
    assert found.camera.principal_point == (900.0, 500.0)
    skewed = MATRIX + np.array([[0, 30, 0], [0, 0, 0], [0, 0, 0]])
    found, _ = with_camera(config(), images(rng, camera_matrix=skewed))
    assert found.camera.focal == pytest.approx(2500)


def test_what_is_given_stays_and_other_methods_do_without(rng):
    seen = images(rng, image_size=SIZE)
    given = config(model="weak-perspective")
    assert with_camera(given, seen) == (given, ())
    assert without_camera(config("convex")).camera.model == "weak-perspective"
