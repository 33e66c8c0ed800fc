"""Procrustes and mirroring: planted motions, certificates, scipy as judge."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from shapefit.geometry.procrustes import (
    are_coincident,
    generalised_procrustes,
    lateral_axis,
    mirror,
    rotation_onto,
    similarity_transform,
)
from shapefit.geometry.rotations import random_rotations
from tests.points import centred, resized, with_noise

MIRROR = np.diag([1.0, 1, -1])


def residual(transform, source, target):
    """Return the sum of squares (n,) that a transform leaves."""
    squares = (transform.apply(source) - target) ** 2
    return squares.sum(axis=(-2, -1))


class TestCoincide:
    @pytest.mark.parametrize(
        ("roundings", "together"), [(0, True), (1, True), (9, False), (100, False)]
    )
    def test_up_to_four_roundings_of_their_size(self, roundings, together):
        points = np.full((3, 4), 7.0)
        points[1, 2] += roundings * np.spacing(7.0)
        assert bool(are_coincident(points)) == together

    def test_each_set_by_itself(self):
        sets = np.array([[[0.0, 0.0]], [[1.0, 2.0]]])
        assert are_coincident(sets).tolist() == [True, False]

    def test_no_points_are_together(self):
        nothing = np.empty((2, 3, 0))
        assert are_coincident(nothing).tolist() == [True, True]


class TestSimilarityTransform:
    SPOILT = (2, 5)

    @pytest.fixture
    def source(self, rng):
        shapes = rng.standard_normal((30, 3, 7))
        return shapes + rng.standard_normal((30, 3, 1))

    @pytest.fixture
    def target(self, source, rng):
        turned = random_rotations(30, rng) @ source
        sizes = rng.uniform(0.5, 4, 30)
        return with_noise(resized(turned, sizes), 0.5, rng)

    def test_finds_a_planted_motion(self, source, rng):
        scale = rng.uniform(0.1, 9, 30)
        R = random_rotations(30, rng)
        shift = 5 * rng.standard_normal((30, 3))
        target = resized(R @ source, scale) + shift[..., None]

        found = similarity_transform(source, target)

        assert_allclose(found.scale, scale, rtol=1e-12)
        assert_allclose(found.rotation, R, atol=1e-12)
        assert_allclose(found.translation, shift, atol=1e-12)
        assert_allclose(found.apply(source), target, atol=1e-12)

    def test_never_mirrors(self, source):
        target = MIRROR @ source
        found = similarity_transform(source, target)
        assert_allclose(np.linalg.det(found.rotation), 1)
        assert (residual(found, source, target) > 1e-3).all()

    @pytest.mark.parametrize("name", ["scale", "rotation", "translation"])
    def test_nan_spoils_only_its_own_transform(self, source, target, name):
        spoilt = source.copy()
        spoilt[2, 0, 0] = np.nan
        spoilt[5] = np.nan

        clean = getattr(similarity_transform(source, target), name)
        found = getattr(similarity_transform(spoilt, target), name)

        others = np.delete(np.arange(30), self.SPOILT)
        assert np.isnan(found[list(self.SPOILT)]).all()
        assert_array_equal(found[others], clean[others])

    def test_a_source_of_one_point_is_only_moved(self, source):
        point = np.full((3, 7), 0.1)
        target = source[0]

        found = similarity_transform(point, target)

        assert found.scale == 1
        assert_array_equal(found.rotation, np.eye(3))
        assert_allclose(found.translation, target.mean(axis=-1) - 0.1)


class TestRotationOnto:
    def test_agrees_with_scipy(self, rng):
        source, target = rng.standard_normal((2, 20, 3, 5))

        found = rotation_onto(source, target)

        for R, X, Y in zip(found, source, target, strict=True):
            expected, _ = Rotation.align_vectors(Y.T, X.T)
            assert_allclose(R, expected.as_matrix(), atol=1e-8)


class TestGeneralisedProcrustes:
    TORSO = (0, 2, 3, 5)
    LIMBS = (1, 4, 6, 7, 8)

    @pytest.fixture
    def shapes(self, rng):
        """One noisy shape, turned at random."""
        base = centred(rng.standard_normal((3, 9)))
        noisy = centred(base + 0.3 * rng.standard_normal((25, 3, 9)))
        return random_rotations(25, rng) @ noisy

    def test_certificate(self, shapes):
        """Each shape already lies as well on the mean as a rotation can bring it."""
        found = generalised_procrustes(shapes)

        further = rotation_onto(found.shapes, found.mean)
        assert found.converged
        assert_allclose(further - np.eye(3), 0, atol=1e-7)

    def test_it_ends_after_the_rounds_that_it_may_take(self, shapes):
        found = generalised_procrustes(shapes, max_rounds=1)
        assert found.rounds == 1

    @pytest.fixture
    def spoilt(self, shapes, rng):
        """The shapes with limbs that lie elsewhere."""
        spoilt = shapes.copy()
        spoilt[..., list(self.LIMBS)] += rng.standard_normal((25, 3, 5))
        return spoilt

    def test_only_the_chosen_landmarks_choose_the_rotation(self, shapes, spoilt):
        torso = list(self.TORSO)

        clean = generalised_procrustes(shapes, torso)
        found = generalised_procrustes(spoilt, torso)

        assert_allclose(found.rotations, clean.rotations, atol=1e-12)
        assert_allclose(found.rotations @ spoilt, found.shapes, atol=1e-14)

    def test_without_a_choice_all_landmarks_choose_it(self, spoilt):
        by_torso = generalised_procrustes(spoilt, list(self.TORSO))
        by_all = generalised_procrustes(spoilt)
        difference = np.abs(by_all.rotations - by_torso.rotations)
        assert difference.max() > 0.1


PARTNERS = [2, 1, 0, 3]
"""Left hand, nose, right hand, tail: hands are partners, nose and tail their own."""


def test_mirror_negates_the_lateral_axis_and_exchanges_partners():
    shape = np.array([[1.0, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]])
    expected = np.array([[-3.0, -2, -1, -4], [7, 6, 5, 8], [11, 10, 9, 12]])
    assert_array_equal(mirror(shape, PARTNERS), expected)


@pytest.mark.parametrize("lateral", [0, 1, 2])
class TestLateralAxis:
    """The lateral axis is the one along which partners lie apart."""

    @pytest.fixture
    def shapes(self, rng, lateral):
        """Nearly symmetric shapes."""
        offsets = 0.1 * rng.normal(size=(5, 3, 4))
        shape = rng.normal(size=(5, 3, 4))
        symmetric = (shape + mirror(shape, PARTNERS, lateral)) / 2
        return symmetric + offsets

    def test_of_shapes_that_are_nearly_symmetric(self, shapes, lateral):
        assert lateral_axis(shapes, PARTNERS) == lateral

    def test_of_one_shape_beside_the_origin(self, shapes, lateral):
        assert lateral_axis(shapes[0] + 100, PARTNERS) == lateral

    def test_one_shape_of_which_they_lie_apart_elsewhere_does_not_matter(self, lateral):
        shapes = np.zeros((4, 3, 4))
        shapes[:, lateral, 0] = 2
        shapes[0, lateral - 1, 0] = 3
        assert lateral_axis(shapes, PARTNERS) == lateral


def test_no_bit_of_an_alignment_depends_on_the_number_of_threads(rng, monkeypatch):
    shapes = rng.normal(size=(2500, 3, 5))

    def align_on(cores):
        monkeypatch.setattr("os.cpu_count", lambda: cores)
        return generalised_procrustes(shapes)

    one = align_on(1)

    for cores in (2, 3):
        several = align_on(cores)
        assert_array_equal(one.shapes, several.shapes)
        assert_array_equal(one.mean, several.mean)
