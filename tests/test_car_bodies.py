"""Cars by class of body: images made of them, the table, and what the figure shows."""

import numpy as np
import pytest

import shapefit
from experiments import car_bodies
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

BODIES = {"sedan": ["car07", "car01"], "SUV": ["car05"], "pick-up": ["car04"]}


@pytest.fixture(scope="module")
def cars():
    """Bodies of 120 landmarks that differ in height and length, about 5 long."""
    rng = np.random.default_rng(0)
    box = rng.uniform(-1, 1, (120, 3)) * np.array([1.0, 0.8, 2.4])
    cars = [box * np.array([1, 1 + 0.1 * i, 1 - 0.03 * i]) for i in range(4)]
    return shapefit.Shapes(
        np.array(cars) + 0.02 * rng.standard_normal((4, 120, 3)),
        items=("car01", "car04", "car05", "car07"),
        edges=np.array([[0, 1], [1, 2], [2, 3]]),
    )


def test_images_show_the_side_that_faces_a_camera_all_around(cars):
    images = look_at(cars)
    assert len(images) == 4 * VIEWS
    seen = np.isfinite(images.landmarks).all(axis=2)
    assert (seen.sum(axis=1) == VISIBLE).all()
    R = images.extras["true_rotation"]
    np.testing.assert_allclose(np.linalg.det(R), 1)
    headings = np.degrees(np.arctan2(R[:VIEWS, 2, 0], R[:VIEWS, 2, 2]))
    gaps = np.diff(np.sort(headings))
    assert gaps.max() < 2 * 360 / VIEWS
    up_in_the_image = R @ np.array([0.0, 1.0, 0.0])
    assert (up_in_the_image[:, 1] < -0.9).all()  # y of an image points down
    towards_the_car = R[:, 2]
    assert (towards_the_car[:, 1] < 0).all()  # from above
    for row in (0, 30, 95):
        points = cars.shapes[row // VIEWS]
        points = points - points.mean(axis=0)
        x, y, z = R[row] @ points.T
        there = FOCAL * np.stack([x, y], axis=1) / (z + DISTANCE)[:, None]
        np.testing.assert_allclose(images.landmarks[row][seen[row]], there[seen[row]])
        assert z[seen[row]].mean() < z.mean() - 0.2


def test_sedan_suv_and_pick_up_are_lifted_by_both_methods(cars):
    table, cases = measure_bodies(cars, BODIES)
    header, _, *rows = (
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in table.splitlines()
    )
    assert header[1:] == ["sedan (48)", "SUV (24)", "pick-up (24)"]
    assert [row[0] for row in rows] == list(METHODS)
    rotation = {row[0]: float(row[1].split(" / ")[2]) for row in rows}
    assert rotation["Perspective from the mean shape"] < rotation["Mean shape"]
    assert rotation["Perspective from the mean shape"] < 5
    assert [case.body for case in cases] == list(SHOWN)
    images = look_at(cars)
    for case in cases:
        row = images.items.index(f"{SHOWN[case.body]}/{SHOWN_VIEW}")
        seen = np.isfinite(case.landmarks).all(axis=1)
        np.testing.assert_array_equal(case.landmarks, images.landmarks[row])
        assert list(case.fitted) == list(METHODS)[:2]
        for method in case.fitted:
            off = np.linalg.norm(case.fitted[method] - case.landmarks, axis=1)[seen]
            assert off.mean() < 0.1 * np.ptp(case.landmarks[seen], axis=0).max()
            apart = np.linalg.norm(case.shapes[method] - case.truth, axis=1)
            assert apart.mean() < 0.15 * np.ptp(case.truth)


def test_errors_are_means_of_the_images_of_a_class():
    metrics = [("similarity", "normalised"), ("camera", "normalised")]
    errors = {metric: np.array([0.1, 0.3, np.nan, 0.5]) for metric in metrics}
    errors["rotation", "deg"] = np.array([1.0, 2.0, 3.0, 4.0])
    models = np.array(["a", "b", "b", "c"])
    header, rows = rows_of_bodies(
        {"mine": errors}, models, {"x": ["a", "b"], "y": ["c"], "none": ["d"]}
    )
    assert header[1:] == ["x (3)", "y (1)"]
    assert rows == [["mine", "0.200 / 0.200 / 2.0", "0.500 / 0.500 / 4.0"]]


def test_the_page_and_the_figure(cars, tmp_path, monkeypatch):
    shapefit.write_shapes(tmp_path / "cars.h5", cars)
    page = write_bodies(tmp_path / "out", tmp_path / "cars.h5", BODIES)
    assert "pick-up (24)" in page
    assert (tmp_path / "out/bodies.md").read_text(encoding="utf-8") == page
    assert (tmp_path / "out/bodies.png").read_bytes()[1:4] == b"PNG"


def test_without_the_shapes_it_says_what_is_left_out(tmp_path):
    page = write_bodies(tmp_path / "out", tmp_path / "cars.h5", BODIES)
    assert "left out" in page
    assert str(tmp_path / "cars.h5") in page
    assert not (tmp_path / "out").exists()


def test_every_model_is_of_one_class():
    from experiments.pages import quoted

    bodies = quoted("cars")["bodies"]
    names = [name for models in bodies.values() for name in models]
    assert len(names) == len(set(names)) == 34 + 15
    assert {car for _, car in car_bodies.SHOWN.items()} <= set(names)
    for body, car in SHOWN.items():
        assert car in bodies[body]
