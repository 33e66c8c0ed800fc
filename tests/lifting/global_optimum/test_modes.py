"""All readings of an image: shapes whose readings are known, and random descents."""

import numpy as np
import pytest

from shapefit import core
from shapefit.convex.problem import Problem, build_problem
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.global_optimum.modes import APART, find_modes
from shapefit.lifting.global_optimum.optimum import Limits, find_optimum
from tests.lifting.global_optimum.conftest import best_at, rotation_rows


def readings_of(problem: Problem, within: float = 0.05, **options):
    found = find_optimum(problem, threads=1)
    return find_modes(problem, found.rotation, within, threads=1, **options), found


def angle(R: np.ndarray, S: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(R @ S.T) - 1) / 2, -1, 1)))


@pytest.fixture
def shape(rng) -> np.ndarray:
    B = rng.standard_normal((3, 10))
    return B - B.mean(axis=1, keepdims=True)


def seen_by(B: np.ndarray, R: np.ndarray) -> Problem:
    return build_problem((R @ B)[:, :2], B[None], 0.05)


def tilted(rng: np.random.Generator, n: int) -> np.ndarray:
    """Views at least 25 degrees off the axis and the plane of a flat shape."""
    R = random_rotations(20 * n, rng)
    axis = np.abs(R[:, 2, 2])
    return R[(axis < np.cos(np.deg2rad(25))) & (axis > np.sin(np.deg2rad(25)))][:n]


def test_a_shape_whose_front_is_its_back_has_two_readings(shape, rng):
    """A flat shape tilted away looks as if it were tilted towards the camera."""
    flat = shape * np.array([[1.0], [1.0], [0.0]])
    R = tilted(rng, 4)
    readings, found = readings_of(seen_by(flat, R))
    mirror = np.diag([1.0, 1.0, -1.0])
    for one, truth, least in zip(readings, R, found.objective, strict=True):
        assert one.complete
        assert len(one) == 2
        np.testing.assert_allclose(one.objective, least, rtol=1e-9)
        known = (truth, mirror @ truth @ mirror)
        for reading in one.rotation:
            assert min(angle(reading, R) for R in known) < 0.02  # lambda shrinks the shape
        assert angle(*one.rotation) > APART


def test_a_chiral_shape_has_one_reading(shape, rng):
    readings, _ = readings_of(seen_by(shape, tilted(rng, 4)))
    for one in readings:
        assert one.complete
        assert len(one) == 1


def test_readings_are_complete(make_scene, rng):
    """No descent from a random start ends below the limit outside what is listed or its valley."""
    problem = make_scene(n=8, k=4, p=6, noise=0.8).problem(0.3)
    within = 0.4
    readings, found = readings_of(problem, within)
    assert max(len(one) for one in readings) > 1
    for image, one in enumerate(readings):
        assert one.complete
        assert one.objective[0] == pytest.approx(found.objective[image], rel=1e-9)
        assert (np.diff(one.objective) >= 0).all()
        assert (one.objective <= (1 + within) * one.objective[0] * (1 + 1e-12)).all()
        for j, R in enumerate(one.rotation):
            assert best_at(problem, image, R[:2])[0] == pytest.approx(one.objective[j], rel=1e-7)
            assert all(angle(R, other) > APART for other in one.rotation[:j])
        single = problem.take(np.array([image]))
        for start in rng.standard_normal((60, 4)):
            q = start / np.linalg.norm(start)
            arguments = (single.landmarks, single.weights, single.atoms, single.lam, False, q)
            value = core.parts.descend(*arguments, 1e-13)
            if value <= (1 + within) * one.objective[0]:
                rows = rotation_rows(q)
                R = np.vstack([rows, np.cross(*rows)])
                assert min(angle(R, listed) for listed in one.rotation) <= APART + 1e-6


def test_shapes_are_those_of_the_rotations(make_scene):
    problem = make_scene(n=3, noise=0.5).problem(0.3)
    readings, _ = readings_of(problem, 0.2)
    for image, one in enumerate(readings):
        for R, S in zip(one.rotation, one.shapes, strict=True):
            np.testing.assert_allclose(S.mean(axis=1), 0, atol=1e-9)
            left = problem.landmarks[image] - S[:2]
            _, Y = best_at(problem, image, R[:2])
            np.testing.assert_allclose(left - left.mean(axis=1, keepdims=True), Y, atol=1e-5)


def test_a_limit_says_that_readings_may_be_missing(make_scene):
    problem = make_scene(n=2, noise=0.5).problem(0.3)
    readings, _ = readings_of(problem, limits=Limits(10, 1.0))
    for one in readings:
        assert not one.complete
        assert len(one) >= 1


def test_an_image_without_a_rotation_has_no_reading(make_scene):
    problem = make_scene(n=2).problem(1e4)
    readings, _ = readings_of(problem)
    assert [len(one) for one in readings] == [0, 0]
