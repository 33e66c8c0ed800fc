"""Figures of a dictionary: by hand, and the same from parts as from all shapes at once."""

import numpy as np
import pytest

from shapefit.dictionary.coding import duality_gaps, objectives, sparse_code
from shapefit.dictionary.summary import summarise

BETA = 0.1


def test_of_a_small_state():
    atoms = np.zeros((3, 3, 2))
    atoms[0, 0], atoms[1, 1], atoms[2, 2] = [1, -1], [1, -1], [1, -1]
    C = np.array([[1.0, 2, 0], [0, 4, 0]])
    shapes = np.array([[[1.0, -1], [2, -2], [3, -3]], [[0, 0], [4, -4], [4, -4]]])
    found = summarise([(shapes, C, np.array([1.0, 3]))], atoms, BETA)
    assert found.active_atoms == 1.5
    assert found.dead_atoms == 1
    # The residuals are (0, 0, 3) and (0, 0, 4), twice; the shapes have 14 + 32, twice.
    assert found.relative_error == pytest.approx(5 / np.sqrt(46))
    assert found.objective == pytest.approx(25 + 0.1 * 7)
    assert found.largest_gap is not None
    # The spread of each atom is 1/3; the second is used twice by the first shape, four times by
    # the other; nobody uses the third.
    np.testing.assert_allclose(found.atom_scale, [3, 3 * (2 + 12) / 6, 6])


@pytest.fixture
def coded(rng):
    shapes, atoms = rng.standard_normal((50, 3, 5)), 0.2 * rng.standard_normal((6, 3, 5))
    return shapes, sparse_code(shapes, atoms, BETA), rng.uniform(1, 2, 50), atoms


def test_parts_give_what_all_shapes_give(coded):
    *parts, atoms = coded
    whole = summarise([tuple(parts)], atoms, BETA)
    rows = (slice(0, 1), slice(1, 30), slice(30, 50))
    found = summarise([tuple(part[some] for part in parts) for some in rows], atoms, BETA)
    for name in ("objective", "relative_error", "active_atoms", "dead_atoms", "atom_scale"):
        np.testing.assert_allclose(getattr(found, name), getattr(whole, name), rtol=1e-12)
    assert found.largest_gap == pytest.approx(whole.largest_gap, abs=1e-12)


def test_the_largest_gap_is_that_of_the_worst_shape(coded):
    shapes, C, scale, atoms = coded
    C[7] = 0
    found = summarise([(shapes, C, scale)], atoms, BETA).largest_gap
    gap = duality_gaps(shapes, atoms, BETA, C)[7] / objectives(shapes, atoms, BETA, C)[7]
    assert found == pytest.approx(gap)
    assert found > 1e-3


def test_without_beta_the_gap_is_unknown(coded):
    shapes, C, scale, atoms = coded
    assert summarise([(shapes, C, scale)], atoms, 0.0).largest_gap is None
