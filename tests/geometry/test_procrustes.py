"""Procrustes and mirroring: planted motions, certificates, scipy as judge."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from shapefit.geometry.procrustes import (
    coincide,
    generalised_procrustes,
    lateral_axis,
    mirror,
    rotation_onto,
    similarity_transform,
)
from shapefit.geometry.rotations import random_rotations

MIRROR = np.diag([1.0, 1, -1])


def residual(transform, source, target):
    return ((transform.apply(source) - target) ** 2).sum(axis=(-2, -1))


class TestCoincide:
    def test_up_to_four_roundings_of_their_size(self):
        points, rounding = np.full((3, 4), 7.0), np.spacing(7.0)
        for steps, together in ((0, True), (1, True), (9, False), (100, False)):
            points[1, 2] = 7.0 + steps * rounding
            assert bool(coincide(points)) == together, steps
        assert coincide(np.array([[[0.0, 0.0]], [[1.0, 2.0]]])).tolist() == [
            True,
            False,
        ]
        assert coincide(np.empty((2, 3, 0))).tolist() == [True, True]


class TestSimilarityTransform:
    @pytest.fixture
    def source(self, rng):
        return rng.standard_normal((30, 3, 7)) + rng.standard_normal((30, 3, 1))

    @pytest.fixture
    def target(self, source, rng):
        turned = random_rotations(30, rng) @ source
        return rng.uniform(0.5, 4, (30, 1, 1)) * turned + 0.5 * rng.standard_normal(
            source.shape
        )

    def test_finds_a_planted_motion(self, source, rng):
        scale, R = rng.uniform(0.1, 9, 30), random_rotations(30, rng)
        shift = 5 * rng.standard_normal((30, 3))
        target = scale[:, None, None] * (R @ source) + shift[..., None]
        found = similarity_transform(source, target)
        assert_allclose(found.scale, scale, rtol=1e-12)
        assert_allclose(found.rotation, R, atol=1e-12)
        assert_allclose(found.translation, shift, atol=1e-12)
        assert_allclose(found.apply(source), target, atol=1e-12)

    def test_never_mirrors(self, source):
        found = similarity_transform(source, MIRROR @ source)
        assert_allclose(np.linalg.det(found.rotation), 1)
        assert (residual(found, source, MIRROR @ source) > 1e-3).all()

    def test_nan_spoils_only_its_own_transform(self, source, target):
        spoiled = source.copy()
        spoiled[2, 0, 0] = np.nan
        spoiled[5] = np.nan
        found, clean = (
            similarity_transform(spoiled, target),
            similarity_transform(source, target),
        )
        for name in ("scale", "rotation", "translation"):
            ours, theirs = getattr(found, name), getattr(clean, name)
            assert np.isnan(ours[[2, 5]]).all()
            assert_array_equal(np.delete(ours, [2, 5], 0), np.delete(theirs, [2, 5], 0))

    def test_a_source_of_one_point_is_only_moved(self, source):
        found = similarity_transform(np.full((3, 7), 0.1), source[0])
        assert found.scale == 1
        assert_array_equal(found.rotation, np.eye(3))
        assert_allclose(found.translation, source[0].mean(axis=-1) - 0.1)


class TestRotationOnto:
    def test_agrees_with_scipy(self, rng):
        source, target = rng.standard_normal((2, 20, 3, 5))
        found = rotation_onto(source, target)
        for R, X, Y in zip(found, source, target, strict=True):
            expected = Rotation.align_vectors(Y.T, X.T)[0].as_matrix()
            assert_allclose(R, expected, atol=1e-8)


class TestGeneralisedProcrustes:
    @pytest.fixture
    def base(self, rng):
        shape = rng.standard_normal((3, 9))
        return shape - shape.mean(axis=-1, keepdims=True)

    @pytest.fixture
    def shapes(self, base, rng):
        noisy = base + 0.3 * rng.standard_normal((25, 3, 9))
        noisy -= noisy.mean(axis=-1, keepdims=True)
        return random_rotations(25, rng) @ noisy

    def test_certificate(self, shapes):
        # Each shape already lies as well on the mean as a rotation can bring it.
        found = generalised_procrustes(shapes)
        assert found.converged
        more = rotation_onto(found.shapes, found.mean)
        assert_allclose(more, np.broadcast_to(np.eye(3), more.shape), atol=1e-7)
        assert generalised_procrustes(shapes, max_rounds=1).rounds == 1

    def test_only_the_chosen_landmarks_choose_the_rotation(self, shapes, rng):
        torso = [0, 2, 3, 5]
        limbs = [1, 4, 6, 7, 8]
        spoiled = shapes.copy()
        spoiled[..., limbs] += rng.standard_normal((25, 3, 5))
        clean, found = (generalised_procrustes(s, torso) for s in (shapes, spoiled))
        assert_allclose(found.rotations, clean.rotations, atol=1e-12)
        assert_allclose(found.rotations @ spoiled, found.shapes, atol=1e-14)
        everything = generalised_procrustes(spoiled)
        assert np.abs(everything.rotations - found.rotations).max() > 0.1


# left hand, nose, right hand, tail: hands are partners, nose and tail their own
PARTNERS = [2, 1, 0, 3]


def test_mirror_negates_the_lateral_axis_and_exchanges_partners():
    shape = np.array([[1.0, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]])
    expected = np.array([[-3.0, -2, -1, -4], [7, 6, 5, 8], [11, 10, 9, 12]])
    assert_array_equal(mirror(shape, PARTNERS), expected)


@pytest.mark.parametrize("lateral", [0, 1, 2])
def test_the_lateral_axis_is_the_one_along_which_partners_lie_apart(rng, lateral):
    offsets = 0.1 * rng.normal(size=(5, 3, 4))
    shape = rng.normal(size=(5, 3, 4))
    shapes = (shape + mirror(shape, PARTNERS, lateral)) / 2 + offsets
    assert lateral_axis(shapes, PARTNERS) == lateral
    assert lateral_axis(shapes[0] + 100, PARTNERS) == lateral
    shapes = np.zeros((4, 3, 4))
    shapes[:, lateral, 0], shapes[0, lateral - 1, 0] = (
        2,
        3,
    )  # apart along another axis in one
    assert lateral_axis(shapes, PARTNERS) == lateral
