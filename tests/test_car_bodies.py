"""Cars by class of body: images made of them, the table, and what the figure shows."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import shapefit
from experiments.car_bodies import (
    DISTANCE,
    FOCAL,
    METHODS,
    SHOWN,
    SHOWN_VIEW,
    VIEWS,
    VISIBLE,
    look_at,
    measure_bodies,
    rows_of_bodies,
    write_bodies,
)
from experiments.pages import quoted

BODIES = {"sedan": ["car07", "car01"], "SUV": ["car05"], "pick-up": ["car04"]}


@pytest.fixture(scope="module")
def cars():
    """Bodies of 120 landmarks that differ in height and length, about 5 long."""
    rng = np.random.default_rng(0)
    box = rng.uniform(-1, 1, (120, 3)) * np.array([1.0, 0.8, 2.4])
    sizes = [np.array([1, 1 + 0.1 * i, 1 - 0.03 * i]) for i in range(4)]
    noise = 0.02 * rng.standard_normal((4, 120, 3))
    return shapefit.Shapes(
        np.array([box * size for size in sizes]) + noise,
        items=("car01", "car04", "car05", "car07"),
        edges=np.array([[0, 1], [1, 2], [2, 3]]),
    )


@pytest.fixture(scope="module")
def images(cars):
    return look_at(cars)


def visible(landmarks):
    return np.isfinite(landmarks).all(axis=-1)


def test_every_car_has_views_of_so_many_landmarks(images):
    counts = visible(images.landmarks).sum(axis=1)
    assert len(images) == 4 * VIEWS
    assert (counts == VISIBLE).all()


def test_cameras_stand_all_around_and_look_from_above(images):
    R = images.extras["true_rotation"]
    headings = np.degrees(np.arctan2(R[:VIEWS, 2, 0], R[:VIEWS, 2, 2]))
    gaps = np.diff(np.sort(headings))
    y_of_up_in_the_image = R[:, 1, 1]
    height_of_the_view = R[:, 2, 1]
    assert_allclose(np.linalg.det(R), 1)
    assert gaps.max() < 2 * 360 / VIEWS
    assert (y_of_up_in_the_image < -0.9).all()  # y of an image points down
    assert (height_of_the_view < 0).all()


@pytest.mark.parametrize("row", [0, 30, 95])
def test_images_show_the_side_that_faces_the_camera(cars, images, row):
    points = cars.shapes[row // VIEWS]
    centred = points - points.mean(axis=0)
    R = images.extras["true_rotation"][row]
    x, y, z = R @ centred.T
    seen = visible(images.landmarks[row])
    expected = FOCAL * np.stack([x, y], axis=1) / (z + DISTANCE)[:, None]
    assert_allclose(images.landmarks[row][seen], expected[seen])
    assert z[seen].mean() < z.mean() - 0.2


@pytest.fixture(scope="module")
def measured(cars):
    """The rows of the table of the cars by class of body, and the cases shown."""
    table, cases = measure_bodies(cars, BODIES)
    rows = []
    for line in table.splitlines():
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows, cases


def test_sedan_suv_and_pick_up_are_lifted_by_all_methods(measured):
    (header, _line, *rows), _ = measured
    errors_of_rotation = {row[0]: float(row[1].split(" / ")[2]) for row in rows}
    refined = errors_of_rotation["Perspective from the mean shape"]
    assert header[1:] == ["sedan (48)", "SUV (24)", "pick-up (24)"]
    assert [row[0] for row in rows] == list(METHODS)
    assert refined < errors_of_rotation["Mean shape"]
    assert refined < 5


def mean_distance(points, others):
    return np.linalg.norm(points - others, axis=1).mean()


def test_cases_are_fitted_by_both_methods(measured, images):
    _, cases = measured
    assert [case.body for case in cases] == list(SHOWN)
    for case in cases:
        row = images.items.index(f"{SHOWN[case.body]}/{SHOWN_VIEW}")
        assert_array_equal(case.landmarks, images.landmarks[row])
        assert list(case.fitted) == list(METHODS)[:2]


def test_cases_are_near_what_is_seen_and_near_the_truth(measured):
    _, cases = measured
    for case in cases:
        seen = visible(case.landmarks)
        landmarks = case.landmarks[seen]
        size = np.ptp(landmarks, axis=0).max()
        for method, fitted in case.fitted.items():
            assert mean_distance(fitted[seen], landmarks) < 0.1 * size
            distance = mean_distance(case.shapes[method], case.truth)
            assert distance < 0.15 * np.ptp(case.truth)


def test_errors_are_means_of_the_images_of_a_class():
    values = np.array([0.1, 0.3, np.nan, 0.5])
    errors = {
        ("similarity", "normalised"): values,
        ("camera", "normalised"): values,
        ("rotation", "deg"): np.array([1.0, 2.0, 3.0, 4.0]),
    }
    models = np.array(["a", "b", "b", "c"])
    classes = {"x": ["a", "b"], "y": ["c"], "none": ["d"]}
    header, rows = rows_of_bodies({"mine": errors}, models, classes)
    assert header[1:] == ["x (3)", "y (1)"]
    assert rows == [["mine", "0.200 / 0.200 / 2.0", "0.500 / 0.500 / 4.0"]]


def test_the_page_and_the_figure(cars, tmp_path):
    source = tmp_path / "cars.h5"
    output = tmp_path / "out"
    shapefit.write_shapes(source, cars)
    page = write_bodies(output, source, BODIES)
    assert "pick-up (24)" in page
    assert (output / "bodies.md").read_text(encoding="utf-8") == page
    assert (output / "bodies.png").read_bytes()[1:4] == b"PNG"


def test_without_the_shapes_it_says_what_is_left_out(tmp_path):
    source = tmp_path / "cars.h5"
    output = tmp_path / "out"
    page = write_bodies(output, source, BODIES)
    assert "left out" in page
    assert str(source) in page
    assert not output.exists()


def test_every_model_is_of_one_class():
    bodies = quoted("cars")["bodies"]
    names = [name for models in bodies.values() for name in models]
    assert len(names) == 34 + 15
    assert len(set(names)) == len(names)
    for body, car in SHOWN.items():
        assert car in bodies[body]
