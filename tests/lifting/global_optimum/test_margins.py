"""Rounding is on the safe side: what the search claims holds in exact rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest

from shapefit import core
from shapefit.convex.problem import Problem, build_problem
from shapefit.convex.solver import Status
from shapefit.lifting.global_optimum.method import Limits, find_optimum, record_tree
from shapefit.verification.tree import SLIVER, bilinear, unfold
from tests.lifting.global_optimum.conftest import TRIPLES

exact = np.frompyfunc(Fraction, 1, 1)
"""The rational numbers that floats are, as arrays of objects."""


def judge(problem: Problem, corners: np.ndarray, cut: float) -> tuple[bool, np.ndarray]:
    """Whether the kernel drops a cell of the only image, and the excess of its coefficients."""
    excess = np.zeros(20)
    image = (problem.landmarks, problem.weights, problem.atoms, problem.lam)
    return core.parts.judge_cell(*image, corners, cut, excess), excess


def test_the_excess_of_a_cell_is_above_the_exact_one_by_the_share_of_slivers(make_scene, rng):
    """With multipliers as they are recorded.

    The share of rounding is a seventieth of that of slivers: nothing shows where it alone lacks.
    """
    problem = make_scene(n=1, k=4, p=6, noise=0.2, weighted=True).problem(0.3)
    bound = float(find_optimum(problem, tolerance=0.05, threads=1).bound[0])
    tree = record_tree(problem, 0, bound)
    leaves = unfold(tree.splits, tree.vertices)
    atoms, lam = exact(problem.atoms), Fraction(float(problem.lam[0]))
    for leaf in rng.choice(leaves, 6, replace=False):
        corners = tree.vertices[leaf]
        q = exact(corners * np.where(corners @ corners[0] < 0, -1.0, 1.0)[:, None])
        weighted = exact(tree.multipliers[leaf]) * exact(problem.weights[0])
        G = np.array([[Y @ B.T for B in atoms] for Y in weighted])
        size = max(np.sqrt((G.astype(float) ** 2).sum(axis=(2, 3)).max(axis=1)))
        dropped, excess = judge(problem, corners, bound)
        assert dropped
        for (a, b, c), found in zip(TRIPLES, excess, strict=True):
            sides = ((a, b, c), (b, a, c), (c, a, b))
            left = sum((bilinear(q[y], q[z]) * G[x]).sum(axis=(1, 2)) for x, y, z in sides)
            right = lam * (q[b] @ q[c] + q[a] @ q[c] + q[a] @ q[b])
            assert max(left) - right + Fraction(3 * SLIVER * size) <= Fraction(float(found))


def test_every_multiplier_has_the_value_of_the_bound_exactly(make_scene):
    """D(Y) = <Y, Omega o W> - 1/2 ||Y||^2, translations taken out of Y to rounding."""
    problem = make_scene(n=1, k=4, p=6, noise=0.2, weighted=True).problem(0.3)
    bound = float(find_optimum(problem, tolerance=0.05, threads=1).bound[0])
    tree = record_tree(problem, 0, bound)
    omega, W = exact(problem.weights[0]), exact(problem.landmarks[0])
    W = W - (W * omega**2).sum(axis=1, keepdims=True) / (omega**2).sum()
    for Y in exact(tree.multipliers):
        assert (Y * omega * W).sum() - (Y**2).sum() / 2 >= Fraction(bound)


def test_the_bound_is_below_the_cut_by_a_share_of_rounding():
    """Where no atom pays, v = 1/2 ||W||^2 at every rotation, here 16 without rounding.

    The multipliers have room for rounding of their own; this one is for the objective.
    """
    W = np.array([[[2.0, 2, -2, -2], [2, -2, -2, 2]]])
    atoms = np.random.default_rng(3).standard_normal((3, 3, 4))
    found = find_optimum(build_problem(W, atoms, 1000.0), tolerance=2.0**-44, threads=1)
    assert found.status == (Status.OPTIMAL,)
    assert found.objective[0] == 16
    rounding = 64 * 2.0**-52 * 32
    assert found.bound[0] == pytest.approx(16 * (1 - 2.0**-44) - rounding, abs=0.01 * rounding)


def test_a_search_that_was_cut_short_proves_its_bound(make_scene):
    """At the bound all cells that waited are dropped: here those of the 600-cell."""
    problem = make_scene(n=6, k=6, noise=0.3).problem(0.2)
    found = find_optimum(problem, tolerance=1e-3, limits=Limits(1, 10.0), threads=1)
    vertices, cells = np.zeros((60, 4)), np.zeros((300, 4), np.int64)
    core.parts.root_cells(vertices, cells)
    for image, bound in enumerate(found.bound):
        assert bound > 0
        one = problem.take(np.array([image]))
        assert all(judge(one, vertices[cell], float(bound))[0] for cell in cells)
