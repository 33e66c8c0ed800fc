"""Recovery of planted rotations: what counts as recovered, and a tiny grid."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks import rotation_recovery
from benchmarks.rotation_recovery import is_recovered, plant, run_cell
from shapefit.geometry.rotations import rotation_about
from shapefit.lifting.methods import SearchOptions, choose_method


@pytest.fixture
def planted(rng):
    return plant(6, 12, 3, rng)


def test_a_planted_shape_is_its_atoms_in_one_rotation(planted):
    flat = (planted.rotation @ planted.atoms).reshape(6, -1).T
    c = np.linalg.lstsq(flat, planted.shape.ravel(), rcond=None)[0]
    np.testing.assert_allclose(flat @ c, planted.shape.ravel(), atol=1e-12)
    assert np.sum(c > 1e-9) == 3
    assert c.sum() == pytest.approx(planted.size)


def test_recovered_is_up_to_translation_but_neither_scale_nor_rotation(planted):
    shape, R = planted.shape, planted.rotation
    moved = shape + np.array([[1.0], [2.0], [3.0]])
    axis = np.array([0.0, 0.0, 1.0])
    assert is_recovered(planted, moved, R)
    assert not is_recovered(planted, 1.02 * shape, R)
    assert is_recovered(planted, shape, rotation_about(axis, np.radians(0.9)) @ R)
    assert not is_recovered(planted, shape, rotation_about(axis, np.radians(1.1)) @ R)
    assert not is_recovered(planted, shape, np.full((3, 3), np.nan))


def test_the_search_recovers_where_the_relaxation_does_not():
    easy, hard = run_cell(30, 2, 3), run_cell(20, 6, 4)
    assert set(easy.recovered.values()) >= {1.0}
    for cell in (easy, hard):
        assert cell.recovered["global"] == cell.certified == 1
        assert cell.missed == cell.better == cell.stopped == 0
    assert hard.recovered["convex"] < 0.5


def test_a_certified_miss_has_an_objective_below_the_planted_one():
    cell = run_cell(5, 6, 4, k=30)
    assert cell.certified == 1
    assert cell.missed == cell.better == 4


def test_a_search_that_stopped_early_is_counted_as_such(monkeypatch):
    def stopped(name, settings):
        options = SearchOptions(max_cells=1) if name == "global" else None
        return choose_method(name, replace(settings, options=options))

    monkeypatch.setattr(rotation_recovery, "choose_method", stopped)
    cell = run_cell(15, 10, 4)
    assert cell.certified == 0
    assert cell.missed == cell.better + cell.stopped
    assert cell.stopped > 0


def test_two_runs_of_a_cell_are_the_same():
    assert run_cell(10, 2, 2, k=8) == run_cell(10, 2, 2, k=8)


def test_the_section_has_a_row_for_each_method_and_is_left_out_where_nothing_was_run(tmp_path):
    assert rotation_recovery.sections(tmp_path) == []
    cells = [asdict(run_cell(10, z, 2, k=6)) for z in (1, 2)]
    path = tmp_path / "rotation-recovery.json"
    path.write_text(json.dumps({"cells": cells}), encoding="utf-8")
    page = "\n".join(rotation_recovery.sections(tmp_path))
    for name in rotation_recovery.METHODS:
        shares = [f"{100 * cell['recovered'][name]:.0f}" for cell in cells]
        row = next(line for line in page.splitlines() if f"`{name}`" in line)
        assert [entry.strip() for entry in row.strip("|").split("|")][1:] == shares
