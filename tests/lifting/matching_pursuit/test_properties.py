"""What changes a pursuit and what does not, and the rules that end it."""

from dataclasses import replace

import numpy as np

from shapefit.convex.solver import Status


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
