"""Shares of successes, and how they are written."""

import csv
import json

import pytest

from shapefit.convex.solution import Status
from shapefit.evaluation.experiments.recovery import Attempt
from shapefit.evaluation.experiments.recovery_grid import (
    Cell,
    RecoveryGrid,
    grid_json,
    markdown,
    write_csv,
)

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
