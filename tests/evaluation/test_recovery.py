"""Planted instances are what they say, and the program finds what an independent solver finds."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import kstest

from shapefit.convex.solution import Status
from shapefit.evaluation.recovery import (
    Attempt,
    Cell,
    Instance,
    RecoveryGrid,
    grid_json,
    markdown,
    plant,
    recover,
    write_csv,
)

CLOSE = {"tolerance": 1e-8, "max_iterations": 10000}


def instance(p, z, seed, k=50):
    return plant(k, p, z, np.random.default_rng(seed))


def error(instance, *, free_translation=False):
    attempt = recover(instance, free_translation=free_translation, **CLOSE)
    assert attempt.status is Status.OPTIMAL
    return attempt.error


def sizes(instance):
    return np.linalg.norm(instance.transforms, ord=2, axis=(1, 2))


@pytest.mark.parametrize(("k", "p", "z"), [(50, 20, 5), (3, 4, 3), (7, 1, 1)])
def test_landmarks_are_the_sum_of_turned_atoms(k, p, z):
    planted = instance(p, z, 1, k)
    W = sum(M @ B for M, B in zip(planted.transforms, planted.atoms, strict=True))
    assert planted.atoms.shape == (k, 3, p)
    np.testing.assert_allclose(planted.landmarks, W, atol=1e-12)


def test_z_transforms_are_multiples_of_two_rows_of_a_rotation_and_the_others_zero():
    planted = instance(20, 5, 2)
    c = sizes(planted)
    assert np.count_nonzero(c) == 5
    assert ((c >= 0) & (c < 1)).all()
    gram = planted.transforms @ planted.transforms.swapaxes(1, 2)
    np.testing.assert_allclose(gram, c[:, None, None] ** 2 * np.eye(2), atol=1e-12)


def test_draws_have_the_distributions_of_the_paper():
    many = [instance(5, 10, seed) for seed in range(100)]
    atoms = np.concatenate([one.atoms.ravel() for one in many])
    coefficients = np.concatenate([sizes(one)[sizes(one) > 0] for one in many])
    places = np.concatenate([np.flatnonzero(sizes(one)) for one in many])
    assert kstest(atoms, "norm").pvalue > 1e-3
    assert kstest(coefficients, "uniform").pvalue > 1e-3
    assert set(places) == set(range(50))
    # A coordinate of a random direction is uniform on [-1, 1] (Archimedes).
    entries = np.concatenate([M[:, 0, 2] / c for M, c in ((o.transforms, sizes(o)) for o in many)
                              for M, c in [(M[c > 0], c[c > 0])]])  # fmt: skip
    assert kstest((entries + 1) / 2, "uniform").pvalue > 1e-3


def test_a_seed_gives_one_instance():
    first, same, other = (instance(10, 2, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.landmarks, same.landmarks)
    assert not np.allclose(first.landmarks, other.landmarks)


@pytest.mark.parametrize("free_translation", [True, False])
def test_one_atom_seen_by_many_landmarks_always_comes_back(free_translation):
    for seed in range(20):
        assert error(instance(25, 1, seed), free_translation=free_translation) < 1e-5


@pytest.mark.parametrize("free_translation", [True, False])
def test_ten_atoms_seen_by_few_landmarks_never_come_back(free_translation):
    for seed in range(20):
        assert error(instance(10, 10, seed), free_translation=free_translation) > 0.1


def judge(planted, *, free_translation):
    """The error of the same program solved by Clarabel."""
    import cvxpy as cp

    M = [cp.Variable((2, 3)) for _ in planted.atoms]
    T = cp.Variable((2, 1)) if free_translation else np.zeros((2, 1))
    ones = np.ones((1, planted.landmarks.shape[1]))
    W = sum(m @ B for m, B in zip(M, planted.atoms, strict=True)) + T @ ones
    program = cp.Problem(cp.Minimize(sum(map(cp.sigma_max, M))), [planted.landmarks == W])
    program.solve(solver=cp.CLARABEL)
    found = np.stack([m.value for m in M])
    return np.linalg.norm(found - planted.transforms) / np.linalg.norm(planted.transforms)


@pytest.mark.slow
@pytest.mark.parametrize("free_translation", [True, False])
@pytest.mark.parametrize(("z", "recovered"), [(1, True), (3, False)])
def test_an_independent_solver_finds_the_same(z, recovered, free_translation):
    planted = instance(8, z, 8, k=12)  # of a single optimum, with T and without
    theirs = judge(planted, free_translation=free_translation)
    assert (theirs < 1e-3) == recovered
    assert error(planted, free_translation=free_translation) == pytest.approx(
        theirs, rel=1e-3, abs=1e-5
    )


def test_a_free_translation_is_centring():
    planted = instance(12, 4, 6)
    centred = Instance(
        planted.landmarks - planted.landmarks.mean(axis=1, keepdims=True),
        planted.atoms - planted.atoms.mean(axis=2, keepdims=True),
        planted.transforms,
    )
    free = error(planted, free_translation=True)
    assert free > 1e-3
    assert error(centred, free_translation=False) == pytest.approx(free, rel=1e-4)
    assert error(planted, free_translation=False) != pytest.approx(free, rel=1e-2)


def test_only_a_free_translation_forgives_a_shift():
    planted = instance(25, 2, 7)
    shifted = Instance(
        planted.landmarks + np.array([[3.0], [-1.0]]), planted.atoms, planted.transforms
    )
    assert error(shifted, free_translation=True) < 1e-5
    assert error(shifted, free_translation=False) > 0.1


def test_a_solver_that_is_stopped_says_so():
    attempt = recover(instance(40, 9, 8), free_translation=True, tolerance=1e-6, max_iterations=1)
    assert attempt.status is Status.ITERATION_LIMIT
    assert attempt.iterations == 1
    assert attempt.error > 1e-3


NAN = float("nan")


def attempt(error, status=Status.OPTIMAL, gap=1e-7):
    return Attempt(error, gap, residual=2e-7, iterations=10, status=status)


def cell(p, z, errors):
    return Cell(p, z, tuple(attempt(error) for error in errors), success_below=1e-3)


@pytest.fixture
def cells():
    return (
        cell(5, 1, [1e-9, 2e-4, 1e-3, 0.5]),
        cell(5, 2, [0.1, 0.2, 0.3, 0.4]),
        cell(10, 1, [1e-9] * 4),
        cell(10, 2, [1e-9, 1e-9, 1e-9, 1]),
    )


@pytest.fixture
def grid(cells):
    return RecoveryGrid(cells, "min f.", {"seconds": 1.5})


def test_an_error_below_the_bound_is_a_success(grid):
    assert grid.shares == {(5, 1): 0.5, (5, 2): 0.0, (10, 1): 1.0, (10, 2): 0.75}


def test_what_the_solver_did_not_finish_is_unsolved_unless_it_is_a_success():
    limit, broken = Status.ITERATION_LIMIT, Status.NUMERICAL_FAILURE
    attempts = (attempt(1e-5, limit), attempt(0.2, limit), attempt(NAN, broken), attempt(0.2))
    unfinished = Cell(5, 1, attempts, success_below=1e-3)
    assert unfinished.success == 0.25
    assert unfinished.unsolved == (1, 2)


def test_csv_has_a_row_for_each_cell(tmp_path, grid):
    write_csv(tmp_path / "recovery.csv", grid)
    with (tmp_path / "recovery.csv").open(newline="", encoding="utf-8") as file:
        assert list(csv.reader(file)) == [
            ["p", "z", "trials", "success"],
            ["5", "1", "4", "0.5"],
            ["5", "2", "4", "0.0"],
            ["10", "1", "4", "1.0"],
            ["10", "2", "4", "0.75"],
        ]


def test_json_has_the_statistics_of_each_cell():
    attempts = (
        Attempt(1e-4, -3e-7, 1e-7, 10, Status.OPTIMAL),
        Attempt(0.3, 1e-7, 5e-7, 40, Status.OPTIMAL),
        Attempt(NAN, NAN, NAN, 5, Status.NUMERICAL_FAILURE),
    )
    grid = RecoveryGrid((Cell(5, 1, attempts, 1e-3),), "min f.", provenance={"seconds": 1.5})
    document = json.loads(grid_json(grid))
    assert document["seconds"] == 1.5
    assert document["cells"] == [
        {
            "p": 5,
            "z": 1,
            "trials": 3,
            "success": pytest.approx(1 / 3),
            "unsolved": [2],
            "median_error": pytest.approx(0.15005),
            "largest_relative_gap": 3e-7,
            "largest_residual": 5e-7,
            "median_iterations": 10,
            "largest_iterations": 40,
        }
    ]


def test_json_of_a_cell_without_any_number_has_nulls():
    broken = Attempt(NAN, NAN, NAN, 0, Status.NUMERICAL_FAILURE)
    (entry,) = json.loads(grid_json(RecoveryGrid((Cell(5, 1, (broken,), 1e-3),), "")))["cells"]
    assert entry["median_error"] is None
    assert entry["largest_residual"] is None


def rows_of(text, heading):
    """Rows of the first Markdown table after a heading."""
    lines = text.split(heading)[1].splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("|"))
    table = []
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        table.append([entry.strip() for entry in line.strip("|").split("|")])
    return [table[0], *table[2:]]


def test_markdown_has_the_shares(grid):
    text = markdown(grid)
    assert rows_of(text, "# Exact recovery") == [
        ["p \\ z", "1", "2"],
        ["5", "0.50", "0.00"],
        ["10", "1.00", "0.75"],
    ]
    assert "4 random instances" in text
    assert "below 0.001" in text


def test_markdown_counts_what_was_not_solved(cells):
    open_ = Cell(15, 1, (attempt(0.2, Status.ITERATION_LIMIT),) * 4, 1e-3)
    assert "- p=15 z=1: 4" in markdown(RecoveryGrid((*cells, open_), ""))
    assert "Not solved" not in markdown(RecoveryGrid(cells, ""))
