"""What changes a pursuit and what does not, and the rules that end it."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np

from shapefit.convex.solver import Status
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting.matching_pursuit import PIXELS, Pursuit


class TestProperties:
    RULES = MappingProxyType({"goal": 0.05, "most_atoms": 5})

    def found(self, scene, **keys) -> Pursuit:
        return scene.pursue(**{**self.RULES, **keys})

    def same(self, found: Pursuit, expected: Pursuit, **keys) -> None:
        np.testing.assert_array_equal(found.rounds, expected.rounds)
        assert found.status == expected.status
        for name in ("coefficients", "mean_coefficient", "camera", "error"):
            wanted = keys.get(name, getattr(expected, name))
            np.testing.assert_allclose(getattr(found, name), wanted, rtol=1e-8, atol=1e-8)

    def test_turning_the_image_turns_the_camera(self, noisy):
        Q = rotation_about(np.array([0.0, 0.0, 1.0]), np.array([0.7]))[0, :2, :2]
        expected = self.found(noisy)
        turned = replace(noisy, landmarks=Q @ noisy.landmarks)
        self.same(self.found(turned), expected, camera=Q @ expected.camera)

    def test_turning_the_dictionary_turns_the_camera(self, noisy, rng):
        (R,) = random_rotations(1, rng)
        expected = self.found(noisy)
        turned = replace(noisy, mean=R @ noisy.mean, bases=R @ noisy.bases)
        self.same(self.found(turned), expected, camera=expected.camera @ R.T)

    def test_the_order_of_landmarks_does_not_matter(self, noisy, rng):
        order = rng.permutation(noisy.mean.shape[1])
        names = ("landmarks", "weights", "mean", "bases", "shapes")
        permuted = replace(
            noisy,
            **{name: getattr(noisy, name)[..., order] for name in names},
            edges=np.argsort(order)[noisy.edges],
        )
        self.same(self.found(permuted), self.found(noisy))

    def test_the_order_and_sign_of_atoms_do_not_matter(self, noisy, rng):
        order, sign = rng.permutation(9), rng.choice([-1.0, 1.0], 9)
        other = replace(noisy, bases=(sign[:, None, None] * noisy.bases)[order])
        expected = self.found(noisy)
        signed = (sign * expected.coefficients)[:, order]
        self.same(self.found(other), expected, coefficients=signed)

    def test_what_lies_under_the_mask_does_not_matter(self, noisy, rng):
        hidden = np.broadcast_to((noisy.weights == 0)[:, None], noisy.landmarks.shape)
        assert hidden.any()
        garbage = np.where(hidden, 1e6 * rng.standard_normal(hidden.shape), noisy.landmarks)
        self.same(self.found(replace(noisy, landmarks=garbage)), self.found(noisy))

    def test_the_place_of_the_image_does_not_matter(self, noisy):
        moved = replace(noisy, landmarks=noisy.landmarks + np.array([[30.0], [-7.0]]))
        self.same(self.found(moved), self.found(noisy))

    def test_with_its_rules_the_image_can_be_scaled(self, noisy):
        expected = self.found(noisy)
        grown = replace(noisy, landmarks=3 * noisy.landmarks)
        found = self.found(grown, goal=9 * self.RULES["goal"], change=9 / PIXELS**2)
        self.same(found, expected, camera=3 * expected.camera, error=9 * expected.error)

    def test_images_do_not_see_each_other(self, noisy):
        landmarks, weights = (np.concatenate([a] * 30) for a in (noisy.landmarks, noisy.weights))
        many = replace(noisy, landmarks=landmarks, weights=weights)
        together = self.found(many, threads=2)
        alone = self.found(noisy, threads=1)
        np.testing.assert_array_equal(together.coefficients, np.tile(alone.coefficients, (30, 1)))


class TestRules:
    def test_an_image_converges_at_the_goal(self, noisy):
        free = noisy.pursue(goal=0.0, most_atoms=2)
        goal = float(np.median(free.error))
        found = noisy.pursue(goal=goal, most_atoms=2)
        met = found.error <= goal
        assert 0 < met.sum() < 5
        wanted = [Status.CONVERGED if done else Status.ITERATION_LIMIT for done in met]
        assert list(found.status) == wanted
        assert (np.count_nonzero(found.coefficients, axis=1)[~met] == 2).all()

    def test_a_loop_ends_where_the_error_rests(self, noisy):
        rounds = [
            noisy.pursue(goal=0.0, change=change, most_atoms=1, most_rounds=500).rounds
            for change in (1e3, 1e-3, 1e-9)
        ]
        np.testing.assert_array_equal(rounds[0], 1)
        assert (rounds[0] < rounds[1]).all()
        assert (rounds[1] < rounds[2]).all()
        np.testing.assert_array_equal(noisy.pursue(goal=0.0, change=0.0, most_atoms=2).rounds, 60)

    def test_atoms_that_depend_on_the_chosen_ones_are_passed_over(self, noisy):
        doubled = replace(
            noisy, bases=np.concatenate([noisy.bases, -noisy.bases, noisy.mean[None]])
        )
        expected = noisy.pursue(goal=0.0, most_atoms=9)
        found = doubled.pursue(goal=0.0, most_atoms=15)
        np.testing.assert_allclose(found.coefficients[:, :9], expected.coefficients, atol=1e-8)
        assert not found.coefficients[:, 9:].any()
        assert set(found.status) == {Status.ITERATION_LIMIT}
