"""The camera: measured, stated about the centre of the image, assumed, or none; and its
lens.
"""

import numpy as np
import pytest

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
    undistorted,
)
from shapefit.pipelines.verify import Request
from shapefit.pipelines.verify import verify_results as run_verify
from shapefit.records import Landmarks
from tests.io.files import load, save
from tests.pipelines.fitted import failures

SIZE = np.array([1280, 720])
MATRIX = np.array([[800.0, 0, 640], [0, 820, 360], [0, 0, 1]])
SKEWED = MATRIX + np.array([[0, 30.0, 0], [0, 0, 0], [0, 0, 0]])
CENTRE = (640.0, 360.0)
ASSUMED = ASSUMED_FOCAL * 1280
OF_FILES = [800, 820]


def box(width=300.0, height=400.0, n=6):
    """Points (n, 2, 4): the corners of a box in each image."""
    corners = np.array([[0, width, 0, width], [0, 0, height, height]], dtype=np.float64)
    return np.tile(np.array([300.0, 100.0])[:, None] + corners, (n, 1, 1))


def images(points=None, unit="px", per_item=None, **whole):
    points = box() if points is None else points
    items = tuple(f"{i:03}" for i in range(len(points)))
    names = tuple("abcd")
    return Landmarks(
        points.swapaxes(1, 2),
        landmark_names=names,
        items=items,
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
SMALL = box(60, 80, n=3)
LARGE = 4 * box(n=1)


@pytest.mark.parametrize(
    ("images", "keys", "focal", "centre", "text"),
    [
        # the image's centre is the principal point wherever a size is known
        (images(image_size=SIZE), {}, ASSUMED, CENTRE, "focal length 1408 px (assumed"),
        (
            images(per_item={"image_size": np.tile(SIZE, (6, 1))}),
            {},
            ASSUMED,
            CENTRE,
            "1280 x 720",
        ),
        (images(), {"image_size": (1280, 720)}, ASSUMED, CENTRE, "image 1280 x 720"),
        (
            images(image_size=SIZE),
            {"focal": 1674},
            1674,
            CENTRE,
            "1674 px, principal point 640",
        ),
        (
            images(),
            {"focal": 9, "principal_point": (90, 50)},
            9,
            (90, 50),
            "point 90, 50",
        ),
        (
            images(image_size=SIZE),
            {"focal": 9, "method": "convex+refine"},
            9,
            CENTRE,
            "9 px",
        ),
        # without a size: weak perspective
        (images(), {}, None, None, "exact positions in metres need --image-size"),
        (images(image_size=np.array([0, 5])), {}, None, None, "not known"),
        (images(per_item=MIXED), {}, None, None, "not known"),
        (images(unit="m", image_size=SIZE), {}, None, None, "not in pixels"),
        (images(box(100, 80), image_size=SIZE), {}, None, None, "cover little"),
        (
            images(np.concatenate([SMALL, LARGE]), image_size=SIZE),
            {},
            None,
            None,
            "cover little",
        ),
        (images(image_size=SIZE), {"focal": "none"}, None, None, "weak perspective"),
        (images(image_size=SIZE), {"method": "convex"}, None, None, "weak perspective"),
        (
            images(image_size=SIZE),
            {"from_landmarks": True},
            None,
            None,
            "class was learned",
        ),
        # measured cameras are taken as they are
        (
            images(camera_matrix=MATRIX, image_size=SIZE),
            {},
            OF_FILES,
            CENTRE,
            "of the files",
        ),
        (
            images(camera_matrix=MATRIX),
            {"focal": "files"},
            OF_FILES,
            CENTRE,
            "of the files",
        ),
        (images(camera_matrix=SKEWED), {}, OF_FILES, CENTRE, "of the files"),
        (
            images(camera_matrix=MATRIX),
            {"focal": "files", "principal_point": (1, 2)},
            OF_FILES,
            (1, 2),
            "of the files",
        ),
    ],
)
def test_the_camera(images, keys, focal, centre, text):
    camera, line = choose(images, **keys)
    assert text in line
    assert (camera is None) == (focal is None)
    if camera is not None:
        np.testing.assert_allclose(camera.focal, np.broadcast_to(focal, (6, 2)))
        np.testing.assert_array_equal(camera.centre, np.tile(centre, (6, 1)))


def test_cameras_of_single_images():
    each = MATRIX * np.arange(1, 7)[:, None, None]
    each[:, 2, 2] = 1
    camera = find_camera(images(per_item={"camera_matrix": each}))
    np.testing.assert_array_equal(camera.focal, each[:, [0, 1], [0, 1]])
    np.testing.assert_array_equal(camera.centre, each[:, :2, 2])


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


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (None, "no such dataset; .*CSV holds no datasets"),
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
    ],
)
def test_what_is_no_camera_is_refused(values, message):
    given = {} if values is None else {"camera_matrix": values}
    with pytest.raises(InputError, match=f"camera_matrix: .*{message}"):
        choose(images(**given), focal="files")


class TestPerspective:
    """Cars that are refined as a camera sees them."""

    @pytest.fixture
    def fit(self, fit, project, tmp_path, made_cars):
        """Return what fits the views through a camera."""

        def fitted(**camera):
            write_dictionary(tmp_path / "dictionary.h5", made_cars)
            views = project / "sample_data" / "cars_views.h5"
            keys = {"method": "convex+refine", "lam": 1.0, "camera": camera}
            result, outcomes = fit(tmp_path / "dictionary.h5", views, **keys)
            assert not failures(outcomes)
            return result

        return fitted

    def test_cars_are_found_better_and_in_their_place(self, fit, project):
        """The distance is to the middle of the landmarks, whose size the dictionary
        knows.
        """
        views = load(project / "sample_data" / "cars_views.h5")
        cars = read_shapes([project / "sample_data" / "cars.h5"])
        R = np.asarray(views.column("true_rotation"), float)
        weak = fit()
        full = fit(focal="files")
        errors = [
            np.median(rotation_angle(result.rotation, R)) for result in (weak, full)
        ]
        assert errors[1] < 0.5 * errors[0]
        residuals = [
            np.median(np.sqrt(np.nanmean((fitted - views.landmarks) ** 2, axis=(1, 2))))
            for fitted in (weak.shapes[..., :2], full.landmarks_fitted)
        ]
        assert residuals[1] < 0.5 * residuals[0]
        assert set(full.status) == {Status.CONVERGED.value}
        shown = [cars.items.index(name) for name in views.column("true_model")]
        truth = np.einsum("nij,nj->ni", R, cars.as_columns().mean(axis=2)[shown])
        truth += views.column("true_translation")
        error = np.linalg.norm(full.column("position") - truth, axis=1)
        assert np.median(error / truth[:, 2]) < 0.05


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


class TestLens:
    """Distortion is removed before a fit, once, and the result says so."""

    @pytest.fixture
    def views(self, made_cars):
        """Cars before a camera, as a lens without and with distortion shows them, in
        pixels.
        """
        shapes = made_cars.atoms[:4] + np.array([[0.2], [0.1], [7.0]])
        plane = shapes[:, :2] / shapes[:, 2:]

        def images(points, **datasets):
            return Landmarks(
                (MATRIX[:2, 2, None] + np.diag(MATRIX)[:2, None] * points).swapaxes(
                    1, 2
                ),
                landmark_names=made_cars.landmark_names,
                items=tuple("abcd"),
                unit="px",
                y_axis="down",
                file_extras={"camera_matrix": MATRIX, **datasets},
            )

        return images(plane), images(
            distort(plane, complete_coefficients(LENS))[0], distortion=LENS
        )

    @pytest.fixture
    def fit(self, fit, tmp_path, made_cars):
        """Return what fits images with the cars."""

        def fitted(images, **keys):
            write_dictionary(tmp_path / "cars.h5", made_cars)
            return fit(tmp_path / "cars.h5", images, **keys)[0]

        return fitted

    def test_a_distorted_image_fits_like_a_straight_one(self, views, fit, tmp_path):
        # Solved so closely that what is left of the lens, 1e-8 of a pixel, counts more
        # than what the solver leaves of the gap.
        straight, bent = views
        expected, result = (fit(images, tolerance=1e-10) for images in (straight, bent))
        size = np.abs(expected.shapes).max()
        off = np.abs(result.shapes - expected.shapes).max() / size
        assert off < 1e-7
        np.testing.assert_allclose(result.landmarks, straight.landmarks, atol=1e-8)
        np.testing.assert_array_equal(result.column("removed_distortion"), LENS)
        assert result.column("distortion") is None
        once = undistorted(bent, None)
        np.testing.assert_array_equal(
            undistorted(once, None).as_columns(), once.as_columns()
        )

        def verify(images):
            save(tmp_path / "given.h5", images)
            request = Request(
                tmp_path / "result.h5", tmp_path / "cars.h5", (tmp_path / "given.h5",)
            )
            return failures(run_verify(request))

        assert "c" not in verify(bent)
        shifted = bent.as_columns() + 1e-3 * (np.arange(4) == 2)[:, None, None]
        assert "c" in verify(bent.replaced(landmarks=shifted.swapaxes(1, 2)))

    def test_a_calibration_gives_camera_lens_and_place(self, views, fit, tmp_path):
        straight, bent = views
        (tmp_path / "calibration.toml").write_text(CALIBRATION)
        camera = {"calibration": tmp_path / "calibration.toml", "name": "left"}
        expected = fit(straight, camera={"focal": "files"}, method="convex+refine")
        bare = bent.replaced(file_extras={})
        result = fit(bare, camera=camera, method="convex+refine")
        np.testing.assert_allclose(result.shapes, expected.shapes, atol=1e-4)
        np.testing.assert_array_equal(result.column("extrinsic_translation"), [1, 2, 3])
        assert result.column("extrinsic_rotation").shape == (3, 3)
        np.testing.assert_array_equal(result.column("image_size"), SIZE)
        np.testing.assert_allclose(result.column("focal"), np.tile([800, 820], (4, 1)))
        written = (tmp_path / f"{name}.h5" for name in ("result", "cars", "views"))
        path, dictionary, landmarks = written
        assert not failures(run_verify(Request(path, dictionary, (landmarks,))))

    def test_cameras_of_single_images_and_y_that_points_up(self, views):
        straight, bent = views
        flip = np.array([[1.0], [-1.0]])
        turned = MATRIX.copy()
        turned[1, 2] = -turned[1, 2]
        further = {
            "camera_matrix": np.tile(turned, (4, 1, 1)),
            "distortion": np.tile(LENS, (4, 1)),
        }
        up = bent.replaced(
            landmarks=(bent.as_columns() * flip).swapaxes(1, 2),
            y_axis="up",
            extras=further,
            file_extras={},
        )
        result = undistorted(up, None)
        np.testing.assert_allclose(
            result.as_columns() * flip, straight.as_columns(), atol=1e-8
        )
        assert result.column("removed_distortion").shape == (4, 5)
