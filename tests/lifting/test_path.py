"""A regularisation path: what each program starts from, and what is said of its optimum."""

from __future__ import annotations

from functools import partial

import numpy as np

from shapefit.convex.newton import solve_newton
from shapefit.lifting.path import follow_path
from shapefit.lifting.reconstruction import reconstruct

LAMBDAS = (0.5, 0.1, 0.02)


def test_each_program_starts_from_the_optimum_before_it(make_scene):
    starts, found = [], []

    def solve(problem, *, start=None):
        starts.append(start)
        found.append(solve_newton(problem, start=start))
        return found[-1]

    follow_path(make_scene(noise=0.1).problem(0.3), LAMBDAS, solve)
    assert starts[0] is None
    assert [id(start) for start in starts[1:]] == [id(solution) for solution in found[:-1]]


def test_atoms_are_counted_as_those_of_single_programs(make_scene):
    scene = make_scene(noise=0.1)
    solve = partial(solve_newton, tolerance=1e-8)
    path = follow_path(scene.problem(0.3), LAMBDAS, solve)
    singles = [solve(scene.problem(lam)) for lam in LAMBDAS]
    counts = [reconstruct(single.transforms, scene.atoms).active_atoms for single in singles]
    np.testing.assert_array_equal(path.active_atoms, np.stack(counts, axis=1))
    assert len(np.unique(path.active_atoms)) > 2
