"""The global optimum: planted answers, other methods, random descents, limits."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import combinations_with_replacement
from typing import NamedTuple
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, Problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting import global_optimum
from shapefit.lifting.estimate import fit_translation
from shapefit.lifting.global_optimum import (
    MAX_KEPT_NUMBERS,
    MAX_SEARCH_CELLS,
    DroppedCells,
    GlobalOptimum,
    find_optimum,
    limit_cells,
)
from shapefit.lifting.reconstruction import combine
from shapefit.lifting.shared_rotation import alternate
from tests.lifting.estimators import make_estimator
from tests.points import centred, draw_rotations, mix, transpose


def objective_of(problem, starts):
    """The least objective (n,) of descents from rotations (n, s, 3, 3)."""
    found = alternate(problem, starts)
    R = np.nan_to_num(found.rotation)
    shapes = combine(found.coefficients, problem.atoms, R)
    residual = fit_translation(problem, shapes).half_squared_residual
    return residual + problem.lam * found.coefficients.sum(axis=1)


class Planted(NamedTuple):
    """A problem, and the rotations (n, 3, 3) and objectives (n,) of its optimum."""

    problem: Problem
    rotation: Floats
    objective: Floats


@pytest.fixture
def make_planted(rng: np.random.Generator) -> Callable[..., Planted]:
    """Return a function that makes a problem whose optimum is known by construction.

    A residual Y is chosen, and atoms are turned so that <Y, Rbar B_i> is largest, the
    nuclear norm of Y B_i^T, at one rotation R for all of them, and scaled so that it is
    lambda for active atoms: then Y is feasible at every rotation, and its value is the
    objective at R.
    """

    def make(
        n: int = 4, k: int = 8, p: int = 12, *, active: int = 3, weighted: bool = False
    ) -> Planted:
        lam = 0.5
        omega = rng.uniform(0.5, 2, p) if weighted else np.ones(p)
        R = random_rotations(1, rng)[0]
        Y = rng.standard_normal((2, p))
        Y -= (Y @ omega)[:, None] * omega / (omega @ omega)
        atoms = rng.standard_normal((k, 3, p))
        for i, B in enumerate(atoms):
            share = 1 if i < active else rng.uniform(0.3, 0.9)
            atoms[i] = turn_to_dual(B, Y * omega, R, share * lam)

        c = np.zeros((n, k))
        c[:, :active] = rng.uniform(1, 3, (n, active))
        W = R[:2] @ mix(c, atoms) + Y / omega
        W += rng.standard_normal((n, 2, 1))
        objective = 0.5 * (Y**2).sum() + lam * c.sum(axis=1)
        problem = Problem(W, np.tile(omega, (n, 1)), atoms, np.full(n, lam))
        return Planted(problem, np.tile(R, (n, 1, 1)), objective)

    return make


def turn_to_dual(B: Floats, weighted_dual: Floats, R: Floats, size: float) -> Floats:
    """Turn an atom so that <Y, Rbar B> is largest at R, and scale it so that it is
    `size` there.
    """
    U, singular_values, Vt = np.linalg.svd(weighted_dual @ B.T, full_matrices=False)
    rows = U @ Vt
    best = np.vstack([rows, np.cross(*rows)])
    return R.T @ best @ B * size / singular_values.sum()


@pytest.mark.parametrize("weighted", [False, True])
def test_a_planted_optimum_is_found_with_a_gap_of_rounding(make_planted, weighted):
    planted = make_planted(weighted=weighted)

    found = find_optimum(planted.problem, tolerance=1e-9, threads=1)

    assert set(found.status) == {Status.OPTIMAL}
    assert_allclose(found.objective, planted.objective, rtol=1e-12)
    assert_allclose(found.rotation, planted.rotation, atol=1e-5)
    assert (found.bound <= planted.objective * (1 + 1e-13)).all()
    assert (found.relative_gap <= 1.1e-9).all()


def best_at(problem: Problem, image: int, rows: Floats) -> tuple[float, Floats]:
    """Return v at a rotation and the multiplier Y (2, p) there, from scipy's nnls.

    With A^T A = U^T U the lasso over c >= 0 is the non-negative least squares of U c =
    U^-T (A^T w - lambda).
    """
    omega = problem.weights[image]
    direction = omega / np.linalg.norm(omega)

    def without_translation(points: Floats) -> Floats:
        weighted = points * omega
        return weighted - (weighted @ direction)[..., None] * direction

    w = without_translation(problem.landmarks[image])
    columns = without_translation(rows @ problem.atoms)
    A = columns.reshape(len(problem.atoms), -1).T
    lam = problem.lam[image]
    gram = A.T @ A
    shift = 1e-12 * np.trace(gram) * np.eye(len(gram))
    U = np.linalg.cholesky(gram + shift).T
    right_side = np.linalg.solve(U.T, A.T @ w.ravel() - lam)
    c, _ = nnls(U, right_side, maxiter=10_000)
    Y = w - (A @ c).reshape(2, -1)
    return 0.5 * (Y**2).sum() + lam * c.sum(), Y


def test_the_objective_is_that_of_an_independent_solver_at_the_rotation(make_scene):
    problem = make_scene(n=4, noise=0.3, weighted=True, hidden=0.2).problem(0.2)

    found = find_optimum(problem, threads=1)

    for image, R in enumerate(found.rotation):
        expected, _ = best_at(problem, image, R[:2])
        assert expected == pytest.approx(found.objective[image], rel=1e-8)


SETTINGS = {"solve": partial(solve_newton, tolerance=1e-8), "tolerance": 0.01}


@pytest.mark.parametrize("hidden", [0.0, 0.25])
class TestBesideOtherMethods:
    """The optimum is never above other methods, its bound never above any rotation."""

    @pytest.fixture
    def scene(self, make_scene, hidden):
        return make_scene(n=12, k=12, noise=0.4, weighted=hidden > 0, hidden=hidden)

    @pytest.fixture
    def problem(self, scene):
        return scene.problem(0.2)

    @pytest.fixture
    def estimate_by(self, problem, scene):
        def estimate_by(name):
            settings = SETTINGS | {"mean_shape": scene.mean_shape}
            return make_estimator(name, **settings)(problem)

        return estimate_by

    def bound_of(self, found):
        return found.objective * (1 - found.relative_gap)

    def test_it_is_optimal_to_the_tolerance(self, estimate_by):
        found = estimate_by("global")
        assert set(found.status) == {Status.OPTIMAL}
        assert (found.relative_gap <= 0.01 + 1e-10).all()

    @pytest.mark.parametrize("name", ["convex+refine", "alternate"])
    def test_it_is_never_above_another_method(self, estimate_by, name):
        found = estimate_by("global")
        other = estimate_by(name)
        assert (found.objective <= other.objective * (1 + 1e-9)).all()
        assert (self.bound_of(found) <= other.objective).all()

    def test_it_starts_from_what_the_other_methods_find(self, estimate_by, monkeypatch):
        search = Mock(wraps=find_optimum)
        monkeypatch.setattr(global_optimum, "find_optimum", search)

        estimate_by("global")

        _, starts = search.call_args.args
        assert_array_equal(starts[:, 0], estimate_by("convex+refine").rotation)
        assert_array_equal(starts[:, 1], estimate_by("alternate").rotation)

    def test_its_bound_is_below_descents_from_anywhere(self, estimate_by, problem, rng):
        found = estimate_by("global")
        starts = draw_rotations(12, 20, rng)
        assert (self.bound_of(found) <= objective_of(problem, starts)).all()


class TestLimit:
    """A search that is cut short leaves a bound that holds."""

    TOLERANCE = 1e-3

    @pytest.fixture
    def problem(self, make_scene):
        return make_scene(n=5, noise=0.3).problem(0.2)

    @pytest.fixture
    def optimum(self, problem):
        return find_optimum(problem, tolerance=self.TOLERANCE, threads=1).objective

    def cut_short(self, problem, cells) -> GlobalOptimum:
        return find_optimum(
            problem, tolerance=self.TOLERANCE, max_cells=cells, threads=1
        )

    @pytest.mark.parametrize("cells", [1, 200, 600])
    def test_the_search_ends_at_it_and_says_so(self, problem, cells):
        found = self.cut_short(problem, cells)
        assert set(found.status) == {Status.ITERATION_LIMIT}
        assert (found.cells <= 2 * cells).all()
        assert (found.relative_gap > self.TOLERANCE).all()

    @pytest.mark.parametrize("cells", [1, 200, 600])
    def test_its_bound_holds(self, problem, optimum, cells):
        found = self.cut_short(problem, cells)
        assert (found.bound <= optimum).all()
        assert (found.bound >= 0).all()

    def test_after_600_cells_the_bound_says_something(self, problem, optimum):
        found = self.cut_short(problem, 600)
        assert (found.bound > 0.5 * optimum).all()

    def test_a_small_objective_has_no_smaller_gap(self, problem):
        small = replace(
            problem, landmarks=problem.landmarks / 100, lam=problem.lam / 100
        )
        found = find_optimum(small, max_cells=1, threads=1)
        assert (found.relative_gap > 1e-2).all()

    def test_it_is_in_cells_and_falls_with_the_size_of_the_problem(self):
        assert limit_cells(64, 15) == MAX_SEARCH_CELLS
        assert limit_cells(2000, 1000) == MAX_KEPT_NUMBERS // 18_000


LEAST = 1e-7
"""Share of lambda and of an objective by which nnls, whose Gram matrix is shifted, may
be off.
"""

ROOT_CELLS = 300
MAX_DROPPED_CELLS = 20_000


class Cell(NamedTuple):
    """Corners q (4, 4) of a cell that was dropped, and the cut, at which it was."""

    corners: Floats
    cut: float


class Dropped(NamedTuple):
    """The search of an image: its bound, and the cells that it dropped."""

    problem: Problem
    image: int
    bound: float
    corners: Floats
    cuts: Floats

    def cells(self) -> Iterator[Cell]:
        """Yield each cell, corners on the side of the first."""
        yield from map(Cell, self.corners, self.cuts)


@pytest.fixture(params=[0.0, 0.25], ids=["all seen", "some hidden"])
def dropped_cells(request, make_scene) -> list[Dropped]:
    """What the search drops for two images."""
    hidden = request.param
    scene = make_scene(n=2, k=12, noise=0.4, weighted=hidden > 0, hidden=hidden)
    problem = scene.problem(0.2)
    room = DroppedCells.allocate(2, MAX_DROPPED_CELLS)
    found = find_optimum(problem, tolerance=0.05, threads=1, dropped=room)
    assert set(found.status) == {Status.OPTIMAL}
    dropped = []
    for image, count in enumerate(room.number):
        corners = room.corners[image, :count]
        side = np.sign(corners @ transpose(corners[:, :1]))
        cuts = room.cuts[image, :count]
        dropped.append(
            Dropped(problem, image, found.bound[image], corners * side, cuts)
        )
    return dropped


class TestDroppedCells:
    """The theorem of docs/global.md, cell by cell, with multipliers of scipy's nnls."""

    def test_all_cells_are_noted(self, dropped_cells):
        for dropped in dropped_cells:
            assert ROOT_CELLS / 2 < len(dropped.cuts) < MAX_DROPPED_CELLS

    def test_corners_are_unit_quaternions(self, dropped_cells):
        for dropped in dropped_cells:
            assert np.linalg.norm(dropped.corners, axis=2) == pytest.approx(1)

    def test_no_cut_is_below_the_bound(self, dropped_cells):
        for dropped in dropped_cells:
            assert dropped.cuts.min() >= dropped.bound

    def test_every_rotation_is_in_a_cell(self, dropped_cells, rng):
        """Random ones are cones over the corners of one."""
        for dropped in dropped_cells:
            inverse = np.linalg.inv(dropped.corners)
            for q in rng.standard_normal((500, 4)):
                share = q @ inverse
                is_before = (share >= -1e-12).all(axis=1)
                is_behind = (share <= 1e-12).all(axis=1)
                assert (is_before | is_behind).any()

    def test_the_theorem_holds_for_every_cell(self, dropped_cells):
        for dropped in dropped_cells:
            problem, image = dropped.problem, dropped.image

            @cache
            def multiplier_at(corner, problem=problem, image=image):
                _, Y = best_at(problem, image, rows_of(corner))
                return Y

            for cell in dropped.cells():
                multipliers = [multiplier_at(tuple(q)) for q in cell.corners]
                check_theorem(problem, image, cell, multipliers)

    def test_no_objective_within_a_cell_is_below_its_cut(self, dropped_cells, rng):
        for dropped in dropped_cells:
            for cell in [*dropped.cells()][::20]:
                q = rng.dirichlet(np.ones(4)) @ cell.corners
                rows = rows_of(q / np.linalg.norm(q))
                value, _ = best_at(dropped.problem, dropped.image, rows)
                assert value >= cell.cut * (1 - LEAST)


def rows_of(q) -> Floats:
    """Return the first two rows of the rotation of a unit quaternion (w, x, y, z)."""
    scalar_last = np.roll(q, -1)
    return Rotation.from_quat(scalar_last).as_matrix()[:2]


def make_bilinear() -> Floats:
    """Return Q (4, 4, 2, 3), symmetric, with Q(q, q) = |q|^2 rows_of(q / |q|)."""

    def quadratic(q: Floats) -> Floats:
        if not q.any():
            return np.zeros((2, 3))
        return (q @ q) * rows_of(q / np.linalg.norm(q))

    Q = [[quadratic(e + f) - quadratic(e - f) for e in np.eye(4)] for f in np.eye(4)]
    return np.array(Q) / 4


BILINEAR = make_bilinear()


def scale_to_cut(Y: Floats, w: Floats, cut: float) -> Floats:
    """Return s Y with the least s for which s <Y, w> - s^2 ||Y||^2 / 2 = cut."""
    square = (Y * Y).sum()
    along = (Y * w).sum()
    discriminant = along**2 - 2 * square * cut
    assert discriminant >= -1e-6 * along**2
    s = (along - np.sqrt(max(discriminant, 0.0))) / square
    return s * Y


def check_theorem(
    problem: Problem, image: int, cell: Cell, multipliers: list[Floats]
) -> None:
    """Assert the inequalities of a cell for its multipliers Y, scaled to the cut."""
    omega = problem.weights[image]
    lam = problem.lam[image]
    w = problem.landmarks[image] * omega
    scaled = [scale_to_cut(Y, w, cell.cut) for Y in multipliers]
    products = [(Y * omega) @ transpose(problem.atoms) for Y in scaled]
    q = cell.corners
    Q = np.einsum("be,cf,efxy->bcxy", q, q, BILINEAR)
    for triple in combinations_with_replacement(range(4), 3):
        left = np.zeros(len(problem.atoms))
        right = 0.0
        for e in range(3):
            a, b, c = triple[e], triple[e - 1], triple[e - 2]
            left += (products[a] * Q[b, c]).sum(axis=(1, 2))
            right += lam * (q[b] @ q[c])
        assert left.max() <= right + LEAST * 10 * lam


def test_coefficients_are_optimal_for_the_rotation(make_scene):
    """To rounding: of 400 images some have an unused atom that is nearly worth it."""
    problem = make_scene(n=400, k=40, noise=0.3).problem(0.1)

    found = find_optimum(problem, tolerance=0.9, threads=1)

    rows = found.rotation[:, :2]
    seen = rows @ mix(found.coefficients, problem.atoms)
    Y = centred(problem.landmarks - seen)
    along = np.einsum("nap,nab,kbp->nk", Y, rows, problem.atoms)
    is_used = found.coefficients > 0
    assert along.max() <= 0.1 * (1 + 1e-7)
    assert_allclose(along[is_used], 0.1, rtol=1e-7)


@pytest.fixture
def small_problem(make_scene):
    return make_scene(n=2).problem(0.2)


def test_one_landmark_is_degenerate(small_problem):
    weights = small_problem.weights.copy()
    weights[1, 1:] = 0
    found = find_optimum(replace(small_problem, weights=weights), threads=1)
    assert found.status == (Status.OPTIMAL, Status.DEGENERATE)


def test_other_losses_are_refused(small_problem):
    absolute = replace(small_problem, loss=Loss.ABSOLUTE)
    with pytest.raises(ValueError, match="squared loss only"):
        find_optimum(absolute)


def test_starts_of_another_shape_are_refused(small_problem):
    with pytest.raises(ValueError, match="starts"):
        find_optimum(small_problem, np.zeros((2, 3, 3)))


def test_an_image_whose_atoms_underflow_is_a_failure(small_problem):
    tiny = replace(
        small_problem,
        atoms=1e-165 * small_problem.atoms,
        lam=1e-165 * small_problem.lam,
    )
    found = find_optimum(tiny)
    assert set(found.status) == {Status.NUMERICAL_FAILURE}
