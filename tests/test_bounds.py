"""Bounds of cars and of optimality, beside the experiments."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.lower_bounds import best_combination, nearest_atom
from benchmarks.optimality import sections
from shapefit.evaluation.metrics import similarity_error
from shapefit.geometry.rotations import random_rotations

NAN = np.nan


BEST = [1.0, 2.0, 4.0, NAN]


def write_result(
    path: Path,
    *,
    signed: bool = False,
    status: list[str] | None = None,
    **data: list[float],
):
    with h5py.File(path, "w") as file:
        file.attrs["config"] = json.dumps({"signed": signed})
        for name, values in data.items():
            file[name] = values
        if status is not None:
            file.create_dataset("status", data=status, dtype=h5py.string_dtype())


@pytest.fixture
def optima(tmp_path):
    """Results of four images: that of the search, refined ones, and those of
    alternation.
    """
    write_result(
        tmp_path / "global.h5",
        objective=BEST,
        relative_gap=[0.01, 0.03, 0.0, NAN],
        status=["optimal", "iteration limit", "optimal", "degenerate"],
    )
    write_result(
        tmp_path / "refine.h5",
        objective=[1.0, 2.5, 4.0, NAN],
        relative_gap=[0.1, 0.5, 0.0, NAN],
    )
    write_result(
        tmp_path / "alternate-nonnegative.h5", objective=[1.005, 2.0, 6.0, NAN]
    )
    return tmp_path


def cells(page: str) -> dict[str, list[str]]:
    """Return the rows of the tables of a page, by first cell."""
    rows = {}
    for line in page.splitlines():
        if line.startswith("|"):
            first, *others = [cell.strip() for cell in line.strip("|").split("|")]
            rows[first] = others
    return rows


def test_excess_and_the_parts_of_the_gap(optima):
    _, _, table = sections(optima)
    rows = cells(table)
    mean_excess = (1 - 1 / 1.005 + 1 - 4 / 6) / 3
    expected = ["33.33%", "50% (50%)", "–", f"{mean_excess:.2%}", "–"]
    refined = ["33.33%", "25% (25%)", "20.00%", "6.67%", "13.33%"]
    assert rows["Convex+refine"] == refined
    assert rows["Alternate, c >= 0"] == expected
    assert rows["the better of both"][:2] == ["0.00%", "0% (0%)"]


def test_how_many_images_are_certified_is_told(optima):
    _, text, _ = sections(optima)
    assert "Certified to 1%: 66.67% of 3 images; largest gap 3.00%." in text


def test_results_of_another_model_are_refused(optima):
    write_result(optima / "alternate-nonnegative.h5", signed=True, objective=BEST)
    with pytest.raises(ValueError, match="another model"):
        sections(optima)


@pytest.fixture
def atoms(rng):
    """Variants of one shape, as exemplars are: a rotation fits all of them or none."""
    common = rng.standard_normal((3, 9))
    atoms = common + 0.4 * rng.standard_normal((4, 3, 9))
    return atoms - atoms.mean(axis=-1, keepdims=True)


def test_the_nearest_atom_is_the_one_that_the_shape_was_made_from(atoms, rng):
    shown = atoms[[2, 0, 3, 2]]
    noise = 0.01 * rng.standard_normal((4, 3, 9))
    shapes = 5 * random_rotations(4, rng) @ (shown + noise) + 7
    expected = similarity_error(shown, shapes)
    assert_allclose(nearest_atom(shapes, atoms), expected, rtol=1e-12)


def test_a_combination_of_atoms_is_found_whichever_way_it_is_turned_and_sized(
    atoms, rng
):
    c = np.abs(rng.standard_normal((6, 4)))
    mixed = np.einsum("nk,kap->nap", c, atoms)
    turned = 3 * random_rotations(6, rng) @ mixed
    shapes = turned + rng.standard_normal((6, 3, 1))
    best = best_combination(shapes, atoms)
    assert_allclose(best, 3 * mixed, atol=1e-3)
    assert_allclose(similarity_error(best, shapes), 0, atol=1e-3)
