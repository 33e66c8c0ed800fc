"""The camera: measured, stated about the centre of the image, assumed, or none; and its
lens.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config import FitConfig
from shapefit.convex.solver import Status
from shapefit.errors import InputError
from shapefit.geometry.pinhole import ASSUMED_FOCAL, complete_coefficients, distort
from shapefit.geometry.rotations import rotation_angle
from shapefit.io import (
    read_shapes,
    write_dictionary,
)
from shapefit.pipelines.fit.camera import (
    camera_factory,
    choose_camera,
    find_camera,
    remove_distortion,
)
from shapefit.pipelines.verify import Request
from shapefit.pipelines.verify import verify_results as run_verify
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.io.files import load, save
from tests.pipelines.fitted import failures

SIZE = np.array([1280, 720])
MATRIX = np.array([[800.0, 0, 640], [0, 820, 360], [0, 0, 1]])
SKEWED = MATRIX + np.array([[0, 30.0, 0], [0, 0, 0], [0, 0, 0]])
CENTRE = (640.0, 360.0)
ASSUMED = ASSUMED_FOCAL * 1280
OF_FILES = [800, 820]


def box(width=300.0, height=400.0, n=6):
    """Points (n, 4, 2): the corners of a box in each image."""
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]])
    return np.tile(corners + np.array([300.0, 100.0]), (n, 1, 1))


def images(points=None, unit="px", per_item=None, **whole):
    """Return images of points, those of a box unless others are given."""
    if points is None:
        points = box()
    return Landmarks(
        points,
        landmark_names=tuple("abcd"),
        items=tuple(f"{i:03}" for i in range(len(points))),
        unit=unit,
        extras=per_item or {},
        file_extras=whole,
    )


def choose(images, method="posterior", image_size=None, from_landmarks=False, **camera):
    """Return the cameras that were chosen, None for weak perspective, and the line
    about them.
    """
    keys = {"method": method, "camera": camera, "image_size": image_size}
    config = FitConfig(landmarks=[__file__], output="b.h5", **keys)
    chosen, line = choose_camera(config, images, from_landmarks=from_landmarks)
    cameras = camera_factory(config.changed(camera=chosen).camera)
    return None if cameras is None else cameras(images), line


MIXED = {"image_size": np.arange(1, 13).reshape(6, 2)}
"""Sizes that differ from image to image."""
SMALL = box(60, 80, n=3)
LARGE = 4 * box(n=1)


SIZED = images(image_size=SIZE)


MEASURED = images(camera_matrix=MATRIX)


EACH_SIZED = images(per_item={"image_size": np.tile(SIZE, (6, 1))})


PERSPECTIVE = [
    # the image's centre is the principal point wherever a size is known
    (SIZED, {}, ASSUMED, CENTRE, "focal length 1408 px (assumed"),
    (EACH_SIZED, {}, ASSUMED, CENTRE, "1280 x 720"),
    (images(), {"image_size": (1280, 720)}, ASSUMED, CENTRE, "image 1280 x 720"),
    (SIZED, {"focal": 1674}, 1674, CENTRE, "1674 px, principal point 640"),
    (images(), {"focal": 9, "principal_point": (90, 50)}, 9, (90, 50), "point 90, 50"),
    (SIZED, {"focal": 9, "method": "convex+refine"}, 9, CENTRE, "9 px"),
    # measured cameras are taken as they are
    (
        images(camera_matrix=MATRIX, image_size=SIZE),
        {},
        OF_FILES,
        CENTRE,
        "of the files",
    ),
    (MEASURED, {"focal": "files"}, OF_FILES, CENTRE, "of the files"),
    (images(camera_matrix=SKEWED), {}, OF_FILES, CENTRE, "of the files"),
    (
        MEASURED,
        {"focal": "files", "principal_point": (1, 2)},
        OF_FILES,
        (1, 2),
        "of the files",
    ),
]
"""Images, keys, the focal length and principal point that follow, and what is said."""


WEAK_PERSPECTIVE = [
    (images(), {}, "exact positions in metres need --image-size"),
    (images(image_size=np.array([0, 5])), {}, "not known"),
    (images(per_item=MIXED), {}, "not known"),
    (images(unit="m", image_size=SIZE), {}, "not in pixels"),
    (images(box(100, 80), image_size=SIZE), {}, "cover little"),
    (images(np.concatenate([SMALL, LARGE]), image_size=SIZE), {}, "cover little"),
    (SIZED, {"focal": "none"}, "weak perspective"),
    (SIZED, {"method": "convex"}, "weak perspective"),
    (SIZED, {"from_landmarks": True}, "class was learned"),
]
"""Images, keys, and what is said."""


@pytest.mark.parametrize(("images", "keys", "focal", "centre", "text"), PERSPECTIVE)
def test_the_camera(images, keys, focal, centre, text):
    camera, line = choose(images, **keys)
    assert text in line
    assert_allclose(camera.focal, np.broadcast_to(focal, (6, 2)))
    assert_array_equal(camera.centre, np.tile(centre, (6, 1)))


@pytest.mark.parametrize(("images", "keys", "text"), WEAK_PERSPECTIVE)
def test_no_camera(images, keys, text):
    camera, line = choose(images, **keys)
    assert camera is None
    assert text in line


def test_cameras_of_single_images():
    matrices = MATRIX * np.arange(1, 7)[:, None, None]
    matrices[:, 2, 2] = 1
    camera = find_camera(images(per_item={"camera_matrix": matrices}))
    assert_array_equal(camera.focal, matrices[:, [0, 1], [0, 1]])
    assert_array_equal(camera.centre, matrices[:, :2, 2])


NO_CAMERAS = [
    (
        np.zeros((6, 2)),
        r"shape \(6, 2\), or is not finite; give \(3, 3\) finite numbers",
    ),
    (np.array(["a"] * 6), r"shape \(6,\)"),
    (MATRIX.T, "impossible camera matrix; give matrices with rows fx 0 cx"),
    (2 * MATRIX, "impossible camera matrix"),
    (MATRIX * [[-1.0], [1], [1]], "impossible camera matrix"),
    (MATRIX * np.array([[1, 1, np.inf]] * 3), "not finite"),
    (MATRIX + 0j, "not finite"),
]
"""Values of a dataset `camera_matrix`, and what is said."""


@pytest.mark.parametrize(
    ("images", "method"),
    [
        (images(), "posterior"),
        (images(), "convex+refine"),
        (images(per_item=MIXED), "posterior"),
    ],
)
def test_a_focal_length_without_a_size_asks_for_it(images, method):
    with pytest.raises(InputError, match="--image-size WxH"):
        choose(images, method, focal=1674)


@pytest.mark.parametrize(("values", "message"), NO_CAMERAS)
def test_what_is_no_camera_is_refused(values, message):
    with pytest.raises(InputError, match=f"camera_matrix: .*{message}"):
        choose(images(camera_matrix=values), focal="files")


def test_files_without_a_camera_are_refused_where_it_is_asked_for():
    message = "camera_matrix: .*no such dataset; .*CSV holds no datasets"
    with pytest.raises(InputError, match=message):
        choose(images(), focal="files")


@pytest.fixture
def cars_file(tmp_path, made_cars):
    path = tmp_path / "cars.h5"
    write_dictionary(path, made_cars)
    return path


@pytest.fixture
def views_file(project):
    return project / "sample_data" / "cars_views.h5"


@pytest.fixture
def refine(fit, cars_file, views_file):
    """Refine views of cars as a camera sees them."""

    def refine(**camera):
        keys = {"method": "convex+refine", "lam": 1.0, "camera": camera}
        result, outcomes = fit(cars_file, views_file, **keys)
        assert not failures(outcomes)
        return result

    return refine


def median_residual(fitted, seen):
    """Return the median of the distances of images from what was seen."""
    mean_square = np.nanmean((fitted - seen) ** 2, axis=(1, 2))
    return np.median(np.sqrt(mean_square))


def test_cars_are_found_better_through_their_camera(refine, views_file):
    views = load(views_file)
    R = np.asarray(views.column("true_rotation"), float)
    weak = refine()
    full = refine(focal="files")
    turn_weak = np.median(rotation_angle(weak.rotation, R))
    turn_full = np.median(rotation_angle(full.rotation, R))
    residual_weak = median_residual(weak.shapes[..., :2], views.landmarks)
    residual_full = median_residual(full.landmarks_fitted, views.landmarks)
    assert turn_full < 0.5 * turn_weak
    assert residual_full < 0.5 * residual_weak
    assert set(full.status) == {Status.CONVERGED.value}


def test_cars_are_found_in_their_place(refine, views_file, project):
    """The distance is to the middle of the landmarks, whose size the dictionary
    knows.
    """
    views = load(views_file)
    cars = read_shapes([project / "sample_data" / "cars.h5"])
    result = refine(focal="files")
    R = np.asarray(views.column("true_rotation"), float)
    shown = [cars.items.index(name) for name in views.column("true_model")]
    middle = cars.shapes.mean(axis=1)[shown]
    truth = np.einsum("nij,nj->ni", R, middle) + views.column("true_translation")
    error = np.linalg.norm(result.column("position") - truth, axis=1)
    assert np.median(error / truth[:, 2]) < 0.05


@pytest.fixture
def car_images(made_cars):
    """Make images (4, 2, p) of cars, before a camera, in pixels."""

    def make(plane, **datasets):
        focal = np.diag(MATRIX)[:2]
        return Landmarks(
            in_rows(plane) * focal + CENTRE,
            landmark_names=made_cars.landmark_names,
            items=tuple("abcd"),
            unit="px",
            y_axis="down",
            file_extras={"camera_matrix": MATRIX, **datasets},
        )

    return make


@pytest.fixture
def plane(made_cars):
    """Where four cars are on the plane at depth 1."""
    shapes = made_cars.atoms[:4] + np.array([[0.2], [0.1], [7.0]])
    return shapes[:, :2] / shapes[:, 2:]


@pytest.fixture
def straight(car_images, plane):
    return car_images(plane)


@pytest.fixture
def bent(car_images, plane):
    """The same cars as a lens with distortion shows them."""
    distorted, *_ = distort(plane, complete_coefficients(LENS))
    return car_images(distorted, distortion=LENS)


@pytest.fixture
def fit_cars(fit, cars_file):
    """Fit images with the cars; return the result."""

    def fit_cars(images, **keys):
        result, _ = fit(cars_file, images, **keys)
        return result

    return fit_cars


@pytest.fixture
def verify(tmp_path, cars_file):
    """Verify the last result with these images; return the failures."""

    def verify(images):
        path = tmp_path / "given.h5"
        save(path, images)
        request = Request(tmp_path / "result.h5", cars_file, (path,))
        return failures(run_verify(request))

    return verify


def test_a_distorted_image_fits_like_a_straight_one(straight, bent, fit_cars):
    """Solved so closely that what is left of the lens, 1e-8 of a pixel, counts more
    than what the solver leaves of the gap.
    """
    expected = fit_cars(straight, tolerance=1e-10)
    result = fit_cars(bent, tolerance=1e-10)
    size = np.abs(expected.shapes).max()
    difference = np.abs(result.shapes - expected.shapes).max()
    assert difference / size < 1e-7


def test_a_result_says_which_lens_was_removed(straight, bent, fit_cars):
    result = fit_cars(bent)
    assert_allclose(result.landmarks, straight.landmarks, atol=1e-8)
    assert_array_equal(result.column("removed_distortion"), LENS)
    assert result.column("distortion") is None


def test_a_lens_is_removed_once(bent):
    once = remove_distortion(bent, None)
    twice = remove_distortion(once, None)
    assert_array_equal(twice.landmarks, once.landmarks)


def test_verification_removes_the_lens_too(bent, fit_cars, verify):
    fit_cars(bent, tolerance=1e-10)
    landmarks = bent.landmarks.copy()
    landmarks[2] += 1e-3
    assert "c" not in verify(bent)
    assert "c" in verify(bent.replaced(landmarks=landmarks))


@pytest.fixture
def calibrated(bent, fit_cars, tmp_path):
    """The result of images that know nothing of their camera, by its calibration."""
    path = tmp_path / "calibration.toml"
    path.write_text(CALIBRATION)
    camera = {"calibration": path, "name": "left"}
    bare = bent.replaced(file_extras={})
    return fit_cars(bare, camera=camera, method="convex+refine")


def test_a_calibration_gives_camera_and_lens(calibrated, straight, fit_cars):
    expected = fit_cars(straight, camera={"focal": "files"}, method="convex+refine")
    focal = np.tile([800, 820], (4, 1))
    assert_allclose(calibrated.shapes, expected.shapes, atol=1e-4)
    assert_array_equal(calibrated.column("image_size"), SIZE)
    assert_allclose(calibrated.column("focal"), focal)


def test_a_calibration_gives_the_place_of_the_camera(calibrated):
    translation = calibrated.column("extrinsic_translation")
    assert_array_equal(translation, [1, 2, 3])
    assert calibrated.column("extrinsic_rotation").shape == (3, 3)


def test_a_result_by_a_calibration_is_verified(calibrated, tmp_path, cars_file):
    request = Request(tmp_path / "result.h5", cars_file, (tmp_path / "views.h5",))
    assert not failures(run_verify(request))


def test_cameras_of_single_images_and_y_that_points_up(straight, bent):
    flip = np.array([1.0, -1.0])
    turned = MATRIX.copy()
    turned[1, 2] = -turned[1, 2]
    extras = {
        "camera_matrix": np.tile(turned, (4, 1, 1)),
        "distortion": np.tile(LENS, (4, 1)),
    }
    up = bent.replaced(
        landmarks=bent.landmarks * flip, y_axis="up", extras=extras, file_extras={}
    )
    result = remove_distortion(up, None)
    assert_allclose(result.landmarks * flip, straight.landmarks, atol=1e-8)
    assert result.column("removed_distortion").shape == (4, 5)


LENS = np.array([-0.25, 0.08, 0.002, -0.001, 0.0])
CALIBRATION = """
[cam_0]
name = 'left'
size = [1280, 720]
matrix = [[800.0, 0.0, 640.0], [0.0, 820.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [-0.25, 0.08, 0.002, -0.001, 0.0]
rotation = [0.1, 0.2, 0.3]
translation = [1.0, 2.0, 3.0]
"""
